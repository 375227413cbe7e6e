//! Bodies of a scene: their conversion to grid units, their motion, and starts inside them.

use crate::common::{distance, parse};
use fnopt::cloth::{Control, Pose, Shape};
use fnopt::scene::Scene;
use glam::DVec3;

fn pose_m(pose: &Pose, edge_m: f64) -> [f64; 3] {
    // y up again.
    let [x, y, z] = pose.position.map(|c| c * edge_m);
    [x, z, -y]
}

#[test]
fn bodies_are_converted_to_grid_units() {
    let text = r#"{
        "grid": [11, 11], "start": "flat", "handles": [], "motion": "none", "frames": 3, "friction": 0.4,
        "bodies": [
            {"shape": "sphere", "radius_m": 0.2, "position_m": [0.5, -0.3, 0.1], "friction": 0.7},
            {"shape": "box", "sides_m": [0.4, 0.6, 0.8], "position_m": [0, -2, 0], "thickness_m": 0.01},
            {"shape": "capsule", "radius_m": 0.1, "length_m": 0.5, "axis": [0, 0, 2], "position_m": [0, -2, 0]},
            {"shape": "plane", "position_m": [0, -1, 0], "normal": [0, 3, 0]}
        ]
    }"#;
    let scene = parse(text).unwrap();
    let setup = scene.setup().unwrap();
    let bodies = &setup.model.cloths[0].bodies;
    assert!(matches!(bodies[0].shape, Shape::Sphere { radius } if (radius - 2.0).abs() < 1e-12));
    assert!(distance(pose_m(&bodies[0].pose, 0.1), [0.5, -0.3, 0.1]) < 1e-12);
    assert_eq!([bodies[0].friction, bodies[1].friction], [0.4, 0.3]);
    let Shape::Box { half } = bodies[1].shape else { panic!("{:?}", bodies[1]) };
    assert!(distance(half, [2.0, 4.0, 3.0]) < 1e-12, "{half:?}");
    let thickness = |k: usize| bodies[k].thickness;
    assert!((thickness(1) - 0.26).abs() < 1e-12 && (thickness(3) - 0.16).abs() < 1e-12);
    // A capsule of one edge: its edges clear it.
    assert!((thickness(2) - 0.16).abs() < 1e-12 && (thickness(0) - 0.16).abs() < 1e-12);
    // z of the scene is -y inside.
    let axis = bodies[2].pose.turned(DVec3::Z);
    assert!((axis + DVec3::Y).length() < 1e-12, "{axis}");
    assert!((bodies[3].pose.turned(DVec3::Z) - DVec3::Z).length() < 1e-12);
    assert!(setup.control::<f64>(1).bodies.is_empty(), "nothing moves");
    let again = Scene::parse(&scene.to_json().to_string(), "again", std::path::Path::new("")).unwrap();
    let again = again.setup().unwrap();
    for (one, other) in bodies.iter().zip(&again.model.cloths[0].bodies) {
        assert_eq!(one.shape, other.shape);
        assert!(distance(one.pose.position, other.pose.position) < 1e-12);
        let turned = |pose: &Pose| pose.turned(DVec3::new(1.0, 2.0, 3.0));
        assert!((turned(&one.pose) - turned(&other.pose)).length() < 1e-12);
    }
}

#[test]
fn bodies_move_through_keys_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let poses = ndarray::arr2(&[[0.0, -1.0, 0.0], [0.0, -1.5, 0.0]]);
    ndarray_npy::write_npy(folder.path().join("poses.npy"), &poses).unwrap();
    let text = r#"{
        "grid": [11, 11], "start": "flat", "handles": [], "motion": "none", "frames": 121, "up": "z",
        "bodies": [
            {"shape": "sphere", "radius_m": 0.1, "position_m": [0, 0, -1], "motion": [
                {"time_s": 0.5}, {"time_s": 1.5, "position_m": [1, 0, -1], "rotation": [90, 0, 0, 1]}]},
            {"shape": "sphere", "radius_m": 0.1, "motion": "poses.npy"}
        ]
    }"#;
    let setup = Scene::parse(text, "scene.json", folder.path()).unwrap().setup().unwrap();
    let place = |frame: usize, k: usize| {
        let control: Control<f64> = setup.control(frame);
        [control.bodies[k].from, control.bodies[k].to].map(|pose| pose.position.map(|c| 0.1 * c))
    };
    // Frame 60 is at 1 s, halfway.
    assert!(
        distance(place(60, 0)[1], [0.5, 0.0, -1.0]) < 1e-9
            && distance(place(60, 0)[0], place(59, 0)[1]) < 1e-12
    );
    assert_eq!([place(10, 0)[0], place(120, 0)[1]], [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0]]);
    let turned = setup.control::<f64>(60).bodies[0].to.turned(DVec3::X);
    assert!((turned - DVec3::new(1.0, 1.0, 0.0).normalize()).length() < 1e-9, "{turned}");
    assert!(
        distance(place(1, 1)[0], [0.0, -1.0, 0.0]) < 1e-12
            && distance(place(100, 1)[0], [0.0, -1.5, 0.0]) < 1e-12
    );
}

#[test]
fn a_start_inside_a_body_is_moved_out() {
    let text = r#"{"grid": [16, 16], "start": "flat", "handles": [], "motion": "none", "frames": 2,
        "bodies": [{"shape": "sphere", "radius_m": 0.3, "position_m": [0.5, -0.1, 0]}]}"#;
    let setup = parse(text).unwrap().setup().unwrap();
    let body = setup.model.cloths[0].bodies[0];
    let n = setup.model.grid.particles();
    let x = &setup.start.x;
    let gaps: Vec<f64> = (0..n)
        .map(|p| body.shape.distance(body.pose.inward(DVec3::new(x[p], x[n + p], x[2 * n + p]))).distance)
        .collect();
    assert!(gaps.iter().all(|gap| *gap > body.thickness - 1e-9));
    assert!(gaps.iter().filter(|gap| **gap < body.thickness + 1e-9).count() > 20);
}
