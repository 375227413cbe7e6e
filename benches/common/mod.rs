//! What the benches share.

use criterion::Criterion;
use fnopt::gpu::{AdapterChoice, AdapterKind, Context};
use fnopt::network::Weights;
use fnopt::scene::{Batch, Scene, Setup};
use fnopt::sim::{Grid, Optimizer};
use std::time::Duration;

const WEIGHTS: &[u8] = include_bytes!("../../assets/weights/starter.safetensors");

/// Few samples and a short time each: a software adapter takes up to a second for a frame.
pub fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args()
}

/// The best adapter, a software one included; without any the reason is printed.
pub fn adapter() -> Option<Context> {
    match Context::headless(&AdapterChoice::Best) {
        Ok(context) => Some(context),
        Err(error) => {
            eprintln!("nothing is measured on a GPU: {error}");
            None
        }
    }
}

/// Whether it runs on the host's processor.
pub fn is_software(context: &Context) -> bool {
    context.kind() == AdapterKind::Software
}

/// The learned optimizer with the weights that come with the program.
pub fn learned() -> Optimizer {
    let weights =
        Weights::from_bytes(WEIGHTS, "starter weights").expect("the weights that come along are good");
    Optimizer::learned(weights)
}

/// `batch` cloths of the default scene on a grid of `n` by `n`.
pub fn cloths(n: usize, batch: usize) -> Batch {
    let mut scene = Scene::default();
    scene
        .regrid(Grid::new(n, n, "bench").expect("a grid of a benchmark"))
        .expect("the default scene fits any grid");
    let setup = scene.setup().expect("the default scene is good");
    Setup::batch(&vec![setup; batch]).expect("equal scenes make a batch")
}
