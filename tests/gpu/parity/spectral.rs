//! `spectral` against its formula.

use crate::common::{
    ROUNDING, assert_close, context, device, largest, noise, poisoned, read, run, sharings, tensor,
};
use fnopt::kernels::operator::{Spectral, spectral::by_mode};

#[test]
fn products_match_with_and_without_tiles_of_samples() {
    let _turn = device();
    let kernels = sharings().map(|tuning| Spectral::new(context(), &tuning).unwrap());
    let (modes_h, modes_w, inputs, outputs) = (8, 5, 48, 80);
    let modes = modes_h * modes_w;
    // Three samples and their multiples share one reading of the weights, other numbers do not.
    for samples in [1, 3, 4, 9] {
        let x = noise(samples * modes * inputs * 2, 51);
        let weight = noise(inputs * outputs * modes * 2, 52);
        let mut expected = vec![0.0; samples * modes * outputs * 2];
        for (index, y) in expected.chunks_exact_mut(2).enumerate() {
            let (o, m, s) = (index % outputs, index / outputs % modes, index / (outputs * modes));
            for i in 0..inputs {
                let complex = |v: &[f32], at: usize| (f64::from(v[2 * at]), f64::from(v[2 * at + 1]));
                let (xr, xi) = complex(&x, (s * modes + m) * inputs + i);
                let (wr, wi) = complex(&weight, (i * outputs + o) * modes + m);
                y[0] += xr * wr - xi * wi;
                y[1] += xr * wi + xi * wr;
            }
        }
        let weight = tensor("weight", &[modes, inputs, outputs, 2], &by_mode(&weight, inputs, outputs));
        let x = tensor("x", &[samples, modes_h, modes_w, inputs, 2], &x);
        for kernel in &kernels {
            let y = poisoned("y", &[samples, modes_h, modes_w, outputs, 2]);
            run(|schedule| kernel.push(schedule, &weight, &x, &y));
            // A rounding of each of the 96 products.
            let atol = 10.0 * ROUNDING * largest(&expected);
            assert_close(&format!("spectral {samples}"), &read(&y), &expected, (atol, 0.0));
        }
    }
}
