//! Repeats of a simulation from starts that are all but the same. Where a solver stops short of convergence, a fold may go
//! another way after a difference as small as rounding, and then one simulation tells little of the solver.

use super::{Score, mean_and_deviation};
use crate::scene::Setup;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// How far the start of a repeat is from the recorded one, at most, along each axis \[edges\].
///
/// This is a few units in the last place of a position in f32 (2e-6 from 16 edges on), so that rounding leaves another start.
/// It strains no edge by more than 4e-5, and is a thousandth of what recorded positions are told to in half precision.
const NUDGE: f64 = 1e-5;

/// What makes the start of a repeat another than the recorded one.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Nudge {
    /// Number of the repeat, from 1; it seeds the random numbers.
    pub repeat: u64,
    /// How far a particle is moved along each axis, at most \[edges\].
    pub edges: f64,
}

impl Nudge {
    /// That of a repeat; none of repeat 0, which begins at the recorded start.
    pub fn of(repeat: u64) -> Option<Self> {
        (repeat > 0).then_some(Self { repeat, edges: NUDGE })
    }

    /// Moves the particles of a start that are no handles, each by a random amount: the same for the same repeat and grid.
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

/// Means over the repeats of a solver on a sequence and grid, each with the deviation; none where one of them has no number.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OverRepeats {
    /// How many there are.
    pub repeats: usize,
    /// Chamfer distance [m^2].
    pub e_cd: Option<[f64; 2]>,
    /// Relative error of the vertices.
    pub e_3d: Option<[f64; 2]>,
    /// Time of a frame \[ms\].
    pub ms_per_frame: Option<[f64; 2]>,
    /// |dL/da| at the last iteration (grid units).
    pub gradient: Option<[f64; 2]>,
    /// Largest `|edge| - 1` of the edges away from handles.
    pub stretch_largest: Option<[f64; 2]>,
}

impl OverRepeats {
    /// Those of a score's sequence, grid and solver, all of whose repeats are in `scores`.
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

/// Mean and deviation of a figure of the repeats of a solver on a sequence; none when one of them diverged or has no such figure.
pub(super) fn mean_over_repeats(
    repeats: &[&Score],
    of: impl Fn(&Score) -> Option<f64>,
) -> Option<(f64, f64)> {
    let values: Option<Vec<f64>> = repeats.iter().map(|s| of(s).filter(|_| s.stable)).collect();
    values.filter(|values| !values.is_empty()).map(|values| mean_and_deviation(&values))
}
