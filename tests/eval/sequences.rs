//! Reading of sequences: grids and meshes, other systems' files, checksums, refusals.

use crate::common::{PHYSICS, SETTINGS, newton, shipped, square};
use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::eval::{Sequence, Settings, compare, run};
use fnopt::io::{ReadOptions, Trajectory};
use fnopt::scene::{Mass, Wind};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Writes a copy of the shipped sequence with its vertices in reverse order, in a mesh with further vertices
/// at the centres of the cells. At rest it lies in the x-z plane.
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
        // Vertex numbers of the file, which start at 1.
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
fn a_mesh_that_is_not_a_grid_is_resampled_to_one() {
    let folder = tempfile::tempdir().unwrap();
    let to = meshed(folder.path());
    let sequence = Sequence::load(folder.path(), "meshed").unwrap();
    let original = Sequence::load(&shipped(), "xy_v2").unwrap();
    // About as many particles as vertices. Without handles.npy, the handles follow their vertices.
    assert_eq!(sequence.grid(), Grid { h: 45, w: 45 });
    let [found, expected] =
        [&sequence, &original].map(|s| s.scene(Grid { h: 32, w: 32 }, &PHYSICS).unwrap().setup().unwrap());
    assert_eq!(found.model.cloths[0].handles, expected.model.cloths[0].handles);
    let apart = |a: [f64; 3], b: [f64; 3]| square(a, b).sqrt();
    for frame in [0, 19] {
        for (&a, &b) in found.handles[frame].iter().zip(&expected.handles[frame]) {
            // In edges. The shipped trajectory is stored in half precision.
            assert!(apart(a, b) < 0.02, "handles of frame {frame}: {a:?}, {b:?}");
        }
    }
    let [mine, theirs] = [&found, &expected].map(|setup| setup.vertices_m(&setup.start.x));
    assert!(mine.iter().zip(&theirs).all(|(&a, &b)| apart(a, b) < 3e-3), "the start is elsewhere");
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
    assert!(Sequence::load(folder.path(), "meshed").is_err(), "1985 vertices are not a square grid");
    let meta = r#"{"handle_vertices": [31, 1023], "obj_code": "sheet"}"#;
    std::fs::write(to.join("meta.json"), meta).unwrap();
    assert_eq!(Sequence::load(folder.path(), "meshed").unwrap().grid(), Grid { h: 45, w: 45 });
}

/// Files without faces are on the ground truth's grid if they have as many vertices, else on a square grid.
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
        // 144 vertices could also be 12x12.
        let found = sequence.read_other(&wide.write(&to, "theirs", format).unwrap()).unwrap();
        assert_eq!(found.grid(), grid);
        assert_eq!(compare(&sequence, "theirs", &found, &settings).unwrap().e_3d, Some(0.0));
    }
    let bare = to.join("bare");
    std::fs::create_dir(&bare).unwrap();
    let points: String = frame.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
    (0..3).for_each(|k| std::fs::write(bare.join(format!("{k:05}.obj")), &points).unwrap());
    assert_eq!(sequence.read_other(&bare).unwrap().grid(), grid);
    let mut square = Trajectory::new(Grid { h: 10, w: 10 }, 60.0);
    (0..3).for_each(|_| square.push(&frame[..100], &frame[..100]));
    let file = square.write(&to, "square", fnopt::io::Format::Npy).unwrap();
    assert_eq!(sequence.read_other(&file).unwrap().grid(), Grid { h: 10, w: 10 });

    let to = meshed(folder.path());
    let sequence = Sequence::load(folder.path(), "meshed").unwrap();
    let found = sequence.read_other(&to.join("cloth_pos.npy")).unwrap();
    assert_eq!(found.grid().particles(), 1985);
    let score = compare(&sequence, "theirs", &found, &Settings { frames: 20, ..SETTINGS }).unwrap();
    // e_CD is that of two samples of one surface. The truth was resampled in the same way, so e_3D is 0.
    assert!(score.e_cd.unwrap() < 2e-3 && score.e_3d == Some(0.0), "{:?}, {:?}", score.e_cd, score.e_3d);
    assert_eq!(
        (score.grid.as_str(), sequence.on_grid(&found).unwrap().grid()),
        ("45x45", Grid { h: 45, w: 45 })
    );
}

/// Every field of `meta.json` reaches the scene, in its units and axes.
#[test]
fn the_cloth_is_the_one_described() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("other");
    std::fs::create_dir(&to).unwrap();
    std::fs::copy(shipped().join("xy_v2/cloth_pos.npy"), to.join("cloth_pos.npy")).unwrap();
    let meta = r#"{"handle_vertices": [992, 0], "fps": 50, "side_length_m": 0.5, "mass_per_area_kg_m2": 0.3,
        "gravity_m_s2": [0, -5, 1], "wind": {"velocity": [1, 2, 3], "density": 0.7, "drag": 0.02}}"#;
    std::fs::write(to.join("meta.json"), meta).unwrap();
    let sequence = Sequence::load(folder.path(), "other").unwrap();
    assert_eq!((sequence.truth.fps(), sequence.side_m()), (50.0, 0.5));
    let scene = sequence.scene(Grid { h: 32, w: 32 }, &PHYSICS).unwrap();
    let Wind { velocity, density, drag, .. } = scene.wind;
    assert_eq!((velocity, density, drag), ([1.0, 2.0, 3.0], 0.7, 0.02));
    assert_eq!((scene.mass, scene.gravity), (Mass::Areal(0.3), [0.0, -5.0, 1.0]));
    let setup = scene.setup().unwrap();
    assert_eq!((setup.units.length_m, setup.units.frame_time_s), (0.5 / 31.0, 0.02));
    // The z axis points up inside: y becomes z, and z becomes -y.
    let per_frame2 = 0.02 * 0.02 / (0.5 / 31.0);
    let expected = [0.0, -per_frame2, -5.0 * per_frame2];
    assert!(square(setup.model.cloths[0].gravity, expected).sqrt() < 1e-12, "{:?}", setup.model.cloths[0]);
    assert_eq!(setup.model.cloths[0].gravity, setup.acceleration_of::<f64>([0.0, -5.0, 1.0]));
    assert_eq!(setup.wind.velocity, setup.wind_of::<f64>([1.0, 2.0, 3.0]));
}

/// A change to any file of a sequence changes its checksum.
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
        // A digit in meta.json, or the lowest bit of a number in the middle of an array.
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

/// Sequences without anything to measure errors on, or relative to, are refused.
#[test]
fn recordings_of_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("short");
    std::fs::create_dir(&to).unwrap();
    let refused = |shape: (usize, usize, usize), zero: Option<usize>, meta: &str, said: &str| {
        let mut frames = ndarray::Array3::from_shape_fn(shape, |(_, p, c)| (p + c) as f32);
        if let Some(frame) = zero {
            frames.index_axis_mut(ndarray::Axis(0), frame).fill(0.0);
        }
        ndarray_npy::write_npy(to.join("cloth_pos.npy"), &frames).unwrap();
        std::fs::write(to.join("meta.json"), meta).unwrap();
        let error = Sequence::load(folder.path(), "short").unwrap_err().to_string();
        assert!(error.contains("cloth_pos.npy") && error.contains(said), "{error}");
    };
    refused((1, 64, 3), None, "{}", "frames: expected at least 2, found 1");
    refused((2, 1, 3), None, r#"{"handle_vertices": [0]}"#, "vertices: expected those of a grid");
    refused((3, 64, 3), Some(1), "{}", "frame 1: expected positions, found zeros only");
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
    assert!(error("grid").contains("fps: expected a number above 0"));
    std::fs::write(grid.join("meta.json"), "{").unwrap();
    assert!(error("grid").contains("meta.json: line 1, column 1: expected JSON"));
    std::fs::write(grid.join("meta.json"), r#"{"handle_vertices": "corner"}"#).unwrap();
    assert!(error("grid").contains("handle_vertices"));
    // Without handles.npy, the handles follow their vertices. start.npy has more digits than cloth_pos.npy.
    std::fs::write(grid.join("meta.json"), r#"{"handle_vertices": [992, 0]}"#).unwrap();
    let setup = |folder: &Path, name: &str| {
        let sequence = Sequence::load(folder, name).unwrap();
        sequence.scene(Grid { h: 32, w: 32 }, &PHYSICS).unwrap().setup().unwrap()
    };
    let recorded = setup(&shipped(), "xy_v2");
    std::fs::remove_file(grid.join("handles.npy")).unwrap();
    let followed = setup(folder.path(), "grid");
    let gap = |a: &[[f64; 3]], b: &[[f64; 3]]| square(a[0], b[0]).max(square(a[1], b[1])).sqrt();
    let farthest = recorded.handles.iter().zip(&followed.handles).map(|(a, b)| gap(a, b)).fold(0.0, f64::max);
    assert!(farthest > 0.0 && farthest < 0.02, "half precision: {farthest} edges");
    assert_ne!(recorded.start.x, followed.start.x);
    std::fs::copy(shipped().join("xy_v2/start.npy"), grid.join("start.npy")).unwrap();
    assert!(
        recorded.start.x.iter().zip(&setup(folder.path(), "grid").start.x).all(|(a, b)| (a - b).abs() < 0.02)
    );
    // Without meta.json, the cloth is the default one.
    std::fs::remove_file(grid.join("meta.json")).unwrap();
    assert_eq!(Sequence::load(folder.path(), "grid").unwrap().grid(), Grid { h: 32, w: 32 });
    assert_eq!(Sequence::names(folder.path()).unwrap(), ["grid"]);
    // Misspelt keys, values that are not numbers, and wrong numbers of frames are not ignored.
    let meta = copy("meta");
    let said = |text: &str, said: &str| {
        std::fs::write(meta.join("meta.json"), text).unwrap();
        let error = error("meta");
        assert!(error.contains("meta.json") && error.contains(said), "no '{said}' in {error}");
    };
    said(r#"{"wind": {"density": "1.2"}}"#, "wind.density: expected a number, 0 or more, found \"1.2\"");
    said(r#"{"wind": {"densty": 1.2}}"#, "'densty' (did you mean density?");
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
