//! The plain definitions of the energy's local terms against central differences, and the vectorised forms against
//! the plain ones.

use crate::cloths::{jagged, make_uneven};
use crate::golden::relative_error;
use crate::noise::noise;
use fnopt::cloth::terms::{Angle, Edge, Particle};
use fnopt::cloth::{Cloth, EnergyTerms, Grid, Mark, Material, Model, State};
use fnopt::cpu::Real;
use fnopt::cpu::cloth::{
    CurvatureRows, Elements, GradientRows, Hessian, LocalModel, PlainTotal, Projection, Trial, energy,
    gradient, local_model, masses, neighbours, plain_total,
};
use glam::{DMat3, DVec3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Directions along which second derivatives are compared.
const K: usize = 4;

const BEND: Angle = Angle { factor: 3.0, rest: 0.0 };
const SHEAR: Angle = Angle { factor: 8.0, rest: FRAC_PI_2 };

fn vectors(seed: u64) -> Vec<DVec3> {
    noise(60, seed).chunks_exact(3).map(DVec3::from_slice).collect()
}

/// Returns the derivative of `f` with respect to each component of `at`, by central differences of fourth order.
fn differences(f: impl Fn(DVec3) -> f64, at: DVec3, step: f64) -> DVec3 {
    DVec3::AXES
        .map(|axis| {
            let near = |k: f64| f(at + k * step * axis);
            (8.0 * (near(1.0) - near(-1.0)) - (near(2.0) - near(-2.0))) / (12.0 * step)
        })
        .into()
}

/// Returns the derivatives of a vector, one column per component of `at`.
fn jacobian(f: impl Fn(DVec3) -> DVec3, at: DVec3, step: f64) -> DMat3 {
    DMat3::from_cols_array_2d(&[0, 1, 2].map(|row| differences(|x| f(x)[row], at, step).to_array()))
        .transpose()
}

/// Returns the largest entry's size.
fn size(m: DMat3) -> f64 {
    m.to_cols_array().iter().fold(0.0, |most, v| if v.is_nan() { f64::NAN } else { v.abs().max(most) })
}

#[test]
fn edges_have_these_derivatives() {
    let lengths = [1e-3, 0.1, 0.9, 1.0, 1.1, 3.0].into_iter().cycle();
    let dampings = [(0.0, 1.0), (2.0, 1.05), (0.5, 0.9), (1.0, 0.0)].into_iter().cycle();
    for ((e, length), (damping, before)) in vectors(1).into_iter().zip(lengths).zip(dampings) {
        let (edge, e) = (Edge { factor: 700.0, damping, before }, length * e.normalize());
        let step = 3e-4 * length;
        let slope = differences(|e| edge.energy(e), e, step);
        let scale = 2.0 * 700.0 * ((length - 1.0).abs() + damping * (length - before).abs()).max(1e-3);
        assert!((slope - edge.gradient(e)).length() < 1e-9 * scale, "{length}: {slope}");
        let change = jacobian(|e| edge.gradient(e), e, step);
        let scale = 2.0 * 700.0 * (1.0 + damping) * (1.0 / length).max(1.0);
        assert!(size(change - edge.hessian(e)) < 1e-9 * scale, "{length}: {change}");
    }
}

#[test]
fn particles_have_these_derivatives() {
    for (a, external) in vectors(2).into_iter().zip(vectors(3)) {
        let particle = Particle { mass: 0.7, external };
        let slope = differences(|a| particle.inertia(a) + particle.work(a), a, 1e-3);
        assert!((slope - particle.gradient(a)).length() < 1e-11);
        assert!(size(jacobian(|a| particle.gradient(a), a, 1e-3) - particle.hessian()) < 1e-11);
    }
}

/// Returns pairs of edges: of any angle and length, nearly parallel and antiparallel, and nearly at right angles.
fn pairs() -> Vec<(DVec3, DVec3)> {
    let lengths = [(1.0, 1.0), (0.9, 1.2), (1e-3, 1.0), (1.0, 1e-3), (1e-3, 2e-3), (3.0, 0.5)];
    let turns = [1e-3, PI - 1e-3, FRAC_PI_2 - 1e-3, FRAC_PI_2 + 1e-3, 0.3, 1.2, 2.0, 3.0];
    let cases = lengths.into_iter().flat_map(|lengths| turns.map(|turn| (lengths, turn)));
    let axes = vectors(4).into_iter().zip(vectors(5)).cycle();
    let pair = |(((of_u, of_w), turn), (u, w)): (((f64, f64), f64), (DVec3, DVec3))| {
        let (u, across) = (u.normalize(), u.cross(w).cross(u).normalize());
        (of_u * u, of_w * (f64::cos(turn) * u + f64::sin(turn) * across))
    };
    cases.zip(axes).map(pair).collect()
}

#[test]
fn angles_have_these_derivatives() {
    for (angle, (u, w)) in
        [BEND, SHEAR].into_iter().flat_map(|angle| pairs().into_iter().map(move |p| (angle, p)))
    {
        let lengths = [u.length(), w.length()];
        let sine = u.cross(w).length() / (lengths[0] * lengths[1]);
        let excess = sine.atan2(u.dot(w) / (lengths[0] * lengths[1])) - angle.rest;
        // Unless at its rest value, an angle's energy has a kink where the edges are parallel: steps stay away.
        let steps = lengths.map(|length| 3e-4 * length * sine);
        let what = format!("{angle:?} off by {excess} with edges of {lengths:?}");

        let slopes = [
            differences(|u| angle.energy(u, w), u, steps[0]),
            differences(|w| angle.energy(u, w), w, steps[1]),
        ];
        for ((slope, found), length) in slopes.into_iter().zip(angle.gradient(u, w)).zip(lengths) {
            let error = (slope - found).length() * length / (2.0 * angle.factor * excess.abs());
            assert!(error < 2e-8, "{what}: gradient {found}, not {slope}: {error:.1e}");
        }

        // Blocks in units that do not depend on the lengths; their size is that of the largest.
        let columns = [
            [0, 1].map(|k| jacobian(|u| angle.gradient(u, w)[k], u, steps[0])),
            [0, 1].map(|k| jacobian(|w| angle.gradient(u, w)[k], w, steps[1])),
        ];
        let hessian = angle.hessian(u, w);
        let unit = |m: DMat3, i: usize, j: usize| m * lengths[i] * lengths[j];
        let places = [(0, 0), (0, 1), (1, 0), (1, 1)];
        let largest = places.map(|(i, j)| size(unit(columns[j][i], i, j))).into_iter().fold(0.0, f64::max);
        for (i, j) in places {
            let error = size(unit(columns[j][i] - hessian[i][j], i, j)) / largest;
            assert!(error < 2e-8, "{what}: block {i}, {j}: {}, not {}", hessian[i][j], columns[j][i]);
        }
    }
}

#[test]
fn degenerate_elements_take_their_limits() {
    let (edge, zero) = (Edge { factor: 700.0, damping: 0.0, before: 1.0 }, DVec3::ZERO);
    assert_eq!((edge.energy(zero), edge.gradient(zero), edge.hessian(zero)), (700.0, zero, DMat3::ZERO));
    let w = DVec3::new(-0.5, -0.7, -0.2);
    for angle in [BEND, SHEAR] {
        for (u, w) in [(zero, w), (w, zero), (zero, -w), (zero, zero)] {
            assert_eq!(angle.energy(u, w), angle.factor * angle.rest * angle.rest);
            assert_eq!(angle.gradient(u, w), [zero; 2]);
            assert_eq!(angle.hessian(u, w), [[DMat3::ZERO; 2]; 2]);
        }
        for factor in [2.0, -0.5] {
            assert_eq!(angle.gradient(w, factor * w), [zero; 2]);
            assert!(angle.hessian(w, factor * w).as_flattened().iter().all(|block| block.is_finite()));
        }
    }
    // A straight bend is the square of the distance between the two directions, whatever the normal.
    let u = DVec3::new(0.48, 0.6, 0.64);
    let across = DMat3::IDENTITY - DMat3::from_cols(u.x * u, u.y * u, u.z * u);
    let slightly = |turn: f64| u + turn * u.cross(DVec3::X).normalize();
    for (w, tolerance) in [(u, 1e-15), (slightly(1e-10), 1e-9), (slightly(1e-8), 1e-7)] {
        let [[uu, uw], [wu, ww]] = BEND.hessian(u, w);
        for (found, expected) in [(uu, across), (uw, -across), (wu, -across), (ww, across)] {
            assert!(size(found - 6.0 * expected) <= 6.0 * tolerance, "{found}, not {expected}");
        }
    }
}

/// One cloth at a trial, with directions that are 0 at its handles. All numbers are exact in single precision, so
/// that only the arithmetic of the two precisions differs.
struct Sheet {
    grid: Grid,
    x: Vec<f64>,
    shift: Vec<f64>,
    a: Vec<f64>,
    f: Vec<f64>,
    marks: Vec<Mark>,
    cloth: Cloth,
    directions: Vec<f64>,
}

impl Sheet {
    /// Builds a sheet at rest, plus noise of this size.
    fn new(grid: (usize, usize), crumpled: f64, handles: &[usize]) -> Self {
        Self::cut(grid, crumpled, Cloth { handles: handles.to_vec(), ..Cloth::default() })
    }

    /// As [`Sheet::new`], of a cloth that may not be a full rectangle.
    fn cut((h, w): (usize, usize), crumpled: f64, cloth: Cloth) -> Self {
        let grid = Grid { h, w };
        let n = grid.particles();
        let exact = |values: Vec<f64>| values.into_iter().map(|v| f64::from(v as f32)).collect::<Vec<_>>();
        let noise = |len, seed, size: f64| exact(noise(len, seed).into_iter().map(|v| size * v).collect());
        let rest = State::<f64>::rest(grid, 1).x;
        let x = exact(rest.iter().zip(noise(3 * n, 11, crumpled)).map(|(x, d)| x + d).collect());
        let mut directions = noise(K * 3 * n, 12, 1.0);
        for p in (0..n).filter(|&p| cloth.handles.contains(&p) || !cloth.contains(p)) {
            directions.chunks_exact_mut(n).for_each(|field| field[p] = 0.0);
        }
        let shift = noise(3 * n, 13, 0.3 * crumpled);
        let marks = Model { grid, cloths: vec![cloth.clone()] }.marks();
        Self { grid, x, shift, a: noise(3 * n, 14, 0.1), f: noise(3 * n, 15, 0.1), marks, cloth, directions }
    }

    /// Builds a sheet at rest whose particles are moved by `place`, from (j, i) on.
    fn placed(grid: (usize, usize), place: impl Fn(f64, f64) -> [f64; 3]) -> Self {
        let mut sheet = Self::new(grid, 0.0, &[]);
        let n = sheet.grid.particles();
        for p in 0..n {
            let to = place((p % grid.1) as f64, (p / grid.1) as f64);
            (0..3).for_each(|c| sheet.x[c * n + p] = to[c]);
        }
        sheet
    }

    fn with_trial<T: Real, R>(&self, use_it: impl FnOnce(&Trial<'_, T>, &[T]) -> R) -> R {
        let all = |values: &[f64]| values.iter().map(|&v| T::of(v)).collect::<Vec<T>>();
        let (x, shift, a, f) = (all(&self.x), all(&self.shift), all(&self.a), all(&self.f));
        let material = Material { stretch: 700.0, shear: 8.0, bend: 3.0, ..self.cloth.material };
        let damping = self.cloth.damping;
        let (grid, marks) = (self.grid, &self.marks[..]);
        let (masses, elements) = (masses(grid, marks), Elements::of(grid, marks));
        let [x, shift, a, f, masses] = [&x, &shift, &a, &f, &masses].map(|values| &values[..]);
        let elements = elements.as_ref();
        let trial = Trial { grid, material, damping, x, shift, a, f, marks, masses, elements, near: None };
        use_it(&trial, &all(&self.directions))
    }

    fn plain(&self) -> PlainTotal {
        self.with_trial(plain_total)
    }

    /// Returns what the vectorised forms compute.
    fn vectorised<T: Real>(&self) -> (EnergyTerms, Vec<f64>, LocalModel) {
        self.with_trial::<T, _>(|trial, directions| {
            // Working memory is reused, as it is between iterations.
            let (mut grad, mut rows) = (vec![T::nan(); trial.x.len()], GradientRows::new(trial.grid));
            (0..2).for_each(|_| gradient(trial, &mut rows, &mut grad));
            let model = local_model(trial, &mut CurvatureRows::new(trial.grid), directions, &grad);
            (energy(trial), grad.iter().map(|g| g.f64()).collect(), model)
        })
    }

    /// Returns the deviations of the vectorised forms from the plain sums, relative to the largest number of their kind:
    /// of the energy terms, the gradient, and the local model's energies, slopes and second derivatives.
    fn deviations<T: Real>(&self) -> [f64; 5] {
        let plain = self.plain();
        let (energy, grad, model) = self.vectorised::<T>();
        let slopes: Vec<f64> =
            self.directions.chunks_exact(grad.len()).map(|p| dot(p, &plain.gradient)).collect();
        // Slopes may be small sums of large terms.
        let scale = dot(&plain.gradient, &plain.gradient).sqrt() * (grad.len() as f64).sqrt();
        let of_slopes =
            model.slopes.iter().zip(&slopes).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        [
            relative_by_term(energy, plain.energy),
            relative_error(&grad, &plain.gradient),
            relative_by_term(model.energy, plain.energy),
            of_slopes / scale,
            relative_error(model.curvature.as_flattened(), &plain.curvature.concat()),
        ]
    }

    /// Returns the deviation of Newton's Hessian, for which all particles are free, along the directions, relative to the
    /// largest number. The masses, which it leaves out, are added to both.
    fn deviation_of_hessian(&self) -> f64 {
        let (grid, n) = (self.grid, self.grid.particles());
        let free = Self {
            x: self.x.clone(),
            shift: self.shift.clone(),
            ..Self::cut((grid.h, grid.w), 0.0, Cloth { handles: Vec::new(), ..self.cloth.clone() })
        };
        let mut hessian = Hessian::new(grid).unwrap();
        free.with_trial(|trial, _| hessian.fill(trial, Projection::NONE));
        let mut found = vec![vec![0.0; K]; K];
        let fields: Vec<&[f64]> = free.directions.chunks_exact(3 * n).collect();
        let pairs = (0..n).flat_map(|p| neighbours(grid, p).chain([p]).map(move |q| (p, q)));
        for (p, q) in pairs {
            let mut block = DMat3::from_cols_array_2d(&hessian.block(p, q)).transpose();
            if p == q {
                block += DMat3::IDENTITY * (free.marks[p].mass() / n as f64);
            }
            let at = |field: &[f64], p: usize| DVec3::new(field[p], field[n + p], field[2 * n + p]);
            for (i, j) in (0..K).flat_map(|i| (0..K).map(move |j| (i, j))) {
                found[i][j] += at(fields[i], p).dot(block * at(fields[j], q));
            }
        }
        relative_error(&found.concat(), &free.plain().curvature.concat())
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the largest deviation of a term relative to itself, or to 1e-12 if it is smaller. The external work, a small
/// sum of large terms, is compared with the inertia: accelerations and forces are of one size.
fn relative_by_term(found: EnergyTerms, expected: EnergyTerms) -> f64 {
    let all = |e: EnergyTerms| [e.stretch, e.shear, e.bend, e.inertia, e.external, e.repulsion];
    let scales = all(EnergyTerms { external: expected.inertia, ..expected });
    let apart = all(found).into_iter().zip(all(expected)).map(|(a, b)| (a - b).abs());
    let apart = apart.zip(scales).map(|(apart, scale)| apart / scale.max(1e-12));
    apart.fold(0.0, |most: f64, d| if d.is_nan() { f64::INFINITY } else { most.max(d) })
}

/// Returns deviations as text: of the energy, the gradient, and the local model's energy, slopes and curvature.
fn shown(deviations: &[f64; 5]) -> String {
    deviations.map(|d| format!("{d:.1e}")).join(", ")
}

/// Returns crumpled sheets and such as are nearly flat, on grids of all shapes: with rows that end within a register
/// and at the end of one, without interior, and with several tasks. With and without handles.
fn sheets() -> Vec<(String, Sheet)> {
    let grids = [(8, 8), (5, 9), (2, 3), (13, 6), (2, 2), (7, 2), (9, 12), (8, 16), (11, 17), (130, 131)];
    let rows = (8..=35).map(|w| (8, w));
    let of_grid = |(h, w): (usize, usize)| {
        let handles = [vec![], vec![0, h * w / 2, h * w - 1]];
        let each =
            handles.into_iter().flat_map(|handles| [0.4, 1e-3].map(|crumpled| (handles.clone(), crumpled)));
        each.map(move |(handles, crumpled)| {
            let name = format!("{h}x{w}, crumpled by {crumpled}, {} handles", handles.len());
            (name, Sheet::new((h, w), crumpled, &handles))
        })
    };
    let masked = |(h, w): (usize, usize)| {
        let mask = jagged(Grid { h, w });
        let handles = (0..h * w).filter(|&p| mask.contains(p)).step_by(7).take(3).collect();
        let cloth = Cloth { handles, mask: Some(mask), ..Cloth::default() };
        let sheet = move |crumpled| Sheet::cut((h, w), crumpled, cloth.clone());
        [0.4, 1e-3].map(|crumpled| (format!("{h}x{w}, jagged, crumpled by {crumpled}"), sheet(crumpled)))
    };
    let uneven = |(h, w): (usize, usize)| {
        let grid = Grid { h, w };
        let mut cloth = Cloth { handles: vec![0, h * w / 2], ..Cloth::default() };
        make_uneven(grid, &mut cloth);
        let masked = Cloth { mask: Some(jagged(grid)), handles: Vec::new(), ..cloth.clone() };
        let sheet = move |cloth: &Cloth| Sheet::cut((h, w), 0.4, cloth.clone());
        [("uneven", sheet(&cloth)), ("uneven and jagged", sheet(&masked))]
            .map(|(name, sheet)| (format!("{h}x{w}, {name}, crumpled by 0.4"), sheet))
    };
    let full = grids.into_iter().chain(rows.clone()).flat_map(of_grid);
    let others = rows.chain([(9, 12), (11, 17), (130, 131)]);
    full.chain(others.clone().flat_map(masked)).chain(others.flat_map(uneven)).collect()
}

/// Returns sheets with edges of length zero, straight and folded bends, and corners without a normal.
fn degenerate_sheets() -> Vec<(String, Sheet)> {
    let mut collapsed = Sheet::new((9, 13), 0.2, &[5]);
    let n = collapsed.grid.particles();
    for (p, q) in [(0, 1), (40, 53), (n - 2, n - 1)] {
        for field in [&mut collapsed.x, &mut collapsed.shift] {
            (0..3).for_each(|c| field[c * n + q] = field[c * n + p]);
        }
    }
    let sheets = [
        ("collapsed", collapsed),
        ("flat", Sheet::placed((8, 9), |j, i| [1.125 * j, 0.75 * i, 0.0])),
        ("folded", Sheet::placed((8, 9), |j, i| [(j - 4.0).abs(), 1.25 * i, 0.0])),
        ("a line", Sheet::placed((8, 9), |j, i| [0.0, 1.25 * i + 0.5 * j, 0.0])),
        ("a point", Sheet::placed((8, 9), |_, _| [1.0, 2.0, 3.0])),
    ];
    sheets.map(|(name, sheet)| (name.to_owned(), sheet)).into()
}

#[test]
fn vectorised_forms_agree_with_the_plain_sums() {
    let mut most = [0.0f64; 5];
    for (name, sheet) in sheets().into_iter().chain(degenerate_sheets()) {
        let found = sheet.deviations::<f64>();
        assert!(found.iter().all(|d| *d < 1e-10), "{name}: {}", shown(&found));
        most = std::array::from_fn(|k| most[k].max(found[k]));
    }
    println!("largest deviations in double precision: {}", shown(&most));
}

/// To a few roundings of single precision (6e-8 each); slopes, whose scale is that of all terms added up, to fewer.
#[test]
fn single_precision_agrees_with_the_plain_sums() {
    let (mut most, tolerances) = ([0.0f64; 5], [1e-6, 1e-6, 1e-6, 2e-7, 1e-6]);
    for (name, sheet) in sheets().into_iter().filter(|(name, _)| name.contains("by 0.4")) {
        let found = sheet.deviations::<f32>();
        assert!((0..5).all(|k| found[k] < tolerances[k]), "{name}: {}", shown(&found));
        most = std::array::from_fn(|k| most[k].max(found[k]));
    }
    println!("largest deviations in single precision: {}", shown(&most));
}

#[test]
fn the_hessian_of_newtons_method_agrees_with_the_plain_sums() {
    let mut most = 0.0f64;
    for (name, sheet) in
        sheets().into_iter().filter(|(_, s)| s.grid.particles() < 500).chain(degenerate_sheets())
    {
        let found = sheet.deviation_of_hessian();
        assert!(found < 1e-10, "{name}: {found:.1e}");
        most = most.max(found);
    }
    println!("largest deviation of the Hessian: {most:.1e}");
}
