//! The backward pass of the network against finite differences, layer by layer, and the adjoint transform
//! against its definition.

use crate::noise::noise;
use fnopt::cloth::Grid;
use fnopt::cpu::operator::{Adjoint, LaidOut, Network, Spectral, Transform};
use fnopt::cpu::optim::{Hidden, UpdateAdjoint};
use fnopt::network::{Config, Weights};
use fnopt::settings::Normalisation;

/// Returns weights that stay exact in single precision when small multiples of [`STEP`] are added.
fn weights(config: Config, seed: u64) -> Weights {
    let count = Weights::zeros(config).flat().len();
    let flat: Vec<f32> = noise(count, seed).iter().map(|v| ((v * 1024.0).round() / 2048.0) as f32).collect();
    Weights::from_flat(config, &flat)
}

/// Step of the finite differences over the weights, a power of two.
const STEP: f32 = 1.0 / 4096.0;

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

struct Case {
    config: Config,
    grid: Grid,
    samples: usize,
}

fn cases() -> [Case; 4] {
    let config =
        Config { fields: 3, lifting: 6, channels: 5, projection: 4, layers: 4, modes_h: 4, modes_w: 3 };
    [
        Case { config, grid: Grid { h: 9, w: 11 }, samples: 3 },
        // The last kept column is its own conjugate.
        Case { config: Config { modes_w: 5, ..config }, grid: Grid { h: 8, w: 8 }, samples: 2 },
        Case { config: Config { layers: 2, channels: 17, ..config }, grid: Grid { h: 13, w: 8 }, samples: 1 },
        // With one block, the scalar head reads the last block.
        Case { config: Config { layers: 1, ..config }, grid: Grid { h: 8, w: 9 }, samples: 2 },
    ]
}

#[test]
fn gradients_of_every_parameter_match_differences() {
    for (number, Case { config, grid, samples }) in cases().into_iter().enumerate() {
        let weights = weights(config, 1);
        let input = noise(samples * config.fields * grid.particles(), 2204);
        // With these seeds, no maximum moves to another position within the differences.
        let (adj_field, adj_scalar) = (noise(samples * grid.particles(), 3), noise(samples, 204));
        let value = |weights: &Weights| {
            let mut network = Network::<f64>::new(weights, grid, samples).unwrap();
            network.forward(&input);
            dot(network.field(), &adj_field) + dot(network.scalar(), &adj_scalar)
        };
        let mut adjoint = Adjoint::<f64>::new(&Weights::zeros(config), grid, samples).unwrap();
        adjoint.set_weights(&LaidOut::new(&weights));
        adjoint.forward(&input);
        assert!(
            (dot(adjoint.field(), &adj_field) + dot(adjoint.scalar(), &adj_scalar) - value(&weights)).abs()
                < 1e-12
        );
        let mut gradient = vec![0.0; weights.flat().len()];
        adjoint.backward(&input, (&adj_field, &adj_scalar), &mut gradient);
        let mut start = 0;
        for (index, parameter) in weights.parameters().iter().enumerate() {
            // All numbers of a parameter are moved at once, with random signs.
            let signs: Vec<f64> =
                noise(parameter.len(), 5 + index as u64).iter().map(|v| v.signum()).collect();
            let moved = |steps: f32| {
                let mut moved = weights.clone();
                for (to, &sign) in moved.parameters_mut()[index].iter_mut().zip(&signs) {
                    *to += steps * STEP * sign as f32;
                }
                value(&moved)
            };
            // Five points: the error falls with the fourth power of the step.
            let difference = (8.0 * (moved(1.0) - moved(-1.0)) - (moved(2.0) - moved(-2.0))) / 12.0;
            let expected = difference / f64::from(STEP);
            let found = dot(&gradient[start..start + parameter.len()], &signs);
            let error = (found - expected).abs() / expected.abs().max(1e-12);
            assert!(error < 1e-6, "case {number}, parameter {index}: {found}, not {expected}");
            start += parameter.len();
        }
    }
}

#[test]
fn gradients_add_up_and_repeat_bit_for_bit() {
    let Case { config, grid, samples } = &cases()[0];
    let weights = weights(*config, 6);
    let input: Vec<f32> = noise(samples * 3 * grid.particles(), 7).iter().map(|&v| v as f32).collect();
    let adj_field = vec![0.5f32; samples * grid.particles()];
    let adj_scalar = vec![-1.0f32; *samples];
    let run = |threads: usize, times: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut adjoint = Adjoint::<f32>::new(&weights, *grid, *samples).unwrap();
            let mut gradient = vec![0.0; weights.flat().len()];
            for _ in 0..times {
                adjoint.forward(&input);
                adjoint.backward(&input, (&adj_field, &adj_scalar), &mut gradient);
            }
            gradient
        })
    };
    let once = run(1, 1);
    assert_eq!(once, run(3, 1), "the number of threads changes the sums");
    let twice = run(2, 2);
    assert!(once.iter().zip(&twice).all(|(once, twice)| (2.0 * once - twice).abs() <= 1e-5 * once.abs()));
}

#[test]
fn the_adjoint_transform_is_the_transpose() {
    for Case { config, grid, .. } in cases() {
        let c = 16;
        let transform = Transform::<f64>::new(&config, grid, c).unwrap();
        let adjoint = transform.adjoint();
        // Each forward transform is paired with the other's inverse. Only the kept modes are compared.
        let modes = noise(config.modes() * c * 2, 8);
        let field = noise(grid.particles() * c, 9);
        let forward = |t: &Transform<f64>| {
            let mut spectra = vec![0.0; grid.h * t.row_len()];
            for (out, x) in spectra.chunks_exact_mut(t.row_len()).zip(field.chunks_exact(grid.w * c)) {
                t.row_forward(out, x);
            }
            let mut found = vec![0.0; modes.len()];
            for k_w in 0..config.modes_w {
                let mut sums = vec![0.0; t.column_len() / config.modes_w];
                t.column_forward(&mut sums, &spectra, k_w);
                for (m_h, i) in (0..config.modes_h).flat_map(|m| (0..c).map(move |i| (m, i))) {
                    let at = ((m_h * config.modes_w + k_w) * c + i) * 2;
                    (found[at], found[at + 1]) = t.mode(&sums, m_h, i);
                }
            }
            found
        };
        // <F x, z> = <x, F' z>, and the corresponding identity for the inverse.
        let pairs = [
            (dot(&forward(&transform), &modes), dot(&field, &adjoint.inverse(&modes))),
            (dot(&forward(&adjoint), &modes), dot(&field, &transform.inverse(&modes))),
        ];
        for (left, right) in pairs {
            assert!((left - right).abs() < 1e-10 * left.abs().max(1.0), "{left} and {right} on {grid}");
        }
    }
}

#[test]
fn the_adjoint_product_is_the_conjugate_transpose() {
    let Case { config, grid, .. } = cases()[2];
    let (c, samples) = (32, 2);
    let block = &weights(config, 10).blocks[0];
    let transform = Transform::<f64>::new(&config, grid, c).unwrap();
    let apply = |product: &Spectral<f64>, sums: &[f64]| {
        let mut out = vec![0.0; config.modes() * 4 * samples * c];
        let mut scratch = vec![0.0; product.scratch_len(samples)];
        product.apply(&mut out, sums, &transform, &mut scratch);
        (out, scratch)
    };
    let (straight, adjoint) = (Spectral::new(&config, block), Spectral::adjoint(&config, block));
    let [x, y] = [11, 12].map(|seed| noise(samples * transform.column_len(), seed));
    let ((wx, x_modes), (wy, y_modes)) = (apply(&straight, &x), apply(&adjoint, &y));
    // Outputs are (re, im) of all samples, then the same times the imaginary unit; inputs are
    // (re, -im, im, re) per sample.
    let product = |out: &[f64], modes: &[f64]| -> f64 {
        let len = 4 * samples * c;
        let per_mode = out.chunks_exact(len).zip(modes.chunks_exact(len));
        per_mode
            .flat_map(|(out, modes)| {
                (0..samples).map(move |s| {
                    let (re, im) = (&modes[4 * s * c..][..c], &modes[(4 * s + 2) * c..][..c]);
                    dot(&out[2 * s * c..][..c], re) + dot(&out[(2 * s + 1) * c..][..c], im)
                })
            })
            .sum()
    };
    let (left, right) = (product(&wx, &y_modes), product(&wy, &x_modes));
    assert!((left - right).abs() < 1e-10 * left.abs(), "{left} and {right}");
}

/// Returns the gradient over the weights of equal samples, one per element of `sizes`, which scales its
/// cotangents.
fn gradient_of_samples(sizes: &[f32], normalisation: Normalisation) -> Vec<f64> {
    let Case { config, grid, .. } = cases()[0];
    let (weights, n) = (weights(config, 6), grid.particles());
    let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect::<Vec<f32>>();
    let (grad, adj_step) = (single(noise(n, 7)), single(noise(n, 8)));
    let norm = grad.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
    let count = sizes.len();
    let mut rule = UpdateAdjoint::<f32>::new(&weights, (grid, count), normalisation).unwrap();
    let zeros = || vec![0.0; count * n];
    let mut hidden = Hidden { last_grad: zeros(), last_step: zeros(), scale: vec![0.05; count] };
    rule.forward((&grad.repeat(count), &vec![norm; count]), &mut hidden, &mut zeros());
    let adj_steps: Vec<f32> = sizes.iter().flat_map(|size| adj_step.iter().map(move |a| size * a)).collect();
    let mut gradient = vec![0f32; weights.parameter_count()];
    rule.backward(&adj_steps, &hidden, &mut gradient);
    gradient.into_iter().map(f64::from).collect()
}

/// Asserts that `found` is `times` times `one`.
fn assert_times(found: &[f64], times: f64, one: &[f64], what: &str) {
    let apart: Vec<f64> = found.iter().zip(one).map(|(a, b)| a - times * b).collect();
    assert!(dot(&apart, &apart).sqrt() <= 1e-5 * times * dot(one, one).sqrt(), "{what}");
}

/// Every sample weighs the same, whatever the size of its cotangents. A sample in equilibrium weighs nothing.
#[test]
fn cotangents_of_the_update_rule_are_normalised_sample_by_sample() {
    let gradient = |sizes: &[f32]| gradient_of_samples(sizes, Normalisation::Component);
    let one = gradient(&[1.0]);
    assert!(dot(&one, &one) > 0.0);
    for sizes in [&[1e6][..], &[1e-30], &[1.0, 0.0], &[0.0, 1.0]] {
        assert_times(&gradient(sizes), 1.0, &one, &format!("{sizes:?}"));
    }
}

/// Every cloth weighs the same, whatever the size of its cotangents, and its components in proportion to
/// theirs.
#[test]
fn cotangents_of_the_update_rule_are_normalised_cloth_by_cloth() {
    let gradient = |sizes: &[f32]| gradient_of_samples(sizes, Normalisation::Cloth);
    let one = gradient_of_samples(&[1.0], Normalisation::Component);
    // The three sizes are divided by their root mean square. The samples are equal, so their gradients add up
    // to the sum of the quotients times one of them.
    for sizes in [[1.0, 1.0, 1.0], [3.0, 2.0, 1.0], [2e-9, 1e-9, 0.0], [0.0, 0.0, 1e6], [0.0; 3]] {
        let mean_square = sizes.iter().map(|s| f64::from(s * s)).sum::<f64>() / 3.0;
        let times = sizes.iter().map(|&s| f64::from(s)).sum::<f64>() / mean_square.sqrt().max(1e-40);
        assert_times(&gradient(&sizes), times, &one, &format!("{sizes:?}"));
    }
    let both = gradient(&[3.0, 2.0, 1.0, 5e4, 0.0, 0.0]);
    assert_times(&both, 6.0 / (14.0f64 / 3.0).sqrt() + 3f64.sqrt(), &one, "two cloths");
}
