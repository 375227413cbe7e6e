//! `fnopt tune`: finds the fastest tile sizes for an adapter.

use super::device::{gpu, told};
use super::output::{output, status};
use super::{Ending, SolverArgs, default_scenes, go_on, interrupt_flag, one_grid, writable_file};
use anyhow::Result;
use fnopt::Device;
use fnopt::Error;
use fnopt::gpu::Tuning;
use fnopt::sim::tune;
use std::io::Write;
use std::ops::ControlFlow;

/// Arguments of `fnopt tune`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Grid of the cloths to time; the result serves all grids, batches and precisions of the adapter
    #[arg(long, num_args = 1..=2, default_value = "64", value_name = "N|HxW|H W")]
    grid: Vec<String>,
    /// Number of cloths simulated together
    #[arg(long, default_value_t = 1, value_name = "B", value_parser = clap::value_parser!(u32).range(1..=4096))]
    batch: u32,
    /// Adapter to run on, by part of its name or by its index in `fnopt doctor` [default: the best]
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    #[command(flatten)]
    solver: SolverArgs,
    /// Measure only; store nothing
    #[arg(long)]
    dry_run: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Ending> {
    let optimizer = args.solver.optimizer()?;
    if optimizer.weights().is_none() {
        // Chance would choose between tilings of a network that is not there.
        let expected = "fnopt, whose network is what the tile sizes are for";
        return Err(Error::invalid("--solver", "solver", expected, optimizer.name()).into());
    }
    let setups = default_scenes(one_grid(&args.grid)?, args.batch as usize)?;
    let start = setups.start.cast();
    let Device::Gpu(context) = told(gpu(&args.adapter).open())? else {
        return Err(Error::Device("the CPU path has nothing to tune".into()).into());
    };
    if let Some(path) = Tuning::path(&context).filter(|_| !args.dry_run) {
        writable_file(&path)?;
    }
    let interrupted = interrupt_flag();
    let mut out = output();
    let mut all = Vec::new();
    let mut failed = Ok(());
    let mut tried = |tuning: &Tuning, ms: f64| {
        all.push(serde_json::json!({ "tuning": tuning, "ms": ms }));
        if !args.json {
            failed = writeln!(out, "{ms:9.3} ms/frame  {}", describe(tuning));
        }
        if failed.is_err() { ControlFlow::Break(()) } else { go_on(&interrupted) }
    };
    let best =
        tune(&context, (&setups.model, &start), &optimizer, args.solver.iterations(&optimizer), &mut tried)?;
    failed?;
    if go_on(&interrupted).is_break() {
        status!("interrupted; nothing was stored");
        return Ok(Ending::Interrupted);
    }
    let stored = match args.dry_run {
        true => None,
        false => Some(best.store(&context)?),
    };
    if args.json {
        let file = stored.map(|path| path.display().to_string());
        let result =
            serde_json::json!({ "adapter": context.name(), "best": best, "file": file, "tried": all });
        writeln!(out, "{result:#}")?;
        return Ok(Ending::Done);
    }
    if best == Tuning::table(&context) {
        writeln!(out, "nothing beats the built-in tuning twice: {}", describe(&best))?;
    } else {
        writeln!(out, "best: {}", describe(&best))?;
    }
    if let Some(path) = stored {
        writeln!(out, "stored in {}; remove the file to undo", path.display())?;
    }
    Ok(Ending::Done)
}

fn describe(tuning: &Tuning) -> String {
    let Tuning { channels, pointwise_group, block_wide, block_span, block_deep, block_lines, staged, .. } =
        tuning;
    let Tuning { rows_in_blocks, spectral_teams, busy_groups, sharing, texels, activation_bytes, .. } =
        tuning;
    let passes = activation_bytes >> 20;
    let rows = if *rows_in_blocks { "in blocks" } else { "apart" };
    let staged = if *staged { " staged" } else { "" };
    let texels = if *texels { ", texels" } else { "" };
    let lines = if *block_lines > 1 { format!(" of {block_lines} rows in batches") } else { String::new() };
    format!(
        "tile {channels}, block {block_wide}x{block_span}x{block_deep}{staged}{lines}, group {pointwise_group}, rows {rows}, teams {spectral_teams}, \
         busy {busy_groups}, {sharing:?}{texels}, passes of {passes} MiB"
    )
    .to_lowercase()
}
