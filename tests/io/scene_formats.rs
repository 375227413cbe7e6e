//! USD and glTF, as other programs read them.

use super::{GRID, waving};
use fnopt::{
    cloth::Grid,
    io::{Format, Recording, Topology, Trajectory, WriteOptions, write},
};
use serde_json::Value;
use std::{collections::BTreeMap, fs, path::Path};

/// Returns the numbers of each time sample of an attribute of a USD file.
fn samples(text: &str, attribute: &str) -> BTreeMap<i64, Vec<f32>> {
    let (_, rest) = text.split_once(&format!(" {attribute}.timeSamples = {{\n")).expect(attribute);
    let (block, _) = rest.split_once("\n        }\n").unwrap();
    let sample = |line: &str| {
        let (time, values) = line.trim().split_once(": ").unwrap();
        let words = values.split(['[', ']', '(', ')', ',', ' ']).filter(|word| !word.is_empty());
        (time.parse().unwrap(), words.map(|word| word.parse().unwrap()).collect())
    };
    block.lines().map(sample).collect()
}

#[test]
fn usd_has_every_frame_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    let mut written = waving(GRID, 20);
    let tiny: Vec<[f32; 3]> = written.frame(3).iter().map(|p| p.map(|c| 1e-30 * c)).collect();
    written.push(&tiny, &tiny);
    // Played at half speed, in which the velocities are half as large.
    let options = WriteOptions { start_frame: 7, z_up: true, fps: Some(30.0), ..Default::default() };
    let text =
        fs::read_to_string(write(&written, dir.path(), "cloth", Format::Usda, &options).unwrap()).unwrap();
    for line in [
        "#usda 1.0",
        "    defaultPrim = \"cloth\"",
        "    startTimeCode = 7",
        "    endTimeCode = 27",
        "    timeCodesPerSecond = 30",
        "    framesPerSecond = 30",
        "    metersPerUnit = 1",
        "    upAxis = \"Z\"",
        "        uniform token subdivisionScheme = \"none\"",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}");
    }
    let [points, velocities, normals, extent] =
        ["points", "velocities", "normals", "extent"].map(|name| samples(&text, name));
    for sampled in [&points, &velocities, &normals, &extent] {
        assert!(sampled.keys().copied().eq(7..28), "{:?}", sampled.keys());
    }
    for frame in 0..21 {
        let time = 7 + frame as i64;
        assert_eq!(points[&time], written.frame(frame).as_flattened(), "frame {frame}");
        let halved: Vec<f32> =
            written.frame_velocities(frame).as_flattened().iter().map(|v| v / 2.0).collect();
        assert_eq!(velocities[&time], halved, "frame {frame}");
        for c in 0..3 {
            let along = || written.frame(frame).iter().map(|p| p[c]);
            assert_eq!(extent[&time][c], along().fold(f32::MAX, f32::min));
            assert_eq!(extent[&time][3 + c], along().fold(f32::MIN, f32::max));
        }
        let unit = |n: &[f32]| (n.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-3;
        assert!(frame == 20 || normals[&time].chunks(3).all(unit));
    }
    let uv = GRID.texture_coordinates();
    assert!(text.contains(&format!("primvars:st = [({}, {}), ", uv[0][0], uv[0][1])));
}

/// Quads stay quads where a format has them, and there are neither normals nor texture coordinates unless asked for.
#[test]
fn polygons_are_written_as_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = Topology::new(5, [&[0, 1, 2, 3][..], &[1, 4, 2]]).unwrap();
    let mut recording = Recording::new(dir.path(), mesh, 24.0).unwrap();
    let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]];
    for frame in 0..3 {
        let moved = points.map(|[x, y, z]| [x, y, z + frame as f32]);
        recording.push(&moved, &[[0.0, 0.0, 24.0]; 5]).unwrap();
    }
    let written = |format| recording.write(dir.path(), "mesh", format, &WriteOptions::default()).unwrap();
    let usd = fs::read_to_string(written(Format::Usda)).unwrap();
    assert!(
        usd.contains("faceVertexCounts = [4, 3]\n")
            && usd.contains("faceVertexIndices = [0, 1, 2, 3, 1, 4, 2]\n")
    );
    assert!(!usd.contains("normals") && !usd.contains("primvars:st"));
    let obj = fs::read_to_string(written(Format::Obj).join("00002.obj")).unwrap();
    assert!(obj.ends_with("v 2 0 2\nf 1 2 3 4\nf 2 5 3\n"), "{obj}");
    let ply = fs::read(written(Format::Ply).join("00000.ply")).unwrap();
    assert!(ply.ends_with(&[&[3][..], bytemuck::cast_slice(&[1u32, 4, 2])].concat()));
    let [end, faces] = ["end_header\n".len(), 1 + 16 + 1 + 12];
    let header = ply.windows(end).position(|w| w == b"end_header\n").unwrap();
    assert_eq!(ply.len(), header + end + 5 * 12 + faces);
    let read = |format| {
        Trajectory::read(
            written(format),
            &fnopt::io::ReadOptions { grid: Some(Grid { h: 1, w: 5 }), ..Default::default() },
        )
    };
    for format in Format::SINGLE_FILES {
        assert_eq!(read(format).unwrap().frame(2)[4], [2.0, 0.0, 2.0], "{format}");
    }
    let glb = Glb::read(&written(Format::Glb));
    assert_eq!(glb.numbers::<u32>(&glb.primitive()["indices"]), [0, 1, 2, 0, 2, 3, 1, 4, 2]);
    assert_eq!(glb.primitive()["attributes"].as_object().unwrap().len(), 1);
}

/// A binary glTF file.
struct Glb {
    json: Value,
    binary: Vec<u8>,
}

impl Glb {
    fn read(path: &Path) -> Self {
        let bytes = fs::read(path).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..][..4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let text = word(12);
        assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
        let rest = 20 + text;
        assert_eq!((&bytes[rest + 4..rest + 8], word(rest)), (&b"BIN\0"[..], bytes.len() - rest - 8));
        let json = serde_json::from_slice(&bytes[20..rest]).unwrap();
        Self { json, binary: bytes[rest + 8..].to_vec() }
    }

    fn primitive(&self) -> &Value {
        &self.json["meshes"][0]["primitives"][0]
    }

    /// Returns the numbers of an accessor.
    fn numbers<T: bytemuck::AnyBitPattern>(&self, accessor: &Value) -> Vec<T> {
        let accessor = &self.json["accessors"][accessor.as_u64().expect("an accessor") as usize];
        let view = &self.json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let number = |value: &Value| value.as_u64().unwrap() as usize;
        let each = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            _ => 3,
        };
        let (within, len) = (number(&accessor["byteOffset"]), 4 * each * number(&accessor["count"]));
        assert!(within + len <= number(&view["byteLength"]));
        let bytes = &self.binary[number(&view["byteOffset"]) + within..][..len];
        bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()
    }
}

#[test]
fn gltf_has_a_target_for_each_frame_and_is_y_up() {
    let dir = tempfile::tempdir().unwrap();
    let written = waving(GRID, 9);
    for z_up in [false, true] {
        let options = WriteOptions { z_up, fps: Some(24.0), ..Default::default() };
        let glb = Glb::read(&write(&written, dir.path(), "cloth", Format::Glb, &options).unwrap());
        let first = glb.numbers::<f32>(&glb.primitive()["attributes"]["POSITION"]);
        let targets = glb.primitive()["targets"].as_array().unwrap();
        assert_eq!(targets.len(), 8);
        for frame in 0..9 {
            let turned = |&[x, y, z]: &[f32; 3]| if z_up { [x, z, -y] } else { [x, y, z] };
            let expected: Vec<[f32; 3]> = written.frame(frame).iter().map(turned).collect();
            let moved = match frame {
                0 => vec![0.0; first.len()],
                _ => glb.numbers::<f32>(&targets[frame - 1]["POSITION"]),
            };
            let found = first.iter().zip(&moved).map(|(a, b)| a + b);
            let far = found.zip(expected.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(far < 1e-6, "frame {frame}: {far}");
        }
        let sampler = &glb.json["animations"][0]["samplers"][0];
        let times = glb.numbers::<f32>(&sampler["input"]);
        assert!(times.iter().enumerate().all(|(k, t)| (t - k as f32 / 24.0).abs() < 1e-6), "{times:?}");
        let weights = glb.numbers::<f32>(&sampler["output"]);
        let on = |frame: usize, target: usize| f32::from(u8::from(frame == target + 1));
        let expected: Vec<f32> =
            (0..9).flat_map(|frame| (0..8).map(move |target| on(frame, target))).collect();
        assert_eq!(weights, expected);
        let uv = glb.numbers::<f32>(&glb.primitive()["attributes"]["TEXCOORD_0"]);
        assert_eq!(uv[1], 1.0 - GRID.texture_coordinates()[0][1]);
    }
    // A frame alone does not move.
    let glb = Glb::read(&waving(GRID, 1).write(dir.path(), "still", Format::Glb).unwrap());
    assert!(glb.json.get("animations").is_none() && glb.primitive().get("targets").is_none());
}

#[test]
fn clips_that_are_too_long_for_gltf_are_refused_with_the_number() {
    let small = Topology::from(Grid { h: 8, w: 8 });
    Format::Glb.check_capacity(&small, 2049, "--format").unwrap();
    let error = Format::Glb.check_capacity(&small, 2050, "--format").unwrap_err().to_string();
    assert!(error.contains("--format: glb: expected at most 2049 frames (--every keeps fewer"), "{error}");
    assert!(error.ends_with("found 2050"), "{error}");
    let large = Topology::from(Grid { h: 512, w: 512 });
    let error = Format::Glb.check_capacity(&large, 391, "--format").unwrap_err().to_string();
    assert!(
        error.contains("at most 1.0 GiB") && error.contains("found 2.3 GiB, 391 frames of 262144"),
        "{error}"
    );
    let dir = tempfile::tempdir().unwrap();
    let error =
        waving(Grid { h: 2, w: 2 }, 2050).write(dir.path(), "long", Format::Glb).unwrap_err().to_string();
    assert!(
        error.contains("long.glb: glb: expected") && fs::read_dir(dir.path()).unwrap().count() == 0,
        "{error}"
    );
}

#[test]
fn formats_that_are_only_written_say_so() {
    let dir = tempfile::tempdir().unwrap();
    for format in [Format::Usda, Format::Glb] {
        let path = waving(GRID, 2).write(dir.path(), "cloth", format).unwrap();
        let error = Trajectory::read(&path, &Default::default()).unwrap_err().to_string();
        assert!(error.contains(&format!("found {format}, which is written only")), "{error}");
    }
}
