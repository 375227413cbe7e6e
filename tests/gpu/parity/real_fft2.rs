//! The full real transform and its passes against a library's transform in double precision.

use crate::common::{
    ROUNDING, assert_close, context, device, largest, noise, poisoned, read, run, tensor, widened,
};
use fnopt::cloth::Grid;
use fnopt::cpu::fft::Fft2;
use fnopt::gpu::Tensor;
use fnopt::kernels::fft::{Fields, RealFft2};
use fnopt::settings::Norm;

/// Sides of one, powers of two, odd and even sides, primes and their squares, and very unequal sides.
const SIZES: [[usize; 2]; 17] = [
    [1, 1],
    [1, 7],
    [7, 1],
    [2, 3],
    [3, 2],
    [8, 8],
    [9, 13],
    [31, 33],
    [33, 47],
    [48, 32],
    [49, 25],
    [64, 64],
    [97, 101],
    [100, 100],
    [2, 1024],
    [513, 4],
    [3, 1009],
];

struct Case {
    fields: Fields,
    plan: RealFft2,
    oracle: Fft2<f64>,
    x: Vec<f32>,
}

impl Case {
    fn new([h, w]: [usize; 2], batch: usize, norm: Norm) -> Self {
        let fields = Fields { batch, h, w };
        Self {
            fields,
            plan: RealFft2::new(context(), fields, norm).unwrap(),
            oracle: Fft2::new(Grid { h, w }, norm),
            x: noise(batch * h * w, (h * 1000 + w) as u64),
        }
    }

    fn name(&self, what: &str) -> String {
        let Fields { batch, h, w } = self.fields;
        format!("{what} {batch} x {h} x {w}")
    }

    fn upload(&self, x: &[f32]) -> Tensor {
        tensor("x", &[self.fields.batch, self.fields.h, self.fields.w], x)
    }

    /// Rounding errors grow with the number of passes, and as the root of a prime factor in its direct sum.
    /// In the spectra of noise, the largest magnitude is 3 or 4 times that of a typical element.
    fn tolerance(&self, expected: &[f64]) -> f64 {
        let Fields { h, w, .. } = self.fields;
        let passes = ((h * w) as f64).log2() + 2.0;
        let prime = largest_prime(h).max(largest_prime(w)) as f64;
        ROUNDING * (passes + prime.sqrt()) * largest(expected)
    }
}

fn largest_prime(mut n: usize) -> usize {
    let mut factor = 2;
    while n > factor {
        if n.is_multiple_of(factor) { n /= factor } else { factor += 1 }
    }
    n
}

#[test]
fn forward_and_inverse_match_a_library() {
    let _turn = device();
    for size in SIZES {
        for (batch, norm) in [(1, Norm::Forward), (3, Norm::Backward)] {
            let case = Case::new(size, batch, norm);
            let expected: Vec<f64> =
                case.oracle.forward(&widened(&case.x)).iter().flat_map(|z| [z.re, z.im]).collect();
            let x = case.upload(&case.x);
            let spectrum = poisoned("spectrum", &case.plan.spectrum_shape());
            let again = poisoned("again", &[batch, size[0], size[1]]);
            run(|schedule| {
                case.plan.push_forward(schedule, &x, &spectrum);
                case.plan.push_inverse(schedule, &spectrum, &again);
            });
            assert_close(
                &case.name("forward"),
                &read(&spectrum),
                &expected,
                (case.tolerance(&expected), 0.0),
            );
            assert_eq!(read(&x), case.x, "the input changed");
            let back = widened(&case.x);
            assert_close(&case.name("round trip"), &read(&again), &back, (2.0 * case.tolerance(&back), 0.0));
        }
    }
}

/// The inverse takes any numbers and ignores what is not Hermitian in columns that are their own conjugates.
#[test]
fn the_inverse_ignores_the_non_hermitian_part() {
    let _turn = device();
    for size in SIZES {
        let case = Case::new(size, 2, Norm::Forward);
        let shape = case.plan.spectrum_shape();
        let z = noise(shape.iter().product(), 5);
        let complex: Vec<_> =
            widened(&z).chunks_exact(2).map(|z| realfft::num_complex::Complex::new(z[0], z[1])).collect();
        let expected = case.oracle.inverse(&complex);
        let spectrum = tensor("spectrum", &shape, &z);
        let x = poisoned("x", &[2, size[0], size[1]]);
        run(|schedule| case.plan.push_inverse(schedule, &spectrum, &x));
        assert_close(&case.name("inverse"), &read(&x), &expected, (case.tolerance(&expected), 0.0));
        assert_eq!(read(&spectrum), z, "the input changed");
    }
}

/// Two rows share a complex row, but never across fields: a field alone has the same bits as in a batch.
#[test]
fn fields_of_a_batch_do_not_touch() {
    let _turn = device();
    for [h, w] in [[31, 33], [8, 12]] {
        let spectrum_of = |x: &[f32], batch: usize| {
            let case = Case::new([h, w], batch, Norm::Forward);
            let spectrum = poisoned("spectrum", &case.plan.spectrum_shape());
            run(|schedule| case.plan.push_forward(schedule, &case.upload(x), &spectrum));
            read(&spectrum)
        };
        let mut x = noise(3 * h * w, 9);
        x[h * w..2 * h * w].fill(f32::NAN);
        let all = spectrum_of(&x, 3);
        let each = all.len() / 3;
        assert_eq!(all[..each], spectrum_of(&x[..h * w], 1));
        assert_eq!(all[2 * each..], spectrum_of(&x[2 * h * w..], 1));
    }
}

/// A prime close to the longest side of a grid, summed directly, stays below the loop limit of software
/// drivers.
#[test]
fn long_primes_are_summed_to_the_end() {
    let _turn = device();
    let case = Case::new([1, 4093], 1, Norm::Forward);
    let expected: Vec<f64> =
        case.oracle.forward(&widened(&case.x)).iter().flat_map(|z| [z.re, z.im]).collect();
    let spectrum = poisoned("spectrum", &case.plan.spectrum_shape());
    run(|schedule| case.plan.push_forward(schedule, &case.upload(&case.x), &spectrum));
    assert_close(&case.name("forward"), &read(&spectrum), &expected, (case.tolerance(&expected), 0.0));
}

#[test]
fn impossible_sizes_are_errors() {
    for fields in [
        Fields { batch: 1, h: 0, w: 4 },
        Fields { batch: 1, h: 4, w: 70_000 },
        Fields { batch: 0, h: 4, w: 4 },
    ] {
        let error = RealFft2::new(context(), fields, Norm::Forward).unwrap_err().to_string();
        assert!(error.starts_with("transform: "), "{error}");
    }
}
