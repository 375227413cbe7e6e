//! The processes that train one network together.

use crate::{Error, Result};
use std::fmt::Display;
use std::rc::Rc;

/// The processes that train one network together, as seen by one of them. Each is a *rank*, numbered from 0.
///
/// All ranks hold the same weights and AdamW moments. Each has its own pools, simulated from its own seed
/// ([`Ranks::seed`]), and contributes the gradient of its own batches to every step
/// ([`Ranks::sum_gradients`]). Rank 0 alone measures, writes the files of the run and decides when to stop
/// ([`Ranks::decide`]); the others only write their part of each checkpoint.
///
/// Every call of a method other than `rank`, `count`, `local_rank`, `seed` and `abort` must be made by all
/// ranks, in the same order.
pub trait Ranks {
    /// Returns the number of this rank.
    fn rank(&self) -> usize;

    /// Returns the number of ranks.
    fn count(&self) -> usize;

    /// Returns the number of this rank among those on its machine, which share the machine's adapters.
    fn local_rank(&self) -> usize;

    /// Replaces `values` with their sums over the ranks, bit-identical on all of them. The length must be the
    /// same on all ranks.
    fn sum(&self, values: &mut [f32]);

    /// Replaces `bytes` with those of rank 0. The length must be the same on all ranks.
    fn broadcast(&self, bytes: &mut [u8]);

    /// Prints `error` and aborts all ranks, which would otherwise wait for this one forever. Returns if this
    /// is the only rank, so that the error is handled as usual.
    fn abort(&self, error: &dyn Display);

    /// Returns the seed of this rank's pools in a run with seed `seed`: `seed + rank 2^32`. Rank 0 uses the
    /// run's seed.
    fn seed(&self, seed: u64) -> u64 {
        seed.wrapping_add((self.rank() as u64) << 32)
    }

    /// Replaces `gradient`, that of this rank's loss with respect to all weights, with that of the sum of all
    /// ranks' losses. The loss of one learner is the sum over its pools, so the ranks together act as one
    /// learner with all their pools. They also act as one with larger batches, because the backward pass
    /// weighs every component, or every cloth, the same; hence the sum is not divided by the number of ranks.
    /// If any rank's loss is not finite, the gradient becomes non-finite on all ranks, so that all skip the
    /// step.
    fn sum_gradients(&self, gradient: &mut [f32], loss: f64) {
        if !loss.is_finite() && self.count() > 1 {
            gradient.fill(f32::NAN);
        }
        self.sum(gradient);
    }

    /// Returns rank 0's number.
    fn broadcast_u64(&self, number: u64) -> u64 {
        let mut bytes = number.to_le_bytes();
        self.broadcast(&mut bytes);
        u64::from_le_bytes(bytes)
    }

    /// Returns rank 0's decision.
    fn decide(&self, yes: bool) -> bool {
        self.broadcast_u64(u64::from(yes)) == 1
    }

    /// Returns whether all ranks say yes. Also acts as a barrier.
    fn all(&self, yes: bool) -> bool {
        let mut no = [f32::from(u8::from(!yes))];
        self.sum(&mut no);
        no == [0.0]
    }
}

/// A process that trains alone; nothing is exchanged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn local_rank(&self) -> usize {
        0
    }

    fn sum(&self, _: &mut [f32]) {}

    fn broadcast(&self, _: &mut [u8]) {}

    fn abort(&self, _: &dyn Display) {}
}

/// Returns the ranks of this job: with the crate's feature `mpi` those started by `mpirun` or `srun`, without
/// it one process [`Alone`]. Fails if MPI cannot be initialized.
#[cfg(feature = "mpi")]
pub fn ranks() -> Result<Rc<dyn Ranks>> {
    match super::mpi::Mpi::new() {
        Some(ranks) => Ok(Rc::new(ranks)),
        None => Err(Error::Device("MPI was started before or cannot be started".into())),
    }
}

/// Returns the ranks of this job: with the crate's feature `mpi` those started by `mpirun` or `srun`, without
/// it one process [`Alone`]. Fails if a launcher started several processes, which would all write the same
/// files.
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
