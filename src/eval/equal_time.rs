//! Energy gaps at equal time: what a solver reaches in the time that another takes.

use super::score::column;
use super::suite::CaseScore;
use super::tables::DIVERGED;
use super::{Cell, Table};

/// The number of iterations whose times are common ones, or the nearest that was measured.
const USUAL: f64 = 10.0;
/// Smallest figure that is told from 0.
const LEAST: f64 = 5e-5;

/// The energy gap of a solver after a number of iterations, and the time that they take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GapPoint {
    /// Iterations per frame; 0 for a solver that converges.
    pub iterations: usize,
    /// Median energy gap; infinite if one of the gaps is not finite.
    pub gap: f64,
    /// Median wall time of a frame \[ms\].
    pub ms_per_frame: f64,
}

/// The energy gap of a solver over the time of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct GapCurve {
    /// Name of the solver.
    pub solver: String,
    /// Points, with the time ascending.
    pub points: Vec<GapPoint>,
}

/// The energy gaps of solvers on a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GapCurves {
    /// The grid, as in `32x32`.
    pub grid: String,
    /// A curve for each solver, in order of first appearance.
    pub solvers: Vec<GapCurve>,
}

impl GapCurve {
    /// Returns the gap in frames of `ms`, interpolated between the two points next to it in the logarithms of gap
    /// and time. `None` outside the times of the points, and next to a gap that is not a positive number.
    pub fn at(&self, ms: f64) -> Option<f64> {
        if let Some(point) = self.points.iter().find(|point| point.ms_per_frame == ms) {
            return Some(point.gap).filter(|gap| gap.is_finite());
        }
        let around = |ends: &&[GapPoint]| ends[0].ms_per_frame < ms && ms < ends[1].ms_per_frame;
        let ends = self.points.windows(2).find(around)?;
        let [a, b] = [ends[0], ends[1]];
        if ![a, b].iter().all(|point| point.gap.is_finite() && point.gap > 0.0) {
            return None;
        }
        let share = (ms / a.ms_per_frame).ln() / (b.ms_per_frame / a.ms_per_frame).ln();
        Some(a.gap * (b.gap / a.gap).powf(share))
    }

    /// Returns the point with the number of iterations that is nearest to [`USUAL`].
    fn usual(&self) -> Option<&GapPoint> {
        let apart = |point: &GapPoint| (point.iterations as f64 / USUAL).ln().abs();
        self.points.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))
    }
}

/// Collects the gaps of named solvers in the cases of [`Suite::Iterations`](super::suite::Suite::Iterations), by
/// grid. Scores without a gap or a time are left out.
pub fn gap_curves<'a>(scores: impl IntoIterator<Item = (&'a str, &'a CaseScore)>) -> Vec<GapCurves> {
    let mut grids: Vec<GapCurves> = Vec::new();
    for (solver, score) in scores {
        let (Some(gap), Some(ms_per_frame)) = (score.measured_gap(), score.gap_ms_per_frame) else {
            continue;
        };
        let of_grid = grids.iter().position(|of| of.grid == score.grid).unwrap_or_else(|| {
            grids.push(GapCurves { grid: score.grid.clone(), solvers: Vec::new() });
            grids.len() - 1
        });
        let solvers = &mut grids[of_grid].solvers;
        let of_solver = solvers.iter().position(|of| of.solver == solver).unwrap_or_else(|| {
            solvers.push(GapCurve { solver: solver.to_owned(), points: Vec::new() });
            solvers.len() - 1
        });
        solvers[of_solver].points.push(GapPoint { iterations: score.iterations, gap, ms_per_frame });
    }
    let curves = grids.iter_mut().flat_map(|of| &mut of.solvers);
    curves.for_each(|curve| curve.points.sort_by(|a, b| a.ms_per_frame.total_cmp(&b.ms_per_frame)));
    grids
}

/// Builds two tables for each grid: gap and time of every solver and number of iterations; then the gaps of all
/// solvers at equal time, at the time that each of them takes for ten iterations or the nearest number measured,
/// if there are several. A cell is empty where the time is outside those that were measured of a solver.
pub fn gap_tables(all: &[GapCurves]) -> Vec<Table> {
    let tables = all.iter().flat_map(|of_grid| [gaps_and_times(of_grid), at_equal_time(of_grid)]);
    tables.filter(|table| !table.rows.is_empty()).collect()
}

fn gaps_and_times(GapCurves { grid, solvers }: &GapCurves) -> Table {
    let row = |curve: &GapCurve, point: &GapPoint| {
        let cells = [percent(point.gap), significant(point.ms_per_frame)];
        (column(&curve.solver, point.iterations), cells.map(|text| Cell { text, best: false }).to_vec())
    };
    // By the number of iterations, whatever the times.
    let rows = |curve: &GapCurve| {
        let mut points = curve.points.clone();
        points.sort_by_key(|point| point.iterations);
        points.iter().map(|point| row(curve, point)).collect::<Vec<_>>()
    };
    Table {
        title: format!("{grid}: energy gap and time of a frame alone"),
        columns: ["solver", "energy gap [%]", "ms/frame"].map(str::to_owned).to_vec(),
        rows: solvers.iter().flat_map(rows).collect(),
    }
}

fn at_equal_time(GapCurves { grid, solvers }: &GapCurves) -> Table {
    let usual = |curve: &GapCurve| {
        let point = curve.usual()?;
        Some((point.ms_per_frame, column(&curve.solver, point.iterations)))
    };
    let mut times: Vec<(f64, String)> = solvers.iter().filter_map(usual).collect();
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    let row = |(ms, of): (f64, String)| {
        let gaps: Vec<Option<f64>> = solvers.iter().map(|curve| curve.at(ms)).collect();
        let smallest = gaps.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        let cell = |gap: &Option<f64>| Cell {
            text: gap.map_or_else(String::new, percent),
            best: gaps.iter().flatten().count() > 1 && *gap == Some(smallest),
        };
        (format!("{} ms ({of})", significant(ms)), gaps.iter().map(cell).collect())
    };
    // A single solver is compared with none.
    let times = times.into_iter().filter(|_| solvers.len() > 1);
    let names = solvers.iter().map(|curve| curve.solver.clone());
    Table {
        title: format!("{grid}: energy gap [%] at equal time"),
        columns: std::iter::once("time of a frame".to_owned()).chain(names).collect(),
        rows: times.map(row).collect(),
    }
}

/// Formats a share in percent.
fn percent(share: f64) -> String {
    if share.is_finite() { significant(100.0 * share) } else { DIVERGED.to_owned() }
}

/// Formats a number with three significant digits, if they are among the first four decimals.
fn significant(value: f64) -> String {
    if value.abs() < LEAST {
        return "0".to_owned();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 4) as usize;
    format!("{value:.digits$}")
}
