//! Bodies of a scene: their conversion to grid units, their motion, and starts inside them.

use crate::common::{distance, parse};
use fnopt::cloth::{Control, Pose, Shape};
use fnopt::scene::Scene;
use glam::DVec3;

fn pose_m(pose: &Pose, edge_m: f64) -> [f64; 3] {
    // y up again.
    let [x, y, z] = pose.position.map(|c| c * edge_m);
    [x, z, -y]
}

#[test]
fn bodies_are_converted_to_grid_units() {
    let text = r#"{
        "grid": [11, 11], "start": "flat", "handles": [], "motion": "none", "frames": 3, "friction": 0.4,
        "bodies": [
            {"shape": "sphere", "radius_m": 0.2, "position_m": [0.5, -0.3, 0.1], "friction": 0.7},
            {"shape": "box", "sides_m": [0.4, 0.6, 0.8], "position_m": [0, -2, 0], "thickness_m": 0.01},
            {"shape": "capsule", "radius_m": 0.1, "length_m": 0.5, "axis": [0, 0, 2], "position_m": [0, -2, 0]},
            {"shape": "plane", "position_m": [0, -1, 0], "normal": [0, 3, 0]}
        ]
    }"#;
    let scene = parse(text).unwrap();
    let setup = scene.setup().unwrap();
    let bodies = &setup.model.cloths[0].bodies;
    assert!(matches!(bodies[0].shape, Shape::Sphere { radius } if (radius - 2.0).abs() < 1e-12));
    assert!(distance(pose_m(&bodies[0].pose, 0.1), [0.5, -0.3, 0.1]) < 1e-12);
    assert_eq!([bodies[0].friction, bodies[1].friction], [0.4, 0.3]);
    let Shape::Box { half } = bodies[1].shape else { panic!("{:?}", bodies[1]) };
    assert!(distance(half, [2.0, 4.0, 3.0]) < 1e-12, "{half:?}");
    let thickness = |k: usize| bodies[k].thickness;
    assert!((thickness(1) - 0.26).abs() < 1e-12 && (thickness(3) - 0.16).abs() < 1e-12);
    // A capsule of one edge: its edges clear it.
    assert!((thickness(2) - 0.16).abs() < 1e-12 && (thickness(0) - 0.16).abs() < 1e-12);
    // z of the scene is -y inside.
    let axis = bodies[2].pose.turned(DVec3::Z);
    assert!((axis + DVec3::Y).length() < 1e-12, "{axis}");
    assert!((bodies[3].pose.turned(DVec3::Z) - DVec3::Z).length() < 1e-12);
    assert!(setup.control::<f64>(1).bodies.is_empty(), "nothing moves");
    let again = Scene::parse(&scene.to_json().to_string(), "again", std::path::Path::new("")).unwrap();
    let again = again.setup().unwrap();
    for (one, other) in bodies.iter().zip(&again.model.cloths[0].bodies) {
        assert_eq!(one.shape, other.shape);
        assert!(distance(one.pose.position, other.pose.position) < 1e-12);
        let turned = |pose: &Pose| pose.turned(DVec3::new(1.0, 2.0, 3.0));
        assert!((turned(&one.pose) - turned(&other.pose)).length() < 1e-12);
    }
}

#[test]
fn bodies_move_through_keys_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let poses = ndarray::arr2(&[[0.0, -1.0, 0.0], [0.0, -1.5, 0.0]]);
    ndarray_npy::write_npy(folder.path().join("poses.npy"), &poses).unwrap();
    let text = r#"{
        "grid": [11, 11], "start": "flat", "handles": [], "motion": "none", "frames": 121, "up": "z",
        "bodies": [
            {"shape": "sphere", "radius_m": 0.1, "position_m": [0, 0, -1], "motion": [
                {"time_s": 0.5}, {"time_s": 1.5, "position_m": [1, 0, -1], "rotation": [90, 0, 0, 1]}]},
            {"shape": "sphere", "radius_m": 0.1, "motion": "poses.npy"}
        ]
    }"#;
    let setup = Scene::parse(text, "scene.json", folder.path()).unwrap().setup().unwrap();
    let place = |frame: usize, k: usize| {
        let control: Control<f64> = setup.control(frame);
        [control.bodies[k].from, control.bodies[k].to].map(|pose| pose.position.map(|c| 0.1 * c))
    };
    // Frame 60 is at 1 s, halfway.
    assert!(
        distance(place(60, 0)[1], [0.5, 0.0, -1.0]) < 1e-9
            && distance(place(60, 0)[0], place(59, 0)[1]) < 1e-12
    );
    assert_eq!([place(10, 0)[0], place(120, 0)[1]], [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0]]);
    let turned = setup.control::<f64>(60).bodies[0].to.turned(DVec3::X);
    assert!((turned - DVec3::new(1.0, 1.0, 0.0).normalize()).length() < 1e-9, "{turned}");
    assert!(
        distance(place(1, 1)[0], [0.0, -1.0, 0.0]) < 1e-12
            && distance(place(100, 1)[0], [0.0, -1.5, 0.0]) < 1e-12
    );
}

#[test]
fn a_start_inside_a_body_is_moved_out() {
    let text = r#"{"grid": [16, 16], "start": "flat", "handles": [], "motion": "none", "frames": 2,
        "bodies": [{"shape": "sphere", "radius_m": 0.3, "position_m": [0.5, -0.1, 0]}]}"#;
    let setup = parse(text).unwrap().setup().unwrap();
    let body = &setup.model.cloths[0].bodies[0];
    let n = setup.model.grid.particles();
    let x = &setup.start.x;
    let gaps: Vec<f64> = (0..n)
        .map(|p| body.shape.distance(body.pose.inward(DVec3::new(x[p], x[n + p], x[2 * n + p]))).distance)
        .collect();
    assert!(gaps.iter().all(|gap| *gap > body.thickness - 1e-9));
    assert!(gaps.iter().filter(|gap| **gap < body.thickness + 1e-9).count() > 20);
}

/// The sides of a box from `low` to `high`, as JSON.
fn box_mesh(low: [f64; 3], high: [f64; 3]) -> String {
    let corner = |k: usize| -> [f64; 3] { std::array::from_fn(|c| [low, high][k >> c & 1][c]) };
    let squares = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces: Vec<[u32; 3]> = squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    let vertices: Vec<[f64; 3]> = (0..8).map(corner).collect();
    format!(r#""vertices": {vertices:?}, "faces": {faces:?}"#)
}

/// A mesh comes from a file or stands in the scene, in any unit and with either axis up, and is the body that it shows.
#[test]
fn meshes_are_converted_to_grid_units() {
    let folder = tempfile::tempdir().unwrap();
    let obj = "v -20 -30 -40\nv 20 -30 -40\nv 20 30 -40\nv -20 30 -40\nv -20 -30 40\nv 20 -30 40\nv 20 30 40\nv -20 30 40\n\
        f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 3 4 8 7\nf 2 3 7 6\nf 1 5 8 4\n";
    std::fs::write(folder.path().join("box.obj"), obj).unwrap();
    let scene = |bodies: &str| {
        let text = format!(
            r#"{{"grid": [11, 11], "start": "flat", "handles": [], "motion": "none", "frames": 3, "bodies": [{bodies}]}}"#
        );
        Scene::parse(&text, "scene.json", folder.path()).unwrap()
    };
    let at = r#""position_m": [0.1, -1.2, 0]"#;
    let file = format!(r#"{{"shape": "mesh", "file": "box.obj", "unit_m": 0.01, "cells": 20, {at}}}"#);
    let inline = format!(r#"{{"shape": "mesh", {}, {at}}}"#, box_mesh([-0.2, -0.3, -0.4], [0.2, 0.3, 0.4]));
    let exact = format!(r#"{{"shape": "box", "sides_m": [0.4, 0.6, 0.8], {at}}}"#);
    let scene = scene(&[file, inline, exact].join(", "));
    let setup = scene.setup().unwrap();
    let [file, inline, exact] = &setup.model.cloths[0].bodies[..] else { panic!("three bodies") };
    for k in 0..400 {
        let p = (DVec3::new(0.754_877, 0.569_840, 0.430_159) * f64::from(k)).fract() * 16.0 - 8.0;
        let expected = exact.shape.distance(p);
        for (mesh, cell) in [(file, 0.4), (inline, 0.125)] {
            let found = mesh.shape.distance(p);
            // Beyond the samples it is a bound.
            let beyond = (p.abs() - DVec3::new(2.0, 4.0, 3.0)).max_element() > 2.0 * cell - 1e-6;
            assert!(found.distance < expected.distance + 0.5 * cell, "{found:?} at {p}, not {expected:?}");
            assert!(beyond || found.distance > expected.distance - 0.5 * cell, "{found:?}, not {expected:?}");
        }
    }
    assert_eq!(scene.files().count(), 1);
    let again = Scene::parse(&scene.to_json().to_string(), "scene.json", std::path::Path::new("")).unwrap();
    assert_eq!(again.bodies, scene.bodies);
}

/// glTF is y up, and an OBJ as the scene is: the same body, whichever axis is up.
#[test]
fn gltf_meshes_are_turned_to_the_scene() {
    use fnopt::io::{Format, Recording, Topology, WriteOptions, write_mesh};
    let folder = tempfile::tempdir().unwrap();
    let corner = |k: usize| std::array::from_fn(|c| [-0.2, 0.1, -0.4, 0.2, 0.5, 0.4][2 * c + (k >> c & 1)]);
    let corners: Vec<[f32; 3]> = (0..8).map(corner).collect();
    let sides = [[0u32, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut recording = Recording::new(folder.path(), Topology::new(8, sides).unwrap(), 60.0).unwrap();
    recording.push(&corners, &[[0.0; 3]; 8]).unwrap();
    write_mesh(&recording, folder.path().join("box.obj")).unwrap();
    for (up, z_up) in [("y", false), ("z", true)] {
        let options = WriteOptions { z_up, ..Default::default() };
        recording.write(folder.path(), "box", Format::Glb, &options).unwrap();
        let body = |file: &str| format!(r#"{{"shape": "mesh", "file": "{file}", "cells": 16}}"#);
        let bodies = [body("box.obj"), body("box.glb")].join(", ");
        let text = format!(
            r#"{{"up": "{up}", "start": "flat", "handles": [], "motion": "none", "bodies": [{bodies}]}}"#
        );
        let scene = Scene::parse(&text, "scene.json", folder.path()).unwrap();
        let setup = scene.setup().unwrap();
        let [obj, glb] = &setup.model.cloths[0].bodies[..] else { panic!("two bodies") };
        assert_eq!(obj.shape, glb.shape, "{up} up");
    }
}

#[test]
fn meshes_without_an_inside_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("open.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n",
    )
    .unwrap();
    let refusal = |body: &str| {
        let text = format!(r#"{{"handles": [], "motion": "none", "bodies": [{{"shape": "mesh", {body}}}]}}"#);
        let scene = Scene::parse(&text, "scene.json", folder.path());
        scene.and_then(|scene| scene.setup()).expect_err(&text).to_string()
    };
    for (body, said) in [
        (r#""file": "open.obj""#, &["open.obj: faces", "a closed mesh", "3 of its edges lack a face"][..]),
        (r#""file": "none.obj""#, &["none.obj"]),
        (r#""vertices": [[0, 0, 0]], "faces": []"#, &["scene.json: bodies[0]", "no faces"]),
        (
            r#""vertices": [[0, 0, 0]], "faces": [[0, 0, 1]]"#,
            &["bodies[0]", "vertex 1, which does not exist"],
        ),
        (r#""vertices": [[0, 0, 0]]"#, &["bodies[0]", "either the \"file\""]),
        (r#""file": "open.obj", "faces": []"#, &["bodies[0]", "either the \"file\""]),
        (r#""file": "open.obj", "cells": 7"#, &["bodies[0].cells", "8 to 256", "7"]),
        (r#""file": "open.obj", "unit_m": 0"#, &["bodies[0].unit_m", "above 0"]),
        (r#""fil": "open.obj""#, &["either the \"file\""]),
        (r#""file": "open.obj", "radius_m": 1"#, &["radius_m"]),
    ] {
        let error = refusal(body);
        said.iter().for_each(|part| assert!(error.contains(part), "'{part}' is missing from: {error}"));
    }
}
