//! Host side of `shaders/optim/features.wgsl`.

use super::Iterate;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::cloth::gradient;
use crate::kernels::{common, padded, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "features",
    wgsl: include_str!("../../../shaders/optim/features.wgsl"),
    appended: &[pieces::FEATURES, common::TANH],
};

/// Channels of the network's input: gradient, last gradient, last step, and two for the position.
pub const CHANNELS: usize = 5;

/// Workgroup memory for the sums of the fields' squares \[bytes\].
pub(crate) const SUMS_BYTES: usize = 4 * 32;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    row_quads: u32,
    samples: u32,
    place: Place,
}

/// Where a kernel finds the data from which the features of its samples are computed.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct Place {
    pub first: u32,
    pub hidden: u32,
    pub parts: u32,
    pub first_sum: u32,
}

/// What the features of some samples are computed from.
#[derive(Clone, Copy, Debug)]
pub struct FeatureInputs<'a> {
    /// Gradient and hidden state.
    pub iterate: &'a Iterate,
    /// Partial sums of squares of these, shape [S, parts, 2] ([`gradient::parts`]).
    pub sums: &'a Tensor,
    /// Index of the first of these samples.
    pub first: usize,
}

impl FeatureInputs<'_> {
    /// Returns the tensors that a kernel binds (fields and sums), and where it finds `count` samples of a
    /// grid in them.
    pub(crate) fn bound(&self, grid: Grid, count: usize) -> ([Tensor; 2], Place) {
        let (samples, n) = self.iterate.samples_and_particles();
        assert_eq!((n, self.sums.shape()), (grid.particles(), &[samples, gradient::parts(grid), 2][..]));
        assert!(
            self.first + count <= samples,
            "features: {count} samples from {} on of {samples}",
            self.first
        );
        let ((fields, hidden), (sums, first_sum)) = (self.iterate.fields(), self.sums.whole());
        let place = Place {
            first: size(self.first),
            hidden: size(hidden.expect("features need a hidden state")),
            parts: size(gradient::parts(grid)),
            // Views begin at an even element.
            first_sum: size(first_sum / 2),
        };
        ([fields, sums], place)
    }
}

/// Computes the network's input from the gradient and the hidden state.
#[derive(Clone, Debug)]
pub struct Features {
    kernel: Kernel,
}

impl Features {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `embedded` [s, H, 5, W'] for s samples.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, from: FeatureInputs<'_>, embedded: &Tensor) {
        let (w, embedded_samples) = (padded(grid.w), embedded.shape()[0]);
        assert_eq!(embedded.shape(), [embedded_samples, grid.h, CHANNELS, w]);
        let ([fields, sums], place) = from.bound(grid, embedded_samples);
        let (samples, _) = from.iterate.samples_and_particles();
        let params = Params {
            rows: size(grid.h),
            columns: size(grid.w),
            row_quads: size(w / 4),
            samples: size(samples),
            place,
        };
        let count = self.kernel.groups([w / 4, grid.h, embedded_samples]);
        schedule.dispatch(&self.kernel, &params, &[&fields, &sums, embedded], count);
    }
}
