//! The plan of a subspace method: a step of a few directions, of the lengths that suit the energy best.

use super::cosine_columns::squared_frequencies;
use super::cosine_rows::{fields_shape, table};
use super::subspace_step::STATE;
use super::{CosineColumns, CosineDirections, CosineRows, Extrapolate, SubspaceStep, When, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::cloth::{Objective, SheetAxes, curvature};

/// Minimises a quadratic model of the energy in the span of three or four directions: the gradient times the
/// inverse Hessian of a flat sheet (`P C^T diag(1 / lambda) C P`, see [`super::QuasiNewton`]), the same in
/// the sheet's own axes, where stretching is stiffer than bending, the last step, and the step of a network.
///
/// A step that increases the energy is shortened, and at the end of the frame taken back.
///
/// A frame is [`Subspace::begin`], an evaluation ([`Objective::evaluate`]) and [`Subspace::start`], then for each
/// iteration an evaluation and [`Subspace::push`], then [`Subspace::end`].
#[derive(Clone, Debug)]
pub struct Subspace {
    grid: Grid,
    iterations: usize,
    axes_kernel: SheetAxes,
    extrapolate: Extrapolate,
    rows: CosineRows,
    /// Forward, inverse.
    columns: [CosineColumns; 2],
    directions_kernel: CosineDirections,
    step: SubspaceStep,
    /// Cosine matrices along a column and along a row.
    tables: [Tensor; 2],
    /// Squared frequencies, shape [H + W].
    mu: Tensor,
    /// Axes of the sheet, shape [B, 10, n].
    axes: Tensor,
    /// Six fields before and after a transform, shape [B, 6, H, W].
    fields: [Tensor; 2],
    /// Shape [K, slot].
    directions: Tensor,
    /// Accelerations of the frame before the last one, 0 at handles; shape [B, 3, n].
    earlier: Tensor,
    /// Shape [B, parts, 24].
    parts: Tensor,
    /// Shape [iterations + 2, B, 5].
    state: Tensor,
}

impl Subspace {
    /// Builds the kernels and tensors for frames of this many iterations of `batch` cloths on a grid, with `count`
    /// directions: 3, or 4 with that of a network. Panics without iterations.
    pub fn new(
        context: &Context,
        count: usize,
        iterations: usize,
        (grid, batch): (Grid, usize),
    ) -> Result<Self> {
        assert!(iterations > 0, "a frame has iterations");
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let fields = || zeros("subspace.fields", &fields_shape(batch, grid));
        Ok(Self {
            grid,
            iterations,
            axes_kernel: SheetAxes::new(context)?,
            extrapolate: Extrapolate::new(context)?,
            rows: CosineRows::new(context)?,
            columns: [CosineColumns::new(context, false)?, CosineColumns::new(context, true)?],
            directions_kernel: CosineDirections::new(context)?,
            step: SubspaceStep::new(context)?,
            tables: [table(context, grid.h)?, table(context, grid.w)?],
            mu: squared_frequencies(context, grid)?,
            axes: zeros("subspace.axes", &[batch, AXES, grid.particles()])?,
            fields: [fields()?, fields()?],
            directions: zeros("subspace.directions", &directions::shape(count, batch, grid))?,
            earlier: zeros("subspace.earlier", &[batch, 3, grid.particles()])?,
            parts: zeros("subspace.parts", &curvature::parts_shape(batch, grid))?,
            state: zeros("subspace.state", &[iterations + 2, batch, STATE])?,
        })
    }

    /// Starts a frame from `iterate.base`, with the last frame's acceleration still in `iterate.a`: it
    /// becomes the last step, and 0, or with bodies what keeps the particles out of them. Two dispatches, and another with
    /// bodies.
    pub fn begin(&self, schedule: &mut Schedule, objective: &Objective) {
        let of = (objective.cloths(), &objective.iterate, &objective.x);
        let to = [&self.axes, &self.directions, &self.earlier];
        self.axes_kernel.push(schedule, objective.grid(), of, to);
        self.extrapolate.push(schedule, objective.grid(), &objective.iterate, &self.directions);
        objective.confine(schedule, None);
    }

    /// Moves the iterate from a = 0, where it was evaluated, to the best start near the accelerations of the two frames
    /// before ([`WARMEST`](crate::settings::WARMEST)). Two dispatches.
    pub fn start(&self, schedule: &mut Schedule, objective: &Objective) {
        // The other directions are those of the frame before, whose sums are not read.
        objective.local_model(schedule, &self.directions, &self.parts);
        self.decide(schedule, objective, When::Start);
        objective.confine(schedule, Some(&self.directions));
    }

    /// Moves the iterate, which was evaluated, by the step of `iteration`, counted from 0. Six dispatches, and
    /// another with a repulsion, and two with bodies.
    pub fn push(&self, schedule: &mut Schedule, objective: &Objective, iteration: usize) {
        assert!(iteration < self.iterations, "iteration {iteration} of {}", self.iterations);
        let (grid, iterate) = (objective.grid(), &objective.iterate);
        let Self { axes, directions, mu, .. } = self;
        let ([along_column, along_row], [z, other]) = (&self.tables, &self.fields);
        let [forward, inverse] = &self.columns;
        let of_columns = (objective.cloths(), along_column, mu);
        self.rows.push(schedule, grid, (iterate, axes, along_row), z);
        forward.push(schedule, grid, of_columns, [z, other]);
        inverse.push(schedule, grid, of_columns, [other, z]);
        self.directions_kernel.push(schedule, grid, (iterate, axes, along_row), [z, directions]);
        objective.local_model(schedule, directions, &self.parts);
        self.decide(schedule, objective, When::Iteration(iteration));
        objective.confine(schedule, Some(&self.directions));
    }

    /// Ends a frame: takes the last step back if it has increased the energy. Two dispatches, without a repulsion.
    pub fn end(&self, schedule: &mut Schedule, objective: &Objective) {
        objective.model_energy(schedule, &self.directions, &self.parts);
        self.decide(schedule, objective, When::End(self.iterations));
    }

    fn decide(&self, schedule: &mut Schedule, objective: &Objective, when: When) {
        let sums = (&self.parts, objective.position_parts());
        let to = (&objective.iterate, &self.directions, &self.state);
        self.step.push(schedule, objective.grid(), when, sums, to);
    }

    /// Returns where a network leaves its step between the gradient and [`Subspace::push`], shape
    /// [B, 3, n], 0 at handles; `None` if there are only three directions.
    pub fn learned_step(&self) -> Option<Tensor> {
        let (&[count, _], &[_, batch, _]) = (self.directions.shape(), self.state.shape()) else {
            unreachable!("shapes are fixed")
        };
        (count > directions::LEARNED)
            .then(|| directions::one(&self.directions, directions::LEARNED, batch, self.grid))
    }

    /// Returns the accelerations of the frame before the last one, shape [B, 3, n].
    pub fn earlier(&self) -> &Tensor {
        &self.earlier
    }

    /// Returns the state after each decision: at the start, in each iteration and at the end of the frame, shape
    /// [iterations + 2, B, 5]: accepted energy, sum of the magnitudes of its terms, slope of the step, shortened
    /// steps, and directions dropped as not finite, both since the frame began.
    pub fn state(&self) -> &Tensor {
        &self.state
    }
}
