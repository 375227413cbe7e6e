//! Pairs of layers that one dispatch computes, if their weights do not change.

use super::parameters::Layers;
use super::{Config, Keep, Plan, Weights};
use crate::Result;
use crate::gpu::{Context, Tensor};
use crate::kernels::operator::{Layer, block};
use crate::kernels::optim::features;

/// The weights that fused layers read.
#[derive(Default)]
pub(super) struct Fused {
    /// Those of the last block and of the last layer of the field head, if the head's first layer is the
    /// identity ([`Weights::folded`]).
    pub head: Option<Layer>,
    /// Those of the first layer of the lifting, for a kernel that computes both of its layers.
    pub units: Option<Tensor>,
}

impl Fused {
    /// Uploads those of `weights` that can be fused under `plan`. `layers` are all layers on the device,
    /// padded to the sizes of `config`.
    pub fn new(
        context: &Context,
        weights: &Weights,
        (config, layers): (Config, &Layers),
        plan: &Plan,
    ) -> Result<Self> {
        let padded = |values: &[f32], len: usize| {
            let mut values = values.to_vec();
            values.resize(len, 0.0);
            values
        };
        let head = if plan.keep == Keep::Nothing && weights.is_folded() {
            let last = weights.blocks.len() - 1;
            let [_, outer] = &weights.projection;
            let [bias, head] =
                [&weights.blocks[last].bias, &outer.weight].map(|values| padded(values, config.channels));
            let bias = block::with_head(&bias, (&head, outer.bias[0]));
            let bias = Tensor::from_slice(context, "bias and head", &[bias.len()], &bias)?;
            Some(Layer { weight: layers.skips[last].weight.clone(), bias })
        } else {
            None
        };
        let units = if plan.keep != Keep::Adjoint && config.inputs() == features::CHANNELS {
            let [inner, _] = &weights.lifting;
            let (weight, bias) = (
                padded(&inner.weight, config.lifting * config.inputs()),
                padded(&inner.bias, config.lifting),
            );
            let units = block::hidden_units(&weight, &bias);
            let shape = [config.lifting, units.len() / config.lifting];
            Some(Tensor::from_slice(context, "hidden units", &shape, &units)?)
        } else {
            None
        };
        Ok(Self { head, units })
    }
}
