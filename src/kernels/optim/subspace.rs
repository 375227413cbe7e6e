//! The plan of a subspace method: a step of a few directions, of the lengths that suit the energy best.

use super::cosine_columns::squared_frequencies;
use super::cosine_rows::table;
use super::subspace_step::STATE;
use super::{
    AnswerRows, CosineColumns, CosineRows, Extrapolate, Fields, Reacting, SheetSteps, SubspaceStep, When,
    directions,
};
use crate::Result;
use crate::cloth::modes::Reactions;
use crate::cloth::{Grid, Model};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::cloth::{Objective, SheetAxes, curvature};

/// Minimises a quadratic model of the energy in the span of three or four directions: the gradient times the
/// inverse Hessian of a flat sheet (`P C^T diag(1 / lambda) C P`, see [`super::QuasiNewton`]), a step across the sheet with what it
/// asks for along it, the last step, and the step of a network.
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
    /// Of the fields in space and across the sheet, and of those along it.
    columns: [CosineColumns; 2],
    answer_rows: AnswerRows,
    sheet_steps: SheetSteps,
    step: SubspaceStep,
    /// Cosine matrices along a column and along a row.
    tables: [Tensor; 2],
    /// Squared frequencies, shape [H + W].
    mu: Tensor,
    /// Axes of the sheet, shape [B, 16, n].
    axes: Tensor,
    reacting: Reacting,
    /// The fields, whose rows are transformed, and working space, where those in space and across the sheet are in the end, shape
    /// [B, 6, H, W] each.
    modes: [Tensor; 2],
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
    /// directions: 3, or 4 with that of a network; at most `room` handles of a cloth react to them. The operands of transforms are
    /// `staged` in workgroup memory as the adapter's [`Tuning`](crate::gpu::Tuning) says. Panics without iterations.
    pub fn new(
        context: &Context,
        (count, room): (usize, usize),
        (iterations, staged): (usize, bool),
        (grid, batch): (Grid, usize),
    ) -> Result<Self> {
        assert!(iterations > 0, "a frame has iterations");
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        Ok(Self {
            grid,
            iterations,
            axes_kernel: SheetAxes::new(context)?,
            extrapolate: Extrapolate::new(context)?,
            rows: CosineRows::new(context, staged)?,
            columns: [
                CosineColumns::new(context, Fields::SpaceAndNormal, grid, staged)?,
                CosineColumns::new(context, Fields::Tangents, grid, staged)?,
            ],
            answer_rows: AnswerRows::new(context, grid, staged)?,
            sheet_steps: SheetSteps::new(context, staged)?,
            step: SubspaceStep::new(context)?,
            tables: [table(context, grid.h)?, table(context, grid.w)?],
            mu: squared_frequencies(context, grid)?,
            axes: zeros("subspace.axes", &[batch, AXES, grid.particles()])?,
            reacting: Reacting::new(context, room, (grid, batch))?,
            modes: [
                zeros("subspace.modes", &Fields::shape(batch, grid))?,
                zeros("subspace.fields", &Fields::shape(batch, grid))?,
            ],
            directions: zeros("subspace.directions", &directions::shape(count, batch, grid))?,
            earlier: zeros("subspace.earlier", &[batch, 3, grid.particles()])?,
            parts: zeros("subspace.parts", &curvature::parts_shape(batch, grid))?,
            state: zeros("subspace.state", &[iterations + 2, batch, STATE])?,
        })
    }

    /// Starts a frame from `iterate.base`, with the last frame's acceleration still in `iterate.a`: it
    /// becomes the last step, and 0, or with bodies what keeps the particles out of them. Two dispatches, two more with
    /// bodies and one with self-contact.
    pub fn begin(&self, schedule: &mut Schedule, objective: &Objective) {
        let of = (objective.cloths(), &objective.iterate, &objective.x);
        let to = [&self.axes, &self.directions, &self.earlier];
        self.axes_kernel.push(schedule, objective.grid(), of, to);
        objective.shorten_axes(schedule, &self.axes);
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

    /// Whether a frame must be recorded anew for handles of these cloths, of which more react than before.
    pub fn lacks_room(&self, model: &Model) -> bool {
        Reactions::most(model) > self.reacting.handles.shape()[1]
    }

    /// Returns memory for the handles of these cloths. Fails if the device has too little.
    pub fn room_for(&self, context: &Context, model: &Model) -> Result<Reacting> {
        Reacting::new(context, Reactions::most(model), (self.grid, model.batch()))
    }

    /// Keeps handles in this memory from now on, and returns that in which they were. Frames that were recorded before go on with
    /// the latter.
    pub fn replace_room(&mut self, room: Reacting) -> Reacting {
        std::mem::replace(&mut self.reacting, room)
    }

    /// Takes the handles and materials of the cloths, from the next submission on. Panics without room for them
    /// ([`Subspace::lacks_room`]).
    pub fn set_cloths(&self, context: &Context, model: &Model) {
        self.reacting.write(context, model);
    }

    /// Moves the iterate, which was evaluated, by the step of `iteration`, counted from 0. Seven dispatches, and
    /// another where rows are longer than 128 particles, another with a repulsion, and two with bodies.
    pub fn push(&self, schedule: &mut Schedule, objective: &Objective, iteration: usize) {
        assert!(iteration < self.iterations, "iteration {iteration} of {}", self.iterations);
        let (grid, iterate) = (objective.grid(), &objective.iterate);
        let Self { axes, reacting, directions, modes: [z, y], tables: [along_column, along_row], .. } = self;
        let of_columns = (objective.cloths(), along_column, &self.mu);
        let of_sheet = (iterate, axes, reacting);
        let [space_and_normal, tangents] = &self.columns;
        self.rows.push(schedule, grid, (iterate, axes), [along_row, z]);
        space_and_normal.push(schedule, of_columns, [z, y]);
        self.answer_rows.push(schedule, grid, of_sheet, [along_row, z, y]);
        tangents.push(schedule, of_columns, [z, y]);
        self.sheet_steps.push(schedule, grid, of_sheet, [along_row, z, y, directions]);
        objective.local_model(schedule, directions, &self.parts);
        self.decide(schedule, objective, When::Iteration(iteration));
        objective.confine(schedule, Some(directions));
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
