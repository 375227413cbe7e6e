//! Helpers shared by the tests of scenes.

use fnopt::cloth::Grid;
use fnopt::scene::{Scene, Setup};
use ndarray_npy::ReadNpyExt;
use std::path::{Path, PathBuf};

pub fn assets(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name)
}

pub fn read(name: &str) -> ndarray::Array3<f32> {
    ndarray::Array3::read_npy(std::fs::File::open(assets(name)).unwrap()).unwrap()
}

pub fn parse(text: &str) -> fnopt::Result<Scene> {
    Scene::parse(text, "scene.json", &assets("scenes"))
}

/// Returns the error of a scene that must be refused when it is parsed or set up.
pub fn refusal(text: &str) -> String {
    parse(text).and_then(|s| s.setup()).map(|_| ()).expect_err(text).to_string()
}

pub fn expect_refusal(text: &str, parts: &[&str]) {
    let error = refusal(text);
    for part in parts {
        assert!(error.contains(part), "'{part}' is missing from: {error}");
    }
}

pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt()
}

/// Returns the lengths of the edges, in rest lengths, along the height and along the width.
pub fn edges(setup: &Setup) -> [Vec<f64>; 2] {
    let Grid { h, w } = setup.model.grid;
    let at = |i: usize, j: usize| std::array::from_fn(|c| setup.start.x[(c * h + i) * w + j]);
    let along = |di: usize, dj: usize| {
        let cells = (0..h - di).flat_map(move |i| (0..w - dj).map(move |j| (i, j)));
        cells.map(|(i, j)| distance(at(i, j), at(i + di, j + dj))).collect()
    };
    [along(1, 0), along(0, 1)]
}

pub fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len() as f64
}
