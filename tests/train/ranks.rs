//! Ranks as threads: they have the gradient of one learner, stay together, and write one checkpoint.

use super::support::{Fake, ThreadRank};
use fnopt::Device;
use fnopt::train::{
    Alone, Batch, Config, End, Learner, Limits, Pool, Ranks, Run, WeightUpdate, initial_weights, learner,
};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::rc::Rc;

const CONFIG: &str = r#"
    steps = 12
    log_every = 2
    average = 0.9
    checkpoint = { every = { steps = 2 } }
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
    [optimizer]
    clip = 1e30
    [validation]
    frames = 2
    iterations = 2
    grids = [[9, 12]]
"#;

fn config() -> Config {
    Config::parse(CONFIG, Path::new("test.toml")).unwrap()
}

fn cpu(config: &Config) -> Box<dyn Learner> {
    learner(&Device::Cpu, config, &initial_weights(config, &Alone).unwrap()).unwrap()
}

/// Runs `body` on each of `count` ranks.
fn on_ranks<R: Send>(count: usize, body: impl Fn(Rc<dyn Ranks>) -> R + Sync) -> Vec<R> {
    ThreadRank::run(count, |thread| body(Rc::new(thread)))
}

fn fake(config: &Config) -> fnopt::Result<Box<dyn Learner>> {
    Ok(Box::new(Fake::new(config)))
}

fn create(root: &Path, learner: Box<dyn Learner>, ranks: &Rc<dyn Ranks>) -> Run {
    Run::create(root, CONFIG, config(), learner, ranks.clone()).unwrap()
}

fn train(run: &mut Run, steps: u64) -> End {
    run.train(&Limits { steps: Some(steps), ..Limits::default() }, |_| ControlFlow::Continue(())).unwrap()
}

fn checkpoints(root: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(root.join("checkpoints")).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn two_ranks_have_the_gradient_of_one_learner_with_the_batches_of_both() {
    const STEPS: u64 = 4;
    // The weights do not change, so that only gradients are compared.
    let update = |step| WeightUpdate { number: step + 1, rate: 0.0, average: 0.0 };
    let mean_gradient = |learner: &dyn Learner| {
        let count = initial_weights(&config(), &Alone).unwrap().flat().len();
        learner.save().unwrap().get("adamw.mean", &[count]).unwrap().to_vec()
    };
    let ranks = on_ranks(2, |ranks| {
        let config = config();
        let (seed, rules) = (ranks.seed(config.seed), (config.motion, config.reset));
        let pools = config.pools.iter().enumerate();
        let mut pools: Vec<Pool> = pools.map(|(k, pool)| Pool::new(k, seed, pool.clone(), rules)).collect();
        let mut learner = cpu(&config);
        let step = |step| {
            let batches: Vec<Batch> = pools.iter().map(|pool| pool.draw(step)).collect();
            let report = learner.step(&batches, update(step), &*ranks).unwrap();
            for (pool, (batch, outcomes)) in pools.iter_mut().zip(batches.iter().zip(&report.outcomes)) {
                pool.record(batch, outcomes);
            }
            (batches, report, mean_gradient(&*learner))
        };
        (0..STEPS).map(step).collect::<Vec<_>>()
    });
    let mut both = config();
    both.pools.extend(config().pools);
    let mut learner = cpu(&both);
    for step in 0..STEPS {
        let [(ours, report, mean), (others, other_report, other_mean)] =
            [&ranks[0], &ranks[1]].map(|rank| &rank[step as usize]);
        assert_ne!(ours, others, "each rank has cloths of its own");
        assert!(mean == other_mean && report.gradient_norm == other_report.gradient_norm, "step {step}");
        // The pools of the second rank follow those of the first.
        let behind = others.iter().map(|batch| Batch { pool: batch.pool + ours.len(), ..batch.clone() });
        let batches: Vec<Batch> = ours.iter().cloned().chain(behind).collect();
        let together = learner.step(&batches, update(step), &Alone).unwrap();
        let expected = mean_gradient(&*learner);
        let norm =
            |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
        let difference = norm(&mut mean.iter().zip(&expected).map(|(a, b)| a - b));
        let error = difference / norm(&mut expected.iter().copied());
        let norm_error = (report.gradient_norm / together.gradient_norm - 1.0).abs();
        let loss_error = ((report.loss() + other_report.loss()) / together.loss() - 1.0).abs();
        println!("step {step}: gradient {error:.1e}, norm {norm_error:.1e}, loss {loss_error:.1e}");
        assert!(error < 1e-5 && norm_error < 1e-5 && loss_error < 1e-5, "step {step}: {error}, {norm_error}");
    }
}

#[test]
fn a_run_of_two_ranks_in_two_sessions_has_the_bits_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let [once, twice] = ["once", "twice"].map(|name| folder.path().join(name));
    let unbroken = on_ranks(2, |ranks| {
        let mut run = create(&once, cpu(&config()), &ranks);
        assert_eq!(train(&mut run, 8), End::Done);
        run.weights().unwrap()
    });
    on_ranks(2, |ranks| train(&mut create(&twice, cpu(&config()), &ranks), 5));
    let resumed = on_ranks(2, |ranks| {
        let (mut run, passed_over) = Run::resume(&twice, None, |config| Ok(cpu(config)), ranks).unwrap();
        assert!(passed_over.is_empty() && run.step() == 5);
        train(&mut run, 8);
        run.weights().unwrap()
    });
    assert!(unbroken[0] == unbroken[1] && unbroken == resumed, "ranks or sessions differ");
    let state = |root: &Path, rank: &str| -> Vec<(String, Vec<u8>)> {
        let path: PathBuf = root.join(format!("checkpoints/step-00000008{rank}.safetensors"));
        let bytes = std::fs::read(path).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let mut tensors: Vec<_> = file.iter().map(|(n, view)| (n.to_owned(), view.data().to_vec())).collect();
        tensors.sort();
        tensors
    };
    for rank in ["", ".rank1"] {
        assert!(state(&once, rank) == state(&twice, rank), "part '{rank}' differs");
    }
    assert_eq!(checkpoints(&once).len(), 6, "three checkpoints of two ranks are kept");
    // The weights and AdamW's moments are equal; the cloths differ.
    let differing: Vec<String> = (state(&once, "").into_iter().zip(state(&once, ".rank1")))
        .filter(|(first, second)| first != second)
        .map(|((name, _), _)| name)
        .collect();
    assert!(differing.iter().all(|name| name.starts_with("pool")), "{differing:?}");
    assert!(["pool0.x", "pool1.x"].iter().all(|x| differing.iter().any(|name| name == x)), "{differing:?}");
}

#[test]
fn a_loss_that_is_not_finite_on_one_rank_is_skipped_by_all() {
    let folder = tempfile::tempdir().unwrap();
    let ended = on_ranks(3, |ranks| {
        let broken = if ranks.rank() == 1 { vec![3, 4, 7] } else { Vec::new() };
        let mut run = create(folder.path(), Box::new(Fake::new(&config()).broken_at(broken)), &ranks);
        (train(&mut run, 12), run.step(), run.skipped(), run.weights().unwrap())
    });
    assert_eq!((ended[0].0, ended[0].1, ended[0].2), (End::Done, 12, 3));
    assert!(ended[0] == ended[1] && ended[0] == ended[2], "the ranks differ");
    let folder = tempfile::tempdir().unwrap();
    let ended = on_ranks(2, |ranks| {
        let broken = if ranks.rank() == 1 { 1..50 } else { 0..0 };
        let mut run = create(folder.path(), Box::new(Fake::new(&config()).broken_at(broken)), &ranks);
        (train(&mut run, 12), run.step(), run.skipped())
    });
    assert_eq!(ended, [(End::NonFinite, 11, 10); 2]);
}

#[test]
fn all_ranks_end_where_rank_0_does() {
    let folder = tempfile::tempdir().unwrap();
    let ended = on_ranks(2, |ranks| {
        let mut run = create(folder.path(), Box::new(Fake::new(&config())), &ranks);
        // Rank 1 would stop before rank 0 does.
        let stop = if ranks.rank() == 0 { 5 } else { 3 };
        let end = run.train(&Limits::default(), |progress| {
            if progress.step == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        (end.unwrap(), run.step())
    });
    assert_eq!(ended, [(End::Interrupted, 5); 2]);
    let ended = on_ranks(2, |ranks| {
        let minutes = (ranks.rank() == 0).then_some(1e-9);
        let (mut run, _) = Run::resume(folder.path(), None, fake, ranks).unwrap();
        let end = run.train(&Limits { minutes, ..Limits::default() }, |_| ControlFlow::Continue(()));
        (end.unwrap(), run.step())
    });
    assert_eq!(ended, [(End::Done, 6); 2]);
}

#[test]
fn another_number_of_ranks_is_refused() {
    for (began, now) in [(2, 1), (2, 3), (1, 2)] {
        let folder = tempfile::tempdir().unwrap();
        on_ranks(began, |ranks| train(&mut create(folder.path(), Box::new(Fake::new(&config())), &ranks), 2));
        let refused = on_ranks(now, |ranks| {
            Run::resume(folder.path(), None, fake, ranks).err().expect("other ranks").to_string()
        });
        let said = format!("ranks: expected {began}, as many as the run began with, found {now}");
        assert!(refused.iter().all(|message| message.contains(&said)), "{refused:?}");
    }
}

#[test]
fn a_checkpoint_that_is_damaged_on_one_rank_is_passed_over_by_all() {
    let folder = tempfile::tempdir().unwrap();
    on_ranks(2, |ranks| train(&mut create(folder.path(), Box::new(Fake::new(&config())), &ranks), 6));
    std::fs::write(folder.path().join("checkpoints/step-00000006.rank1.safetensors"), "").unwrap();
    // A rank's part of a checkpoint that rank 0 did not get to write.
    let left = folder.path().join("checkpoints/step-00000007.rank1.safetensors");
    std::fs::write(&left, "").unwrap();
    let resumed = on_ranks(2, |ranks| {
        let (mut run, passed_over) = Run::resume(folder.path(), None, fake, ranks).unwrap();
        assert_eq!(run.step(), 4);
        train(&mut run, 8);
        passed_over.iter().map(ToString::to_string).collect::<Vec<_>>()
    });
    assert!(resumed[0].is_empty() && resumed[1][0].contains("step-00000006.rank1"), "{resumed:?}");
    let mut expected = Vec::new();
    for step in [4, 6, 8] {
        expected.extend(["rank1.safetensors", "safetensors"].map(|end| format!("step-{step:08}.{end}")));
    }
    assert_eq!(checkpoints(folder.path()), expected);
}

#[test]
fn ranks_of_different_configurations_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let errors = on_ranks(2, |ranks| {
        let mut config = config();
        // The second machine has a copy with another rate.
        config.optimizer.rate *= (1 + ranks.rank()) as f64;
        let learner = fake(&config).unwrap();
        Run::create(folder.path(), CONFIG, config, learner, ranks).err().map(|error| error.to_string())
    });
    for error in errors {
        let error = error.expect("the ranks differ");
        assert!(error.contains("configuration") && error.contains("the same one on all ranks"), "{error}");
    }
}
