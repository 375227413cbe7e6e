//! The contact of a particle with a body.

use glam::{DMat3, DVec3};

/// What a body adds for one particle, as a function of the particle's displacement y in the frame \[edges\].
///
/// The body is a plane for the frame: the particle is `g = n . y + g_0` above it. Nearer than the thickness h, a cubic
/// barrier `psi = 2 k / (3 h) (h - g)^3` pushes it away: it is smooth where it begins, finite at g = 0 and convex (the form
/// is that of ZOZO's contact solver). With `s = (2 k / (3 h))^(1/3)` it is the cube of `z = offset - gradient . y`, where
/// `gradient = s n` and `offset = s (h - g_0)`.
///
/// Friction acts on the displacement u along the plane relative to the body's, with the load P that the contact had
/// at the start of the frame (lagged Coulomb friction): `mu P |u|`, rounded off below [`Contact::STICKING`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// s n.
    pub gradient: DVec3,
    /// s (h - g_0).
    pub offset: f64,
    /// Displacement of the body's point in the frame \[edges\].
    pub drift: DVec3,
    /// mu P, the largest force of friction.
    pub friction: f64,
}

impl Contact {
    /// Displacement relative to the body, along it, below which friction counts as sticking \[edges / frame\].
    pub const STICKING: f64 = 1e-3;
    /// Share of the thickness that is left at least: a particle nearer than that is moved away.
    pub const LEAST_GAP: f64 = 0.05;
    /// Share of the thickness at which a gap counts in the stiffness at least.
    pub const STIFFEST: f64 = 0.1;
    /// Most steps of the search along a particle's way to a body.
    pub const STEPS: usize = 64;
    /// The least share of the way that such a step advances.
    pub const LEAST_ADVANCE: f64 = 1.0 / 48.0;

    /// Returns the stiffness k of a contact: the particle's own, `elastic = n . D n` with its block D of the
    /// elastic Hessian, and that of its mass over the gap, which is at least a tenth of the thickness and at
    /// most all of it.
    pub fn stiffness(elastic: f64, mass: f64, gap: f64, thickness: f64) -> f64 {
        let gap = gap.clamp(Self::STIFFEST * thickness, thickness);
        elastic + mass / (gap * gap)
    }

    /// Returns the force of the barrier at a gap, `2 k / h (h - g)^2`.
    pub fn load_at(stiffness: f64, gap: f64, thickness: f64) -> f64 {
        let depth = (thickness - gap).max(0.0);
        2.0 * stiffness / thickness * depth * depth
    }

    /// Returns the contact whose plane has the normal `n` and is `gap` away at y = 0.
    pub fn new(n: DVec3, gap: f64, stiffness: f64, thickness: f64) -> Self {
        let s = (2.0 * stiffness / (3.0 * thickness)).cbrt();
        Self { gradient: s * n, offset: s * (thickness - gap), drift: DVec3::ZERO, friction: 0.0 }
    }

    /// Returns z where it is positive, else 0: there is no contact.
    fn depth(self, y: DVec3) -> f64 {
        (self.offset - self.gradient.dot(y)).max(0.0)
    }

    /// Returns the part of the displacement relative to the body that is along the plane.
    fn slip(self, y: DVec3) -> DVec3 {
        (y - self.drift).reject_from(self.gradient)
    }

    /// Returns the energy of the barrier and of the friction.
    pub fn energies(self, y: DVec3) -> [f64; 2] {
        let slip = self.slip(y).length();
        let slipping = match slip < Self::STICKING {
            true => 0.5 * slip * slip / Self::STICKING,
            false => slip - 0.5 * Self::STICKING,
        };
        [self.depth(y).powi(3), self.friction * slipping]
    }

    /// Returns the derivative of both with respect to y.
    pub fn gradient(self, y: DVec3) -> DVec3 {
        let z = self.depth(y);
        let slip = self.slip(y);
        -3.0 * z * z * self.gradient + self.friction / slip.length().max(Self::STICKING) * slip
    }

    /// Returns about how much both resist displacements: their second derivative across the plane and one of those along it.
    pub fn resistance(self, y: DVec3) -> f64 {
        let barrier = 6.0 * self.depth(y) * self.gradient.length_squared();
        barrier + self.friction / self.slip(y).length().max(Self::STICKING)
    }

    /// Returns their second derivatives with respect to y.
    pub fn hessian(self, y: DVec3) -> DMat3 {
        let outer = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
        let slip = self.slip(y);
        let along = DMat3::IDENTITY - outer(self.gradient.normalize());
        let length = slip.length();
        let of_friction = match length < Self::STICKING {
            true => along * (self.friction / Self::STICKING),
            false => (along - outer(slip / length)) * (self.friction / length),
        };
        outer(self.gradient) * (6.0 * self.depth(y)) + of_friction
    }
}
