//! Training on a GPU.

use super::arrays::Arrays;
use super::checkpoint::Tensors;
use super::config::{Config, PoolConfig};
use super::device::{DeviceAdamW, DeviceLoss};
use super::learner::{Batch, Learner, Outcome, StepReport, WeightUpdate};
use super::ranks::Ranks;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Readback, Schedule, Tensor, Tuning};
use crate::kernels::cloth::{ClothTerms, TERMS};
use crate::kernels::train::{Advance, Draw, Drawn, PoolTensors, Store};
use crate::network::{self, Parameters, TransposedWeights, Weights};
use crate::settings::Normalisation;
use crate::sim::INITIAL_SCALE;

/// The learner on a GPU. Weights, moments and pools stay on the device. A step takes two submissions, because
/// the host decides in between whether the step is usable.
pub(super) struct GpuLearner {
    context: Context,
    network: network::Config,
    parameters: Parameters,
    adamw: DeviceAdamW,
    pools: Vec<PoolState>,
    /// Runs before the batches: clears the gradient and transposes the weights.
    prepare: Schedule,
    /// Runs after the batches: computes the norm of the gradient.
    norm: Schedule,
    /// Reads the squared norm back.
    norm_readback: Readback,
    update: Schedule,
}

/// A pool: all its cloths, and the buffers and schedule of a step on one batch.
struct PoolState {
    grid: Grid,
    /// Fields of all cloths, shape [P, 5, 3, n], see [`PoolTensors`].
    fields: Tensor,
    /// Persistent scales, shape [P, 3].
    scale: Tensor,
    drawn: Tensor,
    loss: DeviceLoss,
    step: Schedule,
    readback: Readback,
    /// The commands of the next step. Recorded while the device is busy with this one, they do not keep it
    /// waiting.
    ahead: Option<wgpu::CommandBuffer>,
}

impl PoolState {
    fn new(
        context: &Context,
        pool: &PoolConfig,
        (parameters, transposed): (&Parameters, &TransposedWeights),
        into: (&Tensor, Normalisation),
        tuning: &Tuning,
    ) -> Result<Self> {
        let (grid, batch) = (pool.grid, pool.batch);
        let fields = Tensor::zeros(context, "pool", &[pool.cloths, 5, 3, grid.particles()])?;
        let scale = Tensor::zeros(context, "pool scale", &[pool.cloths, 3])?;
        let drawn = Tensor::zeros(context, "drawn", &[batch, size_of::<Drawn>() / 4])?;
        let loss = DeviceLoss::new(context, (grid, batch), parameters, into, tuning)?;
        let mut step = Schedule::new(context);
        let pool = PoolTensors { fields: &fields, scale: &scale };
        Draw::new(context)?.push(&mut step, (grid, INITIAL_SCALE), (&drawn, pool), loss.tensors());
        loss.push(&mut step, transposed)?;
        let objective = loss.objective();
        Advance::new(context)?.push(&mut step, &drawn, objective.state(), &objective.iterate);
        Store::new(context)?.push(&mut step, grid, (&drawn, pool), loss.tensors());
        let readback = Readback::new(context, &[&objective.terms, &loss.sizes, loss.scale()], 2)?;
        Ok(Self { grid, fields, scale, drawn, loss, step: step.finish()?, readback, ahead: None })
    }

    /// Records a step with the readback of its outcomes.
    fn record(&mut self, context: &Context) -> wgpu::CommandBuffer {
        context.commands(|encoder| {
            self.step.record(encoder);
            self.readback.record(encoder);
        })
    }

    /// Uploads the cloths of the next step.
    fn set(&self, context: &Context, batch: &Batch) {
        let drawn = batch.cloths.iter().map(|drawn| Drawn {
            slot: u32::try_from(drawn.slot).expect("a pool's cloths fit 32 bits"),
            begin: drawn.start.is_some().into(),
            advance: drawn.advance.into(),
            keep: (1.0 - drawn.damping) as f32,
            rotation: drawn.start.unwrap_or_default().map(|[x, y, z]| [x as f32, y as f32, z as f32, 0.0]),
        });
        self.drawn.write(context, &drawn.collect::<Vec<_>>());
        self.loss.set_cloths(&batch.model(self.grid), &batch.control());
    }

    /// Reads the pool back to the host.
    fn read(&self, context: &Context) -> Result<Arrays<f32>> {
        let mut arrays = Arrays::new(self.grid, self.scale.shape()[0]);
        let fields: Vec<f32> = self.fields.read(context)?;
        let len = 3 * self.grid.particles();
        for (k, to) in arrays.fields().into_iter().enumerate() {
            for (to, from) in to.chunks_exact_mut(len).zip(fields.chunks_exact(5 * len)) {
                to.copy_from_slice(&from[k * len..][..len]);
            }
        }
        arrays.hidden.scale = self.scale.read(context)?;
        Ok(arrays)
    }

    /// Uploads the pool from the host.
    fn write(&self, context: &Context, mut arrays: Arrays<f32>) {
        let mut fields = vec![0.0; self.fields.len()];
        let len = 3 * self.grid.particles();
        for (k, from) in arrays.fields().into_iter().enumerate() {
            for (from, to) in from.chunks_exact(len).zip(fields.chunks_exact_mut(5 * len)) {
                to[k * len..][..len].copy_from_slice(from);
            }
        }
        self.fields.write(context, &fields);
        self.scale.write(context, &arrays.hidden.scale);
    }
}

/// Decodes the outcomes of the last step's `batch` cloths from the bytes read back.
fn outcomes(bytes: &[u8], batch: usize) -> Vec<Outcome> {
    let numbers: Vec<f32> = bytemuck::pod_collect_to_vec(bytes);
    let (terms, rest) = numbers.split_at(TERMS * batch);
    let (sizes, scales) = rest.split_at(batch);
    let outcome = |((terms, &size), scale): ((ClothTerms, &f32), &[f32])| Outcome {
        energy: terms.energy,
        log_gradient: f64::from(size).ln(),
        scale: [0, 1, 2].map(|k| f64::from(scale[k])),
    };
    ClothTerms::all(terms).zip(sizes).zip(scales.chunks_exact(3)).map(outcome).collect()
}

impl GpuLearner {
    /// Creates a learner that starts from `weights`. Fails if a grid is too small for the modes, or if device
    /// memory cannot hold the pools.
    pub fn new(context: &Context, config: &Config, weights: &Weights) -> Result<Self> {
        context.checked(|| Self::build(context, config, weights))
    }

    fn build(context: &Context, config: &Config, weights: &Weights) -> Result<Self> {
        // Use the tuning table, not measured tunings, so that a resumed run continues bit for bit.
        let tuning = Tuning::table(context);
        let parameters = Parameters::new(context, weights, &tuning)?;
        let adamw = DeviceAdamW::new(context, parameters.flat.len(), config.optimizer.settings)?;
        adamw.moments.averaged.write(context, &parameters.layout().to_device(&weights.flat()));
        let transposed = TransposedWeights::new(context, &parameters)?;
        let mut prepare = Schedule::new(context);
        prepare.clear(&adamw.gradient);
        transposed.push(&mut prepare);
        let state = |pool: &PoolConfig| {
            let into = (&adamw.gradient, config.normalisation);
            PoolState::new(context, pool, (&parameters, &transposed), into, &tuning)
        };
        let pools = config.pools.iter().map(state).collect::<Result<_>>()?;
        let [mut norm, mut update] = [(); 2].map(|()| Schedule::new(context));
        adamw.push_norm(&mut norm)?;
        adamw.push_step(&mut update, &parameters.flat)?;
        let [prepare, norm, update] = [prepare.finish()?, norm.finish()?, update.finish()?];
        let norm_readback = Readback::new(context, &[&adamw.norm_squared], 1)?;
        let (context, network) = (context.clone(), weights.config);
        Ok(Self { context, network, parameters, adamw, pools, prepare, norm, norm_readback, update })
    }

    /// Returns the vectors of a checkpoint with their names.
    fn vectors(&self) -> [(&'static str, &Tensor); 4] {
        let moments = &self.adamw.moments;
        [
            ("weights", &self.parameters.flat),
            ("averaged", &moments.averaged),
            ("adamw.mean", &moments.mean),
            ("adamw.square", &moments.square),
        ]
    }

    fn download(&self, vector: &Tensor) -> Result<Vec<f32>> {
        Ok(self.parameters.layout().to_host(&vector.read(&self.context)?))
    }

    fn upload(&self, vector: &Tensor, host: &[f32]) {
        vector.write(&self.context, &self.parameters.layout().to_device(host));
    }
}

impl Learner for GpuLearner {
    fn step(&mut self, batches: &[Batch], update: WeightUpdate, ranks: &dyn Ranks) -> Result<StepReport> {
        let Self { context, pools, adamw, .. } = self;
        for batch in batches {
            pools[batch.pool].set(context, batch);
        }
        let mut commands = vec![context.commands(|encoder| self.prepare.record(encoder))];
        for batch in batches {
            let state = &mut pools[batch.pool];
            commands.push(state.ahead.take().unwrap_or_else(|| state.record(context)));
        }
        if ranks.count() == 1 {
            commands.push(context.commands(|encoder| {
                self.norm.record(encoder);
                self.norm_readback.record(encoder);
            }));
        }
        let submission = context.queue.submit(commands);
        for batch in batches {
            let state = &mut pools[batch.pool];
            state.readback.submitted(&submission);
            state.ahead = Some(state.record(context));
        }
        let mut report = StepReport { outcomes: vec![Vec::new(); pools.len()], ..StepReport::default() };
        for batch in batches {
            let state = &mut pools[batch.pool];
            let outcomes = state.readback.next(|bytes| outcomes(bytes, state.loss.batch()))?;
            report.outcomes[batch.pool] = outcomes.expect("one read is under way");
        }
        let mut submission = submission;
        if ranks.count() > 1 {
            // Only with several ranks does the gradient leave the device.
            let mut gradient = adamw.gradient.read(context)?;
            ranks.sum_gradients(&mut gradient, report.loss());
            adamw.gradient.write(context, &gradient);
            submission = context.submit(|encoder| {
                self.norm.record(encoder);
                self.norm_readback.record(encoder);
            });
        }
        self.norm_readback.submitted(&submission);
        let norm_squared: Option<f32> = self.norm_readback.next(bytemuck::pod_read_unaligned)?;
        report.gradient_norm = f64::from(norm_squared.expect("one read is under way")).sqrt();
        if report.is_finite() {
            adamw.set_factors(report.gradient_norm, update.number, (update.rate, update.average));
            context.submit(|encoder| self.update.record(encoder));
        }
        Ok(report)
    }

    fn weights(&self) -> Result<Weights> {
        Ok(Weights::from_flat(self.network, &self.download(&self.parameters.flat)?))
    }

    fn averaged(&self) -> Result<Weights> {
        Ok(Weights::from_flat(self.network, &self.download(&self.adamw.moments.averaged)?))
    }

    fn gradient_order(&self) -> u64 {
        self.parameters.layout().tile() as u64
    }

    fn device(&self) -> String {
        self.context.name().to_owned()
    }

    fn save(&self) -> Result<Tensors> {
        let mut tensors = Tensors::default();
        for (name, vector) in self.vectors() {
            let values = self.download(vector)?;
            tensors.insert(name.to_owned(), &[values.len()], values);
        }
        for (k, state) in self.pools.iter().enumerate() {
            state.read(&self.context)?.save(&format!("pool{k}"), &mut tensors);
        }
        Ok(tensors)
    }

    fn load(&mut self, saved: &Tensors) -> Result<()> {
        let shape = [Weights::zeros(self.network).parameter_count()];
        for (name, vector) in self.vectors() {
            self.upload(vector, saved.get(name, &shape)?);
        }
        for (k, state) in self.pools.iter().enumerate() {
            let mut arrays = Arrays::new(state.grid, state.scale.shape()[0]);
            arrays.load(&format!("pool{k}"), saved)?;
            state.write(&self.context, arrays);
        }
        Ok(())
    }
}
