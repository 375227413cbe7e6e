//! Four cloths advance together. They differ only in their resistance to stretch.

use fnopt::cloth::Material;
use fnopt::network::Weights;
use fnopt::scene::{Scene, Setup, Stiffness};
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};

const FRAMES: usize = 40;

fn main() -> fnopt::Result<()> {
    let stretch = [2000.0, 1000.0, 500.0, 250.0];
    let setups: Vec<Setup> = stretch
        .iter()
        .map(|&stretch| {
            let stiffness = Stiffness::Grid(Material { stretch, ..Default::default() });
            Scene { stiffness, ..Default::default() }.setup()
        })
        .collect::<fnopt::Result<_>>()?;
    let batch = Setup::batch(&setups)?;

    let optimizer = Optimizer::learned(Weights::shipped());
    let mut simulator = Simulator::new(&Device::Cpu, &batch.model, &optimizer, 10)?;
    simulator.set_state(&batch.start.cast());
    let mut frame = simulator.step(&batch.control(1))?;
    for f in 2..=FRAMES {
        frame = simulator.step(&batch.control(f))?;
    }

    // The state of cloth b is the b-th part of the batch's arrays. Its own setup converts it to metres.
    let cloths = frame.state.x.chunks_exact(3 * batch.model.grid.particles());
    let mut lowest = Vec::new();
    for ((setup, x), (stretch, stats)) in setups.iter().zip(cloths).zip(stretch.iter().zip(&frame.stats)) {
        let bottom = setup.vertices_m(x).iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
        println!(
            "stretch {stretch:4}: lowest point {bottom:.4} m, mean stretch {:.2} %",
            100.0 * stats.stretch_mean
        );
        lowest.push(bottom);
    }
    assert!(frame.stats.iter().all(|s| s.is_finite()));
    assert!(lowest.is_sorted_by(|stiff, soft| stiff > soft), "softer cloths hang lower: {lowest:?}");
    Ok(())
}
