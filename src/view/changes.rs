//! What the panel changes about a scene while it runs.

use crate::cloth::Cloth;
use crate::scene::{Moduli, Setup, Units};
use glam::DVec3;

/// What replaces the scene's own values, in SI units and the scene's axes; `None` for what the scene says, events included.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Changes {
    /// Moduli of the cloth.
    pub moduli: Option<Moduli>,
    /// Mass per area [kg/m^2]. The moduli stay.
    pub areal_mass_kg_m2: Option<f64>,
    /// Gravity, downwards [m/s^2].
    pub gravity: Option<f64>,
    /// Velocity of the wind [m/s].
    pub wind: Option<[f64; 3]>,
}

/// The values that a cloth has, in SI units and the scene's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Values {
    /// Moduli of the cloth.
    pub moduli: Moduli,
    /// Mass per area [kg/m^2].
    pub areal_mass_kg_m2: f64,
    /// Magnitude of gravity [m/s^2].
    pub gravity: f64,
    /// Velocity of the wind, without gusts [m/s].
    pub wind: [f64; 3],
}

impl Changes {
    /// Returns the units of the changed cloth.
    pub(super) fn units(&self, setup: &Setup) -> Units {
        let areal_mass_kg_m2 = self.areal_mass_kg_m2.unwrap_or(setup.units.areal_mass_kg_m2);
        Units { areal_mass_kg_m2, ..setup.units }
    }

    /// Returns the cloth that the scene has now, changed.
    pub(super) fn apply(&self, setup: &Setup, cloth: &Cloth) -> Cloth {
        let (grid, units) = (setup.model.grid, self.units(setup));
        let mut changed = cloth.clone();
        if self.moduli.is_some() || self.areal_mass_kg_m2.is_some() {
            let own = setup.units.moduli(grid, cloth.material);
            changed.material = units.material(grid, self.moduli.unwrap_or(own));
            let (density, drag) = setup.units.air_si(cloth.air);
            changed.air = units.air(density, drag);
        }
        if let Some(gravity) = self.gravity {
            changed.gravity = setup.acceleration_of(setup.up.down(gravity));
        }
        changed
    }

    /// Returns the values of the changed cloth. `wind` is what the scene has now [edges / frame].
    pub(super) fn values(&self, setup: &Setup, cloth: &Cloth, wind: [f64; 3]) -> Values {
        let gravity = DVec3::from(setup.units.acceleration_m_s2(cloth.gravity)).length();
        let wind = setup.up.from_z_up(setup.units.velocity_m_s(wind));
        Values {
            moduli: self.moduli.unwrap_or_else(|| setup.units.moduli(setup.model.grid, cloth.material)),
            areal_mass_kg_m2: self.units(setup).areal_mass_kg_m2,
            gravity: self.gravity.unwrap_or(gravity),
            wind: self.wind.unwrap_or(wind),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn a_heavier_cloth_keeps_its_moduli_and_its_air() {
        let setup = Scene::default().setup().unwrap();
        let cloth = &setup.model.cloths[0];
        assert_eq!(&Changes::default().apply(&setup, cloth), cloth);
        let heavier = Changes { areal_mass_kg_m2: Some(2.0 * 0.187), ..Changes::default() };
        let changed = heavier.apply(&setup, cloth);
        assert!((changed.material.stretch * 2.0 / cloth.material.stretch - 1.0).abs() < 1e-12);
        assert!((changed.air.density * 2.0 / cloth.air.density - 1.0).abs() < 1e-12);
        assert_eq!(changed.gravity, cloth.gravity);
        let values = heavier.values(&setup, cloth, [0.0; 3]);
        assert!((values.moduli.stretch_modulus / 1492.888 - 1.0).abs() < 1e-9, "{values:?}");
        assert!((values.gravity - 9.8).abs() < 1e-9);
    }

    #[test]
    fn gravity_and_moduli_are_those_of_the_panel() {
        let setup = Scene::default().setup().unwrap();
        let mut moduli = setup.units.moduli(setup.model.grid, setup.model.cloths[0].material);
        (moduli.stretch_modulus, moduli.bending_stiffness) = (500.0, 1e-4);
        let changes = Changes { moduli: Some(moduli), gravity: Some(1.62), ..Changes::default() };
        let changed = changes.apply(&setup, &setup.model.cloths[0]);
        let values = Changes::default().values(&setup, &changed, [0.0; 3]);
        assert!((values.gravity - 1.62).abs() < 1e-9, "{values:?}");
        assert!((values.moduli.bending_stiffness / 1e-4 - 1.0).abs() < 1e-9, "{values:?}");
    }
}
