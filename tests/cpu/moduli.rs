//! Sheets of given moduli in equilibrium, against closed forms, on six grids.

use fnopt::cloth::{Cloth, Control, Grid, Map, Material, Model, State, Weave};
use fnopt::cpu::Reference;
use fnopt::scene::{Moduli, Units};

/// Side of the sheet \[m\].
const SIDE: f64 = 1.0;
/// Mass per area [kg/m^2].
const MASS: f64 = 0.2;

/// Returns where a flat sheet in the plane of x and y, whose first `held` rows are held, comes to rest under a
/// gravity [m/s^2]: displacements \[m\], shape [3, H, W]. A frame of 100 s leaves inertia no part in the energy.
fn at_rest(grid: Grid, moduli: Moduli, gravity: [f64; 3], held: usize) -> Vec<f64> {
    let handles = (0..held * grid.w).collect();
    at_rest_of(grid, moduli, gravity, Cloth { handles, ..Cloth::default() })
}

/// As [`at_rest`], with the handles, the maps and the damping of this cloth.
fn at_rest_of(grid: Grid, moduli: Moduli, gravity: [f64; 3], cloth: Cloth) -> Vec<f64> {
    let units = Units { length_m: SIDE / (grid.h - 1) as f64, frame_time_s: 100.0, areal_mass_kg_m2: MASS };
    let cloth =
        Cloth { material: units.material(grid, moduli), gravity: units.acceleration(gravity), ..cloth };
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
    let moduli =
        Moduli { stretch_modulus: 64.2, shear_modulus: 20.0, bending_stiffness: 1e-4, weave: Weave::EVEN };
    for grid in squares().chain([Grid { h: 8, w: 8 }, Grid { h: 24, w: 40 }, Grid { h: 33, w: 9 }]) {
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.0, 9.81, 0.0], 1), 1);
        assert_near(&format!("sag {grid}"), found, MASS * 9.81 * SIDE * SIDE / (2.0 * 64.2));
    }
}

/// Returns the mean displacement of the last column along an axis.
fn of_last_column(grid: Grid, displacements: &[f64], axis: usize) -> f64 {
    let of_axis = &displacements[axis * grid.particles()..][..grid.particles()];
    of_axis.chunks_exact(grid.w).map(|row| row[grid.w - 1]).sum::<f64>() / grid.h as f64
}

/// Returns the particles of the first columns.
fn columns(grid: Grid, count: usize) -> Vec<usize> {
    (0..grid.particles()).filter(|p| p % grid.w < count).collect()
}

/// Warp and weft: a sheet that hangs from its first row stretches as its warp does, one that hangs from its first column as
/// its weft.
#[test]
fn warp_and_weft_stretch_by_themselves() {
    let weave = Weave { stretch: [1.6, 0.4], ..Weave::EVEN };
    let moduli = Moduli { stretch_modulus: 64.2, shear_modulus: 20.0, bending_stiffness: 1e-4, weave };
    let sag = |modulus: f64| MASS * 9.81 * SIDE * SIDE / (2.0 * modulus);
    for grid in [Grid { h: 24, w: 24 }, Grid { h: 48, w: 48 }] {
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.0, 9.81, 0.0], 1), 1);
        assert_near(&format!("warp {grid}"), found, sag(1.6 * 64.2));
        let cloth = Cloth { handles: columns(grid, 1), ..Cloth::default() };
        let found = of_last_column(grid, &at_rest_of(grid, moduli, [9.81, 0.0, 0.0], cloth), 0);
        assert_near(&format!("weft {grid}"), found, sag(0.4 * 64.2));
    }
}

#[test]
fn warp_and_weft_bend_by_themselves() {
    let weave = Weave { bend: [0.5, 1.5], ..Weave::EVEN };
    let moduli = Moduli { stretch_modulus: 1e4, shear_modulus: 1e3, bending_stiffness: 1e-2, weave };
    let grid = Grid { h: 32, w: 32 };
    let free = SIDE * (1.0 - 0.5 / 31.0);
    let droop = |stiffness: f64| MASS * 1e-3 * free.powi(4) / (8.0 * stiffness);
    let found = of_last_row(grid, &at_rest(grid, moduli, [0.0, 0.0, 1e-3], 2), 2);
    assert_near("warp", found, droop(0.5e-2));
    let cloth = Cloth { handles: columns(grid, 2), ..Cloth::default() };
    let found = of_last_column(grid, &at_rest_of(grid, moduli, [0.0, 0.0, 1e-3], cloth), 2);
    assert_near("weft", found, droop(1.5e-2));
}

/// A sheet whose density, or stiffness, grows with the depth s as 1 + s / L.
#[test]
fn maps_of_density_and_stiffness_are_those_of_the_sheet() {
    let moduli =
        Moduli { stretch_modulus: 64.2, shear_modulus: 20.0, bending_stiffness: 1e-4, weave: Weave::EVEN };
    let unit = MASS * 9.81 * SIDE * SIDE / 64.2;
    for grid in [Grid { h: 24, w: 24 }, Grid { h: 49, w: 33 }] {
        let factors: Vec<f64> =
            (0..grid.particles()).map(|p| 1.0 + (p / grid.w) as f64 / (grid.h - 1) as f64).collect();
        let map = || Some(Map::new(grid, &factors, "a test", "map").unwrap());
        let hung = || Cloth { handles: (0..grid.w).collect(), ..Cloth::default() };
        let sag = |cloth| of_last_row(grid, &at_rest_of(grid, moduli, [0.0, 9.81, 0.0], cloth), 1);
        assert_near(&format!("density {grid}"), sag(Cloth { density: map(), ..hung() }), 5.0 / 6.0 * unit);
        let soft = 2.0 * 2f64.ln() - 1.0;
        assert_near(&format!("stiffness {grid}"), sag(Cloth { stiffness: map(), ..hung() }), soft * unit);
    }
}

/// One frame of a wave along the columns. With the eigenvalue l of stretch over inertia and the damping t, the step solves
/// `a + l ((1 + t) (u + a) - t u) = 0`.
#[test]
fn damping_resists_the_change_of_a_frame() {
    let grid = Grid { h: 17, w: 8 };
    let (n, stretch) = (grid.particles(), 3.0);
    let material = Material { stretch, shear: 0.0, bend: 0.0, ..Material::PAPER };
    let height = (grid.h - 1) as f64;
    let phase = std::f64::consts::PI / height;
    let mut state = State::<f64>::rest(grid, 1);
    let wave: Vec<f64> = (0..n).map(|p| 1e-3 * (phase * (p / grid.w) as f64).cos()).collect();
    state.x[n..2 * n].iter_mut().zip(&wave).for_each(|(y, u)| *y += u);
    let l = 2.0 * stretch * grid.h as f64 / height * (2.0 - 2.0 * phase.cos());
    for damping in [0.0, 0.5, 4.0] {
        let cloth = Cloth { material, damping, ..Cloth::default() };
        let mut reference = Reference::new(&Model { grid, cloths: vec![cloth] }).unwrap();
        reference.tolerance = 1e-14;
        let minimum = reference.minimise(&state, &Control::default(), &vec![0.0; 3 * n]);
        let factor = -l / (1.0 + l * (1.0 + damping));
        // Inner columns: those at the borders have half the mass.
        for p in (0..n).filter(|p| (1..grid.w - 1).contains(&(p % grid.w))) {
            let (found, expected) = (minimum.a[n + p], factor * wave[p]);
            assert!((found - expected).abs() < 1e-9, "damping {damping}: {found}, not {expected}");
        }
    }
}

/// A sheet that hardly stretches, pulled sideways, shears by `rho g L^2 / (2 G)`. It also bends in its plane, as a beam
/// does, by `3 G / Y` of that if it is square. It is too stiff to buckle.
#[test]
fn sheets_pulled_sideways_shear_as_their_modulus_says() {
    let moduli =
        Moduli { stretch_modulus: 1e5, shear_modulus: 10.0, bending_stiffness: 1.0, weave: Weave::EVEN };
    for grid in squares().chain([Grid { h: 24, w: 40 }]) {
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.01, 0.0, 0.0], 1), 0);
        assert_near(&format!("shear {grid}"), found, MASS * 0.01 * SIDE * SIDE / (2.0 * 10.0));
    }
}

/// A sheet clamped at one edge droops by `rho g L^4 / (8 D)`. Two rows are held, which clamps it half an edge
/// after the first of them.
#[test]
fn clamped_sheets_droop_as_their_stiffness_says() {
    let moduli =
        Moduli { stretch_modulus: 1e4, shear_modulus: 1e3, bending_stiffness: 1e-2, weave: Weave::EVEN };
    for grid in squares() {
        let free = SIDE * (1.0 - 0.5 / (grid.h - 1) as f64);
        let found = of_last_row(grid, &at_rest(grid, moduli, [0.0, 0.0, 1e-3], 2), 2);
        assert_near(&format!("droop {grid}"), found, MASS * 1e-3 * free.powi(4) / (8.0 * 1e-2));
    }
}
