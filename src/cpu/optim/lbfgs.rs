//! Limited-memory BFGS by the two-loop recursion, with steps of length 1 or along secants, and a history that is
//! cleared every frame. The initial inverse Hessian is a multiple of the identity, or that of the cloth at rest, which
//! makes it the quasi-Newton method.

use super::{FactoredRestHessian, InverseHessian, Minimizer, RestHessian, dot};
use crate::Result;
use crate::cloth::Model;
use crate::cpu::Real;
use crate::settings::{LONGEST, LbfgsSettings, SHORTEST};
use rayon::prelude::*;

/// L-BFGS for a batch of cloths, each with its own history.
pub struct Lbfgs<T> {
    cloths: Vec<(History<T>, Initial<T>)>,
    curvature: f64,
    /// Whether steps are corrected to the minimum of their secants.
    secant: bool,
    /// Number of unknowns per cloth.
    len: usize,
}

/// The initial inverse Hessian. If `None`, the identity, scaled by the newest pair.
type Initial<T> = Option<Box<dyn InverseHessian<T>>>;

/// The L-BFGS history of one cloth.
pub(in crate::cpu) struct History<T> {
    /// Pairs of step s and gradient difference y, with `1 / (s . y)`. Only the first `pairs` are valid,
    /// oldest first.
    ring: Vec<Pair<T>>,
    pairs: usize,
    /// The gradient at the last iterate, and the step taken from there.
    last_grad: Vec<T>,
    last_step: Vec<T>,
    /// Whether that step has been taken.
    started: bool,
    /// Multiple of the direction that the next step along a secant begins with, at most 1.
    length: f64,
    /// The gradient at the iterate, then the result of [`History::compute_direction`].
    pub direction: Vec<T>,
}

struct Pair<T> {
    s: Vec<T>,
    y: Vec<T>,
    inverse: f64,
}

impl<T: Real> Lbfgs<T> {
    /// Builds L-BFGS for `batch` cloths of `len` unknowns each.
    pub fn new(settings: LbfgsSettings, len: usize, batch: usize) -> Self {
        let LbfgsSettings { history, curvature } = settings;
        let cloths = (0..batch).map(|_| (History::new(history, len), None)).collect();
        Self { cloths, curvature, secant: false, len }
    }

    /// Corrects steps to the minimum of their secants ([`Length::Secant`](crate::sim::Length::Secant)).
    pub fn along_secants(self) -> Self {
        Self { secant: true, ..self }
    }

    /// Builds the quasi-Newton method for the cloths of `model`: L-BFGS that starts from their Hessians at
    /// rest, either `factored` or inverted by a cosine transform. Fails if there is not enough
    /// memory for the factors.
    pub fn from_rest(settings: LbfgsSettings, factored: bool, model: &Model) -> Result<Self> {
        let LbfgsSettings { history, curvature } = settings;
        let len = 3 * model.grid.particles();
        let cloth = |cloth| -> Result<_> {
            let initial: Box<dyn InverseHessian<T>> = match factored {
                true => Box::new(FactoredRestHessian::new(model.grid, cloth)?),
                false => Box::new(RestHessian::new(model.grid, cloth)),
            };
            Ok((History::new(history, len), Some(initial)))
        };
        let cloths = model.cloths.iter().map(cloth).collect::<Result<_>>()?;
        Ok(Self { cloths, curvature, secant: false, len })
    }
}

impl<T: Real> Minimizer<T> for Lbfgs<T> {
    fn begin_frame(&mut self) {
        self.cloths.iter_mut().for_each(|(history, _)| history.clear());
    }

    fn step(&mut self, grad: &[T], _norms: &[f64], a: &mut [T]) {
        let (curvature, secant) = (self.curvature, self.secant);
        let batch = grad.par_chunks(self.len).zip(a.par_chunks_mut(self.len));
        self.cloths.par_iter_mut().zip(batch).for_each(|((history, initial), (grad, a))| {
            history.remember(grad, curvature);
            if secant {
                history.move_to_minimum_of_secant(a);
            }
            history.compute_direction(initial.as_deref_mut());
            history.step(T::of(history.length), a);
        });
    }
}

impl<T: Real> History<T> {
    /// Builds an empty history of at most `pairs` pairs for `len` unknowns.
    pub fn new(pairs: usize, len: usize) -> Self {
        let zeros = || vec![T::zero(); len];
        let pair = |_| Pair { s: zeros(), y: zeros(), inverse: 0.0 };
        Self {
            ring: (0..pairs).map(pair).collect(),
            pairs: 0,
            last_grad: zeros(),
            last_step: zeros(),
            started: false,
            length: 1.0,
            direction: zeros(),
        }
    }

    /// Forgets all pairs and the last step.
    pub fn clear(&mut self) {
        self.pairs = 0;
        self.started = false;
        self.length = 1.0;
    }

    /// Takes the gradient at the iterate, and stores the pair of the last step, if any, that led there, provided
    /// that its curvature suffices. A full ring drops its oldest pair.
    pub fn remember(&mut self, grad: &[T], curvature: f64) {
        self.direction.copy_from_slice(grad);
        if !self.started {
            return;
        }
        let product: f64 = (self.last_step.iter().zip(grad).zip(&self.last_grad))
            .map(|((&s, &g), &last)| s.f64() * (g - last).f64())
            .sum();
        if product.is_nan() || product <= curvature || self.ring.is_empty() {
            return;
        }
        if self.pairs == self.ring.len() {
            self.ring.rotate_left(1);
        } else {
            self.pairs += 1;
        }
        let pair = &mut self.ring[self.pairs - 1];
        pair.inverse = product.recip();
        pair.s.copy_from_slice(&self.last_step);
        for ((y, &g), &last) in pair.y.iter_mut().zip(grad).zip(&self.last_grad) {
            *y = g - last;
        }
    }

    /// Moves the iterate `a` and its gradient along the last step, if any, to the minimum of the parabola that has the
    /// slopes at its ends; the gradient is interpolated. The next step begins longer or shorter by as much.
    fn move_to_minimum_of_secant(&mut self, a: &mut [T]) {
        if !self.started {
            return;
        }
        let before = dot(&self.last_grad, &self.last_step);
        let rise = dot(&self.direction, &self.last_step) - before;
        let factor = -before / rise;
        if rise.is_nan() || rise <= 0.0 || !factor.is_finite() {
            return;
        }
        let more = T::of(factor.clamp(0.0, LONGEST) - 1.0);
        add_scaled(a, &self.last_step, more.f64());
        for (grad, &last) in self.direction.iter_mut().zip(&self.last_grad) {
            *grad = *grad + more * (*grad - last);
        }
        self.length = (self.length * factor.clamp(SHORTEST, LONGEST)).min(1.0);
    }

    /// Sets `direction` to the inverse Hessian times the gradient. The inverse Hessian is `initial`, updated by the
    /// pairs of the history.
    pub fn compute_direction(&mut self, initial: Option<&mut (dyn InverseHessian<T> + 'static)>) {
        let pairs = &self.ring[..self.pairs];
        let direction = &mut self.direction;
        self.last_grad.copy_from_slice(direction);
        let mut weights = vec![0.0; pairs.len()];
        for (pair, weight) in pairs.iter().zip(&mut weights).rev() {
            *weight = pair.inverse * dot(&pair.s, direction);
            add_scaled(direction, &pair.y, -*weight);
        }
        if let Some(initial) = initial {
            initial.apply(direction);
        } else if let Some(newest) = pairs.last() {
            let gamma = T::of((newest.inverse * dot(&newest.y, &newest.y)).recip());
            direction.iter_mut().for_each(|d| *d = *d * gamma);
        }
        for (pair, weight) in pairs.iter().zip(&weights) {
            let correction = pair.inverse * dot(&pair.y, direction);
            add_scaled(direction, &pair.s, weight - correction);
        }
    }

    /// Steps against the direction: adds `-length direction` to `a`, the iterate at which the direction was
    /// computed.
    pub fn step(&mut self, length: T, a: &mut [T]) {
        for ((a, step), &d) in a.iter_mut().zip(&mut self.last_step).zip(&self.direction) {
            *step = -length * d;
            *a = *a + *step;
        }
        self.started = true;
    }
}

fn add_scaled<T: Real>(to: &mut [T], u: &[T], factor: f64) {
    let factor = T::of(factor);
    for (to, &u) in to.iter_mut().zip(u) {
        *to = *to + factor * u;
    }
}
