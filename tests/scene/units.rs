//! Units: moduli, masses and wind against elasticity and mechanics.

use crate::common::distance;
use fnopt::cloth::{Grid, Material, Repulsion};
use fnopt::scene::{Moduli, RepulsionSettings, Units, UpAxis};

/// Returns the energy of section 3 of one cloth, without inertia and external work; `x` has shape [H][W].
fn energy(x: &[Vec<[f64; 3]>], k: Material) -> f64 {
    let (h, w) = (x.len(), x[0].len());
    let sub = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|c| a[c] - b[c]) };
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| a[c] * b[c]).sum::<f64>();
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let angle = |a, b| dot(cross(a, b), cross(a, b)).sqrt().atan2(dot(a, b));
    let ev = |i: usize, j: usize| sub(x[i + 1][j], x[i][j]);
    let eh = |i: usize, j: usize| sub(x[i][j + 1], x[i][j]);
    let (mut stretch, mut shear, mut bend) = (0.0, 0.0, 0.0);
    for i in 0..h {
        for j in 0..w {
            let off = |e: [f64; 3]| (dot(e, e).sqrt() - 1.0).powi(2);
            if i + 1 < h {
                stretch += off(ev(i, j)) / ((h - 1) * w) as f64;
            }
            if j + 1 < w {
                stretch += off(eh(i, j)) / (h * (w - 1)) as f64;
            }
            if i + 1 < h && j + 1 < w {
                for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    shear += (angle(ev(i, j + a), eh(i + b, j)) - std::f64::consts::FRAC_PI_2).powi(2);
                }
            }
            if i + 2 < h {
                bend += angle(ev(i, j), ev(i + 1, j)).powi(2);
            }
            if j + 2 < w {
                bend += angle(eh(i, j), eh(i, j + 1)).powi(2);
            }
        }
    }
    k.stretch * stretch + (k.shear * shear + k.bend * bend) / (h * w) as f64
}

/// Deforms a sheet of given moduli uniformly and compares the energy of section 3, in joules, with
/// elasticity.
#[test]
fn moduli_are_those_of_a_stretched_a_sheared_and_a_bent_sheet() {
    let moduli = Moduli {
        stretch_modulus: 900.0,
        shear_modulus: 40.0,
        bending_stiffness: 2e-4,
        weave: fnopt::cloth::Weave::EVEN,
    };
    for (h, w, side) in [(300, 240, 1.0), (400, 500, 0.6), (12, 12, 1.0), (8, 20, 0.3)] {
        let grid = Grid { h, w };
        let length = side / (h - 1) as f64;
        let units = Units { length_m: length, frame_time_s: 1.0 / 50.0, areal_mass_kg_m2: 0.2 };
        let k = units.material(grid, moduli);
        let area = side * length * (w - 1) as f64;
        let sheet = |place: &dyn Fn(f64, f64) -> [f64; 3]| -> Vec<Vec<[f64; 3]>> {
            (0..h).map(|i| (0..w).map(|j| place(i as f64, j as f64)).collect()).collect()
        };
        let joules = |x: &[Vec<[f64; 3]>]| units.energy_j(energy(x, k), h * w);
        let (strain, curvature) = (1e-4, 2.0);
        let stretched = sheet(&|i, j| [j, i * (1.0 + strain), 0.0]);
        let sheared = sheet(&|i, j| [j + strain * i, i, 0.0]);
        // Points on an arc with chords of one edge; the angle between chords is curvature times length.
        let turn = curvature * length;
        let radius = 0.5 / (turn / 2.0).sin();
        let bent = sheet(&|i, j| [radius * (turn * j).sin(), i, radius * (1.0 - (turn * j).cos())]);
        // Its ends are straight, and the one coefficient is the mean of two directions.
        let beside = |count: usize| count as f64 / (count - 1) as f64;
        let bends = (w - 2) as f64 / (w - 1) as f64 * (beside(h) / beside(w)).sqrt();
        let cases = [
            ("stretch", joules(&stretched), 0.5 * moduli.stretch_modulus * strain * strain * area),
            ("shear", joules(&sheared), 0.5 * moduli.shear_modulus * strain * strain * area),
            ("bend", joules(&bent), 0.5 * moduli.bending_stiffness * curvature * curvature * area * bends),
        ];
        for (name, found, expected) in cases {
            println!("{h}x{w} {name}: {:.5}", found / expected);
            assert!((found / expected - 1.0).abs() < 1e-3, "{name} at {h}x{w}: {found} J, not {expected} J");
        }
        let back = units.moduli(grid, k);
        assert!((back.bending_stiffness / moduli.bending_stiffness - 1.0).abs() < 1e-14);
    }
}

#[test]
fn units_go_both_ways() {
    let units = Units { length_m: 1.0 / 31.0, frame_time_s: 1.0 / 60.0, areal_mass_kg_m2: 0.187 };
    let v = [1.0, -2.0, 3.0];
    assert!(distance(units.position_m(units.position(v)), v) < 1e-14);
    assert!(distance(units.velocity_m_s(units.velocity(v)), v) < 1e-14);
    assert!(distance(units.acceleration_m_s2(units.acceleration(v)), v) < 1e-14);
    assert_eq!(units.position([1.0, 0.0, 0.0])[0], 31.0);
    assert!((units.acceleration([3600.0, 0.0, 0.0])[0] - 31.0).abs() < 1e-12);
    let (density, drag) = units.air_si(units.air(1.2, 0.3));
    assert!((density - 1.2).abs() < 1e-14 && (drag - 0.3).abs() < 1e-14);
    for up in [UpAxis::Y, UpAxis::Z] {
        assert_eq!(up.from_z_up(up.to_z_up(v)), v);
        assert_eq!(up.to_z_up(up.down(1.0)), [0.0, 0.0, -1.0]);
    }
    assert_eq!(UpAxis::Y.to_z_up([1.0, 2.0, 3.0]), [1.0, -3.0, 2.0]);
}

/// Two particles, each with the mass of a cell, repel each other. The energy per mass that they lose as they
/// part becomes their speed.
#[test]
fn the_same_repulsion_parts_layers_as_fast_on_every_grid() {
    for (length_m, frame_time_s) in [(1.0 / 31.0, 1.0 / 60.0), (0.01, 1.0 / 60.0), (0.01, 0.005)] {
        let units = Units { length_m, frame_time_s, areal_mass_kg_m2: 0.3 };
        let Repulsion { strength, distance } =
            units.repulsion(RepulsionSettings { strength: 2.0, distance: 0.8 });
        // Both orders of the pair, from half the distance: 2 k log 4 = 2 (v^2 / 2), in edges and frames.
        let v = (2.0 * strength * 4f64.ln()).sqrt();
        let speed = units.velocity_m_s([v, 0.0, 0.0])[0];
        assert!((speed - (2.0 * 2.0 * 4f64.ln()).sqrt()).abs() < 1e-12 && distance == 0.8, "{speed} m/s");
    }
}

#[test]
fn the_same_wind_accelerates_a_cell_by_its_physics() {
    let units = Units { length_m: 0.02, frame_time_s: 0.01, areal_mass_kg_m2: 0.3 };
    let air = units.air(1.2, 0.5);
    // A free cell perpendicular to a wind of 3 m/s along x, and one parallel to it.
    let u = units.velocity([3.0, 0.0, 0.0])[0];
    let across = units.acceleration_m_s2([air.density * u * u, 0.0, 0.0])[0];
    assert!((across - 1.2 * 9.0 / 0.3).abs() < 1e-12);
    let along = units.acceleration_m_s2([air.drag * u, 0.0, 0.0])[0];
    assert!((along - 0.5 * 3.0 / 0.3).abs() < 1e-12);
}
