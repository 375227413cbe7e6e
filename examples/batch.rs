//! Four cloths advance together. They differ only in their resistance to stretch.

use fnopt::cloth::Material;
use fnopt::scene::Stiffness;
use fnopt::{Optimizer, Scene, Simulation, SimulationOptions, Weights};

const FRAMES: usize = 40;

fn main() -> fnopt::Result<()> {
    let stretch = [2000.0, 1000.0, 500.0, 250.0];
    let scenes = stretch.map(|stretch| {
        let stiffness = Stiffness::Grid(Material { stretch, ..Default::default() });
        Scene { stiffness, ..Default::default() }
    });
    let optimizer = Optimizer::learned(Weights::shipped());
    let options = SimulationOptions { iterations: Some(10), ..Default::default() };
    let mut simulation = Simulation::of(&scenes.each_ref(), &optimizer, &options)?;
    for _ in 0..FRAMES {
        simulation.step()?;
    }

    // Cloth b is the b-th part of the positions.
    let (positions, stats) = (simulation.positions(), &simulation.frame().stats);
    let cloths = positions.chunks_exact(simulation.particles());
    let mut lowest = Vec::new();
    for ((cloth, stats), stretch) in cloths.zip(stats).zip(stretch) {
        let bottom = cloth.iter().map(|p| p[1]).fold(f32::INFINITY, f32::min);
        let mean = 100.0 * stats.stretch_mean;
        println!("stretch {stretch:4}: lowest point {bottom:.4} m, mean stretch {mean:.2} %");
        lowest.push(bottom);
    }
    assert!(stats.iter().all(|s| s.is_finite()));
    assert!(lowest.is_sorted_by(|stiff, soft| stiff > soft), "softer cloths hang lower: {lowest:?}");
    Ok(())
}
