//! Host side of `shaders/cloth/layer_curvature.wgsl`.

use super::{Pairs, Trial, curvature};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
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
        pieces::CONTACT_PRODUCTS,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    buckets: u32,
    room: u32,
    parts: u32,
    slot: u32,
}

/// Adds the second derivatives of the pairs of parts of a cloth to the quadratic model of the energy.
#[derive(Clone, Debug)]
pub struct LayerCurvature {
    three: Kernel,
    four: Kernel,
}

impl LayerCurvature {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |count: f64| Kernel::new(context, &SOURCE, 0, &[("K", count)]);
        Ok(Self { three: kernel(3.0)?, four: kernel(4.0)? })
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
        let kernel = match directions.shape()[0] {
            3 => &self.three,
            4 => &self.four,
            other => panic!("three or four directions, not {other}"),
        };
        let (grid, batch, iterate) = (trial.grid, trial.batch(), trial.iterate);
        let shape @ [_, groups, _] = curvature::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let of_pairs = pairs.params(grid);
        let params = Params {
            rows: of_pairs.rows,
            columns: of_pairs.columns,
            buckets: of_pairs.buckets,
            room: of_pairs.room,
            parts: size(groups),
            slot: size(directions::slot(directions, iterate)),
        };
        let (given, ..) = &iterate.given();
        let tensors = [&pairs.ends, &pairs.pairs, &iterate.a, given, directions, parts];
        schedule.dispatch(kernel, &params, &tensors, [size(groups), size(batch), 1]);
    }
}
