//! Points: reading them from arrays, and arithmetic.

use crate::{Error, Result};
use ndarray::ArrayD;

/// Returns the rows of an array of shape [.., 3] as points, in row-major order. Fails if a number is not
/// finite.
pub(super) fn from_array(origin: &str, array: &ArrayD<f64>) -> Result<Vec<[f64; 3]>> {
    let flat: Vec<f64> = array.iter().copied().collect();
    if let Some(k) = flat.iter().position(|v| !v.is_finite()) {
        let field = format!("row {}, component {}", k / 3, k % 3);
        return Err(Error::invalid(origin, field, "a finite number", flat[k]));
    }
    Ok(flat.as_chunks::<3>().0.to_vec())
}

/// Combines two points component by component with `f`.
pub(super) fn zip(a: [f64; 3], b: [f64; 3], f: impl Fn(f64, f64) -> f64) -> [f64; 3] {
    std::array::from_fn(|c| f(a[c], b[c]))
}

/// Returns the length of a vector.
pub(super) fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}
