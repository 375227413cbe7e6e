//! Materials that no cloth has: they are allowed, but as a rule a slip of units.

use super::Units;
use crate::cloth::{Cloth, Grid};

/// Most that a metre of a fabric stretches under its own weight, as a share of that, before it is doubted. Of the fabric `sweater` it
/// is a third.
const MOST_STRETCH: f64 = 0.5;
/// Least that the free end of a metre of a fabric sinks under its own weight when the other is clamped, as a share of that.
const LEAST_SAG: f64 = 0.01;
/// Gravity under which materials are judged [m/s^2].
const GRAVITY: f64 = 9.8;

/// Returns what is doubtful about the material of a cloth on this grid; nothing where there is no gravity.
pub(super) fn doubts(grid: Grid, cloth: &Cloth, units: &Units) -> Vec<String> {
    let mut doubts = Vec::new();
    if cloth.gravity == [0.0; 3] {
        return doubts;
    }
    let weight_n_m2 = GRAVITY * units.areal_mass_kg_m2;
    let moduli = units.moduli(grid, cloth.material);
    // Along the height and along the width.
    let both = |modulus: f64, coefficients: [f64; 2], mean: f64| {
        coefficients.map(|coefficient| if mean > 0.0 { modulus * coefficient / mean } else { 0.0 })
    };
    let stretch = both(moduli.stretch_modulus, cloth.material.stretches(), cloth.material.stretch);
    let bend = both(moduli.bending_stiffness, cloth.material.bends(), cloth.material.bend);
    let [weakest, strongest] = [stretch[0].min(stretch[1]), stretch[0].max(stretch[1])];
    if weakest == 0.0 {
        doubts.push("nothing holds the sheet together: its stretch modulus is 0".into());
    } else if weight_n_m2 / weakest > MOST_STRETCH {
        let percent = 100.0 * weight_n_m2 / weakest;
        doubts.push(format!(
            "a metre of it would stretch by {percent:.0} % under its own weight: is its stretch modulus {weakest:.3e} N/m?"
        ));
    }
    // The edge at the top carries all of the others, and its length is the difference of positions as large as their number, which cancels.
    if weight_n_m2 * units.length_m / strongest < f64::from(f32::EPSILON) {
        doubts.push(format!(
            "single precision does not resolve how it stretches under its own weight: is its stretch modulus {strongest:.3e} N/m?"
        ));
    }
    // Of a clamped strip, w L^4 / (8 D).
    let stiffest = bend[0].max(bend[1]);
    if weight_n_m2 / (8.0 * stiffest) < LEAST_SAG {
        doubts.push(format!(
            "a metre of it, clamped at one end, would not bend down by a hundredth of that: is its bending stiffness {stiffest:.3e} N m?"
        ));
    }
    doubts
}

#[cfg(test)]
mod tests {
    use crate::cloth::Grid;
    use crate::scene::{Moduli, Scene, Start, Stiffness, fabrics, named_scenes};

    fn doubts_of(scene: &Scene) -> Vec<String> {
        let flat = Scene { start: Start::Flat, mask: None, ..scene.clone() };
        let setup = flat.setup().unwrap();
        super::doubts(setup.model.grid, &setup.model.cloths[0], &setup.units)
    }

    fn doubts(stretch_modulus: f64, bending_stiffness: f64, change: impl Fn(&mut Scene)) -> Vec<String> {
        let weave = Default::default();
        let moduli = Moduli { stretch_modulus, shear_modulus: 20.0, bending_stiffness, weave };
        let mut scene = Scene { stiffness: Stiffness::Moduli(moduli), ..Scene::default() };
        change(&mut scene);
        doubts_of(&scene)
    }

    #[test]
    fn slips_of_units_are_doubted() {
        let same = |_: &mut Scene| ();
        assert_eq!(doubts(160.0, 1.5e-5, same), [""; 0]);
        let one = |found: Vec<String>, text: &str| {
            assert!(found.len() == 1 && found[0].contains(text), "{found:?}, not {text}");
        };
        one(
            doubts(3.0, 1.5e-5, same),
            "stretch by 61 % under its own weight: is its stretch modulus 3.000e0 N/m?",
        );
        one(doubts(0.0, 1.5e-5, same), "nothing holds the sheet together");
        one(doubts(3e7, 1.5e-5, same), "does not resolve");
        one(doubts(160.0, 100.0, same), "bending stiffness 1.000e2 N m?");
        assert_eq!(doubts(3.0, 100.0, |scene| scene.gravity = [0.0; 3]), [""; 0]);
    }

    #[test]
    fn fabrics_and_scenes_are_not_doubted() {
        for fabric in fabrics() {
            for grid in [Grid { h: 32, w: 32 }, Grid { h: 24, w: 70 }] {
                let of = |scene: &mut Scene| {
                    scene.set_fabric(fabric.name).unwrap();
                    scene.regrid(grid).unwrap();
                };
                assert_eq!(doubts(160.0, 1.5e-5, of), [""; 0], "{} on {grid}", fabric.name);
            }
        }
        for scene in named_scenes() {
            assert_eq!(doubts_of(&Scene::named(scene.name).unwrap()), [""; 0], "{}", scene.name);
        }
    }
}
