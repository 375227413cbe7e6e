//! Golden files, computed with the authors' implementation or from the equations in double precision.

use fnopt::network::Weights;
use safetensors::{Dtype, SafeTensors};
use std::path::{Path, PathBuf};

/// A golden file in memory.
pub struct Golden(Vec<u8>);

pub fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.safetensors"))
}

/// Loads the perturbed weights of the network and update-rule files.
pub fn weights() -> Weights {
    Weights::load(path("network_weights")).unwrap()
}

impl Golden {
    pub fn open(name: &str) -> Self {
        Self(std::fs::read(path(name)).unwrap())
    }

    pub fn has(&self, name: &str) -> bool {
        SafeTensors::deserialize(&self.0).unwrap().tensor(name).is_ok()
    }

    pub fn shape(&self, name: &str) -> Vec<usize> {
        SafeTensors::deserialize(&self.0).unwrap().tensor(name).unwrap().shape().to_vec()
    }

    pub fn get(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(name).unwrap();
        match tensor.dtype() {
            Dtype::F32 => {
                tensor.data().chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()).into()).collect()
            }
            Dtype::F64 => {
                tensor.data().chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
            }
            other => panic!("{name} is {other:?}"),
        }
    }
}

/// Returns the largest difference over the largest magnitude of `expected`.
pub fn relative_error(found: &[f64], expected: &[f64]) -> f64 {
    largest_difference(found, expected) / expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()))
}

/// Returns the largest difference, or infinity if one of them is NaN.
pub fn largest_difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let differences = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
    differences.fold(0.0, |m: f64, d| if d.is_nan() { f64::INFINITY } else { m.max(d) })
}

/// Converts single precision to double.
pub fn widened(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| v.into()).collect()
}

/// Converts double precision to single.
pub fn narrowed(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}
