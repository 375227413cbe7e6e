//! Adapters: tunings, the pipeline cache, half precision, and solvers that exist only on the CPU. GPU tests
//! run on the software adapter, which the test suite needs anyway.

use super::command::{command, copy_golden, done, evaluate, fnopt, json, quiet, refused_cleanly, text};
use std::path::Path;

/// Holds whether or not there is a GPU that `auto` would take.
#[test]
fn a_solver_that_only_the_cpu_has_runs_there_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let newton = ["rollout", "--solver", "newton", "--frames", "2", "--grid", "8x8", "--no-pictures"];
    let output = fnopt(folder.path(), &newton);
    let log = text(&output.stderr);
    assert!(output.status.success() && log.contains("the solver runs only on the CPU"), "{log}");
}

/// On machines without a desktop, Mesa's device selection used to print two lines that began with "error:".
#[test]
fn machines_without_a_desktop_get_no_errors_of_the_driver() {
    let folder = tempfile::tempdir().unwrap();
    // An unknown adapter makes the command look at all adapters.
    let mut asking = command(folder.path(), &["rollout", "--adapter", "nope"]);
    for name in ["XDG_RUNTIME_DIR", "DISPLAY", "NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT", "DRI_PRIME"] {
        asking.env_remove(name);
    }
    let log = text(&asking.output().expect("the command starts").stderr);
    assert!(log.contains("llvmpipe") && !log.contains("XDG_RUNTIME_DIR"), "{log}");
}

#[test]
fn a_tuning_is_stored_for_its_adapter_and_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("cache");
    let run = |arguments: &[&str]| {
        let arguments = [arguments, &["--adapter", "llvmpipe", "--iterations", "1"]].concat();
        let output = command(folder.path(), &arguments).output().expect("the command starts");
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        (text(&output.stdout), text(&output.stderr))
    };
    let (dry, _) = run(&["tune", "--grid", "8", "--dry-run"]);
    assert!(
        dry.contains("best: tile ") || dry.contains("nothing beats the built-in tuning twice: tile "),
        "{dry}"
    );
    assert!(!cache.exists());
    let (tuned, _) = run(&["tune", "--grid", "8", "--json"]);
    let tuned: serde_json::Value = serde_json::from_str(&tuned).unwrap();
    let times: Vec<f64> =
        tuned["tried"].as_array().unwrap().iter().map(|t| t["ms"].as_f64().unwrap()).collect();
    assert!(times.len() > 5 && times.iter().all(|&ms| ms > 0.0), "{times:?}");
    let file = tuned["file"].as_str().unwrap();
    let stored: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    assert_eq!(stored["tuning"], tuned["best"]);

    let few = ["--frames", "2", "--grid", "8", "--solver", "gd", "--no-pictures"];
    let rollout = [&["rollout", "--device", "gpu"], &few[..]].concat();
    let (_, log) = run(&rollout);
    assert!(!log.contains("not a tuning for"), "{log}");
    // A tuning that does not fit is ignored, with the reason.
    let with = |field: &str, value: serde_json::Value| {
        let mut changed = stored.clone();
        changed[field] = value;
        changed.to_string()
    };
    let mut odd = stored["tuning"].clone();
    odd["channels"] = 3.into();
    for (damage, why) in [
        ("{".to_owned(), "EOF"),
        (with("tuning", odd), "sizes that the kernels do not support"),
        (with("adapter", "another".into()), "measured on another"),
        (with("version", "0.0.1".into()), "version 0.0.1"),
    ] {
        std::fs::write(file, &damage).unwrap();
        let (_, log) = run(&rollout);
        assert!(log.contains("not a tuning for") && log.contains(why), "{damage}: {log}");
    }
}

#[test]
fn a_tuning_that_cannot_be_stored_is_not_measured() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let tune = ["tune", "--adapter", "llvmpipe", "--grid", "8", "--iterations", "1"];
    let mut command = quiet(folder.path(), &tune);
    let output = command.env("FNOPT_CACHE", folder.path().join("file/cache")).output().unwrap();
    let said = text(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("cannot create the folder"), "{said}");
    assert!(output.stdout.is_empty(), "{}", text(&output.stdout));
}

/// The software adapter caches next to nothing, but its file is written and read like any other.
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
    assert_eq!(written(), before, "the cache was rewritten although nothing changed");

    let mut changed = stored.clone();
    changed[stored.len() / 2] ^= 1;
    for damage in [&changed[..], &stored[..stored.len() - 1], b"", b"of something else"] {
        std::fs::write(file, damage).unwrap();
        let log = run(&cache);
        assert!(log.contains("not a pipeline cache of") && log.contains(", 0 bytes"), "{log}");
        assert_eq!(std::fs::read(file).unwrap().len(), stored.len(), "the damaged cache was not replaced");
        assert!(!run(&cache).contains("not a pipeline cache of"));
    }
    // The cache folder cannot be created: a file is in its place.
    let log = run(file);
    assert!(log.contains("the next start will be as slow"), "{log}");
}

/// The software adapter supports f16.
#[test]
fn networks_run_in_half_precision() {
    let folder = tempfile::tempdir().unwrap();
    let on = ["--device", "gpu", "--adapter", "llvmpipe", "--precision", "f16"];
    let golden = folder.path().join("golden");
    copy_golden(&golden, &["network_weights", "network_forward_16x24", "update_rule_24x40"]);
    for (arguments, said) in [
        (&["rollout", "--frames", "3", "--grid", "12", "8", "--no-pictures", "--json"][..], "network in f16"),
        (&["bench", "--grid", "8", "--frames", "1", "--json"], "network in f16"),
        (&["verify", golden.to_str().unwrap()], "gpu f16"),
    ] {
        let output = fnopt(folder.path(), &[arguments, &on].concat());
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        assert!(text(&output.stdout).contains(said), "{arguments:?}: {}", text(&output.stdout));
    }
}

/// The CPU-only solvers run on the CPU even if an adapter is named; the others run on that adapter.
#[test]
fn solvers_that_only_the_cpu_has_run_there() {
    let folder = tempfile::tempdir().unwrap();
    let gpu = ["--adapter", "llvmpipe", "--grid", "8", "--solver", "newton,quasi-newton-exact:2,gd:2"];
    let (_, log) = done(evaluate(folder.path(), &[&gpu[..], &["--json", "s.json", "--plots", "p"]].concat()));
    assert!(
        log.contains("running on the CPU, as they have no GPU version: newton, quasi-newton-exact"),
        "{log}"
    );
    assert!(folder.path().join("p/convergence.png").is_file());
    let scores = json(&folder.path().join("s.json"));
    let made_with = |k: usize, field: &str| scores[k]["made_with"][field].as_str().unwrap().to_owned();
    for (k, device, kind) in [(0, "cpu", "cpu"), (1, "cpu", "cpu"), (2, "llvmpipe", "gpu")] {
        assert!(made_with(k, "device").contains(device), "{scores}");
        assert_eq!(made_with(k, "kind"), kind);
    }
    let suite = [
        "evaluate",
        "--suite",
        "handles",
        "--sequences",
        "corners drape",
        "--frames",
        "3",
        "--json",
        "s.json",
    ];
    done(quiet(folder.path(), &[&suite[..], &gpu].concat()).output().unwrap());
    let scores = json(&folder.path().join("s.json"));
    assert!(scores[0]["made_with"]["device"].as_str().unwrap().starts_with("cpu"), "{scores}");
}

#[test]
fn frames_are_predicted_for_cards_that_are_not_here() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let arguments = [&["predict", "--adapter", "llvmpipe"], arguments].concat();
        let output = command(folder.path(), &arguments).output().expect("the command starts");
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        text(&output.stdout)
    };
    let rows = run(&["--grid", "32,64", "--solver", "spectral:3", "--json"]);
    let rows: Vec<serde_json::Value> = serde_json::from_str(&rows).unwrap();
    let of = |row: &serde_json::Value, field: &str| row[field].as_f64().unwrap();
    let mut before = 0.0;
    for row in rows.iter().filter(|row| row["card"] == "H100") {
        let bounds = row["ms_bounds"].as_object().unwrap().values();
        let sum: f64 = bounds.map(|ms| ms.as_f64().unwrap()).sum::<f64>() + of(row, "ms_gaps");
        assert!((sum / of(row, "ms_per_frame") - 1.0).abs() < 1e-9, "{row}");
        assert!(of(row, "ms_per_frame") > before, "{rows:?}");
        before = of(row, "ms_per_frame");
        assert_eq!(row["iterations"], 3);
    }
    assert!(rows.len() == 8 && (0.1..1.0).contains(&before), "{rows:?}");
    let lines = run(&["--grid", "16", "--batch", "2", "--solver", "gd", "--iterations", "2"]);
    assert!(lines.starts_with("gd:2 16x16 batch 2  RTX 4090"), "{lines}");
    refused_cleanly(folder.path(), &["predict", "--grid", "4"], &["--grid", "8 to 4096"]);
    refused_cleanly(folder.path(), &["predict", "--solver", "newton"], &["newton"]);
}
