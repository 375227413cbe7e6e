//! The arrays of a pool do what the solver does, one iteration at a time.

use fnopt::cloth::{Grid, Model, State};
use fnopt::cpu::optim::{Minimizer, Update};
use fnopt::cpu::{self, Objective};
use fnopt::network;
use fnopt::sim::Optimizer;
use fnopt::train::{Arrays, Batch, MotionRanges, Pool, PoolConfig, ResetRules, Script, random_weights};

const GRID: Grid = Grid { h: 9, w: 12 };
const ITERATIONS: u32 = 2;

fn small_network() -> network::Weights {
    let config =
        network::Config { lifting: 16, channels: 16, projection: 16, layers: 2, ..Default::default() };
    random_weights(config, 3)
}

/// Runs one iteration of the update rule on the cloths of a batch.
fn iterate(batch: &Batch, drawn: &mut Arrays<f64>) {
    let (model, control) = (batch.model(GRID), batch.control());
    let mut objective = Objective::new(&model);
    objective.begin_frame(&drawn.state, &control);
    objective.set_accelerations(&drawn.a);
    objective.evaluate(&drawn.state, &control);
    let mut update = Update::new(&small_network(), GRID, objective.norms().len()).unwrap();
    *update.hidden_mut() = drawn.hidden.clone();
    update.step(objective.grad(), objective.norms(), &mut drawn.a);
    drawn.hidden = update.hidden().clone();
}

#[test]
fn frames_of_a_pool_are_those_of_the_solver() {
    let config = PoolConfig { grid: GRID, iterations: ITERATIONS, cloths: 4, batch: 3, ..Default::default() };
    let motion = MotionRanges { damping: 0.5, ..MotionRanges::default() };
    let mut pool =
        Pool::new(0, 7, config.clone(), (motion, ResetRules { energy: 1e30, ..Default::default() }));
    let mut arrays = Arrays::<f64>::of_pool(&config);
    let mut drawn = Arrays::new(GRID, config.batch);
    let mut frames = [0; 4];
    for step in 0..9 {
        let batch = pool.draw(step);
        arrays.draw(&batch, &mut drawn);
        iterate(&batch, &mut drawn);
        arrays.store(&batch, &mut drawn);
        pool.record(&batch, &vec![super::support::outcome(1.0); config.batch]);
        batch.cloths.iter().filter(|c| c.advance).for_each(|c| frames[c.slot] += 1);
    }
    assert!(frames.iter().all(|&f| f >= 2), "{frames:?}");
    let field = 3 * GRID.particles();
    for (slot, frames) in frames.into_iter().enumerate() {
        let script = Script::new(7, &motion, (0, &config), (slot, 0));
        let model = Model { grid: GRID, cloths: vec![script.cloth.clone()] };
        let optimizer = Optimizer::paper(small_network());
        let mut solver = cpu::Solver::<f64>::new(&model, &optimizer, ITERATIONS as usize).unwrap();
        let mut state = State::rest(GRID, 1);
        let rest = state.x.clone();
        let n = GRID.particles();
        for (component, row) in script.start().iter().enumerate() {
            (0..n).for_each(|p| {
                state.x[component * n + p] = (0..3).map(|k| row[k] * rest[k * n + p]).sum();
            });
        }
        for frame in 1..=frames {
            let handles = script.targets(frame);
            solver.step(&mut state, &fnopt::cloth::Control { handles, ..Default::default() });
            state.v.iter_mut().for_each(|v| *v *= 1.0 - script.damping);
            for &p in &script.cloth.handles {
                (0..3).for_each(|component| state.v[component * n + p] = 0.0);
            }
        }
        let at = slot * field..(slot + 1) * field;
        assert!(arrays.state.x[at.clone()] == state.x[..], "positions of cloth {slot} after {frames} frames");
        assert!(arrays.state.v[at.clone()] == state.v[..], "velocities of cloth {slot}");
        let begun = arrays.a[at].iter().any(|&a| a != 0.0);
        let iterations = pool.draw(99).cloths.iter().find(|c| c.slot == slot).map(|c| c.advance);
        assert!(iterations.is_none_or(|advance| advance == begun), "a is 0 between frames");
    }
}
