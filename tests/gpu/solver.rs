//! Whole frames: against the CPU path, repeated, in batches, and in a host's encoder.

use crate::cloths::{self, one_by_one};
use crate::common::{assert_close, context, device, half, largest, read, sharings};
use fnopt::cloth::{Control, Grid, Mask, Model, State};
use fnopt::cpu::{self, Track};
use fnopt::eval::median_gap;
use fnopt::gpu::{Context, Readback, Tensor, Tuning};
use fnopt::network::Weights;
use fnopt::scene::Scene;
use fnopt::settings::LEARNED_ITERATIONS;
use fnopt::sim::{FrameStats, Optimizer, Solver};
use fnopt::{Device, Simulator};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

/// Returns the weights of the golden rollouts.
pub fn starter() -> &'static Arc<Weights> {
    static WEIGHTS: LazyLock<Arc<Weights>> = LazyLock::new(|| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/checkpoint_starter.safetensors");
        Arc::new(Weights::load(&path).unwrap())
    });
    &WEIGHTS
}

/// Returns the optimizers that a device supports.
pub fn optimizers() -> [Optimizer; 7] {
    let [paper, learned] = [Optimizer::paper, Optimizer::learned].map(|of| of(starter().clone()));
    let [gd, adam] = [Optimizer::gradient_descent(), Optimizer::adam()];
    [paper, learned, Optimizer::spectral(), gd, adam, Optimizer::lbfgs(), Optimizer::quasi_newton()]
}

/// Returns the optimizers with the adapter's own tuning, and the learned one with a hardware tuning, which
/// divides the convolutions of one cloth differently from those of three.
pub fn tuned() -> Vec<(Optimizer, Tuning)> {
    let [own, hardware] = [context().tuning(), Tuning { busy_groups: 60, ..sharings()[1] }];
    let learned = Optimizer::paper(starter().clone());
    optimizers().map(|optimizer| (optimizer, own)).into_iter().chain([(learned, hardware)]).collect()
}

/// Creates a solver on the device, in the given state.
pub fn solver(model: &Model, optimizer: &Optimizer, iterations: usize, start: &State<f32>) -> Solver {
    solver_with(context().tuning(), model, (optimizer, iterations), start)
}

pub fn solver_with(
    tuning: Tuning,
    model: &Model,
    (optimizer, iterations): (&Optimizer, usize),
    start: &State<f32>,
) -> Solver {
    let solver = Solver::new(&context_with(tuning), model, optimizer, iterations).unwrap();
    solver.set_state(start);
    solver
}

/// Returns the one context of a tuning: solvers of one context share its compiled kernels.
fn context_with(tuning: Tuning) -> Context {
    static CONTEXTS: Mutex<Vec<Context>> = Mutex::new(Vec::new());
    let mut contexts = CONTEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    if contexts.is_empty() {
        contexts.push(context().clone());
    }
    if let Some(known) = contexts.iter().find(|context| context.tuning() == tuning) {
        return known.clone();
    }
    let new = context().with_tuning(tuning).unwrap();
    contexts.push(new.clone());
    new
}

/// Asserts that both have the same bits and are finite.
pub fn assert_same(what: &str, found: &[f32], expected: &[f32]) {
    let differ = found.iter().zip(expected).filter(|(f, e)| f.to_bits() != e.to_bits()).count();
    let most = found.iter().zip(expected).fold(0.0, |m: f32, (f, e)| m.max((f - e).abs()));
    assert_eq!(found.len(), expected.len(), "{what}");
    assert!(differ == 0, "{what}: {differ} of {} elements differ, by up to {most:e}", found.len());
    assert!(found.iter().all(|f| f.is_finite()), "{what}");
}

/// Returns the state after a frame.
pub fn step(solver: &Solver, control: &Control<f32>) -> State<f32> {
    solver.set_control(control);
    context().submit(|encoder| solver.record(encoder));
    State { x: read(solver.positions()), v: read(solver.velocities()) }
}

/// Asserts, right after a frame from `start` under the first of two controls that ended at `found`, that it repeats, and that
/// both frames in one submission equal frames submitted one by one.
pub fn assert_repeats(
    name: &str,
    solver: &Solver,
    start: &State<f32>,
    controls: &[Control<f32>; 2],
    found: &[f32],
) {
    let second = step(solver, &controls[1]);
    solver.set_state(start);
    assert_same(&format!("{name} repeats"), &step(solver, &controls[0]).x, found);
    solver.set_state(start);
    context().submit(|encoder| solver.record_frames(encoder, controls).unwrap());
    assert_same(&format!("{name}, two frames at once"), &read(solver.positions()), &second.x);
}

pub fn statistics(solver: &Solver) -> Vec<FrameStats> {
    let contents: Vec<f32> = solver.statistics_tensors().into_iter().flat_map(read).collect();
    solver.statistics(bytemuck::cast_slice(&contents))
}

/// Builds three different cloths in wind, on a grid that no tile divides.
pub fn varied_batch() -> (Model, State<f32>, Control<f32>) {
    cloths::varied_batch(Grid { h: 21, w: 18 })
}

/// Returns the root mean square and the largest magnitude of the differences [edges].
fn apart(found: &[f32], exact: &[f64]) -> (f64, f64) {
    let differences: Vec<f64> = found.iter().zip(exact).map(|(&f, &e)| f64::from(f) - e).collect();
    let squares: f64 = differences.iter().map(|d| d * d).sum();
    ((squares / found.len() as f64).sqrt(), largest(&differences))
}

/// Computes each of eleven frames of the default scene from the state that double precision reached. After
/// one frame, the device is as close to double precision as the host is in single: in the median to a factor of two, and at
/// most to a factor of ten, since a line search may end elsewhere in one frame. (The
/// next test starts frames where the device ended, and shows what earlier roundings grow to.)
#[test]
fn frames_on_the_device_are_nearly_as_exact_as_on_the_host() {
    let _turn = device();
    let setup = Scene::released().setup().unwrap();
    for optimizer in optimizers() {
        let solver = solver(&setup.model, &optimizer, 10, &setup.start.cast());
        let mut single = cpu::Solver::<f32>::new(&setup.model, &optimizer, 10).unwrap();
        let mut double = cpu::Solver::<f64>::new(&setup.model, &optimizer, 10).unwrap();
        let mut start = setup.start.cast::<f32>();
        let (mut on_device, mut on_host) = (Vec::new(), Vec::new());
        for frame in 1..=11 {
            let mut exact = start.cast::<f64>();
            double.reset_memory();
            double.step(&mut exact, &setup.control(frame));
            solver.set_state(&start);
            let found = step(&solver, &setup.control(frame));
            single.reset_memory();
            single.step(&mut start, &setup.control(frame));
            let finite = |x: &[f32]| x.iter().all(|x| x.is_finite());
            assert!(finite(&found.x) && finite(&start.x), "{}, frame {frame}", optimizer.name());
            on_device.push(apart(&found.x, &exact.x).0);
            on_host.push(apart(&start.x, &exact.x).0);
            start = exact.cast();
        }
        let name = optimizer.name();
        let [[median, most], [of_host, most_of_host]] = [on_device, on_host].map(|mut all| {
            all.sort_by(f64::total_cmp);
            [all[all.len() / 2], all[all.len() - 1]]
        });
        let what = format!(
            "{name}: {median:.1e} edges, at most {most:.1e}, on the device, {of_host:.1e} and {most_of_host:.1e} on the host"
        );
        println!("{what}");
        assert!(median < 2.0 * of_host && most < 10.0 * most_of_host, "{what}");
    }
}

/// Twenty frames of the default scene, each from where the last one ended.
///
/// An optimizer that stops far from the minimum amplifies differences at the start of a frame: the learned
/// one two- or threefold, L-BFGS a hundredfold in ten frames. In single precision, the host, too, is soon far
/// from double precision. The root mean square and the largest magnitude of the differences stay within a share
/// of the side. After the first frame of an optimizer that amplifies, a device, which rounds in every
/// operation, may differ by ten times the host's distance if that is more. (Adam is left out: where a gradient
/// is 0 but for roundings, its sign decides about a whole step. Quasi-Newton's distances are those of L-BFGS
/// within five frames.)
#[test]
fn twenty_frames_drift_within_bounds_of_the_host() {
    let _turn = device();
    let learned = Optimizer::paper(starter().clone());
    for (optimizer, first, (mean, most)) in [
        (learned.clone(), 31, (1e-6, 1e-5)),
        (learned, 91, (1e-6, 1e-5)),
        (Optimizer::gradient_descent(), 31, (1e-7, 1e-6)),
        (Optimizer::lbfgs(), 31, (1e-3, 1e-3)),
    ] {
        let setup = Scene::default().setup().unwrap();
        let side = (setup.model.grid.h - 1) as f64;
        let mut rounded = setup.start.cast::<f32>();
        let mut exact = rounded.cast::<f64>();
        let solver = solver(&setup.model, &optimizer, 10, &rounded);
        let mut single = cpu::Solver::<f32>::new(&setup.model, &optimizer, 10).unwrap();
        let mut double = cpu::Solver::<f64>::new(&setup.model, &optimizer, 10).unwrap();
        let mut farthest = (0.0f64, 0.0f64);
        for frame in first..first + 20 {
            let found = step(&solver, &setup.control(frame));
            single.step(&mut rounded, &setup.control(frame));
            double.step(&mut exact, &setup.control(frame));
            let (on_device, on_host) = (apart(&found.x, &exact.x), apart(&rounded.x, &exact.x));
            farthest = (farthest.0.max(on_host.0), farthest.1.max(on_host.1));
            let what = format!("{}, frame {frame}", optimizer.name());
            println!(
                "{what}: {:.1e}, {:.1e}; on the host {:.1e}, {:.1e}",
                on_device.0, on_device.1, on_host.0, on_host.1
            );
            let amplifies = optimizer.name() != "gd";
            let times = if frame > first && amplifies { 10.0 } else { 0.0 };
            let grown = (times * farthest.0, times * farthest.1);
            let allowed = ((mean * side).max(grown.0), (most * side).max(grown.1));
            assert!(
                on_device.0 < allowed.0,
                "{what}: {:e} edges on average, not {:e}",
                on_device.0,
                allowed.0
            );
            assert!(on_device.1 < allowed.1, "{what}: {:e} edges, not {:e}", on_device.1, allowed.1);
        }
    }
}

/// Where steps are checked against the energy, little is left to amplify: twenty frames of a sheet that swings end at the same place
/// on both devices, to a thousandth of its side.
#[test]
fn twenty_frames_of_checked_steps_stay_together() {
    let _turn = device();
    let setup = Scene::released().setup().unwrap();
    let start = setup.start.cast::<f32>();
    let most = 1e-3 * (setup.model.grid.h - 1) as f64;
    for optimizer in [Optimizer::spectral(), Optimizer::learned(Weights::shipped())] {
        let solver = solver(&setup.model, &optimizer, 20, &start);
        let mut host = cpu::Solver::<f32>::new(&setup.model, &optimizer, 20).unwrap();
        let mut on_host = start.clone();
        let mut farthest = 0.0f64;
        for frame in 1..=20 {
            let found = step(&solver, &setup.control(frame));
            host.step(&mut on_host, &setup.control(frame));
            farthest = farthest.max(apart(&found.x, &on_host.cast::<f64>().x).1);
        }
        println!("{}: {farthest:.1e} edges after 20 frames", optimizer.name());
        assert!(farthest < most, "{}: {farthest} edges, not {most}", optimizer.name());
        let moved = apart(&start.x, &on_host.cast::<f64>().x).1;
        assert!(moved > 0.5, "the sheet swings: {moved} edges");
    }
}

/// A mask of all particles changes no bit.
#[test]
fn a_mask_of_all_particles_is_none() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = model.grid.particles();
    let mut masked = model.clone();
    for cloth in &mut masked.cloths {
        cloth.mask.get_or_insert_with(|| Mask::new(model.grid, &vec![true; n], "a test").unwrap());
    }
    assert_ne!(masked, model, "a cloth without a mask");
    for optimizer in [Optimizer::spectral(), Optimizer::learned(starter().clone()), Optimizer::quasi_newton()]
    {
        let [full, masked] = [&model, &masked].map(|model| {
            let solver = solver(model, &optimizer, 3, &start);
            step(&solver, &control);
            step(&solver, &control)
        });
        assert_same(optimizer.name(), &masked.x, &full.x);
        assert_same(optimizer.name(), &masked.v, &full.v);
    }
}

/// Frames of all optimizers, for different cloths in wind and under external accelerations: state, energies,
/// norms, stretch and scales.
#[test]
fn frames_of_all_optimizers_agree_with_the_host() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    // A single iteration updates the scale in place.
    // In later iterations a network's last proposal stays among the directions.
    let later = ((Optimizer::learned(starter().clone()), context().tuning()), LEARNED_ITERATIONS + 2);
    let cases = tuned().into_iter().flat_map(|tuned| [(tuned.clone(), 5), (tuned, 1)]).chain([later]);
    for ((optimizer, tuning), n) in cases {
        let solver = solver_with(tuning, &model, (&optimizer, n), &start);
        let mut host = cpu::Solver::<f64>::new(&model, &optimizer, n).unwrap();
        let mut expected = start.cast::<f64>();
        let double = control.cast();
        for frame in 0..3 {
            let found = step(&solver, &control);
            let stats = host.step(&mut expected, &double);
            let what = format!("{}:{n}, frame {frame}", optimizer.name());
            // Adam divides by the gradient's size, L-BFGS by curvatures: digits are lost where these are
            // small.
            let digits =
                if matches!(optimizer.name(), "adam" | "lbfgs" | "quasi-newton") { 2e-4 } else { 2e-5 };
            let atol = digits * 5f64.powi(frame) * largest(&expected.v);
            assert_close(&what, &found.x, &expected.x, (atol, 2e-7));
            assert_close(&what, &found.v, &expected.v, (atol, 2e-7));
            let numbers = |s: &FrameStats| {
                let e = s.energy;
                let terms = [e.stretch, e.shear, e.bend, e.inertia, e.external, e.total()];
                let others = [s.gradient_first, s.gradient_last, s.stretch_largest, s.stretch_mean];
                [&terms[..], &others].concat()
            };
            for (found, expected) in statistics(&solver).iter().zip(&stats) {
                let (found, expected) = (numbers(found), numbers(expected));
                let found: Vec<f32> = found.iter().map(|&v| v as f32).collect();
                let atol = 1e-4 * 5f64.powi(frame) * largest(&expected);
                assert_close(&format!("statistics of {what}"), &found, &expected, (atol, 0.0));
            }
            let (log, wanted) = (solver.iteration_log().unwrap(), host.iteration_log());
            for (found, wanted) in
                [(log.gradient_norms, &wanted.gradient_norms), (log.scales, &wanted.scales)]
            {
                let found: Vec<f32> = found.iter().map(|&v| v as f32).collect();
                let atol = 1e-4 * 5f64.powi(frame) * largest(wanted);
                assert_close(&format!("iterations of {what}"), &found, wanted, (atol, 0.0));
            }
        }
    }
}

#[test]
fn runs_repeat_bit_for_bit_and_batches_equal_single_cloths() {
    let _turn = device();
    let batch = varied_batch();
    let (model, start, control) = &batch;
    for (optimizer, tuning) in tuned() {
        let run = |model: &Model, optimizer: &Optimizer, start: &State<f32>, control: &Control<f32>| {
            let solver = solver_with(tuning, model, (optimizer, 4), start);
            step(&solver, control);
            step(&solver, control);
            step(&solver, control)
        };
        let all = run(model, &optimizer, start, control);
        let again = run(model, &optimizer, start, control);
        assert_same(&format!("{} repeats", optimizer.name()), &all.x, &again.x);
        assert_same(&format!("{} repeats", optimizer.name()), &all.v, &again.v);
        for (b, (model, start, control)) in one_by_one(&batch).enumerate() {
            let at = b * start.x.len()..(b + 1) * start.x.len();
            let end = run(&model, &optimizer, &start, &control);
            assert_same(&format!("cloth {b} with {}", optimizer.name()), &end.x, &all.x[at]);
        }
    }
}

/// From sixteen cloths on, invocations of a block have several rows, here of 21: the last ones have fewer. Each of their sums stays
/// the same.
#[test]
fn large_batches_have_the_bits_of_small_ones() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let optimizer = Optimizer::paper(starter().clone());
    let run = |times: usize, tuning: Tuning| {
        let cloths = std::iter::repeat_n(&model.cloths, times).flatten().cloned().collect();
        let model = Model { grid: model.grid, cloths };
        let start = State { x: start.x.repeat(times), v: start.v.repeat(times) };
        let Control { handles, wind, external, .. } = control.clone();
        let control = Control {
            handles: handles.repeat(times),
            wind: wind.repeat(times),
            external: external.repeat(times),
            ..control.clone()
        };
        let solver = solver_with(tuning, &model, (&optimizer, 2), &start);
        step(&solver, &control);
        step(&solver, &control)
    };
    let hardware = sharings()[1];
    let small = run(1, hardware);
    for block_lines in [2, 4] {
        let large = run(Tuning::BATCH.div_ceil(3), Tuning { block_lines, ..hardware });
        for (k, x) in large.x.chunks_exact(small.x.len()).enumerate() {
            assert_same(&format!("cloths from {} on, {block_lines} rows", 3 * k), x, &small.x);
        }
    }
}

/// A host can record any number of frames into its own encoder, among its own commands.
#[test]
fn frames_are_recorded_into_a_hosts_encoder() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let optimizer = Optimizer::paper(starter().clone());
    let solver = solver(&model, &optimizer, 2, &start);
    let apart = {
        step(&solver, &control);
        step(&solver, &control)
    };

    solver.set_state(&start);
    solver.set_control(&control);
    let kept = Tensor::zeros(context(), "kept", solver.positions().shape()).unwrap();
    let mut encoder = context().device.create_command_encoder(&Default::default());
    solver.record(&mut encoder);
    let bytes = kept.bytes();
    encoder.copy_buffer_to_buffer(solver.positions().buffer(), 0, kept.buffer(), 0, bytes);
    solver.record(&mut encoder);
    context().queue.submit([encoder.finish()]);
    let (x, v) = (read(solver.positions()), read(solver.velocities()));
    solver.set_state(&start);
    assert_same("first of two frames", &read(&kept), &step(&solver, &control).x);
    assert_same("second of two frames", &x, &apart.x);
    assert_same("second of two frames", &v, &apart.v);
}

/// One submission of several frames, each with its own control: wind and forces come and go.
#[test]
fn frames_of_one_submission_are_those_of_several() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let lifted = |by: f32| control.handles.iter().map(|&[x, y, z]| [x, y, z + by]).collect();
    let calm = Control { handles: lifted(0.1), ..Control::default() };
    let windy = Control { handles: lifted(0.2), external: vec![], ..control.clone() };
    let controls = [control.clone(), calm.clone(), windy, calm];
    let solver = solver(&model, &Optimizer::paper(starter().clone()), 2, &start);
    let apart = controls.each_ref().map(|control| step(&solver, control));
    assert!(apart.windows(2).all(|pair| pair[0].x != pair[1].x), "nothing moves");
    for together in [1, 3, 4] {
        solver.set_state(&start);
        context().submit(|encoder| solver.record_frames(encoder, &[]).unwrap());
        for controls in controls.chunks(together) {
            context().submit(|encoder| solver.record_frames(encoder, controls).unwrap());
        }
        assert_same("positions", &read(solver.positions()), &apart[3].x);
        assert_same("velocities", &read(solver.velocities()), &apart[3].v);
    }
}

#[test]
fn a_ring_hands_out_frames_in_order_waiting_or_not() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let solver = solver(&model, &Optimizer::gradient_descent(), 2, &start);
    let mut readback = Readback::new(context(), &[solver.positions()], 3).unwrap();
    let positions = |bytes: &[u8]| bytemuck::pod_collect_to_vec::<u8, f32>(bytes);
    assert!(readback.try_next(positions).unwrap().is_none());
    let mut dropped = context().device.create_command_encoder(&Default::default());
    readback.record(&mut dropped);
    readback.discard();
    let frames = [(); 3].map(|()| {
        solver.set_control(&control);
        let submission = context().submit(|encoder| {
            solver.record(encoder);
            readback.record(encoder);
        });
        readback.submitted(&submission);
        read(solver.positions())
    });
    assert!(readback.is_full());
    let mut arrived = || loop {
        if let Some(frame) = readback.try_next(positions).unwrap() {
            return frame;
        }
        std::thread::yield_now();
    };
    assert_same("the first frame", &arrived(), &frames[0]);
    assert_same("the second frame", &arrived(), &frames[1]);
    let last = readback.next(positions).unwrap();
    assert_same("the last frame", &last.unwrap(), &frames[2]);
    assert!(!readback.is_full());
    assert!(readback.next(positions).unwrap().is_none());
}

/// A host may change the state of one cloth, or materials, while the other cloths go on. The bits are those
/// of solvers built that way from the start.
#[test]
fn single_cloths_restart_and_materials_change() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = model.grid.particles();
    for optimizer in [Optimizer::paper(starter().clone()), Optimizer::quasi_newton()] {
        let whole = solver(&model, &optimizer, 2, &start);
        let first = step(&whole, &control);
        // The second cloth goes back to its start; the others stay where they are.
        let at = 3 * n..6 * n;
        whole.set_cloth_state(1, &State { x: start.x[at.clone()].to_vec(), v: start.v[at.clone()].to_vec() });
        let again = step(&whole, &control);
        assert_same("the restarted cloth", &again.x[at.clone()], &first.x[at.clone()]);
        assert_ne!(again.x[..3 * n], first.x[..3 * n]);
        // Where it is, the second cloth forgets its last steps.
        whole.replace_state(&start);
        whole.reset_memory_of(1);
        let forgetful = step(&whole, &control);
        assert_same("the forgetful cloth", &forgetful.x[at.clone()], &first.x[at.clone()]);
        let learned = optimizer.weights().is_some();
        assert_eq!(forgetful.x[..3 * n] != first.x[..3 * n], learned);

        let mut other = model.clone();
        other.cloths[0].material.stretch *= 3.0;
        other.cloths[2].gravity[1] += 0.01;
        let mut changed = solver(&model, &optimizer, 2, &start);
        changed.set_control(&control);
        changed.set_cloths(&other.cloths).unwrap();
        let fresh = solver(&other, &optimizer, 2, &start);
        let (changed_frame, fresh_frame) = (step(&changed, &control), step(&fresh, &control));
        assert_same("other cloths", &changed_frame.x, &fresh_frame.x);
        assert_ne!(fresh_frame.x[..3 * n], first.x[..3 * n]);

        let refused = changed.set_cloths(&other.cloths[1..]).unwrap_err().to_string();
        assert!(refused.contains("the number that the solver was built for"), "{refused}");
    }
}

/// One cloth becomes non-finite and starts over. The others have the bits of an undisturbed batch.
#[test]
fn a_broken_cloth_restarts_and_the_others_continue() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let len = 3 * model.grid.particles();
    let second = len..2 * len;
    let own = State { x: start.x[second.clone()].to_vec(), v: start.v[second.clone()].to_vec() };
    for optimizer in [Optimizer::paper(starter().clone()), Optimizer::quasi_newton()] {
        let on = Device::Gpu(context().clone());
        let mut simulator = Simulator::new(&on, &model, &optimizer, 2).unwrap();
        simulator.set_state(&start);
        let first = simulator.step(&control).unwrap().state;
        let undisturbed = simulator.step(&control).unwrap().state;
        simulator.set_state(&start);
        let mut broken = own.clone();
        broken.x[7] = f32::NAN;
        simulator.set_cloth_state(1, &broken);
        let error = simulator.step(&control).unwrap_err();
        assert!(matches!(error, fnopt::Error::NonFinite { frame: 1, cloth: 1 }), "{error}");
        simulator.set_cloth_state(1, &own);
        let next = simulator.step(&control).unwrap().state;
        assert_same("the restarted cloth", &next.x[second.clone()], &first.x[second.clone()]);
        assert_same("the first cloth", &next.x[..len], &undisturbed.x[..len]);
        assert_same("the third cloth", &next.x[2 * len..], &undisturbed.x[2 * len..]);
    }
}

/// Particles may be released and held at any time. The bits are those of a solver built with these handles.
#[test]
fn handles_change_at_any_time() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let n = model.grid.particles();
    for (optimizer, tuning) in tuned() {
        let mut changing = solver_with(tuning, &model, (&optimizer, 2), &start);
        let mut on_host = cpu::Solver::<f32>::new(&model, &optimizer, 2).unwrap();
        let mut host = start.clone();
        step(&changing, &control);
        on_host.step(&mut host, &control);
        // No handles, more than before, and others.
        for handles in [
            [vec![], vec![], vec![]],
            [vec![0, 3, n - 1], vec![5], vec![1, 2]],
            [vec![4], vec![], vec![n / 2]],
        ] {
            let mut other = model.clone();
            for (cloth, handles) in other.cloths.iter_mut().zip(handles) {
                cloth.handles = handles;
            }
            // Changing handles keeps the optimizer's memory, so it is reset here.
            changing.reset_memory();
            on_host.reset_memory();
            let before = State {
                x: changing.positions().read(context()).unwrap(),
                v: changing.velocities().read(context()).unwrap(),
            };
            changing.set_cloths(&other.cloths).unwrap();
            on_host.set_cloths(&other.cloths).unwrap();
            let fresh = solver_with(tuning, &other, (&optimizer, 2), &before);
            let mut fresh_on_host = cpu::Solver::<f32>::new(&other, &optimizer, 2).unwrap();
            let held = fresh.handles_of(&before);
            let moved = Control {
                handles: held.iter().map(|p| [p[0], p[1] + 0.1, p[2] - 0.2]).collect(),
                ..control.clone()
            };
            let name = optimizer.name();
            let (changed, expected) = (step(&changing, &moved), step(&fresh, &moved));
            assert_same(name, &changed.x, &expected.x);
            assert_same(name, &changed.v, &expected.v);
            assert_eq!(changing.handles_of(&State { x: changed.x, v: changed.v }), moved.handles, "{name}");
            let mut same = host.clone();
            on_host.step(&mut host, &moved);
            fresh_on_host.step(&mut same, &moved);
            assert!(host == same, "{name} on the host");
        }
    }
}

/// A control without wind and forces used to leave those of the previous frame in place.
#[test]
fn wind_and_forces_end_with_the_control_that_has_them() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let solver = solver(&model, &Optimizer::gradient_descent(), 3, &start);
    let calm = Control { wind: vec![], external: vec![], ..control.clone() };
    let expected = step(&solver, &calm);
    solver.set_state(&start);
    assert!(step(&solver, &control).x != expected.x, "wind and forces do nothing");
    solver.set_state(&start);
    assert_same("calm again", &step(&solver, &calm).x, &expected.x);
}

/// Setting a state resets the hidden state of the learned optimizer.
#[test]
fn a_new_state_forgets_the_hidden_one() {
    let _turn = device();
    let (model, start, control) = varied_batch();
    let solver = solver(&model, &Optimizer::paper(starter().clone()), 3, &start);
    let first = step(&solver, &control);
    assert!(step(&solver, &control).x != first.x, "nothing moves");
    solver.set_state(&start);
    assert_same("after a reset", &step(&solver, &control).x, &first.x);
}

/// Handles stay in place until a control is set. The corners used to jump to the targets of the previous
/// state, at first those of the sheet at rest.
#[test]
fn a_new_state_holds_its_handles() {
    let _turn = device();
    let (model, start, _) = varied_batch();
    let n = model.grid.particles();
    let solver = solver(&model, &Optimizer::gradient_descent(), 1, &start);
    let handles = |solver: &Solver| {
        context().submit(|encoder| solver.record(encoder));
        solver.handles_of(&State { x: read(solver.positions()), v: vec![] })
    };
    let held = solver.handles_of(&start);
    assert!(
        held != solver.handles_of(&State::rest(model.grid, model.batch())),
        "the start is the sheet at rest"
    );
    assert_eq!(handles(&solver), held);

    let lifted: Vec<_> = held.iter().map(|&[x, y, z]| [x, y, z + 0.5]).collect();
    solver.set_control(&Control { handles: lifted.clone(), ..Control::default() });
    assert_eq!(handles(&solver), lifted);
    let at = 3 * n..6 * n;
    solver.set_cloth_state(1, &State { x: start.x[at.clone()].to_vec(), v: start.v[at].to_vec() });
    let (first, second) = (model.cloths[0].handles.len(), model.cloths[1].handles.len());
    let found = handles(&solver);
    assert_eq!(found[..first], lifted[..first]);
    assert_eq!(found[first..][..second], held[first..][..second]);
    assert_eq!(found[first + second..], lifted[first + second..]);
}

/// Device and host, and the network in 16 and in 32 bits, minimise equally well: median gaps agree to a
/// tenth. In 16 bits that is the mean of two ways to share the work, which round differently: one alone is moved as far by that.
#[test]
fn half_precision_closes_the_gap_as_far() {
    let _turn = device();
    let Some(half) = half() else { return };
    // From its first frame on this sheet moves.
    let mut scene = Scene::released();
    scene.regrid(Grid { h: 24, w: 24 }).unwrap();
    let setup = scene.setup().unwrap();
    let controls = (1..46).map(|frame| setup.control(frame));
    let track = Track::new(&setup.model, setup.start.clone(), controls).unwrap();
    let optimizer = Optimizer::paper(Weights::shipped());
    let median_on = |on: &Device| {
        median_gap(&track, (&optimizer, 10), on, || ControlFlow::Continue(())).unwrap().unwrap()
    };
    let median = |context: &Context| median_on(&Device::Gpu(context.clone()));
    let host = median_on(&Device::Cpu);
    let as_on_hardware = half.with_tuning(sharings()[1]).unwrap();
    let (single, half, fused) = (median(context()), median(&half), median(&as_on_hardware));
    println!("median gap {host:.4} on the host, {single:.4} in f32, {half:.4} and {fused:.4} in f16");
    assert!((single - host).abs() < 0.1 * host, "{single} in f32, {host} on the host");
    let both = 0.5 * (half + fused);
    assert!((both - single).abs() < 0.1 * single, "{half} and {fused} in f16, {single} in f32");
}

/// Kernels have the table's sizes unless a program specifies others, whatever is stored on this machine.
#[test]
fn a_context_keeps_its_tuning() {
    let other = Tuning { channels: 16, ..Tuning::table(context()) };
    let tuned = context().with_tuning(other).unwrap();
    assert_eq!(tuned.tuning(), other);
    assert_eq!(context().tuning(), Tuning::table(context()));
}

/// Types that hosts move between threads or share.
#[test]
fn device_types_are_send_and_sync() {
    fn moves<T: Send>() {}
    fn is_shared<T: Send + Sync>() {}
    is_shared::<Context>();
    is_shared::<Solver>();
    is_shared::<Readback>();
    is_shared::<fnopt::gpu::Schedule>();
    moves::<fnopt::Simulator>();
    moves::<cpu::Solver<f32>>();
}
