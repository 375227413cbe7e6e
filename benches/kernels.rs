//! Each kernel by itself: all its dispatches in one frame of one cloth, submitted and waited for.
//!
//! The dispatches are picked from the frames that the solvers record, so the shapes are the real ones and no kernel in
//! use is left out. What is reported includes one submission (about 0.1 ms); `fnopt bench` shows device time by kernel.

#[path = "common/cloths.rs"]
mod cloths;
mod common;

use cloths::{cloths, learned};
use common::{adapter, criterion, is_software};
use criterion::{Criterion, criterion_group, criterion_main};
use fnopt::gpu::{Context, Schedule};
use fnopt::sim::{Optimizer, Solver, SolverOptions};
use std::collections::BTreeSet;

fn kernels(c: &mut Criterion) {
    let Some(context) = adapter() else { return };
    eprintln!("{}", context.name());
    let grids: &[usize] = if is_software(&context) { &[32] } else { &[32, 64, 100] };
    for &n in grids {
        let mut measured = BTreeSet::new();
        for optimizer in [learned(), Optimizer::gradient_descent(), Optimizer::adam(), Optimizer::lbfgs()] {
            of_frame(c, &context, (n, &optimizer), &mut measured);
        }
    }
}

/// Measures the kernels of a frame that were not yet measured.
fn of_frame(
    c: &mut Criterion,
    context: &Context,
    (n, optimizer): (usize, &Optimizer),
    measured: &mut BTreeSet<&'static str>,
) {
    let cloth = cloths(n, 1);
    let solver = Solver::new(context, &cloth.model, optimizer, &SolverOptions::default())
        .expect("a benchmark fits any adapter");
    let mut group = c.benchmark_group(format!("kernels {n}x{n}"));
    for kernel in solver.frame().kernels() {
        if !measured.insert(kernel) {
            continue;
        }
        // A whole frame first, so that the kernel works on what a frame holds.
        solver.set_state(&cloth.start.cast());
        solver.set_control(&cloth.control(1));
        run(context, solver.frame());
        let alone = solver.frame().only(kernel);
        group.bench_function(format!("{kernel}, {} dispatches", alone.dispatches()), |b| {
            b.iter(|| run(context, &alone));
        });
    }
}

fn run(context: &Context, schedule: &Schedule) {
    context.submit(|encoder| schedule.record(encoder));
    context.wait().expect("the device is there");
}

criterion_group!(name = benches; config = criterion(); targets = kernels);
criterion_main!(benches);
