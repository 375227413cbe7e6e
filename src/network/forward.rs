//! The forward pass of the network as dispatches.

use super::fused::Fused;
use super::parameters::Layers;
use super::plan::{block_size, epilogue, spectral_size};
use super::{Config, Keep, Layout, Parameters, Plan, Weights, tables};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Storage, Tensor, Tuning};
use crate::kernels::operator::{
    Activate, Block, BlockTensors, Epilogue, Inputs, JoinedLayer, Layer, LayerSize, Lifting, Pointwise,
    PoolRows, Project, ScalarHead, Scales, Spectral, SpectralTensors, TransformRows, pointwise::Lines,
};
use crate::kernels::optim::{FeatureInputs, Features};
use crate::kernels::padded;

/// The network on a device, for samples on one grid. Its input is [`Forward::embedded`], or the fields from
/// which that is built; its outputs are [`Forward::field`] and [`Forward::scalar`].
///
/// Rows are padded to quads of columns ([`padded`]). The padding does not affect any result, but must be
/// finite. Activations have shape [S, H, C, W'], with the channels of a row next to each other: a layer reads
/// all channels of a few rows, which is then one contiguous block. With one plane per channel, planes of 4
/// KiB would evict each other from the cache, and larger ones would be pages apart.
#[derive(Debug)]
pub struct Forward {
    pub(super) config: Config,
    pub(super) grid: Grid,
    /// Input channels, shape [S, H, 5, W']: the normalised fields, then `i / (H-1)` and `j / (W-1)`; zero in
    /// the padding. A pass from fields writes them only if the lifting does not embed the fields itself.
    pub embedded: Tensor,
    /// Output of the field head in parts to be summed, shape [parts, S, H, W']; a single part unless
    /// [`Plan::keep`] is [`Keep::Nothing`].
    pub field: Tensor,
    /// Output of the scalar head, shape `[S]`; not written with [`Head::Deferred`].
    pub scalar: Tensor,
    /// Hidden layer of the lifting, shape [lines, lifting, W'], for the lines that are lifted at once. A line
    /// is a row of a sample.
    pub(super) hidden: Tensor,
    keep: Keep,
    /// The last block's layer, with the field head appended to its bias, if one kernel computes both.
    head: Option<Layer>,
    /// Both layers of the lifting, if one kernel computes them.
    lifting: Option<Lifted>,
    /// What each block computes besides the linear part of its output.
    epilogues: Vec<Epilogue>,
    pub(super) activations: Activations,
    pub(super) spectral: Spectra,
    pub(super) rows_max: Tensor,
    pub(super) layers: Layers,
    pub(super) kernels: Kernels,
}

/// Both layers of the lifting in one dispatch.
#[derive(Debug)]
struct Lifted {
    of_embedded: Block,
    of_fields: Block,
    /// The first layer; see [`block::hidden_units`].
    units: Tensor,
}

/// How a pass treats the scalar head.
#[derive(Clone, Copy, Debug)]
pub enum Head<'a> {
    /// Writes it to [`Forward::scalar`].
    Store,
    /// Writes it to [`Forward::scalar`] and updates the persistent scales of the samples.
    StoreAndRescale(Scales<'a>),
    /// Leaves it to the update kernel, which computes it from the row maxima ([`Forward::pooled`]).
    Deferred,
}

/// Activations between layers. A block reads the output of the layer before it and writes another tensor; only
/// two of them take turns unless the plan keeps them all.
#[derive(Debug)]
pub(super) struct Activations {
    /// Output of the lifting and of the blocks, shape [S, H, C, W'] each.
    of_layers: Vec<Tensor>,
    /// Pre-activations of each block but the last, shape [S, H, C, W'], and of the projection's hidden layer;
    /// only with [`Keep::Adjoint`].
    pub before_gelu: Vec<Tensor>,
    /// Hidden layer of the projection, shape [S, H, projection, W'].
    pub projected: Tensor,
}

impl Activations {
    fn new(context: &Context, config: &Config, plan: &Plan, in_texels: bool) -> Result<Self> {
        let &Plan { grid, samples, keep, .. } = plan;
        let (h, w) = (grid.h, padded(grid.w));
        let shape = [samples, h, config.channels, w];
        let stored = |label, shape: &[usize]| Tensor::stored_zeros(context, label, shape);
        let activation = |label| match in_texels {
            true => Ok(Tensor::texels(context, label, &shape)),
            false => stored(label, &shape),
        };
        let count = match keep {
            Keep::Nothing => 2,
            // One for the lifting, and one for each block.
            Keep::Blocks | Keep::Adjoint => config.layers + 1,
        };
        let of_layers: Vec<Tensor> = (0..count).map(|_| activation("activation")).collect::<Result<_>>()?;
        let projected = if keep == Keep::Nothing && config.projection == config.channels {
            // The input of the last block is no longer needed.
            of_layers[(config.layers + 1) % count].clone()
        } else {
            stored("projected", &[samples, h, config.projection, w])?
        };
        let mut before_gelu = Vec::new();
        if keep == Keep::Adjoint {
            for _ in 1..config.layers {
                before_gelu.push(activation("pre-activations")?);
            }
            before_gelu.push(Tensor::zeros(context, "pre-activations", &[samples, h, config.projection, w])?);
        }
        Ok(Self { of_layers, before_gelu, projected })
    }

    /// Returns the output of the lifting (0) or of block `i - 1`, as long as no later layer has replaced it.
    fn of_layer(&self, i: usize) -> &Tensor {
        &self.of_layers[i % self.of_layers.len()]
    }
}

#[derive(Debug)]
pub(super) struct Spectra {
    pub rows: Tensor,
    /// Kept modes of the input of each block, shape [S, modes_h, modes_w, C, 2]; only with [`Keep::Adjoint`].
    pub modes: Vec<Tensor>,
    pub inverse: Tensor,
    forward_rows: Tensor,
    columns: Tensor,
    /// Table of the inverse row transform, followed by that of the forward one if blocks transform their
    /// rows.
    block_rows: Tensor,
}

impl Spectra {
    fn new(context: &Context, config: &Config, plan: &Plan, rows_in_blocks: bool) -> Result<Self> {
        let &Plan { grid, samples, ref tuning, keep } = plan;
        let (h, w, columns) = (grid.h, padded(grid.w), 2 * config.modes_w);
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let upload =
            |label, shape: &[usize], data: Vec<f32>| Tensor::from_slice(context, label, shape, &data);
        let kept = if keep == Keep::Adjoint { config.layers } else { 0 };
        let spectrum = [samples, config.modes_h, config.modes_w, config.channels, 2];
        let mut block_rows = tables::inverse_rows(config, grid.w);
        if rows_in_blocks {
            block_rows.extend(tables::forward_rows(config, h, grid.w));
        }
        let waves = upload("columns", &[h, config.modes_h / 2 + 1, 2], tables::columns(config, h))?;
        Ok(Self {
            rows: zeros("rows", &[samples, h, columns, config.channels])?,
            modes: (0..kept).map(|_| zeros("spectrum", &spectrum)).collect::<Result<_>>()?,
            inverse: zeros("inverse", &[samples, h, columns, config.channels])?,
            forward_rows: upload(
                "forward_rows",
                &[w / 4, columns, 4],
                tables::forward_rows(config, h, grid.w),
            )?,
            columns: if tuning.texels { waves.to_texels(context) } else { waves },
            block_rows: upload("block_rows", &[block_rows.len() / (columns * w), columns, w], block_rows)?,
        })
    }

    /// Returns the tensors of the spectral convolution from `rows` to `inverse`.
    pub fn columns<'a>(&'a self, spectrum: Option<&'a Tensor>) -> SpectralTensors<'a> {
        let Self { columns: table, rows: r, inverse, .. } = self;
        SpectralTensors { table, r, inverse, spectrum }
    }
}

#[derive(Debug)]
pub(super) struct Kernels {
    pub dense: Pointwise,
    dense_gelu: Pointwise,
    pub transform_rows: TransformRows,
    pub spectral: Spectral,
    /// One for each distinct epilogue in the network.
    blocks: Vec<Block>,
    features: Features,
    activate: Activate,
    pool_rows: PoolRows,
    scalar_head: ScalarHead,
    project: Project,
}

impl Forward {
    /// Uploads the weights and builds what a pass needs.
    pub fn new(context: &Context, weights: &Weights, plan: &Plan) -> Result<Self> {
        // The backward pass uses single precision.
        let storage = if plan.keep == Keep::Adjoint { Storage::F32 } else { context.storage() };
        let context = &context.with_storage(storage)?;
        let layout = plan.layout(context, weights.config);
        let mut layers = layout.stored_layers(context, weights)?;
        // The backward pass puts weights of its own in their place.
        let texels = plan.tuning.texels && plan.keep != Keep::Adjoint;
        let texels = texels && layers.products.iter().all(|w| Tensor::fits_texels(context, w.len()));
        if texels {
            // In single precision the vector of all weights still holds them, too.
            layers.products = layers.products.iter().map(|weight| weight.to_texels(context)).collect();
        }
        let plan = &Plan { tuning: Tuning { texels, ..plan.tuning }, ..*plan };
        let fused = Fused::new(context, weights, (layout.padded(), &layers), plan)?;
        Self::build(context, &layout, layers, fused, plan)
    }

    /// Builds the network on weights that are already on the device and may change there. It uses single
    /// precision, whatever the context's storage.
    pub fn with_parameters(context: &Context, parameters: &Parameters, plan: &Plan) -> Result<Self> {
        let context = &context.with_storage(Storage::F32)?;
        let layout = parameters.layout();
        let plan = &Plan { tuning: Tuning { texels: false, ..plan.tuning }, ..*plan };
        Self::build(context, layout, layout.layers(&parameters.flat)?, Fused::default(), plan)
    }

    fn build(context: &Context, layout: &Layout, layers: Layers, fused: Fused, plan: &Plan) -> Result<Self> {
        let config = layout.padded();
        let plan = &Plan { tuning: Tuning { channels: layout.tile(), ..plan.tuning }, ..*plan };
        let &Plan { grid, samples, ref tuning, keep } = plan;
        config.check_grid(grid, "network", "grid")?;
        let (h, w) = (grid.h, padded(grid.w));
        let lifted_at_once = match fused.units {
            // Fused layers need no buffer between them.
            Some(_) => 0,
            None => tuning.most_samples(context, config.lifting * w).clamp(1, (samples * h).max(1)),
        };
        // For the backward pass a block outputs its pre-activations, but its rows are transformed after the
        // GELU.
        let size = block_size(&config, grid);
        let rows_in_blocks = keep != Keep::Adjoint && Block::takes_rows(context, tuning, &size);
        let Fused { head, units } = fused;
        let fuses_field_head = head.is_some();
        let of_lifting = |of_fields| {
            let lifting = Lifting { hidden: config.lifting, inputs: config.inputs(), of_fields };
            LayerSize { lifting: Some(lifting), ..size }
        };
        let lifting_takes_rows = rows_in_blocks && Block::takes_rows(context, tuning, &of_lifting(true));
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let stored = |label, shape: &[usize]| Tensor::stored_zeros(context, label, shape);
        let shape = [samples, h, config.channels, w];
        // If only blocks and a lifting in one dispatch read and write them.
        let in_texels = tuning.texels
            && keep == Keep::Nothing
            && fuses_field_head
            && units.is_some()
            && lifting_takes_rows
            && Tensor::fits_texels(context, shape.iter().product());
        let epilogues: Vec<Epilogue> = (0..config.layers)
            .map(|block| epilogue(&config, block, keep, fuses_field_head, rows_in_blocks))
            .collect();
        let of_blocks = &Tuning { texels: in_texels, block_lines: plan.block_lines(), ..*tuning };
        let lifting = |of_fields| {
            let epilogue = Epilogue { rows: lifting_takes_rows, ..Epilogue::default() };
            Block::new(context, of_blocks, of_lifting(of_fields), epilogue)
        };
        let lifted = |units| -> Result<_> {
            Ok(Lifted { of_embedded: lifting(false)?, of_fields: lifting(true)?, units })
        };
        let kernels = Kernels::new(context, &config, (size, of_blocks), &epilogues, plan)?;
        let parts =
            if fuses_field_head { kernels.block(epilogues[config.layers - 1]).field_parts() } else { 1 };
        Ok(Self {
            config,
            grid,
            embedded: stored("embedded", &[samples, h, config.inputs(), w])?,
            field: zeros("field", &[parts, samples, h, w])?,
            scalar: zeros("scalar", &[samples])?,
            hidden: stored("hidden", &[lifted_at_once, config.lifting, w])?,
            keep,
            head,
            lifting: units.map(lifted).transpose()?,
            activations: Activations::new(context, &config, plan, in_texels)?,
            spectral: Spectra::new(context, &config, plan, rows_in_blocks)?,
            rows_max: zeros("rows_max", &[samples, h, config.channels])?,
            layers,
            kernels,
            epilogues,
        })
    }

    /// Appends a pass over all samples; see [`Forward::push_first`].
    pub fn push(&self, schedule: &mut Schedule, from: Option<FeatureInputs<'_>>, head: Head<'_>) {
        self.push_first(schedule, self.samples(), from, head);
    }

    /// Returns the number of samples (S).
    pub fn samples(&self) -> usize {
        self.embedded.shape()[0]
    }

    /// Returns the field head's output for the first `samples` samples, shape [parts, samples, H, W'].
    pub fn first_field(&self, samples: usize) -> Tensor {
        let &[parts, _, h, w] = self.field.shape() else { unreachable!("the field has four axes") };
        self.field.view(0, &[parts, samples, h, w])
    }

    /// Returns the scalar head's layer, and the row maxima of the first `samples` samples after a pass, shape
    /// [samples, H, C].
    pub fn pooled(&self, samples: usize) -> (&JoinedLayer, Tensor) {
        (&self.layers.scalar, self.rows_max.first(samples))
    }

    /// Appends a pass over the first `samples` samples, which must be a multiple of three if
    /// [`Forward::samples`] is. The input is built from the fields `from`, or read from [`Forward::embedded`]
    /// if that is `None`. The outputs are [`Forward::field`] and, as requested by `head`, the scalar head.
    pub fn push_first(
        &self,
        schedule: &mut Schedule,
        samples: usize,
        from: Option<FeatureInputs<'_>>,
        head: Head<'_>,
    ) {
        let mut has_rows = self.push_lifting(schedule, samples, from);
        for block in 0..self.config.layers {
            has_rows = self.push_block(schedule, samples, (block, has_rows));
            if block == self.config.scalar_block() {
                self.push_scalar_head(schedule, samples, (block, head));
            }
        }
        // The last block's epilogue may have been the field head.
        if self.head.is_none() {
            self.push_field_head(schedule, samples);
        }
    }

    /// Appends a block, after the row transform of its input unless the layer before has done that. Returns
    /// whether it transforms the rows of its output.
    fn push_block(&self, schedule: &mut Schedule, samples: usize, (block, has_rows): (usize, bool)) -> bool {
        let (k, s, epilogue) = (&self.kernels, &self.spectral, self.epilogues[block]);
        let first = |tensor: &Tensor| tensor.first(samples);
        let [x, y] = [block, block + 1].map(|i| first(self.activations.of_layer(i)));
        let [rows, inverse, rows_max] = [&s.rows, &s.inverse, &self.rows_max].map(first);
        if !has_rows {
            k.transform_rows.push(schedule, &s.forward_rows, &x, &rows);
        }
        let spectrum = s.modes.get(block).map(first);
        let columns = SpectralTensors { r: &rows, inverse: &inverse, ..s.columns(spectrum.as_ref()) };
        k.spectral.push(schedule, &self.layers.products[block], columns);
        let is_last = block + 1 == self.config.layers;
        let before = self.activations.before_gelu.get(block).filter(|_| !is_last).map(first);
        let field = self.first_field(samples);
        let tensors = BlockTensors {
            x: Inputs::Stored(&x),
            r: &inverse,
            y: before.as_ref().unwrap_or(&y),
            rows_or_field: if epilogue.field { Some(&field) } else { epilogue.rows.then_some(&rows) },
            rows_max: epilogue.pool.then_some(&rows_max),
        };
        let with_head = self.head.as_ref().filter(|_| epilogue.field);
        let layer = with_head.unwrap_or(&self.layers.skips[block]);
        k.block(epilogue).push(schedule, layer, (&s.block_rows, self.grid.w), tensors);
        if let Some(before) = &before {
            k.activate.push(schedule, before, &y);
        }
        epilogue.rows
    }

    /// Appends the scalar head on the output of `block`, unless it is left to the update.
    fn push_scalar_head(&self, schedule: &mut Schedule, samples: usize, (block, head): (usize, Head<'_>)) {
        let (k, rows_max) = (&self.kernels, self.rows_max.first(samples));
        if !self.epilogues[block].pool {
            let y = self.activations.of_layer(block + 1).first(samples);
            k.pool_rows.push(schedule, self.grid.w, &y, &rows_max);
        }
        let scales = match head {
            Head::Store => None,
            Head::StoreAndRescale(scales) => Some(scales),
            Head::Deferred => return,
        };
        let tensors = (&rows_max, &self.scalar.first(samples));
        k.scalar_head.push(schedule, &self.layers.scalar, tensors, scales);
    }

    /// Appends both layers of the field head on the output of the last block.
    fn push_field_head(&self, schedule: &mut Schedule, samples: usize) {
        let (k, [inner, outer]) = (&self.kernels, &self.layers.projection);
        let y = self.activations.of_layer(self.config.layers).first(samples);
        let projected = self.activations.projected.first(samples);
        match self.activations.before_gelu.last().map(|before| before.first(samples)) {
            Some(before) => {
                k.dense.push(schedule, inner, &y, &before);
                k.activate.push(schedule, &before, &projected);
            }
            None => k.dense_gelu.push(schedule, inner, &y, &projected),
        }
        k.project.push(schedule, outer, &projected, &self.first_field(samples));
    }

    /// Returns the output of the lifting (0) or of block `i - 1`, shape [S, H, C, W']. Panics unless the plan
    /// keeps the blocks.
    pub fn activation(&self, i: usize) -> &Tensor {
        assert_ne!(self.keep, Keep::Nothing, "the activations were not kept");
        self.activations.of_layer(i)
    }

    /// Splits the lines of the first `samples` samples into batches that are lifted at once. Each item maps a
    /// tensor of all lines into [`Forward::hidden`], and back.
    pub(super) fn lifted_at_once(&self, samples: usize) -> impl Iterator<Item = (Lines, Lines)> {
        let (all, at_once) = (samples * self.grid.h, self.hidden.shape()[0]);
        (0..all).step_by(at_once).map(move |first| {
            let count = at_once.min(all - first);
            (Lines { count, x_first: first, y_first: 0 }, Lines { count, x_first: 0, y_first: first })
        })
    }

    /// Appends the lifting. Returns whether it also transforms the rows of its output.
    fn push_lifting(&self, schedule: &mut Schedule, samples: usize, from: Option<FeatureInputs<'_>>) -> bool {
        let (k, lifted) = (&self.kernels, self.activations.of_layer(0));
        if let Some(Lifted { of_embedded, of_fields, units }) = &self.lifting {
            let [embedded, y, row_spectra] =
                [&self.embedded, lifted, &self.spectral.rows].map(|tensor| tensor.first(samples));
            let (kernel, x) = match from {
                Some(fields) => (of_fields, Inputs::Fields(fields)),
                None => (of_embedded, Inputs::Stored(&embedded)),
            };
            let rows = kernel.epilogue().rows;
            let tensors = BlockTensors {
                x,
                r: units,
                y: &y,
                rows_or_field: rows.then_some(&row_spectra),
                rows_max: None,
            };
            let tables = (&self.spectral.forward_rows, self.grid.w);
            kernel.push(schedule, &self.layers.lifting[1], tables, tensors);
            return rows;
        }
        if let Some(fields) = from {
            k.features.push(schedule, self.grid, fields, &self.embedded.first(samples));
        }
        let [inner, outer] = &self.layers.lifting;
        for (into, back) in self.lifted_at_once(samples) {
            k.dense_gelu.push_lines(schedule, inner, (&self.embedded, &self.hidden), into);
            k.dense.push_lines(schedule, outer, (&self.hidden, lifted), back);
        }
        false
    }
}

impl Kernels {
    fn new(
        context: &Context,
        config: &Config,
        (size, of_blocks): (LayerSize, &Tuning),
        epilogues: &[Epilogue],
        plan: &Plan,
    ) -> Result<Self> {
        let &Plan { samples, ref tuning, keep, .. } = plan;
        let mut blocks: Vec<Block> = Vec::new();
        for &epilogue in epilogues {
            if blocks.iter().all(|b| b.epilogue() != epilogue) {
                blocks.push(Block::new(context, of_blocks, size, epilogue)?);
            }
        }
        Ok(Self {
            dense: Pointwise::new(context, tuning, false)?,
            dense_gelu: Pointwise::new(context, tuning, true)?,
            transform_rows: TransformRows::new(context, tuning, config.modes_w)?,
            spectral: Spectral::new(context, tuning, &spectral_size(config), samples, keep == Keep::Adjoint)?,
            blocks,
            features: Features::new(context)?,
            activate: Activate::new(context)?,
            pool_rows: PoolRows::new(context)?,
            scalar_head: ScalarHead::new(context)?,
            project: Project::new(context)?,
        })
    }

    /// Returns the kernel of a block with this epilogue.
    pub fn block(&self, epilogue: Epilogue) -> &Block {
        let found = self.blocks.iter().find(|b| b.epilogue() == epilogue);
        found.expect("every kind of block of the network is built")
    }
}
