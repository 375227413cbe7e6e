//! Sizes and weights of the Fourier neural operator (paper section 4).

use crate::cloth::Grid;
use crate::{Error, Result};

/// Sizes of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Fields per sample, without the positional channels: gradient, last gradient, last step.
    pub fields: usize,
    /// Hidden channels of the lifting (256).
    pub lifting: usize,
    /// Channels of the Fourier blocks (64).
    pub channels: usize,
    /// Hidden channels of the projection (64).
    pub projection: usize,
    /// Number of Fourier blocks (4).
    pub layers: usize,
    /// Kept modes: rows `k_h = -modes_h/2 ..= (modes_h-1)/2` (8 of them).
    pub modes_h: usize,
    /// Kept modes: columns `k_w = 0 .. modes_w` (5 of them).
    pub modes_w: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            fields: Self::FIELDS,
            lifting: 256,
            channels: 64,
            projection: 64,
            layers: 4,
            modes_h: 8,
            modes_w: 5,
        }
    }
}

/// Most blocks of a network, beyond any sensible one, so that damaged metadata fails early.
pub(super) const MAX_LAYERS: usize = 64;

impl Config {
    /// Number of fields of the update rule: gradient, last gradient and last step.
    pub const FIELDS: usize = 3;

    /// Fails unless the sizes are positive and bounded, and the fields those of the update rule; `origin` and `field`
    /// name the configuration's source in the error.
    pub(crate) fn check(&self, origin: &str, field: &str) -> Result<()> {
        let Self { fields, lifting, channels, projection, layers, modes_h, modes_w } = *self;
        let sizes = [fields, lifting, channels, projection, layers, modes_h, modes_w];
        if !sizes.iter().all(|n| (1..=1 << 20).contains(n)) || layers > MAX_LAYERS {
            let expected = format!("positive sizes and at most {MAX_LAYERS} layers");
            return Err(Error::invalid(origin, field, expected, format!("{self:?}")));
        }
        if self.fields == Self::FIELDS {
            return Ok(());
        }
        let expected = format!("{} fields: gradient, last gradient and last step", Self::FIELDS);
        Err(Error::invalid(origin, field, expected, self.fields))
    }

    /// Fails unless the grid can represent the kept modes; `origin` and `field` name the grid's source in the
    /// error.
    pub fn check_grid(&self, grid: Grid, origin: &str, field: &str) -> Result<()> {
        let Self { modes_h, modes_w, .. } = *self;
        if modes_h <= grid.h && modes_w <= grid.w / 2 + 1 {
            return Ok(());
        }
        let expected = format!("at least {modes_h}x{} for {modes_h}x{modes_w} modes", 2 * modes_w - 2);
        Err(Error::invalid(origin, field, expected, grid))
    }

    /// Returns the number of input channels: the fields and two positional channels.
    pub fn inputs(&self) -> usize {
        self.fields + 2
    }

    /// Returns the number of kept modes per channel.
    pub fn modes(&self) -> usize {
        self.modes_h * self.modes_w
    }

    /// Returns the floating-point operations of one pass over one sample on `grid`, with a multiply-add
    /// counted as two: pointwise layers, truncated transforms as matrix products, spectral products.
    pub fn flop(&self, grid: Grid) -> f64 {
        let n = grid.particles() as f64;
        let [lifting, channels, projection] =
            [self.lifting, self.channels, self.projection].map(|c| c as f64);
        let (inputs, modes) = (self.inputs() as f64, self.modes() as f64);
        let pointwise = inputs * lifting + lifting * channels + channels * projection + projection;
        let rows = 2.0 * self.modes_w as f64 * channels * n;
        let columns = 4.0 * modes * channels * grid.h as f64;
        let block = channels * channels * n + 2.0 * (rows + columns) + 4.0 * modes * channels * channels;
        2.0 * (pointwise * n + self.layers as f64 * block)
    }

    /// Returns the number of real parameters; a complex one counts twice.
    pub fn parameter_count(&self) -> usize {
        let Self { lifting, channels: c, projection, layers, .. } = *self;
        let dense = |inputs: usize, outputs: usize| (inputs + 1) * outputs;
        let heads = dense(c, projection) + dense(projection, 1) + dense(c, 1);
        let block = c * c * 2 * self.modes() + dense(c, c);
        dense(self.inputs(), lifting) + dense(lifting, c) + layers * block + heads
    }

    /// Returns the index of the block whose output feeds the scalar head: the last but one, or 0 if there is
    /// only one.
    pub fn scalar_block(&self) -> usize {
        self.layers.saturating_sub(2)
    }
}

/// A pointwise layer: `y = weight x + bias`.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense {
    /// Weight, shape [out, in].
    pub weight: Vec<f32>,
    /// Bias, shape `[out]`.
    pub bias: Vec<f32>,
}

impl Dense {
    /// Whether the layer is the identity.
    fn is_identity(&self) -> bool {
        let n = self.bias.len();
        self.bias.iter().all(|&b| b == 0.0) && self.weight == diagonal(&vec![1.0; n])
    }
}

/// Returns a diagonal matrix as a weight, shape [n, n].
pub(super) fn diagonal(values: &[f32]) -> Vec<f32> {
    let n = values.len();
    let mut weight = vec![0.0; n * n];
    weight.iter_mut().step_by(n + 1).zip(values).for_each(|(w, &value)| *w = value);
    weight
}

/// A Fourier block: `y = K(x) + S x + bias`.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Complex weight of the spectral product, shape [in, out, modes_h, modes_w, 2].
    pub spectral: Vec<f32>,
    /// Bias, shape `[channels]`.
    pub bias: Vec<f32>,
    /// Weight of the skip `S`, shape [out, in]. A soft gate is stored as its diagonal matrix.
    pub skip: Vec<f32>,
}

/// All weights of the network, in single precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Sizes.
    pub config: Config,
    /// The two layers of the lifting, `inputs -> lifting -> channels`.
    pub lifting: [Dense; 2],
    /// The Fourier blocks.
    pub blocks: Vec<Block>,
    /// The two layers of the field head, `channels -> projection -> 1`.
    pub projection: [Dense; 2],
    /// The scalar head, `channels -> 1`.
    pub scalar: Dense,
}

/// The checkpoint file of [`Weights::shipped`].
#[cfg(feature = "weights")]
const SHIPPED: &[u8] = include_bytes!("../../assets/weights/fnopt.safetensors");

impl Weights {
    /// Returns the trained weights that ship with the crate (feature `weights`).
    #[cfg(feature = "weights")]
    pub fn shipped() -> Self {
        Self::from_bytes(SHIPPED, "the weights that come with the program")
            .expect("they are checked before they ship")
    }

    /// Fails if the sizes are not those of a network of the update rule, or if a parameter does not have the length that
    /// they require. `origin` names the weights' source.
    pub fn check(&self, origin: &str) -> Result<()> {
        self.config.check(origin, "network")?;
        let Config { lifting, channels: c, projection, layers, .. } = self.config;
        if self.blocks.len() != layers {
            return Err(Error::invalid(origin, "blocks", format!("{layers} of them"), self.blocks.len()));
        }
        let dense = |outputs: usize, inputs: usize| [outputs.saturating_mul(inputs), outputs];
        let spectral = c.saturating_mul(c).saturating_mul(self.config.modes().saturating_mul(2));
        let block = [spectral, c, c.saturating_mul(c)];
        let layers = [dense(lifting, self.config.inputs()), dense(c, lifting)].concat().into_iter();
        let heads = [dense(projection, c), dense(1, projection), dense(1, c)].concat();
        let expected = layers.chain(self.blocks.iter().flat_map(|_| block)).chain(heads);
        for ((name, found), expected) in self.parameter_names().iter().zip(self.parameters()).zip(expected) {
            if found.len() != expected {
                let expected = format!("{expected} numbers for {:?}", self.config);
                return Err(Error::invalid(origin, name, expected, found.len()));
            }
        }
        Ok(())
    }

    /// Returns weights that are all zero.
    pub fn zeros(config: Config) -> Self {
        let dense = |outputs: usize, inputs: usize| Dense {
            weight: vec![0.0; outputs * inputs],
            bias: vec![0.0; outputs],
        };
        let c = config.channels;
        let block = || Block {
            spectral: vec![0.0; c * c * config.modes() * 2],
            bias: vec![0.0; c],
            skip: vec![0.0; c * c],
        };
        Self {
            config,
            lifting: [dense(config.lifting, config.inputs()), dense(c, config.lifting)],
            blocks: (0..config.layers).map(|_| block()).collect(),
            projection: [dense(config.projection, c), dense(1, config.projection)],
            scalar: dense(1, c),
        }
    }

    /// Returns an equivalent network that needs less work. The last block and the first layer of the
    /// projection have nothing between them, so the layer is multiplied into the block and replaced by the
    /// identity. Returns the network unchanged if the layer is not square, or if the scalar head reads that
    /// block.
    pub fn folded(&self) -> Self {
        let mut folded = self.clone();
        let Config { channels: c, projection, layers, .. } = self.config;
        if projection != c || layers < 2 {
            return folded;
        }
        let first = &self.projection[0];
        let weight = |to: usize, from: usize| f64::from(first.weight[to * c + from]);
        let (block, last) = (&self.blocks[layers - 1], &mut folded.blocks[layers - 1]);
        for to in 0..c {
            let of = |value: &dyn Fn(usize) -> f32| {
                (0..c).map(|from| weight(to, from) * f64::from(value(from))).sum::<f64>()
            };
            last.bias[to] = (of(&|from| block.bias[from]) + f64::from(first.bias[to])) as f32;
            for input in 0..c {
                last.skip[to * c + input] = of(&|from| block.skip[from * c + input]) as f32;
            }
        }
        let numbers = 2 * self.config.modes();
        let inputs =
            last.spectral.chunks_exact_mut(c * numbers).zip(block.spectral.chunks_exact(c * numbers));
        for (new, old) in inputs {
            let mut sums = vec![0.0; numbers];
            for (to, new) in new.chunks_exact_mut(numbers).enumerate() {
                sums.fill(0.0);
                for (from, old) in old.chunks_exact(numbers).enumerate() {
                    let factor = weight(to, from);
                    sums.iter_mut().zip(old).for_each(|(sum, &z)| *sum += factor * f64::from(z));
                }
                new.iter_mut().zip(&sums).for_each(|(z, &sum)| *z = sum as f32);
            }
        }
        folded.projection[0] = Dense { weight: diagonal(&vec![1.0; c]), bias: vec![0.0; c] };
        folded
    }

    /// Whether the first layer of the projection is the identity and can be skipped, as after
    /// [`Weights::folded`].
    pub fn is_folded(&self) -> bool {
        self.config.layers > 1 && self.projection[0].is_identity()
    }

    /// Returns all parameters in a fixed order: lifting, blocks (spectral, bias, skip), projection, scalar
    /// head. Training works on their concatenation, [`Weights::flat`].
    pub fn parameters(&self) -> Vec<&[f32]> {
        let mut all: Vec<&[f32]> = Vec::new();
        for d in &self.lifting {
            all.extend([&d.weight[..], &d.bias]);
        }
        for b in &self.blocks {
            all.extend([&b.spectral[..], &b.bias, &b.skip]);
        }
        for d in self.projection.iter().chain([&self.scalar]) {
            all.extend([&d.weight[..], &d.bias]);
        }
        all
    }

    /// Returns the names of [`Weights::parameters`], after the authors' state dict.
    pub fn parameter_names(&self) -> Vec<String> {
        let dense = |stem: &str| [format!("{stem}.weight"), format!("{stem}.bias")];
        let mut names: Vec<String> =
            ["lifting.fcs.0", "lifting.fcs.1"].iter().flat_map(|s| dense(s)).collect();
        for n in 0..self.blocks.len() {
            names.push(format!("fno_blocks.convs.weight.{n}"));
            names.push(format!("fno_blocks.convs.bias[{n}]"));
            names.push(format!("fno_blocks.fno_skips.{n}.conv.weight"));
        }
        names.extend(["projection.fcs.0", "projection.fcs.1", "out_scalar"].iter().flat_map(|s| dense(s)));
        names
    }

    /// Returns [`Weights::parameters`] for writing.
    pub fn parameters_mut(&mut self) -> Vec<&mut [f32]> {
        let mut all: Vec<&mut [f32]> = Vec::new();
        for d in &mut self.lifting {
            all.extend([&mut d.weight[..], &mut d.bias]);
        }
        for b in &mut self.blocks {
            all.extend([&mut b.spectral[..], &mut b.bias, &mut b.skip]);
        }
        for d in self.projection.iter_mut().chain([&mut self.scalar]) {
            all.extend([&mut d.weight[..], &mut d.bias]);
        }
        all
    }

    /// Concatenates all parameters in the order of [`Weights::parameters`].
    pub fn flat(&self) -> Vec<f32> {
        self.parameters().concat()
    }

    /// Builds weights from a vector, the inverse of [`Weights::flat`]. Panics if the number of parameters
    /// differs.
    pub fn from_flat(config: Config, flat: &[f32]) -> Self {
        let mut weights = Self::zeros(config);
        let mut rest = flat;
        for parameter in weights.parameters_mut() {
            let (head, tail) = rest.split_at(parameter.len());
            parameter.copy_from_slice(head);
            rest = tail;
        }
        assert!(rest.is_empty(), "{} parameters too many", rest.len());
        weights
    }
}
