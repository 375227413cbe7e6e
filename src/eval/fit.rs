//! Fit of the material with which the converged simulation comes closest to recorded trajectories.

use super::{Entry, Physics, Sequence, Settings, conditions, run};
use crate::Device;
use crate::cloth::{Grid, Material};
use crate::scene::Stiffness;
use crate::sim::Optimizer;
use crate::{Error, Result, io};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;

/// The parameters that can be fitted, in the order of [`Point`].
pub const PARAMETERS: [&str; 6] = ["stretch", "shear", "bend", "density", "drag", "frame_time"];

/// A value for each of [`PARAMETERS`]: energy coefficients (grid units), density [kg/m^3] and drag [N s/m^3]
/// of the air, and the frame time \[s\].
pub type Point = [f64; 6];

/// Largest number of points in the coarse grid: months of work.
const MOST_POINTS: usize = 100_000;

/// A search: first on a grid of points spaced by equal ratios, then around the best one in ever smaller
/// steps.
#[derive(Clone, Debug)]
pub struct Fit<'a> {
    /// The trajectories, whose mean error is minimised.
    pub sequences: &'a [Sequence],
    /// The grid of the simulations.
    pub grid: Grid,
    /// Frames and points of a comparison; each point of the search replaces the physics.
    pub settings: Settings,
    /// Smallest and largest value of each parameter; equal if the parameter is fixed.
    pub ranges: [[f64; 2]; 6],
    /// Number of values of each parameter in the coarse grid.
    pub levels: usize,
    /// Rounds of refinement, each of which halves the step (takes the square root of its ratio).
    pub rounds: usize,
}

/// Errors of the points tried so far: mean e_CD [m^2], infinite if the simulation diverged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorSurface {
    /// What the errors were measured on ([`Fit::subject`]).
    subject: String,
    errors: BTreeMap<Key, (Point, f64)>,
}

impl ErrorSurface {
    /// Reads the errors of an earlier search. Fails if its subject is not that of `fit`. Returns an empty
    /// surface if there is no such file.
    pub fn load(path: &Path, fit: &Fit<'_>) -> Result<Self> {
        let mut surface = Self { subject: fit.subject(), ..Self::default() };
        if !path.is_file() {
            return Ok(surface);
        }
        let bytes = io::read_bytes(path)?;
        let text = String::from_utf8_lossy(&bytes);
        let bad = |number: usize, expected: &str, line: &str| {
            let (origin, field) = (path.display().to_string(), format!("line {}", number + 1));
            Error::invalid(origin, field, expected, line)
        };
        let first = text.lines().next().unwrap_or_default();
        if first.strip_prefix("# ") != Some(&surface.subject) {
            return Err(bad(0, &format!("# {}, as in this search", surface.subject), first));
        }
        let heads = heads();
        match text.lines().nth(1) {
            Some(line) if line == heads => {}
            line => return Err(bad(1, &heads, line.unwrap_or("nothing"))),
        }
        for (number, line) in text.lines().enumerate().skip(2) {
            let values: Option<Vec<f64>> = line.split(',').map(|v| v.parse().ok()).collect();
            let Some(Ok([point @ .., error])) = values.map(<[f64; 7]>::try_from) else {
                return Err(bad(number, "seven numbers", line));
            };
            // Written so that NaN fails.
            if !(error >= 0.0 && point.iter().all(|&v| v >= 0.0)) {
                return Err(bad(number, "numbers that are not negative", line));
            }
            surface.errors.insert(key(&point), (point, error));
        }
        Ok(surface)
    }

    /// Adds the points of another search. Panics if its subject differs.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.subject, other.subject, "errors of one thing");
        self.errors.extend(&other.errors);
    }

    /// Writes all errors as CSV, in ascending order.
    pub fn write(&self, path: &Path) -> Result<()> {
        let line = |(point, error): &(Point, f64)| {
            let values: Vec<String> = point.iter().chain([error]).map(f64::to_string).collect();
            format!("{}\n", values.join(","))
        };
        let lines: String = self.sorted().iter().map(line).collect();
        let heads = heads();
        io::write_atomic(path, |file| write!(file, "# {}\n{heads}\n{lines}", self.subject))
    }

    /// Returns all points with their errors, the best first.
    pub fn sorted(&self) -> Vec<(Point, f64)> {
        let mut all: Vec<(Point, f64)> = self.errors.values().copied().collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1));
        all
    }
}

/// Returns the column headings of the file of a search.
fn heads() -> String {
    format!("{},e_cd", PARAMETERS.join(","))
}

/// A point in single precision: computed in two ways, the same point differs in its last bits.
type Key = [u32; PARAMETERS.len()];

fn key(point: &Point) -> Key {
    point.map(|v| (v as f32).to_bits())
}

fn physics(&[stretch, shear, bend, density, drag, frame_time]: &Point) -> Physics {
    Physics {
        stiffness: Stiffness::Grid(Material { stretch, shear, bend, ..Material::PAPER }),
        density: Some(density),
        drag: Some(drag),
        frame_time_s: Some(frame_time),
    }
}

impl Fit<'_> {
    /// Describes what errors are measured on, so that only comparable points are compared: the sequences with
    /// their frames and a checksum of their files, the grid, the number of sample points, and the version.
    pub fn subject(&self) -> String {
        let of = |s: &Sequence| {
            let frames = s.truth.frames().min(self.settings.frames);
            format!("{} ({frames} frames, {:08x})", s.name, s.checksum())
        };
        let sequences: Vec<String> = self.sequences.iter().map(of).collect();
        let (names, points, version) = (sequences.join(" "), self.settings.points, conditions::version());
        format!("{names} on {} with {points} points by {version}", self.grid)
    }

    /// Runs the search, starting from the points in `surface`. After every few points, `tried` is called with
    /// the surface and the number of points left. `tick` is called after each frame and may end the search,
    /// which discards unfinished points. Fails if the coarse grid has too many points, if the ends of the
    /// ranges cannot be simulated, or if all points diverge.
    pub fn search(
        &self,
        surface: &mut ErrorSurface,
        tick: impl Fn() -> ControlFlow<()> + Sync,
        mut tried: impl FnMut(&ErrorSurface, usize) -> Result<()>,
    ) -> Result<()> {
        let free: Vec<usize> = (0..6).filter(|&k| self.ranges[k][0] < self.ranges[k][1]).collect();
        let count = self.levels.checked_pow(free.len() as u32).filter(|&count| count <= MOST_POINTS);
        if count.is_none() || self.levels < 2 {
            let expected = format!("at least 2, and at most {MOST_POINTS} points in the coarse grid");
            let found = format!("{} of each of {} parameters", self.levels, free.len());
            return Err(Error::invalid("fit", "levels", expected, found));
        }
        self.check()?;
        let ratio = |k: usize| (self.ranges[k][1] / self.ranges[k][0]).powf(1.0 / (self.levels - 1) as f64);
        let mut points = vec![self.ranges.map(|range| range[0])];
        for &k in &free {
            let value = |level: usize| self.ranges[k][0] * ratio(k).powi(level as i32);
            let along = |p: &Point| {
                let p = *p;
                (0..self.levels).map(move |level| {
                    let mut p = p;
                    p[k] = value(level);
                    p
                })
            };
            points = points.iter().flat_map(along).collect();
        }
        if self.try_all(&points, surface, (&tick, &mut tried))?.is_break() {
            return Ok(());
        }
        for round in 1..=self.rounds {
            let step = |k: usize| ratio(k).powf(0.5f64.powi(round as i32));
            // Descend with this step until no neighbour of the best point is better.
            loop {
                let (best, error) = self.best(surface)?;
                let around = free.iter().flat_map(|&k| {
                    [1.0 / step(k), step(k)].map(|factor| {
                        let mut point = best;
                        point[k] = (point[k] * factor).clamp(self.ranges[k][0], self.ranges[k][1]);
                        point
                    })
                });
                let around: Vec<Point> = around.collect();
                if self.try_all(&around, surface, (&tick, &mut tried))?.is_break() {
                    return Ok(());
                }
                if self.best(surface)?.1 >= error {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Returns the points of a surface that lie in the ranges, with their errors, the best first: an earlier
    /// search may have had other ranges.
    pub fn found(&self, surface: &ErrorSurface) -> Vec<(Point, f64)> {
        let inside = |point: &Point| {
            let in_range = |(&v, range): (&f64, &[f64; 2])| {
                // In single precision, like [`Key`]: points are computed from the ranges with rounding.
                (range[0] as f32..=range[1] as f32).contains(&(v as f32))
            };
            point.iter().zip(&self.ranges).all(in_range)
        };
        surface.sorted().into_iter().filter(|(point, _)| inside(point)).collect()
    }

    fn best(&self, surface: &ErrorSurface) -> Result<(Point, f64)> {
        let best = self.found(surface).first().copied().filter(|best| best.1.is_finite());
        best.ok_or_else(|| Error::invalid("fit", "ranges", "a point that does not diverge", "none"))
    }

    /// Tries the points that are new, as many at a time as there are threads.
    fn try_all<Tick, Tried>(
        &self,
        points: &[Point],
        surface: &mut ErrorSurface,
        (tick, tried): (&Tick, &mut Tried),
    ) -> Result<ControlFlow<()>>
    where
        Tick: Fn() -> ControlFlow<()> + Sync,
        Tried: FnMut(&ErrorSurface, usize) -> Result<()>,
    {
        let mut seen: BTreeSet<Key> = surface.errors.keys().copied().collect();
        let new: Vec<Point> = points.iter().copied().filter(|point| seen.insert(key(point))).collect();
        let mut left = new.len();
        for some in new.chunks(rayon::current_num_threads()) {
            let errors: Vec<Result<Option<f64>>> = some.par_iter().map(|p| self.error(p, tick)).collect();
            let mut ended = Ok(ControlFlow::Continue(()));
            for (point, error) in some.iter().zip(errors) {
                match error {
                    Ok(Some(error)) => drop(surface.errors.insert(key(point), (*point, error))),
                    Ok(None) => ended = ended.map(|_| ControlFlow::Break(())),
                    Err(error) => ended = ended.and(Err(error)),
                }
            }
            left = left.saturating_sub(some.len());
            // The finished points are kept, whatever became of the others.
            tried(surface, left)?;
            if ended?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Fails if a sequence cannot be simulated on the grid at the lower or the upper ends of the ranges.
    fn check(&self) -> Result<()> {
        let ends = [0, 1].map(|end| physics(&self.ranges.map(|range| range[end])));
        let scenes = self.sequences.iter().flat_map(|sequence| ends.iter().map(move |end| (sequence, end)));
        for (sequence, physics) in scenes {
            sequence.scene(self.grid, physics)?.setup()?;
        }
        Ok(())
    }

    /// Returns the mean e_CD over the sequences, infinite if a simulation diverged or did not converge;
    /// `None` if `tick` ended the simulation.
    fn error(&self, point: &Point, tick: &(impl Fn() -> ControlFlow<()> + Sync)) -> Result<Option<f64>> {
        let settings = Settings { physics: physics(point), ..self.settings };
        let entry =
            Entry { name: "newton".into(), optimizer: Optimizer::newton(), iterations: 1, coarse: false };
        let mut sum = 0.0;
        for sequence in self.sequences {
            let Some((score, _)) = run((sequence, None), self.grid, &entry, (&Device::Cpu, &settings), tick)?
            else {
                return Ok(None);
            };
            // Without convergence the error is not the material's.
            let converged = score.unconverged == Some(0);
            sum += score.e_cd.filter(|_| converged).unwrap_or(f64::INFINITY);
        }
        Ok(Some(sum / self.sequences.len() as f64))
    }
}
