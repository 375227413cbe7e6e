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

/// Passes that part layers of a cloth at the end of a frame, after a search for those that its optimizer has left too near to
/// each other, and most such rounds.
pub const PARTINGS: usize = 8;
/// See [`PARTINGS`].
pub const PARTING_ROUNDS: usize = 3;

/// Largest multiple of the last step at which its secant's minimum is sought: farther out the slopes at its ends say
/// little.
pub const LONGEST: f64 = 2.0;

/// Least factor by which the length of steps along secants changes from one to the next.
pub const SHORTEST: f64 = 0.1;

/// Longest history of L-BFGS that the kernel supports.
pub const MAX_HISTORY: usize = 32;

/// Share of the tangential stiffness that a mode of the sheet has along its other axis, and across its surface: a
/// sheet under tension resists there, too. The median gap that ten iterations leave on `xy_v2` is 0.57 % at 32x32, and
/// with a tension of 0.001 0.68 %; over the first 150 frames at 64x64 with the moduli of the default sheet it is 0.78 and
/// 1.14 %. A smaller
/// tension gains on such soft sheets alone.
pub const TENSION: f64 = 3e-4;

/// Largest multiple of the last frame's acceleration that a frame in a subspace starts at. With 1, what ten
/// iterations leave undone in soft modes adds up: a sheet that hangs from one corner is then driven to 3 m/s within
/// 600 frames.
pub const WARMEST: f64 = 0.5;

/// Iterations of a frame in a subspace in which a network proposes a step. Its direction is worth most far from the
/// minimum: with it, five iterations leave 1.9 % of the gap of `xy_v2` at 32x32 where three directions leave 3.1 %.
/// Later it disturbs the conjugacy of the others: proposing in all ten iterations left 1.1 %, in the first five 0.4 %.
pub const LEARNED_ITERATIONS: usize = 5;

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
