//! The simulations of an evaluation, and their scores in files.

use super::progress;
use crate::cli::go_on;
use crate::cli::output::tell;
use fnopt::eval::{
    Conditions, Entry, Nudge, SNAPSHOTS, Score, Sequence, Settings, belong_together, coarse, compare, run,
    snapshots,
};
use fnopt::io::{self, ReadOptions, Trajectory};
use fnopt::sim::{Device, Grid};
use fnopt::{Error, Result};
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How work ended: whether to go on, or why it failed.
type Ended = Result<ControlFlow<()>>;

/// What every solver is run on.
pub struct Plan<'a> {
    pub sequences: &'a [Sequence],
    pub grids: &'a [Grid],
    pub entries: &'a [Entry],
    pub device: &'a Device,
    pub settings: Settings,
    /// How often each is done, first from the recorded start, then from others that are all but the same.
    pub repeats: u64,
}

/// A solver on a grid, to be run on a sequence.
pub struct Job<'a> {
    /// The piece of the work that it belongs to. The solvers on one sequence and grid are not shared out: their times are compared.
    pub piece: usize,
    sequence: &'a Sequence,
    nudge: Option<Nudge>,
    grid: Grid,
    entry: &'a Entry,
    /// Where its score is kept; a few of its frames are kept beside it.
    file: PathBuf,
}

/// A score and a few frames of what it is of, if they are there.
pub struct Kept {
    pub score: Score,
    pub snapshots: Option<Trajectory>,
}

impl<'a> Plan<'a> {
    /// All jobs, each once, with their files in a folder.
    pub fn jobs(&self, folder: &Path) -> Result<Vec<Job<'a>>> {
        for sequence in self.sequences {
            for &grid in self.grids {
                let coarser = coarse(grid);
                let scene = || sequence.scene(coarser, &self.settings.physics)?.setup();
                if self.entries.iter().any(|entry| entry.coarse) && scene().is_err() {
                    let expected = format!("a coarser grid of the shape of {grid}");
                    return Err(Error::invalid("--solver", "interpolation", expected, coarser));
                }
            }
        }
        let (mut jobs, mut known) = (Vec::new(), BTreeSet::new());
        // All are done once before any is done again.
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
        Ok(jobs)
    }

    /// Does the jobs whose scores are not there yet: the scores, in the order of the jobs, and how it ended, which is early when
    /// it was interrupted. Those of the CPU run side by side, as many as there are cores, on one each, or on as many as the whole
    /// plan's jobs leave, whichever of them are still missing: so their times are alike. One frame after the other keeps
    /// several cores far less busy. A GPU's have it to themselves, one by one.
    pub fn work(&self, jobs: &[Job], interrupted: &AtomicBool) -> (Vec<Kept>, Ended) {
        let frames = |job: &Job| job.sequence.truth.frames().min(self.settings.frames) - 1;
        let bar = progress(jobs.iter().map(frames).sum(), "frames");
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
        // The finest grids first, so that at the end no core waits long for another; but once all, before any is repeated.
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

    /// Number of the jobs that run on the CPU, whatever share of them is to be done here.
    fn on_cpu(&self) -> usize {
        let entries = self.entries.iter().filter(|entry| matches!(entry.device(self.device), Device::Cpu));
        self.sequences.len() * self.grids.len() * entries.count() * self.repeats as usize
    }
}

/// Goes on with `next` unless it has ended.
fn then(ended: ControlFlow<()>, next: impl FnOnce() -> Ended) -> Ended {
    if ended.is_break() { Ok(ended) } else { next() }
}

/// Does one job after the other, until one fails or ends everything.
fn in_turn(jobs: &[usize], done: impl Fn(usize) -> Ended) -> Ended {
    jobs.iter().try_fold(ControlFlow::Continue(()), |ended, &job| then(ended, || done(job)))
}

/// Does jobs, of `all` that there are, on threads of their own, each with a pool of its share of the cores: those of a common one
/// would begin another job in the middle of a frame that waits, and its time with it. One that fails sets `failed`, which ends the
/// others, and is told.
fn side_by_side(
    (jobs, all): (&[usize], usize),
    failed: &AtomicBool,
    done: &(impl Fn(usize) -> Ended + Sync),
) -> Ended {
    let (cores, count) = (rayon::current_num_threads(), jobs.len());
    let threads = cores / cores.min(all).max(1);
    let workers = (cores / threads).min(count);
    if workers > 1 {
        tell!("{count} simulations, {workers} side by side on {threads} of {cores} threads each");
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
                // Those that there are do the work of all.
                Err(_) if !spawned.is_empty() => break,
                Err(e) => return Err(Error::Device(format!("cpu: no thread to simulate on: {e}"))),
            }
        }
        let mut all = spawned.into_iter().map(|w| w.join().unwrap_or_else(|e| std::panic::resume_unwind(e)));
        // What failed is told, not that others ended early because of it.
        all.try_fold(ControlFlow::Continue(()), |ended, next| {
            next.map(|next| if ended.is_break() { ended } else { next })
        })
    })
}

/// Tells the others to end when the thread that holds it panics.
struct Unwinding<'a>(&'a AtomicBool);

impl Drop for Unwinding<'_> {
    fn drop(&mut self) {
        self.0.fetch_or(std::thread::panicking(), Ordering::Relaxed);
    }
}

/// A sequence whose scene can be made on all grids: what is wrong with one is said before the work and not in the middle of it.
pub fn playable(sequence: Sequence, grids: &[Grid], settings: &Settings) -> Result<Sequence> {
    grids.iter().try_for_each(|&grid| sequence.scene(grid, &settings.physics)?.setup().map(drop))?;
    Ok(sequence)
}

/// The file of a score: all that it depends on is in its name, or in the checksum there.
fn file(folder: &Path, what: &str, conditions: &Conditions) -> PathBuf {
    folder.join(format!("{what}_{:08x}.json", conditions.checksum()))
}

impl Kept {
    /// Another system's score, and a few frames of it on a grid.
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

    /// Keeps another system's score beside those of the solvers.
    pub fn keep_imported(&self, folder: &Path) -> Result<()> {
        let Score { sequence, grid, solver, made_with, .. } = &self.score;
        let plain: String = solver.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
        // Of the name itself, too: several may look alike without their signs.
        let system = format!("_{plain}-{:08x}_compared_", crc32fast::hash(solver.as_bytes()));
        let own = file(folder, &format!("{sequence}_{grid}{}", system.trim_end_matches('_')), made_with);
        // An earlier trajectory may have been on another grid.
        let fail = |e| Error::io(folder, "cannot read the folder", e);
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let rest = name.strip_prefix(&format!("{sequence}_")).and_then(|rest| rest.split_once(&system));
            // What is between is a grid, and no part of another sequence's name.
            if rest.is_some_and(|(grid, _)| !grid.contains('_')) && path != own {
                io::remove(&path)?;
            }
        }
        self.write(&own)
    }

    /// The score in a file, and the frames beside it; nothing where it is not there, or where frames of a stable one are not.
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
            let options = ReadOptions { grid, fps: 1.0 };
            let frames = Trajectory::read(file.with_extension("npy"), &options).ok()?;
            (frames.frames() == SNAPSHOTS).then_some(frames)
        };
        Ok(read().map(|snapshots| Self { score, snapshots: Some(snapshots) }))
    }

    /// The score last: once it is there, all is.
    fn write(&self, file: &Path) -> Result<()> {
        if let (Some(frames), Some(folder), Some(stem)) = (&self.snapshots, file.parent(), file.file_stem()) {
            frames.write(folder, &stem.to_string_lossy(), io::Format::Npy)?;
        }
        self.score.write(file)
    }
}

/// All scores that folders keep, by sequence and grid; they must belong together.
pub fn merged(folders: &[PathBuf]) -> Result<Vec<Score>> {
    let mut files = Vec::new();
    for folder in folders {
        let fail = |e| Error::io(folder, "cannot read the folder", e);
        let mut own = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if path.extension().is_some_and(|e| e == "json") {
                own.push(path);
            }
        }
        if own.is_empty() {
            return Err(Error::invalid(folder.display().to_string(), "scores", "files of scores", "none"));
        }
        own.sort();
        files.extend(own);
    }
    let (mut scores, mut of_files): (Vec<Score>, Vec<&Path>) = (Vec::new(), Vec::new());
    for file in &files {
        let score = Score::read(file)?;
        // Another system's may have been kept beside the solvers of several folders.
        if !(score.is_imported() && scores.contains(&score)) {
            scores.push(score);
            of_files.push(file);
        }
    }
    let told: Vec<(&Path, &Score)> = of_files.into_iter().zip(&scores).collect();
    belong_together(&told)?;
    // As tables of one run have them, whichever folder a score is in.
    let particles = |score: &Score| {
        let sides = score.grid.split('x').map(|side| side.parse::<usize>().unwrap_or(0));
        sides.product::<usize>()
    };
    scores.sort_by(|a, b| (&a.sequence, particles(a)).cmp(&(&b.sequence, particles(b))));
    Ok(scores)
}
