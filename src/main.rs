//! The `fnopt` command: arguments and loops; everything else is in the library.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    match cli::log_to_stderr() {
        Ok(()) => cli::run(cli),
        Err(error) => {
            cli::output::tell!("error: {error}");
            ExitCode::from(2)
        }
    }
}
