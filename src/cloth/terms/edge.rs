//! The stretch of an edge.

use glam::{DMat3, DVec3};

/// The stretch of an edge e, the vector between two neighbours at the trial \[edges\]: `c (|e| - 1)^2` (paper
/// section 3.2). The rest length is 1.
///
/// With damping t, `c t (|e| - |e0|)^2` is added, where e0 is the edge at the start of the frame. The force that this takes
/// along the edge, `2 c t` times the change of its length in a frame, is that of a spring with strain-rate damping,
/// t being its stiffness-proportional (Rayleigh) coefficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// The coefficient c: `k_stretch` over the number of edges of the same direction.
    pub factor: f64,
    /// The damping t \[frames\].
    pub damping: f64,
    /// The length of e0 \[edges\].
    pub before: f64,
}

impl Edge {
    /// Returns the energy.
    pub fn energy(self, e: DVec3) -> f64 {
        let l = e.length();
        self.factor * ((l - 1.0).powi(2) + self.damping * (l - self.before).powi(2))
    }

    /// Returns the derivative with respect to e, `2 c ((1 + t) |e| - r) e / |e|` with `r = 1 + t |e0|`. An edge of length zero
    /// has no direction: it is taken as 0.
    pub fn gradient(self, e: DVec3) -> DVec3 {
        match e.try_normalize() {
            Some(u) => 2.0 * self.factor * ((1.0 + self.damping) * e.length() - self.rest()) * u,
            None => DVec3::ZERO,
        }
    }

    /// Returns the second derivatives with respect to e: `2 c (1 + t)` along the edge and `2 c (1 + t - r / |e|)` across it,
    /// which is negative for a compressed edge. For an edge of length zero they are taken as 0.
    pub fn hessian(self, e: DVec3) -> DMat3 {
        let Some(u) = e.try_normalize() else { return DMat3::ZERO };
        let along = outer(u, u);
        let across = DMat3::IDENTITY - along;
        let total = 1.0 + self.damping;
        2.0 * self.factor * (total * along + (total - self.rest() / e.length()) * across)
    }

    /// Returns r.
    fn rest(self) -> f64 {
        1.0 + self.damping * self.before
    }
}

/// Returns the matrix `u w'`.
pub(super) fn outer(u: DVec3, w: DVec3) -> DMat3 {
    DMat3::from_cols(w.x * u, w.y * u, w.z * u)
}
