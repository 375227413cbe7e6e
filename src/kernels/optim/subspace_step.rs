//! Host side of `shaders/optim/subspace_step.wgsl`.

use super::{Iterate, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::{curvature, energy};
use crate::kernels::{common, size};
use crate::settings::WARMEST;

pub(crate) const SOURCE: Source = Source {
    name: "subspace_step",
    wgsl: include_str!("../../../shaders/optim/subspace_step.wgsl"),
    appended: &[common::FINITE],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    elements: u32,
    slot: u32,
    parts: u32,
    groups: u32,
    batch: u32,
    before: u32,
    after: u32,
    stage: u32,
    last_step: u32,
}

/// Minimises the quadratic model of the energy in the span of the directions, or takes the last step back.
#[derive(Clone, Debug)]
pub struct SubspaceStep {
    /// Without and with repulsion, each without and with a hidden state.
    kernels: [[Kernel; 2]; 2],
    /// Bound in place of the energy's parts if there is no repulsion, and of fields without a hidden state.
    nothing: Tensor,
    no_fields: Tensor,
}

/// The place of a dispatch in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// At the start, where a = 0 and the last frame's acceleration and what extrapolates it, in the co-rotated slot, are the
    /// only directions. It writes row 0 of the state.
    Start,
    /// Iteration, counted from 0. It writes the next row of the state, from the row of this number.
    Iteration(usize),
    /// After this many iterations. It writes the row after theirs, and only takes steps back.
    End(usize),
}

/// Number of values in the state of a cloth: accepted energy, sum of the magnitudes of its terms, slope of the
/// step from there, steps that were shortened, and directions that were dropped as they were not finite.
pub const STATE: usize = 5;

/// Most workgroups per cloth: each of them adds up all parts.
const MAX_GROUPS: usize = 64;

impl SubspaceStep {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |repels: f64, remembers: f64| {
            let constants = [("REPELS", repels), ("REMEMBERS", remembers), ("WARMEST", WARMEST)];
            Kernel::new(context, &SOURCE, 0, &constants)
        };
        Ok(Self {
            kernels: [[kernel(0.0, 0.0)?, kernel(0.0, 1.0)?], [kernel(1.0, 0.0)?, kernel(1.0, 1.0)?]],
            nothing: Tensor::zeros(context, "no repulsion", &[1])?,
            no_fields: Tensor::zeros(context, "no fields", &[1])?,
        })
    }

    /// Moves `iterate.a` and the last step in `directions` and in the hidden state, if there is one, from the model in `parts` ([`curvature`]) and the
    /// repulsion in the parts of the energy ([`energy`]), if there is one. Reads and writes rows of `state`
    /// [rows, B, 5].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        when: When,
        (parts, repulsion): (&Tensor, Option<&Tensor>),
        (iterate, directions, state): (&Iterate, &Tensor, &Tensor),
    ) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        let &[rows, _, _] = state.shape() else { panic!("subspace_step: {:?}", state.shape()) };
        let (after, stage) = match when {
            When::Start => (0, 0),
            When::Iteration(at) => (at + 1, 1),
            When::End(count) => (count + 1, 2),
        };
        assert!(after < rows, "{when:?} of {rows} rows");
        assert_eq!((n, state.shape()), (grid.particles(), &[rows, batch, STATE][..]));
        assert_eq!(parts.shape(), curvature::parts_shape(batch, grid));
        let groups = repulsion.map_or(0, |of_energy| {
            assert_eq!(of_energy.shape(), energy::parts_shape(batch, grid));
            of_energy.shape()[1]
        });
        let (fields, hidden) = iterate.fields();
        let params = Params {
            elements: size(3 * n),
            slot: size(directions::slot(directions, iterate)),
            parts: size(parts.shape()[1]),
            groups: size(groups),
            batch: size(batch),
            before: size(after.saturating_sub(1)),
            after: size(after),
            stage,
            last_step: size(hidden.map_or(0, |first| first + samples * n)),
        };
        let kernel = &self.kernels[usize::from(repulsion.is_some())][usize::from(hidden.is_some())];
        let fields = if hidden.is_some() { &fields } else { &self.no_fields };
        let energies = repulsion.unwrap_or(&self.nothing);
        let tensors = [parts, energies, directions, &iterate.a, state, fields];
        let count = (3 * n).div_ceil(256).clamp(1, MAX_GROUPS);
        schedule.dispatch(kernel, &params, &tensors, [size(count), size(batch), 1]);
    }
}
