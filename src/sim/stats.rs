//! Statistics that a frame reports for each cloth.

use crate::cloth::{BodyStats, EnergyTerms, LayerStats};

/// Statistics of one cloth in one frame, in grid units. Stretch is over all edges, including those at handles,
/// which rightly stretch more ([`FreeEdges`](crate::eval::FreeEdges) leaves them out).
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct FrameStats {
    /// Energy terms at the accepted acceleration.
    pub energy: EnergyTerms,
    /// Norm of dL/da over the whole cloth at a = 0, before or in the first iteration.
    pub gradient_first: f64,
    /// Norm of dL/da in the last iteration, before its step; at the minimum for
    /// [`Optimizer::newton`](super::Optimizer::newton).
    pub gradient_last: f64,
    /// Largest `|edge| - 1`; negative if every edge is compressed.
    pub stretch_largest: f64,
    /// Mean of `||edge| - 1|`.
    pub stretch_mean: f64,
    /// Whether Newton's method reached its tolerance; `None` for optimizers that end after a number of iterations.
    pub converged: Option<bool>,
    /// What became of the steps.
    pub steps: StepCounts,
    /// What each body did, in the order of the cloth's bodies.
    #[serde(skip)]
    pub bodies: Vec<BodyStats>,
    /// What the layers did to each other; `None` for a cloth that passes through itself.
    #[serde(skip)]
    pub layers: Option<LayerStats>,
}

/// What became of the steps of one cloth in one frame, where they are checked
/// ([`Length::Subspace`](super::Length::Subspace)); zeros elsewhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[non_exhaustive]
pub struct StepCounts {
    /// Steps that raised the energy, and were shortened or taken back.
    pub shortened: usize,
    /// Directions that were not finite, and were left out.
    pub dropped: usize,
}

impl FrameStats {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let others = [self.gradient_first, self.gradient_last, self.stretch_largest, self.stretch_mean];
        self.energy.to_array().iter().chain(&others).all(|v| v.is_finite())
    }
}

/// A log of the optimizer's iterations in one frame.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct IterationLog {
    /// `|dL/da|` of each sample, shape [N, S] with S = 3 B. Newton's method has two rows: at the start and at
    /// the minimum.
    pub gradient_norms: Vec<f64>,
    /// Scale of the network's steps after each iteration in which it proposes one, shape [N or less, S]; empty for
    /// other optimizers.
    pub scales: Vec<f64>,
}
