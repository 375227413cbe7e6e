//! A batch of cloths that have nothing in common but their grid.

use crate::noise;
use fnopt::cloth::{
    Air, Body, Cloth, Control, DistanceField, Grid, Map, Mask, Material, Model, Pose, Shape, State, Sweep,
    Weave,
};
use std::sync::Arc;

/// Builds three different cloths in wind, the second of them not a full rectangle, the third not even, their state and their control.
pub fn varied_batch(grid: Grid) -> (Model, State<f32>, Control<f32>) {
    let n = grid.particles();
    let noise = |seed| noise::noise(9 * n, seed).into_iter().map(|v| v as f32);
    let cloth = |b: usize| Cloth {
        material: Material {
            stretch: 100.0 * (1 + b) as f64,
            shear: 3.0,
            bend: 0.2 * b as f64,
            ..Material::PAPER
        },
        gravity: [0.0, 0.01 * b as f64, -0.1],
        air: Air { density: 0.1 * b as f64, drag: 0.02 },
        handles: vec![b, n - 1 - b][..2 - b % 2].to_vec(),
        mask: (b == 1).then(|| jagged(grid)),
        ..Cloth::default()
    };
    let mut model = Model { grid, cloths: (0..3).map(cloth).collect() };
    make_uneven(grid, &mut model.cloths[2]);
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

/// Returns the distances of a crystal with corners at distance 1 along the axes.
#[allow(dead_code, reason = "not every test meets bodies")]
pub fn crystal() -> Arc<DistanceField> {
    let corner =
        |k: usize| std::array::from_fn(|c| if k / 2 == c { 1.0 - 2.0 * (k % 2) as f64 } else { 0.0 });
    let vertices: Vec<[f64; 3]> = (0..6).map(corner).collect();
    // One face for each choice of signs, whose fronts turn with their product.
    let face = |k: u32| {
        let [x, y, z] = [k & 1, 2 + (k >> 1 & 1), 4 + (k >> 2 & 1)];
        if k.count_ones().is_multiple_of(2) { [x, y, z] } else { [y, x, z] }
    };
    let faces: Vec<[u32; 3]> = (0..8).map(face).collect();
    Arc::new(DistanceField::new(&vertices, &faces, 24).unwrap())
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
        body(sphere.clone(), turned([0.4 * across, 0.0, -0.3 * across - 0.02], 0.0), 0.4),
        body(Shape::Box { half: [1.0, 2.0, 1.0] }, turned([0.7 * across, 0.2 * along, -1.25], 0.4), 0.2),
        body(capsule.clone(), turned([1.0, -0.3 * along, 0.9], 1.4), 0.0),
        body(Shape::Plane, turned([0.0, 0.0, -0.1], 0.02), 0.3),
        body(sphere, turned([0.5 * across, 0.0, 0.3 * across + 0.2], 0.0), 0.1),
    ];
    let crystal = crystal();
    let mesh = |scale, inset| Shape::Mesh { field: Arc::clone(&crystal), scale, inset };
    let hidden = Body { present: false, ..body(Shape::Plane, turned([0.0, 0.0, 0.5], 0.0), 0.9) };
    model.cloths[2].bodies = vec![
        body(capsule, turned([0.5 * across, 0.0, -1.1], 1.6), 0.5),
        body(mesh(2.0, 0.1), turned([0.2 * across, -0.2 * along, -1.95], 0.3), 0.4),
        hidden,
        body(mesh(1.5, 0.0), turned([0.8 * across, 0.1 * along, 1.55], 0.0), 0.2),
    ];
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

/// Makes a cloth differ between its axes and from place to place, and damps it.
pub fn make_uneven(grid: Grid, cloth: &mut Cloth) {
    let map = |factor: &dyn Fn(usize, usize) -> f64| {
        let factors: Vec<f64> = (0..grid.particles()).map(|p| factor(p / grid.w, p % grid.w)).collect();
        Some(Map::new(grid, &factors, "a test", "map").unwrap())
    };
    cloth.material.weave = Weave { stretch: [1.25, 0.75], bend: [0.5, 1.5] };
    cloth.damping = 0.5;
    cloth.density = map(&|i, j| 1.0 + 0.25 * (i % 3) as f64 + 0.125 * (j % 5) as f64);
    cloth.stiffness = map(&|i, j| if (i + j) % 4 == 0 { 3.0 } else { 0.5 + 0.125 * (j % 4) as f64 });
}

/// Returns a mask with a hole, a corner cut off, and a border with teeth, which keeps the middle of the first row.
pub fn jagged(grid: Grid) -> Mask {
    let Grid { h, w } = grid;
    let has = |i: usize, j: usize| {
        let hole = (i, j) == (h / 2, w / 2) || (i, j) == (h / 2 + 1, w / 2);
        let corner = i + 1 >= h - 2 && j < 3 && h - i + j < 5;
        let teeth = j + 1 == w && i % 4 < 2;
        !(hole || corner || teeth)
    };
    let wanted: Vec<bool> = (0..h * w).map(|p| has(p / w, p % w)).collect();
    Mask::new(grid, &wanted, "a test").unwrap()
}
