//! Stateless randomness: each draw has its own generator, keyed by its purpose.

use rand::{SeedableRng, rngs::ChaCha8Rng};

/// The purpose of a generator.
#[derive(Clone, Copy, Debug)]
pub(super) enum Purpose {
    /// Fresh weights.
    Weights,
    /// The cloths that a step draws from a pool; index: the step.
    Batch { pool: usize },
    /// The material of a slot, which never changes; index: the slot.
    Material { pool: usize },
    /// One life of a cloth, from its start to its reset; index: the slot.
    Life { pool: usize, generation: u32 },
}

/// Creates the generator for `purpose` and `index` in a run with this seed. ChaCha yields the same numbers on
/// every machine.
pub(super) fn generator(seed: u64, purpose: Purpose, index: u64) -> ChaCha8Rng {
    let (kind, pool, generation) = match purpose {
        Purpose::Weights => (0, 0, 0),
        Purpose::Batch { pool } => (1, pool, 0),
        Purpose::Material { pool } => (2, pool, 0),
        Purpose::Life { pool, generation } => (3, pool, generation),
    };
    let mut key = [0; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&index.to_le_bytes());
    key[16..20].copy_from_slice(&generation.to_le_bytes());
    key[20..24].copy_from_slice(&(pool as u32).to_le_bytes());
    key[24] = kind;
    ChaCha8Rng::from_seed(key)
}
