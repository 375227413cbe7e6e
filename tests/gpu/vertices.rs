//! The vertex buffer of a solver.

use crate::common::{assert_close, context, device, read};
use crate::solver::solver;
use fnopt::cloth::{Embedding, Grid, VertexView};
use fnopt::io::vertex_normals;
use fnopt::scene::{Scene, Setup, Side};
use fnopt::sim::Optimizer;

/// Returns the vertices of a cloth with these positions: positions in metres and normals, in turn.
fn interleaved(setup: &Setup, x: &[f32]) -> Vec<f64> {
    let points: Vec<_> = setup.vertices_m(x).into_iter().map(|p| p.map(|c| c as f32)).collect();
    let normals = vertex_normals(&points, &setup.model.grid.faces());
    points.into_iter().zip(normals).flat_map(|(p, n)| [p, n]).flatten().map(f64::from).collect()
}

/// Positions at a time within the frame that led from `before` to `after`.
fn between(before: &[f32], after: &[f32], time: f32) -> Vec<f32> {
    before.iter().zip(after).map(|(before, after)| before + time * (after - before)).collect()
}

/// The expected normals come from positions in metres in single precision, which round edges of a few
/// hundredths of a metre.
const TOLERANCE: (f64, f64) = (3e-5, 0.0);

/// Vertices at a time between two frames are interpolated, so that a host can draw more often than it
/// simulates.
#[test]
fn vertices_follow_a_solver_between_its_frames() {
    let _turn = device();
    let setup = Scene::released().setup().unwrap();
    let solver = solver(&setup.model, &Optimizer::gradient_descent(), 2, &setup.start.cast());
    let vertices = solver.vertices().unwrap();
    solver.set_control(&setup.control(40));
    let before: Vec<f32> = read(solver.positions());
    context().submit(|encoder| solver.record(encoder));
    let after: Vec<f32> = read(solver.positions());
    for time in [0.0, 1.0 / 3.0, 1.0] {
        vertices.set_view(&VertexView { time, ..setup.vertex_view() });
        context().submit(|encoder| vertices.record(encoder));
        let expected = interleaved(&setup, &between(&before, &after, time));
        assert_close(&format!("time {time}"), &read(vertices.tensor()), &expected, TOLERANCE);
    }
}

/// Cloths of different sizes in one batch are all in metres, each in the view of its own scene, at one time.
#[test]
fn each_cloth_of_a_batch_has_its_own_view() {
    let _turn = device();
    let setups = [1.0, 2.5].map(|m| Scene { side_m: Side::Height(m), ..Scene::default() }.setup().unwrap());
    let batch = Setup::batch(&setups).unwrap();
    let solver = solver(&batch.model, &Optimizer::gradient_descent(), 2, &batch.start.cast());
    let vertices = solver.vertices().unwrap();
    vertices.set_view(&batch.vertex_view(0));
    vertices.set_cloth_view(1, &batch.vertex_view(1));
    solver.set_control(&batch.control(40));
    let before: Vec<f32> = read(solver.positions());
    context().submit(|encoder| solver.record(encoder));
    let after: Vec<f32> = read(solver.positions());
    for time in [1.0, 0.25] {
        vertices.set_time(time);
        context().submit(|encoder| vertices.record(encoder));
        let x = between(&before, &after, time);
        let cloths = setups.iter().zip(x.chunks_exact(x.len() / 2));
        let expected: Vec<f64> = cloths.flat_map(|(setup, x)| interleaved(setup, x)).collect();
        assert_close(&format!("time {time}"), &read(vertices.tensor()), &expected, TOLERANCE);
    }
}

/// Cloths in one batch carry the same mesh, where the files have it.
#[test]
fn a_mesh_is_carried_by_each_cloth_of_a_batch() {
    let _turn = device();
    let setups = [1.0, 2.5].map(|m| Scene { side_m: Side::Height(m), ..Scene::default() }.setup().unwrap());
    let batch = Setup::batch(&setups).unwrap();
    let grid = batch.model.grid;
    let solver = solver(&batch.model, &Optimizer::gradient_descent(), 2, &batch.start.cast());
    let uv: Vec<[f32; 2]> = (0..700).map(|k| [0.618 * k as f32 % 1.0, 0.755 * k as f32 % 1.0]).collect();
    let embedding = Embedding::new(grid, None, &uv, "a test").unwrap();
    let vertices = solver.embedded_vertices(&embedding).unwrap();
    assert_eq!(vertices.tensor().shape(), [2, 700, 6]);
    vertices.set_view(&batch.vertex_view(0));
    vertices.set_cloth_view(1, &batch.vertex_view(1));
    solver.set_control(&batch.control(40));
    context().submit(|encoder| solver.record(encoder));
    context().submit(|encoder| vertices.record(encoder));
    let (x, found): (Vec<f32>, Vec<f32>) = (read(solver.positions()), read(vertices.tensor()));
    for (b, found) in found.chunks_exact(700 * 6).enumerate() {
        let expected = embedding.positions(&batch.vertices_m(b, &x));
        let positions: Vec<f32> = found.chunks_exact(6).flat_map(|vertex| vertex[..3].to_vec()).collect();
        assert_close(&format!("cloth {b}"), &positions, expected.as_flattened(), TOLERANCE);
        for vertex in found.chunks_exact(6) {
            let length = vertex[3..].iter().map(|c| c * c).sum::<f32>().sqrt();
            assert!((length - 1.0).abs() < 1e-5, "{vertex:?}");
        }
    }
    let other = Embedding::new(Grid { h: 9, w: 9 }, None, &uv, "a test").unwrap();
    let error = solver.embedded_vertices(&other).unwrap_err().to_string();
    assert!(error.contains("embedding: grid: expected 32x32, found 9x9"), "{error}");
    let none = Embedding::new(grid, None, &[], "a test").unwrap();
    assert!(solver.embedded_vertices(&none).unwrap_err().to_string().contains("at least one, found 0"));
}
