//! The configuration of a training run.

use super::read;
use super::schedule::{Decay, RateSchedule};
use crate::cloth::Grid;
use crate::cpu::train::AdamWSettings;
use crate::settings::Normalisation;
use crate::{Result, io, network};
use std::path::{Path, PathBuf};

/// A training run: its pools, optimizer, length and monitoring. The default is the paper's recipe
/// (section 4).
///
/// Read from TOML by [`Config::parse`]. Omitted fields take their defaults; unknown fields are errors.
///
/// | field | default |
/// |---|---|
/// | `notes` | empty; a text for the model cards |
/// | `seed`, `steps`, `log_every`, `average` | 1, 500000, 50, 0 |
/// | `normalisation` | `"component"`; or `"cloth"` ([`Normalisation`]) |
/// | `init` | fresh weights; or a safetensors file, relative to the configuration, or several to average |
/// | `[network]` `lifting`, `channels`, `projection`, `layers`, `modes_h`, `modes_w` | 256, 64, 64, 4, 8, 5 |
/// | `[[pool]]` `grid`, `iterations`, `cloths`, `batch` | four pools of 1, 3, 10 and 30 iterations; in an explicit pool `[32, 32]`, 10, 1000, 10 (at most `cloths`) |
/// | `[[pool]]` `sequence_length`, `corners`, `every` | that of `[reset]`, that of `[motion]`, 1 |
/// | `[pool.material]` `stretch`, `shear`, `bend` | `[100, 1000]`, `[1, 100]`, `[0.01, 10]` |
/// | `[motion]` `moving`, `rotation`, `amplitude`, `frequency`, `pinch`, `gravity`, `aligned`, `corners`, `more_handles`, `damping` | 0.8, 0.0628, 10, 0.2, 0.4, 0.125, 0, 1, 0.5, 0 |
/// | `[reset]` `energy`, `sequence_length`, `scale` | 20000, 1000, unbounded |
/// | `[optimizer]` `rate`, `betas`, `epsilon`, `weight_decay`, `clip` | 1e-3, `[0.9, 0.999]`, 1e-8, 0.01, 1 |
/// | `[schedule]` `warmup`, `decay` | 0, `{ halvings = [125000, 250000, 375000] }`; or `"none"`, `{ cosine = { final = 1e-5 } }` |
/// | `[validation]` `every`, `frames`, `iterations`, `grids` | `{ minutes = 15 }`, 60, 10, `[[32, 32], [64, 64], [100, 100], [48, 32]]` |
/// | `[checkpoint]` `every` | `{ minutes = 10 }`; or `{ steps = 1000 }` |
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Config {
    /// Purpose of the run and lessons learned, copied into its model cards.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub notes: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Training steps of the whole run. A cosine decay spans them; halvings are absolute steps.
    pub steps: u64,
    /// Steps averaged into one row of `metrics.csv`, unless a checkpoint comes first.
    pub log_every: u64,
    /// Decay of the running mean of the weights, which is what gets validated and saved; 0 disables
    /// averaging.
    pub average: f64,
    /// Normalisation of the cotangents of a step.
    pub normalisation: Normalisation,
    /// Files of the initial weights, which are averaged; empty for fresh ones ([`super::random_weights`]).
    pub init: Vec<PathBuf>,
    /// Sizes of the network.
    pub network: network::Config,
    /// The pools of cloths.
    #[serde(rename = "pool")]
    pub pools: Vec<PoolConfig>,
    /// Motion of the handles, and gravity.
    pub motion: MotionRanges,
    /// Conditions under which cloths are reset.
    pub reset: ResetRules,
    /// Options of AdamW.
    pub optimizer: AdamWOptions,
    /// Schedule of the learning rate.
    pub schedule: RateSchedule,
    /// Validation rollouts.
    pub validation: ValidationConfig,
    /// How often the state of the run is saved.
    pub checkpoint: Every,
}

/// A pool: cloths on one grid with the same number of iterations per frame.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct PoolConfig {
    /// Particles along the height and the width.
    #[serde(serialize_with = "read::serialize_grid")]
    pub grid: Grid,
    /// Iterations per frame.
    pub iterations: u32,
    /// Cloths in the pool.
    pub cloths: usize,
    /// Cloths drawn in each step.
    pub batch: usize,
    /// Ranges of the materials.
    pub material: MaterialRanges,
    /// Mean life of a cloth of this pool in frames; `None` for [`ResetRules::sequence_length`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sequence_length: Option<u64>,
    /// Probability that the first handles are the two corners; `None` for [`MotionRanges::corners`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corners: Option<f64>,
    /// Number of steps per draw from this pool; above 1 for fine grids, which cost the most.
    pub every: u64,
}

/// An interval `[smallest, largest]` of positive numbers, sampled log-uniformly.
pub type Range = [f64; 2];

/// Ranges of the energy coefficients, drawn once per slot of a pool (grid units).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MaterialRanges {
    /// Stretch coefficient.
    pub stretch: Range,
    /// Shear coefficient.
    pub shear: Range,
    /// Bend coefficient.
    pub bend: Range,
}

/// Ranges of the motion of the handles and of gravity.
///
/// Lengths and accelerations refer to a sheet 31 edges high, the paper's 32x32. On a grid of H rows both are
/// multiplied by (H - 1) / 31, so that sheets on all grids undergo the same motions in metres.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MotionRanges {
    /// Probability that the handles of a cloth move.
    pub moving: f64,
    /// Largest rate of each of the three Euler angles [rad / frame]. Unlike the paper's, whose rotation per
    /// frame is constant, it turns about an axis that moves, at up to twice this rate where two angles act
    /// alike.
    pub rotation: f64,
    /// Largest amplitude of the translation along each axis \[edges\].
    pub amplitude: f64,
    /// Largest angular frequency of translation and pinch [rad / frame].
    pub frequency: f64,
    /// Depth of the pinch p: handles are scaled by `1 - p + p cos(frequency t)`.
    pub pinch: f64,
    /// Magnitude of gravity [edges / frame^2]; its direction is random.
    pub gravity: f64,
    /// Probability that a sheet starts unrotated, with gravity along an axis. This is typical of users'
    /// scenes, and makes whole components of the first gradient zero.
    pub aligned: f64,
    /// Probability that the first handles are the two corners; otherwise the first handle is one random
    /// particle. A pool may [override](PoolConfig::corners) it.
    pub corners: f64,
    /// Probability of adding each further handle, a random particle.
    pub more_handles: f64,
    /// Largest fraction of its velocity that a cloth loses per frame, drawn for each life, so that the pools
    /// also contain cloths at rest. The minimised energy does not include damping.
    pub damping: f64,
}

/// Conditions under which a cloth is reset.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ResetRules {
    /// Largest stretch, shear and bend energy; a cloth above it after an iteration, or with a non-finite
    /// energy, is reset.
    pub energy: f64,
    /// Mean life of a cloth in frames; cloths are reset round-robin. A pool may
    /// [override](PoolConfig::sequence_length) it.
    pub sequence_length: u64,
    /// Allowed interval of the persistent scale; a cloth that leaves it is reset. `None` for no bounds.
    pub scale: Option<Range>,
}

/// AdamW with clipping by gradient norm, as in PyTorch.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct AdamWOptions {
    /// Learning rate.
    pub rate: f64,
    /// All other settings.
    #[serde(flatten)]
    pub settings: AdamWSettings,
}

/// How often something is done.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Every {
    /// At every multiple of this many steps.
    Steps(u64),
    /// Whenever this many minutes have passed since the last time, or since the session started.
    Minutes(f64),
}

/// Rollouts of fixed scenes by which weights are judged ([`super::Validation`]).
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ValidationConfig {
    /// How often to validate. A validation also takes place when a session reaches its limit or the end of
    /// the run, but not when it is interrupted.
    pub every: Every,
    /// Frames of each rollout.
    pub frames: usize,
    /// Iterations per frame.
    pub iterations: usize,
    /// Grids of the hanging sheet; the falling sheet has the finest of them.
    #[serde(serialize_with = "read::serialize_grids")]
    pub grids: Vec<Grid>,
}

impl Default for Config {
    fn default() -> Self {
        let pool = |iterations| PoolConfig { iterations, ..Default::default() };
        Self {
            seed: 1,
            steps: 500_000,
            log_every: 50,
            notes: String::new(),
            average: 0.0,
            normalisation: Normalisation::default(),
            init: Vec::new(),
            network: network::Config::default(),
            pools: [1, 3, 10, 30].map(pool).to_vec(),
            motion: MotionRanges::default(),
            reset: ResetRules::default(),
            optimizer: AdamWOptions::default(),
            schedule: RateSchedule { warmup: 0, decay: Decay::Halvings(vec![125_000, 250_000, 375_000]) },
            validation: ValidationConfig::default(),
            checkpoint: Every::Minutes(10.0),
        }
    }
}

impl Default for PoolConfig {
    fn default() -> Self {
        let (grid, material) = (Grid { h: 32, w: 32 }, MaterialRanges::default());
        Self {
            grid,
            iterations: 10,
            cloths: 1000,
            batch: 10,
            material,
            sequence_length: None,
            corners: None,
            every: 1,
        }
    }
}

impl Default for MaterialRanges {
    fn default() -> Self {
        Self { stretch: [100.0, 1000.0], shear: [1.0, 100.0], bend: [0.01, 10.0] }
    }
}

impl Default for MotionRanges {
    fn default() -> Self {
        Self {
            moving: 0.8,
            rotation: 0.0628,
            amplitude: 10.0,
            frequency: 0.2,
            pinch: 0.4,
            gravity: 0.125,
            aligned: 0.0,
            corners: 1.0,
            more_handles: 0.5,
            damping: 0.0,
        }
    }
}

impl Default for ResetRules {
    fn default() -> Self {
        Self { energy: 20_000.0, sequence_length: 1000, scale: None }
    }
}

impl Default for AdamWOptions {
    fn default() -> Self {
        Self { rate: 1e-3, settings: AdamWSettings::default() }
    }
}

impl Default for ValidationConfig {
    fn default() -> Self {
        let grids = [(32, 32), (64, 64), (100, 100), (48, 32)].map(|(h, w)| Grid { h, w }).to_vec();
        Self { every: Every::Minutes(15.0), frames: 60, iterations: 10, grids }
    }
}

impl Config {
    /// Reads a configuration file. Returns its text, which a run keeps, and the parsed configuration. Paths
    /// in the text are made absolute, so that a copy of it in another folder names the same files.
    pub fn load(path: impl AsRef<Path>) -> Result<(String, Self)> {
        let path = path.as_ref();
        let text = io::read_text(path)?;
        Self::parse(&text, path)?;
        let text = read::absolute_paths(text, path)?;
        let config = Self::parse(&text, path)?;
        Ok((text, config))
    }

    /// Parses a configuration from TOML. `path` names it in errors, and `init` is relative to its folder.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        read::config(text, path)
    }
}
