//! Host side of `shaders/cloth/energy_sum.wgsl`.

use crate::Result;
use crate::cloth::EnergyTerms;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;

pub(crate) const SOURCE: Source = Source {
    name: "energy_sum",
    wgsl: include_str!("../../../shaders/cloth/energy_sum.wgsl"),
    appended: &[],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    groups: u32,
}

/// Number of values that the device keeps for the energy of a cloth or of a part of it: see [`ClothTerms`].
pub const TERMS: usize = 8;

/// What the device reports about a cloth at a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClothTerms {
    /// Terms of the energy.
    pub energy: EnergyTerms,
    /// Largest `|edge| - 1`.
    pub stretch_largest: f64,
    /// Sum of `||edge| - 1|` over the edges.
    pub stretch_sum: f64,
}

impl ClothTerms {
    /// Returns the terms of each cloth, read from the contents of `terms` [B, 8].
    pub fn all(terms: &[f32]) -> impl Iterator<Item = Self> {
        terms.chunks_exact(TERMS).map(|of_cloth| {
            let at = |k: usize| f64::from(of_cloth[k]);
            let energy = EnergyTerms::from_array([at(0), at(1), at(2), at(3), at(4), at(7), 0.0]);
            Self { energy, stretch_largest: at(5), stretch_sum: at(6) }
        })
    }
}

/// Sums the energy terms of each cloth over its parts.
#[derive(Clone, Debug)]
pub struct EnergySum {
    kernel: Kernel,
}

impl EnergySum {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `terms` [B, 8] from `parts` [B, parts, 8].
    pub fn push(&self, schedule: &mut Schedule, parts: &Tensor, terms: &Tensor) {
        let &[batch, count, TERMS] = parts.shape() else { panic!("energy_sum: {:?}", parts.shape()) };
        assert_eq!(terms.shape(), [batch, TERMS]);
        let params = Params { groups: size(count) };
        schedule.dispatch(&self.kernel, &params, &[parts, terms], [size(batch), 1, 1]);
    }
}
