//! Bodies as triangles.

use crate::cloth::{Pose, Shape};
use glam::{DQuat, DVec2, DVec3, Vec3, dvec3};
use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Segments of a round body along its equator, and rings of each of its halves.
const SEGMENTS: usize = 96;
const RINGS: usize = 24;
/// Segments of the edge of the part that is drawn of a plane.
const EDGE: usize = 64;
/// Samples of the distance of a mesh along its longest side.
const SAMPLES: usize = 72;
/// Lines on a plane per size of the cloth.
const LINES: f64 = 4.0;

/// A position and a normal.
pub(super) type Corner = [[f32; 3]; 2];

/// A triangle mesh in a body's own axes \[m\].
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Solid {
    pub corners: Vec<Corner>,
    pub faces: Vec<[u32; 3]>,
    /// Of a plane, the middle of the part that is drawn, its radius, and lines per metre.
    pub patch: Option<[f32; 4]>,
}

/// What the cloth needs around it: the part that is drawn of planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    /// Its middle \[m\].
    pub middle: Vec3,
    /// Its size \[m\].
    pub size: f32,
}

impl Solid {
    /// Returns the mesh of a shape in metres; `pose` is where it is at the start.
    pub fn new(shape: &Shape, pose: &Pose, room: Room) -> Self {
        match *shape {
            Shape::Plane => plane(pose, room),
            Shape::Sphere { radius } => round(radius, 0.0),
            Shape::Capsule { radius, half_length } => round(radius, half_length),
            Shape::Box { half } => cuboid(half.into()),
            Shape::Mesh { ref field, scale, .. } => {
                let bounds = field.bounds().map(|corner| scale * DVec3::from(corner));
                surface(bounds, |p| {
                    let nearest = shape.distance(p);
                    (nearest.distance, nearest.normal)
                })
            }
        }
    }
}

/// Returns the pose as the columns of a rotation, each with a component of the position.
pub(super) fn columns(pose: &Pose) -> [[f32; 4]; 3] {
    let turn = DQuat::from_array(pose.rotation);
    let columns = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turn * axis);
    std::array::from_fn(|k| columns[k].extend(pose.position[k]).as_vec4().to_array())
}

fn corner(place: DVec3, normal: DVec3) -> Corner {
    [place, normal].map(|v| v.as_vec3().to_array())
}

/// A ball, or a capsule along z.
fn round(radius: f64, half_length: f64) -> Solid {
    let rows = 2 * RINGS + 2;
    // Two rings share the equator, as far apart as the capsule is long.
    let point = |k: usize| {
        let (row, turn) = (k / (SEGMENTS + 1), k % (SEGMENTS + 1));
        let (sign, ring) = if row <= RINGS { (1.0, RINGS - row) } else { (-1.0, row - RINGS - 1) };
        let (rise, out) = (FRAC_PI_2 * ring as f64 / RINGS as f64).sin_cos();
        let (y, x) = (TAU * turn as f64 / SEGMENTS as f64).sin_cos();
        let normal = dvec3(out * x, out * y, sign * rise);
        corner(radius * normal + dvec3(0.0, 0.0, sign * half_length), normal)
    };
    let corners = (0..rows * (SEGMENTS + 1)).map(point).collect();
    let cell = |k: usize| {
        let a = (k / SEGMENTS * (SEGMENTS + 1) + k % SEGMENTS) as u32;
        let below = a + SEGMENTS as u32 + 1;
        [[a, below, a + 1], [a + 1, below, below + 1]]
    };
    Solid { corners, faces: (0..(rows - 1) * SEGMENTS).flat_map(cell).collect(), patch: None }
}

fn cuboid(half: DVec3) -> Solid {
    let mut solid = Solid::default();
    for (axis, sign) in (0..6).map(|k| (k / 2, if k % 2 == 0 { 1.0 } else { -1.0 })) {
        let mut normal = DVec3::ZERO;
        normal[axis] = sign;
        let (mut u, mut v) = (DVec3::ZERO, DVec3::ZERO);
        u[(axis + 1) % 3] = 1.0;
        v[(axis + 2) % 3] = sign;
        let first = solid.corners.len() as u32;
        let ends = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        solid.corners.extend(ends.map(|(a, b)| corner(half * (normal + a * u + b * v), normal)));
        solid.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    solid
}

/// A disc below the cloth.
fn plane(pose: &Pose, room: Room) -> Solid {
    let middle: DVec2 = pose.inward(room.middle.as_dvec3()).truncate();
    let radius = 1.6 * f64::from(room.size);
    let rim = |k: usize| {
        let (y, x) = (TAU * k as f64 / EDGE as f64).sin_cos();
        corner((middle + radius * DVec2::new(x, y)).extend(0.0), DVec3::Z)
    };
    let corners = std::iter::once(corner(middle.extend(0.0), DVec3::Z)).chain((0..EDGE).map(rim)).collect();
    let faces = (0..EDGE as u32).map(|k| [0, 1 + k, 1 + (k + 1) % EDGE as u32]).collect();
    let patch = [middle.x, middle.y, radius, LINES / f64::from(room.size)].map(|number| number as f32);
    Solid { corners, faces, patch: Some(patch) }
}

/// The surface on which a signed distance is 0: one corner in each cell of a grid that it passes through, drawn onto it, and a
/// square across each edge of the grid that it crosses. `nearest` returns the distance and its gradient.
fn surface([low, high]: [DVec3; 2], nearest: impl Fn(DVec3) -> (f64, DVec3)) -> Solid {
    let step = (high - low).max_element() / SAMPLES as f64;
    let origin = low - 1.5 * step;
    let size = ((high - low) / step).ceil().to_array().map(|cells| cells as usize + 4);
    let index = |[x, y, z]: [usize; 3]| (z * size[1] + y) * size[0] + x;
    let point = |at: [usize; 3]| origin + step * DVec3::from(at.map(|k| k as f64));
    let all = |size: [usize; 3]| {
        (0..size[2]).flat_map(move |z| (0..size[1]).flat_map(move |y| (0..size[0]).map(move |x| [x, y, z])))
    };
    let inside: Vec<bool> = all(size).map(|at| nearest(point(at)).0 < 0.0).collect();
    let (mut solid, mut cells) = (Solid::default(), HashMap::new());
    for at @ [x, y, z] in all(size.map(|n| n - 1)) {
        let corners = (0..8).filter(|k| inside[index([x + (k & 1), y + (k >> 1 & 1), z + (k >> 2)])]).count();
        if corners > 0 && corners < 8 {
            let mut place = point(at) + 0.5 * step;
            let mut normal = DVec3::Z;
            for _ in 0..3 {
                let (distance, away) = nearest(place);
                (place, normal) = (place - distance * away, away);
            }
            cells.insert(index(at), solid.corners.len() as u32);
            solid.corners.push(corner(place, normal));
        }
    }
    for at in all(size.map(|n| n - 1)) {
        for axis in 0..3 {
            let (mut end, from) = (at, inside[index(at)]);
            end[axis] += 1;
            if from == inside[index(end)] {
                continue;
            }
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let around = [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(a, b)| {
                let mut cell = at;
                (cell[u], cell[v]) = (cell[u].wrapping_sub(a), cell[v].wrapping_sub(b));
                cells.get(&index(cell)).copied()
            });
            let [Some(a), Some(b), Some(c), Some(d)] = around else { continue };
            let [b, d] = if from { [b, d] } else { [d, b] };
            solid.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    solid
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOM: Room = Room { middle: Vec3::ZERO, size: 1.0 };

    /// Every triangle lies on the surface, turns the way of its normals, and all together close it.
    fn check(shape: &Shape, solid: &Solid, volume: f64, within: f64) {
        let place = |k: u32| Vec3::from(solid.corners[k as usize][0]).as_dvec3();
        let mut sum = 0.0;
        for face in &solid.faces {
            let [a, b, c] = face.map(place);
            let across = (b - a).cross(c - a);
            sum += a.dot(across) / 6.0;
            let outward = Vec3::from(solid.corners[face[0] as usize][1]).as_dvec3();
            assert!(across.length() < 1e-9 || across.dot(outward) > 0.0, "{face:?} {across} {outward}");
        }
        for [place, _] in &solid.corners {
            assert!(shape.distance(Vec3::from(*place).as_dvec3()).distance.abs() < within, "{place:?}");
        }
        assert!((sum / volume - 1.0).abs() < 0.02, "{sum} of {volume}");
    }

    #[test]
    fn bodies_are_closed_and_lie_on_their_surfaces() {
        let pi = std::f64::consts::PI;
        let of = |shape: &Shape| Solid::new(shape, &Pose::default(), ROOM);
        let ball = Shape::Sphere { radius: 0.3 };
        check(&ball, &of(&ball), 4.0 / 3.0 * pi * 0.027, 1e-6);
        let capsule = Shape::Capsule { radius: 0.2, half_length: 0.5 };
        check(&capsule, &of(&capsule), 4.0 / 3.0 * pi * 0.008 + pi * 0.04, 1e-6);
        let cuboid = Shape::Box { half: [0.1, 0.2, 0.3] };
        check(&cuboid, &of(&cuboid), 8.0 * 0.006, 1e-6);
        let bounds = [DVec3::splat(-0.3), DVec3::splat(0.3)];
        let sampled = surface(bounds, |p| (ball.distance(p).distance, ball.distance(p).normal));
        check(&ball, &sampled, 4.0 / 3.0 * pi * 0.027, 1e-6);
    }
}
