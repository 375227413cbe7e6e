//! `predict` against its formula.

use super::cloth::{crumpled, field, iterate, model, targets, upload};
use crate::common::{ROUNDING, assert_close, cases, context, device, read, run, tensor};
use fnopt::cloth::Role;
use fnopt::kernels::cloth::{Predict, StateTensors};

#[test]
fn frames_start_where_velocity_and_handles_lead() {
    let _turn = device();
    let kernel = Predict::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let (x, v, targets) = (crumpled(&model, 0.3), field(&model, 0.5, 77), targets(&model));
        let (marks, n) = (model.marks(), grid.particles());
        let start = |at: usize| match marks[at / (3 * n) * n + at % n].role() {
            Role::Free => f64::from(v[at]),
            Role::Handle(k) => f64::from(targets[k][at / n % 3]) - f64::from(x[at]),
            Role::Outside => 0.0,
        };
        let expected: Vec<f64> = (0..x.len()).map(start).collect();
        let iterate = iterate(&model);
        let [x, v] = [x, v].map(|values| upload("input", &model, &values));
        let targets = tensor("targets", &[model.handles(), 3], targets.as_flattened());
        run(|schedule| kernel.push(schedule, StateTensors { x: &x, v: &v, targets: &targets }, &iterate));
        let base = read(&iterate.base);
        assert_close(&format!("predict {batch} x {grid}"), &base, &expected, (0.0, ROUNDING));
        assert!(read(&iterate.a).iter().all(|&a| a == 0.0));
    }
}

/// Kernels run without bounds checks, so they bound slots themselves.
#[test]
fn slots_beyond_the_targets_are_those_of_the_last() {
    let _turn = device();
    let kernel = Predict::new(context()).unwrap();
    let (grid, batch) = cases().next().unwrap();
    let model = model(grid, batch);
    let iterate = iterate(&model);
    iterate.marks.write(context(), &vec![u32::MAX - 1; 2 * batch * grid.particles()]);
    let [x, v] = [0.0, 1.0].map(|value| upload("input", &model, &vec![value; 3 * batch * grid.particles()]));
    let targets = tensor("targets", &[4, 3], &[[0.0; 3], [0.0; 3], [0.0; 3], [5.0, 6.0, 7.0]].concat());
    run(|schedule| kernel.push(schedule, StateTensors { x: &x, v: &v, targets: &targets }, &iterate));
    let shifts = read(&iterate.base);
    let components = shifts.chunks_exact(grid.particles()).enumerate();
    assert!(
        components
            .flat_map(|(c, shifts)| shifts.iter().map(move |s| (c, s)))
            .all(|(c, &s)| s == 5.0 + (c % 3) as f32)
    );
}
