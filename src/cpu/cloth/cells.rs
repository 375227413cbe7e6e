//! A uniform grid of cells in space, in which the neighbours of a particle are found (paper section 3.4).

use super::Trial;
use super::vector::{add, at};
use crate::cpu::Real;

/// Bits of a cell's index along each axis. The origin lies in the middle of the range.
const BITS: u32 = 21;

/// The particles of one cloth, sorted by cell.
pub struct Cells<T> {
    sorted: Vec<Placed<T>>,
}

/// A particle at its trial position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed<T> {
    /// Its cell: the indices along x, y and z, concatenated. Neighbours along z are consecutive.
    pub cell: u64,
    /// Its number.
    pub particle: usize,
    /// Its position \[edges\].
    pub place: [T; 3],
}

/// Finds the neighbours of one particle after another, in the order of [`Cells::sorted`].
pub struct Walk<'a, T> {
    sorted: &'a [Placed<T>],
    /// For each column of three cells around the particle, the number of particles before it.
    before: [usize; 9],
}

impl<T: Real> Cells<T> {
    /// Sorts the particles of a trial into cubes of this side \[edges\], which must be above 0; those that the cloth doesn't
    /// have lie out of reach.
    pub fn new(trial: &Trial<'_, T>, side: T) -> Self {
        let n = trial.grid.particles();
        let place = |particle: usize| match trial.marks[particle].is_outside() {
            true => [T::infinity(); 3],
            false => add(at(trial.x, n, particle), at(trial.shift, n, particle)),
        };
        Self::of((0..n).map(place), side)
    }

    /// Sorts places likewise; a particle is then the number of one.
    pub fn of(places: impl Iterator<Item = [T; 3]>, side: T) -> Self {
        let placed = |(particle, place)| Placed { cell: cell(place, side), particle, place };
        let mut sorted: Vec<_> = places.enumerate().map(placed).collect();
        sorted.sort_unstable_by_key(|placed| (placed.cell, placed.particle));
        Self { sorted }
    }

    /// Returns the particles, ordered by cell, and within a cell by number.
    pub fn sorted(&self) -> &[Placed<T>] {
        &self.sorted
    }

    /// Starts a walk at `first`.
    pub fn walk(&self, first: &Placed<T>) -> Walk<'_, T> {
        let before =
            columns(first.cell).map(|[begin, _]| self.sorted.partition_point(|placed| placed.cell < begin));
        Walk { sorted: &self.sorted, before }
    }
}

impl<T: Real> Walk<'_, T> {
    /// Returns the particles in the cell of `own` and the 26 around it, including `own`. They contain all
    /// that are closer than a cell's side. The order does not depend on where the walk started.
    pub fn around(&mut self, own: &Placed<T>) -> impl Iterator<Item = &Placed<T>> {
        let columns = columns(own.cell);
        // The particles advance from cell to cell, and so do the columns around them.
        for (before, [begin, _]) in self.before.iter_mut().zip(columns) {
            *before += self.sorted[*before..].iter().take_while(|placed| placed.cell < begin).count();
        }
        let of_column = |(&before, [_, end]): (&usize, [u64; 2])| {
            self.sorted[before..].iter().take_while(move |placed| placed.cell <= end)
        };
        self.before.iter().zip(columns).flat_map(of_column)
    }
}

impl<T: Real> Placed<T> {
    /// Whether it is less than a million edges (2^20) from the origin along each axis. A particle beyond, or
    /// at NaN, counts as near nothing.
    pub fn is_within_reach(&self) -> bool {
        self.place.iter().all(|x| x.f64().abs() < (1u64 << (BITS - 1)) as f64)
    }
}

/// Returns the cell that contains a position. The outermost cells contain everything beyond them; NaN gets an
/// arbitrary one.
fn cell<T: Real>(place: [T; 3], side: T) -> u64 {
    let (middle, last) = (1i64 << (BITS - 1), (1i64 << BITS) - 1);
    // Every cell has a cell before and one after it along each axis.
    let number = |x: T| (((x / side).f64().floor() as i64).saturating_add(middle)).clamp(1, last - 1) as u64;
    let [x, y, z] = place.map(number);
    (x << (2 * BITS)) | (y << BITS) | z
}

/// Returns the first and the last cell of each column of three around a cell.
fn columns(cell: u64) -> [[u64; 2]; 9] {
    let corner = cell - (1 << (2 * BITS)) - (1 << BITS);
    std::array::from_fn(|k| {
        let middle = corner + ((k as u64 / 3) << (2 * BITS)) + ((k as u64 % 3) << BITS);
        [middle - 1, middle + 1]
    })
}
