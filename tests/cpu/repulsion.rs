//! The repulsion of nearby particles: golden files, a sum over all pairs, central differences, and a sheet
//! that folds onto itself.

use crate::golden::{Golden, relative_error};
use crate::marks_of;
use crate::noise::noise;
use fnopt::cloth::{Grid, Mark, Material, Repulsion, State};
use fnopt::cpu::Solver;
use fnopt::cpu::cloth::{Cells, Projection, Trial, masses, repelling_pairs, repulsion, repulsion_curvature};
use fnopt::eval;
use fnopt::scene::{RepulsionSettings, Scene};
use fnopt::sim::Optimizer;
use fnopt::verify::{CpuStages, Stages};

const GRID: Grid = Grid { h: 12, w: 15 };

/// What our energy adds to the authors' for each ordered pair, so that it is 0 at the distance.
fn at_distance(distance: f64) -> f64 {
    (distance * distance + 1e-8).ln()
}

/// Returns which particles of a grid an edge of a face joins.
fn adjacent(grid: Grid) -> Vec<Vec<bool>> {
    let n = grid.particles();
    let mut adjacent = vec![vec![false; n]; n];
    for face in grid.faces() {
        for (p, q) in [(0, 1), (1, 2), (2, 0)] {
            let (p, q) = (face[p] as usize, face[q] as usize);
            (adjacent[p][q], adjacent[q][p]) = (true, true);
        }
    }
    adjacent
}

/// The arrays that a trial borrows.
struct Sheet {
    x: Vec<f64>,
    shift: Vec<f64>,
    f: Vec<f64>,
    marks: Vec<Mark>,
}

impl Sheet {
    /// Builds a sheet contracted until most particles are near particles that they share no edge with. Two
    /// are held.
    fn crumpled() -> Self {
        let n = GRID.particles();
        let mut x: Vec<f64> = State::<f64>::rest(GRID, 1).x.iter().map(|x| 0.2 * x).collect();
        x.iter_mut().zip(noise(3 * n, 91)).for_each(|(x, noise)| *x += 0.4 * noise);
        let of_noise = |seed| noise(3 * n, seed).into_iter().map(|v| 0.1 * v).collect();
        let marks = marks_of(GRID, &[20, n - 1]);
        Self { x, shift: of_noise(92), f: of_noise(93), marks }
    }

    fn repel(&self, of_cloth: Repulsion) -> (f64, Vec<f64>) {
        let mut total = vec![f64::NAN; self.x.len()];
        let energy = self.with_trial(|trial| repulsion(trial, of_cloth, &mut total));
        (energy, total)
    }

    fn with_trial<R>(&self, use_it: impl FnOnce(&Trial<'_, f64>) -> R) -> R {
        let Self { x, shift, f, marks } = self;
        let (a, masses) = (vec![0.0; x.len()], masses(GRID, marks));
        use_it(&Trial {
            grid: GRID,
            material: Material::default(),
            x,
            shift,
            a: &a,
            f,
            marks,
            masses: &masses,
            damping: 0.0,
            elements: None,
            near: None,
        })
    }

    fn place(&self, p: usize) -> [f64; 3] {
        let n = GRID.particles();
        [0, 1, 2].map(|c| self.x[c * n + p] + self.shift[c * n + p])
    }
}

#[test]
fn energies_and_gradients_agree_with_the_authors() {
    for name in ["repulsion_threshold0.5", "repulsion_threshold1.0"] {
        let file = Golden::open(name);
        let shape = file.shape("positions");
        let grid = Grid { h: shape[1], w: shape[2] };
        // For lambda = 1.
        let of_cloth = Repulsion { strength: grid.particles() as f64, distance: file.get("threshold")[0] };
        let mut stages = CpuStages::<f64>::new();
        let (energy, gradient) = stages.repulsion(grid, &file.get("positions"), of_cloth).unwrap();
        // The file has the authors' value, which is not 0 at the distance.
        let (x, n) = (file.get("positions"), grid.particles());
        let square =
            |p: usize, q: usize| [0, 1, 2].map(|c| (x[c * n + p] - x[c * n + q]).powi(2)).iter().sum::<f64>();
        let adjacent = adjacent(grid);
        let is_near =
            |p: usize, q: usize| p != q && !adjacent[p][q] && square(p, q).sqrt() < of_cloth.distance;
        let pairs = (0..n * n).filter(|pair| is_near(pair / n, pair % n)).count();
        let expected = file.get("energy")[0] + pairs as f64 * at_distance(of_cloth.distance);
        assert!((energy - expected).abs() < 1e-12 * expected, "{name}: {energy}, not {expected}");
        assert!(relative_error(&gradient, &file.get("gradient")) < 1e-12, "{name}");
    }
}

#[test]
fn every_pair_in_range_and_not_adjacent_counts() {
    let (sheet, n) = (Sheet::crumpled(), GRID.particles());
    for distance in [0.2, 0.5, 1.0] {
        let of_cloth = Repulsion { strength: 0.3, distance };
        let (energy, total) = sheet.repel(of_cloth);
        let (mut sum, mut pairs, mut expected) = (0.0, 0, sheet.f.clone());
        for (p, adjacent) in adjacent(GRID).iter().enumerate() {
            for q in (0..n).filter(|&q| q != p && !adjacent[q]) {
                let (own, other) = (sheet.place(p), sheet.place(q));
                let offset = [0, 1, 2].map(|c| own[c] - other[c]);
                let square: f64 = offset.iter().map(|d| d * d).sum();
                if square.sqrt() < distance {
                    pairs += 1;
                    sum -= (square + 1e-8).ln();
                    let factor = 4.0 * 0.3 / GRID.mass(p / GRID.w, p % GRID.w) / (square + 1e-8);
                    if sheet.marks[p].is_free() {
                        (0..3).for_each(|c| expected[c * n + p] += factor * offset[c]);
                    }
                }
            }
        }
        assert!(pairs > 20, "{pairs} pairs");
        let shift = 0.3 / n as f64 * f64::from(pairs) * at_distance(distance);
        sum = 0.3 / n as f64 * sum + shift;
        assert!((energy - sum).abs() < 1e-12 * sum.abs(), "{energy}, not {sum}");
        let largest = expected.iter().fold(0.0, |most: f64, a| most.max(a.abs()));
        for (found, expected) in total.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-12 * largest, "{found}, not {expected}");
        }
        let points: Vec<[f64; 3]> = (0..n).map(|p| sheet.place(p)).collect();
        let measured = 0.3 / n as f64 * eval::repulsion(&points, &GRID.faces(), distance) + shift;
        assert!((energy - measured).abs() < 1e-12 * energy.abs(), "{energy}, measured {measured}");
    }
}

/// The repulsive force is minus the slope of the energy, since no pair enters or leaves the range within a
/// difference.
#[test]
fn pushes_are_the_slope_of_the_energy() {
    let (mut sheet, n) = (Sheet::crumpled(), GRID.particles());
    let of_cloth = Repulsion { strength: 0.3, distance: 0.8 };
    let (_, total) = sheet.repel(of_cloth);
    let step = 1e-6;
    let free: Vec<usize> = (0..n).filter(|&p| sheet.marks[p].is_free()).collect();
    for p in free {
        for at in [p, n + p, 2 * n + p] {
            let before = sheet.x[at];
            let [more, less] = [step, -step].map(|step| {
                sheet.x[at] = before + step;
                sheet.repel(of_cloth).0
            });
            sheet.x[at] = before;
            let slope = (more - less) / (2.0 * step);
            let mass = GRID.mass(p / GRID.w, p % GRID.w) / n as f64;
            let expected = -mass * (total[at] - sheet.f[at]);
            assert!((slope - expected).abs() < 1e-6 * expected.abs().max(1e-2), "{slope}, not {expected}");
        }
    }
}

/// Returns directions [K, 3, H, W] that are 0 at the handles of a sheet.
fn directions(sheet: &Sheet, count: usize) -> Vec<f64> {
    let n = GRID.particles();
    let mut directions = noise(3 * n * count, 94);
    (0..directions.len()).filter(|k| !sheet.marks[k % n].is_free()).for_each(|k| directions[k] = 0.0);
    directions
}

/// The second derivatives are the change of the pushes, along directions and pair by pair.
#[test]
fn second_derivatives_are_the_change_of_the_pushes() {
    let (sheet, n) = (Sheet::crumpled(), GRID.particles());
    for distance in [0.5, 0.8] {
        let of_cloth = Repulsion { strength: 0.3, distance };
        let directions = directions(&sheet, 4);
        let along = |k: usize| &directions[3 * n * k..][..3 * n];
        // The gradient at the positions moved by `length` along direction `k`, 0 at handles.
        let gradient = |k: usize, length: f64| -> Vec<f64> {
            let x = sheet.x.iter().zip(along(k)).map(|(x, d)| x + length * d).collect();
            let moved =
                Sheet { x, shift: sheet.shift.clone(), f: sheet.f.clone(), marks: sheet.marks.clone() };
            let (_, total) = moved.repel(of_cloth);
            let mass = |p: usize| GRID.mass(p / GRID.w, p % GRID.w) / n as f64;
            total.iter().zip(&sheet.f).enumerate().map(|(k, (total, f))| -mass(k % n) * (total - f)).collect()
        };
        let found = sheet.with_trial(|trial| repulsion_curvature(trial, of_cloth, &directions));
        let pairs = sheet.with_trial(|trial| repelling_pairs(trial, of_cloth));
        assert!(pairs.len() > 100, "{} pairs", pairs.len());
        let step = 1e-7;
        for i in 0..4 {
            let change: Vec<f64> = (gradient(i, step).iter().zip(gradient(i, -step)))
                .map(|(ahead, behind)| (ahead - behind) / (2.0 * step))
                .collect();
            for j in 0..4 {
                let expected: f64 = along(j).iter().zip(&change).map(|(p, change)| p * change).sum();
                let scale = (found[i][i] * found[j][j]).abs().sqrt();
                assert!(
                    (found[i][j] - expected).abs() < 1e-6 * scale,
                    "{i} and {j}: {}, not {expected}",
                    found[i][j]
                );
                let by_pairs: f64 = (pairs.iter())
                    .map(|pair| {
                        let block = pair.block(Projection::NONE);
                        let part = |k: usize, c: usize| along(k)[c * n + pair.p] - along(k)[c * n + pair.q];
                        (0..9).map(|k| part(i, k / 3) * block[k / 3][k % 3] * part(j, k % 3)).sum::<f64>()
                    })
                    .sum();
                assert!((by_pairs - found[i][j]).abs() < 1e-10 * scale, "{by_pairs}, not {}", found[i][j]);
            }
        }
        // Fewer directions have the same second derivatives.
        let fewer = sheet.with_trial(|trial| repulsion_curvature(trial, of_cloth, &directions[..6 * n]));
        for (i, j) in (0..16).map(|k| (k / 4, k % 4)) {
            assert_eq!(fewer[i][j], if i.max(j) < 2 { found[i][j] } else { 0.0 });
        }
        // Without the negative part, no direction has negative curvature.
        for pair in &pairs {
            let block = pair.block(Projection::FULL);
            let along = |u: [f64; 3]| (0..9).map(|k| u[k / 3] * block[k / 3][k % 3] * u[k % 3]).sum::<f64>();
            assert!(
                [[1.0, 0.0, 0.0], [0.3, -0.8, 0.5], [-0.1, 0.2, 0.9]].map(along).iter().all(|&l| l > -1e-12)
            );
        }
    }
}

/// A pair that comes into range does not raise the energy at once: a hair inside it is as little as the slope
/// says, and outside it is 0.
#[test]
fn the_energy_begins_at_zero() {
    let n = GRID.particles();
    for distance in [0.3, 0.5, 1.0] {
        let of_cloth = Repulsion { strength: 0.3, distance };
        let energy = |apart: f64| {
            // Two particles near each other, and all others far from everything.
            let x = (0..3 * n).map(|k| 10.0 * (k % n) as f64 * f64::from(u8::from(k < n))).collect();
            let mut sheet =
                Sheet { x, shift: vec![0.0; 3 * n], f: vec![0.0; 3 * n], marks: marks_of(GRID, &[]) };
            sheet.x[100] = sheet.x[3] + apart;
            sheet.repel(of_cloth).0
        };
        assert_eq!(energy(distance + 1e-9), 0.0);
        let (inside, slope) = (energy(distance - 1e-6), 4.0 * 0.3 / n as f64 / distance);
        assert!((inside - 1e-6 * slope).abs() < 1e-5 * inside, "{inside:e} at {distance}");
    }
}

/// The neighbours of a particle, and their order, are the same wherever a walk starts.
#[test]
fn walks_find_the_same_wherever_they_begin() {
    let cells = Sheet::crumpled().with_trial(|trial| Cells::new(trial, 0.5));
    let around = |first: usize| {
        let mut walk = cells.walk(&cells.sorted()[first]);
        let of_particle = |own| walk.around(own).map(|other| other.particle).collect::<Vec<_>>();
        cells.sorted()[first..].iter().map(of_particle).collect::<Vec<_>>()
    };
    let all = around(0);
    for first in 1..all.len() {
        assert_eq!(around(first), all[first..], "from {first} on");
    }
}

/// Coincident particles and non-finite positions do not cause a panic.
#[test]
fn degenerate_cloths_do_not_panic() {
    let mut sheet = Sheet::crumpled();
    sheet.x.fill(0.0);
    sheet.shift.fill(0.0);
    let (energy, total) = sheet.repel(Repulsion { strength: 0.3, distance: 1.0 });
    assert!(energy.is_finite() && total.iter().all(|a| a.is_finite()));
    let n = GRID.particles();
    for wrong in [f64::NAN, f64::INFINITY, 1e300] {
        sheet.x[7] = wrong;
        // Nothing is near this particle, so no other is affected.
        let (energy, total) = sheet.repel(Repulsion { strength: 0.3, distance: 1e-3 });
        assert!(energy.is_finite() && total.iter().all(|a| a.is_finite()));
        assert_eq!(
            total[7..].iter().step_by(n).collect::<Vec<_>>(),
            sheet.f[7..].iter().step_by(n).collect::<Vec<_>>()
        );
    }
}

/// A flat sheet that is held at its centre folds; without repulsion its halves pass through each other.
#[test]
fn the_layers_of_a_folding_sheet_stay_apart() {
    let of_scene = |repulsion: Option<RepulsionSettings>| {
        let text = r#"{ "start": "flat", "handles": "single-center", "motion": "none", "frames": 91 }"#;
        let scene = Scene::parse(text, "test", std::path::Path::new("")).unwrap();
        let setup = Scene { repulsion, ..scene }.setup().unwrap();
        let optimizer = Optimizer::paper(fnopt::network::Weights::shipped());
        let mut solver = Solver::<f32>::new(&setup.model, &optimizer, 10).unwrap();
        let (mut state, n) = (setup.start.cast::<f32>(), setup.model.grid.particles());
        let faces = setup.model.grid.faces();
        let mut sum = 0.0;
        for frame in 1..setup.frames() {
            let stats = solver.step(&mut state, &setup.control(frame));
            assert!(stats[0].is_finite() && stats[0].stretch_largest < 0.6, "frame {frame}");
            assert!(repulsion.is_some() || stats[0].energy.repulsion == 0.0);
            let point = |p: usize| [0, 1, 2].map(|c| f64::from(state.x[c * n + p]));
            sum += eval::repulsion(&(0..n).map(point).collect::<Vec<_>>(), &faces, 0.5);
        }
        sum
    };
    let (without, with) = (of_scene(None), of_scene(Some(RepulsionSettings::default())));
    assert!(without > 500.0, "the sheet did not fold onto itself: {without}");
    assert!(with < 0.01 * without, "{with} with repulsion, {without} without");
}
