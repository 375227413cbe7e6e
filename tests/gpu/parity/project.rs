//! `project` against its formula.

use super::operator::{activations, dense, head};
use crate::common::{ROUNDING, assert_close, cases, context, device, largest, poisoned, read_unpadded, run};
use fnopt::kernels::operator::Project;
use fnopt::kernels::padded;

#[test]
fn fields_match() {
    let _turn = device();
    let kernel = Project::new(context()).unwrap();
    let (weight, bias, layer) = head(48);
    for (grid, batch) in cases() {
        let (x, x_tensor) = activations(batch, 48, grid, 0.5);
        let expected = dense(&weight, &[bias], &x, grid.particles());
        let field = poisoned("field", &[1, batch, grid.h, padded(grid.w)]);
        run(|schedule| kernel.push(schedule, &layer, &x_tensor, &field));
        let atol = 7.0 * ROUNDING * largest(&expected);
        let what = format!("project {batch} x {grid}");
        assert_close(&what, &read_unpadded(&field, grid), &expected, (atol, 0.0));
    }
}
