//! The contacts of cloths with themselves on a device.

use super::layer_find::Finds;
use super::layer_motion::Way;
use super::layer_press::Tells;
use super::{
    CellScan, Cells, LayerAxes, LayerCurvature, LayerFind, LayerForce, LayerList, LayerMotion, LayerOrder,
    LayerPart, LayerPlace, LayerPress, LayerReport, Trial, buckets, layer_report,
};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::size;
use crate::settings::{PARTING_ROUNDS, PARTINGS};

/// Most pairs of near parts for each particle of a cloth, for which there is room; a crumpled one has some twenty.
pub const MOST_PAIRS: usize = 32;

/// Most of those that a search at the end of a frame finds.
pub const MOST_MISSED: usize = 8;

/// Number of 32-bit values in an element of the WGSL's `array<Pair>`.
const PAIR: usize = 20;

/// What kernels need to know of [`Pairs`].
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PairParams {
    /// H.
    pub rows: u32,
    /// W.
    pub columns: u32,
    /// Length of each cloth's part of the ends.
    pub buckets: u32,
    /// Most pairs of a cloth.
    pub room: u32,
}

/// The pairs of parts of each cloth that a search found, and for each particle those that it belongs to. Pairs beyond the room
/// for them count, but none is kept then.
#[derive(Clone, Debug)]
pub struct Pairs {
    /// Where the pairs of each patch end, shape [B, buckets]; integers.
    pub ends: Tensor,
    /// Shape [B, room, 20].
    pub pairs: Tensor,
    /// Where the list of each particle ends, shape [B, buckets]; integers.
    pub list_ends: Tensor,
    /// Four times the number of a pair, and which of its particles it is, shape [B, 4 room]; integers.
    pub lists: Tensor,
    /// What each pair tells its particles, shape [B, room, 4].
    pub presses: Tensor,
}

impl Pairs {
    /// Allocates room for so many for each particle; `ends` [B, buckets] may belong to others.
    fn new(context: &Context, (batch, grid): (usize, Grid), most: usize, ends: Tensor) -> Result<Self> {
        let room = most * grid.particles();
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        Ok(Self {
            ends,
            pairs: zeros("pairs of layers", &[batch, room, PAIR])?,
            list_ends: zeros("list ends", &[batch, buckets(grid)])?,
            lists: zeros("lists of pairs", &[batch, 4 * room])?,
            presses: zeros("presses", &[batch, room, 4])?,
        })
    }

    /// Returns the most pairs of a cloth.
    pub fn room(&self) -> usize {
        self.pairs.shape()[1]
    }

    /// Returns what the kernels need to know.
    pub fn params(&self, grid: Grid) -> PairParams {
        PairParams {
            rows: size(grid.h),
            columns: size(grid.w),
            buckets: size(self.ends.shape()[1]),
            room: size(self.room()),
        }
    }
}

/// The pairs of parts of each cloth that may touch, and what computes with them. [`crate::cpu::cloth::Layers`] is its
/// counterpart.
#[derive(Clone, Debug)]
pub struct Layers {
    /// What the layers did in the last frame, shape [B, 8], see [`layer_report`].
    pub report: Tensor,
    /// Places and ways of the particles, shape [B, n, 8].
    motion: Tensor,
    /// Sizes of the search, shape [B, 4].
    extents: Tensor,
    cells: Cells,
    /// The pairs of the frame.
    pairs: Pairs,
    /// Those that each search at the frame's end finds; they share all but their ends.
    missed: Vec<Pairs>,
    /// The ends of those, shape [rounds, B, buckets].
    missed_ends: Tensor,
    motion_kernel: LayerMotion,
    place: LayerPlace,
    find: LayerFind,
    scan: CellScan,
    list: LayerList,
    order: LayerOrder,
    axes: LayerAxes,
    press: LayerPress,
    force: LayerForce,
    part: LayerPart,
    curvature: LayerCurvature,
    report_kernel: LayerReport,
}

impl Layers {
    /// Builds the kernels and tensors for `batch` cloths on a grid.
    pub fn new(context: &Context, batch: usize, grid: Grid) -> Result<Self> {
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let (n, buckets) = (grid.particles(), buckets(grid));
        let pairs = |most, ends| Pairs::new(context, (batch, grid), most, ends);
        let missed_ends = zeros("missed ends", &[PARTING_ROUNDS, batch, buckets])?;
        let of_round = |round: usize| missed_ends.view(round * batch * buckets, &[batch, buckets]);
        let missed = pairs(MOST_MISSED, of_round(0))?;
        let missed = (0..PARTING_ROUNDS).map(|round| Pairs { ends: of_round(round), ..missed.clone() });
        Ok(Self {
            report: zeros("layer report", &[batch, layer_report::VALUES])?,
            motion: zeros("motion", &[batch, n, 8])?,
            extents: zeros("extents", &[batch, 4])?,
            cells: Cells::new(context, batch, grid)?,
            pairs: pairs(MOST_PAIRS, zeros("pair ends", &[batch, buckets])?)?,
            missed: missed.collect(),
            missed_ends,
            motion_kernel: LayerMotion::new(context)?,
            place: LayerPlace::new(context)?,
            find: LayerFind::new(context)?,
            scan: CellScan::new(context)?,
            list: LayerList::new(context)?,
            order: LayerOrder::new(context)?,
            axes: LayerAxes::new(context)?,
            press: LayerPress::new(context)?,
            force: LayerForce::new(context)?,
            part: LayerPart::new(context)?,
            curvature: LayerCurvature::new(context)?,
            report_kernel: LayerReport::new(context)?,
        })
    }

    /// Returns the pairs of the frame.
    pub fn pairs(&self) -> &Pairs {
        &self.pairs
    }

    /// Appends the search for the pairs of a frame that begins at `trial`. Eleven dispatches.
    pub fn find(&self, schedule: &mut Schedule, trial: Trial<'_>) {
        self.search(schedule, trial, Way::Predicted, &self.pairs);
    }

    fn search(&self, schedule: &mut Schedule, trial: Trial<'_>, way: Way, pairs: &Pairs) {
        let Self { motion, extents, cells, .. } = self;
        let counted @ [counts, ..] = cells.counted();
        self.motion_kernel.push(schedule, trial, way, [motion, extents]);
        self.place.push(schedule, trial.grid, [motion, extents], counted);
        cells.sort(schedule);
        for (finds, ends) in [(Finds::Counts, &pairs.ends), (Finds::Writes, &pairs.list_ends)] {
            let tensors = [trial.cloths, motion, extents, counts];
            self.find.push(schedule, (trial.grid, finds), (cells, pairs), tensors);
            self.scan.push(schedule, counts, ends);
        }
        self.list.push(schedule, trial.grid, pairs, counts);
        self.order.push(schedule, trial.grid, pairs, counts);
    }

    /// Appends what shortens the axes of the sheet where other layers hold it ([`LayerAxes::push`]). One dispatch.
    pub fn shorten_axes(&self, schedule: &mut Schedule, trial: Trial<'_>, axes: &Tensor) {
        self.axes.push(schedule, trial, &self.pairs, axes);
    }

    /// Appends the accelerations between layers and their energy ([`LayerForce::push`]). Two dispatches.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, after_others: bool, parts: &Tensor) {
        self.press.push(schedule, trial, &self.pairs, Tells::Forces);
        self.force.push(schedule, trial, after_others, (&self.pairs, parts));
    }

    /// Appends their second derivatives ([`LayerCurvature::push`]). One dispatch.
    pub fn push_curvature(&self, schedule: &mut Schedule, trial: Trial<'_>, tensors: [&Tensor; 2]) {
        self.curvature.push(schedule, trial, &self.pairs, tensors);
    }

    /// Appends what takes back the slip of layers that stick, and parts those at the end of a frame that its accelerations lead too
    /// near each other: first those that were found at its start, then those that were missed because particles left their way.
    /// Changes `iterate.a`.
    pub fn part(&self, schedule: &mut Schedule, trial: Trial<'_>) {
        self.press.push(schedule, trial, &self.pairs, Tells::SlipsBack);
        self.part.push(schedule, trial, &self.pairs);
        self.part_pairs(schedule, trial, &self.pairs);
        for missed in &self.missed {
            self.search(schedule, trial, Way::Taken, missed);
            self.part_pairs(schedule, trial, missed);
        }
    }

    fn part_pairs(&self, schedule: &mut Schedule, trial: Trial<'_>, pairs: &Pairs) {
        for _ in 0..PARTINGS {
            self.press.push(schedule, trial, pairs, Tells::WaysOut);
            self.part.push(schedule, trial, pairs);
        }
    }

    /// Appends the report at the accepted accelerations, before the frame ends. One dispatch.
    pub fn report(&self, schedule: &mut Schedule, trial: Trial<'_>) {
        self.report_kernel.push(schedule, trial, &self.pairs, [&self.missed_ends, &self.report]);
    }
}
