//! Behaviour common to all commands: refusals, exit codes, logs and file names.

use super::command::{command, copy_golden, exploding_bench, fnopt, refused_cleanly, text};
use std::path::Path;
use std::process::Stdio;

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
            &["cut.safetensors", "expected a complete safetensors"],
        ),
        (&["rollout", "--checkpoint", "nan.safetensors"], &["nan.safetensors", "finite"]),
        (&["rollout", "key.json"], &["key.json", "gravty", "did you mean gravity?"]),
        (&["rollout", "mass.json"], &["mass.json", "mass_kg"]),
        (&["rollout", "free.json"], &["free.json", "handles"]),
        (&["rollout", "outside.json"], &["outside.json", "handles"]),
        (&["rollout", "none.json"], &["none.json", "cannot read"]),
        (&["rollout", "--grid", "4", "32"], &["--grid", "8 to 4096", "found 4"]),
        (&["rollout", "--grid", "48,32"], &["--grid", "N or HxW", "48,32"]),
        (
            &["rollout", "--grid", "48", "scene.json"],
            &["--grid", "with any file name before --grid", "48 scene.json"],
        ),
        #[cfg(not(feature = "view"))]
        (&["view", "--size", "9x9"], &["unknown command 'view'", "--features view"]),
        (&["tune", "--grid", "8x5"], &["--grid", "found 5"]),
        (&["tune", "--solver", "adam"], &["--solver", "expected fnopt", "found adam"]),
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
        // Finite in double precision, but not in single.
        (&["rollout", "brief.json"], &["brief.json", "frame_time_s", "single precision"]),
        (&["rollout", "wide.json"], &["wide.json", "side_m", "single precision"]),
        (&["rollout", "--out", "taken"], &["taken/rollout.npz", "a folder"]),
        (&["rollout", "--out", "mesh", "--format", "pc2"], &["mesh/rollout.obj", "a folder"]),
        (&["rollout", "--out", "frames", "--format", "npz,obj"], &["frames/rollout_obj", "cannot create"]),
        (&["evaluate", "--solver", "gd"], &["--ground-truth", "assets/ground_truth", "root of a checkout"]),
        (&["train", "few.toml", "--steps", "5"], &["--steps", "at most 4", "found 5"]),
        (&["verify", "nowhere"], &["nowhere", "cannot read"]),
        (&["rollout", "--frames", "-1"], &["'-1' for '--frames <F>'"]),
        (&["evaluate", "--frames", "0"], &["'0' for '--frames <F>'"]),
        (&["inspect", "key.json"], &["key.json"]),
        (&["bench", "--batch", "0"], &["--batch"]),
        (&["bench", "--grid", "8,9", "--most-particles", "10"], &["--most-particles", "64 or more"]),
        (&["bench", "--iterations", "-1"], &["--iterations", "-1"]),
        (&["bench", "--batch", "100000"], &["--batch"]),
        (
            &["bench", "--device", "cpu", "--solver", "gd", "--grid", "4096", "--batch", "5", "--json"],
            &["--batch", "at most 4 of 4096x4096"],
        ),
        // Everything is checked before anything is measured.
        (&["bench", "--device", "cpu", "--grid", "8,5", "--json"], &["--grid", "found 5"]),
        (&["bench", "--device", "cpu", "--plot", "key.json/plot.png"], &["key.json", "cannot create"]),
        (&["bench", "--device", "cpu", "--plot", "."], &[".: type", "a folder"]),
        (&["bench", "--device", "cpu", "--plot", "p.jpg"], &["--plot", "ends in .png", "p.jpg"]),
        (&["bench", "--device", "cpu", "--plot", "-"], &["--plot", "ends in .png"]),
        (&["bench", "--device", "cpu", "--grid", "8,"], &["--grid", "N or HxW, found ''"]),
        (&["train", "none.toml"], &["none.toml", "cannot read"]),
        (&["train", "key.toml"], &["key.toml", "optimizer", "did you mean rate"]),
        (&["train", "large.toml"], &["large.toml", "network", "parameters"]),
        (&["train", "range.toml"], &["range.toml", "pool[0].material.bend", "[smallest, largest]"]),
        (&["train", "start.toml"], &["missing.safetensors", "cannot read"]),
        (
            &["train", "sizes.toml"],
            &["checkpoint_starter.safetensors", "network.channels", "32, as in the configuration, found 64"],
        ),
        (&["train", "--resume", "nowhere"], &["nowhere", "config.toml"]),
        (&["train", "--resume", "x", "--out", "y"], &["--resume"]),
        (&["train", "--minutes", "0"], &["--minutes", "above 0"]),
        // Negative numbers are values, of every option.
        (&["train", "--minutes", "-1"], &["--minutes", "above 0"]),
        (&["train", "few.toml", "--steps", "-1"], &["'-1' for '--steps <N>'"]),
        (&["bench", "--batch", "-1"], &["'-1' for '--batch"]),
        (&["rollout", "-5"], &["unknown scene '-5'", "no file of this name"]),
    ];
    for (arguments, said) in cases {
        refused_cleanly(at, arguments, said);
    }
}

/// A reader that closes its pipe early, or a log that cannot be written, does not change the exit code.
#[test]
fn exit_codes_do_not_hang_on_who_listens() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/adamw.safetensors");
    let rollout = ["rollout", "--device", "cpu", "--solver", "gd", "--frames", "3", "--no-pictures"];
    let explodes = exploding_bench("64x8,8x64");
    let cases: [(&[&str], i32); 4] = [
        (&rollout, 0),
        // A file that is not a network, and a missing file.
        (&["inspect", golden.to_str().unwrap()], 1),
        (&["inspect", "missing.safetensors"], 2),
        (&explodes, 3),
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

#[cfg(target_os = "linux")]
#[test]
fn results_that_cannot_be_printed_are_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/network_weights.safetensors");
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let mut inspect = command(folder.path(), &["inspect", golden.to_str().unwrap()]);
    let output = inspect.stdout(full).stderr(Stdio::piped()).spawn().unwrap().wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("stdout: cannot write"), "{said}");
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
fn logging_follows_its_variable() {
    let folder = tempfile::tempdir().unwrap();
    let log = |filter: &str, code| {
        let rollout = ["rollout", "--device", "cpu", "--frames", "2", "--grid", "8", "8", "--no-pictures"];
        let output = command(folder.path(), &rollout).env("FNOPT_LOG", filter).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    let info = log("info", 0);
    for line in ["scene: ", "weights: shipped with the program, ", "device: cpu"] {
        assert!(info.contains(line), "no '{line}' in: {info}");
    }
    assert!(!info.contains('\u{1b}'), "colours in a file: {info:?}");
    assert!(!log("", 0).contains("scene: ") && !log("off", 0).contains("scene: "));
    let refused = log("fnopt=loud", 2);
    assert!(refused.contains("FNOPT_LOG") && refused.contains("fnopt=loud"), "{refused}");
    assert!(log("inof", 2).contains("FNOPT_LOG: unknown level 'inof' (did you mean info"));
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
    assert!(text(&good.stdout).ends_with("16 passed, 0 failed, 0 skipped\n"), "{}", text(&good.stdout));
    let end = bytes.len();
    bytes.truncate(end - 100);
    std::fs::write(&name, &bytes).unwrap();
    let damaged = fnopt(folder.path(), &["verify", ".", "--device", "cpu", "--json"]);
    assert_eq!(damaged.status.code(), Some(1));
    let all: serde_json::Value = serde_json::from_slice(&damaged.stdout).unwrap();
    let [double, single] = all["checks"].as_array().unwrap().as_slice() else { panic!("{all}") };
    for check in [double, single] {
        assert!(check["message"].as_str().unwrap().contains("energy_small.safetensors"), "{check}");
        assert!(check.get("absolute").is_none(), "nothing was compared: {check}");
    }

    // Checking nothing is an error, and files that are skipped are reported.
    std::fs::rename(&name, folder.path().join("enrgy_small.safetensors")).unwrap();
    let nothing = fnopt(folder.path(), &["verify", ".", "--device", "cpu"]);
    assert_eq!(nothing.status.code(), Some(2), "{}", text(&nothing.stdout));
    let said = text(&nothing.stderr);
    assert!(said.contains("folder: expected golden files") && said.contains("such as enrgy_small"), "{said}");
    std::fs::copy(golden.join("energy_small.safetensors"), &name).unwrap();
    let some = fnopt(folder.path(), &["verify", ".", "--device", "cpu"]);
    assert_eq!(some.status.code(), Some(0), "{}", text(&some.stdout));
    let said = text(&some.stdout);
    assert!(said.contains("unknown kind of golden file 'enrgy_small' (did you mean energy_"), "{said}");

    // Each of these stages has checks that pass.
    let stages = ["training_step", "adamw", "energy_crumpled", "repulsion_threshold0.5"];
    copy_golden(&folder.path().join("some"), &[&stages[..], &["network_weights"]].concat());
    let all = fnopt(folder.path(), &["verify", "some", "--device", "cpu"]);
    assert_eq!(all.status.code(), Some(0), "{}", text(&all.stdout));
    for stage in stages {
        assert!(text(&all.stdout).contains(&format!("pass  {stage} ")), "no check of {stage}");
    }

    let weights = golden.join("network_weights.safetensors");
    let output = fnopt(folder.path(), &["inspect", weights.to_str().unwrap(), "--json"]);
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(value["network"]["parameters"], 1_349_634);
}

#[test]
fn a_number_of_threads_that_is_none_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for asked in ["many", "100000", "-1"] {
        let output = command(folder.path(), &["bench"]).env("RAYON_NUM_THREADS", asked).output().unwrap();
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("RAYON_NUM_THREADS: threads: expected a number of threads up to"), "{said}");
    }
}
