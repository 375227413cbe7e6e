//! Directions, the local model along them, and the best step among them.

use crate::marks_of;
use crate::noise::noise;
use fnopt::cloth::modes::{SheetConstants, TENSION};
use fnopt::cloth::{Cloth, Control, Grid, Mark, Material, Model, Repulsion, State, Weave};
use fnopt::cpu::cloth::{AXES, CurvatureRows, Elements, LocalModel, SheetAxes, Trial, masses};
use fnopt::cpu::optim::{Cosines, InverseHessian, RestHessian, SheetHessian, SheetSteps, best_step};
use fnopt::cpu::{Objective, Real, Solver};
use fnopt::network::Weights;
use fnopt::scene::Scene;
use fnopt::settings::{ARCHING, HANDLE_SHARE};
use fnopt::sim::Optimizer;
use std::sync::Arc;

/// The smallest grid, odd sides, a tall one and one that several tasks share.
const GRIDS: [Grid; 4] =
    [Grid { h: 8, w: 8 }, Grid { h: 31, w: 33 }, Grid { h: 48, w: 32 }, Grid { h: 130, w: 131 }];

/// A frame of one crumpled cloth, with directions that are 0 at its handles.
struct Frame {
    model: Model,
    state: State<f64>,
    control: Control<f64>,
    a: Vec<f64>,
    directions: Vec<f64>,
}

impl Frame {
    fn new(grid: Grid, crumpled: f64, repulsion: Option<Repulsion>) -> Self {
        let n = grid.particles();
        let cloth = Cloth {
            material: Material { stretch: 700.0, shear: 8.0, bend: 3.0, ..Material::PAPER },
            gravity: [0.0, 0.01, -0.1],
            handles: vec![0, n - 1, n / 2],
            repulsion,
            ..Cloth::default()
        };
        let mut state = State::<f64>::rest(grid, 1);
        state.x.iter_mut().zip(noise(3 * n, 1)).for_each(|(x, d)| *x += crumpled * d);
        state.v = noise(3 * n, 2).iter().map(|v| 0.02 * v).collect();
        let handles = cloth.handles.iter().map(|p| [0, 1, 2].map(|c| state.x[c * n + p] + 0.1)).collect();
        let mut directions = noise(12 * n, 3);
        for field in directions.chunks_exact_mut(n) {
            cloth.handles.iter().for_each(|&p| field[p] = 0.0);
        }
        let a = noise(3 * n, 4).iter().map(|a| 0.03 * a).collect();
        let control = Control { handles, ..Control::default() };
        Self { model: Model { grid, cloths: vec![cloth] }, state, control, a, directions }
    }

    /// Returns the gradient at the accelerations moved by `length` along direction `k`.
    fn gradient(&self, k: usize, length: f64) -> Vec<f64> {
        let along = &self.directions[k * self.a.len()..][..self.a.len()];
        let a: Vec<f64> = self.a.iter().zip(along).map(|(a, d)| a + length * d).collect();
        let mut objective = Objective::new(&self.model);
        objective.begin_frame(&self.state, &self.control);
        objective.set_accelerations(&a);
        objective.evaluate(&self.state, &self.control);
        objective.grad().to_vec()
    }

    /// Returns the local model along the first `count` directions, and the energy terms on their own.
    fn local_model<T: Real>(&self, count: usize) -> (LocalModel, [f64; 6]) {
        let narrow = |values: &[f64]| values.iter().map(|&v| T::of(v)).collect::<Vec<T>>();
        let (state, control) = (self.state.cast::<T>(), self.control.cast::<T>());
        let mut objective = Objective::<T>::new(&self.model);
        objective.begin_frame(&state, &control);
        objective.set_accelerations(&narrow(&self.a));
        objective.evaluate(&state, &control);
        let mut rows = CurvatureRows::new(self.model.grid);
        let directions = narrow(&self.directions[..count * self.a.len()]);
        // Working memory that has seen other directions gives the same.
        objective.local_model(&state, 0, (&narrow(&self.directions), &mut rows));
        let model = objective.local_model(&state, 0, (&directions, &mut rows));
        let terms = objective.energy(&state, 0);
        (model, [terms.stretch, terms.shear, terms.bend, terms.inertia, terms.external, terms.repulsion])
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[track_caller]
fn assert_near(what: &str, found: f64, expected: f64, scale: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance * scale, "{what}: {found:e}, not {expected:e}");
}

#[test]
fn curvature_is_the_change_of_the_gradient() {
    // So strong that the repulsion makes up much of the curvature.
    let strong = Some(Repulsion { strength: 500.0, distance: 0.9 });
    for (grid, crumpled, repulsion) in GRIDS.into_iter().flat_map(|g| [(g, 0.2, None), (g, 0.5, strong)]) {
        let frame = Frame::new(grid, crumpled, repulsion);
        let len = frame.a.len();
        let (model, terms) = frame.local_model::<f64>(4);
        let grad = frame.gradient(0, 0.0);
        let along = |k: usize| &frame.directions[k * len..][..len];
        for i in 0..4 {
            let what = format!("{grid}, direction {i}");
            assert_near(&what, model.slopes[i], dot(along(i), &grad), dot(&grad, &grad).sqrt() * 30.0, 1e-13);
            assert_near(&what, model.squares[i], dot(along(i), along(i)), model.squares[i], 1e-12);
            // So short that no pair enters or leaves the range, where the gradient jumps.
            let step = if repulsion.is_some() { 1e-7 } else { 1e-5 };
            let [ahead, behind] = [step, -step].map(|length| frame.gradient(i, length));
            for j in 0..4 {
                let change = (dot(along(j), &ahead) - dot(along(j), &behind)) / (2.0 * step);
                let scale = (model.curvature[i][i] * model.curvature[j][j]).abs().sqrt();
                assert_near(&format!("{what} and {j}"), model.curvature[i][j], change, scale, 1e-6);
            }
        }
        if repulsion.is_some() {
            let mut without = Frame::new(grid, crumpled, None);
            without.state = frame.state.clone();
            let (without, _) = without.local_model::<f64>(4);
            let share =
                (model.curvature[0][0] - without.curvature[0][0]).abs() / without.curvature[0][0].abs();
            assert!(share > 0.01, "the repulsion adds {share:e} on {grid}");
        }
        let found = model.energy;
        let found = [found.stretch, found.shear, found.bend, found.inertia, found.external, found.repulsion];
        for (found, expected) in found.into_iter().zip(terms) {
            assert_near(&format!("energy on {grid}"), found, expected, expected.abs(), 1e-12);
        }
    }
}

#[test]
fn fewer_directions_give_the_same_model() {
    for grid in GRIDS {
        let frame = Frame::new(grid, 0.2, None);
        let (all, _) = frame.local_model::<f64>(4);
        for count in 0..4 {
            let (some, _) = frame.local_model::<f64>(count);
            for i in 0..count {
                assert_near("slope", some.slopes[i], all.slopes[i], all.slopes[i].abs(), 1e-12);
                for j in 0..count {
                    let expected = all.curvature[i][j];
                    assert_near("curvature", some.curvature[i][j], expected, expected.abs(), 1e-9);
                }
            }
            assert!(some.curvature[count] == [0.0; 4] && some.squares[count] == 0.0);
        }
    }
}

#[test]
fn flat_and_folded_sheets_have_finite_curvature() {
    // Straight bends have no normal, right angles no excess, and edges folded back on themselves both.
    let mut frame = Frame::new(Grid { h: 9, w: 11 }, 0.0, None);
    frame.state.v.fill(0.0);
    frame.a.fill(0.0);
    frame.control.handles.clear();
    frame.model.cloths[0].handles.clear();
    let n = frame.model.grid.particles();
    let (flat, _) = frame.local_model::<f64>(4);
    // At rest the Hessian is that of small waves: a shift of the whole sheet costs its inertia alone.
    for component in frame.directions[..3 * n].chunks_exact_mut(n) {
        component.fill(1.0);
    }
    let (shifted, _) = frame.local_model::<f64>(1);
    let mass: f64 = (0..n).map(|p| frame.model.grid.mass(p / 11, p % 11)).sum::<f64>() / n as f64;
    assert_near("inertia", shifted.curvature[0][0], 3.0 * mass, 3.0 * mass, 1e-12);
    for p in 0..n {
        let j = p % 11;
        frame.state.x[p] = if j > 5 { 10.0 - j as f64 } else { j as f64 };
    }
    let (folded, _) = frame.local_model::<f64>(4);
    for p in 0..n {
        frame.state.x[p] = 0.0;
    }
    let (pointlike, _) = frame.local_model::<f32>(4);
    for model in [flat, folded, pointlike] {
        assert!(model.curvature.as_flattened().iter().all(|v| v.is_finite()), "{model:?}");
    }
}

#[test]
fn best_steps_solve_the_model() {
    let mut model = LocalModel::default();
    // Of very different lengths, which must not matter.
    let lengths = [1e-6, 1.0, 300.0];
    let shape = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
    let slopes = [0.3, -1.0, 0.7];
    for i in 0..3 {
        model.squares[i] = lengths[i] * lengths[i];
        model.slopes[i] = slopes[i] * lengths[i];
        for j in 0..3 {
            model.curvature[i][j] = shape[i][j] * lengths[i] * lengths[j];
        }
    }
    let residual = |model: &LocalModel, factors: [f64; 4]| -> Vec<f64> {
        let row =
            |i: usize| model.slopes[i] + (0..3).map(|j| model.curvature[i][j] * factors[j]).sum::<f64>();
        (0..3).map(|i| row(i) / lengths[i]).collect()
    };
    let best = best_step(&model, 3);
    assert!(residual(&model, best.factors).iter().all(|r| r.abs() < 1e-12) && best.dropped == 0, "{best:?}");

    // A direction twice: a singular model has many solutions, all finite.
    let mut singular = model;
    singular.squares[2] = singular.squares[1];
    singular.slopes[2] = singular.slopes[1];
    for k in 0..3 {
        singular.curvature[2][k] = singular.curvature[1][k];
    }
    for k in 0..3 {
        singular.curvature[k][2] = singular.curvature[k][1];
    }
    let best = best_step(&singular, 3);
    assert!(best.factors.iter().all(|f| f.is_finite()));
    let small =
        |factors: [f64; 4], upto: usize| residual(&singular, factors)[..upto].iter().all(|r| r.abs() < 1e-5);
    assert!(small(best.factors, 2), "{best:?}");

    // Where the energy curves down, the step still descends.
    let mut indefinite = model;
    indefinite.curvature[1][1] *= -1.0;
    let best = best_step(&indefinite, 3);
    let slope: f64 = (0..3).map(|k| best.factors[k] * indefinite.slopes[k]).sum();
    assert!(slope < 0.0, "{slope}");

    // Directions that are zero or not finite take no part.
    let alone = best_step(&model, 2);
    let mut broken = model;
    broken.squares[2] = f64::NAN;
    broken.slopes[2] = f64::NAN;
    for k in 0..3 {
        (broken.curvature[k][2], broken.curvature[2][k]) = (f64::NAN, f64::NAN);
    }
    let best = best_step(&broken, 3);
    assert_eq!((best.factors, best.dropped), (alone.factors, 1));
    assert_eq!(best_step(&LocalModel::default(), 4).factors, [0.0; 4]);
}

/// Returns the axes of a sheet of this material and damping, shape [16, H, W].
fn axes_of(
    (grid, marks): (Grid, &[Mark]),
    (material, damping): (Material, f64),
    x: &[f64],
    shift: &[f64],
) -> Vec<f64> {
    let n = grid.particles();
    let (zeros, masses) = (vec![0.0; 3 * n], masses(grid, marks));
    let elements = Elements::of(grid, marks);
    let trial = Trial {
        grid,
        material,
        damping,
        x,
        shift,
        a: &zeros,
        f: &zeros,
        marks,
        masses: &masses,
        elements: elements.as_ref(),
        near: None,
    };
    let mut axes = vec![f64::NAN; AXES * n];
    SheetAxes::new(grid, marks).compute(&trial, &mut axes);
    axes
}

#[test]
fn axes_are_orthogonal_and_turn_with_the_sheet() {
    let grid = Grid { h: 9, w: 12 };
    let n = grid.particles();
    let mut x = State::<f64>::rest(grid, 1).x;
    x.iter_mut().zip(noise(3 * n, 5)).for_each(|(x, d)| *x += 0.3 * d);
    let shift: Vec<f64> = noise(3 * n, 6).iter().map(|v| 0.1 * v).collect();
    // A turn by 0.7 about the axis (2, 1, 2) / 3.
    let (c, s, u) = (0.7f64.cos(), 0.7f64.sin(), [2.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0]);
    let turned = |field: &[f64]| {
        let mut out = vec![0.0; 3 * n];
        for p in 0..n {
            let v = [field[p], field[n + p], field[2 * n + p]];
            let along = (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) * (1.0 - c);
            let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            (0..3).for_each(|k| out[k * n + p] = c * v[k] + s * cross[k] + along * u[k]);
        }
        out
    };
    let marks = marks_of(grid, &[]);
    let axes = |x: &[f64], shift: &[f64]| axes_of((grid, &marks), (Material::PAPER, 0.0), x, shift);
    let (own, other) = (axes(&x, &shift), axes(&turned(&x), &turned(&shift)));
    // Three axes, then the factor, then two edges.
    for first in [0, 3, 6, 10, 13] {
        let of = |axes: &[f64]| axes[first * n..][..3 * n].to_vec();
        turned(&of(&own))
            .iter()
            .zip(&of(&other))
            .for_each(|(a, b)| assert!((a - b).abs() < 1e-12, "{a} {b}"));
    }
    assert_eq!(own[9 * n..10 * n], other[9 * n..10 * n]);
    for p in 0..n {
        let at = |first: usize| [0, 1, 2].map(|k| own[(first + k) * n + p]);
        let (one, two, normal) = (at(0), at(3), at(6));
        let of = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let lengths = [of(one, one) - 1.0, of(two, two) - 1.0];
        assert!(of(normal, normal) < 1.0 + 1e-12 && lengths.iter().all(|v| v.abs() < 1e-12), "{lengths:?}");
        let products = [of(one, two), of(one, normal), of(two, normal)];
        assert!(products.iter().all(|v| v.abs() < 1e-12), "{products:?}");
    }
    // The sheet at rest has i along y and j along x; one without extent has axes all the same.
    let flat = axes(&State::<f64>::rest(grid, 1).x, &vec![0.0; 3 * n]);
    assert!((flat[n] - 1.0).abs() < 1e-12 && (flat[3 * n] - 1.0).abs() < 1e-12);
    assert!(axes(&vec![2.0; 3 * n], &vec![0.0; 3 * n])[..n].iter().all(|&v| v == 1.0));
}

#[test]
fn axes_are_shorter_next_to_handles_and_across_an_arch() {
    // Bent along the height by the same angle at every particle, with one handle.
    let grid = Grid { h: 9, w: 12 };
    let (n, w) = (grid.particles(), grid.w);
    let material = Material { weave: Weave { stretch: [1.0, 0.5], ..Weave::EVEN }, ..Material::PAPER };
    let mut x = State::<f64>::rest(grid, 1).x;
    let angle = 0.2_f64;
    for p in 0..n {
        // Ends of edges of length 1.
        let (mut y, mut z) = (0.0, 0.0);
        for k in 0..p / w {
            y += (angle * k as f64).cos();
            z += (angle * k as f64).sin();
        }
        (x[n + p], x[2 * n + p]) = (y, z);
    }
    let handle = 4 * w + 5;
    let marks = marks_of(grid, &[handle]);
    let axes = axes_of((grid, &marks), (material, 0.5), &x, &vec![0.0; 3 * n]);
    let length =
        |p: usize, first: usize| (0..3).map(|c| axes[(first + c) * n + p].powi(2)).sum::<f64>().sqrt();
    // k is 1000 along the height. The first row has no edge before it, and is no arch.
    let change = 2.0 * (angle / 2.0).sin();
    let arch = 1.0 / (1.0 + ARCHING * 1000.0 * change * change).sqrt();
    for (p, distance, arch) in [
        (0, None, 1.0),
        (4 * w + 2, None, arch),
        (handle + 1, Some(1.0), arch),
        (handle + w + 1, Some(2f64.sqrt()), arch),
    ] {
        let near = distance.map_or(1.0, |d| 1.0 - HANDLE_SHARE / (1.0 + d));
        for (first, expected) in [(0, 1.0), (3, 1.0), (6, arch)] {
            assert_near(&format!("axis {first} of {p}"), length(p, first), near * expected, 1.0, 1e-12);
        }
        assert_near("factor", axes[9 * n + p], near, 1.0, 1e-12);
    }
    // Edges are as stiff as their energy k (|e| - 1)^2 and the damping of half a frame make them.
    let stiffness = [2.0 * 1.5 * 1000.0 / (8.0 * 12.0), 2.0 * 1.5 * 500.0 / (9.0 * 11.0)];
    for (first, stiffness, last) in [(10, stiffness[0], 8 * w), (13, stiffness[1], w - 1)] {
        assert_near("edge", length(3 * w + 4, first), f64::sqrt(stiffness), 1.0, 1e-12);
        assert_eq!(length(last, first), 0.0, "past the border");
    }
}

/// Returns the product of the inverse Hessian in the sheet with a field.
fn inverse_in_sheet(grid: Grid, cloth: &Cloth, axes: &[f64], field: &[f64]) -> Vec<f64> {
    let mut hessian = SheetHessian::new(&Arc::new(Cosines::new(grid)), cloth, &SheetConstants::FITTED);
    let mut product = field.to_vec();
    hessian.apply_in_sheet(axes, &mut product);
    product
}

/// Returns the steps of a sheet by these forces: in space, in the sheet.
fn steps(grid: Grid, cloth: &Cloth, axes: &[f64], forces: &[f64]) -> [Vec<f64>; 2] {
    let mut steps = SheetSteps::new(&Arc::new(Cosines::new(grid)), cloth, &SheetConstants::FITTED);
    let mut both = [forces.to_vec(), forces.to_vec()];
    steps.in_space(axes, &mut both[0]);
    steps.in_sheet(axes, &mut both[1]);
    both
}

#[test]
fn inverses_of_a_sheet_are_symmetric_and_positive() {
    for grid in [Grid { h: 8, w: 8 }, Grid { h: 13, w: 10 }] {
        let n = grid.particles();
        let cloth = Cloth { handles: vec![3, n - 2], ..Cloth::default() };
        let mut x = State::<f64>::rest(grid, 1).x;
        x.iter_mut().zip(noise(3 * n, 7)).for_each(|(x, d)| *x += 0.3 * d);
        let marks = marks_of(grid, &cloth.handles);
        let axes = axes_of((grid, &marks), (cloth.material, 0.0), &x, &vec![0.0; 3 * n]);
        let (u, w) = (noise(3 * n, 8), noise(3 * n, 9));
        let both = |field: &[f64]| {
            let [in_space, _] = steps(grid, &cloth, &axes, field);
            [in_space, inverse_in_sheet(grid, &cloth, &axes, field)]
        };
        for (of_u, of_w) in both(&u).iter().zip(&both(&w)) {
            let (one, two) = (dot(of_u, &w), dot(&u, of_w));
            assert_near("symmetry", one, two, one.abs(), 1e-10);
            assert!(dot(of_u, &u) > 0.0 && cloth.handles.iter().all(|&p| of_u[p] == 0.0));
        }
    }
}

#[test]
fn steps_are_known_for_the_waves_of_a_flat_sheet() {
    // In space the step is that of the inverse at rest; in the sheet it knows that the sheet is soft across its surface: it
    // takes the normal wave further. Nothing couples the two in a flat sheet.
    let grid = Grid { h: 16, w: 12 };
    let n = grid.particles();
    let cloth = Cloth::default();
    let at_rest = State::<f64>::rest(grid, 1).x;
    let axes = axes_of((grid, &marks_of(grid, &[])), (cloth.material, 0.0), &at_rest, &vec![0.0; 3 * n]);
    let wave = |k: usize, i: usize| (std::f64::consts::PI * (k * (2 * i + 1)) as f64 / 32.0).cos();
    let field = |component: usize| {
        let mut field = vec![0.0; 3 * n];
        (0..n).for_each(|p| field[component * n + p] = wave(3, p / 12));
        field
    };
    let mu = 2.0 - 2.0 * (std::f64::consts::PI * 3.0 / 16.0).cos();
    let (count, stretch, bend) = (n as f64, 1000.0, 0.5);
    let along = 2.0 * stretch / (15.0 * 12.0) * mu;
    let (share, constants) = (TENSION, SheetConstants::FITTED);
    // A wave along the height, with displacements along it (y) and across it (x, z).
    let eigenvalues = [
        (1, constants.tangential_inertia / count + along),
        (
            0,
            constants.tangential_inertia / count
                + share * 2.0 * stretch / (16.0 * 11.0) * mu
                + (8.0 * 8.0 * mu + 2.0 * bend * mu * mu) / count,
        ),
        (
            2,
            (constants.normal_inertia + 2.0 * share * stretch) / count
                + share * along
                + 2.0 * constants.normal_bend * bend * mu * mu / count,
        ),
    ];
    let in_space = 1.0 / count + along + (4.0 * 8.0 * mu + 2.0 * bend * mu * mu) / count;
    for (component, eigenvalue) in eigenvalues {
        let field = field(component);
        let [space, sheet] = steps(grid, &cloth, &axes, &field);
        let inverse = inverse_in_sheet(grid, &cloth, &axes, &field);
        for (out, eigenvalue) in [(space, in_space), (sheet, eigenvalue), (inverse, eigenvalue)] {
            for (out, field) in out.iter().zip(&field) {
                assert_near(&format!("component {component}"), out * eigenvalue, *field, 1.0, 1e-10);
            }
        }
    }
    let mut alike = field(2);
    RestHessian::<f64>::new(grid, &cloth).apply(&mut alike);
    let [_, normal] = steps(grid, &cloth, &axes, &field(2));
    assert!(dot(&normal, &normal) > 50.0 * dot(&alike, &alike));
}

/// Why the step in a sheet is taken across it first and then along it: what it does to the stretch of an arch.
#[test]
fn a_step_across_an_arch_hardly_stretches_it() {
    let grid = Grid { h: 24, w: 16 };
    let (n, w) = (grid.particles(), grid.w);
    let cloth = Cloth { handles: vec![0, w - 1], ..Cloth::default() };
    // A roll of one turn.
    let radius = 23.0 / std::f64::consts::TAU;
    let mut x = State::<f64>::rest(grid, 1).x;
    for p in 0..n {
        let turn = (p / w) as f64 / radius;
        (x[n + p], x[2 * n + p]) = (radius * turn.sin(), radius * turn.cos());
    }
    let marks = marks_of(grid, &cloth.handles);
    let axes = axes_of((grid, &marks), (cloth.material, 0.0), &x, &vec![0.0; 3 * n]);
    // A push from one side, and what the stretch makes of a step.
    let mut forces = vec![0.0; 3 * n];
    forces[2 * n..].fill(1.0);
    let stretched = |step: &[f64]| {
        let edge = |first: usize, p: usize, q: usize| {
            (0..3)
                .map(|c| axes[(first + c) * n + p] * (step[c * n + q] - step[c * n + p]))
                .sum::<f64>()
                .powi(2)
        };
        let down: f64 = (0..n - w).map(|p| edge(10, p, p + w)).sum();
        down + (0..n).filter(|p| p % w + 1 < w).map(|p| edge(13, p, p + 1)).sum::<f64>()
    };
    let [_, step] = steps(grid, &cloth, &axes, &forces);
    // The part across alone, with the handles still.
    let across: Vec<f64> = (0..3 * n)
        .map(|k| {
            let (c, p) = (k / n, k % n);
            let normal = [0, 1, 2].map(|c| axes[(6 + c) * n + p]);
            let length: f64 = normal.iter().map(|v| v * v).sum();
            let along: f64 = (0..3).map(|c| normal[c] * step[c * n + p]).sum();
            normal[c] * along / length
        })
        .collect();
    let (both, alone) = (stretched(&step), stretched(&across));
    assert!(both < 0.1 * alone, "{both} of {alone}");
    assert!(cloth.handles.iter().all(|&p| (0..3).all(|c| step[c * n + p] == 0.0)), "handles hold");
}

/// Returns the optimizers that step in a subspace.
fn optimizers() -> [Optimizer; 2] {
    [Optimizer::spectral(), Optimizer::learned(Weights::shipped())]
}

#[test]
fn the_energy_never_rises_from_accepted_step_to_step() {
    // Crumpled so much that the first models are far off, stiff and soft, with and without handles.
    for (grid, stretch) in [
        (Grid { h: 8, w: 8 }, 1e6),
        (Grid { h: 8, w: 40 }, 10.0),
        (Grid { h: 24, w: 16 }, 1e4),
        (Grid { h: 8, w: 256 }, 200.0),
        (Grid { h: 4096, w: 8 }, 200.0),
    ] {
        let near = Some(Repulsion { strength: 1.0, distance: 0.9 });
        let sheets = [(2.0, None), (0.3, None), (2.0, near)];
        // The longest ones take their time.
        let (sheets, counts) =
            if grid.particles() < 1000 { (&sheets[..], 1..=12) } else { (&sheets[..1], 2..=3) };
        for (optimizer, (crumpled, repulsion)) in
            optimizers().into_iter().flat_map(|o| sheets.iter().map(move |&sheet| (o.clone(), sheet)))
        {
            let mut frame = Frame::new(grid, crumpled, repulsion);
            frame.model.cloths[0].material.stretch = stretch;
            let mut last = f64::INFINITY;
            for iterations in counts.clone() {
                let mut solver = Solver::<f64>::new(&frame.model, &optimizer, iterations).unwrap();
                let mut state = frame.state.clone();
                let stats = solver.step(&mut state, &frame.control);
                let energy = stats[0].energy.total();
                let rounding = 1e-12 * (stats[0].energy.stretch + stats[0].energy.shear);
                let what = format!(
                    "{} on {grid}, {crumpled}, repulsion {repulsion:?}, {iterations} iterations",
                    optimizer.name()
                );
                assert!(energy <= last + rounding, "{what}: {energy} after {last}");
                last = energy;
            }
        }
    }
}

#[test]
fn a_free_sheet_falls_as_a_stone() {
    for optimizer in optimizers() {
        let scene = Scene::parse(
            r#"{"handles": [], "motion": "none", "start": "flat", "wind": {"density": 0}, "frames": 61}"#,
            "scene",
            std::path::Path::new("."),
        );
        let setup = scene.unwrap().setup().unwrap();
        let mut solver = Solver::<f32>::new(&setup.model, &optimizer, 10).unwrap();
        let mut state = setup.start.cast::<f32>();
        let first = setup.vertices_m(&state.x);
        for frame in 1..=60 {
            solver.step(&mut state, &setup.control(frame));
        }
        let fallen: Vec<f64> =
            setup.vertices_m(&state.x).iter().zip(&first).map(|(now, then)| then[1] - now[1]).collect();
        // Backward Euler: g T^2 n (n + 1) / 2.
        let expected = 9.8 / 3600.0 * 60.0 * 61.0 / 2.0;
        for fallen in fallen {
            assert_near(optimizer.name(), fallen, expected, expected, 1e-4);
        }
    }
}

#[test]
fn a_weightless_sheet_does_not_move() {
    for optimizer in optimizers() {
        let model = Model { grid: Grid { h: 32, w: 32 }, cloths: vec![Cloth::default()] };
        let mut solver = Solver::<f32>::new(&model, &optimizer, 10).unwrap();
        let mut state = State::<f32>::rest(model.grid, 1);
        let start = state.clone();
        for _ in 0..30 {
            solver.step(&mut state, &Control::default());
        }
        let moved = state.x.iter().zip(&start.x).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(moved < 1e-5, "{}: {moved} edges", optimizer.name());
    }
}

#[test]
fn directions_that_are_not_finite_are_left_out_and_counted() {
    let mut weights = Weights::shipped();
    weights.parameters_mut().into_iter().for_each(|values| values.fill(f32::NAN));
    let frame = Frame::new(Grid { h: 16, w: 16 }, 0.1, None);
    let step = |optimizer: &Optimizer| {
        let mut solver = Solver::<f64>::new(&frame.model, optimizer, 4).unwrap();
        let mut state = frame.state.clone();
        let stats = solver.step(&mut state, &frame.control);
        (state, stats[0].steps)
    };
    let (broken, dropped) = step(&Optimizer::learned(weights));
    let (without, none) = step(&Optimizer::spectral());
    // An iteration that shortens a step has no use for directions.
    assert_eq!((dropped.dropped + dropped.shortened, none.dropped), (4, 0));
    assert!(dropped.dropped > 0 && dropped.shortened == none.shortened);
    assert!(broken == without);
}
