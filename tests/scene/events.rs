//! Handles that follow bodies, and what changes on the way.

use crate::common::{distance, expect_refusal, parse};
use fnopt::cloth::{Control, Grid, State};
use fnopt::scene::{Course, Handles, Lead, Scene, Script, Scripts};
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};
use glam::DVec3;
use std::ops::ControlFlow;

/// A rod that moves and turns, with two of the four handles on it.
const ATTACHED: &str = r#"{
    "grid": [12, 12], "start": "hanging", "handles": [[0, 0], [4, 0], [7, 0], [11, 0]], "motion": "updown",
    "attached": [{"body": 0, "handles": [0, 3]}], "frames": 60,
    "bodies": [{"shape": "capsule", "radius_m": 0.02, "length_m": 1, "axis": [0, 0, 1], "motion": [
        {"time_s": 0, "position_m": [0, 0.55, 0]},
        {"time_s": 1, "position_m": [0.5, 0.55, 0.1], "rotation": [50, 0, 1, 0]}]}]
}"#;

/// Attached handles keep their place on the body, and the others follow the motion.
#[test]
fn attached_handles_follow_their_body_rigidly() {
    let setup = parse(ATTACHED).unwrap().setup().unwrap();
    let alone = parse(&ATTACHED.replace(r#""body": 0, "handles": [0, 3]"#, r#""body": 0, "handles": []"#));
    let alone = alone.unwrap().setup().unwrap();
    let own = |frame: usize, handle: usize| {
        let place = setup.handles[frame][handle];
        setup.poses[0][frame].inward(DVec3::from(place)).to_array()
    };
    for frame in 0..60 {
        for handle in [0, 3] {
            assert!(distance(own(frame, handle), own(0, handle)) < 1e-12, "frame {frame}, handle {handle}");
        }
        for handle in [1, 2] {
            assert_eq!(setup.handles[frame][handle], alone.handles[frame][handle]);
        }
    }
    assert!(distance(setup.handles[59][0], setup.handles[0][0]) > 5.0, "it moves");
    assert_eq!(setup.start, alone.start, "the start is where it was");
}

/// Two of three handles are let go, others are grabbed by a body that turns, and all is changed that can be.
const EVENTS: &str = r#"{
    "grid": [12, 12], "start": "hanging", "handles": [[0, 0], [5, 0], [11, 0]], "motion": "none", "frames": 40,
    "bodies": [
        {"shape": "sphere", "radius_m": 0.1, "visible": false, "motion": [
            {"time_s": 0.2, "position_m": [0.3, 0, 0]}, {"time_s": 0.6, "position_m": [0.4, 0.1, 0], "rotation": [90, 1, 0, 0]}]},
        {"shape": "plane", "position_m": [0, -2, 0]}],
    "events": [
        {"frame": 10, "release": [[0, 0], [11, 0]]},
        {"frame": 10, "gravity": 3, "show": [0], "hide": [1]},
        {"frame": 20, "grab": [[6, 11]], "body": 0},
        {"frame": 20, "grab": [[0, 0]], "wind": {"velocity": [0, 0, 2], "density": 2}},
        {"frame": 30, "release": "all", "material": {"stretch": 500, "shear": 4, "bend": 1}}
    ]
}"#;

#[test]
fn events_change_the_cloth_on_the_way() {
    let scene = parse(EVENTS).unwrap();
    let setup = scene.setup().unwrap();
    let [first, second, third] = &setup.changes[..] else { panic!("{:?}", setup.changes) };
    assert_eq!([first.frame, second.frame, third.frame], [10, 20, 30]);
    let start = &setup.model.cloths[0];
    assert_eq!(start.bodies.iter().map(|body| body.present).collect::<Vec<_>>(), [false, true]);
    assert_eq!(first.cloth.bodies.iter().map(|body| body.present).collect::<Vec<_>>(), [true, false]);
    assert_eq!((&first.cloth.handles[..], &first.leads[..]), (&[60][..], &[Lead::Motion(1)][..]));
    assert!((first.cloth.gravity[2] / start.gravity[2] - 3.0 / 9.8).abs() < 1e-12);
    assert_eq!(second.cloth.handles, [60, 6 * 12 + 11, 0]);
    assert_eq!(second.leads, [Lead::Motion(1), Lead::Body(0), Lead::Place]);
    assert_eq!(second.cloth.air.density, 2.0 * start.air.density);
    assert_eq!((third.cloth.handles.len(), third.cloth.material.bend), (0, 1.0));
    assert_eq!(third.cloth.gravity, first.cloth.gravity, "what was changed stays");
    let again = Scene::parse(&scene.to_json().to_string(), "scene.json", "".as_ref()).unwrap();
    assert_eq!(again.events, scene.events);
    assert_eq!(again.setup().unwrap().changes, setup.changes);
}

/// A grabbed particle stays at the point of its body, or of space, at which it was grabbed; one that is let go falls.
#[test]
fn grabbed_particles_are_led_from_where_they_are() {
    let setup = parse(EVENTS).unwrap().setup().unwrap();
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::spectral(), 5).unwrap();
    simulator.set_state(&setup.start.cast());
    let mut frames: Vec<State<f32>> = vec![setup.start.cast()];
    let mut script = Script::new(&setup);
    let mut taken = Vec::new();
    simulator
        .play(&mut script, |script, frame| {
            taken.push((frame.index, script.cloth().handles.len()));
            frames.push(frame.state);
            ControlFlow::Continue(())
        })
        .unwrap();
    let expected = (1..40).map(|f| (f, [3, 1, 3, 0][f / 10]));
    assert_eq!(taken, expected.collect::<Vec<_>>());
    let place = |frame: usize, p: usize| [p, 144 + p, 288 + p].map(|k| f64::from(frames[frame].x[k]));
    let own = |frame: usize, p: usize| {
        let pose = setup.poses[0][frame.min(setup.poses[0].len() - 1)];
        pose.inward(DVec3::from(place(frame, p))).to_array()
    };
    for frame in 20..30 {
        assert!(distance(own(frame, 83), own(19, 83)) < 1e-5, "frame {frame}");
        assert!(distance(place(frame, 0), place(19, 0)) < 1e-6);
        assert!(distance(place(frame, 60), place(0, 60)) < 1e-6);
    }
    assert!(distance(place(29, 83), place(19, 83)) > 0.3, "the body moves");
    let fell = distance(place(19, 0), place(9, 0));
    assert!(fell > 1e-3 && distance(place(9, 0), place(0, 0)) < 1e-6, "it was let go: {fell}");
    assert!(distance(place(39, 60), place(29, 60)) > 0.02, "all were let go");
    // A script that goes on in between leads to the same places.
    let before = Script::resume(&setup, 25, script_at(&setup, &frames, 25).anchors()).unwrap();
    let (one, other): (Control<f64>, Control<f64>) =
        (before.control(26), script_at(&setup, &frames, 26).control(26));
    assert_eq!(one, other);
    assert!(Script::resume(&setup, 25, &[0.0; 6]).unwrap_err().to_string().contains("9 finite numbers"));
}

/// Returns the script after the frames up to `last`.
fn script_at<'a>(setup: &'a fnopt::scene::Setup, frames: &[State<f32>], last: usize) -> Script<'a> {
    let mut script = Script::new(setup);
    for frame in 1..=last {
        script.enter(frame, &frames[frame - 1]);
    }
    script
}

/// A body that is not there touches nothing, and does from the frame on that shows it.
#[test]
fn a_body_that_appears_is_met() {
    let text = r#"{
        "grid": [10, 10], "start": "flat", "handles": [], "motion": "none", "frames": 50, "wind": {"density": 0},
        "bodies": [{"shape": "plane", "position_m": [0, -0.5, 0], "visible": false}],
        "events": [{"frame": 5, "show": [0]}, {"frame": 40, "hide": [0]}]
    }"#;
    let setup = parse(text).unwrap().setup().unwrap();
    let lowest = |state: &State<f32>| state.x[200..].iter().fold(f32::MAX, |low, z| low.min(*z));
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::spectral(), 10).unwrap();
    simulator.set_state(&setup.start.cast());
    let mut gaps = Vec::new();
    simulator
        .play(&mut Script::new(&setup), |_, frame| {
            gaps.push(f64::from(lowest(&frame.state)) - setup.poses[0][0].position[2]);
            ControlFlow::Continue(())
        })
        .unwrap();
    assert!(gaps[..39].iter().all(|gap| *gap > 0.0), "{gaps:?}");
    assert!(gaps[38] < 0.2, "it lies on the plane: {}", gaps[38]);
    assert!(gaps[48] < -0.1, "and falls through it where it is no longer: {}", gaps[48]);
}

#[test]
fn wrong_attachments_and_events_are_refused() {
    let with = |fields: &str| {
        format!(
            r#"{{"grid": [12, 12], "motion": "none", "frames": 40, "bodies": [{{"shape": "plane", "position_m": [0, -2, 0]}}], {fields}}}"#
        )
    };
    for (fields, said) in [
        (r#""attached": [{"handles": [0]}]"#, &["attached[0]", "a \"body\""][..]),
        (r#""attached": [{"body": 1}]"#, &["attached[0].body", "below 1", "found 1"]),
        (r#""attached": [{"body": 0, "handles": [2]}]"#, &["attached[0].handles[0]", "2 handles"]),
        (
            r#""attached": [{"body": 0}, {"body": 0, "handles": [1]}]"#,
            &["attached[1].handles[0]", "not attached"],
        ),
        (r#""attached": [{"bodi": 0}]"#, &["attached[0]", "bodi", "did you mean body"]),
        (r#""events": [{"release": "all"}]"#, &["events[0]", "\"frame\""]),
        (r#""events": [{"frame": 0}]"#, &["events[0].frame", "1 to 39", "found 0"]),
        (r#""events": [{"frame": 40}]"#, &["events[0].frame", "1 to 39", "found 40"]),
        (r#""events": [{"frame": 9}, {"frame": 8}]"#, &["events[1].frame", "9 or later", "order of time"]),
        (r#""events": [{"frame": 9, "release": "cornrs"}]"#, &["events[0].release", "cornrs", "corners"]),
        (r#""events": [{"frame": 9, "release": [[3, 3]]}]"#, &["events[0].release", "held", "(3, 3)"]),
        (r#""events": [{"frame": 9, "grab": [[0, 0]]}]"#, &["events[0].grab", "not held", "(0, 0)"]),
        (r#""events": [{"frame": 9, "grab": [[0, 12]]}]"#, &["events[0].grab", "j below 12"]),
        (r#""events": [{"frame": 9, "grab": [[0, 3]], "body": 4}]"#, &["events[0].body", "below 1"]),
        (r#""events": [{"frame": 9, "body": 0}]"#, &["events[0].body", "grab"]),
        (r#""events": [{"frame": 9, "hide": [7]}]"#, &["events[0].hide[0]", "below 1"]),
        (r#""events": [{"frame": 9, "wind": {"density": -1}}]"#, &["events[0].wind.density", "0 or more"]),
        (r#""events": [{"frame": 9, "material": {"bend": -1}}]"#, &["events[0].material.bend", "0 or more"]),
        (r#""events": [{"frame": 9, "gravity": 1e300}]"#, &["gravity", "overflow"]),
        (r#""events": [{"frame": 9, "let_go": "all", "grabs": []}]"#, &["unknown field"]),
    ] {
        expect_refusal(&with(fields), said);
    }
    expect_refusal(r#"{"attached": [{"body": 0}]}"#, &["attached[0].body", "\"bodies\""]);
    let setup = parse(EVENTS).unwrap().setup().unwrap();
    let error = fnopt::scene::Setup::batch(&[setup]).unwrap_err().to_string();
    assert!(error.contains("cloth 0") && error.contains("frame 10"), "{error}");
}

/// On another grid, events name the nearest particles.
#[test]
fn events_move_to_another_grid() {
    let mut scene = parse(EVENTS).unwrap();
    scene.regrid(fnopt::cloth::Grid { h: 23, w: 23 }).unwrap();
    let setup = scene.setup().unwrap();
    assert_eq!(setup.changes[1].cloth.handles, [10 * 23, 12 * 23 + 22, 0]);
}

/// On a coarser grid handles may become one; attachments follow by number.
#[test]
fn attachments_follow_their_handles_to_another_grid() {
    let text = r#"{"grid": [32, 32], "motion": "none", "handles": [[0, 0], [0, 1], [31, 31], [15, 15]],
        "bodies": [{"shape": "plane", "position_m": [0, -9, 0]}, {"shape": "plane", "position_m": [0, -8, 0]}],
        "attached": [{"body": 0, "handles": [1, 3]}, {"body": 1, "handles": [0, 2]}]}"#;
    let mut scene = parse(text).unwrap();
    scene.regrid(Grid { h: 8, w: 8 }).unwrap();
    assert_eq!(scene.handles, Handles::Cells(vec![[0, 0], [7, 7], [3, 3]]));
    // The first two are one, which the first attachment has.
    let attached: Vec<_> = scene.attached.iter().map(|of| (of.body, of.handles.clone().unwrap())).collect();
    assert_eq!(attached, [(0, vec![0, 2]), (1, vec![1])]);
    scene.setup().unwrap();
}

/// Scenes with events of their own advance together as each does alone.
#[test]
fn scenes_with_events_advance_together() {
    let moving = parse(ATTACHED).unwrap().setup().unwrap();
    let still = parse(EVENTS).unwrap().setup().unwrap();
    let plain = parse(r#"{"grid": [12, 12], "start": "hanging", "frames": 20}"#).unwrap().setup().unwrap();
    let setups = [moving, still, plain];
    let (mut scripts, batch) = Scripts::new(&setups).unwrap();
    assert_eq!((batch.frames(), scripts.each().len()), (60, 3));
    let optimizer = Optimizer::spectral();
    let mut together = Simulator::new(&Device::Cpu, &batch.model, &optimizer, 5).unwrap();
    together.set_state(&batch.start.cast());
    let mut states = Vec::new();
    let took = together.play(&mut scripts, |_, frame| {
        states.push(frame.state.x);
        ControlFlow::Continue(())
    });
    took.unwrap();
    assert_eq!(states.len(), 59);
    for (b, setup) in setups.iter().enumerate() {
        let mut alone = Simulator::new(&Device::Cpu, &setup.model, &optimizer, 5).unwrap();
        alone.set_state(&setup.start.cast());
        let played = alone.play(&mut Script::new(setup), |_, frame| {
            let all = &states[frame.index - 1];
            let len = all.len() / 3;
            assert_eq!(all[b * len..(b + 1) * len], frame.state.x, "cloth {b}, frame {}", frame.index);
            ControlFlow::Continue(())
        });
        played.unwrap();
    }
    assert!(setups[1].changes.len() > 1);
}

/// A host that keeps the anchors alone goes through the same frames.
#[test]
fn courses_go_on_from_their_anchors() {
    let setups = [ATTACHED, EVENTS].map(|text| parse(text).unwrap().setup().unwrap());
    let (mut whole, batch) = Scripts::new(&setups).unwrap();
    let start = batch.start.cast();
    let anchors_of = |scripts: &Scripts| -> Vec<Vec<f64>> {
        scripts.each().iter().map(|script| script.anchors().to_vec()).collect()
    };
    let (mut entered, mut anchors) = (0, anchors_of(&whole));
    for frame in 1..batch.frames() {
        let mut resumed = Scripts::resume(&setups, entered, &anchors).unwrap();
        assert_eq!((resumed.frames(), resumed.next_change()), (batch.frames(), whole.next_change()));
        let cloths = resumed.enter(frame, &start);
        assert_eq!(cloths, whole.enter(frame, &start));
        if cloths.is_some() {
            (entered, anchors) = (frame, anchors_of(&resumed));
        }
        assert_eq!(resumed.control(frame), whole.control(frame), "frame {frame}");
    }
    assert!(entered > 0);
    let error = Scripts::resume(&setups, entered, &anchors[..1]).unwrap_err().to_string();
    assert!(error.contains("anchors: expected those of 2 scenes, found 1"), "{error}");
}
