//! A learner that computes nothing but keeps the state that a real one would, and ranks that are threads.

use fnopt::Result;
use fnopt::cloth::EnergyTerms;
use fnopt::network::Weights;
use fnopt::train::{Alone, Batch, Config, Learner, Outcome, Ranks, StepReport, Tensors, WeightUpdate};
use std::cell::RefCell;
use std::collections::HashSet;
use std::fmt::Display;
use std::rc::Rc;
use std::sync::mpsc::{Receiver, Sender, channel};

/// Returns the outcome of a step with this external energy.
pub fn outcome(external: f64) -> Outcome {
    Outcome { energy: EnergyTerms { external, ..Default::default() }, log_gradient: -2.0, scale: [0.05; 3] }
}

/// A learner whose weights depend on all its inputs, so that any difference between two runs shows in them.
pub struct Fake {
    weights: Weights,
    /// One number per cloth of each pool.
    cloths: Vec<Vec<f32>>,
    /// Steps with a non-finite loss, as counted by this object.
    broken: HashSet<u64>,
    /// The step after which the weights are not finite.
    overflows: Option<u64>,
    step: u64,
    /// The update of each step.
    pub updates: Rc<RefCell<Vec<WeightUpdate>>>,
}

impl Fake {
    pub fn new(config: &Config) -> Self {
        let weights = fnopt::train::initial_weights(config, &Alone).expect("weights");
        let cloths = config.pools.iter().map(|p| vec![0.0; p.cloths]).collect();
        Self { weights, cloths, broken: HashSet::new(), overflows: None, step: 0, updates: Rc::default() }
    }

    pub fn broken_at(mut self, steps: impl IntoIterator<Item = u64>) -> Self {
        self.broken = steps.into_iter().collect();
        self
    }

    pub fn overflows_after(self, step: u64) -> Self {
        Self { overflows: Some(step), ..self.broken_at(step + 1..1000) }
    }
}

impl Learner for Fake {
    fn step(&mut self, batches: &[Batch], update: WeightUpdate, ranks: &dyn Ranks) -> Result<StepReport> {
        let broken = self.broken.contains(&self.step);
        self.step += 1;
        self.updates.borrow_mut().push(update);
        let mut report = StepReport { outcomes: vec![Vec::new(); self.cloths.len()], ..Default::default() };
        for batch in batches {
            let mut outcomes = Vec::new();
            for drawn in &batch.cloths {
                let cloth = &mut self.cloths[batch.pool][drawn.slot];
                let inputs = drawn.targets.iter().flatten().chain(&drawn.cloth.gravity).sum::<f64>();
                let from = if drawn.start.is_some() { 0.1 } else { *cloth };
                *cloth = (from * 0.9 + inputs as f32).sin() + f32::from(u8::from(drawn.advance));
                outcomes.push(outcome(if broken { f64::NAN } else { f64::from(*cloth) }));
            }
            report.outcomes[batch.pool] = outcomes;
        }
        let mut gradient = [report.loss() as f32];
        ranks.sum_gradients(&mut gradient, report.loss());
        report.gradient_norm = gradient[0].abs().into();
        if report.is_finite() {
            let share = update.rate * update.number as f64 * (1.0 - update.average);
            self.weights.scalar.bias[0] += gradient[0] * share as f32;
        }
        if self.overflows == Some(self.step - 1) {
            self.weights.scalar.bias[0] = f32::INFINITY;
        }
        Ok(report)
    }

    fn weights(&self) -> Result<Weights> {
        Ok(self.weights.clone())
    }

    /// Returns weights that are told from the current ones by a bias that is larger by 1.
    fn averaged(&self) -> Result<Weights> {
        let mut averaged = self.weights()?;
        averaged.scalar.bias[0] += 1.0;
        Ok(averaged)
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

/// One of several threads that train together. If one panics, the others do, too.
pub struct ThreadRank {
    rank: usize,
    /// Senders to each rank, including this one.
    to: Vec<Sender<Vec<u8>>>,
    /// Receivers from each rank.
    from: Vec<Receiver<Vec<u8>>>,
}

impl ThreadRank {
    /// Calls `body` on each of `count` ranks and returns the results in order of rank.
    pub fn run<R: Send>(count: usize, body: impl Fn(ThreadRank) -> R + Sync) -> Vec<R> {
        let of = |rank| ThreadRank { rank, to: Vec::new(), from: Vec::new() };
        let mut ranks: Vec<ThreadRank> = (0..count).map(of).collect();
        for (from, to) in (0..count).flat_map(|from| (0..count).map(move |to| (from, to))) {
            let (sender, receiver) = channel();
            ranks[from].to.push(sender);
            ranks[to].from.push(receiver);
        }
        let body = &body;
        std::thread::scope(|scope| {
            let threads: Vec<_> = ranks.into_iter().map(|rank| scope.spawn(move || body(rank))).collect();
            threads.into_iter().map(|thread| thread.join().expect("a rank panicked")).collect()
        })
    }

    /// Returns the bytes of all ranks, in order of rank.
    fn exchange(&self, bytes: &[u8]) -> Vec<Vec<u8>> {
        self.to.iter().for_each(|to| to.send(bytes.to_vec()).expect("another rank has ended"));
        self.from.iter().map(|from| from.recv().expect("another rank has ended")).collect()
    }
}

impl Ranks for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.to.len()
    }

    fn local_rank(&self) -> usize {
        self.rank
    }

    fn sum(&self, values: &mut [f32]) {
        let brought = self.exchange(bytemuck::cast_slice(values));
        values.fill(0.0);
        for other in brought {
            let other: Vec<f32> = bytemuck::pod_collect_to_vec(&other);
            assert_eq!(other.len(), values.len(), "ranks are at different sums");
            values.iter_mut().zip(other).for_each(|(sum, value)| *sum += value);
        }
    }

    fn broadcast(&self, bytes: &mut [u8]) {
        bytes.copy_from_slice(&self.exchange(bytes)[0]);
    }

    fn abort(&self, error: &dyn Display) {
        panic!("rank {}: {error}", self.rank);
    }
}
