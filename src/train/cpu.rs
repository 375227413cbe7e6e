//! Training on the CPU.

use super::arrays::Arrays;
use super::checkpoint::Tensors;
use super::config::Config;
use super::learner::{Batch, Learner, Outcome, StepReport, WeightUpdate};
use super::ranks::Ranks;
use crate::Device;
use crate::Result;
use crate::cloth::{Cloth, Model};
use crate::cpu::operator::LaidOut;
use crate::cpu::train::{AdamW, Loss};
use crate::network::{self, Weights};

/// The learner on the CPU, in single precision, on all threads of the current rayon pool.
pub(super) struct CpuLearner {
    network: network::Config,
    pools: Vec<PoolState>,
    weights: Vec<f32>,
    averaged: Vec<f32>,
    gradient: Vec<f32>,
    adamw: AdamW<f32>,
}

/// A pool: all its cloths, those of the current batch, and the batch's loss.
struct PoolState {
    all: Arrays<f32>,
    drawn: Arrays<f32>,
    loss: Loss<f32>,
}

impl CpuLearner {
    /// Creates a learner that starts from `weights`. Fails if a grid is too small for the modes.
    pub fn new(config: &Config, weights: &Weights) -> Result<Self> {
        let state = |pool: &super::PoolConfig| {
            let model = Model { grid: pool.grid, cloths: vec![Cloth::default(); pool.batch] };
            let drawn = Arrays::new(pool.grid, pool.batch);
            Ok(PoolState {
                all: Arrays::of_pool(pool),
                drawn,
                loss: Loss::new(weights, &model, config.normalisation)?,
            })
        };
        let flat = weights.flat();
        let adamw = AdamW::new(config.optimizer.settings, flat.len());
        Ok(Self {
            network: weights.config,
            pools: config.pools.iter().map(state).collect::<Result<_>>()?,
            averaged: flat.clone(),
            gradient: vec![0.0; flat.len()],
            adamw,
            weights: flat,
        })
    }
}

impl CpuLearner {
    /// Steps the cloths of all batches, accumulates their gradients and reports their outcomes.
    fn add_gradients(&mut self, batches: &[Batch], weights: &LaidOut<f32>, report: &mut StepReport) {
        for batch in batches {
            let PoolState { all, drawn, loss } = &mut self.pools[batch.pool];
            all.draw(batch, drawn);
            loss.set_weights(weights);
            loss.set_model(&batch.model(drawn.grid()));
            let share = 1.0 / batch.cloths.len() as f64;
            let Arrays { state, a, hidden, .. } = &mut *drawn;
            let outcomes = loss.step((state, &batch.control()), (a, hidden), share, &mut self.gradient);
            let scales = hidden.scale.chunks_exact(3).map(|s| [s[0], s[1], s[2]].map(f64::from));
            let outcomes = outcomes.iter().zip(scales).map(|(outcome, scale)| Outcome {
                energy: outcome.energy,
                log_gradient: outcome.mean_gradient.ln(),
                scale,
            });
            report.outcomes[batch.pool] = outcomes.collect();
            all.store(batch, drawn);
        }
    }
}

impl Learner for CpuLearner {
    fn step(&mut self, batches: &[Batch], update: WeightUpdate, ranks: &dyn Ranks) -> Result<StepReport> {
        let weights = LaidOut::new(&self.weights()?);
        self.gradient.fill(0.0);
        let mut report = StepReport { outcomes: vec![Vec::new(); self.pools.len()], ..StepReport::default() };
        // Run as one task inside the rayon pool, like a frame: from outside, each parallel loop would wait
        // for a thread to wake.
        rayon::scope(|_| self.add_gradients(batches, &weights, &mut report));
        ranks.sum_gradients(&mut self.gradient, report.loss());
        report.gradient_norm = AdamW::norm(&self.gradient);
        if report.is_finite() {
            let gradient = (&self.gradient[..], report.gradient_norm);
            self.adamw.step(&mut self.weights, gradient, update.number, update.rate);
            let keep = update.average as f32;
            for (mean, &weight) in self.averaged.iter_mut().zip(&self.weights) {
                *mean = keep * *mean + (1.0 - keep) * weight;
            }
        }
        Ok(report)
    }

    fn weights(&self) -> Result<Weights> {
        Ok(Weights::from_flat(self.network, &self.weights))
    }

    fn averaged(&self) -> Result<Weights> {
        Ok(Weights::from_flat(self.network, &self.averaged))
    }

    fn device(&self) -> String {
        Device::Cpu.name()
    }

    fn save(&self) -> Result<Tensors> {
        let mut tensors = Tensors::default();
        let vectors = [
            ("weights", &self.weights),
            ("averaged", &self.averaged),
            ("adamw.mean", &self.adamw.mean),
            ("adamw.square", &self.adamw.square),
        ];
        for (name, values) in vectors {
            tensors.insert(name.to_owned(), &[values.len()], values.clone());
        }
        for (k, state) in self.pools.iter().enumerate() {
            state.all.save(&format!("pool{k}"), &mut tensors);
        }
        Ok(tensors)
    }

    fn load(&mut self, saved: &Tensors) -> Result<()> {
        let shape = [self.weights.len()];
        let vectors = [
            ("weights", &mut self.weights),
            ("averaged", &mut self.averaged),
            ("adamw.mean", &mut self.adamw.mean),
            ("adamw.square", &mut self.adamw.square),
        ];
        for (name, values) in vectors {
            values.copy_from_slice(saved.get(name, &shape)?);
        }
        for (k, state) in self.pools.iter_mut().enumerate() {
            state.all.load(&format!("pool{k}"), saved)?;
        }
        Ok(())
    }
}
