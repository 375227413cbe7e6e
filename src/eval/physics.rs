//! A material, with the air and the frame time that belong to it.

use crate::io::{self, Node};
use crate::scene::{Scene, Stiffness};
use crate::{Error, Result};
use serde_json::{Map, Value};
use std::path::Path;

/// The scene fields that a material document may have; others document its origin.
const FIELDS: [&str; 3] = ["material", "wind", "frame_time_s"];

/// Physical parameters that replace those of a sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Physics {
    /// Energy coefficients (grid units), or moduli, which describe the same cloth on every grid.
    pub stiffness: Stiffness,
    /// Density of the air [kg/m^3]; `None` for the sequence's.
    pub density: Option<f64>,
    /// Drag of the air [N s/m^3]; `None` for the sequence's.
    pub drag: Option<f64>,
    /// Frame time \[s\]; `None` for the sequence's.
    pub frame_time_s: Option<f64>,
}

impl Physics {
    /// Parses a material document: `material` and, optionally, `density` and `drag` in `wind`, and
    /// `frame_time_s`, all as in a scene. Fails if it gives a wind velocity, which is not a property of the
    /// material. Other fields are notes, unless they look like a misspelling of one of these.
    pub fn parse(text: &str, origin: &str) -> Result<Self> {
        let document = io::parse_json(origin, text)?;
        Node::root(origin, &document).no_misspelling(&FIELDS)?;
        let given = |field: &str| document.get(field).filter(|value| !value.is_null());
        if given("material").is_none() {
            return Err(Error::invalid(origin, "material", "an object of coefficients or moduli", "none"));
        }
        let part = |&field: &&str| given(field).map(|value| (field.to_owned(), value.clone()));
        let scene: Map<String, Value> = FIELDS.iter().filter_map(part).collect();
        let scene = Scene::parse(&Value::Object(scene).to_string(), origin, Path::new(""))?;
        let of_wind =
            |field: &str| given("wind").is_some_and(|wind| wind.get(field).is_some_and(|v| !v.is_null()));
        if of_wind("velocity") {
            return Err(Error::invalid(origin, "wind.velocity", "density and drag only", "a velocity"));
        }
        Ok(Self {
            stiffness: scene.stiffness,
            density: of_wind("density").then_some(scene.wind.density),
            drag: of_wind("drag").then_some(scene.wind.drag),
            frame_time_s: given("frame_time_s").map(|_| scene.frame_time_s),
        })
    }

    /// Sets the material of a scene, and its air and frame time if given.
    pub fn apply(&self, scene: &mut Scene) {
        scene.stiffness = self.stiffness;
        scene.wind.density = self.density.unwrap_or(scene.wind.density);
        scene.wind.drag = self.drag.unwrap_or(scene.wind.drag);
        scene.frame_time_s = self.frame_time_s.unwrap_or(scene.frame_time_s);
    }

    /// Returns the document that [`Physics::parse`] reads back, with the air and the frame time if given.
    pub fn to_json(&self) -> Value {
        let scene = Scene { stiffness: self.stiffness, ..Scene::default() }.to_json();
        let mut document = serde_json::json!({ "material": scene["material"] });
        for (field, value) in [("density", self.density), ("drag", self.drag)] {
            if let Some(value) = value {
                document["wind"][field] = value.into();
            }
        }
        if let Some(time) = self.frame_time_s {
            document["frame_time_s"] = time.into();
        }
        document
    }
}
