//! Batches and grids beyond what a device takes at once, and requests that it cannot serve at all.

use crate::common::{assert_close, context, device, narrow, read, run, sharings, widened};
use crate::forward::random;
use crate::solver::{assert_same, solver, solver_with, starter, statistics, step, varied_batch};
use fnopt::cloth::{Cloth, Control, Grid, Mark, Material, Model, State};
use fnopt::cpu;
use fnopt::gpu::{Readback, Sharing, Tuning};
use fnopt::kernels::optim::{GradientDescent, Iterate};
use fnopt::network::Config;
use fnopt::sim::{Optimizer, Solver};
use fnopt::{Device, Error, Simulator};

/// The network takes as many samples at once as tuning and device allow: single ones, whole cloths, or all.
#[test]
fn samples_in_passes_have_the_same_bits() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let [paper, fnopt] = ["fnopt-paper", "fnopt"]
        .map(|name| Optimizer::named(name, "a test", || Ok((**starter()).clone())).unwrap());
    // 18 columns are padded to 20.
    let one = 4 * 64 * 21 * 20;
    let table = Tuning::table(context());
    let busy = Tuning { busy_groups: 60, ..sharings()[1] };
    for (optimizer, table) in [(&paper, table), (&paper, busy), (&fnopt, busy)] {
        let run = |activation_bytes: usize| {
            let tuning = Tuning { activation_bytes: activation_bytes.max(1), ..table };
            let solver = solver_with(tuning, &model, (optimizer, 3), &start);
            step(&solver, &control);
            (step(&solver, &control), solver.schedule().dispatches())
        };
        let (whole, few) = run(9 * one);
        let mut dispatches = vec![few];
        // Room for one cloth, for two (two, then one), for single samples, and for less than one.
        for at_once in [3, 7, 2, 0] {
            let (found, more) = run(at_once * one);
            assert_same("positions", &found.x, &whole.x);
            assert_same("velocities", &found.v, &whole.v);
            dispatches.push(more);
        }
        let [one, three, two, nine, again] = dispatches[..] else { panic!("{dispatches:?}") };
        // If not even one sample fits, its lifting is divided further.
        assert!(one < two && two < three && three < nine && nine <= again, "{dispatches:?}");
    }
}

/// The parameters of a schedule are in one buffer, and in another once that is full. Parameters that are
/// already there are reused.
#[test]
fn a_schedule_has_more_parameters_than_one_buffer_holds() {
    let _turn = device();
    let kernel = GradientDescent::new(context()).unwrap();
    let n = 64;
    let iterate = Iterate::new(context(), 1, &vec![Mark::default(); n]).unwrap();
    iterate.grad.write(context(), &[1f32; 192]);
    // Whole numbers, so that their sum is exact. Each appears twice.
    run(|schedule| {
        for rate in (1..=3000).chain(1..=3000) {
            kernel.push(schedule, f64::from(rate), &iterate);
        }
    });
    assert_eq!(read(&iterate.a), [-9_003_000.0; 192]);
}

/// The activations of this batch exceed what the device binds.
#[test]
fn batches_are_larger_than_a_binding() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let optimizer = Optimizer::paper(starter().clone());
    let (narrow, batch, n) = (narrow(8 << 20), 30, model.grid.particles());
    let cloth = |batch: usize| {
        let model = Model { grid: model.grid, cloths: vec![model.cloths[0].clone(); batch] };
        let repeat = |values: &[f32]| values[..3 * n].repeat(batch);
        let state = State { x: repeat(&start.x), v: repeat(&start.v) };
        let handles = control.handles[..model.cloths[0].handles.len()].repeat(batch);
        let wind = vec![control.wind[0]; batch];
        (model, state, Control { handles, wind, external: repeat(&control.external), ..Control::default() })
    };
    // 18 columns are padded to 20.
    assert!((4 * 64 * 21 * 20 * 3 * batch) as u64 > narrow.largest_binding());
    let (model, start, control) = cloth(batch);
    let tuning = Tuning::table(&narrow);
    let solver = Solver::new(&narrow.with_tuning(tuning).unwrap(), &model, &optimizer, 1).unwrap();
    solver.set_state(&start);
    solver.set_control(&control);
    narrow.submit(|encoder| solver.record(encoder));
    let all: Vec<f32> = solver.positions().read(&narrow).unwrap();
    let (model, start, control) = cloth(1);
    let one = step(&solver_with(tuning, &model, (&optimizer, 1), &start), &control);
    for (b, found) in all.chunks_exact(3 * n).enumerate() {
        assert_same(&format!("cloth {b}"), found, &one.x);
    }
}

/// This grid has more particles than one row of workgroups has invocations.
#[test]
fn grids_are_larger_than_a_row_of_workgroups() {
    let _turn = device();
    let grid = Grid { h: 2048, w: 2051 };
    let last = grid.particles() - 1;
    let cloth = Cloth { handles: vec![0, last], gravity: [0.0, 0.0, -0.1], ..Cloth::default() };
    let model = Model { grid, cloths: vec![cloth] };
    let start = State::<f32>::rest(grid, 1);
    let optimizer = Optimizer::gradient_descent();
    let mut host = cpu::Solver::<f32>::new(&model, &optimizer, 1).unwrap();
    let solver = solver(&model, &optimizer, 1, &start);
    let mut control = Control { handles: solver.handles_of(&start), ..Control::default() };
    control.handles[1][2] += 0.5;
    let mut expected = start.clone();
    let wanted = host.step(&mut expected, &control);
    let found = step(&solver, &control);
    assert_eq!(found.v[3 * last + 2], 0.5);
    assert_close("velocities", &found.v, &widened(&expected.v), (1e-6, 1e-5));
    let stats = &statistics(&solver)[0];
    assert!((stats.stretch_largest - wanted[0].stretch_largest).abs() < 1e-5, "{stats:?}");
}

/// Losing the device in mid-run is an error, so that a program can keep its frames.
#[test]
fn a_device_that_is_lost_is_an_error() {
    let _turn = device();
    let lost = narrow(128 << 20);
    let (model, start, control) = varied_batch();
    let on = Device::Gpu(lost.clone());
    let mut simulator = Simulator::new(&on, &model, &Optimizer::gradient_descent(), 1).unwrap();
    simulator.set_state(&start);
    simulator.step(&control).unwrap();
    let optimizer = Optimizer::gradient_descent();
    let solver = Solver::new(&lost, &model, &optimizer, 1).unwrap();
    let mut readback = Readback::new(&lost, &solver.frame_tensors(), 2).unwrap();
    let record = |readback: &mut Readback| {
        let submission = lost.submit(|encoder| {
            solver.record(encoder);
            readback.record(encoder);
        });
        readback.submitted(&submission);
    };
    // Of two frames in flight, one has arrived.
    record(&mut readback);
    record(&mut readback);
    lost.wait().unwrap();
    assert!(!lost.is_lost());

    lost.device.destroy();
    assert!(lost.is_lost());
    let is_lost = |what: &str, error: Option<Error>| match error {
        Some(Error::Lost(message)) => assert!(message.contains(lost.name()), "{what}: {message}"),
        other => panic!("{what}: {other:?}"),
    };
    // Whatever is asked, and every time.
    for _ in 0..3 {
        is_lost("step", simulator.step(&control).err());
        is_lost("state", simulator.state().err());
        is_lost("wait", lost.wait().err());
        is_lost("log", solver.iteration_log().err());
        is_lost("new", Solver::new(&lost, &model, &optimizer, 1).err());
        is_lost("vertices", solver.vertices().err());
        is_lost("ring", Readback::new(&lost, &solver.frame_tensors(), 2).err());
        let mut encoder = lost.device.create_command_encoder(&Default::default());
        is_lost("frames", solver.record_frames(&mut encoder, std::slice::from_ref(&control)).err());
    }
    is_lost("frame in flight", readback.next(|_| ()).err());
    is_lost("frame in flight", readback.try_next(|_| ()).err());
}

/// Its owner may have callbacks on a device that panic. That is not the loss of the device.
#[test]
fn a_panic_in_a_callback_of_the_owner_is_passed_on() {
    let _turn = device();
    let own = narrow(128 << 20);
    let buffer = own.upload("bytes", &[0; 8]).unwrap();
    let target = own.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: 8,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    own.submit(|encoder| encoder.copy_buffer_to_buffer(&buffer, 0, &target, 0, 8));
    target.map_async(wgpu::MapMode::Read, .., |_| panic!("of the owner"));
    let panic = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| own.wait())).unwrap_err();
    assert_eq!(panic.downcast_ref(), Some(&"of the owner"));
    own.wait().unwrap();
}

/// Models, networks and tunings that would make kernels read beyond their tensors, or that cannot be
/// dispatched, are refused before anything runs.
#[test]
fn unsupported_models_and_options_are_refused() {
    let _turn = device();
    let grid = Grid { h: 8, w: 8 };
    let cloth = Cloth { material: Material::default(), ..Cloth::default() };
    let model = |grid: Grid, batch: usize| Model { grid, cloths: vec![cloth.clone(); batch] };
    let gd = Optimizer::gradient_descent();
    let refused = |model: &Model, optimizer: &Optimizer, iterations| {
        Solver::new(context(), model, optimizer, iterations).unwrap_err().to_string()
    };

    // One cloth too many along an axis.
    let error = refused(&model(grid, 21846), &gd, 10);
    assert!(error.contains("the device takes 65535 along an axis"), "{error}");

    let own = Tuning::table(context());
    let shared = Tuning { sharing: context().sharing(), ..own };
    let mut refused_tunings = vec![
        Tuning { channels: 6, ..own },
        Tuning { spectral_teams: 0, ..own },
        Tuning { block_deep: 17, ..own },
        Tuning { pointwise_group: 257, ..own },
    ];
    // Parts of a subgroup cannot share operands.
    if shared.sharing == Sharing::Broadcast {
        refused_tunings
            .extend([Tuning { block_wide: 12, ..shared }, Tuning { pointwise_group: 12, ..shared }]);
    }
    for tuning in refused_tunings {
        let error = context().with_tuning(tuning).unwrap_err().to_string();
        assert!(error.contains("context: tuning: expected tile sizes"), "{error}");
    }
    let error = refused(&model(grid, 1), &gd, 0);
    assert!(error.contains("solver: iterations: expected at least 1, found 0"), "{error}");

    let weights = random(Config { fields: 2, ..starter().config });
    let held = |handles: &[usize]| {
        let held = Cloth { handles: handles.to_vec(), ..cloth.clone() };
        Model { grid, cloths: vec![cloth.clone(), held, cloth.clone()] }
    };
    for device in [Device::Cpu, Device::Gpu(context().clone())] {
        let refused = |model: &Model, optimizer: &Optimizer| {
            Simulator::new(&device, model, optimizer, 1).err().expect("it is refused").to_string()
        };
        // A particle of the next cloth, and a particle listed twice.
        assert_eq!(
            refused(&held(&[3, 64]), &gd),
            "model: handles of cloth 1: expected particles 0 to 63 of a grid of 8x8, found 64"
        );
        assert_eq!(
            refused(&held(&[3, 5, 3]), &gd),
            "model: handles of cloth 1: expected no particle more than once, found 3"
        );
        assert_eq!(
            refused(&held(&[]), &Optimizer::paper(weights.clone())),
            "the optimizer's weights: network: expected 3 fields: gradient, last gradient and last step, found 2"
        );
        assert!(refused(&model(grid, 0), &gd).contains("model: cloths: expected at least one"));
    }
}

/// The number of dispatches per frame, on llvmpipe and on hardware.
#[test]
fn a_frame_is_few_dispatches() {
    let _turn = device();
    let (model, start, _) = varied_batch();
    let optimizer = Optimizer::paper(starter().clone());
    for (tuning, of_iteration) in sharings().into_iter().zip([12, 11]) {
        let solver = solver_with(tuning, &model, (&optimizer, 10), &start);
        assert_eq!(solver.schedule().dispatches(), 10 * of_iteration + 5);
    }
}
