//! The learned optimizer on a device: from a gradient to the next iterate.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor, Tuning};
use crate::kernels::operator::{LastStep, Scales};
use crate::kernels::optim::{FeatureInputs, Iterate, Update, UpdateTensors};
use crate::network::{Forward, Head, Keep, Plan, Weights};

/// The network and the update rule for the samples of a batch, in several passes if their activations do not
/// fit at once.
#[derive(Debug)]
pub(crate) struct Learned {
    grid: Grid,
    forward: Forward,
    update: Update,
    /// Whether the update kernel computes the scalar head: one dispatch fewer, but every workgroup repeats
    /// the work.
    defers_scalar_head: bool,
}

impl Learned {
    /// Uploads the weights and builds what an iteration over `samples` samples needs.
    pub fn new(context: &Context, weights: &Weights, tuning: &Tuning, shape: (Grid, usize)) -> Result<Self> {
        let (grid, samples) = shape;
        let plan = Plan { grid, samples, tuning: *tuning, keep: Keep::Nothing };
        let plan = plan.fit_passes(context, weights.config);
        let forward = Forward::new(context, &weights.folded(), &plan)?;
        Ok(Self { grid, forward, update: Update::new(context)?, defers_scalar_head: tuning.staged })
    }

    /// Appends the step that updates `iterate` and its hidden state from its gradient, or only proposes a
    /// `direction`, which begins with the size of the last step. `sums` [S, parts, 2] holds the partial sums of squares of
    /// the gradient and the last step; `scales` are those of all samples.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        (iterate, sums): (&Iterate, &Tensor),
        scales: Scales<'_>,
        direction: Option<&Tensor>,
    ) {
        let (samples, particles) = iterate.samples_and_particles();
        // Every workgroup of the update reads the old scales, so the new ones must go elsewhere.
        let defers_scalar_head = self.defers_scalar_head && scales.before != scales.after;
        for first in (0..samples).step_by(self.forward.samples()) {
            let count = self.forward.samples().min(samples - first);
            let last_step = direction.map(|_| LastStep { sums, first, particles });
            let Scales { tensor, before, after, .. } = scales;
            let scales = Scales { tensor, before: before + first, after: after + first, last_step };
            let head = if defers_scalar_head { Head::Deferred } else { Head::StoreAndRescale(scales) };
            self.forward.push_first(schedule, count, Some(FeatureInputs { iterate, sums, first }), head);
            let (layer, rows_max) = self.forward.pooled(count);
            let from = UpdateTensors {
                field: &self.forward.first_field(count),
                first,
                scales,
                head: defers_scalar_head.then_some((layer, &rows_max)),
                direction,
            };
            self.update.push(schedule, self.grid, from, iterate);
        }
    }
}
