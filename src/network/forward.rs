//! The forward pass of the network as dispatches.

use super::parameters::Layers;
use super::{Config, Parameters, Weights, tables};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::operator::{
    Activate, Block, BlockTensors, InverseColumns, Pointwise, PoolRows, Project, ScalarHead, Spectral,
    TransformColumns, TransformRows, pointwise,
};
use crate::kernels::{Tuning, padded};
use crate::sim::Grid;
use crate::{Error, Result};

/// The network on a device, for `samples` samples of one grid: [`Forward::embedded`] in, [`Forward::field`] and
/// [`Forward::scalar`] out.
///
/// Inside, rows are padded to quads of columns ([`padded`]); the padding holds finite numbers that nothing reads.
#[derive(Debug)]
pub struct Forward {
    pub(super) config: Config,
    pub(super) grid: Grid,
    /// Input channels, shape [S, 5, H, W']: the normalised fields, then `i / (H-1)` and `j / (W-1)`; zero in the padding.
    pub embedded: Tensor,
    /// Output of the field head, shape [S, H, W'].
    pub field: Tensor,
    /// Output of the scalar head, shape `[S]`.
    pub scalar: Tensor,
    pub(super) hidden: Tensor,
    keep: Keep,
    /// Whether the first layer of the projection changes nothing ([`Weights::folded`]) and is left out.
    folded: bool,
    activations: Vec<Tensor>,
    /// What is before the GELU of each block but the last, shape [S, C, H, W'], and of the projection's hidden layer; only
    /// with [`Keep::Adjoint`].
    pub(super) before_gelu: Vec<Tensor>,
    /// Hidden layer of the projection, shape [S, projection, H, W'].
    pub(super) projected: Tensor,
    pub(super) spectral: SpectralTensors,
    pub(super) rows_max: Tensor,
    pub(super) layers: Layers,
    pub(super) kernels: Kernels,
}

#[derive(Debug)]
pub(super) struct SpectralTensors {
    pub rows: Tensor,
    /// Kept modes of each block, or one for all in turn.
    spectra: Vec<Tensor>,
    pub product: Tensor,
    pub inverse: Tensor,
    forward_rows: Tensor,
    pub forward_columns: Tensor,
    pub inverse_columns: Tensor,
    inverse_rows: Tensor,
}

impl SpectralTensors {
    /// Modes of the input of a block, shape [S, modes_h, modes_w, C, 2].
    pub fn spectrum(&self, block: usize) -> &Tensor {
        &self.spectra[block % self.spectra.len()]
    }
}

#[derive(Debug)]
pub(super) struct Kernels {
    pub dense: Pointwise,
    dense_gelu: Pointwise,
    pub transform_rows: TransformRows,
    pub transform_columns: TransformColumns,
    pub spectral: Spectral,
    pub inverse_columns: InverseColumns,
    pub block: Block,
    block_gelu: Block,
    activate: Activate,
    pool_rows: PoolRows,
    scalar_head: ScalarHead,
    project: Project,
}

/// What is kept of the activations between the layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Two buffers in turn.
    Nothing,
    /// Every block's output, for checks.
    Blocks,
    /// Every block's output, what is before its GELU, and its modes: for the backward pass ([`super::Backward`]).
    Adjoint,
}

impl Forward {
    /// Uploads the weights and makes what a pass over `samples` samples needs.
    pub fn new(
        context: &Context,
        weights: &Weights,
        tuning: &Tuning,
        shape: (Grid, usize),
        keep: Keep,
    ) -> Result<Self> {
        let parameters = Parameters::new(context, weights, tuning)?;
        let mut forward = Self::with_parameters(context, &parameters, tuning, shape, keep)?;
        forward.folded = keep == Keep::Nothing && weights.is_folded();
        Ok(forward)
    }

    /// The same on weights that are on the device already, and may change there.
    pub fn with_parameters(
        context: &Context,
        parameters: &Parameters,
        tuning: &Tuning,
        shape: (Grid, usize),
        keep: Keep,
    ) -> Result<Self> {
        let (grid, samples) = shape;
        let config = parameters.layout().padded();
        check_modes(&config, grid)?;
        let (h, w) = (grid.h, padded(grid.w));
        let plane = h * w;
        let lifted_at_once = (tuning.hidden_bytes / (4 * config.lifting * plane)).clamp(1, samples.max(1));
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let activation = |label| zeros(label, &[samples, config.channels, h, w]);
        let count = match keep {
            Keep::Nothing => 2,
            // The lifting and the blocks.
            Keep::Blocks | Keep::Adjoint => config.layers + 1,
        };
        let activations: Vec<Tensor> = (0..count).map(|_| activation("activation")).collect::<Result<_>>()?;
        let projected = if keep == Keep::Nothing && config.projection == config.channels {
            // The input of the last block is not needed any more.
            activations[(config.layers + 1) % count].clone()
        } else {
            zeros("projected", &[samples, config.projection, h, w])?
        };
        let mut before_gelu = Vec::new();
        if keep == Keep::Adjoint {
            for _ in 1..config.layers {
                before_gelu.push(activation("before GELU")?);
            }
            before_gelu.push(zeros("before GELU", &[samples, config.projection, h, w])?);
        }
        let spectra = if keep == Keep::Adjoint { config.layers } else { 1 };
        let columns = 2 * config.modes_w;
        let spectrum = [samples, config.modes_h, config.modes_w, config.channels, 2];
        let upload =
            |label, shape: &[usize], data: Vec<f32>| Tensor::from_slice(context, label, shape, &data);
        Ok(Self {
            config,
            grid,
            embedded: zeros("embedded", &[samples, config.inputs(), h, w])?,
            field: zeros("field", &[samples, h, w])?,
            scalar: zeros("scalar", &[samples])?,
            hidden: zeros("hidden", &[lifted_at_once, config.lifting, h, w])?,
            keep,
            folded: false,
            activations,
            before_gelu,
            projected,
            spectral: SpectralTensors {
                rows: zeros("rows", &[samples, h, columns, config.channels])?,
                spectra: (0..spectra).map(|_| zeros("spectrum", &spectrum)).collect::<Result<_>>()?,
                product: zeros("product", &spectrum)?,
                inverse: zeros("inverse", &[samples, h, columns, config.channels])?,
                forward_rows: upload(
                    "forward_rows",
                    &[w / 4, columns, 4],
                    tables::forward_rows(&config, h, grid.w),
                )?,
                forward_columns: upload(
                    "forward_columns",
                    &[h, config.modes_h, 2],
                    tables::columns(&config, h, false),
                )?,
                inverse_columns: upload(
                    "inverse_columns",
                    &[h, config.modes_h, 2],
                    tables::columns(&config, h, true),
                )?,
                inverse_rows: upload("inverse_rows", &[columns, w], tables::inverse_rows(&config, grid.w))?,
            },
            rows_max: zeros("rows_max", &[samples, h, config.channels])?,
            layers: parameters.layout().layers(&parameters.flat),
            kernels: Kernels::new(context, &config, tuning, w / 4)?,
        })
    }

    /// Appends a pass: from `embedded` to `field` and `scalar`.
    pub fn push(&self, schedule: &mut Schedule) {
        let k = &self.kernels;
        let slot = |i: usize| &self.activations[i % self.activations.len()];
        self.push_lifting(schedule);
        for block in 0..self.config.layers {
            let (x, y) = (slot(block), slot(block + 1));
            let s = &self.spectral;
            let spectrum = s.spectrum(block);
            k.transform_rows.push(schedule, &s.forward_rows, x, &s.rows);
            k.transform_columns.push(schedule, &s.forward_columns, &s.rows, spectrum);
            k.spectral.push(schedule, &self.layers.products[block], spectrum, &s.product);
            k.inverse_columns.push(schedule, &s.inverse_columns, &s.product, &s.inverse);
            let last = block + 1 == self.config.layers;
            let gelu = if last { self.folded } else { self.keep != Keep::Adjoint };
            let kernel = if gelu { &k.block_gelu } else { &k.block };
            let before = self.before_gelu.get(block).filter(|_| !last);
            let tensors = BlockTensors { x, r: &s.inverse, y: before.unwrap_or(y) };
            kernel.push(schedule, &self.layers.skips[block], &s.inverse_rows, tensors);
            if let Some(before) = before {
                k.activate.push(schedule, before, y);
            }
            if block == self.config.scalar_block() {
                k.pool_rows.push(schedule, self.grid.w, y, &self.rows_max);
                k.scalar_head.push(schedule, &self.layers.scalar, &self.rows_max, &self.scalar);
            }
        }
        let [inner, outer] = &self.layers.projection;
        let y = slot(self.config.layers);
        if self.folded {
            k.project.push(schedule, outer, y, &self.field);
            return;
        }
        match self.before_gelu.last() {
            Some(before) => {
                k.dense.push(schedule, inner, y, before);
                k.activate.push(schedule, before, &self.projected);
            }
            None => k.dense_gelu.push(schedule, inner, y, &self.projected),
        }
        k.project.push(schedule, outer, &self.projected, &self.field);
    }

    /// Output of the lifting (0) or of block `i - 1`, shape [S, C, H, W']; only where blocks are kept.
    pub fn activation(&self, i: usize) -> &Tensor {
        assert_ne!(self.keep, Keep::Nothing, "the activations were not kept");
        &self.activations[i]
    }

    fn push_lifting(&self, schedule: &mut Schedule) {
        let (samples, at_once) = (self.embedded.shape()[0], self.hidden.shape()[0]);
        let (k, lifted) = (&self.kernels, &self.activations[0]);
        for first in (0..samples).step_by(at_once) {
            let count = at_once.min(samples - first);
            let [inner, outer] = &self.layers.lifting;
            let into = pointwise::Samples { count, x_first: first, y_first: 0 };
            k.dense_gelu.push_part(schedule, inner, (&self.embedded, &self.hidden), into);
            let from = pointwise::Samples { count, x_first: 0, y_first: first };
            k.dense.push_part(schedule, outer, (&self.hidden, lifted), from);
        }
    }
}

impl Kernels {
    fn new(context: &Context, config: &Config, tuning: &Tuning, row_quads: usize) -> Result<Self> {
        Ok(Self {
            dense: Pointwise::new(context, tuning, false)?,
            dense_gelu: Pointwise::new(context, tuning, true)?,
            transform_rows: TransformRows::new(context, tuning, config.modes_w)?,
            transform_columns: TransformColumns::new(context, tuning, config.modes_h)?,
            spectral: Spectral::new(context, tuning)?,
            inverse_columns: InverseColumns::new(context, tuning, config.modes_h)?,
            block: Block::new(context, tuning, row_quads, false)?,
            block_gelu: Block::new(context, tuning, row_quads, true)?,
            activate: Activate::new(context)?,
            pool_rows: PoolRows::new(context)?,
            scalar_head: ScalarHead::new(context)?,
            project: Project::new(context)?,
        })
    }
}

fn check_modes(config: &Config, grid: Grid) -> Result<()> {
    if grid.h < config.modes_h || grid.w / 2 + 1 < config.modes_w {
        let expected = format!("at least {}x{}", config.modes_h, 2 * config.modes_w - 2);
        return Err(Error::invalid("checkpoint", "grid that carries its Fourier modes", expected, grid));
    }
    Ok(())
}
