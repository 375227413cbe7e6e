//! `spectral_weight_adj` against its formula.

use crate::common::{ROUNDING, assert_close, context, device, largest, noise, read, run, sharings, tensor};
use fnopt::kernels::operator::SpectralWeightAdj;

#[test]
fn gradients_over_the_spectral_weights_match() {
    let _turn = device();
    let (modes_h, modes_w, inputs, outputs) = (7, 3, 32, 80);
    let modes = modes_h * modes_w;
    for samples in [1, 5] {
        let (x, adj) = (noise(samples * modes * inputs * 2, 53), noise(samples * modes * outputs * 2, 54));
        let before = noise(modes * inputs * outputs * 2, 55);
        let mut expected: Vec<f64> = before.iter().map(|&b| f64::from(b)).collect();
        for (index, sum) in expected.chunks_exact_mut(2).enumerate() {
            let (o, parity) = (index / 2 % outputs, index % 2);
            let (i, m) = (index / (2 * outputs) % (inputs / 2) * 2 + parity, index / (outputs * inputs));
            for s in 0..samples {
                let complex = |v: &[f32], at: usize| (f64::from(v[2 * at]), f64::from(v[2 * at + 1]));
                let (xr, xi) = complex(&x, (s * modes + m) * inputs + i);
                let (yr, yi) = complex(&adj, (s * modes + m) * outputs + o);
                sum[0] += xr * yr + xi * yi;
                sum[1] += xr * yi - xi * yr;
            }
        }
        let x = tensor("x", &[samples, modes_h, modes_w, inputs, 2], &x);
        let adj = tensor("adj", &[samples, modes_h, modes_w, outputs, 2], &adj);
        for tuning in sharings() {
            let kernel = SpectralWeightAdj::new(context(), &tuning).unwrap();
            let gradient = tensor("gradient", &[modes, inputs / 2, outputs, 4], &before);
            run(|schedule| kernel.push(schedule, &x, &adj, &gradient));
            let atol = 4.0 * ROUNDING * largest(&expected);
            assert_close(&format!("spectral weights {samples}"), &read(&gradient), &expected, (atol, 0.0));
        }
    }
}
