//! `fnopt scenes`, and scenes that are asked for by name.

use super::command::{done, fnopt, json, refused_cleanly};
use fnopt::cloth::Grid;
use fnopt::eval::suite::Suite;
use fnopt::scene::{Scene, named_scenes};
use std::path::Path;

const SHORT: [&str; 8] = ["--device", "cpu", "--solver", "gd", "--frames", "3", "--grid", "16"];

#[test]
fn scenes_are_listed_and_printed() {
    let folder = tempfile::tempdir().unwrap();
    let (list, _) = done(fnopt(folder.path(), &["scenes"]));
    let (all, _) = done(fnopt(folder.path(), &["scenes", "--json"]));
    let all: Vec<serde_json::Value> = serde_json::from_str(&all).unwrap();
    assert_eq!((list.lines().count(), all.len()), (named_scenes().len(), named_scenes().len()));
    for ((scene, line), value) in named_scenes().iter().zip(list.lines()).zip(&all) {
        assert!(line.starts_with(scene.name) && line.ends_with(scene.description), "{line}");
        assert_eq!(value, &serde_json::json!({ "name": scene.name, "description": scene.description }));
        let (printed, _) = done(fnopt(folder.path(), &["scenes", scene.name]));
        assert_eq!(printed, scene.text);
        // What is printed, kept in a file, is the same scene.
        let file = folder.path().join("own.json");
        std::fs::write(&file, printed).unwrap();
        let own = Scene::load(&file).unwrap();
        assert_eq!(Scene { origin: scene.name.into(), ..own }, Scene::named(scene.name).unwrap());
    }
    refused_cleanly(folder.path(), &["scenes", "spere"], &["unknown scene 'spere' (did you mean sphere"]);
}

#[test]
fn a_scene_runs_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let short = ["--device", "cpu", "--frames", "3", "--grid", "16", "--no-pictures"];
    done(fnopt(folder.path(), &[&["rollout", "sphere"], &short[..]].concat()));
    let report = json(&folder.path().join("out/report.json"));
    assert_eq!(report["frames"], 3);
    assert_eq!(report["settings"]["scene"]["bodies"][0]["shape"], "sphere");
    // Of several, each has a folder of its own.
    done(fnopt(folder.path(), &[&["rollout", "edge", "flag", "--no-pictures"], &SHORT[..]].concat()));
    for (name, shape) in [("edge", "box"), ("flag", "capsule")] {
        let report = json(&folder.path().join("out").join(name).join("report.json"));
        assert_eq!(report["settings"]["scene"]["bodies"][0]["shape"], shape);
    }
}

#[test]
fn a_file_goes_before_a_scene_of_its_name_and_a_folder_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let shapes = |at: &Path| {
        done(fnopt(at, &[&["rollout", "sphere", "--no-pictures"], &SHORT[..]].concat()));
        json(&at.join("out/report.json"))["settings"]["scene"]["bodies"].as_array().unwrap().len()
    };
    std::fs::create_dir(folder.path().join("sphere")).unwrap();
    assert_eq!(shapes(folder.path()), 2);
    std::fs::remove_dir(folder.path().join("sphere")).unwrap();
    std::fs::write(folder.path().join("sphere"), "{}").unwrap();
    assert_eq!(shapes(folder.path()), 0);
}

#[test]
fn a_scene_that_is_neither_file_nor_name_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let said = ["unknown scene 'spere' (did you mean sphere", "no file of this name", "`fnopt scenes`"];
    refused_cleanly(folder.path(), &["rollout", "spere"], &said);
    // What looks like a file is one.
    for file in ["sphere.json", "./sphere", "spere.json"] {
        refused_cleanly(folder.path(), &["rollout", file], &[file, "cannot read"]);
    }
}

/// The scenes that fold are those of the suite, whose numbers then hold for them.
#[test]
fn folding_scenes_are_cases_of_the_suite() {
    let cases = Suite::Repulsion.cases(Grid { h: 64, w: 64 }).unwrap();
    for (name, case) in [("fold-corner", "corner-center with"), ("fold-edge", "single-mid-edge with")] {
        let case = cases.iter().find(|found| found.name == case).unwrap();
        let named = Scene::named(name).unwrap();
        assert_eq!(Scene { origin: named.origin.clone(), ..case.scene.clone() }, named);
    }
}
