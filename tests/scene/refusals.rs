//! Invalid scenes and files are refused by name and never cause a panic.

use crate::common::{assets, expect_refusal, parse};
use fnopt::cloth::Grid;
use fnopt::scene::{BuiltIn, Motion, Scene, Start};
use ndarray_npy::WriteNpyExt;
use proptest::prelude::*;
use std::path::Path;

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
        (r#"{"grid": 7}"#, &["grid height", "8 to", "7"]),
        (r#"{"grid": 32.5}"#, &["grid", "whole number", "32.5"]),
        (r#"{"grid": "32"}"#, &["grid", "[H, W], or one for both"]),
        (r#"{"grid": [32.5, 32]}"#, &["grid[0]", "whole number", "32.5"]),
        (r#"{"grid": [-32, 32]}"#, &["grid[0]", "-32"]),
        (r#"{"grid": [99999999999999999999, 32]}"#, &["grid[0]"]),
        (r#"{"grid": [5000, 5000]}"#, &["grid height", "4096"]),
        (r#"{"side_m": [1, 1.5]}"#, &["side_m", "width of 1.000000 m", "or a 33x49 grid", "1.5"]),
        (r#"{"side_m": [1, 200]}"#, &["side_m", "1 m high, found 200 m"]),
        (r#"{"motion": "walk.csv"}"#, &["motion", "a built-in motion or an .npy file", "walk.csv"]),
        (
            r#"{"start": "frames/cloth.pc2"}"#,
            &["start", "hanging or an .obj, .npy or .npz file", "cloth.pc2"],
        ),
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
        (r#"{"wind": {"velocity": [1e300, 0, 0]}}"#, &["wind", "single precision"]),
        (r#"{"start": {"file": "cloth.obj", "grid": [4, 9]}}"#, &["start: grid height", "found 4"]),
        (r#"{"self_contact": 1}"#, &["self_contact", "true, false or", "found 1"]),
        (r#"{"self_contact": {"thickness": 1}}"#, &["self_contact", "'thickness'", "thickness_m"]),
        (r#"{"self_contact": {"thickness_m": -1}}"#, &["self_contact.thickness_m", "above 0", "-1"]),
        (
            r#"{"self_contact": {"thickness_m": 0.1}}"#,
            &["self_contact.thickness", "0.001 to 0.5 edges", "3.1"],
        ),
        (r#"{"self_contact": {"friction": -1}}"#, &["self_contact.friction", "0 or more", "-1"]),
        (r#"{"self_collision": true}"#, &["self_collision", "\"self_contact\": true"]),
        (r#"{"repulsion": 1}"#, &["repulsion", "true, false or", "found 1"]),
        (r#"{"repulsion": {"strengh": 1}}"#, &["repulsion", "'strengh'", "strength"]),
        (r#"{"repulsion": {"strength": -1}}"#, &["repulsion.strength", "-1"]),
        (r#"{"repulsion": {"strength": 1e300}}"#, &["repulsion", "single precision"]),
        (r#"{"repulsion": {"distance": 0}}"#, &["repulsion.distance", "0.001 to 1 edges", "found 0"]),
        (r#"{"repulsion": {"distance": 1.5}}"#, &["repulsion.distance", "0.001 to 1 edges", "1.5"]),
        (r#"{"material": {"stretch": -1}}"#, &["material.stretch", "-1"]),
        (r#"{"material": {"stretch_modulus": 1}}"#, &["material", "all three of"]),
        (r#"{"material": {"stretch_modulus": 1, "bend": 1}}"#, &["material.bend", "not both"]),
        (r#"{"frame_time_s": 0}"#, &["frame_time_s"]),
        (r#"{"frames": 0}"#, &["frames", "1 or more"]),
        (r#"{"frames": -1}"#, &["frames", "1 or more, found -1"]),
        (r#"{"motion": 5}"#, &["motion", "a .npy file, or positions [frames, handles, 3], found 5"]),
        (r#"{"frames": 1000000000}"#, &["frames", "1 to 1000000"]),
        (r#"{"frame_time_s": 1e-300}"#, &["side_m, frame_time_s", "overflow"]),
        (r#"{"speed": 1e-300}"#, &["frame_time_s, speed", "1 to 1000000 frames"]),
        (r#"{"frame_time_s": 1e-310, "frames": 3}"#, &["frame_time_s", "1e-310"]),
        (r#"{"speed": -2}"#, &["speed"]),
        (r#"{"up": "x"}"#, &["up", "\"y\" or \"z\""]),
        (r#"{"damping": 0.1}"#, &["unknown field 'damping'", "wind"]),
        (r#"{"colliders": []}"#, &["unknown field 'colliders'", "bodies"]),
        (r#"{"floor": 0}"#, &["unknown field 'floor'", "plane"]),
        (r#"{"bodies": {}}"#, &["bodies", "an array"]),
        (r#"{"bodies": [3]}"#, &["bodies[0]", "a body"]),
        (r#"{"bodies": [{"radius_m": 1}]}"#, &["bodies[0]", "shape"]),
        (r#"{"bodies": [{"shape": "shpere", "radius_m": 1}]}"#, &["bodies[0].shape", "did you mean sphere"]),
        (r#"{"bodies": [{"shape": "sphere"}]}"#, &["bodies[0]", "radius_m"]),
        (r#"{"bodies": [{"shape": "sphere", "radius_m": 0}]}"#, &["bodies[0].radius_m", "above 0"]),
        (r#"{"bodies": [{"shape": "sphere", "radius": 1}]}"#, &["bodies[0]", "radius_m"]),
        (r#"{"bodies": [{"shape": "box", "sides_m": [1, 1]}]}"#, &["bodies[0].sides_m", "three"]),
        (r#"{"bodies": [{"shape": "plane", "normal": [0, 0, 0]}]}"#, &["bodies[0].normal", "not zero"]),
        (
            r#"{"bodies": [{"shape": "plane", "normal": [0, 1, 0], "rotation": [90, 1, 0, 0]}]}"#,
            &["bodies[0].rotation", "not both"],
        ),
        (r#"{"bodies": [{"shape": "plane", "friction": -1}]}"#, &["bodies[0].friction", "0 or more"]),
        (r#"{"bodies": [{"shape": "plane", "motion": []}]}"#, &["bodies[0].motion", "at least one key"]),
        (
            r#"{"bodies": [{"shape": "plane", "motion": [{"time_s": 1}, {"time_s": 1}]}]}"#,
            &["bodies[0].motion[1].time_s", "later"],
        ),
        (r#"{"bodies": [{"shape": "plane", "motion": "up"}]}"#, &["bodies[0].motion", ".npy"]),
        (r#"{"bodies": [{"shape": "plane", "position_m": [0, 1e9, 0]}]}"#, &["bodies[0].pose", "1e6 edges"]),
        (r#"{"friction": -1}"#, &["friction", "0 or more"]),
        (r#"{"thickness_m": 0}"#, &["thickness_m", "above 0"]),
        (
            r#"{"thickness_m": 1, "bodies": [{"shape": "plane"}]}"#,
            &["bodies[0].thickness", "0.001 to 10 edges"],
        ),
        (r#"{"pressure": 1}"#, &["unknown field 'pressure'", "gravity"]),
        (r#"{"substeps": 4}"#, &["unknown field 'substeps'", "frame_time_s"]),
        (r#"{"fps": 60}"#, &["unknown field 'fps'", "frame_time_s"]),
        (r#"{"material": "plastic"}"#, &["unknown material 'plastic'", "paper"]),
        ("{\n  // a sheet\n}", &["line 2, column 3", "a comment, which JSON does not have"]),
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
            r#"{"start": "../starts/settled_32.npy", "grid": [64, 64]}"#,
            &["settled_32.npy", "shape", "[64, 64, 3]", "[32, 32, 3]"],
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
        &["dtype", "floating-point numbers"],
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
    // Faces with texture coordinates, and faces that count from the end, are accepted.
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
    let start = Start::Vertices(Grid { h: 9, w: 4 }, vec![[0.0; 3]; 36]);
    assert!(refused(Scene { start, ..Scene::default() }).contains("scene: start: grid width"));
    assert!(
        refused(Scene { gravity: [1e308; 3], frame_time_s: 100.0, frames: Some(1), ..Scene::default() })
            .contains("gravity")
    );
    assert!(Scene { grid: Grid { h: 1, w: 1 }, ..Scene::default() }.regrid(Grid { h: 8, w: 8 }).is_err());
    assert!(Motion::parse("swing", "--motion", Path::new(".")).unwrap_err().to_string().contains("--motion"));
    assert!(Start::parse("swing", "--start", Path::new(".")).is_err());
    assert!(BuiltIn::named("xy_opp_opp").is_none());
}

/// Generates texts that a field of a scene could hold by mistake.
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
        file in prop::sample::select(vec!["default", "moduli", "cells", "obj_start", "authors", "recorded", "npy_start", "table", "cape", "twist"]),
        field in any::<prop::sample::Index>(),
        value in junk(),
        cut in any::<prop::sample::Index>(),
    ) {
        let text = std::fs::read_to_string(assets(&format!("scenes/{file}.json"))).unwrap();
        // One top-level field is replaced; the text is cut short; one byte of it is changed.
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
