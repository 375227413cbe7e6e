//! Scores of simulations and of other systems' trajectories, and which of them belong together.

use crate::common::{MATERIAL, PHYSICS, SETTINGS, newton, shipped, square};
use fnopt::cloth::{Grid, Material};
use fnopt::eval;
use fnopt::eval::{Entry, Format, Physics, Score, Sequence, Settings, belong_together, compare, run, tables};
use fnopt::io::Trajectory;
use fnopt::scene::Stiffness;
use fnopt::sim::{FrameStats, Optimizer};
use fnopt::{Device, Simulator};
use proptest::prelude::*;
use std::ops::ControlFlow;
use std::path::Path;

#[test]
fn a_sequence_is_repeated_from_its_first_frame() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    assert_eq!((sequence.truth.frames(), sequence.grid()), (391, Grid { h: 32, w: 32 }));
    for grid in [Grid { h: 32, w: 32 }, Grid { h: 20, w: 20 }] {
        let tick = || ControlFlow::Continue(());
        let (score, _) =
            run((&sequence, None), grid, &newton(), (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap();
        assert!(score.stable && score.frames == 24 && score.per_frame.e_cd.len() == 24);
        // The true cloth hangs at rest. Ours, with the default material, sags by a few centimetres.
        let (e_cd, e_3d) = (score.e_cd.unwrap(), score.e_3d.unwrap());
        assert!(e_cd < 8e-3 && e_3d < 0.25, "{grid}: {e_cd}, {e_3d}");
        assert!(score.ms_per_frame.unwrap() > 0.0 && score.gradient.unwrap() < 1e-2);
    }
    let stopped = run((&sequence, None), sequence.grid(), &newton(), (&Device::Cpu, &SETTINGS), || {
        ControlFlow::Break(())
    });
    assert!(stopped.unwrap().is_none());
}

/// The recordings rest for 30 frames before the handles move.
#[test]
fn handles_are_where_the_recording_has_them() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let (grid, settings) = (Grid { h: 8, w: 8 }, Settings { frames: 46, ..SETTINGS });
    let tick = || ControlFlow::Continue(());
    let setup = sequence.scene(grid, &PHYSICS).unwrap().setup().unwrap();
    let (score, found) =
        run((&sequence, None), grid, &newton(), (&Device::Cpu, &settings), tick).unwrap().unwrap();
    assert!(score.stable && found.frames() == 46);
    // At the end of a frame whose handles moved, Newton's gradient is that of rounding.
    assert!(score.gradient.unwrap() < 1e-5, "{:?}", score.gradient);
    let apart = |a: [f32; 3], b: [f32; 3]| square(a.map(f64::from), b.map(f64::from)).sqrt();
    for (k, &handle) in setup.model.cloths[0].handles.iter().enumerate() {
        for frame in [31, 45] {
            let mut x = setup.start.x.clone();
            (0..3).for_each(|c| x[64 * c + handle] = setup.handles[frame][k][c]);
            let target = setup.vertices_m(&x)[handle].map(|c| c as f32);
            let off = apart(found.frame(frame)[handle], target);
            assert!(off < 1e-5, "frame {frame}, handle {k}: {off}");
        }
        // s(t) = (1 - cos(pi t)) / 2 a quarter of a second into the first move.
        let moved = apart(found.frame(45)[handle], found.frame(0)[handle]);
        assert!((moved - 0.5 * (1.0 - 0.5f64.sqrt())).abs() < 1e-3, "handle {k} moved {moved} m");
    }
}

/// The figures of a score are means over the frames, each under its own name.
#[test]
fn energies_and_stretch_are_means_over_the_frames() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let (grid, settings) = (Grid { h: 8, w: 8 }, Settings { frames: 41, ..SETTINGS });
    let (optimizer, iterations) = (Optimizer::lbfgs(), 8);
    let entry = Entry { name: "x".into(), optimizer: optimizer.clone(), iterations, coarse: false };
    let tick = || ControlFlow::Continue(());
    let (score, _) = run((&sequence, None), grid, &entry, (&Device::Cpu, &settings), tick).unwrap().unwrap();
    let setup = sequence.scene(grid, &PHYSICS).unwrap().setup().unwrap();
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &optimizer, iterations).unwrap();
    simulator.set_state(&setup.start.cast());
    let stats: Vec<_> =
        (1..41).map(|frame| simulator.step(&setup.control(frame)).unwrap().stats[0].clone()).collect();
    let mean = |of: &dyn Fn(&FrameStats) -> f64| stats.iter().map(of).sum::<f64>() / 40.0;
    let near = |found: Option<f64>, expected: f64| {
        let found = found.unwrap();
        assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{found}, not {expected}");
    };
    near(score.energy, mean(&|s| s.energy.total()));
    near(score.stretch_mean, mean(&|s| s.stretch_mean));
    let terms = score.energy_terms.unwrap();
    near(Some(terms.stretch), mean(&|s| s.energy.stretch));
    near(Some(terms.shear), mean(&|s| s.energy.shear));
    near(Some(terms.bend), mean(&|s| s.energy.bend));
    near(Some(terms.inertia), mean(&|s| s.energy.inertia));
    near(Some(terms.external), mean(&|s| s.energy.external));
    assert!(terms.repulsion == 0.0 && terms.bend != terms.shear);
}

/// A flat sheet that rises by 0.1 m per frame, and its copy 0.1 m above: the errors of every frame are those
/// of two parallel sheets.
#[test]
fn each_frame_is_compared_with_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let grid = Grid { h: 9, w: 16 };
    let rising = |above: f32| {
        let mut sheet = Trajectory::new(grid, 60.0);
        for frame in 0..4 {
            let height = 0.1 * frame as f32 + above;
            let point = |p: usize| [(p % 16) as f32 / 8.0, height, (p / 16) as f32 / 8.0];
            let points: Vec<[f32; 3]> = (0..144).map(point).collect();
            sheet.push(&points, &points);
        }
        sheet
    };
    let to = folder.path().join("rising");
    rising(0.0).write(&to, "cloth_pos", fnopt::io::Format::Npy).unwrap();
    std::fs::write(to.join("meta.json"), r#"{"grid": [9, 16]}"#).unwrap();
    let sequence = Sequence::load(folder.path(), "rising").unwrap();
    let settings = Settings { frames: 4, ..SETTINGS };
    let compared = |above| compare(&sequence, "other", &rising(above), &settings).unwrap();
    let (same, apart) = (compared(0.0), compared(0.1));
    assert_eq!((same.per_frame.e_cd.len(), apart.per_frame.e_cd.len()), (3, 3));
    // The nearest of 1000 points on two square metres is about 0.02 m away, and the sum has two directions.
    assert!(same.per_frame.e_cd.iter().all(|&e| e < 5e-3), "{:?}", same.per_frame.e_cd);
    let parallel = 2.0 * 0.1f64.powi(2);
    let near = |e: f64| (parallel..parallel + 5e-3).contains(&e);
    assert!(apart.per_frame.e_cd.iter().all(|&e| near(e)), "{:?}", apart.per_frame.e_cd);
    // 0.1 m per frame.
    assert!((same.speed_at_end.unwrap() - 6.0).abs() < 1e-5, "{:?}", same.speed_at_end);
}

/// Speed at the end is that of the last half second.
#[test]
fn the_speed_at_the_end_leaves_out_the_beginning() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let mut sheet = Trajectory::new(sequence.grid(), 60.0);
    for frame in 0..45 {
        let height = if frame < 10 { 0.5 * frame as f32 } else { 4.5 + 0.01 * (frame - 9) as f32 };
        let points: Vec<_> = sequence.truth.frame(0).iter().map(|&[x, y, z]| [x, y + height, z]).collect();
        sheet.push(&points, &points);
    }
    let score = compare(&sequence, "rising", &sheet, &Settings { frames: 45, ..SETTINGS }).unwrap();
    assert!((score.speed_at_end.unwrap() - 0.6).abs() < 1e-3, "{:?}", score.speed_at_end);
}

#[test]
fn the_truth_compared_with_itself_is_exact() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let score = compare(&sequence, "itself", &sequence.truth, &SETTINGS).unwrap();
    assert_eq!(score.e_3d, Some(0.0));
    // Two samples of one surface: the error falls with the number of points.
    let more = Settings { points: 8000, ..SETTINGS };
    let closer = compare(&sequence, "itself", &sequence.truth, &more).unwrap();
    assert!(closer.e_cd.unwrap() < 0.3 * score.e_cd.unwrap() && score.e_cd.unwrap() < 2e-3);
    let longer = Settings { frames: 500, ..SETTINGS };
    assert_eq!(compare(&sequence, "itself", &sequence.truth, &longer).unwrap().frames, 390);
    let short = Trajectory::new(sequence.grid(), 60.0);
    let error = compare(&sequence, "short", &short, &SETTINGS).unwrap_err().to_string();
    assert!(error.contains("short, xy_v2: frames: expected at least 25"), "{error}");
    // Frames at other times cannot be compared.
    let mut slow = Trajectory::new(sequence.grid(), 30.0);
    (0..25).for_each(|f| slow.push(sequence.truth.frame(f), sequence.truth.frame(f)));
    let error = compare(&sequence, "slow", &slow, &SETTINGS).unwrap_err().to_string();
    assert!(error.contains("slow, xy_v2: fps: expected 60 frames per second, found 30"), "{error}");
}

/// Another system's cloth that is far away has diverged, as one of our own solvers would have. Tables show a
/// dash instead of a number.
#[test]
fn a_trajectory_that_exploded_has_diverged() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let moved = |metres: f32| {
        let mut trajectory = Trajectory::new(sequence.grid(), 60.0);
        for f in 0..25 {
            let mut frame = sequence.truth.frame(f).to_vec();
            frame[500][1] -= if f == 20 { metres } else { 0.0 };
            trajectory.push(&frame, &frame);
        }
        compare(&sequence, "theirs", &trajectory, &SETTINGS).unwrap()
    };
    let near = moved(0.1);
    assert!(near.stable && near.e_cd.is_some());
    let far = moved(1e3);
    assert!(!far.stable && far.e_cd.is_none() && far.e_3d.is_none());
    let overview = tables(&[far]).iter().map(|t| t.write(Format::Csv)).collect::<String>();
    assert!(overview.contains("\n32x32 theirs,1,-,,-,,"), "{overview}");
}

#[test]
fn interpolation_is_the_coarse_simulation_between_its_particles() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let descent = Entry { name: "gd".into(), optimizer: Optimizer::adam(), iterations: 5, coarse: false };
    let carried = Entry { name: "interpolation".into(), coarse: true, ..descent.clone() };
    let of = |n: usize, entry: &Entry| {
        let tick = || ControlFlow::Continue(());
        run((&sequence, None), Grid { h: n, w: n }, entry, (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap()
    };
    let (_, coarse) = of(32, &descent);
    assert_eq!(of(32, &carried).1.frame(24), coarse.frame(24), "its own grid");
    // Every other particle of 63 rows coincides with one of 32.
    let (score, fine) = of(63, &carried);
    assert_eq!((score.grid.as_str(), score.gradient, score.stretch_largest), ("63x63", None, None));
    for (p, found) in fine.frame(24).iter().enumerate().filter(|(p, _)| p / 63 % 2 == 0 && p % 63 % 2 == 0) {
        let at = coarse.frame(24)[p / 63 / 2 * 32 + p % 63 / 2];
        let near = (0..3).all(|c| (found[c] - at[c]).abs() < 1e-5);
        assert!(near, "particle {p}: {found:?}, not {at:?}");
    }
    assert_eq!(eval::coarse(Grid { h: 63, w: 125 }), Grid { h: 32, w: 63 });
}

#[test]
fn vertex_errors_are_distances_at_the_vertices() {
    let place = |n: usize, off: f32| -> Vec<[f32; 3]> {
        (0..n * n).map(|p| [(p % n) as f32 / (n - 1) as f32, (p / n) as f32 / (n - 1) as f32, off]).collect()
    };
    let (small, large) = (Grid { h: 9, w: 9 }, Grid { h: 20, w: 20 });
    let errors = eval::vertex_errors((&place(20, 0.25), large), (&place(9, 0.0), small));
    assert_eq!(errors.len(), 400);
    assert!(errors.iter().all(|error| (error - 0.25).abs() < 1e-6));
    let mut trajectory = Trajectory::new(small, 60.0);
    (0..9).for_each(|k| trajectory.push(&place(9, k as f32), &place(9, 0.0)));
    let kept = eval::snapshots(&trajectory, 9);
    let heights: Vec<f32> = (0..kept.frames()).map(|f| kept.frame(f)[0][2]).collect();
    assert_eq!(heights, [2.0, 4.0, 6.0, 8.0]);
    assert_eq!(eval::snapshots(&trajectory, 5).frame(3)[0][2], 4.0);
}

#[test]
fn repulsion_is_judged_on_the_grid_of_the_paper() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    // A sheet folded onto itself at half its height, 0.2 edges of the 32-row grid apart.
    let folded = |n: usize| {
        let grid = Grid { h: n, w: n };
        let mut trajectory = Trajectory::new(grid, 60.0);
        let place = |p: usize| {
            let [down, across] = [p / n, p % n].map(|k| k as f32 / (n - 1) as f32);
            let side = if down > 0.5 { 0.2 / 31.0 } else { 0.0 };
            [across, if down > 0.5 { 1.0 - down } else { down }, side]
        };
        let frame: Vec<_> = (0..n * n).map(place).collect();
        (0..3).for_each(|_| trajectory.push(&frame, &frame));
        compare(&sequence, "folded", &trajectory, &Settings { frames: 3, ..SETTINGS }).unwrap().repulsion
    };
    // Every other row and column of 63 coincides with one of 32.
    let [coarse, fine] = [32, 63].map(|n| folded(n).unwrap());
    assert!(coarse[0] > 1.0 && coarse[1] == 1.0);
    assert!((fine[0] / coarse[0] - 1.0).abs() < 1e-3, "{} and {}", fine[0], coarse[0]);
    // A sheet of fewer rows is measured on as many.
    let few = folded(16).unwrap();
    assert!((few[0] / coarse[0] - 1.0).abs() < 0.2, "{} and {}", few[0], coarse[0]);
}

/// Repulsion is measured in rest lengths, whatever the first frame looks like. There the corners are handles,
/// which stretch the edges next to them.
#[test]
fn repulsion_counts_in_edges_at_rest() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let folded = |corner: f32| {
        let mut trajectory = Trajectory::new(Grid { h: 32, w: 32 }, 60.0);
        // Folded onto itself at half its height, 0.2 edges apart.
        let place = |p: usize| {
            let (i, j) = (p / 32, p % 32);
            let (down, side) = if i < 16 { (i, 0.0) } else { (31 - i, 0.2 / 31.0) };
            [j as f32 / 31.0, down as f32 / 31.0, side]
        };
        let mut frame: Vec<_> = (0..1024).map(place).collect();
        (0..3).for_each(|k| {
            frame[0] = if k == 0 { [-corner, 0.0, 0.0] } else { place(0) };
            trajectory.push(&frame, &frame);
        });
        compare(&sequence, "folded", &trajectory, &Settings { frames: 3, ..SETTINGS })
            .unwrap()
            .repulsion
            .unwrap()
    };
    // Each of 480 particles and its partner across, in both orders: 30 of 32 rows have one at 0.2 edges. The two
    // rows at the fold are joined by edges.
    let expected = 960.0 * -(0.04f64 + 1e-8).ln();
    let found = folded(0.0);
    assert!(
        (found[0] / expected - 1.0).abs() < 1e-3 && found[1..] == [1.0, 1.0],
        "{found:?}, not {expected}"
    );
    assert_eq!(folded(0.5), found);
    // A trajectory without cells is an error, not a panic.
    let mut point = Trajectory::new(Grid { h: 1, w: 1 }, 60.0);
    (0..3).for_each(|_| point.push(&[[0.0; 3]], &[[0.0; 3]]));
    let error =
        compare(&sequence, "point", &point, &Settings { frames: 3, ..SETTINGS }).unwrap_err().to_string();
    assert!(error.contains("point, xy_v2: grid: expected a cell or more"), "{error}");
}

#[test]
fn only_scores_made_alike_are_merged() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let score = compare(&sequence, "itself", &sequence.truth, &SETTINGS).unwrap();
    let other = |change: &dyn Fn(&mut Score)| {
        let mut other = Score { sequence: "other".into(), ..score.clone() };
        change(&mut other);
        let (a, b) = (Path::new("a.json"), Path::new("b.json"));
        belong_together(&[(a, &score), (b, &other)]).map_err(|e| e.to_string())
    };
    assert_eq!(other(&|_| ()), Ok(()));
    // Different columns may come from different devices.
    let elsewhere = |s: &mut Score| s.made_with.kind = Some("gpu".into());
    assert_eq!(
        other(&|s| {
            elsewhere(s);
            s.iterations = 3;
        }),
        Ok(())
    );
    let softer = Settings {
        physics: Physics { stiffness: Stiffness::Grid(Material { bend: 0.1, ..MATERIAL }), ..PHYSICS },
        ..SETTINGS
    };
    type Change<'a> = (&'a str, &'a dyn Fn(&mut Score));
    let changes: [Change; 6] = [
        ("version", &|s| s.made_with.version = "0".into()),
        ("settings.material.bend", &|s| s.made_with.settings = softer.to_json()),
        ("device", &elsewhere),
        ("weights_crc32", &|s| s.made_with.weights_crc32 = Some("1".into())),
        ("score", &|s| s.sequence = score.sequence.clone()),
        ("truth_crc32", &|s| {
            (s.sequence, s.grid) = (score.sequence.clone(), "64x64".into());
            s.made_with.truth_crc32 = Some("1".into());
        }),
    ];
    for (field, change) in changes {
        let error = other(change).unwrap_err();
        let expected = [format!("b.json: {field}: expected"), "a.json".into()];
        expected.iter().for_each(|part| assert!(error.contains(part), "no '{part}' in {error}"));
    }
}

/// A score of the truth with itself, as it is kept.
fn kept() -> String {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let score = compare(&sequence, "itself", &sequence.truth, &Settings { frames: 3, ..SETTINGS }).unwrap();
    serde_json::to_string(&score).unwrap()
}

proptest! {
    #[test]
    fn damaged_scores_never_panic(
        at in any::<prop::sample::Index>(), text in "[\\[\\]{}\",:0-9eE+.nul-]{1,12}", longer in any::<bool>()
    ) {
        thread_local!(static KEPT: String = kept());
        let mut json = KEPT.with(String::clone);
        let from = at.index(json.len());
        let to = if longer { from } else { (from + text.len()).min(json.len()) };
        json.replace_range(from..to, &text);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("score.json");
        std::fs::write(&path, json).unwrap();
        if let Ok(score) = Score::read(&path) {
            for table in tables(&[score]) {
                for format in [Format::Text { bold: false }, Format::Markdown, Format::Csv] {
                    prop_assert!(!table.write(format).is_empty());
                }
            }
        }
    }
}
