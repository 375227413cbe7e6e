//! A training step on a GPU as dispatches: the loss of a batch with its gradient, and AdamW.

use super::pool::MAX_HANDLES;
use crate::Result;
use crate::cpu::optim::Normalisation;
use crate::cpu::train::{AdamWFactors, AdamWSettings};
use crate::gpu::{Context, Schedule, Storage, Tensor};
use crate::kernels::Tuning;
use crate::kernels::cloth::{
    ClothParams, Energy, EnergySum, ExternalForce, ExternalForceTensors, Gradient, Physics, Predict,
    StateTensors, TERMS, energy, gradient,
};
use crate::kernels::operator::Scales;
use crate::kernels::optim::{Fields, Iterate, Update, UpdateAdj, UpdateAdjTensors, UpdateTensors};
use crate::kernels::train::{AdamW, BatchTensors, Factors, GradientSize, Moments, Squares, squares};
use crate::network::{Backward, Forward, Head, Keep, Parameters, Plan, Transposed};
use crate::sim::{Control, Grid, Model};

/// The loss of a batch of B cloths on one grid, and its gradient over the weights (paper section 3.3): one iteration of the
/// learned optimizer, judged by the energies where it leads.
#[derive(Debug)]
pub struct DeviceLoss {
    context: Context,
    grid: Grid,
    batch: usize,
    /// Positions and velocities at the start of the frame, shape [B, 3, n].
    x: Tensor,
    v: Tensor,
    cloths: Tensor,
    targets: Tensor,
    /// Accelerations of the caller's [edges / frame^2], shape [B, 3, n].
    pub given: Tensor,
    external: Tensor,
    iterate: Iterate,
    scale: Tensor,
    /// Energy terms at the new a, as [`EnergySum`] gives them, shape [B, 8].
    pub terms: Tensor,
    /// Mean magnitude of the gradient there, shape \[B\].
    pub sizes: Tensor,
    forward: Forward,
    backward: Backward,
    normalisation: Normalisation,
}

impl DeviceLoss {
    /// For batches of `batch` cloths; `gradient` is a vector in the order of `parameters`.
    pub fn new(
        context: &Context,
        (grid, batch): (Grid, usize),
        parameters: &Parameters,
        (gradient, normalisation): (&Tensor, Normalisation),
        tuning: &Tuning,
    ) -> Result<Self> {
        let context = &context.with_storage(Storage::F32)?;
        let (samples, n) = (3 * batch, grid.particles());
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let field = |label| zeros(label, &[batch, 3, n]);
        let plan = Plan { grid, samples, tuning: *tuning, keep: Keep::Adjoint };
        let forward = Forward::with_parameters(context, parameters, &plan)?;
        let backward = Backward::new(context, &forward, parameters, gradient, tuning)?;
        Ok(Self {
            context: context.clone(),
            grid,
            batch,
            x: field("positions")?,
            v: field("velocities")?,
            cloths: zeros("cloths", &[batch, ClothParams::LEN])?,
            targets: zeros("handle targets", &[batch * MAX_HANDLES, 3])?,
            given: field("given accelerations")?,
            external: field("external")?,
            iterate: Iterate::with_hidden(context, batch, &vec![0; batch * n])?,
            scale: zeros("scale", &[samples])?,
            terms: zeros("energy terms", &[batch, TERMS])?,
            sizes: zeros("gradient sizes", &[batch])?,
            forward,
            backward,
            normalisation,
        })
    }

    /// Number of cloths.
    pub fn batch(&self) -> usize {
        self.batch
    }

    /// What the step begins with and changes.
    pub fn tensors(&self) -> BatchTensors<'_> {
        let Self { x, v, scale, iterate, .. } = self;
        BatchTensors { x, v, a: &iterate.a, hidden: iterate.hidden_state(), scale }
    }

    /// Scale of the next step of each sample, shape `[3 B]`.
    pub fn scale(&self) -> &Tensor {
        &self.scale
    }

    /// The state, where handles are to be, and the iterate: for what ends a frame.
    pub fn state(&self) -> (StateTensors<'_>, &Iterate) {
        (StateTensors { x: &self.x, v: &self.v, targets: &self.targets }, &self.iterate)
    }

    /// Sets cloths, handles and their targets, ahead of whatever is submitted next. Panics when a cloth has more handles
    /// than [`MAX_HANDLES`] or a repulsion, which training does not have here, or the numbers are not the batch's.
    pub fn set_cloths(&self, model: &Model, control: &Control<f32>) {
        assert_eq!((model.batch(), control.handles.len()), (self.batch, model.handles()));
        assert!(!model.repels(), "training has no repulsion");
        self.cloths.write(&self.context, &ClothParams::all(model, &[]));
        self.iterate.slots.write(&self.context, &model.handle_slots());
        let mut targets = control.handles.clone();
        assert!(targets.len() <= self.batch * MAX_HANDLES, "at most {MAX_HANDLES} handles for each cloth");
        targets.resize(self.batch * MAX_HANDLES, [0.0; 3]);
        self.targets.write(&self.context, &targets);
    }

    /// Appends an iteration: the step is added to a and remembered, and the gradient over all weights of the mean of the
    /// energies is added to the vector given. `transposed` holds the weights.
    pub fn push(&self, schedule: &mut Schedule, transposed: &Transposed) -> Result<()> {
        let (context, grid) = (&self.context, self.grid);
        let Self { x, v, cloths, given, external, iterate, scale, forward, backward, .. } = self;
        let (samples, _) = iterate.samples_and_particles();
        let (state, _) = self.state();
        Predict::in_a_frame(context)?.push(schedule, state, iterate);
        let from = ExternalForceTensors { cloths, x, v, given };
        ExternalForce::new(context)?.push(schedule, grid, from, external);
        let physics = Physics { cloths, external, x };
        let kernel = Gradient::new(context)?;
        let sums = &Tensor::zeros(context, "sums of squares", &[samples, gradient::parts(grid), 2])?;
        kernel.push(schedule, grid, physics, (iterate, sums));
        let (fields, scales) = (Fields { iterate, sums, first: 0 }, Scales::in_place(scale));
        forward.push(schedule, Some(fields), Head::Rescaling(scales));
        let from = UpdateTensors { field: &forward.field, first: 0, scales, head: None };
        Update::new(context)?.push(schedule, grid, from, iterate);

        kernel.push(schedule, grid, physics, (iterate, sums));
        let parts = Tensor::zeros(context, "energy parts", &energy::parts_shape(self.batch, grid))?;
        Energy::new(context)?.push(schedule, grid, physics, (iterate, &parts));
        EnergySum::new(context)?.push(schedule, &parts, &self.terms);
        GradientSize::new(context)?.push(schedule, &iterate.grad, &self.sizes);
        let Forward { field, scalar, .. } = forward;
        let from = UpdateAdjTensors { field, scalar, scale, grad: &iterate.grad };
        let to = (&backward.adj_field, &backward.adj_scalar);
        let kernel = UpdateAdj::new(context, self.normalisation)?;
        kernel.push(schedule, grid, (from, 1.0 / self.batch as f32), to);
        backward.push(schedule, forward, transposed);
        Ok(())
    }
}

/// AdamW on a vector of weights on the device.
#[derive(Debug)]
pub struct DeviceAdamW {
    context: Context,
    /// The gradient, as long as the weights.
    pub gradient: Tensor,
    /// Mean gradient, mean squared gradient, and the running mean of the weights.
    pub moments: Moments,
    /// Sum of the squares of the gradient, after [`DeviceAdamW::push_norm`]: shape \[1\].
    pub norm_squared: Tensor,
    sums: Tensor,
    factors: Tensor,
    settings: AdamWSettings,
}

impl DeviceAdamW {
    /// For `weights` numbers, with a fresh memory.
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

    /// Appends the norm of the gradient.
    pub fn push_norm(&self, schedule: &mut Schedule) -> Result<()> {
        Squares::new(&self.context)?.push(schedule, &self.gradient, &self.sums, &self.norm_squared);
        Ok(())
    }

    /// Appends a step of `weights`, by the factors as they are when it runs.
    pub fn push_step(&self, schedule: &mut Schedule, weights: &Tensor) -> Result<()> {
        let vectors = (&self.gradient, weights);
        AdamW::new(&self.context)?.push(schedule, &self.factors, vectors, &self.moments);
        Ok(())
    }

    /// Sets the factors of update number `number`, from 1 on, for a gradient of this norm; `average` is the decay of the
    /// running mean of the weights. Ahead of whatever is submitted next.
    pub fn set_factors(&self, norm: f64, number: u64, (rate, average): (f64, f64)) {
        let AdamWSettings { betas: [beta1, beta2], epsilon, .. } = self.settings;
        let AdamWFactors { shorten, shrink, pace, root } = self.settings.factors(norm, number, rate);
        let factors = Factors {
            shorten: shorten as f32,
            shrink: shrink as f32,
            pace: pace as f32,
            root: root as f32,
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            add1: (1.0 - beta1) as f32,
            add2: (1.0 - beta2) as f32,
            epsilon: epsilon as f32,
            average: average as f32,
            pad: [0.0; 2],
        };
        self.factors.write(&self.context, &[factors]);
    }
}
