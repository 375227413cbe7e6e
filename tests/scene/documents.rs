//! Valid scene files: the examples, the defaults, and the authors' own format.

use crate::common::{assets, distance, parse};
use fnopt::cloth::{Grid, SelfContact};
use fnopt::scene::{Handles, Motion, Placement, RepulsionSettings, Scene, Side, Start, UpAxis};
use std::path::{Path, PathBuf};

/// Returns the scene with the paths that a saved one names. On Windows `..` is resolved in them.
fn with_absolute_paths(mut scene: Scene) -> Scene {
    let absolute = |path: &mut PathBuf| *path = std::path::absolute(&path).unwrap();
    if let Start::File(file) = &mut scene.start {
        absolute(&mut file.path);
    }
    if let Motion::File(path) = &mut scene.motion {
        absolute(path);
    }
    scene
}

#[test]
fn every_example_loads_sets_up_and_survives_a_round_trip() {
    let mut count = 0;
    for entry in std::fs::read_dir(assets("scenes")).unwrap() {
        let path = entry.unwrap().path();
        let scene = Scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
        scene.setup().unwrap_or_else(|e| panic!("{e}"));
        // A number with seventeen digits, whose last digit an imprecise parser gets wrong.
        let scene = Scene { speed: 5.0 * 5f64.sqrt(), ..scene };
        let setup = scene.setup().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let saved = folder.path().join("saved.json");
        scene.save(&saved).unwrap();
        let again = Scene::load(&saved).unwrap();
        let expected = Scene { origin: again.origin.clone(), ..with_absolute_paths(scene) };
        assert_eq!(again, expected, "{}", path.display());
        assert_eq!(again.setup().unwrap(), setup, "{}", path.display());
        count += 1;
    }
    assert!(count >= 16);
}

/// A scene that was put together in the program may name files relative to where it runs.
#[test]
fn a_saved_scene_names_its_files_from_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let start = Start::parse("cloth.obj", "start", Path::new("data")).unwrap();
    let scene = Scene { start, motion: Motion::File("data/motion.npy".into()), ..Scene::default() };
    let saved = folder.path().join("saved.json");
    scene.save(&saved).unwrap();
    let again = Scene::load(&saved).unwrap();
    let Start::File(file) = &again.start else { panic!("{:?}", again.start) };
    let here = std::env::current_dir().unwrap();
    assert_eq!(file.path, here.join("data/cloth.obj"));
    assert_eq!(again.motion, Motion::File(here.join("data/motion.npy")));
}

#[test]
fn an_empty_document_and_the_default_file_are_the_default_scene() {
    let named = |s: Scene| Scene { origin: "scene".into(), ..s };
    assert_eq!(named(parse("{}").unwrap()), Scene::default());
    let file = named(Scene::load(assets("scenes/default.json")).unwrap());
    assert_eq!(file, Scene { frames: Some(391), ..Scene::default() });
    let setup = Scene::default().setup().unwrap();
    assert_eq!(setup.frames(), 391);
    assert_eq!(setup.model.cloths[0].handles, [31 * 32, 0]);
    assert!((setup.model.cloths[0].gravity[2] + 9.8 * 31.0 / 3600.0).abs() < 1e-15);
    assert!((setup.model.cloths[0].air.density - 1.0 / 31.0 / 0.187).abs() < 1e-15);
}

#[test]
fn self_contact_is_asked_for_with_or_without_numbers() {
    let scene = |text: &str| parse(text).unwrap();
    let of = |text: &str| scene(text).setup().unwrap().model.cloths[0].self_contact;
    assert_eq!(of("{}"), None);
    assert_eq!(of(r#"{"self_contact": false}"#), None);
    assert_eq!(of(r#"{"self_contact": true}"#), Some(SelfContact { thickness: 0.16, friction: 1.0 }));
    // Those of the cloth, of which layers take half an edge at most.
    let thick = of(r#"{"self_contact": true, "thickness_m": 0.5, "friction": 0.3}"#);
    assert_eq!(thick, Some(SelfContact { thickness: 0.5, friction: 0.3 }));
    let own =
        r#"{"self_contact": {"thickness_m": 0.01, "friction": 0.2}, "side_m": 3.1, "thickness_m": 0.5}"#;
    assert!((of(own).unwrap().thickness - 0.1).abs() < 1e-12);
    assert_eq!(of(own).unwrap().friction, 0.2);
    for text in ["{}", r#"{"self_contact": true}"#, own] {
        let scene = scene(text);
        assert_eq!(parse(&scene.to_json().to_string()).unwrap().self_contact, scene.self_contact);
    }
}

#[test]
fn repulsion_is_asked_for_with_or_without_numbers() {
    let of = |text: &str| parse(&format!("{{\"repulsion\": {text}}}")).unwrap().repulsion;
    assert_eq!([of("false"), of("null")], [None; 2]);
    assert_eq!([of("true"), of("{}")], [Some(RepulsionSettings::default()); 2]);
    let distance = RepulsionSettings { distance: 0.5, ..RepulsionSettings::default() };
    assert_eq!(of(r#"{"distance": 0.5}"#), Some(distance));
    assert_eq!(
        of(r#"{"strength": 0, "distance": 0.5}"#),
        Some(RepulsionSettings { strength: 0.0, ..distance })
    );
}

#[test]
fn the_authors_scenes_are_read() {
    let scene = Scene::load(assets("scenes/authors.json")).unwrap();
    assert_eq!((scene.grid, scene.up), (Grid { h: 12, w: 9 }, UpAxis::Z));
    assert_eq!((scene.frame_time_s, scene.side_m), (0.02, Side::Height(0.55)));
    let setup = scene.setup().unwrap();
    // Their handles are ordered from the last to the first.
    assert_eq!(setup.model.cloths[0].handles, [99, 0]);
    // z up, a quarter turn about +x: (x, y, z) -> (x, -z, y).
    assert!(distance(setup.vertices_m(&setup.start.x)[8], [0.4, 0.194454, 0.5]) < 1e-6);
    let gravity = setup.units.acceleration_m_s2(setup.model.cloths[0].gravity);
    assert!(distance(gravity, [0.0, 0.0, -9.76]) < 1e-12);
}

#[test]
fn variants_of_the_authors_scenes_are_read() {
    let read = |fields: &str| {
        parse(&format!("{{\"mesh_file\": \"../starts/tent_12x9.obj\", {fields}}}"))
            .unwrap_or_else(|e| panic!("{e}"))
    };
    // The faces determine which side is which. A matrix, a translation and a scalar gravity are accepted.
    let a = read(
        r#""mesh_resolution": [12, 9], "mesh_size": [0.55, 0.4], "gravity": -9.8, "transform": [0, 0, 1]"#,
    );
    let b = read(
        r#""mesh_resolution_h": 12, "mesh_resolution_w": 9, "mesh_size": 0.55, "handle_ind_list": [3],
           "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]], "gravity": 9.8"#,
    );
    for scene in [&a, &b] {
        assert_eq!((scene.grid, scene.side_m), (Grid { h: 12, w: 9 }, Side::Height(0.55)));
        assert_eq!(scene.gravity, [0.0, 0.0, -9.8]);
    }
    assert_eq!(a.setup().unwrap().start, b.setup().unwrap().start);
    assert_eq!(b.handles, Handles::Vertices(vec![3]));
    assert_eq!(a.handles, Handles::Placement(Placement::Corners));
}
