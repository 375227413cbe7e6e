//! Settings and constants of the methods, which mean the same on every device. [`crate::kernels`] and [`crate::cpu`]
//! both take them from here.

/// Settings of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamSettings {
    /// Learning rate.
    pub rate: f64,
    /// Decay of the mean gradient.
    pub beta1: f64,
    /// Decay of the mean squared gradient.
    pub beta2: f64,
    /// Constant added to the denominator.
    pub epsilon: f64,
}

/// Settings of L-BFGS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LbfgsSettings {
    /// Number of curvature pairs kept, 1 to [`MAX_HISTORY`].
    pub history: usize,
    /// Threshold: a pair is kept if `y.s` exceeds it.
    pub curvature: f64,
}

/// Passes of a round that parts layers of a cloth at the end of a frame, after a search for those that its optimizer has left too
/// near to each other.
pub const PARTINGS: usize = 8;

/// Most rounds, each a search and [`PARTINGS`] passes, at the end of a frame.
pub const PARTING_ROUNDS: usize = 3;

/// Largest multiple of the last step at which its secant's minimum is sought: farther out the slopes at its ends say
/// little.
pub const LONGEST: f64 = 2.0;

/// Least factor by which the length of steps along secants changes from one to the next.
pub const SHORTEST: f64 = 0.1;

/// Longest history of L-BFGS that the kernel supports.
pub const MAX_HISTORY: usize = 32;

pub use crate::cloth::modes::{MAX_REACTIONS, SheetConstants, TENSION};

/// Numbers for each particle of a sheet: its three axes, a factor along those of the world, and the edges that begin there.
pub const AXES: usize = 16;

/// How much a curved sheet resists across its surface, as a share of what its stretch would add if nothing moved along it.
pub const ARCHING: f64 = 0.03;

/// What contacts take away from the step of a particle across the sheet and along it: with the sum r of what they resist
/// ([`Contact::resistance`](crate::cloth::terms::Contact::resistance)) for each unit of mass, the sheet's axes shorten by
/// `(1 + HOLDING r)^(-1/2)`. Ten iterations then leave a third of the gap of a sheet on a ball, and a quarter of that of one whose
/// layers press on each other (8 %; with 0.0003 and 0.003 it is 10 and 7 %). The factor along the axes of the world stays: with that shortened, too, particles
/// that meet in a frame are moved less than those around them, and layers passed through each other in the scene `twist` at 48x48.
pub const HOLDING: f64 = 1e-3;

/// What a handle takes away from the step of a particle near it: this share over one plus their distance. With this and [`ARCHING`],
/// and the inertia and bend of [`SheetConstants::FITTED`], five iterations leave little of the gap of ten scenes, from 24x40 to 64x64
/// particles, of six fabrics and the default sheet; an evolution strategy (CMA-ES) found them.
pub const HANDLE_SHARE: f64 = 0.5;

/// Rows and columns of particles within which a handle counts as near.
pub const HANDLE_REACH: usize = 2;

/// Share of the last frame's accelerations that a frame in a subspace starts at where they are rough.
///
/// What too few iterations leave undone of a mode is taken from the start, which is of frames before: the force comes late, and
/// what comes late drives instead of damping. Let the iterations leave a share r of a mode's error. From w times the accelerations
/// `a` of the last frame the force lags by `r w / (1 - r w)` frames, and backward Euler's damping makes up for one: w = 1/2 pumps no mode, w = 1
/// each that is left half undone (a sheet that hung from one corner was driven to 3 m/s within 600 frames). From `2 a` less
/// the accelerations before, as if they went on changing, there is no lag. Soft modes are then damped whatever is left undone of them; only where a frame
/// is long for a mode (stiffness over mass above 0.02) and a third is left, it rings. Those modes are short waves, so
/// the start is extrapolated where accelerations are smooth ([`SMOOTHING`]), and this share of them elsewhere.
pub const WARMEST: f64 = 0.5;

/// Weights of the mean that smooth accelerations are, along either axis, from the middle outwards: the binomial coefficients of four passes of
/// (1, 2, 1) / 4. Half of a wave of eight edges is left. Two passes leave bending in motion with ten iterations, eight leave
/// 1.4 times the gap.
pub const SMOOTHING: [f64; 5] = [70.0 / 256.0, 56.0 / 256.0, 28.0 / 256.0, 8.0 / 256.0, 1.0 / 256.0];

/// Iterations of a frame in a subspace in which a network proposes a step. Its direction is worth most far from the minimum, and little
/// since the others know the sheet as it is: proposing in none, 1, 2 and all of three iterations leaves 0.25, 0.26, 0.24 and 0.25 % of
/// the gap of `xy_v2` at 32x32 (0.22, 0.21, 0.21 and 0.22 % at 64x64), in none, 1, 2 and 5 of ten 0.0017, 0.0016, 0.0016
/// and 0.0015 %. Each of its steps costs as much as thirty iterations of the others on a CPU.
pub const LEARNED_ITERATIONS: usize = 2;

/// The norm by which training divides the cotangents of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Normalisation {
    /// Each component is divided by its own norm: every component of every cloth weighs the same (the
    /// authors' rule).
    #[default]
    Component,
    /// Each component is divided by the root mean square of the three norms of its cloth. Every cloth weighs
    /// the same, and a component in proportion to its share of the cloth's gradient.
    Cloth,
}

impl Normalisation {
    /// Returns the number of samples that share a norm.
    pub fn samples(self) -> usize {
        match self {
            Self::Component => 1,
            Self::Cloth => 3,
        }
    }
}

/// Bound on the magnitude of a normalised cotangent.
pub(crate) const CLAMP: f64 = 10.0;

/// Which direction of a Fourier transform carries the factor 1/(HW).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Norm {
    /// The forward transform, as in the operator.
    #[default]
    Forward,
    /// The inverse transform.
    Backward,
}
