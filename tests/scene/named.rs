//! The scenes that come with the library.

use crate::common::assets;
use fnopt::scene::{Scene, named_scenes};
use std::collections::BTreeSet;

#[test]
fn every_named_scene_sets_up_and_survives_a_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    for named in named_scenes() {
        let scene = Scene::named(named.name).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(scene.origin, named.name);
        assert_eq!(scene.files().count(), 0, "{}: a name has no folder to find files in", named.name);
        let setup = scene.setup().unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(setup.poses.len(), scene.bodies.len());
        let saved = folder.path().join(format!("{}.json", named.name));
        scene.save(&saved).unwrap();
        let again = Scene { origin: scene.origin.clone(), ..Scene::load(&saved).unwrap() };
        assert_eq!(again, scene);
        assert_eq!(again.setup().unwrap(), setup, "{}", named.name);
        let file = Scene::load(assets(&format!("scenes/{}.json", named.name))).unwrap();
        assert_eq!(Scene { origin: scene.origin.clone(), ..file }, scene);
    }
}

/// No particle of their starts is inside a body, so a frame of them begins as it is drawn.
#[test]
fn named_scenes_start_outside_their_bodies() {
    for named in named_scenes() {
        let setup = Scene::named(named.name).unwrap().setup().unwrap();
        let scene = Scene::named(named.name).unwrap();
        let bare = Scene { bodies: vec![], attached: vec![], events: vec![], ..scene }.setup().unwrap();
        assert_eq!(setup.start, bare.start, "{}", named.name);
    }
}

#[test]
fn named_scenes_have_names_and_descriptions_of_their_own() {
    let names: BTreeSet<&str> = named_scenes().iter().map(|scene| scene.name).collect();
    let descriptions: BTreeSet<&str> = named_scenes().iter().map(|scene| scene.description).collect();
    assert_eq!([names.len(), descriptions.len()], [named_scenes().len(); 2]);
    for scene in named_scenes() {
        // The command line takes what has none of these for a name.
        assert!(!scene.name.contains(['.', '/', '\\']), "{}", scene.name);
        assert!(!scene.description.is_empty() && !scene.description.contains('\n'), "{}", scene.name);
        assert!(scene.text.ends_with("}\n"), "{}", scene.name);
    }
}

#[test]
fn an_unknown_name_is_told_the_nearest() {
    for (wrong, right) in [("spere", "sphere"), ("Curtain", "curtain"), ("fold_edge", "fold-edge")] {
        let error = Scene::named(wrong).unwrap_err().to_string();
        let said = format!("unknown scene '{wrong}' (did you mean {right}");
        assert!(error.contains(&said), "{error}");
    }
}
