//! What the page changes of a scene while it runs, in SI units.

use fnopt::cloth::{Cloth, Grid};
use fnopt::scene::{Setup, Units};
use fnopt::serde_json::{Value, json};
use fnopt::{Error, Result};

/// The fields that the page may set, each with the largest value that is accepted.
const FIELDS: [(&str, f64); 7] = [
    ("stretch", 1e6),
    ("shear", 1e6),
    ("bend", 1e3),
    ("density", 100.0),
    ("gravity", 100.0),
    ("wind", 100.0),
    ("wind_direction", 360.0),
];

/// Values in place of the scene's own, in the order of [`FIELDS`]; `None` for what the scene has.
#[derive(Clone, Copy, Debug, Default)]
pub struct Settings([Option<f64>; FIELDS.len()]);

impl Settings {
    /// Sets a field. Fails with the nearest names if there is none, or if the value is out of range.
    pub fn set(&mut self, field: &str, value: f64) -> Result<()> {
        let names = FIELDS.iter().map(|(name, _)| *name);
        let k = FIELDS.iter().position(|(name, _)| *name == field);
        let k = k.ok_or_else(|| Error::unknown("page", "field", field, names))?;
        let (name, most) = FIELDS[k];
        let least = if name == "density" { 1e-3 } else { 0.0 };
        if !(least..=most).contains(&value) {
            return Err(Error::invalid("page", name, format!("{least} to {most}"), value));
        }
        self.0[k] = Some(value);
        Ok(())
    }

    /// Returns the units of the scene's cloth with the page's density.
    fn units(&self, setup: &Setup) -> Units {
        let areal_mass_kg_m2 = self.0[3].unwrap_or(setup.units.areal_mass_kg_m2);
        Units { areal_mass_kg_m2, ..setup.units }
    }

    /// Returns the cloth with the page's material and gravity.
    pub fn applied(&self, setup: &Setup, cloth: &Cloth) -> Cloth {
        let (grid, own, units) = (setup.model.grid, &setup.units, self.units(setup));
        let mut moduli = own.moduli(grid, cloth.material);
        let fields = [&mut moduli.stretch_modulus, &mut moduli.shear_modulus, &mut moduli.bending_stiffness];
        fields.into_iter().zip(self.0).for_each(|(field, value)| *field = value.unwrap_or(*field));
        let (density, drag) = own.air_si(cloth.air);
        let mut cloth = cloth.clone();
        cloth.material = units.material(grid, moduli);
        cloth.air = units.air(density, drag);
        if let Some(gravity) = self.0[4] {
            cloth.gravity = units.acceleration([0.0, 0.0, -gravity]);
        }
        cloth
    }

    /// Returns the wind [edges / frame] in place of the scene's.
    pub fn wind(&self, setup: &Setup, own: [f32; 3]) -> [f32; 3] {
        let [_, _, _, _, _, speed, direction] = self.0;
        if speed.is_none() && direction.is_none() {
            return own;
        }
        let [of_scene, towards] = polar(setup, own);
        let (speed, towards) = (speed.unwrap_or(of_scene), direction.unwrap_or(towards).to_radians());
        setup.units.velocity([speed * towards.cos(), speed * towards.sin(), 0.0]).map(|c| c as f32)
    }

    /// Returns all fields as they are, given the scene's cloth and wind.
    pub fn values(&self, setup: &Setup, cloth: &Cloth, wind: [f32; 3]) -> Value {
        let grid: Grid = setup.model.grid;
        let (units, cloth) = (self.units(setup), self.applied(setup, cloth));
        let moduli = units.moduli(grid, cloth.material);
        let gravity = units.acceleration_m_s2(cloth.gravity).iter().map(|c| c * c).sum::<f64>().sqrt();
        let [speed, direction] = polar(setup, self.wind(setup, wind));
        json!({
            "stretch": moduli.stretch_modulus, "shear": moduli.shear_modulus, "bend": moduli.bending_stiffness,
            "density": units.areal_mass_kg_m2, "gravity": gravity, "wind": speed, "wind_direction": direction,
        })
    }
}

/// Returns the speed [m/s] of a wind [edges / frame] and where it blows to, counter-clockwise from the x axis seen from above
/// \[degrees, 0 to 360\].
fn polar(setup: &Setup, wind: [f32; 3]) -> [f64; 2] {
    let [x, y, z] = setup.units.velocity_m_s(wind.map(f64::from));
    [(x * x + y * y + z * z).sqrt(), y.atan2(x).to_degrees().rem_euclid(360.0)]
}
