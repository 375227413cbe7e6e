//! Scene files: conversion between JSON and [`Scene`].

use super::start::read_transform;
use super::{
    Attachment, BodyMotion, BodySettings, BodyShape, Event, Fabric, Gusts, Handles, MapSettings,
    MaskSettings, Mass, MeshSource, Moduli, Motion, Placement, RepulsionSettings, RestShape, Scene,
    SelfContactSettings, Side, Start, StartFile, Stiffness, UpAxis, Wind, authors,
};
use crate::cloth::{Grid, Material, Weave};
use crate::io::{MeshFile, Node};
use crate::{Error, Result, io};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The fields of a scene file.
pub(super) const FIELDS: [&str; 26] = [
    "grid",
    "side_m",
    "mask",
    "mesh",
    "mass_kg",
    "areal_mass_kg_m2",
    "material",
    "damping_s",
    "maps",
    "rest_shape",
    "gravity",
    "wind",
    "repulsion",
    "self_contact",
    "bodies",
    "friction",
    "thickness_m",
    "frame_time_s",
    "frames",
    "start",
    "handles",
    "attached",
    "motion",
    "speed",
    "events",
    "up",
];

impl Stiffness {
    /// Returns the material as [`read_stiffness`] reads it.
    pub(super) fn to_json(self) -> Value {
        match self {
            Stiffness::Grid(coefficients) => json!(coefficients),
            Stiffness::Moduli(moduli) => json!(moduli),
        }
    }
}

impl Handles {
    /// Returns the handles as [`read_handles`] reads them.
    pub(super) fn to_json(&self) -> Value {
        match self {
            Handles::Placement(placement) => json!(placement.name()),
            Handles::Cells(cells) => json!(cells),
            Handles::Vertices(vertices) => json!(vertices),
        }
    }
}

impl Scene {
    /// Reads a scene file, in our format or the authors', and checks its numbers. [`Scene::setup`] reads the
    /// files it names.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let text = io::read_text(path)?;
        // An absolute folder keeps the paths of the scene valid if it is saved elsewhere.
        let folder = path.parent().unwrap_or(Path::new(""));
        let folder =
            std::path::absolute(folder.join(".")).map_err(|e| Error::io(folder, "cannot find", e))?;
        Self::parse(&text, &path.display().to_string(), &folder)
    }

    /// Parses a scene from JSON text. Relative paths in it are resolved against `folder`; `origin` names the
    /// text in errors.
    pub fn parse(text: &str, origin: &str, folder: &Path) -> Result<Self> {
        let document = io::parse_json(origin, text)?;
        let node = Node::root(origin, &document);
        let scene =
            if authors::recognise(&document) { authors::read(&node, folder)? } else { read(&node, folder)? };
        scene.check()?;
        scene.handles.on(scene.grid, origin)?;
        Ok(scene)
    }

    /// Returns the scene as a document that [`Scene::parse`] reads back to the same scene, except for its
    /// `origin`. Paths are written as they are; [`Scene::parse`] resolves relative ones against its folder.
    pub fn to_json(&self) -> Value {
        let (mass_field, mass) = match self.mass {
            Mass::Total(kg) => ("mass_kg", kg),
            Mass::Areal(kg_m2) => ("areal_mass_kg_m2", kg_m2),
        };
        let mut document = json!({
            "grid": [self.grid.h, self.grid.w],
            "side_m": match self.side_m {
                Side::Height(h) => json!(h),
                Side::Both(sides) => json!(sides),
            },
            "mask": self.mask.as_ref().map(MaskSettings::to_json),
            "mesh": self.mesh.as_ref().map(|file| match &file.object {
                Some(object) => json!({ "file": file.path.to_string_lossy(), "object": object }),
                None => json!(file.path.to_string_lossy()),
            }),
            "material": self.stiffness.to_json(),
            "damping_s": self.damping_s,
            "maps": self.maps.to_json(),
            "rest_shape": self.rest_shape.to_json(),
            "gravity": self.gravity,
            "wind": self.wind,
            "repulsion": self.repulsion.map_or(json!(false), |settings| json!(settings)),
            "self_contact": self.self_contact.map_or(json!(false), |settings| json!(settings)),
            "bodies": self.bodies.iter().map(BodySettings::to_json).collect::<Vec<_>>(),
            "friction": self.friction,
            "thickness_m": self.thickness_m,
            "frame_time_s": self.frame_time_s,
            "frames": self.frames,
            "start": match &self.start {
                Start::File(file) => json!({
                    "file": file.path.to_string_lossy(),
                    "grid": file.grid.map(|g| [g.h, g.w]),
                    "transform": file.transform,
                }),
                Start::Vertices(grid, vertices) => json!({ "vertices": vertices, "grid": [grid.h, grid.w] }),
                named => json!(named.name()),
            },
            "handles": self.handles.to_json(),
            "attached": self.attached.iter().map(Attachment::to_json).collect::<Vec<_>>(),
            "motion": match &self.motion {
                Motion::Rows(rows) => json!(rows),
                named => json!(named.to_string()),
            },
            "speed": self.speed,
            "events": self.events.iter().map(Event::to_json).collect::<Vec<_>>(),
            "up": match self.up {
                UpAxis::Y => "y",
                UpAxis::Z => "z",
            },
        });
        document[mass_field] = json!(mass);
        document
    }

    /// Writes the scene to a file that [`Scene::load`] reads back, with absolute paths. The file appears
    /// whole or not at all.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut scene = self.clone();
        let absolute = |path: &mut PathBuf| -> Result<()> {
            *path = std::path::absolute(&*path).map_err(|e| Error::io(&*path, "cannot find", e))?;
            Ok(())
        };
        if let Start::File(file) = &mut scene.start {
            absolute(&mut file.path)?;
        }
        if let Motion::File(path) = &mut scene.motion {
            absolute(path)?;
        }
        scene.mesh.iter_mut().map(|file| &mut file.path).try_for_each(absolute)?;
        scene.mask.iter_mut().flat_map(MaskSettings::files_mut).try_for_each(absolute)?;
        scene.maps.files_mut().try_for_each(absolute)?;
        for body in &mut scene.bodies {
            if let BodyMotion::File(path) = &mut body.motion {
                absolute(path)?;
            }
            if let BodyShape::Mesh { source: MeshSource::File(file), .. } = &mut body.shape {
                absolute(&mut file.path)?;
            }
        }
        io::replace(path, |w| writeln!(w, "{:#}", scene.to_json()))
    }
}

/// Fields that other simulators have, and what to do here.
const ABSENT: [(&str, &str); 39] = [
    (
        "damping",
        "\"damping_s\" damps changes of the stretch, and the air slows the cloth (\"wind\": {\"density\", \"drag\"})",
    ),
    ("fabric", "it is called \"material\": \"denim\""),
    ("stiffness", "it is called \"material\", or \"maps\": {\"stiffness\"} where it varies"),
    ("drag", "it is a field of \"wind\""),
    ("colliders", BODIES),
    ("collider", BODIES),
    ("collisions", BODIES),
    ("collision", BODIES),
    ("obstacles", BODIES),
    ("ground", A_PLANE),
    ("floor", A_PLANE),
    ("self_collision", "it is called \"self_contact\": true"),
    ("self_collisions", "it is called \"self_contact\": true"),
    (
        "thickness",
        "\"thickness_m\" is the distance from bodies, and \"self_contact\": {\"thickness_m\"} that of layers",
    ),
    ("pressure", "there is none; a uniform acceleration is \"gravity\", and a wind is \"wind\""),
    ("substeps", "a frame is one step; \"frame_time_s\" makes it shorter"),
    ("fps", "\"frame_time_s\" is its reciprocal"),
    ("dt", "\"frame_time_s\" is the duration of a frame [s]"),
    ("time_step", "\"frame_time_s\" is the duration of a frame [s]"),
    ("duration", "\"frames\" is the number of frames, including the start"),
    ("density", "\"areal_mass_kg_m2\" is the cloth's, and \"wind\": {\"density\"} the air's"),
    ("mass", "it is called \"mass_kg\", or \"areal_mass_kg_m2\""),
    ("resolution", "it is called \"grid\""),
    ("size", "it is called \"side_m\""),
    ("render_mesh", A_MESH),
    ("embedding", A_MESH),
    ("uv", "it is in the file that \"mesh\" names"),
    ("pins", "they are called \"handles\""),
    ("pinned", "they are called \"handles\""),
    ("air", "it is called \"wind\""),
    ("stretch", "it is a field of \"material\""),
    ("bend", "it is a field of \"material\""),
    ("shear", "it is a field of \"material\""),
    ("creases", A_REST_SHAPE),
    ("pleats", A_REST_SHAPE),
    ("rest_angles", A_REST_SHAPE),
    ("curvature", A_REST_SHAPE),
    ("solver", "it is an option of the command, --solver"),
    ("iterations", "it is an option of the command, --iterations"),
];
const A_REST_SHAPE: &str = "it belongs into \"rest_shape\": {\"creases\": [{\"u\": 0.5, \"angle\": 90}], \"pleats\", \"curvature_per_m\"}";
const A_MESH: &str = "it is called \"mesh\": the path of an .obj, .glb or .gltf with texture coordinates";
const BODIES: &str =
    "they are called \"bodies\": [{\"shape\": \"sphere\", \"radius_m\": 0.2, \"position_m\": [0, 0, 0]}]";
const A_PLANE: &str = "it is one of \"bodies\": [{\"shape\": \"plane\", \"position_m\": [0, 0, 0]}]";

/// Reads our own format; see the documentation of [`super`].
fn read(node: &Node, folder: &Path) -> Result<Scene> {
    node.deny_absent(&ABSENT)?;
    node.deny_unknown(&FIELDS)?;
    let fallback = Scene::default();
    let up = node.get_or("up", UpAxis::Y, read_up)?;
    let mask = node.get_or("mask", None, |n| MaskSettings::read(n, folder).map(Some))?;
    let maps = node.get_or("maps", MapSettings::default(), |n| MapSettings::read(n, folder))?;
    let rest_shape = node.get_or("rest_shape", RestShape::default(), RestShape::read)?;
    let is_sheet = mask.is_none() && maps.is_empty() && rest_shape.is_flat();
    let start = if is_sheet { fallback.start } else { Start::Flat };
    Ok(Scene {
        grid: node.get_or("grid", fallback.grid, read_grid)?,
        side_m: node.get_or("side_m", fallback.side_m, read_side)?,
        mask,
        maps,
        rest_shape,
        damping_s: node.get_or("damping_s", fallback.damping_s, Node::number)?,
        mesh: node.get_or("mesh", None, |n| read_mesh(n, folder).map(Some))?,
        mass: read_mass(node)?,
        stiffness: node.get_or("material", fallback.stiffness, read_stiffness)?,
        gravity: node.get_or("gravity", up.down(super::GRAVITY_M_S2), |n| read_gravity(n, up))?,
        wind: node.get_or("wind", fallback.wind, read_wind)?,
        repulsion: node.get_or("repulsion", fallback.repulsion, read_repulsion)?,
        self_contact: node.get_or("self_contact", fallback.self_contact, read_self_contact)?,
        bodies: node.get_or("bodies", Vec::new(), |n| {
            n.items()?.iter().map(|body| BodySettings::read(body, up, folder)).collect()
        })?,
        friction: node.get_or("friction", fallback.friction, Node::number)?,
        thickness_m: node.get_or("thickness_m", None, |n| n.number().map(Some))?,
        frame_time_s: node.get_or("frame_time_s", fallback.frame_time_s, Node::number)?,
        frames: node.get_or("frames", None, read_frames)?,
        start: node.get_or("start", start, |n| read_start(n, folder))?,
        handles: node.get_or("handles", fallback.handles, read_handles)?,
        motion: node.get_or("motion", fallback.motion, |n| read_motion(n, folder))?,
        attached: node
            .get_or("attached", Vec::new(), |n| n.items()?.iter().map(Attachment::read).collect())?,
        speed: node.get_or("speed", fallback.speed, Node::number)?,
        events: node.get_or("events", Vec::new(), |n| {
            n.items()?.iter().map(|event| Event::read(event, up)).collect()
        })?,
        up,
        origin: node.origin.to_owned(),
    })
}

fn read_mesh(node: &Node, folder: &Path) -> Result<MeshFile> {
    if node.value.is_string() {
        let path = Path::new(node.text()?);
        let is_obj = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
        return if is_obj || io::is_gltf(path) {
            Ok(folder.join(path).into())
        } else {
            Err(node.invalid("the path of an .obj, .glb or .gltf file"))
        };
    }
    if !node.value.is_object() {
        let expected = "the path of an .obj, .glb or .gltf file, or {\"file\": path, \"object\": name}";
        return Err(node.invalid(expected));
    }
    node.deny_unknown(&["file", "object"])?;
    let file = node.get("file").ok_or_else(|| node.invalid("{\"file\": path}"))?;
    file.text()?;
    Ok(MeshFile { object: read_object(node)?, ..read_mesh(&file, folder)? })
}

/// Reads which object of a file of meshes is meant.
pub(super) fn read_object(node: &Node) -> Result<Option<String>> {
    node.get_or("object", None, |name| name.text().map(|name| Some(name.to_owned())))
}

fn read_frames(node: &Node) -> Result<Option<usize>> {
    match node.count() {
        Ok(frames) if frames > 0 => Ok(Some(frames)),
        _ => Err(node.invalid("a whole number, 1 or more")),
    }
}

fn read_up(node: &Node) -> Result<UpAxis> {
    match node.text()? {
        "y" => Ok(UpAxis::Y),
        "z" => Ok(UpAxis::Z),
        _ => Err(node.invalid("\"y\" or \"z\"")),
    }
}

fn read_grid(node: &Node) -> Result<Grid> {
    let [h, w] = match node.value.is_number() {
        true => [node.count()?; 2],
        false => node.array("two sizes [H, W], or one for both", Node::count)?,
    };
    // The scene's own grid needs no further name.
    let origin = match node.path.strip_suffix(".grid") {
        Some(parent) => format!("{}: {parent}", node.origin),
        None => node.origin.to_owned(),
    };
    Grid::new(h, w, &origin)
}

fn read_side(node: &Node) -> Result<Side> {
    if node.value.is_number() {
        return Ok(Side::Height(node.number()?));
    }
    Ok(Side::Both(node.array("the side along the height, or [height, width]", Node::number)?))
}

/// Reads the mass, which is by default that of the fabric that the material names.
fn read_mass(node: &Node) -> Result<Mass> {
    let fabric = node.get("material").and_then(|material| Fabric::known(material.value.as_str()?));
    match (node.get("mass_kg"), node.get("areal_mass_kg_m2")) {
        (None, None) => Ok(fabric.map_or(Mass::default(), |fabric| fabric.mass())),
        (Some(total), None) => Ok(Mass::Total(total.number()?)),
        (None, Some(areal)) => Ok(Mass::Areal(areal.number()?)),
        (Some(total), Some(_)) => Err(total.invalid("either mass_kg or areal_mass_kg_m2, not both")),
    }
}

/// Reads a material: coefficients, moduli or a name, also that of a fabric.
pub(crate) fn read_stiffness(node: &Node) -> Result<Stiffness> {
    const MODULI: [&str; 3] = ["stretch_modulus", "shear_modulus", "bending_stiffness"];
    const GRID: [&str; 3] = ["stretch", "shear", "bend"];
    if let Value::String(name) = node.value {
        return Stiffness::named(name, &format!("{}: {}", node.origin, node.path));
    }
    let known: Vec<&str> = GRID.into_iter().chain(MODULI).chain(["weave"]).collect();
    node.deny_unknown(&known)?;
    // Of the numbers themselves if they say so, else of the factors.
    let weave = |of_numbers: Weave| match node.get("weave") {
        Some(given) if !of_numbers.is_even() => Err(given.invalid("none beside two numbers for both axes")),
        Some(given) => read_weave(&given),
        None => Ok(of_numbers),
    };
    if MODULI.iter().all(|key| node.get(key).is_none()) {
        let typical = Material::default();
        let (stretch, of_stretch) = node.get_or(GRID[0], (typical.stretch, [1.0; 2]), read_along_axes)?;
        let (bend, of_bend) = node.get_or(GRID[2], (typical.bend, [1.0; 2]), read_along_axes)?;
        let weave = weave(Weave { stretch: of_stretch, bend: of_bend })?;
        let shear = node.get_or(GRID[1], typical.shear, Node::number)?;
        return Ok(Stiffness::Grid(Material { stretch, shear, bend, weave }));
    }
    if let Some(mixed) = GRID.iter().find_map(|key| node.get(key)) {
        return Err(mixed.invalid("either grid coefficients or SI moduli, not both"));
    }
    let expected = format!("all three of {}", MODULI.join(", "));
    let modulus = |key| node.get(key).ok_or_else(|| node.invalid(expected.clone()));
    let (stretch_modulus, of_stretch) = read_along_axes(&modulus(MODULI[0])?)?;
    let (bending_stiffness, of_bend) = read_along_axes(&modulus(MODULI[2])?)?;
    let weave = weave(Weave { stretch: of_stretch, bend: of_bend })?;
    let shear_modulus = modulus(MODULI[1])?.number()?;
    Ok(Stiffness::Moduli(Moduli { stretch_modulus, shear_modulus, bending_stiffness, weave }))
}

/// Reads a number, or one along the height and one along the width: their mean, and the factors of it.
fn read_along_axes(node: &Node) -> Result<(f64, [f64; 2])> {
    if node.value.is_number() {
        return Ok((node.number()?, [1.0; 2]));
    }
    let along = node.array("a number, or two: [along the height, along the width]", Node::number)?;
    if along.iter().any(|number| *number < 0.0) {
        return Err(node.invalid("numbers of 0 or more"));
    }
    let mean = 0.5 * along[0] + 0.5 * along[1];
    Ok((mean, if along[0] == along[1] { [1.0; 2] } else { along.map(|number| number / mean) }))
}

/// Reads the factors of both axes, which a scene is written with.
fn read_weave(node: &Node) -> Result<Weave> {
    node.deny_unknown(&["stretch", "bend"])?;
    let factors = |field: &str| {
        node.get_or(field, [1.0; 2], |node| {
            let factors = node.array("two factors: [along the height, along the width]", Node::number)?;
            match factors.iter().all(|factor| *factor >= 0.0) {
                true => Ok(factors),
                false => Err(node.invalid("factors of 0 or more")),
            }
        })
    };
    Ok(Weave { stretch: factors("stretch")?, bend: factors("bend")? })
}

/// Reads gravity: a vector, or a magnitude that points down whatever its sign.
pub(super) fn read_gravity(node: &Node, up: UpAxis) -> Result<[f64; 3]> {
    if node.value.is_number() {
        return Ok(up.down(node.number()?.abs()));
    }
    node.array("three numbers [x, y, z], or one that points down", Node::number)
}

pub(super) fn read_wind(node: &Node) -> Result<Wind> {
    node.deny_unknown(&["velocity", "density", "drag", "gusts"])?;
    let fallback = Wind::default();
    Ok(Wind {
        velocity: node.get_or("velocity", fallback.velocity, Node::vector)?,
        density: node.get_or("density", fallback.density, Node::number)?,
        drag: node.get_or("drag", fallback.drag, Node::number)?,
        gusts: node.get_or("gusts", None, |n| Gusts::read(n).map(Some))?,
    })
}

fn read_repulsion(node: &Node) -> Result<Option<RepulsionSettings>> {
    let fallback = RepulsionSettings::default();
    match node.value {
        Value::Bool(wanted) => Ok(wanted.then_some(fallback)),
        Value::Object(_) => {
            node.deny_unknown(&["strength", "distance"])?;
            Ok(Some(RepulsionSettings {
                strength: node.get_or("strength", fallback.strength, Node::number)?,
                distance: node.get_or("distance", fallback.distance, Node::number)?,
            }))
        }
        _ => Err(node.invalid("true, false or {\"strength\", \"distance\"}")),
    }
}

fn read_self_contact(node: &Node) -> Result<Option<SelfContactSettings>> {
    match node.value {
        Value::Bool(wanted) => Ok(wanted.then(SelfContactSettings::default)),
        Value::Object(_) => {
            node.deny_unknown(&["thickness_m", "friction"])?;
            Ok(Some(SelfContactSettings {
                thickness_m: node.get_or("thickness_m", None, |n| n.number().map(Some))?,
                friction: node.get_or("friction", None, |n| n.number().map(Some))?,
            }))
        }
        _ => Err(node.invalid("true, false or {\"thickness_m\", \"friction\"}")),
    }
}

fn read_start(node: &Node, folder: &Path) -> Result<Start> {
    if node.value.is_string() {
        return Start::parse(node.text()?, node.origin, folder);
    }
    if let Some(vertices) = node.get("vertices") {
        node.deny_unknown(&["vertices", "grid"])?;
        let grid = node.get("grid").ok_or_else(|| node.invalid("a \"grid\" next to \"vertices\""))?;
        return Ok(Start::Vertices(read_grid(&grid)?, read_points(&vertices)?));
    }
    if !node.value.is_object() {
        return Err(node.invalid("a start's name, a path, or an object with a \"file\" or \"vertices\""));
    }
    node.deny_unknown(&["file", "grid", "transform"])?;
    let file = node.get("file").ok_or_else(|| node.invalid("a name, a path or {\"file\": path, ..}"))?;
    match Start::parse(file.text()?, node.origin, folder)? {
        Start::File(StartFile { path, .. }) => Ok(Start::File(StartFile {
            path,
            grid: node.get_or("grid", None, |n| read_grid(n).map(Some))?,
            transform: node.get_or("transform", None, |n| read_transform(n).map(Some))?,
        })),
        _ => Err(file.invalid("the path of an .obj, .npy or .npz file")),
    }
}

fn read_motion(node: &Node, folder: &Path) -> Result<Motion> {
    match node.value {
        Value::Array(_) => Ok(Motion::Rows(node.items()?.iter().map(read_points).collect::<Result<_>>()?)),
        Value::String(name) => Motion::parse(name, node.origin, folder),
        _ => Err(node.invalid("a motion's name, a .npy file, or positions [frames, handles, 3]")),
    }
}

fn read_points(node: &Node) -> Result<Vec<[f64; 3]>> {
    node.items()?.iter().map(Node::vector).collect()
}

pub(super) fn read_handles(node: &Node) -> Result<Handles> {
    if node.value.is_string() {
        return Placement::named(node.text()?, node.origin).map(Handles::Placement);
    }
    let Some(items) = node.value.as_array() else {
        return Err(node.invalid("the name of a placement, pairs [i, j] or vertex numbers"));
    };
    if items.first().is_some_and(Value::is_array) {
        let pair = |n: &Node| n.array("a pair [i, j]", Node::count);
        return Ok(Handles::Cells(node.items()?.iter().map(pair).collect::<Result<_>>()?));
    }
    Ok(Handles::Vertices(node.items()?.iter().map(Node::count).collect::<Result<_>>()?))
}
