//! Which edges and angles a cloth has that is not a full rectangle.

use super::rows::Stored;
use crate::cloth::{Grid, Mark};
use crate::cpu::Real;

/// 1 for each edge and angle of the grid that the cloth has, and 0 for the others, as factors for
/// rows. An edge that it doesn't have is loaded as one of length zero, which forms no angle.
#[derive(Clone, Debug)]
pub struct Cut<T> {
    stride: usize,
    /// Shape [H, 8, W'], by [`Element`].
    factors: Vec<T>,
}

/// The elements that begin at a particle (i, j).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Element {
    /// The edge to (i, j+1).
    Right,
    /// The edge to (i+1, j).
    Down,
    /// The angle between the edges to (i, j+1) and on to (i, j+2).
    StraightRight,
    /// The angle between the edges to (i+1, j) and on to (i+2, j).
    StraightDown,
    /// The corners of the cell behind it: the edges to (i+1, j) and to (i, j+1),
    UpperLeft,
    /// those to (i+1, j) and from there,
    LowerLeft,
    /// those to (i, j+1) and from there,
    UpperRight,
    /// and the two opposite ones.
    LowerRight,
}

impl Element {
    /// Returns the corner of a cell at its lower and at its right end, or not.
    pub fn corner(lower: bool, right: bool) -> Self {
        match (lower, right) {
            (false, false) => Self::UpperLeft,
            (true, false) => Self::LowerLeft,
            (false, true) => Self::UpperRight,
            (true, true) => Self::LowerRight,
        }
    }
}

impl<T: Real> Cut<T> {
    /// Returns the elements between the particles with these marks, shape [H, W]; `None` if the cloth has all.
    pub fn of(grid: Grid, marks: &[Mark]) -> Option<Self> {
        if !marks.iter().any(|mark| mark.is_outside()) {
            return None;
        }
        let (Grid { h, w }, stride) = (grid, Stored::new(grid.w).stride);
        let has = |i: usize, j: usize| i < h && j < w && !marks[i * w + j].is_outside();
        let right = |i: usize, j: usize| has(i, j) && has(i, j + 1);
        let down = |i: usize, j: usize| has(i, j) && has(i + 1, j);
        let mut factors = Vec::with_capacity(h * 8 * stride);
        for i in 0..h {
            let elements: [&dyn Fn(usize) -> bool; 8] = [
                &|j| right(i, j),
                &|j| down(i, j),
                &|j| right(i, j) && right(i, j + 1),
                &|j| down(i, j) && down(i + 1, j),
                &|j| down(i, j) && right(i, j),
                &|j| down(i, j) && right(i + 1, j),
                &|j| down(i, j + 1) && right(i, j),
                &|j| down(i, j + 1) && right(i + 1, j),
            ];
            let row = |has: &dyn Fn(usize) -> bool| -> Vec<T> {
                (0..stride).map(|j| T::of(f64::from(u8::from(has(j))))).collect()
            };
            elements.iter().for_each(|has| factors.extend(row(has)));
        }
        Some(Self { stride, factors })
    }

    /// Returns the factors of the elements of one kind that begin in row `i`, shape \[W'\].
    pub(super) fn row(&self, i: usize, element: Element) -> &[T] {
        &self.factors[(i * 8 + element as usize) * self.stride..][..self.stride]
    }
}
