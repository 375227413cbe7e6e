//! The particles of a cloth by the cells of a uniform grid in space, in which what is near a particle is found (paper section 3.4).

use super::Trial;
use super::vector::{add, at};
use crate::cpu::Real;

/// The particles of one cloth, sorted by the cubes of space that they are in.
pub struct Cells<T> {
    sorted: Vec<Placed<T>>,
}

/// A particle where the trial has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed<T> {
    /// Its cell.
    pub cell: [i32; 3],
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
            // What is too far away for a cell's number, or no number, is in some cell all the same.
            let cell = place.map(|x| ((x / side).f64().floor() as i32).clamp(i32::MIN + 1, i32::MAX - 1));
            Placed { cell, particle, place }
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
        let of_column = |(&before, [_, end]): (&usize, [[i32; 3]; 2])| {
            self.sorted[before..].iter().take_while(move |placed| placed.cell <= end)
        };
        self.before.iter().zip(columns).flat_map(of_column)
    }
}

/// First and last cell of each column of three around a cell.
fn columns([x, y, z]: [i32; 3]) -> [[[i32; 3]; 2]; 9] {
    std::array::from_fn(|k| {
        let (x, y) = (x + k as i32 / 3 - 1, y + k as i32 % 3 - 1);
        [[x, y, z - 1], [x, y, z + 1]]
    })
}
