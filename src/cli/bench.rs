//! `fnopt bench`: times frames, kernels and command recording.

use super::device::{InferenceArgs, told};
use super::output::{output, status};
use super::{
    Ending, ListedSolver, MOST_ITERATIONS, default_scenes, go_on, grids, interrupt_flag, listed_solvers,
    median, picture_file, trimmed,
};
use anyhow::Result;
use fnopt::Error;
use fnopt::cloth::{Control, Grid};
use fnopt::eval::WARM_UP;
use fnopt::gpu::{Context, Profile, Schedule, Tensor};
use fnopt::kernels::operator::MultiplyAdd;
use fnopt::network::Weights;
use fnopt::render::{Chart, Curve, Image, Scale, charts, write_png};
use fnopt::settings::LEARNED_ITERATIONS;
use fnopt::sim::{Length, Optimizer, Solver};
use fnopt::{Device, Simulator};
use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Arguments of `fnopt bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Grids to time
    #[arg(long, value_delimiter = ',', default_value = "32,64,100", value_name = "N|HxW,..")]
    grid: Vec<String>,
    /// Numbers of cloths simulated together
    #[arg(long, value_delimiter = ',', default_value = "1", value_name = "B,..", value_parser = batch)]
    batch: Vec<u32>,
    /// Skip combinations of a grid and a batch with more than N particles in all
    #[arg(long, value_name = "N")]
    most_particles: Option<usize>,
    /// Frames to time, after three untimed ones
    #[arg(long, default_value_t = 10, value_name = "F", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: u32,
    /// Solvers, which take turns: fnopt (learned), fnopt-paper (as published), spectral, gd, adam, lbfgs or quasi-newton;
    /// on the CPU only, quasi-newton-exact or newton, which runs to convergence. A number of iterations may follow after a
    /// colon
    #[arg(long, value_delimiter = ',', default_value = "fnopt", value_parser = trimmed::<String>, value_name = "NAME[:N],..")]
    solver: Vec<String>,
    /// Iterations per frame for solvers given without a number [default: what suits each: 20 for fnopt, spectral and
    /// quasi-newton-exact, 10 for fnopt-paper and gd, 40 for quasi-newton, 100 for lbfgs and adam]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MOST_ITERATIONS))]
    iterations: Option<u32>,
    /// Weights of the learned optimizer, a safetensors file [default: the weights that ship with the program]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    #[command(flatten)]
    device: InferenceArgs,
    /// Plot ms per frame over particles and cloths (PNG), and the network's operations per second below the
    /// device's peak
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Compare with an earlier bench: its JSON, of the same grids and batches, and of the same solvers if it has several
    #[arg(long, value_name = "FILE.json")]
    against: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Trials of the device's peak.
const PEAK_TRIALS: usize = 5;
/// Frames per submission when frames are timed without a readback in between.
const TOGETHER: usize = 4;
/// Most timed recordings of a frame, and the seconds after which to stop early. At least five are timed.
const RECORDINGS: (usize, f64) = (100, 1.0);

/// A solver to time.
struct Timed {
    /// Its name, with the number of iterations if it was given.
    label: String,
    optimizer: Optimizer,
    iterations: usize,
}

#[derive(serde::Serialize)]
struct Row {
    solver: String,
    grid: String,
    #[serde(skip)]
    particles: usize,
    batch: usize,
    /// `null` for Newton's method, which runs to convergence.
    iterations: Option<usize>,
    ms_per_frame: f64,
    ms_least: f64,
    /// The times of frames that a tenth and nine tenths of all do not exceed.
    ms_p10: f64,
    ms_p90: f64,
    cloth_frames_per_s: f64,
    /// The time of each frame.
    ms_frames: Vec<f64>,
    /// `ms_per_frame` over that of the same size, and solver if there are several, in the file of `--against`.
    ratio: Option<f64>,
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

/// A solver that could not be timed at a size.
#[derive(serde::Serialize)]
struct Failure {
    solver: String,
    grid: String,
    batch: usize,
    error: String,
}

/// Parses a number of cloths.
pub fn batch(text: &str) -> std::result::Result<u32, String> {
    let batch = text.trim().parse().ok().filter(|batch| (1..=4096).contains(batch));
    batch.ok_or_else(|| "expected a whole number, 1 to 4096".into())
}

pub fn run(args: &Args) -> Result<Ending> {
    let grids = grids(&args.grid)?;
    let solvers = args.solvers()?;
    if let Some(path) = &args.plot {
        picture_file(path, "--plot")?;
    }
    let sizes = sizes(args, &grids)?;
    let earlier = args.against.as_deref().map(Earlier::read).transpose()?;
    if let Some((earlier, path)) = earlier.as_ref().zip(args.against.as_ref())
        && !solvers.iter().any(|of| sizes.iter().any(|&size| earlier.ms(size, &of.label).is_some()))
    {
        let of = if solvers.len() > 1 { format!("{} on ", solvers[0].label) } else { String::new() };
        let expected = format!("a row of {of}{} x {}, as is to be timed", sizes[0].1, sizes[0].0);
        return Err(Error::invalid(path.display().to_string(), "rows", expected, "only others").into());
    }
    let on_gpu = solvers.iter().find(|of| of.optimizer.runs_on_gpu()).unwrap_or(&solvers[0]);
    let device = told(args.device.choice().open_for(&on_gpu.optimizer))?;
    let interrupted = interrupt_flag();
    let (mut rows, mut failures, mut first_error) = (Vec::new(), Vec::new(), None);
    let (mut out, several) = (output(), solvers.len() > 1);
    // Solvers take turns at each size: how warm the machine is changes little between neighbours.
    let trials: Vec<_> = sizes.iter().flat_map(|&size| solvers.iter().map(move |of| (size, of))).collect();
    let (count, them) = (trials.len(), if several { "trials" } else { "sizes" });
    for (size, of) in trials {
        match measure(args, &device, of, size, &interrupted) {
            Ok(Some(mut row)) => {
                let before = earlier.as_ref().and_then(|earlier| earlier.ms(size, &of.label));
                row.ratio = before.map(|before| row.ms_per_frame / before);
                if !args.json {
                    print(&mut out, &row, several)?;
                }
                rows.push(row);
            }
            Ok(None) => break,
            // The remaining sizes are still measured.
            Err(error) => {
                let (grid, batch) = size;
                if count > 1 {
                    status!("{} on {grid} batch {batch}: {error:#}", of.label);
                }
                let (solver, grid) = (of.label.clone(), grid.to_string());
                failures.push(Failure { solver, grid, batch, error: error.to_string() });
                first_error.get_or_insert(error);
            }
        }
        if out.is_closed() && args.plot.is_none() {
            break;
        }
    }
    let mut peak_rate = None;
    if !rows.is_empty() && go_on(&interrupted).is_continue() {
        // The best of several trials: whatever else runs only takes away.
        for _ in 0..PEAK_TRIALS {
            match peak(&device) {
                Ok(rate) => peak_rate = Some(peak_rate.map_or(rate, |best: f64| best.max(rate))),
                Err(error) => {
                    first_error.get_or_insert(error);
                    break;
                }
            }
        }
    }
    if go_on(&interrupted).is_break() {
        status!("interrupted after {} of {count} {them}", rows.len());
    }
    let gflop_per_s = peak_rate.map(|rate| rate * 1e-9);
    // Input that is refused leaves no output.
    let of_input = |e: &anyhow::Error| !matches!(e.downcast_ref(), Some(Error::NonFinite { .. }));
    let is_refused = count == 1 && first_error.as_ref().is_some_and(of_input);
    let ending = match first_error {
        _ if go_on(&interrupted).is_break() => Ok(Ending::Interrupted),
        None => Ok(Ending::Done),
        Some(error) if count == 1 || failures.is_empty() => Err(error),
        Some(error) => Err(error.context(format!("{} of {count} {them} could not be timed", failures.len()))),
    };
    if rows.is_empty() && ending.is_err() && (is_refused || !args.json) {
        return ending;
    }
    if args.json {
        let all = serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"),
            "device": device.name(),
            "processor": processor(),
            "system": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            "tuning": match &device {
                Device::Cpu => None,
                Device::Gpu(context) => Some(context.tuning()),
            },
            "solver": solvers.iter().map(|of| &*of.label).collect::<Vec<_>>().join(","),
            "weights_crc32": solvers.iter().find_map(|of| of.optimizer.weights_crc32()),
            "precision": args.device.precision,
            "frames": args.frames,
            "against": args.against,
            "peak_gflop_per_s": gflop_per_s,
            "rows": rows,
            "failures": failures,
        });
        writeln!(out, "{all:#}")?;
    } else if let Some(peak) = gflop_per_s {
        let of = match device {
            Device::Cpu => "a matrix product in the first-level cache",
            Device::Gpu(_) => "multiply-adds in registers",
        };
        writeln!(out, "peak of the device: {peak:.0} GFLOP/s ({of})")?;
    }
    if let Some(path) = args.plot.as_ref().filter(|_| !rows.is_empty()) {
        write_png(path, &plot(&rows, peak_rate))?;
    }
    ending
}

/// An earlier bench.
struct Earlier(serde_json::Value);

impl Earlier {
    /// Reads its JSON. Fails if it has no rows of times.
    fn read(path: &Path) -> Result<Self> {
        let origin = path.display().to_string();
        let value: serde_json::Value = serde_json::from_str(&fnopt::io::read_text(path)?)
            .map_err(|e| Error::invalid(&origin, "text", "JSON, as fnopt bench --json prints it", e))?;
        let timed = |row: &serde_json::Value| row["ms_per_frame"].as_f64().is_some_and(|ms| ms > 0.0);
        match value["rows"].as_array() {
            Some(rows) if !rows.is_empty() && rows.iter().all(timed) => Ok(Self(value)),
            _ => {
                let expected = "at least one, each with \"ms_per_frame\" above 0";
                Err(Error::invalid(&origin, "rows", expected, &value["rows"]).into())
            }
        }
    }

    /// Returns the milliseconds per frame of a size, if it is there: of this solver, or of the only one.
    fn ms(&self, (grid, batch): (Grid, usize), solver: &str) -> Option<f64> {
        let rows = self.0["rows"].as_array()?.iter();
        let of_size: Vec<_> =
            rows.filter(|row| row["grid"] == grid.to_string() && row["batch"] == batch).collect();
        let row = match of_size[..] {
            [only] => only,
            _ => of_size.into_iter().find(|row| row["solver"] == solver)?,
        };
        row["ms_per_frame"].as_f64()
    }
}

impl Args {
    /// Returns the solvers, each once.
    fn solvers(&self) -> Result<Vec<Timed>> {
        let mut seen = HashSet::new();
        let listed = listed_solvers(&self.solver, self.checkpoint.as_deref())?.into_iter();
        let timed = listed.map(|ListedSolver { name, optimizer, iterations }| {
            let label = iterations.map_or(name.clone(), |n| format!("{name}:{n}"));
            let asked = iterations.or(self.iterations.map(|n| n as usize));
            Timed { label, iterations: asked.unwrap_or(optimizer.default_iterations()), optimizer }
        });
        Ok(timed.filter(|of| seen.insert(of.label.clone())).collect())
    }
}

/// Returns the time that this share of the frames does not exceed.
fn percentile(times: &[f64], share: f64) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

/// Returns the name of the host's processor where the system tells it.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let name = text.lines().find_map(|line| line.strip_prefix("model name"))?;
    Some(name.trim_start_matches([' ', '\t', ':']).to_owned())
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

/// Measures the most floating-point operations per second of multiply-adds in single precision.
fn peak(device: &Device) -> Result<f64> {
    Ok(match device {
        Device::Cpu => fnopt::cpu::peak_rate(),
        Device::Gpu(context) => peak_of(context)?,
    })
}

/// Measures the multiply-adds in registers of an adapter. Takes about half a second.
fn peak_of(context: &Context) -> Result<f64> {
    /// Elements, enough for a quad per invocation of a large GPU.
    const LEN: usize = 1 << 20;
    /// Length of a run in which its start and end do not matter, and of all runs \[s\].
    const LONG: f64 = 0.02;
    const ENOUGH: f64 = 0.3;
    let (x, y) = (Tensor::zeros(context, "x", &[LEN])?, Tensor::zeros(context, "y", &[LEN])?);
    let kernel = MultiplyAdd::new(context)?;
    let seconds = |steps: u32| -> Result<f64> {
        let mut schedule = Schedule::new(context);
        kernel.push(&mut schedule, (steps, 0.5, 0.5), &x, &y);
        let begun = Instant::now();
        context.submit(|encoder| schedule.record(encoder));
        context.wait()?;
        Ok(begun.elapsed().as_secs_f64())
    };
    let mut steps = 1;
    seconds(steps)?;
    while seconds(steps)? < LONG && steps < 1 << 20 {
        steps *= 2;
    }
    let (begun, mut best) = (Instant::now(), f64::INFINITY);
    while begun.elapsed().as_secs_f64() < ENOUGH {
        best = best.min(seconds(steps)?);
    }
    Ok((MultiplyAdd::FLOP * steps as usize * LEN) as f64 / best)
}

/// Plots time over the particles of all cloths, with a curve for each solver and batch size, and for the learned
/// optimizer also the operations per second, with the peak of the device.
fn plot(rows: &[Row], peak: Option<f64>) -> Image {
    let particles = |row: &Row| (row.particles * row.batch) as f64;
    let mut kinds: Vec<(&str, usize)> = rows.iter().map(|row| (&*row.solver, row.batch)).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let several = kinds.iter().any(|kind| kind.0 != kinds[0].0);
    let curves = |value: &dyn Fn(&Row) -> Option<f64>| -> Vec<Curve> {
        let of = |&(solver, batch): &(&str, usize)| {
            let rows = rows.iter().filter(|row| row.solver == solver && row.batch == batch);
            let mut points: Vec<[f64; 2]> =
                rows.filter_map(|row| Some([particles(row), value(row)?])).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            let solver = if several { format!("{solver}, ") } else { String::new() };
            let label = format!("{solver}{batch} cloth{}", if batch == 1 { "" } else { "s" });
            Curve { label, colour: 0, points, notes: Vec::new() }
        };
        let coloured = |(colour, kind)| Curve { colour, ..of(kind) };
        kinds.iter().enumerate().map(coloured).filter(|curve| !curve.points.is_empty()).collect()
    };
    let chart = |title: &str, unit: &str, curves| {
        let axes = ["particles".into(), unit.into()];
        Chart { title: title.into(), axes, curves, lines: Vec::new(), scales: [Scale::Logarithmic; 2] }
    };
    let mut both = vec![chart("Time of a frame", "ms", curves(&|row| Some(row.ms_per_frame)))];
    let mut speeds = curves(&|row| row.gflop_per_s);
    if !speeds.is_empty() {
        let ends = [f64::min, f64::max].map(|end| rows.iter().map(particles).reduce(end));
        let line = peak.map(|peak| ends.into_iter().flatten().map(|p| [p, peak * 1e-9]).collect());
        let (label, colour, notes) = ("peak".into(), kinds.len(), Vec::new());
        speeds.extend(line.map(|points| Curve { label, colour, points, notes }));
        both.push(chart("Operations", "GFLOP/s", speeds));
    }
    charts(&both, (600, 420))
}

/// Times a size. Returns `None` if interrupted.
fn measure(
    args: &Args,
    device: &Device,
    Timed { label, optimizer, iterations }: &Timed,
    (grid, batch): (Grid, usize),
    interrupted: &AtomicBool,
) -> Result<Option<Row>> {
    let setups = default_scenes(grid, batch)?;
    let (frames, iterations) = (args.frames as usize, *iterations);
    let mut simulator = Simulator::new(device, &setups.model, optimizer, iterations)?;
    simulator.set_state(&setups.start.cast());
    let mut times = Vec::with_capacity(frames);
    // Repeats the motion as often as needed, so that every frame has work to do.
    let controls = (0..WARM_UP + frames).map(|f| setups.control(1 + f % (setups.frames() - 1)));
    simulator.rollout(controls, |frame| {
        if frame.index > WARM_UP {
            times.push(frame.wall.as_secs_f64() * 1e3);
        }
        go_on(interrupted)
    })?;
    if go_on(interrupted).is_break() {
        return Ok(None);
    }
    let ms_per_frame = median(&times);
    // In a subspace the network takes part in the first iterations alone.
    let evaluations = match optimizer.length {
        Length::Subspace => iterations.min(LEARNED_ITERATIONS),
        _ => iterations,
    };
    let of_network = |weights: &Arc<Weights>| weights.config.flop(grid) * (3 * batch * evaluations) as f64;
    let flop = optimizer.weights().map(of_network);
    let mut row = Row {
        solver: label.clone(),
        grid: grid.to_string(),
        particles: grid.particles(),
        batch,
        iterations: (!optimizer.converges()).then_some(iterations),
        ms_per_frame,
        ms_least: times.iter().copied().fold(f64::INFINITY, f64::min),
        ms_p10: percentile(&times, 0.1),
        ms_p90: percentile(&times, 0.9),
        cloth_frames_per_s: 1e3 * batch as f64 / ms_per_frame,
        gflop_per_s: flop.map(|f| f / ms_per_frame * 1e-6),
        ratio: None,
        ms_together: None,
        encode_ms: None,
        dispatches: None,
        kernels: Vec::new(),
        ms_frames: times,
    };
    if let Device::Gpu(context) = device {
        drop(simulator);
        let solver = Solver::new(context, &setups.model, optimizer, iterations)?;
        solver.set_state(&setups.start.cast());
        record_times(context, &solver, &mut row)?;
        let controls: Vec<_> = (0..TOGETHER).map(|f| setups.control(1 + f % (setups.frames() - 1))).collect();
        row.ms_together = Some(time_together(context, &solver, &controls)?);
    }
    Ok(Some(row))
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
        let mut encoder = context.device.create_command_encoder(&Default::default());
        solver.record_frames(&mut encoder, controls)?;
        context.queue.submit([encoder.finish()]);
        context.wait()?;
        times.push(start.elapsed().as_secs_f64() * 1e3 / controls.len() as f64);
    }
    Ok(median(&times))
}

/// Prints a row, with its solver if there are several.
fn print(out: &mut impl Write, row: &Row, several: bool) -> std::io::Result<()> {
    if several {
        write!(out, "{} on ", row.solver)?;
    }
    let Row { grid, batch, iterations, ms_per_frame, ms_least, cloth_frames_per_s, .. } = row;
    match iterations {
        Some(1) => write!(out, "{grid} batch {batch}, 1 iteration: ")?,
        Some(count) => write!(out, "{grid} batch {batch}, {count} iterations: ")?,
        None => write!(out, "{grid} batch {batch}, to convergence: ")?,
    }
    write!(out, "{ms_per_frame:.3} ms/frame")?;
    write!(out, " (minimum {ms_least:.3}), {cloth_frames_per_s:.1} cloth-frames/s")?;
    if let Some(rate) = row.gflop_per_s {
        write!(out, ", {rate:.1} GFLOP/s")?;
    }
    if let Some(ratio) = row.ratio {
        write!(out, ", {ratio:.2} times as long as before")?;
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
