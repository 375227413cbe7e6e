//! Requirements on the shipped weights: every rollout is finite, with no edge away from a handle stretched
//! beyond the limit, and ten iterations come close to the minimum of a frame.
//!
//! The full check takes hours:
//! `fnopt evaluate --suite motions --solver fnopt --grid 32,64,100,128,48x32,32x100`, the same with
//! `--suite handles`, and `--iterations 5` on 32 and 64. These tests cover a part that takes seconds.

use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::cpu::Track;
use fnopt::eval::median_gap;
use fnopt::eval::suite::{Prepared, Suite};
use fnopt::network::Weights;
use fnopt::scene::Scene;
use fnopt::sim::Optimizer;
use std::ops::ControlFlow;

fn learned() -> Optimizer {
    Optimizer::paper(Weights::shipped())
}

/// Asserts that every case whose name begins with one of `names` is sound.
fn sound(suite: Suite, names: &[&str], (grid, frames, iterations): (Grid, usize, usize)) {
    let cases = suite.cases(grid).unwrap();
    for name in names {
        assert!(cases.iter().any(|case| case.name.starts_with(name)), "no case {name}");
    }
    for case in cases.into_iter().filter(|c| names.iter().any(|n| c.name.starts_with(n))) {
        let tick = || ControlFlow::Continue(());
        let name = case.name.clone();
        let prepared = Prepared::new(case, frames).unwrap();
        let ran = prepared.run((&learned(), iterations), &Device::Cpu, false, tick);
        let (score, trajectory) = ran.unwrap().expect("the run was interrupted");
        assert_eq!(trajectory.frames(), frames);
        let stretch = score.verdict;
        assert!(score.sound(), "{grid} {name}, {iterations} iterations: {stretch:.3?}");
    }
}

#[test]
fn sheets_swing_and_fall_without_tearing() {
    let square = |n: usize| Grid { h: n, w: n };
    sound(Suite::Motions, &["xy_v2", "rot_h0", "updown_opp"], (square(32), 100, 10));
    sound(Suite::Handles, &["diagonal", "single-center"], (square(32), 40, 10));
    sound(Suite::Motions, &["xyz_v3"], (square(32), 60, 5));
    // From a fresh hidden state, where whole components of the first gradient are zero.
    sound(Suite::Handles, &["corners flat", "single-corner flat"], (square(64), 15, 10));
    sound(Suite::Handles, &["corners flat", "diagonal drape"], (square(100), 6, 10));
    sound(Suite::Handles, &["single-center flat"], (square(128), 5, 10));
    sound(Suite::Handles, &["mid-edge drape"], (Grid { h: 48, w: 32 }, 20, 10));
}

/// On the first frames of the default scene, in absolute terms and against the classical method.
#[test]
fn ten_iterations_come_close_to_the_minimum() {
    for (n, frames, most, share) in [(32, 40, 0.015, 0.75), (64, 12, 0.05, 1.0)] {
        let mut scene = Scene::released();
        scene.regrid(Grid { h: n, w: n }).unwrap();
        let setup = scene.setup().unwrap();
        let controls = (1..=frames).map(|frame| setup.control(frame));
        let track = Track::new(&setup.model, setup.start.clone(), controls).unwrap();
        let tick = || ControlFlow::Continue(());
        let gap = |optimizer| {
            median_gap(&track, (&optimizer, 10), &Device::Cpu, tick)
                .unwrap()
                .expect("the run was interrupted")
        };
        let (learned, classical) = (gap(learned()), gap(Optimizer::quasi_newton()));
        println!("{n}x{n}: {learned:.4}, quasi-newton {classical:.4}");
        assert!(learned < most, "{n}x{n}: {learned:.4}");
        assert!(learned < share * classical, "{n}x{n}: {learned:.4}, quasi-newton {classical:.4}");
    }
}
