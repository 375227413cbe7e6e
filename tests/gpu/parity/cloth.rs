//! Helpers shared by the tests of the cloth and optimizer kernels.

use crate::cloths::{jagged, make_uneven};
use crate::common::{context, noise, poisoned, tensor, widened};
use fnopt::cloth::{Air, Cloth, Grid, Mark, Material, Model, Repulsion, State};
use fnopt::cpu::cloth::{Elements, Trial, masses};
use fnopt::gpu::Tensor;
use fnopt::kernels::cloth::{self, ClothParams};
use fnopt::kernels::optim::Iterate;

/// Wind of each cloth [edges / frame].
pub const WIND: [[f32; 3]; 3] = [[0.3, -0.2, 0.1], [0.0, 0.0, 0.0], [-0.5, 0.4, 0.2]];

/// The upper triangle of a matrix over four directions, row by row, as the kernels sum it.
pub const PAIRS: [(usize, usize); 10] =
    [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];

/// Builds cloths with different materials, air and handles. The second is not a full rectangle, the third not even.
pub fn model(grid: Grid, batch: usize) -> Model {
    let (h, w) = (grid.h, grid.w);
    let cloth = |b: usize| Cloth {
        material: Material {
            stretch: 1000.0 / (b + 1) as f64,
            shear: 8.0 + b as f64,
            bend: 0.5,
            ..Material::PAPER
        },
        gravity: [0.02 * b as f64, -0.01, -0.07],
        air: [Air { density: 0.3, drag: 0.1 }, Air { density: 0.0, drag: 0.2 }, Air::default()][b],
        handles: [vec![0, (h - 1) * w], vec![w / 2], vec![w - 1, h * w - 1, h * w / 2]][b].clone(),
        mask: (b == 1).then(|| jagged(grid)),
        ..Cloth::default()
    };
    let mut model = Model { grid, cloths: (0..batch).map(cloth).collect() };
    model.cloths.iter_mut().skip(2).for_each(|cloth| make_uneven(grid, cloth));
    model
}

/// Adds repulsion to all cloths but the second.
pub fn repelling(model: &Model) -> Model {
    let mut model = model.clone();
    for (cloth, distance) in model.cloths.iter_mut().zip([0.5, 0.0, 1.0]) {
        cloth.repulsion = (distance > 0.0).then_some(Repulsion { strength: 0.1, distance });
    }
    model
}

/// Returns the handle positions of a model [handles, 3].
pub fn targets(model: &Model) -> Vec<[f32; 3]> {
    noise(3 * model.handles(), 71).chunks_exact(3).map(|p| [3.0 * p[0], 3.0 * p[1], 3.0 * p[2]]).collect()
}

/// Returns a field [B, 3, n] of noise.
pub fn field(model: &Model, amplitude: f32, seed: u64) -> Vec<f32> {
    let len = model.batch() * 3 * model.grid.particles();
    noise(len, seed).into_iter().map(|v| amplitude * v).collect()
}

/// Returns noise that is 0 where no free particle is.
pub fn held(model: &Model, amplitude: f32, seed: u64) -> Vec<f32> {
    let (marks, n) = (model.marks(), model.grid.particles());
    let mut values = field(model, amplitude, seed);
    for (k, v) in values.iter_mut().enumerate() {
        if !marks[k / (3 * n) * n + k % n].is_free() {
            *v = 0.0;
        }
    }
    values
}

/// Returns positions at rest plus noise, so that edges are strained and every angle is bent.
pub fn crumpled(model: &Model, amplitude: f32) -> Vec<f32> {
    let rest = State::<f32>::rest(model.grid, model.batch()).x;
    rest.iter().zip(field(model, amplitude, 72)).map(|(x, d)| x + d).collect()
}

/// Uploads a field.
pub fn upload(label: &'static str, model: &Model, values: &[f32]) -> Tensor {
    tensor(label, &[model.batch(), 3, model.grid.particles()], values)
}

/// Uploads the constants of the cloths.
pub fn constants(model: &Model) -> Tensor {
    let params = ClothParams::all(model);
    Tensor::from_slice(context(), "cloths", &[model.batch(), ClothParams::LEN], &params).unwrap()
}

/// Uploads what the particles are.
pub fn marks(model: &Model) -> Tensor {
    let shape = [model.batch(), model.grid.particles(), 2];
    Tensor::from_slice(context(), "marks", &shape, &model.marks()).unwrap()
}

/// Creates the unknown of a frame, filled with NaN except for the marks.
pub fn iterate(model: &Model) -> Iterate {
    let iterate = Iterate::new(context(), model.batch(), &model.marks()).unwrap();
    poison(if model.repels() { iterate.with_total(context()).unwrap() } else { iterate })
}

/// Fills all fields of an iterate with NaN.
fn poison(iterate: Iterate) -> Iterate {
    let Iterate { grad, hidden, base, external, total, a, marks: _ } = &iterate;
    for tensor in [grad, base, external, a].into_iter().chain(hidden).chain(total) {
        tensor.write(context(), &vec![f32::NAN; tensor.len()]);
    }
    iterate
}

/// Creates the unknown of a frame with a hidden state, also filled with NaN.
pub fn iterate_with_hidden(model: &Model) -> Iterate {
    poison(Iterate::with_hidden(context(), model.batch(), &model.marks()).unwrap())
}

/// The cloths of a model on the device, at a trial.
pub struct OnDevice {
    grid: Grid,
    cloths: Tensor,
    x: Tensor,
    pub iterate: Iterate,
}

impl OnDevice {
    /// Uploads positions, displacements at a = 0, accelerations and external accelerations, each [B, 3, n].
    pub fn new(model: &Model, fields: [&[f32]; 4]) -> Self {
        Self::with(model, iterate(model), fields)
    }

    /// As [`OnDevice::new`], into this iterate.
    pub fn with(model: &Model, iterate: Iterate, [x, base, a, f]: [&[f32]; 4]) -> Self {
        for (tensor, values) in [(&iterate.base, base), (&iterate.a, a), (&iterate.external, f)] {
            tensor.write(context(), values);
        }
        Self { grid: model.grid, cloths: constants(model), x: upload("x", model, x), iterate }
    }

    /// Returns what the energy kernels take.
    pub fn trial(&self) -> cloth::Trial<'_> {
        cloth::Trial { grid: self.grid, cloths: &self.cloths, x: &self.x, iterate: &self.iterate }
    }
}

/// Returns the displacements of the particles in a trial.
pub fn shift(model: &Model, base: &[f32], a: &[f32]) -> Vec<f64> {
    let (marks, n) = (model.marks(), model.grid.particles());
    let free = |k: usize| marks[k / (3 * n) * n + k % n].is_free();
    let moved = |k: usize| f64::from(base[k]) + if free(k) { f64::from(a[k]) } else { 0.0 };
    (0..base.len()).map(moved).collect()
}

/// Creates a field of NaN.
pub fn poisoned_field(model: &Model) -> Tensor {
    poisoned("output", &[model.batch(), 3, model.grid.particles()])
}

/// All cloths in double precision, with the values of the device.
#[derive(Clone)]
pub struct Doubles {
    model: Model,
    marks: Vec<Mark>,
    masses: Vec<f64>,
    elements: Vec<Option<Elements<f64>>>,
    x: Vec<f64>,
    shift: Vec<f64>,
    a: Vec<f64>,
    f: Vec<f64>,
}

impl Doubles {
    /// Takes positions, displacements at a = 0, accelerations and external accelerations, each [B, 3, n].
    pub fn new(model: &Model, fields: [&[f32]; 4]) -> Self {
        let shift = shift(model, fields[1], fields[2]);
        let [x, _, a, f] = fields.map(widened);
        let (grid, marks) = (model.grid, model.marks());
        let elements = marks.chunks_exact(grid.particles()).map(|marks| Elements::of(grid, marks)).collect();
        Self { model: model.clone(), masses: masses(grid, &marks), marks, elements, x, shift, a, f }
    }

    /// Returns the cloths with accelerations changed by `step` times a direction [B, 3, n] that is 0 at handles.
    pub fn moved(&self, direction: &[f64], step: f64) -> Self {
        let add = |to: &[f64]| to.iter().zip(direction).map(|(to, p)| to + step * p).collect();
        Self { shift: add(&self.shift), a: add(&self.a), ..self.clone() }
    }

    /// Returns cloth `b`.
    pub fn cloth(&self, b: usize) -> Trial<'_, f64> {
        let n = self.model.grid.particles();
        let at = 3 * n * b..3 * n * (b + 1);
        Trial {
            grid: self.model.grid,
            material: self.model.cloths[b].material,
            damping: self.model.cloths[b].damping,
            x: &self.x[at.clone()],
            shift: &self.shift[at.clone()],
            a: &self.a[at.clone()],
            f: &self.f[at],
            marks: &self.marks[n * b..n * (b + 1)],
            masses: &self.masses[n * b..n * (b + 1)],
            elements: self.elements[b].as_ref(),
            near: None,
        }
    }
}
