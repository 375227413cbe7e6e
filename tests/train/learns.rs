//! Training on the CPU path with a real learner: it learns, and two sessions have the bits of one.

use fnopt::Device;
use fnopt::train::{Alone, Config, Learner, Limits, Run, initial_weights, learner};
use safetensors::SafeTensors;
use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;

const CONFIG: &str = r#"
    steps = 200
    log_every = 10
    average = 0.9
    [[pool]]
    grid = [16, 16]
    iterations = 10
    cloths = 64
    batch = 16
    [[pool]]
    grid = [16, 16]
    iterations = 30
    cloths = 64
    batch = 16
    [validation]
    frames = 2
    grids = [[16, 16]]
"#;

fn cpu(config: &Config) -> fnopt::Result<Box<dyn Learner>> {
    learner(&Device::Cpu, config, &initial_weights(config, &Alone)?)
}

fn parsed(text: &str) -> Config {
    Config::parse(text, Path::new("test.toml")).unwrap()
}

#[test]
fn two_hundred_steps_from_scratch_lower_the_gradient() {
    let folder = tempfile::tempdir().unwrap();
    let config = parsed(CONFIG);
    let learner = cpu(&config).unwrap();
    let mut run = Run::create(&folder.path().join("run"), CONFIG, config, learner, Rc::new(Alone)).unwrap();
    let mut logs = vec![Vec::new(); 2];
    run.train(&Limits::default(), |progress| {
        for (log, outcomes) in logs.iter_mut().zip(&progress.report.expect("a step").outcomes) {
            log.push(outcomes.iter().map(|o| o.log_gradient).sum::<f64>() / outcomes.len() as f64);
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    let mean = |log: &[f64]| log.iter().sum::<f64>() / log.len() as f64;
    for (log, iterations) in logs.iter().zip([10, 30]) {
        let (first, last) = (mean(&log[..50]), mean(&log[150..]));
        println!("{iterations} iterations: log mean gradient {first:.2}, then {last:.2}");
        // The gradient is less than half of what it was.
        assert!(last < first - 0.7, "{iterations} iterations: log mean gradient {first}, then {last}");
    }
}

#[test]
fn a_run_in_two_sessions_has_the_bits_of_one() {
    let text = r#"
        steps = 6
        log_every = 2
        average = 0.9
        [network]
        lifting = 6
        channels = 5
        projection = 4
        [[pool]]
        grid = [9, 12]
        iterations = 1
        cloths = 5
        batch = 3
        [[pool]]
        grid = [12, 8]
        iterations = 3
        cloths = 4
        batch = 2
        [validation]
        frames = 2
        grids = [[9, 12]]
    "#;
    let folder = tempfile::tempdir().unwrap();
    let config = parsed(text);
    let [once, twice] = ["once", "twice"].map(|name| folder.path().join(name));
    let session = |run: &mut Run, steps| {
        run.train(&Limits { steps: Some(steps), ..Limits::default() }, |_| ControlFlow::Continue(()))
            .unwrap();
    };
    let mut unbroken =
        Run::create(&once, text, config.clone(), cpu(&config).unwrap(), Rc::new(Alone)).unwrap();
    session(&mut unbroken, 6);
    let mut broken =
        Run::create(&twice, text, config.clone(), cpu(&config).unwrap(), Rc::new(Alone)).unwrap();
    session(&mut broken, 3);
    drop(broken);
    let (mut resumed, passed_over) = Run::resume(&twice, None, cpu, Rc::new(Alone)).unwrap();
    assert!(passed_over.is_empty() && resumed.step() == 3);
    session(&mut resumed, 6);
    assert_eq!(unbroken.weights().unwrap(), resumed.weights().unwrap());
    // The whole state: arrays of all cloths, AdamW's memory, counters.
    let [once, twice] =
        [once, twice].map(|root| std::fs::read(root.join("checkpoints/step-00000006.safetensors")).unwrap());
    let [once, twice] = [&once, &twice].map(|bytes| SafeTensors::deserialize(bytes).unwrap());
    let mut names = once.names();
    names.sort();
    assert!(names.len() > 10, "{names:?}");
    for name in names {
        assert!(once.tensor(name).unwrap() == twice.tensor(name).unwrap(), "{name} differs");
    }
}
