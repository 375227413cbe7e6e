//! What the kernels of forces by positions share: they add to an acceleration and to an energy, or set both.

use super::{Trial, energy};
use crate::Result;
use crate::gpu::{Context, Kernel, Source, Tensor};
use crate::kernels::size;

/// A kernel with the override SETS, of forces that several of may act on a cloth: the first sets `iterate.total` and the last number
/// of each part of the energy, and those after it add to both.
#[derive(Clone, Debug)]
pub(super) struct Force {
    first: Kernel,
    after_others: Kernel,
}

/// The fields of such a kernel's Params that say where the sums are.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct Sums {
    groups: u32,
    first_source: u32,
    first_total: u32,
}

impl Force {
    /// Builds the kernel with these constants beside SETS.
    pub fn new(context: &Context, source: &Source, constants: &[(&'static str, f64)]) -> Result<Self> {
        let kernel = |sets: f64| Kernel::new(context, source, 0, &[constants, &[("SETS", sets)]].concat());
        Ok(Self { first: kernel(1.0)?, after_others: kernel(0.0)? })
    }

    /// Returns the kernel and where it sums: the accelerations of the `trial`, and the `parts` of its energy [B, parts, 8]. Panics if
    /// the iterate has no total.
    pub fn of(&self, trial: Trial<'_>, after_others: bool, parts: &Tensor) -> (&Kernel, Sums) {
        let shape @ [_, groups, _] = energy::parts_shape(trial.batch(), trial.grid);
        assert_eq!(parts.shape(), shape);
        let (_, external, total) = trial.iterate.given();
        let total = total.expect("the iterate has a total");
        let (kernel, source) = match after_others {
            true => (&self.after_others, total),
            false => (&self.first, external),
        };
        (kernel, Sums { groups: size(groups), first_source: size(source), first_total: size(total) })
    }
}
