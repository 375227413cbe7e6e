//! Host side of `shaders/optim/answer_rows.wgsl`.

use super::{Fields, Iterate, Reacting};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::sheet_axes::AXES;
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "answer_rows",
    wgsl: include_str!("../../../shaders/optim/answer_rows.wgsl"),
    appended: &[common::MARK, pieces::FOUR_FIELDS, pieces::ROWS_BACK, pieces::ROWS_FORWARD],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    room: u32,
}

/// Transforms the rows of the fields in space and across the sheet back, where handles hold, and forward what the step across leaves to be
/// done along it.
#[derive(Clone, Debug)]
pub struct AnswerRows {
    /// One for both ways, or one for each.
    kernels: Vec<Kernel>,
    tile: Tile,
}

/// What a workgroup computes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Tile {
    rows: usize,
    /// Teams of invocations, each with 32 columns.
    teams: usize,
    /// Rows at either end that are its neighbours' own, and are computed twice, so that nothing waits for others.
    margin: usize,
}

impl Tile {
    /// Chooses it for rows of this grid: few rows for many workgroups, or without workgroup memory, on processors, as few as possible that
    /// are computed twice. A workgroup has at most 256 invocations and 16 KiB of memory.
    fn new(grid: Grid, staged: bool) -> Self {
        let teams = grid.w.div_ceil(32).next_power_of_two().min(4);
        let (teams, most) = if staged { (teams, 8) } else { (teams.div_ceil(2), 22) };
        if grid.w > 128 {
            // A workgroup would go through its rows several times, while others have nothing to do.
            return Self { rows: 8, teams, margin: 0 };
        }
        let groups = grid.h.div_ceil(most.min(32 / teams) - 2);
        Self { rows: (grid.h.div_ceil(groups) + 2).max(8), teams, margin: 1 }
    }
}

impl AnswerRows {
    /// Builds the kernel for rows of this grid, whose operands on the way back go through workgroup memory if `staged`.
    pub fn new(context: &Context, grid: Grid, staged: bool) -> Result<Self> {
        let tile = Tile::new(grid, staged);
        let kernel = |[back, answers]: [f64; 2]| {
            let constants = [
                ("ROWS", tile.rows as f64),
                ("TEAMS", tile.teams as f64),
                ("MARGIN", tile.margin as f64),
                ("BACK", back),
                ("ANSWERS", answers),
                ("STAGED", f64::from(u8::from(staged))),
            ];
            Kernel::new(context, &SOURCE, 0, &constants)
        };
        let parts: &[_] = if tile.margin > 0 { &[[1.0, 1.0]] } else { &[[1.0, 0.0], [0.0, 1.0]] };
        Ok(Self { kernels: parts.iter().map(|&part| kernel(part)).collect::<Result<_>>()?, tile })
    }

    /// Transforms [`Fields::SpaceAndNormal`] of `z` ([`Fields::shape`]) to `y`, of the same shape, and sets [`Fields::Tangents`] of `z`
    /// from these, the gradient [B, 3, n] of `iterate` and the `axes` [B, 16, n] of the sheet, with
    /// [`super::cosine_rows::table`] of W points. The other fields of `y` are overwritten. One dispatch, two for rows of more than 128
    /// particles.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        (iterate, axes, reacting): (&Iterate, &Tensor, &Reacting),
        [table, z, y]: [&Tensor; 3],
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!((n, axes.shape()), (grid.particles(), &[batch, AXES, n][..]));
        assert_eq!(table.shape(), [grid.w; 2]);
        assert_eq!([z, y].map(Tensor::shape), [&Fields::shape(batch, grid)[..]; 2]);
        let room = size(reacting.room(batch, n));
        let params = Params { rows: size(grid.h), columns: size(grid.w), room };
        let Reacting { handles, fields } = reacting;
        let tensors = [table, &iterate.marks, axes, handles, fields, &iterate.grad, z, y];
        let Tile { rows, teams, margin } = self.tile;
        let across = if margin > 0 { 1 } else { grid.w.div_ceil(32 * teams) };
        let groups = [across, grid.h.div_ceil(rows - 2 * margin), batch].map(size);
        self.kernels.iter().for_each(|kernel| schedule.dispatch(kernel, &params, &tensors, groups));
    }
}
