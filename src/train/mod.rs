//! Training (paper sections 3.3 and 4): the network learns to be an optimizer from physics alone, on cloths that it
//! simulates itself.
//!
//! # One training step
//!
//! ```text
//! Pool::draw       which cloths, with their handles' targets; which begin anew; which end their frame with this step
//! Learner::step    gradient g -> update rule -> a + step -> energy -> backward -> AdamW; the cloths' arrays stay there
//! Pool::record     counts iterations and frames; begins cloths anew that went wrong
//! Pool::rotate     now and then begins the next cloth anew in any case
//! ```
//!
//! The host ([`Pool`]) holds a few whole numbers per cloth. All that is random about a cloth, its [`Script`], follows
//! from the seed and the numbers of its pool, slot and life; the cloths of a batch follow from the seed and the number of
//! the step. So a run's random state *is* its seed and its counters, and a run resumed from a checkpoint continues to the
//! same bits. The device ([`Learner`]) holds positions, velocities, accelerations and the optimizer's memory, and tells a
//! few numbers per cloth after each step.
//!
//! # A run
//!
//! [`Run`] is a folder and what goes on in it:
//!
//! | file | holds |
//! |---|---|
//! | `config.toml` | the exact configuration ([`Config`]), its paths made absolute |
//! | `metrics.csv` | means over `log_every` steps: loss, its terms and the log mean absolute gradient of each pool, gradient norm, speed |
//! | `validation.csv` | each rollout of each validation |
//! | `plot.png` | both as curves |
//! | `checkpoints/` | the last three whole states of the run, to resume from with as many ranks; a file for each rank |
//! | `run.lock` | nothing; locked by the process that trains in the folder, and of no meaning afterwards |
//! | `weights/best.safetensors`, `last.safetensors` | weights (averaged, if that is on), each with a model card in JSON |
//!
//! # Several ranks
//!
//! Several processes can train one network together, each with pools of its own ([`Ranks`]); with the crate's feature `mpi`
//! MPI connects them. Rank 0 writes the folder, and its losses are those in `metrics.csv`; the gradient norm is that of all.

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
pub use initial::{first_weights, initial_weights};
pub use learner::{Batch, Drawn, Learner, Outcome, StepReport, Update, learner};
pub use pool::{MAX_HANDLES, Pool};
pub use ranks::{Alone, Ranks, ranks};
pub use run::{End, Limits, Progress, Run};
pub use schedule::{Decay, RateSchedule};
pub use script::Script;
pub use validation::{SceneScore, Validation};
