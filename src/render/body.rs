//! The bodies that a cloth meets, as they are drawn: the surface that a ray from the eye meets first. Rays need no
//! facets, which would show through a cloth that lies a few millimetres above them.

use super::camera::{Camera, Unit};
use crate::cloth::{Body, Pose, Shape, VertexView};
use glam::{DMat3, DQuat, DVec2, DVec3, Vec2, Vec3};

/// The bodies that a cloth meets and where they are in each frame, for pictures.
///
/// A plane is drawn as a patch of floor around the cloth that fades at its edge. Planes do not affect where a picture
/// is taken from, except that a wall or a slope is seen from its outer side if the view leaves that open. Other bodies
/// are seen whole while they are near the cloth. Bodies are drawn slightly smaller than they are, by half their
/// [thickness](Body::thickness), because the flat triangles of a cloth dip below its particles.
///
/// ```
/// use fnopt::render::{Bodies, StripOptions, strip};
/// use fnopt::scene::Scene;
///
/// let setup = Scene::default().setup()?;
/// let cloth = &setup.model.cloths[0];
/// let bodies = Bodies::new(&cloth.bodies, &setup.poses, &setup.vertex_view());
/// let options = StripOptions { height: 40, bodies: &bodies, ..StripOptions::default() };
/// strip(&setup.trajectory()?, &cloth.handles, &options);
/// # Ok::<(), fnopt::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bodies {
    all: Vec<Path>,
}

/// A body and its poses in the axes of the trajectory, all lengths in metres.
#[derive(Clone, Debug, PartialEq)]
struct Path {
    shape: Shape,
    poses: Vec<Pose>,
    /// Frames from which on it is there or is not, in order.
    presence: Vec<(usize, bool)>,
}

/// No bodies.
pub(super) static NONE: Bodies = Bodies { all: Vec::new() };

/// Share of a body's size that is drawn at least.
const LEAST_PART: f64 = 0.5;

impl Bodies {
    /// Returns bodies \[edges\] with their poses in each frame, of which the last one holds for all later frames, shape
    /// `[bodies][frames]`. A body without poses stays where it is. `view` leads to the positions \[m\] of the trajectory
    /// that is drawn; it may turn, scale and move, but neither stretch nor mirror.
    pub fn new(bodies: &[Body], poses: &[Vec<Pose>], view: &VertexView) -> Self {
        let row = view.transform.map(|row| row.map(f64::from));
        let column = |c: usize| DVec3::new(row[0][c], row[1][c], row[2][c]);
        let scale = column(0).length();
        let turn =
            DQuat::from_mat3(&DMat3::from_cols(column(0), column(1), column(2)).mul_scalar(1.0 / scale))
                .normalize();
        let convert = |pose: &Pose| Pose {
            position: (scale * (turn * DVec3::from(pose.position)) + column(3)).to_array(),
            rotation: (turn * DQuat::from_array(pose.rotation)).to_array(),
        };
        let path = |(k, body): (usize, &Body)| {
            let given = poses.get(k).filter(|poses| !poses.is_empty());
            let poses = given.map_or(std::slice::from_ref(&body.pose), Vec::as_slice);
            let (shape, lowered) = smaller(body.shape.clone(), 0.5 * body.thickness);
            let lower =
                |pose: Pose| Pose { position: pose.outward(DVec3::NEG_Z * lowered).to_array(), ..pose };
            Path {
                shape: scaled(shape, scale),
                poses: poses.iter().map(|pose| convert(&lower(*pose))).collect(),
                presence: vec![(0, body.present)],
            }
        };
        Self { all: bodies.iter().enumerate().map(path).collect() }
    }

    /// Shows and hides bodies, given as at the start, according to those that a scene has from `frame` on. Frames are given
    /// in order.
    pub fn change(&mut self, frame: usize, bodies: &[Body]) {
        for (path, body) in self.all.iter_mut().zip(bodies) {
            path.presence.push((frame, body.present));
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Number of frames after which no body moves.
    fn frames(&self) -> usize {
        let of_path = |path: &Path| path.poses.len().max(path.presence.last().map_or(0, |last| last.0 + 1));
        self.all.iter().map(of_path).max().unwrap_or(0)
    }

    /// Returns number, shape and pose of each body in a frame, in metres and the axes of the trajectory.
    pub(crate) fn there(&self, frame: usize) -> impl Iterator<Item = (usize, &Shape, &Pose)> {
        let is_there =
            move |path: &Path| path.presence.iter().rfind(|from| from.0 <= frame).is_some_and(|from| from.1);
        let all = self.all.iter().enumerate().filter(move |(_, path)| is_there(path));
        all.map(move |(k, path)| (k, &path.shape, &path.poses[frame.min(path.poses.len() - 1)]))
    }

    /// Returns the bodies in a frame, in the unit of a picture.
    fn at<'a>(&'a self, frame: usize, unit: &'a Unit) -> impl Iterator<Item = (Shape, DVec3, DQuat)> + 'a {
        self.there(frame).map(move |(_, shape, pose)| {
            let place = unit.place(pose.position.into());
            (scaled(shape.clone(), 1.0 / unit.size()), place, DQuat::from_array(pose.rotation))
        })
    }

    /// Returns points on the outlines of the bodies that are inside the `room` in any of `frames` frames, but not more
    /// than about `most`.
    pub(super) fn outlines(&self, frames: usize, unit: &Unit, room: &Room, most: usize) -> Vec<Vec3> {
        let frames = self.frames().min(frames.max(1));
        let stride = (frames * self.all.len() * OUTLINE / most.max(1)).max(1);
        (0..frames)
            .step_by(stride)
            .flat_map(move |frame| self.at(frame, unit))
            .map(|(shape, place, rotation)| outline(&shape, place, rotation))
            .filter(|outline| !outline.is_empty() && outline.iter().all(|p| room.holds(*p)))
            .flatten()
            .collect()
    }

    /// Returns the bodies in a frame as a camera sees them. A body that holds the eye is left out, because it would
    /// hide everything.
    pub(super) fn seen(&self, frame: usize, unit: &Unit, camera: &Camera, room: &Room) -> Vec<Solid> {
        let turn = DQuat::from_mat3(&camera.rotation.as_dmat3());
        let solid = |(shape, place, rotation): (Shape, DVec3, DQuat)| {
            let outline = outline(&shape, place, rotation);
            let inward = DMat3::from_quat((turn * rotation).inverse());
            let own = rotation.inverse() * (room.middle.as_dvec3() - place);
            Solid {
                shape,
                normal: (rotation * DVec3::Z).as_vec3(),
                place: place.as_vec3(),
                at: turn * place - camera.eye().as_dvec3(),
                inward,
                patch: own.truncate(),
                radius: f64::from(room.radius),
                is_near: !outline.is_empty() && outline.iter().all(|p| room.holds(*p)),
            }
        };
        let all = self.at(frame, unit).map(solid);
        all.filter(|solid| solid.shape.distance(solid.own(DVec3::ZERO)).distance > 0.0).collect()
    }

    /// Returns the horizontal part of the outward direction of the first plane that has one in the first frame: a wall
    /// or a slope.
    pub(super) fn outward(&self, up: Vec3) -> Option<Vec3> {
        let planes = self.all.iter().filter(|path| path.shape == Shape::Plane);
        let outward = planes.map(|path| (DQuat::from_array(path.poses[0].rotation) * DVec3::Z).as_vec3());
        outward.map(|n| n - up * up.dot(n)).find(|level| level.length() > 0.1)
    }
}

/// Where the cloth moves, and with it bodies that are to be seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    low: Vec3,
    high: Vec3,
    middle: Vec3,
    /// Radius of the patch that is drawn of a plane.
    radius: f32,
}

impl Room {
    /// How far beyond the cloth's movement a body may reach and count as near \[sizes of the cloth\].
    const AROUND: f32 = 0.75;
    /// Radius of the patch of a plane: the share of the half diagonal of the cloth's movement, and what is added
    /// \[sizes of the cloth\].
    const PATCH: [f32; 2] = [1.2, 1.0];

    /// Returns the room around the points of a movement.
    pub fn around(points: impl Iterator<Item = Vec3>) -> Self {
        let box_of = |(low, high): (Vec3, Vec3), p: Vec3| (low.min(p), high.max(p));
        let (low, high) = points.fold((Vec3::MAX, Vec3::MIN), box_of);
        let (low, high) = if low.cmple(high).all() { (low, high) } else { (Vec3::ZERO, Vec3::ZERO) };
        let radius = Self::PATCH[0] * (high - low).length() / 2.0 + Self::PATCH[1];
        let (middle, around) = ((low + high) / 2.0, Vec3::splat(Self::AROUND));
        Self { low: low - around, high: high + around, middle, radius }
    }

    fn holds(&self, p: Vec3) -> bool {
        p.cmpge(self.low).all() && p.cmple(self.high).all()
    }
}

/// A body in one frame \[sizes of the cloth\], along the camera's axes and seen from the eye.
pub(super) struct Solid {
    shape: Shape,
    /// The body's up axis, and its origin, both along the axes of the trajectory.
    normal: Vec3,
    place: Vec3,
    /// The body's origin.
    at: DVec3,
    /// Rotation to the body's own axes.
    inward: DMat3,
    /// Middle of the patch that is drawn of a plane, and its radius, in the body's own axes.
    patch: DVec2,
    radius: f64,
    /// Whether it is near the cloth, where it casts a shadow.
    is_near: bool,
}

/// What is seen of a body at one point of a picture.
pub(super) struct Spot {
    /// Normal, along the camera's axes.
    pub normal: Vec3,
    /// Whether it is part of a plane.
    pub is_plane: bool,
    /// From 1 to 0 at the edge of the patch of a plane.
    pub opacity: f32,
    /// Position in the grid of lines on a plane \[fields\].
    pub field: Vec2,
}

/// Share of the radius of a plane's patch inside which it does not fade.
const SOLID_PART: f64 = 0.45;
/// Lines per size of the cloth on a plane.
const LINES: f64 = 4.0;
/// A plane is a floor if its normal has at least this component upwards.
const FLOOR: f32 = 0.5;

impl Solid {
    fn own(&self, p: DVec3) -> DVec3 {
        self.inward * (p - self.at)
    }

    /// Returns where the ray from the eye along `ray` enters the body, in the body's own axes, and how many times
    /// `ray` that is away.
    fn hit(&self, ray: Vec3) -> Option<(DVec3, f64)> {
        let (from, along) = (self.own(DVec3::ZERO), self.inward * ray.as_dvec3());
        let times = entry(&self.shape, from, along)?;
        let at = from + times * along;
        (self.shape != Shape::Plane || at.truncate().distance(self.patch) < self.radius)
            .then_some((at, times))
    }

    /// Returns the distance in front of the eye at which `ray` meets the body.
    pub fn distance(&self, ray: Vec3) -> Option<f32> {
        self.hit(ray).map(|(_, times)| times as f32 * -ray.z)
    }

    /// Returns what is seen along `ray`.
    pub fn spot(&self, ray: Vec3) -> Option<Spot> {
        let (at, _) = self.hit(ray)?;
        let is_plane = self.shape == Shape::Plane;
        let edge = (1.0 - at.truncate().distance(self.patch) / self.radius) / (1.0 - SOLID_PART);
        let edge = if is_plane { edge.clamp(0.0, 1.0) as f32 } else { 1.0 };
        Some(Spot {
            normal: (self.inward.transpose() * self.shape.distance(at).normal).as_vec3(),
            is_plane,
            opacity: edge * edge * (3.0 - 2.0 * edge),
            field: (LINES * at.truncate()).as_vec2(),
        })
    }

    /// Returns two corners of a rectangle of the picture that holds all that is seen of the body.
    pub fn bounds(&self, camera: &Camera) -> [Vec2; 2] {
        let reach = self.shape.reach();
        let [near, far] = [-self.at.z - reach, -self.at.z + reach];
        if near.is_nan() || near <= 1e-3 * reach {
            return [Vec2::NEG_INFINITY, Vec2::INFINITY];
        }
        let side = |middle: f64, sign: f64| {
            let edge = middle + sign * reach;
            // The farther of the two places at which the edge of a cube around the body is seen.
            f64::from(camera.focal) * if edge * sign > 0.0 { edge / near } else { edge / far }
        };
        let [x, y] = camera.centre;
        let (left, right) = (side(self.at.x, -1.0) as f32, side(self.at.x, 1.0) as f32);
        let (bottom, top) = (side(self.at.y, -1.0) as f32, side(self.at.y, 1.0) as f32);
        [Vec2::new(x + left, y - top), Vec2::new(x + right, y - bottom)]
    }

    /// Whether the body is above a point along the camera's axes, seen from the eye, or holds it; `up` leads upwards.
    pub fn shades(&self, p: Vec3, up: Vec3) -> bool {
        let own = self.own(p.as_dvec3());
        self.is_near
            && (self.shape.distance(own).distance <= 0.0
                || entry(&self.shape, own, self.inward * up.as_dvec3()).is_some())
    }

    /// Returns the normal n of a plane that is a floor, and n . p for all its points p; along the axes of the
    /// trajectory, in which `up` leads upwards.
    pub fn floor(&self, up: Vec3) -> Option<(Vec3, f32)> {
        let is_floor = self.shape == Shape::Plane && self.normal.dot(up) >= FLOOR;
        is_floor.then(|| (self.normal, self.normal.dot(self.place)))
    }
}

/// Returns a shape whose surface is `by` farther in, but at most half as large; for a plane, how far it is lowered.
fn smaller(shape: Shape, by: f64) -> (Shape, f64) {
    let less = |size: f64| (size - by).max(LEAST_PART * size);
    match shape {
        Shape::Plane => (shape, by),
        Shape::Sphere { radius } => (Shape::Sphere { radius: less(radius) }, 0.0),
        Shape::Capsule { radius, half_length } => (Shape::Capsule { radius: less(radius), half_length }, 0.0),
        Shape::Box { half } => (Shape::Box { half: half.map(less) }, 0.0),
        Shape::Mesh { field, scale, inset } => (Shape::Mesh { field, scale, inset: inset + by }, 0.0),
    }
}

fn scaled(shape: Shape, by: f64) -> Shape {
    match shape {
        Shape::Plane => shape,
        Shape::Sphere { radius } => Shape::Sphere { radius: by * radius },
        Shape::Capsule { radius, half_length } => {
            Shape::Capsule { radius: by * radius, half_length: by * half_length }
        }
        Shape::Box { half } => Shape::Box { half: half.map(|half| by * half) },
        Shape::Mesh { field, scale, inset } => Shape::Mesh { field, scale: by * scale, inset: by * inset },
    }
}

/// Number of points of the longest outline.
const OUTLINE: usize = 2 * TURNS * RINGS;
/// Points around each half of a round outline.
const TURNS: usize = 12;
const RINGS: usize = 4;

/// Returns points on the surface of a body that show its extent; none for a plane.
fn outline(shape: &Shape, place: DVec3, rotation: DQuat) -> Vec<Vec3> {
    let round = |radius: f64, half_length: f64| {
        // Rings from the poles to the equator of either half.
        let point = |k: usize| {
            let (half, ring, turn) = (k / (TURNS * RINGS), k / TURNS % RINGS, k % TURNS);
            let sign = if half == 0 { 1.0 } else { -1.0 };
            let (rise, out) = (std::f64::consts::FRAC_PI_2 * ring as f64 / (RINGS - 1) as f64).sin_cos();
            let (y, x) = (std::f64::consts::TAU * turn as f64 / TURNS as f64).sin_cos();
            DVec3::new(radius * out * x, radius * out * y, sign * (half_length + radius * rise))
        };
        (0..OUTLINE).map(point).collect::<Vec<DVec3>>()
    };
    let corners = |[low, high]: [[f64; 3]; 2]| {
        let corner = |k: usize| DVec3::from_array(std::array::from_fn(|c| [low, high][k >> c & 1][c]));
        (0..8).map(corner).collect()
    };
    let own = match *shape {
        Shape::Plane => Vec::new(),
        Shape::Sphere { radius } => round(radius, 0.0),
        Shape::Capsule { radius, half_length } => round(radius, half_length),
        Shape::Box { half } => corners([half.map(|half| -half), half]),
        Shape::Mesh { ref field, scale, .. } => {
            corners(field.bounds().map(|corner| corner.map(|c| scale * c)))
        }
    };
    own.into_iter().map(|p| (rotation * p + place).as_vec3()).collect()
}

/// Returns how many times `along` a ray from a point outside a shape goes before it enters it.
fn entry(shape: &Shape, from: DVec3, along: DVec3) -> Option<f64> {
    match *shape {
        Shape::Mesh { .. } => march(shape, from, along),
        Shape::Plane => (along.z < 0.0 && from.z > 0.0).then(|| from.z / -along.z),
        Shape::Sphere { radius } => ball(from, along, radius),
        Shape::Capsule { radius, half_length } => {
            let flat = DVec3::new(1.0, 1.0, 0.0);
            let side = ball(from * flat, along * flat, radius);
            let side = side.filter(|times| (from.z + times * along.z).abs() <= half_length);
            // A ray that enters between the ends does so through the side.
            let ends = [half_length, -half_length].map(|end| ball(from - DVec3::Z * end, along, radius));
            [side, ends[0], ends[1]].into_iter().flatten().min_by(f64::total_cmp)
        }
        Shape::Box { half } => {
            let half = DVec3::from(half);
            let (a, b) = ((-half - from) / along, (half - from) / along);
            let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
            (enter > 0.0 && enter <= leave).then_some(enter)
        }
    }
}

/// Implements [`entry`] for any shape, in steps of the distance.
fn march(shape: &Shape, from: DVec3, along: DVec3) -> Option<f64> {
    let (reach, length) = (shape.reach(), along.length());
    let near = NEAR * reach;
    // The way through a ball that holds it, which it may touch.
    let ahead = -from.dot(along) / length;
    let aside = from.length_squared() - ahead * ahead;
    let half = ((reach + 2.0 * near).powi(2) - aside).max(0.0).sqrt();
    let (mut way, end) = ((ahead - half).max(0.0), ahead + half);
    if shape.distance(from).distance <= 0.0 {
        return None;
    }
    for _ in 0..STEPS {
        if way >= end {
            return None;
        }
        let left = shape.distance(from + along * (way / length)).distance;
        if left <= near {
            return Some(way / length);
        }
        way += left;
    }
    None
}

/// Most steps along a ray to a shape.
const STEPS: usize = 256;
/// Distance at which a ray has reached a shape [radii of a ball that holds it].
const NEAR: f64 = 1e-4;

/// Implements [`entry`] for a ball around the origin.
fn ball(from: DVec3, along: DVec3, radius: f64) -> Option<f64> {
    let approach = -from.dot(along);
    let outside = from.length_squared() - radius * radius;
    let root = approach * approach - along.length_squared() * outside;
    // In this form nothing cancels.
    (approach > 0.0 && outside > 0.0 && root >= 0.0).then(|| outside / (approach + root.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::DistanceField;
    use std::sync::Arc;

    const SHAPES: [Shape; 4] = [
        Shape::Plane,
        Shape::Sphere { radius: 0.7 },
        Shape::Capsule { radius: 0.3, half_length: 0.8 },
        Shape::Box { half: [0.9, 0.4, 0.6] },
    ];

    /// Returns points spread over a cube from -1 to 1.
    fn spread() -> impl Iterator<Item = DVec3> {
        (1..400).map(|k| (DVec3::new(0.754_877, 0.569_840, 0.430_159) * f64::from(k)).fract() * 2.0 - 1.0)
    }

    /// A mesh is reached within a small part of its size, from the outside.
    #[test]
    fn a_ray_enters_a_mesh_near_its_surface() {
        let corner = |k: usize| std::array::from_fn(|c| if k >> c & 1 == 0 { -0.8 } else { 0.8 });
        let squares = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let faces: Vec<[u32; 3]> =
            squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        let vertices: Vec<[f64; 3]> = (0..8).map(corner).collect();
        let field = Arc::new(DistanceField::new(&vertices, &faces, 32).expect("a closed mesh"));
        let (mesh, exact) = (Shape::Mesh { field, scale: 1.0, inset: 0.0 }, Shape::Box { half: [0.8; 3] });
        let (mut entered, mut differ) = (0, 0);
        for (from, to) in spread().map(|p| 4.0 * p.normalize()).zip(spread().skip(7)) {
            let along = 0.5 * (to - from);
            let (found, expected) = (entry(&mesh, from, along), entry(&exact, from, along));
            entered += usize::from(found.is_some());
            differ += usize::from(found.is_some() != expected.is_some());
            if let Some(times) = found {
                let gap = mesh.distance(from + times * along).distance;
                assert!(gap.abs() < 1e-3, "from {from} along {along}: {gap}");
            }
            if let (Some(found), Some(expected)) = (found, expected) {
                // Where it grazes an edge, which is rounded, it enters later.
                assert!((found - expected).abs() * along.length() < 0.2, "{found}, not {expected}");
            }
        }
        assert!(entered > 100 && differ < 8, "{entered} rays enter, {differ} only one");
    }

    #[test]
    fn a_ray_enters_a_body_where_its_distance_becomes_zero() {
        for shape in SHAPES {
            let rays = spread().map(|p| 4.0 * p.normalize()).zip(spread().skip(7));
            let rays = rays.filter(|(from, _)| shape.distance(*from).distance > 0.0);
            let mut entered = 0;
            for (from, to) in rays {
                // Of another length than 1.
                let along = 0.5 * (to - from);
                let times = entry(&shape, from, along);
                entered += usize::from(times.is_some());
                if let Some(times) = times {
                    let gap = shape.distance(from + times * along).distance;
                    assert!(gap.abs() < 1e-12, "{shape:?} from {from} along {along}: {gap}");
                }
                let before = times.unwrap_or(20.0) - 1e-9;
                for part in 0..100 {
                    let p = from + along * (before * f64::from(part) / 99.0);
                    assert!(
                        shape.distance(p).distance > 0.0,
                        "{shape:?} from {from} along {along}: inside at {p}"
                    );
                }
            }
            assert!((20..390).contains(&entered), "{shape:?}: {entered} rays enter");
        }
    }

    #[test]
    fn all_that_is_seen_of_a_body_is_within_its_bounds() {
        let camera = Camera::fit(glam::Mat3::IDENTITY, &[Vec3::ONE, Vec3::NEG_ONE], [120, 90]);
        for (k, place) in spread().take(60).enumerate() {
            let rotation = DQuat::from_scaled_axis(2.0 * place);
            let pose = Pose { position: (2.0 * place).to_array(), rotation: rotation.to_array() };
            let shape = SHAPES[1 + k % 3].clone();
            let body = Body { shape: shape.clone(), pose, thickness: 1e-3, friction: 0.0, present: true };
            let bodies = Bodies::new(&[body], &[], &VertexView::default());
            let unit = Unit::new(&[]);
            let solids = bodies.seen(0, &unit, &camera, &Room::around(std::iter::empty()));
            let [low, high] = solids[0].bounds(&camera);
            for (x, y) in (-40..160).flat_map(|x| (-40..130).map(move |y| (x as f32, y as f32))) {
                let place = Vec2::new(x, y);
                let is_inside = place.cmpge(low).all() && place.cmple(high).all();
                assert!(is_inside || solids[0].distance(camera.ray(place)).is_none(), "{shape:?} at {place}");
            }
        }
    }

    #[test]
    fn a_body_is_converted_as_a_cloth_is_and_no_larger_than_it_is() {
        // Edges of 0.1 m, y up, 3 m aside.
        let transform = [[0.1, 0.0, 0.0, 3.0], [0.0, 0.0, 0.1, 0.0], [0.0, -0.1, 0.0, 0.0]];
        let view = VertexView { transform, time: 1.0 };
        let pose = |position| Pose { position, rotation: DQuat::from_rotation_x(0.4).to_array() };
        let capsule = Shape::Capsule { radius: 2.0, half_length: 5.0 };
        let body =
            |shape| Body { shape, pose: pose([1.0, 2.0, 3.0]), thickness: 0.2, friction: 0.0, present: true };
        let later = vec![pose([0.0; 3]), pose([0.0, 0.0, 8.0])];
        let bodies = Bodies::new(&[body(capsule), body(Shape::Plane)], &[later], &view);
        let at = |frame: usize| bodies.at(frame, &Unit::new(&[])).collect::<Vec<_>>();
        for (frame, height) in [(0, 0.0), (1, 0.8), (7, 0.8)] {
            let (Shape::Capsule { radius, half_length }, place, rotation) = at(frame)[0] else {
                panic!("a capsule")
            };
            assert!((radius - 0.19).abs() < 1e-6 && (half_length - 0.5).abs() < 1e-6);
            assert!(place.distance(DVec3::new(3.0, height, 0.0)) < 1e-6, "{place}");
            let axis = DVec3::new(0.0, 0.4f64.cos(), 0.4f64.sin());
            assert!((rotation * DVec3::Z).distance(axis) < 1e-6, "{}", rotation * DVec3::Z);
            // Without poses, and lowered by half its thickness.
            let (Shape::Plane, place, _) = at(frame)[1] else { panic!("a plane") };
            assert!(place.distance(DVec3::new(3.1, 0.3, -0.2) - 0.01 * axis) < 1e-6, "{place}");
        }
    }
}
