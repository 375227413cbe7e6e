//! The optimizers on a device: what each keeps from iteration to iteration, and the dispatches of its step.

use super::learned::Learned;
use super::{Direction, Initial, Length, Optimizer};
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor, Tuning};
use crate::kernels::operator::Scales;
use crate::kernels::optim::{
    Adam, AdamSettings, GradientDescent, Iterate, Lbfgs, LbfgsMemory, LbfgsSettings, QuasiNewton,
};
use crate::{Error, Result};

/// An optimizer with its kernels and the state that it keeps on the device.
#[derive(Debug)]
pub(super) enum Rule {
    /// `scales` holds the persistent scale after each iteration, in rows of `[S]`. The next frame starts from
    /// the last row.
    Learned {
        step: Box<Learned>,
        scales: Tensor,
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

impl Rule {
    /// Builds the kernels of `optimizer` and its state for `batch` cloths and frames of `iterations`. Fails if
    /// the device does not support it, or if the grid is too large for it.
    pub fn new(
        context: &Context,
        optimizer: &Optimizer,
        tuning: &Tuning,
        (grid, batch, iterations): (Grid, usize, usize),
    ) -> Result<Self> {
        let (samples, n) = (3 * batch, grid.particles());
        let memory = |settings: LbfgsSettings| LbfgsMemory::new(context, batch, n, settings.history);
        let refused = || {
            let expected = "a device that supports this optimizer";
            let found = format!("{}, which does not (use the CPU)", context.name());
            Err(Error::invalid("optimizer", optimizer.name(), expected, found))
        };
        let ([direction], Length::Fixed(length)) = (&optimizer.directions[..], optimizer.length) else {
            return refused();
        };
        Ok(match *direction {
            Direction::Network(ref weights) => {
                let step = Box::new(Learned::new(context, weights, tuning, (grid, samples))?);
                Self::Learned { step, scales: rows(context, "scales", iterations, samples)? }
            }
            Direction::Gradient => {
                Self::GradientDescent { kernel: GradientDescent::new(context)?, rate: length }
            }
            Direction::Adam(settings) => Self::Adam {
                kernel: Adam::new(context)?,
                settings,
                moments: Tensor::zeros(context, "adam.moments", &[samples, n, 2])?,
            },
            Direction::Lbfgs { settings, initial: Initial::Identity } => {
                let kernel = Lbfgs::new(context, settings)?;
                kernel.check_size(context, n)?;
                Self::Lbfgs { kernel, memory: memory(settings)? }
            }
            Direction::Lbfgs { settings, initial: Initial::Spectral } => {
                let plan = QuasiNewton::new(context, settings, (grid, batch))?;
                plan.check_size(context, n)?;
                Self::QuasiNewton { plan: Box::new(plan), memory: memory(settings)? }
            }
            _ => return refused(),
        })
    }

    /// Appends the step of `iteration`: from the gradient of `iterate` and the `sums` of squares [S, parts, 2]
    /// to the next iterate.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        iteration: usize,
        (iterate, cloths, sums): (&Iterate, &Tensor, &Tensor),
    ) {
        match self {
            Self::Learned { step, scales } => {
                let &[iterations, stride] = scales.shape() else { unreachable!("scales are rows") };
                let last = (iteration + iterations - 1) % iterations;
                let [before, after] = [last, iteration].map(|row| row * stride);
                step.push(schedule, (iterate, sums), Scales { tensor: scales, before, after });
            }
            Self::GradientDescent { kernel, rate } => kernel.push(schedule, *rate, iterate),
            Self::Adam { kernel, settings, moments } => {
                kernel.push(schedule, *settings, iteration, (iterate, moments));
            }
            Self::Lbfgs { kernel, memory } => kernel.push(schedule, iteration, iterate, memory),
            Self::QuasiNewton { plan, memory } => plan.push(schedule, iteration, (iterate, cloths), memory),
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
