//! The backward pass of the network as dispatches: from the cotangents of field and scalar to the gradient
//! with respect to all weights.
//!
//! The adjoint of a block runs the kernels of a block (rows, spectral convolution, inverse and skip) in
//! reverse order, with transposed tables and weights. The network's inputs are constants of training, so
//! nothing is propagated beyond the lifting, whose hidden layer is recomputed instead of kept.

use super::parameters::Layers;
use super::{Forward, Parameters, tables};
use crate::Result;
use crate::gpu::{Context, Schedule, Tensor, Tuning};
use crate::kernels::operator::{
    BlockTensors, Epilogue, GeluAdj, HeadWeightAdj, Inputs, JoinedLayer, Layer, Parts, PointwiseWeightAdj,
    PoolAdj, PoolAdjTensors, ProjectAdj, SpectralTranspose, SpectralWeightAdj, SumParts, Transpose,
    pointwise::Lines, pointwise_weight_adj,
};
use crate::kernels::padded;

/// The transposed weights, as the adjoint of each layer reads them.
#[derive(Debug)]
pub struct TransposedWeights {
    /// The original weights.
    layers: Layers,
    /// Skips of the blocks. Their biases are zero, as are those of `lifting` and `projection`.
    skips: Vec<Layer>,
    products: Vec<Tensor>,
    /// Second layer of the lifting.
    lifting: Layer,
    /// First layer of the projection.
    projection: Layer,
    transpose: Transpose,
    spectral_transpose: SpectralTranspose,
}

/// The backward pass for the samples of a [`Forward`] that keeps what it needs ([`super::Keep::Adjoint`]).
#[derive(Debug)]
pub struct Backward {
    /// Cotangent of [`Forward::field`], shape [S, H, W'], zero in the padding.
    pub adj_field: Tensor,
    /// Cotangent of [`Forward::scalar`], shape `[S]`.
    pub adj_scalar: Tensor,
    gradient: Layers<JoinedLayer>,
    /// Cotangents of the blocks' outputs before their GELU, in two alternating buffers, shape [S, H, C, W'].
    adj: [Tensor; 2],
    adj_projected: Tensor,
    /// Cotangents of the lifting's hidden layer, for the lines that are lifted at once.
    adj_hidden: Tensor,
    adj_spectrum: Tensor,
    inverse_rows_adj: Tensor,
    forward_rows_adj: Tensor,
    pooled: Tensor,
    partial: Tensor,
    tile: usize,
    kernels: Kernels,
}

#[derive(Debug)]
struct Kernels {
    gelu_adj: GeluAdj,
    pointwise_weight_adj: PointwiseWeightAdj,
    spectral_weight_adj: SpectralWeightAdj,
    head_weight_adj: HeadWeightAdj,
    sum_parts: SumParts,
    pool_adj: PoolAdj,
    project_adj: ProjectAdj,
}

impl TransposedWeights {
    /// Allocates the transposes of the weights in `parameters`; [`TransposedWeights::push`] fills them.
    pub fn new(context: &Context, parameters: &Parameters) -> Result<Self> {
        let layout = parameters.layout();
        let layers = layout.layers(&parameters.flat)?;
        let transposed = |layer: &Layer| -> Result<Layer> {
            let &[tiles, inputs, tile] = layer.weight.shape() else { panic!("a layer is tiled") };
            Ok(Layer {
                weight: Tensor::zeros(context, "transposed weight", &[inputs / tile, tiles * tile, tile])?,
                bias: Tensor::zeros(context, "no bias", &[inputs])?,
            })
        };
        let product = |weight: &Tensor| Tensor::zeros(context, "transposed product", weight.shape());
        Ok(Self {
            skips: layers.skips.iter().map(transposed).collect::<Result<_>>()?,
            products: layers.products.iter().map(product).collect::<Result<_>>()?,
            lifting: transposed(&layers.lifting[1])?,
            projection: transposed(&layers.projection[0])?,
            transpose: Transpose::new(context)?,
            spectral_transpose: SpectralTranspose::new(context)?,
            layers,
        })
    }

    /// Appends the transposition of the weights, with the values they have when it runs.
    pub fn push(&self, schedule: &mut Schedule) {
        for (weight, transposed) in self.layers.products.iter().zip(&self.products) {
            self.spectral_transpose.push(schedule, weight, transposed);
        }
        let [_, lifting] = &self.layers.lifting;
        let [projection, _] = &self.layers.projection;
        let skips = self.layers.skips.iter().zip(&self.skips);
        for (layer, transposed) in skips.chain([(lifting, &self.lifting), (projection, &self.projection)]) {
            self.transpose.push(schedule, &layer.weight, &transposed.weight);
        }
    }
}

impl Backward {
    /// Builds what a pass needs. The pass adds to `gradient`, a vector in the order of `parameters`.
    pub fn new(
        context: &Context,
        forward: &Forward,
        parameters: &Parameters,
        gradient: &Tensor,
        tuning: &Tuning,
    ) -> Result<Self> {
        let (config, grid) = (forward.config, forward.grid);
        let &[1, samples, h, w] = forward.field.shape() else { panic!("a field is [1, S, H, W']") };
        let zeros = |label, shape: &[usize]| Tensor::zeros(context, label, shape);
        let upload =
            |label, shape: &[usize], data: Vec<f32>| Tensor::from_slice(context, label, shape, &data);
        let gradient = parameters.layout().gradient_layers(gradient)?;
        let parts = pointwise_weight_adj::parts(samples * h * w / 4);
        let layers = [&gradient.lifting[0], &gradient.lifting[1], &gradient.projection[0]];
        let longest =
            layers.into_iter().chain(&gradient.skips).map(|g| g.weight_and_bias.len()).max().unwrap_or(0);
        let (columns, c) = (2 * config.modes_w, config.channels);
        let adj = || zeros("adj", &[samples, h, c, w]);
        Ok(Self {
            adj_field: zeros("adj_field", &[samples, h, w])?,
            adj_scalar: zeros("adj_scalar", &[samples])?,
            gradient,
            adj: [adj()?, adj()?],
            adj_projected: zeros("adj_projected", &[samples, h, config.projection, w])?,
            adj_hidden: zeros("adj_hidden", forward.hidden.shape())?,
            adj_spectrum: zeros("adj_spectrum", forward.spectral.modes[0].shape())?,
            inverse_rows_adj: upload(
                "inverse_rows_adj",
                &[w / 4, columns, 4],
                tables::inverse_rows_adj(&config, grid.w),
            )?,
            forward_rows_adj: upload(
                "forward_rows_adj",
                &[columns, padded(grid.w)],
                tables::forward_rows_adj(&config, h, grid.w),
            )?,
            pooled: zeros("pooled", &[samples, c])?,
            partial: zeros("gradient parts", &[parts, longest])?,
            tile: parameters.layout().tile(),
            kernels: Kernels {
                gelu_adj: GeluAdj::new(context)?,
                pointwise_weight_adj: PointwiseWeightAdj::new(context)?,
                spectral_weight_adj: SpectralWeightAdj::new(context, tuning)?,
                head_weight_adj: HeadWeightAdj::new(context)?,
                sum_parts: SumParts::new(context)?,
                pool_adj: PoolAdj::new(context)?,
                project_adj: ProjectAdj::new(context)?,
            },
        })
    }

    /// Appends the backward pass from `adj_field` and `adj_scalar` through the last pass of `forward`.
    pub fn push(&self, schedule: &mut Schedule, forward: &Forward, transposed: &TransposedWeights) {
        let (config, k) = (&forward.config, &self.kernels);
        self.push_heads(schedule, forward, transposed);
        let [mut adj_y, mut adj_x] = self.adj.each_ref();
        for block in (0..config.layers).rev() {
            self.push_block(schedule, (forward, transposed), block, (adj_y, adj_x));
            if block > 0 {
                self.push_pool(schedule, forward, block - 1, adj_x);
                k.gelu_adj.push(schedule, &forward.activations.before_gelu[block - 1], adj_x);
            }
            std::mem::swap(&mut adj_y, &mut adj_x);
        }
        self.push_lifting(schedule, (forward, transposed), adj_y);
    }

    /// Appends the adjoint of the field head down to the last block's output, that of the scalar head if it
    /// reads that output, and the gradients with respect to their weights.
    fn push_heads(&self, schedule: &mut Schedule, forward: &Forward, transposed: &TransposedWeights) {
        let (config, k) = (&forward.config, &self.kernels);
        let [_, outer] = &forward.layers.projection;
        let [inner_gradient, outer_gradient] = &self.gradient.projection;
        let (y, before) =
            (forward.activation(config.layers), &forward.activations.before_gelu[config.layers - 1]);
        let to = (&outer_gradient.weight_and_bias, outer_gradient.bias);
        k.head_weight_adj.push(schedule, &forward.activations.projected, &self.adj_field, to);
        k.project_adj.push(schedule, &outer.weight, &self.adj_field, &self.adj_projected);
        k.gelu_adj.push(schedule, before, &self.adj_projected);
        self.push_weights(schedule, (y, &self.adj_projected), self.all(), inner_gradient);
        let [adj_y, _] = &self.adj;
        forward.kernels.dense.push(schedule, &transposed.projection, &self.adj_projected, adj_y);
        self.push_pool(schedule, forward, config.layers - 1, adj_y);
    }

    /// Appends the adjoint of the scalar head, and the gradient with respect to its weights, if it reads the
    /// output of `block`.
    fn push_pool(&self, schedule: &mut Schedule, forward: &Forward, block: usize, adj: &Tensor) {
        if forward.config.scalar_block() != block {
            return;
        }
        let (rows_max, columns) = (&forward.rows_max, forward.grid.w);
        let x = forward.activation(block + 1);
        let from = PoolAdjTensors { adj_scalar: &self.adj_scalar, rows_max, x, columns };
        let &[samples, channels] = self.pooled.shape() else { unreachable!("what is pooled is [S, C]") };
        let weight = forward.layers.scalar.weight_and_bias.view(0, &[channels]);
        self.kernels.pool_adj.push(schedule, &weight, from, (adj, &self.pooled));
        let JoinedLayer { weight_and_bias, bias } = &self.gradient.scalar;
        let pooled = self.pooled.view(0, &[samples, channels, 1]);
        self.kernels.head_weight_adj.push(schedule, &pooled, &self.adj_scalar, (weight_and_bias, *bias));
    }

    /// Appends the adjoint of a block, from its output before the GELU to its input, and the gradients with
    /// respect to its weights.
    fn push_block(
        &self,
        schedule: &mut Schedule,
        (forward, transposed): (&Forward, &TransposedWeights),
        block: usize,
        (adj_y, adj_x): (&Tensor, &Tensor),
    ) {
        let (k, s) = (&forward.kernels, &forward.spectral);
        k.transform_rows.push(schedule, &self.inverse_rows_adj, adj_y, &s.rows);
        k.spectral.push(schedule, &transposed.products[block], s.columns(Some(&self.adj_spectrum)));
        let to = &self.gradient.products[block];
        self.kernels.spectral_weight_adj.push(schedule, &s.modes[block], &self.adj_spectrum, to);
        let tensors = BlockTensors {
            x: Inputs::Stored(adj_y),
            r: &s.inverse,
            y: adj_x,
            rows_or_field: None,
            rows_max: None,
        };
        let tables = (&self.forward_rows_adj, forward.grid.w);
        k.block(Epilogue::default()).push(schedule, &transposed.skips[block], tables, tensors);
        let x = forward.activation(block);
        self.push_weights(schedule, (x, adj_y), self.all(), &self.gradient.skips[block]);
    }

    /// Appends the gradients with respect to the lifting's weights, from the cotangent of its output.
    fn push_lifting(
        &self,
        schedule: &mut Schedule,
        (forward, transposed): (&Forward, &TransposedWeights),
        adj: &Tensor,
    ) {
        let (dense, hidden) = (&forward.kernels.dense, &forward.hidden);
        let [inner, _] = &forward.layers.lifting;
        let [inner_gradient, outer_gradient] = &self.gradient.lifting;
        for (into, back) in forward.lifted_at_once(self.adj_scalar.len()) {
            dense.push_lines(schedule, inner, (&forward.embedded, hidden), into);
            dense.push_lines(schedule, &transposed.lifting, (adj, &self.adj_hidden), into);
            self.kernels.gelu_adj.push(schedule, hidden, &self.adj_hidden);
            self.push_weights(schedule, (hidden, adj), back, outer_gradient);
            self.push_weights(schedule, (&forward.embedded, &self.adj_hidden), into, inner_gradient);
        }
    }

    /// Returns all lines of the samples.
    fn all(&self) -> Lines {
        let &[samples, h, _] = self.adj_field.shape() else { unreachable!("a cotangent is [S, H, W']") };
        Lines { count: samples * h, x_first: 0, y_first: 0 }
    }

    /// Adds the gradient with respect to a pointwise layer's weight and bias, from its input `x` and the
    /// cotangent of its output.
    fn push_weights(
        &self,
        schedule: &mut Schedule,
        (x, adj): (&Tensor, &Tensor),
        part: Lines,
        gradient: &JoinedLayer,
    ) {
        let JoinedLayer { weight_and_bias, bias } = gradient;
        let parts =
            Parts { partial: &self.partial, len: weight_and_bias.len(), bias: *bias, tile: self.tile };
        let count = self.kernels.pointwise_weight_adj.push(schedule, (x, adj), part, parts);
        self.kernels.sum_parts.push(schedule, (&self.partial, count), weight_and_bias);
    }
}
