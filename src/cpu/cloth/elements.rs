//! Which edges and angles a cloth has that is not a full rectangle, and how stiff they are if not all the same.

use super::rows::Stored;
use crate::cloth::{Grid, Mark};
use crate::cpu::Real;

/// The stiffness of each edge and angle of the grid as a factor of the material's, 0 for those that the cloth doesn't have, in
/// rows. An edge that it doesn't have is loaded as one of length zero, which forms no angle.
#[derive(Clone, Debug)]
pub struct Elements<T> {
    stride: usize,
    /// Shape [H, 8, W'], by [`Element`].
    factors: Vec<T>,
    /// Whether the cloth has the edges to the right and down, 1 or 0, shape [H, 2, W'].
    edges: Vec<T>,
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
    /// All of them, in order.
    const ALL: [Self; 8] = [
        Self::Right,
        Self::Down,
        Self::StraightRight,
        Self::StraightDown,
        Self::UpperLeft,
        Self::LowerLeft,
        Self::UpperRight,
        Self::LowerRight,
    ];

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

impl<T: Real> Elements<T> {
    /// Returns the elements between the particles with these marks, shape [H, W]; `None` if the cloth has all, and all are as
    /// stiff as its material.
    pub fn of(grid: Grid, marks: &[Mark]) -> Option<Self> {
        if marks.iter().all(|mark| !mark.is_outside() && mark.is_even()) {
            return None;
        }
        let (Grid { h, w }, stride) = (grid, Stored::new(grid.w).stride);
        let has = |i: usize, j: usize| i < h && j < w && !marks[i * w + j].is_outside();
        let at = |i: usize, j: usize| marks[i * w + j].stiffness();
        let right = |i: usize, j: usize| has(i, j) && has(i, j + 1);
        let down = |i: usize, j: usize| has(i, j) && has(i + 1, j);
        // An edge has the mean of its ends, an angle that of the particle where its edges meet.
        let factor = |i: usize, j: usize, element: Element| {
            let (exists, of_it): (bool, &dyn Fn() -> f64) = match element {
                Element::Right => (right(i, j), &|| 0.5 * (at(i, j) + at(i, j + 1))),
                Element::Down => (down(i, j), &|| 0.5 * (at(i, j) + at(i + 1, j))),
                Element::StraightRight => (right(i, j) && right(i, j + 1), &|| at(i, j + 1)),
                Element::StraightDown => (down(i, j) && down(i + 1, j), &|| at(i + 1, j)),
                Element::UpperLeft => (down(i, j) && right(i, j), &|| at(i, j)),
                Element::LowerLeft => (down(i, j) && right(i + 1, j), &|| at(i + 1, j)),
                Element::UpperRight => (down(i, j + 1) && right(i, j), &|| at(i, j + 1)),
                Element::LowerRight => (down(i, j + 1) && right(i + 1, j), &|| at(i + 1, j + 1)),
            };
            if exists { of_it() } else { 0.0 }
        };
        let (mut factors, mut edges) =
            (Vec::with_capacity(h * 8 * stride), Vec::with_capacity(h * 2 * stride));
        for i in 0..h {
            for element in Element::ALL {
                factors.extend((0..stride).map(|j| T::of(factor(i, j, element))));
            }
            edges.extend((0..stride).map(|j| T::of(f64::from(u8::from(right(i, j))))));
            edges.extend((0..stride).map(|j| T::of(f64::from(u8::from(down(i, j))))));
        }
        Some(Self { stride, factors, edges })
    }

    /// Returns the factors of the elements of one kind that begin in row `i`, shape \[W'\].
    pub(super) fn row(&self, i: usize, element: Element) -> &[T] {
        &self.factors[(i * 8 + element as usize) * self.stride..][..self.stride]
    }

    /// Returns which edges, to the right or down, begin in row `i`, shape \[W'\].
    pub(super) fn edges(&self, i: usize, down: bool) -> &[T] {
        &self.edges[(i * 2 + usize::from(down)) * self.stride..][..self.stride]
    }
}
