//! `fnopt evaluate`: compares solvers with recorded trajectories.

mod plots;
mod suite;

use super::device::InferenceArgs;
use super::{Ending, go_on, interrupt_flag, load_weights};
use anyhow::Result;
use fnopt::Error;
use fnopt::eval::suite::Suite;
use fnopt::eval::{
    Entry, Format, Physics, Score, Sequence, Settings, Table, compare, run, snapshots, tables,
};
use fnopt::io::{self, ReadOptions, Trajectory, write_atomic};
use fnopt::network::Weights;
use fnopt::sim::{Device, Grid, Material, Optimizer};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Arguments of `fnopt evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of sequences, each a folder with cloth_pos.npy and, where there are such, meta.json (what is told of the cloth),
    /// handles.npy, start.npy, and mesh.obj where the vertices are no grid
    #[arg(long, default_value = "assets/ground_truth", value_name = "DIR")]
    ground_truth: PathBuf,
    /// Sequences, or cases of a suite, to take part [default: all]
    #[arg(long, value_delimiter = ',', value_name = "NAME,..")]
    sequences: Option<Vec<String>>,
    /// Grids to simulate on: rows, or rows and columns
    #[arg(long, value_delimiter = ',', default_value = "32", value_name = "N|HxW,..")]
    grid: Vec<String>,
    /// Solvers: fnopt, gd, adam, lbfgs, quasi-newton, newton, single-pass, which is fnopt:1, or interpolation, which is fnopt
    /// on 32 rows carried to the grid; with iterations of their own after a colon
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
    /// Energy coefficients stretch, shear, bend, or a JSON file with them under "material" [default: those fitted to the
    /// trajectories of assets/ground_truth, assets/materials/arcsim.json]; suites have their own
    #[arg(long, value_name = "KS,KH,KB|FILE")]
    material: Option<String>,
    /// Density of the air [kg/m^3] [default: the sequence's]
    #[arg(long, value_name = "DENSITY")]
    wind: Option<f64>,
    /// Frames of each sequence, the start included [default: all]
    #[arg(long, value_name = "F")]
    frames: Option<usize>,
    /// Points sampled from each surface for e_CD
    #[arg(long, default_value_t = 10_000, value_name = "N")]
    points: usize,
    /// Another system's trajectories: DIR/SEQUENCE.npz, .npy or .pc2, or folders of OBJ files, on any grid or on the sequence's
    /// mesh; may be given more than once
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
    device: InferenceArgs,
}

/// A solver on a grid, to be run on a sequence.
struct Job {
    sequence: usize,
    grid: Grid,
    entry: Entry,
    /// Where its score is kept; a few of its frames are kept beside it.
    file: PathBuf,
}

/// A score and a few frames of what it is of, if they are there.
struct Kept {
    score: Score,
    snapshots: Option<Trajectory>,
}

pub fn run_command(args: &Args) -> Result<Ending> {
    if !args.merge.is_empty() {
        let mut all = Vec::new();
        for folder in &args.merge {
            all.extend(kept(folder)?);
        }
        return args.write(&all, &[], &Device::Cpu, &interrupt_flag()).map(|()| Ending::Done);
    }
    let settings = args.settings()?;
    let entries = args.entries()?;
    let grids: Vec<Grid> = args.grid.iter().map(|text| grid(text)).collect::<fnopt::Result<_>>()?;
    if let Some(name) = &args.suite {
        return args.run_suite(Suite::named(name)?, &entries, &grids, settings.frames);
    }
    let sequences = Sequence::load_all(&args.ground_truth, args.sequences.as_deref())?;
    let (index, count) = args.shard()?;
    // Others' trajectories first: what is wrong with them is then said before the work, not after it.
    let mut systems = Vec::new();
    for (name, folder) in args.systems()? {
        for sequence in &sequences {
            let found = sequence.read_other(&imported(&folder, sequence)?)?;
            let score = compare(sequence, &name, &found, &settings)?;
            let frames = sequence.truth.frames().min(settings.frames);
            systems.push(Kept { score, snapshots: Some(snapshots(&*sequence.on_grid(&found)?, frames)) });
        }
    }
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
    let jobs: Vec<Job> = jobs.into_iter().skip(index).step_by(count).collect();
    let interrupted = interrupt_flag();
    let (mut all, complete) = work((&jobs, &sequences), (&device, &settings), &interrupted)?;
    all.extend(systems);
    args.write(&all, &sequences, &device, &interrupted)?;
    if !complete || go_on(&interrupted).is_break() {
        eprintln!("interrupted; the scores so far are kept in {}", args.out.display());
        return Ok(Ending::Interrupted);
    }
    Ok(Ending::Done)
}

/// Does the jobs whose scores are not there yet; tells whether all were done. Newton's method takes one core, so that as many of
/// its jobs as there are cores run side by side; the others take all cores and have them to themselves.
fn work(
    (jobs, sequences): (&[Job], &[Sequence]),
    (device, settings): (&Device, &Settings),
    interrupted: &AtomicBool,
) -> Result<(Vec<Kept>, bool)> {
    let frames = |job: &Job| sequences[job.sequence].truth.frames().min(settings.frames) as u64 - 1;
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} frames, {eta} left  {msg}");
    let bar =
        ProgressBar::new(jobs.iter().map(frames).sum()).with_style(style.expect("the template is valid"));
    let failed = AtomicBool::new(false);
    // Nothing when it was interrupted.
    let done = |job: &Job| -> Result<Option<Kept>> {
        if job.file.is_file() {
            bar.inc(frames(job));
            return Ok(Some(Kept::read(&job.file)?));
        }
        let sequence = &sequences[job.sequence];
        bar.set_message(format!("{} {} {}", sequence.name, job.grid, job.entry.name));
        let tick = || {
            bar.inc(1);
            if failed.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { go_on(interrupted) }
        };
        let Some((score, found)) = run(sequence, job.grid, &job.entry, (device, settings), tick)? else {
            return Ok(None);
        };
        let snapshots = score.stable.then(|| snapshots(&found, usize::MAX));
        let kept = Kept { score, snapshots };
        kept.write(&job.file)?;
        Ok(Some(kept))
    };
    let of_one_core = |&job: &usize| matches!(jobs[job].entry.optimizer, Optimizer::Newton);
    let (side_by_side, alone): (Vec<usize>, Vec<usize>) = (0..jobs.len()).partition(of_one_core);
    // Threads of their own: a pool's would begin another sequence in the middle of a frame that waits, and its time with it.
    let next = AtomicUsize::new(0);
    let mine = || -> Result<Vec<(usize, Kept)>> {
        let mut all = Vec::new();
        while let Some(&job) = side_by_side.get(next.fetch_add(1, Ordering::Relaxed)) {
            let kept = done(&jobs[job]).inspect_err(|_| failed.store(true, Ordering::Relaxed))?;
            let Some(kept) = kept else { break };
            all.push((job, kept));
        }
        Ok(all)
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from).min(side_by_side.len());
    let shares: Vec<Result<Vec<_>>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..cores).map(|_| scope.spawn(mine)).collect();
        threads.into_iter().map(|t| t.join().unwrap_or_else(|e| std::panic::resume_unwind(e))).collect()
    });
    let mut all = Vec::new();
    for share in shares {
        all.extend(share?);
    }
    if all.len() == side_by_side.len() {
        for job in alone {
            let Some(kept) = done(&jobs[job])? else { break };
            all.push((job, kept));
        }
    }
    bar.finish_and_clear();
    all.sort_by_key(|&(job, _)| job);
    let complete = all.len() == jobs.len();
    Ok((all.into_iter().map(|(_, kept)| kept).collect(), complete))
}

impl Kept {
    /// The score in a file, and the frames beside it.
    fn read(file: &Path) -> fnopt::Result<Self> {
        let (score, frames) = (Score::read(file)?, file.with_extension("npy"));
        let read = || {
            let (h, w) = score.grid.split_once('x')?;
            let grid = Some(Grid::new(h.parse().ok()?, w.parse().ok()?, "grid").ok()?);
            frames.is_file().then(|| Trajectory::read(&frames, &ReadOptions { grid, fps: 1.0 }))
        };
        let snapshots = read().transpose()?;
        Ok(Self { score, snapshots })
    }

    /// The score last: once it is there, all is.
    fn write(&self, file: &Path) -> fnopt::Result<()> {
        if let (Some(frames), Some(folder), Some(stem)) = (&self.snapshots, file.parent(), file.file_stem()) {
            frames.write(folder, &stem.to_string_lossy(), io::Format::Npy)?;
        }
        self.score.write(file)
    }
}

impl Args {
    fn settings(&self) -> fnopt::Result<Settings> {
        if self.points == 0 || self.frames.is_some_and(|frames| frames < 2) {
            return Err(Error::invalid("--points, --frames", "counts", "a point and two frames", "fewer"));
        }
        let material = material(self.material.as_deref())?;
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
            let (known, own) = match name {
                "single-pass" => ("fnopt", Some(1)),
                "interpolation" => ("fnopt", own),
                _ => (name, own),
            };
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
            let of = |iterations| Entry {
                name: name.to_owned(),
                optimizer: optimizer.clone(),
                iterations,
                coarse: name == "interpolation",
            };
            entries.extend(all.into_iter().map(of));
        }
        Ok(entries)
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

    /// Prints the tables and writes what was asked for.
    fn write(
        &self,
        all: &[Kept],
        sequences: &[Sequence],
        device: &Device,
        interrupted: &AtomicBool,
    ) -> Result<()> {
        let scores: Vec<Score> = all.iter().map(|kept| kept.score.clone()).collect();
        self.write_tables(&tables(&scores), &scores)?;
        if let Some(folder) = &self.plots {
            plots::draw(folder, &scores)?;
            for sequence in sequences {
                plots::error_maps(folder, sequence, (all, self.frames.unwrap_or(usize::MAX)))?;
            }
            self.plot_convergence(folder, sequences, device, interrupted)?;
        }
        Ok(())
    }

    /// The energy gap against the number of iterations of every solver, on the first frames of the first sequence.
    fn plot_convergence(
        &self,
        folder: &Path,
        sequences: &[Sequence],
        device: &Device,
        interrupted: &AtomicBool,
    ) -> Result<()> {
        let (Some(sequence), Some(text)) = (sequences.first(), self.grid.first()) else { return Ok(()) };
        let optimizers = self.entries()?.into_iter().map(|entry| entry.optimizer).collect();
        let frames = self.frames.unwrap_or(usize::MAX);
        Ok(plots::convergence(
            folder,
            (sequence, grid(text)?),
            (optimizers, frames),
            (&self.settings()?.physics, device),
            || go_on(interrupted),
        )?)
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

/// The fitted material.
const MATERIAL: &str = include_str!("../../../assets/materials/arcsim.json");

/// Three numbers or a file of them; the fitted ones where nothing is given.
fn material(text: Option<&str>) -> fnopt::Result<Material> {
    let coefficients = match text {
        None => of_file("the fitted material", MATERIAL.as_bytes())?,
        Some(text) if text.contains(',') => {
            let numbers: Vec<f64> = text.split(',').filter_map(|n| n.trim().parse().ok()).collect();
            let three = <[f64; 3]>::try_from(numbers);
            three
                .map_err(|_| Error::invalid("--material", "coefficients", "three numbers or a file", text))?
        }
        Some(path) => {
            let bytes = std::fs::read(path).map_err(|e| Error::io(path, "cannot read", e))?;
            of_file(path, &bytes)?
        }
    };
    if !coefficients.iter().all(|k| k.is_finite() && *k >= 0.0) {
        let found = format!("{coefficients:?}");
        return Err(Error::invalid("--material", "coefficients", "numbers that are not negative", found));
    }
    let [stretch, shear, bend] = coefficients;
    Ok(Material { stretch, shear, bend })
}

/// Stretch, shear and bend under `material` of a JSON object.
fn of_file(origin: &str, bytes: &[u8]) -> fnopt::Result<[f64; 3]> {
    let bad = |field: String, expected: &str, found: String| Error::invalid(origin, field, expected, found);
    let object: serde_json::Value =
        serde_json::from_slice(bytes).map_err(|e| bad("text".into(), "JSON", e.to_string()))?;
    let mut coefficients = [0.0; 3];
    for (to, key) in coefficients.iter_mut().zip(["stretch", "shear", "bend"]) {
        let value = &object["material"][key];
        *to = value.as_f64().ok_or_else(|| bad(format!("material.{key}"), "a number", value.to_string()))?;
    }
    Ok(coefficients)
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
    sum.update(&sequence.checksum().to_le_bytes());
    if let Optimizer::Learned(weights) = &entry.optimizer {
        weights.parameters().into_iter().flatten().for_each(|v| sum.update(&v.to_le_bytes()));
    }
    let Entry { name, iterations, .. } = entry;
    Ok(format!("{}_{grid}_{name}_{iterations}_{:08x}.json", sequence.name, sum.finalize()))
}

/// All scores that a folder keeps, in the order of their files' names.
fn kept(folder: &Path) -> fnopt::Result<Vec<Kept>> {
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
    files.iter().map(|file| Kept::read(file)).collect()
}

/// The file or folder of another system's trajectory of a sequence.
fn imported(folder: &Path, sequence: &Sequence) -> fnopt::Result<PathBuf> {
    let names = ["npz", "npy", "pc2"].map(|e| format!("{}.{e}", sequence.name));
    let inside = ["rollout.npz", "cloth_pos.npy"].map(|file| format!("{}/{file}", sequence.name));
    let all = names.into_iter().chain(inside).chain([sequence.name.clone()]).map(|name| folder.join(name));
    let found = all.into_iter().find(|path| path.exists());
    found.ok_or_else(|| {
        let expected = format!("{0}.npz, .npy or .pc2, or a folder {0} of OBJ files", sequence.name);
        Error::invalid(folder.display().to_string(), "trajectory", expected, "none of them")
    })
}
