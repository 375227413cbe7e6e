//! What is under the pointer.

use super::camera::place_of;
use crate::render::shared::Camera;
use glam::{Vec2, Vec3};

/// How near the pointer must be to a handle \[px\], for a picture of 1 px per point.
const REACH: f32 = 16.0;

/// Returns the particle under the pointer: the handle that is nearest to it, or else the corner of the triangle that it is over
/// which is nearest. `positions` are those of the particles \[m\] and `scale` is the number of pixels of a point.
pub(super) fn particle(
    camera: &Camera,
    (pointer, scale): (Vec2, f32),
    positions: &[[f32; 3]],
    (faces, handles): (&[[u32; 3]], &[usize]),
) -> Option<usize> {
    let place = |p: usize| place_of(camera, Vec3::from(positions[p]));
    let apart = |p: usize| place(p).map(|at| (at.distance(pointer), p));
    let nearest =
        |all: &mut dyn Iterator<Item = usize>| all.filter_map(apart).min_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((apart, handle)) = nearest(&mut handles.iter().copied())
        && apart < scale * REACH
    {
        return Some(handle);
    }
    let over = |face: &&[u32; 3]| distance(camera, pointer, face.map(|p| Vec3::from(positions[p as usize])));
    let faces = faces.iter().filter_map(|face| over(&face).map(|distance| (distance, face)));
    let (_, face) = faces.min_by(|a, b| a.0.total_cmp(&b.0))?;
    nearest(&mut face.iter().map(|&p| p as usize)).map(|(_, p)| p)
}

/// Returns how many times its own length the ray through a place of the picture goes until it meets a triangle.
fn distance(camera: &Camera, pointer: Vec2, corners: [Vec3; 3]) -> Option<f32> {
    let ray = camera.ray(pointer);
    let [a, b, c] = corners.map(|corner| camera.rotation * corner - camera.eye());
    let (along, up) = (b - a, c - a);
    let across = ray.cross(up);
    let whole = along.dot(across);
    if whole.abs() < 1e-12 {
        return None;
    }
    let u = -a.dot(across) / whole;
    let turned = (-a).cross(along);
    let v = ray.dot(turned) / whole;
    let distance = up.dot(turned) / whole;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0).then_some(distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat3, vec2, vec3};

    /// Two sheets behind each other, seen along -z.
    #[test]
    fn the_nearer_triangle_gives_its_nearest_corner_and_handles_come_first() {
        let camera = Camera::at(Mat3::IDENTITY, vec3(0.0, 0.0, 5.0), [400.0, 400.0]);
        let positions = [
            [-1.0, -1.0, 0.0],
            [1.0, -1.0, 0.0],
            [0.0, 1.0, 0.0],
            [-1.0, -1.0, 1.0],
            [1.0, -1.0, 1.0],
            [0.0, 1.0, 1.0],
        ];
        let faces = [[0, 1, 2], [3, 4, 5]];
        let picked = |pointer: Vec2, handles: &[usize]| {
            particle(&camera, (pointer, 1.0), &positions, (&faces, handles))
        };
        let over = |p: usize, by: f32| {
            let at = Vec3::from(positions[p]) * (1.0 - by);
            place_of(&camera, vec3(at.x, at.y, positions[p][2])).unwrap()
        };
        assert_eq!([3, 4, 5].map(|p| picked(over(p, 0.1), &[])), [Some(3), Some(4), Some(5)]);
        assert_eq!(picked(over(0, 0.1), &[0]), Some(3));
        assert_eq!(picked(over(0, 0.0), &[0]), Some(0));
        assert_eq!(picked(vec2(2.0, 2.0), &[0]), None);
    }
}
