//! Fabrics as the material of a scene.

use super::common::parse;
use fnopt::cloth::Weave;
use fnopt::scene::{Fabric, Mass, Scene, Stiffness, fabrics};

#[test]
fn a_fabric_sets_stiffness_and_mass() {
    for fabric in fabrics() {
        let scene = parse(&format!(r#"{{"material": "{}", "start": "flat"}}"#, fabric.name)).unwrap();
        assert_eq!((scene.stiffness, scene.mass), (fabric.stiffness(), fabric.mass()));
        // It is written as numbers, which are the same cloth.
        let again = Scene::parse(&scene.to_json().to_string(), &scene.origin, "".as_ref()).unwrap();
        assert_eq!(again, scene);
        // And is that cloth on a grid, too.
        let setup = scene.setup().unwrap();
        assert_eq!(setup.units.areal_mass_kg_m2, fabric.areal_mass_kg_m2);
        let found = setup.units.moduli(setup.model.grid, setup.model.cloths[0].material);
        for (found, expected) in [
            (found.stretch_modulus, fabric.moduli.stretch_modulus),
            (found.shear_modulus, fabric.moduli.shear_modulus),
            (found.bending_stiffness, fabric.moduli.bending_stiffness),
        ] {
            assert!(expected > 0.0 && (found / expected - 1.0).abs() < 1e-12, "{found} for {expected}");
        }
    }
}

#[test]
fn a_mass_of_the_scene_goes_before_that_of_the_fabric() {
    for (field, expected) in [
        (r#""areal_mass_kg_m2": 0.5"#, Mass::Areal(0.5)),
        (r#""mass_kg": 0.7"#, Mass::Total(0.7)),
        (r#""mass_kg": null"#, Mass::Areal(0.324)),
    ] {
        let scene = parse(&format!(r#"{{"material": "denim", {field}}}"#)).unwrap();
        assert_eq!(scene.mass, expected);
        assert_eq!(scene.stiffness, Stiffness::named("denim", "a test").unwrap());
    }
    // Those that are no fabric leave it as it was.
    for name in ["paper", "default"] {
        assert_eq!(parse(&format!(r#"{{"material": "{name}"}}"#)).unwrap().mass, Mass::Areal(0.187));
        assert_eq!(Fabric::known(name), None);
    }
    assert_eq!(parse(r#"{"material": "paper"}"#).unwrap().stiffness, Stiffness::paper());
}

/// Mass per area and bending length, as a laboratory gives them, are in the range of apparel: 80 to 350 g/m^2 and 1 to 3 cm. Sheets of
/// rubber and leather are heavier, and canvas is stiffer.
#[test]
fn fabrics_are_cloths() {
    let mut names: Vec<_> = fabrics().iter().map(|fabric| fabric.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), fabrics().len());
    for fabric in fabrics() {
        let lengths = fabric.moduli.bending_lengths_m(fabric.areal_mass_kg_m2, 9.81);
        let (heaviest, longest) = match fabric.name {
            "rubber" | "leather" => (0.53, 0.03),
            "canvas" => (0.35, 0.045),
            _ => (0.35, 0.03),
        };
        assert!(
            lengths.iter().all(|length| (0.01..longest).contains(length)),
            "{}: {lengths:?} m",
            fabric.name
        );
        assert!((0.08..heaviest).contains(&fabric.areal_mass_kg_m2), "{}", fabric.name);
        assert!(!fabric.description.is_empty() && !fabric.source.is_empty());
        assert_eq!(Fabric::find(fabric.name, "a test").unwrap(), *fabric);
    }
    // Half a millimetre of rubber with a shear modulus of 0.5 MPa, so Young's of 1.5 MPa.
    let rubber = Fabric::known("rubber").unwrap().moduli;
    assert!((rubber.stretch_modulus - 750.0).abs() < 1e-9 && (rubber.shear_modulus - 250.0).abs() < 1e-9);
    let bending = 1.5e6 * 0.5e-3_f64.powi(3) / (12.0 * (1.0 - 0.25));
    assert!((rubber.bending_stiffness / bending - 1.0).abs() < 1e-12);
    // 1 g of weight on 1 cm, B = D / (rho g) = 1 cm^3: 9.81e-6 N m at 1 kg/m^2.
    let weave = Weave { bend: [1.0, 8.0], ..Weave::EVEN };
    let moduli = fnopt::scene::Moduli { bending_stiffness: 9.81e-6, weave, ..fabrics()[0].moduli };
    for (length, expected) in moduli.bending_lengths_m(1.0, 9.81).into_iter().zip([0.01, 0.02]) {
        assert!((length - expected).abs() < 1e-15);
    }
}

/// Conversions of what the sources list, by hand.
#[test]
fn moduli_follow_from_measurements() {
    let close =
        |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-3, "{found} for {expected}");
    // 0.067 gf cm^2/cm; 8.149 and 21.860 MPa along the threads and 0.170 MPa between them, times 0.568 mm.
    let wool = Fabric::known("wool").unwrap().moduli;
    close(wool.bending_stiffness, 6.570e-6);
    close(wool.stretch_modulus * wool.weave.stretch[0], 4628.5);
    close(wool.stretch_modulus * wool.weave.stretch[1], 12416.0);
    close(wool.shear_modulus, 24.31);
    // A strip of silk that contracts freely as it is pulled: 1.8145 and 4.1952 MPa, times 0.18 mm.
    let silk = Fabric::known("silk").unwrap().moduli;
    close(silk.stretch_modulus * silk.weave.stretch[0], 326.61);
    close(silk.stretch_modulus * silk.weave.stretch[1], 755.13);
    close(silk.shear_modulus, 51.3);
    close(silk.bending_stiffness * silk.weave.bend[0], 2.0898e-6);
    close(silk.bending_stiffness * silk.weave.bend[1], 4.8318e-6);
}

#[test]
fn a_misspelt_fabric_gets_the_nearest_name() {
    let error = parse(r#"{"material": "demin"}"#).unwrap_err().to_string();
    assert!(error.contains("material: unknown material 'demin' (did you mean denim"), "{error}");
    let error = Fabric::find("trouser", "fabrics").unwrap_err().to_string();
    assert!(error.contains("fabrics: unknown fabric 'trouser' (did you mean trousers"), "{error}");
}

/// The mass of a cloth stays when its stiffness becomes that of a fabric.
#[test]
fn an_event_changes_the_stiffness_alone() {
    let text = r#"{"material": "denim", "start": "flat", "frames": 9, "motion": "none",
        "events": [{"frame": 4, "material": "t-shirt"}]}"#;
    let setup = parse(text).unwrap().setup().unwrap();
    let found = setup.units.moduli(setup.model.grid, setup.changes[0].cloth.material);
    let shirt = Fabric::known("t-shirt").unwrap().moduli;
    assert!((found.bending_stiffness / shirt.bending_stiffness - 1.0).abs() < 1e-12);
    assert_eq!(setup.units.areal_mass_kg_m2, 0.324);
}
