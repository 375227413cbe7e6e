//! The Hessian of the elastic energy, and Newton's method with it.

use crate::marks_of;
use crate::noise::noise;
use fnopt::cloth::{Cloth, Control, Grid, Mark, Material, Model, Repulsion, State};
use fnopt::cpu::cloth::{
    Contacts, Couples, GradientRows, Hessian, Projection, Trial, gradient, masses, repelling_pairs,
};
use fnopt::cpu::optim::InverseHessian;
use fnopt::cpu::{FactoredHessian, Reference, Solver};
use fnopt::scene::{Scene, Stiffness};
use fnopt::sim::Optimizer;

/// A sheet with its arrays, crumpled by `noise` so that some edges are longer than at rest and some shorter.
struct Sheet {
    grid: Grid,
    x: Vec<f64>,
    zeros: Vec<f64>,
    marks: Vec<Mark>,
    masses: Vec<f64>,
}

impl Sheet {
    fn new(grid: Grid, crumpled: f64) -> Self {
        let rest = State::<f64>::rest(grid, 1).x;
        let x = rest.iter().zip(noise(rest.len(), 1)).map(|(x, d)| x + crumpled * d).collect();
        let marks = marks_of(grid, &[]);
        Self { grid, zeros: vec![0.0; rest.len()], x, masses: masses(grid, &marks), marks }
    }

    /// Folds the sheet in two, with its halves 0.4 edges apart.
    fn fold(&mut self) {
        let (Grid { h, w }, n) = (self.grid, self.grid.particles());
        for (i, j) in (h / 2..h).flat_map(|i| (0..w).map(move |j| (i, j))) {
            let middle = (h / 2) as f64 - 0.5 - (h - 1) as f64 / 2.0;
            let (y, z) = (n + i * w + j, 2 * n + i * w + j);
            (self.x[y], self.x[z]) = (2.0 * middle - self.x[y], self.x[z] + 0.4);
        }
    }

    fn at<'a>(&'a self, x: &'a [f64]) -> Trial<'a, f64> {
        Trial {
            grid: self.grid,
            material: Material { stretch: 700.0, shear: 8.0, bend: 3.0, ..Material::PAPER },
            x,
            shift: &self.zeros,
            a: &self.zeros,
            f: &self.zeros,
            marks: &self.marks,
            masses: &self.masses,
            damping: 0.0,
            elements: None,
            near: None,
        }
    }

    /// Returns the gradient at the free particles and the direction of a Newton step.
    fn directions(&self, hessian: &mut FactoredHessian) -> [Vec<f64>; 2] {
        hessian.reset();
        hessian.factor(&self.at(&self.x), None, (&Contacts::default(), &Couples::default())).unwrap();
        let mut grad = self.gradient(&self.x);
        let n = self.grid.particles();
        (0..3 * n).filter(|k| !self.marks[k % n].is_free()).for_each(|k| grad[k] = 0.0);
        let mut direction = grad.clone();
        hessian.apply(&mut direction);
        [grad, direction]
    }

    fn gradient(&self, x: &[f64]) -> Vec<f64> {
        let mut grad = vec![0.0; x.len()];
        gradient(&self.at(x), &mut GradientRows::new(self.grid), &mut grad);
        grad
    }

    /// Returns the Hessian times a direction.
    fn hessian_times(&self, projection: Projection, direction: &[f64]) -> Vec<f64> {
        let n = self.grid.particles();
        let mut found = vec![0.0; direction.len()];
        let mut hessian = Hessian::new(self.grid).unwrap();
        // Filled at another trial first, of which nothing may remain.
        let elsewhere: Vec<f64> =
            self.x.iter().zip(noise(self.x.len(), 9)).map(|(x, d)| x + 0.3 * d).collect();
        hessian.fill(&self.at(&elsewhere), Projection(0.5));
        hessian.fill(&self.at(&self.x), projection);
        assert!(hessian.values().iter().all(|v| v.is_finite()));
        for (p, q) in (0..n).flat_map(|p| (0..n).map(move |q| (p, q))) {
            for (row, line) in hessian.block(p, q).iter().enumerate() {
                let product = line.iter().enumerate().map(|(column, b)| b * direction[column * n + q]);
                found[row * n + p] += product.sum::<f64>();
            }
        }
        found
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn the_projected_hessian_is_never_negative() {
    let sheet = Sheet::new(Grid { h: 10, w: 8 }, 0.4);
    let (mut lowest, mut exact_lowest) = (f64::INFINITY, f64::INFINITY);
    for seed in 3..40 {
        // One particle moves alone: in such directions compressed edges buckle.
        let mut direction = vec![0.0; sheet.x.len()];
        let n = sheet.grid.particles();
        let p = (seed as usize * 31) % n;
        (0..3).for_each(|c| direction[c * n + p] = noise(3, seed)[c]);
        lowest = lowest.min(dot(&direction, &sheet.hessian_times(Projection::FULL, &direction)));
        exact_lowest = exact_lowest.min(dot(&direction, &sheet.hessian_times(Projection::NONE, &direction)));
        let all = noise(sheet.x.len(), seed);
        assert!(dot(&all, &sheet.hessian_times(Projection::FULL, &all)) >= 0.0);
    }
    assert!(lowest >= 0.0, "{lowest}");
    assert!(exact_lowest < 0.0, "the sheet has no compressed edge: {exact_lowest}");
}

/// Two particles coincide. Their edge has no direction, and no angle with any other.
#[test]
fn collapsed_edges_leave_a_usable_hessian() {
    let grid = Grid { h: 9, w: 13 };
    let n = grid.particles();
    for (p, q) in [(0, 1), (0, grid.w), (40, 41), (40, 40 + grid.w), (n - 2, n - 1), (n - 1 - grid.w, n - 1)]
    {
        let mut sheet = Sheet::new(grid, 0.1);
        (0..3).for_each(|c| sheet.x[c * n + q] = sheet.x[c * n + p]);
        for seed in 11..14 {
            let all = noise(sheet.x.len(), seed);
            assert!(dot(&all, &sheet.hessian_times(Projection::FULL, &all)) >= 0.0, "{p} on {q}");
        }
        let [grad, direction] = sheet.directions(&mut FactoredHessian::new(grid).unwrap());
        assert!(dot(&direction, &grad) > 0.0, "{p} on {q}");
    }
}

/// The part left out is proportional to the share, term by term.
#[test]
fn a_share_of_the_negative_curvature_is_left_out() {
    let sheet = Sheet::new(Grid { h: 9, w: 11 }, 0.4);
    let direction = noise(sheet.x.len(), 21);
    let [none, part, full] = [0.0, 0.25, 1.0].map(|share| sheet.hessian_times(Projection(share), &direction));
    let size = dot(&full, &full).sqrt();
    for ((none, part), full) in none.iter().zip(part).zip(full) {
        assert!((part - (0.75 * none + 0.25 * full)).abs() < 1e-12 * size);
    }
}

/// Factors depend only on the current trial: earlier handles and non-finite values leave no trace.
#[test]
fn factors_are_computed_again() {
    let grid = Grid { h: 17, w: 32 };
    let mut reused = FactoredHessian::new(grid).unwrap();
    let mut broken = Sheet::new(grid, 0.1);
    for p in [0, 31, 200, grid.particles() - 1] {
        for value in [f64::NAN, f64::INFINITY] {
            broken.x[p] = value;
            assert!(
                reused
                    .factor(&broken.at(&broken.x), None, (&Contacts::default(), &Couples::default()))
                    .is_err(),
                "{value} at {p}"
            );
            broken.x[p] = 0.0;
        }
    }
    for (seed, handles) in [(1, vec![]), (2, vec![0, 31]), (3, (0..32).collect()), (4, vec![5, 6, 38, 300])] {
        let mut sheet = Sheet::new(grid, 0.05 * seed as f64);
        sheet.marks = marks_of(sheet.grid, &handles);
        let again = sheet.directions(&mut reused);
        assert_eq!(again, sheet.directions(&mut FactoredHessian::new(grid).unwrap()), "sheet {seed}");
    }
}

/// One grid is factored number by number, the others block by block.
#[test]
fn the_direction_solves_the_system() {
    for (h, w) in [(8, 11), (24, 33), (32, 32)] {
        solves_the_system(Grid { h, w }, None);
        // With pairs that share no elastic term.
        solves_the_system(Grid { h, w }, Some(Repulsion { strength: 10.0, distance: 0.9 }));
    }
}

fn solves_the_system(grid: Grid, repulsion: Option<Repulsion>) {
    let mut sheet = Sheet::new(grid, 0.05);
    // At two corners, at a border, and inside.
    sheet.marks = marks_of(grid, &[0, 3, 4 * grid.w + 6, grid.particles() - 1]);
    let n = sheet.grid.particles();
    let marks = sheet.marks.clone();
    let held = |k: usize| !marks[k % n].is_free();
    let mut grad = noise(3 * n, 5);
    (0..3 * n).filter(|&k| held(k)).for_each(|k| grad[k] = 0.0);
    let mut hessian = FactoredHessian::new(sheet.grid).unwrap();
    if repulsion.is_some() {
        // The pattern grows as pairs come into range.
        hessian.factor(&sheet.at(&sheet.x), repulsion, (&Contacts::default(), &Couples::default())).unwrap();
        hessian.reset();
        sheet.fold();
    }
    hessian.factor(&sheet.at(&sheet.x), repulsion, (&Contacts::default(), &Couples::default())).unwrap();
    let pairs = repulsion.map_or_else(Vec::new, |r| repelling_pairs(&sheet.at(&sheet.x), r));
    assert!(repulsion.is_none() || pairs.len() > n / 3, "{} pairs", pairs.len());
    let mut direction = grad.clone();
    hessian.apply(&mut direction);
    assert!((0..3 * n).filter(|&k| held(k)).all(|k| direction[k] == 0.0));
    let inertia = |k: usize| sheet.grid.mass(k % n / sheet.grid.w, k % n % sheet.grid.w) / n as f64;
    // The shares that are tried in order. The factors are in single precision, hence the tolerance.
    let residuals = [0.25, 1.0].map(|share| {
        let mut apart = sheet.hessian_times(Projection(share), &direction);
        for pair in &pairs {
            let block = pair.block(Projection(share));
            for (row, column) in (0..9).map(|k| (k / 3, k % 3)) {
                let pull =
                    block[row][column] * (direction[column * n + pair.p] - direction[column * n + pair.q]);
                apart[row * n + pair.p] += pull;
                apart[row * n + pair.q] -= pull;
            }
        }
        (0..3 * n).for_each(|k| {
            apart[k] = if held(k) { 0.0 } else { apart[k] + inertia(k) * direction[k] - grad[k] };
        });
        (dot(&apart, &apart) / dot(&grad, &grad)).sqrt()
    });
    let least = residuals.into_iter().fold(f64::INFINITY, f64::min);
    assert!(least < 1e-5, "{grid}: no Hessian times the direction is the gradient: {residuals:?}");
}

/// Nothing holds this sheet, and it is ten billion times as stiff as heavy. Rounding erases the mass that
/// makes the Hessian definite, yet there is a direction, and it leads down.
#[test]
fn pivots_lost_to_rounding_are_replaced() {
    let material = Material { stretch: 1e10, shear: 1e8, bend: 1e8, ..Material::PAPER };
    for w in 8..24 {
        let sheet = Sheet::new(Grid { h: 9, w }, 0.05);
        let stiff = Trial { material, ..sheet.at(&sheet.x) };
        let mut grad = vec![0.0; sheet.x.len()];
        gradient(&stiff, &mut GradientRows::new(sheet.grid), &mut grad);
        let mut hessian = FactoredHessian::new(sheet.grid).unwrap();
        hessian
            .factor(&stiff, None, (&Contacts::default(), &Couples::default()))
            .unwrap_or_else(|e| panic!("9x{w}: {e}"));
        let mut direction = grad.clone();
        hessian.apply(&mut direction);
        assert!(direction.iter().all(|d| d.is_finite()), "9x{w}");
        assert!(dot(&direction, &grad) > 0.0, "9x{w}: {}", dot(&direction, &grad));
    }
}

/// Frames of the default scene converge to |gradient| <= 1e-8: the first 60, or all with `FRAMES=391`.
#[test]
fn frames_of_a_swinging_sheet_converge() {
    let setup = Scene::released().setup().unwrap();
    let mut reference = Reference::new(&setup.model).unwrap();
    let (mut state, still) = (setup.start.clone(), vec![0.0; setup.start.x.len()]);
    let (mut most, begun) = (0, std::time::Instant::now());
    let frames = 391.min(std::env::var("FRAMES").map_or(60, |f| f.parse().unwrap()));
    for frame in 1..frames {
        let minimum = reference.minimise(&state, &setup.control(frame), &still);
        assert!(minimum.converged, "frame {frame}: |gradient| {:.1e}", minimum.gradient());
        most = most.max(minimum.iterations);
        reference.end_frame(&mut state, &setup.control(frame));
    }
    println!(
        "{most} iterations at most, {:.1} ms a frame",
        begun.elapsed().as_secs_f64() / frames as f64 * 1e3
    );
}

/// The default cloth's moduli on a finer grid, where stretch outweighs inertia a hundred thousand times.
/// Factors in single precision suffice.
#[test]
fn a_stiff_fine_sheet_converges() {
    let mut scene = Scene::released();
    scene.regrid(Grid { h: 100, w: 100 }).unwrap();
    scene.stiffness =
        Stiffness::Grid(Material { stretch: 10_000.0, shear: 80.0, bend: 50.0, ..Material::PAPER });
    let setup = scene.setup().unwrap();
    let mut reference = Reference::new(&setup.model).unwrap();
    let (mut state, still) = (setup.start.clone(), vec![0.0; setup.start.x.len()]);
    for frame in 1..4 {
        let minimum = reference.minimise(&state, &setup.control(frame), &still);
        assert!(minimum.converged, "frame {frame}: |gradient| {:.1e}", minimum.gradient());
        reference.end_frame(&mut state, &setup.control(frame));
    }
}

/// As a single-precision solver for a batch, Newton's method follows the reference to single precision.
#[test]
fn a_batch_is_solved_cloth_by_cloth() {
    let setup = Scene::released().setup().unwrap();
    let model = Model { grid: setup.model.grid, cloths: vec![setup.model.cloths[0].clone(); 2] };
    let mut solver = Solver::<f32>::new(&model, &Optimizer::newton(), 1).unwrap();
    let twice = |values: &[f64]| [values, values].concat().iter().map(|&v| v as f32).collect::<Vec<_>>();
    let mut state = State { x: twice(&setup.start.x), v: twice(&setup.start.v) };
    let (mut exact, still) = (setup.start.clone(), vec![0.0; setup.start.x.len()]);
    let mut reference = Reference::new(&setup.model).unwrap();
    for frame in 40..44 {
        let control = setup.control::<f64>(frame);
        let handles = [&control.handles[..], &control.handles].concat();
        let handles = handles.iter().map(|p| p.map(|v| v as f32)).collect();
        let stats = solver.step(&mut state, &Control { handles, ..Default::default() });
        assert!(stats[0].gradient_last < 1e-3 * stats[0].gradient_first, "{stats:?}");
        assert_eq!(stats[0], stats[1]);
        reference.minimise(&exact, &control, &still);
        reference.end_frame(&mut exact, &control);
    }
    let (one, other) = state.x.split_at(exact.x.len());
    assert_eq!(one, other);
    let apart = crate::golden::largest_difference(&crate::golden::widened(one), &exact.x);
    assert!(apart < 1e-3, "{apart} edges");
}

/// Layers that are pressed together, within range of each other, converge to |gradient| <= 1e-8, whatever frame came
/// before. (Where a pair only just touches, the gradient jumps, and does not vanish at the minimum.)
#[test]
fn layers_within_range_converge() {
    let grid = Grid { h: 24, w: 20 };
    let (Grid { h, w }, n) = (grid, grid.particles());
    let mut sheet = Sheet::new(grid, 0.02);
    sheet.fold();
    let of_cloth = Repulsion { strength: 0.03, distance: 0.9 };
    // The fold itself is held.
    let cloth = Cloth {
        material: Material { stretch: 700.0, shear: 8.0, bend: 0.1, ..Material::PAPER },
        repulsion: Some(of_cloth),
        handles: ((h / 2 - 2) * w..(h / 2 + 2) * w).collect(),
        ..Cloth::default()
    };
    let handles = cloth.handles.iter().map(|p| [0, 1, 2].map(|c| sheet.x[c * n + p])).collect();
    // Forces that balance the repulsion of two particles at half an edge. Stronger ones make the layers slide.
    let mut external = vec![0.0; 3 * n];
    for p in 0..n {
        let towards = if p < n / 2 { 0.24 } else { -0.24 };
        external[2 * n + p] = towards / grid.mass(p / w, p % w);
    }
    let model = Model { grid, cloths: vec![cloth] };
    let (control, still) = (Control { handles, external, ..Control::default() }, vec![0.0; 3 * n]);
    let mut state = State { x: sheet.x.clone(), v: still.clone() };
    let mut reference = Reference::new(&model).unwrap();
    for frame in 0..3 {
        let minimum = reference.minimise(&state, &control, &still);
        assert!(minimum.converged, "frame {frame}: |gradient| {:.1e}", minimum.gradient());
        assert!(minimum.iterations < 60, "frame {frame}: {} iterations", minimum.iterations);
        let fresh = Reference::new(&model).unwrap().minimise(&state, &control, &still);
        assert_eq!(minimum, fresh, "frame {frame}");
        reference.end_frame(&mut state, &control);
        let pairs = repelling_pairs(&sheet.at(&state.x), of_cloth);
        assert!(pairs.len() > n / 3, "frame {frame}: {} pairs", pairs.len());
    }
}
