//! Meshes that a cloth carries along, and starts whose vertices are in another order than its particles.

use fnopt::cloth::Grid;
use fnopt::scene::{Scene, Setup};
use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// Writes a mesh of vertices with these texture coordinates, joined by triangles in turn, into `mesh.obj`.
fn write_mesh(folder: &Path, uv: &[[f32; 2]]) {
    let mut text = String::new();
    for [u, v] in uv {
        // Where its vertices are in the file does not matter.
        writeln!(text, "v 7 {u} -3\nvt {u} {v}").unwrap();
    }
    for k in 3..=uv.len() {
        writeln!(text, "f {0}/{0} {1}/{1} {2}/{2}", k - 2, k - 1, k).unwrap();
    }
    std::fs::write(folder.join("mesh.obj"), text).unwrap();
}

fn scattered(count: usize) -> Vec<[f32; 2]> {
    (0..count).map(|k| [(0.618_034 * k as f64 % 1.0) as f32, (0.754_878 * k as f64 % 1.0) as f32]).collect()
}

fn scene(folder: &Path, fields: &str) -> Scene {
    let text = format!(r#"{{"mesh": "mesh.obj", {fields}}}"#);
    Scene::parse(&text, "scene.json", folder).unwrap()
}

fn setup(folder: &Path, fields: &str) -> Setup {
    scene(folder, fields).setup().unwrap()
}

#[test]
fn a_mesh_is_where_the_sheet_is() {
    let folder = tempfile::tempdir().unwrap();
    let uv = scattered(400);
    write_mesh(folder.path(), &uv);
    let setup = setup(folder.path(), r#""grid": [17, 25], "start": "flat", "side_m": 0.8, "up": "z""#);
    let topology = setup.topology();
    assert_eq!((topology.vertices(), topology.uv(), topology.counts().len()), (400, &uv[..], 398));
    let [positions, velocities] = setup.points(&setup.start.cast());
    for (found, [u, v]) in positions.iter().zip(&uv) {
        // Edges of 0.05 m.
        let expected = [(1.0 - v) * 24.0 * 0.05, (1.0 - u) * 0.8 - 0.4, 0.0];
        (0..3).for_each(|c| assert!((found[c] - expected[c]).abs() < 1e-6, "{found:?} {expected:?}"));
    }
    assert!(velocities.as_flattened().iter().all(|v| *v == 0.0));
    // Simulations go on from the particles.
    assert_eq!(setup.particles(&setup.start.cast())[0].len(), 17 * 25);
    assert_eq!(setup.trajectory().unwrap().positions().shape(), [1, 17 * 25, 3]);
    assert_eq!(setup.particle_topology().vertices(), 17 * 25);
}

#[test]
fn the_mesh_of_the_grid_itself_is_its_particles() {
    let folder = tempfile::tempdir().unwrap();
    let grid = Grid { h: 12, w: 19 };
    write_mesh(folder.path(), &grid.texture_coordinates());
    let setup = setup(folder.path(), r#""grid": [12, 19]"#);
    let state = setup.start.cast();
    assert_eq!(setup.points(&state), setup.particles(&state));
}

#[test]
fn a_mesh_is_carried_by_what_a_mask_leaves() {
    let folder = tempfile::tempdir().unwrap();
    // Around the rim of the disc, up to 0.9 edges beyond it.
    let rim = |k: usize, edges: f64| {
        let (sin, cos) = (k as f64 / 60.0 * std::f64::consts::TAU).sin_cos();
        [cos, sin].map(|c| (0.5 + c * (0.5 - 1.0 / 32.0 + edges / 32.0)) as f32)
    };
    write_mesh(folder.path(), &(0..60).map(|k| rim(k, 0.9)).collect::<Vec<_>>());
    let disc = r#""grid": [33, 33], "mask": "disc", "handles": [[16, 16]], "motion": "none""#;
    let setup = setup(folder.path(), disc);
    let (mask, embedded) = (setup.model.cloths[0].mask.clone().unwrap(), setup.embedding.clone().unwrap());
    for k in 0..60 {
        assert!(embedded.embedding.corners(k).iter().all(|&(p, _)| mask.contains(p)));
    }
    write_mesh(folder.path(), &[[0.5, 0.5], [0.9, 0.5], [0.99, 0.99]]);
    let error = scene(folder.path(), disc).setup().unwrap_err().to_string();
    assert!(error.contains("mesh.obj: vertex 2: ") && error.contains("found uv [0.99, 0.99]"), "{error}");
}

#[test]
fn scenes_with_a_mesh_survive_a_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    write_mesh(folder.path(), &scattered(9));
    let scene = scene(folder.path(), r#""start": "flat""#);
    let object =
        Scene::parse(r#"{"mesh": {"file": "mesh.obj"}, "start": "flat"}"#, "scene.json", folder.path());
    assert_eq!(object.unwrap(), scene);
    assert_eq!(Scene::parse(&scene.to_json().to_string(), "scene.json", Path::new("")).unwrap(), scene);
    assert!(scene.files().any(|file| file.ends_with("mesh.obj")));
    let relative = Scene { mesh: Some("data/mesh.obj".into()), ..scene };
    relative.save(folder.path().join("saved.json")).unwrap();
    let saved = Scene::load(folder.path().join("saved.json")).unwrap();
    assert_eq!(saved.mesh, Some(std::env::current_dir().unwrap().join("data/mesh.obj").into()));
}

#[test]
fn what_is_no_mesh_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |text: &str, parts: &[&str]| {
        let error =
            Scene::parse(text, "scene.json", folder.path()).and_then(|scene| scene.setup()).unwrap_err();
        let error = error.to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{text}: {error}");
    };
    std::fs::write(folder.path().join("bare.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    std::fs::write(folder.path().join("far.obj"), "v 0 0 0\nvt 0 1.25\nf 1/1 1/1 1/1\n").unwrap();
    refused(r#"{"mesh": "absent.obj"}"#, &["absent.obj", "cannot read"]);
    refused(
        r#"{"mesh": "bare.obj"}"#,
        &["bare.obj: mesh: expected texture coordinates", "a mesh without UVs"],
    );
    refused(r#"{"mesh": "far.obj"}"#, &["far.obj: line 3, vertex 1: ", "from 0 to 1", "uv [0, 1.25]"]);
    refused(
        r#"{"mesh": "mesh.fbx"}"#,
        &["scene.json: mesh: expected the path of an .obj, .glb or .gltf file"],
    );
    refused(
        r#"{"mesh": 3}"#,
        &["mesh: expected the path of an .obj, .glb or .gltf file, or {\"file\": path, \"object\": name}"],
    );
    refused(r#"{"mesh": {"file": "a.obj", "object": 3}}"#, &["mesh.object: expected a text"]);
    refused(r#"{"mesh": {"file": "a.obj", "objects": "b"}}"#, &["objects", "did you mean object"]);
    let bodies = |fields: &str| format!(r#"{{"bodies": [{{"shape": "mesh", {fields}}}]}}"#);
    refused(
        &bodies(r#""object": "b", "vertices": [], "faces": []"#),
        &["bodies[0].object: expected none without the \"file\" that it is in"],
    );
    refused(r#"{"mesh": {"path": "a.obj"}}"#, &["path", "file"]);
    refused(r#"{"mesh": {"file": 3}}"#, &["mesh.file"]);
    refused(r#"{"mehs": "a.obj"}"#, &["mehs", "did you mean mesh"]);
    refused(r#"{"render_mesh": "a.obj"}"#, &["it is called \"mesh\""]);
}

/// A file with a flag, a closed body and something else, as programs write what they have.
#[test]
fn a_cloth_and_its_bodies_may_be_objects_of_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let things = "o Elsewhere\nv 9 9 9\nv 9 8 9\nv 8 9 9\nvt 7 7\nf 1/1 2/1 3/1\n\
        o Flag\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0.5 1\nf 4/2 5/3 6/4\n\
        o Things\ng Stand big\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 7 9 8\nf 7 8 10\nf 8 9 10\nf 7 10 9\n";
    std::fs::write(folder.path().join("things.obj"), things).unwrap();
    let text = |object: &str| {
        format!(
            r#"{{"grid": [12, 12], "start": "flat", "mesh": {{"file": "things.obj", "object": "{object}"}},
                "bodies": [{{"shape": "mesh", "file": "things.obj", "object": "Stand", "cells": 16,
                    "position_m": [0, -3, 0]}}]}}"#
        )
    };
    let scene = Scene::parse(&text("Flag"), "scene.json", folder.path()).unwrap();
    assert_eq!(Scene::parse(&scene.to_json().to_string(), "scene.json", Path::new("")).unwrap(), scene);
    let setup = scene.setup().unwrap();
    assert_eq!(setup.topology().vertices(), 3);
    // All of the stand and nothing of the rest, which is metres away.
    let body = &setup.model.cloths[0].bodies[0];
    let fnopt::cloth::Shape::Mesh { field, .. } = &body.shape else { panic!("{body:?}") };
    assert!((field.volume() - 1.0 / 6.0).abs() < 1e-12, "{}", field.volume());
    assert!(field.bounds().as_flattened().iter().all(|c| c.abs() < 1.1), "{:?}", field.bounds());
    let error =
        Scene::parse(&text("flag"), "scene.json", folder.path()).unwrap().setup().unwrap_err().to_string();
    let said = "things.obj: unknown object with faces 'flag' (did you mean Flag";
    assert!(error.contains(said), "{error}");
}

/// The vertices of a sheet in another order, as other programs write them.
#[test]
fn a_start_in_another_order_is_recognised() {
    let folder = tempfile::tempdir().unwrap();
    let grid = Grid { h: 9, w: 12 };
    let setup = |name: &str| {
        let text =
            format!(r#"{{"grid": [9, 12], "side_m": 0.8, "up": "z", "start": "{name}", "motion": "none"}}"#);
        Scene::parse(&text, "scene.json", folder.path()).and_then(|scene| scene.setup())
    };
    // A wave that is not the same from any side.
    let place = |p: usize| {
        let (i, j) = ((p / 12) as f64, (p % 12) as f64);
        [0.1 * j, 0.1 * i, 0.02 * (0.7 * i + 0.2 * j).sin()]
    };
    let write = |name: &str, order: &dyn Fn(usize) -> usize, has_uv: bool| {
        let mut at = vec![0; 108];
        (0..108).for_each(|p| at[order(p)] = p);
        let (uv, mut text) = (grid.texture_coordinates(), String::new());
        for &p in &at {
            let ([x, y, z], [u, v]) = (place(p), uv[p]);
            writeln!(text, "v {x} {y} {z}").unwrap();
            if has_uv {
                writeln!(text, "vt {u} {v}").unwrap();
            }
        }
        for (i, j) in (0..8).flat_map(|i| (0..11).map(move |j| (i, j))) {
            let cell = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| order(i * 12 + j) + 1);
            let corner = |k: usize| if has_uv { format!("{k}/{k}") } else { k.to_string() };
            writeln!(text, "f {}", cell.map(corner).join(" ")).unwrap();
        }
        std::fs::write(folder.path().join(name), text).unwrap();
    };
    write("own.obj", &|p| p, false);
    let own = setup("own.obj").unwrap();
    // 5 has no factor in common with 108.
    let scrambled = |p: usize| (5 * p + 17) % 108;
    let columns = |p: usize| p % 12 * 9 + p / 12;
    write("scrambled.obj", &scrambled, true);
    write("columns.obj", &columns, false);
    assert_eq!(setup("scrambled.obj").unwrap().start, own.start);
    // Column by column is a grid in order, though not this one: more often a mistake.
    let error = setup("columns.obj").unwrap_err().to_string();
    assert!(error.contains("they fit 12x9"), "{error}");
    // Of the two ways that the faces leave, that whose first particle is the first in the file.
    let first_is_first = |p: usize| if p == 0 { 0 } else { 1 + 7 * p % 107 };
    write("first.obj", &first_is_first, false);
    assert_eq!(setup("first.obj").unwrap().start, own.start);
    // No grid: two faces in the place of one.
    let mut text = std::fs::read_to_string(folder.path().join("scrambled.obj")).unwrap();
    text += "f 1/1 2/2 3/3\n";
    std::fs::write(folder.path().join("wrong.obj"), text).unwrap();
    assert!(setup("wrong.obj").unwrap_err().to_string().contains("the corners of one cell of the 9x12 grid"));
}

/// A mesh of 20,000 vertices costs little beside a frame of 64x64 particles.
#[test]
fn carrying_a_mesh_is_cheap() {
    let folder = tempfile::tempdir().unwrap();
    write_mesh(folder.path(), &scattered(20_000));
    let setup = setup(folder.path(), r#""grid": [64, 64], "start": "flat""#);
    let optimizer = fnopt::sim::Optimizer::named("spectral", "a test", || unreachable!()).unwrap();
    let mut simulator = fnopt::Simulator::new(&fnopt::Device::Cpu, &setup.model, &optimizer, 20).unwrap();
    simulator.set_state(&setup.start.cast());
    let embedding = &setup.embedding.as_ref().unwrap().embedding;
    let (mut frames, mut carrying) = (Vec::new(), Vec::new());
    for frame in 1..12 {
        let frame = simulator.step(&setup.control(frame)).unwrap();
        frames.push(frame.wall);
        let [particles, _] = setup.particles(&frame.state);
        let begin = Instant::now();
        assert_eq!(embedding.positions(&particles).len(), 20_000);
        carrying.push(begin.elapsed());
    }
    let median = |times: &mut Vec<Duration>| {
        times.sort();
        times[times.len() / 2]
    };
    let (frame, carrying) = (median(&mut frames), median(&mut carrying));
    println!("a frame takes {frame:?}, and 20000 vertices {carrying:?}");
    assert!(carrying < frame / 10, "{carrying:?} of {frame:?}");
}
