//! Training on the device: against the CPU path step by step, and reproducible to the bit.

use crate::common::{context, device, half};
use crate::order::ORDERS;
use fnopt::Device;
use fnopt::settings::Normalisation;
use fnopt::train::{
    Alone, Batch, Config, Learner, Limits, Pool, Run, WeightUpdate, initial_weights, learner,
};
use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;

/// Grids with odd sides, batches of one and more, channels that do not fill a tile. Frames end and cloths
/// start over within a few steps.
const CONFIG: &str = r#"
    steps = 6
    log_every = 2
    average = 0.9
    [network]
    lifting = 20
    channels = 12
    projection = 9
    [[pool]]
    grid = [9, 13]
    iterations = 1
    cloths = 4
    batch = 3
    [[pool]]
    grid = [12, 8]
    iterations = 2
    cloths = 2
    batch = 1
    every = 2
    [motion]
    damping = 0.5
    [reset]
    sequence_length = 2
    [validation]
    frames = 2
    grids = [[9, 12]]
"#;

fn config() -> Config {
    Config::parse(CONFIG, Path::new("test.toml")).unwrap()
}

fn on(device: &Device) -> Box<dyn Learner> {
    of(&config(), device)
}

fn of(config: &Config, device: &Device) -> Box<dyn Learner> {
    learner(device, config, &initial_weights(config, &Alone).unwrap()).unwrap()
}

/// Returns the pools of a run, before any step.
fn pools(config: &Config) -> Vec<Pool> {
    let of = |(index, pool): (usize, &fnopt::train::PoolConfig)| {
        Pool::new(index, config.seed, pool.clone(), (config.motion, config.reset))
    };
    config.pools.iter().enumerate().map(of).collect()
}

/// Returns what the pools that take part in a step draw.
fn draw(pools: &[Pool], step: u64) -> Vec<Batch> {
    pools.iter().filter(|pool| pool.takes_part(step)).map(|pool| pool.draw(step)).collect()
}

fn gpu() -> Device {
    Device::Gpu(context().clone())
}

#[test]
fn steps_are_those_of_the_cpu() {
    let _turn = device();
    for normalisation in [Normalisation::Component, Normalisation::Cloth] {
        compare_steps(&Config { normalisation, ..config() });
    }
}

fn compare_steps(config: &Config) {
    let mut learners = [of(config, &Device::Cpu), of(config, &gpu())];
    let mut pools = pools(config);
    let count = initial_weights(config, &Alone).unwrap().parameter_count();
    let distance =
        |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt();
    let (mut begun, mut advanced) = (0, 0);
    for step in 0..12 {
        let batches = draw(&pools, step);
        begun += batches.iter().flat_map(|b| &b.cloths).filter(|c| c.start.is_some()).count();
        advanced += batches.iter().flat_map(|b| &b.cloths).filter(|c| c.advance).count();
        let update = WeightUpdate { number: step + 1, rate: 1e-3, average: 0.9 };
        // Both start from the same state. Otherwise diverging weights would be compared instead of steps.
        let before = learners[0].save().unwrap();
        learners[1].load(&before).unwrap();
        let [host, found] =
            learners.each_mut().map(|learner| learner.step(&batches, update, &Alone).unwrap());
        let close = |what: &str, found: f64, host: f64, tolerance: f64| {
            let error = (found - host).abs() / host.abs().max(1e-3);
            assert!(error < tolerance, "step {step}: {what} {found}, on the CPU {host}");
        };
        close("loss", found.loss(), host.loss(), 1e-3);
        close("gradient", found.gradient_norm, host.gradient_norm, 1e-3);
        for (found, host) in found.outcomes.iter().flatten().zip(host.outcomes.iter().flatten()) {
            close("log gradient", found.log_gradient, host.log_gradient, 1e-3);
            (0..3).for_each(|k| close("scale", found.scale[k], host.scale[k], 1e-3));
        }
        // The mean gradient moves by a share of the gradient. (The weights would show less: AdamW makes a
        // whole step even if the gradient is all rounding.)
        let [ours, theirs] = learners.each_ref().map(|learner| learner.save().unwrap());
        let [before, ours, theirs] =
            [&before, &ours, &theirs].map(|state| state.get("adamw.mean", &[count]).unwrap());
        let (apart, moved) = (distance(ours, theirs), distance(ours, before));
        assert!(moved > 0.0 && apart < 5e-3 * moved, "step {step}: gradient {:.1e} apart", apart / moved);
        for batch in &batches {
            pools[batch.pool].record(batch, &host.outcomes[batch.pool]);
        }
        pools.iter_mut().for_each(|pool| pool.rotate(step));
    }
    assert!(begun > 6 && advanced > 36, "{begun} lives began, {advanced} frames ended");
}

/// The weights after a step follow from the moments after it, the settings of the configuration, and the
/// step's own number, rate and decay (Loshchilov and Hutter 2019, algorithm 2).
#[test]
fn a_step_is_that_of_adamw_with_the_settings_of_the_run() {
    let _turn = device();
    const SETTINGS: &str =
        "[optimizer]\nbetas = [0.8, 0.99]\nepsilon = 1e-3\nweight_decay = 0.3\nclip = 1e-3\n";
    let config = Config::parse(&format!("{CONFIG}{SETTINGS}"), Path::new("test.toml")).unwrap();
    let batches = draw(&pools(&config), 0);
    let count = initial_weights(&config, &Alone).unwrap().parameter_count();
    for device in [Device::Cpu, gpu()] {
        let mut learner = of(&config, &device);
        let vector = |learner: &dyn Learner, name: &str| {
            let saved = learner.save().unwrap();
            saved.get(name, &[count]).unwrap().iter().map(|&w| f64::from(w)).collect::<Vec<_>>()
        };
        let [weights, averaged] = ["weights", "averaged"].map(|name| vector(&*learner, name));
        assert_eq!(weights, averaged, "the running mean begins at the weights");
        let report =
            learner.step(&batches, WeightUpdate { number: 3, rate: 0.02, average: 0.875 }, &Alone).unwrap();
        assert!(report.gradient_norm > 1e-2, "the gradient is clipped");
        let [mean, square] = ["adamw.mean", "adamw.square"].map(|name| vector(&*learner, name));
        let norm = mean.iter().map(|m| m * m).sum::<f64>().sqrt();
        assert!((norm / (0.2 * 1e-3) - 1.0).abs() < 1e-3, "{}: {norm}", device.name());
        let [after, mean_after] = ["weights", "averaged"].map(|name| vector(&*learner, name));
        let mut moved = 0.0f64;
        for k in 0..count {
            let denominator = (square[k] / (1.0 - 0.99f64.powi(3))).sqrt() + 1e-3;
            let step = 0.02 / (1.0 - 0.8f64.powi(3)) * mean[k] / denominator;
            let expected = weights[k] * (1.0 - 0.02 * 0.3) - step;
            moved = moved.max(step.abs());
            let near = |found: f64, expected: f64| (found - expected).abs() < 1e-6 * (1.0 + expected.abs());
            assert!(near(after[k], expected), "{}: weight {k}: {} not {expected}", device.name(), after[k]);
            let expected = 0.875 * averaged[k] + 0.125 * after[k];
            assert!(near(mean_after[k], expected), "{}: mean {k}: {}", device.name(), mean_after[k]);
        }
        assert!(moved > 1e-4, "{}: steps of {moved} at most", device.name());
    }
}

#[test]
fn runs_repeat_and_resume_to_the_same_bits() {
    let _turn = device();
    let folder = tempfile::tempdir().unwrap();
    let [once, twice] = ["once", "twice"].map(|name| folder.path().join(name));
    let session = |run: &mut Run, steps| {
        run.train(&Limits { steps: Some(steps), ..Limits::default() }, |_| ControlFlow::Continue(()))
            .unwrap();
    };
    let mut unbroken = Run::create(&once, CONFIG, config(), on(&gpu()), Rc::new(Alone)).unwrap();
    session(&mut unbroken, 6);
    let mut broken = Run::create(&twice, CONFIG, config(), on(&gpu()), Rc::new(Alone)).unwrap();
    session(&mut broken, 3);
    drop(broken);
    let (mut resumed, _) = Run::resume(&twice, None, |_| Ok(on(&gpu())), Rc::new(Alone)).unwrap();
    assert_eq!(resumed.step(), 3);
    session(&mut resumed, 6);
    assert_eq!(unbroken.weights().unwrap(), resumed.weights().unwrap());
}

/// Which invocation runs first is up to the device.
#[test]
fn steps_have_the_same_bits_in_every_order() {
    let _turn = device();
    for normalisation in ["component", "cloth"] {
        let text = format!("normalisation = \"{normalisation}\"\n{CONFIG}");
        let config = Config::parse(&text, Path::new("test.toml")).unwrap();
        let [natural, reversed, scattered] = ORDERS.map(|order| {
            let folder = tempfile::tempdir().unwrap();
            let learner = of(&config, &Device::Gpu(context().with_order(order)));
            let mut run = Run::create(folder.path(), &text, config.clone(), learner, Rc::new(Alone)).unwrap();
            let limits = Limits { steps: Some(5), ..Limits::default() };
            run.train(&limits, |_| ControlFlow::Continue(())).unwrap();
            run.weights().unwrap()
        });
        assert_eq!(natural, reversed);
        assert_eq!(natural, scattered);
    }
}

/// Every vector and every pool: a fresh learner has moments and pools of zeros.
#[test]
fn a_run_moves_from_device_to_device() {
    let _turn = device();
    let config = config();
    let mut ours = on(&gpu());
    for step in 0..2 {
        let batches = draw(&pools(&config), step);
        ours.step(&batches, WeightUpdate { number: step + 1, rate: 1e-3, average: 0.9 }, &Alone).unwrap();
    }
    let saved = ours.save().unwrap();
    let mut host = on(&Device::Cpu);
    host.load(&saved).unwrap();
    assert_eq!(host.weights().unwrap(), ours.weights().unwrap());
    assert_ne!(host.averaged().unwrap(), ours.weights().unwrap());
    let again = host.save().unwrap();
    assert!(again == saved, "the CPU changed what it loaded");
    let mut back = on(&gpu());
    back.load(&again).unwrap();
    assert!(back.save().unwrap() == saved, "the device changed what it loaded");
}

/// Training ignores that a context stores networks in 16 bits: weights move by less than 16 bits resolve.
#[test]
fn training_is_in_single_precision_whatever_the_context() {
    let _turn = device();
    let Some(half) = half() else { return };
    let config = config();
    let step = |device: &Device| {
        let mut learner = on(device);
        let batches = draw(&pools(&config), 0);
        learner.step(&batches, WeightUpdate { number: 1, rate: 1e-3, average: 0.9 }, &Alone).unwrap();
        learner.weights().unwrap().flat()
    };
    assert_eq!(step(&Device::Gpu(half)), step(&gpu()));
}
