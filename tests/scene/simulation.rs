//! Simulations that own their scenes, in SI units.

use fnopt::scene::{BodyPose, Script};
use fnopt::{
    Device, DeviceChoice, DeviceKind, Optimizer, Prescribed, Scene, Simulation, SimulationOptions, Simulator,
};
use std::ops::ControlFlow;
use std::path::Path;

/// A sheet that lets go of one of its two handles and meets a wind.
const SCENE: &str = r#"{"grid": [10, 8], "frames": 20, "up": "z", "handles": [[0, 0], [9, 0]], "start": "flat",
    "motion": "none", "events": [{"frame": 6, "release": [[0, 0]]}, {"frame": 9, "wind": {"velocity": [3, 0, 0]}}]}"#;

fn scene() -> Scene {
    Scene::parse(SCENE, "a scene", Path::new("")).unwrap()
}

fn on_the_cpu() -> SimulationOptions {
    SimulationOptions { iterations: Some(4), device: DeviceChoice::cpu(), ..Default::default() }
}

fn simulation(scenes: &[&Scene], copies: usize) -> Simulation {
    let options = SimulationOptions { copies, ..on_the_cpu() };
    Simulation::of(scenes, &Optimizer::spectral(), &options).unwrap()
}

#[test]
fn frames_are_those_of_the_scene_with_its_events() {
    let setup = scene().setup().unwrap();
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::spectral(), 4).unwrap();
    simulator.set_state(&setup.start.cast());
    let mut expected = Vec::new();
    let played = simulator.play(&mut Script::new(&setup), |_, frame| {
        expected.push(frame.state);
        ControlFlow::Continue(())
    });
    played.unwrap();
    // Three cloths of the same scene, and in one of them nothing is prescribed differently.
    let mut simulation = simulation(&[&scene()], 3);
    assert_eq!((simulation.frames(), simulation.setups().len()), (20, 3));
    let mut held = Vec::new();
    for expected in &expected {
        let prescribed = simulation.prescribed().unwrap();
        let frame = simulation.step_with(&prescribed).unwrap();
        for (b, x) in frame.state.x.chunks_exact(expected.x.len()).enumerate() {
            let far = x.iter().zip(&expected.x).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            // Targets went to metres and back.
            assert!(far < 1e-4, "frame {}, cloth {b}: {far} edges", frame.index);
        }
        held.push(simulation.cloths()[2].handles.len());
    }
    assert_eq!((held[4], held[5]), (2, 1));
    // In the scene's axes, z up, the sheet has fallen.
    let n = simulation.particles();
    let lowest = simulation.positions()[2 * n..].iter().map(|p| p[2]).fold(f32::INFINITY, f32::min);
    assert!(lowest < -0.3, "{lowest} m");
    assert!(simulation.velocities().iter().any(|v| v[2] < -0.5));
}

#[test]
fn a_snapshot_and_the_start_can_be_gone_back_to() {
    let mut simulation = simulation(&[&scene()], 1);
    let start = simulation.positions();
    let run = |simulation: &mut Simulation, frames: usize| {
        (0..frames).for_each(|_| assert!(simulation.step().is_ok()));
        simulation.positions()
    };
    run(&mut simulation, 7);
    let snapshot = simulation.snapshot().unwrap();
    let expected = run(&mut simulation, 5);
    simulation.restore(&snapshot).unwrap();
    assert_eq!(simulation.frame().index, 7);
    assert_eq!(run(&mut simulation, 5), expected, "the same bits");
    simulation.reset().unwrap();
    assert_eq!((simulation.positions(), simulation.cloths()[0].handles.len()), (start, 2));
    assert_eq!(run(&mut simulation, 12), expected, "the same bits from the start");
}

#[test]
fn what_is_prescribed_is_checked_and_done() {
    let mut simulation = simulation(&[&scene()], 1);
    let refused = |simulation: &mut Simulation, given: Prescribed| {
        simulation.step_with(&given).map(|_| ()).unwrap_err().to_string()
    };
    let few = Prescribed { handles: Some(vec![[0.0; 3]]), ..Default::default() };
    let error = refused(&mut simulation, few);
    assert!(error.contains("handles") && error.contains("expected 2"), "{error}");
    let infinite = Prescribed { wind: Some(vec![[f64::INFINITY; 3]]), ..Default::default() };
    let error = refused(&mut simulation, infinite);
    assert!(error.contains("wind[0]") && error.contains("finite"), "{error}");
    assert_eq!(simulation.frame().index, 0, "nothing was computed");

    let mut prescribed = simulation.prescribed().unwrap();
    let handles = prescribed.handles.as_mut().unwrap();
    handles[0][2] += 0.05;
    let target = handles[0].map(|v| v as f32);
    simulation.step_with(&prescribed).unwrap();
    let at = simulation.positions()[simulation.cloths()[0].handles[0]];
    let far = at.iter().zip(target).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 1e-6, "{at:?} m, not {target:?}");

    let none = SimulationOptions { copies: 0, ..on_the_cpu() };
    let error = Simulation::of(&[&scene()], &Optimizer::spectral(), &none).err().unwrap().to_string();
    assert!(error.contains("at least one"), "{error}");
}

/// Returns a vector that is z up in the axes of a scene with this axis up.
fn in_axes(up: &str, [x, y, z]: [f64; 3]) -> [f64; 3] {
    if up == "z" { [x, y, z] } else { [x, z, -y] }
}

/// A sheet that hangs from a rod by one corner, and from a place by the other, with a ball beside it.
fn with_bodies(up: &str, motions: [&str; 2]) -> Scene {
    let [rod, ball] = motions;
    let (of_rod, of_ball) = (in_axes(up, [0.0, -0.1, 0.0]), in_axes(up, [0.3, -0.4, -0.5]));
    let text = format!(
        r#"{{"grid": [10, 10], "frames": 20, "up": "{up}", "handles": [[0, 0], [0, 9]], "start": "hanging", "motion": "none",
            "bodies": [{{"shape": "capsule", "radius_m": 0.02, "length_m": 1, "position_m": {of_rod:?} {rod}}},
                       {{"shape": "sphere", "radius_m": 0.1, "position_m": {of_ball:?} {ball}}}],
            "attached": [{{"handles": [0], "body": 0}}],
            "events": [{{"frame": 12, "grab": [[9, 5]], "body": 1}}]}}"#
    );
    Scene::parse(&text, "a scene", Path::new("")).unwrap()
}

/// A host leads bodies where a scene would, and what is attached to them, grabbed by them or in their way cannot tell.
#[test]
fn bodies_that_a_host_leads_act_as_those_of_a_scene() {
    let frame_s = Scene::default().frame_time_s;
    let turn = 40.0;
    for up in ["z", "y"] {
        let place = |k: usize, frame: usize| {
            let t = frame as f64;
            in_axes(up, [[0.0, -0.1 - 0.004 * t, 0.002 * t], [0.3, -0.4 + 0.03 * t, -0.5]][k])
        };
        let axis = |k: usize| in_axes(up, [[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]][k]);
        let keys = |k: usize| {
            let key = |frame: usize| {
                let ([x, y, z], degrees) = (axis(k), turn * frame as f64 / 19.0);
                format!(
                    r#"{{"time_s": {}, "position_m": {:?}, "rotation": [{degrees}, {x}, {y}, {z}]}}"#,
                    frame as f64 * frame_s,
                    place(k, frame)
                )
            };
            format!(r#", "motion": [{}, {}]"#, key(0), key(19))
        };
        let own = with_bodies(up, [&keys(0), &keys(1)]);
        let led = with_bodies(up, ["", ""]);
        let [mut own, mut led] = [&own, &led].map(|scene| simulation(&[scene], 2));
        let poses = |frame: usize| {
            let pose = |k: usize| {
                let (sine, cosine) = (0.5 * (turn * frame as f64 / 19.0).to_radians()).sin_cos();
                // Of length 2.
                let [x, y, z] = axis(k).map(|c| 2.0 * sine * c);
                BodyPose { position_m: place(k, frame), rotation: [x, y, z, 2.0 * cosine] }
            };
            [0, 1, 0, 1].map(pose).to_vec()
        };
        let still = led.positions();
        for frame in 1..16 {
            own.step().unwrap();
            // As a host does that changes what the scene does, and as one that says no more than it must.
            let mut given = if frame % 2 == 0 { led.prescribed().unwrap() } else { Prescribed::default() };
            given.bodies = Some(poses(frame));
            led.step_with(&given).unwrap();
            let at = [&own, &led].map(|simulation| simulation.positions());
            let far = at[0].iter().flatten().zip(at[1].iter().flatten());
            let far = far.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(far < 1e-5, "{up} up, frame {frame}: {far} m");
            for (own, led) in own.bodies().iter().zip(led.bodies()) {
                let numbers =
                    |pose: &BodyPose| pose.position_m.into_iter().chain(pose.rotation).collect::<Vec<_>>();
                let far =
                    numbers(own).iter().zip(numbers(&led)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(far < 1e-12, "{up} up, frame {frame}: {own:?}, {led:?}");
            }
        }
        assert_eq!(led.cloths()[0].handles.len(), 3, "the ball has grabbed a particle");
        let moved = led.positions()[0].iter().zip(still[0]).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt();
        assert!(moved > 0.05, "what is attached to the rod moved by {moved} m");

        // Both go on to the same bits from a snapshot, and without a host the bodies go back to where the scene has them.
        let lead = |led: &mut Simulation| {
            led.step_with(&Prescribed { bodies: Some(poses(16)), ..Default::default() }).unwrap();
            led.positions()
        };
        let snapshot = led.snapshot().unwrap();
        let expected = lead(&mut led);
        led.restore(&snapshot).unwrap();
        assert_eq!(lead(&mut led), expected);
        led.step().unwrap();
        let ball = led.bodies()[1];
        let far = ball.position_m.iter().zip(place(1, 0)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(far < 1e-12 && ball.rotation == [0.0, 0.0, 0.0, 1.0], "{ball:?}");
        led.reset().unwrap();
        assert_eq!(led.positions(), still);
        let error = simulation(&[&scene()], 2).restore(&snapshot).unwrap_err().to_string();
        assert!(error.contains("snapshot"), "{error}");
    }
}

#[test]
fn bodies_that_cannot_be_led_are_named() {
    let still = with_bodies("z", ["", ""]);
    let [mut other, mut fresh] = [(); 2].map(|()| simulation(&[&still], 1));
    let before = other.bodies();
    let mut refused = |bodies: Vec<BodyPose>| {
        let given = Prescribed { bodies: Some(bodies), ..Default::default() };
        other.step_with(&given).map(|_| ()).unwrap_err().to_string()
    };
    let one = BodyPose::default();
    let error = refused(vec![one]);
    assert!(error.contains("control: bodies: expected 2, one for each body"), "{error}");
    let error = refused(vec![one, BodyPose { rotation: [0.0; 4], ..one }]);
    assert!(error.contains("bodies[1].rotation: expected a quaternion that is not zero"), "{error}");
    let error = refused(vec![BodyPose { position_m: [f64::NAN, 0.0, 0.0], ..one }, one]);
    assert!(error.contains("bodies[0]") && error.contains("NaN"), "{error}");
    assert_eq!((other.frame().index, other.bodies()), (0, before), "nothing was computed");
    for simulation in [&mut other, &mut fresh] {
        simulation.step().unwrap();
    }
    assert_eq!(other.positions(), fresh.positions());
}

#[test]
fn choices_that_contradict_themselves_are_refused() {
    let on = |choice: DeviceChoice| choice.open().map(|opened| opened.to_string());
    let cpu = DeviceChoice::cpu();
    let opened = on(cpu.clone()).unwrap();
    assert!(opened.starts_with("cpu, ") && opened.ends_with("(asked for)"), "{opened}");
    let error = on(DeviceChoice { adapter: Some("llvmpipe".into()), ..cpu.clone() }).unwrap_err().to_string();
    assert!(error.contains("adapter") && error.contains("none with the device cpu"), "{error}");
    let half = DeviceChoice { storage: fnopt::gpu::Storage::F16, ..cpu };
    let error = on(half).unwrap_err().to_string();
    assert!(error.contains("precision") && error.contains("f16"), "{error}");
    let error = DeviceKind::named("gpus").unwrap_err().to_string();
    assert!(error.contains("gpu"), "{error}");
    // What runs only on the CPU runs there unless another device is asked for.
    let opened = DeviceChoice::default().open_for(&Optimizer::newton()).unwrap();
    assert!(matches!(opened.device, Device::Cpu), "{opened}");
}
