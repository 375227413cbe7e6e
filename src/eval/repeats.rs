//! Repeats of a simulation from nearly identical starts. If a solver stops short of convergence, a difference
//! as small as rounding can make a fold go another way, and then a single simulation says little about the
//! solver.

use super::{Score, mean_and_deviation};
use crate::scene::Setup;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Largest distance along each axis of a repeat's start from the recorded one \[edges\].
///
/// This is a few units in the last place of a position in f32 (2e-6 from 16 edges on), so that it survives
/// rounding. It strains no edge by more than 4e-5, and is a thousandth of the resolution of recorded
/// positions in half precision.
const NUDGE: f64 = 1e-5;

/// The perturbation of the recorded start for a repeat.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Nudge {
    /// Number of the repeat, from 1, which seeds the random numbers.
    pub repeat: u64,
    /// Largest displacement of a particle along each axis \[edges\].
    pub edges: f64,
}

impl Nudge {
    /// Returns the perturbation of a repeat; `None` for repeat 0, which begins at the recorded start.
    pub fn of(repeat: u64) -> Option<Self> {
        (repeat > 0).then_some(Self { repeat, edges: NUDGE })
    }

    /// Moves the particles of a start, except handles, each by a random amount: the same for the same repeat
    /// and grid.
    pub fn apply(&self, setup: &mut Setup) {
        let mut random = ChaCha8Rng::seed_from_u64(self.repeat);
        let particles = setup.model.grid.particles();
        let handles = &setup.model.cloths[0].handles;
        for (k, x) in setup.start.x.iter_mut().enumerate() {
            let moved = self.edges * (2.0 * random.random::<f64>() - 1.0);
            if !handles.contains(&(k % particles)) {
                *x += moved;
            }
        }
    }
}

/// Mean and standard deviation of figures over the repeats of a solver on a sequence and grid. A figure is
/// `None` if a repeat diverged or lacks it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OverRepeats {
    /// Number of repeats.
    pub repeats: usize,
    /// Chamfer distance [m^2].
    pub e_cd: Option<[f64; 2]>,
    /// Relative error of the vertices.
    pub e_3d: Option<[f64; 2]>,
    /// Time of a frame \[ms\].
    pub ms_per_frame: Option<[f64; 2]>,
    /// |dL/da| at the end of a frame (grid units).
    pub gradient: Option<[f64; 2]>,
    /// Largest `|edge| - 1` of the edges away from handles.
    pub stretch_largest: Option<[f64; 2]>,
}

impl OverRepeats {
    /// Returns the figures for the sequence, grid and solver of a score, all of whose repeats are in
    /// `scores`.
    pub fn of(score: &Score, scores: &[Score]) -> Self {
        let same = |other: &&Score| {
            (&other.sequence, &other.grid, other.column()) == (&score.sequence, &score.grid, score.column())
        };
        let repeats: Vec<&Score> = scores.iter().filter(same).collect();
        let both = |of: fn(&Score) -> Option<f64>| mean_over_repeats(&repeats, of).map(<[f64; 2]>::from);
        Self {
            repeats: repeats.len(),
            e_cd: both(|s| s.e_cd),
            e_3d: both(|s| s.e_3d),
            ms_per_frame: both(|s| s.ms_per_frame),
            gradient: both(|s| s.gradient),
            stretch_largest: both(|s| s.stretch_largest),
        }
    }
}

/// Returns the mean and standard deviation of a figure over the repeats of a solver on a sequence; `None` if
/// a repeat diverged or lacks the figure.
pub(super) fn mean_over_repeats(
    repeats: &[&Score],
    of: impl Fn(&Score) -> Option<f64>,
) -> Option<(f64, f64)> {
    let values: Option<Vec<f64>> = repeats.iter().map(|s| of(s).filter(|_| s.stable)).collect();
    values.filter(|values| !values.is_empty()).map(|values| mean_and_deviation(&values))
}
