//! The whole network, from normalised fields to a field and a scalar per sample.

use super::block::Skip;
use super::lifting::{Fields, Lifting};
use super::projection::Projection;
use super::scalar_head::ScalarHead;
use super::spectral::Spectral;
use super::transform::{ModeParts, Transform};
use super::{padded, task_rows};
use crate::cloth::Grid;
use crate::cpu::real::Real;
use crate::network::{Config, Weights};
use crate::{Result, memory};
use rayon::prelude::*;
use std::sync::Arc;

/// A point inside the network at which [`Network::forward_observed`] reports the values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The fields followed by the two positional fields, [S, fields + 2, H, W].
    Embedded,
    /// The output of the lifting, [S, C, H, W].
    Lifted,
    /// The output of a Fourier block, after its GELU if it has one, [S, C, H, W].
    Block(usize),
}

/// The network for a number of samples on one grid, with all its working memory.
pub struct Network<T: Real> {
    pub(super) config: Config,
    pub(super) grid: Grid,
    /// Number of channels as stored.
    pub(super) channels: usize,
    pub(super) transform: Transform<T>,
    pub(super) layers: Arc<Layers<T>>,
    pub(super) kept: Option<Kept<T>>,
    buffers: Buffers<T>,
}

/// The weights, each layer in the order in which its stage reads them.
pub(super) struct Layers<T> {
    pub lifting: Lifting<T>,
    pub blocks: Vec<(Spectral<T>, Skip<T>)>,
    pub projection: Projection<T>,
    pub scalar_head: ScalarHead<T>,
}

/// The results of a forward pass that the backward pass needs. The hidden layers of lifting and projection
/// are recomputed instead.
pub(super) struct Kept<T> {
    /// Output of the lifting, shape [S, H, W, C].
    pub lifted: Vec<T>,
    /// Output of each block before its GELU, shape [S, H, W, C].
    pub blocks: Vec<Vec<T>>,
    /// Kept modes of each block's input, in the layout that the spectral product reads.
    pub modes: Vec<Vec<T>>,
    /// The largest value of each channel, shape [S, C], and the first row that attains it.
    pub pooled: Vec<T>,
    pub first_rows: Vec<u32>,
}

impl<T: Real> Layers<T> {
    pub fn new(weights: &Weights) -> Self {
        let block = |block| (Spectral::new(&weights.config, block), Skip::new(&weights.config, block));
        Self {
            lifting: Lifting::new(weights),
            blocks: weights.blocks.iter().map(block).collect(),
            projection: Projection::new(weights),
            scalar_head: ScalarHead::new(weights),
        }
    }
}

struct Buffers<T> {
    /// Input of a block, shape [S, H, W, C].
    x: Vec<T>,
    /// Its output, same shape.
    y: Vec<T>,
    /// Row spectra of the next block's input, shape [S, H, modes_w, 2, C].
    rows: Vec<T>,
    /// Column sums, shape [S, modes_w, 2 modes_h, 2, C].
    sums: Vec<T>,
    /// Modes after the product, shape [modes_h, modes_w, 2, S, 2, C].
    modes: Vec<T>,
    /// Working memory of the spectral product.
    spectral: Vec<T>,
    /// Largest value of each row, shape [S, H, C].
    pooled: Vec<T>,
    /// Result, shape [S, 1, H, W].
    field: Vec<T>,
    /// Result, shape \[S\].
    scalar: Vec<T>,
}

/// Allocates two activations of `len` numbers, by far the largest buffers of a pass. Fails before either is
/// touched, which takes long.
fn activations<T: Real>(len: usize) -> Result<[Vec<T>; 2]> {
    let mut both = [Vec::new(), Vec::new()];
    memory::reserve_each(both.each_mut(), len, "activations")?;
    both.iter_mut().for_each(|values| values.resize(len, T::zero()));
    Ok(both)
}

impl<T: Real> Network<T> {
    /// Lays out the weights for `samples` samples on `grid`. Fails if the grid is too small for
    /// the kept modes or there is not enough memory.
    pub fn new(weights: &Weights, grid: Grid, samples: usize) -> Result<Self> {
        let config = weights.config;
        let channels = padded(config.channels);
        let transform = Transform::new(&config, grid, channels)?;
        let layers = Arc::new(Layers::new(weights));
        let zeros = |n: usize| vec![T::zero(); n];
        let n = grid.particles();
        let [x, y] = activations(samples * n * channels)?;
        let buffers = Buffers {
            x,
            y,
            rows: zeros(samples * grid.h * transform.row_len()),
            sums: zeros(samples * transform.column_len()),
            modes: zeros(config.modes() * 4 * samples * channels),
            spectral: zeros(layers.blocks.first().map_or(0, |b| b.0.scratch_len(samples))),
            pooled: zeros(samples * grid.h * channels),
            field: zeros(samples * n),
            scalar: zeros(samples),
        };
        Ok(Self { config, grid, channels, transform, layers, kept: None, buffers })
    }

    /// Makes every later run keep what the backward pass needs.
    pub(super) fn keep(&mut self) {
        let zeros = |like: &Vec<T>| vec![T::zero(); like.len()];
        let Buffers { x, spectral, scalar, .. } = &self.buffers;
        let pooled = vec![T::zero(); scalar.len() * self.channels];
        let blocks = || self.layers.blocks.iter();
        self.kept = Some(Kept {
            lifted: zeros(x),
            blocks: blocks().map(|_| zeros(x)).collect(),
            modes: blocks().map(|_| zeros(spectral)).collect(),
            first_rows: vec![0; pooled.len()],
            pooled,
        });
    }

    /// Runs the network on `input` [S, fields, H, W], the normalised gradient, last gradient and last step.
    pub fn forward(&mut self, input: &[T]) {
        self.run(input, &mut |_, _| {});
    }

    /// Runs the network as [`Network::forward`] does and passes each [`Stage`] to `observer`, channels first.
    pub fn forward_observed(&mut self, input: &[T], observer: &mut dyn FnMut(Stage, &[T])) {
        observer(Stage::Embedded, &self.embedded(input));
        let (c, stored, n) = (self.config.channels, self.channels, self.grid.particles());
        self.run(input, &mut |stage, x| observer(stage, &channels_first(x, n, stored, c)));
    }

    /// Returns the field of the last run, shape [S, 1, H, W].
    pub fn field(&self) -> &[T] {
        &self.buffers.field
    }

    /// Returns the scalars of the last run, shape \[S\].
    pub fn scalar(&self) -> &[T] {
        &self.buffers.scalar
    }

    fn run(&mut self, input: &[T], observer: &mut dyn FnMut(Stage, &[T])) {
        let per_sample = self.config.fields * self.grid.particles();
        assert_eq!(input.len(), self.buffers.scalar.len() * per_sample, "input has shape [S, fields, H, W]");
        self.lift(input);
        observer(Stage::Lifted, &self.buffers.x);
        for index in 0..self.layers.blocks.len() {
            self.mix(index);
            self.finish_block(index);
            if let (0, Some(kept)) = (index, &mut self.kept) {
                std::mem::swap(&mut self.buffers.x, &mut kept.lifted);
            }
            std::mem::swap(&mut self.buffers.x, &mut self.buffers.y);
            observer(Stage::Block(index), &self.buffers.x);
        }
        let (scalar_head, Buffers { pooled, scalar, .. }) = (&self.layers.scalar_head, &mut self.buffers);
        if let Some(kept) = &mut self.kept {
            scalar_head.first_rows(&mut kept.first_rows, pooled);
        }
        scalar_head.apply(scalar, pooled);
        if let Some(kept) = &mut self.kept {
            let samples = pooled.chunks_exact(self.grid.h * self.channels);
            for (to, from) in kept.pooled.chunks_exact_mut(self.channels).zip(samples) {
                to.copy_from_slice(&from[..self.channels]);
            }
        }
    }

    /// Applies the lifting and the row transform, band by band.
    fn lift(&mut self, input: &[T]) {
        let Grid { h, w } = self.grid;
        let (lifting, transform) = (&self.layers.lifting, &self.transform);
        let Buffers { x, rows, scalar, .. } = &mut self.buffers;
        let (band, row) = (task_rows(self.grid, scalar.len()), w * self.channels);
        let samples = x.par_chunks_mut(h * row);
        let spectra = rows.par_chunks_mut(h * transform.row_len());
        let fields = input.par_chunks(input.len() / scalar.len());
        samples.zip(spectra).zip(fields).for_each(|((x, spectra), values)| {
            let fields = Fields { values, grid: Grid { h, w } };
            let bands = x.par_chunks_mut(band * row).zip(spectra.par_chunks_mut(band * transform.row_len()));
            bands.enumerate().for_each_init(
                || lifting.scratch(),
                |scratch, (index, (x, spectra))| {
                    let rows = x.chunks_exact_mut(row).zip(spectra.chunks_exact_mut(transform.row_len()));
                    for (k, (x, spectrum)) in rows.enumerate() {
                        lifting.row(x, fields, index * band + k, scratch);
                        transform.row_forward(spectrum, x);
                    }
                },
            );
        });
    }

    /// Applies the column transform and the spectral product of block `index`.
    fn mix(&mut self, index: usize) {
        let transform = &self.transform;
        let Buffers { rows, sums, modes, spectral, .. } = &mut self.buffers;
        let sample = self.grid.h * transform.row_len();
        let modes_w = self.config.modes_w;
        sums.par_chunks_mut(transform.column_len() / modes_w).enumerate().for_each(|(column, sums)| {
            let rows = &rows[column / modes_w * sample..][..sample];
            transform.column_forward(sums, rows, column % modes_w);
        });
        let scratch = self.kept.as_mut().map_or(spectral, |kept| &mut kept.modes[index]);
        self.layers.blocks[index].0.apply(modes, sums, transform, scratch);
    }

    /// Finishes block `index` band by band, with the position-wise work that follows it: the GELU and the row
    /// transform of the next block, or the projection; and the maximum for the scalar head.
    fn finish_block(&mut self, index: usize) {
        let Grid { h, w } = self.grid;
        let Layers { blocks, projection, scalar_head, .. } = &*self.layers;
        let transform = &self.transform;
        let (c, row, row_len) = (self.channels, w * self.channels, transform.row_len());
        let band = task_rows(self.grid, self.buffers.scalar.len());
        let skip = &blocks[index].1;
        let last = index + 1 == blocks.len();
        let pools = index == self.config.scalar_block();
        let Buffers { x, y, rows, modes, pooled, field, scalar, .. } = &mut self.buffers;
        let samples = scalar.len();
        let modes = &*modes;
        let kept = self.kept.as_mut().map(|kept| &mut kept.blocks[index][..]);
        let kept = optional_chunks(kept, h * row, samples);
        let finish_row =
            |(y, z, pooled): (&mut [T], &mut [T], &mut [T]), field: &mut [T], scratch: &mut [T]| {
                if !last {
                    T::gelu(y);
                    transform.row_forward(z, y);
                }
                if pools {
                    scalar_head.pool(pooled, y);
                }
                if last {
                    projection.apply(field, y, scratch);
                }
            };
        let activations = x.par_chunks(h * row).zip(y.par_chunks_mut(h * row));
        let heads = rows
            .par_chunks_mut(h * row_len)
            .zip(pooled.par_chunks_mut(h * c))
            .zip(field.par_chunks_mut(h * w));
        activations.zip(heads).zip(kept).enumerate().for_each(|(sample, (parts, kept))| {
            let ((x, y), ((rows, pooled), field)) = parts;
            let kept = optional_chunks(kept, band * row, h.div_ceil(band));
            let activations = x.par_chunks(band * row).zip(y.par_chunks_mut(band * row));
            let heads = rows
                .par_chunks_mut(band * row_len)
                .zip(pooled.par_chunks_mut(band * c))
                .zip(field.par_chunks_mut(band * w));
            activations.zip(heads).zip(kept).enumerate().for_each_init(
                || projection.scratch(),
                |scratch, (index, (((x, y), ((rows, pooled), field)), mut kept))| {
                    let parts = ModeParts { values: modes, samples, sample };
                    transform.column_inverse(rows, index * band, parts);
                    let activations = x.chunks_exact(row).zip(y.chunks_exact_mut(row));
                    let heads = rows
                        .chunks_exact_mut(row_len)
                        .zip(pooled.chunks_exact_mut(c))
                        .zip(field.chunks_exact_mut(w));
                    for (k, ((x, y), ((z, pooled), field))) in activations.zip(heads).enumerate() {
                        skip.row(y, x, z, transform);
                        if let Some(kept) = &mut kept {
                            kept[k * row..][..row].copy_from_slice(y);
                        }
                        finish_row((y, z, pooled), field, scratch);
                    }
                },
            );
        });
    }

    /// Returns the inputs of the lifting, shape [S, fields + 2, H, W].
    fn embedded(&self, input: &[T]) -> Vec<T> {
        let Grid { h, w } = self.grid;
        let (inputs, n) = (self.config.inputs(), h * w);
        let mut embedded = Vec::with_capacity(input.len() / self.config.fields * inputs);
        for values in input.chunks_exact(self.config.fields * n) {
            let fields = Fields { values, grid: self.grid };
            let mut positions = vec![T::zero(); n * inputs];
            for (p, at) in positions.chunks_exact_mut(inputs).enumerate() {
                self.layers.lifting.embed(at, fields, p / w, p % w);
            }
            embedded.extend(channels_first(&positions, n, inputs, inputs));
        }
        embedded
    }
}

/// Splits an optional slice into chunks of `size` numbers. Without a slice, returns `count` times `None`.
fn optional_chunks<T>(all: Option<&mut [T]>, size: usize, count: usize) -> Vec<Option<&mut [T]>> {
    match all {
        Some(all) => all.chunks_mut(size).map(Some).collect(),
        None => (0..count).map(|_| None).collect(),
    }
}

/// Converts [S, n, stored channels] to [S, channels, n].
fn channels_first<T: Real>(x: &[T], n: usize, stored: usize, channels: usize) -> Vec<T> {
    let samples = x.chunks_exact(n * stored);
    samples.flat_map(|x| (0..channels).flat_map(move |c| (0..n).map(move |p| x[p * stored + c]))).collect()
}
