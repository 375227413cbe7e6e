//! `transpose` and `spectral_transpose` against their definitions, exactly: they only move or negate
//! elements.

use super::operator::{by_mode, tiled};
use crate::common::{context, device, noise, poisoned, read, run, tensor};
use fnopt::kernels::operator::{SpectralTranspose, Transpose};

#[test]
fn weights_are_transposed() {
    let _turn = device();
    let kernel = Transpose::new(context()).unwrap();
    for (outputs, inputs, tile) in [(64, 32, 8), (32, 96, 32), (48, 16, 16)] {
        let weight = noise(outputs * inputs, 41);
        let transposed: Vec<f32> =
            (0..inputs * outputs).map(|k| weight[k % outputs * inputs + k / outputs]).collect();
        let from = tensor("w", &[outputs / tile, inputs, tile], &tiled(&weight, inputs, tile));
        let to = poisoned("transposed", &[inputs / tile, outputs, tile]);
        run(|schedule| kernel.push(schedule, &from, &to));
        assert_eq!(read(&to), tiled(&transposed, outputs, tile), "{outputs} {inputs} {tile}");
    }
}

#[test]
fn spectral_weights_are_transposed_and_conjugated() {
    let _turn = device();
    let kernel = SpectralTranspose::new(context()).unwrap();
    let (modes, inputs, outputs) = (21, 48, 80);
    let weight = noise(inputs * outputs * modes * 2, 42);
    let mut transposed = vec![0.0; weight.len()];
    for (k, pair) in weight.chunks_exact(2).enumerate() {
        let (i, o, m) = (k / (modes * outputs), k / modes % outputs, k % modes);
        let at = 2 * ((o * inputs + i) * modes + m);
        (transposed[at], transposed[at + 1]) = (pair[0], -pair[1]);
    }
    let from = tensor("w", &[modes, inputs / 2, outputs, 4], &by_mode(&weight, inputs, outputs));
    let to = poisoned("transposed", &[modes, outputs / 2, inputs, 4]);
    run(|schedule| kernel.push(schedule, &from, &to));
    assert_eq!(read(&to), by_mode(&transposed, outputs, inputs));
}
