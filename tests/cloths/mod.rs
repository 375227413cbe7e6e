//! A batch of cloths that have nothing in common but their grid.

use crate::noise;
use fnopt::cloth::{Air, Body, Cloth, Control, Grid, Material, Model, Pose, Shape, State, Sweep};

/// Builds three different cloths in wind, their state and their control.
pub fn varied_batch(grid: Grid) -> (Model, State<f32>, Control<f32>) {
    let n = grid.particles();
    let noise = |seed| noise::noise(9 * n, seed).into_iter().map(|v| v as f32);
    let cloth = |b: usize| Cloth {
        material: Material { stretch: 100.0 * (1 + b) as f64, shear: 3.0, bend: 0.2 * b as f64 },
        gravity: [0.0, 0.01 * b as f64, -0.1],
        air: Air { density: 0.1 * b as f64, drag: 0.02 },
        handles: vec![b, n - 1 - b][..2 - b % 2].to_vec(),
        ..Cloth::default()
    };
    let model = Model { grid, cloths: (0..3).map(cloth).collect() };
    let mut state = State::<f32>::rest(grid, 3);
    state.x.iter_mut().zip(noise(6)).for_each(|(x, noise)| *x += 0.05 * noise);
    let mut handles = vec![];
    for (b, cloth) in model.cloths.iter().enumerate() {
        handles.extend(cloth.handles.iter().map(|p| [0, 1, 2].map(|c| state.x[(3 * b + c) * n + p] + 0.1)));
    }
    let wind = vec![[0.1, 0.0, 0.2], [0.0; 3], [-0.2, 0.1, 0.0]];
    let external = noise(7).map(|f| 0.02 * f).collect();
    (model, state, Control { handles, wind, external, ..Control::default() })
}

/// Returns each cloth of such a batch alone.
pub fn one_by_one(
    (model, state, control): &(Model, State<f32>, Control<f32>),
) -> impl Iterator<Item = (Model, State<f32>, Control<f32>)> {
    let len = 3 * model.grid.particles();
    let mut handles = &control.handles[..];
    model.cloths.iter().enumerate().map(move |(b, cloth)| {
        let own = |of_all: &[f32]| of_all[b * len..(b + 1) * len].to_vec();
        let (mine, others) = handles.split_at(cloth.handles.len());
        handles = others;
        let control = Control {
            handles: mine.to_vec(),
            wind: vec![control.wind[b]],
            external: own(&control.external),
            ..Control::default()
        };
        let state = State { x: own(&state.x), v: own(&state.v) };
        (Model { grid: model.grid, cloths: vec![cloth.clone()] }, state, control)
    })
}

/// Builds such a batch among bodies of all shapes, which move, touch most of the cloths and rub on them; the second cloth
/// meets none.
#[allow(dead_code, reason = "not every test meets bodies")]
pub fn among_bodies(grid: Grid) -> (Model, State<f32>, Control<f32>) {
    let (mut model, mut state, control) = varied_batch(grid);
    let turned = |position: [f64; 3], angle: f64| {
        let rotation = [0.0, (0.5 * angle).sin(), 0.0, (0.5 * angle).cos()];
        Pose { position, rotation }
    };
    let body = |shape, pose, friction| Body { shape, pose, thickness: 0.2, friction, present: true };
    let (across, along) = (grid.w as f64, grid.h as f64);
    let sphere = Shape::Sphere { radius: 0.3 * across };
    let capsule = Shape::Capsule { radius: 1.0, half_length: 2.0 };
    model.cloths[0].bodies = vec![
        body(sphere, turned([0.4 * across, 0.0, -0.3 * across - 0.02], 0.0), 0.4),
        body(Shape::Box { half: [1.0, 2.0, 1.0] }, turned([0.7 * across, 0.2 * along, -1.25], 0.4), 0.2),
        body(capsule, turned([1.0, -0.3 * along, 0.9], 1.4), 0.0),
        body(Shape::Plane, turned([0.0, 0.0, -0.1], 0.02), 0.3),
        body(sphere, turned([0.5 * across, 0.0, 0.3 * across + 0.2], 0.0), 0.1),
    ];
    model.cloths[2].bodies = vec![body(capsule, turned([0.5 * across, 0.0, -1.1], 1.6), 0.5)];
    // Some particles fly into the bodies or through them.
    state
        .v
        .iter_mut()
        .zip(noise::noise(9 * grid.particles(), 11))
        .for_each(|(v, noise)| *v = 0.2 * noise as f32);
    let swept = |body: &Body| {
        let from = Pose { position: body.pose.position.map(|c| c - 0.05), ..body.pose };
        Sweep { from, to: body.pose }
    };
    let bodies = model.cloths.iter().flat_map(|cloth| &cloth.bodies).map(swept).collect();
    (model, state, Control { bodies, ..control })
}
