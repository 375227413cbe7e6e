//! The kernels of contacts against the CPU path: what is found at the start of a frame, shows in all that follows.

use crate::cloths::among_bodies;
use crate::common::{assert_close, assert_shortened, context, device, largest, poisoned, read, run, tensor};
use fnopt::cloth::{Body, Control, Grid, Model, Pose, Shape, State, Sweep};
use fnopt::cpu;
use fnopt::cpu::cloth::{AXES, CurvatureRows};
use fnopt::kernels::cloth::{Begin, ClothContacts, Fields, Objective, Room, curvature, gradient};
use fnopt::kernels::optim::directions;

const GRIDS: [Grid; 3] = [Grid { h: 8, w: 8 }, Grid { h: 31, w: 33 }, Grid { h: 48, w: 32 }];

/// Compares one frame of a batch at the accelerations `a`, which the bodies change.
fn compare(what: &str, (model, state, control): &(Model, State<f32>, Control<f32>), a: &[f32], digits: f64) {
    let (grid, batch, n) = (model.grid, model.batch(), model.grid.particles());
    let most = model.cloths.iter().map(|cloth| cloth.bodies.len()).max().unwrap();
    let room = Room {
        handles: model.handles(),
        repulsion: false,
        self_contact: false,
        bodies: most,
        fields: Fields::of(model).words_count(),
        rest_angles: false,
        hidden: false,
    };
    let device = Objective::new(context(), grid, batch, room).unwrap();
    device.set_cloths(model);
    let (bodies, params) = device.bodies(model, control).unwrap();
    bodies.write(context(), &params);
    device.x.write(context(), &state.x);
    device.v.write(context(), &state.v);
    device.wind.write(context(), &control.wind);
    device.targets.write(context(), &control.handles);
    device.control_accelerations.write(context(), &control.external);
    let marks = model.marks();
    let held = |k: usize| !marks[k / (3 * n) * n + k % n].is_free();
    let a: Vec<f32> = a.iter().enumerate().map(|(k, &a)| if held(k) { 0.0 } else { a }).collect();
    device.iterate.a.write(context(), &a);
    let along: Vec<f32> = (0..4).flat_map(|k| crate::common::noise(3 * batch * n, 20 + k)).collect();
    let along: Vec<f32> =
        along.iter().enumerate().map(|(k, &d)| if held(k % (3 * batch * n)) { 0.0 } else { d }).collect();
    let shape @ [_, slot] = directions::shape(4, batch, grid);
    let mut padded = vec![0.0; 4 * slot];
    for (k, field) in along.chunks_exact(3 * batch * n).enumerate() {
        padded[k * slot..][..field.len()].copy_from_slice(field);
    }
    let all = tensor("directions", &shape, &padded);
    let parts = poisoned("parts", &curvature::parts_shape(batch, grid));
    let sums = poisoned("sums", &[3 * batch, gradient::parts(grid), 2]);
    let long = crate::common::noise(batch * AXES * n, 31);
    let axes = tensor("axes", &[batch, AXES, n], &long);
    run(|schedule| {
        device.begin_frame(schedule, Begin::Kept).unwrap();
        device.confine(schedule, None);
        device.shorten_axes(schedule, &axes);
        device.evaluate(schedule, &sums);
        device.local_model(schedule, &all, &parts);
        device.energy(schedule);
        device.end_frame(schedule);
    });

    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let (mut expected, control) = (state.cast::<f64>(), control.cast::<f64>());
    let mut host = cpu::Objective::<f64>::new(model);
    host.begin_frame(&expected, &control);
    host.set_accelerations(&wide(&a));
    let mut moved = 0;
    host.confine(&expected, |_, _, _| moved += 1);
    assert!(moved > 0, "{what}: no particle is in a body");
    host.evaluate(&expected, &control);
    assert_close(
        &format!("gradient of {what}"),
        &read(&device.iterate.grad),
        host.grad(),
        (digits * largest(host.grad()), 0.0),
    );
    assert_shortened(what, &host, (&long, &read(&axes)), digits);
    let found = read(&parts);
    let report = read(device.contact_report().unwrap());
    for b in 0..batch {
        let own: Vec<f64> =
            along.chunks_exact(3 * batch * n).flat_map(|field| wide(&field[3 * b * n..][..3 * n])).collect();
        let local = host.local_model(&expected, b, (&own, &mut CurvatureRows::new(grid)));
        let of_cloth = &found[b * found.len() / batch..][..found.len() / batch];
        let sum = |k: usize| of_cloth.chunks_exact(24).map(|part| f64::from(part[k])).sum::<f64>() as f32;
        let wanted: Vec<f64> =
            (0..4).flat_map(|i| (i..4).map(move |j| (i, j))).map(|(i, j)| local.curvature[i][j]).collect();
        let sums: Vec<f32> = (0..10).map(sum).collect();
        assert_close(&format!("curvature of {what} {b}"), &sums, &wanted, (digits * largest(&wanted), 0.0));
        let contacts = ClothContacts::of(&report[b * report.len() / batch..], model.cloths[b].bodies.len());
        let wanted = host.body_stats(&expected, &control, b);
        let energy = local.energy.contact;
        assert!((contacts.energy - energy).abs() <= digits * energy, "{what} {b}: {contacts:?} {energy}");
        assert_eq!(contacts.bodies.len(), wanted.len());
        for (found, wanted) in contacts.bodies.iter().zip(&wanted) {
            assert!(found.touching.abs_diff(wanted.touching) <= 1, "{what} {b}: {found:?} {wanted:?}");
            assert!((found.deepest - wanted.deepest).abs() < 1e-4, "{what} {b}: {found:?} {wanted:?}");
            let loads = |load: &[f64; 3]| load.map(|l| l as f32);
            let atol = 2.0 * digits * largest(&wanted.load) + 1e-9;
            assert_close(&format!("load of {what} {b}"), &loads(&found.load), &wanted.load, (atol, 0.0));
            let (work, expected) = (found.friction_work, wanted.friction_work);
            assert!(
                (work - expected).abs() <= 10.0 * digits * expected + 1e-9,
                "{what} {b}: {work} {expected}"
            );
        }
    }
    host.end_frame(&mut expected, &control);
    let atol = (digits * largest(&expected.v), 2e-7);
    assert_close(&format!("x of {what}"), &read(&device.x), &expected.x, atol);
    assert_close(&format!("v of {what}"), &read(&device.v), &expected.v, atol);
}

#[test]
fn contacts_match() {
    let _turn = device();
    for grid in GRIDS {
        let case = among_bodies(grid);
        let a: Vec<f32> = crate::common::noise(case.1.x.len(), 12).iter().map(|a| 0.05 * a).collect();
        // Depths are differences of positions, which are rounded by the size of the sheet.
        compare(&format!("{grid}"), &case, &a, 2e-6 * grid.h as f64);
    }
}

/// Fast bodies are met on the way.
#[test]
fn contacts_with_fast_bodies_match() {
    let _turn = device();
    let grid = Grid { h: 31, w: 33 };
    let (mut model, mut state, control) = among_bodies(grid);
    state.v.fill(0.0);
    let pose = |z: f64| Pose { position: [16.0, 1.0, z], ..Pose::default() };
    let ball = Body {
        shape: Shape::Sphere { radius: 4.0 },
        pose: pose(20.0),
        thickness: 0.16,
        friction: 0.3,
        present: true,
    };
    model.cloths.iter_mut().for_each(|cloth| cloth.bodies = vec![ball.clone()]);
    let sweeps = vec![Sweep { from: pose(20.0), to: pose(-20.0) }; 3];
    let a = vec![0.0; state.x.len()];
    compare("a fast ball", &(model, state, Control { bodies: sweeps, ..control }), &a, 2e-4);
}
