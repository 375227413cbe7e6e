//! The cloths whose frames are measured.

use fnopt::cloth::Grid;
use fnopt::network::Weights;
use fnopt::scene::{Batch, Scene, Setup};
use fnopt::sim::Optimizer;

/// Returns the learned optimizer with the weights that ship with the program.
pub fn learned() -> Optimizer {
    Optimizer::paper(Weights::shipped())
}

/// Returns `batch` cloths of the default scene on an `n` by `n` grid.
pub fn cloths(n: usize, batch: usize) -> Batch {
    let mut scene = Scene::released();
    scene
        .regrid(Grid::new(n, n, "bench").expect("a grid of a benchmark"))
        .expect("the default scene fits any grid");
    let setup = scene.setup().expect("the default scene is good");
    Setup::batch(&vec![setup; batch]).expect("equal scenes make a batch")
}
