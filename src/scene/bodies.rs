//! The bodies of a scene, in SI units and the scene's axes.

use super::file::read_object;
use super::setup::warn_once;
use super::{Units, UpAxis};
use crate::cloth::{Body, DistanceField, Pose, Shape};
use crate::io::{self, MeshFile, Node};
use crate::{Error, Result, memory};
use glam::{DQuat, DVec3};
use ndarray::{ArrayD, Ix2};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Thickness of a contact unless the cloth has one \[edges\].
pub(super) const THICKNESS: f64 = 0.16;
/// Samples of a mesh's distance along its longest side, unless it says.
const CELLS: usize = 64;
/// Bytes for each sample while they are computed.
const BYTES_PER_SAMPLE: usize = 24;
/// Friction of a body that does not say.
const FRICTION: f64 = 0.3;

/// A body that the cloth meets, which the cloth does not move.
#[derive(Clone, Debug, PartialEq)]
pub struct BodySettings {
    /// Its shape.
    pub shape: BodyShape,
    /// Where it is at the start, unless its motion says so.
    pub pose: BodyPose,
    /// How it moves.
    pub motion: BodyMotion,
    /// Coulomb's coefficient of friction. Between cloth and body the smaller of both counts.
    pub friction: f64,
    /// Thickness that is added to that of the cloth \[m\].
    pub thickness_m: f64,
    /// Whether it is there at the start. Events hide and show bodies.
    pub visible: bool,
}

/// The shape of a body around its own origin, in the scene's axes.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum BodyShape {
    /// Everything below a plane across the body's up axis.
    Plane,
    /// A ball.
    Sphere {
        /// Radius \[m\].
        radius_m: f64,
    },
    /// A cylinder along the body's up axis with round ends.
    Capsule {
        /// Radius \[m\].
        radius_m: f64,
        /// Length between the centres of its ends \[m\].
        length_m: f64,
    },
    /// A box.
    Box {
        /// Lengths of its sides along the axes \[m\].
        sides_m: [f64; 3],
    },
    /// A closed mesh.
    Mesh {
        /// Where it comes from.
        source: MeshSource,
        /// What one of its units of length is \[m\].
        unit_m: f64,
        /// Samples of its distance along its longest side, 8 to 256.
        cells: usize,
    },
}

/// Where the mesh of a body comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshSource {
    /// An OBJ file in the scene's axes, or a glTF file (`.glb`, `.gltf`), which is y up, or an object in it.
    File(MeshFile),
    /// The mesh itself.
    Mesh {
        /// Vertices in the scene's axes.
        vertices: Vec<[f64; 3]>,
        /// The numbers of each face's vertices, from 0.
        faces: Vec<[u32; 3]>,
    },
}

/// Where a body is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyPose {
    /// Position of its origin \[m\].
    pub position_m: [f64; 3],
    /// Rotation as a quaternion (x, y, z, w) of length 1.
    pub rotation: [f64; 4],
}

impl Default for BodyPose {
    /// At the origin, not rotated.
    fn default() -> Self {
        Self { position_m: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] }
    }
}

impl BodyPose {
    /// Returns the pose with a quaternion of length 1. Fails if that is zero or not finite; `origin` and `field` name it in the error.
    pub(crate) fn normalised(self, origin: &str, field: String) -> Result<Self> {
        let rotation = DQuat::from_array(self.rotation);
        if !(rotation.is_finite() && rotation.length() > 0.0) {
            let found = format!("{:?}", self.rotation);
            return Err(Error::invalid(origin, field, "a quaternion that is not zero", found));
        }
        Ok(Self { rotation: rotation.normalize().to_array(), ..self })
    }
}

impl From<[f64; 7]> for BodyPose {
    /// A position and a quaternion.
    fn from([x, y, z, i, j, k, w]: [f64; 7]) -> Self {
        Self { position_m: [x, y, z], rotation: [i, j, k, w] }
    }
}

impl From<BodyPose> for [f64; 7] {
    fn from(pose: BodyPose) -> Self {
        let ([x, y, z], [i, j, k, w]) = (pose.position_m, pose.rotation);
        [x, y, z, i, j, k, w]
    }
}

/// How a body moves.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum BodyMotion {
    /// Not at all.
    Still,
    /// Through these poses at these times \[s\], which increase: straight and evenly from one to the next.
    Keys(Vec<(f64, BodyPose)>),
    /// Through the poses in a `.npy` of shape [frames, 3] (positions) or [frames, 7] (positions and quaternions), one
    /// for each frame.
    File(PathBuf),
}

impl BodySettings {
    /// Returns a body of this shape that stays at the origin, with the default friction.
    pub fn new(shape: BodyShape) -> Self {
        let (pose, motion) = (BodyPose::default(), BodyMotion::Still);
        Self { shape, pose, motion, friction: FRICTION, thickness_m: 0.0, visible: true }
    }

    /// Reads a body of a scene file with this axis up. Relative paths are resolved against `folder`.
    pub(super) fn read(node: &Node, up: UpAxis, folder: &Path) -> Result<Self> {
        const COMMON: [&str; 7] =
            ["shape", "position_m", "rotation", "motion", "friction", "thickness_m", "visible"];
        if !node.value.is_object() {
            return Err(node.invalid("a body, {\"shape\": \"sphere\", \"radius_m\": 0.2, ..}"));
        }
        let shape = node.get("shape").ok_or_else(|| {
            node.invalid("a \"shape\": \"plane\", \"sphere\", \"capsule\", \"box\" or \"mesh\"")
        })?;
        let need = |field: &str, what: &str| {
            node.get(field).ok_or_else(|| node.invalid(format!("\"{field}\", {what}")))
        };
        let (shape, own): (_, &[&str]) = match shape.text()? {
            "plane" => (BodyShape::Plane, &["normal"]),
            "sphere" => (
                BodyShape::Sphere { radius_m: need("radius_m", "the radius [m]")?.positive()? },
                &["radius_m"],
            ),
            "capsule" => {
                let radius_m = need("radius_m", "the radius [m]")?.positive()?;
                let length_m =
                    need("length_m", "the distance between the centres of its ends [m]")?.not_negative()?;
                (BodyShape::Capsule { radius_m, length_m }, &["radius_m", "length_m", "axis"])
            }
            "box" => {
                let sides_m =
                    need("sides_m", "its sides [m]")?.array("three lengths above 0 [m]", Node::positive)?;
                (BodyShape::Box { sides_m }, &["sides_m"])
            }
            "mesh" => (read_mesh(node, folder)?, &["file", "object", "vertices", "faces", "unit_m", "cells"]),
            other => {
                let origin = format!("{}: {}", node.origin, shape.path);
                let known = ["plane", "sphere", "capsule", "box", "mesh"];
                return Err(Error::unknown(origin, "shape", other, known));
            }
        };
        node.deny_unknown(&[&COMMON[..], own].concat())?;
        let mut body = Self::new(shape);
        body.pose = read_pose(node, body.pose)?;
        if let Some(axis) = ["normal", "axis"].iter().find_map(|field| node.get(field)) {
            if let Some(rotation) = node.get("rotation") {
                return Err(rotation.invalid(format!("either a rotation or {}, not both", axis.path)));
            }
            body.pose.rotation = towards(&axis, up)?;
        }
        body.friction = node.get_or("friction", body.friction, Node::not_negative)?;
        body.thickness_m = node.get_or("thickness_m", 0.0, Node::not_negative)?;
        body.visible = node.get_or("visible", true, Node::flag)?;
        if let Some(motion) = node.get("motion") {
            body.motion = read_motion(&motion, body.pose, folder)?;
        }
        Ok(body)
    }

    /// Returns the body as [`BodySettings::read`] reads it.
    pub(super) fn to_json(&self) -> Value {
        let pose = |pose: &BodyPose| json!({ "position_m": pose.position_m, "rotation": degrees(pose) });
        let mut document = pose(&self.pose);
        let mut set = |field: &str, value: Value| document[field] = value;
        match self.shape {
            BodyShape::Mesh { ref source, unit_m, cells } => {
                set("shape", json!("mesh"));
                set("unit_m", json!(unit_m));
                set("cells", json!(cells));
                match source {
                    MeshSource::File(file) => {
                        set("file", json!(file.path.to_string_lossy()));
                        if let Some(object) = &file.object {
                            set("object", json!(object));
                        }
                    }
                    MeshSource::Mesh { vertices, faces } => {
                        set("vertices", json!(vertices));
                        set("faces", json!(faces));
                    }
                }
            }
            BodyShape::Plane => set("shape", json!("plane")),
            BodyShape::Sphere { radius_m } => {
                set("shape", json!("sphere"));
                set("radius_m", json!(radius_m));
            }
            BodyShape::Capsule { radius_m, length_m } => {
                set("shape", json!("capsule"));
                set("radius_m", json!(radius_m));
                set("length_m", json!(length_m));
            }
            BodyShape::Box { sides_m } => {
                set("shape", json!("box"));
                set("sides_m", json!(sides_m));
            }
        }
        set("friction", json!(self.friction));
        set("thickness_m", json!(self.thickness_m));
        set("visible", json!(self.visible));
        match &self.motion {
            BodyMotion::Still => {}
            BodyMotion::File(path) => set("motion", json!(path.to_string_lossy())),
            BodyMotion::Keys(keys) => {
                let key = |(time_s, at): &(f64, BodyPose)| {
                    let mut key = pose(at);
                    key["time_s"] = json!(time_s);
                    key
                };
                set("motion", keys.iter().map(key).collect());
            }
        }
        document
    }

    /// Returns the poses of a body in each frame of a scene, or the single one of a body that stays; and the body in
    /// grid units. `cloth` is what the cloth adds: its thickness \[m\], if it has one, and its friction.
    pub(super) fn setup(
        &self,
        (units, up, frames): (&Units, UpAxis, usize),
        (cloth_thickness_m, cloth_friction): (Option<f64>, f64),
        (origin, field): (&str, &str),
    ) -> Result<(Body, Vec<Pose>)> {
        let edges = |m: f64| m / units.length_m;
        let shape = match self.shape {
            BodyShape::Mesh { ref source, unit_m, cells } => {
                let field = source.distances(up, cells, (origin, field))?;
                Shape::Mesh { field: Arc::new(field), scale: edges(unit_m), inset: 0.0 }
            }
            BodyShape::Plane => Shape::Plane,
            BodyShape::Sphere { radius_m } => Shape::Sphere { radius: edges(radius_m) },
            BodyShape::Capsule { radius_m, length_m } => {
                Shape::Capsule { radius: edges(radius_m), half_length: edges(0.5 * length_m) }
            }
            BodyShape::Box { sides_m } => {
                Shape::Box { half: up.to_z_up(sides_m).map(|side| edges(0.5 * side.abs())) }
            }
        };
        // An edge between two particles on a ball clears it by 1 / (8 R) less than they do.
        let curved = match shape {
            Shape::Sphere { radius } | Shape::Capsule { radius, .. } => 1.0 / (8.0 * radius),
            _ => 0.0,
        };
        let own = cloth_thickness_m.map_or(THICKNESS, edges).max(curved);
        let poses: Vec<Pose> = match &self.motion {
            BodyMotion::Still => vec![in_grid_units(&self.pose, units, up)],
            BodyMotion::Keys(keys) => (0..frames)
                .map(|frame| in_grid_units(&at(keys, frame as f64 * units.frame_time_s), units, up))
                .collect(),
            BodyMotion::File(path) => {
                read_poses(path)?.iter().take(frames).map(|pose| in_grid_units(pose, units, up)).collect()
            }
        };
        let body = Body {
            shape: shape.clone(),
            pose: poses[0],
            thickness: own + edges(self.thickness_m),
            friction: self.friction.min(cloth_friction),
            present: self.visible,
        };
        body.check(origin, field)?;
        poses.iter().enumerate().try_for_each(|(frame, pose)| {
            let moved = Body { pose: *pose, ..body.clone() };
            moved.check(origin, &format!("{field} in frame {frame}"))
        })?;
        Ok((body, poses))
    }
}

impl MeshSource {
    /// Returns the mesh's distances in its own unit, z up, with so many samples along its longest side. `origin` and `field`
    /// name the body in errors.
    fn distances(&self, up: UpAxis, cells: usize, (origin, field): (&str, &str)) -> Result<DistanceField> {
        // As many as a cube of its longest side takes, with the empty cells around it.
        let samples = (cells + 2 * DistanceField::MARGIN_CELLS + 2).pow(3);
        memory::check(samples * BYTES_PER_SAMPLE, &format!("{field}: a mesh with {cells} cells"))?;
        let build = |vertices: &mut dyn Iterator<Item = [f64; 3]>,
                     faces: &[[u32; 3]],
                     (origin, field): (&str, &str)| {
            let vertices: Vec<[f64; 3]> = vertices.collect();
            let distances = DistanceField::new(&vertices, faces, cells).map_err(|fault| {
                Error::invalid(
                    origin,
                    field,
                    "a closed mesh, whose faces all turn their fronts outwards",
                    fault,
                )
            })?;
            if distances.overlaps() {
                warn_once(format!(
                    "{origin}: {field}: parts of the mesh overlap; the body is what is inside of any of them"
                ));
            }
            Ok(distances)
        };
        match self {
            Self::File(file) => {
                let mesh = io::read_mesh(file.clone())?;
                // glTF is y up, whatever the scene is.
                let axes = if io::is_gltf(&file.path) { UpAxis::Y } else { up };
                let mut vertices = mesh.positions.iter().map(|p| axes.to_z_up(p.map(f64::from)));
                build(&mut vertices, &mesh.faces, (&file.to_string(), "faces"))
            }
            Self::Mesh { vertices, faces } => {
                build(&mut vertices.iter().map(|v| up.to_z_up(*v)), faces, (origin, field))
            }
        }
    }
}

/// Reads the shape of a body that is a mesh.
fn read_mesh(node: &Node, folder: &Path) -> Result<BodyShape> {
    let source = match (node.get("file"), node.get("vertices"), node.get("faces")) {
        (Some(file), None, None) => {
            MeshSource::File(MeshFile { path: folder.join(file.text()?), object: read_object(node)? })
        }
        _ if let Some(object) = node.get("object") => {
            return Err(object.invalid("none without the \"file\" that it is in"));
        }
        (None, Some(vertices), Some(faces)) => {
            let corner =
                |n: &Node| u32::try_from(n.count()?).map_err(|_| n.invalid("the number of a vertex"));
            MeshSource::Mesh {
                vertices: vertices.items()?.iter().map(Node::vector).collect::<Result<_>>()?,
                faces: faces
                    .items()?
                    .iter()
                    .map(|face| face.array("the numbers of three vertices", corner))
                    .collect::<Result<_>>()?,
            }
        }
        _ => {
            return Err(
                node.invalid("either the \"file\" of an .obj, .glb or .gltf, or \"vertices\" and \"faces\"")
            );
        }
    };
    let cells = node.get_or("cells", CELLS, |n| {
        n.count()
            .ok()
            .filter(|cells| (8..=256).contains(cells))
            .ok_or_else(|| n.invalid("a whole number, 8 to 256"))
    })?;
    Ok(BodyShape::Mesh { source, unit_m: node.get_or("unit_m", 1.0, Node::positive)?, cells })
}

/// Reads position and rotation; what is missing is that of `fallback`.
fn read_pose(node: &Node, fallback: BodyPose) -> Result<BodyPose> {
    Ok(BodyPose {
        position_m: node.get_or("position_m", fallback.position_m, Node::vector)?,
        rotation: node.get_or("rotation", fallback.rotation, |n| {
            let [degrees, x, y, z] = n.array("[degrees, x, y, z]", Node::number)?;
            let axis = DVec3::new(x, y, z).try_normalize();
            let axis = axis.ok_or_else(|| n.invalid("an axis that is not zero"))?;
            Ok(DQuat::from_axis_angle(axis, degrees.to_radians()).to_array())
        })?,
    })
}

/// Reads an axis and returns the rotation that turns the scene's up axis there.
fn towards(node: &Node, up: UpAxis) -> Result<[f64; 4]> {
    let axis = DVec3::from(node.vector()?).try_normalize();
    let axis = axis.ok_or_else(|| node.invalid("an axis that is not zero"))?;
    Ok(DQuat::from_rotation_arc(up.down(-1.0).into(), axis).to_array())
}

fn read_motion(node: &Node, at_start: BodyPose, folder: &Path) -> Result<BodyMotion> {
    match node.value {
        Value::String(path) if path.ends_with(".npy") => Ok(BodyMotion::File(folder.join(path))),
        Value::Array(_) => {
            let mut keys: Vec<(f64, BodyPose)> = Vec::new();
            for key in node.items()? {
                key.deny_unknown(&["time_s", "position_m", "rotation"])?;
                let time = key.get("time_s").ok_or_else(|| key.invalid("a \"time_s\" [s]"))?;
                let (time_s, before) = (time.number()?, keys.last());
                if before.is_some_and(|(before, _)| *before >= time_s) {
                    return Err(time.invalid("a time later than that of the key before"));
                }
                let pose = read_pose(&key, before.map_or(at_start, |(_, pose)| *pose))?;
                keys.push((time_s, pose));
            }
            if keys.is_empty() {
                return Err(node.invalid("at least one key"));
            }
            Ok(BodyMotion::Keys(keys))
        }
        _ => {
            Err(node.invalid("the path of a .npy, or keys [{\"time_s\", \"position_m\", \"rotation\"}, ..]"))
        }
    }
}

/// Reads the poses of a body, one for each frame.
fn read_poses(path: &Path) -> Result<Vec<BodyPose>> {
    let origin = path.display().to_string();
    let array: ArrayD<f64> = io::read_npy(path)?;
    let found = format!("{:?}", array.shape());
    let rows =
        array.into_dimensionality::<Ix2>().ok().filter(|a| a.nrows() > 0 && [3, 7].contains(&a.ncols()));
    let Some(rows) = rows else {
        return Err(Error::invalid(origin, "shape", "[frames, 3] or [frames, 7]", found));
    };
    let pose = |(frame, row): (usize, ndarray::ArrayView1<'_, f64>)| {
        let position_m = [row[0], row[1], row[2]];
        if row.len() == 3 {
            return Ok(BodyPose { position_m, ..BodyPose::default() });
        }
        let pose = BodyPose { position_m, rotation: [row[3], row[4], row[5], row[6]] };
        pose.normalised(&origin, format!("rotation of frame {frame}"))
    };
    rows.rows().into_iter().enumerate().map(pose).collect()
}

/// Returns the pose at a time between keys.
fn at(keys: &[(f64, BodyPose)], time_s: f64) -> BodyPose {
    let after = keys.partition_point(|(time, _)| *time <= time_s);
    if after == 0 || after == keys.len() {
        return keys[after.min(keys.len() - 1)].1;
    }
    let ((begin, from), (end, to)) = (keys[after - 1], keys[after]);
    let share = (time_s - begin) / (end - begin);
    let turn = DQuat::from_array(from.rotation).slerp(DQuat::from_array(to.rotation), share);
    BodyPose {
        position_m: DVec3::from(from.position_m).lerp(to.position_m.into(), share).to_array(),
        rotation: turn.normalize().to_array(),
    }
}

/// Returns a rotation as [degrees, x, y, z].
fn degrees(pose: &BodyPose) -> [f64; 4] {
    let (axis, angle) = DQuat::from_array(pose.rotation).to_axis_angle();
    [angle.to_degrees(), axis.x, axis.y, axis.z]
}

/// Converts a pose to grid units, z up.
pub(super) fn in_grid_units(pose: &BodyPose, units: &Units, up: UpAxis) -> Pose {
    let [x, y, z, w] = pose.rotation;
    let [x, y, z] = up.to_z_up([x, y, z]);
    Pose { position: units.position(up.to_z_up(pose.position_m)), rotation: [x, y, z, w] }
}

/// Converts a pose from grid units, z up: the inverse of [`in_grid_units`].
pub(super) fn in_metres(pose: &Pose, units: &Units, up: UpAxis) -> BodyPose {
    let [x, y, z, w] = pose.rotation;
    let [x, y, z] = up.from_z_up([x, y, z]);
    BodyPose { position_m: up.from_z_up(units.position_m(pose.position)), rotation: [x, y, z, w] }
}
