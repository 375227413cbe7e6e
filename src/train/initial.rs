//! Initial weights.

use super::config::Config;
use super::random::{Purpose, generator};
use super::ranks::Ranks;
use crate::network::{self, Weights};
use crate::{Error, Result};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use std::f64::consts::TAU;
use std::path::PathBuf;

/// Returns the initial weights of a run: the mean of those in the files `init`, or fresh ones. All ranks get
/// rank 0's, because logarithms and cosines may differ between machines in the last bit.
pub fn initial_weights(config: &Config, ranks: &dyn Ranks) -> Result<Weights> {
    let mut flat = match &config.init[..] {
        [] => random_weights(config.network, config.seed).flat(),
        files => mean(config, files)?,
    };
    ranks.broadcast(bytemuck::cast_slice_mut(&mut flat));
    Ok(Weights::from_flat(config.network, &flat))
}

/// Returns the mean of the weights in these files. Fails if a file cannot be read or is of a network of other
/// sizes.
fn mean(config: &Config, files: &[PathBuf]) -> Result<Vec<f32>> {
    let mut sums: Vec<f64> = Vec::new();
    for path in files {
        let weights = Weights::load(path)?;
        if weights.config != config.network {
            let (field, [expected, found]) = differing(&config.network, &weights.config);
            let expected = format!("{expected}, as in the configuration");
            return Err(Error::invalid(
                path.display().to_string(),
                format!("network.{field}"),
                expected,
                found,
            ));
        }
        let flat = weights.flat();
        sums.resize(flat.len(), 0.0);
        sums.iter_mut().zip(&flat).for_each(|(sum, &w)| *sum += f64::from(w));
    }
    Ok(sums.iter().map(|sum| (sum / files.len() as f64) as f32).collect())
}

/// Returns the first size in which two networks differ, and its values.
fn differing(ours: &network::Config, theirs: &network::Config) -> (String, [String; 2]) {
    let sizes = |config| serde_json::to_value(config).expect("sizes are plain numbers");
    let (ours, theirs) = (sizes(ours), sizes(theirs));
    let all = ours.as_object().expect("sizes have names");
    let field = all.keys().find(|field| ours[*field] != theirs[*field]).expect("the networks differ");
    (field.clone(), [&ours, &theirs].map(|sizes| sizes[field].to_string()))
}

/// Draws random weights like the authors' implementation (the defaults of neuraloperator and PyTorch).
///
/// Pointwise layers, skips and the scalar head: weights and biases uniform within `1 / sqrt(inputs)` of 0
/// (the skips have no bias). Spectral weights: complex normal numbers of variance
/// `2 / (channels + channels)`, half of it in each part. Biases of the blocks: real normal numbers of the
/// same variance.
pub fn random_weights(config: network::Config, seed: u64) -> Weights {
    let random = &mut generator(seed, Purpose::Weights, 0);
    let mut weights = Weights::zeros(config);
    let Weights { lifting, blocks, projection, scalar, .. } = &mut weights;
    for dense in lifting.iter_mut().chain(projection).chain([scalar]) {
        let inputs = dense.weight.len() / dense.bias.len();
        uniform(random, &mut dense.weight, inputs);
        uniform(random, &mut dense.bias, inputs);
    }
    let deviation = (config.channels as f64).sqrt().recip();
    for block in blocks {
        normal(random, &mut block.spectral, deviation * 0.5f64.sqrt());
        normal(random, &mut block.bias, deviation);
        uniform(random, &mut block.skip, config.channels);
    }
    weights
}

fn uniform(random: &mut ChaCha8Rng, values: &mut [f32], inputs: usize) {
    let bound = (inputs as f64).sqrt().recip();
    values.fill_with(|| (bound * (2.0 * random.random::<f64>() - 1.0)) as f32);
}

/// Draws normal numbers by the Box-Muller transform; `1 - u` keeps the logarithm finite.
fn normal(random: &mut ChaCha8Rng, values: &mut [f32], deviation: f64) {
    values.fill_with(|| {
        let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
        (deviation * radius * (TAU * random.random::<f64>()).cos()) as f32
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresh_weights_have_the_spread_of_the_authors() {
        let weights = random_weights(network::Config::default(), 7);
        assert_eq!(weights, random_weights(network::Config::default(), 7));
        assert_ne!(weights, random_weights(network::Config::default(), 8));
        let variance =
            |values: &[f32]| values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / values.len() as f64;
        // A uniform number within b has variance b^2 / 3.
        let near =
            |value: f64, exact: f64| assert!((value / exact - 1.0).abs() < 0.1, "{value}, not {exact}");
        near(variance(&weights.lifting[0].weight), 1.0 / 15.0);
        near(variance(&weights.projection[0].weight), 1.0 / 192.0);
        near(variance(&weights.blocks[2].skip), 1.0 / 192.0);
        near(variance(&weights.blocks[1].spectral), 0.5 / 64.0);
        assert!(weights.lifting[0].weight.iter().all(|w| w.abs() <= 0.2f32.sqrt()));
    }
}
