//! Validation: its scenes and score, and how a run makes up for one that is missing.

use super::run::{CONFIG, config, fresh, lines, resume, stop, train};
use super::support::Fake;
use fnopt::cloth::Grid;
use fnopt::eval::FreeEdges;
use fnopt::scene::{Motion, Scene, Start};
use fnopt::sim::Optimizer;
use fnopt::train::{
    Alone, Config, End, Limits, Progress, Run, SceneScore, Validation, ValidationConfig, initial_weights,
};
use fnopt::{Device, Simulator};
use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The scenes are as long as configured, and in the last one nothing moves the handles.
#[test]
fn scenes_of_a_validation_are_those_of_its_configuration() {
    let settings = ValidationConfig { frames: 100, grids: vec![Grid { h: 9, w: 8 }], ..config().validation };
    let validation = Validation::new(&settings).unwrap();
    let weights = initial_weights(&config(), &Alone).unwrap();
    let mut frames = 0;
    let mut tick = || {
        frames += 1;
        ControlFlow::Continue(())
    };
    let scores = validation.run(&weights, &mut tick).unwrap().unwrap();
    // Of the hanging sheet: a rollout, Newton's frames, and the gap on each. The falling one has no gap.
    assert_eq!(frames, 4 * 100);
    let mut scene = Scene { start: Start::Flat, motion: Motion::Still, ..Scene::default() };
    scene.regrid(settings.grids[0]).unwrap();
    let setup = scene.setup().unwrap();
    let optimizer = Optimizer::paper(weights);
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &optimizer, settings.iterations).unwrap();
    simulator.set_state(&setup.start.cast());
    let edges = FreeEdges::new(&setup.model, 0);
    let stretch = (1..101)
        .map(|frame| edges.largest(&simulator.step(&setup.control(frame)).unwrap().state.x))
        .fold(0.0, f64::max);
    assert_eq!((scores[1].scene.as_str(), scores[1].stretch_largest), ("falling 9x8", Some(stretch)));
}

#[test]
fn an_unsound_rollout_outweighs_any_gap() {
    let scene =
        |gap: Option<f64>, sound| SceneScore { scene: "x".into(), gap, stretch_largest: Some(0.1), sound };
    let score = |scores: &[SceneScore]| Validation::score(scores);
    assert!((score(&[scene(Some(0.1), true), scene(Some(0.3), true)]) - 0.2).abs() < 1e-12);
    assert_eq!(score(&[scene(Some(0.1), true), scene(None, true)]), 0.05);
    for unsound in [scene(Some(0.1), false), scene(None, false), scene(Some(f64::NAN), true)] {
        assert_eq!(score(&[unsound]), 10.0);
    }
}

/// A run that ends during a validation does not lose that validation.
#[test]
fn a_validation_that_was_cut_off_is_made_up_for() {
    let folder = tempfile::tempdir().unwrap();
    let [mut run, mut whole] = [fresh(folder.path()), fresh(&folder.path().join("whole"))];
    assert_eq!((train(&mut run, 12), train(&mut whole, 12)), (End::Done, End::Done));
    let of = |file: &str| [folder.path().join(file), folder.path().join("whole").join(file)];
    let [table, of_whole] = of("validation.csv").map(lines);
    assert_eq!(table, of_whole);
    drop(run);
    // As if the run had been killed in its last validation.
    let cut: String =
        table.iter().filter(|row| !row.starts_with("12,")).map(|row| format!("{row}\n")).collect();
    assert!(cut.lines().count() < table.len());
    std::fs::write(folder.path().join("validation.csv"), cut).unwrap();
    for resumed in 0..2 {
        let (mut run, _) = resume(folder.path()).unwrap();
        let mut told = Vec::new();
        let watch = |progress: &Progress<'_>| {
            told.push((progress.step, progress.report.is_some(), progress.validation.map(<[_]>::len)));
            ControlFlow::Continue(())
        };
        assert_eq!(run.train(&Limits::default(), watch).unwrap(), End::Done, "{resumed}");
        assert_eq!(told, if resumed == 0 { vec![(12, false, Some(2))] } else { vec![] });
        assert_eq!(lines(folder.path().join("validation.csv")), of_whole);
    }

    // An existing validation is not repeated after further steps.
    let folder = tempfile::tempdir().unwrap();
    let stop_at = |run: &mut Run, step| {
        assert_eq!(run.train(&Limits::default(), stop(step)).unwrap(), End::Interrupted);
    };
    let mut run = fresh(folder.path());
    stop_at(&mut run, 4);
    drop(run);
    let rows = lines(folder.path().join("validation.csv")).len();
    let (mut run, _) = resume(folder.path()).unwrap();
    stop_at(&mut run, 5);
    drop(run);
    stop_at(&mut resume(folder.path()).unwrap().0, 6);
    assert_eq!(lines(folder.path().join("validation.csv")).len(), rows);
}

#[test]
fn a_validation_that_is_interrupted_is_made_up_for() {
    let folder = tempfile::tempdir().unwrap();
    let text = CONFIG.replace("every = { steps = 4 }", "every = { steps = 1 }");
    let config = Config::parse(&text, Path::new("test.toml")).unwrap();
    let learner = Box::new(Fake::new(&config));
    let mut run = Run::create(folder.path(), &text, config, learner, Rc::new(Alone)).unwrap();
    let interrupted = AtomicBool::new(true);
    // The first step is the last. Without its validation, the session is not done.
    let limits = Limits { steps: Some(1), interrupted: Some(&interrupted), ..Limits::default() };
    let watch =
        |_: &Progress<'_>| -> ControlFlow<()> { panic!("the step was reported without its validation") };
    assert_eq!(run.train(&limits, watch).unwrap(), End::Interrupted);
    drop(run);
    let mut run = resume(folder.path()).unwrap().0;
    assert_eq!(run.train(&limits, watch).unwrap(), End::Interrupted);
    drop(run);
    let rows = || lines(folder.path().join("validation.csv")).len();
    assert_eq!(rows(), 1);
    interrupted.store(false, Ordering::Relaxed);
    let mut run = resume(folder.path()).unwrap().0;
    let watch = |progress: &Progress<'_>| {
        assert!(progress.report.is_none() && progress.validation.is_some());
        ControlFlow::Continue(())
    };
    assert_eq!((run.train(&limits, watch).unwrap(), run.step()), (End::Done, 1));
    assert_eq!(rows(), 3);
}

#[test]
fn a_validation_that_fails_again_leaves_the_run_going() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = fresh(folder.path());
    let best = folder.path().join("weights/best.safetensors");
    std::fs::create_dir_all(&best).unwrap();
    // Validation is due after four steps and cannot save the weights that it finds best. No step is lost.
    let limits = Limits { steps: Some(6), ..Limits::default() };
    let error = run.train(&limits, |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(error.contains("best.safetensors"), "{error}");
    drop(run);
    assert_eq!(resume(folder.path()).unwrap().0.step(), 4);
    // The validation after step 4 is due again, and fails again. Later steps do not wait for it.
    let (mut run, _) = resume(folder.path()).unwrap();
    let limits = Limits { steps: Some(5), ..Limits::default() };
    run.train(&limits, |progress| {
        assert!(progress.step == 5);
        ControlFlow::Continue(())
    })
    .unwrap_err();
    drop(run);
    assert_eq!(resume(folder.path()).unwrap().0.step(), 5);
}
