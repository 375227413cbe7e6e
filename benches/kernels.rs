//! Each kernel by itself: all its dispatches in one frame of one cloth, or in one training step of a batch,
//! submitted and waited for.
//!
//! The dispatches are taken from the schedules that are recorded in use, so the shapes are the real ones. Of the
//! kernels in use only those that copy cloths to and from a pool are left out. Full transforms are also measured
//! as a whole, for sides of all kinds. The reported time includes one submission (about 0.1 ms); `fnopt bench`
//! shows device time by kernel.

#[path = "common/cloths.rs"]
mod cloths;
mod common;

use cloths::{cloths, learned};
use common::{adapter, criterion, is_software};
use criterion::{Criterion, criterion_group, criterion_main};
use fnopt::cloth::Repulsion;
use fnopt::cpu::train::AdamWSettings;
use fnopt::gpu::{Context, Schedule, Tensor};
use fnopt::kernels::fft::{Fields, RealFft2};
use fnopt::kernels::train::BatchTensors;
use fnopt::network::{Parameters, TransposedWeights, Weights};
use fnopt::scene::Batch;
use fnopt::settings::{Norm, Normalisation};
use fnopt::sim::{Optimizer, Solver};
use fnopt::train::{DeviceAdamW, DeviceLoss};
use std::collections::BTreeSet;

fn kernels(c: &mut Criterion) {
    let Some(context) = adapter() else { return };
    eprintln!("{}", context.name());
    let grids: &[usize] = if is_software(&context) { &[32] } else { &[32, 64, 100] };
    for &n in grids {
        let mut measured = BTreeSet::new();
        let classical = [
            Optimizer::spectral(),
            Optimizer::gradient_descent(),
            Optimizer::adam(),
            Optimizer::lbfgs(),
            Optimizer::quasi_newton(),
        ];
        let mut cloth = cloths(n, 1);
        for optimizer in [learned()].into_iter().chain(classical) {
            of_frame(c, &context, (n, &cloth, &optimizer), &mut measured);
        }
        cloth.model.cloths[0].repulsion = Some(Repulsion { strength: 0.25, distance: 1.0 });
        of_frame(c, &context, (n, &cloth, &Optimizer::gradient_descent()), &mut measured);
    }
}

/// Measures the kernels of the gradient of a training step of ten cloths, and of the update of the weights.
fn training(c: &mut Criterion) {
    let Some(context) = adapter() else { return };
    let (n, batch) = (32, if is_software(&context) { 2 } else { 10 });
    let cloths = cloths(n, batch);
    let (tuning, weights) = (context.tuning(), Weights::shipped());
    let (prepare, step, update, loss) = context
        .checked(|| {
            let parameters = Parameters::new(&context, &weights, &tuning)?;
            let adamw = DeviceAdamW::new(&context, parameters.flat.len(), AdamWSettings::default())?;
            let into = (&adamw.gradient, Normalisation::Component);
            let loss = DeviceLoss::new(&context, (cloths.model.grid, batch), &parameters, into, &tuning)?;
            let transposed = TransposedWeights::new(&context, &parameters)?;
            let [mut prepare, mut step, mut update] = [(); 3].map(|()| Schedule::new(&context));
            transposed.push(&mut prepare);
            loss.push(&mut step, &transposed)?;
            adamw.push_norm(&mut update)?;
            adamw.push_step(&mut update, &parameters.flat)?;
            adamw.set_factors(1.0, 1, (0.0, 0.0));
            Ok((prepare, step, update, loss))
        })
        .expect("a benchmark fits any adapter");
    loss.set_cloths(&cloths.model, &cloths.control(1));
    let BatchTensors { x, v, .. } = loss.tensors();
    let start = cloths.start.cast::<f32>();
    x.write(&context, &start.x);
    v.write(&context, &start.v);
    let mut group = c.benchmark_group(format!("kernels of training, {batch} x {n}x{n}"));
    for schedule in [&prepare, &step, &update] {
        run(&context, schedule);
        for kernel in schedule.kernels() {
            let alone = schedule.only(kernel);
            group.bench_function(format!("{kernel}, {} dispatches", alone.dispatches()), |b| {
                b.iter(|| run(&context, &alone));
            });
        }
    }
}

/// Measures the kernels of a frame that have not been measured yet.
fn of_frame(
    c: &mut Criterion,
    context: &Context,
    (n, cloth, optimizer): (usize, &Batch, &Optimizer),
    measured: &mut BTreeSet<&'static str>,
) {
    let solver = Solver::new(context, &cloth.model, optimizer, 10).expect("a benchmark fits any adapter");
    let mut group = c.benchmark_group(format!("kernels {n}x{n}"));
    for kernel in solver.schedule().kernels() {
        if !measured.insert(kernel) {
            continue;
        }
        // Run a whole frame first, so that the kernel works on the data of a real frame.
        solver.set_state(&cloth.start.cast());
        solver.set_control(&cloth.control(1));
        run(context, solver.schedule());
        let alone = solver.schedule().only(kernel);
        group.bench_function(format!("{kernel}, {} dispatches", alone.dispatches()), |b| {
            b.iter(|| run(context, &alone));
        });
    }
}

/// Measures full real transforms, forward and back, of 64 fields whose sides are a power of two, have small
/// factors or are prime.
fn transforms(c: &mut Criterion) {
    let Some(context) = adapter() else { return };
    let mut group = c.benchmark_group("full real transform");
    for n in [64, 100, 97] {
        let plan = RealFft2::new(&context, Fields { batch: 64, h: n, w: n }, Norm::default())
            .expect("a benchmark fits any adapter");
        let zeros = |shape: &[usize]| Tensor::zeros(&context, "field", shape).expect("it fits");
        let (x, spectrum) = (zeros(&[64, n, n]), zeros(&plan.spectrum_shape()));
        let mut schedule = Schedule::new(&context);
        plan.push_forward(&mut schedule, &x, &spectrum);
        plan.push_inverse(&mut schedule, &spectrum, &x);
        group.bench_function(format!("64 x {n}x{n}, {} dispatches", schedule.dispatches()), |b| {
            b.iter(|| run(&context, &schedule));
        });
    }
}

fn run(context: &Context, schedule: &Schedule) {
    context.submit(|encoder| schedule.record(encoder));
    context.wait().expect("the device is there");
}

criterion_group!(name = benches; config = criterion(); targets = kernels, training, transforms);
criterion_main!(benches);
