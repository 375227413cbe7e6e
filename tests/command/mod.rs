//! The command as tests start it.

use std::path::Path;
use std::process::{Child, Command};

/// What the command reads of its caller: a test that runs in a job of a cluster must not become a part of that job.
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

/// The command in `folder`, where its cache is, too.
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

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}
