//! Bodies that a cloth meets: their shapes, where they are, and how they move in a frame. Grid units throughout, z up.

use super::DistanceField;
use crate::{Error, Result};
use glam::{DQuat, DVec3};
use std::sync::Arc;

/// Most bodies that one cloth may meet.
pub const MAX_BODIES: usize = 32;
/// Most bodies that act on one particle in a frame: the nearest ones.
pub const MAX_CONTACTS: usize = 4;
/// Largest size or distance of a body \[edges\]: beyond it, single precision does not resolve a contact.
const FARTHEST: f64 = 1e6;

/// The shape of a body around its own origin, given by its signed distance.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Everything below the plane z = 0.
    Plane,
    /// A ball of this radius \[edges\].
    Sphere {
        /// Radius \[edges\].
        radius: f64,
    },
    /// All points nearer than the radius to a segment on the z axis, from -half_length to half_length.
    Capsule {
        /// Radius \[edges\].
        radius: f64,
        /// Half the length of the segment \[edges\].
        half_length: f64,
    },
    /// All points with |x|, |y|, |z| up to these \[edges\].
    Box {
        /// Half of each side \[edges\].
        half: [f64; 3],
    },
    /// A closed triangle mesh.
    Mesh {
        /// Its distances, in a unit of its own. Bodies that share it share its memory.
        field: Arc<DistanceField>,
        /// That unit \[edges\].
        scale: f64,
        /// How far inside of the mesh the surface is \[edges\]; 0 for the mesh itself.
        inset: f64,
    },
}

/// A point's distance to the surface of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// The distance \[edges\], negative inside.
    pub distance: f64,
    /// Its gradient, of length 1: away from the body.
    pub normal: DVec3,
}

impl Shape {
    /// Returns the signed distance of a point. Where several points of the surface are equally near, as at the centre of
    /// a ball, it takes one of them.
    pub fn distance(&self, p: DVec3) -> Distance {
        match *self {
            Self::Mesh { ref field, scale, inset } => {
                let Distance { distance, normal } = field.distance(p / scale);
                Distance { distance: scale * distance + inset, normal }
            }
            Self::Plane => Distance { distance: p.z, normal: DVec3::Z },
            Self::Sphere { radius } => around(p, radius),
            Self::Capsule { radius, half_length } => {
                around(p - DVec3::new(0.0, 0.0, p.z.clamp(-half_length, half_length)), radius)
            }
            Self::Box { half } => {
                let half = DVec3::from(half);
                let beyond = p.abs() - half;
                let outside = beyond.max(DVec3::ZERO);
                if outside != DVec3::ZERO {
                    let distance = outside.length();
                    return Distance { distance, normal: outside / distance * signs(p) };
                }
                let distance = beyond.max_element();
                // The face that is nearest.
                let axis = [DVec3::X, DVec3::Y, DVec3::Z]
                    .into_iter()
                    .find(|axis| beyond.dot(*axis) == distance)
                    .unwrap_or(DVec3::Z);
                Distance { distance, normal: axis * signs(p) }
            }
        }
    }

    /// Returns the radius of a ball around the origin that holds the shape \[edges\]; infinite for a plane.
    pub fn reach(&self) -> f64 {
        match *self {
            Self::Mesh { ref field, scale, .. } => scale * field.reach(),
            Self::Plane => f64::INFINITY,
            Self::Sphere { radius } => radius,
            Self::Capsule { radius, half_length } => radius + half_length,
            Self::Box { half } => DVec3::from(half).length(),
        }
    }

    /// Returns the name of the shape in a scene file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Plane => "plane",
            Self::Sphere { .. } => "sphere",
            Self::Capsule { .. } => "capsule",
            Self::Box { .. } => "box",
            Self::Mesh { .. } => "mesh",
        }
    }

    /// The numbers of the shape, as the kernels read them; those it has not are 0.
    pub(crate) fn sizes(&self) -> [f64; 3] {
        match *self {
            Self::Mesh { scale, inset, .. } => [scale, inset, self.reach()],
            Self::Plane => [0.0; 3],
            Self::Sphere { radius } => [radius, 0.0, 0.0],
            Self::Capsule { radius, half_length } => [radius, half_length, 0.0],
            Self::Box { half } => half,
        }
    }
}

/// Returns the distance from a ball around the origin.
fn around(p: DVec3, radius: f64) -> Distance {
    let length = p.length();
    Distance { distance: length - radius, normal: if length > 0.0 { p / length } else { DVec3::Z } }
}

/// Returns 1 or -1 for each component.
fn signs(p: DVec3) -> DVec3 {
    DVec3::select(p.cmplt(DVec3::ZERO), DVec3::NEG_ONE, DVec3::ONE)
}

/// Where a body is: a point of it at `p` in its own axes is at `rotation p + position`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Place of the body's origin \[edges\].
    pub position: [f64; 3],
    /// Rotation from the body's axes as a quaternion (x, y, z, w) of length 1.
    pub rotation: [f64; 4],
}

impl Default for Pose {
    /// At the origin, not rotated.
    fn default() -> Self {
        Self { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] }
    }
}

impl Pose {
    /// Returns the point of space at which the body has its point `p`.
    pub fn outward(&self, p: DVec3) -> DVec3 {
        self.turned(p) + DVec3::from(self.position)
    }

    /// Returns the body's own point that is at `p` in space.
    pub fn inward(&self, p: DVec3) -> DVec3 {
        DQuat::from_array(self.rotation).inverse() * (p - DVec3::from(self.position))
    }

    /// Returns a direction of the body in space.
    pub fn turned(&self, direction: DVec3) -> DVec3 {
        DQuat::from_array(self.rotation) * direction
    }

    fn is_valid(&self) -> bool {
        self.position.iter().all(|c| c.abs() <= FARTHEST)
            && (DQuat::from_array(self.rotation).length() - 1.0).abs() < 1e-6
    }
}

/// How a body moves in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sweep {
    /// Where it is at the start of the frame.
    pub from: Pose,
    /// Where it is at the end.
    pub to: Pose,
}

impl Sweep {
    /// Returns the sweep of a body that stays.
    pub fn still(at: Pose) -> Self {
        Self { from: at, to: at }
    }

    /// Fails unless both poses are finite, within a million edges, and rotated by quaternions of length 1. `field` names
    /// it in the error.
    pub(crate) fn check(&self, field: &str) -> Result<()> {
        for (end, pose) in [("from", self.from), ("to", self.to)] {
            if !pose.is_valid() {
                let expected = "a position within 1e6 edges and a quaternion of length 1";
                return Err(Error::invalid(
                    "control",
                    format!("{field}.{end}"),
                    expected,
                    format!("{pose:?}"),
                ));
            }
        }
        Ok(())
    }
}

/// A body that a cloth meets and that the cloth does not move.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Its shape.
    pub shape: Shape,
    /// Where it is unless a [`Control`](super::Control) says so.
    pub pose: Pose,
    /// Distance that the cloth's particles keep from its surface, the h of [`Contact`](super::terms::Contact) \[edges\].
    pub thickness: f64,
    /// Coulomb's coefficient of friction between the cloth and the body.
    pub friction: f64,
    /// Whether the cloth meets it; else it is as if it were not there, but keeps its place among the bodies.
    pub present: bool,
}

impl Body {
    /// Fails if a number is out of range; `origin` and `field` name the body in the error.
    pub(crate) fn check(&self, origin: &str, field: &str) -> Result<()> {
        let refused = |part: &str, expected: &str, found: String| {
            Err(Error::invalid(origin, format!("{field}.{part}"), expected, found))
        };
        let &Self { ref shape, pose, thickness, friction, .. } = self;
        let positive = match *shape {
            Shape::Mesh { ref field, scale, inset } => {
                scale > 0.0 && inset >= 0.0 && scale * field.reach() <= FARTHEST
            }
            Shape::Plane => true,
            Shape::Sphere { radius } => radius > 0.0,
            Shape::Capsule { radius, half_length } => radius > 0.0 && half_length >= 0.0,
            Shape::Box { half } => half.iter().all(|half| *half > 0.0),
        };
        if !(positive && shape.sizes().iter().all(|size| *size <= FARTHEST)) {
            return refused("shape", "sizes above 0 and up to 1e6 edges", format!("{shape:?}"));
        }
        if !pose.is_valid() {
            let expected = "a position within 1e6 edges and a quaternion of length 1";
            return refused("pose", expected, format!("{pose:?}"));
        }
        if !(1e-3..=10.0).contains(&thickness) {
            return refused("thickness", "0.001 to 10 edges", thickness.to_string());
        }
        if !(0.0..=100.0).contains(&friction) {
            return refused("friction", "0 to 100", friction.to_string());
        }
        Ok(())
    }
}

/// What the layers of a cloth did to each other in one frame, in grid units.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct LayerStats {
    /// Number of pairs of parts, a particle and a triangle or two edges, that were near enough to be watched.
    pub pairs: usize,
    /// Number of those that pressed on each other: they are nearer than the thickness.
    pub touching: usize,
    /// Least distance between two parts \[edges\], along the direction in which they are kept apart; infinite without
    /// pairs.
    pub nearest: f64,
    /// The most pairs for each particle that there is room for, if there were more: 128 on average on the CPU, 32 for any particle
    /// on a GPU, and 8 in the search at the end of a frame. Then none was kept; [`Simulator`](crate::Simulator) ends with an error.
    pub overflow: Option<usize>,
}

impl Default for LayerStats {
    fn default() -> Self {
        Self { pairs: 0, touching: 0, nearest: f64::INFINITY, overflow: None }
    }
}

/// What a body did to one cloth in one frame, in grid units.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct BodyStats {
    /// Number of particles on which it pressed.
    pub touching: usize,
    /// Largest depth of a particle below its surface \[edges\]; 0 if all are outside.
    pub deepest: f64,
    /// Sum of the forces of the cloth on it, barrier and friction: the derivative of the energy
    /// ([`Contact::gradient`](super::terms::Contact::gradient)), shape \[3\].
    pub load: [f64; 3],
    /// Work that friction took from the cloth.
    pub friction_work: f64,
}
