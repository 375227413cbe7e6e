//! `fnopt evaluate`: compares solvers with recorded trajectories.

use super::device::DeviceArgs;
use super::{Ending, interrupt_flag, load_weights};
use anyhow::Result;
use fnopt::Error;
use fnopt::eval::suite::{self, Case, CaseScore, Suite};
use fnopt::eval::{Entry, Format, Physics, Score, Sequence, Settings, Table, compare, run, tables};
use fnopt::io::{ReadOptions, Trajectory, write_atomic};
use fnopt::network::Weights;
use fnopt::render::{Chart, Curve, StripOptions, View, charts, strip, write_png};
use fnopt::sim::{Device, Grid, Material, Optimizer};
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Arguments of `fnopt evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of sequences, each a folder with cloth_pos.npy, handles.npy and meta.json
    #[arg(long, default_value = "assets/ground_truth", value_name = "DIR")]
    ground_truth: PathBuf,
    /// Sequences, or cases of a suite, to take part [default: all]
    #[arg(long, value_delimiter = ',', value_name = "NAME,..")]
    sequences: Option<Vec<String>>,
    /// Grids to simulate on: rows, or rows and columns
    #[arg(long, value_delimiter = ',', default_value = "32", value_name = "N|HxW,..")]
    grid: Vec<String>,
    /// Solvers: fnopt, gd, adam, lbfgs, quasi-newton, newton, or single-pass, which is fnopt:1; with iterations of their own
    /// after a colon
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "newton,fnopt,quasi-newton,lbfgs:100,adam:500",
        value_name = "NAME[:N],.."
    )]
    solver: Vec<String>,
    /// Iterations per frame of the solvers without their own
    #[arg(long, value_delimiter = ',', default_value = "10", value_name = "N,..")]
    iterations: Vec<usize>,
    /// Weights of the learned optimizer, a safetensors file [default: those that come with the program]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Energy coefficients stretch, shear, bend
    #[arg(long, value_delimiter = ',', default_value = "1000,8,0.5", value_name = "KS,KH,KB")]
    material: Vec<f64>,
    /// Density of the air [kg/m^3] [default: the sequence's]
    #[arg(long, value_name = "DENSITY")]
    wind: Option<f64>,
    /// Frames of each sequence, the start included [default: all]
    #[arg(long, value_name = "F")]
    frames: Option<usize>,
    /// Points sampled from each surface for e_CD
    #[arg(long, default_value_t = 10_000, value_name = "N")]
    points: usize,
    /// Another system's trajectories: DIR/SEQUENCE.npz, .npy or .pc2, or folders of OBJ files; may be given more than once
    #[arg(long, value_name = "NAME=DIR")]
    compare: Vec<String>,
    /// Folder of the scores; those that are there already are used again
    #[arg(long, default_value = "out/evaluate", value_name = "DIR")]
    out: PathBuf,
    /// Do every n-th piece of the work only, beginning with the i-th (from 0) [default: SLURM_ARRAY_TASK_ID of
    /// SLURM_ARRAY_TASK_COUNT where these are set]
    #[arg(long, value_name = "I/N")]
    shard: Option<String>,
    /// Simulate nothing; make the tables of all scores in these folders
    #[arg(long, value_name = "DIR", num_args = 1..)]
    merge: Vec<PathBuf>,
    /// Instead of recorded trajectories, how far each solver generalises from the default scene: motions, handles, speeds,
    /// grids, materials or iterations; tables, and a picture of each case in --out
    #[arg(long, value_name = "SUITE", conflicts_with_all = ["compare", "shard", "merge", "plots"])]
    suite: Option<String>,
    /// Leave the energy gap out of a suite: its converged simulation takes most of the time
    #[arg(long, requires = "suite")]
    no_gap: bool,
    /// Scores as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Tables as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Tables as Markdown
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Folder for plots (PNG)
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// A solver on a grid, to be run on a sequence.
struct Job {
    sequence: usize,
    grid: Grid,
    entry: Entry,
    /// Where its score is kept.
    file: PathBuf,
}

pub fn run_command(args: &Args) -> Result<Ending> {
    if !args.merge.is_empty() {
        let mut scores = Vec::new();
        for folder in &args.merge {
            scores.extend(kept(folder)?);
        }
        return args.write(&scores).map(|()| Ending::Done);
    }
    let settings = args.settings()?;
    let entries = args.entries()?;
    let grids: Vec<Grid> = args.grid.iter().map(|text| grid(text)).collect::<fnopt::Result<_>>()?;
    if let Some(name) = &args.suite {
        return args.run_suite(Suite::named(name)?, &entries, &grids, settings.frames);
    }
    let sequences = args.sequences()?;
    let systems = args.systems()?;
    let (device, line) = args.device.open()?;
    eprintln!("{line}");
    std::fs::create_dir_all(&args.out).map_err(|e| Error::io(&args.out, "cannot create the folder", e))?;

    let mut jobs = Vec::new();
    for (sequence, loaded) in sequences.iter().enumerate() {
        for &grid in &grids {
            for entry in &entries {
                let file = args.out.join(file_name(loaded, grid, entry, (&settings, &device))?);
                jobs.push(Job { sequence, grid, entry: entry.clone(), file });
            }
        }
    }
    let (index, count) = args.shard()?;
    let jobs: Vec<Job> = jobs.into_iter().skip(index).step_by(count).collect();
    let (mut scores, complete) = work(&jobs, &sequences, (&device, &settings))?;
    for (name, folder) in &systems {
        for sequence in &sequences {
            scores.push(compare(sequence, name, &imported(folder, sequence)?, &settings)?);
        }
    }
    args.write(&scores)?;
    if !complete {
        eprintln!("interrupted; the scores so far are kept in {}", args.out.display());
        return Ok(Ending::Interrupted);
    }
    Ok(Ending::Done)
}

/// Does the jobs whose scores are not there yet; tells whether all were done.
fn work(
    jobs: &[Job],
    sequences: &[Sequence],
    (device, settings): (&Device, &Settings),
) -> Result<(Vec<Score>, bool)> {
    let frames = |job: &Job| sequences[job.sequence].truth.frames().min(settings.frames) as u64 - 1;
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} frames, {eta} left  {msg}");
    let bar =
        ProgressBar::new(jobs.iter().map(frames).sum()).with_style(style.expect("the template is valid"));
    let interrupted = interrupt_flag();
    let mut scores = Vec::new();
    for job in jobs {
        if job.file.is_file() {
            bar.inc(frames(job));
            scores.push(Score::read(&job.file)?);
            continue;
        }
        let sequence = &sequences[job.sequence];
        bar.set_message(format!("{} {} {}", sequence.name, job.grid, job.entry.name));
        let tick = || {
            bar.inc(1);
            match interrupted.load(Ordering::Relaxed) {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        };
        let Some(score) = run(sequence, job.grid, &job.entry, (device, settings), tick)? else {
            return Ok((scores, false));
        };
        score.write(&job.file)?;
        scores.push(score);
    }
    bar.finish_and_clear();
    Ok((scores, true))
}

impl Args {
    fn settings(&self) -> fnopt::Result<Settings> {
        let &[stretch, shear, bend] = &self.material[..] else {
            let found = format!("{} numbers", self.material.len());
            return Err(Error::invalid("--material", "coefficients", "three numbers", found));
        };
        if self.points == 0 || self.frames.is_some_and(|frames| frames < 2) {
            return Err(Error::invalid("--points, --frames", "counts", "a point and two frames", "fewer"));
        }
        let material = Material { stretch, shear, bend };
        let physics = Physics { material, density: self.wind, drag: None, frame_time_s: None };
        Ok(Settings { physics, points: self.points, frames: self.frames.unwrap_or(usize::MAX) })
    }

    /// The solvers with each of their numbers of iterations.
    fn entries(&self) -> fnopt::Result<Vec<Entry>> {
        let mut weights: Option<Weights> = None;
        let mut entries = Vec::new();
        for text in &self.solver {
            let (name, own) = match text.split_once(':') {
                None => (text.as_str(), None),
                Some((name, n)) => (
                    name,
                    Some(
                        n.parse()
                            .map_err(|_| Error::invalid("--solver", name, "NAME or NAME:ITERATIONS", text))?,
                    ),
                ),
            };
            let (known, own) = if name == "single-pass" { ("fnopt", Some(1)) } else { (name, own) };
            let mut load = || match &weights {
                Some(weights) => Ok(weights.clone()),
                None => Ok(weights.insert(load_weights(self.checkpoint.as_deref())?).clone()),
            };
            let optimizer = Optimizer::named(known, &mut load)?;
            let all = match (own, &optimizer) {
                (Some(n), _) => vec![n],
                (None, Optimizer::Newton) => vec![1],
                (None, _) => self.iterations.clone(),
            };
            if all.contains(&0) {
                return Err(Error::invalid("--iterations", name, "at least one", 0));
            }
            let of = |iterations| Entry { name: name.to_owned(), optimizer: optimizer.clone(), iterations };
            entries.extend(all.into_iter().map(of));
        }
        Ok(entries)
    }

    fn sequences(&self) -> fnopt::Result<Vec<Sequence>> {
        let known = Sequence::names(&self.ground_truth)?;
        let names = self.sequences.as_ref().unwrap_or(&known);
        let load = |name: &String| match known.contains(name) {
            true => Sequence::load(&self.ground_truth, name),
            false => {
                let origin = self.ground_truth.display().to_string();
                Err(Error::unknown(origin, "sequence", name, known.iter().map(String::as_str)))
            }
        };
        names.iter().map(load).collect()
    }

    /// The cases of a suite that take part.
    fn cases(&self, suite: Suite, grid: Grid) -> fnopt::Result<Vec<Case>> {
        let cases = suite.cases(grid)?;
        let Some(names) = &self.sequences else { return Ok(cases) };
        let known = || cases.iter().map(|case| case.name.as_str());
        if let Some(name) = names.iter().find(|name| !known().any(|known| known == *name)) {
            return Err(Error::unknown("--sequences", "case", name, known()));
        }
        Ok(cases.iter().filter(|case| names.contains(&case.name)).cloned().collect())
    }

    /// Names and folders of the systems to compare with.
    fn systems(&self) -> fnopt::Result<Vec<(String, PathBuf)>> {
        let parse = |text: &String| {
            let (name, folder) = text
                .split_once('=')
                .ok_or_else(|| Error::invalid("--compare", "system", "NAME=DIR", text))?;
            let folder = PathBuf::from(folder);
            if !folder.is_dir() {
                return Err(Error::invalid("--compare", name, "a folder", folder.display()));
            }
            Ok((name.to_owned(), folder))
        };
        self.compare.iter().map(parse).collect()
    }

    /// Number of this share and number of shares.
    fn shard(&self) -> fnopt::Result<(usize, usize)> {
        let of_slurm = || {
            let number = |name: &str| std::env::var(name).ok()?.parse::<usize>().ok();
            let first = number("SLURM_ARRAY_TASK_MIN").unwrap_or(0);
            Some((number("SLURM_ARRAY_TASK_ID")?.checked_sub(first)?, number("SLURM_ARRAY_TASK_COUNT")?))
        };
        let (index, count) = match &self.shard {
            None => of_slurm().unwrap_or((0, 1)),
            Some(text) => text
                .split_once('/')
                .and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)))
                .ok_or_else(|| Error::invalid("--shard", "share", "I/N, as in 0/4", text))?,
        };
        if index >= count {
            return Err(Error::invalid(
                "--shard",
                "share",
                format!("0 to {} of {count}", count.max(1) - 1),
                index,
            ));
        }
        Ok((index, count))
    }

    /// Runs the cases of a suite with each solver on each grid.
    fn run_suite(&self, suite: Suite, entries: &[Entry], grids: &[Grid], frames: usize) -> Result<Ending> {
        let (device, line) = self.device.open()?;
        eprintln!("{line}");
        let mut jobs = Vec::new();
        for entry in entries {
            for &grid in grids {
                jobs.extend(self.cases(suite, grid)?.into_iter().map(|case| (entry, case)));
            }
        }
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} cases, {eta} left  {msg}");
        let bar = ProgressBar::new(jobs.len() as u64).with_style(style.expect("the template is valid"));
        let interrupted = interrupt_flag();
        let tick = || match interrupted.load(Ordering::Relaxed) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        let mut scores: Vec<(String, CaseScore)> = Vec::new();
        let mut complete = true;
        for (entry, case) in jobs {
            bar.set_message(format!("{} {} {}", entry.name, case.scene.grid, case.name));
            let solver = (&entry.optimizer, entry.iterations);
            let Some((score, trajectory)) = suite::run(&case, solver, &device, (frames, !self.no_gap), tick)?
            else {
                complete = false;
                break;
            };
            let setup = case.scene.setup()?;
            let view = View { up: [0.0, 1.0, 0.0], ..Default::default() };
            let options = StripOptions { view, ..Default::default() };
            let image = strip(&trajectory, &setup.model.cloths[0].handles, &options);
            let file = format!("{}_{}_{}.png", entry.name, score.grid, score.case).replace(' ', "_");
            write_png(self.out.join(file), &image)?;
            scores.push((entry.name.clone(), score));
            bar.inc(1);
        }
        bar.finish_and_clear();
        let of = |entry: &Entry| -> Vec<CaseScore> {
            scores.iter().filter(|(name, _)| *name == entry.name).map(|(_, score)| score.clone()).collect()
        };
        let tables: Vec<Table> = entries.iter().map(|entry| suite::table(&entry.name, &of(entry))).collect();
        let named: Vec<_> = scores
            .iter()
            .map(|(solver, score)| serde_json::json!({"solver": solver, "score": score}))
            .collect();
        self.write_tables(&tables, &named)?;
        if !complete {
            eprintln!("interrupted; the cases so far are above");
        }
        let sound = scores.iter().all(|(_, score)| score.sound());
        Ok(match (complete, sound) {
            (false, _) => Ending::Interrupted,
            (true, false) => Ending::CheckFailed,
            (true, true) => Ending::Done,
        })
    }

    /// Prints the tables and writes what was asked for.
    fn write(&self, scores: &[Score]) -> Result<()> {
        self.write_tables(&tables(scores), scores)?;
        if let Some(folder) = &self.plots {
            plot(folder, scores)?;
        }
        Ok(())
    }

    fn write_tables(&self, tables: &[Table], scores: &[impl serde::Serialize]) -> Result<()> {
        let text = |format: Format| tables.iter().map(|t| t.write(format)).collect::<Vec<_>>().join("\n");
        let mut out = std::io::stdout().lock();
        let bold = out.is_terminal();
        write!(out, "{}", text(Format::Text { bold }))?;
        let into =
            |path: &Path, content: String| write_atomic(path, |file| file.write_all(content.as_bytes()));
        if let Some(path) = &self.csv {
            into(path, text(Format::Csv))?;
        }
        if let Some(path) = &self.markdown {
            into(path, text(Format::Markdown))?;
        }
        if let Some(path) = &self.json {
            into(path, serde_json::to_string_pretty(scores).expect("scores are plain data"))?;
        }
        Ok(())
    }
}

/// `32` or `48x32`.
fn grid(text: &str) -> fnopt::Result<Grid> {
    let (h, w) = text.split_once('x').unwrap_or((text, text));
    match (h.parse(), w.parse()) {
        (Ok(h), Ok(w)) => Grid::new(h, w, "--grid"),
        _ => Err(Error::invalid("--grid", "grid", "N or HxW", text)),
    }
}

/// The name of a score's file: what it is of, and a checksum of all that it depends on.
fn file_name(
    sequence: &Sequence,
    grid: Grid,
    entry: &Entry,
    (settings, device): (&Settings, &Device),
) -> fnopt::Result<String> {
    let mut sum = crc32fast::Hasher::new();
    let settings = serde_json::to_string(settings).expect("settings are plain data");
    sum.update(format!("{} {settings} {}", env!("CARGO_PKG_VERSION"), device.name()).as_bytes());
    for frame in [0, sequence.truth.frames() - 1] {
        sequence.truth.frame(frame).iter().flatten().for_each(|v| sum.update(&v.to_le_bytes()));
    }
    if let Optimizer::Learned(weights) = &entry.optimizer {
        weights.parameters().into_iter().flatten().for_each(|v| sum.update(&v.to_le_bytes()));
    }
    let Entry { name, iterations, .. } = entry;
    Ok(format!("{}_{grid}_{name}_{iterations}_{:08x}.json", sequence.name, sum.finalize()))
}

/// All scores that a folder keeps, in the order of their files' names.
fn kept(folder: &Path) -> fnopt::Result<Vec<Score>> {
    let fail = |e| Error::io(folder, "cannot read the folder", e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if path.extension().is_some_and(|e| e == "json") {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(Error::invalid(folder.display().to_string(), "scores", "files of scores", "none"));
    }
    files.iter().map(|file| Score::read(file)).collect()
}

/// Another system's trajectory of a sequence.
fn imported(folder: &Path, sequence: &Sequence) -> fnopt::Result<Trajectory> {
    let options = ReadOptions { grid: None, fps: sequence.truth.fps() };
    let names = ["npz", "npy", "pc2"].map(|e| format!("{}.{e}", sequence.name));
    let inside = ["rollout.npz", "cloth_pos.npy"].map(|file| format!("{}/{file}", sequence.name));
    let all = names.into_iter().chain(inside).chain([sequence.name.clone()]).map(|name| folder.join(name));
    let found = all.into_iter().find(|path| path.exists());
    let Some(path) = found else {
        let expected = format!("{0}.npz, .npy or .pc2, or a folder {0} of OBJ files", sequence.name);
        return Err(Error::invalid(folder.display().to_string(), "trajectory", expected, "none of them"));
    };
    Trajectory::read(path, &options)
}

/// Error per frame and solver for each sequence and grid; error and time against iterations.
fn plot(folder: &Path, scores: &[Score]) -> fnopt::Result<()> {
    /// Width and height of a chart \[px\].
    const SIZE: (usize, usize) = (640, 420);
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "cannot create the folder", e))?;
    let label = |s: &Score| match s.iterations {
        0 => s.solver.clone(),
        n => format!("{} n {n}", s.solver),
    };
    let mut of_frames: BTreeMap<(String, String), Vec<Curve>> = BTreeMap::new();
    let mut of_iterations: BTreeMap<(String, String), Vec<[f64; 3]>> = BTreeMap::new();
    for score in scores.iter().filter(|s| s.stable) {
        let points = score.per_frame.e_cd.iter().enumerate().map(|(f, &e)| [(f + 1) as f64, 1e3 * e]);
        let curve = Curve { label: label(score), points: points.collect() };
        of_frames.entry((score.sequence.clone(), score.grid.clone())).or_default().push(curve);
        if let (Some(e), Some(ms), 1..) = (score.e_cd, score.ms_per_frame, score.iterations) {
            let key = (score.grid.clone(), score.solver.clone());
            of_iterations.entry(key).or_default().push([score.iterations as f64, 1e3 * e, ms]);
        }
    }
    let draw = |name: String, all: Vec<Chart>| {
        let image = charts(&all, (2 * SIZE.0, SIZE.1 * all.len().div_ceil(2)));
        write_png(folder.join(name), &image)
    };
    let mut frames = Vec::new();
    for ((sequence, grid), curves) in of_frames {
        frames.push(Chart { title: format!("{sequence} {grid}: e_CD x 1000 per frame"), curves });
    }
    if !frames.is_empty() {
        draw("per_frame.png".into(), frames)?;
    }
    let mut grids: BTreeMap<String, [Vec<Curve>; 2]> = BTreeMap::new();
    for ((grid, solver), points) in of_iterations {
        let mut means: BTreeMap<u64, Vec<[f64; 2]>> = BTreeMap::new();
        points.iter().for_each(|p| means.entry(p[0] as u64).or_default().push([p[1], p[2]]));
        for (k, curves) in grids.entry(grid).or_default().iter_mut().enumerate() {
            let mean = |v: &[[f64; 2]]| v.iter().map(|v| v[k]).sum::<f64>() / v.len() as f64;
            let points = means.iter().map(|(&n, v)| [n as f64, mean(v)]).collect();
            curves.push(Curve { label: solver.clone(), points });
        }
    }
    let mut iterations = Vec::new();
    for (grid, [errors, times]) in grids {
        iterations.push(Chart { title: format!("{grid}: e_CD x 1000 by iterations"), curves: errors });
        iterations.push(Chart { title: format!("{grid}: ms per frame by iterations"), curves: times });
    }
    match iterations.is_empty() {
        true => Ok(()),
        false => draw("iterations.png".into(), iterations),
    }
}
