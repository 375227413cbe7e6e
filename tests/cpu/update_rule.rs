//! The learned update rule against the authors' implementation.

use crate::golden::{Golden, narrowed, relative_error, weights, widened};
use fnopt::cloth::Grid;
use fnopt::cpu::Real;
use fnopt::cpu::optim::{Minimizer, Update};

/// Runs one update from the state in the file, or from a fresh one. Returns the step and the new scales.
fn update<T: Real>(golden: &Golden, fresh: bool) -> (Vec<f64>, Vec<f64>) {
    let shape = golden.shape("grads");
    let grid = Grid { h: shape[2], w: shape[3] };
    let cast = |name: &str| golden.get(name).into_iter().map(T::of).collect::<Vec<_>>();
    let grad = cast("grads");
    let mut rule = Update::<T>::new(&weights(), grid, shape[0]).unwrap();
    if !fresh {
        let hidden = rule.hidden_mut();
        hidden.last_grad = cast("last_grads");
        hidden.last_step = cast("last_steps");
        hidden.scale = cast("scales");
    }
    let norm = |g: &[T]| g.iter().map(|g| g.f64().powi(2)).sum::<f64>().sqrt();
    let norms: Vec<f64> = grad.chunks(grid.particles()).map(norm).collect();
    let mut a = vec![T::zero(); grad.len()];
    rule.step(&grad, &norms, &mut a);
    assert!(a == rule.hidden().last_step, "the step is added to a");
    assert!(grad == rule.hidden().last_grad, "the gradient is remembered");
    let double = |values: &[T]| values.iter().map(|v| v.f64()).collect();
    (double(&a), double(rule.scales()))
}

#[test]
fn steps_agree_with_the_authors() {
    let golden = Golden::open("update_rule_24x40");
    for (fresh, suffix) in [(false, ""), (true, "_from_fresh_state")] {
        for (step, scales) in [update::<f64>(&golden, fresh), update::<f32>(&golden, fresh)] {
            let error = relative_error(&step, &golden.get(&format!("step{suffix}")));
            assert!(error < 2e-5, "step{suffix}: {error}");
            let error = relative_error(&scales, &golden.get(&format!("new_scales{suffix}")));
            assert!(error < 2e-5, "new_scales{suffix}: {error}");
        }
    }
}

#[test]
fn vanishing_gradients_stay_finite() {
    let grid = Grid { h: 9, w: 12 };
    let n = grid.particles();
    for size in [0.0f32, 1e-42, 1e-38, 1e-20] {
        let mut rule = Update::<f32>::new(&weights(), grid, 3).unwrap();
        let (mut a, zero) = (vec![0.0; 3 * n], vec![0.0; 3 * n]);
        let grad = narrowed(&crate::noise::noise(3 * n, 5)).iter().map(|g| g * size).collect::<Vec<_>>();
        for grad in [&grad, &zero, &grad] {
            let norm = widened(grad).iter().map(|g| g * g).sum::<f64>().sqrt();
            rule.step(grad, &[norm; 3], &mut a);
        }
        assert!(a.iter().all(|a| a.is_finite()), "gradients of size {size}");
    }
}
