//! `external_force` against the CPU path.

use super::cloth::{WIND, constants, crumpled, field, marks, model, poisoned_field, upload};
use crate::common::{ROUNDING, assert_close, cases, context, device, largest, read, run, tensor, widened};
use fnopt::cloth::Model;
use fnopt::cpu::cloth::add_wind;
use fnopt::kernels::cloth::{ExternalForce, ExternalForceTensors};

fn expected(model: &Model, x: &[f32], v: &[f32], control: &[f32]) -> Vec<f64> {
    let n = model.grid.particles();
    let (x, v, mut f) = (widened(x), widened(v), widened(control));
    for (b, f) in f.chunks_exact_mut(3 * n).enumerate() {
        for (f, g) in f.chunks_exact_mut(n).zip(model.cloths[b].gravity) {
            f.iter_mut().for_each(|f| *f += g);
        }
        let at = 3 * n * b..3 * n * (b + 1);
        let marks = &model.marks()[n * b..n * (b + 1)];
        add_wind(
            (model.grid, marks),
            model.cloths[b].air,
            WIND[b].map(f64::from),
            (&x[at.clone()], &v[at]),
            f,
        );
    }
    f
}

#[test]
fn gravity_forces_and_air_match() {
    let _turn = device();
    let kernel = ExternalForce::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let (x, v, control) = (crumpled(&model, 0.3), field(&model, 0.5, 75), field(&model, 0.1, 76));
        let expected = expected(&model, &x, &v, &control);
        let [x, v, control] = [x, v, control].map(|values| upload("input", &model, &values));
        let (cloths, marks, external) = (constants(&model), marks(&model), poisoned_field(&model));
        let wind = tensor("wind", &[batch, 3], WIND[..batch].as_flattened());
        let tensors = ExternalForceTensors {
            cloths: &cloths,
            marks: &marks,
            wind: &wind,
            x: &x,
            v: &v,
            control_accelerations: &control,
        };
        run(|schedule| kernel.push(schedule, grid, tensors, &external));
        // The roundings of differences of positions, two products and four cells.
        let atol = 16.0 * ROUNDING * largest(&expected);
        assert_close(&format!("external_force {batch} x {grid}"), &read(&external), &expected, (atol, 0.0));
    }
}

/// Cells without area have no normal and feel no air.
#[test]
fn air_ignores_cells_without_area() {
    let _turn = device();
    let kernel = ExternalForce::new(context()).unwrap();
    let (grid, _) = cases().next().unwrap();
    let model = model(grid, 1);
    let x = vec![1.0; 3 * grid.particles()];
    let (v, control) = (field(&model, 0.5, 75), vec![0.0; x.len()]);
    let expected = expected(&model, &x, &v, &control);
    let [x, v, control] = [x, v, control].map(|values| upload("input", &model, &values));
    let (cloths, marks, external) = (constants(&model), marks(&model), poisoned_field(&model));
    let wind = tensor("wind", &[1, 3], &WIND[0]);
    let tensors = ExternalForceTensors {
        cloths: &cloths,
        marks: &marks,
        wind: &wind,
        x: &x,
        v: &v,
        control_accelerations: &control,
    };
    run(|schedule| kernel.push(schedule, grid, tensors, &external));
    assert_close("external_force collapsed", &read(&external), &expected, (0.0, ROUNDING));
}
