//! Sheets of given moduli in equilibrium, against closed forms, on six grids.

use fnopt::cloth::{Cloth, Control, Grid, Model, State};
use fnopt::cpu::Reference;
use fnopt::scene::{Moduli, Units};

/// Side of the sheet \[m\].
const SIDE: f64 = 1.0;
/// Mass per area [kg/m^2].
const MASS: f64 = 0.2;

/// Returns where a flat sheet in the plane of x and y, whose first `held` rows are held, comes to rest under a
/// gravity [m/s^2]: displacements \[m\], shape [3, H, W]. A frame of 100 s leaves inertia no part in the energy.
fn at_rest(grid: Grid, moduli: Moduli, gravity: [f64; 3], held: usize) -> Vec<f64> {
    let units = Units { length_m: SIDE / (grid.h - 1) as f64, frame_time_s: 100.0, areal_mass_kg_m2: MASS };
    let cloth = Cloth {
        material: units.material(grid, moduli),
        gravity: units.acceleration(gravity),
        handles: (0..held * grid.w).collect(),
        ..Cloth::default()
    };
    let start = State::<f64>::rest(grid, 1);
    let n = grid.particles();
    let handles = cloth.handles.iter().map(|&p| [0, 1, 2].map(|c| start.x[c * n + p])).collect();
    let control = Control { handles, ..Control::default() };
    let force = cloth.gravity.iter().map(|g| g * g).sum::<f64>().sqrt();
    let mut reference = Reference::new(&Model { grid, cloths: vec![cloth] }).unwrap();
    // The forces add up to the 1/sqrt(H W) of this.
    reference.tolerance = 1e-6 * force;
    let minimum = reference.minimise(&start, &control, &vec![0.0; 3 * n]);
    assert!(minimum.converged, "{grid}: |gradient| {:e} of {force:e}", minimum.gradient());
    minimum.a.iter().map(|a| a * units.length_m).collect()
}

/// Returns the mean displacement of the last row along an axis.
fn of_last_row(grid: Grid, displacements: &[f64], axis: usize) -> f64 {
    let first = axis * grid.particles() + (grid.h - 1) * grid.w;
    displacements[first..][..grid.w].iter().sum::<f64>() / grid.w as f64
}

fn squares() -> impl Iterator<Item = Grid> {
    [12, 16, 24, 32, 48, 64].map(|side| Grid { h: side, w: side }).into_iter()
}

fn assert_near(what: &str, found: f64, expected: f64) {
    println!("{what}: {found:.6} m, {:+.3} %", 100.0 * (found / expected - 1.0));
    assert!((found / expected - 1.0).abs() < 5e-3, "{what}: {found} m, not {expected} m");
}

/// A sheet that hangs from its edge is longer by `rho g L^2 / (2 Y)`.
#[test]
fn hanging_sheets_stretch_as_their_modulus_says() {
    let moduli = Moduli { stretch_modulus: 64.2, shear_modulus: 20.0, bending_stiffness: 1e-4 };
    for grid in squares().chain([Grid { h: 24, w: 40 }, Grid { h: 33, w: 9 }]) {
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.0, 9.81, 0.0], 1), 1);
        assert_near(&format!("sag {grid}"), found, MASS * 9.81 * SIDE * SIDE / (2.0 * 64.2));
    }
}

/// A sheet that hardly stretches, pulled sideways, shears by `rho g L^2 / (2 G)`. It also bends in its plane, as a beam
/// does, by `3 G / Y` of that if it is square. It is too stiff to buckle.
#[test]
fn sheets_pulled_sideways_shear_as_their_modulus_says() {
    let moduli = Moduli { stretch_modulus: 1e5, shear_modulus: 10.0, bending_stiffness: 1.0 };
    for grid in squares().chain([Grid { h: 24, w: 40 }]) {
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.01, 0.0, 0.0], 1), 0);
        assert_near(&format!("shear {grid}"), found, MASS * 0.01 * SIDE * SIDE / (2.0 * 10.0));
    }
}

/// A sheet clamped at one edge droops by `rho g L^4 / (8 D)`. Two rows are held, which clamps it half an edge
/// after the first of them.
#[test]
fn clamped_sheets_droop_as_their_stiffness_says() {
    let moduli = Moduli { stretch_modulus: 1e4, shear_modulus: 1e3, bending_stiffness: 1e-2 };
    for grid in squares() {
        let free = SIDE * (1.0 - 0.5 / (grid.h - 1) as f64);
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.0, 0.0, 1e-3], 2), 2);
        assert_near(&format!("droop {grid}"), found, MASS * 1e-3 * free.powi(4) / (8.0 * 1e-2));
    }
}
