//! `update_adj` against the authors' rule in double precision.

use crate::common::{
    ROUNDING, assert_close, cases, context, device, noise, pad, poisoned, read, run, tensor,
};
use fnopt::kernels::optim::{UpdateAdj, UpdateAdjTensors};
use fnopt::kernels::padded;
use fnopt::settings::Normalisation;

#[test]
fn normalised_cotangents_match() {
    let _turn = device();
    matches(Normalisation::Component);
    matches(Normalisation::Cloth);
}

fn matches(normalisation: Normalisation) {
    let kernel = UpdateAdj::new(context(), normalisation).unwrap();
    for (grid, batch) in cases() {
        let (samples, n) = (3 * batch, grid.particles());
        let field: Vec<f32> = noise(samples * n, 121).iter().map(|v| 3.0 * v).collect();
        let scalar = noise(samples, 122);
        let scale: Vec<f32> = (0..samples).map(|s| 0.05 * (s + 1) as f32).collect();
        let mut grad = noise(samples * n, 123);
        // Sample 1 has all its gradient at one particle; sample 2 is in equilibrium.
        grad[n..2 * n].fill(0.0);
        grad[n + n / 2] = -7.0;
        grad[2 * n..3 * n].fill(0.0);
        let share = 0.25;
        let row = |v: &[f32], s: usize| v[s * n..][..n].iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
        let tanh = |s: usize| row(&field, s).iter().map(|f| f.tanh()).collect::<Vec<_>>();
        let step_scale = |s: usize| f64::from(share) * f64::from(scale[s]);
        // The cotangent of the exponent, and the norm of that of tanh(field).
        let along =
            |s: usize| step_scale(s) * tanh(s).iter().zip(row(&grad, s)).map(|(u, g)| u * g).sum::<f64>();
        let norm = |s: usize| step_scale(s) * row(&grad, s).iter().map(|g| g * g).sum::<f64>().sqrt();
        let together = normalisation.samples();
        let shared = |s: usize, size: &dyn Fn(usize) -> f64| {
            let begin = s / together * together;
            let squares: f64 = (begin..begin + together).map(|s| size(s).powi(2)).sum();
            (squares / together as f64).sqrt().max(1e-40)
        };
        // The terms of the sum `along` cancel, but the roundings of terms and additions remain. They grow as
        // a random walk over the additions of an invocation, then over those of the workgroup.
        let additions = (padded(grid.w) * grid.h).div_ceil(256) + 8;
        let lost = |s: usize| {
            let squares: f64 = tanh(s).iter().zip(row(&grad, s)).map(|(u, g)| (u * g).powi(2)).sum();
            step_scale(s) * squares.sqrt() * 0.5 * ROUNDING * (additions as f64).sqrt()
        };
        let (mut adj_field, mut adj_scalar, mut rounding) = (Vec::new(), Vec::new(), 0.0f64);
        for (s, &scalar) in scalar.iter().enumerate() {
            let begin = s / together * together;
            let most = (begin..begin + together).map(lost).fold(0.0, f64::max);
            // Divided by its own magnitude, `along` is its sign.
            rounding = if together == 1 { 0.0 } else { rounding.max(most / shared(s, &along)) };
            let half = (f64::from(scalar) / 2.0).tanh();
            adj_scalar.push((along(s) / shared(s, &along)).clamp(-10.0, 10.0) * (1.0 - half * half));
            let norm = shared(s, &norm);
            let back = |(u, g): (f64, f64)| (step_scale(s) * g / norm).clamp(-10.0, 10.0) * (1.0 - u * u);
            adj_field.extend(tanh(s).into_iter().zip(row(&grad, s)).map(back));
        }
        let field = tensor("field", &[1, samples, grid.h, padded(grid.w)], &pad(&field, grid, f32::NAN));
        let [scalar, scale] = [&scalar, &scale].map(|v| tensor("samples", &[samples], v));
        let grad = tensor("grad", &[samples, n], &grad);
        let to_field = poisoned("adj_field", &field.shape()[1..]);
        let to_scalar = poisoned("adj_scalar", &[samples]);
        let from = UpdateAdjTensors { field: &field, scalar: &scalar, scale: &scale, grad: &grad };
        run(|schedule| kernel.push(schedule, grid, (from, share), (&to_field, &to_scalar)));
        let what = format!("update_adj {batch} x {grid}, {normalisation:?}");
        let found = read(&to_field);
        let dense: Vec<f32> =
            found.chunks_exact(padded(grid.w)).flat_map(|row| &row[..grid.w]).copied().collect();
        assert_close(&what, &dense, &adj_field, (4.0 * ROUNDING, 16.0 * ROUNDING));
        assert_close(&what, &read(&to_scalar), &adj_scalar, (rounding, 8.0 * ROUNDING));
        let beyond = found.chunks_exact(padded(grid.w)).flat_map(|row| &row[grid.w..]);
        assert!(beyond.into_iter().all(|&v| v == 0.0), "{what}: the padding is zero");
    }
}
