//! Checkpoints: safetensors files with the weights under the names of the authors' state dict.
//!
//! Names may carry the prefix `nn.`. Complex tensors are pairs of reals on a last axis of 2, or complex
//! numbers. The configuration comes from the metadata (key `config`, JSON) if present, else from the shapes.

use super::weights::{Block, Config, Dense, MAX_LAYERS, Weights, diagonal};
use crate::{Error, Result, io};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::io::Write;
use std::path::Path;

/// A checkpoint file in memory. Its tensors are in single precision, whatever the precision of the file.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    origin: String,
    tensors: BTreeMap<String, Tensor>,
    metadata: BTreeMap<String, String>,
}

#[derive(Clone, Debug)]
struct Tensor {
    dtype: Dtype,
    /// Shape, with complex numbers as a last axis of 2.
    shape: Vec<usize>,
    values: Vec<f32>,
}

impl Checkpoint {
    /// Reads a file, which may be any safetensors file of floating-point tensors.
    pub fn open(path: &Path) -> Result<Self> {
        let bytes = io::read_bytes(path)?;
        Self::from_bytes(&bytes, &path.display().to_string())
    }

    /// Reads a file from memory; `origin` names it in errors.
    pub fn from_bytes(bytes: &[u8], origin: &str) -> Result<Self> {
        let broken = |e: safetensors::SafeTensorError| {
            let found = format!("{e} ({} bytes)", bytes.len());
            Error::invalid(origin, "header", "a complete safetensors file", found)
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let file = SafeTensors::deserialize(bytes).map_err(broken)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            tensors.insert(name.to_owned(), Tensor::read(&view, origin, name)?);
        }
        let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
        Ok(Self { origin: origin.to_owned(), tensors, metadata })
    }

    /// Returns the tensors whose names begin with `prefix`, with the prefix removed: several sets of weights
    /// may share a file.
    pub fn part(&self, prefix: &str) -> Self {
        let under = |(name, tensor): (&String, &Tensor)| {
            Some((name.strip_prefix(prefix)?.to_owned(), tensor.clone()))
        };
        Self {
            origin: format!("{}: {prefix}*", self.origin),
            tensors: self.tensors.iter().filter_map(under).collect(),
            metadata: self.metadata.clone(),
        }
    }

    /// Returns the weights of the network. Fails if a tensor is missing, unknown, of the wrong shape or not
    /// finite.
    pub fn weights(&self) -> Result<Weights> {
        if self.metadata.contains_key("counters") {
            let expected = "weights (see weights/last.safetensors and best.safetensors in the run's folder)";
            return Err(Error::invalid(&self.origin, "checkpoint", expected, "the state of a training run"));
        }
        let config = match self.metadata.get("config") {
            Some(json) => self.config_from_json(json)?,
            None => self.config_from_shapes()?,
        };
        let Config { channels: c, layers, modes_h, modes_w, .. } = config;
        let mut reader = Reader { checkpoint: self, used: Vec::new() };
        let mut dense = |stem: &str, outputs: usize, inputs: usize| {
            Ok::<_, Error>(Dense {
                weight: reader.take(&format!("{stem}.weight"), &[outputs, inputs])?,
                bias: reader.take(&format!("{stem}.bias"), &[outputs])?,
            })
        };
        let lifting = [
            dense("lifting.fcs.0", config.lifting, config.inputs())?,
            dense("lifting.fcs.1", c, config.lifting)?,
        ];
        let projection = [
            dense("projection.fcs.0", config.projection, c)?,
            dense("projection.fcs.1", 1, config.projection)?,
        ];
        let scalar = dense("out_scalar", 1, c)?;
        let biases = reader.take("fno_blocks.convs.bias", &[layers, c])?;
        let mut blocks = Vec::new();
        for (n, bias) in biases.chunks_exact(c).enumerate() {
            let spectral = reader.take(&spectral_name(n), &[c, c, modes_h, modes_w, 2])?;
            let gate = gate_name(n);
            let skip = if self.find(&gate).is_some() {
                diagonal(&reader.take(&gate, &[1, c])?)
            } else {
                reader.take(&format!("fno_blocks.fno_skips.{n}.conv.weight"), &[c, c])?
            };
            blocks.push(Block { spectral, bias: bias.to_vec(), skip });
        }
        reader.finish()?;
        Ok(Weights { config, lifting, blocks, projection, scalar })
    }

    /// Returns a readable description of the file's contents.
    pub fn describe(&self) -> Description {
        let tensors = self.tensors.iter().map(|(name, t)| t.summary(name)).collect();
        Description { metadata: self.metadata.clone(), tensors }
    }

    fn find(&self, name: &str) -> Option<(&String, &Tensor)> {
        self.tensors.get_key_value(name).or_else(|| self.tensors.get_key_value(&format!("nn.{name}")))
    }

    fn config_from_json(&self, json: &str) -> Result<Config> {
        let config: Config = serde_json::from_str(json)
            .map_err(|e| Error::invalid(&self.origin, "metadata 'config'", "a network configuration", e))?;
        self.checked(config, "metadata 'config'")
    }

    fn config_from_shapes(&self) -> Result<Config> {
        let sizes = |name: &str, rank: usize, expected: &str| {
            let (name, tensor) = self.require(name)?;
            if tensor.shape.len() < rank {
                let found = format!("{:?}", tensor.shape);
                return Err(Error::invalid(&self.origin, name, format!("shape {expected}"), found));
            }
            Ok(&tensor.shape)
        };
        let lifting = sizes("lifting.fcs.0.weight", 2, "[hidden, inputs, 1]")?;
        let projection = sizes("projection.fcs.0.weight", 2, "[hidden, channels, 1]")?;
        let spectral = sizes(&spectral_name(0), 4, "[channels, channels, modes_h, modes_w, 2]")?;
        let layers = (0..=MAX_LAYERS).take_while(|&n| self.find(&spectral_name(n)).is_some()).count();
        let config = Config {
            fields: lifting[1].saturating_sub(2),
            lifting: lifting[0],
            channels: spectral[0],
            projection: projection[0],
            layers,
            modes_h: spectral[2],
            modes_w: spectral[3],
        };
        self.checked(config, "tensor shapes")
    }

    fn checked(&self, config: Config, field: &str) -> Result<Config> {
        config.check(&self.origin, field)?;
        Ok(config)
    }

    fn require(&self, name: &str) -> Result<(&String, &Tensor)> {
        self.find(name).ok_or_else(|| {
            let found = format!("none among {} tensors", self.tensors.len());
            Error::invalid(&self.origin, format!("tensor '{name}'"), "a tensor with this name", found)
        })
    }
}

/// Takes tensors from a checkpoint by name and records which ones were used.
struct Reader<'a> {
    checkpoint: &'a Checkpoint,
    used: Vec<&'a str>,
}

impl Reader<'_> {
    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let origin = &self.checkpoint.origin;
        let (name, tensor) = self.checkpoint.require(name)?;
        if significant(&tensor.shape) != significant(shape) {
            let (expected, found) = (format!("shape {shape:?}"), format!("{:?}", tensor.shape));
            return Err(Error::invalid(origin, format!("tensor '{name}'"), expected, found));
        }
        if let Some(at) = tensor.values.iter().position(|v| !v.is_finite()) {
            let found = format!("{} at element {at}", tensor.values[at]);
            return Err(Error::invalid(origin, format!("tensor '{name}'"), "finite numbers", found));
        }
        self.used.push(name);
        Ok(tensor.values.clone())
    }

    /// Fails if a tensor was not used.
    fn finish(self) -> Result<()> {
        match self.checkpoint.tensors.keys().find(|name| !self.used.contains(&name.as_str())) {
            Some(name) => {
                Err(Error::unknown(&self.checkpoint.origin, "tensor", name, self.used.iter().copied()))
            }
            None => Ok(()),
        }
    }
}

/// Strips a shape's trailing axes of length 1, which the authors' convolutions carry.
fn significant(shape: &[usize]) -> &[usize] {
    &shape[..shape.iter().rposition(|&n| n != 1).map_or(0, |last| last + 1)]
}

fn spectral_name(block: usize) -> String {
    format!("fno_blocks.convs.weight.{block}.tensor")
}

impl Tensor {
    fn read(view: &TensorView<'_>, origin: &str, name: &str) -> Result<Self> {
        fn convert<const N: usize>(bytes: &[u8], f: impl Fn([u8; N]) -> f32) -> Vec<f32> {
            bytes.chunks_exact(N).map(|b| f(b.try_into().expect("a chunk has its size"))).collect()
        }
        let bytes = view.data();
        let values = match view.dtype() {
            Dtype::F32 | Dtype::C64 => convert(bytes, f32::from_le_bytes),
            Dtype::F64 => convert(bytes, |b| f64::from_le_bytes(b) as f32),
            Dtype::F16 => convert(bytes, |b| half::f16::from_le_bytes(b).to_f32()),
            Dtype::BF16 => convert(bytes, |b| half::bf16::from_le_bytes(b).to_f32()),
            other => {
                let field = format!("tensor '{name}'");
                return Err(Error::invalid(
                    origin,
                    field,
                    "dtype F64, F32, F16, BF16 or C64",
                    format!("{other:?}"),
                ));
            }
        };
        let mut shape = view.shape().to_vec();
        if view.dtype() == Dtype::C64 {
            shape.push(2);
        }
        Ok(Self { dtype: view.dtype(), shape, values })
    }

    fn summary(&self, name: &str) -> TensorSummary {
        let values = self.values.iter().map(|&v| v as f64);
        let finite = values.clone().filter(|v| v.is_finite());
        TensorSummary {
            name: name.to_owned(),
            shape: self.shape.clone(),
            dtype: format!("{:?}", self.dtype),
            norm: values.clone().map(|v| v * v).sum::<f64>().sqrt(),
            min: finite.clone().reduce(f64::min).unwrap_or(f64::NAN),
            max: finite.reduce(f64::max).unwrap_or(f64::NAN),
            non_finite: values.filter(|v| !v.is_finite()).count(),
        }
    }
}

/// Returns the name of the soft gate of a block's skip.
fn gate_name(block: usize) -> String {
    format!("fno_blocks.fno_skips.{block}.weight")
}

/// The contents of a checkpoint, tensor by tensor. Displays as a table.
#[derive(Clone, Debug)]
pub struct Description {
    /// Metadata of the file, such as `config` and `format`.
    pub metadata: BTreeMap<String, String>,
    /// Tensors in the order of their names.
    pub tensors: Vec<TensorSummary>,
}

/// One tensor of a [`Description`].
#[derive(Clone, Debug, serde::Serialize)]
pub struct TensorSummary {
    /// Name in the file.
    pub name: String,
    /// Shape, with complex numbers as a last axis of 2.
    pub shape: Vec<usize>,
    /// Number type in the file.
    pub dtype: String,
    /// Euclidean norm.
    pub norm: f64,
    /// Smallest finite element; NaN if there is none.
    pub min: f64,
    /// Largest finite element; NaN if there is none.
    pub max: f64,
    /// Number of elements that are NaN or infinite.
    pub non_finite: usize,
}

impl Description {
    /// Returns the kind of the skips around the spectral products: `soft-gating` or `linear`. A soft gate is
    /// loaded as its diagonal matrix.
    pub fn skip(&self) -> &'static str {
        let gates = self.tensors.iter().any(|t| t.name.ends_with(&gate_name(0)));
        if gates { "soft-gating" } else { "linear" }
    }

    /// Returns the number of real parameters in all tensors.
    pub fn parameter_count(&self) -> usize {
        self.tensors.iter().map(|t| t.shape.iter().product::<usize>()).sum()
    }
}

impl fmt::Display for Description {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (key, value) in &self.metadata {
            writeln!(f, "{key}: {value}")?;
        }
        let width = self.tensors.iter().map(|t| t.name.len()).max().unwrap_or(0);
        for t in &self.tensors {
            let shape = format!("{:?}", t.shape);
            write!(f, "{:width$}  {:5} {shape:20}", t.name, t.dtype)?;
            write!(f, " norm {:<11.4e} min {:<11.4e} max {:<11.4e}", t.norm, t.min, t.max)?;
            match t.non_finite {
                0 => writeln!(f)?,
                n => writeln!(f, " {n} NOT FINITE")?,
            }
        }
        write!(f, "{} tensors, {} real parameters", self.tensors.len(), self.parameter_count())
    }
}

impl Weights {
    /// Reads the weights of a checkpoint file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        Checkpoint::open(path.as_ref())?.weights()
    }

    /// Reads the weights of a checkpoint in memory; `origin` names it in errors.
    pub fn from_bytes(bytes: &[u8], origin: &str) -> Result<Self> {
        Checkpoint::from_bytes(bytes, origin)?.weights()
    }

    /// Writes a checkpoint file with the configuration in its metadata. The file appears completely or not at
    /// all.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        io::replace(path, |w| w.write_all(&self.to_bytes()))
    }

    /// Returns the CRC-32 of the file that [`Weights::save`] writes, which identifies the weights.
    pub fn checksum(&self) -> u32 {
        crc32fast::hash(&self.to_bytes())
    }

    /// Returns the checkpoint file that [`Weights::save`] writes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let tensors: Vec<_> = self
            .named_tensors()
            .into_iter()
            .map(|(name, shape, values)| {
                let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
                (name, shape, bytes)
            })
            .collect();
        let views = tensors.iter().map(|(name, shape, bytes)| {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytes);
            (name, view.expect("a tensor has the number of elements of its shape"))
        });
        let config = serde_json::to_string(&self.config).expect("a configuration is plain data");
        // A single entry: the order of several would vary from run to run, and identical weights would give
        // different files.
        let metadata = HashMap::from([("config".to_owned(), config)]);
        safetensors::serialize(views, Some(metadata)).expect("the weights fit the format")
    }

    /// Returns the number of real parameters; a complex one counts twice.
    pub fn parameter_count(&self) -> usize {
        self.config.parameter_count()
    }

    /// Returns every tensor with its name, shape and values, as in the authors' state dict.
    pub fn named_tensors(&self) -> Vec<(String, Vec<usize>, Vec<f32>)> {
        let Config { channels: c, layers, modes_h, modes_w, .. } = self.config;
        let mut tensors = Vec::new();
        let mut push = |name: &str, shape: &[usize], values: &[f32]| {
            tensors.push((format!("nn.{name}"), shape.to_vec(), values.to_vec()));
        };
        for (head, layers) in [("lifting", &self.lifting), ("projection", &self.projection)] {
            for (n, Dense { weight, bias }) in layers.iter().enumerate() {
                let inputs = weight.len() / bias.len();
                push(&format!("{head}.fcs.{n}.weight"), &[bias.len(), inputs, 1], weight);
                push(&format!("{head}.fcs.{n}.bias"), &[bias.len()], bias);
            }
        }
        push("out_scalar.weight", &[1, c], &self.scalar.weight);
        push("out_scalar.bias", &[1], &self.scalar.bias);
        let biases: Vec<f32> = self.blocks.iter().flat_map(|b| b.bias.iter().copied()).collect();
        push("fno_blocks.convs.bias", &[layers, c, 1, 1], &biases);
        for (n, block) in self.blocks.iter().enumerate() {
            push(&spectral_name(n), &[c, c, modes_h, modes_w, 2], &block.spectral);
            push(&format!("fno_blocks.fno_skips.{n}.conv.weight"), &[c, c, 1], &block.skip);
        }
        tensors
    }
}
