//! Host side of `shaders/optim/subspace_step.wgsl`.

use super::{Iterate, directions};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::{curvature, energy};
use crate::kernels::{common, size};

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
    first: u32,
    last: u32,
}

/// Minimises the quadratic model of the energy in the span of the directions, or takes the last step back.
#[derive(Clone, Debug)]
pub struct SubspaceStep {
    alone: Kernel,
    with_repulsion: Kernel,
    /// Bound in place of the energy's parts if there is no repulsion.
    nothing: Tensor,
}

/// The place of a dispatch in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// Iteration, counted from 0. It writes this row of the state, from the row before.
    Iteration(usize),
    /// After this many iterations. It writes the row of that number, and only takes steps back.
    End(usize),
}

/// Number of values in the state of a cloth: accepted energy, sum of the magnitudes of its terms, rejected
/// steps, and directions that were dropped as they were not finite.
pub const STATE: usize = 4;

/// Most workgroups per cloth: each of them adds up all parts.
const MAX_GROUPS: usize = 64;

impl SubspaceStep {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |repels: f64| Kernel::new(context, &SOURCE, 0, &[("REPELS", repels)]);
        Ok(Self {
            alone: kernel(0.0)?,
            with_repulsion: kernel(1.0)?,
            nothing: Tensor::zeros(context, "no repulsion", &[1])?,
        })
    }

    /// Moves `iterate.a` and the last step in `directions`, from the model in `parts` ([`curvature`]) and the
    /// repulsion in the parts of the energy ([`energy`]), if there is one. Reads and writes rows of `state`
    /// [rows, B, 4].
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
        let (after, last) = match when {
            When::Iteration(at) => (at, false),
            When::End(count) => (count, true),
        };
        assert!(after < rows && !(last && after == 0), "{when:?} of {rows} rows");
        assert_eq!((n, state.shape()), (grid.particles(), &[rows, batch, STATE][..]));
        assert_eq!(parts.shape(), curvature::parts_shape(batch, grid));
        let groups = repulsion.map_or(0, |of_energy| {
            assert_eq!(of_energy.shape(), energy::parts_shape(batch, grid));
            of_energy.shape()[1]
        });
        let params = Params {
            elements: size(3 * n),
            slot: size(directions::slot(directions, iterate)),
            parts: size(parts.shape()[1]),
            groups: size(groups),
            batch: size(batch),
            before: size(after.saturating_sub(1)),
            after: size(after),
            first: u32::from(after == 0),
            last: u32::from(last),
        };
        let kernel = if repulsion.is_some() { &self.with_repulsion } else { &self.alone };
        let tensors = [parts, repulsion.unwrap_or(&self.nothing), directions, &iterate.a, state];
        let count = (3 * n).div_ceil(256).clamp(1, MAX_GROUPS);
        schedule.dispatch(kernel, &params, &tensors, [size(count), size(batch), 1]);
    }
}
