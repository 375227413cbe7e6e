//! The stages on the CPU, in either precision.

use super::{
    AdamWCase, EnergyCase, NetworkOutput, Precision, RolloutCase, RolloutFrame, Stages, TrainingCase,
    TrainingOutput, UpdateCase, gradient_of_push,
};
use crate::Result;
use crate::cloth::{Cloth, Control, EnergyTerms, Grid, Material, Model, Repulsion, State};
use crate::cpu::cloth::{GradientRows, Trial, energy, gradient, masses, repulsion};
use crate::cpu::operator::{Network, Stage};
use crate::cpu::optim::{Hidden, Minimizer, Update};
use crate::cpu::train::{AdamW, AdamWSettings, Loss};
use crate::cpu::{Real, Solver};
use crate::network::Weights;
use crate::settings::Normalisation;
use crate::sim::Optimizer;
use std::marker::PhantomData;
use std::sync::Arc;

/// The stages on the CPU in the precision of `T`.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuStages<T>(PhantomData<T>);

impl<T> CpuStages<T> {
    /// Builds the stages in the precision of `T`.
    pub fn new() -> Self {
        Self(PhantomData)
    }
}

impl<T: Real> Stages for CpuStages<T> {
    fn name(&self) -> String {
        format!("cpu f{}", 8 * size_of::<T>())
    }

    fn precision(&self) -> Precision {
        if size_of::<T>() == 8 { Precision::Double } else { Precision::Single }
    }

    fn network(&mut self, weights: &Weights, grid: Grid, input: &[f64]) -> Result<NetworkOutput> {
        let samples = input.len() / (weights.config.fields * grid.particles());
        let mut network = Network::<T>::new(weights, grid, samples)?;
        let mut output = NetworkOutput::default();
        network.forward_observed(&cast(input), &mut |stage, values| match stage {
            Stage::Embedded => output.embedded = double(values),
            Stage::Lifted => output.lifted = double(values),
            Stage::Block(_) => output.blocks.push(double(values)),
        });
        output.field = double(network.field());
        output.scalar = double(network.scalar());
        Ok(output)
    }

    fn energy(&mut self, case: &EnergyCase) -> Result<(Vec<EnergyTerms>, Vec<f64>)> {
        let model = Model { grid: case.grid, cloths: case.cloths.clone() };
        let (marks, n) = (model.marks(), case.grid.particles());
        let masses = masses(case.grid, &marks);
        let [x, base, a, f] = [&case.x, &case.base, &case.a, &case.external].map(|v| cast::<T>(v));
        let moved = |k: usize| match marks[k / (3 * n) * n + k % n].is_free() {
            true => base[k] + a[k],
            false => base[k],
        };
        let shift: Vec<T> = (0..x.len()).map(moved).collect();
        let mut rows = GradientRows::new(case.grid);
        let (mut terms, mut gradients) = (Vec::new(), Vec::new());
        for (b, cloth) in model.cloths.iter().enumerate() {
            let at = 3 * n * b..3 * n * (b + 1);
            let trial = Trial {
                grid: case.grid,
                material: cloth.material,
                x: &x[at.clone()],
                shift: &shift[at.clone()],
                a: &a[at.clone()],
                f: &f[at],
                marks: &marks[n * b..n * (b + 1)],
                masses: &masses[n * b..n * (b + 1)],
                damping: 0.0,
                elements: None,
                near: None,
            };
            terms.push(energy(&trial));
            let mut grad = vec![T::zero(); 3 * n];
            gradient(&trial, &mut rows, &mut grad);
            gradients.extend(double(&grad));
        }
        Ok((terms, gradients))
    }

    fn repulsion(&mut self, grid: Grid, positions: &[f64], of_cloth: Repulsion) -> Result<(f64, Vec<f64>)> {
        let n = grid.particles();
        let (x, zeros, mut accelerations) =
            (cast::<T>(positions), vec![T::zero(); 3 * n], vec![T::zero(); 3 * n]);
        let marks = Model { grid, cloths: vec![Cloth::default()] }.marks();
        let trial = Trial {
            grid,
            material: Material::default(),
            x: &x,
            shift: &zeros,
            a: &zeros,
            f: &zeros,
            marks: &marks,
            masses: &masses(grid, &marks),
            damping: 0.0,
            elements: None,
            near: None,
        };
        let energy = repulsion(&trial, of_cloth, &mut accelerations);
        Ok((energy, gradient_of_push(grid, &double(&accelerations))))
    }

    fn update(&mut self, weights: &Weights, case: &UpdateCase) -> Result<(Vec<f64>, Vec<f64>)> {
        let (samples, n) = (case.scale.len(), case.grid.particles());
        let mut update = Update::<T>::new(weights, case.grid, samples)?;
        let hidden = update.hidden_mut();
        hidden.last_grad = cast(&case.last_grad);
        hidden.last_step = cast(&case.last_step);
        hidden.scale = cast(&case.scale);
        let norm = |g: &[f64]| g.iter().map(|g| g * g).sum::<f64>().sqrt();
        let norms: Vec<f64> = case.grad.chunks_exact(n).map(norm).collect();
        // Starting from a = 0, the acceleration is the step.
        let mut step = vec![T::zero(); samples * n];
        update.step(&cast(&case.grad), &norms, &mut step);
        Ok((double(&step), double(&update.hidden().scale)))
    }

    fn training_step(&mut self, weights: &Weights, case: &TrainingCase) -> Result<TrainingOutput> {
        let model = Model { grid: case.grid, cloths: case.cloths.clone() };
        let batch = model.batch();
        let state = State { x: cast(&case.x), v: cast(&case.v) };
        let control = Control {
            handles: case.targets.iter().map(|p| p.map(T::of)).collect(),
            external: cast(&case.external),
            ..Default::default()
        };
        let mut hidden = Hidden {
            last_grad: cast(&case.last_grad),
            last_step: cast(&case.last_step),
            scale: cast(&case.scale),
        };
        let mut gradient = vec![T::zero(); weights.parameter_count()];
        let share = 1.0 / batch as f64;
        let outcomes = Loss::<T>::new(weights, &model, Normalisation::Component)?.step(
            (&state, &control),
            (&mut cast(&case.a), &mut hidden),
            share,
            &mut gradient,
        );
        let loss = outcomes.iter().map(|o| o.energy.total()).sum::<f64>() * share;
        Ok(TrainingOutput { loss, step: double(&hidden.last_step), gradient: double(&gradient) })
    }

    fn adamw(&mut self, case: &AdamWCase) -> Result<Vec<Vec<f64>>> {
        let mut weights = cast::<T>(&case.before);
        let settings = AdamWSettings { clip: case.clip, ..Default::default() };
        let mut adamw = AdamW::new(settings, weights.len());
        let steps = case.gradients.iter().zip(1..).map(|(gradient, number)| {
            let gradient = cast::<T>(gradient);
            adamw.step(&mut weights, (&gradient, AdamW::norm(&gradient)), number, case.rate);
            double(&weights)
        });
        Ok(steps.collect())
    }

    fn rollout(&mut self, weights: &Arc<Weights>, case: &RolloutCase) -> Result<Vec<RolloutFrame>> {
        let model = Model { grid: case.grid, cloths: vec![case.cloth.clone()] };
        let mut solver = Solver::<T>::new(&model, &Optimizer::paper(weights.clone()), case.iterations)?;
        let x = cast::<T>(&case.start);
        let mut state = State { v: vec![T::zero(); x.len()], x };
        let mut frames = Vec::with_capacity(case.targets.len());
        for targets in &case.targets {
            let handles = targets.iter().map(|p| p.map(T::of)).collect();
            solver.step(&mut state, &Control { handles, ..Default::default() });
            let log = solver.iteration_log();
            frames.push(RolloutFrame {
                x: double(&state.x),
                v: double(&state.v),
                a: double(solver.accelerations()),
                scales: log.scales.clone(),
                gradient_norms: log.gradient_norms.clone(),
            });
        }
        Ok(frames)
    }
}

fn cast<T: Real>(values: &[f64]) -> Vec<T> {
    values.iter().map(|&v| T::of(v)).collect()
}

fn double<T: Real>(values: &[T]) -> Vec<f64> {
    values.iter().map(|v| v.f64()).collect()
}
