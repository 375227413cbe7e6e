//! A batch of cloths that have nothing in common but their grid.

use crate::noise;
use fnopt::cloth::{Air, Cloth, Control, Grid, Material, Model, State};

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
    (model, state, Control { handles, wind, external })
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
        let control =
            Control { handles: mine.to_vec(), wind: vec![control.wind[b]], external: own(&control.external) };
        let state = State { x: own(&state.x), v: own(&state.v) };
        (Model { grid: model.grid, cloths: vec![cloth.clone()] }, state, control)
    })
}
