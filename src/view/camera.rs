//! The camera, which circles a point.

use crate::render::View;
use crate::render::shared::{Camera, TANGENT};
use glam::{Mat3, Vec2, Vec3, vec2, vec3};
use std::f32::consts::FRAC_PI_2;

/// Radians by which the camera turns while the pointer crosses the height of the picture.
const TURN: f32 = 3.6;
/// The steepest elevation \[radians\]: short of the pole, where left and right would change sides.
const STEEPEST: f32 = FRAC_PI_2 - 0.02;
/// Least distance of the eye \[sizes of what is seen\], and greatest.
const DISTANCES: [f32; 2] = [0.05, 60.0];

/// A camera that looks at a point from a direction and a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// The point that it looks at \[m\].
    pub target: Vec3,
    /// Distance of the eye from it \[m\].
    pub distance: f32,
    /// Angle of the eye about the upward axis \[radians\].
    pub azimuth: f32,
    /// Angle of the eye above the horizon \[radians\].
    pub elevation: f32,
    /// The upward direction, of length 1.
    up: Vec3,
    /// Size of what is seen \[m\].
    size: f32,
}

impl Orbit {
    /// Returns the camera from which all of `points` are seen as in pictures; `normals` are those of the cloth.
    pub(super) fn around(points: &[Vec3], normals: &[[f32; 3]], up: Vec3, [width, height]: [f32; 2]) -> Self {
        let view = View { up: up.to_array(), ..View::default() };
        let rotation = view.rotation(normals, points);
        let camera = Camera::fit(rotation, points, [width, height].map(|side| side.max(1.0) as usize));
        let (low, high) = points
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        let (middle, size) = if points.is_empty() {
            (Vec3::ZERO, 1.0)
        } else {
            ((low + high) / 2.0, (high - low).length().max(1e-3))
        };
        let back = rotation.transpose() * Vec3::Z;
        let eye = rotation.transpose() * camera.eye();
        let distance = (eye - middle).dot(back).max(DISTANCES[0] * size);
        let [east, north] = view.horizontal();
        Self {
            target: eye - back * distance,
            distance,
            azimuth: back.dot(north).atan2(back.dot(east)),
            elevation: back.dot(up).asin(),
            up,
            size,
        }
    }

    /// Returns the camera for a picture of this size \[px\].
    pub(super) fn camera(&self, size: [f32; 2]) -> Camera {
        let rotation = self.rotation();
        Camera::at(rotation, rotation * self.target + vec3(0.0, 0.0, self.distance), size)
    }

    /// Returns the rotation to the camera's axes.
    pub(super) fn rotation(&self) -> Mat3 {
        let view = View { up: self.up.to_array(), ..View::default() };
        view.axes(self.azimuth.to_degrees(), self.elevation.to_degrees())
    }

    /// Returns the upward direction.
    pub(super) fn up(&self) -> Vec3 {
        self.up
    }

    /// Turns with a pointer that moves so far \[heights of the picture\], right and down.
    pub fn turn(&mut self, by: Vec2) {
        self.azimuth = (self.azimuth - TURN * by.x) % std::f32::consts::TAU;
        self.elevation = (self.elevation + TURN * by.y).clamp(-STEEPEST, STEEPEST);
    }

    /// Moves sideways, so that what is seen at the point that is looked at goes with the pointer.
    pub fn pan(&mut self, by: Vec2) {
        let along = self.rotation().transpose() * vec3(-by.x, by.y, 0.0);
        self.target += 2.0 * TANGENT * self.distance * along;
    }

    /// Moves so many times nearer.
    pub fn zoom(&mut self, times: f32) {
        let [near, far] = DISTANCES.map(|distance| distance * self.size);
        self.distance = (self.distance / times.max(1e-3)).clamp(near, far);
    }
}

/// Returns where the ray through a place in the picture \[px\] meets the plane through `at` that faces the camera.
pub(super) fn onto_plane(camera: &Camera, place: Vec2, at: Vec3) -> Vec3 {
    let away = -(camera.rotation * at - camera.eye()).z;
    let ray = camera.ray(place);
    camera.rotation.transpose() * (camera.eye() + ray * (away / -ray.z))
}

/// Returns the place of a point in the picture \[px\]; `None` if it is not in front of the eye.
pub(super) fn place_of(camera: &Camera, at: Vec3) -> Option<Vec2> {
    let place = camera.project(at);
    place.is_finite().then(|| vec2(place.x, place.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [f32; 2] = [600.0, 400.0];

    fn orbit(up: Vec3) -> Orbit {
        let points: Vec<Vec3> =
            (0..40).map(|k| k as f32).map(|k| vec3(k.sin(), k.cos(), (2.0 * k).sin())).collect();
        Orbit::around(&points, &[[1.0, 0.0, 0.0]], up, SIZE)
    }

    #[test]
    fn a_camera_around_points_is_that_of_pictures() {
        let points = [Vec3::ZERO, vec3(1.0, 0.5, 0.2), vec3(-1.0, 0.1, 0.4)];
        for up in [Vec3::Y, Vec3::Z] {
            let normals = [[1.0, 0.0, 0.0]];
            let view = View { up: up.to_array(), ..View::default() };
            let pictured = Camera::fit(view.rotation(&normals, &points), &points, [600, 400]);
            let own = Orbit::around(&points, &normals, up, SIZE).camera(SIZE);
            for p in points {
                assert!(own.project(p).distance(pictured.project(p)) < 0.05, "{own:?} {pictured:?}");
            }
        }
    }

    #[test]
    fn a_point_that_is_dragged_stays_under_the_pointer() {
        for up in [Vec3::Y, Vec3::Z] {
            let mut orbit = orbit(up);
            let (p, by) = (orbit.target, vec2(0.1, -0.05));
            let before = place_of(&orbit.camera(SIZE), p).unwrap();
            let moved = onto_plane(&orbit.camera(SIZE), before + by * SIZE[1], p);
            assert!(place_of(&orbit.camera(SIZE), moved).unwrap().distance(before + by * SIZE[1]) < 0.01);
            orbit.pan(by);
            assert!(place_of(&orbit.camera(SIZE), p).unwrap().distance(before + by * SIZE[1]) < 0.05);
        }
    }

    #[test]
    fn turning_keeps_the_target_and_what_is_up() {
        let mut orbit = orbit(Vec3::Y);
        for _ in 0..50 {
            orbit.turn(vec2(0.31, 0.17));
            orbit.zoom(1.3);
            let camera = orbit.camera(SIZE);
            assert!(place_of(&camera, orbit.target).unwrap().distance(vec2(300.0, 200.0)) < 0.01);
            let above = place_of(&camera, orbit.target + 0.01 * orbit.distance * Vec3::Y).unwrap();
            assert!(above.y < 200.0, "{orbit:?}");
        }
    }
}
