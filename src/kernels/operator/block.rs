//! Host side of `shaders/operator/block.wgsl`.

use super::Layer;
use crate::cloth::Grid;
use crate::gpu::{
    Context, Kernel, LANES, Schedule, Sharing, Source, Storage, Tensor, Tuning, Unroll, WORKGROUP_INVOCATIONS,
};
use crate::kernels::optim::features::{self, FeatureInputs, Place};
use crate::kernels::{common, padded, pieces, size};
use crate::{Error, Result};
use bytemuck::Zeroable;

pub(crate) const SOURCE: Source = Source {
    name: "block",
    wgsl: include_str!("../../../shaders/operator/block.wgsl"),
    appended: &[common::GELU, common::TEXEL, pieces::BLOCK_OUTPUT, pieces::BLOCK_INPUTS],
};

/// The kernel's WGSL as a lifting.
pub(crate) const LIFTING: Source = Source {
    appended: &[
        common::GELU,
        common::TEXEL,
        pieces::BLOCK_OUTPUT,
        pieces::LIFTING_INPUTS,
        pieces::LIFTED_EMBEDDING,
    ],
    ..SOURCE
};

/// The kernel's WGSL as a lifting that embeds its input from fields itself.
pub(crate) const LIFTING_OF_FIELDS: Source = Source {
    appended: &[
        common::GELU,
        common::TEXEL,
        pieces::BLOCK_OUTPUT,
        pieces::LIFTING_INPUTS,
        pieces::LIFTED_FIELDS,
        pieces::FEATURES,
        common::TANH,
    ],
    ..SOURCE
};

/// Workgroup memory for staged inputs and weights \[bytes\], unless rows need more: enough for few rounds of
/// staging, and for several workgroups per multiprocessor.
const STAGE_BYTES: usize = 16 << 10;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    inputs: u32,
    channels: u32,
    rows: u32,
    row_quads: u32,
    columns: u32,
    width: u32,
    samples: u32,
    embedded: u32,
    all_samples: u32,
    place: Place,
}

/// What a layer does in addition to the linear part of its output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Epilogue {
    /// Whether to apply the activation.
    pub gelu: bool,
    /// Whether to transform the output's rows for the next block.
    pub rows: bool,
    /// Whether to compute the largest value of each row of the output, for the scalar head.
    pub pool: bool,
    /// Whether to apply the last layer of the field head and write the field in place of the output.
    pub field: bool,
}

impl Epilogue {
    /// Whether it needs whole rows in a workgroup.
    fn whole_rows(&self) -> bool {
        self.rows || self.pool
    }
}

/// Sizes for which a layer is compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayerSize {
    /// Quads of columns per row (Q).
    pub row_quads: usize,
    /// Kept columns.
    pub modes_w: usize,
    /// Channels of the output (C).
    pub channels: usize,
    /// Further sizes of a lifting; `None` for a block.
    pub lifting: Option<Lifting>,
}

/// Sizes of a lifting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lifting {
    /// Hidden units.
    pub hidden: usize,
    /// Input channels (E).
    pub inputs: usize,
    /// Whether it embeds them itself, from fields.
    pub of_fields: bool,
}

impl LayerSize {
    /// Returns the number of inputs that are summed apart from the columns of spectra: channels, or hidden
    /// units.
    fn summed(&self) -> usize {
        self.lifting.map_or(self.channels, |lifting| lifting.hidden)
    }

    /// Returns the number of quads of the tables: of the inverse rows, which a lifting does not have, and of the
    /// row transform.
    fn table_quads(&self, rows: bool) -> usize {
        2 * self.modes_w * self.row_quads * (usize::from(self.lifting.is_none()) + usize::from(rows))
    }

    /// Returns the number of quads of the weights and of the tables, 0 for those not bound as uniform buffers.
    /// Where loads from storage are expensive, those from uniform buffers are not.
    fn uniform_quads(&self, context: &Context, tuning: &Tuning, epilogue: Epilogue) -> [usize; 2] {
        let weights = self.channels * self.lifting.map_or(self.channels, |lifting| lifting.hidden) / 4;
        let weights = if context.storage() == Storage::F32 { weights } else { 0 };
        let most = context.device.limits().max_uniform_buffer_binding_size;
        let fits = |quads: usize| tuning.sharing == Sharing::Broadcast && 16 * quads as u64 <= most;
        [weights, self.table_quads(epilogue.rows)].map(|quads| if fits(quads) { quads } else { 0 })
    }
}

/// The shape of a workgroup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Group {
    wide: usize,
    span: usize,
    /// Rows of an invocation.
    lines: usize,
    deep: usize,
    /// Number of inputs staged at a time, and (`staged`) of the quads of memory that they take.
    chunk: usize,
    staged: usize,
    /// Quads of memory for the embedding of a lifting of fields.
    embedded_quads: usize,
    /// Quads of workgroup memory.
    memory: usize,
}

impl Group {
    /// Returns the group of a layer, with as many tiles of channels as the tuning allows and the device can
    /// hold, and then as many rows. `None` if a row is too long for the device.
    fn new(limits: &wgpu::Limits, tuning: &Tuning, layer: &LayerSize, epilogue: Epilogue) -> Option<Self> {
        let capacity = limits.max_compute_workgroup_storage_size as usize / 16;
        let most = limits.max_compute_invocations_per_workgroup.min(limits.max_compute_workgroup_size_x);
        // Subgroups that share operands need rows of whole subgroups, of eight lanes each.
        let whole = |lanes: usize| match tuning.sharing {
            Sharing::Loads => lanes,
            Sharing::Broadcast => lanes.next_multiple_of(LANES),
        };
        let lanes = |span: usize| whole(layer.row_quads.div_ceil(span));
        // As many quads per invocation as possible without idling more lanes, and more than one only if each
        // gets the lanes of a subgroup.
        let suits =
            |&span: &usize| span == 1 || (8 * span <= layer.row_quads && span * lanes(span) <= lanes(1));
        let span = (1..=tuning.block_span as usize).rev().find(suits)?;
        // Parts of a row of equal length: the last one would otherwise idle lanes that do all the work.
        let parts = if epilogue.whole_rows() { 1 } else { lanes(span).div_ceil(tuning.block_wide as usize) };
        let wide = whole(lanes(span).div_ceil(parts));
        let quads = tuning.channels / 4;
        let of_fields = layer.lifting.filter(|lifting| lifting.of_fields);
        let sums = of_fields.map_or(0, |_| features::SUMS_BYTES / 16);
        let embedded_quads =
            of_fields.filter(|_| tuning.staged).map_or(0, |lifting| lifting.inputs * span * wide);
        let of_shape = |(lines, deep): (usize, usize)| {
            let kept = match epilogue {
                _ if epilogue.whole_rows() && tuning.sharing == Sharing::Broadcast => {
                    let rows = if epilogue.rows { 2 * layer.modes_w } else { 0 };
                    deep * wide / LANES * (rows + usize::from(epilogue.pool)) * quads
                }
                _ if epilogue.whole_rows() => deep * quads * (4 * (layer.row_quads | 1) + 1),
                _ if epilogue.field => lines * span * wide * deep,
                _ => 1,
            };
            let (mut chunk, mut staged) = (1, 0);
            if tuning.staged {
                let input = lines * (span * wide + deep * quads);
                let at_once =
                    (kept.max(STAGE_BYTES / 16).saturating_sub(embedded_quads + sums) / input).max(1);
                // Whole rounds of loads, of four inputs per row of lanes and place, if there is room for one.
                let round = (4 * deep / (lines * span)).max(1);
                let at_once = if at_once > round { at_once - at_once % round } else { at_once };
                chunk = layer.summed().div_ceil(layer.summed().div_ceil(at_once));
                staged = chunk * input;
            }
            Self {
                wide,
                span,
                lines,
                deep,
                chunk,
                staged,
                embedded_quads,
                memory: kept.max(staged + embedded_quads),
            }
        };
        let tiles = layer.channels / tuning.channels;
        let depths = (1..=tuning.block_deep as usize).rev().filter(|&deep| tiles.is_multiple_of(deep));
        let fits = |g: &Self| {
            let few = g.deep == 1 || g.lanes() <= WORKGROUP_INVOCATIONS as usize;
            few && g.lanes() <= most as usize && g.memory + sums <= capacity
        };
        let group = depths.map(|deep| of_shape((1, deep))).find(fits)?;
        // A lifting embeds one row.
        let takes_lines = tuning.takes_lines() && layer.lifting.is_none();
        let most = if takes_lines { tuning.block_lines as usize } else { 1 };
        let with_lines = (2..=most).rev().map(|lines| of_shape((lines, group.deep))).find(fits);
        Some(with_lines.unwrap_or(group))
    }

    fn lanes(&self) -> usize {
        self.wide * self.deep
    }
}

/// A layer over rows, and what the next kernels need of its output: a Fourier block after its columns
/// (inverse rows, skip, bias, activation), or the lifting.
#[derive(Clone, Debug)]
pub struct Block {
    kernel: Kernel,
    tile: usize,
    group: Group,
    layer: LayerSize,
    epilogue: Epilogue,
    /// Bound in place of `rows_or_field` and `rows_max` if these are not computed.
    nothing: [Tensor; 2],
}

impl Block {
    /// Whether a whole row fits a workgroup, as [`Epilogue::rows`] and [`Epilogue::pool`] require, and the
    /// tuning puts it there. For a lifting it must fit with all channels: workgroups with part of them would
    /// each recompute the hidden layer.
    pub fn takes_rows(context: &Context, tuning: &Tuning, layer: &LayerSize) -> bool {
        Self::rows_fit(&context.device.limits(), tuning, layer) && tuning.rows_in_blocks
    }

    fn rows_fit(limits: &wgpu::Limits, tuning: &Tuning, layer: &LayerSize) -> bool {
        let epilogue = Epilogue { rows: true, pool: true, ..Epilogue::default() };
        let suits = |g: Group| layer.lifting.is_none() || g.deep * tuning.channels == layer.channels;
        Group::new(limits, tuning, layer, epilogue).is_some_and(suits)
    }

    /// Builds the kernel. With [`Tuning::texels`], it takes an input of C channels in texels and writes its
    /// output to texels. Fails if the device's workgroups are too small.
    pub fn new(context: &Context, tuning: &Tuning, layer: LayerSize, epilogue: Epilogue) -> Result<Self> {
        assert!(!(epilogue.field && epilogue.whole_rows()), "FIELD excludes ROWS and POOL");
        assert!(layer.lifting.is_none() || !epilogue.pool, "only blocks pool");
        let group = Group::new(&context.device.limits(), tuning, &layer, epilogue).ok_or_else(|| {
            let quads = layer.row_quads;
            Error::Device(format!("{}: rows of {quads} quads do not fit a workgroup", context.name()))
        })?;
        let flag = |flag: bool| f64::from(u8::from(flag));
        let source = match layer.lifting {
            None => SOURCE,
            Some(Lifting { of_fields: false, .. }) => LIFTING,
            Some(Lifting { of_fields: true, .. }) => LIFTING_OF_FIELDS,
        };
        let mut constants = vec![
            ("GELU", flag(epilogue.gelu)),
            ("ROWS", flag(epilogue.rows)),
            ("POOL", flag(epilogue.pool)),
            ("FIELD", flag(epilogue.field)),
            ("STAGED", flag(tuning.staged)),
            ("WIDE", group.wide as f64),
            ("SPAN", group.span as f64),
            ("LINES", group.lines as f64),
            ("DEEP", group.deep as f64),
            ("CHUNK", group.chunk as f64),
            ("MEMORY", group.memory as f64),
        ];
        if let Some(Lifting { inputs, of_fields, .. }) = layer.lifting {
            let why = "a lifting that embeds its input or is not staged has five input channels";
            assert!((tuning.staged && !of_fields) || inputs == features::CHANNELS, "{why}");
        }
        if layer.lifting.is_some_and(|lifting| lifting.of_fields) {
            constants
                .extend([("EMBEDDED", group.embedded_quads as f64), ("STAGED_QUADS", group.staged as f64)]);
        }
        let uniforms = layer.uniform_quads(context, tuning, epilogue);
        let texels = tuning.texels;
        let unroll = Unroll {
            span: group.lines * group.span,
            second: 2,
            uniforms,
            texels,
            ..tuning.unroll(tuning.channels)
        };
        let kernel = Kernel::new(context, &source, unroll, &constants)?;
        let nothing = || Tensor::zeros(context, "nothing", &[1]);
        let nothing = [nothing()?, nothing()?];
        Ok(Self { kernel, tile: tuning.channels, group, layer, epilogue, nothing })
    }

    /// Returns what the layer does in addition to the linear part.
    pub fn epilogue(&self) -> Epilogue {
        self.epilogue
    }

    /// Returns the number of parts in which the field is computed.
    pub fn field_parts(&self) -> usize {
        self.layer.channels / (self.tile * self.group.deep)
    }

    /// Applies the layer to `tensors`. `weight` has shape [C / tile, inputs, tile]; `bias` has shape `[C]`,
    /// or [2 C + 4] if it includes the field head (see [`with_head`]). `tables` holds [2 modes_w, W'] for a
    /// block, followed by the row transform's table [W' / 4, 2 modes_w, 4] if the rows are transformed.
    /// `width` is the number of columns of the grid.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        Layer { weight, bias }: &Layer,
        (tables, width): (&Tensor, usize),
        tensors: BlockTensors<'_>,
    ) {
        let BlockTensors { x, r, y, rows_or_field, rows_max } = tensors;
        let (epilogue, LayerSize { row_quads, channels, lifting, .. }) = (self.epilogue, self.layer);
        let columns = 2 * self.layer.modes_w;
        let &[samples, h, _, w] = y.shape() else { panic!("block: {:?}", y.shape()) };
        assert_eq!((w / 4, padded(width)), (row_quads, w));
        let (inputs, embedded) = lifting.map_or((channels, 0), |lifting| (lifting.hidden, lifting.inputs));
        match lifting {
            Some(_) => assert_eq!(r.shape(), [inputs, padded(embedded + 1)]),
            None => assert_eq!(r.shape(), [samples, h, columns, channels]),
        }
        let of_fields = lifting.is_some_and(|lifting| lifting.of_fields);
        let (bound, all_samples, place) = match x {
            Inputs::Stored(x) => {
                let from = if lifting.is_some() { embedded } else { channels };
                assert_eq!((x.shape(), of_fields), (&[samples, h, from, w][..], false));
                (vec![x.clone()], 0, Place::zeroed())
            }
            Inputs::Fields(fields) => {
                assert!(of_fields, "the kernel was built for another kind of input");
                let (bound, place) = fields.bound(Grid { h, w: width }, samples);
                (bound.to_vec(), fields.sums.shape()[0], place)
            }
        };
        assert!(tables.len() >= 4 * self.layer.table_quads(epilogue.rows));
        assert_eq!(y.shape(), [samples, h, channels, w]);
        assert_eq!(weight.shape(), [channels / self.tile, inputs, self.tile]);
        assert_eq!(bias.len(), if epilogue.field { 2 * channels + 4 } else { channels });
        assert_eq!(
            (rows_or_field.is_some(), rows_max.is_some()),
            (epilogue.rows || epilogue.field, epilogue.pool)
        );
        let wanted = if epilogue.field {
            [self.field_parts(), samples, h, w]
        } else {
            [samples, h, columns, channels]
        };
        assert!(rows_or_field.is_none_or(|rows_or_field| rows_or_field.shape() == wanted));
        assert!(rows_max.is_none_or(|most| most.shape() == [samples, h, channels]));
        let params = Params {
            inputs: size(inputs),
            channels: size(channels),
            rows: size(h),
            row_quads: size(row_quads),
            columns: size(columns),
            width: size(width),
            samples: size(samples),
            embedded: size(embedded),
            all_samples: size(all_samples),
            place,
        };
        let Group { wide, span, lines, deep, .. } = self.group;
        let tiles = samples * channels / self.tile;
        let count = [row_quads.div_ceil(span * wide), h.div_ceil(lines), tiles / deep].map(size);
        let [no_rows_or_field, no_maxima] = &self.nothing;
        let (rows_or_field, rows_max) =
            (rows_or_field.unwrap_or(no_rows_or_field), rows_max.unwrap_or(no_maxima));
        let mut tensors = vec![weight, bias, tables, r];
        tensors.extend(&bound);
        tensors.extend([y, rows_or_field]);
        if lifting.is_none() {
            tensors.push(rows_max);
        }
        schedule.dispatch(&self.kernel, &params, &tensors, count);
    }
}

/// The input of a layer.
#[derive(Clone, Copy, Debug)]
pub enum Inputs<'a> {
    /// A tensor of shape [S, H, C, W'], or [S, H, E, W'] for a lifting.
    Stored(&'a Tensor),
    /// The fields that a lifting embeds itself.
    Fields(FeatureInputs<'a>),
}

/// Inputs and outputs of a layer.
#[derive(Clone, Copy, Debug)]
pub struct BlockTensors<'a> {
    /// Input.
    pub x: Inputs<'a>,
    /// Inverse columns of the spectral product, shape [S, H, 2 modes_w, C]; for the lifting, its first layer
    /// (see [`hidden_units`]).
    pub r: &'a Tensor,
    /// Output, shape [S, H, C, W']; not written if the field is computed.
    pub y: &'a Tensor,
    /// Row spectra of the output, shape [S, H, 2 modes_w, C], or the field in parts, [parts, S, H, W']. Given
    /// if and only if either is computed.
    pub rows_or_field: Option<&'a Tensor>,
    /// Largest value of each output row, shape [S, H, C]. Given if and only if these are computed.
    pub rows_max: Option<&'a Tensor>,
}

/// Appends a head of one output to a bias, as [`Epilogue::field`] requires.
pub fn with_head(bias: &[f32], head: (&[f32], f32)) -> Vec<f32> {
    let (weight, head_bias) = head;
    assert_eq!(weight.len(), bias.len());
    [bias, weight, &[head_bias, 0.0, 0.0, 0.0]].concat()
}

/// Returns a first layer, weight [outputs, inputs] and bias, in the order in which the lifting reads it:
/// [outputs, inputs + 1 rounded up to quads], with each bias after its weights.
pub fn hidden_units(weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let inputs = weight.len() / bias.len();
    let mut units = vec![0.0; bias.len() * padded(inputs + 1)];
    let rows = units.chunks_exact_mut(padded(inputs + 1)).zip(weight.chunks_exact(inputs));
    for ((unit, weight), &bias) in rows.zip(bias) {
        unit[..inputs].copy_from_slice(weight);
        unit[inputs] = bias;
    }
    units
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::AdapterKind;

    /// A lifting that embeds its input itself has the same workgroups as one that does not, and rows fit up
    /// to the length given in the README.
    #[test]
    fn workgroups_hold_what_a_lifting_embeds() {
        let tuning = Tuning::of(AdapterKind::Hardware, Sharing::Loads);
        for (kib, columns) in [(16, 60), (32, 124)] {
            let limits = wgpu::Limits {
                max_compute_workgroup_storage_size: kib << 10,
                max_compute_invocations_per_workgroup: WORKGROUP_INVOCATIONS,
                max_compute_workgroup_size_x: WORKGROUP_INVOCATIONS,
                ..Default::default()
            };
            for row_quads in 2..=256 {
                let size = |of_fields| {
                    let lifting = Lifting { hidden: 256, inputs: features::CHANNELS, of_fields };
                    LayerSize { row_quads, modes_w: 5, channels: 64, lifting: Some(lifting) }
                };
                let [embedded, of_fields] = [false, true].map(size);
                let block = LayerSize { row_quads, modes_w: 5, channels: 64, lifting: None };
                let rows = Epilogue { rows: true, pool: true, ..Epilogue::default() };
                if let Some(group) = Group::new(&limits, &tuning, &block, rows) {
                    let one = Tuning { block_lines: 1, ..tuning };
                    assert_eq!(
                        group.deep,
                        Group::new(&limits, &one, &block, rows).unwrap().deep,
                        "{row_quads}"
                    );
                    assert!(group.lines == 2 || row_quads > 16, "{row_quads} quads, {kib} KiB: {group:?}");
                }
                assert_eq!(
                    Block::rows_fit(&limits, &tuning, &of_fields),
                    4 * row_quads <= columns,
                    "{row_quads}"
                );
                for layer in [&embedded, &of_fields] {
                    let group = Group::new(&limits, &tuning, layer, Epilogue::default()).unwrap();
                    assert_eq!(group.deep, 8, "{row_quads} quads, {kib} KiB");
                }
            }
        }
    }
}
