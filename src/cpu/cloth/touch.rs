//! The vectorised form of [`terms::Contact`], in the precision of the cloth.

use super::vector::{add, dot, scaled, sub};
use crate::cloth::terms;
use crate::cpu::Real;
use glam::DVec3;

/// A [`terms::Contact`]. Of two parts of a cloth, the displacement y is that of one relative to the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch<T> {
    pub gradient: [T; 3],
    offset: T,
    drift: [T; 3],
    pub friction: T,
}

impl<T: Real> Touch<T> {
    pub fn new(contact: terms::Contact) -> Self {
        let single = |v: DVec3| v.to_array().map(T::of);
        Self {
            gradient: single(contact.gradient),
            offset: T::of(contact.offset),
            drift: single(contact.drift),
            friction: T::of(contact.friction),
        }
    }

    /// Returns z where it is positive, else 0.
    pub fn depth(&self, y: [T; 3]) -> T {
        (self.offset - dot(self.gradient, y)).max(T::zero())
    }

    /// Whether it presses or rubs.
    #[inline(always)]
    pub fn acts(&self, y: [T; 3]) -> bool {
        self.offset > dot(self.gradient, y) || self.friction > T::zero()
    }

    /// Returns the part of the relative displacement along the plane.
    pub fn slip(&self, y: [T; 3]) -> [T; 3] {
        let u = sub(y, self.drift);
        sub(u, scaled(self.gradient, dot(u, self.gradient) / dot(self.gradient, self.gradient)))
    }

    /// Returns how to take back the slip, from the displacement y, of parts that press on each other and stick; `None` where
    /// they do not.
    pub fn slip_back(&self, y: [T; 3]) -> Option<[T; 3]> {
        let slip = self.slip(y);
        let sticks = self.friction > T::zero()
            && self.depth(y) > T::zero()
            && dot(slip, slip).sqrt() < T::of(terms::Contact::STICKING);
        sticks.then(|| scaled(slip, -T::one()))
    }

    /// Returns the energy.
    pub fn energy(&self, y: [T; 3]) -> T {
        let depth = self.depth(y);
        let barrier = depth * depth * depth;
        if self.friction <= T::zero() {
            return barrier;
        }
        let (slip, half, sticking) = (self.slip(y), T::of(0.5), T::of(terms::Contact::STICKING));
        let slip = dot(slip, slip).sqrt();
        let slipping = if slip < sticking { half * slip * slip / sticking } else { slip - half * sticking };
        barrier + self.friction * slipping
    }

    /// Returns its derivative with respect to y.
    pub fn gradient(&self, y: [T; 3]) -> [T; 3] {
        let depth = self.depth(y);
        let barrier = scaled(self.gradient, -T::of(3.0) * depth * depth);
        if self.friction <= T::zero() {
            return barrier;
        }
        let slip = self.slip(y);
        let length = dot(slip, slip).sqrt().max(T::of(terms::Contact::STICKING));
        add(barrier, scaled(slip, self.friction / length))
    }

    /// Returns its second derivatives.
    pub fn curved(&self, y: [T; 3]) -> Curved<T> {
        let normal = scaled(self.gradient, dot(self.gradient, self.gradient).sqrt().recip());
        let mut curved = Curved {
            gradient: self.gradient,
            of_gradient: T::of(6.0) * self.depth(y),
            normal,
            slip: [T::zero(); 3],
            of_friction: T::zero(),
        };
        if self.friction > T::zero() {
            let slip = self.slip(y);
            let length = dot(slip, slip).sqrt();
            let sticking = T::of(terms::Contact::STICKING);
            curved.of_friction = self.friction / length.max(sticking);
            if length >= sticking {
                curved.slip = scaled(slip, length.recip());
            }
        }
        curved
    }

    /// Returns [`terms::Contact::resistance`].
    pub fn resistance(&self, y: [T; 3]) -> T {
        let slip = self.slip(y);
        let length = dot(slip, slip).sqrt().max(T::of(terms::Contact::STICKING));
        let barrier = T::of(6.0) * self.depth(y) * dot(self.gradient, self.gradient);
        barrier + self.friction / length
    }

    /// Returns the distance above the plane at the displacement y \[edges\].
    pub fn gap(&self, thickness: f64, y: [T; 3]) -> f64 {
        let z = self.offset - dot(self.gradient, y);
        thickness - (z / dot(self.gradient, self.gradient).sqrt()).f64()
    }

    /// Returns how to leave, from the displacement y, what is nearer than [`terms::Contact::LEAST_GAP`] of the thickness;
    /// `None` where it is not.
    pub fn way_out(&self, thickness: f64, y: [T; 3]) -> Option<[T; 3]> {
        let squared = dot(self.gradient, self.gradient);
        let deepest = squared.sqrt() * T::of((1.0 - terms::Contact::LEAST_GAP) * thickness);
        let excess = self.offset - dot(self.gradient, y) - deepest;
        (excess > T::zero()).then(|| scaled(self.gradient, excess / squared))
    }
}

/// The second derivatives of a contact: `of_gradient q q' + of_friction (1 - n n' - w w')`.
pub(super) struct Curved<T> {
    gradient: [T; 3],
    of_gradient: T,
    normal: [T; 3],
    /// Direction of a slip; zero where the particle sticks.
    slip: [T; 3],
    of_friction: T,
}

impl<T: Real> Curved<T> {
    /// Returns their product with a vector.
    pub fn times(&self, p: [T; 3]) -> [T; 3] {
        let across = sub(p, scaled(self.normal, dot(self.normal, p)));
        let across = sub(across, scaled(self.slip, dot(self.slip, p)));
        add(scaled(self.gradient, self.of_gradient * dot(self.gradient, p)), scaled(across, self.of_friction))
    }

    /// Returns them as a symmetric matrix.
    pub fn block(&self) -> [[T; 3]; 3] {
        [0, 1, 2].map(|column| {
            let mut unit = [T::zero(); 3];
            unit[column] = T::one();
            self.times(unit)
        })
    }
}
