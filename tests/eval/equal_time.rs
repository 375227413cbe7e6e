//! Energy gaps over the time of a frame.

use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::eval::suite::{CaseScore, Prepared, Suite, cases_of_iterations};
use fnopt::eval::{Entry, Format, GapCurve, GapPoint, gap_curves, gap_tables, timed_gap, track};
use fnopt::scene::Scene;
use fnopt::sim::Optimizer;
use serde_json::json;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// Builds a score with a gap and a time; infinite for a gap that is not finite.
fn score(grid: &str, iterations: usize, gap: f64, ms: f64) -> CaseScore {
    let made_with = json!({
        "version": "0", "truth_crc32": null, "settings": {"gap": true}, "device": "cpu", "kind": "cpu",
        "weights_crc32": null,
    });
    serde_json::from_value(json!({
        "case": "c", "grid": grid, "iterations": iterations, "stable": true,
        "gap": gap.is_finite().then_some(gap), "gap_ms_per_frame": ms, "ms_per_frame": 1e3, "made_with": made_with,
    }))
    .unwrap()
}

fn curve(points: &[[f64; 2]]) -> GapCurve {
    let point = |&[ms_per_frame, gap]: &[f64; 2]| GapPoint { iterations: 1, gap, ms_per_frame };
    GapCurve { solver: "s".into(), points: points.iter().map(point).collect() }
}

#[test]
fn a_gap_is_interpolated_in_logarithms_and_not_beyond_what_was_measured() {
    let curve = |points: &[[f64; 2]]| curve(points);
    let near = |found: Option<f64>, gap: f64| found.is_some_and(|found| (found / gap - 1.0).abs() < 1e-12);
    let falling = curve(&[[1.0, 0.1], [4.0, 1e-3], [64.0, 1e-4]]);
    for (ms, gap) in [(1.0, 0.1), (2.0, 1e-2), (4.0, 1e-3), (16.0, 1e-3 * 0.1f64.sqrt()), (64.0, 1e-4)] {
        assert!(near(falling.at(ms), gap), "{ms}: {:?}", falling.at(ms));
    }
    assert_eq!([0.999, 64.001, f64::NAN].map(|ms| falling.at(ms)), [None; 3]);
    // Between a gap and none there is nothing to interpolate; at the points there is what was measured.
    let broken = curve(&[[1.0, 0.1], [2.0, f64::INFINITY], [3.0, 0.2], [4.0, -1e-9], [5.0, 0.0]]);
    assert_eq!([1.5, 2.0, 2.5, 3.5, 4.5].map(|ms| broken.at(ms)), [None; 5]);
    assert_eq!([3.0, 4.0, 5.0].map(|ms| broken.at(ms)), [Some(0.2), Some(-1e-9), Some(0.0)]);
    // Two that take as long: the first.
    assert_eq!(curve(&[[1.0, 0.3], [1.0, 0.2]]).at(1.0), Some(0.3));
    assert_eq!(curve(&[]).at(1.0), None);
}

#[test]
fn gaps_are_tabulated_with_their_times_and_at_equal_time() {
    let scores = [
        ("quick", score("8x8", 5, 0.2, 1.0)),
        ("slow", score("8x8", 5, 0.1, 4.0)),
        ("quick", score("8x8", 20, 0.002, 4.0)),
        // The nearest to ten iterations is 8.
        ("quick", score("8x8", 8, 0.02, 2.0)),
        ("slow", score("8x8", 10, 0.05, 9.0)),
        ("wild", score("8x8", 10, f64::INFINITY, 3.0)),
        ("newton", score("8x8", 0, 1e-9, 5.0)),
        ("slow", score("9x8", 5, 0.1, 4.0)),
        // Without a gap that was requested, there is none.
        ("slow", CaseScore { gap_ms_per_frame: None, ..score("10x8", 5, 0.1, 4.0) }),
    ];
    let curves = gap_curves(scores.iter().map(|(solver, score)| (*solver, score)));
    assert_eq!(curves.iter().map(|of| &*of.grid).collect::<Vec<_>>(), ["8x8", "9x8"]);
    assert_eq!(curves[0].solvers[0].points.iter().map(|p| p.iterations).collect::<Vec<_>>(), [5, 8, 20]);
    let tables = gap_tables(&curves);
    let text: Vec<String> = tables.iter().map(|table| table.write(Format::Markdown)).collect();
    assert_eq!(text.len(), 3, "{text:?}");
    let rows = |k: usize| -> Vec<&str> { text[k].lines().skip(4).collect() };
    let measured = [
        "| quick, N = 5 | 20.0 | 1.00 |",
        "| quick, N = 8 | 2.00 | 2.00 |",
        "| quick, N = 20 | 0.200 | 4.00 |",
        "| slow, N = 5 | 10.0 | 4.00 |",
        "| slow, N = 10 | 5.00 | 9.00 |",
        "| wild, N = 10 | - | 3.00 |",
        "| newton | 0 | 5.00 |",
    ];
    assert_eq!(rows(0), measured);
    // At 5 ms quick is out of its range, and wild has no gap at all. What is alone is not the best.
    let slow = 10.0 * 0.5f64.powf(1.25f64.ln() / 2.25f64.ln());
    let at_equal_time = [
        "| 2.00 ms (quick, N = 8) | 2.00 |  |  |  |".to_owned(),
        format!("| 3.00 ms (wild, N = 10) | {:.3} |  |  |  |", 2.0 * 0.1f64.powf(1.5f64.ln() / 2.0f64.ln())),
        format!("| 5.00 ms (newton) |  | {slow:.2} |  | **0** |"),
        "| 9.00 ms (slow, N = 10) |  | 5.00 |  |  |".to_owned(),
    ];
    assert_eq!(rows(1), at_equal_time);
    assert!(text[1].contains("8x8: energy gap [%] at equal time") && text[1].contains("| quick | slow |"));
    // A single solver is compared with none.
    assert_eq!(rows(2), ["| slow, N = 5 | 10.0 | 4.00 |"]);
}

#[test]
fn a_solver_takes_part_with_its_own_numbers_of_iterations() {
    let entry = |name: &str, optimizer: Optimizer, iterations| Entry {
        name: name.into(),
        optimizer,
        iterations,
        coarse: false,
    };
    let (gd, lbfgs) = (Optimizer::gradient_descent, Optimizer::lbfgs);
    let entries = [
        entry("newton", Optimizer::newton(), 1),
        entry("gd", gd(), 20),
        entry("lbfgs", lbfgs(), 3),
        entry("gd", gd(), 3),
    ];
    let cases = cases_of_iterations(Grid { h: 8, w: 12 }, &entries).unwrap();
    let of: Vec<_> = cases
        .iter()
        .map(|case| {
            let own = entries.iter().filter(|entry| case.is_of(entry)).map(|entry| &*entry.name);
            (&*case.name, case.iterations, own.collect::<Vec<_>>())
        })
        .collect();
    let expected = [
        ("3 iterations", Some(3), vec!["lbfgs", "gd"]),
        ("20 iterations", Some(20), vec!["gd"]),
        ("converged", None, vec!["newton"]),
    ];
    assert_eq!(of, expected);
    assert_eq!(cases[2].scene.setup().unwrap().model.grid, Grid { h: 8, w: 12 });
    assert_eq!(cases_of_iterations(Grid { h: 8, w: 8 }, &entries[1..]).unwrap().len(), 2);
}

/// The time is that of the frames alone: what runs between them, such as the call of every frame, is not in it.
#[test]
fn the_time_of_a_gap_is_that_of_its_frames_alone() {
    let mut scene = Scene { frames: Some(6), ..Scene::released() };
    scene.regrid(Grid { h: 8, w: 8 }).unwrap();
    let go_on = || ControlFlow::Continue(());
    let track = track(&scene.setup().unwrap(), go_on).unwrap().unwrap();
    let pause = Duration::from_millis(250);
    let begun = Instant::now();
    let slow = || {
        std::thread::sleep(pause);
        ControlFlow::Continue(())
    };
    let found = timed_gap(&track, (&Optimizer::lbfgs(), 2), &Device::Cpu, slow).unwrap().unwrap();
    assert!(begun.elapsed() >= 5 * pause);
    assert!(found.ms_per_frame > 0.0 && found.ms_per_frame < 250.0, "{found:?}");
    assert!(found.median > 0.0 && found.median < 1.0, "{found:?}");
    // More iterations reach more. (That they take longer, other programs on the machine can hide.)
    let more = timed_gap(&track, (&Optimizer::lbfgs(), 500), &Device::Cpu, go_on).unwrap().unwrap();
    assert!(more.ms_per_frame > 0.0 && more.median < found.median, "{more:?}, {found:?}");
    let ended = timed_gap(&track, (&Optimizer::lbfgs(), 2), &Device::Cpu, || ControlFlow::Break(()));
    assert_eq!(ended.unwrap(), None);
}

/// Converged frames that were taken over are those of the scene, and only where the scene is the same.
#[test]
fn a_case_takes_over_the_converged_frames_of_the_same_scene_only() {
    let tick = || ControlFlow::Continue(());
    let of = |suite: Suite, name: &str| {
        let cases = suite.cases(Grid { h: 8, w: 8 }).unwrap();
        Prepared::new(cases.into_iter().find(|case| case.name == name).unwrap(), 45).unwrap()
    };
    let run = |prepared: &Prepared| {
        let score = prepared.run((&Optimizer::lbfgs(), 4), &Device::Cpu, true, tick).unwrap().unwrap().0;
        score.gap.unwrap()
    };
    let (three, five) = (of(Suite::Iterations, "3 iterations"), of(Suite::Iterations, "5 iterations"));
    let alone = (run(&three), run(&five), run(&of(Suite::Speeds, "speed 2")));
    assert!(alone.0 > alone.1, "{alone:?}");
    let five = of(Suite::Iterations, "5 iterations").after(three);
    assert_eq!(run(&five), alone.1);
    let fast = of(Suite::Speeds, "speed 2").after(five);
    assert_eq!(run(&fast), alone.2);
}
