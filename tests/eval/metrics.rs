//! Metrics against brute force and closed forms.

use crate::common::square;
use crate::noise;
use fnopt::cloth::Grid;
use fnopt::eval;
use fnopt::eval::{chamfer, mean_and_deviation, relative_error, repulsion};
use safetensors::SafeTensors;
use std::path::Path;

/// Returns random points in the unit cube.
fn cloud(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let points = noise::noise(3 * count, seed);
    points.as_chunks().0.iter().map(|p: &[f64; 3]| p.map(|c| 0.5 * c + 0.5)).collect()
}

#[test]
fn chamfer_is_that_of_all_pairs() {
    let nearest = |from: &[[f64; 3]], to: &[[f64; 3]]| {
        let of = |&p: &[f64; 3]| to.iter().map(|&q| square(p, q)).fold(f64::INFINITY, f64::min);
        from.iter().map(of).sum::<f64>() / from.len() as f64
    };
    for (m, n) in [(1, 1), (300, 170), (2000, 2000)] {
        let (a, b) = (cloud(m, 1), cloud(n, 2));
        let expected = nearest(&a, &b) + nearest(&b, &a);
        assert!((chamfer(&a, &b) - expected).abs() < 1e-12 * expected, "{m} and {n} points");
        assert_eq!(chamfer(&a, &b), chamfer(&b, &a));
        assert_eq!(chamfer(&a, &a), 0.0);
    }
    // Two planes 0.1 apart, sampled alike: the nearest neighbour of each point is right above or below it.
    let plane = |z: f64| cloud(500, 3).iter().map(|p| [p[0], p[1], z]).collect::<Vec<_>>();
    assert!((chamfer(&plane(0.0), &plane(0.1)) - 2.0 * 0.01).abs() < 1e-12);
}

/// Random clouds of different sizes and scales, against the nearest neighbours of `scipy.spatial.cKDTree`.
#[test]
fn chamfer_is_that_of_scipy() {
    #[derive(serde::Deserialize)]
    struct Case {
        a: Vec<[f64; 3]>,
        b: Vec<[f64; 3]>,
        chamfer: f64,
    }
    let recorded: serde_json::Value =
        serde_json::from_str(include_str!("../data/chamfer_scipy.json")).unwrap();
    let cases: Vec<Case> = serde_json::from_value(recorded["cases"].clone()).unwrap();
    assert_eq!(cases.len(), 3);
    for Case { a, b, chamfer: expected } in cases {
        let found = chamfer(&a, &b);
        assert!((found - expected).abs() < 1e-12 * expected, "{found}, by scipy {expected}");
    }
}

#[test]
fn samples_are_uniform_by_area() {
    // Two triangles, one with three times the area of the other, and one without area.
    let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-3.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
    let faces = [[0, 1, 2], [0, 2, 3], [0, 1, 4]];
    let surface = eval::TriangleMesh { points: &points, faces: &faces };
    let samples = surface.sample(40_000, 7);
    assert_eq!(samples, surface.sample(40_000, 7), "the same seed");
    assert_ne!(samples[..10], surface.sample(10, 8)[..]);
    let right: Vec<_> = samples.iter().filter(|p| p[0] > 0.0).collect();
    // A share of 1/4, with a standard deviation of 0.0022.
    assert!((right.len() as f64 / 40_000.0 - 0.25).abs() < 0.01);
    assert!(samples.iter().all(|p| p[2] == 0.0 && p[1] >= 0.0 && p[1] <= 1.0));
    // The centroid of the right triangle is at a third of its sides.
    for axis in 0..2 {
        let mean = right.iter().map(|p| p[axis]).sum::<f64>() / right.len() as f64;
        assert!((mean - 1.0 / 3.0).abs() < 0.01, "{mean}");
    }
}

#[test]
fn relative_errors_and_deviations_have_closed_forms() {
    let truth = cloud(100, 4);
    let larger: Vec<[f64; 3]> = truth.iter().map(|p| p.map(|c| 1.02 * c)).collect();
    assert!((relative_error(&larger, &truth) - 0.02).abs() < 1e-12);
    assert_eq!(relative_error(&truth, &truth), 0.0);
    let (mean, deviation) = mean_and_deviation(&[1.0, 2.0, 3.0, 4.0]);
    assert!((mean - 2.5).abs() < 1e-12 && (deviation - (5.0f64 / 3.0).sqrt()).abs() < 1e-12);
    assert_eq!(mean_and_deviation(&[3.0]), (3.0, 0.0));
}

#[test]
fn repulsion_is_the_authors() {
    for name in ["repulsion_threshold0.5", "repulsion_threshold1.0"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.safetensors"));
        let bytes = std::fs::read(path).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let numbers = |name: &str| -> Vec<f64> {
            let data = file.tensor(name).unwrap();
            data.data().as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
        };
        let x = numbers("positions");
        let n = x.len() / 3;
        let points: Vec<[f64; 3]> = (0..n).map(|p| [x[p], x[n + p], x[2 * n + p]]).collect();
        let grid = Grid { h: 16, w: 16 };
        let found = repulsion(&points, &grid.faces(), numbers("threshold")[0]);
        let expected = numbers("energy")[0];
        assert!((found / expected - 1.0).abs() < 1e-12, "{name}: {found}, not {expected}");
    }
    let flat: Vec<[f64; 3]> = (0..64).map(|p| [(p % 8) as f64, (p / 8) as f64, 0.0]).collect();
    assert_eq!(repulsion(&flat, &Grid { h: 8, w: 8 }.faces(), 0.5), 0.0);
}
