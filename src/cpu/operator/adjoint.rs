//! The backward pass of the network: from the cotangents of field and scalar to the gradient over all
//! weights.
//!
//! The adjoint of a block has the structure of a block: transform along the rows and the columns, spectral
//! product, inverse, skip, each replaced by its adjoint ([`Transform::adjoint`], [`Spectral::adjoint`],
//! [`Skip::adjoint`]) in reverse order. It therefore runs through the same stages. The network's inputs are
//! constants of training: nothing propagates beyond the lifting.
//!
//! A sum over positions is taken in [`PARTS`] parts, each in order, which are then added in order. The result
//! does not depend on the number of threads.

use super::block::Skip;
use super::lifting::{Fields, LiftingGradient};
use super::network::{Kept, Layers, Network};
use super::pointwise::{PointwiseGradient, straight};
use super::projection::ProjectionGradient;
use super::scalar_head::ScalarHead;
use super::spectral::Spectral;
use super::transform::{ModeParts, Transform};
use super::{band_rows, padded};
use crate::Result;
use crate::cloth::Grid;
use crate::cpu::real::Real;
use crate::network::{Config, Weights};
use rayon::prelude::*;
use std::sync::Arc;

/// Maximum number of parts of a sum over the positions of all samples.
const PARTS: usize = 16;

/// The network for a number of samples on one grid, forward and backward.
pub struct Adjoint<T: Real> {
    network: Network<T>,
    transform: Transform<T>,
    weights: Arc<AdjointWeights<T>>,
    parts: Vec<Part<T>>,
    buffers: Buffers<T>,
}

/// Weights in the order in which the forward and the backward pass read them, laid out once for all networks
/// that share them.
pub struct LaidOut<T> {
    config: Config,
    layers: Arc<Layers<T>>,
    adjoint: Arc<AdjointWeights<T>>,
}

impl<T: Real> LaidOut<T> {
    /// Lays out these weights.
    pub fn new(weights: &Weights) -> Self {
        let (layers, adjoint) = (Layers::new(weights), AdjointWeights::new(weights));
        Self { config: weights.config, layers: Arc::new(layers), adjoint: Arc::new(adjoint) }
    }
}

/// The weights as the adjoint stages read them.
struct AdjointWeights<T> {
    blocks: Vec<(Spectral<T>, Skip<T>)>,
    /// Weight of the second layer of the lifting, shape [C, lifting].
    lifting: Vec<T>,
    /// Weight of the first layer of the projection, shape [projection, C].
    projection: Vec<T>,
}

/// One part of the sums over positions: a range of rows, with working memory.
struct Part<T> {
    /// Range of rows, numbered through all samples.
    rows: std::ops::Range<usize>,
    lifting: LiftingGradient<T>,
    skips: Vec<PointwiseGradient<T>>,
    projection: ProjectionGradient<T>,
    /// A band of the input of a block, its slopes, and the cotangents there.
    band: [Vec<T>; 3],
}

struct Buffers<T> {
    /// Cotangents of a block's output before its GELU, shape [S, H, W, C].
    adj_y: Vec<T>,
    /// Row spectra of these, then the cotangents from the spectral product, shape [S, H, modes_w, 2, C].
    rows: Vec<T>,
    sums: Vec<T>,
    modes: Vec<T>,
    spectral: Vec<T>,
    /// Working memory the size of a block's spectral weights.
    matrices: Vec<T>,
}

impl<T: Real> AdjointWeights<T> {
    fn new(weights: &Weights) -> Self {
        let config = &weights.config;
        let block = |block| (Spectral::adjoint(config, block), Skip::adjoint(config, block));
        Self {
            blocks: weights.blocks.iter().map(block).collect(),
            lifting: straight(&weights.lifting[1].weight, config.channels, config.lifting),
            projection: straight(&weights.projection[0].weight, config.projection, config.channels),
        }
    }
}

impl<T: Real> Part<T> {
    fn new(config: &Config, grid: Grid, rows: std::ops::Range<usize>) -> Self {
        let c = padded(config.channels);
        Self {
            rows,
            lifting: LiftingGradient::new(config),
            skips: (0..config.layers).map(|_| PointwiseGradient::new(c, config.channels)).collect(),
            projection: ProjectionGradient::new(config),
            band: [(); 3].map(|_| vec![T::zero(); band_rows(grid.w) * grid.w * c]),
        }
    }

    fn clear(&mut self) {
        self.lifting.hidden.clear();
        self.lifting.out.clear();
        self.skips.iter_mut().for_each(PointwiseGradient::clear);
        self.projection.hidden.clear();
        self.projection.weight.fill(T::zero());
        self.projection.bias = T::zero();
    }

    fn merge(&mut self, other: &Self) {
        self.lifting.hidden.merge(&other.lifting.hidden);
        self.lifting.out.merge(&other.lifting.out);
        for (to, from) in self.skips.iter_mut().zip(&other.skips) {
            to.merge(from);
        }
        self.projection.hidden.merge(&other.projection.hidden);
        for (to, &from) in self.projection.weight.iter_mut().zip(&other.projection.weight) {
            *to = *to + from;
        }
        self.projection.bias = self.projection.bias + other.projection.bias;
    }
}

/// Some rows of one sample.
struct Band {
    sample: usize,
    /// Number of the first row in the sample.
    first: usize,
    /// Row numbers through all samples.
    rows: std::ops::Range<usize>,
}

/// Splits `rows`, numbered through all samples of `h` rows, into bands of at most `band` rows within one
/// sample.
fn bands(rows: std::ops::Range<usize>, h: usize, band: usize) -> impl Iterator<Item = Band> {
    let mut next = rows.start;
    std::iter::from_fn(move || {
        let start = next;
        next = rows.end.min(start + band).min((start / h + 1) * h);
        (start < next).then_some(Band { sample: start / h, first: start % h, rows: start..next })
    })
}

impl<T: Real> Adjoint<T> {
    /// Builds the network with `weights` for `samples` samples on `grid`. Fails if the grid is too
    /// small for the kept modes or there is not enough memory.
    pub fn new(weights: &Weights, grid: Grid, samples: usize) -> Result<Self> {
        let mut network = Network::new(weights, grid, samples)?;
        network.keep();
        let config = weights.config;
        let rows = samples * grid.h;
        let count = rows.min(PARTS);
        let part = |p: usize| Part::new(&config, grid, rows * p / count..rows * (p + 1) / count);
        let transform = network.transform.adjoint();
        let weights = Arc::new(AdjointWeights::new(weights));
        let zeros = |n: usize| vec![T::zero(); n];
        let spectral = weights.blocks.first();
        let buffers = Buffers {
            adj_y: zeros(rows * grid.w * network.channels),
            rows: zeros(rows * transform.row_len()),
            sums: zeros(samples * transform.column_len()),
            modes: zeros(config.modes() * 4 * samples * network.channels),
            spectral: zeros(spectral.map_or(0, |b| b.0.scratch_len(samples))),
            matrices: zeros(spectral.map_or(0, |b| b.0.weight_len())),
        };
        Ok(Self { network, transform, weights, parts: (0..count).map(part).collect(), buffers })
    }

    /// Replaces the weights with others of the same sizes. Panics if the sizes differ.
    pub fn set_weights(&mut self, weights: &LaidOut<T>) {
        assert_eq!(weights.config, self.network.config, "the network's sizes must not change");
        self.network.layers = weights.layers.clone();
        self.weights = weights.adjoint.clone();
    }

    /// Runs the network on `input` [S, fields, H, W] and keeps what [`Adjoint::backward`] needs.
    pub fn forward(&mut self, input: &[T]) {
        self.network.forward(input);
    }

    /// Returns the field of the last run, shape [S, 1, H, W].
    pub fn field(&self) -> &[T] {
        self.network.field()
    }

    /// Returns the scalars of the last run, shape \[S\].
    pub fn scalar(&self) -> &[T] {
        self.network.scalar()
    }

    /// Adds the gradient over all weights to `gradient`, in the order of [`Weights::parameters`], given the
    /// cotangents `adj_field` [S, 1, H, W] and `adj_scalar` \[S\] of the last run and that run's `input`.
    pub fn backward(&mut self, input: &[T], (adj_field, adj_scalar): (&[T], &[T]), gradient: &mut [T]) {
        let config = self.network.config;
        assert_eq!(adj_field.len(), self.field().len(), "adj_field has shape [S, 1, H, W]");
        assert_eq!(adj_scalar.len(), self.scalar().len(), "adj_scalar has shape [S]");
        let mut slices = Slices::new(&config, gradient);
        self.parts.iter_mut().for_each(Part::clear);
        self.heads(adj_field, adj_scalar);
        for index in (0..config.layers).rev() {
            self.mix(index, slices.blocks[index][0]);
            self.finish_block(index, input, adj_scalar);
        }
        let kept = self.network.kept.as_ref().expect("the network keeps its activations");
        let [weight, bias] = &mut slices.scalar;
        for (pooled, &adj) in kept.pooled.chunks_exact(self.network.channels).zip(adj_scalar) {
            ScalarHead::add_gradient(weight, &mut bias[0], pooled, adj);
        }
        let (first, others) = self.parts.split_first_mut().expect("a part at least");
        others.iter().for_each(|part| first.merge(part));
        slices.add(first);
    }

    /// Goes back through the field head, and through the scalar head if it reads the last block. Sets the
    /// cotangents of the last block's output.
    fn heads(&mut self, adj_field: &[T], adj_scalar: &[T]) {
        let Network { config, grid, channels, layers, kept, .. } = &self.network;
        let (h, row) = (grid.h, grid.w * channels);
        let kept = kept.as_ref().expect("the network keeps its activations");
        let last = config.layers - 1;
        let (transform, weight) = (&self.transform, &self.weights.projection);
        let Buffers { adj_y, rows, .. } = &mut self.buffers;
        let band = band_rows(grid.w);
        let split = parts_of(&mut self.parts, (adj_y, row), (rows, transform.row_len()));
        split.into_par_iter().for_each(|(part, adj_y, spectra)| {
            for b in bands(part.rows.clone(), h, band) {
                let at = b.rows.start - part.rows.start;
                let adj_y = &mut adj_y[at * row..][..b.rows.len() * row];
                let y = &kept.blocks[last][b.rows.start * row..][..adj_y.len()];
                let adj_field = &adj_field[b.rows.start * grid.w..b.rows.end * grid.w];
                layers.projection.backward(adj_y, (y, adj_field), weight, &mut part.projection);
                if config.scalar_block() == last {
                    add_scalar_head(layers, kept, (adj_y, y), &b, adj_scalar);
                }
                let spectra = spectra[at * transform.row_len()..].chunks_exact_mut(transform.row_len());
                for (adj_y, spectrum) in adj_y.chunks_exact(row).zip(spectra) {
                    transform.row_forward(spectrum, adj_y);
                }
            }
        });
    }

    /// Goes back through the column transform and the spectral product of block `index`, whose gradient is
    /// added to `gradient`.
    fn mix(&mut self, index: usize, gradient: &mut [T]) {
        let transform = &self.transform;
        let Buffers { rows, sums, modes, spectral, matrices, .. } = &mut self.buffers;
        let sample = self.network.grid.h * transform.row_len();
        let modes_w = self.network.config.modes_w;
        sums.par_chunks_mut(transform.column_len() / modes_w).enumerate().for_each(|(column, sums)| {
            let rows = &rows[column / modes_w * sample..][..sample];
            transform.column_forward(sums, rows, column % modes_w);
        });
        let product = &self.weights.blocks[index].0;
        product.apply(modes, sums, transform, spectral);
        let kept = self.network.kept.as_ref().expect("the network keeps its activations");
        product.add_gradient(gradient, (&kept.modes[index], spectral), matrices);
    }

    /// Goes back through the rest of block `index`, and through the GELU before it or the lifting.
    fn finish_block(&mut self, index: usize, input: &[T], adj_scalar: &[T]) {
        let Network { config, grid, channels, layers, kept, .. } = &self.network;
        let (h, row, samples) = (grid.h, grid.w * channels, adj_scalar.len());
        let kept = kept.as_ref().expect("the network keeps its activations");
        let (transform, weights) = (&self.transform, &self.weights);
        let skip = &weights.blocks[index].1;
        let row_len = transform.row_len();
        let Buffers { adj_y, rows, modes, .. } = &mut self.buffers;
        let modes = &*modes;
        let band = band_rows(grid.w);
        let split = parts_of(&mut self.parts, (adj_y, row), (rows, row_len));
        split.into_par_iter().for_each(|(part, adj_y, spectra)| {
            for b in bands(part.rows.clone(), h, band) {
                let at = b.rows.start - part.rows.start;
                let len = b.rows.len() * row;
                let adj_y = &mut adj_y[at * row..][..len];
                let spectra = &mut spectra[at * row_len..][..b.rows.len() * row_len];
                let [x, slopes, adj_x] = part.band.each_mut().map(|v| &mut v[..len]);
                let before = if index == 0 { &kept.lifted } else { &kept.blocks[index - 1] };
                x.copy_from_slice(&before[b.rows.start * row..][..len]);
                if index > 0 {
                    T::gelu_and_slope(x, slopes);
                }
                part.skips[index].add(x, adj_y);
                transform.column_inverse(
                    spectra,
                    b.first,
                    ModeParts { values: modes, samples, sample: b.sample },
                );
                let outputs = adj_x.chunks_exact_mut(row).zip(adj_y.chunks_exact(row));
                for ((adj_x, adj_y), z) in outputs.zip(spectra.chunks_exact(row_len)) {
                    skip.row(adj_x, adj_y, z, transform);
                }
                if index == 0 {
                    let fields = config.fields * grid.particles();
                    let values = &input[b.sample * fields..][..fields];
                    let fields = (Fields { values, grid: *grid }, b.first * grid.w);
                    layers.lifting.backward(adj_x, fields, &weights.lifting, &mut part.lifting);
                    continue;
                }
                if config.scalar_block() == index - 1 {
                    add_scalar_head(layers, kept, (adj_x, x), &b, adj_scalar);
                }
                for ((to, &adj), &slope) in adj_y.iter_mut().zip(&*adj_x).zip(&*slopes) {
                    *to = adj * slope;
                }
                for (adj_y, spectrum) in adj_y.chunks_exact(row).zip(spectra.chunks_exact_mut(row_len)) {
                    transform.row_forward(spectrum, adj_y);
                }
            }
        });
    }
}

/// Adds the scalar head's cotangents to `adj_x`, a band of the cotangents of its block's output `x`.
fn add_scalar_head<T: Real>(
    layers: &Layers<T>,
    kept: &Kept<T>,
    (adj_x, x): (&mut [T], &[T]),
    band: &Band,
    adj_scalar: &[T],
) {
    let c = kept.first_rows.len() / adj_scalar.len();
    let first_rows = &kept.first_rows[band.sample * c..][..c];
    let row = x.len() / band.rows.len();
    for (k, (adj_x, x)) in adj_x.chunks_exact_mut(row).zip(x.chunks_exact(row)).enumerate() {
        let place = (band.first + k, first_rows);
        layers.scalar_head.backward_row(adj_x, x, place, adj_scalar[band.sample]);
    }
}

/// Pairs each part with its rows of two buffers, each given with its row length.
fn parts_of<'a, T>(
    parts: &'a mut [Part<T>],
    (mut a, a_row): (&'a mut [T], usize),
    (mut b, b_row): (&'a mut [T], usize),
) -> Vec<(&'a mut Part<T>, &'a mut [T], &'a mut [T])> {
    let mut split = Vec::with_capacity(parts.len());
    for part in parts {
        let (a_head, a_tail) = a.split_at_mut(part.rows.len() * a_row);
        let (b_head, b_tail) = b.split_at_mut(part.rows.len() * b_row);
        (a, b) = (a_tail, b_tail);
        split.push((part, a_head, b_head));
    }
    split
}

/// The flat gradient, split by layer into weight and bias.
struct Slices<'a, T> {
    lifting: [[&'a mut [T]; 2]; 2],
    /// Spectral weight, bias, skip of each block.
    blocks: Vec<[&'a mut [T]; 3]>,
    projection: [[&'a mut [T]; 2]; 2],
    scalar: [&'a mut [T]; 2],
}

impl<'a, T: Real> Slices<'a, T> {
    fn new(config: &Config, mut flat: &'a mut [T]) -> Self {
        let mut take = |n: usize| flat.split_off_mut(..n).expect("a gradient has the size of the weights");
        let mut dense = |outputs: usize, inputs: usize| [take(outputs * inputs), take(outputs)];
        let c = config.channels;
        let lifting = [dense(config.lifting, config.inputs()), dense(c, config.lifting)];
        let blocks =
            (0..config.layers).map(|_| [take(c * c * config.modes() * 2), take(c), take(c * c)]).collect();
        let mut dense = |outputs: usize, inputs: usize| [take(outputs * inputs), take(outputs)];
        let projection = [dense(config.projection, c), dense(1, config.projection)];
        let scalar = dense(1, c);
        assert!(flat.is_empty(), "a gradient has the size of the weights");
        Self { lifting, blocks, projection, scalar }
    }

    /// Adds the sums over positions.
    fn add(self, part: &Part<T>) {
        let [[w0, b0], [w1, b1]] = self.lifting;
        part.lifting.hidden.add_to(w0, b0);
        part.lifting.out.add_to(w1, b1);
        for ([_, bias, skip], sum) in self.blocks.into_iter().zip(&part.skips) {
            sum.add_to(skip, bias);
        }
        let [[w0, b0], [w1, b1]] = self.projection;
        part.projection.hidden.add_to(w0, b0);
        for (to, &from) in w1.iter_mut().zip(&part.projection.weight) {
            *to = *to + from;
        }
        b1[0] = b1[0] + part.projection.bias;
    }
}
