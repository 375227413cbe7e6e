//! The two scalar types of the CPU path, and their operations on vector registers.

use super::compiled::Compiled;
use super::elementary;
use num_traits::Float;
use pulp::Simd;
use realfft::FftNum;

/// A real number type of the CPU path: f64 defines what is correct, f32 is fast. There are no others.
pub trait Real: Float + FftNum + Default + std::iter::Sum + Compiled {
    /// A vector register full of numbers.
    type Lanes<S: Simd>: Copy;

    /// Returns the whole registers of a slice, without the remainder.
    fn lanes<S: Simd>(values: &[Self]) -> &[Self::Lanes<S>];
    /// Returns the whole registers of a slice for writing, as [`lanes`](Self::lanes).
    fn lanes_mut<S: Simd>(values: &mut [Self]) -> &mut [Self::Lanes<S>];
    /// Returns a register with `value` in every lane.
    fn splat<S: Simd>(simd: S, value: Self) -> Self::Lanes<S>;
    /// Returns `a b + c`, fused if the machine supports it.
    fn fma<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>, c: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Returns `a + b`.
    fn add_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Returns `a - b`.
    fn sub_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Returns `a b`.
    fn mul_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Returns `a / b`.
    fn div_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Returns the square root.
    fn sqrt_lanes<S: Simd>(simd: S, a: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Selects `then` where the first of `pair` is greater than the second, `other` elsewhere.
    fn select_greater<S: Simd>(
        simd: S,
        pair: (Self::Lanes<S>, Self::Lanes<S>),
        then: Self::Lanes<S>,
        other: Self::Lanes<S>,
    ) -> Self::Lanes<S>;
    /// Returns the angle in 0..=pi of a nonnegative sine and a cosine, `atan2(sine, cosine)`, whatever their
    /// common scale.
    fn angle<S: Simd>(simd: S, sine: Self::Lanes<S>, cosine: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Loads the first numbers of a slice, with zeros past its end.
    fn load_partial<S: Simd>(simd: S, values: &[Self]) -> Self::Lanes<S>;
    /// Stores into the first numbers of a slice, as many as it has.
    fn store_partial<S: Simd>(simd: S, values: &mut [Self], lanes: Self::Lanes<S>);
    /// Returns the larger of two, lane by lane.
    fn max_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S>;
    /// Returns the sum of all lanes.
    fn reduce_sum<S: Simd>(simd: S, a: Self::Lanes<S>) -> Self;

    /// Replaces each number by its exact GELU, `x / 2 (1 + erf(x / sqrt 2))`.
    fn gelu(values: &mut [Self]);
    /// Applies [`Real::gelu`] and sets `slopes` to its derivative at the original `values`.
    fn gelu_and_slope(values: &mut [Self], slopes: &mut [Self]);
    /// Replaces each number `x` by `amplitude tanh(x factor)`.
    fn squash(values: &mut [Self], factor: Self, amplitude: Self);

    /// Converts from f64, rounding to nearest.
    fn of(value: f64) -> Self;
    /// Converts to f64.
    fn f64(self) -> f64;
}

macro_rules! registers {
    ($real:ty, $lanes:ident, $as:ident, $as_mut:ident, $splat:ident, $fma:ident, $max:ident, $sum:ident,
     $add:ident, $sub:ident, $mul:ident, $div:ident, $sqrt:ident, $greater:ident, $select:ident, $load:ident,
     $store:ident) => {
        type Lanes<S: Simd> = S::$lanes;

        #[inline(always)]
        fn lanes<S: Simd>(values: &[Self]) -> &[Self::Lanes<S>] {
            S::$as(values).0
        }
        #[inline(always)]
        fn lanes_mut<S: Simd>(values: &mut [Self]) -> &mut [Self::Lanes<S>] {
            S::$as_mut(values).0
        }
        #[inline(always)]
        fn splat<S: Simd>(simd: S, value: Self) -> Self::Lanes<S> {
            simd.$splat(value)
        }
        #[inline(always)]
        fn fma<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>, c: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$fma(a, b, c)
        }
        #[inline(always)]
        fn max_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$max(a, b)
        }
        #[inline(always)]
        fn reduce_sum<S: Simd>(simd: S, a: Self::Lanes<S>) -> Self {
            simd.$sum(a)
        }
        #[inline(always)]
        fn add_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$add(a, b)
        }
        #[inline(always)]
        fn sub_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$sub(a, b)
        }
        #[inline(always)]
        fn mul_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$mul(a, b)
        }
        #[inline(always)]
        fn div_lanes<S: Simd>(simd: S, a: Self::Lanes<S>, b: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$div(a, b)
        }
        #[inline(always)]
        fn sqrt_lanes<S: Simd>(simd: S, a: Self::Lanes<S>) -> Self::Lanes<S> {
            simd.$sqrt(a)
        }
        #[inline(always)]
        fn select_greater<S: Simd>(
            simd: S,
            (a, b): (Self::Lanes<S>, Self::Lanes<S>),
            then: Self::Lanes<S>,
            other: Self::Lanes<S>,
        ) -> Self::Lanes<S> {
            simd.$select(simd.$greater(a, b), then, other)
        }
        #[inline(always)]
        fn load_partial<S: Simd>(simd: S, values: &[Self]) -> Self::Lanes<S> {
            let whole = S::$as(values).0;
            if whole.is_empty() { simd.$load(values) } else { whole[0] }
        }
        #[inline(always)]
        fn store_partial<S: Simd>(simd: S, values: &mut [Self], lanes: Self::Lanes<S>) {
            let whole = S::$as_mut(values).0;
            if whole.is_empty() { simd.$store(values, lanes) } else { whole[0] = lanes }
        }
        #[inline(always)]
        fn of(value: f64) -> Self {
            value as $real
        }
        #[inline(always)]
        fn f64(self) -> f64 {
            self as f64
        }
    };
}

impl Real for f64 {
    registers!(
        f64,
        f64s,
        as_simd_f64s,
        as_mut_simd_f64s,
        splat_f64s,
        mul_add_e_f64s,
        max_f64s,
        reduce_sum_f64s,
        add_f64s,
        sub_f64s,
        mul_f64s,
        div_f64s,
        sqrt_f64s,
        greater_than_f64s,
        select_f64s,
        partial_load_f64s,
        partial_store_f64s
    );

    fn gelu(values: &mut [Self]) {
        for x in values {
            *x = 0.5 * *x * libm::erfc(-*x * std::f64::consts::FRAC_1_SQRT_2);
        }
    }

    fn gelu_and_slope(values: &mut [Self], slopes: &mut [Self]) {
        for (x, slope) in values.iter_mut().zip(slopes) {
            let below = 0.5 * libm::erfc(-*x * std::f64::consts::FRAC_1_SQRT_2);
            let density = (-0.5 * *x * *x).exp() / std::f64::consts::TAU.sqrt();
            *slope = below + *x * density;
            *x *= below;
        }
    }

    fn squash(values: &mut [Self], factor: Self, amplitude: Self) {
        for x in values {
            *x = amplitude * (*x * factor).tanh();
        }
    }

    #[inline(always)]
    fn angle<S: Simd>(simd: S, sine: S::f64s, cosine: S::f64s) -> S::f64s {
        elementary::double_angle(simd, sine, cosine)
    }
}

impl Real for f32 {
    registers!(
        f32,
        f32s,
        as_simd_f32s,
        as_mut_simd_f32s,
        splat_f32s,
        mul_add_e_f32s,
        max_f32s,
        reduce_sum_f32s,
        add_f32s,
        sub_f32s,
        mul_f32s,
        div_f32s,
        sqrt_f32s,
        greater_than_f32s,
        select_f32s,
        partial_load_f32s,
        partial_store_f32s
    );

    fn gelu(values: &mut [Self]) {
        elementary::gelu(values);
    }

    fn gelu_and_slope(values: &mut [Self], slopes: &mut [Self]) {
        elementary::gelu_and_slope(values, slopes);
    }

    fn squash(values: &mut [Self], factor: Self, amplitude: Self) {
        elementary::squash(values, factor, amplitude);
    }

    #[inline(always)]
    fn angle<S: Simd>(simd: S, sine: S::f32s, cosine: S::f32s) -> S::f32s {
        elementary::angle(simd, sine, cosine)
    }
}
