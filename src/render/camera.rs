//! The camera: where a picture is taken from.

use glam::{DVec3, Mat3, Vec2, Vec3, vec3};

/// The direction from which a trajectory is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The upward direction, of any length but 0.
    pub up: [f32; 3],
    /// Angle of the eye about the upward axis \[degrees\]. `None` shows the cloth of the first frame at an
    /// angle to its face, from the side on which the whole movement looks narrowest and the cloth therefore
    /// largest.
    pub azimuth: Option<f32>,
    /// Angle of the eye above the horizon \[degrees\], in (-90, 90). `None` gives a low angle for a cloth
    /// that hangs in the first frame and a higher one for a cloth that lies.
    pub elevation: Option<f32>,
}

impl Default for View {
    fn default() -> Self {
        Self { up: [0.0, 1.0, 0.0], azimuth: None, elevation: None }
    }
}

/// Tangent of half the vertical field of view.
pub(crate) const TANGENT: f32 = 0.24;
/// Fraction of the picture that the trajectory may fill, horizontally and vertically.
const FILL: [f32; 2] = [0.90, 0.88];
/// Angle between the eye and the face of the cloth \[degrees\].
const OBLIQUE: f32 = 38.0;
/// Angle of the eye above the horizon for a cloth that hangs, and the amount added for a cloth that lies
/// \[degrees\].
const ELEVATION: [f32; 2] = [14.0, 18.0];
/// Coordinates beyond this \[sizes of the cloth\] are treated like non-finite ones.
const FAR: f32 = 1e4;
/// A frame with a larger extent \[sizes of the cloth\] shows a cloth that has exploded. The camera does not
/// move back for it, so that the frames before it can be seen.
const EXPLODED: f32 = 3.0;

/// The unit in which a trajectory is drawn: the cloth of its first frame is around the origin, and its largest
/// extent is 1. Pictures therefore do not depend on where a cloth is and how large.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unit {
    /// Centre of the first frame \[m\].
    centre: Vec3,
    /// Largest extent of the first frame along an axis \[m\].
    size: f32,
}

impl Unit {
    /// Returns the unit of a trajectory that begins with these positions \[m\].
    pub fn new(first: &[[f32; 3]]) -> Self {
        let finite = || first.iter().map(|&p| Vec3::from(p)).filter(|p| p.is_finite());
        let Some(any) = finite().next() else { return Self { centre: Vec3::ZERO, size: 1.0 } };
        let (low, high) = finite().fold((any, any), |(low, high), p| (low.min(p), high.max(p)));
        let size = (high - low).max_element();
        // A single point has no size.
        Self { centre: (low + high) / 2.0, size: if size > 0.0 { size } else { 1.0 } }
    }

    /// Returns the largest extent of the first frame \[m\].
    pub fn size(&self) -> f64 {
        f64::from(self.size)
    }

    /// Converts a position \[m\].
    pub fn place(&self, p: DVec3) -> DVec3 {
        (p - self.centre.as_dvec3()) / self.size()
    }

    /// Converts positions \[m\].
    pub fn of(&self, positions: &[[f32; 3]]) -> Vec<[f32; 3]> {
        positions.iter().map(|&p| ((Vec3::from(p) - self.centre) / self.size).to_array()).collect()
    }
}

/// Whether the cloth is in one piece in a frame, of which unusable vertices are left out.
pub(super) fn is_whole(frame: &[[f32; 3]]) -> bool {
    let points = || frame.iter().filter(|p| usable(p)).map(|&p| Vec3::from(p));
    let (low, high) = points().fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(p), high.max(p)));
    (high - low).max_element() <= EXPLODED
}

/// Whether a vertex can be drawn.
pub(super) fn usable(p: &[f32; 3]) -> bool {
    p.iter().all(|x| x.abs() < FAR)
}

/// Returns the position of a vertex; NaN if it cannot be drawn.
pub(super) fn place(p: &[f32; 3]) -> Vec3 {
    if usable(p) { Vec3::from(*p) } else { Vec3::NAN }
}

/// Returns the smallest and the largest of some numbers; without numbers, the first exceeds the second.
pub(super) fn range(values: impl Iterator<Item = f32>) -> (f32, f32) {
    values.fold((f32::MAX, f32::MIN), |(low, high), x| (low.min(x), high.max(x)))
}

/// A perspective camera. Its axes are x right, y up, z towards the eye.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Camera {
    /// Rotation from the world to the camera's axes.
    pub rotation: Mat3,
    /// Position of the eye along the camera's axes.
    eye: Vec3,
    /// Pixels per unit of tangent.
    pub focal: f32,
    /// The middle of the picture \[px\].
    pub centre: [f32; 2],
}

impl Camera {
    /// Position of the eye along the camera's axes.
    pub fn eye(&self) -> Vec3 {
        self.eye
    }

    /// Returns the direction from the eye to a place in the picture \[px\], along the camera's axes, of any length.
    pub fn ray(&self, place: Vec2) -> Vec3 {
        vec3(place.x - self.centre[0], self.centre[1] - place.y, -self.focal)
    }

    /// Returns the picture coordinates of a point \[px\], y down, and its distance in front of the eye; NaN if
    /// it is not in front.
    pub fn project(&self, p: Vec3) -> Vec3 {
        let q = self.rotation * p - self.eye;
        if q.z >= 0.0 {
            return Vec3::NAN;
        }
        let scale = self.focal / -q.z;
        vec3(self.centre[0] + scale * q.x, self.centre[1] - scale * q.y, -q.z)
    }

    /// Returns the camera of a picture of `size` pixels that sees all of `points` and looks along the axes of
    /// `rotation`.
    pub fn fit(rotation: Mat3, points: &[Vec3], size: [usize; 2]) -> Self {
        let [width, height] = size.map(|n| n as f32);
        let tangents = [TANGENT * FILL[0] * width / height, TANGENT * FILL[1]];
        // A point is in view if |x - eye.x| <= t (eye.z - z), and likewise for y. Each side of the picture is
        // one linear bound, and the outermost points determine the nearest eye that satisfies all bounds.
        let mut bounds = [[f32::MIN; 2]; 2];
        for q in points.iter().map(|&p| rotation * p) {
            for (axis, &t) in tangents.iter().enumerate() {
                let [low, high] = &mut bounds[axis];
                *high = high.max(q[axis] + t * q.z);
                *low = low.max(t * q.z - q[axis]);
            }
        }
        if points.is_empty() {
            bounds = [[1.0; 2]; 2];
        }
        let middle = bounds.map(|[low, high]| (high - low) / 2.0);
        let distance = [0, 1].map(|axis| (bounds[axis][0] + bounds[axis][1]) / (2.0 * tangents[axis]));
        let nearest = points.iter().map(|&p| (rotation * p).z).fold(f32::MIN, f32::max);
        // Not at the nearest point, for a cloth that is a single point.
        let z = distance[0].max(distance[1]).max(nearest + 0.01);
        Self::at(rotation, vec3(middle[0], middle[1], z), [width, height])
    }

    /// Returns the camera of a picture of `size` pixels that looks along the axes of `rotation` from the eye, which is given
    /// along these axes.
    pub fn at(rotation: Mat3, eye: Vec3, [width, height]: [f32; 2]) -> Self {
        Self { rotation, eye, focal: height / (2.0 * TANGENT), centre: [width / 2.0, height / 2.0] }
    }
}

impl View {
    /// Returns the upward direction, with length 1. Panics if it is zero.
    pub(super) fn up(&self) -> Vec3 {
        Vec3::from(self.up).try_normalize().expect("the upward direction is not zero")
    }

    /// Returns the axes of a camera that sees the points of a trajectory this way; `normals` are those of the
    /// first frame.
    pub(crate) fn rotation(&self, normals: &[[f32; 3]], points: &[Vec3]) -> Mat3 {
        let upright = normals.iter().map(|&n| self.up().dot(Vec3::from(n)).powi(2)).sum::<f32>();
        let lying = upright / normals.len().max(1) as f32;
        let elevation = self.elevation.unwrap_or(ELEVATION[0] + ELEVATION[1] * lying);
        let axes = |azimuth: f32| self.axes(azimuth, elevation);
        if let Some(azimuth) = self.azimuth {
            return axes(azimuth);
        }
        let [east, north] = self.horizontal();
        let facing = facing(normals.iter().map(|&n| (Vec3::from(n).dot(east), Vec3::from(n).dot(north))));
        let candidates = [axes(facing + OBLIQUE), axes(facing - OBLIQUE)];
        let width = |axes: &Mat3| {
            let (low, high) = range(points.iter().map(|&p| axes.row(0).dot(p)));
            high - low
        };
        // Rounding must not decide between equal widths, as of a cloth that only moves up and down.
        if width(&candidates[1]) < 0.99 * width(&candidates[0]) { candidates[1] } else { candidates[0] }
    }

    /// Returns two directions that span the horizon.
    pub(crate) fn horizontal(&self) -> [Vec3; 2] {
        let up = self.up();
        let seed = if up.z.abs() < 0.5 { Vec3::Z } else { Vec3::X };
        let east = if up.z.abs() < 0.5 { up.cross(seed) } else { seed - up * up.dot(seed) }.normalize();
        [east, up.cross(east)]
    }

    pub(crate) fn axes(&self, azimuth: f32, elevation: f32) -> Mat3 {
        let [east, north] = self.horizontal();
        let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
        let level = east * azimuth.cos() + north * azimuth.sin();
        let towards_eye = level * elevation.cos() + self.up() * elevation.sin();
        let right = self.up().cross(towards_eye).normalize();
        Mat3::from_cols(right, towards_eye.cross(right), towards_eye).transpose()
    }
}

/// Returns the horizontal angle \[degrees\] that a cloth faces: the main axis of its normals, on the side
/// they point to.
fn facing(normals: impl Iterator<Item = (f32, f32)>) -> f32 {
    let (mut cos, mut sin, mut net) = (0.0, 0.0, (0.0, 0.0));
    for (x, y) in normals {
        cos += x * x - y * y;
        sin += 2.0 * x * y;
        net = (net.0 + x, net.1 + y);
    }
    let angle = f32::atan2(sin, cos) / 2.0;
    let behind = angle.cos() * net.0 + angle.sin() * net.1 < 0.0;
    angle.to_degrees() + if behind { 180.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_touches_the_margin_and_clips_nothing() {
        let points: Vec<Vec3> = (0..60)
            .map(|k| k as f32)
            .map(|k| vec3(k.sin(), (1.7 * k).cos(), 3.0 * (0.3 * k).sin()))
            .collect();
        let size = [300, 200];
        let camera = Camera::fit(View::default().axes(20.0, 10.0), &points, size);
        let mut slack = f32::MAX;
        for p in points.iter().map(|&p| camera.project(p)) {
            for (axis, (x, n)) in [(p.x, 300.0), (p.y, 200.0)].into_iter().enumerate() {
                let margin = n * (1.0 - FILL[axis]) / 2.0;
                slack = slack.min(x - margin).min(n - margin - x);
            }
        }
        assert!(slack.abs() < 0.05, "{slack}");
    }

    #[test]
    fn up_is_up_for_every_axis() {
        for up in [[0.0, 1.0, 0.0], [0.0, 0.0, 2.0], [-1.0, 0.0, 0.0]] {
            let view = View { up, ..View::default() };
            let axes = view.axes(77.0, 14.0);
            assert!((axes.determinant() - 1.0).abs() < 1e-5);
            let camera = Camera::fit(axes, &[Vec3::ZERO, view.up()], [100, 100]);
            assert!(camera.project(view.up()).y < camera.project(Vec3::ZERO).y);
        }
    }

    #[test]
    fn a_cloth_is_seen_at_an_angle_from_its_front_and_from_higher_if_it_lies() {
        let eye = |normal: [f32; 3]| View::default().rotation(&[normal; 4], &[Vec3::ZERO, Vec3::X]).row(2);
        for normal in [Vec3::X, Vec3::NEG_X, vec3(0.6, 0.0, -0.8)] {
            let cos = OBLIQUE.to_radians().cos() * ELEVATION[0].to_radians().cos();
            assert!((eye(normal.to_array()).dot(normal) - cos).abs() < 1e-4);
        }
        let height = |normal| eye(normal).y.asin().to_degrees();
        assert!((height([1.0, 0.0, 0.0]) - 14.0).abs() < 0.01);
        assert!((height([0.0, -1.0, 0.0]) - 32.0).abs() < 0.01);
    }
}
