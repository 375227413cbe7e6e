//! Measures of `fnopt::eval` on arrays.

use super::arrays::{Points, to_python};
use super::errors::raised;
use super::scene::{GridArgument, scene_of};
use crate::cloth::{self, Grid};
use crate::eval::{self, FreeEdges, Soundness};
use crate::scene::Setup;
use crate::sim::FrameStats;
use crate::{Error, Frame};
use numpy::{IntoPyArray, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

/// Compares frames with true ones, both [frames, particles, 3] in metres: for each frame the mean and the largest distance
/// of a particle from where it should be [m] and the relative error |found - truth| / |truth|, each [frames].
#[pyfunction]
pub(super) fn compare<'py>(
    py: Python<'py>,
    found: &Bound<'py, PyAny>,
    truth: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let (found, truth) = (Points::take(found, "found")?, Points::take(truth, "truth")?);
    let &[frames, particles] = &found.axes[..] else {
        return Err(PyValueError::new_err("found: expected an array [frames, particles, 3]"));
    };
    if found.axes != truth.axes || particles == 0 {
        let text = format!("truth: expected frames and particles {:?}, found {:?}", found.axes, truth.axes);
        return Err(PyValueError::new_err(text));
    }
    let mut columns = [const { Vec::new() }; 3];
    py.detach(|| {
        for f in 0..frames {
            let own = f * particles..(f + 1) * particles;
            let (found, truth) = (&found.points[own.clone()], &truth.points[own]);
            let apart =
                |(p, q): (&[f64; 3], &[f64; 3])| (0..3).map(|c| (p[c] - q[c]).powi(2)).sum::<f64>().sqrt();
            let distances: Vec<f64> = found.iter().zip(truth).map(apart).collect();
            let larger = |a: f64, &b: &f64| if a.is_nan() || a > b { a } else { b };
            columns[0].push(distances.iter().sum::<f64>() / particles as f64);
            columns[1].push(distances.iter().fold(0.0, larger));
            columns[2].push(eval::relative_error(found, truth));
        }
    });
    let all = PyDict::new(py);
    for (name, column) in ["distance_mean", "distance_largest", "relative_error"].iter().zip(columns) {
        all.set_item(name, column.into_pyarray(py))?;
    }
    Ok(all)
}

/// The Chamfer distance of two clouds of points, [points, 3] each: the mean squared distance to the nearest point of the
/// other, summed over both directions [m^2].
#[pyfunction]
pub(super) fn chamfer(py: Python<'_>, a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> PyResult<f64> {
    let cloud = |array, name| {
        let points = Points::take(array, name)?.points;
        let is_whole = !points.is_empty() && points.iter().flatten().all(|c| c.is_finite());
        is_whole
            .then_some(points)
            .ok_or_else(|| PyValueError::new_err(format!("{name}: expected finite points, at least one")))
    };
    let (a, b) = (cloud(a, "a")?, cloud(b, "b")?);
    Ok(py.detach(|| eval::chamfer(&a, &b)))
}

/// Where a cloth, [particles, 3] on a grid (N, or (H, W)), passes through itself: an array [found, 3] of the particles at the
/// ends of an edge and the triangle that it passes through, as a row of `faces`. Exact.
#[pyfunction]
pub(super) fn intersections<'py>(
    py: Python<'py>,
    positions: &Bound<'py, PyAny>,
    grid: GridArgument,
) -> PyResult<Bound<'py, PyArray2<u32>>> {
    let grid = grid.grid()?;
    let points = Points::take(positions, "positions")?.broadcast(&[grid.particles()], "positions")?;
    let found = py.detach(|| {
        let x: Vec<f64> = (0..3).flat_map(|c| points.iter().map(move |p| p[c])).collect();
        cloth::intersections(&grid.faces(), &x)
    });
    super::simulation::rows(py, found.iter().map(|one| [one.edge[0], one.edge[1], one.face]).collect())
}

/// Judges frames of a scene, [frames, particles, 3] in metres, frame 0 the start, whoever computed them: `stretch_largest_free`
/// (of edges away from handles) and `stretch_largest`, as a share of the edge, `gap_estimate`, the share of a frame's decrease
/// of the energy that is left undone, as a median over frames, `sound`, and `unsound`, why not, in words. Without velocities,
/// they are the differences of positions.
#[pyfunction]
#[pyo3(signature = (scene, positions, velocities = None))]
pub(super) fn soundness<'py>(
    py: Python<'py>,
    scene: &Bound<'py, PyAny>,
    positions: &Bound<'py, PyAny>,
    velocities: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let scene = scene_of(scene)?;
    let positions = Points::take(positions, "positions")?;
    let shape = [positions.axes.first().copied().unwrap_or(0), scene.grid.particles()];
    let positions = positions.broadcast(&shape, "positions")?;
    let velocities = match velocities {
        Some(velocities) => Some(Points::take(velocities, "velocities")?.broadcast(&shape, "velocities")?),
        None => None,
    };
    let verdict = py.detach(|| {
        let setup = scene.setup()?;
        judge(&setup, &positions, velocities.as_deref())
    });
    let verdict = verdict.map_err(raised)?;
    let unsound: Vec<String> = verdict.faults().iter().map(ToString::to_string).collect();
    to_python(
        py,
        &json!({
            "sound": unsound.is_empty(),
            "unsound": unsound,
            "stretch_largest_free": verdict.stretch_largest_free,
            "stretch_largest": verdict.stretch_largest,
            "gap_estimate": verdict.gap_estimate,
        }),
    )
}

/// Judges all frames of a scene.
fn judge(
    setup: &Setup,
    positions: &[[f64; 3]],
    velocities: Option<&[[f64; 3]]>,
) -> crate::Result<eval::Verdict> {
    let grid: Grid = setup.model.grid;
    let n = grid.particles();
    let frames = positions.len() / n;
    if frames < 2 {
        return Err(Error::invalid("soundness", "positions", "at least two frames", frames));
    }
    let state = |f: usize| {
        let own = f * n..(f + 1) * n;
        let before = &positions[f.saturating_sub(1) * n..][..n];
        let own_positions = &positions[own.clone()];
        let differences = || {
            let rate = 1.0 / setup.units.frame_time_s;
            let moved = own_positions.iter().zip(before);
            moved.map(|(p, q)| std::array::from_fn(|c| (p[c] - q[c]) * rate)).collect::<Vec<[f64; 3]>>()
        };
        let velocities = velocities.map_or_else(differences, |all| all[own].to_vec());
        Ok::<_, Error>(setup.state_of(grid, own_positions, &velocities)?.cast::<f32>())
    };
    // Without handles, every edge is free.
    let mut held = setup.model.clone();
    held.cloths[0].handles.clear();
    let all_edges = FreeEdges::new(&held, 0);
    let script = crate::scene::Script::new(setup);
    let mut soundness = Soundness::after(script, &state(0)?);
    for index in 1..frames {
        let state = state(index)?;
        let stats = FrameStats { stretch_largest: all_edges.largest(&state.x), ..FrameStats::default() };
        soundness.judge(&Frame { index, state, stats: vec![stats], wall: Default::default() });
    }
    Ok(soundness.verdict())
}
