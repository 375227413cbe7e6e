//! The complete state of one rank of a run as a file.

use super::pool::Slot;
use crate::{Error, Result, io};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

/// Format name in the metadata, with the version that this program writes and reads.
const FORMAT: &str = "fnopt-training-1";

/// Named single-precision tensors, as saved and loaded by a [`super::Learner`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors {
    origin: String,
    tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
}

impl Tensors {
    /// Adds a tensor. Panics if the name is taken or the shape does not match the number of values.
    pub fn insert(&mut self, name: impl Into<String>, shape: &[usize], values: Vec<f32>) {
        let name = name.into();
        assert_eq!(shape.iter().product::<usize>(), values.len(), "tensor '{name}' has another shape");
        let before = self.tensors.insert(name, (shape.to_vec(), values));
        assert!(before.is_none(), "a tensor is saved twice");
    }

    /// Returns the values of a tensor. Fails if it is missing or has another shape.
    pub fn get(&self, name: &str, shape: &[usize]) -> Result<&[f32]> {
        let wrong = |found: String| {
            Error::invalid(&self.origin, format!("tensor '{name}'"), format!("shape {shape:?}"), found)
        };
        match self.tensors.get(name) {
            Some((found, values)) if found == shape => Ok(values),
            Some((found, _)) => Err(wrong(format!("{found:?}"))),
            None => Err(wrong("no such tensor".into())),
        }
    }
}

/// The host's part of a run's state.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Counters {
    /// Number of steps done.
    pub step: u64,
    /// Number of steps that changed the weights.
    pub updates: u64,
    /// Number of consecutive steps up to `step` that were skipped; missing in older files.
    #[serde(default)]
    pub skipped_in_a_row: u32,
    /// Training time of all sessions \[s\].
    pub seconds: f64,
    /// Whether a validation is due after the last step.
    #[serde(default)]
    pub validation_due: bool,
    /// Name of the device of the last session; missing in older files.
    #[serde(default)]
    pub device: String,
    /// Number of ranks that train together; missing in files that predate ranks.
    #[serde(default = "one")]
    pub ranks: usize,
    /// Progress of each cloth of each pool.
    pub pools: Vec<Vec<Slot>>,
}

fn one() -> usize {
    1
}

/// A checkpoint of a run, or one rank's part of it: weights and counters are the same on all ranks, pools
/// differ.
pub(super) struct Checkpoint {
    /// The configuration, as TOML.
    pub config: String,
    /// State of the host.
    pub counters: Counters,
    /// State of the learner.
    pub tensors: Tensors,
}

impl Checkpoint {
    /// Writes the file atomically.
    pub fn write(&self, path: &Path) -> Result<()> {
        let counters = serde_json::to_string(&self.counters).expect("counters are plain data");
        let checksum = checksum([self.config.as_bytes(), counters.as_bytes()], self.views());
        let metadata = [
            ("format", FORMAT.to_owned()),
            ("config", self.config.clone()),
            ("counters", counters),
            ("checksum", checksum),
        ];
        let metadata: HashMap<_, _> = metadata.into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
        let bytes = safetensors::serialize(self.views(), Some(metadata)).map_err(std::io::Error::other);
        let bytes = bytes.map_err(|e| Error::io(path, "cannot write", e))?;
        io::write_atomic(path, |file| file.write_all(&bytes))
    }

    /// Reads a file. Fails if it is of another kind or version, or damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = io::read_bytes(path)?;
        let origin = path.display().to_string();
        let damaged = |e: &dyn std::fmt::Display| {
            Error::invalid(&origin, "checkpoint", "a whole one", format!("{e} ({} bytes)", bytes.len()))
        };
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| damaged(&e))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|e| damaged(&e))?;
        let metadata = header.metadata().clone().unwrap_or_default();
        let field = |name: &str| metadata.get(name).map_or("", String::as_str);
        if field("format") != FORMAT {
            let found = format!("'{}'", field("format"));
            return Err(Error::invalid(&origin, "metadata 'format'", FORMAT, found));
        }
        let mut views: Vec<(&str, TensorView<'_>)> = file.iter().collect();
        views.sort_by_key(|(name, _)| *name);
        let texts = [field("config").as_bytes(), field("counters").as_bytes()];
        let found = checksum(texts, views.iter().map(|(name, view)| (*name, view.clone())));
        if found != field("checksum") {
            return Err(Error::invalid(&origin, "checksum", field("checksum"), found));
        }
        let counters: Counters = serde_json::from_str(field("counters"))
            .map_err(|e| Error::invalid(&origin, "metadata 'counters'", "those of a run", e))?;
        let Counters { step, updates, .. } = counters;
        if updates > step {
            let expected = format!("at most {step} updates in {step} steps");
            return Err(Error::invalid(&origin, "metadata 'counters'", expected, updates));
        }
        let mut tensors = Tensors { origin, ..Tensors::default() };
        for (name, view) in views {
            if view.dtype() != Dtype::F32 {
                let (field, found) = (format!("tensor '{name}'"), format!("{:?}", view.dtype()));
                return Err(Error::invalid(&tensors.origin, field, "dtype F32", found));
            }
            tensors.insert(name, view.shape(), bytemuck::pod_collect_to_vec(view.data()));
        }
        Ok(Self { config: field("config").to_owned(), counters, tensors })
    }

    fn views(&self) -> impl Iterator<Item = (&str, TensorView<'_>)> {
        self.tensors.tensors.iter().map(|(name, (shape, values))| {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytemuck::cast_slice(values));
            (&name[..], view.expect("a tensor has the number of elements of its shape"))
        })
    }
}

/// Returns the CRC-32 of texts, tensor names and tensor data.
fn checksum<'a>(texts: [&[u8]; 2], tensors: impl Iterator<Item = (&'a str, TensorView<'a>)>) -> String {
    let mut hasher = crc32fast::Hasher::new();
    for text in texts {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text);
    }
    for (name, view) in tensors {
        hasher.update(name.as_bytes());
        hasher.update(view.data());
    }
    format!("{:08x}", hasher.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Checkpoint {
        let mut tensors = Tensors::default();
        tensors.insert("b", &[2, 2], vec![1.0, f32::NAN, -0.0, 1e-42]);
        tensors.insert("a", &[3], vec![0.1, 0.2, 0.3]);
        let counters = Counters { step: 7, pools: vec![vec![Slot::default(); 3]], ..Counters::default() };
        Checkpoint { config: "seed = 3".into(), counters, tensors }
    }

    #[test]
    fn a_checkpoint_is_restored_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.safetensors");
        let written = example();
        written.write(&path).unwrap();
        let read = Checkpoint::read(&path).unwrap();
        assert_eq!((&read.config, &read.counters), (&written.config, &written.counters));
        let bits = |c: &Checkpoint, name, shape: &[usize]| {
            c.tensors.get(name, shape).unwrap().iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(bits(&read, "b", &[2, 2]), bits(&written, "b", &[2, 2]));
        assert_eq!(bits(&read, "a", &[3]), bits(&written, "a", &[3]));
        let error = read.tensors.get("a", &[4]).unwrap_err().to_string();
        assert!(error.contains("tensor 'a'") && error.contains("[4]") && error.contains("c.saf"), "{error}");
    }

    #[test]
    fn a_checkpoint_from_before_there_were_ranks_is_of_one() {
        let mut counters = serde_json::to_value(example().counters).unwrap();
        counters.as_object_mut().unwrap().remove("ranks").unwrap();
        assert_eq!(serde_json::from_value::<Counters>(counters).unwrap().ranks, 1);
    }

    #[test]
    fn any_damaged_byte_and_any_cut_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.safetensors");
        example().write(&path).unwrap();
        let good = std::fs::read(&path).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0x10;
            std::fs::write(&path, bad).unwrap();
            // A change in the header's padding may go unnoticed; a change in anything that is read may not.
            if let Ok(read) = Checkpoint::read(&path) {
                assert_eq!(read.config, "seed = 3", "byte {at}");
                assert_eq!(read.counters, example().counters, "byte {at}");
                assert_eq!(read.tensors.get("a", &[3]).unwrap(), [0.1, 0.2, 0.3], "byte {at}");
                let b = |c: &Checkpoint| {
                    c.tensors.get("b", &[2, 2]).unwrap().iter().map(|v| v.to_bits()).collect::<Vec<_>>()
                };
                assert_eq!(b(&read), b(&example()), "byte {at}");
            }
            std::fs::write(&path, &good[..at]).unwrap();
            assert!(Checkpoint::read(&path).is_err(), "cut at {at}");
        }
    }
}
