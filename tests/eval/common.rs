//! Helpers shared by the tests of evaluation.

use fnopt::cloth::Material;
use fnopt::eval::{Entry, Physics, Settings};
use fnopt::scene::Stiffness;
use fnopt::sim::Optimizer;
use std::path::{Path, PathBuf};

pub fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/ground_truth")
}

pub const MATERIAL: Material = Material { stretch: 1000.0, shear: 8.0, bend: 0.5, ..Material::PAPER };
pub const PHYSICS: Physics =
    Physics { stiffness: Stiffness::Grid(MATERIAL), density: None, drag: None, frame_time_s: None };
pub const SETTINGS: Settings = Settings { physics: PHYSICS, own_material: true, points: 1000, frames: 25 };

pub fn newton() -> Entry {
    Entry { name: "newton".into(), optimizer: Optimizer::newton(), iterations: 1, coarse: false }
}

pub fn square(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}
