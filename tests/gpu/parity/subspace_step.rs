//! `subspace_step` against its formula, and whole frames of the plan.

use super::cloth::{crumpled, field, model, repelling};
use crate::common::{assert_close, cases, context, device, noise, poisoned, read, run, tensor};
use crate::solver::assert_same;
use fnopt::cloth::modes::Reactions;
use fnopt::cloth::{Grid, Mark};
use fnopt::cpu::cloth::LocalModel;
use fnopt::cpu::optim::best_start;
use fnopt::gpu::Order;
use fnopt::kernels::cloth::curvature::parts_shape;
use fnopt::kernels::cloth::gradient::parts;
use fnopt::kernels::cloth::{Objective, Room, TERMS, energy};
use fnopt::kernels::optim::{Iterate, Subspace, SubspaceStep, When, directions};

type Vector = [f64; 4];
type Matrix = [Vector; 4];

/// Returns the eigenvalues and eigenvectors (as columns) of a symmetric matrix, by Jacobi's method.
fn eigen(mut m: Matrix) -> (Vector, Matrix) {
    let mut v = [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| f64::from(u8::from(i == j))));
    for _ in 0..30 {
        for (p, q) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            if m[p][q] == 0.0 {
                continue;
            }
            let angle = 0.5 * (2.0 * m[p][q]).atan2(m[q][q] - m[p][p]);
            let (sin, cos) = angle.sin_cos();
            for row in m.iter_mut().chain(&mut v) {
                (row[p], row[q]) = (cos * row[p] - sin * row[q], sin * row[p] + cos * row[q]);
            }
            let (row_p, row_q) = (m[p], m[q]);
            m[p] = [0, 1, 2, 3].map(|k| cos * row_p[k] - sin * row_q[k]);
            m[q] = [0, 1, 2, 3].map(|k| sin * row_p[k] + cos * row_q[k]);
        }
    }
    ([0, 1, 2, 3].map(|i| m[i][i]), v)
}

/// Returns the coefficients of the step and the number of directions that are not finite.
fn coefficients(a: Matrix, b: Vector, squares: Vector) -> (Vector, f64) {
    let finite = [0, 1, 2, 3].map(|i| squares[i].is_finite() && b[i].is_finite() && a[i][i].is_finite());
    let f = [0, 1, 2, 3].map(|i| if finite[i] && squares[i] > 0.0 { squares[i].sqrt().recip() } else { 0.0 });
    let dropped = finite.iter().filter(|finite| !**finite).count() as f64;
    let scaled = |f: f64, v: f64| if f == 0.0 { 0.0 } else { f * v };
    let (l, v) = eigen([0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| scaled(f[i] * f[j], a[i][j]))));
    let most = l.iter().fold(0.0, |most: f64, l| most.max(l.abs()));
    if most == 0.0 {
        return ([0.0; 4], dropped);
    }
    let along = [0, 1, 2, 3]
        .map(|k| (0..4).map(|i| v[i][k] * scaled(f[i], b[i])).sum::<f64>() / l[k].abs().max(1e-7 * most));
    ([0, 1, 2, 3].map(|i| -f[i] * (0..4).map(|k| v[i][k] * along[k]).sum::<f64>()), dropped)
}

/// Returns a symmetric matrix with these eigenvalues for directions of unit length, and some eigenvectors.
fn with_eigenvalues(l: Vector, lengths: Vector, seed: u64) -> Matrix {
    let random = noise(16, seed);
    // The eigenvectors of a random matrix.
    let entry = |i: usize, j: usize| f64::from(random[4 * i.min(j) + i.max(j)]);
    let (_, v) = eigen([0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| entry(i, j))));
    let entry = |i: usize, j: usize| (0..4).map(|k| v[i][k] * l[k] * v[j][k]).sum::<f64>();
    [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| entry(i, j) * lengths[i] * lengths[j]))
}

/// A cloth whose model and energy are given.
struct Given {
    a: Matrix,
    b: Vector,
    squares: Vector,
    energies: [f64; 5],
    /// State of the row before.
    before: [f32; 5],
    /// Direction that is NaN.
    nan: Option<usize>,
}

const ENERGIES: [f64; 5] = [1.0, 0.5, 0.25, 0.5, -1.5];

fn given(a: Matrix, b: Vector, squares: Vector) -> Given {
    // The energy was a little higher.
    Given { a, b, squares, energies: ENERGIES, before: [0.8, 3.7, -0.03, 1.0, 2.0], nan: None }
}

/// All kinds of cloths. Directions of K = 3 have no fourth.
fn all_given(count: usize) -> Vec<Given> {
    let lengths = [1.0, 30.0, 0.01, if count == 4 { 3.0 } else { 0.0 }];
    let squares = lengths.map(|l| l * l);
    let b = [0.3 * lengths[0], -0.5 * lengths[1], 0.2 * lengths[2], 0.7 * lengths[3]];
    let of = |l: Vector, seed| with_eigenvalues(l, lengths, seed);
    let definite = || of([2.0, 0.9, 0.3, 0.1], 141);
    let mut zero = given(definite(), b, squares);
    (zero.b[1], zero.squares[1]) = (0.0, 0.0);
    (0..4).for_each(|k| (zero.a[1][k], zero.a[k][1]) = (0.0, 0.0));
    let mut nan = given(definite(), b, squares);
    (nan.b[0], nan.squares[0], nan.nan) = (f64::NAN, f64::NAN, Some(0));
    (0..4).for_each(|k| (nan.a[0][k], nan.a[k][0]) = (f64::NAN, f64::NAN));
    let mut infinite = given(definite(), b, squares);
    infinite.a[1][1] = f64::INFINITY;
    let rejected = Given { before: [0.7, 3.7, -0.03, 1.0, 2.0], ..given(definite(), b, squares) };
    let far = Given { before: [0.7, 3.7, -1.0, 1.0, 2.0], ..given(definite(), b, squares) };
    let undefined = Given { energies: [f64::NAN; 5], ..given(definite(), b, squares) };
    // As good as the energy before, up to the rounding of its terms.
    let as_good = Given { before: [0.749_999, 3.7, 0.0, 0.0, 0.0], ..given(definite(), b, squares) };
    vec![
        given(definite(), b, squares),
        given(of([1.0, -0.5, 0.25, -0.1], 142), b, squares),
        given([[0.0; 4]; 4], b, squares),
        given([[0.0; 4]; 4], [0.0; 4], [0.0; 4]),
        zero,
        nan,
        infinite,
        rejected,
        far,
        undefined,
        as_good,
    ]
}

/// Returns the upper triangle, slopes, squares and energies, spread over parts.
fn spread(given: &Given, count: usize, seed: u64) -> Vec<f32> {
    let mut values = Vec::new();
    (0..4).for_each(|i| values.extend_from_slice(&given.a[i][i..]));
    values.extend(given.b.iter().chain(&given.squares).chain(&given.energies).chain(&[0.0]));
    let shares: Vec<f64> = noise(count, seed).iter().map(|v| 1.5 + f64::from(*v)).collect();
    let all: f64 = shares.iter().sum();
    shares.iter().flat_map(|share| values.iter().map(move |v| (v * share / all) as f32)).collect()
}

#[test]
fn steps_match() {
    let _turn = device();
    let kernel = SubspaceStep::new(context()).unwrap();
    for (grid, count) in
        [(9, 8), (100, 100)].into_iter().flat_map(|(h, w)| [3, 4].map(|k| (Grid { h, w }, k)))
    {
        let (given, n) = (all_given(count), grid.particles());
        let batch = given.len();
        let marks = vec![Mark::default(); batch * n];
        let before = noise(3 * batch * n, 151);
        let fields: Vec<Vec<f32>> = (0..count)
            .map(|k| {
                let mut field = noise(3 * batch * n, 152 + k as u64);
                for (given, field) in given.iter().zip(field.chunks_exact_mut(3 * n)) {
                    if given.nan == Some(k) {
                        field[5] = f32::NAN;
                    }
                }
                field
            })
            .collect();
        let values: Vec<f32> = given.iter().flat_map(|given| spread(given, parts(grid), 161)).collect();
        let parts = tensor("parts", &parts_shape(batch, grid), &values);
        // Half of the energy as a repulsion.
        let with_repulsion = energy::parts_shape(batch, grid);
        let mut repulsions = vec![f32::NAN; with_repulsion.iter().product()];
        let groups = with_repulsion[1];
        repulsions.iter_mut().skip(TERMS - 1).step_by(TERMS).for_each(|v| *v = 0.5 / groups as f32);
        let repulsions = tensor("energies", &with_repulsion, &repulsions);
        for (when, repels) in [
            (When::Start, false),
            (When::Iteration(2), false),
            (When::Iteration(2), true),
            (When::End(2), false),
        ] {
            let iterate = Iterate::new(context(), batch, &marks).unwrap();
            iterate.a.write(context(), &before);
            let all = poisoned("directions", &directions::shape(count, batch, grid));
            let one = |k: usize| directions::one(&all, k, batch, grid);
            (0..count).for_each(|k| one(k).write(context(), &fields[k]));
            let state = poisoned("state", &[4, batch, 5]);
            let old: Vec<[f32; 5]> = given
                .iter()
                .map(|given| {
                    let [energy, size, slope, shortened, dropped] = given.before;
                    let more = if repels { 0.5 } else { 0.0 };
                    [energy + more, size + more, slope, shortened, dropped]
                })
                .collect();
            state.write_at(context(), 2 * 5 * batch, old.as_flattened());
            let repulsion = repels.then_some(&repulsions);
            run(|schedule| {
                kernel.push(schedule, grid, when, (&parts, repulsion), (&iterate, &all, &state));
            });
            let [rows, found, last] = [&state, &iterate.a, &one(directions::LAST_STEP)].map(read);
            let row = match when {
                When::Start => 0,
                When::Iteration(at) | When::End(at) => at + 1,
            };
            for (b, given) in given.iter().enumerate() {
                let what = format!("{b} {when:?} {repels} {count} {grid}");
                let at = 3 * b * n..3 * (b + 1) * n;
                let terms: Vec<f64> = given.energies.into_iter().chain(repels.then_some(0.5)).collect();
                let (energy, size) = (terms.iter().sum::<f64>(), terms.iter().map(|v| v.abs()).sum::<f64>());
                let old = old[b].map(f64::from);
                let first = when == When::Start;
                let accepted = first || energy <= old[0] + 1e-6 * size.max(old[1]);
                let (mut c, dropped) = coefficients(given.a, given.b, given.squares);
                if first {
                    // The last frame's accelerations, then what extrapolates them.
                    let order = [directions::LAST_STEP, directions::ROTATED];
                    let mut model = LocalModel::default();
                    for (i, &p) in order.iter().enumerate() {
                        model.slopes[i] = given.b[p];
                        order.iter().enumerate().for_each(|(j, &q)| model.curvature[i][j] = given.a[p][q]);
                    }
                    let [last, rest] = best_start(&model);
                    c = [0.0, rest, last, 0.0];
                }
                // Where the parabola is least.
                let least = -0.5 * old[2] / (energy - old[0] - old[2]);
                let fraction = if least.is_finite() { least.clamp(0.1, 0.5) } else { 0.1 };
                let slope: f64 = (0..4).filter(|&i| c[i] != 0.0).map(|i| c[i] * given.b[i]).sum();
                let step = |k: usize| -> f64 {
                    let last = f64::from(fields[2][k]);
                    match (accepted, when) {
                        (true, When::End(_)) => 0.0,
                        (true, _) => {
                            let of = |i: usize| c[i] * f64::from(fields[i][k]);
                            (0..count).filter(|&i| c[i] != 0.0).map(of).sum()
                        }
                        (false, When::End(_)) => -last,
                        (false, _) => (fraction - 1.0) * last,
                    }
                };
                let steps: Vec<f64> = at.clone().map(step).collect();
                let moved: Vec<f64> =
                    at.clone().zip(&steps).map(|(k, step)| f64::from(before[k]) + step).collect();
                // Eigenvalues differ by a factor of twenty, so that their roundings do in the coefficients.
                let most = steps.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
                assert_close(&format!("a {what}"), &found[at.clone()], &moved, (1e-5 * most, 0.0));
                if !matches!(when, When::End(_)) {
                    let kept: Vec<f64> = match accepted {
                        true => steps,
                        false => at.clone().map(|k| fraction * f64::from(fields[2][k])).collect(),
                    };
                    assert_close(&format!("step {what}"), &last[at], &kept, (1e-5 * most, 0.0));
                }
                let [shortened, drops] = if first { [0.0; 2] } else { [old[3], old[4]] };
                let expected = match (accepted, when) {
                    (true, When::Start) => [energy, size, slope, 0.0, 0.0],
                    (true, When::Iteration(_)) => [energy, size, slope, shortened, drops + dropped],
                    (true, When::End(_)) => [energy, size, 0.0, shortened, drops],
                    (false, When::End(_)) => [old[0], old[1], 0.0, shortened + 1.0, drops],
                    (false, _) => [old[0], old[1], fraction * old[2], shortened + 1.0, drops],
                };
                let found = &rows[5 * (row * batch + b)..][..5];
                if energy.is_nan() && accepted {
                    assert!(found[0].is_nan() && found[1].is_nan(), "state {what}: {found:?}");
                    assert_close(&format!("counts {what}"), &found[2..], &expected[2..], (1e-5, 1e-5));
                } else {
                    assert_close(&format!("state {what}"), found, &expected, (2e-6, 1e-5));
                }
            }
        }
    }
}

/// Two directions that are the same leave the length of their difference open. The step stays as short as it
/// can be, up to roundings.
#[test]
fn directions_that_are_the_same_share_the_step() {
    let _turn = device();
    let kernel = SubspaceStep::new(context()).unwrap();
    let grid = Grid { h: 8, w: 8 };
    let n = grid.particles();
    let given = given([[1.0; 4]; 4], [-1.0; 4], [1.0; 4]);
    let parts = tensor("parts", &parts_shape(1, grid), &spread(&given, parts(grid), 161));
    let iterate = Iterate::new(context(), 1, &vec![Mark::default(); n]).unwrap();
    let all = tensor("directions", &directions::shape(4, 1, grid), &vec![1.0; 4 * 3 * n]);
    let state = tensor("state", &[2, 1, 5], &[10.0; 10]);
    run(|schedule| {
        kernel.push(schedule, grid, When::Iteration(0), (&parts, None), (&iterate, &all, &state));
    });
    // b . c + c . A . c / 2 = -s + s^2 / 2 for a sum s of the coefficients.
    assert_close("the same directions", &read(&iterate.a), &vec![1.0; 3 * n], (1e-3, 0.0));
}

/// Whole frames lower the energy in every iteration, in nine dispatches besides the gradient, and one more with
/// repulsion. They have the same bits in whatever order the device runs invocations.
#[test]
fn frames_lower_the_energy() {
    let _turn = device();
    const ITERATIONS: usize = 6;
    for ((grid, batch), repels) in cases().flat_map(|case| [(case, false), (case, true)]) {
        // Full sheets: of a small one with holes less of the energy can be taken.
        let mut calm = model(grid, batch);
        calm.cloths.iter_mut().for_each(|cloth| cloth.mask = None);
        let model = if repels { repelling(&calm) } else { calm };
        let n = grid.particles();
        let sums = poisoned("sums", &[3 * batch, parts(grid), 2]);
        let count = if repels { 4 } else { 3 };
        let marks = model.marks();
        let held = |k: usize| !marks[k / (3 * n) * n + k % n].is_free();
        let mut learned = field(&model, 0.1, 77);
        (0..learned.len()).filter(|&k| held(k)).for_each(|k| learned[k] = 0.0);
        let room = Room {
            handles: model.handles(),
            repulsion: repels,
            self_contact: false,
            bodies: 0,
            fields: 0,
            rest_angles: false,
            hidden: false,
        };
        let frame = |order: Order| {
            let context = context().with_order(order);
            let sizes = (count, Reactions::most(&model));
            let plan = Subspace::new(&context, sizes, (ITERATIONS, !repels), (grid, batch)).unwrap();
            plan.set_cloths(&context, &model);
            assert_eq!(plan.learned_step().is_some(), repels);
            plan.learned_step().inspect(|step| step.write(&context, &learned));
            let objective = Objective::new(&context, grid, batch, room).unwrap();
            objective.set_cloths(&model);
            let Iterate { a, base, external, .. } = &objective.iterate;
            a.write(&context, &field(&model, 0.05, 78));
            base.write(&context, &field(&model, 0.05, 79));
            external.write(&context, &field(&model, 0.1, 74));
            objective.x.write(&context, &crumpled(&model, 0.1));
            run(|schedule| {
                plan.begin(schedule, &objective);
                objective.evaluate(schedule, &sums);
                plan.start(schedule, &objective);
                for iteration in 0..ITERATIONS {
                    objective.evaluate(schedule, &sums);
                    let before = schedule.dispatches();
                    plan.push(schedule, &objective, iteration);
                    assert_eq!(schedule.dispatches(), before + 7 + usize::from(repels));
                }
                plan.end(schedule, &objective);
            });
            [plan.state(), a].map(read)
        };
        let [state, a] = frame(Order::Natural);
        let others = [Order::Reversed, Order::Scattered].into_iter().filter(|_| repels && batch > 1);
        for order in others {
            let [other, moved] = frame(order);
            assert_same(&format!("state {order:?} {batch} x {grid}"), &other, &state);
            assert_same(&format!("a {order:?} {batch} x {grid}"), &moved, &a);
        }
        for b in 0..batch {
            let of = |row: usize, k: usize| state[5 * (row * batch + b) + k];
            let all: Vec<f32> = (0..ITERATIONS + 2).map(|row| of(row, 0)).collect();
            assert!(
                all.windows(2).all(|e| e[1] <= e[0] + 2e-6 * of(0, 1)),
                "{b} of {batch} x {grid}: {all:?}"
            );
            assert!(all[ITERATIONS + 1] < 0.8 * all[0], "{b} of {batch} x {grid}: {all:?}");
            assert_eq!(of(ITERATIONS + 1, 4), 0.0, "directions that are not finite");
        }
        assert!((0..a.len()).all(|k| a[k].is_finite() && (!held(k) || a[k] == 0.0)), "handles move");
    }
}
