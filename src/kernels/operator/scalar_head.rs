//! Host side of `shaders/operator/scalar_head.wgsl`.

use super::Layer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "scalar_head",
    wgsl: include_str!("../../../shaders/operator/scalar_head.wgsl"),
    appended: &[pieces::SCALAR_HEAD, common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    rows: u32,
    before: u32,
    after: u32,
}

/// The scalar head, from the row maxima on, and the persistent scale that it updates.
#[derive(Clone, Debug)]
pub struct ScalarHead {
    alone: Kernel,
    rescaling: Kernel,
    /// Bound in place of the scales if there are none.
    nothing: Tensor,
}

/// Where a pass reads and writes the persistent scales of its samples.
#[derive(Clone, Copy, Debug)]
pub struct Scales<'a> {
    /// The tensor.
    pub tensor: &'a Tensor,
    /// Index of the first of the S scales before the pass.
    pub before: usize,
    /// Index of the first of the S scales after the pass; may be the same.
    pub after: usize,
}

impl<'a> Scales<'a> {
    /// Returns scales `[S]` that are updated in place.
    pub fn in_place(tensor: &'a Tensor) -> Self {
        Self { tensor, before: 0, after: 0 }
    }
}

impl ScalarHead {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |rescale: f64| Kernel::new(context, &SOURCE, 0, &[("RESCALE", rescale)]);
        let nothing = Tensor::zeros(context, "no scale", &[1])?;
        Ok(Self { alone: kernel(0.0)?, rescaling: kernel(1.0)?, nothing })
    }

    /// Computes `scalar` `[S]` from `rows_max` [S, H, C] with `layer` (weight `[C]`, bias `[1]`), and updates
    /// `scales` if they are given.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        layer: &Layer,
        (rows_max, scalar): (&Tensor, &Tensor),
        scales: Option<Scales<'_>>,
    ) {
        let &[samples, rows, channels] = rows_max.shape() else {
            panic!("scalar_head: {:?}", rows_max.shape())
        };
        assert_eq!((layer.weight.len(), layer.bias.len()), (channels, 1));
        assert_eq!(scalar.shape(), [samples]);
        let [_, teams, _] = self.alone.workgroup();
        assert!(rows >= teams as usize, "scalar_head: at least one row per team");
        let Scales { tensor, before, after } = scales.unwrap_or(Scales::in_place(&self.nothing));
        assert!(scales.is_none() || before.max(after) + samples <= tensor.len());
        let params =
            Params { channels: size(channels), rows: size(rows), before: size(before), after: size(after) };
        let tensors = [&layer.weight, &layer.bias, rows_max, scalar, tensor];
        let kernel = if scales.is_some() { &self.rescaling } else { &self.alone };
        schedule.dispatch(kernel, &params, &tensors, [size(samples), 1, 1]);
    }
}
