//! Scene files of the authors of the method.

use super::file::read_gravity;
use super::obj::Mesh;
use super::start::read_transform;
use super::{Handles, Motion, Scene, Side, Start, StartFile, Stiffness, UpAxis, file};
use crate::Result;
use crate::cloth::Grid;
use crate::io::Node;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// The fields that are read. Others (cameras, pictures, folders of results) are ignored.
const FIELDS: [&str; 11] = [
    "mesh_file",
    "mesh_resolution",
    "mesh_resolution_h",
    "mesh_resolution_w",
    "mesh_size",
    "mesh_size_h",
    "mesh_size_w",
    "transform",
    "gravity",
    "handle_ind_list",
    "dataset_dir",
];
/// The authors' gravity [m/s^2] and frame time \[s\].
const GRAVITY_M_S2: f64 = 9.76;
const FRAME_TIME_S: f64 = 1.0 / 50.0;

/// Whether a document is one of the authors' scenes: none of our fields is `handle_ind_list` or begins with
/// `mesh_`.
pub(super) fn recognise(document: &Value) -> bool {
    let is_theirs = |key: &String| key.starts_with("mesh_") || key == "handle_ind_list";
    document.as_object().is_some_and(|object| object.keys().any(is_theirs))
}

/// Reads one of the authors' scenes; see the documentation of [`super`].
pub(super) fn read(node: &Node, folder: &Path) -> Result<Scene> {
    node.no_misspelling(&FIELDS)?;
    let ours = |key: &&String| file::FIELDS.contains(&key.as_str()) && !FIELDS.contains(&key.as_str());
    for key in node.value.as_object().into_iter().flat_map(|object| object.keys().filter(ours)) {
        tracing::warn!("{}: {key}: ignored: a scene with a mesh_file is in the authors' format", node.origin);
    }
    let file = node.get("mesh_file").ok_or_else(|| node.invalid("a field mesh_file"))?;
    let path = find(node, folder, file.text()?)?;
    let (mut grid, swapped) = resolution(node)?;
    let mut sizes = pair(node, "mesh_size", Node::number)?.unwrap_or([1.0; 2]);
    // Their code takes mesh_resolution_w for the rows. If only the other order fits the faces of the mesh,
    // the faces are right.
    let mesh = Mesh::read(&path)?;
    if !mesh.fits(grid) && mesh.fits(swapped) {
        grid = swapped;
        sizes.reverse();
    }
    let transform = node.get_or("transform", None, |n| read_transform(n).map(Some))?;
    let up = UpAxis::Z;
    let default = Scene::default();
    Ok(Scene {
        grid,
        // As in their code: one length scale, from the side along the rows.
        side_m: Side::Height(sizes[1]),
        stiffness: Stiffness::paper(),
        gravity: node.get_or("gravity", up.down(GRAVITY_M_S2), |n| read_gravity(n, up))?,
        frame_time_s: FRAME_TIME_S,
        start: Start::File(StartFile { path, grid: None, transform }),
        handles: handles(node, grid)?,
        motion: Motion::Still,
        up,
        origin: node.origin.to_owned(),
        ..default
    })
}

/// Returns the path of the mesh: next to the scene file or, if it exists only there, in its `dataset_dir`.
fn find(node: &Node, folder: &Path, file: &str) -> Result<PathBuf> {
    let beside = folder.join(file);
    let other = node.get_or("dataset_dir", None, |n| Ok(Some(folder.join(n.text()?).join(file))))?;
    Ok(other.filter(|path| !beside.exists() && path.exists()).unwrap_or(beside))
}

/// Reads one value per side, [of `_h`, of `_w`], where the rows are those of `_w`: from `NAME_h` and
/// `NAME_w`, or from `NAME` as one number or as two [H, W].
fn pair<'a, T: Copy>(
    node: &Node<'a>,
    name: &str,
    read: impl Fn(&Node<'a>) -> Result<T>,
) -> Result<Option<[T; 2]>> {
    let (h, w) = (node.get(&format!("{name}_h")), node.get(&format!("{name}_w")));
    match (node.get(name), h, w) {
        (_, Some(h), Some(w)) => Ok(Some([read(&h)?, read(&w)?])),
        (_, Some(one), None) | (_, None, Some(one)) => {
            Err(one.invalid(format!("both {name}_h and {name}_w, or neither")))
        }
        (Some(both), ..) if both.value.is_array() => {
            // Their files have no such form, so it is read as everywhere here: rows first.
            let [rows, columns] = both.array("one number, or two [H, W]", read)?;
            Ok(Some([columns, rows]))
        }
        (Some(one), ..) => read(&one).map(|v| Some([v, v])),
        (None, ..) => Ok(None),
    }
}

/// Reads the grid as the authors' code takes it, and returns it also with its sides swapped.
fn resolution(node: &Node) -> Result<(Grid, Grid)> {
    let sizes = pair(node, "mesh_resolution", Node::count)?;
    let [h, w] = sizes.ok_or_else(|| node.invalid("a field mesh_resolution"))?;
    Ok((Grid::new(w, h, node.origin)?, Grid::new(h, w, node.origin)?))
}

/// Reads the handles. The authors' code goes through them from last to first: with [0, 992], h0 is 992.
fn handles(node: &Node, grid: Grid) -> Result<Handles> {
    let Some(list) = node.get("handle_ind_list") else {
        return Ok(Scene::default().handles);
    };
    let vertex = |item: &Node| {
        let inside = item.count().ok().filter(|&v| v < grid.particles());
        inside.ok_or_else(|| item.invalid(format!("a vertex below {} ({grid})", grid.particles())))
    };
    let vertices = list.items()?.iter().rev().map(vertex).collect::<Result<_>>()?;
    Ok(Handles::Vertices(vertices))
}
