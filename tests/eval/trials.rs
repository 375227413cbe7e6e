//! Small scenes with a right answer, each from a kind of report that users of cloth simulators file.

use crate::common::{SETTINGS, shipped};
use fnopt::eval::{Fault, Sequence, Soundness, Verdict, compare};
use fnopt::io::Trajectory;
use fnopt::network::Weights;
use fnopt::scene::{Scene, Setup};
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};
use std::ops::ControlFlow;
use std::path::Path;

/// What a solver made of a scene.
struct Run {
    setup: Setup,
    trajectory: Trajectory,
    verdict: Verdict,
}

impl Run {
    fn of(document: &str, solver: &str) -> Self {
        let setup = Scene::parse(document, "trial", Path::new("")).unwrap().setup().unwrap();
        let (name, count) = solver.split_once(':').unwrap_or((solver, ""));
        let optimizer = Optimizer::named(name, "trial", || Ok(Weights::shipped())).unwrap();
        let iterations = count.parse().unwrap_or(optimizer.default_iterations());
        let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &optimizer, iterations).unwrap();
        simulator.set_state(&setup.start.cast());
        let (mut soundness, mut trajectory) = (Soundness::new(&setup), setup.trajectory().unwrap());
        let controls = (1..setup.frames()).map(|frame| setup.control(frame));
        simulator
            .rollout(controls, |frame| {
                soundness.judge(&frame);
                setup.push(&mut trajectory, &frame.state);
                ControlFlow::Continue(())
            })
            .unwrap();
        let verdict = soundness.verdict();
        Self { trajectory, verdict, setup }
    }

    fn sound(document: &str, solver: &str) -> Self {
        let run = Self::of(document, solver);
        assert!(run.verdict.is_sound(), "{solver}: {:?} in {document}", run.verdict.faults());
        run
    }

    /// Mean distance \[m\] between the particles in two frames.
    fn moved(&self, from: usize, to: usize) -> f64 {
        let (a, b) = (self.trajectory.frame(from), self.trajectory.frame(to));
        let distance = |(a, b): (&[f32; 3], &[f32; 3])| {
            a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
        };
        a.iter().zip(b).map(distance).sum::<f64>() / a.len() as f64
    }
}

/// Where a mixed-up trajectory has a particle, given a frame of the right one.
type Place<'a> = &'a dyn Fn(&[[f32; 3]], usize) -> [f32; 3];

#[test]
fn the_settled_start_is_at_rest() {
    for scene in [
        r#"{"motion": "none", "frames": 31}"#,
        r#"{"motion": "none", "frames": 31, "grid": [8, 8]}"#,
        r#"{"motion": "none", "frames": 31, "grid": [40, 60], "up": "z"}"#,
        r#"{"motion": "none", "frames": 16, "grid": [64, 64], "side_m": 2.5}"#,
        r#"{"motion": "none", "frames": 31, "grid": [48, 48], "material": "paper"}"#,
        r#"{"motion": "none", "frames": 31, "gravity": [3, -9, 0], "frame_time_s": 0.03}"#,
        r#"{"motion": "none", "frames": 31, "gravity": 0}"#,
        r#"{"motion": "none", "frames": 31, "material": {"stretch": 100, "shear": 8, "bend": 0.01}, "mass_kg": 2}"#,
    ] {
        let run = Run::sound(scene, "newton");
        let (first, all) = (run.moved(0, 1), run.moved(0, run.trajectory.frames() - 1));
        // Positions in metres are rounded to some 1e-8.
        assert!(first < 2e-7 && all < 2e-5, "{first:.1e} and {all:.1e} m in {scene}");
    }
}

/// A cloth without stiffness cannot hang: the start is the stored drape, and the fall is the scene's.
#[test]
fn a_cloth_that_nothing_holds_together_still_has_a_start() {
    let scene = r#"{"material": {"stretch": 0, "shear": 0, "bend": 0}, "motion": "none", "frames": 3}"#;
    let setup = Scene::parse(scene, "trial", Path::new("")).unwrap().setup().unwrap();
    assert!(setup.start.x.iter().all(|x| x.abs() < 40.0));
}

#[test]
fn a_sheet_held_along_a_whole_edge_hangs_still() {
    let edge = |n: usize, along_height: bool| {
        let places = (0..n).map(|k| if along_height { k * n } else { k }).map(|p| p.to_string());
        places.collect::<Vec<_>>().join(",")
    };
    for n in [24, 32, 48, 64] {
        let scene = format!(
            r#"{{"grid": [{n}, {n}], "start": "hanging", "handles": [{}], "motion": "none", "frames": 31}}"#,
            edge(n, true)
        );
        for solver in ["spectral", "fnopt", "newton", "lbfgs", "quasi-newton", "quasi-newton-exact"] {
            let run = Run::sound(&scene, solver);
            // It stretches by rho g L^2 / (2 Y), 0.6 mm.
            assert!(run.moved(0, 30) < 1e-3, "{solver}, {n}: {:.1e} m", run.moved(0, 30));
        }
    }
    // Held at five places of the edge, at the side i = 0, which hangs vertically, and all round.
    let five = [0, 4, 8, 12, 15].map(|k| (16 * k).to_string()).join(",");
    let all_round: Vec<String> = (0..256)
        .filter(|p| [0, 15].contains(&(p / 16)) || [0, 15].contains(&(p % 16)))
        .map(|p| p.to_string())
        .collect();
    for handles in [five, edge(16, false), all_round.join(",")] {
        let scene = format!(
            r#"{{"grid": [16, 16], "start": "hanging", "handles": [{handles}], "motion": "none", "frames": 31}}"#
        );
        for solver in ["spectral", "fnopt", "newton", "lbfgs", "quasi-newton", "quasi-newton-exact"] {
            Run::sound(&scene, solver);
        }
    }
}

#[test]
fn a_solver_that_does_not_reach_the_minimum_is_not_sound() {
    let fall = r#"{"start": "flat", "handles": [], "motion": "none", "wind": {"density": 0}, "frames": 61}"#;
    for solver in ["spectral", "fnopt", "newton", "quasi-newton", "lbfgs:1000"] {
        let run = Run::sound(fall, solver);
        // g T^2 n (n + 1) / 2 after n frames.
        let fallen = 9.8 / 3600.0 * 60.0 * 61.0 / 2.0;
        let most = if solver.starts_with("lbfgs") { 1e-3 } else { 2e-4 };
        assert!((run.moved(0, 60) / fallen - 1.0).abs() < most, "{solver}: {} m", run.moved(0, 60));
    }
    for solver in ["gd", "lbfgs:10"] {
        let run = Run::of(fall, solver);
        assert!(
            matches!(run.verdict.faults()[..], [Fault::Gap(gap)] if gap > 0.5),
            "{solver}: {:?}",
            run.verdict
        );
        assert!(run.verdict.faults()[0].to_string().contains("more iterations"));
    }
}

/// Uniform wind drives a flat sheet that nothing holds evenly, and one whose rows are reversed moves as its mirror image.
#[test]
fn uniform_wind_drives_a_free_sheet_evenly() {
    let flat = |reversed: bool| {
        let place = |p: usize| {
            let (i, j) = (p / 16, p % 16);
            let i = if reversed { 15 - i } else { i };
            [i as f64 / 15.0, 0.0, j as f64 / 15.0]
        };
        let vertices: Vec<[f64; 3]> = (0..256).map(place).collect();
        serde_json::json!({ "vertices": vertices, "grid": [16, 16] })
    };
    for solver in ["spectral", "fnopt", "newton", "quasi-newton"] {
        let [run, reversed] = [false, true].map(|reversed| {
            let scene = serde_json::json!({
                "grid": [16, 16], "handles": [], "motion": "none", "gravity": 0, "frames": 41, "start": flat(reversed),
                "wind": { "velocity": [0, 3, 0], "density": 1.2, "drag": 0 },
            });
            Run::sound(&scene.to_string(), solver)
        });
        let [last, mirrored] = [&run, &reversed].map(|run| run.trajectory.frame(40));
        let heights = last.iter().map(|p| p[1]);
        let (low, high) = heights.fold((f32::INFINITY, 0.0f32), |(low, high), y| (low.min(y), high.max(y)));
        assert!(low > 0.5 && high - low < 1e-4, "{solver}: from {low} to {high} m");
        for (p, of) in last.iter().enumerate() {
            let other = mirrored[(15 - p / 16) * 16 + p % 16];
            let far = of.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(far < 1e-4, "{solver}: particle {p} at {of:?}, mirrored {other:?}");
        }
    }
}

#[test]
fn nothing_moves_a_weightless_sheet() {
    let scene = r#"{"start": "flat", "motion": "none", "gravity": 0, "wind": {"density": 0}, "frames": 31}"#;
    for solver in ["spectral", "fnopt", "newton", "lbfgs", "quasi-newton", "adam", "gd"] {
        assert_eq!(Run::sound(scene, solver).moved(0, 30), 0.0, "{solver}");
    }
}

/// A light sheet in dense air, moved at a few metres per second.
#[test]
fn a_light_fast_sheet_stays_finite() {
    let scene = r#"{"motion": "updown", "speed": 4, "frames": 40, "frame_time_s": 0.0416667, "areal_mass_kg_m2": 0.02,
        "material": {"stretch_modulus": 280.2, "shear_modulus": 28, "bending_stiffness": 1.46e-05}, "wind": {"density": 1.2}}"#;
    for solver in ["spectral", "fnopt", "newton"] {
        Run::sound(scene, solver);
    }
}

/// Newton's method converges in the frames in which the sheet folds up, too.
#[test]
fn sudden_stops_converge() {
    for speed in [15.0, 30.0] {
        let row = |frame: usize| {
            let x = speed / 60.0 * frame.min(10) as f64;
            format!("[[{x}, 0.5, 0.45], [{x}, 0.5, -0.45]]")
        };
        let rows: Vec<String> = (0..30).map(row).collect();
        let run = Run::of(&format!(r#"{{"motion": [{}]}}"#, rows.join(",")), "newton");
        assert_eq!(run.verdict.unconverged, None, "at {speed} m/s");
        assert_eq!(run.trajectory.frames(), run.setup.frames());
    }
}

/// A trajectory in other units, along other axes or with its vertices in another order is named as such.
#[test]
fn a_mixed_up_trajectory_is_recognised_by_its_first_frame() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let truth = &sequence.truth;
    let grid = truth.grid();
    let refused = |of: Place| {
        let mut mixed = Trajectory::new(grid, truth.fps());
        for frame in 0..truth.frames() {
            let points: Vec<[f32; 3]> = (0..grid.particles()).map(|p| of(truth.frame(frame), p)).collect();
            mixed.push(&points, &points);
        }
        compare(&sequence, "theirs", &mixed, &SETTINGS).map_err(|error| error.to_string())
    };
    let said = |of: Place, part: &str| {
        let error = refused(of).unwrap_err();
        assert!(error.contains("theirs, xy_v2: frame 0") && error.contains(part), "{error}");
    };
    said(&|x, p| x[p].map(|c| 100.0 * c), "100 times too large");
    said(&|x, p| x[p].map(|c| c / 1000.0), "1000 times too small");
    said(&|x, p| [x[p][0], -x[p][2], x[p][1]], "our x, y, z are its x, z, -y");
    said(&|x, p| x[grid.w * (grid.h - 1 - p / grid.w) + p % grid.w], "rows in reverse order");
    said(&|x, p| x[grid.w * (p % grid.w) + p / grid.w], "rows and columns exchanged");
    // A start that is merely near is scored.
    refused(&|x, p| [x[p][0] + 0.01, x[p][1], x[p][2]]).unwrap();
    refused(&|x, p| [x[p][0] + 0.3, x[p][1], x[p][2]]).unwrap();
}
