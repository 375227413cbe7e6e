//! The truncated transform against a library's full one.

use crate::golden::largest_difference;
use crate::noise::noise;
use fnopt::cloth::Grid;
use fnopt::cpu::fft::Fft2;
use fnopt::cpu::operator::Transform;
use fnopt::network::Config;
use fnopt::settings::Norm;

const CHANNELS: usize = 16;

/// Even, odd, prime and smallest sizes.
fn grids() -> [Grid; 7] {
    [(8, 8), (9, 13), (33, 47), (31, 37), (32, 48), (20, 9), (100, 100)].map(|(h, w)| Grid { h, w })
}

/// Returns the kept modes of `x` [H, W, C] as (re, im), shape [modes_h, modes_w, C, 2].
fn truncated(transform: &Transform<f64>, config: &Config, x: &[f64], grid: Grid) -> Vec<f64> {
    let mut rows = vec![0.0; grid.h * transform.row_len()];
    for (row, x) in rows.chunks_mut(transform.row_len()).zip(x.chunks(grid.w * CHANNELS)) {
        transform.row_forward(row, x);
    }
    let mut modes = vec![0.0; config.modes() * CHANNELS * 2];
    for k_w in 0..config.modes_w {
        let mut sums = vec![0.0; transform.column_len() / config.modes_w];
        transform.column_forward(&mut sums, &rows, k_w);
        for m_h in 0..config.modes_h {
            for c in 0..CHANNELS {
                let (re, im) = transform.mode(&sums, m_h, c);
                let at = ((m_h * config.modes_w + k_w) * CHANNELS + c) * 2;
                modes[at..at + 2].copy_from_slice(&[re, im]);
            }
        }
    }
    modes
}

#[test]
fn truncated_forward_transform_is_part_of_the_full_one() {
    let config = Config::default();
    for grid in grids() {
        let transform = Transform::new(&config, grid, CHANNELS).unwrap();
        let x = noise(grid.particles() * CHANNELS, 1);
        let found = truncated(&transform, &config, &x, grid);
        let fft = Fft2::new(grid, Norm::Forward);
        for c in 0..CHANNELS {
            let channel: Vec<f64> = x.iter().skip(c).step_by(CHANNELS).copied().collect();
            let full = fft.forward(&channel);
            for m_h in 0..config.modes_h {
                let k_h = (m_h + grid.h - config.modes_h / 2) % grid.h;
                for k_w in 0..config.modes_w {
                    let z = full[k_h * fft.columns() + k_w];
                    let at = ((m_h * config.modes_w + k_w) * CHANNELS + c) * 2;
                    let difference = largest_difference(&found[at..at + 2], &[z.re, z.im]);
                    assert!(difference < 1e-12, "{grid}: mode ({m_h}, {k_w}): {difference}");
                }
            }
        }
    }
}

#[test]
fn truncated_inverse_transform_is_the_full_one_of_the_kept_modes() {
    let config = Config::default();
    for grid in grids() {
        let transform = Transform::new(&config, grid, CHANNELS).unwrap();
        // Arbitrary modes, not only those of a real field. In column 0, and in the last column if W = 8, only
        // the Hermitian part counts.
        let modes = noise(config.modes() * CHANNELS * 2, 2);
        let found = transform.inverse(&modes);
        let fft = Fft2::new(grid, Norm::Forward);
        for c in 0..CHANNELS {
            let mut full = fft.forward(&vec![0.0; grid.particles()]);
            for m_h in 0..config.modes_h {
                let k_h = (m_h + grid.h - config.modes_h / 2) % grid.h;
                for k_w in 0..config.modes_w {
                    let at = ((m_h * config.modes_w + k_w) * CHANNELS + c) * 2;
                    let z = &mut full[k_h * fft.columns() + k_w];
                    (z.re, z.im) = (modes[at], modes[at + 1]);
                }
            }
            let channel: Vec<f64> = found.iter().skip(c).step_by(CHANNELS).copied().collect();
            let difference = largest_difference(&channel, &fft.inverse(&full));
            assert!(difference < 1e-12, "{grid}: channel {c}: {difference}");
        }
    }
}

#[test]
fn full_transform_is_its_sum_and_inverts() {
    for grid in [Grid { h: 8, w: 8 }, Grid { h: 9, w: 13 }] {
        let x = noise(2 * grid.particles(), 3);
        for norm in [Norm::Forward, Norm::Backward] {
            let fft = Fft2::new(grid, norm);
            assert!(largest_difference(&fft.inverse(&fft.forward(&x)), &x) < 1e-14);
        }
        let fft = Fft2::new(grid, Norm::Backward);
        let spectrum = fft.forward(&x[..grid.particles()]);
        for k_h in 0..grid.h {
            for k_w in 0..fft.columns() {
                let (mut re, mut im) = (0.0, 0.0);
                for (p, x) in x[..grid.particles()].iter().enumerate() {
                    let turns = (k_h * (p / grid.w)) as f64 / grid.h as f64
                        + (k_w * (p % grid.w)) as f64 / grid.w as f64;
                    let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
                    re += x * cos;
                    im -= x * sin;
                }
                let z = spectrum[k_h * fft.columns() + k_w];
                assert!(largest_difference(&[z.re, z.im], &[re, im]) < 1e-12);
            }
        }
    }
}
