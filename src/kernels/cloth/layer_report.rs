//! Host side of `shaders/cloth/layer_report.wgsl`.

use super::{PairParams, Pairs, Trial, layers};
use crate::Result;
use crate::cloth::LayerStats;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "layer_report",
    wgsl: include_str!("../../../shaders/cloth/layer_report.wgsl"),
    appended: &[terms::CONTACT, pieces::PAIR, pieces::PAIRS_OF, pieces::ACROSS],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    of_pairs: PairParams,
    rounds: u32,
    stride: u32,
}

/// Number of values that the device reports about the layers of a cloth.
pub const VALUES: usize = 8;

/// Reports what the layers of a cloth do to each other.
#[derive(Clone, Debug)]
pub struct LayerReport {
    kernel: Kernel,
}

/// What the device reports about the layers of one cloth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClothLayers {
    /// What they did.
    pub stats: LayerStats,
    /// The energy of their contacts.
    pub energy: f64,
}

impl ClothLayers {
    /// Returns those of a cloth of `n` particles, read from its part of the report, \[8\].
    pub fn of(report: &[f32], n: usize) -> Self {
        let [pairs, touching, least, energy, missed, ..] = *report else {
            panic!("layer_report: {} values", report.len())
        };
        let overflow = [(pairs, layers::MOST_PAIRS), (missed, layers::MOST_MISSED)]
            .into_iter()
            .find_map(|(found, most)| (f64::from(found) > (most * n) as f64).then_some(most));
        let stats = LayerStats {
            pairs: if overflow.is_none() { pairs as usize } else { 0 },
            touching: touching as usize,
            nearest: if pairs > 0.0 && overflow.is_none() { f64::from(least) } else { f64::INFINITY },
            overflow,
        };
        Self { stats, energy: f64::from(energy) }
    }
}

impl LayerReport {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `report` [B, 8] from `pairs` at `iterate.a`, and from where those of the searches at the frame's end end,
    /// `missed_ends` [rounds, B, buckets].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        pairs: &Pairs,
        [missed_ends, report]: [&Tensor; 2],
    ) {
        let (grid, batch) = (trial.grid, trial.batch());
        assert_eq!(report.shape(), [batch, VALUES]);
        let &[rounds, of_batch, buckets] = missed_ends.shape() else {
            panic!("layer_report: {:?}", missed_ends.shape())
        };
        let params =
            Params { of_pairs: pairs.params(grid), rounds: size(rounds), stride: size(of_batch * buckets) };
        let (given, ..) = &trial.iterate.given();
        let tensors = [&pairs.ends, missed_ends, &pairs.pairs, &trial.iterate.a, given, report];
        schedule.dispatch(&self.kernel, &params, &tensors, [size(batch), 1, 1]);
    }
}
