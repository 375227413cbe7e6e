//! Damaged files: errors, not panics.

use super::gltf::Maker;
use super::waving;
use fnopt::{
    cloth::Grid,
    io::{Format, ReadOptions, RenderMesh, Trajectory, read_mesh, read_npy, read_obj},
};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::fs;

/// Passes `bytes` to every reader. Readers may refuse, but not panic.
fn read_all(bytes: &[u8]) {
    let dir = tempfile::tempdir().unwrap();
    for format in Format::SINGLE_FILES {
        let path = dir.path().join(format!("x.{format}"));
        fs::write(&path, bytes).unwrap();
        let _ = Trajectory::read(&path, &ReadOptions::default());
        let _ = read_npy(&path);
        let _ = read_obj(&path);
    }
    for name in ["x.obj", "x.glb", "x.gltf"] {
        let path = dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        let _ = read_mesh(&path);
        let _ = RenderMesh::read(&path);
    }
    let frames = dir.path().join("frames");
    fs::create_dir(&frames).unwrap();
    fs::write(frames.join("00000.obj"), bytes).unwrap();
    let _ = Trajectory::read(&frames, &ReadOptions::default());
}

/// Returns a small file of each kind.
fn samples() -> Vec<Vec<u8>> {
    let dir = tempfile::tempdir().unwrap();
    let trajectory = waving(Grid { h: 3, w: 3 }, 2);
    let path = |format| trajectory.write(dir.path(), "s", format).unwrap();
    let obj = path(Format::Obj).join("00000.obj");
    let others = Format::SINGLE_FILES.map(path);
    let files = [obj, "tests/data/compressed.npz".into(), path(Format::Glb)].into_iter().chain(others);
    let meshes = [Maker::triangle().binary(), sparse().text().into_bytes()];
    files.map(|p| fs::read(p).unwrap()).chain(meshes).collect()
}

/// Returns a mesh with most of what a description can have.
fn sparse() -> Maker {
    let mut maker = Maker::triangle();
    let (at, values) = (maker.view(&[1u16, 2]), maker.view(&[1.0f32; 6]));
    maker.document["accessors"][0]["sparse"] = json!({
        "count": 2, "indices": {"bufferView": at, "componentType": 5123}, "values": {"bufferView": values},
    });
    maker.document["nodes"] =
        json!([{"children": [1], "scale": [1, 2, 3]}, {"mesh": 0, "rotation": [0, 0, 0, 1]}]);
    maker
}

/// Returns the places of all numbers in a document.
fn numbers(value: &Value, path: String, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(path),
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(k, v)| numbers(v, format!("{path}/{k}"), found))
        }
        Value::Object(fields) => fields.iter().for_each(|(k, v)| numbers(v, format!("{path}/{k}"), found)),
        _ => {}
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        read_all(&bytes);
    }

    #[test]
    fn arbitrary_headers_never_panic(text in "[{}()'<>f48i:, a-z0-9]{0,80}", version in 0u8..4) {
        let mut bytes = b"\x93NUMPY".to_vec();
        bytes.extend([version, 0]);
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.bytes());
        read_all(&bytes);
    }

    #[test]
    fn arbitrary_meshes_never_panic(text in "(v( -?[0-9]{1,2}){2,4}\n|f( -?[0-9]{1,2}(/[0-9]?)?){0,5}\n|[a-z0-9# ]{0,9}\n){0,30}") {
        read_all(text.as_bytes());
    }

    #[test]
    fn arbitrary_numbers_in_descriptions_never_panic(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), prop_oneof![
            0u64..12,
            Just(5121), Just(5123), Just(5125), Just(5126),
            (0u32..64).prop_map(|bit| 1u64 << bit),
            any::<u64>(),
        ]), 1..4),
        mode in 4u32..7,
    ) {
        let mut maker = sparse();
        maker.primitive()["mode"] = mode.into();
        let mut places = Vec::new();
        numbers(&maker.document, String::new(), &mut places);
        for (at, value) in changes {
            *maker.document.pointer_mut(&places[at.index(places.len())]).unwrap() = value.into();
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.glb");
        fs::write(&path, maker.binary()).unwrap();
        let _ = RenderMesh::read(&path);
    }

    #[test]
    fn mutated_files_never_panic(
        kind in 0usize..9,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        from_end in any::<bool>(),
        length in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        thread_local!(static SAMPLES: Vec<Vec<u8>> = samples());
        let mut bytes = SAMPLES.with(|s| s[kind].clone());
        for (at, value) in changes {
            // Headers lie at the start and, in archives, at the end.
            let at = at.index(bytes.len().min(if from_end { 300 } else { 2000 }));
            let at = if from_end { bytes.len() - 1 - at } else { at };
            bytes[at] = value;
        }
        if cut {
            bytes.truncate(length.index(bytes.len()));
        }
        read_all(&bytes);
    }
}
