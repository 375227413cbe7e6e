//! The Hessian of the energy with respect to positions, term by term.

use super::vector::{cross, dot, length, scaled};
use super::{Factors, Trial};
use crate::sim::Grid;
use std::f64::consts::FRAC_PI_2;

/// A block of the Hessian: second derivatives with respect to the positions of two particles.
pub type Block = [[f64; 3]; 3];

/// How much is left out, term by term, of what could be negative: a share from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Projection(pub f64);

impl Projection {
    /// The Hessian itself, which away from a minimum may have directions of negative curvature.
    pub const NONE: Self = Self(0.0);
    /// Never less than zero along any direction.
    pub const FULL: Self = Self(1.0);

    /// `value` without this share of what is below zero.
    fn of(self, value: f64) -> f64 {
        value - self.0 * value.min(0.0)
    }
}

/// Sines below this are those of parallel edges.
const PARALLEL: f64 = 1e-9;

/// Calls `add(p, q, block)` with what each term of the shape's energy (stretch, shear, bend) contributes to the block of
/// particles p and q, for both orders of a pair; handles are not left out.
pub fn hessian(trial: &Trial<'_, f64>, projection: Projection, mut add: impl FnMut(usize, usize, &Block)) {
    let Grid { h, w } = trial.grid;
    let Factors { vertical, horizontal, shear, bend } = trial.factors();
    let edge = |p: usize, q: usize| Edge { ends: [p, q], vector: trial.edge(p, q) };
    let down = |i: usize, j: usize| edge(i * w + j, (i + 1) * w + j);
    let across = |i: usize, j: usize| edge(i * w + j, i * w + j + 1);
    let mut stretched = |e: Edge, factor: f64| {
        let block = stretch_block(e.vector, factor, projection);
        spread((&e, &e), &block, &mut add);
    };
    for i in 0..h {
        for j in 0..w {
            if i + 1 < h {
                stretched(down(i, j), vertical);
            }
            if j + 1 < w {
                stretched(across(i, j), horizontal);
            }
        }
    }
    let mut bent = |u: Edge, w: Edge, (rest, factor): (f64, f64)| {
        let [uu, uw, ww] = angle_blocks((u.vector, w.vector), rest, factor, projection);
        spread((&u, &u), &uu, &mut add);
        spread((&w, &w), &ww, &mut add);
        spread((&u, &w), &uw, &mut add);
        spread((&w, &u), &transposed(&uw), &mut add);
    };
    for i in 0..h {
        for j in 0..w {
            if i + 2 < h {
                bent(down(i + 1, j), down(i, j), (0.0, bend));
            }
            if j + 2 < w {
                bent(across(i, j + 1), across(i, j), (0.0, bend));
            }
            if i + 1 < h && j + 1 < w {
                for k in [j, j + 1] {
                    for l in [i, i + 1] {
                        bent(down(i, k), across(l, j), (FRAC_PI_2, shear));
                    }
                }
            }
        }
    }
}

/// An edge from one particle to another.
struct Edge {
    ends: [usize; 2],
    vector: [f64; 3],
}

/// Adds the block of two edges to the blocks of their ends: an edge is its second end minus its first.
fn spread((u, w): (&Edge, &Edge), block: &Block, add: &mut impl FnMut(usize, usize, &Block)) {
    let opposite = block.map(|row| row.map(|v| -v));
    let [[u0, u1], [w0, w1]] = [u.ends, w.ends];
    add(u0, w0, block);
    add(u1, w1, block);
    add(u0, w1, &opposite);
    add(u1, w0, &opposite);
}

/// Second derivatives of `factor (|e| - 1)^2`: 2 along the edge, and 2 (1 - 1 / |e|) across it, which is negative for a
/// compressed one.
fn stretch_block(e: [f64; 3], factor: f64, projection: Projection) -> Block {
    let l = length(e);
    if l == 0.0 {
        return [[0.0; 3]; 3];
    }
    let across = projection.of(1.0 - 1.0 / l);
    let d = scaled(e, 1.0 / l);
    let mut block = scaled_outer(d, d, 2.0 * factor * (1.0 - across));
    (0..3).for_each(|k| block[k][k] += 2.0 * factor * across);
    block
}

/// Second derivatives of `factor (t - rest)^2`, t the angle between u and w: with respect to u twice, u and w, w twice.
///
/// With the unit normal n of their plane, m_u the unit vector across u towards w, and m_w that across w towards u,
/// `dt/du = -m_u / |u|`, `d2t/du2 = (cot t nn' + m_u u' + u m_u') / |u|^2` (u of length 1) and `d2t/du dw = -nn' / (|u| |w|
/// sin t)`. The part along n of the whole is `s [[cos t, -1], [-1, cos t]]` with `s = (t - rest) / sin t`, whose eigenvalues
/// are `s (cos t + 1)` and `s (cos t - 1)`; the projection keeps the positive ones and leaves the products of m and u out.
fn angle_blocks((u, w): ([f64; 3], [f64; 3]), rest: f64, factor: f64, projection: Projection) -> [Block; 3] {
    let (lu, lw) = (length(u), length(w));
    if lu == 0.0 || lw == 0.0 {
        return [[[0.0; 3]; 3]; 3];
    }
    let (u, w) = (scaled(u, 1.0 / lu), scaled(w, 1.0 / lw));
    let c = cross(u, w);
    let (sine, cosine) = (length(c), dot(u, w));
    let delta = sine.atan2(cosine) - rest;
    // Between parallel edges every normal will do; there (t - 0) / sin t is 1.
    let (n, s) = match sine > PARALLEL {
        true => (scaled(c, 1.0 / sine), delta / sine),
        false if rest == 0.0 && cosine > 0.0 => (any_normal(u), 1.0),
        false => (any_normal(u), 0.0),
    };
    let (mu, mw) = (cross(n, u), cross(w, n));
    let [sum, difference] = [s * (cosine - 1.0), s * (cosine + 1.0)].map(|value| projection.of(value));
    let radial = (1.0 - projection.0) * delta;
    let own = |m: [f64; 3], e: [f64; 3], l: f64| {
        let factor = 2.0 * factor / (l * l);
        let mut block = scaled_outer(m, m, factor);
        add_outer(&mut block, n, n, factor * 0.5 * (sum + difference));
        add_outer(&mut block, m, e, factor * radial);
        add_outer(&mut block, e, m, factor * radial);
        block
    };
    let both = 2.0 * factor / (lu * lw);
    let mut mixed = scaled_outer(mu, mw, both);
    add_outer(&mut mixed, n, n, both * 0.5 * (sum - difference));
    [own(mu, u, lu), mixed, own(mw, w, lw)]
}

/// A unit vector across the unit vector `u`.
fn any_normal(u: [f64; 3]) -> [f64; 3] {
    let axis = if u[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let c = cross(u, axis);
    scaled(c, 1.0 / length(c))
}

fn scaled_outer(u: [f64; 3], w: [f64; 3], factor: f64) -> Block {
    u.map(|u| w.map(|w| factor * u * w))
}

fn add_outer(block: &mut Block, u: [f64; 3], w: [f64; 3], factor: f64) {
    for (row, u) in block.iter_mut().zip(u) {
        for (to, w) in row.iter_mut().zip(w) {
            *to += factor * u * w;
        }
    }
}

fn transposed(block: &Block) -> Block {
    [0, 1, 2].map(|k| [0, 1, 2].map(|l| block[l][k]))
}
