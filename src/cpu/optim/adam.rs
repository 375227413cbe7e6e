//! Adam with bias correction, restarted every frame.

use super::Minimizer;
use crate::cpu::Real;
use crate::settings::AdamSettings;
use pulp::{Arch, Simd, WithSimd};

/// Adam: `a <- a - rate m / (sqrt(v) + epsilon)`, with m and v the bias-corrected moments of the frame's
/// gradients.
pub struct Adam<T> {
    settings: AdamSettings,
    mean: Vec<T>,
    square: Vec<T>,
    /// Steps taken in this frame.
    steps: i32,
}

impl<T: Real> Adam<T> {
    /// Builds Adam for `len` unknowns.
    pub fn new(settings: AdamSettings, len: usize) -> Self {
        let zeros = || vec![T::zero(); len];
        Self { settings, mean: zeros(), square: zeros(), steps: 0 }
    }
}

impl<T: Real> Minimizer<T> for Adam<T> {
    fn begin_frame(&mut self) {
        self.mean.fill(T::zero());
        self.square.fill(T::zero());
        self.steps = 0;
    }

    fn step(&mut self, grad: &[T], _norms: &[f64], a: &mut [T]) {
        self.steps += 1;
        let AdamSettings { rate, beta1, beta2, epsilon } = self.settings;
        let Self { mean, square, steps, .. } = self;
        let root = (1.0 - beta2.powi(*steps)).sqrt().recip();
        Arch::new().dispatch(Step {
            betas: [beta1, beta2].map(T::of),
            weights: [beta1, beta2].map(|beta| T::of(1.0 - beta)),
            rate: T::of(rate / (1.0 - beta1.powi(*steps))),
            root: T::of(root),
            epsilon: T::of(epsilon),
            grad,
            mean,
            square,
            a,
        });
    }
}

/// One step for all unknowns, one register at a time.
struct Step<'a, T> {
    betas: [T; 2],
    /// 1 - beta, which single precision would make too large by 5e-5 of itself.
    weights: [T; 2],
    /// The rate, with the bias correction of the mean.
    rate: T,
    /// The bias correction of the root mean square.
    root: T,
    epsilon: T,
    grad: &'a [T],
    mean: &'a mut [T],
    square: &'a mut [T],
    a: &'a mut [T],
}

impl<T: Real> WithSimd for Step<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { betas: [beta1, beta2], weights: [new1, new2], rate, root, epsilon, grad, mean, square, a } =
            self;
        let [new1, new2] = [T::splat(simd, new1), T::splat(simd, new2)];
        let [beta1, beta2] = [T::splat(simd, beta1), T::splat(simd, beta2)];
        let [rate, root, epsilon] = [T::splat(simd, rate), T::splat(simd, root), T::splat(simd, epsilon)];
        let mut place = 0;
        while place < a.len() {
            let g = T::load_partial(simd, &grad[place..]);
            let old = T::mul_lanes(simd, beta1, T::load_partial(simd, &mean[place..]));
            let m = T::add_lanes(simd, old, T::mul_lanes(simd, new1, g));
            let old = T::mul_lanes(simd, beta2, T::load_partial(simd, &square[place..]));
            let v = T::add_lanes(simd, old, T::mul_lanes(simd, T::mul_lanes(simd, new2, g), g));
            T::store_partial(simd, &mut mean[place..], m);
            T::store_partial(simd, &mut square[place..], v);
            let below = T::add_lanes(simd, T::mul_lanes(simd, root, T::sqrt_lanes(simd, v)), epsilon);
            let change = T::div_lanes(simd, T::mul_lanes(simd, rate, m), below);
            let next = T::sub_lanes(simd, T::load_partial(simd, &a[place..]), change);
            T::store_partial(simd, &mut a[place..], next);
            place += size_of::<T::Lanes<S>>() / size_of::<T>();
        }
    }
}
