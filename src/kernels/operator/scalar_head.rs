//! Host side of `shaders/operator/scalar_head.wgsl`.

use super::JoinedLayer;
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "scalar_head",
    wgsl: include_str!("../../../shaders/operator/scalar_head.wgsl"),
    appended: &[pieces::SCALAR_HEAD, common::FINITE, common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    channels: u32,
    bias: u32,
    rows: u32,
    before: u32,
    after: u32,
    particles: u32,
    parts: u32,
    first_sum: u32,
    first: u32,
}

/// The scalar head, from the row maxima on, and the persistent scale that it updates.
#[derive(Clone, Debug)]
pub struct ScalarHead {
    alone: Kernel,
    /// From the scales before, and from the size of the last step.
    rescaling: [Kernel; 2],
    /// Bound in place of scales and sums if there are none.
    nothing: [Tensor; 2],
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
    /// The last step, if a pass begins with its size: then the scales before count only for cloths without a step.
    pub last_step: Option<LastStep<'a>>,
}

/// The last step of the samples of a pass, from whose size their scales begin: its root mean square, at least 1 % of the largest
/// of the three components of a cloth.
#[derive(Clone, Copy, Debug)]
pub struct LastStep<'a> {
    /// Partial sums of squares of gradient and last step of all samples, three for each cloth, shape [S, parts, 2].
    pub sums: &'a Tensor,
    /// Index among these of the pass's first sample.
    pub first: usize,
    /// Number of particles of a cloth.
    pub particles: usize,
}

impl<'a> Scales<'a> {
    /// Returns scales `[S]` that are updated in place.
    pub fn in_place(tensor: &'a Tensor) -> Self {
        Self { tensor, before: 0, after: 0, last_step: None }
    }
}

impl<'a> LastStep<'a> {
    /// Returns the tensor to bind, the number of partial sums of a sample, and the index of the first of all.
    pub(in crate::kernels) fn parts(&self) -> (Tensor, usize, usize) {
        let &[samples, parts, 2] = self.sums.shape() else { panic!("sums: {:?}", self.sums.shape()) };
        assert!(samples.is_multiple_of(3) && self.first < samples, "three samples for each cloth");
        let (sums, first) = self.sums.whole();
        // Views begin at an even element.
        (sums, parts, first / 2)
    }
}

impl ScalarHead {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |rescale: f64, of_step: f64| {
            Kernel::new(context, &SOURCE, 0, &[("RESCALE", rescale), ("OF_STEP", of_step)])
        };
        let nothing = [Tensor::zeros(context, "no scale", &[1])?, Tensor::zeros(context, "no sums", &[2])?];
        let rescaling = [kernel(1.0, 0.0)?, kernel(1.0, 1.0)?];
        Ok(Self { alone: kernel(0.0, 0.0)?, rescaling, nothing })
    }

    /// Computes `scalar` `[S]` from `rows_max` [S, H, C] with `layer` (weight `[C]`), and updates `scales` if they are given.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        layer: &JoinedLayer,
        (rows_max, scalar): (&Tensor, &Tensor),
        scales: Option<Scales<'_>>,
    ) {
        let &[samples, rows, channels] = rows_max.shape() else {
            panic!("scalar_head: {:?}", rows_max.shape())
        };
        layer.check_head(channels);
        assert_eq!(scalar.shape(), [samples]);
        let [_, teams, _] = self.alone.workgroup();
        assert!(rows >= teams as usize, "scalar_head: at least one row per team");
        let [no_scale, no_sums] = &self.nothing;
        let Scales { tensor, before, after, last_step } = scales.unwrap_or(Scales::in_place(no_scale));
        assert!(scales.is_none() || before.max(after) + samples <= tensor.len());
        let (sums, parts, first_sum) = last_step.map_or_else(|| (no_sums.clone(), 0, 0), |last| last.parts());
        let (first, particles) = last_step.map_or((0, 0), |last| (last.first, last.particles));
        let params = Params {
            channels: size(channels),
            bias: size(layer.bias),
            rows: size(rows),
            before: size(before),
            after: size(after),
            particles: size(particles),
            parts: size(parts),
            first_sum: size(first_sum),
            first: size(first),
        };
        let tensors = [&layer.weight_and_bias, rows_max, &sums, scalar, tensor];
        let [of_scale, of_step] = &self.rescaling;
        let kernel = match (scales, last_step) {
            (None, _) => &self.alone,
            (Some(_), None) => of_scale,
            (Some(_), Some(_)) => of_step,
        };
        schedule.dispatch(kernel, &params, &tensors, [size(samples), 1, 1]);
    }
}
