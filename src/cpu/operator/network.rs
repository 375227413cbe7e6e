//! The whole network, from normalised fields to a field and a scalar per sample.

use super::block::Skip;
use super::lifting::Lifting;
use super::projection::Projection;
use super::scalar_head::ScalarHead;
use super::spectral::Spectral;
use super::transform::{ModeParts, Transform};
use super::{band_rows, padded};
use crate::Result;
use crate::cpu::real::Real;
use crate::network::{Config, Weights};
use crate::sim::Grid;
use rayon::prelude::*;

/// A point inside the network whose values [`Network::forward_observed`] shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The fields with the two positional fields behind them, [S, fields + 2, H, W].
    Embedded,
    /// The output of the lifting, [S, C, H, W].
    Lifted,
    /// The output of a Fourier block, after its GELU where it has one, [S, C, H, W].
    Block(usize),
}

/// The network for a number of samples on one grid, with all its working memory.
pub struct Network<T: Real> {
    config: Config,
    grid: Grid,
    /// Channels as they lie in memory.
    channels: usize,
    lifting: Lifting<T>,
    transform: Transform<T>,
    blocks: Vec<(Spectral<T>, Skip<T>)>,
    projection: Projection<T>,
    scalar_head: ScalarHead<T>,
    buffers: Buffers<T>,
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

impl<T: Real> Network<T> {
    /// Lays the weights out for `samples` samples on `grid`; an error if the grid is too small for the kept modes.
    pub fn new(weights: &Weights, grid: Grid, samples: usize) -> Result<Self> {
        let config = weights.config;
        let channels = padded(config.channels);
        let transform = Transform::new(&config, grid, channels)?;
        let blocks: Vec<_> = weights
            .blocks
            .iter()
            .map(|block| (Spectral::new(&config, block), Skip::new(&config, block)))
            .collect();
        let zeros = |n: usize| vec![T::zero(); n];
        let n = grid.particles();
        let buffers = Buffers {
            x: zeros(samples * n * channels),
            y: zeros(samples * n * channels),
            rows: zeros(samples * grid.h * transform.row_len()),
            sums: zeros(samples * transform.column_len()),
            modes: zeros(config.modes() * 4 * samples * channels),
            spectral: zeros(blocks.first().map_or(0, |b| b.0.scratch_len(samples))),
            pooled: zeros(samples * grid.h * channels),
            field: zeros(samples * n),
            scalar: zeros(samples),
        };
        let lifting = Lifting::new(weights, grid);
        let projection = Projection::new(weights);
        let scalar_head = ScalarHead::new(weights);
        Ok(Self { config, grid, channels, lifting, transform, blocks, projection, scalar_head, buffers })
    }

    /// Runs the network on `input` [S, fields, H, W], the normalised gradient, last gradient and last step.
    pub fn forward(&mut self, input: &[T]) {
        self.run(input, &mut |_, _| {});
    }

    /// [`Network::forward`] that also shows each [`Stage`] on the way, channels first.
    pub fn forward_observed(&mut self, input: &[T], observer: &mut dyn FnMut(Stage, &[T])) {
        observer(Stage::Embedded, &self.embedded(input));
        let (c, stored, n) = (self.config.channels, self.channels, self.grid.particles());
        self.run(input, &mut |stage, x| observer(stage, &channels_first(x, n, stored, c)));
    }

    /// The field of the last run, shape [S, 1, H, W].
    pub fn field(&self) -> &[T] {
        &self.buffers.field
    }

    /// The scalars of the last run, shape \[S\].
    pub fn scalar(&self) -> &[T] {
        &self.buffers.scalar
    }

    fn run(&mut self, input: &[T], observer: &mut dyn FnMut(Stage, &[T])) {
        let per_sample = self.config.fields * self.grid.particles();
        assert_eq!(input.len(), self.buffers.scalar.len() * per_sample, "input has shape [S, fields, H, W]");
        self.lift(input);
        observer(Stage::Lifted, &self.buffers.x);
        for index in 0..self.blocks.len() {
            self.mix(index);
            self.finish_block(index);
            std::mem::swap(&mut self.buffers.x, &mut self.buffers.y);
            observer(Stage::Block(index), &self.buffers.x);
        }
        self.scalar_head.apply(&mut self.buffers.scalar, &mut self.buffers.pooled);
    }

    /// Lifting and the row transform, band by band.
    fn lift(&mut self, input: &[T]) {
        let Grid { h, w } = self.grid;
        let (lifting, transform) = (&self.lifting, &self.transform);
        let Buffers { x, rows, scalar, .. } = &mut self.buffers;
        let (band, row) = (band_rows(w), w * self.channels);
        let samples = x.par_chunks_mut(h * row);
        let spectra = rows.par_chunks_mut(h * transform.row_len());
        let fields = input.par_chunks(input.len() / scalar.len());
        samples.zip(spectra).zip(fields).for_each(|((x, spectra), fields)| {
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

    /// The column transform and the spectral product of block `index`.
    fn mix(&mut self, index: usize) {
        let transform = &self.transform;
        let Buffers { rows, sums, modes, spectral, .. } = &mut self.buffers;
        let sample = self.grid.h * transform.row_len();
        let modes_w = self.config.modes_w;
        sums.par_chunks_mut(transform.column_len() / modes_w).enumerate().for_each(|(column, sums)| {
            let rows = &rows[column / modes_w * sample..][..sample];
            transform.column_forward(sums, rows, column % modes_w);
        });
        self.blocks[index].0.apply(modes, sums, transform, spectral);
    }

    /// The rest of block `index`, band by band, and what follows it position by position: the GELU and the row transform
    /// of the next block, or the projection; and the maximum for the scalar head.
    fn finish_block(&mut self, index: usize) {
        let Grid { h, w } = self.grid;
        let (transform, projection, scalar_head) = (&self.transform, &self.projection, &self.scalar_head);
        let (c, row, row_len) = (self.channels, w * self.channels, transform.row_len());
        let band = band_rows(w);
        let skip = &self.blocks[index].1;
        let last = index + 1 == self.blocks.len();
        let pools = index == self.config.scalar_block();
        let Buffers { x, y, rows, modes, pooled, field, scalar, .. } = &mut self.buffers;
        let samples = scalar.len();
        let modes = &*modes;
        let finish_row = |(x, y): (&[T], &mut [T]), (z, pooled, field): Heads<'_, T>, scratch: &mut [T]| {
            skip.row(y, x, z, transform);
            if last {
                projection.apply(field, y, scratch);
            } else {
                T::gelu(y);
                transform.row_forward(z, y);
            }
            if pools {
                scalar_head.pool(pooled, y);
            }
        };
        let activations = x.par_chunks(h * row).zip(y.par_chunks_mut(h * row));
        let heads = rows
            .par_chunks_mut(h * row_len)
            .zip(pooled.par_chunks_mut(h * c))
            .zip(field.par_chunks_mut(h * w));
        activations.zip(heads).enumerate().for_each(|(sample, ((x, y), ((rows, pooled), field)))| {
            let activations = x.par_chunks(band * row).zip(y.par_chunks_mut(band * row));
            let heads = rows
                .par_chunks_mut(band * row_len)
                .zip(pooled.par_chunks_mut(band * c))
                .zip(field.par_chunks_mut(band * w));
            activations.zip(heads).enumerate().for_each_init(
                || projection.scratch(),
                |scratch, (index, ((x, y), ((rows, pooled), field)))| {
                    let parts = ModeParts { values: modes, samples, sample };
                    transform.column_inverse(rows, index * band, parts);
                    let activations = x.chunks_exact(row).zip(y.chunks_exact_mut(row));
                    let heads = rows
                        .chunks_exact_mut(row_len)
                        .zip(pooled.chunks_exact_mut(c))
                        .zip(field.chunks_exact_mut(w));
                    for (activations, ((z, pooled), field)) in activations.zip(heads) {
                        finish_row(activations, (z, pooled, field), scratch);
                    }
                },
            );
        });
    }

    /// The inputs of the lifting, shape [S, fields + 2, H, W].
    fn embedded(&self, input: &[T]) -> Vec<T> {
        let Grid { h, w } = self.grid;
        let (inputs, n) = (self.config.inputs(), h * w);
        let mut embedded = Vec::with_capacity(input.len() / self.config.fields * inputs);
        for fields in input.chunks_exact(self.config.fields * n) {
            let mut positions = vec![T::zero(); n * inputs];
            for (p, at) in positions.chunks_exact_mut(inputs).enumerate() {
                self.lifting.embed(at, fields, p / w, p % w);
            }
            embedded.extend(channels_first(&positions, n, inputs, inputs));
        }
        embedded
    }
}

/// What a row of a block's output goes on to: its spectrum, its maxima, its part of the field.
type Heads<'a, T> = (&'a mut [T], &'a mut [T], &'a mut [T]);

/// [S, n, stored channels] to [S, channels, n].
fn channels_first<T: Real>(x: &[T], n: usize, stored: usize, channels: usize) -> Vec<T> {
    let samples = x.chunks_exact(n * stored);
    samples.flat_map(|x| (0..channels).flat_map(move |c| (0..n).map(move |p| x[p * stored + c]))).collect()
}
