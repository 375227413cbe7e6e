//! `fnopt inspect`: shows the contents of a checkpoint.

use super::Ending;
use super::output::output;
use anyhow::Result;
use fnopt::network::Checkpoint;
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `fnopt inspect`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A safetensors file
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Ending> {
    let checkpoint = Checkpoint::open(&args.file)?;
    let description = checkpoint.describe();
    let weights = checkpoint.weights();
    let mut out = output();
    if args.json {
        let network = match &weights {
            Ok(w) => serde_json::json!({
                "config": w.config, "skip": description.skip(), "parameters": w.parameter_count(),
            }),
            Err(e) => serde_json::json!({ "error": e.to_string() }),
        };
        let all = serde_json::json!({
            "file": args.file.display().to_string(), "metadata": description.metadata,
            "tensors": description.tensors, "network": network,
        });
        writeln!(out, "{all:#}")?;
    } else {
        writeln!(out, "{description}")?;
        match &weights {
            Ok(w) => {
                let c = w.config;
                writeln!(
                    out,
                    "network: {} fields, lifting {}, {} blocks of {} channels, {}x{} modes, {} skips, projection {}",
                    c.fields,
                    c.lifting,
                    c.layers,
                    c.channels,
                    c.modes_h,
                    c.modes_w,
                    description.skip(),
                    c.projection
                )?;
                let gates = if description.skip() == "linear" { "" } else { ", gates counted as matrices" };
                writeln!(out, "{} parameters{gates}", w.parameter_count())?;
            }
            Err(e) => writeln!(out, "not a usable network: {e}")?,
        }
    }
    Ok(if weights.is_ok() { Ending::Done } else { Ending::CheckFailed })
}
