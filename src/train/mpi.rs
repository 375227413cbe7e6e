//! Ranks connected by MPI.

use super::ranks::Ranks;
use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives, Root};
use std::fmt::Display;
use std::io::Write;

/// The ranks of an MPI job. MPI chooses the order of summation, but does not change it between runs with the
/// same number of ranks on the same machines, so such runs are reproducible bit for bit.
pub(super) struct Mpi {
    world: SimpleCommunicator,
    local_rank: usize,
    // Finalizes MPI when dropped, so it must be the last field.
    _universe: Universe,
}

impl Mpi {
    /// Joins the job. Returns `None` if MPI cannot be initialized, for instance because it already was. Only
    /// this thread may use it.
    pub fn new() -> Option<Self> {
        let (universe, _) = mpi::initialize_with_threading(Threading::Funneled)?;
        let world = universe.world();
        let local_rank = world.split_shared(world.rank()).rank() as usize;
        Some(Self { world, local_rank, _universe: universe })
    }
}

impl Ranks for Mpi {
    fn rank(&self) -> usize {
        self.world.rank() as usize
    }

    fn count(&self) -> usize {
        self.world.size() as usize
    }

    fn local_rank(&self) -> usize {
        self.local_rank
    }

    fn sum(&self, values: &mut [f32]) {
        let own = values.to_vec();
        self.world.all_reduce_into(&own[..], values, SystemOperation::sum());
    }

    fn broadcast(&self, bytes: &mut [u8]) {
        self.world.process_at_rank(0).broadcast_into(bytes);
    }

    fn abort(&self, error: &dyn Display) {
        if self.count() > 1 {
            let line = format!("error on rank {}: {error}\n", self.rank());
            let _ = std::io::stderr().write_all(line.as_bytes());
            self.world.abort(2);
        }
    }
}

impl Drop for Mpi {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.abort(&"the program panicked");
        }
        // Wait: if a rank exits before the others, the launcher kills them, and they may still be writing.
        self.world.barrier();
    }
}
