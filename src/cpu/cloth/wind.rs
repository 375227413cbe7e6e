//! Air drag on the cells of a cloth.

use super::rows::{Stored, cross, dot, scaled, width};
use crate::cloth::{Air, Grid, Mark};
use crate::cpu::Real;
use crate::cpu::matmul::LANES;
use pulp::{Arch, Simd, WithSimd};

/// Adds to the accelerations `f` [3, H, W] the effect of air that moves with velocity `wind` [edges / frame]
/// on a cloth with these `marks` [H, W], positions `x` and velocities `v`, shape [3, H, W].
///
/// With the vector area of a cell (half the cross product of its diagonals: the same for both ways to cut it), its
/// size A and unit normal n, and `v_rel = wind - mean velocity of the corners`, the force on the cell is
/// `density A |v_n| v_n n + drag A (v_rel - v_n n)` with `v_n = n . v_rel`. Each corner carries a quarter of it, as it
/// carries a quarter of the cell's mass, so that uniform wind moves a flat sheet uniformly.
///
/// The force is that at the end of the frame: `v_n` divided by `1 + density A |v_n|`, and the part along the cell by
/// `1 + drag A` (a cell has mass 1), which is the velocity of a free cell after an implicit step. So the air never
/// turns a motion round, however light or fast the cloth.
pub fn add_wind<T: Real>(
    (grid, marks): (Grid, &[Mark]),
    air: Air,
    wind: [T; 3],
    (x, v): (&[T], &[T]),
    f: &mut [T],
) {
    if air == Air::default() {
        return;
    }
    let stored = Stored::new(grid.w);
    let zeros = |count: usize| vec![T::zero(); count];
    let (pushes, exist, shares) = (zeros(LANES + 3 * stored.stride), zeros(stored.stride), zeros(grid.w));
    Arch::new().dispatch(Rows { grid, marks, air, wind, x, v, f, stored, pushes, exist, shares });
}

/// All rows of cells of a cloth.
struct Rows<'a, T> {
    grid: Grid,
    marks: &'a [Mark],
    air: Air,
    wind: [T; 3],
    x: &'a [T],
    v: &'a [T],
    f: &'a mut [T],
    stored: Stored,
    /// A quarter of the forces on a row of cells, shape [3, W'] after the zeros of a register: so the first has one before it.
    pushes: Vec<T>,
    /// Which cells the cloth has, 1 or 0, shape \[W'\].
    exist: Vec<T>,
    /// One over the masses of a row of particles, 0 outside of the cloth, shape \[W\].
    shares: Vec<T>,
}

impl<T: Real> WithSimd for Rows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let Grid { h, w } = self.grid;
        self.weigh(0);
        for i in 0..h - 1 {
            for (exists, mark) in self.exist[..w].iter_mut().zip(&self.marks[i * w..][..w]) {
                *exists = if mark.begins_cell() { T::one() } else { T::zero() };
            }
            self.push::<S>(simd, i);
            self.share::<S>(simd, i);
            self.weigh(i + 1);
            self.share::<S>(simd, i + 1);
        }
    }
}

impl<T: Real> Rows<'_, T> {
    /// Sets the shares of a row of particles.
    fn weigh(&mut self, i: usize) {
        let w = self.grid.w;
        for (share, mark) in self.shares.iter_mut().zip(&self.marks[i * w..][..w]) {
            let mass = T::of(mark.mass());
            *share = if mass > T::zero() { mass.recip() } else { T::zero() };
        }
    }

    /// Computes the forces on row `i` of cells.
    #[inline(always)]
    fn push<S: Simd>(&mut self, simd: S, i: usize) {
        let Self { grid: Grid { h, w }, air, wind, x, v, stored, pushes, exist, .. } = self;
        let (h, w) = (*h, *w);
        let (zero, one) = (T::splat(simd, T::zero()), T::splat(simd, T::one()));
        let [half, quarter] = [0.5, 0.25].map(T::of);
        let (half, quarter) = (T::splat(simd, half), T::splat(simd, quarter));
        let (density, drag) = (T::splat(simd, T::of(air.density)), T::splat(simd, T::of(air.drag)));
        for register in 0..(w - 1).div_ceil(width::<T, S>()) {
            let place = register * width::<T, S>();
            // The corners of a cell are a and b, and below them c and d. Past the last cell there is none.
            let (mut across, mut along, mut relative) = ([zero; 3], [zero; 3], [zero; 3]);
            for c in 0..3 {
                let (upper, lower) = ((c * h + i) * w + place, (c * h + i + 1) * w + place);
                let (end, end_below) = (upper + w - place, lower + w - place);
                let a = T::load_partial(simd, &x[upper..end]);
                let b = T::load_partial(simd, &x[upper + 1..end]);
                let below = T::load_partial(simd, &x[lower..end_below]);
                let d = T::load_partial(simd, &x[lower + 1..end_below]);
                across[c] = T::sub_lanes(simd, d, a);
                along[c] = T::sub_lanes(simd, b, below);
                let a = T::load_partial(simd, &v[upper..end]);
                let b = T::load_partial(simd, &v[upper + 1..end]);
                let below = T::load_partial(simd, &v[lower..end_below]);
                let d = T::load_partial(simd, &v[lower + 1..end_below]);
                let sum = T::add_lanes(simd, T::add_lanes(simd, a, d), T::add_lanes(simd, b, below));
                let wind = T::splat(simd, wind[c]);
                relative[c] = T::sub_lanes(simd, wind, T::mul_lanes(simd, sum, quarter));
            }
            let normal = cross::<T, S>(simd, across, along);
            let double_area = T::sqrt_lanes(simd, dot::<T, S>(simd, normal, normal));
            let inverse = T::div_lanes(simd, one, double_area);
            let exists = T::lanes::<S>(&exist[place..])[0];
            let exists = T::select_greater(simd, (double_area, zero), exists, zero);
            let normal = scaled::<T, S>(simd, normal, inverse);
            let speed = dot::<T, S>(simd, normal, relative);
            let area = T::mul_lanes(simd, double_area, half);
            let size = T::max_lanes(simd, speed, T::sub_lanes(simd, zero, speed));
            let pressure = T::mul_lanes(simd, T::mul_lanes(simd, density, area), size);
            let friction = T::mul_lanes(simd, drag, area);
            let pressure = T::div_lanes(simd, pressure, T::add_lanes(simd, one, pressure));
            let friction = T::div_lanes(simd, friction, T::add_lanes(simd, one, friction));
            // Along the normal (pressure - friction) speed, and friction times all of the relative velocity.
            let along_normal = T::mul_lanes(simd, T::sub_lanes(simd, pressure, friction), speed);
            for c in 0..3 {
                let push = T::mul_lanes(simd, friction, relative[c]);
                let push = T::mul_lanes(simd, quarter, T::fma(simd, along_normal, normal[c], push));
                let push = T::select_greater(simd, (exists, zero), push, zero);
                T::lanes_mut::<S>(&mut pushes[LANES + c * stored.stride + place..])[0] = push;
            }
        }
    }

    /// Adds to the accelerations of row `i` of particles what its shares make of the forces.
    #[inline(always)]
    fn share<S: Simd>(&mut self, simd: S, i: usize) {
        let Self { grid: Grid { h, w }, stored, f, pushes, shares, .. } = self;
        let (h, w) = (*h, *w);
        for c in 0..3 {
            let pushes = &pushes[LANES - 1 + c * stored.stride..];
            for register in 0..w.div_ceil(width::<T, S>()) {
                let place = register * width::<T, S>();
                let before = T::lanes::<S>(&pushes[place..])[0];
                let behind = T::lanes::<S>(&pushes[place + 1..])[0];
                let share = T::load_partial(simd, &shares[place..]);
                let f = &mut f[(c * h + i) * w + place..][..w - place];
                let sum = T::load_partial(simd, f);
                let sum = T::fma(simd, share, T::add_lanes(simd, before, behind), sum);
                T::store_partial(simd, f, sum);
            }
        }
    }
}
