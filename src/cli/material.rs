//! `--material`: the energy coefficients or moduli of the cloth.

use super::numbers;
use fnopt::cloth::Material;
use fnopt::eval::Physics;
use fnopt::io::read_text;
use fnopt::scene::{Fabric, Scene, Stiffness};
use fnopt::{Error, Result};
use std::path::Path;

/// The fitted material, as JSON.
const FITTED: &str = include_str!("../../assets/materials/arcsim.json");

/// Parses the fitted material.
pub fn fitted() -> Result<Physics> {
    Physics::parse(FITTED, "the fitted material")
}

/// Whether `--material` gives a name: a file of that name goes before it.
fn is_name(text: &str) -> bool {
    text.chars().all(|c| c.is_alphanumeric() || c == '-')
        && !Path::new(text).exists()
        && text.parse::<f64>().is_err()
}

/// Sets what `--material` says in a scene: the material, and the mass per area of a fabric, too.
pub fn apply(text: &str, scene: &mut Scene) -> Result<()> {
    if is_name(text) && Fabric::known(text).is_some() {
        return scene.set_fabric(text);
    }
    read(text)?.apply(scene);
    Ok(())
}

/// Reads `--material`: the name of a material, three energy coefficients, or a file.
pub fn read(text: &str) -> Result<Physics> {
    if is_name(text) {
        return Ok(Physics { stiffness: Stiffness::named(text, "--material")?, ..Physics::default() });
    }
    let Some(coefficients) = numbers::<3>(text) else {
        let numeric = text.contains(',') || text.parse::<f64>().is_ok();
        if numeric && !Path::new(text).is_file() {
            return Err(Error::invalid("--material", "coefficients", "three numbers or a file", text));
        }
        return Physics::parse(&read_text(Path::new(text))?, text);
    };
    if !coefficients.iter().all(|k| k.is_finite() && *k >= 0.0) {
        return Err(Error::invalid(
            "--material",
            "coefficients",
            "finite numbers that are not negative",
            text,
        ));
    }
    let [stretch, shear, bend] = coefficients;
    Ok(Physics {
        stiffness: Stiffness::Grid(Material { stretch, shear, bend, ..Material::PAPER }),
        ..Physics::default()
    })
}
