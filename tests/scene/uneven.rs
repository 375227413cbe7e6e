//! Cloths that differ between their axes and from place to place, as scenes describe them.

use crate::common::{expect_refusal, parse};
use fnopt::cloth::Weave;
use fnopt::render::{Image, write_png};
use fnopt::scene::{MapFile, Scene, Stiffness};
use std::path::Path;

/// Returns the scene that the document of this one makes.
fn again(scene: &Scene) -> Scene {
    Scene::parse(&scene.to_json().to_string(), &scene.origin, Path::new("")).unwrap()
}

#[test]
fn materials_have_a_warp_and_a_weft() {
    let grid = parse(r#"{"material": {"stretch": [1500, 500], "bend": [0.1, 0.4]}}"#).unwrap();
    let Stiffness::Grid(of_grid) = grid.stiffness else { panic!("{:?}", grid.stiffness) };
    assert_eq!((of_grid.stretch, of_grid.shear, of_grid.bend), (1000.0, 8.0, 0.25));
    assert_eq!((of_grid.stretches(), of_grid.bends()), ([1500.0, 500.0], [0.1, 0.4]));
    let moduli =
        r#"{"material": {"stretch_modulus": [30, 70], "shear_modulus": 5, "bending_stiffness": 1e-5}}"#;
    let of_moduli = parse(moduli).unwrap();
    let Stiffness::Moduli(si) = of_moduli.stiffness else { panic!("{:?}", of_moduli.stiffness) };
    assert_eq!((si.stretch_modulus, si.weave), (50.0, Weave { stretch: [0.6, 1.4], bend: [1.0; 2] }));
    for scene in [grid, of_moduli] {
        assert_eq!(again(&scene), scene);
        let material = scene.setup().unwrap().model.cloths[0].material;
        assert!(!material.weave.is_even());
    }
    let even = parse(r#"{"material": {"stretch": [700, 700]}}"#).unwrap();
    assert!(even.setup().unwrap().model.cloths[0].material.weave.is_even());
}

#[test]
fn damping_is_a_time() {
    let scene = parse(r#"{"damping_s": 0.02, "frame_time_s": 0.01}"#).unwrap();
    assert_eq!(scene.setup().unwrap().model.cloths[0].damping, 2.0);
    assert_eq!(again(&scene), scene);
}

#[test]
fn maps_are_read_from_arrays_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let array = ndarray::array![[1.0, 3.0], [2.0, 4.0]];
    ndarray_npy::write_npy(folder.path().join("density.npy"), &array).unwrap();
    // Bright to the left.
    let picture = Image { width: 16, height: 8, pixels: [[[255; 3]; 8], [[0; 3]; 8]].concat().repeat(8) };
    write_png(folder.path().join("seams.png"), &picture).unwrap();
    let text = r#"{"grid": [9, 17], "handles": [], "motion": "none",
        "maps": {"density": "density.npy", "stiffness": {"file": "seams.png", "range": [0.5, 2]}}}"#;
    let scene = Scene::parse(text, "a test", folder.path()).unwrap();
    assert_eq!(again(&scene), scene);
    assert_eq!(scene.files().count(), 2);
    let setup = scene.setup().unwrap();
    let cloth = &setup.model.cloths[0];
    let (density, stiffness) = (cloth.density.as_ref().unwrap(), cloth.stiffness.as_ref().unwrap());
    let at = |i: usize, j: usize| i * 17 + j;
    for (p, expected) in
        [(at(0, 0), 1.0), (at(0, 16), 3.0), (at(8, 0), 2.0), (at(8, 16), 4.0), (at(4, 8), 2.5)]
    {
        assert_eq!(density.at(p), expected);
    }
    // u, from the left, is 1 - i / (H - 1).
    for j in 0..17 {
        assert_eq!((stiffness.at(at(8, j)), stiffness.at(at(0, j))), (2.0, 0.5));
    }
    // The sheet is heavier by the mean of the factors, and falls no faster.
    let mass: f64 = setup.model.marks().iter().map(|mark| mark.mass()).sum();
    assert!((mass / (8.0 * 16.0) - 2.5).abs() < 1e-3, "{mass}");
}

#[test]
fn wrong_maps_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    ndarray_npy::write_npy(folder.path().join("zero.npy"), &ndarray::array![[1.0, 0.0]]).unwrap();
    ndarray_npy::write_npy(folder.path().join("row.npy"), &ndarray::array![1.0, 2.0]).unwrap();
    let refused = |maps: &str| {
        let text = format!(r#"{{"grid": [8, 8], "maps": {maps}}}"#);
        let scene = Scene::parse(&text, "a test", folder.path());
        scene.and_then(|scene| scene.setup()).map(|_| ()).expect_err(maps).to_string()
    };
    for (maps, parts) in [
        (r#"{"density": "zero.npy"}"#, ["maps.density", "0.001 to 1000"]),
        (r#"{"density": "row.npy"}"#, ["row.npy", "[H, W]"]),
        (r#"{"density": "none.npy"}"#, ["none.npy", "cannot"]),
        (r#"{"density": "map.jpg"}"#, ["map.jpg", ".png or .npy"]),
        (r#"{"densty": "zero.npy"}"#, ["densty", "density"]),
        (r#"{"stiffness": "seams.png"}"#, ["maps.stiffness", "range"]),
        (r#"{"stiffness": {"file": "seams.png", "range": [0, 1]}}"#, ["maps.stiffness.range", "0.001"]),
        (r#"{"stiffness": {"file": "zero.npy", "range": [1, 2]}}"#, ["maps.stiffness", "no \"range\""]),
        (r#"{"stiffness": 3}"#, ["maps.stiffness", ".npy"]),
    ] {
        let error = refused(maps);
        assert!(parts.iter().all(|part| error.contains(part)), "{maps}: {error}");
    }
    let settled = Scene {
        maps: fnopt::scene::MapSettings {
            density: Some(MapFile { path: folder.path().join("ones.npy"), range: None }),
            stiffness: None,
        },
        ..Scene::default()
    };
    ndarray_npy::write_npy(folder.path().join("ones.npy"), &ndarray::array![[1.0, 1.0]]).unwrap();
    assert!(settled.setup().unwrap_err().to_string().contains("no settled drape"));
}

#[test]
fn rest_shapes_are_creases_pleats_and_curls() {
    let text = r#"{"grid": [21, 11], "side_m": 2, "rest_shape": {"curvature_per_m": [0, 3], "pleats": {"count": 4, "angle": 50},
        "creases": [{"u": 0.25, "angle": 90}, {"v": 0.999, "angle": -60}]}}"#;
    let scene = parse(text).unwrap();
    assert_eq!((again(&scene), scene.start.clone()), (scene.clone(), fnopt::scene::Start::Flat));
    let setup = scene.setup().unwrap();
    let angles = setup.model.cloths[0].rest_angles.as_ref().unwrap();
    for i in 0..21 {
        // u grows against i; pleats are at 1/8, 3/8, 5/8 and 7/8.
        let [pleat, crease] = match i {
            18 | 8 => [50.0, 0.0],
            13 | 3 => [-50.0, 0.0],
            15 => [0.0, 90.0],
            _ => [0.0; 2],
        };
        for j in 0..11 {
            let [along, across] = angles.at(i * 11 + j).map(f64::from);
            assert!((along - f64::to_radians(pleat + crease)).abs() < 1e-6, "({i}, {j}): {along}");
            // The edge has a length of 0.1 m, and a crease keeps off the border.
            let wanted = 0.3 + if j == 1 { f64::to_radians(-60.0) } else { 0.0 };
            assert!((across - wanted).abs() < 1e-6, "({i}, {j}): {across}, not {wanted}");
        }
    }
    assert!(!parse("{}").unwrap().setup().unwrap().model.has_rest_angles());
    let settled = Scene { start: fnopt::scene::Start::Settled, ..scene };
    assert!(settled.setup().unwrap_err().to_string().contains("a rest shape has no settled drape"));
}

#[test]
fn wrong_rest_shapes_are_refused() {
    let refused =
        |shape: &str, parts: &[&str]| expect_refusal(&format!(r#"{{"rest_shape": {shape}}}"#), parts);
    refused(r#"{"creases": [{"u": 0.5, "angle": 180}]}"#, &["creases[0].angle", "-180 and 180"]);
    refused(r#"{"creases": [{"u": 0.5, "v": 0.5, "angle": 10}]}"#, &["creases[0]", "either"]);
    refused(r#"{"creases": [{"angle": 10}]}"#, &["creases[0]", "either"]);
    refused(r#"{"creases": [{"u": 0.5}]}"#, &["creases[0]", "angle"]);
    refused(r#"{"creases": [{"x": 0.5, "angle": 10}]}"#, &["unknown field 'x'", "u"]);
    refused(r#"{"pleats": {"angle": 10}}"#, &["pleats", "count"]);
    refused(r#"{"pleats": {"count": 0, "angle": 10}}"#, &["pleats.count", "1 to 1000"]);
    refused(r#"{"pleats": {"count": 1e9, "angle": 10}}"#, &["pleats.count", "1 to 1000"]);
    refused(r#"{"pleats": {"count": 4, "angle": 10, "along": "w"}}"#, &["pleats.along", "\"u\" or \"v\""]);
    refused(r#"{"curvature_per_m": 3}"#, &["curvature_per_m", "two curvatures"]);
    refused(r#"{"crease": []}"#, &["unknown field 'crease'", "creases"]);
    expect_refusal(r#"{"pleats": {"count": 4}}"#, &["pleats", "rest_shape"]);
    // What depends on the grid.
    let refused = |shape: &str| {
        let scene = parse(&format!(r#"{{"rest_shape": {shape}}}"#)).unwrap();
        scene.setup().map(|_| ()).expect_err(shape).to_string()
    };
    for (shape, parts) in [
        (r#"{"creases": [{"v": 0, "angle": 10}]}"#, ["rest_shape.creases[0].v", "between 0 and 1"]),
        (r#"{"creases": [{"u": 2, "angle": 10}]}"#, ["rest_shape.creases[0].u", "between 0 and 1"]),
        (r#"{"curvature_per_m": [0, 1000]}"#, ["rest_shape", "-180 and 180"]),
        (
            r#"{"creases": [{"u": 0.5, "angle": 100}, {"u": 0.5, "angle": 100}]}"#,
            ["rest_shape", "-180 and 180"],
        ),
    ] {
        let error = refused(shape);
        assert!(parts.iter().all(|part| error.contains(part)), "{shape}: {error}");
    }
}

#[test]
fn wrong_weaves_are_refused() {
    expect_refusal(r#"{"material": {"stretch": [1, 2, 3]}}"#, &["material.stretch", "along the height"]);
    expect_refusal(r#"{"material": {"bend": [1, -1]}}"#, &["material.bend", "0 or more"]);
    expect_refusal(
        r#"{"material": {"stretch": [1, 2], "weave": {"bend": [1, 1]}}}"#,
        &["material.weave", "none beside"],
    );
    expect_refusal(r#"{"material": {"shear": [1, 2]}}"#, &["material.shear", "a number"]);
    expect_refusal(r#"{"damping_s": -1}"#, &["damping_s", "0 or more"]);
    expect_refusal(r#"{"damping": 0.1}"#, &["unknown field 'damping'", "damping_s"]);
}
