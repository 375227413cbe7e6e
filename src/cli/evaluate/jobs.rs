//! The simulations of an evaluation, and the files that hold their scores.

use super::SOLVERS;
use crate::cli::go_on;
use crate::cli::output::{progress, status};
use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::eval::{
    Conditions, Entry, Nudge, SNAPSHOTS, Score, Sequence, Settings, belong_together, coarse, compare, run,
    snapshots,
};
use fnopt::io::{self, ReadOptions, Trajectory};
use fnopt::{Error, Result};
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How work ended: whether to continue, or why it failed.
type Ended = Result<ControlFlow<()>>;

/// The simulations to run: every solver on every sequence and grid.
pub struct Plan<'a> {
    pub sequences: &'a [Sequence],
    pub grids: &'a [Grid],
    pub entries: &'a [Entry],
    pub device: &'a Device,
    pub settings: Settings,
    /// Number of times to run each simulation: first from the recorded start, then from slightly perturbed
    /// ones.
    pub repeats: u64,
}

/// A solver to run on a sequence and grid.
pub struct Job<'a> {
    /// Index of the piece of work that it belongs to. The solvers on one sequence and grid stay in one piece,
    /// because their times are compared.
    pub piece: usize,
    sequence: &'a Sequence,
    nudge: Option<Nudge>,
    grid: Grid,
    entry: &'a Entry,
    /// File of its score; a few of its frames are kept next to it.
    file: PathBuf,
}

/// A score and, if available, a few frames of the simulation.
pub struct Kept {
    pub score: Score,
    pub snapshots: Option<Trajectory>,
}

impl<'a> Plan<'a> {
    /// Lists all jobs, each once, with their files in `folder`.
    pub fn jobs(&self, folder: &Path) -> Vec<Job<'a>> {
        let (mut jobs, mut known) = (Vec::new(), BTreeSet::new());
        // All simulations run once before any is repeated.
        let starts = (0..self.repeats).map(Nudge::of);
        let of_start = |nudge| self.sequences.iter().map(move |sequence| (nudge, sequence));
        let of_sequence = |(nudge, sequence)| self.grids.iter().map(move |&grid| (nudge, sequence, grid));
        for (piece, (nudge, sequence, grid)) in starts.flat_map(of_start).flat_map(of_sequence).enumerate() {
            for entry in self.entries {
                let conditions = Conditions::of((sequence, nudge), entry, (self.device, &self.settings));
                let what = format!("{}_{grid}_{}_{}", sequence.name, entry.name, entry.iterations);
                let file = file(folder, &what, &conditions);
                if known.insert(file.clone()) {
                    jobs.push(Job { piece, sequence, nudge, grid, entry, file });
                }
            }
        }
        jobs
    }

    /// Runs the jobs that have no score yet. Returns the scores in the order of the jobs, and how the work
    /// ended, which is early if it was interrupted. CPU jobs run side by side, one per core, or on equal
    /// shares of the cores if the whole plan has fewer CPU jobs. The shares do not depend on which jobs are
    /// still missing, so that times are comparable. Several cores that share one simulation, frame by frame,
    /// would be far less busy. GPU jobs run one at a time, with the GPU to themselves.
    pub fn work(&self, jobs: &[Job], interrupted: &AtomicBool) -> (Vec<Kept>, Ended) {
        let frames = |job: &Job| job.sequence.truth.frames().min(self.settings.frames) - 1;
        let bar = progress(jobs.iter().map(frames).sum::<usize>() as u64, "frames");
        let failed = AtomicBool::new(false);
        let all: Mutex<Vec<(usize, Kept)>> = Mutex::default();
        let done = |number: usize| -> Ended {
            let Job { sequence, nudge, grid, entry, file, .. } = &jobs[number];
            bar.set_message(format!("{} {grid} {}", sequence.name, entry.name));
            let tick = || {
                bar.inc(1);
                if failed.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { go_on(interrupted) }
            };
            let around = (self.device, &self.settings);
            let Some((score, found)) = run((sequence, *nudge), *grid, entry, around, tick)? else {
                return Ok(ControlFlow::Break(()));
            };
            let snapshots = score.stable.then(|| snapshots(&found, usize::MAX));
            let kept = Kept { score, snapshots };
            kept.write(file)?;
            all.lock().unwrap_or_else(|e| e.into_inner()).push((number, kept));
            Ok(ControlFlow::Continue(()))
        };
        let mut missing = Vec::new();
        let mut read = || -> Result<()> {
            for (number, job) in jobs.iter().enumerate() {
                match Kept::read(&job.file)? {
                    Some(kept) => {
                        bar.inc(frames(job) as u64);
                        all.lock().unwrap_or_else(|e| e.into_inner()).push((number, kept));
                    }
                    None => missing.push(number),
                }
            }
            Ok(())
        };
        let read = read();
        let of_cpu = |&job: &usize| matches!(jobs[job].entry.device(self.device), Device::Cpu);
        let (mut on_cpu, on_gpu): (Vec<usize>, Vec<usize>) = missing.into_iter().partition(of_cpu);
        // The finest grids first, so that no core waits long for another at the end. All jobs run once before
        // any is repeated.
        on_cpu.sort_by_key(|&job| {
            let Job { nudge, grid, .. } = &jobs[job];
            (nudge.map_or(0, |nudge| nudge.repeat), Reverse(grid.particles()))
        });
        let ending = read
            .and_then(|()| side_by_side((&on_cpu, self.on_cpu()), &failed, &done))
            .and_then(|ended| then(ended, || in_turn(&on_gpu, done)));
        bar.finish_and_clear();
        let mut all = all.into_inner().unwrap_or_else(|e| e.into_inner());
        all.sort_by_key(|&(number, _)| number);
        (all.into_iter().map(|(_, kept)| kept).collect(), ending)
    }

    /// Number of jobs that run on the CPU, over all shards.
    fn on_cpu(&self) -> usize {
        let entries = self.entries.iter().filter(|entry| matches!(entry.device(self.device), Device::Cpu));
        self.sequences.len() * self.grids.len() * entries.count() * self.repeats as usize
    }
}

/// Continues with `next` unless the work has ended.
fn then(ended: ControlFlow<()>, next: impl FnOnce() -> Ended) -> Ended {
    if ended.is_break() { Ok(ended) } else { next() }
}

/// Runs one job after another, until one fails or ends the work.
fn in_turn(jobs: &[usize], done: impl Fn(usize) -> Ended) -> Ended {
    jobs.iter().try_fold(ControlFlow::Continue(()), |ended, &job| then(ended, || done(job)))
}

/// Runs jobs on separate threads, each with a pool of its share of the cores; `all` counts the CPU jobs of
/// the whole plan. With a common pool, a frame that waits would begin another job and count its time as well.
/// A job that fails sets `failed`, which ends the others, and its error is returned.
fn side_by_side(
    (jobs, all): (&[usize], usize),
    failed: &AtomicBool,
    done: &(impl Fn(usize) -> Ended + Sync),
) -> Ended {
    let (cores, count) = (rayon::current_num_threads(), jobs.len());
    let threads = cores / cores.min(all).max(1);
    let workers = (cores / threads).min(count);
    if workers > 1 {
        status!("{count} simulations, {workers} at a time, each on {threads} of {cores} threads");
    }
    let next = AtomicUsize::new(0);
    let mine = || {
        while let Some(&job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let ended = done(job).inspect_err(|_| failed.store(true, Ordering::Relaxed))?;
            if ended.is_break() {
                return Ok(ended);
            }
        }
        Ok(ControlFlow::Continue(()))
    };
    let in_pool = || {
        let _guard = Unwinding(failed);
        match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
            Ok(pool) => pool.install(mine),
            Err(_) => mine(),
        }
    };
    std::thread::scope(|scope| {
        let mut spawned = Vec::new();
        for _ in 0..workers {
            match std::thread::Builder::new().spawn_scoped(scope, in_pool) {
                Ok(worker) => spawned.push(worker),
                // The threads that did start do all the work.
                Err(_) if !spawned.is_empty() => break,
                Err(e) => return Err(Error::Device(format!("cpu: cannot start a thread: {e}"))),
            }
        }
        let mut all = spawned.into_iter().map(|w| w.join().unwrap_or_else(|e| std::panic::resume_unwind(e)));
        // Report the failure rather than that others ended early because of it.
        all.try_fold(ControlFlow::Continue(()), |ended, next| {
            next.map(|next| if ended.is_break() { ended } else { next })
        })
    })
}

/// Ends the other workers if the thread that holds it panics.
struct Unwinding<'a>(&'a AtomicBool);

impl Drop for Unwinding<'_> {
    fn drop(&mut self) {
        self.0.fetch_or(std::thread::panicking(), Ordering::Relaxed);
    }
}

/// Returns a sequence if its scene can be built on all grids, and, if `coarsened`, on their coarse ones, so that
/// errors are reported before the work and not during it.
pub fn with_valid_scenes(
    sequence: Sequence,
    (grids, coarsened): (&[Grid], bool),
    settings: &Settings,
) -> Result<Sequence> {
    let coarse = grids.iter().filter(|_| coarsened).map(|&grid| coarse(grid));
    for grid in grids.iter().copied().chain(coarse) {
        sequence.scene(grid, &settings.physics_of(&sequence))?.setup()?;
    }
    Ok(sequence)
}

/// Returns the file of a score. Everything that the score depends on is in its name, directly or in the
/// checksum.
fn file(folder: &Path, what: &str, conditions: &Conditions) -> PathBuf {
    folder.join(format!("{what}_{:08x}.json", conditions.checksum()))
}

impl Kept {
    /// Scores another system's trajectory and takes a few frames of it on a grid.
    pub fn imported(
        sequence: &Sequence,
        name: &str,
        found: &Trajectory,
        settings: &Settings,
    ) -> Result<Self> {
        let score = compare(sequence, name, found, settings)?;
        let frames = sequence.truth.frames().min(settings.frames);
        let snapshots = match score.stable {
            true => Some(snapshots(&*sequence.on_grid(found)?, frames)),
            false => None,
        };
        Ok(Self { score, snapshots })
    }

    /// Stores another system's score with those of the solvers, in place of an earlier one of the same system
    /// and sequence.
    pub fn keep_imported(&self, folder: &Path) -> Result<()> {
        let Score { sequence, grid, solver, made_with, .. } = &self.score;
        let plain: String = solver.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
        // With a checksum of the name itself, because names may differ only in their special characters.
        let system = format!("_{plain}-{:08x}_compared_", crc32fast::hash(solver.as_bytes()));
        let own = file(folder, &format!("{sequence}_{grid}{}", system.trim_end_matches('_')), made_with);
        // An earlier trajectory may have been on another grid.
        for path in io::entries(folder)? {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let rest = name.strip_prefix(&format!("{sequence}_")).and_then(|rest| rest.split_once(&system));
            // The text in between must be a grid, not part of another sequence's name.
            if rest.is_some_and(|(grid, _)| !grid.contains('_')) && path != own {
                io::remove(&path)?;
            }
        }
        self.write(&own)
    }

    /// Reads a score and the frames next to it. Returns `None` if there is no score, or if it is stable and
    /// its frames are missing.
    fn read(file: &Path) -> Result<Option<Self>> {
        if !file.is_file() {
            return Ok(None);
        }
        let score = Score::read(file)?;
        if !score.stable {
            return Ok(Some(Self { score, snapshots: None }));
        }
        let read = || {
            let (h, w) = score.grid.split_once('x')?;
            let grid = Some(Grid::new(h.parse().ok()?, w.parse().ok()?, "grid").ok()?);
            let options = ReadOptions { grid, fps: 1.0, ..ReadOptions::default() };
            let frames = Trajectory::read(file.with_extension("npy"), &options).ok()?;
            (frames.frames() == SNAPSHOTS).then_some(frames)
        };
        Ok(read().map(|snapshots| Self { score, snapshots: Some(snapshots) }))
    }

    /// Writes the frames, then the score: if the score exists, so do its frames.
    fn write(&self, file: &Path) -> Result<()> {
        if let (Some(frames), Some(folder), Some(stem)) = (&self.snapshots, file.parent(), file.file_stem()) {
            frames.write(folder, &stem.to_string_lossy(), io::Format::Npy)?;
        }
        self.score.write(file)
    }
}

/// Reads all scores in the folders, by sequence and grid. Fails if they do not belong together.
pub fn merged(folders: &[PathBuf]) -> Result<Vec<Score>> {
    let mut files = Vec::new();
    for folder in folders {
        let mut own = io::entries(folder)?;
        own.retain(|path| path.extension().is_some_and(|e| e == "json"));
        if own.is_empty() {
            return Err(Error::invalid(folder.display().to_string(), "scores", "score files", "none"));
        }
        files.extend(own);
    }
    let (mut scores, mut of_files): (Vec<Score>, Vec<&Path>) = (Vec::new(), Vec::new());
    for file in &files {
        let score = Score::read(file)?;
        // Another system's score may be in several folders.
        if !(score.is_imported() && scores.contains(&score)) {
            scores.push(score);
            of_files.push(file);
        }
    }
    let pairs: Vec<(&Path, &Score)> = of_files.into_iter().zip(&scores).collect();
    belong_together(&pairs)?;
    // Whichever folder a score is in: the default solvers in their order, then others by name, then imported
    // ones.
    let particles = |score: &Score| {
        let sides = score.grid.split('x').map(|side| side.parse::<usize>().unwrap_or(0));
        sides.product::<usize>()
    };
    let solver = |score: &Score| {
        let known = |name: &&str| name.split(':').next() == Some(score.solver.as_str());
        SOLVERS.iter().position(known).unwrap_or(SOLVERS.len())
    };
    let place = |s: &Score| {
        (s.sequence.clone(), particles(s), s.is_imported(), solver(s), s.solver.clone(), s.iterations)
    };
    scores.sort_by_cached_key(place);
    Ok(scores)
}
