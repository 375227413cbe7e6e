//! How a cloth differs from a uniform sheet that is the same along both axes of its grid.

use super::Grid;
use crate::{Error, Result};
use half::f16;
use std::sync::Arc;

/// How stiff a sheet is along the height of its grid (the warp of a fabric) and along its width (the weft), as factors of
/// the coefficients of a [`Material`](super::Material).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Weave {
    /// Factors of the stretch of edges along the height and along the width.
    pub stretch: [f64; 2],
    /// Factors of the bend between two consecutive edges along the height and along the width.
    pub bend: [f64; 2],
}

impl Weave {
    /// The same along both axes.
    pub const EVEN: Self = Self { stretch: [1.0; 2], bend: [1.0; 2] };

    /// Returns the weave of the sheet turned by a quarter.
    pub fn turned(self) -> Self {
        let ([down, across], [bend_down, bend_across]) = (self.stretch, self.bend);
        Self { stretch: [across, down], bend: [bend_across, bend_down] }
    }

    /// Whether both axes are the same.
    pub fn is_even(&self) -> bool {
        *self == Self::EVEN
    }
}

impl Default for Weave {
    fn default() -> Self {
        Self::EVEN
    }
}

/// A factor for each particle of a grid, shape [H, W], kept in half precision: within 0.05 % of what was given.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    grid: Grid,
    factors: Arc<[f16]>,
}

impl Map {
    /// Least and largest factor.
    pub const RANGE: [f64; 2] = [1e-3, 1e3];

    /// Returns a map. Fails if the length is not the grid's, or a factor is out of [`Map::RANGE`]; `origin` and `field` name
    /// its source.
    pub fn new(grid: Grid, factors: &[f64], origin: &str, field: &str) -> Result<Self> {
        if factors.len() != grid.particles() {
            let expected = format!("{} numbers, a particle each", grid.particles());
            return Err(Error::invalid(origin, field, expected, factors.len()));
        }
        let [least, most] = Self::RANGE;
        if let Some(p) = factors.iter().position(|factor| !(least..=most).contains(factor)) {
            let found = format!("{} at particle ({}, {})", factors[p], p / grid.w, p % grid.w);
            return Err(Error::invalid(origin, field, format!("factors from {least} to {most}"), found));
        }
        Ok(Self { grid, factors: factors.iter().map(|&factor| f16::from_f64(factor)).collect() })
    }

    /// Returns the grid that it belongs to.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the factor of particle `p`. Panics if the grid has no such particle.
    pub fn at(&self, p: usize) -> f64 {
        self.factors[p].to_f64()
    }

    /// Returns the factor of particle `p` as it is stored.
    pub(super) fn stored(&self, p: usize) -> f16 {
        self.factors[p]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_keep_their_factors() {
        let grid = Grid { h: 3, w: 2 };
        let factors = [1.0, 0.5, 2.0, 1e-3, 1e3, 1.2345];
        let map = Map::new(grid, &factors, "a test", "maps.density").unwrap();
        for (p, factor) in factors.into_iter().enumerate() {
            assert!((map.at(p) / factor - 1.0).abs() < 5e-4, "{factor}: {}", map.at(p));
        }
        assert_eq!((map.at(0), map.at(1), map.at(2)), (1.0, 0.5, 2.0));
    }

    #[test]
    fn maps_of_another_size_or_range_are_refused() {
        let grid = Grid { h: 3, w: 2 };
        let refused =
            |factors: &[f64]| Map::new(grid, factors, "a test", "maps.density").unwrap_err().to_string();
        assert!(refused(&[1.0; 5]).contains("6 numbers"));
        for wrong in [0.0, -1.0, 2e3, f64::NAN, f64::INFINITY] {
            let error = refused(&[1.0, 1.0, 1.0, wrong, 1.0, 1.0]);
            assert!(error.contains("0.001 to 1000") && error.contains("(1, 1)"), "{error}");
        }
    }
}
