//! The shear and the bend of an angle between two edges.

use super::edge::outer;
use glam::{DMat3, DVec3};

/// The energy of the angle t between two edges u and w at the trial \[edges\], `c (t - rest)^2` with
/// `t = atan2(|u x w|, u . w)` (paper section 3.2): the shear of the corner of a cell, or the bend between two
/// consecutive edges. Unlike the arc cosine, this form of the angle is accurate for the small bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angle {
    /// The coefficient c: `k_shear` or `k_bend` over the number of particles.
    pub factor: f64,
    /// The angle at rest: pi / 2 for shear, 0 for bend.
    pub rest: f64,
}

impl Angle {
    /// Sine below which [`Angle::hessian`] takes edges as parallel: the cross product of two unit vectors no longer
    /// tells their normal.
    pub const PARALLEL: f64 = 1e-9;

    /// Returns the same with a coefficient that is a multiple of this one.
    pub(super) fn times(self, factor: f64) -> Self {
        Self { factor: factor * self.factor, ..self }
    }

    /// Returns the energy. With an edge of length zero, the angle is 0.
    pub fn energy(self, u: DVec3, w: DVec3) -> f64 {
        self.factor * (angle(u, w) - self.rest).powi(2)
    }

    /// Returns the derivatives with respect to u and to w.
    ///
    /// With `c = u x w` they are `2 c (t - rest) / |c|` times `u x c / |u|^2` and `c x w / |w|^2`. Exactly parallel edges
    /// have no normal, and the derivatives are taken as 0; so are those with an edge of length zero.
    pub fn gradient(self, u: DVec3, w: DVec3) -> [DVec3; 2] {
        let c = u.cross(w);
        if c.length() == 0.0 {
            return [DVec3::ZERO; 2];
        }
        let slope = 2.0 * self.factor * (angle(u, w) - self.rest) / c.length();
        [slope * u.cross(c) / u.length_squared(), slope * c.cross(w) / w.length_squared()]
    }

    /// Returns the second derivatives with respect to (u, w), rows, and (u, w), columns. They are taken as 0 if an edge
    /// has length zero.
    ///
    /// With the unit normal n of the plane of the edges, the unit vectors m_u across u towards w and m_w across w
    /// towards u, and u and w divided by their lengths, the derivatives of the angle are
    ///
    /// ```text
    /// dt/du     = -m_u / |u|
    /// d2t/du2   = (cot t nn' + m_u u' + u m_u') / |u|^2
    /// d2t/du dw = -nn' / (|u| |w| sin t)
    /// ```
    ///
    /// and those of the energy `2 c (t_i t_j + (t - rest) t_ij)`. Near parallel edges ([`Angle::PARALLEL`]),
    /// `(t - rest) / sin t` is replaced by its limit, which is 1 if the edges are parallel and rest is 0. Otherwise there
    /// is none; it is taken as 0, and the normal as an arbitrary one across u.
    pub fn hessian(self, u: DVec3, w: DVec3) -> [[DMat3; 2]; 2] {
        let (Some(unit_u), Some(unit_w)) = (u.try_normalize(), w.try_normalize()) else {
            return [[DMat3::ZERO; 2]; 2];
        };
        let excess = angle(u, w) - self.rest;
        let (c, cosine) = (unit_u.cross(unit_w), unit_u.dot(unit_w));
        let (n, over_sine) = match c.length() {
            sine if sine > Self::PARALLEL => (c / sine, excess / sine),
            _ => (any_normal(unit_u), if cosine > 0.0 { self.parallel() } else { 0.0 }),
        };
        let (m_u, m_w) = (n.cross(unit_u), unit_w.cross(n));
        let twice = |m: DVec3, e: DVec3| {
            let turned = over_sine * cosine * outer(n, n) + excess * (outer(m, e) + outer(e, m));
            2.0 * self.factor * (outer(m, m) + turned)
        };
        let mixed =
            2.0 * self.factor * (outer(m_u, m_w) - over_sine * outer(n, n)) / (u.length() * w.length());
        [
            [twice(m_u, unit_u) / u.length_squared(), mixed],
            [mixed.transpose(), twice(m_w, unit_w) / w.length_squared()],
        ]
    }

    /// Returns the limit of `(t - rest) / sin t` for parallel edges, or 0 if there is none.
    pub fn parallel(self) -> f64 {
        if self.rest == 0.0 { 1.0 } else { 0.0 }
    }
}

/// Returns the angle between two edges in 0..=pi; 0 if one has length zero.
fn angle(u: DVec3, w: DVec3) -> f64 {
    // Adding 0 turns a cosine of -0, whose angle would be pi, into 0.
    u.cross(w).length().atan2(u.dot(w) + 0.0)
}

/// Returns a unit vector orthogonal to the unit vector `u`.
fn any_normal(u: DVec3) -> DVec3 {
    let normal = if u.x * u.x > 0.5 { DVec3::new(-u.z, 0.0, u.x) } else { DVec3::new(0.0, u.z, -u.y) };
    normal.normalize()
}
