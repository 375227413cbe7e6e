//! The score of one solver on one sequence: its cost and its distance from the truth.

use super::alignment::check_start;
use super::metrics::{TriangleMesh, chamfer, relative_error};
use super::nearness::{LayerProximity, mean_and_fractions_above};
use super::physics::Physics;
use super::resampling::{Resampling, coarse};
use super::{Conditions, Nudge, Sequence, Soundness, Verdict, median_time};
use crate::cloth::{EnergyTerms, Grid};
use crate::cpu::Objective;
use crate::io::Trajectory;
use crate::scene::{Scene, Setup};
use crate::sim::{FrameStats, Optimizer};
use crate::{Device, Simulator};
use crate::{Error, Result, io};
use rayon::prelude::*;
use std::borrow::Cow;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;

/// Stretch of an edge away from handles at which a simulation counts as diverged.
const DIVERGED: f64 = 3.0;
/// Duration at the end over which the speed is averaged \[s\].
const SETTLED_S: f64 = 0.5;
/// Number of frames that [`snapshots`] keeps.
pub const SNAPSHOTS: usize = 4;

/// A solver to be evaluated.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Name of its column, such as `fnopt` or `adam`.
    pub name: String,
    /// The optimizer.
    pub optimizer: Optimizer,
    /// Iterations per frame.
    pub iterations: usize,
    /// Whether it computes accelerations on the [`coarse`] grid only, and resamples them to the requested
    /// grid (the baseline `interpolation`).
    pub coarse: bool,
}

impl Entry {
    /// Returns the device it runs on if `device` is requested: the CPU for optimizers without a GPU
    /// implementation.
    pub fn device<'a>(&self, device: &'a Device) -> &'a Device {
        if self.optimizer.runs_on_gpu() { device } else { &Device::Cpu }
    }

    /// Returns the iterations as recorded in scores: 0 for an optimizer that always converges.
    pub(super) fn recorded_iterations(&self) -> usize {
        if self.optimizer.converges() { 0 } else { self.iterations }
    }

    /// Returns the name of its column in tables: the solver and its iterations.
    pub fn column(&self) -> String {
        column(&self.name, self.recorded_iterations())
    }
}

/// Returns the name of a column: the solver and, if they are meaningful, its iterations.
pub(super) fn column(solver: &str, iterations: usize) -> String {
    match iterations {
        0 => solver.to_owned(),
        n => format!("{solver}, N = {n}"),
    }
}

/// The settings that all entries share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The cloth and the air.
    pub physics: Physics,
    /// Whether a sequence's own material counts instead of that of `physics`, if it has one.
    pub own_material: bool,
    /// Number of points sampled from each surface for e_CD.
    pub points: usize,
    /// Number of frames to simulate, including the start; at most all of a sequence.
    pub frames: usize,
}

impl Settings {
    /// Returns the cloth and the air of a sequence.
    pub fn physics_of(&self, sequence: &Sequence) -> Physics {
        match sequence.stiffness() {
            Some(stiffness) if self.own_material => Physics { stiffness, ..Physics::default() },
            _ => self.physics,
        }
    }

    /// Returns the settings as a document, with `material` as in a scene, and null for values that the
    /// sequence provides.
    pub fn to_json(&self) -> serde_json::Value {
        let Physics { stiffness, density, drag, frame_time_s } = self.physics;
        let scene = Scene { stiffness, ..Scene::default() }.to_json();
        serde_json::json!({
            "material": scene["material"],
            "density": density,
            "drag": drag,
            "frame_time_s": frame_time_s,
            "own_material": self.own_material,
            "points": self.points,
            "frames": Some(self.frames).filter(|&frames| frames < usize::MAX),
        })
    }
}

/// The result of one solver on one sequence. If it diverged there are no frames to measure, and the figures
/// are `None`.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Score {
    /// Name of the sequence.
    pub sequence: String,
    /// The grid, as in `32x32`.
    pub grid: String,
    /// Name of the solver.
    pub solver: String,
    /// Iterations per frame; 0 if not meaningful.
    pub iterations: usize,
    /// Number of frames that were measured, excluding the start.
    pub frames: usize,
    /// Whether all frames were finite and of plausible size.
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
    /// Mean over the frames of |dL/da| at their end (grid units).
    pub gradient: Option<f64>,
    /// Largest `|edge| - 1` of the edges away from handles.
    pub stretch_largest: Option<f64>,
    /// Mean over the frames and all edges of `||edge| - 1|`.
    pub stretch_mean: Option<f64>,
    /// Number of frames in which Newton's method did not converge; `None` for others.
    #[serde(default)]
    pub unconverged: Option<usize>,
    /// Mean speed of the particles in the last half second [m/s], which shows how far the cloth has settled.
    pub speed_at_end: Option<f64>,
    /// Mean repulsion energy on a grid of 32 rows, and the shares of frames in which it exceeds 0.1 and 0.02
    /// (paper section 6.3.3).
    pub repulsion: Option<[f64; 3]>,
    /// The conditions of the score.
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
    /// Returns the name of its column in tables: the solver and its iterations.
    pub fn column(&self) -> String {
        column(&self.solver, self.iterations)
    }

    /// Whether the score is another system's ([`compare`]) rather than of a simulation of ours.
    pub fn is_imported(&self) -> bool {
        self.iterations == 0 && self.made_with.device.is_none()
    }

    /// Reads a score that [`Score::write`] wrote.
    pub fn read(path: &Path) -> Result<Self> {
        read_kept(path)
    }

    /// Writes the score as JSON.
    pub fn write(&self, path: &Path) -> Result<()> {
        keep(path, self)
    }
}

/// Reads a score of any kind that [`keep`] wrote.
pub(super) fn read_kept<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let bytes = io::read_bytes(path)?;
    let origin = path.display().to_string();
    serde_json::from_slice(&bytes).map_err(|e| {
        Error::invalid(
            origin,
            "score",
            "a score written by this program (delete the file to compute it again)",
            e,
        )
    })
}

/// Writes a score of any kind as JSON.
pub(super) fn keep(path: &Path, score: &impl serde::Serialize) -> Result<()> {
    let json = serde_json::to_vec(score).expect("scores are plain data");
    io::write_atomic(path, |file| file.write_all(&json))
}

/// The output of a simulation, to be measured.
pub(super) struct Simulated {
    pub trajectory: Trajectory,
    pub stats: Vec<FrameStats>,
    /// |dL/da| at the end of each frame, in the state that the optimizer left in single precision.
    pub gradients: Vec<f64>,
    pub times_ms: Vec<f64>,
    pub verdict: Verdict,
    pub stable: bool,
    pub ended_early: bool,
}

impl Simulated {
    /// Returns the median wall time of a frame \[ms\], without the warm-up if there are more frames; `None`
    /// without frames.
    pub fn ms_per_frame(&self) -> Option<f64> {
        (!self.times_ms.is_empty()).then(|| median_time(&self.times_ms))
    }
}

/// Simulates a sequence on a grid, from its recorded start or that of a repeat, and returns the score and the
/// trajectory. An optimizer without a GPU implementation runs on the CPU. `tick` is called after each frame;
/// if it breaks, the result is `None`.
pub fn run(
    (sequence, nudge): (&Sequence, Option<Nudge>),
    grid: Grid,
    entry: &Entry,
    (device, settings): (&Device, &Settings),
    tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Option<(Score, Trajectory)>> {
    let setup = |grid| -> Result<Setup> {
        let mut scene = sequence.scene(grid, &settings.physics_of(sequence))?;
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
        simulated.trajectory = resampled(&simulated.trajectory, grid, &start.vertices_m(&start.start.x));
    }
    let mut score = Score {
        iterations: entry.recorded_iterations(),
        made_with: Conditions::of((sequence, nudge), entry, (device, settings)),
        ..judge(sequence, (&entry.name, &simulated.trajectory), simulated.stable, settings)?
    };
    if score.stable && !simulated.stats.is_empty() {
        let mean = |of: &dyn Fn(&FrameStats) -> f64| {
            simulated.stats.iter().map(of).sum::<f64>() / simulated.stats.len() as f64
        };
        score.ms_per_frame = simulated.ms_per_frame();
        // These figures mean nothing for a cloth on another grid.
        if own == grid {
            score.energy = Some(mean(&|s| s.energy.total()));
            let term = |k: usize| mean(&|s| s.energy.to_array()[k]);
            score.energy_terms = Some(EnergyTerms::from_array(std::array::from_fn(term)));
            let gradients = &simulated.gradients;
            score.gradient = Some(gradients.iter().sum::<f64>() / gradients.len() as f64);
            score.stretch_largest = simulated.verdict.stretch_largest_free;
            score.stretch_mean = Some(mean(&|s| s.stretch_mean));
        }
        if entry.optimizer.converges() {
            let missed = |s: &&FrameStats| s.converged == Some(false);
            score.unconverged = Some(simulated.stats.iter().filter(missed).count());
        }
    }
    Ok(Some((score, simulated.trajectory)))
}

/// Resamples the accelerations of a trajectory to a finer grid and integrates them there from `start`. Both
/// are linear, so it suffices to resample the displacements from the first frame.
fn resampled(coarse: &Trajectory, grid: Grid, start: &[[f64; 3]]) -> Trajectory {
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

/// Returns a few frames of a trajectory for display, evenly spread over its first `frames` and including the
/// last of them.
pub fn snapshots(trajectory: &Trajectory, frames: usize) -> Trajectory {
    let mut kept = Trajectory::new(trajectory.grid(), trajectory.fps());
    for number in snapshot_frames(trajectory.frames().min(frames)) {
        let frame = trajectory.frame(number);
        kept.push(frame, &vec![[0.0; 3]; frame.len()]);
    }
    kept
}

/// Returns the numbers of the frames that [`snapshots`] keeps of the first `frames`.
pub fn snapshot_frames(frames: usize) -> [usize; SNAPSHOTS] {
    std::array::from_fn(|k| (k + 1) * frames.saturating_sub(1) / SNAPSHOTS)
}

/// Returns the distances \[m\] of the vertices of a frame from a truth on another grid, which is resampled to
/// the frame's.
pub fn vertex_errors((found, grid): (&[[f32; 3]], Grid), (truth, of_truth): (&[[f32; 3]], Grid)) -> Vec<f32> {
    let wide: Vec<[f64; 3]> = truth.iter().map(|p| p.map(f64::from)).collect();
    let truth = Resampling::new(of_truth, grid).apply(&wide);
    let apart = |(p, q): (&[f32; 3], [f64; 3])| distance(*p, q.map(|c| c as f32)) as f32;
    found.iter().zip(truth).map(apart).collect()
}

/// Scores another system's trajectory of a sequence, on any grid or on the sequence's mesh
/// ([`Sequence::read_other`]). Fails if it has too few frames or another frame rate,
/// or if it begins elsewhere than the truth and a factor, other axes or another order of the vertices explains that.
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
    check_start(sequence, name, &*sequence.on_grid(found)?)?;
    // A vertex farther away than the cloth could be stretched to has exploded. That counts as divergence, as
    // for our own solvers.
    let reach = DIVERGED * sequence.side_m() * (1.0 + sequence.grid().aspect());
    let near = |frame: usize| {
        let centre = sequence.truth.frame(frame)[0];
        found.frame(frame).iter().all(|&p| distance(p, centre) < reach)
    };
    judge(sequence, (name, found), (0..frames).all(near), settings)
}

/// Simulates a scene until it ends or diverges, or until `tick` breaks.
pub(super) fn simulate(
    setup: &Setup,
    entry: &Entry,
    device: &Device,
    mut tick: impl FnMut() -> ControlFlow<()>,
) -> Result<Simulated> {
    let mut simulator = Simulator::new(device, &setup.model, &entry.optimizer, entry.iterations)?;
    simulator.set_state(&setup.start.cast());
    let mut soundness = Soundness::new(setup);
    let mut objective = Objective::<f64>::new(&setup.model);
    let mut before = setup.start.cast::<f32>().cast();
    let mut done = Simulated {
        trajectory: setup.trajectory()?,
        stats: Vec::new(),
        gradients: Vec::new(),
        times_ms: Vec::new(),
        verdict: Verdict::default(),
        stable: true,
        ended_early: false,
    };
    let controls = (1..setup.frames()).map(|f| setup.control(f));
    let outcome = simulator.rollout(controls, |frame| {
        let state = &frame.state;
        setup.push(&mut done.trajectory, state);
        done.stats.push(frame.stats[0].clone());
        let after = state.cast();
        let control = setup.control::<f32>(frame.index).cast();
        done.gradients.push(objective.gradient_at_end(&before, &after, &control));
        before = after;
        done.times_ms.push(frame.wall.as_secs_f64() * 1e3);
        done.stable = soundness.judge(&frame) < DIVERGED;
        done.ended_early = tick().is_break();
        if done.stable && !done.ended_early { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    done.verdict = soundness.verdict();
    match outcome {
        Ok(()) => {}
        Err(Error::NonFinite { .. }) => {
            done.stable = false;
            done.verdict.stretch_largest_free = None;
        }
        Err(error) => return Err(error),
    }
    Ok(done)
}

/// Measures the distances of a trajectory from the truth.
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
        unconverged: None,
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
    let proximity = LayerProximity::new(found.grid(), sequence.side_m());
    let figures: Vec<[f64; 3]> = (1..frames)
        .into_par_iter()
        .map(|frame| {
            let (a, (b, of_truth)) = (wide(found.frame(frame)), sequence.surface(frame));
            let (seed, own) = (frame as u64, wide(recorded.frame(frame)));
            let clouds = [
                TriangleMesh { points: &own, faces: &faces }.sample(settings.points, 2 * seed),
                TriangleMesh { points: &b, faces: &of_truth }.sample(settings.points, 2 * seed + 1),
            ];
            [
                chamfer(&clouds[0], &clouds[1]),
                relative_error(&resampled.apply(&a), &wide(truth.frame(frame))),
                proximity.of(&a),
            ]
        })
        .collect();
    let column = |k: usize| figures.iter().map(|f| f[k]).collect::<Vec<f64>>();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let per_frame = PerFrame { e_cd: column(0), e_3d: column(1), repulsion: column(2) };
    score.frames = figures.len();
    score.e_cd = Some(mean(&per_frame.e_cd));
    score.e_3d = Some(mean(&per_frame.e_3d));
    score.repulsion = Some(mean_and_fractions_above(&per_frame.repulsion));
    let last = ((found.fps() * SETTLED_S) as usize).clamp(1, frames - 1);
    let speeds: Vec<f64> = (frames - last..frames).map(|f| mean_speed(found, f)).collect();
    score.speed_at_end = Some(mean(&speeds));
    score.per_frame = per_frame;
    Ok(score)
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}

/// Returns the mean speed of the particles in the step that leads to a frame [m/s].
fn mean_speed(trajectory: &Trajectory, frame: usize) -> f64 {
    let (before, after) = (trajectory.frame(frame - 1), trajectory.frame(frame));
    let moved = before.iter().zip(after).map(|(&a, &b)| distance(a, b)).sum::<f64>();
    moved * trajectory.fps() / before.len() as f64
}
