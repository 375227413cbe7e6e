//! `integrate` against the CPU path.

use super::cloth::{crumpled, field, iterate, model, targets, upload};
use crate::common::{ROUNDING, assert_close, cases, context, device, narrowed, read, run, widened};
use fnopt::cpu::cloth::{Frame, end_frame, trial_positions};
use fnopt::kernels::cloth::Integrate;

#[test]
fn frames_end_alike() {
    let _turn = device();
    let kernel = Integrate::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let [x, v, a] = [crumpled(&model, 0.3), field(&model, 0.5, 77), field(&model, 0.1, 78)];
        let (slots, n) = (model.handle_slots(), grid.particles());
        let handles: Vec<_> = targets(&model).iter().map(|p| p.map(f64::from)).collect();
        let [mut x_next, mut v_next, a_double] = [&x, &v, &a].map(|values| widened(values));
        let mut trial = vec![0.0; x.len()];
        for b in 0..batch {
            let at = 3 * n * b..3 * n * (b + 1);
            let frame = Frame { slots: &slots[n * b..][..n], handles: &handles, a: &a_double[at.clone()] };
            trial_positions(frame, &x_next[at.clone()], &v_next[at.clone()], &mut trial[at.clone()]);
            end_frame(frame, &mut x_next[at.clone()], &mut v_next[at]);
        }
        let iterate = iterate(&model);
        iterate.a.write(context(), &a);
        iterate.trial.write(context(), &narrowed(&trial));
        let [x, v] = [x, v].map(|values| upload("state", &model, &values));
        run(|schedule| kernel.push(schedule, &iterate, &x, &v));
        let what = format!("integrate {batch} x {grid}");
        assert_close(&what, &read(&x), &x_next, (0.0, ROUNDING));
        // The way of a handle is the difference of two positions, of which one was rounded.
        let atol = ROUNDING * grid.h.max(grid.w) as f64;
        assert_close(&what, &read(&v), &v_next, (atol, ROUNDING));
    }
}
