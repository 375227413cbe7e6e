//! Sizes that suit an adapter: a table of good ones, and what was measured on the adapter at hand.

use crate::gpu::{AdapterKind, CACHE_FOLDER, Context, Sharing, Unroll, WORKGROUP_INVOCATIONS};
use crate::{Error, Result, io};
use std::io::Write;
use std::path::PathBuf;

/// Sizes of tiles and workgroups that suit a kind of adapter. Results do not depend on them beyond rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tuning {
    /// Output channels per invocation of the matrix products, a power of two from 4 to 64; fewer in a network whose channels it does
    /// not divide, or whose rows do not fit a workgroup with as many.
    pub channels: usize,
    /// Invocations per workgroup of the pointwise layers.
    pub pointwise_group: u32,
    /// Largest number of invocations along a row of the workgroup of a block that does not take whole rows.
    pub block_wide: u32,
    /// Most quads of columns per invocation of a block, at most 4: each weight is read once for all of them. A short row has fewer,
    /// so that lanes are not idle.
    pub block_span: u32,
    /// Most tiles of output channels per workgroup of a block.
    pub block_deep: u32,
    /// Whether the inputs and weights of a block go through workgroup memory: each is read once for all channels of a workgroup,
    /// and an invocation waits for few readings instead of one for each input. The scalar head, little work beside that, is then
    /// repeated in every workgroup that takes a step, instead of a dispatch that all the others wait for.
    pub staged: bool,
    /// Whether blocks transform their rows for the next one where a row fits a workgroup: fewer dispatches, which is what a
    /// frame of few cloths waits for, and one reading less.
    pub rows_in_blocks: bool,
    /// Teams of 64 invocations that share the work of a spectral convolution's workgroup, at most 4.
    pub spectral_teams: u32,
    /// Workgroups that keep the adapter busy: with fewer samples than make as many, a spectral convolution is divided further,
    /// though that repeats a part of the work.
    pub busy_groups: usize,
    /// How operands that a subgroup shares are read.
    pub sharing: Sharing,
    /// Largest size of a layer's activations \[bytes\], where the device binds as much; more samples than fit take turns.
    pub activation_bytes: usize,
}

/// Channel counts are padded to a multiple of this.
pub const CHANNEL_MULTIPLE: usize = 32;

/// Output channels that an invocation of the matrix products may have.
const TILES: [usize; 5] = [4, 8, 16, 32, 64];

/// A measured tuning as it is stored.
#[derive(serde::Serialize, serde::Deserialize)]
struct Stored {
    /// Adapter, driver and backend it was measured on, and with which version of the program.
    adapter: String,
    version: String,
    tuning: Tuning,
}

impl Tuning {
    /// The tuning that the context was given, else [`Tuning::table`]'s ([`Context::with_tuning`]).
    pub fn new(context: &Context) -> Self {
        context.tuning().unwrap_or_else(|| Self::table(context))
    }

    /// The table's entry for the adapter.
    pub fn table(context: &Context) -> Self {
        Self::of(context.kind(), context.sharing())
    }

    /// What suits each kind of adapter: wide tiles and one row to a workgroup where every lane's load is a branch and a move of
    /// its own (llvmpipe, measured); smaller tiles, shared operands and more invocations where there are thousands of lanes to
    /// fill (by reckoning: no hardware has been measured yet).
    pub fn of(kind: AdapterKind, sharing: Sharing) -> Self {
        let software = Self {
            channels: 64,
            pointwise_group: 64,
            block_wide: 64,
            block_span: 2,
            block_deep: 1,
            staged: false,
            rows_in_blocks: true,
            spectral_teams: 1,
            busy_groups: 1,
            sharing,
            activation_bytes: 256 << 20,
        };
        match kind {
            AdapterKind::Software => software,
            AdapterKind::Hardware => Self {
                channels: 8,
                block_wide: 32,
                block_span: 1,
                block_deep: 8,
                staged: true,
                spectral_teams: 4,
                busy_groups: 128,
                ..software
            },
        }
    }

    /// The tunings that differ from this one in one respect and work on the adapter, by respect.
    pub fn neighbours(&self, context: &Context) -> Vec<Vec<Self>> {
        // With as many channels to a workgroup as before, too: where it has fewer, what it stages serves less.
        let channels = TILES.map(|channels| {
            let block_deep = (self.channels * self.block_deep as usize / channels).clamp(1, 16) as u32;
            [Self { channels, ..*self }, Self { channels, block_deep, ..*self }]
        });
        let channels = channels.as_flattened();
        let groups = [32, 64, 128, 256].map(|pointwise_group| Self { pointwise_group, ..*self });
        let widths = [8, 16, 32, 64].map(|block_wide| Self { block_wide, ..*self });
        let spans = [1, 2, 4].map(|block_span| Self { block_span, ..*self });
        let depths = [1, 2, 4, 8, 16].map(|block_deep| Self { block_deep, ..*self });
        let staged = [true, false].map(|staged| Self { staged, ..*self });
        let places = [true, false].map(|rows_in_blocks| Self { rows_in_blocks, ..*self });
        let teams = [1, 2, 4].map(|spectral_teams| Self { spectral_teams, ..*self });
        let busy = [1, 8, 32, 128, 512].map(|busy_groups| Self { busy_groups, ..*self });
        let turns = [4, 16, 64, 256, 1024].map(|mib| Self { activation_bytes: mib << 20, ..*self });
        let sharings = [Sharing::Loads, context.sharing()].map(|sharing| Self { sharing, ..*self });
        let others = |all: &[Self]| -> Vec<Self> {
            let mut found: Vec<Self> = Vec::new();
            for tuning in all.iter().filter(|t| *t != self && t.works(context)) {
                if !found.contains(tuning) {
                    found.push(*tuning);
                }
            }
            found
        };
        vec![
            others(channels),
            others(&depths),
            others(&staged),
            others(&widths),
            others(&spans),
            others(&groups),
            others(&places),
            others(&teams),
            others(&busy),
            others(&sharings),
            others(&turns),
        ]
    }

    /// An error unless [`Tuning::works`].
    pub fn check(&self, context: &Context) -> Result<()> {
        if self.works(context) {
            return Ok(());
        }
        let expected = format!("sizes that the kernels can be made with on {}", context.name());
        Err(Error::invalid("options", "tuning", expected, format!("{self:?}")))
    }

    /// Whether the kernels can be made with it on the adapter.
    pub fn works(&self, context: &Context) -> bool {
        // Subgroups share operands within one row, and so does what is staged.
        let in_rows = self.sharing == Sharing::Loads || self.block_wide.is_multiple_of(8);
        let shared = in_rows && [Sharing::Loads, context.sharing()].contains(&self.sharing);
        let tile = TILES.contains(&self.channels);
        let fits = |n: u32| (1..=WORKGROUP_INVOCATIONS).contains(&n);
        let teams = (1..=WORKGROUP_INVOCATIONS / 64).contains(&self.spectral_teams);
        let groups = fits(self.pointwise_group) && teams && fits(self.block_wide);
        let depth = (1..=16).contains(&self.block_deep) && (1..=4).contains(&self.block_span);
        shared && tile && groups && depth && self.activation_bytes > 0
    }

    /// Most samples of so many activations each that are as large as they may be; none if one is larger.
    pub(crate) fn most_samples(&self, context: &Context, activations: usize) -> usize {
        let binding = usize::try_from(context.largest_binding()).unwrap_or(usize::MAX);
        self.activation_bytes.min(binding) / (context.storage().bytes() * activations)
    }

    /// The text of a kernel with a tile of this size.
    pub fn unroll(&self, tile: usize) -> Unroll {
        Unroll { sharing: self.sharing, ..tile.into() }
    }

    /// Where the tuning of an adapter is stored, in the folder that `FNOPT_CACHE` names, else in `fnopt` of the user's cache
    /// directory; none where there is no such directory.
    pub fn path(context: &Context) -> Option<PathBuf> {
        context.cache_file("tuning", "json")
    }

    /// What was measured on the adapter ([`crate::sim::tune`]) and stored, for a program that wants it: hand it to
    /// [`Context::with_tuning`]. A file that is damaged or of something else counts as none, and is said.
    pub fn measured(context: &Context) -> Option<Self> {
        let path = Self::path(context)?;
        let bytes = std::fs::read(&path).ok()?;
        let stored: Option<Stored> = serde_json::from_slice(&bytes).ok();
        let fits = |s: &Stored| s.adapter == context.name() && s.version == env!("CARGO_PKG_VERSION");
        let found = stored.filter(fits).map(|s| s.tuning).filter(|tuning| tuning.works(context));
        if found.is_none() {
            tracing::warn!("{}: no tuning of {}; the table's is used", path.display(), context.name());
        }
        found
    }

    /// Stores it for the adapter, to be found by [`Tuning::measured`] from then on; the file.
    pub fn store(&self, context: &Context) -> Result<PathBuf> {
        let nowhere =
            || Error::Device(format!("no cache directory to store a tuning in; set {CACHE_FOLDER}"));
        let path = Self::path(context).ok_or_else(nowhere)?;
        let (adapter, version) = (context.name().to_owned(), env!("CARGO_PKG_VERSION").to_owned());
        let json = serde_json::to_vec_pretty(&Stored { adapter, version, tuning: *self });
        let json = json.expect("a tuning is plain data");
        io::write_atomic(&path, |file| file.write_all(&json))?;
        Ok(path)
    }
}
