//! Arrays of points.

use crate::{Error, Result};
use ndarray::ArrayD;

/// The rows of an array of shape [.., 3] as finite points, in row-major order.
pub(super) fn points(origin: &str, array: &ArrayD<f64>) -> Result<Vec<[f64; 3]>> {
    let flat: Vec<f64> = array.iter().copied().collect();
    if let Some(k) = flat.iter().position(|v| !v.is_finite()) {
        let field = format!("row {}, component {}", k / 3, k % 3);
        return Err(Error::invalid(origin, field, "a finite number", flat[k]));
    }
    Ok(flat.as_chunks::<3>().0.to_vec())
}
