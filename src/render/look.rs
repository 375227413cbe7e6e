//! Appearance of the objects of one frame at the samples where they are visible.

use super::{
    camera::{Camera, usable},
    shade::{self, Lights, Sample},
    stage::Stage,
    surface,
};
use crate::{cloth::Grid, io::vertex_normals};
use glam::{Vec2, Vec3, vec2, vec3};

/// The cloth and the markers of one frame, ready to be shaded.
pub(super) struct Look<'a> {
    faces: &'a [[u32; 3]],
    camera: &'a Camera,
    lights: &'a Lights,
    handles: &'a [usize],
    grid: Grid,
    /// Picture coordinates and distance of each vertex.
    projected: Vec<Vec3>,
    /// Normal of the front at each vertex, along the camera's axes.
    normals: Vec<Vec3>,
    /// Depth of the valley at each vertex, as seen from the front.
    valleys: Vec<f32>,
    /// Number of checker fields per edge.
    fields: f32,
    /// Radius of a marker \[samples\].
    radius: f32,
    /// A quantity to show as colour at each vertex, from 0 to 1; if empty, the colours of the two sides are
    /// shown.
    heat: &'a [f32],
}

impl<'a> Look<'a> {
    pub fn new(
        stage: &'a Stage<'_>,
        (positions, heat): (&[[f32; 3]], &'a [f32]),
        handles: &'a [usize],
        projected: Vec<Vec3>,
        radius: f32,
    ) -> Self {
        let normals = vertex_normals(positions, &stage.faces);
        let valleys = valleys(stage.grid, positions, &normals);
        let turn = |n: &[f32; 3]| stage.camera.rotation * Vec3::from(*n);
        Self {
            faces: &stage.faces,
            camera: &stage.camera,
            lights: &stage.lights,
            handles,
            grid: stage.grid,
            projected,
            normals: normals.iter().map(turn).collect(),
            valleys,
            fields: shade::fields_per_edge(stage.grid.h.max(stage.grid.w) - 1),
            radius,
            heat,
        }
    }

    /// Returns the light from the object numbered `seen` at a sample.
    pub fn at(&self, seen: u32, x: usize, y: usize) -> Vec3 {
        let place = vec2(x as f32 + 0.5, y as f32 + 0.5);
        match self.faces.get(seen as usize) {
            Some(&face) => self.cloth(face, place),
            None => self.marker(self.projected[self.handles[seen as usize - self.faces.len()]], place),
        }
    }

    fn cloth(&self, face: [u32; 3], place: Vec2) -> Vec3 {
        let corners = face.map(|v| self.projected[v as usize]);
        let weights = surface::weights(corners, place.x, place.y).to_array();
        let front = surface::is_front(corners);
        let (mut normal, mut valley, mut field, mut heat) = (Vec3::ZERO, 0.0, Vec2::ZERO, 0.0);
        for (weight, v) in weights.into_iter().zip(face.map(|v| v as usize)) {
            normal += weight * self.normals[v];
            valley += weight * self.valleys[v];
            heat += weight * self.heat.get(v).copied().unwrap_or_default();
            field += weight * vec2((v % self.grid.w) as f32, (v / self.grid.w) as f32);
        }
        let side = if front { 1.0 } else { -1.0 };
        self.lights.cloth(&Sample {
            normal: (side * normal).normalize_or(Vec3::Z),
            eye: -self.camera.ray(place).normalize(),
            valley: side * valley,
            field: field * self.fields,
            front,
            heat: (!self.heat.is_empty()).then_some(heat),
        })
    }

    fn marker(&self, centre: Vec3, place: Vec2) -> Vec3 {
        let across = vec2(place.x - centre.x, centre.y - place.y) / self.radius;
        let towards = (1.0 - across.length_squared()).max(0.0).sqrt();
        self.lights.marker(vec3(across.x, across.y, towards))
    }
}

/// Returns how far each vertex lies below its neighbours along its normal, as a share of their distance;
/// these are the folds that light reaches least. Neighbours are 1/24 of the longer side away, and at least
/// one edge.
fn valleys(grid: Grid, positions: &[[f32; 3]], normals: &[[f32; 3]]) -> Vec<f32> {
    let reach = (grid.h.max(grid.w) / 24).max(1);
    let at = |i: usize, j: usize| Vec3::from(positions[i * grid.w + j]);
    let valley = |p: usize| {
        let (i, j) = (p / grid.w, p % grid.w);
        let normal = Vec3::from(normals[p]);
        let mut depth = 0.0;
        let pairs = [
            (i >= reach && i + reach < grid.h).then(|| (at(i - reach, j), at(i + reach, j))),
            (j >= reach && j + reach < grid.w).then(|| (at(i, j - reach), at(i, j + reach))),
        ];
        for (a, b) in pairs.into_iter().flatten() {
            let rise = ((a + b) / 2.0 - at(i, j)).dot(normal) / (a.distance(b) / 2.0).max(1e-6);
            depth += if rise.is_finite() { rise.clamp(-0.5, 0.5) } else { 0.0 };
        }
        depth
    };
    (0..positions.len()).map(|p| if usable(&positions[p]) { valley(p) } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gutter_is_a_valley_from_inside_and_a_ridge_from_outside() {
        let grid = Grid { h: 8, w: 9 };
        let gutter: Vec<[f32; 3]> =
            (0..72).map(|p| [(p % 9) as f32, (p / 9) as f32, 0.1 * ((p % 9) as f32 - 4.0).powi(2)]).collect();
        let inside = valleys(grid, &gutter, &vec![[0.0, 0.0, 1.0]; 72]);
        let outside = valleys(grid, &gutter, &vec![[0.0, 0.0, -1.0]; 72]);
        assert!((inside[4] - 0.1).abs() < 1e-6 && outside[4] == -inside[4]);
    }
}
