//! One solver on one sequence: what it cost and how far from the truth it was.

use super::metrics::{Surface, chamfer, relative_error};
use super::nearness::{Nearness, mean_and_shares};
use super::physics::Physics;
use super::resampling::{Resampling, coarse};
use super::{Conditions, FreeEdges, Nudge, Sequence, median_time};
use crate::io::Trajectory;
use crate::scene::{Scene, Setup};
use crate::sim::{Device, EnergyTerms, FrameStats, Grid, Optimizer, Simulator};
use crate::{Error, Result, io};
use rayon::prelude::*;
use std::borrow::Cow;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;

/// An edge away from the handles that is this much longer than at rest tells that a simulation diverged.
const DIVERGED: f64 = 3.0;
/// Seconds at the end over which the speed is averaged.
const SETTLED_S: f64 = 0.5;
/// Frames that [`snapshots`] keeps.
pub const SNAPSHOTS: usize = 4;

/// A solver that takes part.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Name of its column, such as `fnopt` or `adam`.
    pub name: String,
    /// The optimizer.
    pub optimizer: Optimizer,
    /// Iterations per frame.
    pub iterations: usize,
    /// Whether it only works out accelerations on [`coarse`] grids, which are carried to the grid that was asked for (the
    /// baseline `interpolation`).
    pub coarse: bool,
}

impl Entry {
    /// Where it runs when `device` was asked for: some optimizers only the CPU has.
    pub fn device<'a>(&self, device: &'a Device) -> &'a Device {
        if self.optimizer.runs_on_gpu() { device } else { &Device::Cpu }
    }

    /// Iterations as scores tell them: 0 of an optimizer that converges whatever their number.
    pub(super) fn told_iterations(&self) -> usize {
        if matches!(self.optimizer, Optimizer::Newton) { 0 } else { self.iterations }
    }

    /// Name of its column in tables: the solver and its iterations.
    pub fn column(&self) -> String {
        column(&self.name, self.told_iterations())
    }
}

/// A name, and iterations where they mean something.
pub(super) fn column(solver: &str, iterations: usize) -> String {
    match iterations {
        0 => solver.to_owned(),
        n => format!("{solver}, N = {n}"),
    }
}

/// What all entries share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The cloth and the air.
    pub physics: Physics,
    /// Points sampled from each surface for e_CD.
    pub points: usize,
    /// Frames that are simulated, the start included; all of a sequence at most.
    pub frames: usize,
}

impl Settings {
    /// The settings as a document: `material` as in a scene, null for what is the sequence's.
    pub fn to_json(&self) -> serde_json::Value {
        let Physics { stiffness, density, drag, frame_time_s } = self.physics;
        let scene = Scene { stiffness, ..Scene::default() }.to_json();
        serde_json::json!({
            "material": scene["material"],
            "density": density,
            "drag": drag,
            "frame_time_s": frame_time_s,
            "points": self.points,
            "frames": Some(self.frames).filter(|&frames| frames < usize::MAX),
        })
    }
}

/// How one solver did on one sequence. Without frames to judge, because it diverged, there are no numbers.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Score {
    /// Name of the sequence.
    pub sequence: String,
    /// The grid, as in `32x32`.
    pub grid: String,
    /// Name of the solver.
    pub solver: String,
    /// Iterations per frame; 0 where that means nothing.
    pub iterations: usize,
    /// Frames that were judged, the start not among them.
    pub frames: usize,
    /// Whether all frames were finite and of about the right size.
    pub stable: bool,
    /// Mean Chamfer distance [m^2].
    pub e_cd: Option<f64>,
    /// Mean relative error of the vertices, on the truth's grid.
    pub e_3d: Option<f64>,
    /// Median wall time of a frame \[ms\].
    pub ms_per_frame: Option<f64>,
    /// Mean over the frames of the total energy (grid units).
    pub energy: Option<f64>,
    /// Means over the frames of its terms (grid units).
    pub energy_terms: Option<EnergyTerms>,
    /// Mean over the frames of |dL/da| at the last iteration (grid units).
    pub gradient: Option<f64>,
    /// Largest `|edge| - 1` of the edges away from handles.
    pub stretch_largest: Option<f64>,
    /// Mean over the frames and all edges of `||edge| - 1|`.
    pub stretch_mean: Option<f64>,
    /// Mean speed of the particles in the last half second [m/s]: how far the cloth has settled.
    pub speed_at_end: Option<f64>,
    /// Mean repulsion energy on [`coarse`] grids, and the shares of frames in which it exceeds 0.1 and 0.02 (paper section 6.1).
    pub repulsion: Option<[f64; 3]>,
    /// What it was made with.
    pub made_with: Conditions,
    /// Figures of every frame.
    pub per_frame: PerFrame,
}

/// Figures of every frame.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PerFrame {
    /// Chamfer distance [m^2].
    pub e_cd: Vec<f64>,
    /// Relative error of the vertices.
    pub e_3d: Vec<f64>,
    /// Repulsion energy.
    pub repulsion: Vec<f64>,
}

impl Score {
    /// Name of its column in tables: the solver and its iterations.
    pub fn column(&self) -> String {
        column(&self.solver, self.iterations)
    }

    /// Whether it is another system's ([`compare`]), which no device of ours has simulated.
    pub fn is_imported(&self) -> bool {
        self.iterations == 0 && self.made_with.device.is_none()
    }

    /// Reads a score that [`Score::write`] kept.
    pub fn read(path: &Path) -> Result<Self> {
        read_kept(path)
    }

    /// Keeps the score as JSON.
    pub fn write(&self, path: &Path) -> Result<()> {
        keep(path, self)
    }
}

/// A score of whatever kind that [`keep`] wrote.
pub(super) fn read_kept<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let bytes = io::read_bytes(path)?;
    let origin = path.display().to_string();
    serde_json::from_slice(&bytes).map_err(|e| {
        Error::invalid(origin, "score", "one that was kept (without the file it is made anew)", e)
    })
}

/// Keeps a score of whatever kind as JSON.
pub(super) fn keep(path: &Path, score: &impl serde::Serialize) -> Result<()> {
    let json = serde_json::to_vec(score).expect("scores are plain data");
    io::write_atomic(path, |file| file.write_all(&json))
}

/// What a simulation leaves to be judged.
pub(super) struct Simulated {
    pub trajectory: Trajectory,
    pub stats: Vec<FrameStats>,
    pub times_ms: Vec<f64>,
    pub stretch_largest: f64,
    pub stable: bool,
    pub ended_early: bool,
}

impl Simulated {
    /// Median wall time of a frame \[ms\], without the first frames where there are more; none without frames.
    pub fn ms_per_frame(&self) -> Option<f64> {
        (!self.times_ms.is_empty()).then(|| median_time(&self.times_ms))
    }
}

/// Simulates a sequence on a grid, from its recorded start or that of a repeat, and judges it; the score and what was
/// simulated. An optimizer that only the CPU has runs there. `tick` is called after each frame and may end everything;
/// then there is nothing.
pub fn run(
    (sequence, nudge): (&Sequence, Option<Nudge>),
    grid: Grid,
    entry: &Entry,
    (device, settings): (&Device, &Settings),
    tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Option<(Score, Trajectory)>> {
    let setup = |grid| -> Result<Setup> {
        let mut scene = sequence.scene(grid, &settings.physics)?;
        scene.frames = Some(sequence.truth.frames().min(settings.frames));
        let mut setup = scene.setup()?;
        if let Some(nudge) = nudge {
            nudge.apply(&mut setup);
        }
        Ok(setup)
    };
    let own = if entry.coarse { coarse(grid) } else { grid };
    let mut simulated = simulate(&setup(own)?, entry, entry.device(device), tick)?;
    if simulated.ended_early {
        return Ok(None);
    }
    if own != grid {
        let start = setup(grid)?;
        simulated.trajectory = carried(&simulated.trajectory, grid, &start.vertices_m(&start.start.x));
    }
    let mut score = Score {
        iterations: entry.told_iterations(),
        made_with: Conditions::of((sequence, nudge), entry, (device, settings)),
        ..judge(sequence, (&entry.name, &simulated.trajectory), simulated.stable, settings)?
    };
    if score.stable && !simulated.stats.is_empty() {
        let mean = |of: &dyn Fn(&FrameStats) -> f64| {
            simulated.stats.iter().map(of).sum::<f64>() / simulated.stats.len() as f64
        };
        score.ms_per_frame = simulated.ms_per_frame();
        // Those of another grid's cloth would say nothing.
        if own == grid {
            score.energy = Some(mean(&|s| s.energy.total()));
            let term = |k: usize| mean(&|s| s.energy.to_array()[k]);
            score.energy_terms = Some(EnergyTerms::from_array([0, 1, 2, 3, 4, 5].map(term)));
            score.gradient = Some(mean(&|s| s.gradient_last));
            score.stretch_largest = Some(simulated.stretch_largest);
            score.stretch_mean = Some(mean(&|s| s.stretch_mean));
        }
    }
    Ok(Some((score, simulated.trajectory)))
}

/// Accelerations of a trajectory, carried to a finer grid and integrated there from `start`. Both are linear, so this is the
/// same as carrying the way from the first frame.
fn carried(coarse: &Trajectory, grid: Grid, start: &[[f64; 3]]) -> Trajectory {
    let resampling = Resampling::new(coarse.grid(), grid);
    let mut fine = Trajectory::new(grid, coarse.fps());
    for frame in 0..coarse.frames() {
        let moved = coarse.frame(frame).iter().zip(coarse.frame(0));
        let moved: Vec<[f64; 3]> =
            moved.map(|(a, b)| std::array::from_fn(|c| f64::from(a[c]) - f64::from(b[c]))).collect();
        let place = |(x, d): (&[f64; 3], [f64; 3])| std::array::from_fn(|c| (x[c] + d[c]) as f32);
        let positions: Vec<[f32; 3]> = start.iter().zip(resampling.apply(&moved)).map(place).collect();
        fine.push(&positions, &vec![[0.0; 3]; positions.len()]);
    }
    fine
}

/// A few frames of a trajectory to look at, evenly spread over its first `frames`, the last of them included.
pub fn snapshots(trajectory: &Trajectory, frames: usize) -> Trajectory {
    let mut kept = Trajectory::new(trajectory.grid(), trajectory.fps());
    let last = trajectory.frames().min(frames).saturating_sub(1);
    for k in 1..=SNAPSHOTS {
        let frame = trajectory.frame(k * last / SNAPSHOTS);
        kept.push(frame, &vec![[0.0; 3]; frame.len()]);
    }
    kept
}

/// Distances of the vertices of a frame from a truth on another grid \[m\], at the frame's vertices.
pub fn vertex_errors((found, grid): (&[[f32; 3]], Grid), (truth, of_truth): (&[[f32; 3]], Grid)) -> Vec<f32> {
    let wide: Vec<[f64; 3]> = truth.iter().map(|p| p.map(f64::from)).collect();
    let truth = Resampling::new(of_truth, grid).apply(&wide);
    let apart = |(p, q): (&[f32; 3], [f64; 3])| distance(*p, q.map(|c| c as f32)) as f32;
    found.iter().zip(truth).map(apart).collect()
}

/// Judges positions that another system made for a sequence, on whatever grid they have, or on the sequence's mesh
/// ([`Sequence::read_other`]).
pub fn compare(sequence: &Sequence, name: &str, found: &Trajectory, settings: &Settings) -> Result<Score> {
    let frames = sequence.truth.frames().min(settings.frames);
    if found.frames() < frames {
        let (origin, expected) = (format!("{name}, {}", sequence.name), format!("at least {frames}"));
        return Err(Error::invalid(origin, "frames", expected, found.frames()));
    }
    let rate = sequence.truth.fps();
    if (found.fps() / rate - 1.0).abs() > 1e-3 {
        let (origin, expected) = (format!("{name}, {}", sequence.name), format!("{rate} frames per second"));
        return Err(Error::invalid(origin, "fps", expected, found.fps()));
    }
    // What is further away than the cloth could be stretched to has exploded, as a solver of our own would have.
    let reach = DIVERGED * sequence.side_m() * (1.0 + sequence.grid().aspect());
    let near = |frame: usize| {
        let centre = sequence.truth.frame(frame)[0];
        found.frame(frame).iter().all(|&p| distance(p, centre) < reach)
    };
    judge(sequence, (name, found), (0..frames).all(near), settings)
}

/// Simulates a scene until it ends, diverges, or `tick` ends it.
pub(super) fn simulate(
    setup: &Setup,
    entry: &Entry,
    device: &Device,
    mut tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Simulated> {
    let mut simulator = Simulator::new(device, &setup.model, &entry.optimizer, entry.iterations)?;
    simulator.set_state(&setup.start.cast());
    let edges = FreeEdges::new(&setup.model, 0);
    let mut done = Simulated {
        trajectory: setup.trajectory()?,
        stats: Vec::new(),
        times_ms: Vec::new(),
        stretch_largest: 0.0,
        stable: true,
        ended_early: false,
    };
    let controls = (1..setup.frames()).map(|f| setup.control(f));
    let outcome = simulator.rollout(controls, |frame| {
        let state = &frame.state;
        setup.push(&mut done.trajectory, state);
        done.stats.push(frame.stats[0]);
        done.times_ms.push(frame.wall.as_secs_f64() * 1e3);
        done.stretch_largest = edges.largest(&state.x).max(done.stretch_largest);
        done.stable = done.stretch_largest < DIVERGED;
        done.ended_early = tick().is_break();
        if done.stable && !done.ended_early { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    match outcome {
        Ok(()) => {}
        Err(Error::NonFinite { .. }) => done.stable = false,
        Err(error) => return Err(error),
    }
    Ok(done)
}

/// The distances of a trajectory to the truth.
fn judge(
    sequence: &Sequence,
    (name, found): (&str, &Trajectory),
    stable: bool,
    settings: &Settings,
) -> Result<Score> {
    let truth = &sequence.truth;
    let frames = truth.frames().min(settings.frames);
    let (recorded, found) = (found, &*sequence.on_grid(found)?);
    if found.grid().h < 2 || found.grid().w < 2 {
        let (origin, expected) = (format!("{name}, {}", sequence.name), "a cell or more");
        return Err(Error::invalid(origin, "grid", expected, found.grid()));
    }
    let mut score = Score {
        sequence: sequence.name.clone(),
        grid: found.grid().to_string(),
        solver: name.to_owned(),
        iterations: 0,
        frames: 0,
        stable,
        e_cd: None,
        e_3d: None,
        ms_per_frame: None,
        energy: None,
        energy_terms: None,
        gradient: None,
        stretch_largest: None,
        stretch_mean: None,
        speed_at_end: None,
        repulsion: None,
        made_with: Conditions::new(sequence, settings),
        per_frame: PerFrame::default(),
    };
    if !stable || frames < 2 {
        return Ok(score);
    }
    let wide = |points: &[[f32; 3]]| points.iter().map(|p| p.map(f64::from)).collect::<Vec<_>>();
    let faces = match sequence.mesh_of(recorded) {
        Some(mesh) => Cow::Borrowed(&mesh.faces[..]),
        None => Cow::Owned(found.grid().faces()),
    };
    let resampled = Resampling::new(found.grid(), truth.grid());
    let nearness = Nearness::new(found.grid(), sequence.side_m());
    let figures: Vec<[f64; 3]> = (1..frames)
        .into_par_iter()
        .map(|frame| {
            let (a, (b, of_truth)) = (wide(found.frame(frame)), sequence.surface(frame));
            let (seed, own) = (frame as u64, wide(recorded.frame(frame)));
            let clouds = [
                Surface { points: &own, faces: &faces }.sample(settings.points, 2 * seed),
                Surface { points: &b, faces: &of_truth }.sample(settings.points, 2 * seed + 1),
            ];
            [
                chamfer(&clouds[0], &clouds[1]),
                relative_error(&resampled.apply(&a), &wide(truth.frame(frame))),
                nearness.of(&a),
            ]
        })
        .collect();
    let column = |k: usize| figures.iter().map(|f| f[k]).collect::<Vec<f64>>();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let per_frame = PerFrame { e_cd: column(0), e_3d: column(1), repulsion: column(2) };
    score.frames = figures.len();
    score.e_cd = Some(mean(&per_frame.e_cd));
    score.e_3d = Some(mean(&per_frame.e_3d));
    score.repulsion = Some(mean_and_shares(&per_frame.repulsion));
    let last = ((found.fps() * SETTLED_S) as usize).clamp(1, frames - 1);
    let speeds: Vec<f64> = (frames - last..frames).map(|f| mean_speed(found, f)).collect();
    score.speed_at_end = Some(mean(&speeds));
    score.per_frame = per_frame;
    Ok(score)
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}

/// Mean speed of the particles on the way to a frame [m/s].
fn mean_speed(trajectory: &Trajectory, frame: usize) -> f64 {
    let (before, after) = (trajectory.frame(frame - 1), trajectory.frame(frame));
    let moved = before.iter().zip(after).map(|(&a, &b)| distance(a, b)).sum::<f64>();
    moved * trajectory.fps() / before.len() as f64
}
