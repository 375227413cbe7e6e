//! `fnopt bench`: times frames, kernels and command recording.

use super::device::InferenceArgs;
use super::output::{output, status};
use super::{Ending, SolverArgs, default_scenes, grids, median, writable_file};
use anyhow::Result;
use fnopt::Error;
use fnopt::cloth::{Control, Grid};
use fnopt::eval::WARM_UP;
use fnopt::gpu::{Context, Profile, Schedule, Tensor, Tuning};
use fnopt::kernels::operator::{Layer, Pointwise};
use fnopt::render::{Chart, Curve, Image, Scale, charts, write_png};
use fnopt::sim::{Optimizer, Solver, SolverOptions};
use fnopt::{Device, Simulator};
use std::collections::HashSet;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `fnopt bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Grids to time
    #[arg(long, value_delimiter = ',', default_value = "32,64,100", value_name = "N|HxW,..")]
    grid: Vec<String>,
    /// Numbers of cloths simulated together
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "B,..", value_parser = clap::value_parser!(u32).range(1..=4096))]
    batch: Vec<u32>,
    /// Skip combinations of a grid and a batch with more than N particles in all
    #[arg(long, value_name = "N")]
    most_particles: Option<usize>,
    /// Frames to time, after three untimed ones
    #[arg(long, default_value_t = 10, value_name = "F", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: u32,
    #[command(flatten)]
    solver: SolverArgs,
    #[command(flatten)]
    device: InferenceArgs,
    /// Plot ms per frame over particles and cloths (PNG), with the time that the network's operations alone
    /// would take at the speed of the device's matrix product
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Frames per submission when frames are timed without a readback in between.
const TOGETHER: usize = 4;
/// Most timed recordings of a frame, and the seconds after which to stop early. At least five are timed.
const RECORDINGS: (usize, f64) = (100, 1.0);

#[derive(serde::Serialize)]
struct Row {
    grid: String,
    #[serde(skip)]
    particles: usize,
    batch: usize,
    iterations: usize,
    ms_per_frame: f64,
    ms_least: f64,
    cloth_frames_per_s: f64,
    /// GFLOP/s, counting the operations of the network alone; `null` for the classical optimizers.
    gflop_per_s: Option<f64>,
    /// Time per frame when one submission advances several; `null` on the CPU.
    ms_together: Option<f64>,
    /// Time to record one frame on the host; `null` on the CPU.
    encode_ms: Option<f64>,
    dispatches: Option<usize>,
    /// Device time by kernel, with a pass for each dispatch.
    kernels: Vec<KernelRow>,
}

#[derive(serde::Serialize)]
struct KernelRow {
    name: &'static str,
    ms: f64,
    dispatches: usize,
}

pub fn run(args: &Args) -> Result<Ending> {
    let grids = grids(&args.grid)?;
    let optimizer = args.solver.optimizer()?;
    if let Some(path) = &args.plot {
        writable_file(path)?;
    }
    let sizes = sizes(args, &grids)?;
    let (device, line) = args.device.open_for(&optimizer)?;
    status!("{line}");
    let mut rows = Vec::new();
    let mut out = output();
    let (mut ended, many) = (Ok(Ending::Done), sizes.len() > 1);
    for size in sizes {
        let row = match measure(args, &device, &optimizer, size) {
            Ok(row) => row,
            // The remaining sizes are still measured.
            Err(error) => {
                let (grid, batch) = size;
                if many {
                    status!("{grid} batch {batch}: {error:#}");
                }
                ended = ended.and(Err(error));
                continue;
            }
        };
        if !args.json {
            print(&mut out, &row)?;
        }
        rows.push(row);
        if out.is_closed() && args.plot.is_none() {
            return ended;
        }
    }
    if rows.is_empty() {
        return ended;
    }
    let product = match product_rate(&device) {
        Ok(product) => product,
        Err(error) => {
            ended = ended.and(Err(error));
            f64::NAN
        }
    };
    if args.json {
        let all = serde_json::json!({
            "device": device.name(), "solver": optimizer.name(), "product_gflop_per_s": product * 1e-9, "rows": rows
        });
        writeln!(out, "{all:#}")?;
    } else {
        writeln!(out, "the matrix product alone: {:.0} GFLOP/s", product * 1e-9)?;
    }
    if let Some(path) = &args.plot {
        write_png(path, &plot(&rows, product))?;
    }
    ended
}

/// Returns the grids and batch sizes to measure. Fails if all of them have too many particles.
fn sizes(args: &Args, grids: &[Grid]) -> Result<Vec<(Grid, usize)>> {
    let mut batches = args.batch.clone();
    let mut seen = HashSet::new();
    batches.retain(|batch| seen.insert(*batch));
    let all = grids.iter().flat_map(|&grid| batches.iter().map(move |&batch| (grid, batch as usize)));
    let most = args.most_particles.unwrap_or(usize::MAX);
    let particles = |&(grid, batch): &(Grid, usize)| grid.particles() * batch;
    let (taken, left): (Vec<_>, Vec<_>) = all.partition(|size| particles(size) <= most);
    match left.iter().map(particles).min() {
        Some(least) if taken.is_empty() => {
            let expected = format!("{least} or more, as the smallest size has that many");
            Err(Error::invalid("bench", "--most-particles", expected, most).into())
        }
        _ => Ok(taken),
    }
}

/// Measures the operations per second of the device's matrix product when nothing else limits it.
fn product_rate(device: &Device) -> Result<f64> {
    Ok(match device {
        Device::Cpu => fnopt::cpu::product_rate(),
        Device::Gpu(context) => product_rate_on(context)?,
    })
}

/// Measures the operations per second of a pointwise layer when nothing else limits it: 64 to 64 channels,
/// many positions, dispatches back to back. Takes about a third of a second, plus the time to compile.
fn product_rate_on(context: &Context) -> Result<f64> {
    const SHAPE: [usize; 4] = [12, 64, 64, 64];
    const DISPATCHES: usize = 10;
    let tuning = &Tuning::new(context);
    let [samples, channels, h, w] = SHAPE;
    let stored = |label, shape: &[usize]| Tensor::stored_zeros(context, label, shape);
    let (x, y) = (stored("x", &SHAPE)?, stored("y", &SHAPE)?);
    let weight = stored("weight", &[channels / tuning.channels, channels, tuning.channels])?;
    let layer = Layer { weight, bias: Tensor::zeros(context, "bias", &[channels])? };
    let kernel = Pointwise::new(context, tuning, false)?;
    let mut schedule = Schedule::new(context);
    (0..DISPATCHES).for_each(|_| kernel.push(&mut schedule, &layer, &x, &y));
    let run = || {
        let begun = Instant::now();
        context.submit(|encoder| schedule.record(encoder));
        context.wait().map(|()| begun.elapsed().as_secs_f64())
    };
    run()?;
    let (begun, mut best) = (Instant::now(), f64::INFINITY);
    while begun.elapsed().as_secs_f64() < 0.3 {
        best = best.min(run()?);
    }
    Ok((2 * DISPATCHES * samples * channels * channels * h * w) as f64 / best)
}

/// Plots time and speed over the particles of all cloths, with a curve for each batch size and one for the
/// matrix product.
fn plot(rows: &[Row], product: f64) -> Image {
    let particles = |row: &Row| (row.particles * row.batch) as f64;
    let mut batches: Vec<usize> = rows.iter().map(|row| row.batch).collect();
    batches.sort_unstable();
    batches.dedup();
    let curves = |value: &dyn Fn(&Row) -> f64| -> Vec<Curve> {
        let of = |&batch: &usize| {
            let rows = rows.iter().filter(|row| row.batch == batch);
            let mut points: Vec<[f64; 2]> = rows.map(|row| [particles(row), value(row)]).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            Curve { label: format!("{batch} cloth{}", if batch == 1 { "" } else { "s" }), points }
        };
        batches.iter().map(of).collect()
    };
    let mut times = curves(&|row| row.ms_per_frame);
    let mut speeds = curves(&|row| row.gflop_per_s.unwrap_or(f64::NAN));
    let mut bound: Vec<[f64; 2]> = rows
        .iter()
        .filter_map(|row| Some([particles(row), row.gflop_per_s? * row.ms_per_frame * 1e9 / product]))
        .collect();
    bound.sort_by(|a, b| a[0].total_cmp(&b[0]));
    bound.dedup_by_key(|point| point[0]);
    let label = "matrix product".to_owned();
    speeds
        .push(Curve { label: label.clone(), points: bound.iter().map(|p| [p[0], product * 1e-9]).collect() });
    times.push(Curve { label, points: bound });
    let chart = |title: &str, unit: &str, curves| {
        let axes = ["particles".into(), unit.into()];
        Chart { title: title.into(), axes, curves, scale: Scale::Logarithmic }
    };
    let both = [chart("Time of a frame", "ms", times), chart("Operations", "GFLOP/s", speeds)];
    charts(&both, (1200, 420))
}

fn measure(args: &Args, device: &Device, optimizer: &Optimizer, (grid, batch): (Grid, usize)) -> Result<Row> {
    let setups = default_scenes(grid, batch)?;
    let (frames, iterations) = (args.frames as usize, args.solver.iterations());
    let mut simulator = Simulator::new(device, &setups.model, optimizer, iterations)?;
    simulator.set_state(&setups.start.cast());
    let mut times = Vec::with_capacity(frames);
    // Repeats the motion as often as needed, so that every frame has work to do.
    let controls = (0..WARM_UP + frames).map(|f| setups.control(1 + f % (setups.frames() - 1)));
    simulator.rollout(controls, |frame| {
        if frame.index > WARM_UP {
            times.push(frame.wall.as_secs_f64() * 1e3);
        }
        ControlFlow::Continue(())
    })?;
    let ms_per_frame = median(&times);
    let flop = match optimizer {
        Optimizer::Learned(weights) => Some(weights.config.flop(grid) * (3 * batch * iterations) as f64),
        _ => None,
    };
    let mut row = Row {
        grid: grid.to_string(),
        particles: grid.particles(),
        batch,
        iterations,
        ms_per_frame,
        ms_least: times.iter().copied().fold(f64::INFINITY, f64::min),
        cloth_frames_per_s: 1e3 * batch as f64 / ms_per_frame,
        gflop_per_s: flop.map(|f| f / ms_per_frame * 1e-6),
        ms_together: None,
        encode_ms: None,
        dispatches: None,
        kernels: Vec::new(),
    };
    if let Device::Gpu(context) = device {
        drop(simulator);
        let options = SolverOptions { iterations, ..Default::default() };
        let solver = Solver::new(context, &setups.model, optimizer, &options)?;
        solver.set_state(&setups.start.cast());
        record_times(context, &solver, &mut row)?;
        let controls: Vec<_> = (0..TOGETHER).map(|f| setups.control(1 + f % (setups.frames() - 1))).collect();
        row.ms_together = Some(time_together(context, &solver, &controls)?);
    }
    Ok(row)
}

/// Times command recording and, if the device has timestamps, each kernel.
fn record_times(context: &Context, solver: &Solver, row: &mut Row) -> Result<()> {
    let (most, seconds) = RECORDINGS;
    let (begun, mut encode) = (Instant::now(), Vec::new());
    // As in a run, each frame is computed before the next is recorded: the state of the caches is part of the
    // time.
    while encode.len() < 5 || (encode.len() < most && begun.elapsed().as_secs_f64() < seconds) {
        let mut encoder = context.device.create_command_encoder(&Default::default());
        let start = Instant::now();
        solver.record(&mut encoder);
        let recorded = encoder.finish();
        encode.push(start.elapsed().as_secs_f64() * 1e3);
        context.queue.submit([recorded]);
        context.wait()?;
    }
    row.encode_ms = Some(median(&encode));
    row.dispatches = Some(solver.schedule().dispatches());
    if let Some(mut profile) = Profile::new(context) {
        context.submit(|encoder| solver.schedule().record_timed(encoder, &mut profile));
        let times = profile.read(context)?;
        row.kernels =
            times.into_iter().map(|(name, (ms, dispatches))| KernelRow { name, ms, dispatches }).collect();
        row.kernels.sort_by(|a, b| b.ms.total_cmp(&a.ms));
    }
    Ok(())
}

/// Returns the milliseconds per frame when one submission advances several, with no readback or wait in
/// between.
fn time_together(context: &Context, solver: &Solver, controls: &[Control<f32>]) -> Result<f64> {
    let (_, seconds) = RECORDINGS;
    let (begun, mut times) = (Instant::now(), Vec::new());
    while times.len() < 2 || (times.len() < 20 && begun.elapsed().as_secs_f64() < seconds) {
        let start = Instant::now();
        context.submit(|encoder| solver.record_frames(encoder, controls));
        context.wait()?;
        times.push(start.elapsed().as_secs_f64() * 1e3 / controls.len() as f64);
    }
    Ok(median(&times))
}

fn print(out: &mut impl Write, row: &Row) -> std::io::Result<()> {
    let Row { grid, batch, iterations, ms_per_frame, ms_least, cloth_frames_per_s, .. } = row;
    write!(out, "{grid} batch {batch}, {iterations} iterations: {ms_per_frame:.3} ms/frame")?;
    write!(out, " (minimum {ms_least:.3}), {cloth_frames_per_s:.1} cloth-frames/s")?;
    if let Some(rate) = row.gflop_per_s {
        write!(out, ", {rate:.1} GFLOP/s")?;
    }
    writeln!(out)?;
    if let (Some(ms), Some(count)) = (row.encode_ms, row.dispatches) {
        writeln!(out, "  recording {ms:.3} ms, {count} dispatches")?;
    }
    if let Some(ms) = row.ms_together {
        writeln!(out, "  {ms:.3} ms/frame with {TOGETHER} frames per submission")?;
    }
    let timed: usize = row.kernels.iter().map(|k| k.dispatches).sum();
    if timed > 0 && row.dispatches.is_some_and(|all| all > timed) {
        writeln!(out, "  the first {timed} dispatches by kernel:")?;
    }
    let total: f64 = row.kernels.iter().map(|k| k.ms).sum();
    for k in &row.kernels {
        let share = 100.0 * k.ms / total;
        writeln!(out, "  {:18} {:9.3} ms {share:5.1} %  {:4} dispatches", k.name, k.ms, k.dispatches)?;
    }
    Ok(())
}
