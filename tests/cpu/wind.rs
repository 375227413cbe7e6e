//! Wind on a flat plate, whose drag is known.

use crate::marks_of;
use crate::noise::noise;
use fnopt::cloth::{Air, Grid, State};
use fnopt::cpu::cloth::add_wind;

const GRID: Grid = Grid { h: 9, w: 12 };

/// Returns the force on the whole sheet, the sum of mass times acceleration.
fn force(f: &[f64]) -> [f64; 3] {
    let n = GRID.particles();
    [0, 1, 2].map(|c| (0..n).map(|p| GRID.mass(p / GRID.w, p % GRID.w) * f[c * n + p]).sum())
}

#[test]
fn drag_of_a_flat_plate() {
    let mut state = State::<f64>::rest(GRID, 1);
    let n = GRID.particles();
    // The plate moves with (0.1, 0.2, 0.5) in a wind of (0.4, 0, -1): relative to it the wind is (0.3, -0.2)
    // along the plate and -1.5 across.
    for (v, speed) in state.v.chunks_mut(n).zip([0.1, 0.2, 0.5]) {
        v.fill(speed);
    }
    let mut f = vec![0.0; 3 * n];
    let air = Air { density: 0.7, drag: 0.3 };
    add_wind((GRID, &marks_of(GRID, &[])), air, [0.4, 0.0, -1.0], (&state.x, &state.v), &mut f);
    let area = 8.0 * 11.0;
    // Friction and pressure per mass of a cell, over one plus themselves: the drag at the end of the frame.
    let (friction, pressure) = (0.3 / 1.3, 0.7 * 1.5 / (1.0 + 0.7 * 1.5));
    let expected = [friction * area * 0.3, -friction * area * 0.2, -pressure * area * 1.5];
    for (found, expected) in force(&f).into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-10, "{found} is not {expected}");
    }
    // Every particle accelerates like the plate, in the corners and on the border, too.
    assert!(f[2 * n..].iter().all(|f| (f + pressure * 1.5).abs() < 1e-12), "{:?}", &f[2 * n..]);
}

/// A frame of drag brings a free plate closer to the air, but never past it, however light it is.
#[test]
fn air_never_turns_a_motion_round() {
    let mut state = State::<f64>::rest(GRID, 1);
    let n = GRID.particles();
    state.v[2 * n..].fill(40.0);
    for density in [1e-3, 1.0, 1e3, 1e6] {
        let mut f = vec![0.0; 3 * n];
        add_wind(
            (GRID, &marks_of(GRID, &[])),
            Air { density, drag: density },
            [0.0; 3],
            (&state.x, &state.v),
            &mut f,
        );
        let after = 40.0 / (1.0 + 40.0 * density);
        for f in &f[2 * n..] {
            assert!((40.0 + f - after).abs() < 1e-12 * 40.0, "{density}: {f}");
        }
    }
}

/// Forces on a sheet whose columns or rows are numbered the other way round are those of the sheet, to rounding.
#[test]
fn mirrored_sheets_feel_mirrored_forces() {
    let n = GRID.particles();
    let mut state = State::<f64>::rest(GRID, 1);
    state.x.iter_mut().zip(noise(3 * n, 13)).for_each(|(x, noise)| *x += 0.4 * noise);
    state.v = noise(3 * n, 14);
    let (air, wind) = (Air { density: 0.7, drag: 0.3 }, [0.4, -0.8, 1.0]);
    let forces = |x: &[f64], v: &[f64]| {
        let mut f = vec![0.0; 3 * n];
        add_wind((GRID, &marks_of(GRID, &[])), air, wind, (x, v), &mut f);
        f
    };
    let straight = forces(&state.x, &state.v);
    let largest = straight.iter().fold(0.0, |most: f64, f| most.max(f.abs()));
    let columns = |p: usize| p / GRID.w * GRID.w + GRID.w - 1 - p % GRID.w;
    let rows = |p: usize| (GRID.h - 1 - p / GRID.w) * GRID.w + p % GRID.w;
    for mirror in [&columns as &dyn Fn(usize) -> usize, &rows] {
        let mirrored =
            |field: &[f64]| (0..3 * n).map(|k| field[k / n * n + mirror(k % n)]).collect::<Vec<_>>();
        let found = mirrored(&forces(&mirrored(&state.x), &mirrored(&state.v)));
        for (found, expected) in found.iter().zip(&straight) {
            assert!((found - expected).abs() < 1e-14 * largest, "{found} is not {expected}");
        }
    }
}

#[test]
fn wind_without_density_and_drag_does_nothing() {
    let state = State::<f64>::rest(GRID, 1);
    let mut f = vec![1.0; 3 * GRID.particles()];
    add_wind((GRID, &marks_of(GRID, &[])), Air::default(), [3.0, 2.0, 1.0], (&state.x, &state.v), &mut f);
    assert!(f.iter().all(|&f| f == 1.0));
}

#[test]
fn a_sheet_without_area_feels_no_wind() {
    let x = vec![2.0; 3 * GRID.particles()];
    let mut f = vec![0.0; x.len()];
    add_wind(
        (GRID, &marks_of(GRID, &[])),
        Air { density: 1.0, drag: 1.0 },
        [3.0, 2.0, 1.0],
        (&x, &vec![0.0; x.len()]),
        &mut f,
    );
    assert!(f.iter().all(|&f| f == 0.0));
}

/// Forces rotate with the sheet, its motion and the wind. The crumpled sheet has normals in all directions.
#[test]
fn forces_rotate_with_everything_else() {
    let n = GRID.particles();
    // A product of rotations about all three axes.
    let rotate = |p: [f64; 3]| {
        let about = |[a, b]: [f64; 2], angle: f64| {
            let (sin, cos) = angle.sin_cos();
            [cos * a - sin * b, sin * a + cos * b]
        };
        let [x, y] = about([p[0], p[1]], 0.7);
        let [y, z] = about([y, p[2]], -1.1);
        let [z, x] = about([z, x], 2.3);
        [x, y, z]
    };
    let rotated = |field: &[f64]| {
        let mut rotated = field.to_vec();
        for p in 0..n {
            let at = rotate([0, 1, 2].map(|c| field[c * n + p]));
            (0..3).for_each(|c| rotated[c * n + p] = at[c]);
        }
        rotated
    };
    let mut state = State::<f64>::rest(GRID, 1);
    state.x.iter_mut().zip(noise(3 * n, 11)).for_each(|(x, noise)| *x += 0.4 * noise);
    state.v = noise(3 * n, 12);
    let (air, wind) = (Air { density: 0.7, drag: 0.3 }, [0.4, -0.8, 1.0]);
    let [mut straight, mut around] = [vec![0.0; 3 * n], vec![0.0; 3 * n]];
    add_wind((GRID, &marks_of(GRID, &[])), air, wind, (&state.x, &state.v), &mut straight);
    add_wind(
        (GRID, &marks_of(GRID, &[])),
        air,
        rotate(wind),
        (&rotated(&state.x), &rotated(&state.v)),
        &mut around,
    );
    let largest = straight.iter().fold(0.0, |most: f64, f| most.max(f.abs()));
    for (found, expected) in around.iter().zip(rotated(&straight)) {
        assert!((found - expected).abs() < 1e-12 * largest, "{found} is not {expected}");
    }
}
