//! Sums over a field, in double precision, in which the square of no nonzero single-precision number
//! underflows.

use crate::cpu::Real;

/// Number of partial sums. With a single one, each addition would wait for the one before.
const PARTS: usize = 16;

/// Returns the dot product, summed in an order that depends only on the length.
pub(in crate::cpu) fn dot<T: Real>(u: &[T], w: &[T]) -> f64 {
    let ((u, u_rest), (w, w_rest)) = (u.as_chunks::<PARTS>(), w.as_chunks::<PARTS>());
    let mut sums = [0.0; PARTS];
    for (u, w) in u.iter().zip(w) {
        for ((sum, u), w) in sums.iter_mut().zip(u).zip(w) {
            *sum += u.f64() * w.f64();
        }
    }
    let rest = u_rest.iter().zip(w_rest).map(|(u, w)| u.f64() * w.f64());
    sums.into_iter().chain(rest).sum()
}

/// Returns the Euclidean norm.
pub(in crate::cpu) fn norm<T: Real>(values: &[T]) -> f64 {
    dot(values, values).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_counts_once() {
        for len in [0, 1, 15, 16, 17, 100] {
            let u: Vec<f32> = (0..len).map(|k| k as f32).collect();
            let w: Vec<f32> = (0..len).map(|k| 1.0 + k as f32).collect();
            let expected: f64 = (0..len).map(|k| (k * (k + 1)) as f64).sum();
            assert_eq!(dot(&u, &w), expected);
        }
        assert_eq!(norm(&[1e-30f32; 4]), 2.0 * f64::from(1e-30f32));
    }
}
