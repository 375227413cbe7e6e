//! A learner that computes nothing but keeps what a real one would.

use fnopt::Result;
use fnopt::network::Weights;
use fnopt::sim::EnergyTerms;
use fnopt::train::{Batch, Config, Learner, Outcome, StepReport, Tensors, Update};
use std::collections::HashSet;

/// A cloth that came out of a step with this external energy.
pub fn outcome(external: f64) -> Outcome {
    Outcome { energy: EnergyTerms { external, ..Default::default() }, log_gradient: -2.0, scale: [0.05; 3] }
}

/// Its weights are mixed with all that it is told, so that any difference between two runs shows in them.
pub struct Fake {
    weights: Weights,
    /// One number for each cloth of each pool.
    cloths: Vec<Vec<f32>>,
    /// Steps, counted by this object, whose loss is not finite.
    broken: HashSet<u64>,
    step: u64,
}

impl Fake {
    pub fn new(config: &Config) -> Self {
        let weights = fnopt::train::first_weights(config).expect("weights");
        let cloths = config.pools.iter().map(|p| vec![0.0; p.cloths]).collect();
        Self { weights, cloths, broken: HashSet::new(), step: 0 }
    }

    pub fn broken_at(mut self, steps: impl IntoIterator<Item = u64>) -> Self {
        self.broken = steps.into_iter().collect();
        self
    }
}

impl Learner for Fake {
    fn step(&mut self, batches: &[Batch], update: Update) -> Result<StepReport> {
        let broken = self.broken.contains(&self.step);
        self.step += 1;
        let mut report = StepReport { gradient_norm: 1.0, ..StepReport::default() };
        for batch in batches {
            let mut outcomes = Vec::new();
            for drawn in &batch.cloths {
                let cloth = &mut self.cloths[batch.pool][drawn.slot];
                let told = drawn.targets.iter().flatten().chain(&drawn.cloth.gravity).sum::<f64>();
                let from = if drawn.start.is_some() { 0.1 } else { *cloth };
                *cloth = (from * 0.9 + told as f32).sin() + f32::from(u8::from(drawn.advance));
                outcomes.push(outcome(if broken { f64::NAN } else { f64::from(*cloth) }));
            }
            report.outcomes.push(outcomes);
        }
        if !broken {
            let mixed = (report.loss() * update.rate * update.number as f64 * (1.0 - update.average)) as f32;
            self.weights.scalar.bias[0] += mixed;
        }
        Ok(report)
    }

    fn weights(&self) -> Result<Weights> {
        Ok(self.weights.clone())
    }

    fn averaged(&self) -> Result<Weights> {
        self.weights()
    }

    fn device(&self) -> String {
        "none".into()
    }

    fn save(&self) -> Result<Tensors> {
        let mut tensors = Tensors::default();
        let flat = self.weights.flat();
        tensors.insert("weights", &[flat.len()], flat);
        for (k, cloths) in self.cloths.iter().enumerate() {
            tensors.insert(format!("pool{k}"), &[cloths.len()], cloths.clone());
        }
        Ok(tensors)
    }

    fn load(&mut self, saved: &Tensors) -> Result<()> {
        let flat = self.weights.flat();
        self.weights = Weights::from_flat(self.weights.config, saved.get("weights", &[flat.len()])?);
        for (k, cloths) in self.cloths.iter_mut().enumerate() {
            *cloths = saved.get(&format!("pool{k}"), &[cloths.len()])?.to_vec();
        }
        Ok(())
    }
}
