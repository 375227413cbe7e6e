//! The command as a script sees it: exit codes, messages, files.

mod bench;
mod command;
mod devices;
mod evaluate;
mod every_command;
mod fabrics;
#[cfg(target_os = "linux")]
mod interrupted;
mod rollout;
mod rollout_files;
mod scenes;
mod scores;
mod suite;
mod train;
