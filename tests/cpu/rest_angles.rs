//! Sheets that are folded, pleated or curled at rest.

use crate::noise::noise;
use fnopt::Device;
use fnopt::cloth::{Cloth, Control, Grid, Material, Model, RestAngles, State, Weave};
use fnopt::cpu::cloth::CurvatureRows;
use fnopt::cpu::{Objective, Solver, Track};
use fnopt::eval::median_gap;
use fnopt::scene::{Crease, CreaseLine, RestShape, Scene, Start};
use fnopt::sim::Optimizer;
use glam::DVec3;
use std::ops::ControlFlow;

/// That of the paper in frames ten times as long, which damp its swings.
const MATERIAL: Material =
    Material { stretch: 1e5, shear: 800.0, bend: 50.0, weave: Weave { bend: [0.6, 1.4], ..Weave::EVEN } };

fn angles(grid: Grid, of: impl Fn(usize, usize) -> [f64; 2]) -> RestAngles {
    let angles: Vec<[f64; 2]> = (0..grid.particles()).map(|p| of(p / grid.w, p % grid.w)).collect();
    RestAngles::new(grid, &angles, "a test", "angles").unwrap()
}

fn place(x: &[f64], n: usize, p: usize) -> DVec3 {
    DVec3::new(x[p], x[n + p], x[2 * n + p])
}

/// Returns the angle by which a sheet turns at a particle along an axis, positive towards its front.
fn turn(grid: Grid, x: &[f64], p: usize, axis: usize) -> f64 {
    let n = grid.particles();
    let along = if axis == 0 { grid.w } else { 1 };
    let across = if axis == 0 { 1 } else { grid.w };
    let [before, after] = [place(x, n, p) - place(x, n, p - along), place(x, n, p + along) - place(x, n, p)];
    let other = if axis == 0 { p % grid.w } else { p / grid.w };
    let difference = if other == 0 {
        place(x, n, p + across) - place(x, n, p)
    } else {
        place(x, n, p) - place(x, n, p - across)
    };
    // The front is that of the triangles of the grid.
    let front = if axis == 0 { before.cross(difference) } else { difference.cross(before) };
    let sine = (after - before).dot(front);
    before.angle_between(after).copysign(sine)
}

/// Returns where a sheet comes to rest without any other force, by Newton's method.
fn shape(grid: Grid, cloth: Cloth, frames: usize) -> Vec<f64> {
    let model = Model { grid, cloths: vec![cloth] };
    let mut state = State::<f64>::rest(grid, 1);
    let mut newton = Solver::<f64>::new(&model, &Optimizer::newton(), 1).unwrap();
    for _ in 0..frames {
        newton.step(&mut state, &Control::default());
    }
    state.x
}

#[test]
fn the_front_is_that_of_the_triangles() {
    let grid = Grid { h: 8, w: 9 };
    let (n, x) = (grid.particles(), State::<f64>::rest(grid, 1).x);
    let [a, b, c] = grid.faces()[0].map(|p| place(&x, n, p as usize));
    let front = (b - a).cross(c - a).normalize();
    for axis in [0, 1] {
        let p = 3 * grid.w + 4;
        let mut lifted = x.clone();
        let after = if axis == 0 { p + grid.w } else { p + 1 };
        (0..3).for_each(|c| lifted[c * n + after] += 0.1 * front[c]);
        assert!(turn(grid, &lifted, p, axis) > 0.09, "axis {axis}");
    }
}

/// Gradient and curvature of the energy are its differences, and the couples neither push nor turn a cylinder as a whole.
#[test]
fn couples_are_the_derivatives_of_their_energy() {
    let grid = Grid { h: 9, w: 8 };
    let n = grid.particles();
    let given = noise(2 * n, 6);
    let rest = angles(grid, |i, j| [given[2 * (i * grid.w + j)], 2.0 * given[2 * (i * grid.w + j) + 1]]);
    let cloth = Cloth { material: MATERIAL, rest_angles: Some(rest), handles: vec![11], ..Cloth::default() };
    let model = Model { grid, cloths: vec![cloth] };
    let mut objective = Objective::<f64>::new(&model);
    let mut state = State::<f64>::rest(grid, 1);
    for (x, d) in state.x.iter_mut().zip(noise(3 * n, 7)) {
        *x += 0.4 * d;
    }
    state.v = noise(3 * n, 8).iter().map(|v| 0.2 * v).collect();
    let control = Control { handles: vec![place(&state.x, n, 11).to_array()], ..Control::default() };
    objective.begin_frame(&state, &control);
    let free = |k: usize| k % n != 11;
    let direction = |seed: u64| -> Vec<f64> {
        noise(3 * n, seed).into_iter().enumerate().map(|(k, d)| if free(k) { d } else { 0.0 }).collect()
    };
    let start: Vec<f64> = direction(9).iter().map(|a| 0.3 * a).collect();
    let directions = [direction(10), direction(11)];
    let step = 1e-5;
    let mut at = |moves: [f64; 2]| {
        let a: Vec<f64> = (0..3 * n)
            .map(|k| start[k] + moves[0] * step * directions[0][k] + moves[1] * step * directions[1][k])
            .collect();
        objective.set_accelerations(&a);
        objective.evaluate(&state, &control);
        let model = objective.local_model(&state, 0, (&directions.concat(), &mut CurvatureRows::new(grid)));
        assert!((model.energy.bend - objective.energy(&state, 0).bend).abs() < 1e-9 * model.energy.bend);
        let along = |d: &[f64]| objective.grad().iter().zip(d).map(|(g, d)| g * d).sum::<f64>();
        (objective.energy(&state, 0).total(), directions.each_ref().map(|d| along(d)), model.curvature)
    };
    let (_, slopes, curvature) = at([0.0; 2]);
    for k in 0..2 {
        let unit = |sign: f64| if k == 0 { [sign, 0.0] } else { [0.0, sign] };
        let (forth, back) = (at(unit(1.0)), at(unit(-1.0)));
        let slope = (forth.0 - back.0) / (2.0 * step);
        assert!((slope - slopes[k]).abs() < 1e-6 * slopes[k].abs(), "{slope}, not {}", slopes[k]);
        for l in 0..2 {
            let curved = (forth.1[l] - back.1[l]) / (2.0 * step);
            let scale = (curvature[k][k] * curvature[l][l]).sqrt();
            assert!(
                (curved - curvature[k][l]).abs() < 1e-6 * scale,
                "{k} {l}: {curved}, not {}",
                curvature[k][l]
            );
        }
    }
}

/// On a cylinder, whose axis the couples turn about, they add up to nothing.
#[test]
fn couples_neither_push_nor_turn_a_cylinder() {
    let grid = Grid { h: 9, w: 8 };
    let n = grid.particles();
    for axis in [0, 1] {
        let count = [grid.h, grid.w][axis];
        let (mut place_at, mut heading, mut places) = ([0.0, 0.0], 0.3_f64, vec![[0.0, 0.0]]);
        for turn in &noise(count, 5)[1..] {
            place_at = [place_at[0] + heading.cos(), place_at[1] + heading.sin()];
            places.push(place_at);
            heading += turn;
        }
        let mut state = State::<f64>::rest(grid, 1);
        for p in 0..n {
            let (along, across) = if axis == 0 { (p / grid.w, p % grid.w) } else { (p % grid.w, p / grid.w) };
            [state.x[p], state.x[n + p], state.x[2 * n + p]] =
                [places[along][0], across as f64, places[along][1]];
        }
        let given = noise(n, 6);
        let rest = angles(grid, |i, j| if axis == 0 { [given[i], 0.0] } else { [0.0, given[j]] });
        let force = |rest_angles: Option<RestAngles>| {
            let cloth = Cloth { material: MATERIAL, rest_angles, ..Cloth::default() };
            let mut objective = Objective::<f64>::new(&Model { grid, cloths: vec![cloth] });
            objective.begin_frame(&state, &Control::default());
            objective.evaluate(&state, &Control::default());
            objective.grad().to_vec()
        };
        let couples: Vec<f64> = force(Some(rest)).iter().zip(force(None)).map(|(a, b)| a - b).collect();
        let total: DVec3 = (0..n).map(|p| place(&couples, n, p)).sum();
        let torque: DVec3 = (0..n).map(|p| place(&state.x, n, p).cross(place(&couples, n, p))).sum();
        let size = (0..n).map(|p| place(&couples, n, p).length()).sum::<f64>();
        assert!(size > 1.0 && total.length() < 1e-11 * size, "axis {axis}: {total} of {size}");
        assert!(torque.length() < 1e-10 * size, "axis {axis}: {torque} of {size}");
    }
}

/// A sheet of even rest angles along one axis is a cylinder, whatever its grid.
#[test]
fn curled_sheets_become_cylinders() {
    for grid in [Grid { h: 9, w: 24 }, Grid { h: 17, w: 12 }, Grid { h: 24, w: 24 }] {
        for (axis, angle) in [(0, 0.15), (1, -0.1)] {
            let rest = angles(grid, |_, _| if axis == 0 { [angle, 0.0] } else { [0.0, angle] });
            let x =
                shape(grid, Cloth { material: MATERIAL, rest_angles: Some(rest), ..Cloth::default() }, 800);
            let mut worst = [0.0_f64; 2];
            for p in 0..grid.particles() {
                let (i, j) = (p / grid.w, p % grid.w);
                if (1..grid.h - 1).contains(&i) && (1..grid.w - 1).contains(&j) {
                    worst[axis] = worst[axis].max((turn(grid, &x, p, axis) / angle - 1.0).abs());
                    worst[1 - axis] = worst[1 - axis].max(turn(grid, &x, p, 1 - axis).abs());
                }
            }
            println!("{grid}, axis {axis}: {worst:?}");
            assert!(worst[axis] < 0.01 && worst[1 - axis] < 1e-3, "{grid}, axis {axis}: {worst:?}");
        }
    }
}

/// A free sheet with creases folds to their angles and is flat between them.
#[test]
fn creases_turn_by_their_angle() {
    let grid = Grid { h: 24, w: 16 };
    let fold = |i: usize| match i {
        6 => 100.0_f64.to_radians(),
        15 => -60.0_f64.to_radians(),
        _ => 0.0,
    };
    let rest = angles(grid, |i, _| [fold(i), 0.0]);
    let cloth = Cloth { material: MATERIAL, rest_angles: Some(rest), ..Cloth::default() };
    let x = shape(grid, cloth.clone(), 200);
    for p in 0..grid.particles() {
        let (i, j) = (p / grid.w, p % grid.w);
        if (1..grid.h - 1).contains(&i) {
            let found = turn(grid, &x, p, 0);
            assert!((found - fold(i)).abs() < 0.02, "({i}, {j}): {found}, not {}", fold(i));
        }
    }
}

/// What the optimizers leave of the gap of a pleated sheet that swings on a corner.
#[test]
fn optimizers_see_the_couples() {
    let mut scene = Scene::released();
    scene.regrid(Grid { h: 32, w: 24 }).unwrap();
    scene.start = Start::Flat;
    let pleat = |k: usize| Crease {
        line: CreaseLine::U((k as f64 + 0.5) / 5.0),
        angle_deg: if k.is_multiple_of(2) { 90.0 } else { -90.0 },
    };
    scene.rest_shape = RestShape { creases: (0..5).map(pleat).collect(), curvature_per_m: [0.0, 2.0] };
    let setup = scene.setup().unwrap();
    let controls = (1..90).map(|frame| setup.control(frame));
    let track = Track::new(&setup.model, setup.start.clone(), controls).unwrap();
    assert_eq!(track.unconverged(), 0);
    for (optimizer, iterations, most) in [
        (Optimizer::spectral(), 10, 0.01),
        (Optimizer::spectral(), 20, 0.001),
        (Optimizer::quasi_newton(), 40, 0.1),
    ] {
        let tick = || ControlFlow::Continue(());
        let gap = median_gap(&track, (&optimizer, iterations), &Device::Cpu, tick).unwrap().unwrap();
        println!("{} {iterations}: {:.4} %", optimizer.name(), 100.0 * gap);
        assert!(gap < most, "{} {iterations}: {gap}", optimizer.name());
    }
}

/// Without couples nothing changes, bit for bit; with those of one sign the sheet is the mirror image of the other's.
#[test]
fn no_angles_are_none_and_signs_are_mirror_images() {
    let grid = Grid { h: 12, w: 10 };
    let run = |rest_angles: Option<RestAngles>| {
        let cloth = Cloth { material: MATERIAL, rest_angles, handles: vec![0, 9], ..Cloth::default() };
        let model = Model { grid, cloths: vec![cloth] };
        let mut state = State::<f64>::rest(grid, 1);
        let n = grid.particles();
        let handles = [0, 9].map(|p: usize| [0, 1, 2].map(|c| state.x[c * n + p])).to_vec();
        let control = Control { handles, ..Control::default() };
        let mut solver = Solver::<f64>::new(&model, &Optimizer::spectral(), 10).unwrap();
        (0..30).for_each(|_| drop(solver.step(&mut state, &control)));
        state.x
    };
    assert_eq!(run(None), run(Some(angles(grid, |_, _| [0.0; 2]))));
    let [forth, back] =
        [0.3, -0.3].map(|angle| run(Some(angles(grid, |i, _| [if i == 5 { angle } else { 0.0 }, 0.0]))));
    let n = grid.particles();
    assert!(forth[2 * n..].iter().any(|z| z.abs() > 0.1));
    for (k, (a, b)) in forth.iter().zip(&back).enumerate() {
        let mirrored = if k / n == 2 { -b } else { *b };
        assert!((a - mirrored).abs() < 1e-9, "{k}: {a}, not {mirrored}");
    }
}

#[test]
fn angles_that_no_sheet_has_are_refused() {
    let grid = Grid { h: 8, w: 8 };
    let refused =
        |angles: &[[f64; 2]]| RestAngles::new(grid, angles, "a test", "angles").unwrap_err().to_string();
    assert!(refused(&[[0.0; 2]; 3]).contains("64 pairs"));
    for wrong in [f64::NAN, std::f64::consts::PI, -4.0] {
        let mut angles = vec![[0.0; 2]; 64];
        angles[9][1] = wrong;
        let error = refused(&angles);
        assert!(error.contains("-180 and 180") && error.contains("(1, 1)"), "{error}");
    }
    let other = Some(RestAngles::new(grid, &[[0.0; 2]; 64], "a test", "angles").unwrap());
    let model =
        Model { grid: Grid { h: 8, w: 9 }, cloths: vec![Cloth { rest_angles: other, ..Cloth::default() }] };
    assert!(model.check().unwrap_err().to_string().contains("rest angles of cloth 0"));
}
