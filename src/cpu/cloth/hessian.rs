//! The Hessian of the elastic energy (stretch, shear, bend) with respect to positions, computed along
//! [rows](super::rows) one register at a time: the vectorised form of the second derivatives in [`terms`], checked against
//! the plain one.
//!
//! A particle shares terms with twelve others, and only those blocks are computed term by term. The energy
//! does not change when the whole cloth moves, so a particle's own (diagonal) block is minus the sum of its
//! others.

use super::elements::Element;
use super::rows::{
    Damping, Stored, any_normal, at, cross, dot, load, normalise, scaled, times, total_and_rest, vector_at,
    width,
};
use super::{Angle, Terms, Trial};
use crate::cloth::{Grid, terms};
use crate::cpu::Real;
use crate::cpu::matmul::LANES;
use crate::{Result, memory};
use pulp::{Arch, Simd, WithSimd};

/// A block of the Hessian: second derivatives with respect to the positions of two particles.
pub type Block = [[f64; 3]; 3];

/// Second derivatives of a function of one vector `sum w_k x_k` of up to four particles: for each two of them
/// `w_k w_l block`. A weight of 0 stands for no particle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    /// The particles.
    pub particles: [usize; 4],
    /// Their weights.
    pub weights: [f64; 4],
    /// The second derivatives with respect to the vector, symmetric.
    pub block: Block,
}

impl Coupling {
    /// Iterates over the particles with their weights.
    fn parts(&self) -> impl Iterator<Item = (usize, f64)> + Clone {
        self.particles.into_iter().zip(self.weights).filter(|(_, weight)| *weight != 0.0)
    }

    /// Iterates over each two of the particles, the smaller number first, with the product of their weights.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let later = self.parts();
        self.parts().enumerate().flat_map(move |(k, (p, of_p))| {
            later.clone().skip(k + 1).map(move |(q, of_q)| (p.min(q), p.max(q), of_p * of_q))
        })
    }

    /// Iterates over the particles, each with the square of its weight.
    pub fn squares(&self) -> impl Iterator<Item = (usize, f64)> {
        self.parts().map(|(p, weight)| (p, weight * weight))
    }
}

/// The share, from 0 to 1, of each term's possibly negative part that is removed.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Projection(pub f64);

impl Projection {
    /// The Hessian itself, which away from a minimum may have directions of negative curvature.
    pub const NONE: Self = Self(0.0);
    /// Positive semidefinite: the curvature is never negative along any direction.
    pub const FULL: Self = Self(1.0);

    /// Removes this share of the negative part of each number.
    #[inline(always)]
    fn of<S: Simd>(self, simd: S, value: S::f64s) -> S::f64s {
        let below = simd.min_f64s(value, simd.splat_f64s(0.0));
        simd.mul_add_e_f64s(simd.splat_f64s(-self.0), below, value)
    }
}

/// Number of particles that come after a particle in the grid and share a term with it.
pub const AFTER: usize = 6;

/// Particles that come after a particle in the grid and share a term with it, as offsets in rows and columns.
const NEIGHBOURS: [(isize, isize); AFTER] = [(0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];

/// Start of the block with each of them, in planes of W' numbers.
const RIGHT: usize = 0;
const RIGHT_TWICE: usize = 9;
const DOWN_LEFT: usize = 18;
const DOWN: usize = 27;
const DOWN_RIGHT: usize = 36;
const DOWN_TWICE: usize = 45;
/// Start of the lower triangle of a particle's own block, stored row by row.
const DIAGONAL: usize = 54;
const PLANES: usize = 60;

/// The Hessian of one cloth.
pub struct Hessian {
    grid: Grid,
    stored: Stored,
    /// Shape [H, 60, W'], preceded by some zeros. Each particle holds its blocks with the neighbours that
    /// come after it, indexed by the neighbour's component first, and the lower triangle of its own block.
    /// Each plane is zero past the particles of its row, and so are the numbers before it.
    values: Vec<f64>,
    work: Work,
}

/// Edges of a row and of the next one, shape [4, W']: direction, then one over the length; zeros for an edge
/// of length zero.
struct Work {
    vertical: [Vec<f64>; 2],
    horizontal: [Vec<f64>; 2],
    /// Lengths at the start of the frame, shape \[W'\].
    before: Vec<f64>,
}

impl Hessian {
    /// Allocates a zero Hessian for cloths on this grid. Fails if there is not enough memory.
    pub fn new(grid: Grid) -> Result<Self> {
        let stored = Stored::new(grid.w);
        let edges = || [(); 2].map(|()| vec![0.0; 4 * stored.stride]);
        let (len, mut values) = (LANES + grid.h * PLANES * stored.stride, Vec::new());
        memory::reserve(&mut values, len, "a Hessian")?;
        values.resize(len, 0.0);
        let before = vec![0.0; stored.stride];
        Ok(Self { grid, stored, values, work: Work { vertical: edges(), horizontal: edges(), before } })
    }

    /// Computes the Hessian at a trial, as if the handles were free.
    pub fn fill(&mut self, trial: &Trial<'_, f64>, projection: Projection) {
        assert_eq!(self.grid, trial.grid, "working memory and cloth share a grid");
        Arch::new().dispatch(Fill { trial, projection, hessian: self });
    }

    /// Returns all numbers, as indexed by [`Hessian::index_of`].
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Returns the second derivative with respect to one component each of two particles, for modification.
    /// Panics if the particles share no term.
    pub fn at_mut(&mut self, one: (usize, usize), other: (usize, usize)) -> &mut f64 {
        let place = self.index_of(one, other).expect("the particles share a term");
        &mut self.values[place]
    }

    /// Returns the place in [`Hessian::values`] of the second derivative with respect to one component each
    /// of two particles, or `None` if they share no term.
    pub fn index_of(&self, (p, row): (usize, usize), (q, column): (usize, usize)) -> Option<usize> {
        let ((p, row), (q, column)) = if p < q { ((q, column), (p, row)) } else { ((p, row), (q, column)) };
        let w = self.grid.w;
        let (i, j) = (q / w, q % w);
        let plane = if p == q {
            let (low, high) = (row.min(column), row.max(column));
            DIAGONAL + high * (high + 1) / 2 + low
        } else {
            let offset = ((p / w - i) as isize, (p % w) as isize - j as isize);
            9 * NEIGHBOURS.iter().position(|&neighbour| neighbour == offset)? + 3 * row + column
        };
        Some(LANES + (i * PLANES + plane) * self.stored.stride + j)
    }

    /// Returns the block of two particles, which is zero if they share no term.
    pub fn block(&self, p: usize, q: usize) -> Block {
        let entry =
            |row, column| self.index_of((p, row), (q, column)).map_or(0.0, |place| self.values[place]);
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| entry(row, column)))
    }
}

/// Returns the other particles that share a term with particle `p`.
pub fn neighbours(grid: Grid, p: usize) -> impl Iterator<Item = usize> {
    let Grid { h, w } = grid;
    let offsets = NEIGHBOURS.into_iter().flat_map(|(down, across)| [(down, across), (-down, -across)]);
    offsets.filter_map(move |(down, across)| {
        let (i, j) = ((p / w).checked_add_signed(down)?, (p % w).checked_add_signed(across)?);
        (i < h && j < w).then_some(i * w + j)
    })
}

struct Fill<'a, 'b> {
    trial: &'a Trial<'b, f64>,
    projection: Projection,
    hessian: &'a mut Hessian,
}

impl WithSimd for Fill<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { trial, projection, hessian } = self;
        let Hessian { grid: Grid { h, w }, stored, values, work } = hessian;
        let (h, w, stored) = (*h, *w, *stored);
        let Terms { vertical, horizontal, shear, vertical_bend, horizontal_bend } = trial.terms();
        let terms = Adds { simd, stored, projection };
        let Work { vertical: [v, next_v], horizontal: [e, next_e], before } = work;
        let (mut v, mut next_v, mut e, mut next_e) = (v, next_v, e, next_e);
        let row = PLANES * stored.stride;
        values[LANES..][..row].fill(0.0);
        load(simd, trial, (0, 1, w - 1), stored, e);
        terms.normalise(e);
        load(simd, trial, (0, w, w), stored, v);
        terms.normalise(v);
        for i in 0..h {
            let here = LANES + i * row;
            let next = here + row;
            let factors = |element| trial.stiffness(i, element);
            let damping = Damping::of(simd, trial, (i, 1, w - 1), stored, before);
            terms.stretch(
                e,
                (horizontal, factors(Element::Right), damping),
                (values, terms.plane(here, RIGHT)),
            );
            terms.angle(
                (horizontal_bend, factors(Element::StraightRight)),
                (&e[1..], e),
                values,
                [terms.plane(here, RIGHT) + 1, terms.plane(here, RIGHT)],
                [
                    (terms.plane(here, RIGHT), Mixed::Plus),
                    (terms.plane(here, RIGHT) + 1, Mixed::Plus),
                    (terms.plane(here, RIGHT_TWICE), Mixed::Minus),
                ],
            );
            if i + 1 < h {
                values[next..][..row].fill(0.0);
                let damping = Damping::of(simd, trial, (i, w, w), stored, before);
                terms.stretch(
                    v,
                    (vertical, factors(Element::Down), damping),
                    (values, terms.plane(here, DOWN)),
                );
                load(simd, trial, (i + 1, 1, w - 1), stored, next_e);
                terms.normalise(next_e);
                let (down, right, below) =
                    (terms.plane(here, DOWN), terms.plane(here, RIGHT), terms.plane(next, RIGHT));
                let (down_left, down_right) =
                    (terms.plane(here, DOWN_LEFT) + 1, terms.plane(here, DOWN_RIGHT));
                // The four corners of each cell. Their two edges share a particle, which leaves three pairs
                // of their ends.
                terms.angle(
                    (shear, factors(Element::UpperLeft)),
                    (v, e),
                    values,
                    [down, right],
                    [(down_left, Mixed::Plus), (right, Mixed::MinusTransposed), (down, Mixed::Minus)],
                );
                terms.angle(
                    (shear, factors(Element::UpperRight)),
                    (&v[1..], e),
                    values,
                    [down + 1, right],
                    [(right, Mixed::Plus), (down + 1, Mixed::Plus), (down_right, Mixed::Minus)],
                );
                terms.angle(
                    (shear, factors(Element::LowerLeft)),
                    (v, next_e),
                    values,
                    [down, below],
                    [
                        (down, Mixed::PlusTransposed),
                        (below, Mixed::PlusTransposed),
                        (down_right, Mixed::MinusTransposed),
                    ],
                );
                terms.angle(
                    (shear, factors(Element::LowerRight)),
                    (&v[1..], next_e),
                    values,
                    [down + 1, below],
                    [
                        (down_left, Mixed::PlusTransposed),
                        (down + 1, Mixed::MinusTransposed),
                        (below, Mixed::Minus),
                    ],
                );
            }
            if i + 2 < h {
                load(simd, trial, (i + 1, w, w), stored, next_v);
                terms.normalise(next_v);
                terms.angle(
                    (vertical_bend, factors(Element::StraightDown)),
                    (next_v, v),
                    values,
                    [terms.plane(next, DOWN), terms.plane(here, DOWN)],
                    [
                        (terms.plane(here, DOWN), Mixed::Plus),
                        (terms.plane(next, DOWN), Mixed::Plus),
                        (terms.plane(here, DOWN_TWICE), Mixed::Minus),
                    ],
                );
            }
            terms.diagonal(values, i, here);
            std::mem::swap(&mut v, &mut next_v);
            std::mem::swap(&mut e, &mut next_e);
        }
    }
}

/// How the block of two edges enters that of two particles. An edge is its second end minus its first, and
/// the particle that comes later in the grid, whose components are the rows, may belong to either edge.
#[derive(Clone, Copy)]
enum Mixed {
    Plus,
    Minus,
    PlusTransposed,
    MinusTransposed,
}

#[derive(Clone, Copy)]
struct Adds<S> {
    simd: S,
    stored: Stored,
    projection: Projection,
}

impl<S: Simd> Adds<S> {
    /// Returns where a plane begins in the row of particles that starts at `start`.
    #[inline(always)]
    fn plane(self, start: usize, plane: usize) -> usize {
        start + plane * self.stored.stride
    }

    /// Normalises edges [4, W'] and sets their fourth component to one over the length.
    #[inline(always)]
    fn normalise(self, edges: &mut [f64]) {
        let Self { simd, stored: Stored { stride, count }, .. } = self;
        for k in 0..count / width::<f64, S>() {
            normalise::<f64, S>(simd, edges, k * width::<f64, S>(), stride);
        }
    }

    /// Adds the second derivatives of the stretch of edges ([`terms::Edge::hessian`]): 2 (1 + t) along the edge, and
    /// 2 (1 + t - r / |e|) across it, which is negative for a compressed edge. The block of the edge's two ends is minus that of
    /// the edge.
    #[inline(always)]
    fn stretch(
        self,
        edges: &[f64],
        (factor, factors, damping): (f64, Option<&[f64]>, Option<Damping<'_, f64>>),
        (values, to): (&mut [f64], usize),
    ) {
        let Self { simd, stored: Stored { stride, count }, projection } = self;
        let zero = simd.splat_f64s(0.0);
        let twice = simd.splat_f64s(-2.0 * factor);
        for k in 0..count / width::<f64, S>() {
            let place = k * width::<f64, S>();
            let d = vector_at::<f64, S>(edges, place, stride);
            let inverse = at::<f64, S>(edges, place + 3 * stride);
            let (total, rest) = total_and_rest::<f64, S>(simd, damping, place);
            let twice = times::<f64, S>(simd, twice, factors, place);
            let across = projection.of(simd, simd.sub_f64s(total, simd.mul_f64s(rest, inverse)));
            let along = simd.mul_f64s(twice, simd.sub_f64s(total, across));
            let across = f64::select_greater(simd, (inverse, zero), simd.mul_f64s(twice, across), zero);
            for row in 0..3 {
                let of_d = simd.mul_f64s(along, d[row]);
                for column in 0..3 {
                    let to = &mut values[to + place + (3 * row + column) * stride..];
                    let to = &mut f64::lanes_mut::<S>(to)[0];
                    *to = simd.mul_add_e_f64s(of_d, d[column], *to);
                    if row == column {
                        *to = simd.add_f64s(*to, across);
                    }
                }
            }
        }
    }

    /// Adds the second derivatives of the energy of an angle between edges u and w. Those with respect to u
    /// twice and to w twice are subtracted from the blocks of the two ends of u and of w (`ends`); those with
    /// respect to u and w enter the blocks of one end of each (`mixed`).
    ///
    /// The formulas, with the unit vectors n, m_u and m_w, are those of [`terms::Angle::hessian`]. The part along
    /// n of the whole is `s [[cos t, -1], [-1, cos t]]` with `s = (t - rest) / sin t`, whose eigenvalues are
    /// `s (cos t + 1)` and `s (cos t - 1)`. The projection keeps the positive ones and removes the products of m
    /// and u.
    #[inline(always)]
    fn angle(
        self,
        (Angle { factor, rest, parallel }, factors): (Angle<f64>, Option<&[f64]>),
        (edges_u, edges_w): (&[f64], &[f64]),
        values: &mut [f64],
        ends: [usize; 2],
        mixed: [(usize, Mixed); 3],
    ) {
        let Self { simd, stored: Stored { stride, count }, projection } = self;
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let (limit, least) = (simd.splat_f64s(terms::Angle::PARALLEL), simd.splat_f64s(f64::MIN_POSITIVE));
        let (twice, half) = (simd.splat_f64s(2.0 * factor), simd.splat_f64s(0.5));
        let (rest, parallel) = (simd.splat_f64s(rest), simd.splat_f64s(parallel));
        let kept = simd.splat_f64s(1.0 - projection.0);
        for k in 0..count / width::<f64, S>() {
            let place = k * width::<f64, S>();
            let by_u = at::<f64, S>(edges_u, place + 3 * stride);
            let by_w = at::<f64, S>(edges_w, place + 3 * stride);
            let u = vector_at::<f64, S>(edges_u, place, stride);
            let w = vector_at::<f64, S>(edges_w, place, stride);
            let c = cross::<f64, S>(simd, u, w);
            let (sine, cosine) = (simd.sqrt_f64s(dot::<f64, S>(simd, c, c)), dot::<f64, S>(simd, u, w));
            let delta = simd.sub_f64s(f64::angle(simd, sine, cosine), rest);
            // For parallel edges any normal will do.
            let any = any_normal::<f64, S>(simd, u);
            let across = simd.sqrt_f64s(dot::<f64, S>(simd, any, any));
            let length = simd.max_f64s(f64::select_greater(simd, (sine, limit), sine, across), least);
            let inverse = simd.div_f64s(one, length);
            let parallel = f64::select_greater(simd, (cosine, zero), parallel, zero);
            let s = f64::select_greater(simd, (sine, limit), simd.mul_f64s(delta, inverse), parallel);
            // An edge of length zero forms no angle. If it is w, the normal must be zeroed; if it is u, the
            // normal is zero already.
            let inverse = f64::select_greater(simd, (by_w, zero), inverse, zero);
            let n = [
                f64::select_greater(simd, (sine, limit), c[0], any[0]),
                f64::select_greater(simd, (sine, limit), c[1], any[1]),
                f64::select_greater(simd, (sine, limit), c[2], any[2]),
            ];
            let n = scaled::<f64, S>(simd, n, inverse);
            let (m_u, m_w) = (cross::<f64, S>(simd, n, u), cross::<f64, S>(simd, w, n));
            let sum = projection.of(simd, simd.mul_f64s(s, simd.sub_f64s(cosine, one)));
            let difference = projection.of(simd, simd.mul_f64s(s, simd.add_f64s(cosine, one)));
            let normal = simd.mul_f64s(half, simd.add_f64s(sum, difference));
            let radial = simd.mul_f64s(kept, delta);
            let twice = times::<f64, S>(simd, twice, factors, place);
            for (to, m, e, by) in [(ends[0], m_u, u, by_u), (ends[1], m_w, w, by_w)] {
                let factor = simd.mul_f64s(twice, simd.mul_f64s(by, by));
                let (normal, radial) = (simd.mul_f64s(factor, normal), simd.mul_f64s(factor, radial));
                for row in 0..3 {
                    let of_m = simd.mul_add_e_f64s(factor, m[row], simd.mul_f64s(radial, e[row]));
                    let (of_n, of_e) = (simd.mul_f64s(normal, n[row]), simd.mul_f64s(radial, m[row]));
                    for column in 0..3 {
                        let sum = simd.mul_f64s(of_m, m[column]);
                        let sum = simd.mul_add_e_f64s(of_n, n[column], sum);
                        let sum = simd.mul_add_e_f64s(of_e, e[column], sum);
                        let to = &mut values[to + place + (3 * row + column) * stride..];
                        let to = &mut f64::lanes_mut::<S>(to)[0];
                        *to = simd.sub_f64s(*to, sum);
                    }
                }
            }
            let factor = simd.mul_f64s(twice, simd.mul_f64s(by_u, by_w));
            let normal = simd.mul_f64s(factor, simd.mul_f64s(half, simd.sub_f64s(sum, difference)));
            for row in 0..3 {
                let (of_m, of_n) = (simd.mul_f64s(factor, m_u[row]), simd.mul_f64s(normal, n[row]));
                for column in 0..3 {
                    let entry = simd.mul_add_e_f64s(of_n, n[column], simd.mul_f64s(of_m, m_w[column]));
                    for (to, how) in mixed {
                        let plane = match how {
                            Mixed::Plus | Mixed::Minus => 3 * row + column,
                            Mixed::PlusTransposed | Mixed::MinusTransposed => 3 * column + row,
                        };
                        let to = &mut f64::lanes_mut::<S>(&mut values[to + place + plane * stride..])[0];
                        *to = match how {
                            Mixed::Plus | Mixed::PlusTransposed => simd.add_f64s(*to, entry),
                            Mixed::Minus | Mixed::MinusTransposed => simd.sub_f64s(*to, entry),
                        };
                    }
                }
            }
        }
    }

    /// Sets the own blocks of the particles of row `i`, which starts at `here`, from their blocks with all
    /// others.
    #[inline(always)]
    fn diagonal(self, values: &mut [f64], i: usize, here: usize) {
        let Self { simd, stored: Stored { stride, count }, .. } = self;
        let length = PLANES * stride;
        let above = |rows: usize, plane: usize| self.plane(here.saturating_sub(rows * length), plane);
        // Blocks with the particles before: those of this row, of the row above and of the one above that.
        let before = [
            above(0, RIGHT) - 1,
            above(0, RIGHT_TWICE) - 2,
            above(1, DOWN_LEFT) + 1,
            above(1, DOWN),
            above(1, DOWN_RIGHT) - 1,
            above(2, DOWN_TWICE),
        ];
        let before = &before[..[2, 5, 6][i.min(2)]];
        for k in 0..count / width::<f64, S>() {
            let place = k * width::<f64, S>();
            let mut plane = 0;
            for row in 0..3 {
                for column in 0..=row {
                    let (mine, theirs) = (3 * row + column, 3 * column + row);
                    let mut sum = simd.splat_f64s(0.0);
                    for kind in 0..NEIGHBOURS.len() {
                        let after = self.plane(here, 9 * kind + theirs) + place;
                        sum = simd.sub_f64s(sum, at::<f64, S>(values, after));
                    }
                    for start in before {
                        let before = start + mine * stride + place;
                        sum = simd.sub_f64s(sum, at::<f64, S>(values, before));
                    }
                    f64::lanes_mut::<S>(&mut values[self.plane(here, DIAGONAL + plane) + place..])[0] = sum;
                    plane += 1;
                }
            }
        }
    }
}
