//! A frame of ten iterations with the learned optimizer, including readback, on grids of side 32, 64 and 100,
//! for one cloth and sixteen, on the CPU path and on the best adapter. Also the host's cost of recording a
//! frame.

#[path = "common/cloths.rs"]
mod cloths;
mod common;

use cloths::{cloths, learned};
use common::{adapter, criterion, is_software};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fnopt::gpu::Context;
use fnopt::sim::Solver;
use fnopt::{Device, Simulator};

fn frames(c: &mut Criterion) {
    let mut devices = vec![Device::Cpu];
    devices.extend(adapter().map(Device::Gpu));
    for device in &devices {
        eprintln!("{}", device.name());
        let (name, software) = match device {
            Device::Cpu => ("cpu", false),
            Device::Gpu(context) => ("gpu", is_software(context)),
        };
        if let Device::Gpu(context) = device {
            recording(c, context);
        }
        for n in [32, 64, 100] {
            for batch in [1, 16] {
                if software && n * n * batch > 20_000 {
                    eprintln!(
                        "{name}: {n}x{n} batch {batch} skipped: many seconds per frame on a software adapter"
                    );
                    continue;
                }
                frame(c, (name, device), n, batch);
            }
        }
    }
}

fn frame(c: &mut Criterion, (name, device): (&str, &Device), n: usize, batch: usize) {
    let cloths = cloths(n, batch);
    let mut simulator =
        Simulator::new(device, &cloths.model, &learned(), 10).expect("a benchmark fits any adapter");
    simulator.set_state(&cloths.start.cast());
    let mut at = 0;
    let mut group = c.benchmark_group(format!("frame, {name}"));
    group.throughput(Throughput::Elements(batch as u64));
    group.bench_function(format!("{n}x{n} batch {batch}"), |b| {
        b.iter(|| {
            at = at % (cloths.frames() - 1) + 1;
            simulator.step(&cloths.control(at)).expect("the default scene stays finite")
        });
    });
}

/// Records the frame of one 32x32 cloth and discards it. The recording time that `fnopt bench` reports is
/// longer on a software adapter, where the frames computed in between evict the caches; here none is
/// computed.
fn recording(c: &mut Criterion, context: &Context) {
    let cloths = cloths(32, 1);
    let solver = Solver::new(context, &cloths.model, &learned(), 10).expect("a benchmark fits any adapter");
    let mut group = c.benchmark_group("recording");
    group.bench_function(format!("32x32, {} dispatches", solver.schedule().dispatches()), |b| {
        b.iter(|| {
            let mut encoder = context.device.create_command_encoder(&Default::default());
            solver.record(&mut encoder);
            encoder.finish()
        });
    });
}

criterion_group!(name = benches; config = criterion(); targets = frames);
criterion_main!(benches);
