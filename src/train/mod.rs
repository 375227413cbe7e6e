//! Training (paper sections 3.3 and 4): the network learns to be an optimizer from physics alone, on cloths
//! that it simulates itself.
//!
//! # One training step
//!
//! ```text
//! Pool::draw       which cloths, with their handles' targets; which restart; which end their frame with this step
//! Learner::step    gradient g -> update rule -> a + step -> energy -> backward -> AdamW; the cloths' arrays stay there
//! Pool::record     counts iterations and frames; restarts cloths that went wrong
//! Pool::rotate     restarts the next cloth now and then, in any case
//! ```
//!
//! The host ([`Pool`]) holds a few integers per cloth. Everything random about a cloth, its [`Script`],
//! follows from the seed and the indices of its pool, slot and life; the cloths of a batch follow from the
//! seed and the index of the step. So a run's random state *is* its seed and its counters, and a run resumed
//! from a checkpoint continues bit for bit. The device ([`Learner`]) holds positions, velocities,
//! accelerations and the hidden state of the optimizer, and reports a few numbers per cloth after each step.
//!
//! # A run
//!
//! [`Run`] is a folder and the training that takes place in it:
//!
//! | file | contents |
//! |---|---|
//! | `config.toml` | the exact configuration ([`Config`]), with absolute paths |
//! | `metrics.csv` | means over `log_every` steps: loss, energy terms and log mean absolute gradient of each pool, gradient norm, speed |
//! | `validation.csv` | one row per rollout of each validation |
//! | `plot.png` | both tables as curves |
//! | `checkpoints/` | the last three complete states of the run, one file per rank; resuming needs the same number of ranks |
//! | `run.lock` | empty; locked by the process that trains in the folder, meaningless afterwards |
//! | `weights/best.safetensors`, `last.safetensors` | weights (averaged, if enabled), each with a model card in JSON |
//!
//! # Several ranks
//!
//! Several processes can train one network together, each with its own pools ([`Ranks`]), connected by MPI if
//! the crate's feature `mpi` is enabled. Rank 0 writes the folder. `metrics.csv` holds rank 0's losses and
//! the gradient norm over all ranks.

mod arrays;
mod card;
mod checkpoint;
mod config;
mod cpu;
mod device;
mod folder;
mod gpu;
mod initial;
mod learner;
mod metrics;
#[cfg(feature = "mpi")]
mod mpi;
mod plot;
mod pool;
mod random;
mod ranks;
mod read;
mod records;
mod run;
mod schedule;
mod script;
mod table;
mod validation;

pub use arrays::Arrays;
pub use checkpoint::Tensors;
pub use config::{
    AdamWOptions, Config, Every, MaterialRanges, MotionRanges, PoolConfig, Range, ResetRules,
    ValidationConfig,
};
pub use device::{DeviceAdamW, DeviceLoss};
pub use initial::{initial_weights, random_weights};
pub use learner::{Batch, Drawn, Learner, Outcome, StepReport, WeightUpdate, learner};
pub use pool::{MAX_HANDLES, Pool};
pub use ranks::{Alone, Ranks, ranks};
pub use run::{End, Limits, Progress, Run};
pub use schedule::{Decay, RateSchedule};
pub use script::Script;
pub use validation::{SceneScore, Validation};
