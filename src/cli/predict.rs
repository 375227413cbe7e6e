//! `fnopt predict`: how long frames would take on cards that are not here.

use super::device::{gpu, told};
use super::output::output;
use super::{Ending, ListedSolver, MOST_ITERATIONS, default_scenes, grids, listed_solvers, trimmed};
use anyhow::Result;
use fnopt::Device;
use fnopt::gpu::{AdapterKind, Bound, CARDS, Card, Schedule, Sharing, Tuning};
use fnopt::sim::Solver;
use std::collections::BTreeMap;
use std::io::Write;

/// Arguments of `fnopt predict`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Grids
    #[arg(long, value_delimiter = ',', default_value = "32,100", value_name = "N|HxW,..")]
    grid: Vec<String>,
    /// Numbers of cloths simulated together
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "B,..", value_parser = super::bench::batch)]
    batch: Vec<u32>,
    /// Solvers that run on a GPU: fnopt, fnopt-paper, spectral, gd, adam, lbfgs or quasi-newton. A number of iterations may follow after a colon
    #[arg(long, value_delimiter = ',', default_value = "fnopt:10,spectral:10", value_parser = trimmed::<String>, value_name = "NAME[:N],..")]
    solver: Vec<String>,
    /// Iterations per frame for solvers given without a number [default: what suits each]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MOST_ITERATIONS))]
    iterations: Option<u32>,
    /// Adapter whose kernels are looked at, by part of its name or by its index in `fnopt doctor`: tile sizes depend on it
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(serde::Serialize)]
struct Row {
    solver: String,
    grid: String,
    batch: usize,
    iterations: usize,
    #[serde(flatten)]
    predicted: Predicted,
}

/// What a card would need for a frame.
#[derive(serde::Serialize)]
struct Predicted {
    card: &'static str,
    dispatches: usize,
    ms_per_frame: f64,
    /// Between dispatches.
    ms_gaps: f64,
    /// By what bounds the dispatches.
    ms_bounds: BTreeMap<&'static str, f64>,
    kernels: Vec<KernelRow>,
}

#[derive(serde::Serialize)]
struct KernelRow {
    name: &'static str,
    ms: f64,
    dispatches: usize,
    /// What bounds the longest of them.
    bound: &'static str,
}

pub fn run(args: &Args) -> Result<Ending> {
    let grids = grids(&args.grid)?;
    let solvers = listed_solvers(&args.solver, None)?;
    let Device::Gpu(mut context) = told(gpu(&args.adapter).open())? else {
        unreachable!("a GPU was asked for")
    };
    if context.kind() == AdapterKind::Software {
        context = context.with_tuning(Tuning::of(AdapterKind::Hardware, Sharing::Loads))?;
    }
    let (mut rows, mut out) = (Vec::new(), output());
    for &grid in &grids {
        for &batch in &args.batch {
            let batch = batch as usize;
            let setups = default_scenes(grid, batch)?;
            for ListedSolver { name, optimizer, iterations } in &solvers {
                let asked = iterations.or(args.iterations.map(|n| n as usize));
                let iterations = asked.unwrap_or(optimizer.default_iterations());
                let solver = Solver::new(&context, &setups.model, optimizer, iterations)?;
                let schedule = solver.schedule();
                for card in CARDS {
                    let (solver, grid) = (name.clone(), grid.to_string());
                    let predicted = predicted(schedule, card);
                    let row = Row { solver, grid, batch, iterations, predicted };
                    if !args.json {
                        print(&mut out, &row)?;
                    }
                    rows.push(row);
                }
            }
        }
    }
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&rows)?)?;
    }
    Ok(Ending::Done)
}

fn predicted(schedule: &Schedule, card: &Card) -> Predicted {
    let work = schedule.work(card);
    let mut bounds = BTreeMap::new();
    let mut kernels: BTreeMap<&str, (f64, usize, (f64, Bound))> = BTreeMap::new();
    for (name, work) in &work {
        let (seconds, bound) = card.seconds(work);
        let ms = 1e3 * seconds;
        *bounds.entry(bound.name()).or_insert(0.0) += ms;
        let (sum, count, longest) = kernels.entry(name).or_insert((0.0, 0, (0.0, bound)));
        *sum += ms;
        *count += 1;
        if ms > longest.0 {
            *longest = (ms, bound);
        }
    }
    let ms_gaps = 1e3 * card.gap_s * work.len() as f64;
    let ms_per_frame = ms_gaps + bounds.values().sum::<f64>();
    let mut kernels: Vec<_> = kernels
        .into_iter()
        .map(|(name, (ms, dispatches, (_, bound)))| KernelRow { name, ms, dispatches, bound: bound.name() })
        .collect();
    kernels.sort_by(|a, b| b.ms.total_cmp(&a.ms));
    let (card, dispatches) = (card.name, work.len());
    Predicted { card, dispatches, ms_per_frame, ms_gaps, ms_bounds: bounds, kernels }
}

fn print(out: &mut impl Write, row: &Row) -> Result<()> {
    let Row { solver, grid, batch, iterations, predicted } = row;
    let Predicted { card, dispatches, ms_per_frame, ms_gaps, ms_bounds, kernels } = predicted;
    let bounds: Vec<_> = ms_bounds.iter().map(|(name, ms)| format!("{name} {ms:.3}")).collect();
    writeln!(
        out,
        "{solver}:{iterations} {grid} batch {batch}  {card:12}  {ms_per_frame:8.3} ms/frame: {dispatches} gaps {ms_gaps:.3}, {}",
        bounds.join(", ")
    )?;
    for KernelRow { name, ms, dispatches, bound } in kernels.iter().take(6) {
        writeln!(out, "    {name:16} {ms:8.4} ms  {dispatches:3} dispatches, {bound}")?;
    }
    Ok(())
}
