//! `couple` and `couple_curvature` against the CPU path.

use crate::common::{assert_close, context, device, largest, noise, poisoned, read, run, tensor, widened};
use crate::folding::bent;
use fnopt::cloth::{Grid, Repulsion};
use fnopt::cpu;
use fnopt::cpu::cloth::CurvatureRows;
use fnopt::kernels::cloth::{Begin, ClothTerms, Objective, Room, curvature, gradient};
use fnopt::kernels::optim::directions;

/// Gradient, curvature and energy of cloths with angles at rest, of one with repulsion, too, and of flat ones among them.
#[test]
fn couples_match() {
    let _turn = device();
    for (grid, repels) in
        [(Grid { h: 8, w: 8 }, false), (Grid { h: 31, w: 33 }, true), (Grid { h: 48, w: 32 }, false)]
    {
        let (mut model, state, control) = bent(grid);
        if repels {
            model.cloths[1].repulsion = Some(Repulsion { strength: 0.1, distance: 0.9 });
        }
        let (batch, n) = (model.batch(), grid.particles());
        let room = Room {
            handles: model.handles(),
            repulsion: repels,
            self_contact: false,
            bodies: 0,
            fields: 0,
            rest_angles: true,
            hidden: false,
        };
        let device = Objective::new(context(), grid, batch, room).unwrap();
        device.set_cloths(&model);
        device.x.write(context(), &state.x);
        device.v.write(context(), &state.v);
        device.wind.write(context(), control.wind.as_flattened());
        device.targets.write(context(), control.handles.as_flattened());
        device.control_accelerations.write(context(), &control.external);
        let marks = model.marks();
        let held = |k: usize| !marks[k / (3 * n) * n + k % n].is_free();
        let free = |size: f32, seed: u64| -> Vec<f32> {
            let noise = noise(3 * batch * n, seed).into_iter().enumerate();
            noise.map(|(k, v)| if held(k) { 0.0 } else { size * v }).collect()
        };
        let a = free(0.1, 12);
        device.iterate.a.write(context(), &a);
        let along: Vec<Vec<f32>> = (0..4).map(|k| free(1.0, 20 + k)).collect();
        let shape @ [_, slot] = directions::shape(4, batch, grid);
        let mut padded = vec![0.0; 4 * slot];
        for (k, field) in along.iter().enumerate() {
            padded[k * slot..][..field.len()].copy_from_slice(field);
        }
        let all = tensor("directions", &shape, &padded);
        let parts = poisoned("parts", &curvature::parts_shape(batch, grid));
        let sums = poisoned("sums", &[3 * batch, gradient::parts(grid), 2]);
        run(|schedule| {
            device.begin_frame(schedule, Begin::Kept).unwrap();
            device.evaluate(schedule, &sums);
            device.local_model(schedule, &all, &parts);
        });
        let of_positions = read(device.position_parts().unwrap());
        run(|schedule| device.energy(schedule));

        let (expected, control) = (state.cast::<f64>(), control.cast::<f64>());
        let mut host = cpu::Objective::<f64>::new(&model);
        host.begin_frame(&expected, &control);
        host.set_accelerations(&widened(&a));
        host.evaluate(&expected, &control);
        let what = format!("{grid}");
        let atol = 4e-6 * largest(host.grad());
        assert_close(&format!("gradient of {what}"), &read(&device.iterate.grad), host.grad(), (atol, 0.0));
        // The couples alone: without them the host has another gradient.
        let mut flat = model.clone();
        flat.cloths.iter_mut().for_each(|cloth| cloth.rest_angles = None);
        let mut without = cpu::Objective::<f64>::new(&flat);
        without.begin_frame(&expected, &control);
        without.set_accelerations(&widened(&a));
        without.evaluate(&expected, &control);
        let found = read(&parts);
        for b in 0..batch {
            let own: Vec<f64> =
                along.iter().flat_map(|field| widened(&field[3 * b * n..][..3 * n])).collect();
            let local = host.local_model(&expected, b, (&own, &mut CurvatureRows::new(grid)));
            let of_cloth = &found[b * found.len() / batch..][..found.len() / batch];
            let sum = |k: usize| of_cloth.chunks_exact(24).map(|part| f64::from(part[k])).sum::<f64>() as f32;
            let pairs = (0..4).flat_map(|i| (i..4).map(move |j| (i, j)));
            let wanted: Vec<f64> = pairs.map(|(i, j)| local.curvature[i][j]).collect();
            let found: Vec<f32> = (0..10).map(sum).collect();
            let atol = 4e-6 * largest(&wanted);
            assert_close(&format!("curvature of {what} {b}"), &found, &wanted, (atol, 0.0));
            let terms = ClothTerms::all(&read(&device.terms)).nth(b).unwrap().energy.bend;
            let (bend, wanted) = (host.energy(&expected, b).bend, without.energy(&expected, b).bend);
            assert_eq!(bend != wanted, model.cloths[b].rest_angles.is_some(), "{what} {b}");
            assert!((terms - bend).abs() <= 1e-5 * bend, "{what} {b}: {terms}, not {bend}");
            let own = &of_positions[b * of_positions.len() / batch..][..of_positions.len() / batch];
            let found: f64 = own.chunks_exact(8).map(|part| f64::from(part[7])).sum();
            let wanted = bend - wanted + host.energy(&expected, b).repulsion;
            assert!((found - wanted).abs() <= 1e-5 * bend, "{what} {b}: {found}, not {wanted}");
        }
    }
}
