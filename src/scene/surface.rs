//! Sampled sheets: the stored drape, and resampling from one grid to another.

use super::points::{self, norm, zip};
use crate::cloth::Grid;
use crate::{Result, io};

/// The default cloth at rest on 32x32 particles, hanging from two corners, which are 0.9 of the side apart; side 1 m,
/// y up.
const SETTLED: &[u8] = include_bytes!("../../assets/starts/settled_32.npy");

/// Positions of the particles of a grid, in the order of their numbers.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    /// The grid.
    pub grid: Grid,
    /// The position of each particle.
    pub points: Vec<[f64; 3]>,
}

impl Sheet {
    /// Returns the settled drape on `grid` for a sheet of height 1 m, y up \[m\].
    pub fn settled(grid: Grid) -> Result<Self> {
        let stored = io::parse_npy("the stored drape", SETTLED)?;
        let grid_of = Grid { h: stored.shape()[0], w: stored.shape()[1] };
        Ok(Self { grid: grid_of, points: points::from_array("the stored drape", &stored)? }.regrid(grid))
    }

    /// Resamples the sheet to another grid of square cells, keeping its height. If the ratio of the sides
    /// changes, the sheet becomes longer or shorter along its width, so that edges roughly keep their length.
    pub fn regrid(&self, grid: Grid) -> Self {
        let ratio = grid.aspect() / self.grid.aspect();
        let mut sheet = self.regrid_velocities(grid);
        if ratio > 1.0 + 1e-9 {
            sheet.lengthen(ratio);
        }
        sheet
    }

    /// As [`Sheet::regrid`], for the velocities of a sheet: shortened like the sheet, because that is linear,
    /// but not lengthened, because that only shifts columns.
    pub fn regrid_velocities(&self, grid: Grid) -> Self {
        let mut sheet = if grid == self.grid { self.clone() } else { self.resample(grid) };
        let ratio = grid.aspect() / self.grid.aspect();
        if ratio < 1.0 - 1e-9 {
            sheet.shorten(ratio);
        }
        sheet
    }

    /// Samples the sheet at the particles of another grid with Catmull-Rom splines, corners aligned. Linear
    /// interpolation would put all the bending of a finer grid into creases along the lines of the coarser
    /// one.
    fn resample(&self, grid: Grid) -> Self {
        let place = |k: usize, n: usize, m: usize| (k * (n - 1)) as f64 / (m - 1) as f64;
        let mut points = Vec::with_capacity(grid.particles());
        // Along the height first, for the columns of the source, then along the width.
        let mut row = vec![[0.0; 3]; self.grid.w];
        for i in 0..grid.h {
            let at = place(i, self.grid.h, grid.h);
            for (j, point) in row.iter_mut().enumerate() {
                *point = spline(self.grid.h, at, |k| self.points[k * self.grid.w + j]);
            }
            points.extend((0..grid.w).map(|j| spline(row.len(), place(j, row.len(), grid.w), |k| row[k])));
        }
        Self { grid, points }
    }

    /// Contracts every row of particles towards its end at j = 0. Edges along the width become exactly `ratio`
    /// times as long; edges along the height become blends of two of the original ones.
    fn shorten(&mut self, ratio: f64) {
        for row in self.points.chunks_mut(self.grid.w) {
            let end = row[0];
            row.iter_mut().for_each(|p| *p = zip(end, *p, |e, p| e + ratio * (p - e)));
        }
    }

    /// Shifts every column as a whole along its mean direction from the previous column, until the edges
    /// between the two are on average `ratio` times as long. Edges along the height do not change: stretching
    /// each row separately, as [`Sheet::shorten`] does, would tear apart the neighbouring rows of a fold.
    fn lengthen(&mut self, ratio: f64) {
        let Grid { h, w } = self.grid;
        let before = self.points.clone();
        let mut moved = [0.0; 3];
        for j in 1..w {
            let edges: Vec<[f64; 3]> =
                (0..h).map(|i| zip(before[i * w + j], before[i * w + j - 1], |b, a| b - a)).collect();
            let mean = edges.iter().fold([0.0; 3], |sum, e| zip(sum, *e, |a, b| a + b / h as f64));
            let direction = match norm(mean) {
                0.0 => [1.0, 0.0, 0.0],
                length => mean.map(|c| c / length),
            };
            let length = |by: f64| {
                edges.iter().map(|e| norm(zip(*e, direction, |e, d| e + by * d))).sum::<f64>() / h as f64
            };
            // The mean length grows with the shift, and a shift of (ratio + 1) times the length exceeds the
            // aim.
            let aim = ratio * length(0.0);
            let (mut low, mut high) = (0.0, aim + length(0.0));
            for _ in 0..24 {
                let middle = 0.5 * (low + high);
                if length(middle) < aim { low = middle } else { high = middle }
            }
            moved = zip(moved, direction, |m, d| m + high * d);
            for i in 0..h {
                let point = &mut self.points[i * w + j];
                *point = zip(*point, moved, |p, m| p + m);
            }
        }
    }
}

/// Evaluates the Catmull-Rom spline through `n` points at parameter `at`, 0 to n - 1. Beyond the ends the
/// points are extrapolated linearly.
fn spline(n: usize, at: f64, point: impl Fn(usize) -> [f64; 3]) -> [f64; 3] {
    let k = (at as usize).min(n - 2);
    let t = at - k as f64;
    let (b, c) = (point(k), point(k + 1));
    let a = if k > 0 { point(k - 1) } else { zip(b, c, |b, c| 2.0 * b - c) };
    let d = if k + 2 < n { point(k + 2) } else { zip(c, b, |c, b| 2.0 * c - b) };
    std::array::from_fn(|x| {
        let slope_b = 0.5 * (c[x] - a[x]);
        let slope_c = 0.5 * (d[x] - b[x]);
        let rise = c[x] - b[x];
        let (quadratic, cubic) = (3.0 * rise - 2.0 * slope_b - slope_c, slope_b + slope_c - 2.0 * rise);
        b[x] + t * (slope_b + t * (quadratic + t * cubic))
    })
}
