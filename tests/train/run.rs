//! Runs with a learner that computes nothing: what the folder holds, resuming, damage, non-finite losses.

use super::support::Fake;
use fnopt::network::Weights;
use fnopt::train::{Alone, Config, End, Learner, Limits, Progress, Run, Validation};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::rc::Rc;

pub const CONFIG: &str = r#"
    steps = 12
    log_every = 2
    checkpoint = { every = { steps = 2 } }
    [network]
    lifting = 16
    channels = 16
    projection = 16
    layers = 2
    [[pool]]
    grid = [8, 8]
    iterations = 1
    cloths = 6
    batch = 2
    [[pool]]
    grid = [9, 12]
    iterations = 3
    cloths = 4
    batch = 3
    every = 3
    [reset]
    sequence_length = 2
    [validation]
    every = { steps = 4 }
    frames = 2
    iterations = 2
    grids = [[8, 8]]
"#;

pub fn config() -> Config {
    Config::parse(CONFIG, Path::new("test.toml")).unwrap()
}

fn create(root: &Path, learner: Fake) -> Run {
    Run::create(root, CONFIG, config(), Box::new(learner), Rc::new(Alone)).unwrap()
}

pub fn fresh(root: &Path) -> Run {
    create(root, Fake::new(&config()))
}

/// Creates a run of 30 steps.
fn longer(root: &Path, learner: impl FnOnce(Fake) -> Fake) -> Run {
    let text = CONFIG.replace("steps = 12", "steps = 30");
    let config = Config::parse(&text, Path::new("test.toml")).unwrap();
    let learner = Box::new(learner(Fake::new(&config)));
    Run::create(root, &text, config, learner, Rc::new(Alone)).unwrap()
}

pub fn resume(root: &Path) -> fnopt::Result<(Run, Vec<fnopt::Error>)> {
    resume_given(root, None)
}

fn resume_given(root: &Path, given: Option<&Config>) -> fnopt::Result<(Run, Vec<fnopt::Error>)> {
    let learner = |config: &Config| Ok(Box::new(Fake::new(config)) as Box<dyn Learner>);
    Run::resume(root, given, learner, Rc::new(Alone))
}

pub fn train(run: &mut Run, steps: u64) -> End {
    run.train(&Limits { steps: Some(steps), ..Limits::default() }, |_| ControlFlow::Continue(())).unwrap()
}

/// Interrupts a run after step `at`.
pub fn stop(at: u64) -> impl Fn(&Progress<'_>) -> ControlFlow<()> {
    move |progress| if progress.step == at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

fn checkpoints(root: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root.join("checkpoints")).unwrap();
    let mut paths: Vec<_> = entries.map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths
}

pub fn lines(path: PathBuf) -> Vec<String> {
    std::fs::read_to_string(path).unwrap().lines().map(str::to_owned).collect()
}

#[test]
fn a_run_fills_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("run");
    let mut run = fresh(&root);
    let mut validations = 0;
    let end = run.train(&Limits::default(), |progress| {
        validations += usize::from(progress.validation.is_some());
        ControlFlow::Continue(())
    });
    assert_eq!((end.unwrap(), run.step(), run.skipped(), validations), (End::Done, 12, 0, 3));
    assert_eq!(std::fs::read_to_string(root.join("config.toml")).unwrap(), CONFIG);
    let names: Vec<_> = checkpoints(&root).iter().map(|p| p.file_name().unwrap().to_owned()).collect();
    assert_eq!(
        names,
        ["step-00000008.safetensors", "step-00000010.safetensors", "step-00000012.safetensors"]
    );
    let metrics = lines(root.join("metrics.csv"));
    assert_eq!(metrics.len(), 1 + 6);
    assert!(
        metrics[0]
            .starts_with("step,seconds,steps_per_second,rate,skipped,loss,gradient_norm,pool0_8x8_n1_loss")
    );
    assert!(metrics[0].ends_with("pool1_9x12_n3_log_gradient"));
    assert!(metrics[6].starts_with("12,"));
    // The second pool takes part in steps 2, 5, 8 and 11, counted from 0. The first row covers none of them.
    assert!(metrics[1].ends_with(&",".repeat(7)) && !metrics[2].ends_with(','), "{metrics:?}");
    let validation = lines(root.join("validation.csv"));
    assert_eq!(validation.len(), 1 + 3 * 2);
    assert!(validation[1].starts_with("4,swinging 8x8,") && validation[6].starts_with("12,falling 8x8,"));
    let picture = std::fs::read(root.join("plot.png")).unwrap();
    assert_eq!(&picture[..4], b"\x89PNG");
    for name in ["best", "last"] {
        let weights = Weights::load(root.join(format!("weights/{name}.safetensors"))).unwrap();
        assert_eq!(weights.config, config().network);
        let card = std::fs::read(root.join(format!("weights/{name}.json"))).unwrap();
        let card: serde_json::Value = serde_json::from_slice(&card).unwrap();
        assert_eq!(card["parameters"], weights.parameter_count());
        assert_eq!(card["config"]["pool"][1]["grid"], serde_json::json!([9, 12]));
        assert_eq!(card["validation"][0]["scene"], "swinging 8x8");
    }
}

/// The running mean is what is validated and written, not the weights of the last step.
#[test]
fn the_weights_of_a_run_are_the_running_mean() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = fresh(folder.path());
    train(&mut run, 4);
    let bytes = std::fs::read(folder.path().join("checkpoints/step-00000004.safetensors")).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let flat: Vec<f32> = bytemuck::pod_collect_to_vec(file.tensor("weights").unwrap().data());
    let mut averaged = Weights::from_flat(config().network, &flat);
    averaged.scalar.bias[0] += 1.0;
    assert_eq!(run.weights().unwrap(), averaged);
    for name in ["best", "last"] {
        let path = folder.path().join(format!("weights/{name}.safetensors"));
        assert_eq!(Weights::load(path).unwrap(), averaged, "{name}");
    }
    let scores = Validation::new(&config().validation).unwrap();
    let scores = scores.run(&averaged, || ControlFlow::Continue(())).unwrap().unwrap();
    let card = std::fs::read(folder.path().join("weights/last.json")).unwrap();
    let card: serde_json::Value = serde_json::from_slice(&card).unwrap();
    assert_eq!(card["validation"], serde_json::to_value(scores).unwrap());
}

#[test]
fn a_resumed_run_has_the_bits_of_an_unbroken_one() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, broken) = (folder.path().join("whole"), folder.path().join("broken"));
    let mut run = fresh(&whole);
    train(&mut run, 10);
    let slow = |_: &Progress<'_>| {
        std::thread::sleep(std::time::Duration::from_millis(40));
        ControlFlow::Continue(())
    };
    let limits = Limits { steps: Some(5), ..Limits::default() };
    fresh(&broken).train(&limits, slow).unwrap();
    // Rows that a killed run wrote after its checkpoint are discarded.
    let metrics = broken.join("metrics.csv");
    let left = std::fs::read_to_string(&metrics).unwrap();
    std::fs::write(&metrics, left.clone() + &left.lines().last().unwrap().replacen('5', "6", 1) + "\n7,hal")
        .unwrap();
    let seconds = || {
        let card = std::fs::read(broken.join("weights/last.json")).unwrap();
        serde_json::from_slice::<serde_json::Value>(&card).unwrap()["seconds"].as_f64().unwrap()
    };
    let of_first_session = seconds();
    let (mut resumed, passed_over) = resume(&broken).unwrap();
    assert!(passed_over.is_empty());
    assert_eq!(resumed.step(), 5);
    assert_eq!(std::fs::read_to_string(&metrics).unwrap(), left);
    train(&mut resumed, 10);
    assert!(of_first_session > 0.0 && seconds() > of_first_session, "time counts over sessions");
    let bits = |run: &Run| run.weights().unwrap().flat().iter().map(|w| w.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&run), bits(&resumed));
    let state = |root: &Path| {
        let bytes = std::fs::read(root.join("checkpoints/step-00000010.safetensors")).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let mut tensors: Vec<_> = file.iter().map(|(n, view)| (n.to_owned(), view.data().to_vec())).collect();
        tensors.sort();
        let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
        let counters = header.metadata().as_ref().unwrap()["counters"].clone();
        let mut counters: serde_json::Value = serde_json::from_str(&counters).unwrap();
        counters["seconds"] = 0.into();
        (tensors, counters)
    };
    assert_eq!(state(&whole), state(&broken));
}

#[test]
fn a_damaged_checkpoint_is_skipped_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    train(&mut fresh(folder.path()), 6);
    let all = checkpoints(folder.path());
    let newest = std::fs::read(&all[2]).unwrap();
    std::fs::write(&all[2], &newest[..newest.len() - 7]).unwrap();
    let mut flipped = std::fs::read(&all[1]).unwrap();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    std::fs::write(&all[1], flipped).unwrap();
    let (run, passed_over) = resume(folder.path()).unwrap();
    assert_eq!(run.step(), 2);
    let messages: Vec<String> = passed_over.iter().map(ToString::to_string).collect();
    assert!(
        messages.len() == 2 && messages[0].contains("step-00000006") && messages[1].contains("checksum"),
        "{messages:?}"
    );
    std::fs::write(&all[0], "").unwrap();
    drop(run);
    let message = resume(folder.path()).err().expect("no checkpoint is left").to_string();
    assert!(message.contains("checkpoints") && message.contains("a whole one"), "{message}");
}

#[test]
fn runs_are_not_mixed_up() {
    let folder = tempfile::tempdir().unwrap();
    // A run that ended before its first checkpoint has nothing worth keeping.
    fresh(folder.path());
    train(&mut fresh(folder.path()), 2);
    let again = Run::create(folder.path(), CONFIG, config(), Box::new(Fake::new(&config())), Rc::new(Alone));
    let message = again.err().expect("the folder holds a run").to_string();
    assert!(message.contains("in the folder of a new run"), "{message}");
    let other = Config { seed: 2, ..config() };
    let message = resume_given(folder.path(), Some(&other)).err().expect("another configuration").to_string();
    assert!(message.contains("given with --resume"), "{message}");
    std::fs::write(folder.path().join("config.toml"), CONFIG.replace("steps = 12", "steps = 13")).unwrap();
    let message = resume(folder.path()).err().expect("an edited configuration").to_string();
    assert!(message.contains("config.toml") && message.contains("in the checkpoints"), "{message}");
    let message = resume(&folder.path().join("nowhere")).err().expect("no folder").to_string();
    assert!(message.contains("nowhere"), "{message}");
}

#[test]
fn a_checkpoint_of_another_version_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    train(&mut fresh(folder.path()), 2);
    let path = &checkpoints(folder.path())[0];
    let bytes = std::fs::read(path).unwrap();
    let at = bytes.windows(16).position(|w| w == b"fnopt-training-1").unwrap() + 15;
    let mut other = bytes;
    other[at] = b'9';
    std::fs::write(path, other).unwrap();
    let message = resume(folder.path()).err().expect("another version").to_string();
    assert!(message.contains("fnopt-training-1") && message.contains("fnopt-training-9"), "{message}");
}

#[test]
fn steps_that_are_not_finite_are_skipped_and_ten_in_a_row_end_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = create(folder.path(), Fake::new(&config()).broken_at([3, 4, 7]));
    assert_eq!(train(&mut run, 12), End::Done);
    assert_eq!((run.step(), run.skipped()), (12, 3));
    let skipped: Vec<String> = lines(folder.path().join("metrics.csv"))[1..]
        .iter()
        .map(|l| l.split(',').nth(4).unwrap().to_owned())
        .collect();
    assert_eq!(skipped, ["0", "1", "1", "1", "0", "0"]);

    let folder = tempfile::tempdir().unwrap();
    let mut run = create(folder.path(), Fake::new(&config()).broken_at(2..50));
    let last = || Weights::load(folder.path().join("weights/last.safetensors")).unwrap();
    let mut good = None;
    let end = run.train(&Limits::default(), |progress| {
        if progress.step == 2 {
            good = Some(last());
        }
        ControlFlow::Continue(())
    });
    assert_eq!((end.unwrap(), run.step(), run.skipped()), (End::NonFinite, 12, 10));
    assert!(Some(last()) == good, "the weights are not those of the last good step");
    // There is no checkpoint from after it, either.
    let names: Vec<_> =
        checkpoints(folder.path()).iter().map(|p| p.file_name().unwrap().to_owned()).collect();
    assert_eq!(names, ["step-00000002.safetensors"]);
}

/// A step that is too large leaves non-finite weights. No checkpoint and no weights file gets them.
#[test]
fn weights_that_are_not_finite_are_never_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = longer(folder.path(), |fake| fake.overflows_after(3));
    let end = run.train(&Limits::default(), |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(end, End::NonFinite);
    let weights = folder.path().join("weights/last.safetensors");
    assert!(Weights::load(&weights).unwrap().flat().iter().all(|w| w.is_finite()));
    assert!(std::fs::read_to_string(weights.with_extension("json")).unwrap().contains("\"steps\": 2,"));
    drop(run);
    let (run, passed_over) = resume(folder.path()).unwrap();
    assert_eq!((run.step(), passed_over.len()), (2, 0));

    // A session that ends before a step reveals such weights is not done, either.
    let folder = tempfile::tempdir().unwrap();
    let mut run = longer(folder.path(), |fake| fake.overflows_after(3));
    assert_eq!(train(&mut run, 4), End::NonFinite);

    // With nothing to go back to, nothing is written.
    let folder = tempfile::tempdir().unwrap();
    let mut run = longer(folder.path(), |fake| fake.overflows_after(0));
    assert_eq!(run.train(&Limits::default(), |_| ControlFlow::Continue(())).unwrap(), End::NonFinite);
    assert!(!folder.path().join("weights").exists() && !folder.path().join("checkpoints").exists());
    drop(run);
    longer(folder.path(), |fake| fake);
}

/// The weights of a checkpoint may be finite, yet so large that every step from them is non-finite.
#[test]
fn a_checkpoint_that_no_step_follows_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = longer(folder.path(), |fake| fake);
    assert_eq!(run.train(&Limits::default(), stop(5)).unwrap(), End::Interrupted);
    drop(run);
    let learner = |config: &Config| Ok(Box::new(Fake::new(config).broken_at(0..50)) as Box<dyn Learner>);
    for (from, to) in [(5, 4), (4, 2), (2, 2)] {
        let (mut run, _) = Run::resume(folder.path(), None, learner, Rc::new(Alone)).unwrap();
        assert_eq!(run.step(), from);
        assert_eq!(run.train(&Limits::default(), |_| ControlFlow::Continue(())).unwrap(), End::NonFinite);
        drop(run);
        // The last checkpoint is the only one left, so it is kept.
        assert_eq!(resume(folder.path()).unwrap().0.step(), to);
    }
}

#[test]
fn steps_that_are_not_finite_count_over_sessions() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = create(folder.path(), Fake::new(&config()).broken_at(1..50));
    assert_eq!(train(&mut run, 8), End::Done);
    drop(run);
    // An unfinished file of a killed process is removed, too.
    let unfinished = folder.path().join("checkpoints/.writing-abc");
    std::fs::write(&unfinished, "half").unwrap();
    let learner = |config: &Config| Ok(Box::new(Fake::new(config).broken_at(0..50)) as Box<dyn Learner>);
    let (mut run, _) = Run::resume(folder.path(), None, learner, Rc::new(Alone)).unwrap();
    assert!(!unfinished.exists());
    assert_eq!(run.train(&Limits::default(), |_| ControlFlow::Continue(())).unwrap(), End::NonFinite);
    assert_eq!((run.step(), run.skipped()), (11, 10));
}

#[test]
fn an_interrupted_run_and_one_out_of_time_can_be_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = fresh(folder.path());
    assert_eq!(run.train(&Limits::default(), stop(3)).unwrap(), End::Interrupted);
    drop(run);
    let (mut run, _) = resume(folder.path()).unwrap();
    assert_eq!(run.step(), 3);
    let limits = Limits { minutes: Some(1e-9), ..Limits::default() };
    assert_eq!(run.train(&limits, stop(0)).unwrap(), End::Done);
    assert_eq!(run.step(), 4);
}

#[test]
fn a_folder_is_of_one_run_and_of_one_process_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |run: fnopt::Result<()>, said: &str| {
        let error = run.expect_err("it is refused").to_string();
        assert!(error.contains(said), "{error}");
    };
    let again =
        || Run::create(folder.path(), CONFIG, config(), Box::new(Fake::new(&config())), Rc::new(Alone));
    let mut run = fresh(folder.path());
    refused(again().map(drop), "no other process training in the folder");
    // A run without any steps can be resumed.
    train(&mut run, 0);
    refused(resume(folder.path()).map(drop), "no other process training in the folder");
    drop(run);
    assert_eq!(resume(folder.path()).unwrap().0.step(), 0);
    refused(again().map(drop), "checkpoints");
    std::fs::remove_dir_all(folder.path().join("checkpoints")).unwrap();
    refused(again().map(drop), "last.safetensors");
}

/// The rate depends on all steps, AdamW's bias correction and the running mean only on those that were taken.
#[test]
fn each_step_gets_its_rate_and_number() {
    let folder = tempfile::tempdir().unwrap();
    let more = "average = 0.3\noptimizer = { rate = 1e-2 }\nschedule = { warmup = 4, decay = { cosine = { final = 1e-4 } } }\n";
    let text = more.to_owned() + CONFIG;
    let config = Config::parse(&text, Path::new("test.toml")).unwrap();
    let learner = Fake::new(&config).broken_at([2]);
    let updates = learner.updates.clone();
    train(&mut Run::create(folder.path(), &text, config, Box::new(learner), Rc::new(Alone)).unwrap(), 12);
    let updates = updates.borrow();
    assert_eq!(updates.len(), 12);
    for (step, update) in updates.iter().enumerate() {
        // The third step was not finite.
        let number = if step < 3 { step + 1 } else { step };
        let rate = match step {
            0..4 => 1e-2 * (step + 1) as f64 / 4.0,
            _ => {
                let cosine = (std::f64::consts::PI * (step - 4) as f64 / 8.0).cos();
                1e-4 + (1e-2 - 1e-4) * 0.5 * (1.0 + cosine)
            }
        };
        let average = (number as f64 / (number + 9) as f64).min(0.3);
        assert_eq!((update.number, update.average), (number as u64, average), "step {step}");
        assert!((update.rate - rate).abs() < 1e-12, "step {step}: {} is not {rate}", update.rate);
    }
}

#[test]
fn tables_of_others_are_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let metrics = folder.path().join("metrics.csv");
    std::fs::write(&metrics, "mine\n1\n").unwrap();
    let new = || Run::create(folder.path(), CONFIG, config(), Box::new(Fake::new(&config())), Rc::new(Alone));
    let error = new().map(drop).expect_err("it is refused").to_string();
    assert!(error.contains("metrics.csv"), "{error}");
    std::fs::remove_file(&metrics).unwrap();
    let mut run = new().unwrap();
    train(&mut run, 2);
    drop(run);
    // A table of a version with other columns.
    std::fs::write(&metrics, "step,other\n1,2\n").unwrap();
    train(&mut resume(folder.path()).unwrap().0, 3);
    assert_eq!(lines(folder.path().join("metrics.csv.old")), ["step,other", "1,2"]);
    assert!(lines(metrics)[0].starts_with("step,") && !folder.path().join("metrics.csv.csv.old").exists());
}

#[test]
fn no_step_is_lost_where_metrics_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = fresh(folder.path());
    let metrics = folder.path().join("metrics.csv");
    std::fs::remove_file(&metrics).unwrap();
    train(&mut run, 1);
    // A missing file is started again. A folder in its place ends the session after the next row.
    assert!(lines(metrics.clone())[0].starts_with("step,") && lines(metrics.clone())[1].starts_with("1,"));
    std::fs::remove_file(&metrics).unwrap();
    std::fs::create_dir(&metrics).unwrap();
    let error = run.train(&Limits::default(), |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(error.contains("metrics.csv"), "{error}");
    drop(run);
    std::fs::remove_dir(&metrics).unwrap();
    assert_eq!(resume(folder.path()).unwrap().0.step(), 2);
}

#[test]
fn the_best_weights_are_those_that_the_folder_holds() {
    let folder = tempfile::tempdir().unwrap();
    train(&mut fresh(folder.path()), 2);
    let best = folder.path().join("weights/best.json");
    let card = std::fs::read_to_string(&best).unwrap();
    let mut card: serde_json::Value = serde_json::from_str(&card).unwrap();
    // Unbeatable scores, so these weights are kept.
    for scene in card["validation"].as_array_mut().unwrap() {
        (scene["gap"], scene["sound"], scene["stretch_largest"]) = (0.into(), true.into(), 0.1.into());
    }
    let kept = serde_json::to_string(&card).unwrap();
    std::fs::write(&best, &kept).unwrap();
    train(&mut resume(folder.path()).unwrap().0, 4);
    assert_eq!(std::fs::read_to_string(&best).unwrap(), kept);
    // Weights that beat the best ones replace them.
    for scene in card["validation"].as_array_mut().unwrap() {
        (scene["gap"], scene["sound"]) = (10.into(), false.into());
    }
    std::fs::write(&best, serde_json::to_string(&card).unwrap()).unwrap();
    train(&mut resume(folder.path()).unwrap().0, 8);
    let replaced: serde_json::Value = serde_json::from_slice(&std::fs::read(&best).unwrap()).unwrap();
    assert_eq!(replaced["steps"], 8);
    // An unreadable card does not make the run give them up.
    std::fs::write(&best, "{").unwrap();
    let error = resume(folder.path()).err().expect("a card that ends after its first letter").to_string();
    assert!(error.contains("best.json") && error.contains("validation"), "{error}");
    assert_eq!(std::fs::read_to_string(&best).unwrap(), "{");
    std::fs::write(&best, &kept).unwrap();
    // Without best weights, the next ones take their place.
    std::fs::remove_file(folder.path().join("weights/best.safetensors")).unwrap();
    train(&mut resume(folder.path()).unwrap().0, 12);
    assert_ne!(std::fs::read_to_string(&best).unwrap(), kept);
}

#[test]
fn the_last_good_checkpoint_survives_one_that_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    train(&mut fresh(folder.path()), 2);
    // A folder of this name stands in for a full disk: the file is written but cannot take its place.
    let taken = folder.path().join("checkpoints/step-00000004.safetensors");
    std::fs::create_dir(&taken).unwrap();
    let (mut run, _) = resume(folder.path()).unwrap();
    let limits = Limits { steps: Some(6), ..Limits::default() };
    let error = run.train(&limits, |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(error.contains("step-00000004") && error.contains("cannot write"), "{error}");
    assert_eq!(checkpoints(folder.path()).len(), 2, "no half-written file is left");
    drop(run);
    let (run, passed_over) = resume(folder.path()).unwrap();
    assert_eq!((run.step(), passed_over.len()), (2, 1));
}
