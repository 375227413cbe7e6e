//! Helpers that start the `fnopt` command.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};

/// Environment variables that the command reads. They are removed, so that a test inside a cluster job does
/// not become part of that job.
const INHERITED: [&str; 9] = [
    "SLURM_ARRAY_TASK_ID",
    "SLURM_ARRAY_TASK_COUNT",
    "SLURM_ARRAY_TASK_MIN",
    "SLURM_ARRAY_TASK_STEP",
    "SLURM_STEP_NUM_TASKS",
    "OMPI_COMM_WORLD_SIZE",
    "PMI_SIZE",
    "RAYON_NUM_THREADS",
    "FNOPT_LOG",
];

/// Builds the command with `folder` as its working directory and `folder/cache` as its cache.
pub fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fnopt"));
    command.current_dir(folder).args(arguments).env("FNOPT_CACHE", folder.join("cache"));
    INHERITED.iter().for_each(|name| {
        command.env_remove(name);
    });
    command
}

/// Sends a signal, such as `-INT`.
pub fn send(signal: &str, child: &Child) {
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

/// Returns a set of signals of a process, such as those it ignores (`SigIgn:`), with signal 1 as the lowest
/// bit; `None` where there is no `/proc`.
pub fn signals(process: &str, set: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let mask = status.lines().find_map(|line| line.strip_prefix(set))?;
    u64::from_str_radix(mask.trim(), 16).ok()
}

/// Returns what a command wrote, with `/` between the folders of a path on every system.
pub fn text(bytes: &[u8]) -> String {
    let written = String::from_utf8_lossy(bytes);
    if cfg!(windows) { written.replace('\\', "/") } else { written.into_owned() }
}

/// Builds the command with its log turned off.
pub fn quiet(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = command(folder, arguments);
    command.env("FNOPT_LOG", "off");
    command
}

/// Runs the command with its log turned off.
pub fn fnopt(folder: &Path, arguments: &[&str]) -> Output {
    quiet(folder, arguments).output().expect("the command starts")
}

/// Runs the command and asserts that it refuses its input: a message with every part of `said`, no standard
/// output, and nothing written into `out`.
pub fn refused_cleanly(folder: &Path, arguments: &[&str], said: &[&str]) {
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

pub fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/ground_truth")
}

/// Evaluates four frames of the shipped sequence with 100 points.
pub fn evaluate(folder: &Path, more: &[&str]) -> Output {
    let truth = shipped();
    let few = ["--frames", "4", "--points", "100", "--ground-truth", truth.to_str().unwrap()];
    quiet(folder, &[&["evaluate"], &few[..], more].concat()).output().unwrap()
}

/// Copies the golden files of these names into a new folder.
pub fn copy_golden(to: &Path, names: &[&str]) {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    std::fs::create_dir(to).unwrap();
    for name in names.iter().map(|name| format!("{name}.safetensors")) {
        std::fs::copy(from.join(&name), to.join(&name)).unwrap();
    }
}

pub fn done(output: Output) -> (String, String) {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    (text(&output.stdout), text(&output.stderr))
}

pub fn refused(output: Output, said: &[&str]) {
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    said.iter().for_each(|part| assert!(message.contains(part), "no '{part}' in: {message}"));
}

pub fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Returns the score files in a folder.
pub fn scores(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|e| e == "json")).collect()
}

/// The arguments of a bench on these grids in which 64x8 becomes non-finite within 20 frames, and 8x64 does not.
pub fn exploding_bench(grids: &'static str) -> Vec<&'static str> {
    let before = "bench --device cpu --solver lbfgs --iterations 1 --frames 40 --grid";
    before.split(' ').chain([grids]).collect()
}
