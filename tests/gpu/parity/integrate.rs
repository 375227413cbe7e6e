//! `integrate` against the CPU path.

use super::cloth::{crumpled, field, iterate, model, shift, targets, upload};
use crate::common::{ROUNDING, assert_close, cases, context, device, read, run, tensor, widened};
use fnopt::cpu::cloth::{Frame, end_frame};
use fnopt::kernels::cloth::{Integrate, StateTensors};

#[test]
fn frames_end_alike() {
    let _turn = device();
    let kernel = Integrate::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let [x, v] = [crumpled(&model, 0.3), field(&model, 0.5, 77)];
        let [base, a] = [78, 79].map(|seed| field(&model, 0.5, seed));
        let moved = shift(&model, &base, &a);
        let (marks, targets, n) = (model.marks(), targets(&model), grid.particles());
        let handles: Vec<_> = targets.iter().map(|p| p.map(f64::from)).collect();
        let [mut x_next, mut v_next] = [&x, &v].map(|values| widened(values));
        for b in 0..batch {
            let at = 3 * n * b..3 * n * (b + 1);
            let shift = &moved[at.clone()];
            let frame = Frame { marks: &marks[n * b..][..n], handles: &handles, a: &[] };
            end_frame(frame, shift, &mut x_next[at.clone()], &mut v_next[at]);
        }
        let iterate = iterate(&model);
        iterate.base.write(context(), &base);
        iterate.a.write(context(), &a);
        let [x, v] = [x, v].map(|values| upload("state", &model, &values));
        let targets = tensor("targets", &[model.handles(), 3], targets.as_flattened());
        run(|schedule| kernel.push(schedule, StateTensors { x: &x, v: &v, targets: &targets }, &iterate));
        let what = format!("integrate {batch} x {grid}");
        // The displacement, of up to 1, is rounded before it is added.
        assert_close(&what, &read(&x), &x_next, (ROUNDING, ROUNDING));
        // The velocity is the displacement in the trial.
        assert_close(&what, &read(&v), &moved, (0.0, ROUNDING));
    }
}
