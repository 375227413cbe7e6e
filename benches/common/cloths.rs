//! What frames are measured of.

use fnopt::network::Weights;
use fnopt::scene::{Batch, Scene, Setup};
use fnopt::sim::{Grid, Optimizer};

/// The learned optimizer with the weights that come with the program.
pub fn learned() -> Optimizer {
    Optimizer::learned(Weights::shipped())
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
