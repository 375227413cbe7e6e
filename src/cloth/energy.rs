//! The energy that a frame minimises, term by term.

/// The terms of the energy L that a frame minimises, for one cloth at the end of the frame (paper section
/// 3.2, in grid units).
///
/// They are evaluated at the trial positions `x + v + a`, with the handles at their targets. In the formulas,
/// e is an edge between neighbours at these positions, m a particle's mass
/// ([`Grid::mass`](super::Grid::mass)) and f its external acceleration. The derivatives of the terms are in
/// [`terms`](super::terms).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EnergyTerms {
    /// Stretch: `k_stretch` times the sum of two means of `(|e| - 1)^2`: over the vertical and over the
    /// horizontal edges.
    pub stretch: f64,
    /// Shear: `k_shear / (H W)` times the sum of `(angle - pi / 2)^2` over the four corners of each cell.
    pub shear: f64,
    /// Bend: `k_bend / (H W)` times the sum of `angle^2` over the pairs of consecutive edges of the same
    /// direction.
    pub bend: f64,
    /// Inertia: `1 / (2 H W)` times the sum of `m |a|^2`.
    pub inertia: f64,
    /// External forces: `-1 / (H W)` times the sum of `m a.f`; negative if they do work.
    pub external: f64,
    /// Repulsion: `-k_repulsion / (H W)` times the sum of `log((d^2 + 1e-8) / (delta^2 + 1e-8))` over ordered
    /// pairs of particles that are not joined by an edge of the triangulated grid and whose distance d is below
    /// the distance delta of the [`Repulsion`](super::Repulsion); 0 without one.
    ///
    /// The paper's term is `log(d^2 + 1e-8)`. Both have the same gradient, but the paper's jumps where a pair
    /// comes into range, unless delta is 1: a step that brings particles there would seem to raise the energy.
    #[serde(default)]
    pub repulsion: f64,
    /// Contact with bodies: the sum of the energies of their barriers and friction
    /// ([`Contact`](super::terms::Contact)); 0 without bodies.
    #[serde(default)]
    pub contact: f64,
}

impl EnergyTerms {
    /// Builds the terms from an array in the order of the fields.
    pub(crate) fn from_array(
        [stretch, shear, bend, inertia, external, repulsion, contact]: [f64; 7],
    ) -> Self {
        Self { stretch, shear, bend, inertia, external, repulsion, contact }
    }

    /// Returns the terms in the order of the fields.
    pub(crate) fn to_array(self) -> [f64; 7] {
        let Self { stretch, shear, bend, inertia, external, repulsion, contact } = self;
        [stretch, shear, bend, inertia, external, repulsion, contact]
    }

    /// Returns the energy, the sum of all terms.
    pub fn total(&self) -> f64 {
        self.to_array().iter().sum()
    }

    /// Returns the sum of the terms' magnitudes, in which external work cannot cancel the other terms.
    pub(crate) fn magnitude(&self) -> f64 {
        self.to_array().iter().map(|term| term.abs()).sum()
    }
}
