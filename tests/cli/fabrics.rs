//! `fnopt fabrics`, and fabrics that are asked for by name.

use super::command::{done, fnopt, json, refused_cleanly};
use fnopt::scene::fabrics;

#[test]
fn fabrics_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let (list, _) = done(fnopt(folder.path(), &["fabrics"]));
    let (all, _) = done(fnopt(folder.path(), &["fabrics", "--json"]));
    let all: Vec<serde_json::Value> = serde_json::from_str(&all).unwrap();
    assert_eq!((list.lines().count(), all.len()), (fabrics().len(), fabrics().len()));
    for ((fabric, line), value) in fabrics().iter().zip(list.lines()).zip(&all) {
        assert!(line.starts_with(fabric.name) && line.ends_with(fabric.description), "{line}");
        assert_eq!((&value["name"], &value["source"]), (&fabric.name.into(), &fabric.source.into()));
        assert_eq!(value["material"]["shear_modulus"], fabric.moduli.shear_modulus);
        assert_eq!(
            value["published_drape_coefficients"],
            serde_json::json!(fabric.published_drape_coefficients)
        );
    }
    refused_cleanly(folder.path(), &["fabrics", "denin"], &["unknown fabric 'denin' (did you mean denim"]);
}

#[test]
fn a_fabric_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let measure = ["fabrics", "denim", "--measure", "--grid", "16", "--times", "2"];
    let (line, _) = done(fnopt(folder.path(), &measure));
    assert!(line.contains("bending length 17.16 x 19.68 mm, measured 17.1"), "{line}");
    let (all, _) = done(fnopt(folder.path(), &[&measure[..], &["--json"]].concat()));
    let all: serde_json::Value = serde_json::from_str(&all).unwrap();
    let measured = &all[0]["measured"];
    assert_eq!(measured["drape_coefficients"].as_array().unwrap().len(), 2);
    assert!((0.3..0.9).contains(&measured["drape_coefficient"].as_f64().unwrap()), "{measured}");
    assert_eq!(measured["at_rest"], true);
    let (line, _) =
        done(fnopt(folder.path(), &["fabrics", "wool", "--measure", "--grid", "16", "--times", "1"]));
    assert!(line.trim_end().ends_with(", published 49.8 %"), "{line}");
    refused_cleanly(folder.path(), &["fabrics", "--measure", "--grid", "4"], &["--grid", "16..=256"]);
}

#[test]
fn a_rollout_takes_stiffness_and_mass_of_a_fabric() {
    let folder = tempfile::tempdir().unwrap();
    refused_cleanly(
        folder.path(),
        &["rollout", "--material", "demin"],
        &["--material: unknown material 'demin' (did you mean denim"],
    );
    let short = ["--device", "cpu", "--solver", "gd", "--frames", "3", "--grid", "16", "--no-pictures"];
    let denim = ["rollout", "--material", "denim"];
    done(fnopt(folder.path(), &[&denim[..], &short].concat()));
    let report = json(&folder.path().join("out/report.json"));
    let scene = &report["settings"]["scene"];
    assert_eq!(scene["areal_mass_kg_m2"], 0.324);
    assert_eq!(scene["material"]["shear_modulus"], 53.387184);
    // A file goes before a fabric of its name.
    std::fs::write(folder.path().join("denim"), r#"{"material": "paper"}"#).unwrap();
    done(fnopt(folder.path(), &[&denim[..], &short].concat()));
    let report = json(&folder.path().join("out/report.json"));
    assert_eq!(report["settings"]["scene"]["areal_mass_kg_m2"], 0.187);
}
