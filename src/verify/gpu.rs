//! The stages on a GPU, run one at a time, each to completion.

use super::{
    AdamWCase, EnergyCase, NetworkOutput, Precision, RolloutCase, RolloutFrame, Stages, TrainingCase,
    TrainingOutput, UpdateCase, gradient_of_push,
};
use crate::cloth::{Cloth, Control, EnergyTerms, Grid, Mark, Model, Repulsion, State};
use crate::cpu::train::AdamWSettings;
use crate::gpu::{Context, Schedule, Storage, Tensor};
use crate::kernels::cloth::{ClothTerms, Objective, Room, gradient};
use crate::kernels::operator::Scales;
use crate::kernels::optim::Iterate;
use crate::kernels::padded;
use crate::kernels::train::BatchTensors;
use crate::network::{Forward, Head, Keep, Parameters, Plan, TransposedWeights, Weights};
use crate::settings::Normalisation;
use crate::sim::{Learned, Optimizer, Solver};
use crate::train::{DeviceAdamW, DeviceLoss, MAX_HANDLES};
use crate::{Error, Result};
use std::sync::Arc;

/// The stages on the device of a context.
#[derive(Debug)]
pub struct GpuStages {
    context: Context,
}

impl GpuStages {
    /// Builds the stages on that device, with its tuning ([`Context::tuning`]).
    pub fn new(context: &Context) -> Self {
        Self { context: context.clone() }
    }

    fn upload(&self, label: &'static str, shape: &[usize], data: &[f64]) -> Result<Tensor> {
        Tensor::from_slice(&self.context, label, shape, &single(data))
    }

    fn run(&self, schedule: &Schedule) {
        self.context.submit(|encoder| schedule.record(encoder));
    }

    fn read(&self, tensor: &Tensor) -> Result<Vec<f64>> {
        Ok(tensor.read_widened(&self.context)?.into_iter().map(f64::from).collect())
    }

    /// Reads a network tensor [.., H, W'] without its padding.
    fn read_unpadded(&self, tensor: &Tensor, grid: Grid) -> Result<Vec<f64>> {
        let rows = self.read(tensor)?;
        Ok(rows.chunks_exact(padded(grid.w)).flat_map(|r| &r[..grid.w]).copied().collect())
    }

    /// Reads the first `channels` channels of an activation [S, H, C, W'], returned as [S, channels, H, W].
    fn read_channels(&self, tensor: &Tensor, channels: usize, grid: Grid) -> Result<Vec<f64>> {
        let (rows, stored) = (self.read_unpadded(tensor, grid)?, tensor.shape()[2]);
        let mut values = Vec::with_capacity(rows.len() / stored * channels);
        for sample in rows.chunks_exact(stored * grid.particles()) {
            for c in 0..channels {
                let lines = sample.chunks_exact(stored * grid.w);
                values.extend(lines.flat_map(|line| &line[c * grid.w..][..grid.w]));
            }
        }
        Ok(values)
    }
}

impl Stages for GpuStages {
    fn name(&self) -> String {
        format!("gpu {}", self.context.storage().name())
    }

    fn precision(&self) -> Precision {
        match self.context.storage() {
            Storage::F32 => Precision::Single,
            Storage::F16 => Precision::Half,
        }
    }

    fn network(&mut self, weights: &Weights, grid: Grid, input: &[f64]) -> Result<NetworkOutput> {
        let context = &self.context;
        let samples = input.len() / (weights.config.fields * grid.particles());
        let plan = Plan { grid, samples, tuning: self.context.tuning(), keep: Keep::Blocks };
        let forward = context.checked(|| Forward::new(context, weights, &plan))?;
        forward.embedded.write_narrowed(context, &embed(&single(input), weights.config.fields, grid));
        let mut schedule = Schedule::new(context);
        forward.push(&mut schedule, None, Head::Store);
        self.run(&schedule);
        // Channels added to fill a tile come last.
        let kept = |i: usize| self.read_channels(forward.activation(i), weights.config.channels, grid);
        Ok(NetworkOutput {
            embedded: self.read_channels(&forward.embedded, weights.config.inputs(), grid)?,
            lifted: kept(0)?,
            blocks: (1..=weights.config.layers).map(kept).collect::<Result<_>>()?,
            field: self.read_unpadded(&forward.field, grid)?,
            scalar: self.read(&forward.scalar)?,
        })
    }

    fn energy(&mut self, case: &EnergyCase) -> Result<(Vec<EnergyTerms>, Vec<f64>)> {
        let (context, grid) = (&self.context, case.grid);
        let model = Model { grid, cloths: case.cloths.clone() };
        let mut schedule = Schedule::new(context);
        let objective = context.checked(|| {
            let objective = objective(context, &model)?;
            let parts = [3 * model.batch(), gradient::parts(grid), 2];
            objective.evaluate(&mut schedule, &Tensor::zeros(context, "sums of squares", &parts)?);
            objective.energy(&mut schedule);
            Ok(objective)
        })?;
        let Iterate { a, base, external, grad, .. } = &objective.iterate;
        for (tensor, values) in
            [(a, &case.a), (base, &case.base), (external, &case.external), (&objective.x, &case.x)]
        {
            tensor.write(context, &single(values));
        }
        self.run(&schedule);
        let terms = objective.terms.read::<f32>(context)?;
        Ok((ClothTerms::all(&terms).map(|terms| terms.energy).collect(), self.read(grad)?))
    }

    fn repulsion(&mut self, grid: Grid, positions: &[f64], of_cloth: Repulsion) -> Result<(f64, Vec<f64>)> {
        let context = &self.context;
        let model = Model { grid, cloths: vec![Cloth { repulsion: Some(of_cloth), ..Cloth::default() }] };
        let mut schedule = Schedule::new(context);
        let objective = context.checked(|| {
            let objective = objective(context, &model)?;
            objective.energy(&mut schedule);
            Ok(objective)
        })?;
        objective.x.write(context, &single(positions));
        self.run(&schedule);
        let terms = objective.terms.read::<f32>(context)?;
        let energy = ClothTerms::all(&terms).map(|terms| terms.energy.repulsion).sum();
        let total = objective.iterate.total.as_ref().expect("the cloth has a repulsion");
        Ok((energy, gradient_of_push(grid, &self.read(total)?)))
    }

    fn update(&mut self, weights: &Weights, case: &UpdateCase) -> Result<(Vec<f64>, Vec<f64>)> {
        let (context, grid) = (&self.context, case.grid);
        let (n, wanted) = (grid.particles(), case.scale.len());
        // A cloth has three samples. The last cloth may be filled up with copies of the first samples.
        let batch = wanted.div_ceil(3);
        let samples = 3 * batch;
        let filled = |values: &[f64], per: usize| -> Vec<f32> {
            single(values).into_iter().cycle().take(samples * per).collect()
        };
        let iterate = Iterate::with_hidden(context, batch, &vec![Mark::default(); batch * n])?;
        let [grad, last_step] = [&case.grad, &case.last_step].map(|field| filled(field, n));
        iterate.grad.write(context, &grad);
        iterate.hidden_state().write(context, &[filled(&case.last_grad, n), last_step.clone()].concat());
        // The gradient kernel would have written the sums. Here the whole sum is in the first part.
        let square = |field: &[f32]| field.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>() as f32;
        let parts = gradient::parts(grid);
        let mut squares = vec![0.0; samples * parts * 2];
        let fields = grad.chunks_exact(n).zip(last_step.chunks_exact(n));
        for (sums, (grad, last_step)) in squares.chunks_exact_mut(2 * parts).zip(fields) {
            sums[..2].copy_from_slice(&[square(grad), square(last_step)]);
        }
        let sums = Tensor::from_slice(context, "sums of squares", &[samples, parts, 2], &squares)?;
        // Before and after the step.
        let scales = Tensor::zeros(context, "scales", &[2, samples])?;
        scales.write_at(context, 0, &filled(&case.scale, 1));
        let mut schedule = Schedule::new(context);
        context.checked(|| {
            let step = Learned::new(context, weights, &self.context.tuning(), (grid, samples))?;
            step.push(
                &mut schedule,
                (&iterate, &sums),
                Scales { tensor: &scales, before: 0, after: samples, last_step: None },
                None,
            );
            Ok(())
        })?;
        self.run(&schedule);
        // Starting from a = 0, the acceleration is the step.
        let step = self.read(&iterate.a)?[..wanted * n].to_vec();
        Ok((step, self.read(&scales)?[samples..][..wanted].to_vec()))
    }

    fn training_step(&mut self, weights: &Weights, case: &TrainingCase) -> Result<TrainingOutput> {
        let context = &self.context;
        let model = Model { grid: case.grid, cloths: case.cloths.clone() };
        let most = MAX_HANDLES * model.batch();
        if model.handles() > most {
            let found = model.handles();
            return Err(Error::invalid(
                "training step",
                "handles",
                format!("at most {most} on a device"),
                found,
            ));
        }
        let mut schedule = Schedule::new(context);
        let (parameters, gradient, loss) = context.checked(|| {
            let parameters = Parameters::new(context, weights, &self.context.tuning())?;
            let gradient = Tensor::zeros(context, "gradient", parameters.flat.shape())?;
            let shape = (case.grid, model.batch());
            let loss = DeviceLoss::new(
                context,
                shape,
                &parameters,
                (&gradient, Normalisation::Component),
                &self.context.tuning(),
            )?;
            let transposed = TransposedWeights::new(context, &parameters)?;
            transposed.push(&mut schedule);
            loss.push(&mut schedule, &transposed)?;
            Ok((parameters, gradient, loss))
        })?;
        let handles = case.targets.iter().map(|p| p.map(|c| c as f32)).collect();
        loss.set_cloths(&model, &Control { handles, ..Default::default() });
        loss.objective().control_accelerations.write(context, &single(&case.external));
        let BatchTensors { x, v, a, hidden, scale } = loss.tensors();
        for (tensor, values) in [(x, &case.x), (v, &case.v), (a, &case.a), (scale, &case.scale)] {
            tensor.write(context, &single(values));
        }
        hidden.write(context, &single(&[&case.last_grad[..], &case.last_step].concat()));
        self.run(&schedule);
        let terms: Vec<f32> = loss.objective().terms.read(context)?;
        let step = self.read(hidden)?.split_off(case.last_grad.len());
        let gradient = parameters.layout().to_host(&gradient.read(context)?);
        Ok(TrainingOutput {
            loss: ClothTerms::all(&terms).map(|of_cloth| of_cloth.energy.total()).sum::<f64>()
                / model.batch() as f64,
            step,
            gradient: gradient.into_iter().map(f64::from).collect(),
        })
    }

    fn adamw(&mut self, case: &AdamWCase) -> Result<Vec<Vec<f64>>> {
        let context = &self.context;
        let weights = self.upload("weights", &[case.before.len()], &case.before)?;
        let settings = AdamWSettings { clip: case.clip, ..Default::default() };
        let adamw = DeviceAdamW::new(context, weights.len(), settings)?;
        let [mut norm, mut step] = [(); 2].map(|()| Schedule::new(context));
        context.checked(|| {
            adamw.push_norm(&mut norm)?;
            adamw.push_step(&mut step, &weights)
        })?;
        let steps = case.gradients.iter().zip(1..).map(|(gradient, number)| {
            adamw.gradient.write(context, &single(gradient));
            self.run(&norm);
            adamw.set_factors(self.read(&adamw.norm_squared)?[0].sqrt(), number, (case.rate, 0.0));
            self.run(&step);
            self.read(&weights)
        });
        steps.collect()
    }

    fn rollout(&mut self, weights: &Arc<Weights>, case: &RolloutCase) -> Result<Vec<RolloutFrame>> {
        let context = &self.context;
        let model = Model { grid: case.grid, cloths: vec![case.cloth.clone()] };
        let optimizer = Optimizer::paper(weights.clone());
        let solver = Solver::new(context, &model, &optimizer, case.iterations)?;
        let x = single(&case.start);
        solver.set_state(&State { v: vec![0.0; x.len()], x });
        let mut frames = Vec::with_capacity(case.targets.len());
        for targets in &case.targets {
            let handles = targets.iter().map(|p| p.map(|c| c as f32)).collect();
            solver.set_control(&Control { handles, ..Default::default() });
            context.submit(|encoder| solver.record(encoder));
            let log = solver.iteration_log()?;
            frames.push(RolloutFrame {
                x: self.read(solver.positions())?,
                v: self.read(solver.velocities())?,
                a: self.read(solver.accelerations())?,
                scales: log.scales,
                gradient_norms: log.gradient_norms,
            });
        }
        Ok(frames)
    }
}

/// Builds the objective of the cloths of a model, at zero.
fn objective(context: &Context, model: &Model) -> Result<Objective> {
    let room = Room {
        handles: model.handles(),
        repulsion: model.repels(),
        self_contact: false,
        bodies: 0,
        fields: 0,
        rest_angles: model.has_rest_angles(),
        hidden: false,
    };
    let objective = Objective::new(context, model.grid, model.batch(), room)?;
    objective.set_cloths(model);
    Ok(objective)
}

fn single(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

/// Builds the input channels [S, H, fields + 2, W'] from the fields [S, fields, H, W].
fn embed(fields: &[f32], count: usize, grid: Grid) -> Vec<f32> {
    let (h, w) = (grid.h, padded(grid.w));
    let samples = fields.len() / (count * grid.particles());
    let value = |s: usize, c: usize, i: usize, j: usize| match c {
        _ if j >= grid.w => 0.0,
        c if c < count => fields[((s * count + c) * h + i) * grid.w + j],
        c if c == count => i as f32 / (h - 1) as f32,
        _ => j as f32 / (grid.w - 1) as f32,
    };
    let mut out = Vec::with_capacity(samples * (count + 2) * h * w);
    for s in 0..samples {
        for i in 0..h {
            for c in 0..count + 2 {
                out.extend((0..w).map(|j| value(s, c, i, j)));
            }
        }
    }
    out
}
