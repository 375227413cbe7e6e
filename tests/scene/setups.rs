//! What a scene sets up: starts, grids, handles, motions, and batches of them.

use crate::common::{assets, distance, edges, expect_refusal, mean, parse, read};
use fnopt::cloth::{Grid, Material};
use fnopt::io::{Format, Trajectory, vertex_normals};
use fnopt::scene::{
    BuiltIn, Handles, Mass, Motion, Placement, Scene, Setup, Side, Start, Stiffness, UpAxis, Wind,
};

#[test]
fn built_in_motions_match_the_reference_data() {
    for name in ["xy_v2", "xyz_v3", "rot_h0", "rot_h1"] {
        let truth = read(&format!("motions/{name}.npy"));
        let setup = parse(&format!("{{\"motion\": \"{name}\"}}")).unwrap().setup().unwrap();
        assert_eq!(setup.frames(), truth.shape()[0]);
        let mut worst = 0.0f64;
        for (f, row) in setup.handles.iter().enumerate() {
            for (h, &p) in row.iter().enumerate() {
                let p = UpAxis::Y.from_z_up(setup.units.position_m(p));
                for c in 0..3 {
                    worst = worst.max((p[c] - f64::from(truth[[f, h, c]])).abs());
                }
            }
        }
        assert!(worst < 1e-6, "{name}: {worst:e}");
    }
}

#[test]
fn a_recorded_motion_equals_the_built_in_one_and_is_held_past_its_end() {
    let built_in = parse(r#"{"motion": "xyz_v3", "frames": 400}"#).unwrap().setup().unwrap();
    let recorded = parse(r#"{"motion": "../motions/xyz_v3.npy", "frames": 400}"#).unwrap().setup().unwrap();
    for (a, b) in built_in.handles.iter().flatten().zip(recorded.handles.iter().flatten()) {
        assert!(distance(*a, *b) < 1e-5);
    }
    assert_eq!(recorded.handles[399], recorded.handles[390]);
    assert_eq!(recorded.control::<f64>(1_000_000).handles, recorded.handles[390]);
}

#[test]
fn a_slower_motion_is_interpolated_between_the_rows_of_its_recording() {
    let text = r#"{"motion": [[[0, 0, 0], [1, 0, 0]], [[0.2, 0, 0], [1, 0.4, 0]]], "speed": 0.25}"#;
    let setup = parse(text).unwrap().setup().unwrap();
    assert_eq!(setup.frames(), 5);
    for (frame, row) in setup.handles.iter().enumerate() {
        let done = frame as f64 / 4.0;
        for (&handle, at) in row.iter().zip([[0.2 * done, 0.0, 0.0], [1.0, 0.4 * done, 0.0]]) {
            let found = UpAxis::Y.from_z_up(setup.units.position_m(handle));
            assert!(distance(found, at) < 1e-12, "frame {frame}: {found:?}, not {at:?}");
        }
    }
}

#[test]
fn positions_may_stand_in_the_scene_itself() {
    let mut scene = Scene::load(assets("scenes/inline.json")).unwrap();
    let setup = scene.setup().unwrap();
    let hanging = Scene { start: Start::Hanging, motion: Motion::Still, ..scene.clone() }.setup().unwrap();
    assert!(setup.start.x.iter().zip(&hanging.start.x).all(|(a, b)| (a - b).abs() < 1e-9));
    assert_eq!(setup.frames(), 4);
    let moved = distance(setup.handles[3][0], setup.handles[0][0]) * setup.units.length_m;
    assert!((moved - 0.03).abs() < 1e-12, "{moved} m");
    // On another grid the sheet is resampled.
    scene.regrid(Grid { h: 15, w: 15 }).unwrap();
    let fine = scene.setup().unwrap();
    assert!(edges(&fine).iter().flatten().all(|length| (length - 1.0).abs() < 1e-9));

    let start = |text: &str| format!(r#"{{"grid": [8, 8], "start": {text}}}"#);
    expect_refusal(&start(r#"{"vertices": [[0, 0, 0]]}"#), &["start", "grid"]);
    let few = start(r#"{"vertices": [[0, 0, 0]], "grid": [8, 8]}"#);
    expect_refusal(&few, &["start.vertices", "64 for the 8x8 grid", "found 1"]);
    expect_refusal(&start(r#"{"vertices": [[0, 0]], "grid": [8, 8]}"#), &["start.vertices[0]"]);
    expect_refusal(r#"{"motion": []}"#, &["motion", "at least one row"]);
    expect_refusal(r#"{"motion": [[[0, 0, 0]]]}"#, &["motion[0]", "2 positions", "found 1"]);
}

#[test]
fn a_faster_motion_takes_fewer_frames() {
    for (motion, tolerance) in [("xy_v2", 1e-12), ("../motions/xy_v2.npy", 1e-3)] {
        let at = |speed: f64| {
            let text = format!("{{\"motion\": \"{motion}\", \"speed\": {speed}}}");
            parse(&text).unwrap().setup().unwrap()
        };
        let (slow, fast) = (at(1.0), at(1.5));
        assert_eq!((slow.frames(), fast.frames(), at(2.0).frames()), (391, 261, 196));
        // Frame 50 at 1.5 times the speed is frame 75. Interpolating a recording is off by its curvature.
        assert!(distance(fast.handles[50][0], slow.handles[75][0]) < tolerance);
    }
}

/// The stored drape is that of the default cloth. After a change of that, this test writes it anew if
/// `FNOPT_WRITE_VECTORS` is set.
#[test]
fn the_stored_drape_is_the_default_start() {
    let setup = parse("{}").unwrap().setup().unwrap();
    let path = assets("starts/settled_32.npy");
    if std::env::var_os("FNOPT_WRITE_VECTORS").is_some() {
        let points = ndarray::Array2::from(setup.vertices_m(&setup.start.x));
        ndarray_npy::write_npy(&path, &points.into_shape_with_order((32, 32, 3)).unwrap()).unwrap();
    }
    let stored = fnopt::io::read_npy(&path).unwrap();
    for (p, q) in setup.vertices_m(&setup.start.x).iter().flatten().zip(&stored) {
        assert!((p - q).abs() < 1e-12, "{p} and {q}");
    }
    assert!(setup.start.v.iter().all(|&v| v == 0.0));
}

/// The drape depends on the cloth, not on the grid, and it is computed once.
#[test]
fn the_drape_is_the_same_on_every_grid() {
    // One number is both sizes.
    let coarse = parse(r#"{"grid": 32}"#).unwrap().setup().unwrap();
    assert_eq!((coarse.model.grid.h, coarse.model.grid.w), (32, 32));
    let fine = parse(r#"{"grid": [63, 63]}"#).unwrap().setup().unwrap();
    let (of_coarse, of_fine) = (coarse.vertices_m(&coarse.start.x), fine.vertices_m(&fine.start.x));
    let apart = |(i, j): (usize, usize)| distance(of_coarse[i * 32 + j], of_fine[2 * i * 63 + 2 * j]);
    let apart: Vec<f64> = (0..32).flat_map(|i| (0..32).map(move |j| (i, j))).map(apart).collect();
    // Folds differ a little: a coarse sheet cannot bend as sharply.
    assert!(mean(&apart) < 0.02 && apart.iter().all(|&apart| apart < 0.08), "{} m on average", mean(&apart));
    let again = parse(r#"{"grid": [63, 63], "motion": "none"}"#).unwrap().setup().unwrap();
    assert_eq!(again.start, fine.start);
    let soft = parse(r#"{"grid": [63, 63], "material": "paper"}"#).unwrap().setup().unwrap();
    assert_ne!(soft.start, fine.start);
}

#[test]
fn a_resampled_drape_keeps_its_corners_and_its_edges() {
    for (h, w) in [(33, 48), (64, 64), (32, 100), (100, 32), (31, 33), (8, 8), (16, 200)] {
        let setup = parse(&format!("{{\"grid\": [{h}, {w}]}}")).unwrap().setup().unwrap();
        let corners: Vec<_> = setup.handles[0].iter().map(|&p| setup.units.position_m(p)).collect();
        assert!(
            distance(corners[0], [0.0, -0.45, 0.5]) < 1e-7 && distance(corners[1], [0.0, 0.45, 0.5]) < 1e-7
        );
        let [high, wide] = edges(&setup);
        for (name, lengths) in [("height", &high), ("width", &wide)] {
            let (low, top) = lengths.iter().fold((f64::MAX, 0.0f64), |(a, b), &l| (a.min(l), b.max(l)));
            println!("{h}x{w} {name}: mean {:.4}, {low:.3} to {top:.3}", mean(lengths));
            assert!((mean(lengths) - 1.0).abs() < 0.08, "{h}x{w} {name}: mean {}", mean(lengths));
            assert!(low > 0.25 && top < 1.75, "{h}x{w} {name}: {low} to {top}");
        }
    }
}

#[test]
fn flat_and_hanging_sheets_are_at_rest_length() {
    for start in ["flat", "hanging"] {
        let text =
            format!("{{\"start\": \"{start}\", \"grid\": [20, 31], \"side_m\": 0.7, \"motion\": \"none\"}}");
        let setup = parse(&text).unwrap().setup().unwrap();
        assert!(edges(&setup).iter().flatten().all(|l| (l - 1.0).abs() < 1e-12));
        if start == "flat" {
            assert_eq!(setup.start, fnopt::cloth::State::rest(setup.model.grid, 1));
        } else {
            // y up: the edge j = 0 is the upper one, and i runs along +z as in the drape.
            let at = setup.vertices_m(&setup.start.x);
            assert!(
                distance(at[0], [0.0, 0.35, -0.35]) < 1e-12
                    && distance(at[19 * 31], [0.0, 0.35, 0.35]) < 1e-12
            );
            assert!(at[30][1] < at[0][1]);
        }
    }
}

#[test]
fn an_obj_start_is_transformed_and_rotated() {
    let setup = Scene::load(assets("scenes/obj_start.json")).unwrap().setup().unwrap();
    let at = setup.vertices_m(&setup.start.x);
    // Vertex 8 of the file is at (0.4, 0, -0.194454): a quarter turn about +y makes (x, y, z) -> (z, y, -x).
    assert!(distance(at[8], [-0.194454, 0.5, -0.4]) < 1e-6);
    assert!(edges(&setup).iter().flatten().all(|l| (l - 1.0).abs() < 0.5));
    assert_eq!(setup.model.cloths[0].handles, [107, 0]);
}

/// A sheet whose rows are as long as the scene has particles is not a trajectory of the scene's grid.
#[test]
fn the_axes_of_a_start_are_those_of_its_grid() {
    let folder = tempfile::tempdir().unwrap();
    let rest = |h: usize, w: usize| {
        ndarray::Array3::from_shape_fn((h, w, 3), |(i, j, c)| [j as f64, 0.0, i as f64][c] / (h - 1) as f64)
    };
    let start = |array: &dyn Fn(&std::path::Path), grid: &str| {
        array(&folder.path().join("start.npy"));
        let start = format!(r#"{{"file": "start.npy", "grid": {grid}}}"#);
        let text = format!(r#"{{"grid": [8, 8], "motion": "none", "start": {start}}}"#);
        Scene::parse(&text, "scene.json", folder.path()).unwrap().setup().map(|setup| setup.start)
    };
    let fine = start(&|path| ndarray_npy::write_npy(path, &rest(64, 64)).unwrap(), "[64, 64]").unwrap();
    let coarse = start(&|path| ndarray_npy::write_npy(path, &rest(8, 8)).unwrap(), "[8, 8]").unwrap();
    assert!(fine.x.iter().zip(&coarse.x).all(|(a, b)| (a - b).abs() < 1e-9));
    // By frame, row and column: the first frame counts.
    let frames = ndarray::stack(ndarray::Axis(0), &[rest(8, 8).view(), (rest(8, 8) + 1.0).view()]).unwrap();
    let first = start(&|path| ndarray_npy::write_npy(path, &frames).unwrap(), "[8, 8]").unwrap();
    assert_eq!(first, coarse);
    let error =
        start(&|path| ndarray_npy::write_npy(path, &frames).unwrap(), "[16, 8]").unwrap_err().to_string();
    assert!(error.contains("[frames, 16, 8, 3]") && error.contains("found [2, 8, 8, 3]"), "{error}");
}

#[test]
fn whole_numbers_may_have_a_point() {
    let scene = parse(r#"{"grid": [12.0, 9], "frames": 3.0}"#).unwrap();
    assert_eq!((scene.grid, scene.frames), (Grid { h: 12, w: 9 }, Some(3)));
}

#[test]
fn a_new_grid_keeps_the_sheet() {
    let mut scene = parse(
        r#"{"grid": [32, 32], "mass_kg": 0.2, "handles": [[31, 0], [0, 0], [16, 31]], "motion": "none",
            "material": {"stretch_modulus": 1000, "shear_modulus": 40, "bending_stiffness": 0.001}}"#,
    )
    .unwrap();
    let before = scene.setup().unwrap();
    scene.regrid(Grid { h: 63, w: 125 }).unwrap();
    assert_eq!(scene.handles, Handles::Cells(vec![[62, 0], [0, 0], [32, 124]]));
    assert!(matches!(scene.mass, Mass::Total(kg) if (kg - 0.4).abs() < 1e-15));
    let after = scene.setup().unwrap();
    assert!((after.units.length_m * 62.0 - 1.0).abs() < 1e-15);
    assert!((after.units.areal_mass_kg_m2 / before.units.areal_mass_kg_m2 - 1.0).abs() < 1e-14);
    let k = |s: &Setup| s.model.cloths[0].material;
    let moduli = |s: &Setup| s.units.moduli(s.model.grid, k(s));
    assert!((moduli(&after).stretch_modulus / moduli(&before).stretch_modulus - 1.0).abs() < 1e-12);
    assert!((moduli(&after).shear_modulus / moduli(&before).shear_modulus - 1.0).abs() < 1e-12);
    assert!((moduli(&after).bending_stiffness / moduli(&before).bending_stiffness - 1.0).abs() < 1e-12);
    // Grid coefficients are kept as given.
    scene.stiffness = Stiffness::Grid(Material { stretch: 5.0, shear: 6.0, bend: 7.0, ..Material::PAPER });
    scene.regrid(Grid { h: 40, w: 40 }).unwrap();
    assert_eq!(
        k(&scene.setup().unwrap()),
        Material { stretch: 5.0, shear: 6.0, bend: 7.0, ..Material::PAPER }
    );
    // A start state from a file is resampled from the file's grid.
    let mut scene = Scene::load(assets("scenes/obj_start.json")).unwrap();
    scene.regrid(Grid { h: 23, w: 17 }).unwrap();
    assert_eq!(scene.setup().unwrap().start.x.len(), 3 * 23 * 17);
}

#[test]
fn setups_are_batched() {
    let a = parse(r#"{"motion": "xyz", "frames": 20}"#).unwrap().setup().unwrap();
    let b = parse(
        r#"{"motion": "rot_h1", "handles": "single-center", "frames": 30, "wind": {"velocity": [1, 0, 0]}}"#,
    );
    let b = b.unwrap().setup().unwrap();
    let batch = Setup::batch(&[a.clone(), b.clone(), a.clone()]).unwrap();
    assert_eq!((batch.model.batch(), batch.model.handles(), batch.frames()), (3, 5, 30));
    assert_eq!(batch.start.x.len(), 3 * 3 * 1024);
    let control = batch.control::<f64>(25);
    assert_eq!(
        control.handles,
        [a.handles[19][0], a.handles[19][1], b.handles[25][0], a.handles[19][0], a.handles[19][1]]
    );
    assert_eq!(control.wind, [a.wind, b.wind, a.wind].map(|wind| wind.velocity));
    // Each cloth has the units and axes of its own scene.
    let c = parse(r#"{"side_m": 2, "up": "z", "frames": 20}"#).unwrap().setup().unwrap();
    let both = Setup::batch(&[a.clone(), c.clone()]).unwrap();
    let m = [0.3, 0.5, -0.2];
    for (k, own) in [&a, &c].into_iter().enumerate() {
        assert_eq!(both.handle_at::<f64>(k, m), own.handle_at::<f64>(m));
        assert_eq!(both.wind_of::<f64>(k, m), own.wind_of::<f64>(m));
        assert_eq!(both.acceleration_of::<f64>(k, m), own.acceleration_of::<f64>(m));
        assert_eq!(both.vertices_m(k, &both.start.x), own.vertices_m(&own.start.x));
        assert_eq!(both.velocities_m_s(k, &both.start.x), own.velocities_m_s(&own.start.x));
        assert_eq!(both.vertex_view(k), own.vertex_view());
    }
    let other = parse(r#"{"grid": [16, 16]}"#).unwrap().setup().unwrap();
    assert!(Setup::batch(&[a.clone(), other]).unwrap_err().to_string().contains("32x32"));
    let slow = parse(r#"{"frame_time_s": 0.02}"#).unwrap().setup().unwrap();
    assert!(Setup::batch(&[a, slow]).unwrap_err().to_string().contains("frame time"));
    assert!(Setup::batch(&[]).is_err());
}

#[test]
fn placements_are_where_their_names_say() {
    for (placement, cells) in [
        ("corners", &[[8, 0], [0, 0]][..]),
        ("diagonal", &[[8, 15], [0, 0]]),
        ("mid-edge", &[[8, 8], [0, 8]]),
        ("corner-center", &[[8, 0], [4, 8]]),
        ("single-mid-edge", &[[4, 0]]),
        ("single-center", &[[4, 8]]),
        ("single-corner", &[[8, 0]]),
    ] {
        let placement = Placement::named(placement, "test").unwrap();
        let handles = Handles::Placement(placement).on(Grid { h: 9, w: 16 }, "test").unwrap();
        let expected: Vec<usize> = cells.iter().map(|[i, j]| i * 16 + j).collect();
        assert_eq!(handles, expected, "{}", placement.name());
    }
    assert_eq!(Placement::ALL.len(), 7);
}

/// Half a second after the start of a move, which takes a second, and at its end: along the unit direction.
#[test]
fn built_in_motions_go_where_their_names_say() {
    let named = |name: &str| BuiltIn::named(name).unwrap();
    for (name, [x, y, z]) in [
        ("fwd", [1.0, 0.0, 0.0]),
        ("side", [0.0, 0.0, 1.0]),
        ("updown", [0.0, 1.0, 0.0]),
        ("xy", [1.0, 0.0, 1.0]),
        ("yz", [0.0, 1.0, 1.0]),
        ("xz", [1.0, 1.0, 0.0]),
        ("xyz", [1.0, 1.0, 1.0]),
        ("xy_v2", [1.0, 0.0, -1.0]),
        ("yz_v2", [0.0, 1.0, -1.0]),
        ("xz_v2", [1.0, -1.0, 0.0]),
        ("xyz_v2", [1.0, 1.0, -1.0]),
        ("xyz_v3", [1.0, -1.0, 1.0]),
        ("xyz_v4", [-1.0, 1.0, 1.0]),
    ] {
        let norm = f64::sqrt(x * x + y * y + z * z);
        let start = [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]];
        for (name, sign) in [(name.to_owned(), 1.0), (format!("{name}_opp"), -1.0)] {
            for (t, done) in [(0.4, 0.0), (1.0, 0.5), (1.5, 1.0), (2.0, 0.5), (2.5, 0.0)] {
                for (found, start) in named(&name).at(t, &start).into_iter().zip(start) {
                    let [dx, dy, dz] = [x, y, z].map(|c: f64| sign * done * c / norm);
                    let expected = [start[0] + dx, start[1] + dy, start[2] + dz];
                    assert!(
                        distance(found, expected) < 1e-12,
                        "{name} at {t} s: {found:?}, not {expected:?}"
                    );
                }
            }
        }
    }
    assert_eq!(BuiltIn::names().len(), 30);
}

#[test]
fn handles_that_fall_on_one_particle_merge_unless_a_recording_moves_them() {
    let row = |h: usize| (0..h).map(|i| [i, 0]).collect::<Vec<_>>();
    let mut scene = Scene { handles: Handles::Cells(row(32)), ..Scene::default() };
    scene.regrid(Grid { h: 16, w: 16 }).unwrap();
    assert_eq!(scene.handles, Handles::Cells(row(16)));
    assert_eq!(scene.setup().unwrap().model.cloths[0].handles.len(), 16);
    let rows = vec![vec![[0.0; 3]; 32]; 2];
    let mut scene = Scene {
        handles: Handles::Cells(row(32)),
        motion: Motion::Rows(rows),
        side_m: Side::Both([1.0, 1.0]),
        mass: Mass::Total(0.2),
        ..Scene::default()
    };
    let before = scene.clone();
    let error = scene.regrid(Grid { h: 16, w: 32 }).unwrap_err().to_string();
    assert!(
        error.contains("grid: expected a grid on which each handle") && error.ends_with("16x32"),
        "{error}"
    );
    assert_eq!(scene, before);
}

#[test]
fn a_run_continues_where_another_ended() {
    let folder = tempfile::tempdir().unwrap();
    let grid = Grid { h: 12, w: 17 };
    let mut scene = Scene { motion: Motion::Still, ..Scene::default() };
    scene.regrid(grid).unwrap();
    let setup = scene.setup().unwrap();
    let single = |points: Vec<[f64; 3]>| points.into_iter().map(|p| p.map(|c| c as f32)).collect::<Vec<_>>();
    let still = vec![[0.0; 3]; grid.particles()];
    // The sheet falls and drifts.
    let speed = |p: usize| [0.25, -1.0, p as f32 / 64.0];
    let moving: Vec<_> = (0..grid.particles()).map(speed).collect();
    let mut trajectory = Trajectory::new(grid, 60.0);
    trajectory.push(&still, &still);
    trajectory.push(&single(setup.vertices_m(&setup.start.x)), &moving);
    trajectory.write(folder.path(), "rollout", Format::Npz).unwrap();
    let path = folder.path().join("rollout.npz").display().to_string().replace('\\', "/");
    let text = |start: &str| format!(r#"{{"grid": [12, 17], "motion": "none", "start": {start}}}"#);
    let next = parse(&text(&format!("{path:?}"))).unwrap().setup().unwrap();
    assert!(next.start.x.iter().zip(&setup.start.x).all(|(a, b)| (a - b).abs() < 1e-5));
    assert_eq!(single(next.velocities_m_s(&next.start.v)), moving);
    // A quarter turn about y rotates velocities, too, but the translation does not affect them.
    let rotated = text(&format!(
        r#"{{"file": {path:?}, "transform": {{"rotate": [90, 0, 1, 0], "translate": [5, 0, 0]}}}}"#
    ));
    let rotated = parse(&rotated).unwrap().setup().unwrap();
    for (found, p) in rotated.velocities_m_s(&rotated.start.v).into_iter().zip(&moving) {
        let expected = [p[2], p[1], -p[0]].map(f64::from);
        assert!(distance(found, expected) < 1e-9, "{found:?}, not {expected:?}");
    }
    // On another grid it is resampled.
    let mut finer = parse(&text(&format!("{path:?}"))).unwrap();
    finer.regrid(Grid { h: 23, w: 33 }).unwrap();
    let finer = finer.setup().unwrap();
    let falls = finer.velocities_m_s(&finer.start.v).iter().all(|v| (v[1] + 1.0).abs() < 1e-6);
    assert!(falls && finer.start.x.len() == 3 * 23 * 33);
}

/// Without faces, vertices are those of the scene's grid, before it is changed, even if a square one has as
/// many.
#[test]
fn a_trajectory_without_faces_is_on_the_grid_of_its_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloth.npz");
    let grid = Grid { h: 16, w: 9 };
    let scene = |start: String| {
        let start = start.replace('\\', "/");
        parse(&format!(r#"{{"grid": [16, 9], "motion": "none", "start": {start}}}"#)).unwrap()
    };
    let flat = scene("\"flat\"".into()).setup().unwrap();
    let points: Vec<f64> = flat.vertices_m(&flat.start.x).into_iter().flatten().collect();
    let points = ndarray::Array3::from_shape_vec((1, grid.particles(), 3), points).unwrap();
    let mut file = ndarray_npy::NpzWriter::new(std::fs::File::create(&path).unwrap());
    file.add_array("vertices_seq", &points).unwrap();
    file.finish().unwrap();
    let mut read = scene(format!("{:?}", path.display().to_string()));
    let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
    assert!(near(&read.setup().unwrap().start.x, &flat.start.x));
    let finer = Grid { h: 31, w: 17 };
    read.regrid(finer).unwrap();
    let mut expected = scene("\"flat\"".into());
    expected.regrid(finer).unwrap();
    assert!(near(&read.setup().unwrap().start.x, &expected.setup().unwrap().start.x));
}

/// Positions and velocities in SI units convert to grid units and back.
#[test]
fn metres_go_into_a_control_and_come_back() {
    for up in [UpAxis::Y, UpAxis::Z] {
        let setup = Scene { up, side_m: Side::Height(2.5), ..Scene::default() }.setup().unwrap();
        let at = [0.3, -1.7, 4.25];
        let n = setup.model.grid.particles();
        // The same at every particle.
        let field = |point: [f64; 3]| point.iter().flat_map(|&c| vec![c; n]).collect::<Vec<_>>();
        let handle: [f64; 3] = setup.handle_at(at);
        assert!(distance(setup.vertices_m(&field(handle))[7], at) < 1e-12);
        let gravity: [f64; 3] = setup.acceleration_of(Scene { up, ..Scene::default() }.gravity);
        assert_eq!(gravity, setup.model.cloths[0].gravity);
        let wind: [f64; 3] = setup.wind_of(at);
        let windy = Scene {
            up,
            wind: Wind { velocity: at, ..Wind::default() },
            side_m: Side::Height(2.5),
            ..Scene::default()
        };
        assert_eq!(windy.setup().unwrap().wind.velocity, wind);
        assert!(distance(setup.velocities_m_s(&field(wind))[7], at) < 1e-12);
        // A handle of the start converts to its position in the start.
        let p = setup.model.cloths[0].handles[0];
        let there = [0, 1, 2].map(|c| setup.start.x[c * n + p]);
        assert!(distance(setup.handle_at(setup.vertices_m(&setup.start.x)[p]), there) < 1e-9);
    }
}

/// A state in metres comes back, and on a grid of half the spacing it keeps every second particle.
#[test]
fn a_state_in_metres_continues_on_another_grid() {
    let on = |h, w| {
        let grid = Grid::new(h, w, "test").unwrap();
        Scene { grid, up: UpAxis::Y, side_m: Side::Height(2.5), ..Scene::default() }.setup().unwrap()
    };
    let (coarse, fine) = (on(17, 21), on(33, 41));
    let grid = coarse.model.grid;
    let moving: Vec<f64> = coarse.start.x.iter().map(|x| 0.1 * (3.0 * x).sin()).collect();
    let (positions, velocities) = (coarse.vertices_m(&coarse.start.x), coarse.velocities_m_s(&moving));

    let same = coarse.state_of(grid, &positions, &velocities).unwrap();
    let apart = |a: &[f64], b: &[f64]| a.iter().zip(b).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
    assert!(apart(&same.x, &coarse.start.x) < 1e-12 && apart(&same.v, &moving) < 1e-12);

    let finer = fine.state_of(grid, &positions, &velocities).unwrap();
    let finer = [fine.vertices_m(&finer.x), fine.velocities_m_s(&finer.v)];
    for (p, (&x, &v)) in positions.iter().zip(&velocities).enumerate() {
        let q = 2 * (p / grid.w) * 41 + 2 * (p % grid.w);
        assert!(distance(finer[0][q], x) < 1e-12 && distance(finer[1][q], v) < 1e-12, "particle {p}");
    }

    // On a grid of slightly other proportions a uniform motion stays uniform.
    let other = on(9, 12);
    let uniform = vec![[0.5, -1.0, 2.0]; positions.len()];
    let state = other.state_of(grid, &positions, &uniform).unwrap();
    let apart = other.velocities_m_s(&state.v).into_iter().map(|v| distance(v, uniform[0]));
    assert!(apart.fold(0.0, f64::max) < 1e-12);

    let mut broken = velocities.clone();
    broken[5][1] = f64::NAN;
    let refusals = [
        (coarse.state_of(grid, &positions[1..], &velocities), ["positions", "357", "356"]),
        (coarse.state_of(grid, &positions, &broken), ["velocities of particle 5", "finite", "NaN"]),
        (coarse.state_of(Grid { h: 3, w: 119 }, &positions, &velocities), ["3", "8", "grid"]),
    ];
    for (refused, words) in refusals {
        let message = refused.unwrap_err().to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
}

/// Vertices in a scene's view are its positions in metres, with the normals of its triangles.
#[test]
fn vertices_in_a_scenes_view_are_in_metres() {
    for up in [UpAxis::Y, UpAxis::Z] {
        let setup = Scene { up, side_m: Side::Height(2.5), ..Scene::default() }.setup().unwrap();
        let grid = setup.model.grid;
        let positions = setup.vertices_m(&setup.start.x);
        let single: Vec<_> = positions.iter().map(|p| p.map(|c| c as f32)).collect();
        let normals = vertex_normals(&single, &grid.faces());
        let still = vec![0.0; setup.start.x.len()];
        let vertices =
            fnopt::cpu::cloth::vertices(&grid.faces(), &setup.vertex_view(), &setup.start.x, &still);
        for ([x, y, z, a, b, c], (position, normal)) in
            vertices.into_iter().zip(positions.iter().zip(normals))
        {
            assert!(distance([x, y, z], *position) < 1e-6, "{position:?}");
            assert!(distance([a, b, c], normal.map(f64::from)) < 1e-4, "{normal:?}");
        }
    }
}
