//! What a frame reports of each cloth.

/// The terms of the energy L of one cloth that a frame minimises, at its end (paper section 3.2, in grid units).
///
/// They are taken at the trial positions `x + v + a`, the handles where they are told to be; e are the edges between
/// neighbours there, m a particle's mass ([`Grid::mass`](super::Grid::mass)) and f the external force on it by its mass.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EnergyTerms {
    /// Stretch: `k_stretch` times the mean of `(|e| - 1)^2` over the vertical edges, and that over the horizontal ones.
    pub stretch: f64,
    /// Shear: `k_shear / (H W)` times the sum of `(angle - pi / 2)^2` over the four corners of each cell.
    pub shear: f64,
    /// Bend: `k_bend / (H W)` times the sum of `angle^2` over the pairs of edges in a line that share a particle.
    pub bend: f64,
    /// Inertia: `1 / (2 H W)` times the sum of `m |a|^2`.
    pub inertia: f64,
    /// External forces: `-1 / (H W)` times the sum of `m a.f`; negative when they do work.
    pub external: f64,
    /// Repulsion: `-k_repulsion / (H W)` times the sum of `log(d^2 + 1e-8)` over ordered pairs of particles that no edge of the
    /// triangulated grid joins, at a distance d below that of the [`Repulsion`](super::Repulsion); 0 without one.
    #[serde(default)]
    pub repulsion: f64,
}

impl EnergyTerms {
    /// From the terms in the order of the fields.
    pub(crate) fn from_array([stretch, shear, bend, inertia, external, repulsion]: [f64; 6]) -> Self {
        Self { stretch, shear, bend, inertia, external, repulsion }
    }

    /// The terms in the order of the fields.
    pub(crate) fn to_array(self) -> [f64; 6] {
        let Self { stretch, shear, bend, inertia, external, repulsion } = self;
        [stretch, shear, bend, inertia, external, repulsion]
    }

    /// The energy, the sum of all terms.
    pub fn total(&self) -> f64 {
        self.to_array().iter().sum()
    }

    /// The sum of the terms' magnitudes: external work may cancel the others.
    pub(crate) fn magnitude(&self) -> f64 {
        self.to_array().iter().map(|term| term.abs()).sum()
    }
}

/// Statistics of one cloth in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct FrameStats {
    /// Energy terms at the accepted acceleration.
    pub energy: EnergyTerms,
    /// Norm of dL/da over the whole cloth at a = 0, the first iteration.
    pub gradient_first: f64,
    /// Norm of dL/da at the last iteration, before its step.
    pub gradient_last: f64,
    /// Largest `|edge| - 1` (negative when every edge is compressed).
    pub stretch_largest: f64,
    /// Mean of `||edge| - 1|`.
    pub stretch_mean: f64,
}

impl FrameStats {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        // A term may be infinite of either sign, so the total alone would not tell.
        let others = [self.gradient_first, self.gradient_last, self.stretch_largest, self.stretch_mean];
        self.energy.to_array().iter().chain(&others).all(|v| v.is_finite())
    }
}

/// What the optimizer did in the iterations of one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Iterations {
    /// `|dL/da|` of each component of each cloth, shape [N, S] with S = 3 B.
    pub gradient_norms: Vec<f64>,
    /// Scale of the learned optimizer after each iteration, shape [N, S]; empty for the others.
    pub scales: Vec<f64>,
}
