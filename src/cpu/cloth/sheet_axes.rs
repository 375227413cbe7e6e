//! The sheet's own axes at each particle, how far forces move it along them, and its edges.
//!
//! A frame starts with these. They are computed along [rows](super::rows), one register at a time.

use super::Trial;
use super::elements::Element;
use super::rows::{Stored, at, cross, dot, load, scaled, vector_at, width};
use crate::cloth::terms::Elastic;
use crate::cloth::{Grid, Mark};
use crate::cpu::Real;
use crate::cpu::matmul::LANES;
use crate::settings::{ARCHING, HANDLE_REACH, HANDLE_SHARE};
use pulp::{Arch, Simd, WithSimd};

/// Vectors shorter than this have no direction.
const SHORTEST: f64 = 1e-12;

pub use crate::settings::AXES;

/// Computes the axes of one cloth.
pub struct SheetAxes<T> {
    grid: Grid,
    stored: Stored,
    /// The factor along the axes of the world, shape [H, W].
    near: Vec<T>,
    /// Edges from the row above, to the row below and to the right, each of shape [3, W'] after `LANES` zeros: so the number before an
    /// edge to the right is that of the edge from the left, 0 for the first particle.
    above: Vec<T>,
    below: Vec<T>,
    right: Vec<T>,
}

impl<T: Real> SheetAxes<T> {
    /// Allocates working memory for a cloth with these `marks` [H, W].
    pub fn new(grid: Grid, marks: &[Mark]) -> Self {
        let stored = Stored::new(grid.w);
        let edges = || vec![T::zero(); LANES + 3 * stored.stride];
        let near = nearness(grid, marks).into_iter().map(|near| T::of(1.0 - HANDLE_SHARE * near)).collect();
        Self { grid, stored, near, above: edges(), below: edges(), right: edges() }
    }

    /// Sets `axes` [16, H, W] to three orthogonal vectors t_1, t_2 and n per particle at the positions of `trial`, a factor along the
    /// axes of the world, and the edges to (i+1, j) and to (i, j+1).
    ///
    /// t_1 and t_2 span the tangent plane and are closest to the directions in which i and j grow; n is their normal. A
    /// particle whose neighbours span no plane, or that the cloth doesn't have, gets the axes of the world.
    ///
    /// A vector's length says how far a force takes the particle along it, compared with a flat sheet of its material. It is
    /// `|t_1| = |t_2| = near`, the factor along the axes of the world, which is below 1 next to a handle. A curved sheet is an arch: with
    /// the coefficients k of its stretch and the changes c_1 and c_2 from one edge to the next along either axis,
    /// `|n| = near (1 + ARCHING (k_1 c_1^2 + k_2 c_2^2))^(-1/2)`.
    ///
    /// An edge's vector is its direction times the root of its stiffness, so that a displacement d adds `(edge . d)^2 / 2` to the
    /// energy. It is 0 if the cloth doesn't have the edge.
    pub fn compute(&mut self, trial: &Trial<'_, T>, axes: &mut [T]) {
        assert_eq!(self.grid, trial.grid, "working memory and cloth share a grid");
        Arch::new().dispatch(Rows { work: self, trial, axes });
    }
}

/// Returns `1 / (1 + d)` for the distance d [edges of the grid] of the handle nearest to each particle, 0 if there is none within
/// [`HANDLE_REACH`] rows and columns.
fn nearness(grid: Grid, marks: &[Mark]) -> Vec<f64> {
    let range = |at: usize, count: usize| at.saturating_sub(HANDLE_REACH)..(at + HANDLE_REACH + 1).min(count);
    let mut near = vec![0.0_f64; grid.particles()];
    for handle in (0..grid.particles()).filter(|&p| marks[p].is_handle()) {
        let (i, j) = (handle / grid.w, handle % grid.w);
        for k in range(i, grid.h) {
            for l in range(j, grid.w) {
                let squared = i.abs_diff(k).pow(2) + j.abs_diff(l).pow(2);
                let near = &mut near[k * grid.w + l];
                *near = near.max((1.0 + (squared as f64).sqrt()).recip());
            }
        }
    }
    near
}

/// All rows of a cloth.
struct Rows<'a, 'b, T> {
    work: &'a mut SheetAxes<T>,
    trial: &'a Trial<'b, T>,
    axes: &'a mut [T],
}

impl<T: Real> WithSimd for Rows<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { work, trial, axes } = self;
        let &mut SheetAxes { stored, ref near, ref mut above, ref mut below, ref mut right, .. } = work;
        let (Grid { h, w }, n) = (trial.grid, trial.grid.particles());
        let elastic = Elastic::new(trial.grid, trial.material, trial.damping);
        let roots =
            [elastic.vertical, elastic.horizontal].map(|e| (2.0 * (1.0 + trial.damping) * e.factor).sqrt());
        let arching = trial.material.stretches().map(|k| ARCHING * k);
        let (zero, one) = (T::splat(simd, T::zero()), T::splat(simd, T::one()));
        let world = [[one, zero, zero], [zero, one, zero]];
        below.fill(T::zero());
        for i in 0..h {
            std::mem::swap(above, below);
            if i + 1 < h {
                load(simd, trial, (i, w, w), stored, &mut below[LANES..]);
            } else {
                below.fill(T::zero());
            }
            load(simd, trial, (i, 1, w - 1), stored, &mut right[LANES..]);
            let factors = [Element::Down, Element::Right].map(|element| trial.stiffness(i, element));
            for register in 0..w.div_ceil(width::<T, S>()) {
                let place = register * width::<T, S>();
                let (to, stride) = (LANES + place, stored.stride);
                let u = [vector_at::<T, S>(above, to, stride), vector_at::<T, S>(below, to, stride)];
                let v = [vector_at::<T, S>(right, to - 1, stride), vector_at::<T, S>(right, to, stride)];
                let ([t_1, t_2], exist) = tangents::<T, S>(simd, sum::<T, S>(simd, u), sum::<T, S>(simd, v));
                let tangents =
                    [either::<T, S>(simd, exist, t_1, world[0]), either::<T, S>(simd, exist, t_2, world[1])];
                let near = T::load_partial(simd, &near[i * w + place..][..w - place]);
                let arching = [T::splat(simd, T::of(arching[0])), T::splat(simd, T::of(arching[1]))];
                let arch = T::fma(simd, arching[1], bend::<T, S>(simd, v), one);
                let arch = T::fma(simd, arching[0], bend::<T, S>(simd, u), arch);
                let across = T::div_lanes(simd, near, T::sqrt_lanes(simd, arch));
                let normal = cross::<T, S>(simd, tangents[0], tangents[1]);
                let mut stiff = [u[1], v[1]];
                for k in 0..2 {
                    let (direction, exists) = unit::<T, S>(simd, stiff[k]);
                    let mut root = T::splat(simd, T::of(roots[k]));
                    if let Some(factors) = factors[k] {
                        root = T::mul_lanes(simd, root, T::sqrt_lanes(simd, at::<T, S>(factors, place)));
                    }
                    stiff[k] = either::<T, S>(simd, exists, scaled::<T, S>(simd, direction, root), [zero; 3]);
                }
                let fields = [
                    scaled::<T, S>(simd, tangents[0], near),
                    scaled::<T, S>(simd, tangents[1], near),
                    scaled::<T, S>(simd, normal, across),
                    stiff[0],
                    stiff[1],
                ];
                for component in 0..AXES {
                    let lanes = match component {
                        0..9 => fields[component / 3][component % 3],
                        9 => near,
                        _ => fields[(component - 1) / 3][(component - 1) % 3],
                    };
                    let to = &mut axes[component * n + i * w + place..][..w - place];
                    T::store_partial(simd, to, lanes);
                }
            }
        }
    }
}

/// A register of each component of some vectors.
type Vectors<T, S> = [<T as Real>::Lanes<S>; 3];

#[inline(always)]
fn sum<T: Real, S: Simd>(simd: S, [u, w]: [Vectors<T, S>; 2]) -> Vectors<T, S> {
    [T::add_lanes(simd, u[0], w[0]), T::add_lanes(simd, u[1], w[1]), T::add_lanes(simd, u[2], w[2])]
}

#[inline(always)]
fn difference<T: Real, S: Simd>(simd: S, u: Vectors<T, S>, w: Vectors<T, S>) -> Vectors<T, S> {
    [T::sub_lanes(simd, u[0], w[0]), T::sub_lanes(simd, u[1], w[1]), T::sub_lanes(simd, u[2], w[2])]
}

/// Selects `then` where `which` is 1, `other` where it is 0.
#[inline(always)]
fn either<T: Real, S: Simd>(
    simd: S,
    which: T::Lanes<S>,
    then: Vectors<T, S>,
    other: Vectors<T, S>,
) -> Vectors<T, S> {
    let pair = (which, T::splat(simd, T::zero()));
    [
        T::select_greater(simd, pair, then[0], other[0]),
        T::select_greater(simd, pair, then[1], other[1]),
        T::select_greater(simd, pair, then[2], other[2]),
    ]
}

/// Returns the unit vectors of `u`, and 1 where there is one: where the length is neither 0 nor infinite. Elsewhere 0, and
/// the vector may be anything.
#[inline(always)]
fn unit<T: Real, S: Simd>(simd: S, u: Vectors<T, S>) -> (Vectors<T, S>, T::Lanes<S>) {
    let (zero, one) = (T::splat(simd, T::zero()), T::splat(simd, T::one()));
    let length = T::sqrt_lanes(simd, dot::<T, S>(simd, u, u));
    let exists = T::select_greater(simd, (T::splat(simd, T::max_value()), length), one, zero);
    let exists = T::select_greater(simd, (length, T::splat(simd, T::of(SHORTEST))), exists, zero);
    (scaled::<T, S>(simd, u, T::div_lanes(simd, one, length)), exists)
}

/// Returns the orthonormal pairs in the planes of u and v that are closest to both, with which they make equal angles, and 1 where
/// there are such, else 0.
#[inline(always)]
fn tangents<T: Real, S: Simd>(
    simd: S,
    u: Vectors<T, S>,
    v: Vectors<T, S>,
) -> ([Vectors<T, S>; 2], T::Lanes<S>) {
    let ((u, of_u), (v, of_v)) = (unit::<T, S>(simd, u), unit::<T, S>(simd, v));
    let (s, of_s) = unit::<T, S>(simd, sum::<T, S>(simd, [u, v]));
    // In the plane and orthogonal to s, towards u.
    let along = scaled::<T, S>(simd, s, dot::<T, S>(simd, u, s));
    let (d, of_d) = unit::<T, S>(simd, difference::<T, S>(simd, u, along));
    let (_, of_plane) = unit::<T, S>(simd, cross::<T, S>(simd, u, v));
    let half = T::splat(simd, T::of(std::f64::consts::FRAC_1_SQRT_2));
    let pair = [
        scaled::<T, S>(simd, sum::<T, S>(simd, [s, d]), half),
        scaled::<T, S>(simd, difference::<T, S>(simd, s, d), half),
    ];
    let of_both = T::mul_lanes(simd, of_u, of_v);
    let of_pair = T::mul_lanes(simd, of_s, of_d);
    (pair, T::mul_lanes(simd, T::mul_lanes(simd, of_both, of_pair), of_plane))
}

/// Returns the squares of the changes from one edge to the next, 0 where one is missing (of length 0) or where it is not finite.
#[inline(always)]
fn bend<T: Real, S: Simd>(simd: S, [e, next]: [Vectors<T, S>; 2]) -> T::Lanes<S> {
    let zero = T::splat(simd, T::zero());
    let change = difference::<T, S>(simd, next, e);
    let square = dot::<T, S>(simd, change, change);
    let square = T::select_greater(simd, (T::splat(simd, T::max_value()), square), square, zero);
    let square = T::select_greater(simd, (dot::<T, S>(simd, e, e), zero), square, zero);
    T::select_greater(simd, (dot::<T, S>(simd, next, next), zero), square, zero)
}
