//! Configurations: what they mean, and how bad ones are refused.

use fnopt::settings::Normalisation;
use fnopt::train::{Alone, Config, Decay, Every, PoolConfig, initial_weights, random_weights};
use proptest::prelude::*;
use std::path::Path;

fn parse(text: &str) -> fnopt::Result<Config> {
    Config::parse(text, Path::new("runs/some.toml"))
}

#[test]
fn the_paper_is_the_default() {
    assert_eq!(parse("").unwrap(), Config::default());
    let paper = include_str!("../../assets/training/paper.toml");
    assert_eq!(parse(paper).unwrap(), Config::default());
    let paper = Config::default();
    assert_eq!(paper.pools.iter().map(|p| p.iterations).collect::<Vec<_>>(), [1, 3, 10, 30]);
    assert_eq!(paper.pools.iter().map(|p| (p.cloths, p.batch)).collect::<Vec<_>>(), [(1000, 10); 4]);
    // The paper's recipe in numbers (sections 3.3 and 4).
    let motion = paper.motion;
    assert_eq!((motion.moving, motion.pinch, motion.gravity), (0.8, 0.4, 0.125));
    assert_eq!((motion.rotation, motion.amplitude, motion.frequency), (0.0628, 10.0, 0.2));
    assert_eq!((motion.aligned, motion.corners, motion.more_handles, motion.damping), (0.0, 1.0, 0.5, 0.0));
    assert_eq!((paper.reset.energy, paper.reset.sequence_length, paper.reset.scale), (2e4, 1000, None));
    let settings = paper.optimizer.settings;
    assert_eq!((settings.weight_decay, settings.epsilon, settings.clip), (0.01, 1e-8, 1.0));
    assert_eq!((settings.betas, paper.optimizer.rate), ([0.9, 0.999], 1e-3));
}

#[test]
fn every_field_can_be_set() {
    let config = parse(
        r#"
        seed = 9
        steps = 70
        log_every = 5
        average = 0.9
        normalisation = "cloth"
        notes = "A try."
        init = "given.safetensors"
        checkpoint = { every = { steps = 7 } }
        [network]
        channels = 16
        [[pool]]
        grid = [24, 40]
        iterations = 3
        cloths = 4
        corners = 0.75
        material = { bend = [0.1, 0.1] }
        [motion]
        pinch = 0
        aligned = 0.25
        corners = 0.5
        [reset]
        scale = [1e-5, 2]
        [optimizer]
        betas = [0.8, 0.99]
        [schedule]
        warmup = 3
        decay = { cosine = { final = 1e-6 } }
        [validation]
        every = { minutes = 0.5 }
        grids = [[16, 12]]
        "#,
    )
    .unwrap();
    assert_eq!((config.seed, config.steps, config.log_every, config.average), (9, 70, 5, 0.9));
    assert_eq!(
        (config.normalisation, Config::default().normalisation),
        (Normalisation::Cloth, Normalisation::Component)
    );
    assert_eq!(config.notes, "A try.");
    assert_eq!(config.init, [Path::new("runs/given.safetensors")]);
    let several = parse("init = ['a.safetensors', '../b.safetensors']").unwrap();
    assert_eq!(several.init, [Path::new("runs/a.safetensors"), Path::new("runs/../b.safetensors")]);
    assert_eq!((config.network.channels, config.network.lifting), (16, 256));
    let [pool] = &config.pools[..] else { panic!("one pool") };
    assert_eq!((pool.grid.h, pool.grid.w, pool.iterations, pool.cloths, pool.batch), (24, 40, 3, 4, 4));
    assert_eq!(pool.material.bend, [0.1, 0.1]);
    assert_eq!((pool.corners, pool.sequence_length), (Some(0.75), None));
    assert_eq!(pool.material.stretch, PoolConfig::default().material.stretch);
    assert_eq!((config.motion.pinch, config.motion.aligned, config.motion.corners), (0.0, 0.25, 0.5));
    assert_eq!(config.reset.scale, Some([1e-5, 2.0]));
    assert_eq!(config.optimizer.settings.betas, [0.8, 0.99]);
    assert_eq!((config.schedule.warmup, &config.schedule.decay), (3, &Decay::Cosine { last: 1e-6 }));
    assert_eq!((config.checkpoint, config.validation.every), (Every::Steps(7), Every::Minutes(0.5)));
    let shipped = include_str!("../../assets/training/shipped-13.toml");
    assert!(parse(shipped).unwrap().pools.len() > 4);
}

/// A card shows a configuration as it was written, so a field that is swapped or left out differs.
#[test]
fn a_configuration_is_the_one_that_was_written() {
    let text = r#"
        notes = "All fields, none of them the default."
        seed = 2
        steps = 3000
        log_every = 4
        average = 0.05
        normalisation = "cloth"
        init = []
        [network]
        fields = 3
        lifting = 6
        channels = 7
        projection = 8
        layers = 9
        modes_h = 10
        modes_w = 11
        [[pool]]
        grid = [22, 43]
        iterations = 14
        cloths = 15
        batch = 12
        every = 16
        sequence_length = 17
        corners = 0.18
        material = { stretch = [19.0, 20.0], shear = [21.0, 22.5], bend = [0.23, 24.0] }
        [[pool]]
        grid = [54, 55]
        iterations = 56
        cloths = 57
        batch = 13
        every = 1
        sequence_length = 58
        corners = 0.59
        material = { stretch = [60.0, 61.0], shear = [62.0, 63.5], bend = [0.64, 65.0] }
        [motion]
        moving = 0.25
        rotation = 0.26
        amplitude = 27.0
        frequency = 0.28
        pinch = 0.29
        gravity = 0.30
        aligned = 0.31
        corners = 0.32
        more_handles = 0.33
        damping = 0.34
        [reset]
        energy = 35.0
        sequence_length = 36
        scale = [0.01, 0.37]
        [optimizer]
        rate = 0.38
        betas = [0.39, 0.40]
        epsilon = 0.41
        weight_decay = 0.42
        clip = 0.43
        [schedule]
        warmup = 44
        decay = { cosine = { final = 0.045 } }
        [validation]
        every = { steps = 46 }
        frames = 47
        iterations = 48
        grids = [[29, 50], [31, 52]]
        [checkpoint]
        every = { minutes = 53.0 }
    "#;
    let mut written: serde_json::Value = toml::from_str(text).unwrap();
    let mut without_sizes = written.clone();
    // A property of the cloth, not a setting.
    without_sizes["network"].as_object_mut().unwrap().remove("fields");
    let text = text.replace("fields = 3\n", "");
    assert_eq!(toml::from_str::<serde_json::Value>(&text).unwrap(), without_sizes);
    // The table has a single field.
    written["checkpoint"] = written["checkpoint"]["every"].take();
    let found = serde_json::to_value(parse(&text).unwrap()).unwrap();
    assert_eq!(found, written);
    // Apart from two, no value is the default.
    let default = serde_json::to_value(Config::default()).unwrap();
    let same: Vec<String> =
        leaves(&written).into_iter().filter(|at| written.pointer(at) == default.pointer(at)).collect();
    assert_eq!(same, ["/network/fields", "/pool/1/every"]);
}

/// Returns where the values of a document are that hold no others.
fn leaves(document: &serde_json::Value) -> Vec<String> {
    let below =
        |key: &str, value| leaves(value).into_iter().map(|at| format!("/{key}{at}")).collect::<Vec<_>>();
    match document {
        serde_json::Value::Object(fields) => {
            fields.iter().flat_map(|(key, value)| below(key, value)).collect()
        }
        serde_json::Value::Array(items) => {
            items.iter().enumerate().flat_map(|(k, value)| below(&k.to_string(), value)).collect()
        }
        _ => vec![String::new()],
    }
}

#[test]
fn bad_configurations_are_refused_by_field() {
    let cases: &[(&str, &[&str])] = &[
        ("sed = 3", &["unknown field 'sed'", "did you mean seed"]),
        ("[optimizer]\nrat = 1", &["optimizer", "unknown field 'rat'", "did you mean rate"]),
        ("[[pool]]\n[[pool]]\ncloth = 1", &["pool[1]", "unknown field 'cloth'", "cloths"]),
        ("pool = []", &["pool", "at least one"]),
        ("[[pool]]\ngrid = [4, 32]", &["pool[0].grid", "8 to 4096"]),
        ("[[pool]]\ncloths = 3\nbatch = 4", &["pool[0].batch", "1 to 3", "found 4"]),
        ("[[pool]]\ncorners = 2", &["pool[0].corners", "0 to 1"]),
        ("[[pool]]\nevery = 0", &["pool[0].every", "1 or more"]),
        ("[[pool]]\nevery = 2\n[[pool]]\nevery = 3", &["pool", "one with every = 1"]),
        ("[[pool]]\niterations = 0", &["pool[0].iterations", "found 0"]),
        ("[[pool]]\nmaterial = { bend = [10, 0.01] }", &["pool[0].material.bend", "[smallest, largest]"]),
        ("[[pool]]\nmaterial = { bend = [-1, 1] }", &["pool[0].material.bend", "above 0"]),
        ("[[pool]]\ngrid = [8, 8]\ncloths = 2_000_000", &["pool", "at most 1048576 cloths"]),
        ("[[pool]]\ngrid = [4000, 4000]", &["pool", "particles in all pools"]),
        ("[optimizer]\nrate = -1", &["optimizer.rate", "above 0", "-1"]),
        ("[optimizer]\nrate = nan", &["optimizer.rate", "finite"]),
        ("[optimizer]\nbetas = [0.9, 1]", &["optimizer.betas[1]", "below 1"]),
        ("[motion]\nmoving = 1.5", &["motion.moving", "0 to 1"]),
        ("[motion]\ndamping = -0.1", &["motion.damping", "0 to 1"]),
        ("average = 1", &["average", "below 1"]),
        ("normalisation = 'cloths'", &["normalisation", "\"component\" or \"cloth\"", "cloths"]),
        ("init = 3", &["init", "text"]),
        ("init = ['a', 3]", &["init[1]", "text"]),
        ("steps = 0", &["steps", "1 or more"]),
        ("steps = -5", &["steps", "1 or more", "-5"]),
        ("[schedule]\ndecay = \"cosin\"", &["schedule.decay", "cosine"]),
        (
            "[schedule]\ndecay = { cosine = { final = 1 } }",
            &["schedule.decay.cosine.final", "at most the rate"],
        ),
        ("[validation]\nevery = { hours = 1 }", &["validation.every", "unknown field 'hours'"]),
        ("[validation]\nevery = 3", &["validation.every", "{ steps = N }"]),
        ("[validation]\ngrids = []", &["validation.grids", "at least one"]),
        ("[network]\nmodes_h = 16\n[[pool]]\ngrid = [12, 32]", &["pool[0].grid", "16x5", "12x32"]),
        ("seed = \nsteps = 4", &["line 1, column 8", "TOML"]),
    ];
    for (text, said) in cases {
        let message = parse(text).expect_err(text).to_string();
        assert!(message.starts_with("runs/some.toml: "), "{message}");
        for part in *said {
            assert!(message.contains(part), "{text}: no '{part}' in: {message}");
        }
    }
}

#[test]
fn the_text_of_a_file_names_the_same_files_from_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().canonicalize().unwrap();
    let name = root.join("deep/some.toml");
    std::fs::create_dir(root.join("deep")).unwrap();
    let tail = "seed = 3 # init = 'x'\n[optimizer]\nrate = 1e-4\n";
    for (init, files) in [
        ("init = 'a.st' # kept\n", &["deep/a.st"][..]),
        ("init = [ \"../b c.st\", # kept\n 'q\"\\u.st' ]\n", &["deep/../b c.st", "deep/q\"\\u.st"]),
        ("# kept\n", &[]),
    ] {
        std::fs::write(&name, init.to_owned() + tail).unwrap();
        // The path to the file does not matter.
        for path in [name.clone(), root.join("deep/../deep/some.toml")] {
            let (text, config) = Config::load(&path).unwrap();
            assert_eq!(config.init, files.iter().map(|file| root.join(file)).collect::<Vec<_>>());
            assert!(text.contains("# kept") && text.ends_with(tail), "{text}");
            assert_eq!(Config::parse(&text, Path::new("/another/folder.toml")).unwrap(), config);
        }
    }
}

proptest! {
    #[test]
    fn changed_configurations_never_panic(
        at in any::<prop::sample::Index>(), text in "[\\[\\]{}\"',=.0-9a-z_ \n-]{0,12}"
    ) {
        let mut toml = include_str!("../../assets/training/shipped-9.toml").to_owned();
        let from = toml.floor_char_boundary(at.index(toml.len()));
        let to = toml.floor_char_boundary((from + text.len()).min(toml.len()));
        toml.replace_range(from..to, &text);
        let _ = parse(&toml);
    }

    #[test]
    fn any_file_name_is_found_from_anywhere(name in "[^/\\x00-\\x1f\\x7f]{1,20}") {
        prop_assume!(name != "." && name != "..");
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let quoted = name.replace('\\', "\\\\").replace('"', "\\\"");
        std::fs::write(root.join("c.toml"), format!("init = \"{quoted}\"\n")).unwrap();
        let (text, config) = Config::load(root.join("c.toml")).unwrap();
        prop_assert_eq!(&config.init, &[root.join(&name)]);
        prop_assert_eq!(Config::parse(&text, Path::new("/another/c.toml")).unwrap(), config);
    }
}

#[test]
fn a_run_begins_with_the_mean_of_the_files_it_is_given() {
    let mut config = parse("[network]\nlifting = 8\nchannels = 4\nprojection = 4\nlayers = 1").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let all = [1, 2, 3].map(|seed| random_weights(config.network, seed));
    for (k, weights) in all.iter().enumerate() {
        config.init.push(folder.path().join(format!("{k}.safetensors")));
        weights.save(&config.init[k]).unwrap();
    }
    let found = initial_weights(&config, &Alone).unwrap().flat();
    let all = all.map(|weights| weights.flat());
    for (k, &found) in found.iter().enumerate() {
        let mean = all.iter().map(|flat| f64::from(flat[k])).sum::<f64>() / 3.0;
        assert_eq!(found, mean as f32);
    }
    config.init.truncate(1);
    assert_eq!(initial_weights(&config, &Alone).unwrap().flat(), all[0]);
    config.network.layers = 2;
    let error = initial_weights(&config, &Alone).unwrap_err().to_string();
    assert!(
        error.ends_with("0.safetensors: network.layers: expected 2, as in the configuration, found 1"),
        "{error}"
    );
}
