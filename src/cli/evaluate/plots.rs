//! The plots of `fnopt evaluate --plots`.

use super::jobs::{Kept, Plan};
use crate::cli::output::progress;
use fnopt::Result;
use fnopt::cloth::Grid;
use fnopt::eval::{
    GapCurve, GapCurves, GapPoint, Physics, Score, Sequence, snapshot_frames, snapshots, timed_gap, track,
    vertex_errors,
};
use fnopt::render::{self, Chart, Curve, ErrorMap, Line, Scale, View, charts, write_png};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;

/// Width and height of a chart \[px\].
const SIZE: (usize, usize) = (640, 420);
/// Numbers of iterations at which the energy is evaluated: up to [`MOST_ITERATIONS_OF_ALL`] for every
/// optimizer, and up to its own number for one that is given more.
const ITERATIONS: [usize; 14] = [1, 2, 3, 5, 8, 10, 15, 20, 30, 50, 100, 150, 250, 500];
const MOST_ITERATIONS_OF_ALL: usize = 30;
/// Frames in which the energy is evaluated, including the start.
const CONVERGENCE_FRAMES: usize = 41;

/// Largest energy gap that is drawn.
const WORST_GAP: f64 = 10.0;

/// File of the energy gap over the time of a frame.
const GAP_OVER_TIME: &str = "gap_ms.png";

/// Axis label of the Chamfer distance.
const E_CD: &str = "e_CD \u{b7} 10\u{b3} [m\u{b2}]";

fn write(folder: &Path, name: &str, all: &[Chart]) -> Result<()> {
    if all.is_empty() { Ok(()) } else { write_png(folder.join(name), &charts(all, SIZE)) }
}

/// The colours of solvers, the same in all charts: by solver and column, in the order of the tables.
struct Colours(Vec<(String, String)>);

impl Colours {
    fn new(columns: impl IntoIterator<Item = (String, String)>) -> Self {
        let mut known = Vec::new();
        for column in columns {
            if !known.contains(&column) {
                known.push(column);
            }
        }
        Self(known)
    }

    fn of_column(&self, name: &str) -> usize {
        self.0.iter().position(|(_, column)| column == name).unwrap_or(self.0.len())
    }

    /// A solver has the colour of its first column.
    fn of_solver(&self, name: &str) -> usize {
        self.0.iter().position(|(solver, _)| solver == name).unwrap_or(self.0.len())
    }
}

/// Draws error and repulsion per frame for every sequence and grid, and error and time against the number of
/// iterations.
pub(super) fn draw(folder: &Path, scores: &[Score]) -> Result<()> {
    let colours = Colours::new(scores.iter().map(|score| (score.solver.clone(), score.column())));
    let of = |figure| per_frame(scores, &colours, figure);
    write(folder, "per_frame.png", &of((E_CD, 1e3, |s| &s.per_frame.e_cd)))?;
    // Without folds there is nothing to see.
    if scores.iter().any(|score| score.per_frame.repulsion.iter().any(|&energy| energy > 0.0)) {
        write(folder, "repulsion.png", &of(("repulsion energy", 1.0, |s| &s.per_frame.repulsion)))?;
    }
    write(folder, "iterations.png", &iterations(scores, &colours))
}

/// Whether a score is of a simulation from the recorded start. Only those are drawn frame by frame.
fn recorded_start(score: &Score) -> bool {
    score.made_with.nudge.is_none()
}

/// Returns the value of a key, inserting a default if there is none. Keys stay in order of first appearance,
/// as in the tables.
fn entry<K: PartialEq, V: Default>(all: &mut Vec<(K, V)>, key: K) -> &mut V {
    let place = all.iter().position(|(known, _)| *known == key).unwrap_or_else(|| {
        all.push((key, V::default()));
        all.len() - 1
    });
    &mut all[place].1
}

/// What to plot of a score: a name, a factor and the values per frame.
type Figure = (&'static str, f64, fn(&Score) -> &Vec<f64>);

fn per_frame(scores: &[Score], colours: &Colours, (name, factor, of): Figure) -> Vec<Chart> {
    let mut curves: Vec<((&str, &str), Vec<Curve>)> = Vec::new();
    for score in scores.iter().filter(|s| recorded_start(s)) {
        // One that diverged has no frames to show, but stays in the legend.
        let points = of(score).iter().enumerate().map(|(f, &v)| [(f + 1) as f64, factor * v]);
        let column = score.column();
        let curve = Curve {
            colour: colours.of_column(&column),
            label: if score.stable { column } else { format!("{column} (diverged)") },
            points: points.collect(),
            notes: Vec::new(),
        };
        entry(&mut curves, (&score.sequence, &score.grid)).push(curve);
    }
    let chart = |((sequence, grid), curves)| Chart {
        title: format!("{sequence} on {grid}"),
        axes: ["frame".into(), name.into()],
        curves,
        lines: Vec::new(),
        scales: [Scale::Linear; 2],
    };
    curves.into_iter().map(chart).collect()
}

/// Draws means over the sequences of a grid and solver against the number of iterations: of 1000 times the
/// error and of the time \[ms\]. There is no point where the solver diverged on any sequence, and no chart if
/// no solver has two points.
fn iterations(scores: &[Score], colours: &Colours) -> Vec<Chart> {
    /// Error and time of every sequence, by the number of iterations; `None` if the solver diverged.
    type Figures = BTreeMap<usize, Vec<Option<[f64; 2]>>>;
    let mut of: Vec<((&str, &str), Figures)> = Vec::new();
    for score in scores.iter().filter(|s| s.iterations > 0) {
        let of_solver = entry(&mut of, (&score.grid, &score.solver));
        let both = score.e_cd.zip(score.ms_per_frame).map(|(e, ms)| [1e3 * e, ms]);
        of_solver.entry(score.iterations).or_default().push(both);
    }
    let mut grids: Vec<(&str, [Vec<Curve>; 2])> = Vec::new();
    for ((grid, solver), means) in of {
        for (k, curves) in entry(&mut grids, grid).iter_mut().enumerate() {
            let mean = |v: &[[f64; 2]]| v.iter().map(|v| v[k]).sum::<f64>() / v.len() as f64;
            let whole = |v: &[Option<[f64; 2]>]| v.iter().copied().collect::<Option<Vec<_>>>();
            let points: Vec<_> =
                means.iter().filter_map(|(&n, v)| Some([n as f64, mean(&whole(v)?)])).collect();
            if !points.is_empty() {
                let (label, colour) = (solver.to_owned(), colours.of_solver(solver));
                curves.push(Curve { label, colour, points, notes: Vec::new() });
            }
        }
    }
    grids.retain(|(_, [errors, _])| errors.iter().any(|curve| curve.points.len() > 1));
    grids
        .into_iter()
        .flat_map(|(grid, [errors, times])| {
            let chart = |what: &str, curves| Chart {
                title: format!("Mean over the sequences on {grid}"),
                axes: ["iterations".into(), what.into()],
                curves,
                lines: Vec::new(),
                scales: [Scale::Logarithmic; 2],
            };
            [chart(E_CD, errors), chart("ms per frame", times)]
        })
        .collect()
}

/// Draws for each sequence and grid a convergence chart, and one of the same energy gaps over time. If `tick`,
/// which is called every frame, ends it, the finished charts are drawn.
pub(super) fn convergence(folder: &Path, plan: &Plan, tick: impl Fn() -> ControlFlow<()>) -> Result<()> {
    let bar = progress((plan.sequences.len() * plan.grids.len()) as u64, "convergence charts");
    let (mut by_iterations, mut over_time) = (Vec::new(), Vec::new());
    let colours = Colours::new(plan.entries.iter().map(|entry| (entry.name.clone(), entry.column())));
    let all = plan.sequences.iter().flat_map(|sequence| plan.grids.iter().map(move |&grid| (sequence, grid)));
    for (sequence, grid) in all {
        bar.set_message(format!("{} {grid}", sequence.name));
        let Some(curves) = convergence_on(sequence, grid, plan, &tick)? else { break };
        let title = format!("{} on {grid}", sequence.name);
        let of: Vec<(&GapCurve, usize)> =
            curves.iter().map(|(solver, curve)| (curve, colours.of_solver(solver))).collect();
        by_iterations.push(gap_by_iterations(title.clone(), &of));
        over_time.push(gap_over_time(title, &of));
        bar.inc(1);
    }
    bar.finish_and_clear();
    write(folder, "convergence.png", &by_iterations)?;
    write(folder, GAP_OVER_TIME, &over_time)
}

/// Measures the median energy gap of every optimizer, and the time of a frame, after various numbers of
/// iterations on a converged simulation of a sequence's first frames. Returns the name of the solver and, with
/// the name of its optimizer, what was measured; `None` if `tick` ended it.
fn convergence_on(
    sequence: &Sequence,
    grid: Grid,
    plan: &Plan,
    tick: &impl Fn() -> ControlFlow<()>,
) -> Result<Option<Vec<(String, GapCurve)>>> {
    let mut scene = sequence.scene(grid, &plan.settings.physics_of(sequence))?;
    scene.frames = Some(sequence.truth.frames().min(plan.settings.frames).min(CONVERGENCE_FRAMES));
    let Some(track) = track(&scene.setup()?, tick)? else { return Ok(None) };
    let mut curves: Vec<(String, GapCurve)> = Vec::new();
    for entry in plan.entries {
        let optimizer = &entry.optimizer;
        // Newton's method converges whatever the number of iterations and has no curve; no optimizer has two.
        if optimizer.converges() || curves.iter().any(|(_, c)| c.solver == optimizer.name()) {
            continue;
        }
        let most = plan.entries.iter().filter(|other| other.optimizer.name() == optimizer.name());
        let most = most.map(|other| other.iterations).fold(MOST_ITERATIONS_OF_ALL, usize::max);
        let mut points = Vec::new();
        for iterations in ITERATIONS.into_iter().filter(|&n| n <= most) {
            let found = timed_gap(&track, (optimizer, iterations), entry.device(plan.device), tick)?;
            let Some(found) = found else { return Ok(None) };
            points.push(GapPoint { iterations, gap: found.median, ms_per_frame: found.ms_per_frame });
        }
        curves.push((entry.name.clone(), GapCurve { solver: optimizer.name().to_owned(), points }));
    }
    Ok(Some(curves))
}

/// Charts energy gaps over the number of iterations, each curve with the number of its colour.
fn gap_by_iterations(title: String, curves: &[(&GapCurve, usize)]) -> Chart {
    let curve = |(curve, colour): &(&GapCurve, usize)| {
        // Above 1 the energy is larger than at the start. How much larger does not matter.
        let point = |point: &GapPoint| [point.iterations as f64, point.gap.min(WORST_GAP)];
        let points = curve.points.iter().map(point).collect();
        Curve { label: curve.solver.clone(), colour: *colour, points, notes: Vec::new() }
    };
    Chart {
        title,
        axes: ["iterations".into(), format!("energy gap (at most {WORST_GAP})")],
        curves: curves.iter().map(curve).collect(),
        lines: Vec::new(),
        scales: [Scale::Logarithmic; 2],
    }
}

/// Charts energy gaps in percent over the time of a frame, each curve with the number of its colour and with the
/// numbers of iterations at its points. A solver that converges has no gap, and its time is a vertical line.
fn gap_over_time(title: String, curves: &[(&GapCurve, usize)]) -> Chart {
    let (mut drawn, mut lines) = (Vec::new(), Vec::new());
    for &(GapCurve { solver, points }, colour) in curves {
        let (converged, points): (Vec<GapPoint>, Vec<GapPoint>) =
            points.iter().partition(|point| point.iterations == 0);
        let line = |point: &GapPoint| Line {
            label: format!("{solver} (converged)"),
            colour,
            at: point.ms_per_frame,
        };
        lines.extend(converged.iter().map(line));
        // Beyond the worst gap there is nothing to compare. Solvers that diverge have no point at all.
        let mut points: Vec<&GapPoint> = points.iter().filter(|point| point.gap <= WORST_GAP).collect();
        // Joined by the number of iterations: a time that was disturbed is a step back, and not a zigzag of the gap.
        points.sort_by_key(|point| point.iterations);
        if !points.is_empty() {
            let notes = points.iter().map(|point| point.iterations.to_string()).collect();
            let points = points.iter().map(|point| [point.ms_per_frame, 100.0 * point.gap]).collect();
            drawn.push(Curve { label: solver.clone(), colour, points, notes });
        }
    }
    Chart {
        title,
        axes: ["ms per frame (at the points: iterations)".into(), "energy gap [%]".into()],
        curves: drawn,
        lines,
        scales: [Scale::Logarithmic; 2],
    }
}

/// Draws the energy gap over the time of a frame for each grid on which a solver has a point.
pub(super) fn gaps_over_time(folder: &Path, all: &[GapCurves]) -> Result<()> {
    let names = all.iter().flat_map(|of| of.solvers.iter().map(|curve| curve.solver.clone()));
    let colours = Colours::new(names.map(|name| (name.clone(), name)));
    let chart = |GapCurves { grid, solvers }: &GapCurves| {
        let curves: Vec<(&GapCurve, usize)> =
            solvers.iter().map(|curve| (curve, colours.of_solver(&curve.solver))).collect();
        gap_over_time(format!("Energy gap over time on {grid}"), &curves)
    };
    let charts: Vec<Chart> = all.iter().map(chart).filter(|chart| !chart.curves.is_empty()).collect();
    write(folder, GAP_OVER_TIME, &charts)
}

/// Draws a few frames of a sequence and, for each grid, of every simulation of it, coloured by the distance
/// from the truth.
pub(super) fn error_maps(folder: &Path, sequence: &Sequence, (all, frames): (&[Kept], usize)) -> Result<()> {
    let truth = snapshots(&sequence.truth, frames);
    let times = snapshot_frames(sequence.truth.frames().min(frames)).map(|f| f as f64 / sequence.truth.fps());
    let here = |kept: &&Kept| kept.score.sequence == sequence.name && recorded_start(&kept.score);
    let mut grids: Vec<(&str, Vec<ErrorMap>)> = Vec::new();
    for kept in all.iter().filter(here) {
        let Some(found) = &kept.snapshots else { continue };
        let errors = |f| vertex_errors((found.frame(f), found.grid()), (truth.frame(f), truth.grid()));
        let map = ErrorMap {
            label: kept.score.column(),
            errors: (0..found.frames()).map(errors).collect(),
            frames: found.clone(),
        };
        entry(&mut grids, &*kept.score.grid).push(map);
    }
    let view = View { up: [0.0, 1.0, 0.0], ..Default::default() };
    let handles =
        sequence.scene(sequence.grid(), &Physics::default())?.setup()?.model.cloths[0].handles.clone();
    for (grid, maps) in grids {
        let image = render::error_maps(&truth, &times, &handles, &maps, &view);
        write_png(folder.join(format!("errors_{}_{grid}.png", sequence.name)), &image)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{Colours, WORST_GAP, gap_over_time};
    use fnopt::eval::{GapCurve, GapPoint};

    #[test]
    fn gaps_over_time_are_in_percent_with_their_iterations() {
        let point =
            |(iterations, ms_per_frame, gap): (usize, f64, f64)| GapPoint { iterations, gap, ms_per_frame };
        let curve = |solver: &str, points: &[(usize, f64, f64)]| GapCurve {
            solver: solver.into(),
            points: points.iter().copied().map(point).collect(),
        };
        let lbfgs = curve("lbfgs", &[(20, 4.0, 0.25), (5, 5.0, 0.5), (3, 2.0, 2.0 * WORST_GAP)]);
        let newton = curve("newton", &[(0, 9.0, 1e-9)]);
        let wild = curve("wild", &[(3, 1.0, f64::INFINITY)]);
        let chart = gap_over_time("t".into(), &[(&lbfgs, 2), (&newton, 5), (&wild, 3)]);
        assert_eq!((chart.curves.len(), chart.lines.len()), (1, 1));
        let drawn = &chart.curves[0];
        assert_eq!(
            (&*drawn.label, drawn.colour, &drawn.points),
            ("lbfgs", 2, &vec![[5.0, 50.0], [4.0, 25.0]])
        );
        assert_eq!(drawn.notes, ["5", "20"]);
        assert_eq!(
            (&*chart.lines[0].label, chart.lines[0].colour, chart.lines[0].at),
            ("newton (converged)", 5, 9.0)
        );
    }

    #[test]
    fn a_solver_has_one_colour_in_all_charts() {
        let columns = [("fnopt", "fnopt, N = 5"), ("newton", "newton"), ("fnopt", "fnopt, N = 10")];
        let twice =
            columns.iter().chain(&columns).map(|(solver, column)| ((*solver).into(), (*column).into()));
        let colours = Colours::new(twice);
        assert_eq!(columns.map(|(_, column)| colours.of_column(column)), [0, 1, 2]);
        assert_eq!(columns.map(|(solver, _)| colours.of_solver(solver)), [0, 1, 0]);
        assert_eq!(colours.of_column("adam"), 3);
    }
}
