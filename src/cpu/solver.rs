//! The solver that computes a frame on the CPU (paper sections 3.2 and 3.3).

use super::operator::activations_len;
use super::optim::{Hidden, Minimizer, Subspace, Update, minimizer, norm};
use super::reference::Minimum;
use super::{Objective, Real, Reference};
use crate::cloth::modes::Reactions;
use crate::cloth::{Cloth, Control, MAX_CONTACTS, Model, State};
use crate::settings::LEARNED_ITERATIONS;
use crate::sim::{Direction, FrameStats, Initial, IterationLog, Length, Memory, Optimizer, StepCounts};
use crate::{Error, Result, memory};
use rayon::prelude::*;

/// Advances a batch of cloths frame by frame.
pub struct Solver<T: Real> {
    optimizer: Optimizer,
    method: Method<T>,
    log: IterationLog,
    /// Whether Newton's method reached its tolerance, for each cloth; empty for other optimizers.
    converged: Vec<bool>,
    objective: Objective<T>,
}

/// How a frame is minimised.
enum Method<T: Real> {
    /// By this many steps of an optimizer that sees only the gradient.
    Steps(usize, Box<dyn Minimizer<T>>),
    /// By this many steps in a subspace.
    Subspace(usize, Box<Subspace<T>>),
    /// By Newton's method, each cloth until it converges.
    Newton(Vec<Reference>),
}

impl<T: Real> Solver<T> {
    /// Builds a solver with `iterations` steps of the optimizer per frame. Fails if `iterations`
    /// is 0, the model ([`Model::check`]) or the optimizer is invalid, the grid does not suit the network, or
    /// there is not enough memory.
    pub fn new(model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        T::new_solver(model, optimizer, iterations)
    }

    pub(super) fn generic_new(model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        if iterations == 0 {
            return Err(Error::invalid("solver", "iterations", "at least 1", 0));
        }
        model.check()?;
        optimizer.check()?;
        let what = format!("{} on {} x {}", optimizer.name(), model.batch(), model.grid);
        memory::check(bytes::<T>(optimizer, model), &what)?;
        let method = match optimizer.length {
            Length::Armijo => Method::Newton(references(model)?),
            Length::Subspace => Method::Subspace(iterations, Box::new(Subspace::new(optimizer, model)?)),
            Length::Fixed(_) | Length::Secant => Method::Steps(iterations, minimizer(optimizer, model)?),
        };
        let (optimizer, objective) = (optimizer.clone(), Objective::new(model));
        Ok(Self { optimizer, method, log: IterationLog::default(), converged: Vec::new(), objective })
    }

    /// Replaces materials, gravity, air, repulsion and handles of the cloths, from the next frame on. The
    /// learned optimizer keeps its state.
    ///
    /// Returns an error, and changes nothing, if the number of cloths differs or if they do not form a valid
    /// model ([`Model::check`]).
    pub fn set_cloths(&mut self, cloths: &[Cloth]) -> Result<()> {
        let model = self.objective.model().with_cloths(cloths)?;
        match (&mut self.method, &self.optimizer.directions[..]) {
            (Method::Newton(all), _) => *all = references(&model)?,
            (Method::Subspace(_, subspace), _) => subspace.set_cloths(&model),
            // It may start from the Hessian of the cloth at rest, with the handles held.
            (Method::Steps(_, method), [Direction::Lbfgs { .. }]) => {
                *method = minimizer(&self.optimizer, &model)?;
            }
            (Method::Steps(..), _) => {}
        }
        self.objective.set_model(&model);
        Ok(())
    }

    /// Advances `state` by one frame driven by `control`, and returns the statistics of each cloth.
    ///
    /// Panics if a length does not match the model.
    pub fn step(&mut self, state: &mut State<T>, control: &Control<T>) -> Vec<FrameStats> {
        // Run as one task of the pool: called from outside, each of the hundreds of parallel loops of a frame
        // would wait for a thread of the pool to wake.
        rayon::scope(|_| T::frame(self, state, control))
    }

    pub(super) fn generic_frame(&mut self, state: &mut State<T>, control: &Control<T>) -> Vec<FrameStats> {
        let objective = &mut self.objective;
        objective.begin_frame(state, control);
        objective.trial.a.fill(T::zero());
        self.log.gradient_norms.clear();
        self.log.scales.clear();
        match &mut self.method {
            Method::Steps(iterations, minimizer) => {
                minimizer.begin_frame();
                for _ in 0..*iterations {
                    objective.confine(state, |_, _, _| ());
                    objective.evaluate(state, control);
                    minimizer.step(&objective.grad, &objective.norms, &mut objective.trial.a);
                    self.log.gradient_norms.extend(&objective.norms);
                    self.log.scales.extend(minimizer.scales().iter().map(|s| s.f64()));
                }
            }
            Method::Subspace(iterations, subspace) => {
                subspace.begin_frame(objective, (state, control));
                for iteration in 0..*iterations {
                    objective.evaluate(state, control);
                    subspace.step(objective, state, iteration);
                    self.log.gradient_norms.extend(&objective.norms);
                    if iteration < LEARNED_ITERATIONS {
                        self.log.scales.extend(subspace.scales().iter().map(|s| s.f64()));
                    }
                }
                objective.move_to_trial(state, control);
                subspace.check_last_step(objective, state);
            }
            Method::Newton(references) => {
                objective.evaluate(state, control);
                self.log.gradient_norms.extend(&objective.norms);
                let cloth = objective.cloth_len();
                let still = vec![0.0; cloth];
                let model = &objective.trial.model;
                let parts: Vec<_> = (0..model.batch()).map(|b| part(model, state, control, b)).collect();
                let each = references.par_iter_mut().zip(&parts);
                let minima: Vec<Minimum> = each
                    .map(|(reference, (state, control))| reference.minimise(state, control, &still))
                    .collect();
                self.converged.clear();
                for (b, minimum) in minima.into_iter().enumerate() {
                    self.converged.push(minimum.converged);
                    // That of the minimum, before it is rounded to this precision.
                    self.log.gradient_norms.extend(minimum.norms);
                    for (a, minimum) in objective.trial.a[b * cloth..].iter_mut().zip(minimum.a) {
                        *a = T::of(minimum);
                    }
                }
                objective.settle_handles();
            }
        }
        objective.part_layers(state, control);
        if let Method::Subspace(_, subspace) = &mut self.method {
            subspace.end_frame(objective);
        }
        objective.move_to_trial(state, control);
        let stats = self.stats(state, control);
        self.objective.end_frame(state, control);
        stats
    }

    /// Clears the optimizer's state, as when a scene restarts.
    pub fn reset_memory(&mut self) {
        (0..self.model().batch()).for_each(|b| self.reset_memory_of(b));
    }

    /// Clears the optimizer's state for cloth `b` alone, as when it restarts while the others continue.
    /// Panics if there is no such cloth.
    pub fn reset_memory_of(&mut self, b: usize) {
        let batch = self.model().batch();
        assert!(b < batch, "cloth {b} of {batch}");
        match &mut self.method {
            Method::Steps(_, minimizer) => minimizer.reset_memory_of(b),
            Method::Subspace(_, subspace) => subspace.reset_memory_of(b),
            Method::Newton(_) => {}
        }
    }

    /// Returns what the optimizer remembers from frame to frame, in single precision.
    pub fn memory(&mut self) -> Memory {
        let mut memory = Memory::default();
        let single = |values: &[T]| values.iter().map(|v| v.f64() as f32).collect::<Vec<_>>();
        if let Method::Subspace(_, subspace) = &mut self.method {
            for which in 0..2 {
                let all = subspace.last_accelerations().flat_map(|both| single(both[which]));
                memory.accelerations.extend(all);
            }
        }
        if let Some(Hidden { last_grad, last_step, scale }) = self.hidden_mut() {
            memory.hidden = [single(last_grad), single(last_step)].concat();
            memory.scales = single(scale);
        }
        memory
    }

    /// Replaces what the optimizer remembers. Fails, and changes nothing, if it is not that of such an optimizer
    /// ([`Solver::memory`]), or not finite.
    pub fn set_memory(&mut self, memory: &Memory) -> Result<()> {
        memory.check(&self.memory())?;
        let copy = |to: &mut [T], from: &[f32]| {
            to.iter_mut().zip(from).for_each(|(to, &from)| *to = T::of(from.into()));
        };
        if let Method::Subspace(_, subspace) = &mut self.method {
            let (last, earlier) = memory.accelerations.split_at(memory.accelerations.len() / 2);
            let mut at = 0;
            for [to_last, to_earlier] in subspace.last_accelerations() {
                let own = at..at + to_last.len();
                copy(to_last, &last[own.clone()]);
                copy(to_earlier, &earlier[own.clone()]);
                at = own.end;
            }
        }
        if let Some(Hidden { last_grad, last_step, scale }) = self.hidden_mut() {
            let (of_grad, of_step) = memory.hidden.split_at(last_grad.len());
            copy(last_grad, of_grad);
            copy(last_step, of_step);
            copy(scale, &memory.scales);
        }
        Ok(())
    }

    /// Returns the hidden state of the network, if there is one.
    fn hidden_mut(&mut self) -> Option<&mut Hidden<T>> {
        match &mut self.method {
            Method::Steps(_, minimizer) => minimizer.hidden_mut(),
            Method::Subspace(_, subspace) => subspace.network().map(Update::hidden_mut),
            Method::Newton(_) => None,
        }
    }

    /// Returns the cloths.
    pub fn model(&self) -> &Model {
        self.objective.model()
    }

    /// Returns the log of the optimizer's iterations in the last frame.
    pub fn iteration_log(&self) -> &IterationLog {
        &self.log
    }

    /// Returns the accelerations that the last frame accepted [edges / frame^2], shape [B, 3, H, W].
    pub fn accelerations(&self) -> &[T] {
        &self.objective.trial.a
    }

    fn stats(&self, state: &State<T>, control: &Control<T>) -> Vec<FrameStats> {
        let batch = self.objective.model().batch();
        let norms = &self.log.gradient_norms;
        let first = match &self.method {
            Method::Subspace(_, subspace) => subspace.norms_at_start(),
            _ => norms,
        };
        let last = &norms[norms.len() - 3 * batch..];
        let of_cloth = |norms: &[f64], b: usize| norm(&norms[3 * b..][..3]);
        let cloth = |b: usize| {
            let (stretch_largest, stretch_mean) = self.objective.stretch(state, b);
            FrameStats {
                energy: self.objective.energy(state, b),
                gradient_first: of_cloth(first, b),
                gradient_last: of_cloth(last, b),
                stretch_largest,
                stretch_mean,
                converged: self.converged.get(b).copied(),
                steps: match &self.method {
                    Method::Subspace(_, subspace) => subspace.step_counts(b),
                    _ => StepCounts::default(),
                },
                bodies: self.objective.body_stats(state, control, b),
                layers: self.objective.layer_stats(state, b),
            }
        };
        (0..batch).map(cloth).collect()
    }
}

/// Returns about how many bytes a solver takes, but for the factors of Hessians: measured on 512x512 and 1024x1024
/// particles in single precision, rounded up.
fn bytes<T: Real>(optimizer: &Optimizer, model: &Model) -> usize {
    let of_direction = |direction: &Direction| match direction {
        Direction::Gradient | Direction::Newton => 0,
        Direction::Adam(_) => 30,
        Direction::Lbfgs { settings, initial } => {
            24 * (settings.history + 1) + if *initial == Initial::Identity { 0 } else { 60 }
        }
        Direction::Spectral => 60,
        Direction::CoRotated => 140,
        Direction::Last => 30,
        Direction::Network(_) => 420,
    };
    // What the handles' reactions take, and their computation in double precision.
    let subspace = if optimizer.length == Length::Subspace { 80 + 48 * Reactions::most(model) } else { 0 };
    let bodies = model.cloths.iter().map(|cloth| cloth.bodies.len().min(MAX_CONTACTS)).max().unwrap_or(0);
    // What the search for pairs takes, and some pairs.
    let layers = if model.touches_itself() { 1500 } else { 0 };
    let of_cloth =
        270 + 60 * bodies + layers + subspace + optimizer.directions.iter().map(of_direction).sum::<usize>();
    let samples = 3 * model.batch();
    let activations = optimizer
        .weights()
        .map_or(0, |weights| size_of::<T>() * activations_len(weights.config.channels, model.grid, samples));
    let cloths = (model.batch() * model.grid.particles()).saturating_mul(of_cloth);
    cloths / size_of::<f32>() * size_of::<T>() + activations
}

/// Extracts cloth `b` of a batch, in double precision: its state and control.
fn part<T: Real>(
    model: &Model,
    state: &State<T>,
    control: &Control<T>,
    b: usize,
) -> (State<f64>, Control<f64>) {
    let len = 3 * model.grid.particles();
    let wide = |values: &[T]| values[b * len..(b + 1) * len].iter().map(|v| v.f64()).collect();
    let state = State { x: wide(&state.x), v: wide(&state.v) };
    let point = |p: &[T; 3]| p.map(|v| v.f64());
    let control = Control {
        handles: control.handles[model.handle_range(b)].iter().map(point).collect(),
        wind: control.wind.get(b).map(point).into_iter().collect(),
        external: if control.external.is_empty() { Vec::new() } else { wide(&control.external) },
        bodies: match control.bodies.is_empty() {
            true => Vec::new(),
            false => control.bodies[model.body_range(b)].to_vec(),
        },
    };
    (state, control)
}

/// Builds the reference that finds the minimum, one per cloth.
fn references(model: &Model) -> Result<Vec<Reference>> {
    let alone = |cloth: &Cloth| Model { grid: model.grid, cloths: vec![cloth.clone()] };
    model.cloths.iter().map(|cloth| Reference::new(&alone(cloth))).collect()
}
