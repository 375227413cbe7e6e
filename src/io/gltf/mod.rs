//! Meshes in glTF 2 files, binary (`.glb`) or not (`.gltf`).
//!
//! Parsed by hand, as strictly as other files: every count is checked against the bytes that are there.

mod accessor;
mod file;

use super::{MeshFile, Node};
use crate::{Error, Result, memory};
use accessor::{indices, vectors};
use file::File;
use glam::{DAffine3, DMat4, DQuat, DVec3};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Vertices, and corners of triangles, that even a small file may have by placing its meshes several times.
const MOST_REPEATED: usize = 1 << 24;

/// The triangles of a file's scene: all meshes, where its nodes place them.
pub(super) struct Triangles {
    /// File name, for errors.
    pub origin: String,
    /// Positions \[m\], y up, of one primitive after another, in the order of the nodes; all finite.
    pub positions: Vec<[f32; 3]>,
    /// Texture coordinates of each vertex as in the file, with v down; NaN where a primitive has none.
    pub uv: Vec<[f64; 2]>,
    /// Numbers of vertices, counter-clockwise seen from the front.
    pub faces: Vec<[u32; 3]>,
    /// The primitives.
    pub parts: Vec<Part>,
}

/// A primitive, as a node places it.
pub(super) struct Part {
    /// Its place in the file, as in `meshes[0].primitives[1]`.
    pub path: String,
    /// Its first vertex.
    pub first: usize,
    /// Whether it has texture coordinates.
    pub has_uv: bool,
}

/// Whether the name of a file is one of glTF.
pub(crate) fn is_gltf(path: &Path) -> bool {
    let is = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    is("gltf") || is("glb")
}

impl Triangles {
    /// Reads a file: its default scene, or all nodes if it has no scene, or the object of this name in it. Morph targets, skins and
    /// animations are left out.
    pub fn read(of: &MeshFile) -> Result<Self> {
        let file = File::read(&of.path)?;
        let origin = file.origin.clone();
        let (positions, uv, faces, parts) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut found = Self { origin, positions, uv, faces, parts };
        for (mesh, place) in placed(&file, of.object.as_deref())? {
            let primitives = mesh.get("primitives").ok_or_else(|| mesh.invalid("\"primitives\""))?;
            primitives.items()?.iter().try_for_each(|primitive| found.add(&file, primitive, place))?;
        }
        if found.faces.is_empty() {
            let expected = "at least one triangle in the scene (primitives of mode 4, 5 or 6)";
            return Err(Error::invalid(found.origin, "meshes", expected, "none"));
        }
        Ok(found)
    }

    /// Returns the primitive of a vertex.
    pub fn part(&self, vertex: usize) -> &Part {
        &self.parts[self.parts.partition_point(|part| part.first <= vertex) - 1]
    }

    /// Returns the place in the file of a vertex.
    pub fn place(&self, vertex: usize) -> String {
        let part = self.part(vertex);
        format!("{}, vertex {}", part.path, vertex - part.first)
    }

    /// Adds the triangles of a primitive, if it has some.
    fn add(&mut self, file: &File, primitive: &Node, place: DAffine3) -> Result<()> {
        let mode = primitive.get_or("mode", 4, Node::count)?;
        match mode {
            // Points and lines.
            0..=3 => return Ok(()),
            4..=6 => {}
            _ => return Err(primitive.invalid("a \"mode\" from 0 to 6")),
        }
        let attributes = primitive.get("attributes");
        let attribute = |name| attributes.as_ref().and_then(|attributes| attributes.get(name));
        let position = attribute("POSITION").ok_or_else(|| primitive.invalid("a \"POSITION\""))?;
        let positions = vectors::<3>(file, &position)?;
        let uv = match attribute("TEXCOORD_0") {
            Some(at) => {
                let uv = vectors::<2>(file, &at)?;
                if uv.len() != positions.len() {
                    let expected = format!("as many elements as POSITION has, {}", positions.len());
                    return Err(Error::invalid(&self.origin, &at.path, expected, uv.len()));
                }
                Some(uv)
            }
            None => None,
        };
        let corners = match primitive.get("indices") {
            Some(at) => indices(file, &at, positions.len())?,
            None => (0..positions.len() as u32).collect(),
        };
        let faces = triangles(mode, &corners).ok_or_else(|| {
            let expected = "three corners for each triangle";
            Error::invalid(&self.origin, &primitive.path, expected, format!("{} corners", corners.len()))
        })?;
        let most = file.bytes.max(MOST_REPEATED).min(i32::MAX as usize);
        let (vertices, many) = (self.positions.len() + positions.len(), self.faces.len() + faces.len());
        if vertices > most || many.saturating_mul(3) > most {
            let expected = format!("at most {most} vertices, and corners of triangles, in all nodes");
            return Err(Error::invalid(&self.origin, "nodes", expected, vertices.max(3 * many)));
        }
        memory::check((vertices + many) * size_of::<[f64; 5]>(), &self.origin)?;

        let first = self.positions.len();
        self.parts.push(Part { path: primitive.path.clone(), first, has_uv: uv.is_some() });
        for (k, position) in positions.iter().enumerate() {
            let placed = place.transform_point3(DVec3::from(*position)).as_vec3();
            if !placed.is_finite() {
                let (field, expected) =
                    (format!("{}, element {k}", position_path(primitive)), "finite numbers");
                return Err(Error::invalid(&self.origin, field, expected, placed));
            }
            self.positions.push(placed.to_array());
        }
        self.uv.extend(uv.unwrap_or_else(|| vec![[f64::NAN; 2]; positions.len()]));
        // A node that mirrors its mesh turns the fronts of the triangles to the other side.
        let is_mirrored = place.matrix3.determinant() < 0.0;
        let turned = |[a, b, c]: [u32; 3]| if is_mirrored { [a, c, b] } else { [a, b, c] };
        self.faces.extend(faces.into_iter().map(|face| turned(face).map(|k| first as u32 + k)));
        Ok(())
    }
}

fn position_path(primitive: &Node) -> String {
    format!("{}.attributes.POSITION", primitive.path)
}

/// Returns the triangles of a list (mode 4), a strip (5) or a fan (6), all with their fronts to the same side. A strip's
/// triangles without area only join others and are left out. `None` if corners are left over.
fn triangles(mode: usize, corners: &[u32]) -> Option<Vec<[u32; 3]>> {
    let (threes, rest) = corners.as_chunks::<3>();
    Some(match mode {
        5 => {
            let all = corners.windows(3).enumerate();
            let turned = all.map(|(k, c)| if k % 2 == 0 { [c[0], c[1], c[2]] } else { [c[0], c[2], c[1]] });
            turned.filter(|[a, b, c]| a != b && b != c && c != a).collect()
        }
        6 => corners.get(1..)?.windows(2).map(|pair| [corners[0], pair[0], pair[1]]).collect(),
        _ if rest.is_empty() => threes.to_vec(),
        _ => return None,
    })
}

/// Returns the meshes of the scene and where its nodes place them: all, or those of the object, which is a node of this name with those
/// below it, or a mesh. Fails if there is none.
fn placed<'a>(file: &'a File, object: Option<&str>) -> Result<Vec<(Node<'a>, DAffine3)>> {
    let root = file.root();
    let mut names = BTreeSet::new();
    let mut is_object = |node: &Node| {
        let name = node.value.get("name").and_then(Value::as_str);
        names.extend(name.map(str::to_owned));
        object.is_none() || name == object
    };
    let count = |list: &str| root.value.get(list).and_then(Value::as_array).map_or(0, Vec::len);
    let all = count("nodes");
    let mut waiting: Vec<(usize, DAffine3, bool)> = Vec::new();
    // In their order, since the last one is taken first.
    let add = |waiting: &mut Vec<_>, nodes: Vec<usize>, place: DAffine3, is_in: bool| {
        waiting.extend(nodes.into_iter().rev().map(|node| (node, place, is_in)));
    };
    let mut is_known = vec![false; all];
    let roots = match (count("scenes"), all) {
        (0, 0) => {
            let meshes = root.get("meshes").map_or(Ok(Vec::new()), |meshes| meshes.items())?;
            let meshes: Vec<_> = meshes.into_iter().filter(|mesh| is_object(mesh)).collect();
            return some(
                file,
                meshes.into_iter().map(|mesh| (mesh, DAffine3::IDENTITY)).collect(),
                object,
                &names,
            );
        }
        (0, _) => {
            let mut is_root = vec![true; all];
            for k in 0..all {
                let children = numbers(&file.item("nodes", k, &root)?, "children", all)?;
                children.into_iter().for_each(|child| is_root[child] = false);
            }
            (0..all).filter(|&k| is_root[k]).collect()
        }
        _ => {
            let scene = match root.get("scene") {
                Some(scene) => file.named("scenes", &scene)?,
                None => file.item("scenes", 0, &root)?,
            };
            numbers(&scene, "nodes", all)?
        }
    };
    add(&mut waiting, roots, DAffine3::IDENTITY, false);
    let mut meshes = Vec::new();
    while let Some((number, above, is_in)) = waiting.pop() {
        let node = file.item("nodes", number, &root)?;
        if std::mem::replace(&mut is_known[number], true) {
            return Err(node.invalid("a node of one parent, which no child of it has for a child"));
        }
        let place = above * local(&node)?;
        let is_in = is_object(&node) || is_in;
        if let Some(mesh) = node.get("mesh") {
            // The joints place the mesh of a skin, not the node.
            let place = if node.get("skin").is_some() { DAffine3::IDENTITY } else { place };
            let mesh = file.named("meshes", &mesh)?;
            if is_object(&mesh) || is_in {
                meshes.push((mesh, place));
            }
        }
        add(&mut waiting, numbers(&node, "children", all)?, place, is_in);
    }
    some(file, meshes, object, &names)
}

/// Fails if an object was asked for and has no meshes.
fn some<'a>(
    file: &File,
    meshes: Vec<(Node<'a>, DAffine3)>,
    object: Option<&str>,
    names: &BTreeSet<String>,
) -> Result<Vec<(Node<'a>, DAffine3)>> {
    match object {
        Some(name) if meshes.is_empty() => {
            Err(Error::unknown(&file.origin, "object with a mesh", name, names.iter().map(|name| &**name)))
        }
        _ => Ok(meshes),
    }
}

/// Reads a list of numbers of nodes, which there are `all` of.
fn numbers(node: &Node, field: &str, all: usize) -> Result<Vec<usize>> {
    let items = node.get(field).map_or(Ok(Vec::new()), |numbers| numbers.items())?;
    let number = |item: &Node| {
        let number = item.count()?;
        if number < all { Ok(number) } else { Err(item.invalid(format!("one of {all} nodes, from 0"))) }
    };
    items.iter().map(number).collect()
}

/// Reads how a node is placed in its parent.
fn local(node: &Node) -> Result<DAffine3> {
    if let Some(matrix) = node.get("matrix") {
        let columns: [f64; 16] = matrix.array("16 numbers, column by column", Node::number)?;
        return Ok(DAffine3::from_mat4(DMat4::from_cols_array(&columns)));
    }
    let vector = |field, default| node.get_or(field, default, Node::vector).map(DVec3::from);
    let rotation = node
        .get_or("rotation", [0.0, 0.0, 0.0, 1.0], |n| n.array("a quaternion [x, y, z, w]", Node::number))?;
    let rotation = DQuat::from_array(rotation);
    // Of length 1 but for rounding.
    let rotation = if rotation.length() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    let (scale, translation) = (vector("scale", [1.0; 3])?, vector("translation", [0.0; 3])?);
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}
