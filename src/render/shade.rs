//! Colours and light. Colours are linear until [`to_srgb`].

use super::body::Spot;
use glam::{Vec2, Vec3, vec2, vec3};
use std::sync::LazyLock;

/// The front of the cloth: petrol blue.
pub(crate) const FRONT: Vec3 = vec3(0.065, 0.32, 0.48);
/// The back of the cloth: warm sand.
pub(crate) const BACK: Vec3 = vec3(0.66, 0.47, 0.25);
/// Handles: orange.
pub(crate) const HANDLE: Vec3 = vec3(0.95, 0.16, 0.02);
/// Bodies: grey.
pub(crate) const BODY: Vec3 = vec3(0.37, 0.365, 0.355);
/// Planes: grey, near the background.
pub(crate) const PLANE: Vec3 = vec3(0.47, 0.465, 0.455);
/// Half the width of the lines on a plane \[fields\], and their tone.
const LINE: (f32, f32) = (0.014, 0.88);
/// Background at the top and at the bottom.
pub(crate) const BACKGROUND: [Vec3; 2] = [vec3(0.86, 0.88, 0.90), vec3(0.60, 0.61, 0.62)];
/// Number of checker fields along the longer side of the cloth.
const FIELDS: f32 = 16.0;

/// The lights of a stage, as directions along the camera's axes.
#[derive(Clone)]
pub(crate) struct Lights {
    /// Direction of the light that shows the folds.
    pub key: Vec3,
    /// Direction of the weak light from the other side.
    pub fill: Vec3,
    /// The upward direction.
    pub up: Vec3,
}

/// The properties of the cloth at a sample.
pub(super) struct Sample {
    /// Normal of the visible side, along the camera's axes.
    pub normal: Vec3,
    /// Direction to the eye, along the camera's axes.
    pub eye: Vec3,
    /// Depth of the valley that the sample lies in: positive in one, negative on a ridge.
    pub valley: f32,
    /// Position in the checker \[fields\].
    pub field: Vec2,
    /// Whether the front of the cloth is visible.
    pub front: bool,
    /// A quantity to show as colour instead of the side, from 0 to 1.
    pub heat: Option<f32>,
}

impl Lights {
    /// Places the lights for a cloth that faces along `facing`; both directions are along the camera's axes.
    /// The key light comes from above and from the side that the cloth turns away from, because grazing light
    /// shows the folds.
    pub fn new(up: Vec3, facing: Vec3) -> Self {
        let side = if facing.x < 0.0 { 1.0 } else { -1.0 };
        let light = |x: f32, y: f32, z: f32| (vec3(side * x, 0.0, z) + up * y).normalize();
        Self { key: light(0.55, 0.62, 0.70), fill: light(-0.9, 0.1, 0.5), up }
    }

    /// Returns the light from the cloth to the eye.
    pub(super) fn cloth(&self, s: &Sample) -> Vec3 {
        let n = s.normal;
        // Fabric transmits and scatters some light, so shading continues a little beyond the terminator.
        let key = ((n.dot(self.key) + 0.18) / 1.18).max(0.0);
        let fill = n.dot(self.fill).max(0.0);
        let sky = 0.5 + 0.5 * n.dot(self.up);
        let open = (1.0 - 2.2 * s.valley).clamp(0.45, 1.25);
        let light = vec3(1.0, 0.96, 0.90) * (1.3 * key)
            + vec3(0.75, 0.85, 1.0) * (0.13 * fill)
            + vec3(0.80, 0.88, 1.0) * (0.20 * open * (0.55 + 0.45 * sky));
        // Colour that stands for a number must not depend on the light, but for a hint of the shape.
        if let Some(heat) = s.heat {
            return warmth(heat) * (0.66 + 0.34 * key);
        }
        let colour = if s.front { FRONT } else { BACK };
        let albedo = colour * checker(s.field);
        let facing = n.dot(s.eye).clamp(0.0, 1.0);
        let rim = (1.0 - facing).powi(4) * (0.3 + 0.7 * sky);
        let shine = n.dot((self.key + s.eye).normalize()).max(0.0).powi(24);
        albedo * light * (0.35 + 0.65 * open) + vec3(0.9, 0.95, 1.0) * (0.16 * rim + 0.045 * shine)
    }

    /// Returns the light from a body, which is matte.
    pub(super) fn body(&self, spot: &Spot) -> Vec3 {
        let n = spot.normal;
        let key = (0.5 + 0.5 * n.dot(self.key)).powi(2);
        let fill = n.dot(self.fill).max(0.0);
        let sky = 0.5 + 0.5 * n.dot(self.up);
        let light = vec3(1.0, 0.97, 0.93) * (1.05 * key)
            + vec3(0.75, 0.85, 1.0) * (0.10 * fill)
            + vec3(0.86, 0.91, 1.0) * (0.12 + 0.22 * sky);
        let albedo = if spot.is_plane { PLANE * lines(spot.field) } else { BODY };
        albedo * light
    }

    /// Returns the light from a marker with the normal `n` along the camera's axes.
    pub fn marker(&self, n: Vec3) -> Vec3 {
        let key = (0.5 + 0.5 * n.dot(self.key)).powi(2);
        let shine = n.dot((self.key + Vec3::Z).normalize()).max(0.0).powi(40);
        HANDLE * (0.42 + 0.75 * key) + Vec3::splat(0.45 * shine)
    }
}

/// Maps 0 to 1 to colours from pale through yellow and red to nearly black, ever darker.
pub(super) fn warmth(heat: f32) -> Vec3 {
    const STEPS: [Vec3; 4] =
        [vec3(0.80, 0.80, 0.78), vec3(0.85, 0.52, 0.10), vec3(0.62, 0.08, 0.03), vec3(0.10, 0.01, 0.05)];
    let place = heat.clamp(0.0, 1.0) * (STEPS.len() - 1) as f32;
    let step = (place as usize).min(STEPS.len() - 2);
    STEPS[step].lerp(STEPS[step + 1], place - step as f32)
}

/// Returns the tone of a checker of two similar tones with a darker thread between the fields.
fn checker(field: Vec2) -> f32 {
    // Casts, because coordinates are not negative and rounding functions are calls on many processors.
    let (column, row) = (field.x as u32, field.y as u32);
    let tone = if (column + row).is_multiple_of(2) { 1.05 } else { 0.95 };
    let edge = (field - vec2(column as f32, row as f32) - 0.5).abs().max_element();
    if edge > 0.46 { tone * 0.86 } else { tone }
}

/// Returns the tone of a plane with lines between its fields.
fn lines(field: Vec2) -> f32 {
    let apart = (field - field.round()).abs().min_element();
    if apart < LINE.0 { LINE.1 } else { 1.0 }
}

/// Returns the number of checker fields per edge for a cloth of `cells` by `cells` edges.
pub(crate) fn fields_per_edge(cells: usize) -> f32 {
    FIELDS / cells.max(1) as f32
}

/// Returns the background at a height of the picture, from 0 at the top to 1 at the bottom.
pub(super) fn background(height: f32) -> Vec3 {
    let t = height * height * (3.0 - 2.0 * height);
    BACKGROUND[0].lerp(BACKGROUND[1], t)
}

/// Converts a linear colour to 8-bit sRGB.
pub(super) fn to_srgb(colour: Vec3) -> [u8; 3] {
    static TABLE: LazyLock<Vec<u8>> = LazyLock::new(|| (0..=BRIGHTEST * TONES).map(encode).collect());
    let tone = |x: f32| TABLE[(x.clamp(0.0, BRIGHTEST as f32) * TONES as f32 + 0.5) as usize];
    [tone(colour.x), tone(colour.y), tone(colour.z)]
}

/// Steps of the tone table from 0 to 1: fine enough to reach every 8-bit tone.
const TONES: usize = 1 << 13;
/// Largest linear value in the tone table.
const BRIGHTEST: usize = 2;

fn encode(tone: usize) -> u8 {
    let x = tone as f32 / TONES as f32;
    // Bright highlights roll off instead of clipping.
    let x = if x > 0.8 { 0.8 + 0.2 * (1.0 - (-(x - 0.8) / 0.2).exp()) } else { x };
    let y = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (255.0 * y + 0.5) as u8
}
