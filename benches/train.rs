//! A training step of the paper's recipe: 120 samples (40 cloths) at 32x32, forward, backward and AdamW, on
//! the CPU path and on the best adapter if it is hardware.

mod common;

use common::{adapter, criterion, is_software};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fnopt::Device;
use fnopt::train::{Alone, Config, Pool, WeightUpdate, initial_weights, learner};

/// Cloths per pool. Their number does not affect the time of a step, and few are quick to set up.
const CLOTHS: usize = 40;

fn steps(c: &mut Criterion) {
    let mut config = Config::default();
    config.pools.iter_mut().for_each(|pool| pool.cloths = CLOTHS);
    let weights = initial_weights(&config, &Alone).expect("fresh weights need no file");
    let hardware = adapter().filter(|context| !is_software(context)).map(Device::Gpu);
    for device in std::iter::once(Device::Cpu).chain(hardware) {
        eprintln!("{}", device.name());
        let mut learner = learner(&device, &config, &weights).expect("a benchmark fits any adapter");
        let pool = |(index, pool): (usize, &fnopt::train::PoolConfig)| {
            Pool::new(index, config.seed, pool.clone(), (config.motion, config.reset))
        };
        let mut pools: Vec<Pool> = config.pools.iter().enumerate().map(pool).collect();
        let mut step = 0;
        let mut group = c.benchmark_group("training step");
        group.throughput(Throughput::Elements(1));
        group.sample_size(10);
        group.bench_function(device.name(), |b| {
            b.iter(|| {
                let batches: Vec<_> = pools.iter().map(|pool| pool.draw(step)).collect();
                step += 1;
                let update = WeightUpdate { number: step, rate: 1e-3, average: 0.0 };
                let report = learner.step(&batches, update, &Alone).expect("the device stays");
                for (pool, (batch, outcomes)) in pools.iter_mut().zip(batches.iter().zip(&report.outcomes)) {
                    pool.record(batch, outcomes);
                }
            });
        });
    }
}

criterion_group!(name = benches; config = criterion(); targets = steps);
criterion_main!(benches);
