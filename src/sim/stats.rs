//! What a frame reports of each cloth.

/// Energy terms of one cloth at the end of a frame, weighted as in the energy (specification section 3).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EnergyTerms {
    /// Stretch.
    pub stretch: f64,
    /// Shear.
    pub shear: f64,
    /// Bend.
    pub bend: f64,
    /// Inertia.
    pub inertia: f64,
    /// External forces; negative when they do work.
    pub external: f64,
}

impl EnergyTerms {
    /// The energy, the sum of all terms.
    pub fn total(&self) -> f64 {
        self.stretch + self.shear + self.bend + self.inertia + self.external
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
        let e = &self.energy;
        [e.stretch, e.shear, e.bend, e.inertia, e.external, self.gradient_first, self.gradient_last]
            .iter()
            .chain([&self.stretch_largest, &self.stretch_mean])
            .all(|v| v.is_finite())
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
