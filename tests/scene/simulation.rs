//! Simulations that own their scenes, in SI units.

use fnopt::scene::Script;
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
