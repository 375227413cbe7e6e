//! Elementary functions of the network and the energies in vector registers, where libraries have none or
//! slow ones.

use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// The GELU is `max(x, 0) - h(|x|)` with `h(t) = t erfc(t / sqrt 2) / 2 <= 0.17`, so a relative error of `h`
/// stays small in absolute terms. `h(t)` is approximately `t / p(t)^8` with the polynomial p below, lowest
/// power first: minimax over 0 <= t <= 6 in the error of `h`, by iteratively reweighted least squares
/// (Lawson) on 2000 Chebyshev nodes in double precision, 4.2e-8. Beyond 6 the eighth power makes `h`
/// negligible. With rounding the largest error is 2e-7 for |x| < 3, and half an ulp beyond.
const GELU_TAIL: [f32; 9] = [
    1.090_508_3,
    1.087_520_05e-1,
    4.887_039_6e-2,
    9.315_807e-3,
    1.125_625_4e-3,
    8.748_192e-5,
    1.180_962_5e-4,
    -2.038_251_5e-5,
    3.354_599_8e-6,
];

/// The derivative of that polynomial.
const GELU_TAIL_SLOPE: [f32; 8] = {
    let mut slope = [0.0; 8];
    let mut k = 1;
    while k < GELU_TAIL.len() {
        slope[k - 1] = k as f32 * GELU_TAIL[k];
        k += 1;
    }
    slope
};

/// `tanh x` is approximately `x p(x^2) / q(x^2)` for |x| <= 9, clamped to -1..1: minimax in the relative
/// error by the same method, 1.3e-9; with rounding 3e-7.
const TANH_P: [f32; 6] =
    [1.0, 1.368_085_7e-1, 3.869_508_4e-3, 2.803_132e-5, 3.064_254_8e-8, -1.224_626_1e-11];
const TANH_Q: [f32; 5] = [1.0, 4.701_419e-1, 2.725_015_8e-2, 3.940_714e-4, 1.289_035_7e-6];
const TANH_LIMIT: f32 = 9.0;

/// `atan t` is approximately `t + t p(u)` with `u = t^2` for 0 <= t <= 1: minimax by the same method, 6e-9.
/// The leading 1 is kept separate so that rounding does not swallow the first coefficient. The shaders use
/// the same polynomial.
const ATAN: [f32; 9] = [
    -1.136e-7,
    -3.333_259_7e-1,
    1.998_590_7e-1,
    -1.416_122_9e-1,
    1.049_894_4e-1,
    -7.234_853_5e-2,
    3.978_118e-2,
    -1.440_133_2e-2,
    2.456_718_2e-3,
];

/// For double precision: `atan t` is approximately `t + t u p(u)` with `u = t^2` for 0 <= t <= tan(pi / 8),
/// by the Remez exchange in 40 digits, 1.3e-18.
const ATAN_DOUBLE: [f64; 11] = [
    -3.333_333_333_333_32e-1,
    1.999_999_999_995_404_3e-1,
    -1.428_571_428_024_431e-1,
    1.111_111_078_591_582_7e-1,
    -9.090_897_829_765_746e-2,
    7.692_061_513_548_783e-2,
    -6.663_118_931_493_821e-2,
    5.847_998_031_354_479e-2,
    -5.039_795_150_113_746e-2,
    3.807_701_034_235_288e-2,
    -1.792_081_213_567_108_7e-2,
];
/// Slightly less than tan(pi / 8). Beyond it, the angle is computed as 45 degrees minus the rest.
const EIGHTH: f64 = 0.414_2;

/// Computes [`Real::gelu`](super::Real::gelu) in single precision.
pub(super) fn gelu(values: &mut [f32]) {
    Arch::new().dispatch(Map { values, function: Gelu });
}

/// Computes [`Real::gelu_and_slope`](super::Real::gelu_and_slope) in single precision.
pub(super) fn gelu_and_slope(values: &mut [f32], slopes: &mut [f32]) {
    Arch::new().dispatch(GeluAndSlope { values, slopes });
}

/// Computes [`Real::squash`](super::Real::squash) in single precision.
pub(super) fn squash(values: &mut [f32], factor: f32, amplitude: f32) {
    Arch::new().dispatch(Map { values, function: Squash { factor, amplitude } });
}

/// A function applied to the lanes of a register. Its body contains neither closures nor iterator adapters:
/// they would not be compiled for the instruction set detected at run time.
trait Lanewise: Copy {
    fn of<S: Simd>(self, simd: S, x: S::f32s) -> S::f32s;
}

/// A function applied to every number of a slice.
struct Map<'a, F> {
    values: &'a mut [f32],
    function: F,
}

impl<F: Lanewise> WithSimd for Map<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (whole, rest) = S::as_mut_simd_f32s(self.values);
        for x in whole {
            *x = self.function.of(simd, *x);
        }
        if !rest.is_empty() {
            let x = simd.partial_load_f32s(rest);
            simd.partial_store_f32s(rest, self.function.of(simd, x));
        }
    }
}

#[derive(Clone, Copy)]
struct Gelu;

impl Lanewise for Gelu {
    #[inline(always)]
    fn of<S: Simd>(self, simd: S, x: S::f32s) -> S::f32s {
        let t = simd.abs_f32s(x);
        let p = horner(simd, t, &GELU_TAIL);
        let p2 = simd.mul_f32s(p, p);
        let p4 = simd.mul_f32s(p2, p2);
        let p8 = simd.mul_f32s(p4, p4);
        // (x + |x|) / 2 instead of a maximum, which would swallow a NaN.
        let positive = simd.mul_f32s(simd.splat_f32s(0.5), simd.add_f32s(x, t));
        simd.sub_f32s(positive, simd.div_f32s(t, p8))
    }
}

struct GeluAndSlope<'a> {
    values: &'a mut [f32],
    slopes: &'a mut [f32],
}

impl WithSimd for GeluAndSlope<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (values, rest) = S::as_mut_simd_f32s(self.values);
        let (slopes, rest_slopes) = S::as_mut_simd_f32s(self.slopes);
        for (x, slope) in values.iter_mut().zip(slopes) {
            *slope = gelu_slope(simd, *x);
            *x = Gelu.of(simd, *x);
        }
        if !rest.is_empty() {
            let x = simd.partial_load_f32s(rest);
            simd.partial_store_f32s(rest_slopes, gelu_slope(simd, x));
            simd.partial_store_f32s(rest, Gelu.of(simd, x));
        }
    }
}

/// Returns the derivative of what [`Gelu`] computes: with `h = t / p^8`, `h' = (1 - 8 t p' / p) / p^8`. Its
/// largest error is 2.5e-6, at 0.
#[inline(always)]
fn gelu_slope<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    // Beyond 12 the derivative is 0 or 1 (here to 2e-23), and the powers would overflow.
    let t = simd.min_f32s(simd.abs_f32s(x), simd.splat_f32s(12.0));
    let p = horner(simd, t, &GELU_TAIL);
    let inverse = simd.div_f32s(simd.splat_f32s(1.0), p);
    let i2 = simd.mul_f32s(inverse, inverse);
    let i4 = simd.mul_f32s(i2, i2);
    let i8 = simd.mul_f32s(i4, i4);
    let ratio = simd.mul_f32s(simd.mul_f32s(t, horner(simd, t, &GELU_TAIL_SLOPE)), inverse);
    let tail = simd.mul_f32s(i8, simd.mul_add_e_f32s(ratio, simd.splat_f32s(-8.0), simd.splat_f32s(1.0)));
    let negative = simd.less_than_f32s(x, simd.splat_f32s(0.0));
    simd.select_f32s(negative, tail, simd.sub_f32s(simd.splat_f32s(1.0), tail))
}

#[derive(Clone, Copy)]
struct Squash {
    factor: f32,
    amplitude: f32,
}

impl Lanewise for Squash {
    #[inline(always)]
    fn of<S: Simd>(self, simd: S, x: S::f32s) -> S::f32s {
        let z = clamp(simd, simd.mul_f32s(x, simd.splat_f32s(self.factor)), TANH_LIMIT);
        let u = simd.mul_f32s(z, z);
        let p = simd.mul_f32s(z, horner(simd, u, &TANH_P));
        let tanh = clamp(simd, simd.div_f32s(p, horner(simd, u, &TANH_Q)), 1.0);
        // The clamp would have turned a NaN into a number.
        simd.select_f32s(simd.equal_f32s(x, x), simd.mul_f32s(simd.splat_f32s(self.amplitude), tanh), x)
    }
}

/// Computes [`Real::angle`](super::Real::angle) in single precision: the arc tangent of the smaller over the
/// larger, mirrored at 45 and at 90 degrees.
#[inline(always)]
pub(super) fn angle<S: Simd>(simd: S, sine: S::f32s, cosine: S::f32s) -> S::f32s {
    let c = simd.abs_f32s(cosine);
    let (small, large) = (simd.min_f32s(sine, c), simd.max_f32s(sine, c));
    let t = simd.div_f32s(small, simd.max_f32s(large, simd.splat_f32s(f32::MIN_POSITIVE)));
    let p = horner(simd, simd.mul_f32s(t, t), &ATAN);
    let acute = simd.mul_add_e_f32s(t, p, t);
    let steep = simd.greater_than_f32s(sine, c);
    let right = simd.select_f32s(steep, simd.sub_f32s(simd.splat_f32s(FRAC_PI_2 as f32), acute), acute);
    let obtuse = simd.less_than_f32s(cosine, simd.splat_f32s(0.0));
    simd.select_f32s(obtuse, simd.sub_f32s(simd.splat_f32s(PI as f32), right), right)
}

/// Computes [`Real::angle`](super::Real::angle) in double precision. Unlike [`angle`], it also reduces at
/// 22.5 degrees: `atan (s / l) = 45 degrees - atan ((l - s) / (l + s))`.
#[inline(always)]
pub(super) fn double_angle<S: Simd>(simd: S, sine: S::f64s, cosine: S::f64s) -> S::f64s {
    let c = simd.abs_f64s(cosine);
    let (small, large) = (simd.min_f64s(sine, c), simd.max_f64s(sine, c));
    let far = simd.greater_than_f64s(small, simd.mul_f64s(simd.splat_f64s(EIGHTH), large));
    let over = simd.select_f64s(far, simd.sub_f64s(large, small), small);
    let under = simd.select_f64s(far, simd.add_f64s(large, small), large);
    let t = simd.div_f64s(over, simd.max_f64s(under, simd.splat_f64s(f64::MIN_POSITIVE)));
    let u = simd.mul_f64s(t, t);
    let mut p = simd.splat_f64s(ATAN_DOUBLE[ATAN_DOUBLE.len() - 1]);
    for k in (0..ATAN_DOUBLE.len() - 1).rev() {
        p = simd.mul_add_e_f64s(p, u, simd.splat_f64s(ATAN_DOUBLE[k]));
    }
    let near = simd.mul_add_e_f64s(t, simd.mul_f64s(u, p), t);
    let acute = simd.select_f64s(far, simd.sub_f64s(simd.splat_f64s(FRAC_PI_4), near), near);
    let steep = simd.greater_than_f64s(sine, c);
    let right = simd.select_f64s(steep, simd.sub_f64s(simd.splat_f64s(FRAC_PI_2), acute), acute);
    let obtuse = simd.less_than_f64s(cosine, simd.splat_f64s(0.0));
    simd.select_f64s(obtuse, simd.sub_f64s(simd.splat_f64s(PI), right), right)
}

#[inline(always)]
fn clamp<S: Simd>(simd: S, x: S::f32s, limit: f32) -> S::f32s {
    simd.min_f32s(simd.max_f32s(x, simd.splat_f32s(-limit)), simd.splat_f32s(limit))
}

/// Evaluates a polynomial, lowest power first, by Horner's rule.
#[inline(always)]
fn horner<S: Simd, const N: usize>(simd: S, x: S::f32s, coefficients: &[f32; N]) -> S::f32s {
    let mut sum = simd.splat_f32s(coefficients[N - 1]);
    for k in (0..N - 1).rev() {
        sum = simd.mul_add_e_f32s(sum, x, simd.splat_f32s(coefficients[k]));
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::Real;

    fn points() -> Vec<f32> {
        (-200_000..=200_000).map(|k| k as f32 * 1e-4).collect()
    }

    #[test]
    fn single_precision_gelu_follows_erf() {
        let x = points();
        let (mut single, mut double) = (x.clone(), x.iter().map(|&x| x as f64).collect::<Vec<_>>());
        f32::gelu(&mut single);
        f64::gelu(&mut double);
        for ((&x, &y), &exact) in x.iter().zip(&single).zip(&double) {
            let bound = 2.2e-7 + 6e-8 * exact.abs();
            assert!((y as f64 - exact).abs() < bound, "gelu({x}) = {y}, not {exact}");
        }
    }

    #[test]
    fn single_precision_slope_of_the_gelu_follows_the_exact_one() {
        let x = points();
        let (mut single, mut double) = (x.clone(), x.iter().map(|&x| x as f64).collect::<Vec<_>>());
        let (mut slope, mut exact) = (vec![0f32; x.len()], vec![0f64; x.len()]);
        f32::gelu_and_slope(&mut single, &mut slope);
        f64::gelu_and_slope(&mut double, &mut exact);
        let mut gelu = x.clone();
        f32::gelu(&mut gelu);
        assert_eq!(gelu, single);
        for ((&x, &slope), &exact) in x.iter().zip(&slope).zip(&exact) {
            assert!((slope as f64 - exact).abs() < 2.7e-6, "gelu'({x}) = {slope}, not {exact}");
        }
        let mut v = [-1e30f32, 1e30, -40.0, 40.0];
        let mut slope = [f32::NAN; 4];
        f32::gelu_and_slope(&mut v, &mut slope);
        for (slope, exact) in slope.into_iter().zip([0.0, 1.0, 0.0, 1.0]) {
            assert!((slope - exact).abs() < 1e-22, "{slope}, not {exact}");
        }
    }

    #[test]
    fn double_precision_slope_of_the_gelu_is_its_derivative() {
        let delta = 1e-4;
        for x in [-5.0, -1.3, -0.2, 0.0, 0.7, 2.5] {
            let gelu = |x: f64| {
                let mut v = [x];
                f64::gelu(&mut v);
                v[0]
            };
            // Five-point formula with an error of order `delta^4`.
            let near = |k: f64| gelu(x + k * delta);
            let expected = (8.0 * (near(1.0) - near(-1.0)) - (near(2.0) - near(-2.0))) / (12.0 * delta);
            let (mut v, mut slope) = ([x], [0.0]);
            f64::gelu_and_slope(&mut v, &mut slope);
            assert_eq!(v[0], gelu(x));
            assert!((slope[0] - expected).abs() < 1e-10, "gelu'({x}) = {}, not {expected}", slope[0]);
        }
    }

    #[test]
    fn gelu_of_large_and_unordered_numbers() {
        let mut v = [-1e30f32, -40.0, 40.0, 1e30, f32::NAN];
        f32::gelu(&mut v);
        assert_eq!(v[..4], [0.0, 0.0, 40.0, 1e30]);
        assert!(v[4].is_nan());
    }

    /// Replaces each sine by its angle.
    struct Angles<'a, T> {
        sines: &'a mut [T],
        cosines: &'a [T],
    }

    impl<T: Real> WithSimd for Angles<'_, T> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            let width = size_of::<T::Lanes<S>>() / size_of::<T>();
            for (sines, cosines) in self.sines.chunks_mut(width).zip(self.cosines.chunks(width)) {
                let angle = T::angle(simd, T::load_partial(simd, sines), T::load_partial(simd, cosines));
                T::store_partial(simd, sines, angle);
            }
        }
    }

    #[test]
    fn double_precision_angles_follow_the_arc_tangent() {
        for length in [1.0, 1e-150, 1e150] {
            let turns = (0..=200_000).map(|k| f64::from(k) * PI / 200_000.0);
            let (sines, cosines): (Vec<f64>, Vec<f64>) =
                turns.map(|t| (length * t.sin().max(0.0), length * t.cos())).unzip();
            let mut angles = sines.clone();
            pulp::Arch::new().dispatch(Angles { sines: &mut angles, cosines: &cosines });
            for ((&sine, &cosine), angle) in sines.iter().zip(&cosines).zip(angles) {
                let exact = sine.atan2(cosine);
                let error = (angle - exact).abs();
                assert!(error <= 4.5e-16 * exact, "atan2({sine:e}, {cosine:e}) = {angle}, not {exact}");
            }
        }
        let (mut angles, cosines) = ([1e-300, 1e-9, 0.0, 0.0, 0.0, 5.0], [1.0, -1.0, 0.0, 2.0, -2.0, 0.0]);
        pulp::Arch::new().dispatch(Angles { sines: &mut angles, cosines: &cosines });
        assert_eq!(angles, [1e-300, PI - 1e-9, 0.0, 0.0, PI, FRAC_PI_2]);
    }

    #[test]
    fn single_precision_angles_follow_the_arc_tangent() {
        let turns = (0..=20_000).map(|k| f64::from(k) * std::f64::consts::PI / 20_000.0);
        for length in [1.0, 1e-15, 1e15] {
            let cosines: Vec<f32> = turns.clone().map(|t| (length * t.cos()) as f32).collect();
            let mut angles: Vec<f32> = turns.clone().map(|t| (length * t.sin()).max(0.0) as f32).collect();
            let sines = angles.clone();
            pulp::Arch::new().dispatch(Angles { sines: &mut angles, cosines: &cosines });
            for ((&sine, &cosine), angle) in sines.iter().zip(&cosines).zip(angles) {
                let exact = f64::from(sine).atan2(f64::from(cosine));
                let error = (f64::from(angle) - exact).abs();
                assert!(error <= 2e-7 * exact, "atan2({sine:e}, {cosine:e}) = {angle}, not {exact}");
            }
        }
        // Small angles keep their relative precision, and vectors of length zero have an angle of 0.
        let (mut angles, cosines) = ([1e-30f32, 1e-7, 0.0, 0.0, 0.0], [1.0, -1.0, 0.0, 2.0, -2.0]);
        pulp::Arch::new().dispatch(Angles { sines: &mut angles, cosines: &cosines });
        assert!((angles[0] - 1e-30).abs() < 2e-37, "{:e}", angles[0]);
        let pi = std::f32::consts::PI;
        assert_eq!(angles[1..], [pi - 1e-7, 0.0, 0.0, pi]);
    }

    #[test]
    fn single_precision_tanh_is_relatively_accurate() {
        let x = points();
        let mut y = x.clone();
        f32::squash(&mut y, 0.5, 10.0);
        for (&x, &y) in x.iter().zip(&y) {
            let exact = 10.0 * (x as f64 * 0.5).tanh();
            assert!((y as f64 - exact).abs() <= 5e-7 * exact.abs(), "10 tanh({x} / 2) = {y}, not {exact}");
        }
        let mut v = [f32::INFINITY, f32::NAN, -1e30];
        f32::squash(&mut v, 0.5, 10.0);
        assert!(v[0] == 10.0 && v[1].is_nan() && v[2] == -10.0, "{v:?}");
    }
}
