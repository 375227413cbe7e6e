//! The command as a script meets it: exit codes, messages, files.

mod command;

use command::{command, text};
use std::path::Path;
use std::process::{Output, Stdio};

/// Runs the command in `folder`.
fn fnopt(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).env("FNOPT_LOG", "off").output().expect("the command starts")
}

/// Runs the command, which must refuse its input, say all of `said`, and write nothing into `out`.
fn refused(folder: &Path, arguments: &[&str], said: &[&str]) {
    let output = fnopt(folder, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    for part in said {
        assert!(message.contains(part), "{arguments:?}: no '{part}' in: {message}");
    }
    assert!(output.stdout.is_empty(), "{arguments:?}: {}", text(&output.stdout));
    let written = std::fs::read_dir(folder.join("out")).map_or(0, |entries| entries.count());
    assert_eq!(written, 0, "{arguments:?} left files behind");
}

#[test]
fn bad_input_is_refused_by_name_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let starter = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/checkpoint_starter.safetensors");
    let bytes = std::fs::read(&starter).unwrap();
    let write = |name: &str, content: &[u8]| std::fs::write(at.join(name), content).unwrap();
    write("cut.safetensors", &bytes[..bytes.len() / 2]);
    let mut poisoned = bytes;
    let end = poisoned.len();
    poisoned[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    write("nan.safetensors", &poisoned);
    write("key.json", br#"{"gravty": 9}"#);
    write("mass.json", br#"{"mass_kg": 0}"#);
    write("free.json", br#"{"handles": []}"#);
    write("outside.json", br#"{"handles": [[40, 0]]}"#);
    write("instant.json", br#"{"frame_time_s": 1e-300}"#);
    write("brief.json", br#"{"frame_time_s": 1e-45, "motion": "none", "frames": 3}"#);
    write("wide.json", br#"{"side_m": 1e39}"#);
    write("short.npy", b"\x93NUMPY");
    std::fs::create_dir_all(at.join("taken/rollout.npz")).unwrap();
    std::fs::create_dir_all(at.join("mesh/rollout.obj")).unwrap();
    std::fs::create_dir(at.join("frames")).unwrap();
    write("frames/rollout_obj", b"");
    write("few.toml", b"steps = 4");
    write("large.toml", b"network = { channels = 4096, modes_h = 4096, modes_w = 2049 }");
    write("key.toml", b"[optimizer]\nrat = 1");
    write("range.toml", b"[[pool]]\nmaterial = { bend = [10, 1] }");
    write("start.toml", b"init = 'missing.safetensors'");
    let sizes = format!("init = '{}'\nnetwork = {{ channels = 32 }}", starter.display());
    write("sizes.toml", sizes.as_bytes());
    let cases: &[(&[&str], &[&str])] = &[
        (&["rollout", "--checkpoint", "missing.safetensors"], &["missing.safetensors", "cannot read"]),
        (
            &["rollout", "--checkpoint", "cut.safetensors"],
            &["cut.safetensors", "expected a whole safetensors"],
        ),
        (&["rollout", "--checkpoint", "nan.safetensors"], &["nan.safetensors", "finite"]),
        (&["rollout", "key.json"], &["key.json", "gravty", "did you mean gravity?"]),
        (&["rollout", "mass.json"], &["mass.json", "mass_kg"]),
        (&["rollout", "free.json"], &["free.json", "handles"]),
        (&["rollout", "outside.json"], &["outside.json", "handles"]),
        (&["rollout", "none.json"], &["none.json", "cannot read"]),
        (&["rollout", "--grid", "4", "32"], &["--grid", "8 to 4096", "found 4"]),
        (&["rollout", "--grid", "48,32"], &["--grid", "N or HxW", "48,32"]),
        (&["rollout", "--grid", "48", "scene.json"], &["--grid", "a file goes before it", "48 scene.json"]),
        (&["tune", "--grid", "8x5"], &["--grid", "found 5"]),
        (&["rollout", "--motion", "xz_v3"], &["--motion", "did you mean xyz_v3"]),
        (&["rollout", "--motion", "short.npy"], &["short.npy"]),
        (&["rollout", "--material", "1,2"], &["--material", "three numbers"]),
        (&["rollout", "--material", "nan,2,3"], &["--material", "finite"]),
        (&["rollout", "--material", "mass.json"], &["mass.json", "material"]),
        (&["rollout", "--solver", "bfgs"], &["--solver", "did you mean lbfgs"]),
        (&["rollout", "--adapter", "no such adapter"], &["no adapter named 'no such adapter'"]),
        (&["rollout", "--device", "cpu", "--adapter", "0"], &["--adapter"]),
        (&["rollout", "--device", "cpu", "--precision", "f16"], &["--precision", "f32 on cpu"]),
        (&["verify", ".", "--device", "cpu", "--precision", "f8"], &["--precision", "f16"]),
        (&["rollout", "--format", "obx"], &["obx"]),
        (&["rollout", "instant.json"], &["instant.json", "frame_time_s"]),
        // Finite, but not in single precision.
        (&["rollout", "brief.json"], &["brief.json", "frame_time_s", "single precision"]),
        (&["rollout", "wide.json"], &["wide.json", "side_m", "single precision"]),
        (&["rollout", "--out", "taken"], &["taken/rollout.npz", "a folder"]),
        (&["rollout", "--out", "mesh", "--format", "pc2"], &["mesh/rollout.obj", "a folder"]),
        (&["rollout", "--out", "frames", "--format", "npz,obj"], &["frames/rollout_obj", "cannot create"]),
        (&["evaluate", "--solver", "gd"], &["--ground-truth", "assets/ground_truth", "root of a checkout"]),
        (&["train", "few.toml", "--steps", "5"], &["--steps", "at most 4", "found 5"]),
        (&["verify", "nowhere"], &["nowhere", "cannot read"]),
        (&["inspect", "key.json"], &["key.json"]),
        (&["bench", "--batch", "0"], &["--batch"]),
        (&["bench", "--batch", "100000"], &["--batch"]),
        (
            &["bench", "--device", "cpu", "--solver", "gd", "--grid", "4096", "--batch", "5", "--json"],
            &["--batch", "at most 4 of 4096x4096"],
        ),
        // Nothing is measured before all is checked.
        (&["bench", "--device", "cpu", "--grid", "8,5", "--json"], &["--grid", "found 5"]),
        (&["bench", "--device", "cpu", "--plot", "key.json/plot.png"], &["key.json", "cannot create"]),
        (&["bench", "--device", "cpu", "--plot", "."], &[".: type", "a folder"]),
        (&["train", "none.toml"], &["none.toml", "cannot read"]),
        (&["train", "key.toml"], &["key.toml", "optimizer", "did you mean rate"]),
        (&["train", "large.toml"], &["large.toml", "network", "parameters"]),
        (&["train", "range.toml"], &["range.toml", "pool[0].material.bend", "[smallest, largest]"]),
        (&["train", "start.toml"], &["missing.safetensors", "cannot read"]),
        (&["train", "sizes.toml"], &["checkpoint_starter.safetensors", "network", "channels: 32"]),
        (&["train", "--resume", "nowhere"], &["nowhere", "config.toml"]),
        (&["train", "--resume", "x", "--out", "y"], &["--resume"]),
        (&["train", "--minutes", "0"], &["--minutes", "above 0"]),
    ];
    for (arguments, said) in cases {
        refused(at, arguments, said);
    }
}

#[test]
fn a_file_in_place_of_the_output_folder_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("taken"), "").unwrap();
    refused(folder.path(), &["rollout", "--device", "cpu", "--out", "taken/x"], &["taken", "cannot create"]);
}

#[test]
fn a_rollout_writes_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "rollout", "--device", "cpu", "--grid", "16", "12", "--frames", "6", "--format", "npz,pc2", "--json",
    ];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["frames"], 6);
    for path in summary["written"].as_array().unwrap() {
        assert!(folder.path().join(path.as_str().unwrap()).exists(), "{path}");
    }
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["per_frame"].as_array().unwrap().len(), 5);
    assert!(report["ms_per_frame"].as_f64().unwrap() > 0.0);
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/weights/fnopt.safetensors");
    let sum = crc32fast::hash(&std::fs::read(weights).unwrap());
    assert_eq!(report["weights_crc32"], format!("{sum:08x}"));
    for picture in
        ["out/rollout.png", "out/rollout.gif", "out/rollout.npz", "out/rollout.pc2", "out/rollout.obj"]
    {
        assert!(folder.path().join(picture).metadata().unwrap().len() > 1000, "{picture}");
    }
}

#[test]
fn a_rollout_takes_a_material_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let soft = r#"{"material": {"stretch_modulus": 280, "shear_modulus": 28, "bending_stiffness": 1e-5},
        "wind": {"density": 0.5}, "frame_time_s": 0.01, "fitted_to": "nothing"}"#;
    std::fs::write(folder.path().join("soft.json"), soft).unwrap();
    let arguments = [
        "rollout",
        "--device",
        "cpu",
        "--grid",
        "8",
        "8",
        "--frames",
        "2",
        "--solver",
        "gd",
        "--no-pictures",
        "--material",
        "soft.json",
    ];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let scene = &report["settings"]["scene"];
    assert_eq!(scene["material"]["stretch_modulus"], 280.0, "{report}");
    assert_eq!(scene["wind"]["density"], 0.5);
    assert_eq!(scene["frame_time_s"], 0.01);
}

#[test]
fn a_run_that_explodes_keeps_the_frames_before_and_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["rollout", "--device", "cpu", "--solver", "gd", "--material", "1e30,8,0.5", "--frames", "30"];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("non-finite"));
    for file in ["out/replay.npz", "out/rollout.npz", "out/report.json"] {
        assert!(folder.path().join(file).exists(), "{file}");
    }
    // The replay is not taken for one of the next run, which is good.
    let good = ["rollout", "--device", "cpu", "--solver", "gd", "--frames", "2", "--no-pictures"];
    assert_eq!(fnopt(folder.path(), &good).status.code(), Some(0));
    assert!(!folder.path().join("out/replay.npz").exists());
}

/// A reader that has had enough, and a log that cannot be written, change nothing about how a command ends.
#[test]
fn exit_codes_do_not_hang_on_who_listens() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/adamw.safetensors");
    let rollout = ["rollout", "--device", "cpu", "--solver", "gd", "--frames", "3", "--no-pictures"];
    let cases: [(&[&str], i32); 3] = [
        (&rollout, 0),
        // No network, and nothing at all.
        (&["inspect", golden.to_str().unwrap()], 1),
        (&["inspect", "missing.safetensors"], 2),
    ];
    for (arguments, code) in cases {
        let mut command = command(folder.path(), arguments);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop((child.stdout.take(), child.stderr.take()));
        assert_eq!(child.wait().unwrap().code(), Some(code), "{arguments:?}");
        if cfg!(target_os = "linux") {
            let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
            let ended = command.env("FNOPT_LOG", "info").stdout(Stdio::null()).stderr(full).status().unwrap();
            assert_eq!(ended.code(), Some(code), "{arguments:?}, a full log");
        }
    }
}

/// What fails to be written after the frames are there takes nothing else with it.
#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_is_full_takes_one_file_and_not_the_others() {
    let folder = tempfile::tempdir().unwrap();
    // No file beyond 1000 blocks of 512 bytes: the archive is larger, the positions alone are not.
    let limited = format!(
        "ulimit -f 1000; trap '' XFSZ; exec '{}' rollout --device cpu --solver gd --frames 30 --no-pictures --format npz,npy",
        env!("CARGO_BIN_EXE_fnopt")
    );
    let output =
        std::process::Command::new("sh").args(["-c", &limited]).current_dir(folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("rollout.npz: cannot write"), "{}", text(&output.stderr));
    let out = folder.path().join("out");
    let kept = fnopt::io::Trajectory::read(out.join("rollout.npy"), &Default::default());
    let told = fnopt::io::ReadOptions { grid: Some(fnopt::sim::Grid { h: 32, w: 32 }), ..Default::default() };
    let kept = kept.or_else(|_| fnopt::io::Trajectory::read(out.join("rollout.npy"), &told)).unwrap();
    assert_eq!(kept.frames(), 30);
    let mut names: Vec<_> =
        std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["report.json", "rollout.npy"]);
}

#[cfg(unix)]
#[test]
fn an_interrupted_rollout_keeps_the_frames_so_far() {
    use std::io::BufRead;
    for signal in ["-INT", "-TERM"] {
        let folder = tempfile::tempdir().unwrap();
        let rollout = ["rollout", "--device", "cpu", "--grid", "64", "64", "--no-pictures"];
        let mut child = command(folder.path(), &rollout).stderr(Stdio::piped()).spawn().unwrap();
        let mut log = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
        // From the line that names the device on, the command listens.
        assert!(log.by_ref().map(Result::unwrap).any(|line| line.starts_with("device: ")));
        command::send(signal, &child);
        let told: Vec<String> = log.map(Result::unwrap).collect();
        assert!(told.iter().any(|line| line.starts_with("interrupted after frame ")), "{told:?}");
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let frames = report["frames"].as_u64().unwrap() as usize;
        assert!((2..391).contains(&frames), "{frames} frames");
        assert_eq!(report["per_frame"].as_array().unwrap().len(), frames - 1);
        let kept = folder.path().join("out/rollout.npz");
        let kept = fnopt::io::Trajectory::read(kept, &Default::default()).unwrap();
        assert_eq!(kept.frames(), frames, "{signal}");
    }
}

#[cfg(unix)]
#[test]
fn paths_need_not_be_utf_8() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let name = std::ffi::OsStr::from_bytes(b"caf\xe9");
    let run = |arguments: &[&str]| {
        let output = command(folder.path(), arguments).arg(name).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    let short = ["--device", "cpu", "--solver", "gd", "--frames", "2", "--no-pictures", "--json", "--out"];
    assert_eq!(run(&[&["rollout"], &short[..]].concat())["frames"], 2);
    assert!(folder.path().join(name).join("rollout.npz").is_file());
    std::fs::remove_dir_all(folder.path().join(name)).unwrap();
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/weights/fnopt.safetensors");
    std::fs::copy(weights, folder.path().join(name)).unwrap();
    assert!(run(&["inspect", "--json"])["file"].as_str().unwrap().starts_with("caf"));
}

#[test]
fn verify_fails_on_a_damaged_file_and_inspect_prints_json() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let mut bytes = std::fs::read(golden.join("energy_small.safetensors")).unwrap();
    let name = folder.path().join("energy_small.safetensors");
    std::fs::write(&name, &bytes).unwrap();
    let good = fnopt(folder.path(), &["verify", ".", "--device", "cpu"]);
    assert_eq!(good.status.code(), Some(0), "{}", text(&good.stdout));
    assert!(text(&good.stdout).ends_with("14 passed, 0 failed, 0 skipped\n"), "{}", text(&good.stdout));
    let end = bytes.len();
    bytes.truncate(end - 100);
    std::fs::write(&name, &bytes).unwrap();
    assert_eq!(fnopt(folder.path(), &["verify", ".", "--device", "cpu"]).status.code(), Some(1));

    // One line for each array of each file, in both precisions; nothing is passed over.
    let all = fnopt(folder.path(), &["verify", golden.to_str().unwrap(), "--device", "cpu"]);
    assert_eq!(all.status.code(), Some(0), "{}", text(&all.stdout));
    for stage in ["training_step", "adamw", "energy_crumpled", "repulsion_threshold0.5"] {
        assert!(text(&all.stdout).contains(&format!("pass  {stage} ")), "no check of {stage}");
    }

    let weights = golden.join("network_weights.safetensors");
    let output = fnopt(folder.path(), &["inspect", weights.to_str().unwrap(), "--json"]);
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(value["network"]["parameters"], 1_349_634);
}

#[test]
fn what_is_logged_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let log = |filter: &str, code| {
        let rollout = ["rollout", "--device", "cpu", "--frames", "2", "--grid", "8", "8", "--no-pictures"];
        let output = command(folder.path(), &rollout).env("FNOPT_LOG", filter).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    let told = log("info", 0);
    for line in ["scene: ", "weights: those that come with the program, ", "device: cpu"] {
        assert!(told.contains(line), "no '{line}' in: {told}");
    }
    assert!(!told.contains('\u{1b}'), "colours in a file: {told:?}");
    assert!(!log("", 0).contains("scene: ") && !log("off", 0).contains("scene: "));
    let refused = log("fnopt=loud", 2);
    assert!(refused.contains("FNOPT_LOG") && refused.contains("fnopt=loud"), "{refused}");
    assert!(log("inof", 2).contains("FNOPT_LOG: unknown level 'inof' (did you mean info"));
}

/// A run small enough to take no time, which validates on one small grid.
const TINY: &str = "steps = 4\nnetwork = { lifting = 8, channels = 8, projection = 8 }\n\
    pool = [{ grid = [9, 12], iterations = 2, cloths = 3, batch = 2 }]\n\
    validation = { frames = 2, grids = [[9, 12]] }\n";

#[test]
fn a_training_run_fills_its_folder_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tiny.toml"), TINY).unwrap();
    let train = |arguments: &[&str]| {
        let output = fnopt(folder.path(), &[&["train", "--device", "cpu"], arguments].concat());
        let log = text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{log}");
        // Validation is told where there is no terminal for a bar as well.
        assert!(log.contains(": hanging 9x12: "), "{log}");
        text(&output.stdout)
    };
    assert!(train(&["tiny.toml", "--out", "once"]).contains("4 steps of 4 done"));
    assert!(train(&["tiny.toml", "--out", "twice", "--steps", "2"]).contains("2 steps of 4 done"));
    assert!(train(&["--resume", "twice"]).contains("4 steps of 4 done"));
    let weights = |run: &str| {
        let root = folder.path().join(run);
        for file in ["config.toml", "metrics.csv", "validation.csv", "plot.png", "weights/last.json"] {
            assert!(root.join(file).is_file(), "{run} has no {file}");
        }
        std::fs::read(root.join("weights/last.safetensors")).unwrap()
    };
    assert!(weights("once") == weights("twice"), "a run in two sessions has other bits");
    // One that begins with those weights is continued with its own configuration, and tells where they are.
    std::fs::create_dir(folder.path().join("more")).unwrap();
    let more = "init = '../once/weights/last.safetensors'\n".to_owned() + TINY;
    std::fs::write(folder.path().join("more/more.toml"), more).unwrap();
    train(&["more/more.toml", "--out", "third", "--steps", "2"]);
    assert!(train(&["more/more.toml", "--resume", "third"]).contains("4 steps of 4 done"));
    let card = std::fs::read(folder.path().join("third/weights/last.json")).unwrap();
    let card: serde_json::Value = serde_json::from_slice(&card).unwrap();
    let init = Path::new(card["config"]["init"][0].as_str().unwrap());
    assert!(init.is_absolute() && init.is_file(), "{card}");
    // What it trained can be used.
    let arguments =
        ["rollout", "--device", "cpu", "--frames", "3", "--checkpoint", "once/weights/last.safetensors"];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[cfg(not(feature = "mpi"))]
#[test]
fn several_processes_without_mpi_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, count, code) in
        [("OMPI_COMM_WORLD_SIZE", "2", 2), ("SLURM_STEP_NUM_TASKS", "4", 2), ("SLURM_STEP_NUM_TASKS", "1", 0)]
    {
        std::fs::write(folder.path().join("tiny.toml"), TINY).unwrap();
        let train = ["train", "tiny.toml", "--device", "cpu", "--out", "run"];
        let output = command(folder.path(), &train).env(name, count).output().unwrap();
        let log = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{log}");
        assert!(code == 0 || log.contains(name) && log.contains("without the feature mpi"), "{log}");
    }
}

#[test]
fn a_training_run_that_stays_non_finite_ends_with_3() {
    let folder = tempfile::tempdir().unwrap();
    let config = TINY.replace("batch = 2", "batch = 2, material = { stretch = [1e300, 1e300] }");
    std::fs::write(folder.path().join("stiff.toml"), config.replace("steps = 4", "steps = 40")).unwrap();
    let output = fnopt(folder.path(), &["train", "stiff.toml", "--device", "cpu", "--out", "run"]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("10 skipped"), "{}", text(&output.stderr));
    assert!(folder.path().join("run/weights/last.safetensors").is_file());
}

#[cfg(unix)]
#[test]
fn an_interrupted_training_run_keeps_what_is_done() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("long.toml"), TINY.replace("steps = 4", "steps = 1000000")).unwrap();
    let train = ["train", "long.toml", "--device", "cpu", "--out", "run"];
    let mut child = command(folder.path(), &train).stderr(Stdio::piped()).spawn().unwrap();
    // The first checkpoint would come after minutes; metrics come early.
    let metrics = folder.path().join("run/metrics.csv");
    let begun = std::time::Instant::now();
    while std::fs::read_to_string(&metrics).map_or(0, |text| text.lines().count()) < 2 {
        if begun.elapsed().as_secs() > 60 {
            child.kill().unwrap();
            panic!("no metrics within a minute");
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // As Slurm, `timeout` and `kill` end what they started.
    command::send("-TERM", &child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let output = fnopt(folder.path(), &["train", "--resume", "run", "--device", "cpu", "--minutes", "0.001"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("continuing after step"), "{}", text(&output.stderr));
}

#[test]
fn an_evaluation_keeps_its_scores() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/ground_truth");
    let truth = truth.to_str().unwrap();
    let evaluate = |more: &[&str]| {
        let short =
            ["--frames", "6", "--points", "200", "--solver", "newton,gd,lbfgs", "--ground-truth", truth];
        let output = fnopt(at, &[&["evaluate"], &short[..], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let whole = evaluate(&["--plots", "plots", "--markdown", "t.md", "--csv", "t.csv", "--json", "t.json"]);
    for file in ["per_frame", "repulsion", "iterations", "convergence", "errors_xy_v2_32x32"] {
        assert!(at.join(format!("plots/{file}.png")).is_file(), "{file}");
    }
    for (file, says) in [("t.md", "| xy_v2 |"), ("t.csv", "xy_v2,"), ("t.json", "\"sequence\": \"xy_v2\"")] {
        assert!(std::fs::read_to_string(at.join(file)).unwrap().contains(says), "{file}");
    }
    // Times would differ if anything were simulated again.
    assert_eq!(evaluate(&[]), whole);

    // Another system, here the truth itself, stands beside them.
    let other = evaluate(&["--compare", &format!("arcsim={truth}")]);
    assert!(other.contains("arcsim"), "{other}");

    let clean = tempfile::tempdir().unwrap();
    refused(clean.path(), &["evaluate", "--suite", "motion"], &["motion", "did you mean motions?"]);
    let refused = |arguments: &[&str], said: &[&str]| {
        refused(clean.path(), &[&["evaluate", "--ground-truth", truth], arguments].concat(), said);
    };
    refused(&["--solver", "newtn"], &["newtn", "did you mean newton?"]);
    refused(&["--solver", "fnopt:x"], &["--solver", "NAME:ITERATIONS"]);
    refused(&["--sequences", "xy_v3"], &["xy_v3", "did you mean xy_v2?"]);
    refused(&["--grid", "4"], &["--grid", "8"]);
    refused(&["--shard", "2/2"], &["--shard", "0 to 1"]);
    refused(&["--material", "1,2"], &["--material", "three numbers or a file"]);
    refused(&["--material", "1,2,-3"], &["--material", "not negative"]);
    std::fs::write(clean.path().join("m.json"), r#"{"material": {"stretch": 1, "shear": "8"}}"#).unwrap();
    refused(&["--material", "m.json"], &["m.json", "material.shear", "a number"]);
    refused(&["--compare", "ours=nowhere"], &["--compare", "a folder"]);
    std::fs::create_dir(clean.path().join("empty")).unwrap();
    refused(&["--compare", "ours=empty"], &["empty", "xy_v2.npz"]);
}

#[test]
fn a_suite_fails_when_a_case_is_not_sound() {
    let folder = tempfile::tempdir().unwrap();
    let suite = |solver: &str| {
        let arguments = ["--suite", "handles", "--sequences", "corners flat", "--grid", "12", "--no-gap"];
        fnopt(folder.path(), &[&["evaluate", "--frames", "30", "--solver", solver], &arguments[..]].concat())
    };
    let good = suite("newton");
    assert_eq!(good.status.code(), Some(0), "{}", text(&good.stderr));
    let picture = folder.path().join("out/evaluate/newton_1_12x12_corners_flat.png");
    assert!(picture.is_file());
    assert_eq!(suite("interpolation").status.code(), Some(2));
    // Two numbers of iterations are two tables.
    let both = suite("lbfgs:50,lbfgs:100");
    let rows = text(&both.stdout).lines().filter(|line| line.starts_with("corners flat")).count();
    assert_eq!(rows, 2, "{}", text(&both.stdout));
    // The classical method diverges from a flat sheet on so coarse a grid.
    let bad = suite("quasi-newton:10");
    assert_eq!(bad.status.code(), Some(1), "{}", text(&bad.stdout));
}

/// On the software adapter that the tests need anyway.
#[test]
fn a_tuning_is_stored_for_its_adapter_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let run = |arguments: &[&str]| {
        let arguments = [arguments, &["--adapter", "llvmpipe", "--iterations", "1"]].concat();
        let output = command(folder.path(), &arguments).output().expect("the command starts");
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        (text(&output.stdout), text(&output.stderr))
    };
    let (dry, _) = run(&["tune", "--grid", "8", "--dry-run"]);
    assert!(dry.contains("best: tile ") && !cache.exists(), "{dry}");
    let (tuned, _) = run(&["tune", "--grid", "8", "--json"]);
    let tuned: serde_json::Value = serde_json::from_str(&tuned).unwrap();
    let times: Vec<f64> =
        tuned["tried"].as_array().unwrap().iter().map(|t| t["ms"].as_f64().unwrap()).collect();
    assert!(times.len() > 5 && times.iter().all(|&ms| ms > 0.0), "{times:?}");
    let file = tuned["file"].as_str().unwrap();
    let stored: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    assert_eq!(stored["tuning"], tuned["best"]);

    let rollout = ["rollout", "--device", "gpu", "--frames", "2", "--no-pictures"];
    let (_, log) = run(&rollout);
    assert!(!log.contains("no tuning of"), "{log}");
    // What is damaged, or asks for what the kernels cannot do, is said and passed over.
    for damage in ["{", &stored.to_string().replace("\"channels\":", "\"channels\":3")] {
        std::fs::write(file, damage).unwrap();
        let (_, log) = run(&rollout);
        assert!(log.contains("no tuning of"), "{damage}: {log}");
    }
}

/// On the software adapter, whose cache holds next to nothing: the file is read and written like any other's.
#[test]
fn pipelines_are_stored_for_their_adapter_and_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let run = |cache: &Path| {
        let rollout =
            ["rollout", "--device", "gpu", "--adapter", "llvmpipe", "--solver", "gd", "--no-pictures"];
        let mut command = command(folder.path(), &rollout);
        command.args(["--frames", "2", "--grid", "8", "8"]);
        let output = command.env("FNOPT_CACHE", cache).env("FNOPT_LOG", "info").output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    let first = run(&cache);
    assert!(first.contains("pipeline cache: ") && first.contains(", 0 bytes"), "{first}");
    let entries: Vec<_> = std::fs::read_dir(&cache).unwrap().map(|entry| entry.unwrap().path()).collect();
    let [file] = &entries[..] else { panic!("{entries:?}") };
    let name = file.file_name().unwrap().to_str().unwrap();
    assert!(name.starts_with("pipelines_") && name.ends_with(".bin"), "{name}");
    let stored = std::fs::read(file).unwrap();
    let written = || std::fs::metadata(file).unwrap().modified().unwrap();

    let before = written();
    let again = run(&cache);
    assert!(!again.contains(", 0 bytes") && !again.contains("WARN"), "{again}");
    assert_eq!(written(), before, "nothing was new, and the file was written");

    let mut changed = stored.clone();
    changed[stored.len() / 2] ^= 1;
    for damage in [&changed[..], &stored[..stored.len() - 1], b"", b"of something else"] {
        std::fs::write(file, damage).unwrap();
        let log = run(&cache);
        assert!(log.contains("no pipelines of") && log.contains(", 0 bytes"), "{log}");
        assert_eq!(std::fs::read(file).unwrap().len(), stored.len(), "it was not replaced");
        assert!(!run(&cache).contains("no pipelines of"));
    }
    // Nowhere to store them.
    let log = run(file);
    assert!(log.contains("the next start will be as slow"), "{log}");
}

/// On the software adapter, which has f16.
#[test]
fn networks_run_in_half_precision() {
    let folder = tempfile::tempdir().unwrap();
    let on = ["--device", "gpu", "--adapter", "llvmpipe", "--precision", "f16"];
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    for (arguments, said) in [
        (
            &["rollout", "--frames", "3", "--grid", "12", "8", "--no-pictures", "--json"][..],
            "the network in f16",
        ),
        (&["bench", "--grid", "8", "--frames", "1", "--json"], "the network in f16"),
        (&["verify", golden.to_str().unwrap()], "gpu f16"),
    ] {
        let output = fnopt(folder.path(), &[arguments, &on].concat());
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        assert!(text(&output.stdout).contains(said), "{arguments:?}: {}", text(&output.stdout));
    }
}
