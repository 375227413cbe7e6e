//! The frame on the CPU (paper sections 3.2 and 3.3).

use super::optim::{Minimizer, minimizer, norm};
use super::{Objective, Real};
use crate::Result;
use crate::sim::{Control, FrameStats, Iterations, Model, Optimizer, State};

/// Advances a batch of cloths frame by frame.
pub struct Solver<T: Real> {
    iterations: usize,
    minimizer: Box<dyn Minimizer<T>>,
    log: Iterations,
    objective: Objective<T>,
}

impl<T: Real> Solver<T> {
    /// A solver with `iterations` steps of the optimizer per frame; an error if the grid does not suit the network.
    pub fn new(model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        assert!(iterations > 0, "a frame needs an iteration");
        Ok(Self {
            iterations,
            minimizer: minimizer(optimizer, model)?,
            log: Iterations::default(),
            objective: Objective::new(model),
        })
    }

    /// Advances `state` by one frame driven by `control`; statistics of each cloth.
    ///
    /// Panics when a length is not the model's.
    pub fn step(&mut self, state: &mut State<T>, control: &Control<T>) -> Vec<FrameStats> {
        let objective = &mut self.objective;
        objective.begin_frame(state, control);
        objective.trial.a.fill(T::zero());
        self.log.gradient_norms.clear();
        self.log.scales.clear();
        self.minimizer.begin_frame();
        for _ in 0..self.iterations {
            objective.evaluate(state, control);
            self.minimizer.step(&objective.grad, &objective.norms, &mut objective.trial.a);
            self.log.gradient_norms.extend(&objective.norms);
            self.log.scales.extend(self.minimizer.scales().iter().map(|s| s.f64()));
        }
        objective.place(state, control);
        let stats = self.stats(state);
        self.objective.end_frame(state, control);
        stats
    }

    /// Forgets the optimizer's memory, as when a scene starts again.
    pub fn reset(&mut self) {
        self.minimizer.reset();
    }

    /// What the optimizer did in the last frame.
    pub fn iterations(&self) -> &Iterations {
        &self.log
    }

    /// Accelerations that the last frame accepted [edges / frame^2], shape [B, 3, H, W].
    pub fn accelerations(&self) -> &[T] {
        &self.objective.trial.a
    }

    fn stats(&self, state: &State<T>) -> Vec<FrameStats> {
        let batch = self.objective.model().batch();
        let norms = &self.log.gradient_norms;
        let norm_at = |iteration: usize, b: usize| norm(&norms[iteration * 3 * batch + 3 * b..][..3]);
        let cloth = |b: usize| {
            let (stretch_largest, stretch_mean) = self.objective.stretch(state, b);
            FrameStats {
                energy: self.objective.energy(state, b),
                gradient_first: norm_at(0, b),
                gradient_last: norm_at(self.iterations - 1, b),
                stretch_largest,
                stretch_mean,
            }
        };
        (0..batch).map(cloth).collect()
    }
}
