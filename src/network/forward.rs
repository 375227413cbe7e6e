//! The forward pass of the network as dispatches.

use super::{Config, Dense, Weights, tables};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::operator::{
    Block, BlockTensors, InverseColumns, Layer, Pointwise, PoolRows, Project, ScalarHead, Spectral,
    TransformColumns, TransformRows, pointwise, spectral,
};
use crate::kernels::{CHANNEL_MULTIPLE, Tuning, padded};
use crate::sim::Grid;
use crate::{Error, Result};

/// The network on a device, for `samples` samples of one grid: [`Forward::embedded`] in, [`Forward::field`] and
/// [`Forward::scalar`] out.
///
/// Inside, rows are padded to quads of columns ([`padded`]); the padding holds finite numbers that nothing reads.
#[derive(Debug)]
pub struct Forward {
    config: Config,
    grid: Grid,
    /// Input channels, shape [S, 5, H, W']: the normalised fields, then `i / (H-1)` and `j / (W-1)`; zero in the padding.
    pub embedded: Tensor,
    /// Output of the field head, shape [S, H, W'].
    pub field: Tensor,
    /// Output of the scalar head, shape `[S]`.
    pub scalar: Tensor,
    hidden: Tensor,
    keep: Keep,
    activations: Vec<Tensor>,
    /// Hidden layer of the projection, shape [S, projection, H, W'].
    projected: Tensor,
    spectral: SpectralTensors,
    rows_max: Tensor,
    layers: Layers,
    kernels: Kernels,
}

#[derive(Debug)]
struct SpectralTensors {
    rows: Tensor,
    spectrum: Tensor,
    product: Tensor,
    inverse: Tensor,
    forward_rows: Tensor,
    forward_columns: Tensor,
    inverse_columns: Tensor,
    inverse_rows: Tensor,
}

#[derive(Debug)]
struct Layers {
    lifting: [Layer; 2],
    skips: Vec<Layer>,
    products: Vec<Tensor>,
    projection: [Layer; 2],
    scalar: Layer,
}

#[derive(Debug)]
struct Kernels {
    dense: Pointwise,
    dense_gelu: Pointwise,
    transform_rows: TransformRows,
    transform_columns: TransformColumns,
    spectral: Spectral,
    inverse_columns: InverseColumns,
    block: Block,
    block_gelu: Block,
    pool_rows: PoolRows,
    scalar_head: ScalarHead,
    project: Project,
}

/// What is kept of the activations between the layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Two buffers in turn.
    Nothing,
    /// Every block's output, for checks and for the backward pass.
    Blocks,
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
        let (grid, samples) = shape;
        let weights = padded_channels(weights);
        let config = weights.config;
        check_modes(&config, grid)?;
        let (h, w) = (grid.h, padded(grid.w));
        let plane = h * w;
        let lifted_at_once = (tuning.hidden_bytes / (4 * config.lifting * plane)).clamp(1, samples.max(1));
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let activation = |label| zeros(label, &[samples, config.channels, h, w]);
        let count = match keep {
            Keep::Nothing => 2,
            // The lifting and the blocks.
            Keep::Blocks => config.layers + 1,
        };
        let activations: Vec<Tensor> = (0..count).map(|_| activation("activation")).collect::<Result<_>>()?;
        let projected = if keep == Keep::Nothing && config.projection == config.channels {
            // The input of the last block is not needed any more.
            activations[(config.layers + 1) % count].clone()
        } else {
            zeros("projected", &[samples, config.projection, h, w])?
        };
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
            activations,
            projected,
            spectral: SpectralTensors {
                rows: zeros("rows", &[samples, h, columns, config.channels])?,
                spectrum: zeros("spectrum", &spectrum)?,
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
            layers: Layers::new(context, &weights, tuning)?,
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
            k.transform_rows.push(schedule, &s.forward_rows, x, &s.rows);
            k.transform_columns.push(schedule, &s.forward_columns, &s.rows, &s.spectrum);
            k.spectral.push(schedule, &self.layers.products[block], &s.spectrum, &s.product);
            k.inverse_columns.push(schedule, &s.inverse_columns, &s.product, &s.inverse);
            let kernel = if block + 1 < self.config.layers { &k.block_gelu } else { &k.block };
            let tensors = BlockTensors { x, r: &s.inverse, y };
            kernel.push(schedule, &self.layers.skips[block], &s.inverse_rows, tensors);
            if block == self.config.scalar_block() {
                k.pool_rows.push(schedule, self.grid.w, y, &self.rows_max);
                k.scalar_head.push(schedule, &self.layers.scalar, &self.rows_max, &self.scalar);
            }
        }
        let [inner, outer] = &self.layers.projection;
        k.dense_gelu.push(schedule, inner, slot(self.config.layers), &self.projected);
        k.project.push(schedule, outer, &self.projected, &self.field);
    }

    /// Output of the lifting (0) or of block `i - 1`, shape [S, C, H, W']; only with [`Keep::Blocks`].
    pub fn activation(&self, i: usize) -> &Tensor {
        assert_eq!(self.keep, Keep::Blocks, "the activations were not kept");
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

impl Layers {
    fn new(context: &Context, weights: &Weights, tuning: &Tuning) -> Result<Self> {
        let (config, tile) = (&weights.config, tuning.channels);
        let dense = |label, weight: &[f32], bias: &[f32]| -> Result<Layer> {
            let (outputs, inputs) = (bias.len(), weight.len() / bias.len());
            let shape = [outputs / tile, inputs, tile];
            let tiled = pointwise::tiled(weight, inputs, tile);
            Ok(Layer {
                weight: Tensor::from_slice(context, label, &shape, &tiled)?,
                bias: Tensor::from_slice(context, label, &[outputs], bias)?,
            })
        };
        let head = |label, layer: &Dense| -> Result<Layer> {
            Ok(Layer {
                weight: Tensor::from_slice(context, label, &[layer.weight.len()], &layer.weight)?,
                bias: Tensor::from_slice(context, label, &[1], &layer.bias)?,
            })
        };
        let c = config.channels;
        let [l0, l1] = &weights.lifting;
        let [p0, p1] = &weights.projection;
        Ok(Self {
            lifting: [dense("lifting.0", &l0.weight, &l0.bias)?, dense("lifting.1", &l1.weight, &l1.bias)?],
            skips: weights.blocks.iter().map(|b| dense("skip", &b.skip, &b.bias)).collect::<Result<_>>()?,
            products: weights
                .blocks
                .iter()
                .map(|b| {
                    let ordered = spectral::by_mode(&b.spectral, c, c);
                    Tensor::from_slice(context, "spectral", &[config.modes(), c, c, 2], &ordered)
                })
                .collect::<Result<_>>()?,
            projection: [dense("projection.0", &p0.weight, &p0.bias)?, head("projection.1", p1)?],
            scalar: head("scalar", &weights.scalar)?,
        })
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

/// The same network with every channel count a multiple of [`CHANNEL_MULTIPLE`]: the new channels have weight 0.
fn padded_channels(weights: &Weights) -> Weights {
    let old = weights.config;
    let up = |n: usize| n.next_multiple_of(CHANNEL_MULTIPLE);
    let (l, c, p) = (up(old.lifting), up(old.channels), up(old.projection));
    if (l, c, p) == (old.lifting, old.channels, old.projection) {
        return weights.clone();
    }
    // `unit` numbers belong to each (row, column) of a matrix [rows, columns, unit].
    let matrix = |from: &[f32], columns: usize, to: [usize; 2], unit: usize| {
        let mut wide = vec![0.0; to[0] * to[1] * unit];
        for (row, line) in from.chunks_exact(columns * unit).enumerate() {
            wide[row * to[1] * unit..][..line.len()].copy_from_slice(line);
        }
        wide
    };
    let dense = |d: &Dense, to: [usize; 2]| Dense {
        weight: matrix(&d.weight, d.weight.len() / d.bias.len(), to, 1),
        bias: matrix(&d.bias, d.bias.len(), [1, to[0]], 1),
    };
    let modes = 2 * old.modes();
    Weights {
        config: Config { lifting: l, channels: c, projection: p, ..old },
        lifting: [dense(&weights.lifting[0], [l, old.inputs()]), dense(&weights.lifting[1], [c, l])],
        blocks: weights
            .blocks
            .iter()
            .map(|b| super::Block {
                spectral: matrix(&b.spectral, old.channels, [c, c], modes),
                bias: matrix(&b.bias, old.channels, [1, c], 1),
                skip: matrix(&b.skip, old.channels, [c, c], 1),
            })
            .collect(),
        projection: [dense(&weights.projection[0], [p, c]), dense(&weights.projection[1], [1, p])],
        scalar: dense(&weights.scalar, [1, c]),
    }
}
