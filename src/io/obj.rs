//! Wavefront OBJ meshes.
//!
//! Read by hand: the usual crate renumbers the vertices in the order in which faces use them, and here a vertex number
//! is a place in the grid.

use super::{Mesh, mesh, open};
use crate::{Error, Result, sim::Grid};
use std::{
    io::{self, Read, Write},
    path::Path,
};

/// Statements that say nothing about positions and faces.
const IGNORED: [&str; 12] = ["vt", "vn", "vp", "o", "g", "s", "l", "p", "usemtl", "mtllib", "cstype", "end"];

/// Reads the positions and faces of an OBJ file; polygons are cut into triangles, vertices keep the order of the file.
pub fn read_obj(path: impl AsRef<Path>) -> Result<Mesh> {
    let path = path.as_ref();
    let (mut file, size) = open(path)?;
    let mut bytes = Vec::with_capacity(size as usize);
    file.read_to_end(&mut bytes).map_err(|e| Error::io(path, "cannot read", e))?;
    parse(&bytes, &path.display().to_string())
}

fn parse(bytes: &[u8], origin: &str) -> Result<Mesh> {
    let mut found = Mesh::default();
    for (k, line) in bytes.split(|&b| b == b'\n').enumerate() {
        let line = String::from_utf8_lossy(line);
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_ascii_whitespace();
        let understood = match words.next() {
            None => Some(()),
            Some("v") => position(words).map(|p| found.positions.push(p)),
            Some("f") => face(words, &mut found),
            Some(word) => IGNORED.contains(&word).then_some(()),
        };
        if understood.is_none() {
            let shown: String = line.trim().chars().take(60).collect();
            let expected = "'v' with three finite numbers, 'f' with three or more vertices defined above it, or another OBJ statement";
            return Err(Error::invalid(origin, format!("line {}", k + 1), expected, format!("'{shown}'")));
        }
    }
    if found.positions.is_empty() {
        return Err(Error::invalid(origin, "vertices", "at least one 'v' line", "none"));
    }
    Ok(found)
}

/// `x y z`, perhaps with a weight or colours after them.
fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<[f32; 3]> {
    let mut out = [0.0; 3];
    for x in &mut out {
        *x = words.next()?.parse().ok().filter(|x: &f32| x.is_finite())?;
    }
    words.all(|w| w.parse::<f32>().is_ok()).then_some(out)
}

/// `a b c ..`, each `v`, `v/vt`, `v//vn` or `v/vt/vn`, with negative numbers counted back from the last vertex.
fn face<'a>(words: impl Iterator<Item = &'a str>, mesh: &mut Mesh) -> Option<()> {
    let vertices = mesh.positions.len();
    let number = |word: &'a str| {
        let number: i64 = word.split('/').next()?.parse().ok()?;
        let from_zero = if number < 0 { number.checked_add(vertices as i64)? } else { number - 1 };
        u32::try_from(from_zero).ok().filter(|&k| (k as usize) < vertices)
    };
    let corners = words.map(number).collect::<Option<Vec<u32>>>()?;
    for pair in corners.get(1..)?.windows(2) {
        mesh.faces.push([corners[0], pair[0], pair[1]]);
    }
    (corners.len() >= 3).then_some(())
}

/// Writes a frame of a grid with its texture coordinates.
pub(super) fn write(grid: Grid, positions: &[[f32; 3]], mut writer: impl Write) -> io::Result<()> {
    for [x, y, z] in positions {
        writeln!(writer, "v {x} {y} {z}")?;
    }
    for [u, v] in mesh::texture_coordinates(grid) {
        writeln!(writer, "vt {u} {v}")?;
    }
    for [a, b, c] in grid.faces().iter().map(|f| f.map(|k| k + 1)) {
        writeln!(writer, "f {a}/{a} {b}/{b} {c}/{c}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_in_every_spelling() {
        let text = b"# a\r\nmtllib x.mtl\nv 0 0 0\nv 1 0 0 1\nv 1 1 0 .5 .5 .5\nv 0 1 0\nf 4 3/1 2//1 1/1/1\nf -1 -2 -3 # b";
        let mesh = parse(text, "m.obj").unwrap();
        assert_eq!(mesh.positions.len(), 4);
        assert_eq!(mesh.faces, [[3, 2, 1], [3, 1, 0], [3, 2, 1]]);
    }

    #[test]
    fn vertices_keep_their_order() {
        let text = b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 3 2 1\n";
        assert_eq!(parse(text, "m.obj").unwrap().positions[0], [0.0; 3]);
    }

    #[test]
    fn the_line_is_named() {
        for wrong in [
            "v 1 2",
            "v 1 2 inf",
            "v a b c",
            "f 1 2",
            "f 1 1 2",
            "f 0 1 1",
            "f",
            "xyz",
            "f -2 1 1",
            "v 1 2 3 x",
        ] {
            let error = parse(format!("v 0 0 0\n{wrong}\n").as_bytes(), "m.obj").unwrap_err().to_string();
            assert!(error.starts_with("m.obj: line 2: expected"), "{error}");
        }
        assert!(parse(b"", "m.obj").unwrap_err().to_string().contains("vertices"));
    }
}
