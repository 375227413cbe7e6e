//! `norms` against sums of squares.

use crate::common::{ROUNDING, assert_close, cases, context, device, noise, poisoned, read, run, tensor};
use fnopt::kernels::optim::{Norms, norms::parts};

#[test]
fn partial_sums_of_squares_match() {
    let _turn = device();
    for last_step in [true, false] {
        let kernel = Norms::new(context(), last_step).unwrap();
        for (grid, batch) in cases() {
            let (samples, n) = (3 * batch, grid.particles());
            let (grad, hidden) = (noise(samples * n, 81), noise(2 * samples * n, 82));
            let (count, per_part) = (parts(n), n.div_ceil(parts(n)));
            let squares = |values: &[f32], k: usize| -> f64 {
                let part = values.iter().skip(k * per_part).take(per_part);
                part.map(|&v| f64::from(v) * f64::from(v)).sum()
            };
            let mut expected = Vec::new();
            for s in 0..samples {
                let steps = &hidden[(samples + s) * n..][..n];
                for k in 0..count {
                    expected.push(squares(&grad[s * n..][..n], k));
                    expected.push(if last_step { squares(steps, k) } else { 0.0 });
                }
            }
            let grad = tensor("grad", &[samples, n], &grad);
            let hidden = if last_step {
                tensor("hidden", &[2, samples, n], &hidden)
            } else {
                // Any tensor may stand there: nothing is read of it.
                poisoned("hidden", &[1])
            };
            // A view, as the rows of a solver's iterations are.
            let rows = poisoned("partial", &[192 + 2 * samples * count]);
            let partial = rows.view(192, &[samples, count, 2]);
            run(|schedule| kernel.push(schedule, &grad, &hidden, &partial));
            // Up to 32 squares in turn, then six sums of sums.
            let what = format!("norms {batch} x {grid}");
            assert_close(&what, &read(&partial), &expected, (0.0, 6.0 * ROUNDING));
            assert!(read(&rows)[..192].iter().all(|v| v.is_nan()), "{what} wrote in front of its view");
        }
    }
}
