//! Sequences as they are read, their scores and tables, and the search for a material; `metrics` has the measures.

mod metrics;
#[path = "../noise/mod.rs"]
mod noise;
mod repeats;

use crate::metrics::square;
use fnopt::eval;
use fnopt::eval::fit::{Fit, Surface};
use fnopt::eval::{Entry, Format, Physics, Score, Sequence, Settings, belong_together, compare, run, tables};
use fnopt::io::{ReadOptions, Trajectory};
use fnopt::scene::{Scene, Stiffness};
use fnopt::sim::{Device, Grid, Material, Optimizer, Simulator, State};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/ground_truth")
}

const MATERIAL: Material = Material { stretch: 1000.0, shear: 8.0, bend: 0.5 };
const PHYSICS: Physics =
    Physics { stiffness: Stiffness::Grid(MATERIAL), density: None, drag: None, frame_time_s: None };
const SETTINGS: Settings = Settings { physics: PHYSICS, points: 1000, frames: 25 };

fn newton() -> Entry {
    Entry { name: "newton".into(), optimizer: Optimizer::Newton, iterations: 1, coarse: false }
}

#[test]
fn a_sequence_is_repeated_from_its_first_frame() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    assert_eq!((sequence.truth.frames(), sequence.grid()), (391, Grid { h: 32, w: 32 }));
    for grid in [Grid { h: 32, w: 32 }, Grid { h: 20, w: 20 }] {
        let tick = || ControlFlow::Continue(());
        let (score, _) =
            run((&sequence, None), grid, &newton(), (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap();
        assert!(score.stable && score.frames == 24 && score.per_frame.e_cd.len() == 24);
        // The true cloth hangs at rest; ours, of the default material, sags by a few centimetres.
        let (e_cd, e_3d) = (score.e_cd.unwrap(), score.e_3d.unwrap());
        assert!(e_cd < 8e-3 && e_3d < 0.25, "{grid}: {e_cd}, {e_3d}");
        assert!(score.ms_per_frame.unwrap() > 0.0 && score.gradient.unwrap() < 1e-2);
    }
    let stopped = run((&sequence, None), sequence.grid(), &newton(), (&Device::Cpu, &SETTINGS), || {
        ControlFlow::Break(())
    });
    assert!(stopped.unwrap().is_none());
}

#[test]
fn the_truth_compared_with_itself_is_exact() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let score = compare(&sequence, "itself", &sequence.truth, &SETTINGS).unwrap();
    assert_eq!(score.e_3d, Some(0.0));
    // Two samples of one surface; more points come closer.
    let more = Settings { points: 8000, ..SETTINGS };
    let closer = compare(&sequence, "itself", &sequence.truth, &more).unwrap();
    assert!(closer.e_cd.unwrap() < 0.3 * score.e_cd.unwrap() && score.e_cd.unwrap() < 2e-3);
    let longer = Settings { frames: 500, ..SETTINGS };
    assert_eq!(compare(&sequence, "itself", &sequence.truth, &longer).unwrap().frames, 390);
    let short = Trajectory::new(sequence.grid(), 60.0);
    let error = compare(&sequence, "short", &short, &SETTINGS).unwrap_err().to_string();
    assert!(error.contains("short, xy_v2: frames: expected at least 25"), "{error}");
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
    // Every other particle of 63 rows is one of 32.
    let (score, fine) = of(63, &carried);
    assert_eq!((score.grid.as_str(), score.gradient, score.stretch_largest), ("63x63", None, None));
    for (p, found) in fine.frame(24).iter().enumerate().filter(|(p, _)| p / 63 % 2 == 0 && p % 63 % 2 == 0) {
        let at = coarse.frame(24)[p / 63 / 2 * 32 + p % 63 / 2];
        let apart = (0..3).map(|c| (found[c] - at[c]).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-5, "particle {p}: {found:?}, not {at:?}");
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

/// A copy of the shipped sequence whose vertices are numbered backwards, in a mesh with further vertices in the middles of
/// the cells; at rest it lies in the x-z plane.
fn meshed(folder: &Path) -> PathBuf {
    let grid = Grid { h: 32, w: 32 };
    let to = folder.join("meshed");
    std::fs::create_dir(&to).unwrap();
    let truth = Sequence::load(&shipped(), "xy_v2").unwrap().truth;
    let corners = |k: usize| [0, 1, 32, 33].map(|step| k / 31 * 32 + k % 31 + step);
    let with_middles = |points: &[[f32; 3]]| -> Vec<[f32; 3]> {
        let middle = |k| [0, 1, 2].map(|c| corners(k).map(|p| points[p][c]).iter().sum::<f32>() / 4.0);
        points.iter().rev().copied().chain((0..961).map(middle)).collect()
    };
    let mut frames = Vec::new();
    (0..20).for_each(|f| frames.extend(with_middles(truth.frame(f))));
    let frames = ndarray::Array3::from_shape_vec((20, 1985, 3), frames.concat()).unwrap();
    ndarray_npy::write_npy(to.join("cloth_pos.npy"), &frames).unwrap();
    let rest: Vec<[f32; 3]> =
        (0..1024).map(|p| [1.0 - (p % 32) as f32 / 31.0, 0.0, (p / 32) as f32 / 31.0]).collect();
    let mut obj = String::new();
    with_middles(&rest).iter().for_each(|[x, y, z]| obj += &format!("v {x} {y} {z}\n"));
    for k in 0..961 {
        // As numbered in the file, from 1.
        let [a, b, c, d] = corners(k).map(|p| 1024 - p);
        for [p, q] in [[a, b], [b, d], [d, c], [c, a]] {
            obj += &format!("f {p} {q} {}\n", 1025 + k);
        }
    }
    std::fs::write(to.join("mesh.obj"), obj).unwrap();
    let [h0, h1] = [1023 - 31 * grid.w, 1023];
    let meta = format!(r#"{{"handle_vertices": [{h0}, {h1}], "fps": 60}}"#);
    std::fs::write(to.join("meta.json"), meta).unwrap();
    to
}

#[test]
fn a_mesh_that_is_no_grid_is_carried_to_one() {
    let folder = tempfile::tempdir().unwrap();
    let to = meshed(folder.path());
    let sequence = Sequence::load(folder.path(), "meshed").unwrap();
    let original = Sequence::load(&shipped(), "xy_v2").unwrap();
    // As many particles as vertices, about; the handles without a file are where their vertices are.
    assert_eq!(sequence.grid(), Grid { h: 45, w: 45 });
    let [found, expected] =
        [&sequence, &original].map(|s| s.scene(Grid { h: 32, w: 32 }, &PHYSICS).unwrap().setup().unwrap());
    assert_eq!(found.model.cloths[0].handles, expected.model.cloths[0].handles);
    let apart = |a: [f64; 3], b: [f64; 3]| square(a, b).sqrt();
    for frame in [0, 19] {
        for (&a, &b) in found.handles[frame].iter().zip(&expected.handles[frame]) {
            // The trajectory that ships has half precision; in edges.
            assert!(apart(a, b) < 0.02, "handles of frame {frame}: {a:?}, {b:?}");
        }
    }
    let [mine, theirs] = [&found, &expected].map(|setup| setup.vertices_m(&setup.start.x));
    let farthest = mine.iter().zip(&theirs).map(|(&a, &b)| apart(a, b)).fold(0.0, f64::max);
    assert!(farthest < 3e-3, "the start is {farthest} m away");
    // Distances are measured to the mesh itself.
    let (vertices, faces) = sequence.surface(3);
    assert_eq!((vertices.len(), faces.len()), (1985, 4 * 961));
    let score = compare(&sequence, "itself", &original.truth, &Settings { frames: 20, ..SETTINGS }).unwrap();
    // Two samples of one surface are about as far apart as their points: 1000 on a square metre.
    assert!(score.e_cd.unwrap() < 2e-3 && score.e_3d.unwrap() < 3e-3, "{:?}, {:?}", score.e_cd, score.e_3d);
    let tick = || ControlFlow::Continue(());
    let settings = Settings { frames: 4, ..SETTINGS };
    let (score, _) =
        run((&sequence, None), Grid { h: 16, w: 16 }, &newton(), (&Device::Cpu, &settings), tick)
            .unwrap()
            .unwrap();
    assert!(score.stable && score.e_cd.unwrap() < 8e-3);

    let refused = |file: &str, text: &str, said: &[&str]| {
        let kept = std::fs::read(to.join(file)).unwrap();
        std::fs::write(to.join(file), text).unwrap();
        let error = Sequence::load(folder.path(), "meshed").unwrap_err().to_string();
        std::fs::write(to.join(file), kept).unwrap();
        said.iter().for_each(|part| assert!(error.contains(part), "no '{part}' in {error}"));
    };
    let obj = std::fs::read_to_string(to.join("mesh.obj")).unwrap();
    refused("meta.json", "{}", &["handle_vertices", "as there is a mesh"]);
    refused("meta.json", r#"{"handle_vertices": [5000, 1]}"#, &["vertices below 1985", "5000"]);
    refused("mesh.obj", &obj.replacen("v ", "# ", 1), &["mesh.obj", "line", "that exist"]);
    refused("mesh.obj", &(obj.clone() + "v 0 0 0\n"), &["mesh.obj", "1985, as in cloth_pos.npy", "1986"]);
    refused("mesh.obj", &obj.replacen("v 0 0 1\n", "v 0 0.5 1\n", 1), &["mesh.obj", "a flat sheet"]);
    let holed: Vec<&str> = obj.lines().filter(|line| !line.ends_with(" 1500")).collect();
    refused("mesh.obj", &holed.join("\n"), &["mesh.obj", "fills a rectangle"]);
    std::fs::rename(to.join("mesh.obj"), folder.path().join("sheet.obj")).unwrap();
    assert!(Sequence::load(folder.path(), "meshed").is_err(), "1985 vertices are no square");
    let meta = r#"{"handle_vertices": [31, 1023], "obj_code": "sheet"}"#;
    std::fs::write(to.join("meta.json"), meta).unwrap();
    assert_eq!(Sequence::load(folder.path(), "meshed").unwrap().grid(), Grid { h: 45, w: 45 });
}

#[test]
fn repulsion_is_judged_on_the_grid_of_the_paper() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    // A sheet folded onto itself at half of its height, 0.2 edges of 32 rows apart.
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
    // Every other row and column of 63 is one of 32.
    let [coarse, fine] = [32, 63].map(|n| folded(n).unwrap());
    assert!(coarse[0] > 1.0 && coarse[1] == 1.0);
    assert!((fine[0] / coarse[0] - 1.0).abs() < 1e-3, "{} and {}", fine[0], coarse[0]);
}

/// Whatever its first frame looks like: there the corners are handles, which stretch the edges beside them.
#[test]
fn repulsion_counts_in_edges_at_rest() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let folded = |corner: f32| {
        let mut trajectory = Trajectory::new(Grid { h: 32, w: 32 }, 60.0);
        // Folded onto itself at half of its height, 0.2 edges apart.
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
    assert!(folded(0.0)[0] > 1.0);
    assert_eq!(folded(0.5), folded(0.0));
    // Neither is a trajectory without cells a reason to panic.
    let mut point = Trajectory::new(Grid { h: 1, w: 1 }, 60.0);
    (0..3).for_each(|_| point.push(&[[0.0; 3]], &[[0.0; 3]]));
    let error =
        compare(&sequence, "point", &point, &Settings { frames: 3, ..SETTINGS }).unwrap_err().to_string();
    assert!(error.contains("point, xy_v2: grid: expected a cell or more"), "{error}");
}

/// Files without faces are on the truth's grid where they have as many vertices, else on a square one.
#[test]
fn others_are_on_the_grid_or_the_mesh_of_the_sequence() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("wide");
    let grid = Grid { h: 9, w: 16 };
    let mut wide = Trajectory::new(grid, 60.0);
    let frame: Vec<[f32; 3]> =
        (0..144).map(|p| [(p % 16) as f32 / 8.0, 0.0, (p / 16) as f32 / 8.0]).collect();
    (0..3).for_each(|_| wide.push(&frame, &frame));
    wide.write(&to, "cloth_pos", fnopt::io::Format::Npy).unwrap();
    std::fs::write(to.join("meta.json"), r#"{"grid": [9, 16]}"#).unwrap();
    let sequence = Sequence::load(folder.path(), "wide").unwrap();
    let settings = Settings { frames: 3, ..SETTINGS };
    for format in [fnopt::io::Format::Npy, fnopt::io::Format::Pc2] {
        // 144 vertices could be 12x12 too.
        let found = sequence.read_other(&wide.write(&to, "theirs", format).unwrap()).unwrap();
        assert_eq!(found.grid(), grid);
        assert_eq!(compare(&sequence, "theirs", &found, &settings).unwrap().e_3d, Some(0.0));
    }
    let mut square = Trajectory::new(Grid { h: 10, w: 10 }, 60.0);
    (0..3).for_each(|_| square.push(&frame[..100], &frame[..100]));
    let file = square.write(&to, "square", fnopt::io::Format::Npy).unwrap();
    assert_eq!(sequence.read_other(&file).unwrap().grid(), Grid { h: 10, w: 10 });

    let to = meshed(folder.path());
    let sequence = Sequence::load(folder.path(), "meshed").unwrap();
    let found = sequence.read_other(&to.join("cloth_pos.npy")).unwrap();
    assert_eq!(found.grid().particles(), 1985);
    let score = compare(&sequence, "theirs", &found, &Settings { frames: 20, ..SETTINGS }).unwrap();
    // Two samples of one surface; and the truth was carried to the grid in the same way.
    assert!(score.e_cd.unwrap() < 2e-3 && score.e_3d == Some(0.0), "{:?}, {:?}", score.e_cd, score.e_3d);
    assert_eq!(
        (score.grid.as_str(), sequence.on_grid(&found).unwrap().grid()),
        ("45x45", Grid { h: 45, w: 45 })
    );
}

/// Any file of a sequence makes it another.
#[test]
fn a_checksum_is_of_all_files() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("xy_v2");
    std::fs::create_dir(&to).unwrap();
    let files = ["cloth_pos.npy", "handles.npy", "start.npy", "meta.json"];
    for file in files {
        std::fs::copy(shipped().join("xy_v2").join(file), to.join(file)).unwrap();
    }
    let sum = || Sequence::load(folder.path(), "xy_v2").unwrap().checksum();
    let whole = sum();
    assert_eq!(whole, Sequence::load(&shipped(), "xy_v2").unwrap().checksum());
    for file in files {
        let bytes = std::fs::read(to.join(file)).unwrap();
        let mut changed = bytes.clone();
        // A digit in meta.json, the last bits of a number in the middle of the others.
        let at = match file {
            "meta.json" => bytes.windows(3).position(|w| w == b"187").unwrap(),
            _ => (bytes.len() / 2) & !3,
        };
        changed[at] ^= 1;
        std::fs::write(to.join(file), changed).unwrap();
        assert_ne!(sum(), whole, "{file}");
        std::fs::write(to.join(file), bytes).unwrap();
    }
    std::fs::remove_file(to.join("start.npy")).unwrap();
    assert_ne!(sum(), whole);
}

#[test]
fn only_scores_that_were_made_alike_stand_together() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let score = compare(&sequence, "itself", &sequence.truth, &SETTINGS).unwrap();
    let other = |change: &dyn Fn(&mut Score)| {
        let mut other = Score { sequence: "other".into(), ..score.clone() };
        change(&mut other);
        let (a, b) = (Path::new("a.json"), Path::new("b.json"));
        belong_together(&[(a, &score), (b, &other)]).map_err(|e| e.to_string())
    };
    assert_eq!(other(&|_| ()), Ok(()));
    // A column of its own may be of another device.
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
        ("settings", &|s| s.made_with.settings = softer.to_json()),
        ("device", &elsewhere),
        ("weights", &|s| s.made_with.weights = Some(1)),
        ("score", &|s| s.sequence = score.sequence.clone()),
        ("truth", &|s| {
            (s.sequence, s.grid) = (score.sequence.clone(), "64x64".into());
            s.made_with.truth = s.made_with.truth.map(|sum| sum ^ 1);
        }),
    ];
    for (field, change) in changes {
        let error = other(change).unwrap_err();
        let expected = [format!("b.json: {field}: expected"), "a.json".into()];
        expected.iter().for_each(|part| assert!(error.contains(part), "no '{part}' in {error}"));
    }
}

#[test]
fn a_solver_that_diverges_has_no_numbers() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let descent = Optimizer::GradientDescent { rate: 1e3 };
    let entry = Entry { name: "gd".into(), optimizer: descent, iterations: 10, coarse: false };
    let tick = || ControlFlow::Continue(());
    let (diverged, _) =
        run((&sequence, None), sequence.grid(), &entry, (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap();
    assert!(!diverged.stable && diverged.e_cd.is_none() && diverged.ms_per_frame.is_none());
    let (good, _) =
        run((&sequence, None), sequence.grid(), &newton(), (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap();
    // Many columns are written in parts.
    let many: Vec<Score> = (1..12).map(|n| Score { iterations: 1000 * n, ..good.clone() }).collect();
    for table in tables(&many) {
        let text = table.write(Format::Text { bold: false });
        assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
    }
    let tables = tables(&[good.clone(), diverged]);
    let text = tables[0].write(Format::Text { bold: true });
    let row = text.lines().find(|line| line.starts_with("xy_v2")).unwrap();
    assert!(row.ends_with('-') && row.contains("\x1b[1m"), "{row}");
    let markdown = tables[0].write(Format::Markdown);
    assert!(
        markdown.contains("| sequence | newton | gd, N = 10 |") && markdown.contains("| - |"),
        "{markdown}"
    );
    let csv = tables[0].write(Format::Csv);
    assert!(csv.contains("sequence,newton,\"gd, N = 10\""), "{csv}");
    // The means over the sequences, and what the energy is made of.
    let of =
        |title: &str| tables.iter().find(|t| t.title == title).unwrap().write(Format::Text { bold: false });
    let overview = of("error and time");
    assert!(overview.contains("±") && overview.contains("ms/frame"), "{overview}");
    let energy = of("energy and stretch");
    assert!(["bend", "inertia", "mean stretch"].iter().all(|head| energy.contains(head)), "{energy}");
    let terms = good.energy_terms.unwrap();
    assert!((terms.total() / good.energy.unwrap() - 1.0).abs() < 1e-9 && good.stretch_mean.unwrap() > 0.0);
}

#[test]
fn bad_sequences_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let error = |name: &str| Sequence::load(folder.path(), name).unwrap_err().to_string();
    assert!(Sequence::names(folder.path()).unwrap_err().to_string().contains("cloth_pos.npy"));
    let copy = |name: &str| {
        let to = folder.path().join(name);
        std::fs::create_dir(&to).unwrap();
        for file in ["cloth_pos.npy", "handles.npy", "meta.json"] {
            std::fs::copy(shipped().join("xy_v2").join(file), to.join(file)).unwrap();
        }
        to
    };
    let grid = copy("grid");
    std::fs::write(grid.join("meta.json"), r#"{"grid": [20, 20]}"#).unwrap();
    assert!(error("grid").contains("vertices: expected those of 20x20, found 1024"));
    std::fs::write(grid.join("meta.json"), r#"{"fps": -3}"#).unwrap();
    assert!(error("grid").contains("fps: expected a positive number"));
    std::fs::write(grid.join("meta.json"), "{").unwrap();
    assert!(error("grid").contains("meta.json: line 1, column 1: expected JSON"));
    std::fs::write(grid.join("meta.json"), r#"{"handle_vertices": "corner"}"#).unwrap();
    assert!(error("grid").contains("handle_vertices"));
    // Without handles.npy they are where their vertices are; start.npy has more digits than cloth_pos.npy.
    std::fs::write(grid.join("meta.json"), r#"{"handle_vertices": [992, 0]}"#).unwrap();
    let setup = |folder: &Path, name: &str| {
        let sequence = Sequence::load(folder, name).unwrap();
        sequence.scene(Grid { h: 32, w: 32 }, &PHYSICS).unwrap().setup().unwrap()
    };
    let given = setup(&shipped(), "xy_v2");
    std::fs::remove_file(grid.join("handles.npy")).unwrap();
    let followed = setup(folder.path(), "grid");
    let gap = |a: &[[f64; 3]], b: &[[f64; 3]]| square(a[0], b[0]).max(square(a[1], b[1])).sqrt();
    let farthest = given.handles.iter().zip(&followed.handles).map(|(a, b)| gap(a, b)).fold(0.0, f64::max);
    assert!(farthest > 0.0 && farthest < 0.02, "half precision: {farthest} edges");
    assert_ne!(given.start.x, followed.start.x);
    std::fs::copy(shipped().join("xy_v2/start.npy"), grid.join("start.npy")).unwrap();
    assert!(
        given.start.x.iter().zip(&setup(folder.path(), "grid").start.x).all(|(a, b)| (a - b).abs() < 0.02)
    );
    // Without a meta.json: the default cloth.
    std::fs::remove_file(grid.join("meta.json")).unwrap();
    assert_eq!(Sequence::load(folder.path(), "grid").unwrap().grid(), Grid { h: 32, w: 32 });
    assert_eq!(Sequence::names(folder.path()).unwrap(), ["grid"]);
    // What is misspelt, or no number, or of another number of frames, is not passed over.
    let meta = copy("meta");
    let said = |text: &str, said: &str| {
        std::fs::write(meta.join("meta.json"), text).unwrap();
        let error = error("meta");
        assert!(error.contains("meta.json") && error.contains(said), "no '{said}' in {error}");
    };
    said(r#"{"wind": {"density": "1.2"}}"#, "wind.density: expected a number, found \"1.2\"");
    said(r#"{"wind": {"densty": 1.2}}"#, "'densty' (did you mean density?)");
    said(r#"{"wind": {"drag": -1}}"#, "wind.drag: expected a number, 0 or more");
    said(r#"{"mass_per_area_kg_m": 1}"#, "did you mean mass_per_area_kg_m2?");
    said(r#"{"obj_code": 3}"#, "obj_code: expected a text");
    said(r#"{"gravity_m_s2": [0, -9.8]}"#, "gravity_m_s2: expected three numbers");
    said(r#"{"handle_vertices": {"h0": 1, "h2": 2}}"#, "handle_vertices: expected a field h1");
    std::fs::remove_file(meta.join("meta.json")).unwrap();
    for shape in [(390, 2, 3), (392, 2, 3), (391, 1, 3), (391, 2, 2)] {
        ndarray_npy::write_npy(meta.join("handles.npy"), &ndarray::Array3::<f32>::zeros(shape)).unwrap();
        let error = error("meta");
        assert!(error.contains("handles.npy: shape: expected [391, 2, 3]"), "{error}");
    }
    let cut = copy("cut");
    let bytes = std::fs::read(cut.join("cloth_pos.npy")).unwrap();
    std::fs::write(cut.join("cloth_pos.npy"), &bytes[..bytes.len() - 2]).unwrap();
    assert!(error("cut").contains("length"));
    assert!(Trajectory::read(cut.join("handles.npy"), &ReadOptions::default()).is_err());
}

/// A trajectory that Newton's method made with a known material: the fit finds it, also when it goes on from a file.
#[test]
fn a_known_material_is_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("made");
    std::fs::create_dir(&to).unwrap();
    let truth = Material { stretch: 400.0, shear: 4.0, bend: 0.5 };
    let mut scene = Scene { stiffness: Stiffness::Grid(truth), frames: Some(20), ..Scene::default() };
    scene.regrid(Grid { h: 12, w: 12 }).unwrap();
    let setup = scene.setup().unwrap();
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::Newton, 1).unwrap();
    simulator.set_state(&setup.start.cast());
    let mut trajectory = Trajectory::new(setup.model.grid, 60.0);
    let mut handles = Vec::new();
    let mut push = |state: &State<f32>| {
        let vertices: Vec<[f32; 3]> =
            setup.vertices_m(&state.x).iter().map(|p| p.map(|c| c as f32)).collect();
        handles.extend([vertices[11 * 12], vertices[0]].concat());
        trajectory.push(&vertices, &vertices);
    };
    push(&setup.start.cast());
    for frame in 1..20 {
        push(&simulator.step(&setup.control(frame)).unwrap().state);
    }
    trajectory.write(&to, "cloth_pos", fnopt::io::Format::Npy).unwrap();
    let handles = ndarray::Array3::from_shape_vec((20, 2, 3), handles).unwrap();
    ndarray_npy::write_npy(to.join("handles.npy"), &handles).unwrap();

    let sequences = [Sequence::load(folder.path(), "made").unwrap()];
    let [density, drag, time] = sequences[0].air_and_frame_time();
    let fit = Fit {
        sequences: &sequences,
        grid: Grid { h: 12, w: 12 },
        settings: Settings { frames: 20, ..SETTINGS },
        // The truth is on the way of the refinement: 100 * 16^(1/2).
        ranges: [[100.0, 1600.0], [1.0, 16.0], [0.5; 2], [density; 2], [drag; 2], [time; 2]],
        levels: 2,
        rounds: 1,
    };
    let file = folder.path().join("fit.csv");
    let mut surface = Surface::load(&file, &fit).unwrap();
    // Ended in the middle: of two points a share is done, of which each has 19 frames.
    let frames = AtomicUsize::new(0);
    let few = || match frames.fetch_add(1, Ordering::Relaxed) {
        40.. => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    fit.search(&mut surface, few, |_, _| Ok(())).unwrap();
    surface.write(&file).unwrap();
    let mut again = Surface::load(&file, &fit).unwrap();
    assert_eq!(again, surface, "what was tried is known again");
    let known = again.sorted().len();
    fit.search(&mut again, || ControlFlow::Continue(()), |_, _| Ok(())).unwrap();
    assert!(again.sorted().len() > known);
    let ([stretch, shear, ..], error) = again.sorted()[0];
    assert!((stretch / 400.0 - 1.0).abs() < 1e-9 && (shear / 4.0 - 1.0).abs() < 1e-9, "{stretch}, {shear}");
    // What sampling two equal surfaces leaves.
    assert!(error < 3e-3, "{error}");
    // Errors of fewer frames are others, and damage is named.
    let shorter = Fit { settings: Settings { frames: 10, ..fit.settings }, ..fit.clone() };
    let refused = Surface::load(&file, &shorter).unwrap_err().to_string();
    assert!(refused.contains("line 1: expected # made (10 frames, "), "{refused}");
    // So are those of another file of the sequence.
    std::fs::write(to.join("meta.json"), r#"{"gravity_m_s2": [0, -9.7, 0]}"#).unwrap();
    let changed = [Sequence::load(folder.path(), "made").unwrap()];
    let changed = Fit { sequences: &changed, ..fit.clone() };
    assert!(Surface::load(&file, &changed).unwrap_err().to_string().contains("line 1: expected # made (20"));
    std::fs::write(&file, format!("# {}\nstretch\n1,2\n", fit.subject())).unwrap();
    let refused = Surface::load(&file, &fit).unwrap_err().to_string();
    assert!(refused.contains("line 3: expected seven numbers"), "{refused}");
    std::fs::write(&file, format!("# {}\nstretch\n1,2,x,3,4,5,6,7\n", fit.subject())).unwrap();
    assert!(Surface::load(&file, &fit).is_err(), "what is no number is not passed over");
    let endless = Fit { levels: 1000, ..fit.clone() };
    let refused = endless.search(&mut Surface::default(), || ControlFlow::Break(()), |_, _| Ok(()));
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("--levels") && refused.contains("100000"), "{refused}");
}
