//! A material, and the air and the frame time that belong to it.

use crate::io::{self, Node};
use crate::scene::{Scene, Stiffness};
use crate::{Error, Result};
use serde_json::{Map, Value};
use std::path::Path;

/// The fields of a scene that a document of a material may have; others say where it comes from.
const FIELDS: [&str; 3] = ["material", "wind", "frame_time_s"];

/// What a cloth is simulated with beside what its sequence tells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Physics {
    /// Energy coefficients (grid units), or moduli, which are the same cloth on every grid.
    pub stiffness: Stiffness,
    /// Density of the air [kg/m^3]; the sequence's where not given.
    pub density: Option<f64>,
    /// Drag of the air [N s/m^3]; the sequence's where not given.
    pub drag: Option<f64>,
    /// Frame time \[s\]; the sequence's where not given.
    pub frame_time_s: Option<f64>,
}

impl Physics {
    /// A document's `material`, and the air's `density` and `drag` in `wind` and the `frame_time_s` where it gives them, all as in
    /// a scene; how the air moves is no matter of the material. Other fields are notes, unless they look like one of these
    /// misspelt.
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

    /// Gives a scene this material, and the air and the frame time where they are told.
    pub fn apply(&self, scene: &mut Scene) {
        scene.stiffness = self.stiffness;
        scene.wind.density = self.density.unwrap_or(scene.wind.density);
        scene.wind.drag = self.drag.unwrap_or(scene.wind.drag);
        scene.frame_time_s = self.frame_time_s.unwrap_or(scene.frame_time_s);
    }

    /// The document that [`Physics::parse`] reads back; the air and the frame time where they are given.
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
