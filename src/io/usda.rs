//! Universal Scene Description as text (`.usda`): one mesh whose points are sampled in every frame.

use super::clip::Clip;
use rayon::prelude::*;
use std::{
    fmt::{Display, Write as _},
    io::{self, Write},
};

/// Frames that are turned into text at a time, which bounds the memory.
const CHUNK: usize = 16;
/// Decimals of a component of a normal.
const NORMAL: f32 = 1e4;

/// Writes a clip. Time codes are frames; velocities are in metres per second of the file's own time, as renderers expect
/// for motion blur.
pub(super) fn write(clip: &Clip, writer: &mut impl Write) -> io::Result<()> {
    let (topology, frames, fps) = (clip.topology, clip.frames, clip.fps());
    let last = clip.start() + clip.count().max(1) - 1;
    let up = if clip.options.z_up { "Z" } else { "Y" };
    write!(
        writer,
        "#usda 1.0\n(\n    defaultPrim = \"cloth\"\n    doc = \"Written by fnopt {}\"\n    endTimeCode = {last}\n    \
         framesPerSecond = {fps}\n    metersPerUnit = 1\n    startTimeCode = {}\n    timeCodesPerSecond = {fps}\n    \
         upAxis = \"{up}\"\n)\n\ndef Xform \"cloth\" (\n    kind = \"component\"\n)\n{{\n    def Mesh \"mesh\"\n    {{\n        \
         uniform bool doubleSided = 1\n",
        env!("CARGO_PKG_VERSION"),
        clip.start(),
    )?;
    sampled(clip, writer, "float3[] extent", "", |frame| {
        let [low, high] = extent(&frames.positions_of(frame)?);
        Ok(points(&[low, high]))
    })?;
    writeln!(writer, "        int[] faceVertexCounts = {}", list(topology.counts()))?;
    writeln!(writer, "        int[] faceVertexIndices = {}", list(topology.corners()))?;
    if topology.has_normals() {
        let vertex = " (\n            interpolation = \"vertex\"\n        )";
        sampled(clip, writer, "normal3f[] normals", vertex, |frame| {
            let mut normals = topology.normals(&frames.positions_of(frame)?);
            normals.as_flattened_mut().iter_mut().for_each(|c| *c = (*c * NORMAL).round() / NORMAL);
            Ok(points(&normals))
        })?;
    }
    sampled(clip, writer, "point3f[] points", "", |frame| Ok(points(&frames.positions_of(frame)?)))?;
    if !topology.uv().is_empty() {
        let uv = list(topology.uv().iter().map(|[u, v]| format!("({u}, {v})")));
        write!(
            writer,
            "        texCoord2f[] primvars:st = {uv} (\n            interpolation = \"vertex\"\n        )\n"
        )?;
    }
    writeln!(writer, "        uniform token subdivisionScheme = \"none\"")?;
    let speed = (fps / frames.fps()) as f32;
    sampled(clip, writer, "vector3f[] velocities", "", |frame| {
        let mut velocities = frames.velocities_of(frame)?;
        if speed != 1.0 {
            velocities.to_mut().as_flattened_mut().iter_mut().for_each(|c| *c *= speed);
        }
        Ok(points(&velocities))
    })?;
    writer.write_all(b"    }\n}\n")
}

/// Writes an attribute with a sample in each frame.
fn sampled(
    clip: &Clip,
    writer: &mut impl Write,
    attribute: &str,
    metadata: &str,
    of: impl Fn(usize) -> io::Result<String> + Sync,
) -> io::Result<()> {
    if !metadata.is_empty() {
        writeln!(writer, "        {attribute}{metadata}")?;
    }
    writeln!(writer, "        {attribute}.timeSamples = {{")?;
    for begin in (0..clip.count()).step_by(CHUNK) {
        let end = (begin + CHUNK).min(clip.count());
        let samples: io::Result<Vec<String>> = (begin..end).into_par_iter().map(&of).collect();
        for (frame, sample) in (clip.start() + begin..).zip(samples?) {
            writeln!(writer, "            {frame}: {sample},")?;
        }
    }
    writeln!(writer, "        }}")
}

/// Returns the corners of the box around the finite points.
fn extent(points: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let finite = || points.iter().filter(|p| p.iter().all(|c| c.is_finite()));
    let corner = |of: fn(f32, f32) -> f32| {
        finite().copied().reduce(|a, b| [0, 1, 2].map(|c| of(a[c], b[c]))).unwrap_or_default()
    };
    [corner(f32::min), corner(f32::max)]
}

/// Formats points as an array; every number reads back as the same bits.
fn points(points: &[[f32; 3]]) -> String {
    let mut text = String::with_capacity(36 * points.len());
    for (k, [x, y, z]) in points.iter().enumerate() {
        text.push_str(if k == 0 { "[(" } else { ", (" });
        // Writing to a string does not fail. Tiny numbers are shorter with an exponent.
        for (c, x) in [x, y, z].into_iter().enumerate() {
            text.push_str(if c == 0 { "" } else { ", " });
            let _ = match x.abs() {
                a if a.is_nan() => write!(text, "nan"),
                a if a < 1e-4 && a > 0.0 => write!(text, "{x:e}"),
                _ => write!(text, "{x}"),
            };
        }
        text.push(')');
    }
    text.push(']');
    text
}

/// Formats an array.
fn list<T: Display>(values: impl IntoIterator<Item = T>) -> String {
    let mut text = String::from("[");
    for (k, value) in values.into_iter().enumerate() {
        let _ = write!(text, "{}{value}", if k == 0 { "" } else { ", " });
    }
    text.push(']');
    text
}
