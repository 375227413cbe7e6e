//! `fnopt train`: its folder, how it resumes and how it ends.

use super::command::{command, fnopt, refused, send, text};
use std::path::Path;
use std::process::Stdio;

/// A run that takes almost no time and validates on one small grid.
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
        // Validation is also logged if there is no terminal for a progress bar.
        assert!(log.contains(": swinging 9x12: "), "{log}");
        text(&output.stdout)
    };
    assert!(train(&["tiny.toml", "--out", "once"]).contains("4 of 4 steps done"));
    assert!(train(&["tiny.toml", "--out", "twice", "--steps", "2"]).contains("2 of 4 steps done"));
    assert!(train(&["--resume", "twice"]).contains("4 of 4 steps done"));
    let weights = |run: &str| {
        let root = folder.path().join(run);
        for file in ["config.toml", "metrics.csv", "validation.csv", "plot.png", "weights/last.json"] {
            assert!(root.join(file).is_file(), "{run} has no {file}");
        }
        std::fs::read(root.join("weights/last.safetensors")).unwrap()
    };
    assert!(weights("once") == weights("twice"), "a run in two sessions has other bits");
    // A run that starts from those weights resumes with its own configuration, and records where they are.
    std::fs::create_dir(folder.path().join("more")).unwrap();
    let more = "init = '../once/weights/last.safetensors'\n".to_owned() + TINY;
    std::fs::write(folder.path().join("more/more.toml"), more).unwrap();
    train(&["more/more.toml", "--out", "third", "--steps", "2"]);
    assert!(train(&["more/more.toml", "--resume", "third"]).contains("4 of 4 steps done"));
    let card = std::fs::read(folder.path().join("third/weights/last.json")).unwrap();
    let card: serde_json::Value = serde_json::from_slice(&card).unwrap();
    let init = Path::new(card["config"]["init"][0].as_str().unwrap());
    assert!(init.is_absolute() && init.is_file(), "{card}");
    // The trained weights can be used.
    let arguments =
        ["rollout", "--device", "cpu", "--frames", "3", "--checkpoint", "once/weights/last.safetensors"];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    // The state of a run is not a weights file, but the error names the file that is.
    let state = ["rollout", "--device", "cpu", "--checkpoint", "once/checkpoints/step-00000004.safetensors"];
    refused(fnopt(folder.path(), &state), &["step-00000004", "weights/last.safetensors", "training run"]);
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
    // There is no checkpoint, so nothing is to be resumed.
    let again = fnopt(folder.path(), &["train", "stiff.toml", "--device", "cpu", "--out", "run"]);
    assert_eq!(again.status.code(), Some(2));
    let message = text(&again.stderr);
    assert!(message.contains("last.safetensors") && !message.contains("--resume"), "{message}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_training_run_keeps_what_is_done() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("long.toml"), TINY.replace("steps = 4", "steps = 1000000")).unwrap();
    let train = ["train", "long.toml", "--device", "cpu", "--out", "run"];
    let mut child = command(folder.path(), &train).stderr(Stdio::piped()).spawn().unwrap();
    // The first checkpoint would take minutes; metrics are written early.
    let metrics = folder.path().join("run/metrics.csv");
    let begun = std::time::Instant::now();
    while std::fs::read_to_string(&metrics).map_or(0, |text| text.lines().count()) < 2 {
        if begun.elapsed().as_secs() > 60 {
            child.kill().unwrap();
            panic!("no metrics within a minute");
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // Slurm, `timeout` and `kill` end processes this way.
    send("-TERM", &child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let output = fnopt(folder.path(), &["train", "--resume", "run", "--device", "cpu", "--minutes", "0.001"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("continuing after step"), "{}", text(&output.stderr));
}
