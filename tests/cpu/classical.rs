//! Steps of the classical optimizers against closed forms.

use crate::golden::largest_difference as apart;
use crate::noise::noise;
use fnopt::cpu::optim::{Adam, GradientDescent, Lbfgs, Minimizer};
use fnopt::settings::{AdamSettings, LONGEST, LbfgsSettings, SHORTEST};

/// Returns the iterates from `a` on, for the gradient `k a` with one steepness k per unknown.
fn iterates(
    optimizer: &mut dyn Minimizer<f64>,
    steepness: &[f64],
    mut a: Vec<f64>,
    steps: usize,
) -> Vec<Vec<f64>> {
    optimizer.begin_frame();
    let mut all = vec![a.clone()];
    for _ in 0..steps {
        let grad: Vec<f64> = a.iter().zip(steepness).map(|(a, k)| k * a).collect();
        optimizer.step(&grad, &[], &mut a);
        all.push(a.clone());
    }
    all
}

#[test]
fn gradient_descent_goes_along_the_gradient() {
    let (rate, steepness) = (0.3, 0.5);
    let all = iterates(&mut GradientDescent::new(rate), &[steepness; 12], noise(12, 1), 5);
    for pair in all.windows(2) {
        let expected: Vec<f64> = pair[0].iter().map(|a| a * (1.0 - rate * steepness)).collect();
        assert!(apart(&pair[1], &expected) < 1e-15);
    }
}

#[test]
fn adam_begins_with_steps_of_its_rate() {
    let (rate, betas, epsilon) = (0.01, [0.9, 0.999], 1e-8);
    let steepness: Vec<f64> = noise(12, 2).iter().map(|k| 2.0 + k).collect();
    let adam = &mut Adam::new(AdamSettings { rate, beta1: betas[0], beta2: betas[1], epsilon }, 12);
    let all = iterates(adam, &steepness, noise(12, 1), 2);
    // Both averages hold one gradient, so the first step has the size of the rate, whatever the gradient.
    let gradient = |k: usize, step: usize| steepness[k] * all[step][k];
    let first = (0..12).map(|k| all[0][k] - rate * gradient(k, 0) / (gradient(k, 0).abs() + epsilon));
    let first: Vec<f64> = first.collect();
    assert!(apart(&all[1], &first) < 1e-12 * rate, "{:e}", apart(&all[1], &first));
    // The second step weighs two gradients g and h: (b g + h) / (1 + b), over the root of the same mean of
    // their squares.
    let second = (0..12).map(|k| {
        let (g, h) = (gradient(k, 0), gradient(k, 1));
        let mean = (betas[0] * g + h) / (1.0 + betas[0]);
        let square = (betas[1] * g * g + h * h) / (1.0 + betas[1]);
        all[1][k] - rate * mean / (square.sqrt() + epsilon)
    });
    let second: Vec<f64> = second.collect();
    assert!(apart(&all[2], &second) < 1e-12 * rate, "{:e}", apart(&all[2], &second));
}

#[test]
fn lbfgs_learns_the_curvature_of_a_quadratic() {
    let lbfgs = || Lbfgs::new(LbfgsSettings { history: 5, curvature: 1e-12 }, 12, 1);
    // The second step lands at the minimum of a sphere.
    let all = iterates(&mut lbfgs(), &[0.4; 12], noise(12, 1), 2);
    let first: Vec<f64> = all[0].iter().map(|a| a * (1.0 - 0.4)).collect();
    assert!(apart(&all[1], &first) < 1e-15, "without history the step is the gradient");
    assert!(apart(&all[2], &[0.0; 12]) < 1e-15, "{:?}", all[2]);
    // The inverse Hessian H is symmetric and maps the newest pair onto itself, H y = s. Hence y . H g = s . g
    // for any gradient g.
    let steepness: Vec<f64> = noise(12, 2).iter().map(|k| 1.0 + 0.5 * k).collect();
    let all = iterates(&mut lbfgs(), &steepness, noise(12, 1), 9);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let times = |a: &[f64]| a.iter().zip(&steepness).map(|(a, k)| a * k).collect::<Vec<_>>();
    let minus = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>();
    for three in all.windows(3) {
        let (s, step) = (minus(&three[1], &three[0]), minus(&three[2], &three[1]));
        let (y, g) = (times(&s), times(&three[1]));
        let (found, expected) = (-dot(&y, &step), dot(&s, &g));
        assert!(
            (found - expected).abs() < 1e-12 * dot(&s, &s).sqrt() * dot(&g, &g).sqrt(),
            "{found}, {expected}"
        );
    }
}

/// The two-loop recursion against the matrix that it stands for, built from the newest pairs alone.
#[test]
fn lbfgs_remembers_as_many_pairs_as_it_is_told() {
    const HISTORY: usize = 3;
    let steepness: Vec<f64> = noise(12, 2).iter().map(|k| 1.0 + 0.9 * k).collect();
    let mut lbfgs = Lbfgs::new(LbfgsSettings { history: HISTORY, curvature: 1e-12 }, 12, 1);
    let all = iterates(&mut lbfgs, &steepness, noise(12, 1), 8);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let times = |a: &[f64]| a.iter().zip(&steepness).map(|(a, k)| a * k).collect::<Vec<_>>();
    let minus = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>();
    for at in 1..all.len() - 1 {
        let (g, step) = (times(&all[at]), minus(&all[at + 1], &all[at]));
        let of = |pairs: usize| {
            let pairs: Vec<_> = (at.saturating_sub(pairs)..at)
                .map(|k| minus(&all[k + 1], &all[k]))
                .map(|s| (times(&s), s))
                .collect();
            let (y, s) = pairs.last().expect("a pair");
            let scale = dot(s, y) / dot(y, y);
            let mut inverse: Vec<Vec<f64>> =
                (0..12).map(|i| (0..12).map(|j| if i == j { scale } else { 0.0 }).collect()).collect();
            for (y, s) in &pairs {
                // H <- (1 - r s y^T) H (1 - r y s^T) + r s s^T with r = 1 / s.y
                let r = 1.0 / dot(s, y);
                let hy: Vec<f64> = inverse.iter().map(|row| dot(row, y)).collect();
                let yhy = dot(y, &hy);
                for i in 0..12 {
                    for j in 0..12 {
                        inverse[i][j] += r * ((1.0 + r * yhy) * s[i] * s[j] - s[i] * hy[j] - hy[i] * s[j]);
                    }
                }
            }
            inverse.iter().map(|row| -dot(row, &g)).collect::<Vec<_>>()
        };
        let size = dot(&step, &step).sqrt();
        assert!(apart(&step, &of(HISTORY)) < 1e-9 * size, "step {at}");
        if at > HISTORY {
            let others = [HISTORY - 1, HISTORY + 1].map(|pairs| apart(&step, &of(pairs)) / size);
            assert!(others.iter().all(|&other| other > 1e-6), "step {at}: {others:?}");
        }
    }
}

/// One iteration later, a step along a secant stands at the exact minimum of a quadratic energy along it, unless
/// that is farther than twice the step; the interpolated gradient there is the true one.
#[test]
fn steps_along_secants_are_corrected_to_their_minimum() {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    // Without pairs the first step is the gradient: half the way to the minimum of 0.5, five times that of 5.
    for (steepness, corrected) in [(0.8, 1.0 / 0.8), (5.0, 0.2), (0.25, LONGEST)] {
        let (start, settings) = (noise(12, 1), LbfgsSettings { history: 5, curvature: 1e-12 });
        let mut lbfgs = Lbfgs::new(settings, 12, 1).along_secants();
        let (mut a, grad) = (start.clone(), |a: &[f64]| a.iter().map(|a| steepness * a).collect::<Vec<_>>());
        lbfgs.begin_frame();
        lbfgs.step(&grad(&a), &[], &mut a);
        let first: Vec<f64> = start.iter().zip(&a).map(|(start, a)| a - start).collect();
        lbfgs.step(&grad(&a), &[], &mut a);
        let at: Vec<f64> = start.iter().zip(&first).map(|(start, s)| start + corrected * s).collect();
        // The pair knows the curvature, so the next direction ends at the minimum. It begins shorter if the first
        // step was too long.
        let length = corrected.clamp(SHORTEST, 1.0);
        let expected: Vec<f64> = at.iter().map(|at| (1.0 - length) * at).collect();
        assert!(apart(&a, &expected) < 1e-14 * dot(&start, &start).sqrt(), "{steepness}: {a:?} {expected:?}");
    }
}

#[test]
fn lbfgs_learns_nothing_from_a_pair_without_curvature() {
    let (g, mut a) = (noise(12, 3), vec![0.0; 12]);
    let mut optimizer = Lbfgs::new(LbfgsSettings { history: 5, curvature: 1e-12 }, 12, 1);
    optimizer.begin_frame();
    optimizer.step(&g, &[], &mut a);
    // The gradient has not changed along the step.
    optimizer.step(&g, &[], &mut a);
    let twice: Vec<f64> = g.iter().map(|g| -2.0 * g).collect();
    assert!(apart(&a, &twice) < 1e-15);
}
