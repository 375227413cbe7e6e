//! The arrays of a golden file.

use crate::{Error, Result, io};
use safetensors::tensor::{Dtype, SafeTensors};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A safetensors file of real arrays, converted to double precision.
pub struct Golden {
    path: PathBuf,
    origin: String,
    arrays: BTreeMap<String, Array>,
}

struct Array {
    shape: Vec<usize>,
    values: Vec<f64>,
    /// Whether the array has been read.
    read: Cell<bool>,
}

impl Golden {
    /// Reads a file. Fails unless it is a safetensors file of finite F32 or F64 numbers.
    pub fn open(path: &Path) -> Result<Self> {
        let origin = path.display().to_string();
        let bytes = io::read_bytes(path)?;
        let file = SafeTensors::deserialize(&bytes)
            .map_err(|e| Error::invalid(&origin, "header", "a complete safetensors file", e))?;
        let mut arrays = BTreeMap::new();
        for (name, view) in file.iter() {
            let values: Vec<f64> = match view.dtype() {
                Dtype::F32 => view.data().chunks_exact(4).map(|b| f32_at(b).into()).collect(),
                Dtype::F64 => view.data().chunks_exact(8).map(f64_at).collect(),
                other => return Err(Error::invalid(&origin, name, "dtype F32 or F64", format!("{other:?}"))),
            };
            if let Some(wrong) = values.iter().find(|v| !v.is_finite()) {
                return Err(Error::invalid(&origin, name, "finite numbers", wrong));
            }
            let array = Array { shape: view.shape().to_vec(), values, read: Cell::new(false) };
            arrays.insert(name.to_owned(), array);
        }
        Ok(Self { path: path.to_owned(), origin, arrays })
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is an array of that name.
    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// Returns the names of all arrays.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.arrays.keys().map(String::as_str)
    }

    /// Returns the names of the arrays that have not been read.
    pub fn unread(&self) -> impl Iterator<Item = &str> {
        self.arrays.iter().filter(|(_, array)| !array.read.get()).map(|(name, _)| name.as_str())
    }

    /// Marks the arrays whose names start with `prefix` as read.
    pub fn mark_read(&self, prefix: &str) {
        let of_prefix = self.arrays.iter().filter(|(name, _)| name.starts_with(prefix));
        of_prefix.for_each(|(_, array)| array.read.set(true));
    }

    /// Returns the shape and the values of an array, and marks it as read.
    pub fn array(&self, name: &str) -> Result<(&[usize], &[f64])> {
        match self.arrays.get(name) {
            Some(Array { shape, values, read }) => {
                read.set(true);
                Ok((shape, values))
            }
            None => {
                let there: Vec<&str> = self.arrays.keys().map(String::as_str).collect();
                Err(Error::invalid(&self.origin, name, "an array of that name", there.join(", ")))
            }
        }
    }

    /// Returns the values of an array that must have `shape`.
    pub fn shaped(&self, name: &str, shape: &[usize]) -> Result<&[f64]> {
        let (found, values) = self.array(name)?;
        if found != shape {
            return Err(Error::invalid(&self.origin, name, format!("shape {shape:?}"), format!("{found:?}")));
        }
        Ok(values)
    }

    /// Returns the shape of an array that must have N axes, none of them empty.
    pub fn shape<const N: usize>(&self, name: &str) -> Result<[usize; N]> {
        let (found, _) = self.array(name)?;
        match <[usize; N]>::try_from(found) {
            Ok(shape) if !shape.contains(&0) => Ok(shape),
            _ => {
                Err(Error::invalid(&self.origin, name, format!("{N} axes, none empty"), format!("{found:?}")))
            }
        }
    }
}

fn f32_at(bytes: &[u8]) -> f32 {
    f32::from_le_bytes(bytes.try_into().expect("a chunk of four bytes"))
}

fn f64_at(bytes: &[u8]) -> f64 {
    f64::from_le_bytes(bytes.try_into().expect("a chunk of eight bytes"))
}
