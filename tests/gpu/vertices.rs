//! The vertex buffer of a solver.

use crate::common::{assert_close, context, device};
use crate::solver::solver;
use fnopt::cloth::VertexView;
use fnopt::io::vertex_normals;
use fnopt::scene::{Scene, Setup, Side};
use fnopt::sim::Optimizer;

/// Vertices at a time between two frames are interpolated, so that a host can draw more often than it
/// simulates.
#[test]
fn vertices_follow_a_solver_between_its_frames() {
    let _turn = device();
    let setup = Scene::default().setup().unwrap();
    let grid = setup.model.grid;
    let solver = solver(&setup.model, &Optimizer::gradient_descent(), 2, &setup.start.cast());
    let vertices = solver.vertices().unwrap();
    solver.set_control(&setup.control(40));
    let before = solver.positions().read::<f32>(context()).unwrap();
    context().submit(|encoder| solver.record(encoder));
    let after = solver.positions().read::<f32>(context()).unwrap();
    for time in [0.0, 1.0 / 3.0, 1.0] {
        vertices.set_view(&VertexView { time, ..setup.vertex_view() });
        context().submit(|encoder| vertices.record(encoder));
        let between: Vec<f32> =
            before.iter().zip(&after).map(|(before, after)| before + time * (after - before)).collect();
        let positions = setup.vertices_m(&between);
        let single: Vec<_> = positions.iter().map(|p| p.map(|c| c as f32)).collect();
        let expected = single.iter().zip(vertex_normals(&single, &grid.faces()));
        let expected: Vec<f64> = expected.flat_map(|(p, n)| [*p, n]).flatten().map(f64::from).collect();
        // The expected normals come from positions in metres in single precision, which round edges of a few
        // hundredths of a metre.
        let found = vertices.tensor().read::<f32>(context()).unwrap();
        assert_close(&format!("time {time}"), &found, &expected, (3e-5, 0.0));
    }
}

/// Cloths of different sizes in one batch are all in metres, each in the view of its own scene.
#[test]
fn each_cloth_of_a_batch_has_its_own_view() {
    let _turn = device();
    let setups = [1.0, 2.5].map(|m| Scene { side_m: Side::Height(m), ..Scene::default() }.setup().unwrap());
    let batch = Setup::batch(&setups).unwrap();
    let solver = solver(&batch.model, &Optimizer::gradient_descent(), 1, &batch.start.cast());
    let vertices = solver.vertices().unwrap();
    vertices.set_view(&batch.vertex_view(0));
    vertices.set_cloth_view(1, &batch.vertex_view(1));
    context().submit(|encoder| vertices.record(encoder));
    let found = vertices.tensor().read::<f32>(context()).unwrap();
    let positions: Vec<f32> = found.chunks_exact(6).flat_map(|vertex| vertex[..3].to_vec()).collect();
    let expected = setups.iter().flat_map(|setup| setup.vertices_m(&setup.start.x));
    assert_close("metres", &positions, &expected.flatten().collect::<Vec<_>>(), (1e-6, 0.0));
}
