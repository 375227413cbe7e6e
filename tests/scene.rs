//! Scenes: examples, ground truth, units, and files that are wrong.

use fnopt::scene::{
    BuiltIn, Handles, Mass, Moduli, Motion, Placement, Scene, Setup, Side, Start, Stiffness, Units, UpAxis,
};
use fnopt::sim::{Grid, Material};
use ndarray_npy::{ReadNpyExt, WriteNpyExt};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

fn assets(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets").join(name)
}

fn read(name: &str) -> ndarray::Array3<f32> {
    ndarray::Array3::read_npy(std::fs::File::open(assets(name)).unwrap()).unwrap()
}

fn parse(text: &str) -> fnopt::Result<Scene> {
    Scene::parse(text, "scene.json", &assets("scenes"))
}

/// The error of a scene that must be refused, in loading or in setting up.
fn refusal(text: &str) -> String {
    parse(text).and_then(|s| s.setup()).map(|_| ()).expect_err(text).to_string()
}

fn expect_refusal(text: &str, parts: &[&str]) {
    let error = refusal(text);
    for part in parts {
        assert!(error.contains(part), "'{part}' is missing from: {error}");
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt()
}

/// Lengths of the edges [edges] along the height and along the width.
fn edges(setup: &Setup) -> [Vec<f64>; 2] {
    let Grid { h, w } = setup.model.grid;
    let at = |i: usize, j: usize| std::array::from_fn(|c| setup.start.x[(c * h + i) * w + j]);
    let along = |di: usize, dj: usize| {
        let cells = (0..h - di).flat_map(move |i| (0..w - dj).map(move |j| (i, j)));
        cells.map(|(i, j)| distance(at(i, j), at(i + di, j + dj))).collect()
    };
    [along(1, 0), along(0, 1)]
}

fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len() as f64
}

#[test]
fn every_example_loads_sets_up_and_survives_a_round_trip() {
    let mut count = 0;
    for entry in std::fs::read_dir(assets("scenes")).unwrap() {
        let path = entry.unwrap().path();
        let scene = Scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
        let setup = scene.setup().unwrap_or_else(|e| panic!("{e}"));
        let folder = tempfile::tempdir().unwrap();
        let saved = folder.path().join("saved.json");
        scene.save(&saved).unwrap();
        let again = Scene::load(&saved).unwrap();
        assert_eq!(Scene { origin: scene.origin.clone(), ..again.clone() }, scene, "{}", path.display());
        assert_eq!(again.setup().unwrap(), setup, "{}", path.display());
        count += 1;
    }
    assert!(count >= 14);
}

#[test]
fn an_empty_document_and_the_default_file_are_the_default_scene() {
    let named = |s: Scene| Scene { origin: "scene".into(), ..s };
    assert_eq!(named(parse("{}").unwrap()), Scene::default());
    let file = named(Scene::load(assets("scenes/default.json")).unwrap());
    assert_eq!(file, Scene { frames: Some(391), ..Scene::default() });
    let setup = Scene::default().setup().unwrap();
    assert_eq!(setup.frames(), 391);
    assert_eq!(setup.model.cloths[0].handles, [31 * 32, 0]);
    assert!((setup.model.cloths[0].gravity[2] + 9.8 * 31.0 / 3600.0).abs() < 1e-15);
    assert!((setup.model.cloths[0].air.density - 1.0 / 31.0 / 0.187).abs() < 1e-15);
}

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
fn positions_may_stand_in_the_scene_itself() {
    let mut scene = Scene::load(assets("scenes/inline.json")).unwrap();
    let setup = scene.setup().unwrap();
    let hanging = Scene { start: Start::Hanging, motion: Motion::Still, ..scene.clone() }.setup().unwrap();
    let apart = setup.start.x.iter().zip(&hanging.start.x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-9, "{apart} edges");
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
        // Frame 50 at 1.5 times the speed is frame 75; linear interpolation of a recording is off by its curvature.
        assert!(distance(fast.handles[50][0], slow.handles[75][0]) < tolerance);
        let between = distance(fast.handles[51][0], slow.handles[76][0]);
        assert!(between > 0.0);
    }
}

#[test]
fn the_stored_drape_is_kept_on_its_grid() {
    for n in [32, 64] {
        let truth = read(&format!("starts/settled_{n}.npy"));
        let setup = parse(&format!("{{\"grid\": [{n}, {n}]}}")).unwrap().setup().unwrap();
        for (p, q) in setup.vertices_m(&setup.start.x).iter().zip(truth.rows()) {
            assert!((0..3).all(|c| (p[c] - f64::from(q[c])).abs() < 1e-12));
        }
        assert!(setup.start.v.iter().all(|&v| v == 0.0));
    }
}

#[test]
fn a_resampled_drape_keeps_its_corners_and_its_edges() {
    for (h, w) in [(33, 48), (100, 100), (32, 100), (100, 32), (31, 33), (8, 8), (256, 256), (16, 200)] {
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
            assert_eq!(setup.start, fnopt::sim::State::rest(setup.model.grid, 1));
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
fn an_obj_start_is_transformed_and_turned() {
    let setup = Scene::load(assets("scenes/obj_start.json")).unwrap().setup().unwrap();
    let at = setup.vertices_m(&setup.start.x);
    // Vertex 8 of the file is at (0.4, 0, -0.194454): a quarter turn about +y makes (x, y, z) -> (z, y, -x).
    assert!(distance(at[8], [-0.194454, 0.5, -0.4]) < 1e-6);
    assert!(edges(&setup).iter().flatten().all(|l| (l - 1.0).abs() < 0.5));
    assert_eq!(setup.model.cloths[0].handles, [107, 0]);
}

#[test]
fn the_authors_scenes_are_read() {
    let scene = Scene::load(assets("scenes/authors.json")).unwrap();
    assert_eq!((scene.grid, scene.up), (Grid { h: 12, w: 9 }, UpAxis::Z));
    assert_eq!((scene.frame_time_s, scene.side_m), (0.02, Side::Height(0.55)));
    let setup = scene.setup().unwrap();
    // Their order of handles is from the last to the first.
    assert_eq!(setup.model.cloths[0].handles, [99, 0]);
    // z up, a quarter turn about +x: (x, y, z) -> (x, -z, y).
    assert!(distance(setup.vertices_m(&setup.start.x)[8], [0.4, 0.194454, 0.5]) < 1e-6);
    let gravity = setup.units.acceleration_m_s2(setup.model.cloths[0].gravity);
    assert!(distance(gravity, [0.0, 0.0, -9.76]) < 1e-12);
}

#[test]
fn variants_of_the_authors_scenes_are_read() {
    let read = |fields: &str| {
        parse(&format!("{{\"mesh_file\": \"../starts/tent_12x9.obj\", {fields}}}"))
            .unwrap_or_else(|e| panic!("{e}"))
    };
    // The faces decide which side is which; a matrix, a translation and a scalar gravity are accepted.
    let a = read(
        r#""mesh_resolution": [12, 9], "mesh_size": [0.55, 0.4], "gravity": -9.8, "transform": [0, 0, 1]"#,
    );
    let b = read(
        r#""mesh_resolution_h": 12, "mesh_resolution_w": 9, "mesh_size": 0.55, "handle_ind_list": [3],
           "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]], "gravity": 9.8"#,
    );
    for scene in [&a, &b] {
        assert_eq!((scene.grid, scene.side_m), (Grid { h: 12, w: 9 }, Side::Height(0.55)));
        assert_eq!(scene.gravity, [0.0, 0.0, -9.8]);
    }
    assert_eq!(a.setup().unwrap().start, b.setup().unwrap().start);
    assert_eq!(b.handles, Handles::Vertices(vec![3]));
    assert_eq!(a.handles, Handles::Placement(Placement::Corners));
}

/// The energy of section 3 of one cloth without inertia and external work; `x` of shape [H][W].
fn energy(x: &[Vec<[f64; 3]>], k: Material) -> f64 {
    let (h, w) = (x.len(), x[0].len());
    let sub = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|c| a[c] - b[c]) };
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| a[c] * b[c]).sum::<f64>();
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let angle = |a, b| dot(cross(a, b), cross(a, b)).sqrt().atan2(dot(a, b));
    let ev = |i: usize, j: usize| sub(x[i + 1][j], x[i][j]);
    let eh = |i: usize, j: usize| sub(x[i][j + 1], x[i][j]);
    let (mut stretch, mut shear, mut bend) = (0.0, 0.0, 0.0);
    for i in 0..h {
        for j in 0..w {
            let off = |e: [f64; 3]| (dot(e, e).sqrt() - 1.0).powi(2);
            if i + 1 < h {
                stretch += off(ev(i, j)) / ((h - 1) * w) as f64;
            }
            if j + 1 < w {
                stretch += off(eh(i, j)) / (h * (w - 1)) as f64;
            }
            if i + 1 < h && j + 1 < w {
                for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    shear += (angle(ev(i, j + a), eh(i + b, j)) - std::f64::consts::FRAC_PI_2).powi(2);
                }
            }
            if i + 2 < h {
                bend += angle(ev(i, j), ev(i + 1, j)).powi(2);
            }
            if j + 2 < w {
                bend += angle(eh(i, j), eh(i, j + 1)).powi(2);
            }
        }
    }
    k.stretch * stretch + (k.shear * shear + k.bend * bend) / (h * w) as f64
}

/// Deforms a sheet of given moduli uniformly and compares the energy of section 3, in joules, with elasticity.
#[test]
fn moduli_are_those_of_a_stretched_a_sheared_and_a_bent_sheet() {
    let moduli = Moduli { stretch_modulus: 900.0, shear_modulus: 40.0, bending_stiffness: 2e-4 };
    for (h, w, side) in [(300, 240, 1.0), (400, 500, 0.6)] {
        let length = side / (h - 1) as f64;
        let units = Units { length_m: length, frame_time_s: 1.0 / 50.0, areal_mass_kg_m2: 0.2 };
        let k = units.material(moduli);
        let area = side * length * (w - 1) as f64;
        let sheet = |place: &dyn Fn(f64, f64) -> [f64; 3]| -> Vec<Vec<[f64; 3]>> {
            (0..h).map(|i| (0..w).map(|j| place(i as f64, j as f64)).collect()).collect()
        };
        let joules = |x: &[Vec<[f64; 3]>]| units.energy_j(energy(x, k), h * w);
        let (strain, curvature) = (1e-4, 2.0);
        let stretched = sheet(&|i, j| [j, i * (1.0 + strain), 0.0]);
        let sheared = sheet(&|i, j| [j + strain * i, i, 0.0]);
        // Points on an arc whose chords are one edge long; the angle between them is curvature times length.
        let turn = curvature * length;
        let radius = 0.5 / (turn / 2.0).sin();
        let bent = sheet(&|i, j| [radius * (turn * j).sin(), i, radius * (1.0 - (turn * j).cos())]);
        let cases = [
            ("stretch", joules(&stretched), 0.5 * moduli.stretch_modulus * strain * strain * area),
            ("shear", joules(&sheared), 0.5 * moduli.shear_modulus * strain * strain * area),
            ("bend", joules(&bent), 0.5 * moduli.bending_stiffness * curvature * curvature * area),
        ];
        for (name, found, expected) in cases {
            println!("{h}x{w} {name}: {:.5}", found / expected);
            assert!((found / expected - 1.0).abs() < 0.01, "{name} at {h}x{w}: {found} J, not {expected} J");
        }
        let back = units.moduli(k);
        assert!((back.bending_stiffness / moduli.bending_stiffness - 1.0).abs() < 1e-14);
    }
}

#[test]
fn units_go_both_ways() {
    let units = Units { length_m: 1.0 / 31.0, frame_time_s: 1.0 / 60.0, areal_mass_kg_m2: 0.187 };
    let v = [1.0, -2.0, 3.0];
    assert!(distance(units.position_m(units.position(v)), v) < 1e-14);
    assert!(distance(units.velocity_m_s(units.velocity(v)), v) < 1e-14);
    assert!(distance(units.acceleration_m_s2(units.acceleration(v)), v) < 1e-14);
    assert_eq!(units.position([1.0, 0.0, 0.0])[0], 31.0);
    assert!((units.acceleration([3600.0, 0.0, 0.0])[0] - 31.0).abs() < 1e-12);
    let (density, drag) = units.air_si(units.air(1.2, 0.3));
    assert!((density - 1.2).abs() < 1e-14 && (drag - 0.3).abs() < 1e-14);
    for up in [UpAxis::Y, UpAxis::Z] {
        assert_eq!(up.from_z_up(up.to_z_up(v)), v);
        assert_eq!(up.to_z_up(up.down(1.0)), [0.0, 0.0, -1.0]);
    }
    assert_eq!(UpAxis::Y.to_z_up([1.0, 2.0, 3.0]), [1.0, -3.0, 2.0]);
}

#[test]
fn the_same_wind_accelerates_a_cell_by_its_physics() {
    let units = Units { length_m: 0.02, frame_time_s: 0.01, areal_mass_kg_m2: 0.3 };
    let air = units.air(1.2, 0.5);
    // A free cell across a wind of 3 m/s along x, and one along it.
    let u = units.velocity([3.0, 0.0, 0.0])[0];
    let across = units.acceleration_m_s2([air.density * u * u, 0.0, 0.0])[0];
    assert!((across - 1.2 * 9.0 / 0.3).abs() < 1e-12);
    let along = units.acceleration_m_s2([air.drag * u, 0.0, 0.0])[0];
    assert!((along - 0.5 * 3.0 / 0.3).abs() < 1e-12);
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
    assert!((k(&after).stretch / k(&before).stretch - 4.0).abs() < 1e-12);
    assert!((k(&after).bend / k(&before).bend - 16.0).abs() < 1e-11);
    // Grid coefficients stay as they are given.
    scene.stiffness = Stiffness::Grid(Material { stretch: 5.0, shear: 6.0, bend: 7.0 });
    scene.regrid(Grid { h: 40, w: 40 }).unwrap();
    assert_eq!(k(&scene.setup().unwrap()), Material { stretch: 5.0, shear: 6.0, bend: 7.0 });
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
    assert_eq!(control.wind, [a.wind, b.wind, a.wind]);
    let other = parse(r#"{"grid": [16, 16]}"#).unwrap().setup().unwrap();
    assert!(Setup::batch(&[a.clone(), other]).unwrap_err().to_string().contains("32x32"));
    let slow = parse(r#"{"frame_time_s": 0.02}"#).unwrap().setup().unwrap();
    assert!(Setup::batch(&[a, slow]).unwrap_err().to_string().contains("frame time"));
    assert!(Setup::batch(&[]).is_err());
}

#[test]
fn placements_are_inside_every_grid() {
    for (h, w) in [(8, 8), (9, 16), (33, 48)] {
        let grid = Grid { h, w };
        for placement in Placement::ALL {
            let handles = Handles::Placement(placement).on(grid, "test").unwrap();
            assert_eq!(handles.len(), if placement.name().starts_with("single") { 1 } else { 2 });
            assert_eq!(Placement::named(placement.name(), "test").unwrap(), placement);
        }
    }
}

#[test]
fn wrong_scenes_are_refused_with_the_place_and_what_was_expected() {
    for (text, parts) in [
        ("{", &["scene.json", "line 1", "JSON"][..]),
        ("[1]", &["document", "an object"]),
        (r#"{"gird": [32, 32]}"#, &["unknown field 'gird'", "grid"]),
        (r#"{"wind": {"densty": 1}}"#, &["scene.json: wind", "'densty'", "density"]),
        (r#"{"material": {"strech": 1}}"#, &["'strech'", "stretch"]),
        (r#"{"grid": [7, 32]}"#, &["grid height", "8 to", "7"]),
        (r#"{"grid": [32, 7]}"#, &["grid width", "7"]),
        (r#"{"grid": [32]}"#, &["grid", "[H, W]", "[32]"]),
        (r#"{"grid": [32.5, 32]}"#, &["grid[0]", "whole number", "32.5"]),
        (r#"{"grid": [-32, 32]}"#, &["grid[0]", "-32"]),
        (r#"{"grid": [99999999999999999999, 32]}"#, &["grid[0]"]),
        (r#"{"grid": [5000, 5000]}"#, &["grid height", "4096"]),
        (r#"{"side_m": [1, 1.5]}"#, &["side_m", "width of 1.000000 m", "1.5"]),
        (r#"{"side_m": 0}"#, &["side_m", "above 0"]),
        (r#"{"side_m": "1 m"}"#, &["side_m", "1 m"]),
        (r#"{"mass_kg": -1}"#, &["mass_kg", "above 0", "-1"]),
        (r#"{"areal_mass_kg_m2": 0}"#, &["areal_mass_kg_m2", "above 0"]),
        (r#"{"mass_kg": 1, "areal_mass_kg_m2": 1}"#, &["mass_kg", "not both"]),
        (r#"{"gravity": [0, 1e999, 0]}"#, &["line 1", "number out of range"]),
        (r#"{"gravity": [0, NaN, 0]}"#, &["line 1", "JSON"]),
        (r#"{"gravity": [0, -9.8]}"#, &["gravity", "three numbers"]),
        (r#"{"wind": {"velocity": [0, null, 0]}}"#, &["wind.velocity[1]", "a number"]),
        (r#"{"wind": {"density": -1}}"#, &["wind.density", "-1"]),
        (r#"{"material": {"stretch": -1}}"#, &["material.stretch", "-1"]),
        (r#"{"material": {"stretch_modulus": 1}}"#, &["material", "all three of"]),
        (r#"{"material": {"stretch_modulus": 1, "bend": 1}}"#, &["material.bend", "not both"]),
        (r#"{"frame_time_s": 0}"#, &["frame_time_s"]),
        (r#"{"frames": 0}"#, &["frames", "1 or more"]),
        (r#"{"frames": 1000000000}"#, &["frames", "1 to 1000000"]),
        (r#"{"frame_time_s": 1e-300}"#, &["frames"]),
        (r#"{"speed": -2}"#, &["speed"]),
        (r#"{"up": "x"}"#, &["up", "\"y\" or \"z\""]),
        (r#"{"motion": "xy_v3"}"#, &["unknown motion 'xy_v3'", "xy_v2"]),
        (r#"{"handles": "corner"}"#, &["unknown handle placement", "corners"]),
        (r#"{"handles": [[0, 32]]}"#, &["handles[0]", "j below 32", "[0, 32]"]),
        (r#"{"handles": [5, 1024]}"#, &["handles[1]", "below 1024", "1024"]),
        (r#"{"handles": [5, 7, 5]}"#, &["handles[2]", "(0, 5) again"]),
        (r#"{"handles": [5, [7, 5]]}"#, &["handles[1]", "whole number"]),
        (r#"{"handles": []}"#, &["handles", "motion 'xy_v2'"]),
        (r#"{"handles": {}}"#, &["handles", "placement"]),
        (r#"{"start": "setled"}"#, &["unknown start state", "settled"]),
        (r#"{"start": "absent.obj"}"#, &["absent.obj", "cannot read"]),
        (r#"{"start": {"grid": [32, 32]}}"#, &["start", "file"]),
        (r#"{"start": {"file": "a.obj", "transform": [1]}}"#, &["start.transform", "4x4"]),
        (r#"{"start": {"file": "a.obj", "transform": {"rotate": [1, 0, 0, 0]}}}"#, &["rotate", "axis"]),
        (r#"{"start": "../starts/tent_12x9.obj"}"#, &["tent_12x9.obj", "vertices", "1024", "108"]),
        (
            r#"{"start": "../starts/tent_12x9.obj", "grid": [9, 12]}"#,
            &["tent_12x9.obj", "line", "they fit 12x9"],
        ),
        (
            r#"{"start": "../starts/settled_64.npy"}"#,
            &["settled_64.npy", "shape", "[32, 32, 3]", "[64, 64, 3]"],
        ),
        (r#"{"motion": "../motions/absent.npy"}"#, &["absent.npy", "cannot read"]),
        (
            r#"{"motion": "../motions/xy_v2.npy", "handles": [1]}"#,
            &["xy_v2.npy", "[frames, 1, 3]", "[391, 2, 3]"],
        ),
        (r#"{"mesh_file": "../starts/tent_12x9.obj"}"#, &["mesh_resolution"]),
        (r#"{"mesh_resolution": 12}"#, &["mesh_file"]),
        (r#"{"mesh_file": "a.obj", "mesh_resoluton": 12}"#, &["unknown field", "mesh_resolution"]),
        (r#"{"mesh_file": "absent.obj", "mesh_resolution": 12}"#, &["absent.obj", "cannot read"]),
        (
            r#"{"mesh_file": "../starts/tent_12x9.obj", "mesh_resolution": [12, 9], "handle_ind_list": [0, 108]}"#,
            &["handle_ind_list[1]", "below 108 (12x9)", "found 108"],
        ),
        (r#"{"mesh_file": "../starts/tent_12x9.obj", "mesh_resolution": 12}"#, &["vertices", "144", "108"]),
    ] {
        expect_refusal(text, parts);
    }
}

#[test]
fn wrong_files_of_a_scene_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, bytes: &[u8], field: &str, parts: &[&str]| {
        std::fs::write(folder.path().join(name), bytes).unwrap();
        let text = format!("{{\"grid\": [8, 8], \"{field}\": \"{name}\"}}");
        let scene = Scene::parse(&text, "scene.json", folder.path()).unwrap();
        let error = scene.setup().expect_err(name).to_string();
        for part in [name].iter().chain(parts) {
            assert!(error.contains(part), "'{part}' is missing from: {error}");
        }
    };
    let npy = |a: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = Vec::new();
        a(&mut bytes);
        bytes
    };
    let motion = npy(&|b| ndarray::Array3::<f64>::zeros((4, 2, 3)).write_npy(b).unwrap());
    refused("short.npy", &motion[..motion.len() - 1], "motion", &["data", "bytes"]);
    refused("empty.npy", b"", "motion", &["header", ".npy"]);
    refused("text.npy", b"\x93NUMPY\x01\x00not a header at all", "motion", &["header"]);
    let huge = [b"\x93NUMPY\x02\x00\xff\xff\xff\xff".as_slice(), &motion].concat();
    refused("huge.npy", &huge, "motion", &["header"]);
    refused(
        "int.npy",
        &npy(&|b| ndarray::Array3::<i64>::zeros((4, 2, 3)).write_npy(b).unwrap()),
        "motion",
        &["dtype", "'<f4' or '<f8'"],
    );
    refused(
        "flat.npy",
        &npy(&|b| ndarray::Array2::<f64>::zeros((4, 6)).write_npy(b).unwrap()),
        "motion",
        &["shape", "[frames, 2, 3]", "[4, 6]"],
    );
    refused(
        "none.npy",
        &npy(&|b| ndarray::Array3::<f64>::zeros((0, 2, 3)).write_npy(b).unwrap()),
        "motion",
        &["shape"],
    );
    refused(
        "nan.npy",
        &npy(&|b| ndarray::Array3::from_elem((4, 2, 3), f32::NAN).write_npy(b).unwrap()),
        "motion",
        &["finite", "NaN"],
    );

    let mut obj: String = (0..64).map(|k| format!("v {} {} 0\n", k % 8, k / 8)).collect();
    refused("number.obj", format!("{obj}v 1 x 2\n").as_bytes(), "start", &["line 65", "v X Y Z"]);
    refused("nan.obj", format!("{obj}v 1 nan 2\n").as_bytes(), "start", &["line 65", "finite"]);
    refused(
        "vertex.obj",
        format!("{obj}f 1 2 65\n").as_bytes(),
        "start",
        &["line 65", "vertices that exist"],
    );
    refused("count.obj", format!("{obj}v 1 2 3\n").as_bytes(), "start", &["vertices", "64", "65"]);
    refused(
        "far.obj",
        format!("{obj}f 1 2 60\n").as_bytes(),
        "start",
        &["line 65", "one cell of the 8x8 grid"],
    );
    refused("holes.obj", format!("{obj}f 1 2 10 9\n").as_bytes(), "start", &["cell (0, 1)", "0 triangles"]);
    // Faces with texture coordinates and counted from the end are fine, and so is a mesh without faces.
    for i in 0..7i32 {
        for j in 0..7i32 {
            let a = i * 8 + j + 1;
            obj += &format!("f {a}/1/1 {}/2 {}//3 {}\n", a + 8 - 65, a + 9, a + 1);
        }
    }
    std::fs::write(folder.path().join("good.obj"), &obj).unwrap();
    let scene =
        Scene::parse(r#"{"grid": [8, 8], "start": "good.obj"}"#, "scene.json", folder.path()).unwrap();
    scene.setup().unwrap();
}

#[test]
fn numbers_set_by_hand_are_checked_too() {
    let refused = |scene: Scene| scene.setup().unwrap_err().to_string();
    assert!(refused(Scene { frame_time_s: f64::NAN, ..Scene::default() }).contains("frame_time_s"));
    assert!(refused(Scene { gravity: [f64::INFINITY; 3], ..Scene::default() }).contains("gravity"));
    assert!(refused(Scene { grid: Grid { h: 0, w: 0 }, ..Scene::default() }).contains("grid height"));
    assert!(
        refused(Scene { gravity: [1e308; 3], frame_time_s: 100.0, frames: Some(1), ..Scene::default() })
            .contains("gravity")
    );
    assert!(Scene { grid: Grid { h: 1, w: 1 }, ..Scene::default() }.regrid(Grid { h: 8, w: 8 }).is_err());
    assert!(Motion::parse("swing", "--motion", Path::new(".")).unwrap_err().to_string().contains("--motion"));
    assert!(Start::parse("swing", "--start", Path::new(".")).is_err());
    assert!(BuiltIn::named("xy_opp_opp").is_none());
}

/// Texts that a scene's field could hold by mistake.
fn junk() -> impl Strategy<Value = String> {
    prop_oneof![
        Just("null".to_owned()),
        Just("[]".to_owned()),
        Just("{}".to_owned()),
        Just("\"\"".to_owned()),
        Just("[[1,2],[3]]".to_owned()),
        Just("[0, 0, 1e300]".to_owned()),
        Just("\"x.npy\"".to_owned()),
        any::<f64>().prop_map(|v| v.to_string()),
        any::<i64>().prop_map(|v| v.to_string()),
        prop::collection::vec(any::<u16>(), 0..4).prop_map(|v| format!("{v:?}")),
        "[a-z_]{0,8}".prop_map(|s| format!("\"{s}\"")),
    ]
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(scene) = parse(&String::from_utf8_lossy(&bytes)) {
            let _ = scene.setup();
        }
    }

    #[test]
    fn mutated_scenes_never_panic(
        file in prop::sample::select(vec!["default", "moduli", "cells", "obj_start", "authors", "recorded", "npy_start"]),
        field in any::<prop::sample::Index>(),
        value in junk(),
        cut in any::<prop::sample::Index>(),
    ) {
        let text = std::fs::read_to_string(assets(&format!("scenes/{file}.json"))).unwrap();
        // One field replaced, at any depth of one, and the text cut short or with one byte changed.
        let mut document: serde_json::Value = serde_json::from_str(&text).unwrap();
        let object = document.as_object_mut().unwrap();
        let key = object.keys().nth(field.index(object.len())).unwrap().clone();
        object.insert(key, serde_json::from_str(&value).unwrap_or(serde_json::Value::Null));
        if let Ok(scene) = parse(&document.to_string()) && scene.grid.particles() < 1 << 18 {
            let _ = scene.setup();
        }
        let at = cut.index(text.len());
        let _ = parse(text.get(..at).unwrap_or(""));
        let mut bytes = text.into_bytes();
        bytes[at] ^= 1 + (at % 7) as u8;
        if let Ok(scene) = parse(&String::from_utf8_lossy(&bytes)) && scene.grid.particles() < 1 << 18 {
            let _ = scene.setup();
        }
    }

    #[test]
    fn damaged_arrays_and_meshes_never_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        at in any::<prop::sample::Index>(),
        name in prop::sample::select(vec!["starts/settled_32.npy", "starts/tent_12x9.obj"]),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut whole = std::fs::read(assets(name)).unwrap();
        let from = at.index(if name.ends_with("npy") { 140 } else { whole.len() });
        let to = (from + bytes.len()).min(whole.len());
        whole.splice(from..to, bytes);
        let file = folder.path().join(Path::new(name).file_name().unwrap());
        std::fs::write(&file, whole).unwrap();
        let (h, w) = if name.ends_with("npy") { (32, 32) } else { (12, 9) };
        let file = serde_json::json!({ "grid": [h, w], "start": file.to_str().unwrap() });
        let _ = parse(&file.to_string()).unwrap().setup();
    }
}
