//! `repulsion_curvature` against the CPU path.

use super::cloth::{Doubles, OnDevice, PAIRS, crumpled, field, held, model, repelling};
use crate::common::{ROUNDING, assert_close, cases, context, device, poisoned, read, run, tensor, widened};
use fnopt::cloth::{Grid, Model};
use fnopt::cpu::cloth::{Projection, Trial, repelling_pairs, repulsion_curvature};
use fnopt::kernels::cloth::curvature::{VALUES, parts_shape};
use fnopt::kernels::cloth::{Repulsion, RepulsionCurvature, energy};
use fnopt::kernels::optim::directions;

/// Returns the parts [B, parts, 24] after this many runs from 0.
fn parts(model: &Model, fields: [&[f32]; 4], along: &[Vec<f32>], runs: usize) -> Vec<f32> {
    let (grid, batch) = (model.grid, model.batch());
    let repulsion = Repulsion::new(context(), batch, grid).unwrap();
    let kernel = RepulsionCurvature::new(context()).unwrap();
    let cloths = OnDevice::new(model, fields);
    let all = poisoned("directions", &directions::shape(along.len(), batch, grid));
    for (at, direction) in along.iter().enumerate() {
        directions::one(&all, at, batch, grid).write(context(), direction);
    }
    let shape = parts_shape(batch, grid);
    let parts = tensor("parts", &shape, &vec![0.0; shape.iter().product()]);
    let energies = poisoned("energies", &energy::parts_shape(batch, grid));
    run(|schedule| {
        repulsion.push(schedule, cloths.trial(), &energies);
        for _ in 0..runs {
            kernel.push(schedule, cloths.trial(), repulsion.cells(), [&all, &parts]);
        }
    });
    read(&parts)
}

/// Returns how far each A_ij may be off: the roundings of positions in proportion to the distance of a pair, and those
/// of its products.
fn tolerances(model: &Model, b: usize, trial: &Trial<'_, f64>, along: &[Vec<f64>]) -> [f64; 10] {
    let n = model.grid.particles();
    let off = f64::from(f32::EPSILON) * 0.4 * model.grid.h.max(model.grid.w) as f64;
    let length = |v: [f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let apart =
        |values: &[f64], p: usize, q: usize| length([0, 1, 2].map(|c| values[c * n + p] - values[c * n + q]));
    let places: Vec<f64> = trial.x.iter().zip(trial.shift).map(|(x, shift)| x + shift).collect();
    let mut tolerances = [0.0; 10];
    let Some(of_cloth) = model.cloths[b].repulsion else { return tolerances };
    for pair in repelling_pairs(trial, of_cloth) {
        let block = pair.block(Projection::NONE);
        let size: f64 = block.as_flattened().iter().map(|v| v * v).sum::<f64>().sqrt();
        let relative = 4.0 * off / apart(&places, pair.p, pair.q) + 8.0 * ROUNDING;
        let change = |k: usize| along.get(k).map_or(0.0, |d| apart(&d[3 * n * b..], pair.p, pair.q));
        for (tolerance, (i, j)) in tolerances.iter_mut().zip(PAIRS) {
            *tolerance += relative * size * change(i) * change(j);
        }
    }
    tolerances
}

#[test]
fn second_derivatives_match() {
    let _turn = device();
    // The last has more particles than a part takes at once.
    for (grid, batch) in cases().chain([(Grid { h: 130, w: 139 }, 1)]) {
        let (model, n) = (repelling(&model(grid, batch)), grid.particles());
        // Contracted, so that a particle is near a dozen others.
        let x: Vec<f32> = crumpled(&model, 0.4).iter().map(|x| 0.4 * x).collect();
        let fields = [field(&model, 0.02, 79), field(&model, 0.02, 73), field(&model, 0.1, 74)];
        let [base, a, f] = &fields;
        let four = [81, 82, 83, 84].map(|seed| held(&model, 1.0, seed));
        for along in [&four[..3], &four[..]] {
            let found = parts(&model, [&x, base, a, f], along, 1);
            let doubles = Doubles::new(&model, [&x, base, a, f]);
            let wide: Vec<Vec<f64>> = along.iter().map(|p| widened(p)).collect();
            let per_cloth = found.len() / batch;
            for b in 0..batch {
                let of_cloth: Vec<f64> = wide.iter().flat_map(|p| p[3 * n * b..][..3 * n].to_vec()).collect();
                let trial = doubles.cloth(b);
                let expected = model.cloths[b]
                    .repulsion
                    .map_or([[0.0; 4]; 4], |repulsion| repulsion_curvature(&trial, repulsion, &of_cloth));
                let what = format!("along {}, {b} of {batch} x {grid}", along.len());
                assert_eq!(expected[0][0] != 0.0, model.cloths[b].repulsion.is_some(), "{what}");
                let mut sums = [0.0; VALUES];
                for (k, v) in found[b * per_cloth..][..per_cloth].iter().enumerate() {
                    sums[k % VALUES] += f64::from(*v);
                }
                let tolerances = tolerances(&model, b, &trial, &wide);
                for ((k, (i, j)), tolerance) in PAIRS.into_iter().enumerate().zip(tolerances) {
                    let what = format!("A_{i}{j} {what}");
                    assert_close(&what, &[sums[k] as f32], &[expected[i][j]], (tolerance, 0.0));
                }
                assert!(sums[10..].iter().all(|&v| v == 0.0), "{what}");
            }
        }
    }
}

/// The sums have a fixed order, and are added to what is there.
#[test]
fn second_derivatives_are_added() {
    let _turn = device();
    let model = repelling(&model(Grid { h: 48, w: 32 }, 3));
    let x: Vec<f32> = crumpled(&model, 0.4).iter().map(|x| 0.3 * x).collect();
    let zeros = vec![0.0; x.len()];
    let along = [81, 82, 83].map(|seed| held(&model, 1.0, seed));
    let fields = [&x, &zeros, &zeros, &zeros].map(|field| &field[..]);
    let once = parts(&model, fields, &along, 1);
    let twice: Vec<u32> = once.iter().map(|v| (2.0 * v).to_bits()).collect();
    for _ in 0..3 {
        let again: Vec<u32> = parts(&model, fields, &along, 2).iter().map(|v| v.to_bits()).collect();
        assert!(again == twice);
    }
}
