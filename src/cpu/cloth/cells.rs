//! The particles of a cloth by the cells of a uniform grid in space, in which what is near a particle is found (paper section 3.4).

use super::Trial;
use super::vector::{add, at};
use crate::cpu::Real;

/// Bits of a cell's number along each axis; cells count from the middle of what they span.
const BITS: u32 = 21;

/// The particles of one cloth, sorted by the cubes of space that they are in.
pub struct Cells<T> {
    sorted: Vec<Placed<T>>,
}

/// A particle where the trial has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed<T> {
    /// Its cell: the numbers along x, y and z, one behind the other. Cells that are neighbours along z follow each other.
    pub cell: u64,
    /// Its number.
    pub particle: usize,
    /// Its position \[edges\].
    pub place: [T; 3],
}

/// Finds what is near one particle after the other, in the order of [`Cells::sorted`].
pub struct Walk<'a, T> {
    sorted: &'a [Placed<T>],
    /// For each column of three cells around the particle, how many particles lie before it.
    before: [usize; 9],
}

impl<T: Real> Cells<T> {
    /// Sorts the particles of a trial into cubes of this side \[edges\], above 0.
    pub fn new(trial: &Trial<'_, T>, side: T) -> Self {
        let n = trial.grid.particles();
        let placed = |particle| {
            let place = add(at(trial.x, n, particle), at(trial.shift, n, particle));
            Placed { cell: cell(place, side), particle, place }
        };
        let mut sorted: Vec<_> = (0..n).map(placed).collect();
        sorted.sort_unstable_by_key(|placed| (placed.cell, placed.particle));
        Self { sorted }
    }

    /// The particles, cell by cell, in a cell by their numbers.
    pub fn sorted(&self) -> &[Placed<T>] {
        &self.sorted
    }

    /// A walk that begins with `first`.
    pub fn walk(&self, first: &Placed<T>) -> Walk<'_, T> {
        let before =
            columns(first.cell).map(|[begin, _]| self.sorted.partition_point(|placed| placed.cell < begin));
        Walk { sorted: &self.sorted, before }
    }
}

impl<T: Real> Walk<'_, T> {
    /// The particles in the cell of `own` and the 26 around it, itself among them: all that are nearer than a cell's side, in an
    /// order that does not depend on where the walk began.
    pub fn around(&mut self, own: &Placed<T>) -> impl Iterator<Item = &Placed<T>> {
        let columns = columns(own.cell);
        // As the particles go up from cell to cell, so do the columns around them.
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
    /// Whether it is less than a million edges (2^20) away along each axis: what lies beyond, or is no number, is near nothing.
    pub fn is_within_reach(&self) -> bool {
        self.place.iter().all(|x| x.f64().abs() < (1u64 << (BITS - 1)) as f64)
    }
}

/// The cube of space that a place is in; the outermost has all that lies beyond it, and what is no number is in some one.
fn cell<T: Real>(place: [T; 3], side: T) -> u64 {
    let (middle, last) = (1i64 << (BITS - 1), (1i64 << BITS) - 1);
    // A cell has one before and one behind it.
    let number = |x: T| (((x / side).f64().floor() as i64).saturating_add(middle)).clamp(1, last - 1) as u64;
    let [x, y, z] = place.map(number);
    (x << (2 * BITS)) | (y << BITS) | z
}

/// First and last cell of each column of three around a cell.
fn columns(cell: u64) -> [[u64; 2]; 9] {
    let corner = cell - (1 << (2 * BITS)) - (1 << BITS);
    std::array::from_fn(|k| {
        let middle = corner + ((k as u64 / 3) << (2 * BITS)) + ((k as u64 % 3) << BITS);
        [middle - 1, middle + 1]
    })
}
