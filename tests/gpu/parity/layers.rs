//! The kernels of contacts of a cloth with itself against the CPU path: the search for pairs, and what follows from them.

use crate::common::{
    assert_close, assert_shortened, context, device, largest, narrowed, noise, poisoned, read, run, tensor,
    widened,
};
use crate::touching::{field, folded, touching};
use fnopt::cloth::{Control, Grid, Model, SelfContact, State};
use fnopt::cpu;
use fnopt::cpu::cloth::{AXES, Approach, CurvatureRows, Layers};
use fnopt::kernels::cloth::{Begin, ClothLayers, MOST_PAIRS, Objective, Pairs, Room, curvature, gradient};
use fnopt::kernels::optim::directions;
use std::collections::BTreeSet;

const GRIDS: [Grid; 3] = [Grid { h: 9, w: 10 }, Grid { h: 31, w: 33 }, Grid { h: 48, w: 32 }];

/// Sets up the device's objective for a frame.
fn on_device((model, state, control): &(Model, State<f32>, Control<f32>), a: &[f32]) -> Objective {
    let handles = model.handles();
    let room = Room {
        handles,
        repulsion: false,
        self_contact: true,
        bodies: 0,
        fields: 0,
        rest_angles: false,
        hidden: false,
    };
    let device = Objective::new(context(), model.grid, model.batch(), room).unwrap();
    device.set_cloths(model);
    device.x.write(context(), &state.x);
    device.v.write(context(), &state.v);
    device.targets.write(context(), &control.handles);
    device.iterate.a.write(context(), a);
    device
}

/// Returns the particles of the pairs of cloth `b`, in the order in which they are.
fn particles_of(pairs: &Pairs, b: usize) -> Vec<[usize; 4]> {
    let ends = pairs.ends.read::<u32>(context()).unwrap();
    let count = ends[(b + 1) * pairs.params(Grid { h: 2, w: 2 }).buckets as usize - 1] as usize;
    let all = pairs.pairs.read::<u32>(context()).unwrap();
    let of_cloth = all.chunks_exact(20).skip(b * pairs.room()).take(count);
    of_cloth.map(|pair| [0, 1, 2, 3].map(|k| (pair[k] & 0x7fff_ffff) as usize)).collect()
}

/// Compares one frame of the batch at the accelerations `a`, at whose end layers are parted. Returns how far each cloth is
/// moved by that at most.
fn compare(what: &str, case: &(Model, State<f32>, Control<f32>), a: &[f32], digits: f64) -> Vec<f32> {
    let (model, state, control) = case;
    let (grid, batch, n) = (model.grid, model.batch(), model.grid.particles());
    let marks = model.marks();
    let held = |k: usize| !marks[k / (3 * n) * n + k % n].is_free();
    let free = |values: &[f32]| -> Vec<f32> {
        values.iter().enumerate().map(|(k, &a)| if held(k) { 0.0 } else { a }).collect()
    };
    let a = free(a);
    let device = on_device(case, &a);
    let along: Vec<f32> = (0..4).flat_map(|k| free(&noise(3 * batch * n, 20 + k))).collect();
    let shape @ [_, slot] = directions::shape(4, batch, grid);
    let mut padded = vec![0.0; 4 * slot];
    for (k, field) in along.chunks_exact(3 * batch * n).enumerate() {
        padded[k * slot..][..field.len()].copy_from_slice(field);
    }
    let all = tensor("directions", &shape, &padded);
    let parts = poisoned("parts", &curvature::parts_shape(batch, grid));
    let sums = poisoned("sums", &[3 * batch, gradient::parts(grid), 2]);
    let long = noise(batch * AXES * n, 31);
    let axes = tensor("axes", &[batch, AXES, n], &long);
    let frame = |schedule: &mut _| {
        device.begin_frame(schedule, Begin::Kept).unwrap();
        device.shorten_axes(schedule, &axes);
        device.evaluate(schedule, &sums);
        device.local_model(schedule, &all, &parts);
        device.part_layers(schedule);
        device.energy(schedule);
    };
    run(frame);
    let shortened = read(&axes);
    let (found, report) = (read(&parts), read(device.layer_report().unwrap()));
    let (grad, moved) = (read(&device.iterate.grad), read(&device.iterate.a));
    // Nothing of the first run may be left.
    device.iterate.a.write(context(), &a);
    run(frame);
    assert_eq!(read(&device.iterate.a), moved, "{what} repeats");
    assert_eq!(read(device.layer_report().unwrap()), report, "{what} repeats");
    run(|schedule| device.end_frame(schedule));

    let (mut expected, control) = (state.cast::<f64>(), control.cast::<f64>());
    let mut host = cpu::Objective::<f64>::new(model);
    host.begin_frame(&expected, &control);
    host.set_accelerations(&widened(&a));
    host.evaluate(&expected, &control);
    assert_shortened(what, &host, (&long, &shortened), digits);
    let atol = (digits * largest(host.grad()), 0.0);
    assert_close(&format!("gradient of {what}"), &grad, host.grad(), atol);
    for b in 0..batch {
        let own: Vec<f64> = along
            .chunks_exact(3 * batch * n)
            .flat_map(|field| widened(&field[3 * b * n..][..3 * n]))
            .collect();
        let local = host.local_model(&expected, b, (&own, &mut CurvatureRows::new(grid)));
        let of_cloth = &found[b * found.len() / batch..][..found.len() / batch];
        let sum = |k: usize| of_cloth.chunks_exact(24).map(|part| f64::from(part[k])).sum::<f64>() as f32;
        let wanted: Vec<f64> =
            (0..4).flat_map(|i| (i..4).map(move |j| (i, j))).map(|(i, j)| local.curvature[i][j]).collect();
        let sums: Vec<f32> = (0..10).map(sum).collect();
        assert_close(&format!("curvature of {what} {b}"), &sums, &wanted, (digits * largest(&wanted), 0.0));
    }
    host.part_layers(&expected, &control);
    host.move_to_trial(&expected, &control);
    for b in 0..batch {
        let found = ClothLayers::of(&report[8 * b..][..8], n);
        let Some(wanted) = host.layer_stats(&expected, b) else {
            assert_eq!((found.stats.pairs, found.energy), (0, 0.0), "{what} {b}");
            continue;
        };
        let energy = host.energy(&expected, b).contact;
        assert!((found.energy - energy).abs() <= 4.0 * digits * energy, "{what} {b}: {found:?} {energy}");
        let (found, few) = (found.stats, |count: usize| 2 + count / 200);
        assert!(found.pairs.abs_diff(wanted.pairs) <= few(wanted.pairs), "{what} {b}: {found:?} {wanted:?}");
        assert!(
            found.touching.abs_diff(wanted.touching) <= few(wanted.touching),
            "{what} {b}: {found:?} {wanted:?}"
        );
        assert!(found.overflow.is_none());
        assert!(
            wanted.pairs == 0 || (found.nearest - wanted.nearest).abs() < 1e-4,
            "{what} {b}: {found:?} {wanted:?}"
        );
    }
    host.end_frame(&mut expected, &control);
    let atol = (digits * largest(&expected.v), 4e-7);
    assert_close(&format!("x of {what}"), &read(&device.x), &expected.x, atol);
    assert_close(&format!("v of {what}"), &read(&device.v), &expected.v, atol);
    let off = moved.chunks_exact(3 * n).zip(a.chunks_exact(3 * n));
    off.map(|(moved, a)| moved.iter().zip(a).fold(0.0, |most, (moved, a)| f32::max(most, (moved - a).abs())))
        .collect()
}

#[test]
fn layers_match() {
    let _turn = device();
    for grid in GRIDS {
        let case = touching(grid);
        let a: Vec<f32> = noise(case.1.x.len(), 17).iter().map(|a| 0.01 * a).collect();
        compare(&format!("{grid}"), &case, &a, 4e-7 * grid.h as f64);
    }
}

/// Accelerations that lead layers through each other: within what the search at the start of the frame has seen, and
/// far beyond it.
#[test]
fn layers_are_parted_alike() {
    let _turn = device();
    let grid = Grid { h: 31, w: 33 };
    let (mut case, n) = (touching(grid), grid.particles());
    case.1.v.fill(0.0);
    // Halves that are too far apart to be seen at the start of the frame.
    let far = field(grid, (0.02, 21), |i, j| folded(grid, 0.7, (i, j)));
    case.1.x[6 * n..9 * n].copy_from_slice(&far);
    case.2.handles[2] = [0, 1, 2].map(|c| far[c * n + 3]);
    for (what, down) in [("a push", 0.1), ("a hard push", 1.0)] {
        let mut a: Vec<f32> = noise(case.1.x.len(), 18).iter().map(|a| 0.02 * a).collect();
        for b in [0, 2] {
            let upper = (0..n).filter(|p| p % grid.w > grid.w / 2);
            upper.for_each(|p| a[(3 * b + 2) * n + p] -= down);
        }
        let moved = compare(what, &case, &a, 1e-5);
        assert!(moved[0] > 0.01 && (moved[2] > 0.01) == (down > 0.7) && moved[3] == 0.0, "{what}: {moved:?}");
    }
}

/// Layers at rest that slip by less than friction is rounded off at: both devices take back as much of that.
#[test]
fn layers_that_stick_are_held_alike() {
    let _turn = device();
    let mut case = touching(Grid { h: 31, w: 33 });
    case.1.v.fill(0.0);
    let a: Vec<f32> = noise(case.1.x.len(), 19).iter().map(|a| 2e-4 * a).collect();
    let moved = compare("layers that stick", &case, &a, 1e-5);
    assert!(moved[0] > 1e-4 && moved[0] < 1e-3 && moved[2] == 0.0 && moved[3] == 0.0, "{moved:?}");
}

/// Both devices find the same pairs, but for those on whose nearest points rounding decides.
#[test]
fn the_same_pairs_are_found() {
    let _turn = device();
    for grid in GRIDS {
        let case @ (model, state, control) = &touching(grid);
        let (n, device) = (grid.particles(), on_device(case, &vec![0.0; state.x.len()]));
        run(|schedule| device.begin_frame(schedule, Begin::Kept).unwrap());
        let (marks, wide) = (model.marks(), state.cast::<f64>());
        let targets = control.cast::<f64>().handles;
        for b in 0..model.batch() {
            let ours = particles_of(device.layers().unwrap().pairs(), b);
            let unique: BTreeSet<_> = ours.iter().copied().collect();
            assert_eq!(unique.len(), ours.len(), "a pair is found once");
            let Some(settings) = model.cloths[b].self_contact else {
                assert!(ours.is_empty());
                continue;
            };
            let of_host = |by: f64| -> BTreeSet<[usize; 4]> {
                let start = Approach {
                    grid,
                    cloth: &model.cloths[b],
                    sweeps: &[],
                    x: &wide.x[3 * b * n..][..3 * n],
                    v: &wide.v[3 * b * n..][..3 * n],
                    marks: &marks[b * n..][..n],
                    handles: &targets,
                };
                let settings = SelfContact { thickness: settings.thickness + by, ..settings };
                Layers::find(&start, settings).pairs().map(|(particles, _)| particles).collect()
            };
            let theirs = of_host(0.0);
            let differing: Vec<_> = unique.symmetric_difference(&theirs).collect();
            assert!(differing.len() <= theirs.len() / 500, "cloth {b} of {grid}: {differing:?}");
            assert!(b == 2 || theirs.len() > n / 2, "cloth {b} of {grid}: {}", theirs.len());
        }
    }
}

/// More pairs than there is room for are reported, and none acts.
#[test]
fn too_many_pairs_are_reported() {
    let _turn = device();
    let grid = Grid { h: 31, w: 33 };
    let (model, mut state, control) = touching(grid);
    state.x = narrowed(&noise(state.x.len(), 19).iter().map(|x| 0.1 * f64::from(*x)).collect::<Vec<_>>());
    let a = vec![0.0; state.x.len()];
    let device = on_device(&(model, state, control), &a);
    let sums = poisoned("sums", &[12, gradient::parts(grid), 2]);
    run(|schedule| {
        device.begin_frame(schedule, Begin::Kept).unwrap();
        device.evaluate(schedule, &sums);
        device.part_layers(schedule);
        device.energy(schedule);
    });
    let report = read(device.layer_report().unwrap());
    for b in 0..3 {
        let layers = ClothLayers::of(&report[8 * b..][..8], grid.particles());
        assert_eq!((layers.stats.overflow, layers.stats.pairs), (Some(MOST_PAIRS), 0), "{b}");
        assert_eq!(layers.energy, 0.0);
    }
}
