//! Binary glTF (`.glb`): the first frame as a mesh, and a morph target for each of the others, whose weights an animation
//! turns up one after another.

use super::{Topology, clip::Clip};
use crate::{Error, Result, memory};
use serde_json::{Value, json};
use std::io::{self, Write};

/// Most frames of a file. Viewers keep morph targets as the layers of a texture, of which GPUs have 2048.
const MOST_FRAMES: usize = 2049;
/// Most bytes of a file: browsers hold all of them at once, as do most importers.
const MOST_BYTES: u64 = 1 << 30;

/// Where the parts of the binary chunk are, in bytes from its start, and how long the chunk is.
struct Layout {
    uv: u64,
    /// Positions and normals of the first frame, then the differences of the others from it.
    points: u64,
    times: u64,
    len: u64,
}

/// Numbers of each vertex in each frame.
fn arrays(topology: &Topology) -> u64 {
    if topology.has_normals() { 2 } else { 1 }
}

impl Layout {
    fn new(topology: &Topology, frames: usize) -> Self {
        let (vertices, frames) = (topology.vertices() as u64, frames as u64);
        let triangles: u64 = topology.counts().iter().map(|&count| u64::from(count) - 2).sum();
        let uv = 12 * triangles;
        let points = uv + 8 * topology.uv().len() as u64;
        let times = points + 12 * vertices * arrays(topology) * frames;
        // The animation says the weight of every target at every time.
        let len = if frames > 1 { times + 4 * frames * frames } else { times };
        Self { uv, points, times, len }
    }
}

/// Checks that a file can hold so many frames.
pub(super) fn check_capacity(topology: &Topology, frames: usize, origin: &str) -> Result<()> {
    let more = "--every keeps fewer, usda and pc2 hold more";
    if frames > MOST_FRAMES {
        let expected = format!("at most {MOST_FRAMES} frames ({more})");
        return Err(Error::invalid(origin, "glb", expected, frames));
    }
    let bytes = Layout::new(topology, frames).len;
    if bytes > MOST_BYTES {
        let expected = format!("at most {} ({more})", memory::readable(MOST_BYTES as usize));
        let found = format!(
            "{}, {frames} frames of {} vertices",
            memory::readable(usize::try_from(bytes).unwrap_or(usize::MAX)),
            topology.vertices()
        );
        return Err(Error::invalid(origin, "glb", expected, found));
    }
    Ok(())
}

/// Writes a clip.
pub(super) fn write(clip: &Clip, writer: &mut impl Write) -> io::Result<()> {
    let layout = Layout::new(clip.topology, clip.count());
    let mut text = description(clip, &layout)?.to_string();
    // Chunks are multiples of four bytes long.
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(4) - text.len()));
    let len = |bytes: u64| u32::try_from(bytes).map(u32::to_le_bytes).map_err(io::Error::other);
    let (text_len, binary_len) = (text.len() as u64, layout.len);
    writer.write_all(b"glTF\x02\0\0\0")?;
    writer.write_all(&len(12 + 8 + text_len + 8 + binary_len)?)?;
    writer.write_all(&len(text_len)?)?;
    writer.write_all(b"JSON")?;
    writer.write_all(text.as_bytes())?;
    writer.write_all(&len(binary_len)?)?;
    writer.write_all(b"BIN\0")?;

    for k in clip.topology.triangles().flatten() {
        writer.write_all(&k.to_le_bytes())?;
    }
    // Here v points down.
    for x in clip.topology.uv().iter().flat_map(|&[u, v]| [u, 1.0 - v]) {
        writer.write_all(&x.to_le_bytes())?;
    }
    for_each_array(clip, |points| {
        let bytes: Vec<u8> = points.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
        writer.write_all(&bytes)
    })?;
    let frames = clip.count();
    if frames > 1 {
        for frame in 0..frames {
            writer.write_all(&time(clip, frame).to_le_bytes())?;
        }
        let weights = (0..frames).flat_map(|frame| (1..frames).map(move |target| target == frame));
        for is_on in weights {
            writer.write_all(&f32::from(u8::from(is_on)).to_le_bytes())?;
        }
    }
    Ok(())
}

/// Time of a frame \[s\]; the first is at 0.
fn time(clip: &Clip, frame: usize) -> f32 {
    (frame as f64 / clip.fps()) as f32
}

/// Passes on the arrays of all frames, in the order of the file: positions and, if there are any, normals of the first
/// frame, then the differences of the others from it.
fn for_each_array(clip: &Clip, mut take: impl FnMut(&[[f32; 3]]) -> io::Result<()>) -> io::Result<()> {
    let mut first: Vec<Vec<[f32; 3]>> = Vec::new();
    for frame in 0..clip.count() {
        let mut positions = clip.frames.positions_of(frame)?.into_owned();
        if !positions.as_flattened().iter().all(|c| c.is_finite()) {
            let problem = format!("frame {frame} is not finite, which glTF cannot say");
            return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
        }
        if clip.options.z_up {
            positions.iter_mut().for_each(|[_, y, z]| (*y, *z) = (*z, -*y));
        }
        let mut arrays = Vec::new();
        if clip.topology.has_normals() {
            let mut normals = clip.topology.normals(&positions);
            // Normals have to be of unit length, also where no face is.
            normals.iter_mut().filter(|n| **n == [0.0; 3]).for_each(|n| *n = [0.0, 1.0, 0.0]);
            arrays.push(normals);
        }
        arrays.insert(0, positions);
        if first.is_empty() {
            first = arrays.clone();
        } else {
            for (array, first) in arrays.iter_mut().zip(&first) {
                let both = array.as_flattened_mut().iter_mut().zip(first.as_flattened());
                both.for_each(|(x, first)| *x -= first);
            }
        }
        arrays.iter().try_for_each(|array| take(array))?;
    }
    Ok(())
}

/// Returns what the binary chunk holds, as glTF describes it.
fn description(clip: &Clip, layout: &Layout) -> io::Result<Value> {
    let (topology, frames) = (clip.topology, clip.count());
    let vertices = topology.vertices();
    let has_uv = !topology.uv().is_empty();
    let (vertex_data, indices, float, integer) = (34962, 34963, 5126, 5125);
    let mut views = vec![
        json!({"buffer": 0, "byteOffset": layout.points, "byteLength": layout.times - layout.points, "byteStride": 12, "target": vertex_data}),
    ];
    let (mut accessors, mut offset) = (Vec::new(), 0);
    for_each_array(clip, |points| {
        let mut accessor = json!({
            "bufferView": 0, "byteOffset": offset, "componentType": float, "count": vertices, "type": "VEC3",
        });
        // Positions must have their range.
        if (accessors.len() as u64).is_multiple_of(arrays(topology)) {
            let range = |of: fn(f32, f32) -> f32| {
                points.iter().copied().reduce(|a, b| [0, 1, 2].map(|c| of(a[c], b[c]))).unwrap_or_default()
            };
            accessor["min"] = range(f32::min).map(f64::from).to_vec().into();
            accessor["max"] = range(f32::max).map(f64::from).to_vec().into();
        }
        accessors.push(accessor);
        offset += 12 * vertices;
        Ok(())
    })?;
    let each = arrays(topology) as usize;
    let names = &["POSITION", "NORMAL"][..each];
    let attributes = |frame: usize| -> Value {
        names.iter().enumerate().map(|(k, name)| ((*name).to_owned(), json!(each * frame + k))).collect()
    };
    let mut primitive = json!({"attributes": attributes(0), "material": 0});
    let mut view = |offset: u64, end: u64, target: Option<i32>| {
        let mut view = json!({"buffer": 0, "byteOffset": offset, "byteLength": end - offset});
        if let Some(target) = target {
            view["target"] = target.into();
        }
        views.push(view);
        views.len() - 1
    };
    let mut accessor = |view: usize, offset: usize, component: i32, count: usize, of: &str| {
        accessors.push(
            json!({"bufferView": view, "byteOffset": offset, "componentType": component, "count": count, "type": of}),
        );
        accessors.len() - 1
    };
    if layout.uv > 0 {
        let view = view(0, layout.uv, Some(indices));
        primitive["indices"] = accessor(view, 0, integer, layout.uv as usize / 4, "SCALAR").into();
    }
    if has_uv {
        let view = view(layout.uv, layout.points, Some(vertex_data));
        primitive["attributes"]["TEXCOORD_0"] = accessor(view, 0, float, vertices, "VEC2").into();
    }
    let mut mesh = json!({"name": "cloth"});
    let mut all = json!({
        "asset": {"version": "2.0", "generator": concat!("fnopt ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "cloth"}],
        "materials": [{
            "name": "cloth", "doubleSided": true,
            "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.8, 0.8, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9},
        }],
        "buffers": [{"byteLength": layout.len}],
    });
    if frames > 1 {
        primitive["targets"] = (1..frames).map(attributes).collect();
        mesh["weights"] = vec![0.0; frames - 1].into();
        let view = view(layout.times, layout.len, None);
        let times = accessor(view, 0, float, frames, "SCALAR");
        let weights = accessor(view, 4 * frames, float, frames * (frames - 1), "SCALAR");
        accessors[times]["min"] = [f64::from(time(clip, 0))].to_vec().into();
        accessors[times]["max"] = [f64::from(time(clip, frames - 1))].to_vec().into();
        all["animations"] = json!([{
            "name": "cloth",
            "samplers": [{"input": times, "output": weights, "interpolation": "LINEAR"}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
        }]);
    }
    mesh["primitives"] = [primitive].to_vec().into();
    all["meshes"] = [mesh].to_vec().into();
    all["accessors"] = accessors.into();
    all["bufferViews"] = views.into();
    Ok(all)
}
