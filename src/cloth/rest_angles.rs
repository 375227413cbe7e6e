//! Sheets that are not flat at rest: folded, pleated or curled.

use super::Grid;
use crate::{Error, Result};
use std::f64::consts::PI;
use std::sync::Arc;

/// The angles by which a sheet turns at rest at each of its particles, from one edge to the next: along the height
/// and along the width of its grid, in radians. Positive ones turn it towards its front, the side from which its
/// triangles are counter-clockwise; 0 everywhere is a flat sheet.
///
/// The bend of the paper is the angle between two edges, which has no sign. So a rest angle is a couple, a
/// moment on both edges that is 2 rest times the coefficient of the bend ([`Angle`](super::terms::Angle)): where nothing
/// else pulls, the sheet turns by its rest angles. Where it ends there is no angle, and what is given for it does
/// nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct RestAngles {
    grid: Grid,
    angles: Arc<[[f32; 2]]>,
}

impl RestAngles {
    /// Returns the rest angles [H, W] of a grid. Fails if the length is not the grid's, or an angle is not between
    /// -pi and pi; `origin` and `field` name their source.
    pub fn new(grid: Grid, angles: &[[f64; 2]], origin: &str, field: &str) -> Result<Self> {
        if angles.len() != grid.particles() {
            let expected = format!("{} pairs of angles, one for each particle", grid.particles());
            return Err(Error::invalid(origin, field, expected, angles.len()));
        }
        let is_good = |angles: &[f64; 2]| angles.iter().all(|angle| angle.abs() < PI);
        if let Some(p) = angles.iter().position(|angles| !is_good(angles)) {
            let [i, j] = [p / grid.w, p % grid.w];
            let found = format!("{:?} at particle ({i}, {j})", angles[p].map(|a| a.to_degrees().round()));
            return Err(Error::invalid(origin, field, "angles between -180 and 180 degrees", found));
        }
        Ok(Self { grid, angles: angles.iter().map(|angles| angles.map(|angle| angle as f32)).collect() })
    }

    /// Returns the grid that they belong to.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Returns the angles along the height and along the width at particle `p`. Panics if the grid has no such particle.
    pub fn at(&self, p: usize) -> [f32; 2] {
        self.angles[p]
    }
}
