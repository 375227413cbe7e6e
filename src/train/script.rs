//! The random properties of a cloth in a pool: its material, its start, its handles and their motion.

use super::config::{MotionRanges, PoolConfig, Range};
use super::pool::MAX_HANDLES;
use super::random::{Purpose, generator};
use crate::cloth::{Cloth, Grid, Material};
use glam::{DMat3, DVec3, EulerRot};
use rand::{Rng, RngExt, rngs::ChaCha8Rng};
use std::f64::consts::TAU;

/// Height in edges of the sheet that the ranges of a configuration refer to, the paper's 32x32.
const PAPER_EDGES: f64 = 31.0;
/// Largest initial angle about each axis \[rad\]: a full turn either way.
const START_ANGLE: f64 = TAU;

/// One life of a cloth, from its start to its reset. Handle positions depend only on the frame number.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// Material, gravity and handles.
    pub cloth: Cloth,
    /// Handle positions in the sheet at rest \[edges\].
    anchors: Vec<DVec3>,
    /// Yaw, pitch and roll at the start \[rad\].
    angles: DVec3,
    /// Increment of the angles per frame [rad / frame].
    spin: DVec3,
    /// Amplitude of the translation \[edges\].
    amplitude: DVec3,
    /// Angular frequency of the translation [rad / frame].
    frequency: DVec3,
    /// Angular frequency of the pinch [rad / frame].
    pinch_frequency: f64,
    /// Depth of the pinch.
    pinch: f64,
    /// Fraction of its velocity that the cloth loses per frame.
    pub damping: f64,
}

impl Script {
    /// Draws life number `generation` of the cloth in `slot` of pool `pool`, in a run with this seed.
    pub fn new(
        seed: u64,
        motion: &MotionRanges,
        (pool, config): (usize, &PoolConfig),
        (slot, generation): (usize, u32),
    ) -> Self {
        let grid = config.grid;
        // A grid with more rows is the same sheet with shorter edges.
        let size = (grid.h - 1) as f64 / PAPER_EDGES;
        let mut random = generator(seed, Purpose::Material { pool }, slot as u64);
        let ranges = config.material;
        let [stretch, shear, bend] =
            [ranges.stretch, ranges.shear, ranges.bend].map(|range| log_uniform(&mut random, range));
        let mut random = generator(seed, Purpose::Life { pool, generation }, slot as u64);
        let mut within =
            |largest: f64| DVec3::from_array([(); 3].map(|()| around_zero(&mut random, largest)));
        let angles = within(START_ANGLE);
        let spin = within(motion.rotation);
        let amplitude = within(motion.amplitude * size);
        let frequency = within(motion.frequency);
        let pinch_frequency = around_zero(&mut random, motion.frequency);
        let moves = if random.random_bool(motion.moving) { 1.0 } else { 0.0 };
        let gravity = direction(&mut random);
        let corners = config.corners.unwrap_or(motion.corners);
        let handles = handles(&mut random, grid, corners, motion.more_handles);
        let (angles, gravity) = match random.random_bool(motion.aligned) {
            true => (DVec3::ZERO, along_an_axis(gravity)),
            false => (angles, gravity),
        };
        Self {
            anchors: handles.iter().map(|&p| grid.rest(p).into()).collect(),
            cloth: Cloth {
                material: Material { stretch, shear, bend, ..Material::PAPER },
                gravity: (gravity * motion.gravity * size).into(),
                handles,
                ..Cloth::default()
            },
            angles,
            spin: moves * spin,
            amplitude: moves * amplitude,
            frequency,
            pinch_frequency,
            pinch: moves * motion.pinch,
            damping: motion.damping * random.random::<f64>(),
        }
    }

    /// Returns the rotation from the sheet at rest to its start, as the rows of a matrix: `x = R rest`.
    pub fn start(&self) -> [[f64; 3]; 3] {
        self.rotation(0.0).transpose().to_cols_array_2d()
    }

    /// Returns the handle positions at the end of frame `frame` \[edges\]; frame 0 is the start. Applies
    /// first the pinch, then the rotation, both about the midpoint of the edge j = 0, then the translation.
    pub fn targets(&self, frame: u32) -> Vec<[f64; 3]> {
        let t = f64::from(frame);
        let scale = 1.0 - self.pinch + self.pinch * (self.pinch_frequency * t).cos();
        let rotation = self.rotation(t) * scale;
        let translation = self.amplitude * (self.frequency * t).map(f64::sin);
        self.anchors.iter().map(|&anchor| (rotation * anchor + translation).to_array()).collect()
    }

    /// Returns the rotation at time `t`: yaw about z, pitch about y, roll about x, each advanced by its spin.
    fn rotation(&self, t: f64) -> DMat3 {
        let [yaw, pitch, roll] = (self.angles + self.spin * t).to_array();
        DMat3::from_euler(EulerRot::ZYX, yaw, pitch, roll)
    }
}

/// Draws the handles: the corners (0, 0) and (H-1, 0) or one particle, then one more particle for as long as
/// a biased coin says so.
fn handles(random: &mut ChaCha8Rng, grid: Grid, corners: f64, more: f64) -> Vec<usize> {
    let mut handles = match random.random_bool(corners) {
        true => vec![0, (grid.h - 1) * grid.w],
        false => vec![random.random_range(0..grid.particles())],
    };
    while handles.len() < MAX_HANDLES && random.random_bool(more) {
        let p = random.random_range(0..grid.particles());
        if !handles.contains(&p) {
            handles.push(p);
        }
    }
    handles
}

/// Draws a uniform number between `-largest` and `largest`.
fn around_zero(random: &mut ChaCha8Rng, largest: f64) -> f64 {
    largest * (2.0 * random.random::<f64>() - 1.0)
}

/// Draws a number whose logarithm is uniform.
fn log_uniform(random: &mut ChaCha8Rng, [smallest, largest]: Range) -> f64 {
    (smallest.ln() + (largest / smallest).ln() * random.random::<f64>()).exp().clamp(smallest, largest)
}

/// Draws a uniformly distributed direction.
fn direction(random: &mut impl Rng) -> DVec3 {
    let up = 2.0 * random.random::<f64>() - 1.0;
    let (sin, cos) = (TAU * random.random::<f64>()).sin_cos();
    let across = (1.0 - up * up).sqrt();
    DVec3::new(across * cos, across * sin, up)
}

/// Returns the axis closest to a direction, with its sign.
fn along_an_axis(direction: DVec3) -> DVec3 {
    let size = direction.abs();
    let axis = if size.x >= size.y.max(size.z) {
        DVec3::X
    } else if size.y >= size.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    axis * direction.dot(axis).signum()
}
