//! The processes that train one network together.

use crate::{Error, Result};
use std::fmt::Display;
use std::rc::Rc;

/// The processes that train one network together, seen from one of them. Each is a *rank*, numbered from 0.
///
/// All hold the same weights and AdamW's memory of them. Each has pools of its own, simulated from a seed of its own
/// ([`Ranks::seed`]), and takes part in every step with the gradient of its own batches ([`Ranks::join`]). Rank 0
/// alone measures, writes the files of the run and decides when something ends ([`Ranks::decide`]); the others only write
/// their part of each checkpoint.
///
/// All methods but `rank`, `count`, `on_machine`, `seed` and `abort` must be called by all ranks, in the same order.
pub trait Ranks {
    /// The number of this rank.
    fn rank(&self) -> usize;

    /// How many ranks there are.
    fn count(&self) -> usize;

    /// The number of this rank among those on its machine, who share its adapters out.
    fn on_machine(&self) -> usize;

    /// Replaces `values`, of one length on all ranks, by their sums over the ranks: the same bits on each.
    fn sum(&self, values: &mut [f32]);

    /// Replaces `bytes`, as many on all ranks, by those of rank 0.
    fn broadcast(&self, bytes: &mut [u8]);

    /// Tells `error` and ends all ranks, which would wait for this one for ever. Returns where there is no other, so that
    /// the error goes its usual way.
    fn abort(&self, error: &dyn Display);

    /// The seed of this rank's pools in a run with this seed: `seed + rank 2^32`. That of rank 0 is the run's.
    fn seed(&self, seed: u64) -> u64 {
        seed.wrapping_add((self.rank() as u64) << 32)
    }

    /// Makes the gradient over all weights of this rank's loss that of the sum of all ranks' losses. As the loss of one
    /// learner is the sum over its pools, ranks are together one learner with the pools of all of them. (And because every
    /// component, or every cloth, weighs the same on the way back, also one with larger batches: it is not divided by the number of ranks.) If
    /// a loss is not finite, the gradient is not either, on any rank, so that all skip the step alike.
    fn join(&self, gradient: &mut [f32], loss: f64) {
        if !loss.is_finite() && self.count() > 1 {
            gradient.fill(f32::NAN);
        }
        self.sum(gradient);
    }

    /// Rank 0's number.
    fn first(&self, number: u64) -> u64 {
        let mut bytes = number.to_le_bytes();
        self.broadcast(&mut bytes);
        u64::from_le_bytes(bytes)
    }

    /// Rank 0's decision.
    fn decide(&self, yes: bool) -> bool {
        self.first(u64::from(yes)) == 1
    }

    /// Whether all ranks say yes. None goes on before all have come here.
    fn all(&self, yes: bool) -> bool {
        let mut no = [f32::from(u8::from(!yes))];
        self.sum(&mut no);
        no == [0.0]
    }
}

/// A process that trains on its own; nothing is exchanged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn on_machine(&self) -> usize {
        0
    }

    fn sum(&self, _: &mut [f32]) {}

    fn broadcast(&self, _: &mut [u8]) {}

    fn abort(&self, _: &dyn Display) {}
}

/// The ranks of this job: those that `mpirun` or `srun` started, with the crate's feature `mpi`; without it one process
/// [`Alone`].
#[cfg(feature = "mpi")]
pub fn ranks() -> Result<Rc<dyn Ranks>> {
    match super::mpi::Mpi::new() {
        Some(ranks) => Ok(Rc::new(ranks)),
        None => Err(Error::Device("MPI was started before or cannot be started".into())),
    }
}

/// The ranks of this job: those that `mpirun` or `srun` started, with the crate's feature `mpi`; without it one process
/// [`Alone`]. An error if a launcher started several, which would all write the same files.
#[cfg(not(feature = "mpi"))]
pub fn ranks() -> Result<Rc<dyn Ranks>> {
    for name in ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"] {
        let count = std::env::var(name).ok().and_then(|count| count.parse::<u64>().ok());
        if let Some(several @ 2..) = count {
            let expected = "1, as this program was built without the feature mpi";
            return Err(Error::invalid(name, "ranks", expected, several));
        }
    }
    Ok(Rc::new(Alone))
}
