//! The loss of a batch of cloths on one grid and its gradient over the weights (paper section 3.3): one iteration of the
//! learned optimizer, judged by the energies where it leads, and by those where another one would lead from there.

use crate::Result;
use crate::cpu::operator::LaidOut;
use crate::cpu::optim::{Hidden, UpdateAdjoint, norm};
use crate::cpu::{Objective, Real};
use crate::network::Weights;
use crate::sim::{Control, EnergyTerms, Model, State};

/// The loss for batches of B cloths on one grid.
pub struct Loss<T: Real> {
    objective: Objective<T>,
    update: UpdateAdjoint<T>,
    /// Cotangents of the iterate and of the memory after the iteration.
    adj_a: Vec<T>,
    adj: Hidden<T>,
    lookahead: Option<Lookahead<T>>,
}

/// The iteration after the one that is learned from: how it would use what the first one leaves.
struct Lookahead<T: Real> {
    weight: f64,
    update: UpdateAdjoint<T>,
    /// The iterate before it, and the memory after it.
    a: Vec<T>,
    hidden: Hidden<T>,
    /// Cotangents of the iterate after it and of its gradient, and the latter times the second derivatives.
    adj_a: Vec<T>,
    adj_grad: Vec<T>,
    product: Vec<T>,
}

/// What one cloth contributes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Energy terms after the step.
    pub energy: EnergyTerms,
    /// Mean over particles and components of |dL/da| after the step.
    pub mean_gradient: f64,
}

impl<T: Real> Loss<T> {
    /// For batches like `model`; an error if the grid is too small for the kept modes.
    pub fn new(weights: &Weights, model: &Model) -> Result<Self> {
        let objective = Objective::new(model);
        let (len, samples) = (objective.grad().len(), 3 * model.batch());
        let update = UpdateAdjoint::new(weights, model.grid, samples)?;
        let (adj_a, adj) = (vec![T::zero(); len], Hidden::zeros(len, samples));
        Ok(Self { objective, update, adj_a, adj, lookahead: None })
    }

    /// A loss that also counts the energies one iteration further on, with this weight beside 1: see [`Loss::step`].
    pub fn with_lookahead(weights: &Weights, model: &Model, weight: f64) -> Result<Self> {
        let mut loss = Self::new(weights, model)?;
        if weight > 0.0 {
            let (len, samples) = (loss.adj_a.len(), 3 * model.batch());
            let zeros = || vec![T::zero(); len];
            loss.lookahead = Some(Lookahead {
                weight,
                update: UpdateAdjoint::new(weights, model.grid, samples)?,
                a: zeros(),
                hidden: Hidden::zeros(len, samples),
                adj_a: zeros(),
                adj_grad: zeros(),
                product: zeros(),
            });
        }
        Ok(loss)
    }

    /// Takes other weights of the same sizes.
    pub fn set_weights(&mut self, weights: &LaidOut<T>) {
        self.update.set_weights(weights);
        if let Some(lookahead) = &mut self.lookahead {
            lookahead.update.set_weights(weights);
        }
    }

    /// Takes other cloths, as many on the same grid.
    pub fn set_model(&mut self, model: &Model) {
        self.objective.set_model(model);
    }

    /// One iteration of the frame that `control` drives from `state`: adds the step to `a` [B, 3, H, W] and remembers it
    /// in `hidden`, adds the gradient over all weights of `share` times the sum of the energies to `gradient`.
    ///
    /// With a lookahead, cloths whose frame does not end here (`ends`, shape \[B\]) are judged further on too: the same
    /// weights, now constant, make another step, and the energy after it goes back through that step (its gradient, by the
    /// second derivatives of the energy, and its memory) to the first one. Sample by sample, the cotangents of the first
    /// step of both energies are added with their lengths made 1 and the weight.
    pub fn step(
        &mut self,
        (state, control): (&State<T>, &Control<T>),
        (a, hidden): (&mut [T], &mut Hidden<T>),
        (ends, share): (&[bool], f64),
        gradient: &mut [T],
    ) -> Vec<Outcome> {
        let Self { objective, update, adj_a, adj, lookahead } = self;
        objective.begin_frame(state, control);
        objective.set_accelerations(a);
        objective.evaluate(state, control);
        update.forward((&objective.grad, &objective.norms), hidden, &mut objective.trial.a);
        a.copy_from_slice(&objective.trial.a);
        objective.evaluate(state, control);
        let cloth = objective.cloth_len();
        let outcome = |(b, grad): (usize, &[T])| Outcome {
            energy: objective.energy(state, b),
            mean_gradient: grad.iter().map(|g| g.f64().abs()).sum::<f64>() / cloth as f64,
        };
        let outcomes = objective.grad().chunks_exact(cloth).enumerate().map(outcome).collect();
        let share = T::of(share);
        for (adj, &grad) in adj_a.iter_mut().zip(objective.grad()) {
            *adj = grad * share;
        }
        if let Some(lookahead) = lookahead {
            lookahead.add(objective, (state, control), hidden, ends, (adj_a, adj));
        }
        update.backward(adj_a, adj, hidden, gradient);
        outcomes
    }
}

impl<T: Real> Lookahead<T> {
    /// Adds the cotangents of the energy one iteration further on than `objective` to those of the energy there, `near`,
    /// and sets those of the memory, `adj`. The trial of the objective moves.
    fn add(
        &mut self,
        objective: &mut Objective<T>,
        frame: (&State<T>, &Control<T>),
        memory: &Hidden<T>,
        ends: &[bool],
        (near, adj): (&mut [T], &mut Hidden<T>),
    ) {
        let n = objective.cloth_len() / 3;
        self.cotangents(objective, frame, memory, adj);
        for (sample, (near, far)) in near.chunks_exact_mut(n).zip(self.adj_a.chunks_exact(n)).enumerate() {
            let last_step = &mut adj.last_step[sample * n..][..n];
            // Of the step: it is added to the iterate and remembered.
            let both = |(&far, &step): (&T, &T)| (far.f64() + step.f64()).powi(2);
            let length = far.iter().zip(&*last_step).map(both).sum::<f64>().sqrt();
            // What cannot be measured has no direction.
            let unit = |length: f64| if length.is_normal() { length.recip() } else { 0.0 };
            let weight = if ends[sample / 3] { 0.0 } else { self.weight };
            let (near_by, far_by) = (T::of(unit(norm(near))), T::of(weight * unit(length)));
            near.iter_mut().zip(far).for_each(|(near, &far)| *near = *near * near_by + far * far_by);
            last_step.iter_mut().for_each(|adj| *adj = *adj * far_by);
            adj.scale[sample] = adj.scale[sample] * far_by;
        }
    }

    /// Sets the cotangents of the energy after another iteration: `self.adj_a` to that of the iterate where `objective` was
    /// evaluated, `adj` to that of the memory there.
    fn cotangents(
        &mut self,
        objective: &mut Objective<T>,
        (state, control): (&State<T>, &Control<T>),
        memory: &Hidden<T>,
        adj: &mut Hidden<T>,
    ) {
        let Self { update, a, hidden, adj_a, adj_grad, product, .. } = self;
        hidden.clone_from(memory);
        a.copy_from_slice(&objective.trial.a);
        update.forward((&objective.grad, &objective.norms), hidden, &mut objective.trial.a);
        objective.evaluate(state, control);
        adj_a.copy_from_slice(&objective.grad);
        adj.clear();
        update.pull_back(adj_a, adj, (memory, hidden), adj_grad);
        objective.set_accelerations(a);
        objective.hessian_product((state, control), adj_grad, product);
        for (adj, &more) in adj_a.iter_mut().zip(&*product) {
            *adj = *adj + more;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Config;
    use crate::sim::{Cloth, Grid};
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    fn noise(len: usize, seed: u64, size: f64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..len).map(|_| random.random_range(-size..size)).collect()
    }

    /// Two cloths in the middle of a frame.
    struct Case {
        weights: Weights,
        model: Model,
        state: State<f64>,
        control: Control<f64>,
        a: Vec<f64>,
        memory: Hidden<f64>,
    }

    fn case() -> Case {
        let config =
            Config { fields: 3, lifting: 6, channels: 5, projection: 4, layers: 4, modes_h: 4, modes_w: 3 };
        let flat = noise(Weights::zeros(config).flat().len(), 1, 0.5);
        let flat: Vec<f32> = flat.into_iter().map(|w| w as f32).collect();
        let grid = Grid { h: 9, w: 8 };
        let model = Model { grid, cloths: vec![Cloth { handles: vec![0], ..Cloth::default() }; 2] };
        let mut state = State::<f64>::rest(grid, 2);
        let len = state.x.len();
        state.x.iter_mut().zip(noise(len, 2, 0.1)).for_each(|(x, d)| *x += d);
        let memory = Hidden {
            last_grad: noise(len, 3, 0.1),
            last_step: noise(len, 4, 0.01),
            scale: vec![0.05, 0.06, 0.07, 0.04, 0.03, 0.05],
        };
        let control = Control { handles: vec![[0.1, -4.0, 0.2]; 2], ..Control::default() };
        Case {
            weights: Weights::from_flat(config, &flat),
            model,
            state,
            control,
            a: noise(len, 5, 0.01),
            memory,
        }
    }

    #[test]
    fn the_energy_after_another_iteration_goes_back_to_where_it_began() {
        let Case { weights, model, state, control, a, memory } = case();
        let mut loss = Loss::<f64>::with_lookahead(&weights, &model, 1.0).unwrap();
        let Loss { objective, lookahead: Some(lookahead), adj, .. } = &mut loss else {
            panic!("it looks ahead")
        };
        objective.begin_frame(&state, &control);
        let mut further = |a: &[f64], memory: &Hidden<f64>| {
            objective.set_accelerations(a);
            objective.evaluate(&state, &control);
            lookahead.cotangents(objective, (&state, &control), memory, adj);
            // The trial is back where it was; what came after it is where the last step leads.
            let step = &lookahead.hidden.last_step;
            objective.trial.a.iter_mut().zip(step).for_each(|(a, step)| *a += step);
            objective.place(&state, &control);
            let energy: f64 = (0..2).map(|b| objective.energy(&state, b).total()).sum();
            (energy, lookahead.adj_a.clone(), adj.clone())
        };
        let (_, adj_a, adj) = further(&a, &memory);
        let moved = |x: &[f64], way: &[f64], t: f64| -> Vec<f64> {
            x.iter().zip(way).map(|(x, w)| x + t * w).collect()
        };
        let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let way = Hidden {
            last_grad: noise(a.len(), 6, 0.1),
            last_step: noise(a.len(), 7, 0.1),
            scale: noise(6, 8, 0.1),
        };
        let way_a = noise(a.len(), 9, 0.1);
        let mut slope = |of_a: f64, of_memory: f64| {
            let mut at = |t: f64| {
                let memory = Hidden {
                    last_grad: memory.last_grad.clone(),
                    last_step: moved(&memory.last_step, &way.last_step, t * of_memory),
                    scale: moved(&memory.scale, &way.scale, t * of_memory),
                };
                further(&moved(&a, &way_a, t * of_a), &memory).0
            };
            let h = 1e-4;
            (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
        };
        let found = [dot(&adj_a, &way_a), dot(&adj.last_step, &way.last_step) + dot(&adj.scale, &way.scale)];
        for (found, expected) in found.into_iter().zip([slope(1.0, 0.0), slope(0.0, 1.0)]) {
            assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found}, not {expected}");
        }
    }

    #[test]
    fn nothing_is_looked_for_beyond_the_end_of_a_frame() {
        let Case { weights, model, state, control, a, memory } = case();
        let run = |weight: f64, ends: [bool; 2]| {
            let mut loss = Loss::<f64>::with_lookahead(&weights, &model, weight).unwrap();
            let mut gradient = vec![0.0; weights.parameter_count()];
            let (mut a, mut hidden) = (a.clone(), memory.clone());
            let outcomes = loss.step((&state, &control), (&mut a, &mut hidden), (&ends, 0.5), &mut gradient);
            (outcomes, a, hidden.last_step, gradient)
        };
        let (plain, ended, further) = (run(0.0, [false; 2]), run(0.5, [true; 2]), run(0.5, [false; 2]));
        for other in [&ended, &further] {
            assert_eq!(
                (&plain.0, &plain.1, &plain.2),
                (&other.0, &other.1, &other.2),
                "the cloths move the same way"
            );
        }
        let apart = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
        let size = plain.3.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
        assert!(apart(&plain.3, &ended.3) < 1e-12 * size);
        // The steps of this case are small, and with them what looking ahead changes.
        assert!(apart(&plain.3, &further.3) > 1e-4 * size);
    }
}
