//! Wavefront OBJ meshes.
//!
//! Parsed by hand: the usual crate renumbers vertices in the order in which faces use them, but here a vertex
//! index is a position in the grid.

use super::{Mesh, MeshFile, Topology, read_bytes};
use crate::{Error, Result};
use num_traits::Float;
use std::{
    collections::BTreeSet,
    io::{self, Write},
    path::Path,
    str::FromStr,
};

/// The statements that are skipped: all those of the format that do not describe positions, faces or what these belong to.
const IGNORED: &str = "vn vp s mg l p usemtl mtllib usemap maplib deg bmat step cstype curv curv2 surf parm \
    trim hole scrv sp end con call bevel c_interp d_interp lod shadow_obj trace_obj ctech stech";

/// The vertices and faces of an OBJ file, exactly as given there.
#[derive(Clone, Debug)]
pub(crate) struct Polygons<T> {
    /// File name, for errors.
    pub origin: String,
    /// Vertex positions in file order, all finite.
    pub positions: Vec<[T; 3]>,
    /// Zero-based vertex indices of each face, at least three, and its one-based line number.
    pub faces: Vec<(Vec<usize>, usize)>,
    /// Texture coordinates in file order; NaN where the file has something else, which matters only to those who use them.
    pub uv: Vec<[f64; 2]>,
    /// Zero-based indices of the texture coordinates of each face's corners; `None` where the file has none or names one
    /// that it doesn't have.
    pub uv_of: Vec<Vec<Option<usize>>>,
}

/// Reads the positions and faces of an OBJ file. Polygons are split into triangles; vertices keep the order
/// of the file.
pub fn read_obj(path: impl AsRef<Path>) -> Result<Mesh> {
    Polygons::read(&path.as_ref().into())?.into_mesh()
}

/// The object whose faces are read, and where the lines of a file are.
#[derive(Default)]
struct Choice<'a> {
    /// Its name; `None` for all.
    wanted: Option<&'a str>,
    /// Whether the object and the group of the lines is the one that is wanted.
    is_in: [bool; 2],
    /// The names of all objects and groups.
    names: BTreeSet<String>,
}

impl Choice<'_> {
    /// Begins an object (`o`, 0) or a group (`g`, 1), or a group of several names.
    fn begin(&mut self, kind: usize, names: &str) {
        let Some(wanted) = self.wanted else { return };
        let names = names.trim();
        self.is_in[kind] =
            names == wanted || kind == 1 && names.split_ascii_whitespace().any(|name| name == wanted);
        if kind == 0 {
            self.is_in[1] = false;
        }
        self.names.insert(names.to_owned());
    }

    /// Whether faces are wanted here.
    fn takes(&self) -> bool {
        self.wanted.is_none() || self.is_in.contains(&true)
    }
}

impl<T: Float + FromStr> Polygons<T> {
    /// Reads a file: all of its vertices, and the faces of the object. Fails if there is none of that name.
    pub fn read(file: &MeshFile) -> Result<Self> {
        Self::parse(&read_bytes(&file.path)?, &file.path.display().to_string(), file.object.as_deref())
    }

    fn parse(bytes: &[u8], origin: &str, object: Option<&str>) -> Result<Self> {
        let mut choice = Choice { wanted: object, ..Choice::default() };
        let (positions, faces, uv, uv_of) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut found = Self { origin: origin.to_owned(), positions, faces, uv, uv_of };
        // Some programs write a byte-order mark.
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let (mut joined, mut is_joined, mut is_comment) = (Vec::new(), false, false);
        for (k, line) in bytes.split(|&b| b == b'\n').enumerate() {
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            if !std::mem::take(&mut is_joined) {
                joined.clear();
                is_comment = false;
            }
            joined.extend_from_slice(line);
            is_comment |= line.contains(&b'#');
            // A backslash at the end of a line joins it to the next one.
            if line.ends_with(b"\\") && !is_comment {
                joined.pop();
                joined.push(b' ');
                is_joined = true;
                continue;
            }
            let line = &joined[..];
            // Comments and material names may be in any encoding; everything else is ASCII.
            let line = String::from_utf8_lossy(line);
            let line = line.split('#').next().unwrap_or_default();
            let mut words = line.split_ascii_whitespace();
            let (understood, expected) = match words.next() {
                None => continue,
                Some("v") => (
                    position(words).map(|position| found.positions.push(position)),
                    "'v X Y Z', finite numbers",
                ),
                Some("vt") => {
                    found.uv.push(texture(words));
                    continue;
                }
                Some(kind @ ("o" | "g")) => {
                    choice.begin(usize::from(kind == "g"), line.trim_start().get(1..).unwrap_or_default());
                    continue;
                }
                Some("f") => (
                    face(words, found.positions.len(), found.uv.len()).map(|(face, uv)| {
                        if choice.takes() {
                            found.faces.push((face, k + 1));
                            found.uv_of.push(uv);
                        }
                    }),
                    "'f' with three or more vertices that exist, defined above it",
                ),
                Some(word) => (
                    IGNORED.split(' ').find(|known| *known == word).map(drop),
                    "an OBJ statement such as 'v' or 'f'",
                ),
            };
            if understood.is_none() {
                let shown: String = line.trim().chars().take(60).collect();
                return Err(Error::invalid(
                    origin,
                    format!("line {}", k + 1),
                    expected,
                    format!("'{shown}'"),
                ));
            }
        }
        if let Some(name) = object.filter(|_| found.faces.is_empty()) {
            return Err(Error::unknown(
                origin,
                "object with faces",
                name,
                choice.names.iter().map(|name| &**name),
            ));
        }
        // A face may use a coordinate that comes after it.
        let many = found.uv.len();
        for uv in found.uv_of.iter_mut().flatten() {
            *uv = uv.filter(|&uv| uv < many);
        }
        Ok(found)
    }
}

impl Polygons<f32> {
    /// Splits the polygons into triangle fans around their first corners. Fails if there are no vertices.
    pub fn into_mesh(self) -> Result<Mesh> {
        if self.positions.is_empty() {
            return Err(Error::invalid(self.origin, "vertices", "at least one 'v' line", "none"));
        }
        let mut faces = Vec::with_capacity(self.faces.len());
        for (corners, _) in &self.faces {
            for k in 2..corners.len() {
                faces.push([corners[0], corners[k - 1], corners[k]].map(|v| v as u32));
            }
        }
        Ok(Mesh { positions: self.positions, faces })
    }
}

/// Parses `x y z`, optionally followed by a weight or colours.
fn position<'a, T: Float + FromStr>(mut words: impl Iterator<Item = &'a str>) -> Option<[T; 3]> {
    let mut out = [T::zero(); 3];
    for x in &mut out {
        *x = words.next()?.parse().ok().filter(|x: &T| x.is_finite())?;
    }
    words.all(|w| w.parse::<T>().is_ok()).then_some(out)
}

/// Parses `u v`, or `u` alone, whose v is 0.
fn texture<'a>(mut words: impl Iterator<Item = &'a str>) -> [f64; 2] {
    let mut number = |default| words.next().map_or(default, |word| word.parse().unwrap_or(f64::NAN));
    [number(f64::NAN), number(0.0)]
}

/// Parses `a b c ..`, each `v`, `v/vt`, `v//vn` or `v/vt/vn`, into the vertices and the texture coordinates of the corners;
/// negative numbers count back from the last of `vertices` and `uv`.
fn face<'a>(
    words: impl Iterator<Item = &'a str>,
    vertices: usize,
    uv: usize,
) -> Option<(Vec<usize>, Vec<Option<usize>>)> {
    let index = |word: &str, count: usize| {
        let number: i64 = word.parse().ok()?;
        let from_zero = if number < 0 { number.checked_add(count as i64)? } else { number - 1 };
        usize::try_from(from_zero).ok()
    };
    let corner = |word: &'a str| {
        let mut parts = word.split('/');
        let vertex = index(parts.next()?, vertices).filter(|&k| k < vertices)?;
        Some((vertex, parts.next().and_then(|word| index(word, uv))))
    };
    let (corners, uv): (Vec<_>, Vec<_>) = words.map(corner).collect::<Option<Vec<_>>>()?.into_iter().unzip();
    (corners.len() >= 3).then_some((corners, uv))
}

/// Writes a frame; `rest` is the same in all frames ([`rest`]).
pub(super) fn write(positions: &[[f32; 3]], rest: &[u8], writer: &mut impl Write) -> io::Result<()> {
    for [x, y, z] in positions {
        writeln!(writer, "v {x} {y} {z}")?;
    }
    writer.write_all(rest)
}

/// Returns what follows the positions: texture coordinates and faces.
pub(super) fn rest(topology: &Topology) -> Vec<u8> {
    let mut lines = String::new();
    for [u, v] in topology.uv() {
        lines += &format!("vt {u} {v}\n");
    }
    for face in topology.faces() {
        lines.push('f');
        for k in face.iter().map(|k| k + 1) {
            lines += &if topology.uv().is_empty() { format!(" {k}") } else { format!(" {k}/{k}") };
        }
        lines.push('\n');
    }
    lines.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &[u8], origin: &str) -> Result<Mesh> {
        Polygons::parse(text, origin, None)?.into_mesh()
    }

    #[test]
    fn faces_in_every_spelling() {
        let text = b"# a\r\nmtllib x.mtl\nv 0 0 0\nv 1 0 0 1\nv 1 1 0 .5 .5 .5\nv 0 1 0\nf 4 3/1 2//1 1/1/1\nf -1 -2 -3 # b";
        let mesh = parse(text, "m.obj").unwrap();
        assert_eq!(mesh.positions.len(), 4);
        assert_eq!(mesh.faces, [[3, 2, 1], [3, 1, 0], [3, 2, 1]]);
    }

    #[test]
    fn a_backslash_continues_a_line() {
        let text = b"# c:\\meshes\\\nv 0 0 0\nv 1 \\\r\n0 \\\n0\nv 1 1 0\nf 1 2\\\n 3\nf 1 2 x";
        let error = parse(text, "m.obj").unwrap_err().to_string();
        assert!(error.starts_with("m.obj: line 9: "), "{error}");
        let mesh = parse(&text[..text.len() - 8], "m.obj").unwrap();
        assert_eq!((mesh.positions[1], mesh.faces), ([1.0, 0.0, 0.0], vec![[0, 1, 2]]));
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
