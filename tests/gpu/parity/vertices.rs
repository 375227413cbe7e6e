//! `vertices` against the CPU path.

use super::cloth::{crumpled, field, marks, model, upload};
use crate::common::{assert_close, cases, context, device, poisoned, read, run, tensor, widened};
use fnopt::cloth::VertexView;
use fnopt::cpu;
use fnopt::kernels::cloth::Vertices;

/// Returns the view of a cloth: a rotation, a scale, a shift, and a time between two frames, which is 0.3 for
/// the last cloth of the batch.
fn view(b: usize, batch: usize) -> VertexView {
    let (scale, before) = ([1.0, -0.7, 0.4][b], (batch - 1 - b) as f32);
    let transform = [[0.06, 0.0, 0.08, 0.5], [0.0, 0.1, 0.0, -2.0], [-0.08, 0.0, 0.06, 1.0]]
        .map(|row: [f32; 4]| row.map(|v| scale * v));
    VertexView { transform, time: 0.3 + 0.35 * before }
}

#[test]
fn vertices_match() {
    let _turn = device();
    let kernel = Vertices::new(context()).unwrap();
    for (grid, batch) in cases() {
        let (model, n) = (model(grid, batch), grid.particles());
        let (mut x, v) = (crumpled(&model, 0.3), field(&model, 0.5, 80));
        // Moved back by 0.7 v, the triangles around the first particle of the last cloth are degenerate.
        let first = 3 * n * (batch - 1);
        for p in [0, 1, grid.w, grid.w + 1] {
            (0..3).for_each(|c| x[first + c * n + p] = 0.7 * v[first + c * n + p]);
        }
        let cloths = x.chunks_exact(3 * n).zip(v.chunks_exact(3 * n));
        let expected: Vec<f64> = cloths
            .enumerate()
            .flat_map(|(b, (x, v))| {
                let faces = model.cloths[b].faces(grid);
                cpu::cloth::vertices(&faces, &view(b, batch), &widened(x), &widened(v))
            })
            .flatten()
            .collect();
        let rows: Vec<_> = (0..batch).flat_map(|b| view(b, batch).to_rows()).collect();
        let view = tensor("view", &[batch, 4, 4], rows.as_flattened());
        let interleaved = poisoned("vertices", &[batch, n, 6]);
        let [x, v] = [x, v].map(|values| upload("state", &model, &values));
        let marks = marks(&model);
        run(|schedule| kernel.push(schedule, grid, (&marks, &view, &x, &v), &interleaved));
        let what = format!("vertices {batch} x {grid}");
        let (found, normal) = (read(&interleaved), 6 * n * (batch - 1) + 3);
        assert!(
            found[normal..normal + 3].iter().all(|c| c.abs() <= 1.0),
            "{what}: {:?}",
            &found[normal..normal + 3]
        );
        // Around that particle there is nothing but rounding, so its normal may point anywhere.
        let but_one = |k: usize| (normal..normal + 3).contains(&k);
        let (found, expected): (Vec<f32>, Vec<f64>) = found
            .into_iter()
            .zip(expected)
            .enumerate()
            .filter(|(k, _)| !but_one(*k))
            .map(|(_, pair)| pair)
            .unzip();
        // Edges, of length about 1, are accurate to a few roundings. A normal is accurate to as much over the
        // length of the sum that it is normalised from, which is at least a few hundredths here.
        assert_close(&what, &found, &expected, (2e-5, 1e-6));
    }
}

#[test]
fn a_sheet_without_an_extent_has_no_normals() {
    let _turn = device();
    let kernel = Vertices::new(context()).unwrap();
    let (grid, batch) = cases().next().unwrap();
    let model = model(grid, batch);
    let rows = VertexView::default().to_rows().repeat(batch);
    let view = tensor("view", &[batch, 4, 4], rows.as_flattened());
    let interleaved = poisoned("vertices", &[batch, grid.particles(), 6]);
    let [x, v] = [3.0, 0.0].map(|value| upload("state", &model, &vec![value; 3 * batch * grid.particles()]));
    let marks = marks(&model);
    run(|schedule| kernel.push(schedule, grid, (&marks, &view, &x, &v), &interleaved));
    for vertex in read(&interleaved).chunks_exact(6) {
        assert_eq!(vertex, [3.0, 3.0, 3.0, 0.0, 0.0, 0.0]);
    }
}
