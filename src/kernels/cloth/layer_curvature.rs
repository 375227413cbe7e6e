//! Host side of `shaders/cloth/layer_curvature.wgsl`.

use super::{PairParams, Pairs, Trial, curvature};
use crate::Result;
use crate::gpu::{Context, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_curvature",
    wgsl: include_str!("../../../shaders/cloth/layer_curvature.wgsl"),
    appended: &[
        terms::CONTACT,
        pieces::PAIR,
        pieces::PAIRS_OF,
        pieces::ACROSS,
        pieces::PRODUCTS,
        pieces::PRODUCTS_PART,
        pieces::CONTACT_PRODUCTS,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    of_pairs: PairParams,
    parts: u32,
    slot: u32,
}

/// Adds the second derivatives of the pairs of parts of a cloth to the quadratic model of the energy.
#[derive(Clone, Debug)]
pub struct LayerCurvature {
    kernels: directions::ByCount,
}

impl LayerCurvature {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernels: directions::ByCount::new(context, &SOURCE, &[])? })
    }

    /// Adds to `parts` [B, parts, 24], which hold those of the other terms ([`super::Curvature`]), the second
    /// derivatives of `pairs` at `iterate.a` along `directions` ([`directions::shape`]), which are 0 at handles.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        pairs: &Pairs,
        [directions, parts]: [&Tensor; 2],
    ) {
        let kernel = self.kernels.of(directions);
        let (grid, batch, iterate) = (trial.grid, trial.batch(), trial.iterate);
        let shape @ [_, groups, _] = curvature::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let params = Params {
            of_pairs: pairs.params(grid),
            parts: size(groups),
            slot: size(directions::slot(directions, iterate)),
        };
        let (given, ..) = &iterate.given();
        let tensors = [&pairs.ends, &pairs.pairs, &iterate.a, given, directions, parts];
        schedule.dispatch(kernel, &params, &tensors, [size(groups), size(batch), 1]);
    }
}
