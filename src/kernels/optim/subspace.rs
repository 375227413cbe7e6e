//! The plan of a subspace method: a step of a few directions, of the lengths that suit the energy best.

use super::cosine_columns::squared_frequencies;
use super::cosine_rows::{fields_shape, table};
use super::subspace_step::STATE;
use super::{CosineColumns, CosineDirections, CosineRows, Iterate, SubspaceStep, When, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::cloth::{Curvature, EnergyTensors, SheetAxes, curvature};

/// Iterations of a frame in which a network proposes a step. Its direction is worth most far from the minimum: with
/// it, five iterations leave 1.9 % of the gap of `xy_v2` at 32x32 where three directions leave 3.6 %. Later it
/// disturbs the conjugacy of the others: after ten iterations with it 1.1 % are left, and 0.6 % without.
pub const LEARNED_ITERATIONS: usize = 5;

/// Minimises a quadratic model of the energy in the span of three or four directions: the gradient times the
/// inverse Hessian of a flat sheet (`P C^T diag(1 / lambda) C P`, see [`super::QuasiNewton`]), the same in
/// the sheet's own axes, where stretching is stiffer than bending, the last step, and the step of a network.
///
/// A step that increases the energy is shortened, and at the end of the frame taken back.
///
/// A frame is [`Subspace::begin`], the gradient and [`Subspace::start`], then for each iteration the gradient and
/// [`Subspace::push`], then [`Subspace::end`].
#[derive(Clone, Debug)]
pub struct Subspace {
    grid: Grid,
    iterations: usize,
    axes_kernel: SheetAxes,
    rows: CosineRows,
    /// Forward, inverse.
    columns: [CosineColumns; 2],
    directions_kernel: CosineDirections,
    curvature: Curvature,
    step: SubspaceStep,
    /// Cosine matrices along a column and along a row.
    tables: [Tensor; 2],
    /// Squared frequencies, shape [H + W].
    mu: Tensor,
    /// Axes of the sheet, shape [B, 6, n].
    axes: Tensor,
    /// Six fields before and after a transform, shape [B, 6, H, W].
    fields: [Tensor; 2],
    /// Shape [K, slot].
    directions: Tensor,
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
            rows: CosineRows::new(context)?,
            columns: [CosineColumns::new(context, false)?, CosineColumns::new(context, true)?],
            directions_kernel: CosineDirections::new(context)?,
            curvature: Curvature::new(context)?,
            step: SubspaceStep::new(context)?,
            tables: [table(context, grid.h)?, table(context, grid.w)?],
            mu: squared_frequencies(context, grid)?,
            axes: zeros("subspace.axes", &[batch, 6, grid.particles()])?,
            fields: [fields()?, fields()?],
            directions: zeros("subspace.directions", &directions::shape(count, batch, grid))?,
            parts: zeros("subspace.parts", &curvature::parts_shape(batch, grid))?,
            state: zeros("subspace.state", &[iterations + 2, batch, STATE])?,
        })
    }

    /// Starts a frame from `iterate.base`, with the last frame's acceleration still in `iterate.a`: it
    /// becomes the last step, and 0. One dispatch.
    pub fn begin(&self, schedule: &mut Schedule, x: &Tensor, iterate: &Iterate) {
        self.axes_kernel.push(schedule, self.grid, (iterate, x), [&self.axes, &self.directions]);
    }

    /// Moves `iterate` from a = 0, where its gradient is known, to the best multiple, at most [`WARMEST`](super::WARMEST), of
    /// the last frame's acceleration. `physics` and `repulsion` as in [`Subspace::push`]. Two dispatches.
    pub fn start(
        &self,
        schedule: &mut Schedule,
        physics: EnergyTensors<'_>,
        (iterate, repulsion): (&Iterate, Option<&Tensor>),
    ) {
        let Self { grid, directions, parts, state, .. } = self;
        // The other directions are those of the frame before, whose sums are not read.
        self.curvature.push(schedule, *grid, physics, (iterate, directions, parts));
        self.step.push(schedule, *grid, When::Start, (parts, repulsion), (iterate, directions, state));
    }

    /// Moves `iterate`, whose gradient is known, by the step of `iteration`, counted from 0. `physics` has
    /// the external accelerations without the repulsion; if there is one, `repulsion` are the parts of the
    /// energy that contain it at `iterate.a` ([`crate::kernels::cloth::Repulsion`]). Six dispatches.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        iteration: usize,
        physics: EnergyTensors<'_>,
        (iterate, repulsion): (&Iterate, Option<&Tensor>),
    ) {
        assert!(iteration < self.iterations, "iteration {iteration} of {}", self.iterations);
        let Self { grid, axes, directions, parts, mu, .. } = self;
        let ([along_column, along_row], [z, other]) = (&self.tables, &self.fields);
        let [forward, inverse] = &self.columns;
        let of_columns = (physics.cloths, along_column, mu);
        self.rows.push(schedule, *grid, (iterate, axes, along_row), z);
        forward.push(schedule, *grid, of_columns, [z, other]);
        inverse.push(schedule, *grid, of_columns, [other, z]);
        self.directions_kernel.push(schedule, *grid, (iterate, axes, along_row), [z, directions]);
        self.curvature.push(schedule, *grid, physics, (iterate, directions, parts));
        let when = When::Iteration(iteration);
        self.step.push(schedule, *grid, when, (parts, repulsion), (iterate, directions, &self.state));
    }

    /// Ends a frame: takes the last step back if it has increased the energy. `repulsion` as in
    /// [`Subspace::push`]. Two dispatches.
    pub fn end(
        &self,
        schedule: &mut Schedule,
        physics: EnergyTensors<'_>,
        (iterate, repulsion): (&Iterate, Option<&Tensor>),
    ) {
        let Self { grid, directions, parts, state, .. } = self;
        self.curvature.push_energy(schedule, *grid, physics, (iterate, directions, parts));
        let when = When::End(self.iterations);
        self.step.push(schedule, *grid, when, (parts, repulsion), (iterate, directions, state));
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

    /// Returns the state after each decision: at the start, in each iteration and at the end of the frame, shape
    /// [iterations + 2, B, 5]: accepted energy, sum of the magnitudes of its terms, slope of the step, shortened
    /// steps, and directions dropped as not finite, both since the frame began.
    pub fn state(&self) -> &Tensor {
        &self.state
    }
}
