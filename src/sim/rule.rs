//! The optimizers on a device: what each keeps from iteration to iteration, and the dispatches of its step.

use super::Optimizer;
use super::learned::Learned;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor, Tuning};
use crate::kernels::operator::Scales;
use crate::kernels::optim::{Adam, AdamSettings, GradientDescent, Iterate, Lbfgs, LbfgsMemory, QuasiNewton};
use crate::{Error, Result};

/// The state that an optimizer keeps on the device.
#[derive(Debug)]
pub(super) enum Rule {
    /// `scales` holds the persistent scale after each iteration, in rows of `[S]`. The next frame starts from
    /// the last row.
    Learned {
        step: Box<Learned>,
        scales: Tensor,
    },
    GradientDescent {
        rate: f64,
    },
    Adam {
        settings: AdamSettings,
        moments: Tensor,
    },
    Lbfgs {
        history: usize,
        curvature: f64,
        memory: LbfgsMemory,
    },
    QuasiNewton {
        history: usize,
        curvature: f64,
        memory: LbfgsMemory,
    },
}

/// Appends the dispatches that turn an iteration's gradient and its sums of squares into the next iterate.
type Step<'a> = Box<dyn FnMut(&mut Schedule, usize, &Tensor) + 'a>;

impl Rule {
    /// Allocates the state of `optimizer` for `batch` cloths and frames of `iterations`. Fails if the device
    /// does not support it.
    pub fn new(
        context: &Context,
        optimizer: &Optimizer,
        tuning: &Tuning,
        (grid, batch, iterations): (Grid, usize, usize),
    ) -> Result<Self> {
        let (samples, n) = (3 * batch, grid.particles());
        Ok(match *optimizer {
            Optimizer::Learned(ref weights) => {
                let step = Box::new(Learned::new(context, weights, tuning, (grid, samples))?);
                Self::Learned { step, scales: rows(context, "scales", iterations, samples)? }
            }
            Optimizer::GradientDescent { rate } => Self::GradientDescent { rate },
            Optimizer::Adam { rate, beta1, beta2, epsilon } => Self::Adam {
                settings: AdamSettings { rate, beta1, beta2, epsilon },
                moments: Tensor::zeros(context, "adam.moments", &[samples, n, 2])?,
            },
            Optimizer::Lbfgs { history, curvature } => {
                Self::Lbfgs { history, curvature, memory: LbfgsMemory::new(context, batch, n, history)? }
            }
            Optimizer::QuasiNewton { history, curvature, factored: false } => {
                let memory = LbfgsMemory::new(context, batch, n, history)?;
                Self::QuasiNewton { history, curvature, memory }
            }
            Optimizer::QuasiNewton { factored: true, .. } | Optimizer::Newton => {
                let expected = "a device that supports this optimizer";
                let found = format!("{}, which does not (use the CPU)", context.name());
                return Err(Error::invalid("optimizer", optimizer.name(), expected, found));
            }
        })
    }

    /// Builds the kernels of a step on `iterate`, and returns the function that appends it. Fails if a kernel
    /// does not compile, or if the grid is too large for the adapter.
    pub fn step<'a>(
        &'a self,
        context: &Context,
        (iterate, cloths): (&'a Iterate, &'a Tensor),
        (grid, batch): (Grid, usize),
    ) -> Result<Step<'a>> {
        let n = grid.particles();
        Ok(match self {
            Self::Learned { step, scales } => Box::new(move |frame, iteration, sums| {
                let &[iterations, stride] = scales.shape() else { unreachable!("scales are rows") };
                let last = (iteration + iterations - 1) % iterations;
                let [before, after] = [last, iteration].map(|row| row * stride);
                step.push(frame, (iterate, sums), Scales { tensor: scales, before, after });
            }),
            Self::GradientDescent { rate } => {
                let kernel = GradientDescent::new(context)?;
                Box::new(move |frame, _, _| kernel.push(frame, *rate, iterate))
            }
            Self::Adam { settings, moments } => {
                let kernel = Adam::new(context)?;
                Box::new(move |frame, iteration, _| {
                    kernel.push(frame, *settings, iteration, (iterate, moments))
                })
            }
            Self::Lbfgs { history, curvature, memory } => {
                let kernel = Lbfgs::new(context, *history, *curvature)?;
                kernel.check_size(context, n)?;
                Box::new(move |frame, iteration, _| kernel.push(frame, iteration, iterate, memory))
            }
            Self::QuasiNewton { history, curvature, memory } => {
                let plan = QuasiNewton::new(context, *history, *curvature, (grid, batch))?;
                plan.check_size(context, n)?;
                Box::new(move |frame, iteration, _| plan.push(frame, iteration, (iterate, cloths), memory))
            }
        })
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
