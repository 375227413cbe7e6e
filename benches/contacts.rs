//! A frame of twenty iterations of the spectral optimizer with contacts and without: a sheet of 64x64 that is twisted until its
//! layers press on each other, with self-contact, with five bodies of which some are touched, and with both. Each frame
//! begins from the same state, so that the ratios are those of one moment.

mod common;

use common::{adapter, criterion, is_software};
use criterion::{Criterion, criterion_group, criterion_main};
use fnopt::cloth::{Body, Cloth, Control, Grid, Model, Pose, Shape, State};
use fnopt::cpu::Solver;
use fnopt::scene::{Scene, Script};
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};

const SIDE: usize = 64;
const ITERATIONS: usize = 20;
/// Layers press in this frame.
const FRAME: usize = 130;

/// Returns the twisted sheet, its state and the control of the next frame.
fn twisted() -> (Cloth, State<f32>, Control<f32>) {
    let mut scene = Scene::named("twist").expect("a scene that comes with the program");
    scene.regrid(Grid { h: SIDE, w: SIDE }).expect("the scene fits any grid");
    let setup = scene.setup().expect("the scene is good");
    let mut solver = Solver::<f32>::new(&setup.model, &Optimizer::spectral(), ITERATIONS).expect("it fits");
    let (mut state, mut script) = (setup.start.cast::<f32>(), Script::new(&setup));
    let mut cloth = setup.model.cloths[0].clone();
    for frame in 1..FRAME {
        if let Some(changed) = script.enter(frame, &state) {
            cloth = changed.clone();
            solver.set_cloths(std::slice::from_ref(changed)).expect("the scene is good");
        }
        solver.step(&mut state, &script.control(frame));
    }
    let control = script.control(FRAME);
    (Cloth { bodies: Vec::new(), ..cloth }, state, Control { bodies: Vec::new(), ..control })
}

/// Returns five balls under particles of a cloth, three of which it touches.
fn balls(state: &State<f32>) -> Vec<Body> {
    let n = SIDE * SIDE;
    let ball = |k: usize| {
        let p = (k + 1) * n / 6;
        let at = |c: usize| f64::from(state.x[c * n + p]);
        let (radius, thickness) = (2.0, 0.16);
        let below = radius + if k < 3 { 0.9 * thickness } else { 4.0 };
        let pose = Pose { position: [at(0), at(1), at(2) - below], ..Pose::default() };
        Body { shape: Shape::Sphere { radius }, pose, thickness, friction: 0.3, present: true }
    };
    (0..5).map(ball).collect()
}

fn contacts(c: &mut Criterion) {
    let mut devices = vec![("cpu", Device::Cpu)];
    match adapter() {
        Some(context) if is_software(&context) => {
            eprintln!("gpu: skipped: a second per frame on a software adapter");
        }
        Some(context) => devices.push(("gpu", Device::Gpu(context))),
        None => {}
    }
    let (cloth, state, control) = twisted();
    let bodies = balls(&state);
    for (name, device) in &devices {
        let mut group = c.benchmark_group(format!("contacts, {name}"));
        for (what, touches_itself, meets) in [
            ("none", false, false),
            ("self-contact", true, false),
            ("five bodies", false, true),
            ("both", true, true),
        ] {
            let cloth = Cloth {
                self_contact: cloth.self_contact.filter(|_| touches_itself),
                bodies: if meets { bodies.clone() } else { Vec::new() },
                ..cloth.clone()
            };
            let model = Model { grid: Grid { h: SIDE, w: SIDE }, cloths: vec![cloth] };
            let mut simulator =
                Simulator::new(device, &model, &Optimizer::spectral(), ITERATIONS).expect("it fits");
            group.bench_function(what, |b| {
                b.iter(|| {
                    simulator.set_state(&state);
                    simulator.step(&control).expect("a frame of a good scene stays finite")
                });
            });
        }
    }
}

criterion_group!(name = benches; config = criterion(); targets = contacts);
criterion_main!(benches);
