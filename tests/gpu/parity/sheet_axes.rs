//! `sheet_axes` against its formula.

use super::cloth::{constants, crumpled, field, iterate, model, upload};
use crate::common::{assert_close, cases, context, device, poisoned, read, run};
use fnopt::cloth::{Cloth, Model};
use fnopt::kernels::cloth::SheetAxes;
use fnopt::kernels::cloth::sheet_axes::AXES;
use fnopt::kernels::optim::directions;
use fnopt::settings::{ARCHING, HANDLE_REACH, HANDLE_SHARE, WARMEST};

type Vector = [f64; 3];

fn unit(v: Vector) -> Option<Vector> {
    let length = v.iter().map(|v| v * v).sum::<f64>().sqrt();
    (length > 1e-12 && length.is_finite()).then(|| v.map(|v| v / length))
}

fn cross(u: Vector, w: Vector) -> Vector {
    [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]]
}

fn sum(u: Vector, w: Vector, factor: f64) -> Vector {
    [0, 1, 2].map(|c| u[c] + factor * w[c])
}

/// Positions of a particle and its neighbours, itself for one that the cloth doesn't have: before and behind it along
/// either axis.
struct Around {
    here: Vector,
    along_u: [Vector; 2],
    along_v: [Vector; 2],
}

/// Returns what is around particle (i, j) of a cloth at the positions `y` [3, n].
fn around(model: &Model, (b, y): (usize, &[f64]), (i, j): (usize, usize)) -> Around {
    let (grid, n) = (model.grid, model.grid.particles());
    let at = |k: usize, l: usize| {
        let q = if model.cloths[b].contains(k * grid.w + l) { k * grid.w + l } else { i * grid.w + j };
        [0, 1, 2].map(|c| y[c * n + q])
    };
    Around {
        here: at(i, j),
        along_u: [at(i.saturating_sub(1), j), at((i + 1).min(grid.h - 1), j)],
        along_v: [at(i, j.saturating_sub(1)), at(i, (j + 1).min(grid.w - 1))],
    }
}

/// Returns both axes there, of unit length; none at a particle whose own position is not finite.
fn axes(around: &Around) -> Option<[Vector; 2]> {
    let Around { here, along_u: [above, below], along_v: [before, behind] } = around;
    if !here.iter().all(|x| x.is_finite()) {
        return None;
    }
    let u = unit(sum(*below, *above, -1.0))?;
    let v = unit(sum(*behind, *before, -1.0))?;
    let s = unit(sum(u, v, 1.0))?;
    let d = unit(cross(s, unit(cross(u, v))?))?;
    let both = [1.0, -1.0].map(|sign| sum(s, d, sign).map(|t| t * 0.5f64.sqrt()));
    let along_u = both.map(|t| t.iter().zip(u).map(|(t, u)| t * u).sum::<f64>());
    Some(if along_u[0] >= along_u[1] { both } else { [both[1], both[0]] })
}

/// Returns the square of the change from one edge to the next, 0 without both.
fn bend(here: Vector, [before, behind]: [Vector; 2]) -> f64 {
    let square = |v: Vector| v.iter().map(|v| v * v).sum::<f64>();
    let edges = [sum(here, before, -1.0), sum(behind, here, -1.0)];
    let change = square(sum(edges[1], edges[0], -1.0));
    if edges.iter().all(|&edge| square(edge) > 0.0) && change.is_finite() { change } else { 0.0 }
}

/// Returns what handles leave of a step at particle p.
fn near(model: &Model, b: usize, p: usize) -> f64 {
    let w = model.grid.w;
    let away = |q: &usize| [(q / w).abs_diff(p / w), (q % w).abs_diff(p % w)];
    let within = model.cloths[b].handles.iter().map(away).filter(|d| d.iter().all(|&d| d <= HANDLE_REACH));
    let distances = within.map(|[i, j]| (i as f64).hypot(j as f64));
    distances.map(|d| 1.0 - HANDLE_SHARE / (1.0 + d)).fold(1.0, f64::min)
}

/// Returns the axes, the factor and the edges of all particles, [B, 16, n].
fn all_axes(model: &Model, x: &[f32], base: &[f32]) -> Vec<f64> {
    let (grid, n) = (model.grid, model.grid.particles());
    let mut expected = vec![0.0; model.batch() * AXES * n];
    let y: Vec<f64> = x.iter().zip(base).map(|(&x, &base)| f64::from(x) + f64::from(base)).collect();
    let marks = model.marks();
    for (b, (y, expected)) in y.chunks_exact(3 * n).zip(expected.chunks_exact_mut(AXES * n)).enumerate() {
        let Cloth { material, damping, .. } = model.cloths[b];
        let (stretches, h, w) = (material.stretches(), grid.h as f64, grid.w as f64);
        let stiffness = |q: usize| match marks[b * n + q].is_outside() {
            true => 0.0,
            false => marks[b * n + q].stiffness(),
        };
        for p in 0..n {
            let around = around(model, (b, y), (p / grid.w, p % grid.w));
            let [one, two] = axes(&around).unwrap_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
            let near = near(model, b, p);
            let bends = [bend(around.here, around.along_u), bend(around.here, around.along_v)];
            let arch = ARCHING * (stretches[0] * bends[0] + stretches[1] * bends[1]);
            let across = near / (1.0 + arch).sqrt();
            let all = [one.map(|t| t * near), two.map(|t| t * near), cross(one, two).map(|t| t * across)];
            let edge = |to: Vector, q: usize, each: f64| match unit(sum(to, around.here, -1.0)) {
                Some(edge) if stiffness(p) > 0.0 && stiffness(q) > 0.0 => {
                    let factor = 0.5 * (stiffness(p) + stiffness(q));
                    edge.map(|e| e * (2.0 * (1.0 + damping) * factor * each).sqrt())
                }
                _ => [0.0; 3],
            };
            let down = edge(around.along_u[1], (p + grid.w).min(n - 1), stretches[0] / ((h - 1.0) * w));
            let right = edge(around.along_v[1], (p + 1).min(n - 1), stretches[1] / (h * (w - 1.0)));
            let numbers = [all.as_flattened(), &[near], &down, &right].concat();
            numbers.into_iter().enumerate().for_each(|(c, t)| expected[c * n + p] = t);
        }
    }
    expected
}

#[test]
fn axes_match_and_the_last_accelerations_become_directions() {
    let _turn = device();
    let kernel = SheetAxes::new(context()).unwrap();
    for (grid, batch) in cases() {
        let (model, n) = (model(grid, batch), grid.particles());
        for (amplitude, degenerate) in [(0.02, false), (0.2, false), (0.02, true)] {
            let (mut x, mut base) = (crumpled(&model, amplitude), field(&model, amplitude, 79));
            if degenerate {
                // Neighbours that coincide, a sheet that is folded onto itself, and a position that is NaN.
                for c in 0..3 {
                    x[c * n + 2 * grid.w + 3] = x[c * n + 2 * grid.w + 1];
                    base[c * n + 2 * grid.w + 3] = base[c * n + 2 * grid.w + 1];
                }
                base[5 * grid.w + 5] = f32::NAN;
                x[n + 6 * grid.w + 1] = f32::INFINITY;
            }
            let mut a = field(&model, 0.1, 73);
            (a[9], a[17], a[n + 20]) = (f32::NAN, f32::INFINITY, f32::NEG_INFINITY);
            let iterate = iterate(&model);
            iterate.base.write(context(), &base);
            iterate.a.write(context(), &a);
            let found = poisoned("axes", &[batch, AXES, n]);
            let all = poisoned("directions", &directions::shape(3, batch, grid));
            let (start, cloths) = (upload("x", &model, &x), constants(&model));
            let before = field(&model, 0.1, 74);
            let earlier = upload("earlier", &model, &before);
            let to = [&found, &all, &earlier];
            run(|schedule| kernel.push(schedule, grid, (&cloths, &iterate, &start), to));
            let what = format!("axes {amplitude} {degenerate} {batch} x {grid}");
            // A rounding of the edges, over the sine between them. The changes from edge to edge count more than the edges themselves:
            // the normal's length has their rounding times ARCHING k.
            let (found, expected) = (read(&found), all_axes(&model, &x, &base));
            let stretches = model.cloths.iter().flat_map(|cloth| cloth.material.stretches());
            let arching = 5e-6 + 2.0 * f64::from(f32::EPSILON) * ARCHING * stretches.fold(0.0, f64::max);
            for (planes, tolerance) in [(0..6, 5e-6), (6..9, arching), (9..AXES, 5e-6)] {
                let taken = |k: &usize| planes.contains(&(k / n % AXES));
                let of_both = (0..expected.len()).filter(taken).map(|k| (found[k], expected[k]));
                let (found, expected): (Vec<f32>, Vec<f64>) = of_both.unzip();
                assert_close(&format!("{what} {planes:?}"), &found, &expected, (tolerance, 0.0));
            }

            assert!(read(&iterate.a).iter().all(|&a| a == 0.0), "{what}: a");
            let marks = model.marks();
            let kept = |k: usize| a[k].is_finite() && marks[k / (3 * n) * n + k % n].is_free();
            let expected: Vec<f64> =
                (0..a.len()).map(|k| if kept(k) { f64::from(a[k]) } else { 0.0 }).collect();
            let last = directions::one(&all, directions::LAST_STEP, batch, grid);
            assert_close(&what, &read(&last), &expected, (0.0, 0.0));
            assert_close(&what, &read(&earlier), &expected, (0.0, 0.0));
            let free = |k: usize| marks[k / (3 * n) * n + k % n].is_free();
            let change = |k: usize| (2.0 - WARMEST) * expected[k] - f64::from(before[k]);
            let change: Vec<f64> = (0..a.len()).map(|k| if free(k) { change(k) } else { 0.0 }).collect();
            let found = read(&directions::one(&all, directions::SPECTRAL, batch, grid));
            assert_close(&what, &found, &change, (1e-7, 1e-6));
            let other = directions::one(&all, directions::ROTATED, batch, grid);
            assert!(read(&other).iter().all(|v| v.is_nan()), "{what}: another direction");
        }
    }
}
