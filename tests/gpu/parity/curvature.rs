//! `curvature` against differences of the CPU path's gradient, and against its energies.

use super::cloth::{Doubles, OnDevice, PAIRS, crumpled, field, held, model};
use crate::common::{ROUNDING, assert_close, cases, context, device, largest, poisoned, read, run, widened};
use fnopt::cloth::{Grid, Model, State};
use fnopt::cpu::cloth::{GradientRows, energy, gradient};
use fnopt::kernels::cloth::Curvature;
use fnopt::kernels::cloth::curvature::{VALUES, parts_shape};
use fnopt::kernels::optim::directions;

/// A grid with more tiles than parts, so that a workgroup takes several tiles.
const LARGE: Grid = Grid { h: 130, w: 139 };

/// A trial: positions, displacements at a = 0, accelerations and external accelerations.
struct Case<'a> {
    model: &'a Model,
    fields: [&'a [f32]; 4],
    grad: &'a [f32],
    /// Three or four directions.
    directions: &'a [Vec<f32>],
}

impl Case<'_> {
    /// Returns the sums over all parts [B, 24] in double precision, of the device.
    fn found(&self, kernel: &Curvature, energy_alone: bool) -> Vec<f64> {
        let Self { model, fields, grad, directions } = *self;
        let (grid, batch) = (model.grid, model.batch());
        let cloths = OnDevice::new(model, fields);
        cloths.iterate.grad.write(context(), grad);
        let all = poisoned("directions", &directions::shape(directions.len(), batch, grid));
        for (at, direction) in directions.iter().enumerate() {
            directions::one(&all, at, batch, grid).write(context(), direction);
        }
        let parts = poisoned("parts", &parts_shape(batch, grid));
        run(|schedule| {
            let (trial, of) = (cloths.trial(), [&all, &parts]);
            if energy_alone {
                kernel.push_energy(schedule, trial, of);
            } else {
                kernel.push(schedule, trial, of);
            }
        });
        let mut sums = vec![0.0; VALUES * batch];
        let per_cloth = parts.len() / batch;
        for (k, v) in read(&parts).into_iter().enumerate() {
            sums[k / per_cloth * VALUES + k % VALUES] += f64::from(v);
        }
        sums
    }

    /// Returns A [4, 4] of cloth b by differences of the gradient.
    fn curvature(&self, b: usize) -> Vec<f64> {
        let (doubles, n) = (Doubles::new(self.model, self.fields), self.model.grid.particles());
        let mut rows = GradientRows::new(self.model.grid);
        let directions: Vec<Vec<f64>> = self.directions.iter().map(|p| widened(p)).collect();
        let mut found = vec![0.0; 16];
        for (j, p) in directions.iter().enumerate() {
            let step = 1e-5 / largest(p).max(1.0);
            let mut at = |step: f64| {
                let mut grad = vec![0.0; 3 * n];
                gradient(&doubles.moved(p, step).cloth(b), &mut rows, &mut grad);
                grad
            };
            let (ahead, back) = (at(step), at(-step));
            for (i, p) in directions.iter().enumerate() {
                let changes = ahead.iter().zip(&back).map(|(ahead, back)| (ahead - back) / (2.0 * step));
                found[4 * i + j] = p[3 * b * n..][..3 * n].iter().zip(changes).map(|(p, g)| p * g).sum();
            }
        }
        found
    }
}

#[test]
fn models_and_energies_match() {
    let _turn = device();
    let kernel = Curvature::new(context()).unwrap();
    for (grid, batch) in cases().chain([(LARGE, 1)]) {
        let (model, n) = (model(grid, batch), grid.particles());
        let rest = State::<f32>::rest(grid, batch).x;
        let shrunk = rest.iter().map(|x| 0.75 * x).collect();
        for (name, x) in [
            ("rest", rest),
            ("shrunk", shrunk),
            ("wavy", crumpled(&model, 0.02)),
            ("crumpled", crumpled(&model, 0.3)),
        ] {
            let still = ["rest", "shrunk"].contains(&name);
            let (a, f) = (held(&model, if still { 0.0 } else { 0.05 }, 73), field(&model, 0.1, 74));
            let (base, grad) = (field(&model, if still { 0.0 } else { 0.05 }, 79), field(&model, 1.0, 75));
            // The third is small and the first smooth, as steps are.
            let smooth: Vec<f32> = held(&model, 1.0, 80)
                .iter()
                .enumerate()
                .map(|(k, v)| if *v == 0.0 { 0.0 } else { (0.1 * (k % n / grid.w) as f32).sin() })
                .collect();
            let four = [smooth, held(&model, 1.0, 81), held(&model, 0.001, 82), held(&model, 0.3, 83)];
            for directions in [&four[..3], &four[..]] {
                let case = Case { model: &model, fields: [&x, &base, &a, &f], grad: &grad, directions };
                let all = case.found(&kernel, false);
                let energies = case.found(&kernel, true);
                let doubles = Doubles::new(&model, case.fields);
                for b in 0..batch {
                    let what = format!("{name} {} {b} of {batch} x {grid}", directions.len());
                    let found = |range: std::ops::Range<usize>| -> Vec<f32> {
                        all[b * VALUES..][range].iter().map(|&v| v as f32).collect()
                    };
                    let exact = case.curvature(b);
                    let own = |i: usize| exact[5 * i].abs().sqrt();
                    // Each product against the size of both directions: roundings of edges, of which the
                    // stiffest have unit length, and differences of neighbouring directions.
                    for (k, (i, j)) in PAIRS.into_iter().enumerate() {
                        let (mut size, value) = (own(i) * own(j), exact[4 * i + j]);
                        if size == 0.0 {
                            size = value.abs();
                        }
                        let what = format!("A_{i}{j} {what}");
                        assert_close(&what, &found(k..k + 1), &[value], (1e-6 * size, 0.0));
                    }
                    for (i, p) in directions.iter().enumerate() {
                        let pairs = || {
                            p.iter()
                                .zip(&grad)
                                .skip(3 * b * n)
                                .take(3 * n)
                                .map(|(&p, &g)| (f64::from(p), f64::from(g)))
                        };
                        let slope: f64 = pairs().map(|(p, g)| p * g).sum();
                        let size: f64 = pairs().map(|(p, g)| (p * g).abs()).sum();
                        let square: f64 = pairs().map(|(p, _)| p * p).sum();
                        assert_close(&what, &found(10 + i..11 + i), &[slope], (2.0 * ROUNDING * size, 0.0));
                        assert_close(&what, &found(14 + i..15 + i), &[square], (0.0, 8.0 * ROUNDING));
                    }
                    if directions.len() == 3 {
                        assert_eq!([3, 6, 8, 9, 13, 17].map(|k| all[b * VALUES + k]), [0.0; 6], "{what}");
                    }
                    let e = energy(&doubles.cloth(b));
                    let expected = [e.stretch, e.shear, e.bend, e.inertia];
                    assert_close(&what, &found(18..22), &expected, (1e-9, 16.0 * ROUNDING));
                    let external = (4.0 * ROUNDING * 0.03, 4.0 * ROUNDING);
                    assert_close(&what, &found(22..23), &[e.external], external);
                    assert_eq!(all[b * VALUES + 23], 0.0, "{what}");
                    let alone = &energies[b * VALUES..][..VALUES];
                    assert!(alone[..18].iter().all(|&v| v == 0.0), "{what}: energy alone");
                    assert_close(
                        &what,
                        &alone[18..].iter().map(|&v| v as f32).collect::<Vec<_>>(),
                        &all[b * VALUES..][18..VALUES],
                        (0.0, ROUNDING),
                    );
                }
            }
        }
    }
}

/// A direction that is NaN spoils only its own products.
#[test]
fn other_directions_do_not_see_one_that_is_nan() {
    let _turn = device();
    let kernel = Curvature::new(context()).unwrap();
    let grid = Grid { h: 9, w: 20 };
    let (model, n) = (model(grid, 1), grid.particles());
    let (x, zero) = (crumpled(&model, 0.1), vec![0.0; 3 * n]);
    let mut four = [80, 81, 82, 83].map(|seed| held(&model, 1.0, seed));
    let case = |directions: &[Vec<f32>]| {
        let case = Case { model: &model, fields: [&x, &zero, &zero, &zero], grad: &x, directions };
        case.found(&kernel, false)
    };
    let good = case(&four);
    four[1][n + 17] = f32::NAN;
    let spoilt = case(&four);
    let own: Vec<usize> =
        PAIRS.iter().enumerate().filter(|(_, (i, j))| *i == 1 || *j == 1).map(|(k, _)| k).collect();
    for k in 0..VALUES {
        if own.contains(&k) || k == 11 || k == 15 {
            assert!(spoilt[k].is_nan(), "value {k}");
        } else {
            assert_eq!(spoilt[k], good[k], "value {k}");
        }
    }
}

/// Coincident particles and flat folds: edges without length and angles of pi.
#[test]
fn degenerate_cloths_have_finite_models_and_the_energies_of_the_host() {
    let _turn = device();
    let kernel = Curvature::new(context()).unwrap();
    for (grid, batch) in cases() {
        let model = model(grid, batch);
        let (n, mut x) = (grid.particles(), State::<f32>::rest(grid, batch).x);
        for x in x.chunks_exact_mut(3 * n) {
            for j in 0..grid.w {
                // Row 2 falls onto row 0, and row 4 onto row 3.
                x[n + 2 * grid.w + j] = x[n + j];
                x[n + 4 * grid.w + j] = x[n + 3 * grid.w + j];
            }
        }
        let zero = vec![0.0; x.len()];
        let directions = [80, 81, 82].map(|seed| held(&model, 1.0, seed));
        let case =
            Case { model: &model, fields: [&x, &zero, &zero, &zero], grad: &x, directions: &directions };
        let found = case.found(&kernel, false);
        assert!(found.iter().all(|v| v.is_finite()), "{batch} x {grid}: {found:?}");
        let doubles = Doubles::new(&model, case.fields);
        for (b, found) in found.chunks_exact(VALUES).enumerate() {
            let e = energy(&doubles.cloth(b));
            let found: Vec<f32> = found[18..22].iter().map(|&v| v as f32).collect();
            let expected = [e.stretch, e.shear, e.bend, e.inertia];
            let what = format!("energies folded {b} of {batch} x {grid}");
            assert_close(&what, &found, &expected, (1e-9, 16.0 * ROUNDING));
        }
    }
}
