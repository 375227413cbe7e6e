//! The gradient `dL/da` of the energy, in two passes over the rows: first each row of cells writes the gradient with
//! respect to its edges, every angle once; then each row of particles gathers those of the edges that meet there.
//! Rows write apart from each other, so that the result does not depend on the number of threads.

use super::vector::{angle_gradient, length, scaled};
use super::{Factors, Trial};
use crate::cpu::Real;
use crate::sim::Grid;
use rayon::prelude::*;

/// Gradients with respect to edges, as one row of cells leaves them: shape [H, 4, 3, W].
pub struct GradientRows<T> {
    edges: Vec<T>,
    grid: Grid,
}

/// The vertical edges of this row, from its own stretch, shear and bend.
const VERTICAL: usize = 0;
/// The vertical edges of the next row, from the bend between both.
const NEXT_VERTICAL: usize = 1;
/// The horizontal edges of this row, from their stretch and bend and the shear of the cells below.
const HORIZONTAL: usize = 2;
/// The horizontal edges of the next row, from the shear of the cells above them.
const NEXT_HORIZONTAL: usize = 3;

impl<T: Real> GradientRows<T> {
    /// Working memory for cloths on this grid.
    pub fn new(grid: Grid) -> Self {
        Self { edges: vec![T::zero(); 12 * grid.particles()], grid }
    }

    /// One component of the gradients that row `i` of cells left for one kind of edges, shape \[W\]; `None` outside.
    fn left(&self, i: Option<usize>, kind: usize, component: usize) -> Option<&[T]> {
        let w = self.grid.w;
        i.map(|i| &self.edges[((i * 4 + kind) * 3 + component) * w..][..w])
    }
}

/// `dL/da` of one cloth, `grad` [3, H, W]. At handles only inertia and external work depend on a.
pub fn gradient<T: Real>(trial: &Trial<'_, T>, rows: &mut GradientRows<T>, grad: &mut [T]) {
    let Grid { h, w } = trial.grid;
    assert_eq!(rows.grid, trial.grid, "working memory and cloth share a grid");
    rows.edges.par_chunks_mut(12 * w).enumerate().for_each(|(i, edges)| edge_row(trial, i, edges));
    let rows = &*rows;
    let n = T::of((h * w) as f64);
    grad.par_chunks_mut(w).enumerate().for_each(|(row, grad)| {
        let (component, i) = (row / h, row % h);
        let above = i.checked_sub(1);
        let sources = [
            (rows.left(Some(i), VERTICAL, component), -T::one()),
            (rows.left(above, NEXT_VERTICAL, component), -T::one()),
            (rows.left(above, VERTICAL, component), T::one()),
            (rows.left(i.checked_sub(2), NEXT_VERTICAL, component), T::one()),
        ];
        grad.fill(T::zero());
        for (source, sign) in sources {
            for (grad, &edge) in grad.iter_mut().zip(source.unwrap_or(&[])) {
                *grad = *grad + sign * edge;
            }
        }
        for source in
            [rows.left(Some(i), HORIZONTAL, component), rows.left(above, NEXT_HORIZONTAL, component)]
        {
            let source = source.unwrap_or(&[]);
            for (j, &edge) in source.iter().take(w - 1).enumerate() {
                grad[j] = grad[j] - edge;
                grad[j + 1] = grad[j + 1] + edge;
            }
        }
        let (a, f) = (&trial.a[row * w..][..w], &trial.f[row * w..][..w]);
        for (j, grad) in grad.iter_mut().enumerate() {
            let held = trial.slots[i * w + j] != 0;
            let shape = if held { T::zero() } else { *grad };
            *grad = shape + T::of(trial.grid.mass(i, j)) * (a[j] - f[j]) / n;
        }
    });
}

/// Fills `edges` [4, 3, W] with what row `i` of cells, and the edges that begin in row `i`, contribute.
fn edge_row<T: Real>(trial: &Trial<'_, T>, i: usize, edges: &mut [T]) {
    let Grid { h, w } = trial.grid;
    let Factors { vertical, horizontal, shear, bend } = trial.factors();
    let right_angle = T::of(std::f64::consts::FRAC_PI_2);
    edges.fill(T::zero());
    let mut add = |kind: usize, j: usize, value: [T; 3], factor: T| {
        for (component, value) in scaled(value, factor).into_iter().enumerate() {
            let to = &mut edges[(kind * 3 + component) * w + j];
            *to = *to + value;
        }
    };
    for j in 0..w {
        if i + 1 < h {
            let e = trial.vertical(i, j);
            add(VERTICAL, j, e, vertical * stretch_slope(e));
            if i + 2 < h {
                let (next, this) = angle_gradient(trial.vertical(i + 1, j), e, T::zero());
                add(NEXT_VERTICAL, j, next, bend);
                add(VERTICAL, j, this, bend);
            }
        }
        if j + 1 < w {
            let e = trial.horizontal(i, j);
            add(HORIZONTAL, j, e, horizontal * stretch_slope(e));
            if j + 2 < w {
                let (next, this) = angle_gradient(trial.horizontal(i, j + 1), e, T::zero());
                add(HORIZONTAL, j + 1, next, bend);
                add(HORIZONTAL, j, this, bend);
            }
        }
        if i + 1 < h && j + 1 < w {
            for (k, u) in [(j, trial.vertical(i, j)), (j + 1, trial.vertical(i, j + 1))] {
                for (kind, v) in
                    [(HORIZONTAL, trial.horizontal(i, j)), (NEXT_HORIZONTAL, trial.horizontal(i + 1, j))]
                {
                    let (du, dv) = angle_gradient(u, v, right_angle);
                    add(VERTICAL, k, du, shear);
                    add(kind, j, dv, shear);
                }
            }
        }
    }
}

/// The factor of `e` in the gradient of `(|e| - 1)^2`; 0 where the edge has no length and no direction.
#[inline(always)]
fn stretch_slope<T: Real>(e: [T; 3]) -> T {
    let length = length(e);
    if length > T::zero() { T::of(2.0) * (length - T::one()) / length } else { T::zero() }
}
