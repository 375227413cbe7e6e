//! A training step on a GPU as dispatches: the loss of a batch with its gradient, and AdamW.

use super::pool::MAX_HANDLES;
use crate::Result;
use crate::cloth::{Control, Grid, Model};
use crate::cpu::train::{AdamWFactors, AdamWSettings};
use crate::gpu::{Context, Schedule, Storage, Tensor, Tuning};
use crate::kernels::cloth::{Begin, Objective, Room, gradient};
use crate::kernels::operator::Scales;
use crate::kernels::optim::{FeatureInputs, Update, UpdateAdj, UpdateAdjTensors, UpdateTensors};
use crate::kernels::train::{AdamW, BatchTensors, Factors, GradientSize, Moments, Squares, squares};
use crate::network::{Backward, Forward, Head, Keep, Parameters, Plan, TransposedWeights};
use crate::settings::Normalisation;

/// The loss of a batch of B cloths on one grid, and its gradient over the weights (paper section 3.3): one
/// iteration of the learned optimizer, scored by the energy after it.
#[derive(Debug)]
pub struct DeviceLoss {
    context: Context,
    /// The cloths, in still air.
    objective: Objective,
    scale: Tensor,
    /// Mean absolute gradient at the new a, shape \[B\].
    pub sizes: Tensor,
    forward: Forward,
    backward: Backward,
    normalisation: Normalisation,
}

impl DeviceLoss {
    /// Creates the loss for batches of `batch` cloths. `gradient` is a vector in the order of `parameters`.
    pub fn new(
        context: &Context,
        (grid, batch): (Grid, usize),
        parameters: &Parameters,
        (gradient, normalisation): (&Tensor, Normalisation),
        tuning: &Tuning,
    ) -> Result<Self> {
        let context = &context.with_storage(Storage::F32)?;
        let plan = Plan { grid, samples: 3 * batch, tuning: *tuning, keep: Keep::Adjoint };
        let forward = Forward::with_parameters(context, parameters, &plan)?;
        let backward = Backward::new(context, &forward, parameters, gradient, tuning)?;
        let room = Room {
            handles: batch * MAX_HANDLES,
            repulsion: false,
            self_contact: false,
            bodies: 0,
            fields: 0,
            rest_angles: false,
            hidden: true,
        };
        Ok(Self {
            context: context.clone(),
            objective: Objective::new(context, grid, batch, room)?,
            scale: Tensor::zeros(context, "scale", &[3 * batch])?,
            sizes: Tensor::zeros(context, "gradient sizes", &[batch])?,
            forward,
            backward,
            normalisation,
        })
    }

    /// Returns the number of cloths.
    pub fn batch(&self) -> usize {
        self.objective.batch()
    }

    /// Returns the objective of the cloths. The caller sets its `control_accelerations`, and finds the energy terms at
    /// the new a in its `terms`.
    pub fn objective(&self) -> &Objective {
        &self.objective
    }

    /// Returns the tensors that the step reads and updates.
    pub fn tensors(&self) -> BatchTensors<'_> {
        let Objective { x, v, iterate, .. } = &self.objective;
        BatchTensors { x, v, a: &iterate.a, hidden: iterate.hidden_state(), scale: &self.scale }
    }

    /// Returns the persistent scale of each sample, shape `[3 B]`.
    pub fn scale(&self) -> &Tensor {
        &self.scale
    }

    /// Sets cloths, handles and their targets, effective from the next submission. Panics if the batch has
    /// more than [`MAX_HANDLES`] handles per cloth on average, if the model has repulsion, which is not
    /// supported here, or if the sizes do not match.
    pub fn set_cloths(&self, model: &Model, control: &Control<f32>) {
        assert_eq!(control.handles.len(), model.handles());
        self.objective.set_cloths(model);
        let mut targets = control.handles.clone();
        targets.resize(self.batch() * MAX_HANDLES, [0.0; 3]);
        self.objective.targets.write(&self.context, &targets);
    }

    /// Appends an iteration: adds the step to a, updates the hidden state, and adds the gradient of the mean
    /// energy over all weights to the vector passed to [`DeviceLoss::new`]. `transposed` holds the transposed
    /// weights.
    pub fn push(&self, schedule: &mut Schedule, transposed: &TransposedWeights) -> Result<()> {
        let Self { context, objective, scale, forward, backward, .. } = self;
        let (grid, iterate) = (objective.grid(), &objective.iterate);
        let parts = [3 * self.batch(), gradient::parts(grid), 2];
        let sums = &Tensor::zeros(context, "sums of squares", &parts)?;
        objective.begin_frame(schedule, Begin::Kept)?;
        objective.evaluate(schedule, sums);
        let (fields, scales) = (FeatureInputs { iterate, sums, first: 0 }, Scales::in_place(scale));
        forward.push(schedule, Some(fields), Head::StoreAndRescale(scales));
        let from = UpdateTensors { field: &forward.field, first: 0, scales, head: None, direction: None };
        Update::new(context)?.push(schedule, grid, from, iterate);

        objective.evaluate(schedule, sums);
        objective.energy(schedule);
        GradientSize::new(context)?.push(schedule, &iterate.grad, &self.sizes);
        let Forward { field, scalar, .. } = forward;
        let from = UpdateAdjTensors { field, scalar, scale, grad: &iterate.grad };
        let to = (&backward.adj_field, &backward.adj_scalar);
        let kernel = UpdateAdj::new(context, self.normalisation)?;
        kernel.push(schedule, grid, (from, 1.0 / self.batch() as f32), to);
        backward.push(schedule, forward, transposed);
        Ok(())
    }
}

/// AdamW for a vector of weights on the device.
#[derive(Debug)]
pub struct DeviceAdamW {
    context: Context,
    /// Gradient, of the same length as the weights.
    pub gradient: Tensor,
    /// Mean gradient, mean squared gradient, and the running mean of the weights.
    pub moments: Moments,
    /// Squared norm of the gradient, computed by [`DeviceAdamW::push_norm`], shape \[1\].
    pub norm_squared: Tensor,
    sums: Tensor,
    factors: Tensor,
    settings: AdamWSettings,
}

impl DeviceAdamW {
    /// Creates the optimizer for `weights` numbers, with zero moments.
    pub fn new(context: &Context, weights: usize, settings: AdamWSettings) -> Result<Self> {
        let zeros = |label, len: usize| Tensor::zeros(context, label, &[len]);
        let moments = Moments {
            mean: zeros("mean gradient", weights)?,
            square: zeros("mean squared gradient", weights)?,
            averaged: zeros("mean weights", weights)?,
        };
        Ok(Self {
            context: context.clone(),
            gradient: zeros("gradient", weights)?,
            moments,
            norm_squared: zeros("norm squared", 1)?,
            sums: zeros("sums of squares", squares::parts(weights))?,
            factors: zeros("factors", size_of::<Factors>() / 4)?,
            settings,
        })
    }

    /// Appends the computation of the squared norm of the gradient.
    pub fn push_norm(&self, schedule: &mut Schedule) -> Result<()> {
        Squares::new(&self.context)?.push(schedule, &self.gradient, &self.sums, &self.norm_squared);
        Ok(())
    }

    /// Appends an update of `weights`. It uses the factors that are set when it runs.
    pub fn push_step(&self, schedule: &mut Schedule, weights: &Tensor) -> Result<()> {
        let vectors = (&self.gradient, weights);
        AdamW::new(&self.context)?.push(schedule, &self.factors, vectors, &self.moments);
        Ok(())
    }

    /// Sets the factors of update `number`, counted from 1, for a gradient of norm `norm`, effective from the
    /// next submission. `average` is the decay of the running mean of the weights.
    pub fn set_factors(&self, norm: f64, number: u64, (rate, average): (f64, f64)) {
        let AdamWSettings { betas: [beta1, beta2], epsilon, .. } = self.settings;
        let AdamWFactors { clip, decay, step_size, sqrt_correction } =
            self.settings.factors(norm, number, rate);
        let factors = Factors {
            clip: clip as f32,
            decay: decay as f32,
            step_size: step_size as f32,
            sqrt_correction: sqrt_correction as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            add1: (1.0 - beta1) as f32,
            add2: (1.0 - beta2) as f32,
            epsilon: epsilon as f32,
            average: average as f32,
        };
        self.factors.write(&self.context, &[factors]);
    }
}
