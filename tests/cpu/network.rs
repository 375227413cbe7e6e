//! The network against the authors' implementation.

use crate::golden::{Golden, narrowed, relative_error, weights, widened};
use fnopt::cloth::Grid;
use fnopt::cpu::operator::{Network, Stage};

/// Largest error allowed, over the largest magnitude.
const TOLERANCE: f64 = 2e-5;

fn grid_of(golden: &Golden) -> (Grid, usize) {
    let shape = golden.shape("input");
    (Grid { h: shape[2], w: shape[3] }, shape[0])
}

fn check(file: &str) {
    let golden = Golden::open(file);
    let (grid, samples) = grid_of(&golden);
    let (weights, input) = (weights(), golden.get("input"));
    let mut double = Network::<f64>::new(&weights, grid, samples).unwrap();
    double.forward_observed(&input, &mut |stage, values| {
        let name = match stage {
            Stage::Embedded => "embedded".to_owned(),
            Stage::Lifted => "lifted".to_owned(),
            Stage::Block(n) => format!("block{n}"),
        };
        if golden.has(&name) {
            let error = relative_error(values, &golden.get(&name));
            assert!(error < TOLERANCE, "{file}: {name}: {error}");
        }
    });
    let mut single = Network::<f32>::new(&weights, grid, samples).unwrap();
    single.forward(&narrowed(&input));
    let results = [
        ("field", widened(single.field()), double.field()),
        ("scalar", widened(single.scalar()), double.scalar()),
    ];
    for (name, single, double) in results {
        for (kind, values) in [("f32", &single[..]), ("f64", double)] {
            let error = relative_error(values, &golden.get(name));
            assert!(error < TOLERANCE, "{file}: {name} in {kind}: {error}");
        }
    }
}

#[test]
fn every_stage_agrees_with_the_authors() {
    check("network_forward_16x24");
}

#[test]
fn odd_sizes_keep_modes_in_their_place() {
    check("network_forward_33x47");
}

/// Folding multiplies one layer into another. The network stays the same, up to the rounding of the products.
#[test]
fn folded_weights_make_the_same_network() {
    let golden = Golden::open("network_forward_33x47");
    let (grid, samples) = grid_of(&golden);
    let (weights, input) = (weights(), golden.get("input"));
    let folded = weights.folded();
    assert!(folded.is_folded() && !weights.is_folded());
    assert_eq!(folded.folded(), folded);
    let double = |weights| {
        let mut network = Network::<f64>::new(weights, grid, samples).unwrap();
        network.forward(&input);
        (network.field().to_vec(), network.scalar().to_vec())
    };
    let ((field, scalar), (found_field, found_scalar)) = (double(&weights), double(&folded));
    assert!(relative_error(&found_field, &field) < 1e-6 && found_scalar == scalar);
    let mut single = Network::<f32>::new(&folded, grid, samples).unwrap();
    single.forward(&narrowed(&input));
    assert!(relative_error(&widened(single.field()), &field) < TOLERANCE);

    // If the shapes do not allow folding, the weights are unchanged.
    let config = fnopt::network::Config { projection: 32, ..weights.config };
    let other = fnopt::network::Weights::zeros(config);
    assert_eq!(other.folded(), other);
}

#[test]
fn batches_equal_single_samples_bit_for_bit() {
    let golden = Golden::open("network_forward_16x24");
    let (grid, _) = grid_of(&golden);
    let first = narrowed(&golden.get("input"));
    let len = first.len();
    let input: Vec<f32> = (0..4 * len).map(|k| first[k % len] * (1.0 + (k / len) as f32)).collect();
    let weights = weights();
    let mut batch = Network::<f32>::new(&weights, grid, 4).unwrap();
    batch.forward(&input);
    let mut single = Network::<f32>::new(&weights, grid, 1).unwrap();
    for (s, input) in input.chunks(len).enumerate() {
        single.forward(input);
        assert_eq!(single.field(), &batch.field()[s * grid.particles()..][..grid.particles()]);
        assert_eq!(single.scalar()[0], batch.scalar()[s]);
    }
}

#[test]
fn too_small_a_grid_is_refused() {
    let error = Network::<f32>::new(&weights(), Grid { h: 8, w: 7 }, 1).err().unwrap().to_string();
    assert_eq!(error, "network: grid: expected at least 8x8 for 8x5 modes, found 8x7");
}
