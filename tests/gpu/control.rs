//! What a host changes between the frames of a solver or a simulator.

use crate::common::{context, device, read};
use crate::solver::{assert_same, solver, step, varied_batch};
use fnopt::Error;
use fnopt::cloth::{Control, Map, State};
use fnopt::sim::{Optimizer, Solver};
use fnopt::{Device, Simulator};
use std::ops::ControlFlow;

/// New materials used to end the wind, and those under way in an encoder brought the old ones back.
#[test]
fn new_materials_leave_the_wind() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let mut solver = solver(&model, &Optimizer::gradient_descent(), 3, &start);
    let mut stiffer = model.cloths.clone();
    stiffer.iter_mut().for_each(|cloth| cloth.material.stretch *= 2.0);
    solver.set_cloths(&stiffer).unwrap();
    let expected = step(&solver, &control);

    for set_first in [true, false] {
        solver.set_cloths(&model.cloths).unwrap();
        solver.set_state(&start);
        let mut encoder = context().device.create_command_encoder(&Default::default());
        if set_first {
            solver.set_control(&control);
            solver.set_cloths(&stiffer).unwrap();
            solver.record(&mut encoder);
        } else {
            solver.record_frames(&mut encoder, std::slice::from_ref(&control)).unwrap();
            solver.set_cloths(&stiffer).unwrap();
        }
        context().queue.submit([encoder.finish()]);
        let found = solver.positions().read::<f32>(context()).unwrap();
        assert_same(if set_first { "set before" } else { "recorded before" }, &found, &expected.x);
    }
}

/// A host pins a particle by copying its position into the target, without reading it.
#[test]
fn targets_written_on_the_device_hold() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = model.grid.particles() as u64;
    let solver = solver(&model, &Optimizer::gradient_descent(), 3, &start);
    let moved = step(&solver, &control);
    let far = Control { handles: vec![[90.0; 3]; control.handles.len()], ..control };
    solver.set_control(&far);
    let p = model.cloths[0].handles[0];
    context().submit(|encoder| {
        let (from, to) = (solver.positions(), solver.handle_targets());
        for c in 0..3 {
            encoder.copy_buffer_to_buffer(from.buffer(), 4 * (c * n + p as u64), to.buffer(), 4 * c, 4);
        }
        solver.record(encoder);
    });
    let after = State { x: solver.positions().read(context()).unwrap(), v: vec![] };
    let handles = [&moved, &after].map(|state| solver.handles_of(state));
    assert_eq!(handles[1][0], handles[0][0]);
    assert!(handles[1][1..].iter().all(|&at| at == [90.0; 3]), "{handles:?}");
}

/// Accelerations that a host writes on the device act as those of a control do.
#[test]
fn accelerations_written_on_the_device_act() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let solver = solver(&model, &Optimizer::gradient_descent(), 3, &start);
    let expected = step(&solver, &control);
    solver.set_state(&start);
    solver.set_control(&Control { external: vec![], ..control.clone() });
    solver.control_accelerations().write(context(), &control.external);
    context().submit(|encoder| solver.record(encoder));
    assert_same("on the device", &solver.positions().read(context()).unwrap(), &expected.x);
}

/// A frame that was under way on a GPU when an earlier one broke counts too, and so does one that nobody
/// takes. No control is drawn beyond those.
#[test]
fn frames_under_way_count() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = 3 * model.grid.particles();
    let whole = State { x: start.x[n..2 * n].to_vec(), v: start.v[n..2 * n].to_vec() };
    for device in [Device::Cpu, Device::Gpu(context().clone())] {
        let on_gpu = usize::from(matches!(device, Device::Gpu(_)));
        let mut simulator = Simulator::new(&device, &model, &Optimizer::gradient_descent(), 2).unwrap();
        let mut broken = start.clone();
        broken.v[n] = f32::NAN;
        simulator.set_state(&broken);
        let controls = || std::iter::repeat_n(control.clone(), 4);
        let error = simulator.rollout(controls(), |_| ControlFlow::Continue(())).unwrap_err();
        assert!(matches!(error, Error::NonFinite { frame: 1, cloth: 1 }), "{error}");
        let state = simulator.state().unwrap();
        assert!(state.x[..n].iter().all(|x| x.is_finite()) && state.x[n..2 * n].iter().any(|x| x.is_nan()));

        simulator.set_cloth_state(1, &whole);
        let mut indices = Vec::new();
        let take = |frame: fnopt::Frame| {
            indices.push(frame.index);
            if indices.len() == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let mut drawn = 0;
        simulator.rollout(controls().inspect(|_| drawn += 1), take).unwrap();
        assert_eq!(drawn, 2 + on_gpu);
        let next = simulator.step(&control).unwrap().index;
        indices.push(next);
        assert_eq!(indices, [2 + on_gpu, 3 + on_gpu, 4 + 2 * on_gpu]);
    }
}

/// A control that does not fit is an error after the frames before it, and leaves none of them behind.
#[test]
fn a_control_of_another_length_is_refused_in_its_turn() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let short = Control { handles: control.handles[1..].to_vec(), ..control.clone() };
    for device in [Device::Cpu, Device::Gpu(context().clone())] {
        let mut simulator = Simulator::new(&device, &model, &Optimizer::gradient_descent(), 2).unwrap();
        simulator.set_state(&start);
        let mut frames = 0;
        let controls = [control.clone(), control.clone(), short.clone(), control.clone()];
        let error = simulator.rollout(controls, |_| {
            frames += 1;
            ControlFlow::Continue(())
        });
        let message = error.unwrap_err().to_string();
        let handles = simulator.model().handles();
        assert!(message.contains("handles") && message.contains(&handles.to_string()), "{message}");
        assert_eq!((frames, simulator.step(&control).unwrap().index), (2, 3));
    }
}

/// New handles and materials act on a simulator, on either device, as on one that was built with them.
#[test]
fn a_simulator_takes_other_cloths() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = model.grid.particles();
    let mut other = model.clone();
    for (b, cloth) in other.cloths.iter_mut().enumerate() {
        cloth.handles = vec![5 + b, n - 2];
        cloth.material.stretch *= 1.5;
    }
    let handles = (0..3).flat_map(|b| {
        let place = move |p: usize| [0, 1, 2].map(|c| (3 * b + c) * n + p);
        [5 + b, n - 2].map(place)
    });
    let control = Control { handles: handles.map(|at| at.map(|k| start.x[k] + 0.1)).collect(), ..control };
    for device in [Device::Cpu, Device::Gpu(context().clone())] {
        let of = |model| Simulator::new(&device, model, &Optimizer::gradient_descent(), 3).unwrap();
        let (mut changed, mut fresh) = (of(&model), of(&other));
        changed.set_cloths(&other.cloths).unwrap();
        assert_eq!(changed.model(), &other);
        let [changed, fresh] = [&mut changed, &mut fresh].map(|simulator| {
            simulator.set_state(&start);
            simulator.step(&control).unwrap()
        });
        assert_same(&device.name(), &changed.state.x, &fresh.state.x);
        let after = &changed.state.x;
        assert!((after[3 * n + n - 2] - (start.x[3 * n + n - 2] + 0.1)).abs() < 1e-5);
        assert!(changed.stats == fresh.stats);
    }
}

/// Targets used to stay those of the handles before, so that a new handle jumped to another's place.
#[test]
fn new_handles_stay_where_they_are_until_a_control_moves_them() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = model.grid.particles();
    let mut solver = solver(&model, &Optimizer::gradient_descent(), 1, &start);
    step(&solver, &control);
    let mut cloths = model.cloths.clone();
    for (cloth, handles) in cloths.iter_mut().zip([vec![1, n - 1], vec![n / 3], vec![0, 2, 3]]) {
        cloth.handles = handles;
    }
    solver.set_cloths(&cloths).unwrap();
    let handles = |solver: &Solver| solver.handles_of(&State { x: read(solver.positions()), v: vec![] });
    let held = handles(&solver);
    context().submit(|encoder| solver.record(encoder));
    assert_eq!(handles(&solver), held);
    // A change of material, or of its map, leaves the targets of a control that was set before.
    let mut moved = held;
    for what in ["material", "map"] {
        moved.iter_mut().for_each(|place| place[2] += 0.5);
        solver.set_control(&Control { handles: moved.clone(), ..Control::default() });
        match what {
            "material" => cloths[0].material.bend *= 2.0,
            _ => cloths[0].density = Some(Map::new(model.grid, &vec![1.5; n], "test", "density").unwrap()),
        }
        solver.set_cloths(&cloths).unwrap();
        context().submit(|encoder| solver.record(encoder));
        assert_eq!(handles(&solver), moved, "{what}");
    }
}
