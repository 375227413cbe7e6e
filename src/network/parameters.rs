//! The weights on a device: one vector in the order and with the padding that the kernels expect. Every layer
//! is a view of it. Training works on the vector, the kernels on the views.

use super::{Config, Weights};
use crate::Result;
use crate::gpu::{Context, Storage, Tensor, Tuning};
use crate::kernels::CHANNEL_MULTIPLE;
use crate::kernels::operator::{JoinedLayer, Layer, pointwise, spectral};

/// The weights of a network on a device.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// All weights, with zeros for the padding of the layers.
    pub flat: Tensor,
    layout: Layout,
}

/// The layout of a network's weights in a vector on the device. Channel counts are padded to a multiple of
/// [`CHANNEL_MULTIPLE`]. The weights of the added channels are zero and remain so in training, since nothing
/// flows through these channels in either direction.
#[derive(Clone, Debug)]
pub struct Layout {
    config: Config,
    padded: Config,
    tile: usize,
    lifting: [DensePlace; 2],
    blocks: Vec<BlockPlace>,
    projection: [DensePlace; 2],
    scalar: DensePlace,
    len: usize,
}

/// First elements of a layer's weight and bias, and its padded sizes.
#[derive(Clone, Copy, Debug)]
struct DensePlace {
    weight: usize,
    bias: usize,
    outputs: usize,
    inputs: usize,
}

#[derive(Clone, Copy, Debug)]
struct BlockPlace {
    product: usize,
    skip: DensePlace,
}

/// The layers of a network, most as an `L`: their weights ([`Layer`]) or their gradient ([`JoinedLayer`]).
#[derive(Clone, Debug)]
pub(super) struct Layers<L = Layer> {
    pub lifting: [L; 2],
    pub skips: Vec<L>,
    /// Shape [modes, C / 2, C, 4].
    pub products: Vec<Tensor>,
    pub projection: [L; 2],
    /// Kernels that compute it besides other things can bind one tensor more this way.
    pub scalar: JoinedLayer,
}

impl Layout {
    /// Returns the number of output channels of a tile, on which the order of the parameters depends.
    pub fn tile(&self) -> usize {
        self.tile
    }

    /// Builds the layout of a network of these sizes, for kernels with tiles of `most` channels
    /// ([`Tuning::channels`]), or of the largest smaller power of two that divides all layers.
    pub fn new(config: Config, most: usize) -> Self {
        let up = |n: usize| n.next_multiple_of(CHANNEL_MULTIPLE);
        let (l, c, p) = (up(config.lifting), up(config.channels), up(config.projection));
        let tile = 1 << [most, l, c, p].map(usize::trailing_zeros).into_iter().min().unwrap_or(0);
        let mut len = 0;
        let mut take = |n: usize| {
            let first = len;
            len = (len + n).next_multiple_of(Tensor::VIEW_ALIGNMENT);
            first
        };
        let products: Vec<usize> = (0..config.layers).map(|_| take(config.modes() * c * c * 2)).collect();
        let mut dense = |outputs: usize, inputs: usize| {
            let weight = take(outputs * inputs);
            DensePlace { weight, bias: take(outputs), outputs, inputs }
        };
        let lifting = [dense(l, config.inputs()), dense(c, l)];
        let blocks = products.into_iter().map(|product| BlockPlace { product, skip: dense(c, c) }).collect();
        let projection = [dense(p, c), dense(1, p)];
        let scalar = dense(1, c);
        let padded = Config { lifting: l, channels: c, projection: p, ..config };
        Self { config, padded, tile, lifting, blocks, projection, scalar, len }
    }

    /// Returns the number of elements of the vector.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether the vector is empty.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the sizes including the added channels.
    pub fn padded(&self) -> Config {
        self.padded
    }

    /// Returns the place of every weight in the vector, in the order of [`Weights::flat`].
    fn places(&self) -> Vec<usize> {
        let Config { lifting, channels: c, projection, .. } = self.config;
        let dense = |place: &DensePlace, outputs: usize, inputs: usize| {
            // The only row of a head is a plain vector.
            let tile = if place.outputs == 1 { 1 } else { self.tile };
            let (first, sizes) = (place.weight, (place.inputs, tile));
            let row = move |o| (0..inputs).map(move |i| first + pointwise::index(o, i, sizes));
            let weight: Vec<usize> = (0..outputs).flat_map(row).collect();
            let bias: Vec<usize> = (place.bias..place.bias + outputs).collect();
            [weight, bias]
        };
        let product = |first: usize| {
            let sizes = (self.padded.channels, self.padded.channels);
            let modes = self.config.modes();
            let of = move |io: usize| {
                (0..modes).map(move |mode| first + spectral::index(mode, (io / c, io % c), sizes))
            };
            (0..c * c).flat_map(of).flat_map(|at| [at, at + 1]).collect::<Vec<usize>>()
        };
        let mut places = dense(&self.lifting[0], lifting, self.config.inputs()).concat();
        places.extend(dense(&self.lifting[1], c, lifting).concat());
        for block in &self.blocks {
            let [skip, bias] = dense(&block.skip, c, c);
            places.extend([product(block.product), bias, skip].concat());
        }
        places.extend(dense(&self.projection[0], projection, c).concat());
        places.extend(dense(&self.projection[1], 1, projection).concat());
        places.extend(dense(&self.scalar, 1, c).concat());
        places
    }

    /// Converts a vector from the order of [`Weights::flat`] to the device's.
    pub fn to_device(&self, host: &[f32]) -> Vec<f32> {
        let places = self.places();
        assert_eq!(places.len(), host.len(), "the vector has the size of the weights");
        let mut device = vec![0.0; self.len];
        places.into_iter().zip(host).for_each(|(at, &value)| device[at] = value);
        device
    }

    /// Converts a vector from the device's order back to that of [`Weights::flat`].
    pub fn to_host(&self, device: &[f32]) -> Vec<f32> {
        assert_eq!(device.len(), self.len, "the vector has the size of the layout");
        self.places().into_iter().map(|at| device[at]).collect()
    }

    /// Uploads the layers of `weights` in the context's storage: views of one vector in single precision, or
    /// separate tensors, of which biases and heads with one output remain in single precision.
    pub(super) fn stored_layers(&self, context: &Context, weights: &Weights) -> Result<Layers> {
        let device = self.to_device(&weights.flat());
        if context.storage() == Storage::F32 {
            return self.layers(&Tensor::from_slice(context, "weights", &[self.len], &device)?);
        }
        let single = |first: usize, shape: &[usize]| {
            let values = &device[first..][..shape.iter().product()];
            Tensor::from_slice(context, "weight", shape, values)
        };
        let stored = |first: usize, shape: &[usize]| -> Result<Tensor> {
            let tensor = Tensor::stored_zeros(context, "weight", shape)?;
            tensor.write_narrowed(context, &device[first..][..tensor.len()]);
            Ok(tensor)
        };
        let layer = |place: &DensePlace| -> Result<Layer> {
            let shape = self.weight_shape(place);
            let weight =
                if place.outputs == 1 { single(place.weight, &shape) } else { stored(place.weight, &shape) };
            Ok(Layer { weight: weight?, bias: single(place.bias, &[place.outputs])? })
        };
        let joined = |first: usize, len: usize| single(first, &[len]);
        self.each_layer(layer, stored, joined)
    }

    /// Makes a `Layers` of what `layer` makes of the place of each layer, `product` of the first element and
    /// the shape of each spectral product, and `joined` of the first element and the length of the scalar head.
    fn each_layer<L>(
        &self,
        layer: impl Fn(&DensePlace) -> Result<L>,
        product: impl Fn(usize, &[usize]) -> Result<Tensor>,
        joined: impl Fn(usize, usize) -> Result<Tensor>,
    ) -> Result<Layers<L>> {
        let c = self.padded.channels;
        let shape = [self.config.modes(), c / 2, c, 4];
        let (first, bias) = (self.scalar.weight, self.scalar.bias - self.scalar.weight);
        let pair = |[first, second]: &[DensePlace; 2]| Ok([layer(first)?, layer(second)?]);
        Ok(Layers {
            lifting: pair(&self.lifting)?,
            skips: self.blocks.iter().map(|b| layer(&b.skip)).collect::<Result<_>>()?,
            products: self.blocks.iter().map(|b| product(b.product, &shape)).collect::<Result<_>>()?,
            projection: pair(&self.projection)?,
            // Whole quads: the elements after the bias are padding, too.
            scalar: JoinedLayer { weight_and_bias: joined(first, (bias + 1).next_multiple_of(4))?, bias },
        })
    }

    /// Returns the shape of a layer's weight in the order of the kernels. A head with one output is a plain
    /// vector.
    fn weight_shape(&self, place: &DensePlace) -> Vec<usize> {
        let &DensePlace { outputs, inputs, .. } = place;
        if outputs == 1 { vec![inputs] } else { vec![outputs / self.tile, inputs, self.tile] }
    }

    /// Returns the layers as views of a vector on the device.
    pub(super) fn layers(&self, flat: &Tensor) -> Result<Layers> {
        assert_eq!(flat.len(), self.len, "the vector has the size of the layout");
        let layer = |place: &DensePlace| {
            let weight = flat.view(place.weight, &self.weight_shape(place));
            Ok(Layer { weight, bias: flat.view(place.bias, &[place.outputs]) })
        };
        let view = |first, shape: &[usize]| Ok(flat.view(first, shape));
        self.each_layer(layer, view, |first, len| view(first, &[len]))
    }

    /// Returns the layers of a gradient on the device, as the adjoint kernels write them.
    pub(super) fn gradient_layers(&self, flat: &Tensor) -> Result<Layers<JoinedLayer>> {
        assert_eq!(flat.len(), self.len, "the vector has the size of the layout");
        let layer = |place: &DensePlace| {
            let bias = place.bias - place.weight;
            // Whole quads: the elements after the bias are padding, too.
            let len = (bias + place.outputs).next_multiple_of(4);
            Ok(JoinedLayer { weight_and_bias: flat.view(place.weight, &[len]), bias })
        };
        let view = |first, shape: &[usize]| Ok(flat.view(first, shape));
        self.each_layer(layer, view, |first, len| view(first, &[len]))
    }
}

impl Parameters {
    /// Uploads weights.
    pub fn new(context: &Context, weights: &Weights, tuning: &Tuning) -> Result<Self> {
        let layout = Layout::new(weights.config, tuning.channels);
        let flat = layout.to_device(&weights.flat());
        Ok(Self { flat: Tensor::from_slice(context, "weights", &[layout.len], &flat)?, layout })
    }

    /// Returns the layout of the weights.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }
}

#[cfg(test)]
mod tests {
    use super::{Config, Layout, Weights};

    #[test]
    fn every_weight_has_its_own_place() {
        let config = Config { lifting: 40, channels: 12, projection: 20, layers: 2, ..Default::default() };
        let layout = Layout::new(config, 16);
        let mut places = layout.places();
        assert_eq!(places.len(), Weights::zeros(config).parameter_count());
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), Weights::zeros(config).parameter_count());
        assert!(places.last().is_some_and(|&last| last < layout.len()));
        let host: Vec<f32> = (0..places.len()).map(|k| k as f32).collect();
        assert_eq!(layout.to_host(&layout.to_device(&host)), host);
    }

    /// They used to be laid out like a head, which has one output even with the added ones.
    #[test]
    fn layers_of_one_output_are_laid_out_in_tiles() {
        let config = Config { lifting: 40, channels: 1, ..Default::default() };
        let places = Layout::new(config, 16).places();
        let of_first = 40 * (config.fields + 2) + 40;
        let second = &places[of_first..of_first + 40];
        assert!(second.windows(2).all(|pair| pair[1] - pair[0] == 16), "{second:?}");
    }
}
