//! The stretch of an edge.

use glam::{DMat3, DVec3};

/// The stretch of an edge e, the vector between two neighbours at the trial \[edges\]: `c (|e| - 1)^2` (paper
/// section 3.2). The rest length is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// The coefficient c: `k_stretch` over the number of edges of the same direction.
    pub factor: f64,
}

impl Edge {
    /// Returns the energy.
    pub fn energy(self, e: DVec3) -> f64 {
        self.factor * (e.length() - 1.0).powi(2)
    }

    /// Returns the derivative with respect to e, `2 c (|e| - 1) e / |e|`. An edge of length zero has no direction: it is
    /// taken as 0.
    pub fn gradient(self, e: DVec3) -> DVec3 {
        match e.try_normalize() {
            Some(u) => 2.0 * self.factor * (e.length() - 1.0) * u,
            None => DVec3::ZERO,
        }
    }

    /// Returns the second derivatives with respect to e: `2 c` along the edge and `2 c (1 - 1 / |e|)` across it, which
    /// is negative for a compressed edge. For an edge of length zero they are taken as 0.
    pub fn hessian(self, e: DVec3) -> DMat3 {
        let Some(u) = e.try_normalize() else { return DMat3::ZERO };
        let along = outer(u, u);
        let across = DMat3::IDENTITY - along;
        2.0 * self.factor * (along + (1.0 - 1.0 / e.length()) * across)
    }
}

/// Returns the matrix `u w'`.
pub(super) fn outer(u: DVec3, w: DVec3) -> DMat3 {
    DMat3::from_cols(w.x * u, w.y * u, w.z * u)
}
