//! Energies and gradients: golden files, central differences, and sheets whose energy has a closed form.

use crate::golden::{Golden, relative_error};
use crate::marks_of;
use crate::noise::noise;
use fnopt::cloth::{EnergyTerms, Grid, Mark, Material};
use fnopt::cpu::cloth::{Frame, GradientRows, Trial, end_frame, energy, gradient, masses, shifts, stretch};

/// The arrays that a trial borrows.
struct Sheet {
    grid: Grid,
    material: Material,
    x: Vec<f64>,
    v: Vec<f64>,
    a: Vec<f64>,
    f: Vec<f64>,
    marks: Vec<Mark>,
    handles: Vec<[f64; 3]>,
}

impl Sheet {
    /// Builds a sheet with particle (i, j) at `position(j, i)` and everything else zero.
    fn shaped(grid: Grid, material: Material, position: impl Fn(f64, f64) -> [f64; 3]) -> Self {
        let n = grid.particles();
        let mut x = vec![0.0; 3 * n];
        for p in 0..n {
            let at = position((p % grid.w) as f64, (p / grid.w) as f64);
            (0..3).for_each(|c| x[c * n + p] = at[c]);
        }
        let zeros = || vec![0.0; 3 * n];
        Self {
            grid,
            material,
            x,
            v: zeros(),
            a: zeros(),
            f: zeros(),
            marks: marks_of(grid, &[]),
            handles: vec![],
        }
    }

    /// Reads cloth `b` of a golden file.
    fn golden(file: &Golden, material: Material, b: usize) -> Self {
        let shape = file.shape("positions");
        let grid = Grid { h: shape[2], w: shape[3] };
        let n = grid.particles();
        let field = |name: &str| file.get(name)[b * 3 * n..(b + 1) * 3 * n].to_vec();
        let (mask, targets) = (&file.get("handle_mask")[b * n..(b + 1) * n], field("handle_positions"));
        let held: Vec<usize> = (0..n).filter(|&p| mask[p] != 0.0).collect();
        let handles = held.iter().map(|&p| [targets[p], targets[n + p], targets[2 * n + p]]).collect();
        let (x, v, a) = (field("positions"), field("velocities"), field("accelerations"));
        Self {
            grid,
            material,
            x,
            v,
            a,
            f: field("external_accelerations"),
            marks: marks_of(grid, &held),
            handles,
        }
    }

    fn frame(&self) -> Frame<'_, f64> {
        Frame { marks: &self.marks, handles: &self.handles, a: &self.a }
    }

    fn with_trial<R>(&self, use_it: impl FnOnce(&Trial<'_, f64>) -> R) -> R {
        let shift = self.shift();
        let Self { grid, material, x, a, f, marks, .. } = self;
        let masses = &masses(*grid, marks);
        use_it(&Trial {
            grid: *grid,
            material: *material,
            x,
            shift: &shift,
            a,
            f,
            marks,
            masses,
            damping: 0.0,
            elements: None,
            near: None,
        })
    }

    fn shift(&self) -> Vec<f64> {
        let mut shift = vec![0.0; self.x.len()];
        shifts(self.frame(), &self.x, &self.v, &mut shift);
        shift
    }

    fn energy(&self) -> EnergyTerms {
        self.with_trial(energy)
    }

    fn gradient(&self) -> Vec<f64> {
        let mut grad = vec![f64::NAN; self.x.len()];
        self.with_trial(|trial| gradient(trial, &mut GradientRows::new(self.grid), &mut grad));
        grad
    }
}

fn check(name: &str) {
    let file = Golden::open(name);
    let [stretch, shear, bend] = ["stretching", "shearing", "bending"].map(|name| file.get(name));
    for b in 0..stretch.len() {
        let material = Material { stretch: stretch[b], shear: shear[b], bend: bend[b], ..Material::PAPER };
        let sheet = Sheet::golden(&file, material, b);
        let found = sheet.energy();
        let terms = [
            ("stretching_energy", found.stretch),
            ("shearing_energy", found.shear),
            ("bending_energy", found.bend),
            ("inertia", found.inertia),
            ("external", found.external),
            ("total", found.total()),
        ];
        for (term, value) in terms {
            let expected = file.get(term)[b];
            assert!(
                (value - expected).abs() <= 1e-9 * expected.abs(),
                "{name}: {term}: {value}, not {expected}"
            );
        }
        let grad = sheet.gradient();
        let error = relative_error(&grad, &file.get("gradient")[b * grad.len()..][..grad.len()]);
        assert!(error < 1e-9, "{name}: gradient: {error}");
    }
}

#[test]
fn energies_and_gradients_agree_with_the_authors() {
    check("energy_small");
    check("energy_rest");
}

/// Builds a crumpled sheet with velocities, accelerations, forces and two handles.
fn crumpled(grid: Grid) -> Sheet {
    let material = Material { stretch: 300.0, shear: 20.0, bend: 3.0, ..Material::PAPER };
    let mut sheet = Sheet::shaped(grid, material, |j, i| [j, i, 0.0]);
    let len = sheet.x.len();
    let add = |to: &mut Vec<f64>, seed, size: f64| {
        to.iter_mut().zip(noise(len, seed)).for_each(|(to, noise)| *to += size * noise);
    };
    add(&mut sheet.x, 1, 0.4);
    add(&mut sheet.v, 2, 0.1);
    add(&mut sheet.a, 3, 0.1);
    add(&mut sheet.f, 4, 0.1);
    sheet.marks = marks_of(grid, &[0, grid.w + 1]);
    sheet.handles = vec![[0.2, 0.1, -0.3], [3.1, 0.8, 0.2]];
    sheet
}

#[test]
fn gradient_is_the_slope_of_the_energy() {
    // The last are so narrow that no particle, or no column, is in the interior.
    for grid in [(8, 11), (2, 5), (7, 2), (2, 2)] {
        slope_of_the_energy(Grid { h: grid.0, w: grid.1 });
    }
}

fn slope_of_the_energy(grid: Grid) {
    let mut sheet = crumpled(grid);
    let grad = sheet.gradient();
    let scale = grad.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    for (k, &grad) in grad.iter().enumerate() {
        let a = sheet.a[k];
        let mut total_at = |offset: f64| {
            sheet.a[k] = a + offset;
            sheet.energy().total()
        };
        // Fourth order: only the rounding of the sums remains, about 1e-10.
        let (near, far) = (1e-4, 2e-4);
        let slope =
            (8.0 * (total_at(near) - total_at(-near)) - (total_at(far) - total_at(-far))) / (12.0 * near);
        sheet.a[k] = a;
        assert!((slope - grad).abs() < 1e-9 * scale, "dL/da[{k}] is {slope}, not {grad}");
    }
}

#[test]
fn gradient_of_straight_and_degenerate_edges_is_finite() {
    let grid = Grid { h: 8, w: 9 };
    let straight = Sheet::shaped(grid, Material::default(), |j, i| [j, i, 0.0]);
    assert!(straight.gradient().iter().all(|g| g.abs() < 1e-12), "a sheet at rest feels no force");
    let point = Sheet::shaped(grid, Material::default(), |_, _| [1.0, 2.0, 3.0]);
    let folded = Sheet::shaped(grid, Material::default(), |j, i| [j % 2.0, i, 0.0]);
    for exponent in 0..=323 {
        let mut shrunk = crumpled(grid);
        let factor = 10f64.powi(-exponent);
        (shrunk.x.iter_mut().chain(&mut shrunk.v).chain(&mut shrunk.a)).for_each(|x| *x *= factor);
        shrunk.marks = marks_of(shrunk.grid, &[]);
        assert!(shrunk.gradient().iter().all(|g| g.is_finite()), "edges of length {factor}");
    }
    for sheet in [point, folded] {
        assert!(sheet.gradient().iter().all(|g| g.is_finite()));
    }
}

#[test]
fn uniformly_stretched_sheared_and_bent_sheets() {
    let grid = Grid { h: 9, w: 14 };
    let (h, w) = (9.0, 14.0);
    let material = Material { stretch: 70.0, shear: 5.0, bend: 2.0, ..Material::PAPER };
    let close = |found: f64, expected: f64| {
        assert!((found - expected).abs() < 1e-12 * expected, "{found} {expected}")
    };

    let stretched = Sheet::shaped(grid, material, |j, i| [1.1 * j, 0.8 * i, 0.0]).energy();
    close(stretched.stretch, 70.0 * (0.1f64.powi(2) + 0.2f64.powi(2)));
    close(1.0 + stretched.shear + stretched.bend, 1.0);

    let t: f64 = 0.3;
    let sheared = Sheet::shaped(grid, material, |j, i| [j + t.sin() * i, t.cos() * i, 0.0]).energy();
    close(sheared.shear, 5.0 * 4.0 * (h - 1.0) * (w - 1.0) / (h * w) * t * t);
    close(1.0 + sheared.stretch + sheared.bend, 1.0);

    // Unit chords of a circle, each turned by t relative to the one before.
    let radius = 0.5 / (t / 2.0).sin();
    let bent =
        Sheet::shaped(grid, material, |j, i| [radius * (t * j).cos(), i, radius * (t * j).sin()]).energy();
    close(bent.bend, 2.0 * h * (w - 2.0) / (h * w) * t * t);
    close(1.0 + bent.stretch + bent.shear, 1.0);
}

#[test]
fn stretch_has_the_largest_and_the_mean() {
    let grid = Grid { h: 9, w: 14 };
    let sheet = Sheet::shaped(grid, Material::default(), |j, i| [1.1 * j, 0.8 * i, 0.0]);
    let (largest, mean) = sheet.with_trial(stretch);
    let (vertical, horizontal) = (8.0 * 14.0, 9.0 * 13.0);
    assert!((largest - 0.1).abs() < 1e-12);
    assert!((mean - (0.2 * vertical + 0.1 * horizontal) / (vertical + horizontal)).abs() < 1e-12);
}

#[test]
fn a_frame_ends_where_its_trial_was() {
    let sheet = crumpled(Grid { h: 8, w: 11 });
    let (mut x, mut v) = (sheet.x.clone(), sheet.v.clone());
    end_frame(sheet.frame(), &sheet.shift(), &mut x, &mut v);
    sheet.with_trial(|trial| {
        (0..x.len()).for_each(|k| assert!((trial.x[k] + trial.shift[k] - x[k]).abs() < 1e-14))
    });
    for k in 0..x.len() {
        // Free particles, too: the velocity is the displacement over this frame.
        assert!((v[k] - (x[k] - sheet.x[k])).abs() < 1e-14);
    }
    let (n, p) = (sheet.grid.particles(), sheet.grid.w + 1);
    assert_eq!([x[p], x[n + p], x[2 * n + p]], sheet.handles[1]);
}
