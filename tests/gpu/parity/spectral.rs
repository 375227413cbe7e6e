//! `spectral` against the CPU path's column transform and the formulas of product and inverse.

use super::operator::{CHANNELS, MODES, by_mode, config, turn};
use crate::common::{
    ROUNDING, assert_close, cases, context, device, largest, noise, poisoned, read, run, sharings, tensor,
    widened,
};
use fnopt::cloth::Grid;
use fnopt::cpu::operator::Transform;
use fnopt::gpu::{Tensor, Tuning};
use fnopt::kernels::operator::{Spectral, SpectralSize, SpectralTensors};
use fnopt::network::{Config, tables};

/// Returns the spectrum [S, modes_h, modes_w, C, 2] of the rows' spectra `r` [S, H, 2 modes_w, C].
fn spectrum(config: &Config, grid: Grid, r: &[f32]) -> Vec<f64> {
    let Config { modes_h, modes_w, channels, .. } = *config;
    let transform = Transform::<f64>::new(config, grid, channels).unwrap();
    let mut sums = vec![0.0; transform.column_len() / modes_w];
    let mut spectrum = Vec::new();
    for rows in r.chunks_exact(grid.h * transform.row_len()) {
        let (rows, first) = (widened(rows), spectrum.len());
        spectrum.resize(first + modes_h * modes_w * channels * 2, 0.0);
        for k_w in 0..modes_w {
            transform.column_forward(&mut sums, &rows, k_w);
            for (m_h, c) in (0..modes_h).flat_map(|m| (0..channels).map(move |c| (m, c))) {
                let at = first + ((m_h * modes_w + k_w) * channels + c) * 2;
                (spectrum[at], spectrum[at + 1]) = transform.mode(&sums, m_h, c);
            }
        }
    }
    spectrum
}

/// Returns the channel product of each mode with `weight` [C, C, modes, 2].
fn product(config: &Config, x: &[f64], weight: &[f32]) -> Vec<f64> {
    let (modes, channels) = (config.modes(), config.channels);
    let mut y = vec![0.0; x.len()];
    for (index, y) in y.chunks_exact_mut(2).enumerate() {
        let (o, m, s) = (index % channels, index / channels % modes, index / (channels * modes));
        for i in 0..channels {
            let (at_x, at_w) = (2 * ((s * modes + m) * channels + i), 2 * ((i * channels + o) * modes + m));
            let (xr, xi, wr, wi) =
                (x[at_x], x[at_x + 1], f64::from(weight[at_w]), f64::from(weight[at_w + 1]));
            y[0] += xr * wr - xi * wi;
            y[1] += xr * wi + xi * wr;
        }
    }
    y
}

/// Returns the inverse column transform of `z`, shape [S, H, 2 modes_w, C].
fn inverse(config: &Config, grid: Grid, z: &[f64]) -> Vec<f64> {
    let Config { modes_h, modes_w, channels, .. } = *config;
    let mut r = Vec::new();
    for z in z.chunks_exact(modes_h * modes_w * channels * 2) {
        for i in 0..grid.h {
            for (k_w, part) in (0..modes_w).flat_map(|k| [(k, 0), (k, 1)]) {
                r.extend((0..channels).map(|c| {
                    let mode = |m: usize| {
                        let at = ((m * modes_w + k_w) * channels + c) * 2;
                        let (cos, sin) = turn(m as i64 - (modes_h / 2) as i64, i, grid.h);
                        if part == 0 { z[at] * cos - z[at + 1] * sin } else { z[at] * sin + z[at + 1] * cos }
                    };
                    (0..modes_h).map(mode).sum::<f64>()
                }));
            }
        }
    }
    r
}

/// Covers every division of a workgroup's work, with the spectrum kept and not kept, and weights and a
/// table from buffers and from texels, which give the same bits.
#[test]
fn convolutions_match() {
    let _turn = device();
    for modes in MODES {
        let config = config(modes, CHANNELS);
        let weight = noise(CHANNELS * CHANNELS * config.modes() * 2, 52);
        let by_mode = by_mode(&weight, CHANNELS, CHANNELS);
        let on_device = tensor("weight", &[config.modes(), CHANNELS / 2, CHANNELS, 4], &by_mode);
        let weight_in_texels = on_device.to_texels(context());
        for (grid, samples) in cases() {
            let shape = [samples, grid.h, 2 * config.modes_w, CHANNELS];
            let r = noise(shape.iter().product(), 31);
            let modes = spectrum(&config, grid, &r);
            let expected = inverse(&config, grid, &product(&config, &modes, &weight));
            let table =
                tensor("table", &[grid.h, config.modes_h / 2 + 1, 2], &tables::columns(&config, grid.h));
            let table_in_texels = table.to_texels(context());
            let r = tensor("r", &shape, &r);
            let [software, hardware] = sharings();
            let divided = |(spectral_teams, busy_groups)| {
                [software, hardware].map(|tuning| Tuning { spectral_teams, busy_groups, ..tuning })
            };
            for tuning in [(1, 1), (2, 10), (4, 30), (1, 60), (4, 1000)].into_iter().flat_map(divided) {
                for keep in [false, true] {
                    let found = poisoned("inverse", &shape);
                    let kept = poisoned("spectrum", &[samples, config.modes_h, config.modes_w, CHANNELS, 2]);
                    let convolve = |texels: bool, inverse: &Tensor| {
                        let tuning = Tuning { texels, ..tuning };
                        let Config { modes_h, modes_w, channels, .. } = config;
                        let size = SpectralSize { modes_h, modes_w, channels };
                        let kernel = Spectral::new(context(), &tuning, &size, samples, keep).unwrap();
                        let spectrum = keep.then_some(&kept);
                        let (weight, table) = match texels {
                            true => (&weight_in_texels, &table_in_texels),
                            false => (&on_device, &table),
                        };
                        let tensors = SpectralTensors { table, r: &r, inverse, spectrum };
                        run(|schedule| kernel.push(schedule, weight, tensors));
                    };
                    convolve(false, &found);
                    if !keep {
                        let from_texels = poisoned("inverse", &shape);
                        convolve(true, &from_texels);
                        assert_eq!(read(&from_texels), read(&found));
                    }
                    let what = format!("spectral {samples} x {grid}");
                    let rounding = ROUNDING * (grid.h as f64).sqrt();
                    let atol = rounding * largest(&expected);
                    assert_close(&what, &read(&found), &expected, (atol, 0.0));
                    if keep {
                        assert_close(&what, &read(&kept), &modes, (rounding * largest(&modes), 0.0));
                    }
                }
            }
        }
    }
}
