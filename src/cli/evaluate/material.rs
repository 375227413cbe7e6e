//! `--material`: what the cloth is made of.

use fnopt::eval::Physics;
use fnopt::scene::{Scene, Stiffness};
use fnopt::sim::Material;
use fnopt::{Error, Result};
use serde_json::{Map, Value};
use std::path::Path;

/// The fitted material.
const FITTED: &str = include_str!("../../../assets/materials/arcsim.json");

/// The fields of a scene that a file of a material may have; others say where it comes from.
const FIELDS: [&str; 3] = ["material", "wind", "frame_time_s"];

/// The fitted material.
pub fn fitted() -> Result<Physics> {
    parse("the fitted material", FITTED)
}

/// Three energy coefficients, or a file.
pub fn read(text: &str) -> Result<Physics> {
    if !text.contains(',') {
        let content = std::fs::read_to_string(text).map_err(|e| Error::io(text, "cannot read", e))?;
        return parse(text, &content);
    }
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let Some(Ok(coefficients)) = numbers.map(<[f64; 3]>::try_from) else {
        return Err(Error::invalid("--material", "coefficients", "three numbers or a file", text));
    };
    if !coefficients.iter().all(|k| k.is_finite() && *k >= 0.0) {
        return Err(Error::invalid("--material", "coefficients", "numbers that are not negative", text));
    }
    let [stretch, shear, bend] = coefficients;
    Ok(Physics { stiffness: Stiffness::Grid(Material { stretch, shear, bend }), ..Physics::default() })
}

/// A file's `material`, and the air and the frame time that it gives, all as in a scene.
fn parse(origin: &str, text: &str) -> Result<Physics> {
    let bad = |field: &str, expected: &str, found: &dyn std::fmt::Display| {
        Error::invalid(origin, field, expected, found)
    };
    let document: Value = serde_json::from_str(text).map_err(|e| bad("text", "JSON", &e))?;
    let given = |field: &str| document.get(field).filter(|value| !value.is_null());
    if given("material").is_none() {
        return Err(bad("material", "an object of coefficients or moduli", &"none"));
    }
    let part = |&field: &&str| given(field).map(|value| (field.to_owned(), value.clone()));
    let scene: Map<String, Value> = FIELDS.iter().filter_map(part).collect();
    let scene = Scene::parse(&Value::Object(scene).to_string(), origin, Path::new(""))?;
    let of_wind = |field: &str| given("wind").is_some_and(|wind| wind.get(field).is_some());
    Ok(Physics {
        stiffness: scene.stiffness,
        density: of_wind("density").then_some(scene.wind.density),
        drag: of_wind("drag").then_some(scene.wind.drag),
        frame_time_s: given("frame_time_s").map(|_| scene.frame_time_s),
    })
}

/// A material as a document that [`read`] reads back; the air and the frame time where they are given.
pub fn to_json(physics: &Physics) -> Value {
    let scene = Scene { stiffness: physics.stiffness, ..Scene::default() }.to_json();
    let mut document = serde_json::json!({ "material": scene["material"] });
    for (field, value) in [("density", physics.density), ("drag", physics.drag)] {
        if let Some(value) = value {
            document["wind"][field] = value.into();
        }
    }
    if let Some(time) = physics.frame_time_s {
        document["frame_time_s"] = time.into();
    }
    document
}
