//! The triangles of bodies, in metres around each body's own origin, z up.

use fnopt::cloth::Shape;
use fnopt::glam::DVec3;
use fnopt::scene::{BodySettings, BodyShape, MeshSource, UpAxis};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Steps around a ball, and from its equator to a pole.
const AROUND: u32 = 32;
const UPWARDS: u32 = 8;

/// Positions with normals, as [`fnopt::sim::Vertices`] has them, and the triangles between them.
#[derive(Clone, Debug, Default)]
pub struct Triangles {
    pub vertices: Vec<[f32; 6]>,
    pub indices: Vec<u32>,
}

impl Triangles {
    fn push(&mut self, p: DVec3, normal: DVec3) {
        let [p, n] = [p, normal].map(|v| v.as_vec3().to_array());
        self.vertices.push([p[0], p[1], p[2], n[0], n[1], n[2]]);
    }

    /// Adds a flat polygon that bulges outwards everywhere.
    fn face(&mut self, corners: &[DVec3]) {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let first = self.vertices.len() as u32;
        corners.iter().for_each(|&p| self.push(p, normal));
        for k in 2..corners.len() as u32 {
            self.indices.extend([first, first + k - 1, first + k]);
        }
    }
}

/// Returns a ball that is cut at its equator and drawn out along the z axis to `half_length` either way.
pub fn capsule(radius: f64, half_length: f64) -> Triangles {
    let mut triangles = Triangles::default();
    for half in [-1.0, 1.0] {
        for ring in 0..=UPWARDS {
            // From the south pole to the equator, and from there to the north pole.
            let rise =
                FRAC_PI_2 * (f64::from(ring) / f64::from(UPWARDS) - if half < 0.0 { 1.0 } else { 0.0 });
            for step in 0..=AROUND {
                let turn = TAU * f64::from(step) / f64::from(AROUND);
                let normal = DVec3::new(rise.cos() * turn.cos(), rise.cos() * turn.sin(), rise.sin());
                triangles.push(radius * normal + half * half_length * DVec3::Z, normal);
            }
        }
    }
    let row = AROUND + 1;
    for ring in 0..2 * UPWARDS + 1 {
        for step in 0..AROUND {
            let p = ring * row + step;
            triangles.indices.extend([p, p + 1, p + row, p + 1, p + row + 1, p + row]);
        }
    }
    triangles
}

fn cuboid(half: DVec3) -> Triangles {
    let mut triangles = Triangles::default();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[a, b]| {
                let mut at = [0.0; 3];
                (at[axis], at[(axis + 1) % 3], at[(axis + 2) % 3]) = (side, side * a, b);
                half * DVec3::from(at)
            });
            triangles.face(&corners);
        }
    }
    triangles
}

/// Returns the part of a plane that is up to `radius` from the body's origin.
fn disc(radius: f64) -> Triangles {
    let mut triangles = Triangles::default();
    let corner = |k: u32| {
        let turn = 2.0 * PI * f64::from(k) / f64::from(AROUND);
        radius * DVec3::new(turn.cos(), turn.sin(), 0.0)
    };
    triangles.face(&(0..AROUND).map(corner).collect::<Vec<_>>());
    triangles
}

fn mesh(source: &MeshSource, unit_m: f64, up: UpAxis) -> Triangles {
    let mut triangles = Triangles::default();
    if let MeshSource::Mesh { vertices, faces } = source {
        let at = |v: u32| unit_m * DVec3::from(up.to_z_up(vertices[v as usize]));
        faces.iter().for_each(|face| triangles.face(&face.map(at)));
    }
    triangles
}

/// Returns the triangles of a body of a scene with this axis up; of a plane, those up to `radius` from its origin. `shape` is
/// the same in edges of `length_m`.
pub fn triangles(
    body: &BodySettings,
    shape: &Shape,
    (length_m, up, radius): (f64, UpAxis, f64),
) -> Triangles {
    match (shape, &body.shape) {
        (_, BodyShape::Mesh { source, unit_m, .. }) => mesh(source, *unit_m, up),
        (&Shape::Sphere { radius }, _) => capsule(length_m * radius, 0.0),
        (&Shape::Capsule { radius, half_length }, _) => capsule(length_m * radius, length_m * half_length),
        (&Shape::Box { half }, _) => cuboid(length_m * DVec3::from(half)),
        _ => disc(radius),
    }
}
