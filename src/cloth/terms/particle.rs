//! The inertia and the external work of a particle.

use glam::{DMat3, DVec3};

/// What a particle adds by itself, as a function of its acceleration a [edges / frame^2] (paper section 3.2): the
/// inertia `m |a|^2 / 2` and the external work `-m a . f`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Particle {
    /// The weight m: the particle's mass ([`Mark::mass`](crate::cloth::Mark::mass)) over the number of particles.
    pub mass: f64,
    /// The external acceleration f [edges / frame^2].
    pub external: DVec3,
}

impl Particle {
    /// Returns the inertia.
    pub fn inertia(self, a: DVec3) -> f64 {
        0.5 * self.mass * a.length_squared()
    }

    /// Returns the external work, negative if the external forces do work.
    pub fn work(self, a: DVec3) -> f64 {
        -self.mass * a.dot(self.external)
    }

    /// Returns the derivative with respect to a, `m (a - f)`.
    pub fn gradient(self, a: DVec3) -> DVec3 {
        self.mass * (a - self.external)
    }

    /// Returns the second derivatives with respect to a: m along each axis.
    pub fn hessian(self) -> DMat3 {
        DMat3::from_diagonal(DVec3::splat(self.mass))
    }
}
