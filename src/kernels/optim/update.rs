//! Host side of `shaders/optim/update.wgsl`.

use super::Iterate;
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::operator::{JoinedLayer, Scales};
use crate::kernels::{common, pieces, size};

pub(crate) const SOURCE: Source = Source {
    name: "update",
    wgsl: include_str!("../../../shaders/optim/update.wgsl"),
    appended: &[common::MARK, pieces::SCALAR_HEAD, common::FINITE, common::TANH],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
    row_quads: u32,
    samples: u32,
    parts: u32,
    first: u32,
    in_field: u32,
    hidden: u32,
    channels: u32,
    bias: u32,
    before: u32,
    after: u32,
    parts_of_sums: u32,
    first_sum: u32,
}

/// The learned step.
#[derive(Clone, Debug)]
pub struct Update {
    /// Without and with the scalar head.
    moves: [Kernel; 2],
    /// The scale of a proposal begins with the size of the last step.
    proposes: [Kernel; 2],
    /// Bound in place of the head and the sums if there are none, and of the marks if they are not needed.
    nothing: Tensor,
}

/// Inputs of the learned step, besides the iterate.
#[derive(Clone, Copy, Debug)]
pub struct UpdateTensors<'a> {
    /// Output of the field head, in parts to be summed, shape [parts, s, H, W'].
    pub field: &'a Tensor,
    /// Index among the S samples of the field's first one.
    pub first: usize,
    /// Persistent scales of the s samples.
    pub scales: Scales<'a>,
    /// The scalar head and its row maxima [s, H, C], to compute the scales after the pass from those before
    /// it, at another offset. `None` if they are already computed.
    pub head: Option<(&'a JoinedLayer, &'a Tensor)>,
    /// Where the step is proposed as a direction, shape [B, 3, n], 0 at handles. `None` if it moves the iterate.
    pub direction: Option<&'a Tensor>,
}

/// Most workgroups per sample: with a head, each of them computes the scale.
const MAX_GROUPS: usize = 64;

impl Update {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let kernel = |head: f64, proposes: f64| {
            let constants = [("HEAD", head), ("OF_STEP", proposes), ("PROPOSES", proposes)];
            Kernel::new(context, &SOURCE, 0, &constants)
        };
        Ok(Self {
            moves: [kernel(0.0, 0.0)?, kernel(1.0, 0.0)?],
            proposes: [kernel(0.0, 1.0)?, kernel(1.0, 1.0)?],
            nothing: Tensor::zeros(context, "no head", &[2])?,
        })
    }

    /// Computes one learned step of the samples of `iterate` that `from.field` covers, and moves the iterate by it
    /// or proposes it as a direction.
    pub fn push(&self, schedule: &mut Schedule, grid: Grid, from: UpdateTensors<'_>, iterate: &Iterate) {
        let UpdateTensors { field, first, scales, head, direction } = from;
        let &[parts, in_field, h, w] = field.shape() else { panic!("update: {:?}", field.shape()) };
        let (samples, n) = iterate.samples_and_particles();
        assert_eq!((h, n), (grid.h, grid.particles()));
        assert!(first + in_field <= samples, "update: {in_field} samples from {first} on");
        let Scales { tensor, before, after, last_step } = scales;
        assert!(before.max(after) + in_field <= tensor.len(), "update: scales {:?}", tensor.shape());
        let channels = head.map_or(0, |(_, rows_max)| rows_max.shape()[2]);
        if let Some((layer, rows_max)) = head {
            assert_eq!(rows_max.shape(), [in_field, h, channels]);
            layer.check_head(channels);
            assert!(before.abs_diff(after) >= in_field, "the scales before and after must not overlap");
            let [_, teams, _] = self.moves[1].workgroup();
            assert!(h >= teams as usize, "update: at least one row per team");
        }
        let nothing = &self.nothing;
        let (sums, parts_of_sums, first_sum) =
            last_step.map_or_else(|| (nothing.clone(), 0, 0), |last| last.parts());
        assert!(last_step.is_none_or(|last| (last.first, last.particles) == (first, n)));
        let (fields, hidden) = iterate.fields();
        let params = Params {
            rows: size(h),
            columns: size(grid.w),
            row_quads: size(w / 4),
            samples: size(samples),
            parts: size(parts),
            first: size(first),
            in_field: size(in_field),
            hidden: size(hidden.expect("the learned step has a hidden state")),
            channels: size(channels),
            bias: head.map_or(0, |(layer, _)| size(layer.bias)),
            before: size(before),
            after: size(after),
            parts_of_sums: size(parts_of_sums),
            first_sum: size(first_sum),
        };
        assert_eq!(
            direction.is_some(),
            last_step.is_some(),
            "proposals begin with the size of the last step"
        );
        let ([alone, with_head], marks, to) = match direction {
            Some(direction) => {
                assert_eq!(direction.shape(), iterate.a.shape());
                (&self.proposes, &iterate.marks, direction)
            }
            None => (&self.moves, nothing, &iterate.a),
        };
        let (kernel, rows_max, head) = match head {
            Some((layer, rows_max)) => (with_head, rows_max, &layer.weight_and_bias),
            None => (alone, nothing, nothing),
        };
        let tensors = [field, rows_max, head, &sums, marks, tensor, &fields, to];
        let groups = n.div_ceil(256).clamp(1, MAX_GROUPS);
        schedule.dispatch(kernel, &params, &tensors, [size(groups), size(in_field), 1]);
    }
}
