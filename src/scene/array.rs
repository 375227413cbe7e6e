//! Arrays of floating-point numbers in NumPy's `.npy` format, and the points that they hold.

use crate::{Error, Result};
use ndarray::{ArrayD, IxDyn, ShapeBuilder};
use ndarray_npy::npy::header::Header;
use std::path::Path;

/// A header longer than this is not one of a plain numeric array.
const MAX_HEADER: usize = 4096;

/// Reads a `.npy` file of little-endian `f4` or `f8`.
pub(super) fn read_npy(path: &Path) -> Result<ArrayD<f64>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "cannot read", e))?;
    parse_npy(&path.display().to_string(), &bytes)
}

/// The array in the bytes of a `.npy` file. The size that the header claims is compared with the bytes that are there
/// before anything is allocated for it, so that a damaged file cannot ask for more memory than it has data.
pub(super) fn parse_npy(origin: &str, bytes: &[u8]) -> Result<ArrayD<f64>> {
    let bad = |field: &str, expected: &str, found: String| Error::invalid(origin, field, expected, found);
    let short = bytes.get(8..12).is_some_and(|b| match bytes[6] {
        1 => true,
        _ => u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize <= MAX_HEADER,
    });
    if !short || !bytes.starts_with(b"\x93NUMPY") {
        return Err(bad("header", "a NumPy .npy array", format!("{} bytes that are not one", bytes.len())));
    }
    let mut rest = bytes;
    let header = Header::from_reader(&mut rest)
        .map_err(|e| bad("header", "a NumPy .npy array", e.to_string().replace('\n', " ")))?;
    let descriptor = header.type_descriptor.as_string().map_or("", String::as_str);
    let size = match descriptor {
        "<f4" => 4,
        "<f8" => 8,
        _ => return Err(bad("dtype", "'<f4' or '<f8'", header.type_descriptor.to_string())),
    };
    let length = header.shape.iter().try_fold(size, |n: usize, &d| n.checked_mul(d));
    if length != Some(rest.len()) {
        let expected = format!("the {size} bytes of each number of shape {:?}", header.shape);
        return Err(bad("data", &expected, format!("{} bytes", rest.len())));
    }
    let data: Vec<f64> = match size {
        4 => rest.as_chunks::<4>().0.iter().map(|&b| f64::from(f32::from_le_bytes(b))).collect(),
        _ => rest.as_chunks::<8>().0.iter().map(|&b| f64::from_le_bytes(b)).collect(),
    };
    let shape = IxDyn(&header.shape).set_f(header.layout.is_fortran());
    ArrayD::from_shape_vec(shape, data)
        .map_err(|e| bad("shape", "a shape that an array can have", e.to_string()))
}

/// The rows of an array of shape [.., 3] as finite points, in row-major order.
pub(super) fn points(origin: &str, array: &ArrayD<f64>) -> Result<Vec<[f64; 3]>> {
    let flat: Vec<f64> = array.iter().copied().collect();
    if let Some(k) = flat.iter().position(|v| !v.is_finite()) {
        let field = format!("row {}, component {}", k / 3, k % 3);
        return Err(Error::invalid(origin, field, "a finite number", flat[k]));
    }
    Ok(flat.as_chunks::<3>().0.to_vec())
}
