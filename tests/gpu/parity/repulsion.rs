//! `repulsion` against the CPU path.

use super::cloth::{Doubles, OnDevice, crumpled, field, model, repelling};
use crate::common::{assert_close, cases, context, device, largest, poisoned, read, run};
use fnopt::cloth::{Cloth, Grid, Model};
use fnopt::cpu::cloth::repulsion;
use fnopt::kernels::cloth::{EnergySum, Repulsion, TERMS, energy::parts_shape};

/// Returns external accelerations including repulsion, and the repulsion energy of each cloth, on the device
/// and in double precision.
fn both(model: &Model, fields: [&[f32]; 4]) -> [(Vec<f32>, Vec<f64>); 2] {
    let (grid, batch) = (model.grid, model.batch());
    let (kernel, sum) = (Repulsion::new(context(), batch, grid).unwrap(), EnergySum::new(context()).unwrap());
    let cloths = OnDevice::new(model, fields);
    let (parts, terms) = (poisoned("parts", &parts_shape(batch, grid)), poisoned("terms", &[batch, TERMS]));
    run(|schedule| {
        kernel.push(schedule, cloths.trial(), &parts);
        sum.push(schedule, &parts, &terms);
    });
    let doubles = Doubles::new(model, fields);
    let (mut total, mut energies) = (vec![0.0; fields[0].len()], vec![0.0; batch]);
    for (b, total) in total.chunks_exact_mut(3 * grid.particles()).enumerate() {
        let trial = doubles.cloth(b);
        total.copy_from_slice(trial.f);
        energies[b] = model.cloths[b].repulsion.map_or(0.0, |of_cloth| repulsion(&trial, of_cloth, total));
    }
    let found = read(&terms).chunks_exact(TERMS).map(|terms| terms[TERMS - 1]).collect();
    [(read(cloths.iterate.total.as_ref().unwrap()), total), (found, energies)]
}

#[test]
fn pushes_and_energies_match() {
    let _turn = device();
    for (grid, batch) in cases() {
        let model = repelling(&model(grid, batch));
        // Contracted, so that a particle is near a dozen others.
        let x: Vec<f32> = crumpled(&model, 0.4).iter().map(|x| 0.4 * x).collect();
        let fields = [field(&model, 0.02, 79), field(&model, 0.02, 73), field(&model, 0.1, 74)];
        let [base, a, f] = &fields;
        let [(total, expected), (energies, wanted)] = both(&model, [&x, base, a, f]);
        let what = format!("repulsion {batch} x {grid}");
        assert!(largest(&expected) > 0.5 && wanted[0].abs() > 0.01, "{what}: {wanted:?}");
        // Positions are rounded in proportion to the sheet's size, which close particles feel most.
        let off = f64::from(f32::EPSILON) * 0.4 * grid.h.max(grid.w) as f64;
        assert_close(&what, &total, &expected, (20.0 * off * largest(&expected), 1e-5));
        assert_close(&format!("energy of {what}"), &energies, &wanted, (1e-6 * largest(&wanted), 1e-5));
    }
}

/// Coincident particles, all in one bucket, and a cloth in which no particles are near each other.
#[test]
fn degenerate_cloths_are_finite() {
    let _turn = device();
    let grid = Grid { h: 31, w: 33 };
    let model = repelling(&model(grid, 1));
    let zeros = vec![0.0; 3 * grid.particles()];
    let [(total, _), (energies, _)] = both(&model, [&zeros; 4].map(|z| &z[..]));
    assert!(total.iter().chain(&energies).all(|v| v.is_finite()));
    let apart: Vec<f32> = crumpled(&model, 0.1).iter().map(|x| 2.0 * x).collect();
    let [(total, _), (energies, _)] = both(&model, [&apart, &zeros, &zeros, &zeros]);
    assert!(total.iter().chain(&energies).all(|&v| v == 0.0), "nothing is near");
}

/// A cloth with non-finite or huge positions has no repulsion and does not affect the others of its batch.
#[test]
fn particles_without_a_position_have_no_neighbours() {
    let _turn = device();
    let grid = Grid { h: 31, w: 33 };
    let (model, n) = (repelling(&model(grid, 3)), grid.particles());
    let x: Vec<f32> = crumpled(&model, 0.4).iter().map(|x| 0.4 * x).collect();
    let zeros = vec![0.0; x.len()];
    let [(well, _), (energies, _)] = both(&model, [&x, &zeros, &zeros, &zeros]);
    for wrong in [f32::NAN, f32::INFINITY, 1e30] {
        let mut x = x.clone();
        x[..2 * n].fill(wrong);
        let [(total, _), (others, _)] = both(&model, [&x, &zeros, &zeros, &zeros]);
        assert!(total[..3 * n].iter().chain(&others[..1]).all(|&v| v == 0.0), "{wrong}");
        assert!(total[3 * n..] == well[3 * n..] && others[1..] == energies[1..], "{wrong}");
    }
}

/// Sums have a fixed order, whatever the order in which particles reach their buckets.
#[test]
fn repulsion_repeats_bit_for_bit() {
    let _turn = device();
    let grid = Grid { h: 48, w: 32 };
    let held = Cloth { handles: vec![5], ..model(grid, 1).cloths[0].clone() };
    let model = repelling(&Model { grid, cloths: vec![held] });
    let x: Vec<f32> = crumpled(&model, 0.4).iter().map(|x| 0.3 * x).collect();
    let zeros = vec![0.0; x.len()];
    let runs = [(); 4].map(|()| both(&model, [&x, &zeros, &zeros, &zeros]).map(|(found, _)| found));
    let bits = |[total, energies]: &[Vec<f32>; 2]| {
        total.iter().chain(energies).map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    runs[1..].iter().for_each(|run| assert!(bits(run) == bits(&runs[0])));
}
