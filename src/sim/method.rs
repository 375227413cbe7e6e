//! The optimizers on a device: what each keeps from iteration to iteration, and the dispatches of its step.

use super::learned::Learned;
use super::{Direction, Initial, Length, Optimizer};
use crate::cloth::Model;
use crate::cloth::modes::Reactions;
use crate::gpu::{Context, Schedule, Tensor, Tuning};
use crate::kernels::cloth::Objective;
use crate::kernels::operator::Scales;
use crate::kernels::optim::{
    Adam, GradientDescent, Lbfgs, LbfgsMemory, Part, QuasiNewton, Reacting, Subspace,
};
use crate::settings::{AdamSettings, LEARNED_ITERATIONS, LbfgsSettings};
use crate::{Error, Result};

/// An optimizer with its kernels and the state that it keeps on the device.
#[derive(Debug)]
pub(super) enum Method {
    /// `scales` holds the persistent scale after each iteration, in rows of `[S]`. The next frame starts from
    /// the last row.
    Learned {
        step: Box<Learned>,
        scales: Tensor,
    },
    /// `network` is the fourth direction, with its scales as above in rows for the iterations in which it proposes.
    Subspace {
        plan: Box<Subspace>,
        network: Option<(Box<Learned>, Tensor)>,
    },
    GradientDescent {
        kernel: GradientDescent,
        rate: f64,
    },
    Adam {
        kernel: Adam,
        settings: AdamSettings,
        moments: Tensor,
    },
    Lbfgs {
        kernel: Lbfgs,
        memory: LbfgsMemory,
    },
    QuasiNewton {
        plan: Box<QuasiNewton>,
        memory: LbfgsMemory,
    },
}

impl Method {
    /// Builds the kernels of `optimizer` and its state for the cloths of `model` and frames of `iterations`. Fails if
    /// the device does not support it, or if the grid is too large for it.
    pub fn new(
        context: &Context,
        optimizer: &Optimizer,
        tuning: &Tuning,
        (model, iterations): (&Model, usize),
    ) -> Result<Self> {
        let (grid, batch) = (model.grid, model.batch());
        let (samples, n) = (3 * batch, grid.particles());
        if !optimizer.runs_on_gpu() {
            let expected = "a device that supports this optimizer";
            let found = format!("{}, which does not (use the CPU)", context.name());
            return Err(Error::invalid("optimizer", optimizer.name(), expected, found));
        }
        let memory = |settings: LbfgsSettings| LbfgsMemory::new(context, batch, n, settings.history);
        let learned = |weights, iterations: usize| {
            let step = Box::new(Learned::new(context, weights, tuning, (grid, samples))?);
            Result::Ok((step, rows(context, "scales", iterations, samples)?))
        };
        if optimizer.length == Length::Subspace {
            let weights = optimizer.weights();
            let network = weights.map(|weights| learned(weights, iterations.min(LEARNED_ITERATIONS)));
            let network = network.transpose()?;
            let room = (optimizer.directions.len(), Reactions::most(model));
            let plan = Subspace::new(context, room, (iterations, tuning.staged), (grid, batch))?;
            let plan = Box::new(plan);
            return Ok(Self::Subspace { plan, network });
        }
        let [direction] = &optimizer.directions[..] else {
            unreachable!("checked: one direction for each other length")
        };
        Ok(match (direction, optimizer.length) {
            (Direction::Network(weights), Length::Fixed(_)) => {
                let (step, scales) = learned(weights, iterations)?;
                Self::Learned { step, scales }
            }
            (Direction::Gradient, Length::Fixed(rate)) => {
                Self::GradientDescent { kernel: GradientDescent::new(context)?, rate }
            }
            (&Direction::Adam(settings), Length::Fixed(_)) => Self::Adam {
                kernel: Adam::new(context)?,
                settings,
                moments: Tensor::zeros(context, "adam.moments", &[samples, n, 2])?,
            },
            (&Direction::Lbfgs { settings, initial: Initial::Identity }, length) => {
                let kernel = match length {
                    Length::Secant => Lbfgs::along_secants(context, settings, Part::Whole)?,
                    _ => Lbfgs::new(context, settings)?,
                };
                kernel.check_size(context, n)?;
                Self::Lbfgs { kernel, memory: memory(settings)? }
            }
            (&Direction::Lbfgs { settings, initial: Initial::Spectral }, Length::Secant) => {
                let plan = QuasiNewton::new(context, settings, (grid, batch))?;
                plan.check_size(context, n)?;
                Self::QuasiNewton { plan: Box::new(plan), memory: memory(settings)? }
            }
            (direction, length) => unreachable!("checked: {} with {length:?}", direction.name()),
        })
    }

    /// Whether it checks the energy, and so needs the gradient at a = 0 and the energy at the end of a frame.
    pub fn checks_energy(&self) -> bool {
        matches!(self, Self::Subspace { .. })
    }

    /// Returns the persistent scales of the network's steps, if there is one.
    pub fn scales(&self) -> Option<&Tensor> {
        match self {
            Self::Learned { scales, .. } => Some(scales),
            Self::Subspace { network, .. } => network.as_ref().map(|(_, scales)| scales),
            _ => None,
        }
    }

    /// Returns what became of the steps of a frame, if they are checked ([`Subspace::state`]).
    pub fn state(&self) -> Option<&Tensor> {
        match self {
            Self::Subspace { plan, .. } => Some(plan.state()),
            _ => None,
        }
    }

    /// Returns the accelerations of the frame before the last one, shape [B, 3, n], where a frame starts near those of both.
    pub fn earlier(&self) -> Option<&Tensor> {
        match self {
            Self::Subspace { plan, .. } => Some(plan.earlier()),
            _ => None,
        }
    }

    /// Returns memory for the handles of these cloths if they take more than there is. Fails if the device has too little.
    pub fn room_for(&self, context: &Context, model: &Model) -> Result<Option<Reacting>> {
        match self {
            Self::Subspace { plan, .. } if plan.lacks_room(model) => plan.room_for(context, model).map(Some),
            _ => Ok(None),
        }
    }

    /// Keeps handles in this memory from now on, and returns that in which they were. Frames that were recorded before go on
    /// with the latter. Panics if the optimizer keeps none.
    pub fn replace_room(&mut self, room: Reacting) -> Reacting {
        match self {
            Self::Subspace { plan, .. } => plan.replace_room(room),
            _ => panic!("the optimizer keeps no handles"),
        }
    }

    /// Takes the handles and materials of the cloths, from the next submission on.
    pub fn set_cloths(&self, context: &Context, model: &Model) {
        if let Self::Subspace { plan, .. } = self {
            plan.set_cloths(context, model);
        }
    }

    /// Appends what comes before the first evaluation of a frame: the accelerations of the frame before become a
    /// direction, and 0.
    pub fn push_begin(&self, schedule: &mut Schedule, objective: &Objective) {
        if let Self::Subspace { plan, .. } = self {
            plan.begin(schedule, objective);
        }
    }

    /// Appends the start of a frame, after the evaluation at a = 0.
    pub fn push_start(&self, schedule: &mut Schedule, objective: &Objective) {
        if let Self::Subspace { plan, .. } = self {
            plan.start(schedule, objective);
        }
    }

    /// Appends the end of a frame: a step that raised the energy is taken back.
    pub fn push_end(&self, schedule: &mut Schedule, objective: &Objective) {
        if let Self::Subspace { plan, .. } = self {
            plan.end(schedule, objective);
        }
    }

    /// Appends the step of `iteration`, from an evaluation, which left the partial `sums` of squares [S, parts, 2], to
    /// the next iterate.
    pub fn push(&self, schedule: &mut Schedule, objective: &Objective, iteration: usize, sums: &Tensor) {
        let iterate = &objective.iterate;
        let scales = |tensor| {
            let &[iterations, stride] = Tensor::shape(tensor) else { unreachable!("scales are rows") };
            let last = (iteration + iterations - 1) % iterations;
            let [before, after] = [last, iteration].map(|row| row * stride);
            Scales { tensor, before, after, last_step: None }
        };
        match self {
            Self::Learned { step, scales: rows } => {
                step.push(schedule, (iterate, sums), scales(rows), None);
            }
            Self::Subspace { plan, network } => {
                // Later its last proposal stays among the directions.
                if let Some((step, rows)) = network.as_ref().filter(|_| iteration < LEARNED_ITERATIONS) {
                    let direction = plan.learned_step();
                    step.push(schedule, (iterate, sums), scales(rows), direction.as_ref());
                }
                plan.push(schedule, objective, iteration);
            }
            Self::GradientDescent { kernel, rate } => kernel.push(schedule, *rate, iterate),
            Self::Adam { kernel, settings, moments } => {
                kernel.push(schedule, *settings, iteration, (iterate, moments));
            }
            Self::Lbfgs { kernel, memory } => kernel.push(schedule, iteration, iterate, memory),
            Self::QuasiNewton { plan, memory } => {
                plan.push(schedule, iteration, (iterate, objective.cloths()), memory);
            }
        }
    }
}

/// Allocates a row of at least `len` elements for each iteration, aligned so that it can be a tensor view
/// ([`row`]).
pub(super) fn rows(context: &Context, label: &'static str, iterations: usize, len: usize) -> Result<Tensor> {
    Tensor::zeros(context, label, &[iterations, len.next_multiple_of(Tensor::VIEW_ALIGNMENT)])
}

/// Returns the row of an iteration as a tensor of `shape`.
pub(super) fn row(rows: &Tensor, iteration: usize, shape: &[usize]) -> Tensor {
    rows.view(iteration * rows.shape()[1], shape)
}
