//! Sizes that suit an adapter: a table of good ones, and those measured on the adapter itself.

use super::{AdapterKind, CACHE_FOLDER, Context, LANES, Sharing, Unroll, WORKGROUP_INVOCATIONS};
use crate::{Error, Result, io};
use std::io::Write;
use std::path::PathBuf;

/// Sizes of tiles and workgroups that suit a kind of adapter. Results do not depend on them beyond rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tuning {
    /// Output channels per invocation of the matrix products, a power of two from 4 to 64. Fewer in a network
    /// whose channels are not a multiple of it, or whose rows would not fit a workgroup with so many.
    pub channels: usize,
    /// Invocations per workgroup of the pointwise layers.
    pub pointwise_group: u32,
    /// Largest number of invocations along a row in a block's workgroup, unless it takes whole rows.
    pub block_wide: u32,
    /// Most quads of columns per invocation of a block, at most 4: each weight is read once for all of them.
    /// Short rows have fewer, so that no lanes are idle.
    pub block_span: u32,
    /// Most tiles of output channels per workgroup of a block.
    pub block_deep: u32,
    /// Most rows per invocation of a block in batches ([`Tuning::BATCH`]), at most 4: each staged weight is then read once for all of
    /// them. Fewer where workgroup memory does not hold as many, or where operands are not staged or are broadcast.
    pub block_lines: u32,
    /// Whether the inputs and weights of a block, and the operands of a sheet's transforms, are staged in workgroup memory. Each is then read once for
    /// all channels of a workgroup, and an invocation waits for a few reads instead of one per input. The
    /// scalar head, which is little work in comparison, is then repeated in every workgroup of the update
    /// kernel, instead of in a dispatch that all later ones wait for.
    pub staged: bool,
    /// Whether blocks transform their rows for the next block if a row fits a workgroup. This saves
    /// dispatches, whose latency dominates a frame of few cloths, and one read.
    pub rows_in_blocks: bool,
    /// Teams of 64 invocations that share the work of a workgroup of the spectral convolution, at most 4.
    pub spectral_teams: u32,
    /// Number of workgroups that keeps the adapter busy. If there are too few samples for that, the spectral
    /// convolution is divided further, although this repeats part of the work.
    pub busy_groups: usize,
    /// How operands that a subgroup shares are read.
    pub sharing: Sharing,
    /// Whether activations that only blocks read, and the weights and table of the spectral convolution, are
    /// in texels instead of buffers. Not in training.
    pub texels: bool,
    /// Largest size of a layer's activations \[bytes\], if the device can bind that much. Samples beyond it
    /// are processed in further passes.
    pub activation_bytes: usize,
}

/// Numbers of output channels that an invocation of the matrix products may have.
const TILES: [usize; 5] = [4, 8, 16, 32, 64];

/// A measured tuning, as it is stored.
#[derive(serde::Serialize, serde::Deserialize)]
struct Stored {
    /// Adapter, driver and backend that it was measured on, followed by the version of the program.
    adapter: String,
    version: String,
    tuning: Tuning,
}

impl Tuning {
    /// Number of cloths from which on there are enough rows to keep an adapter busy with several per invocation
    /// ([`Tuning::block_lines`]).
    pub const BATCH: usize = 16;

    /// Returns the table's entry for the adapter.
    pub fn table(context: &Context) -> Self {
        Self::of(context.kind(), context.sharing())
    }

    /// Returns the sizes that suit each kind of adapter. On llvmpipe, where every lane's load from a buffer
    /// is a separate branch and move, these are wide tiles, one row per workgroup and texels (measured). On
    /// hardware, with thousands of lanes to fill, they are smaller tiles, shared operands and more
    /// invocations. On an H100 they take an eighth longer than the best that were found.
    pub fn of(kind: AdapterKind, sharing: Sharing) -> Self {
        let software = Self {
            channels: 64,
            pointwise_group: 64,
            block_wide: 64,
            block_span: 2,
            block_deep: 1,
            block_lines: 1,
            staged: false,
            rows_in_blocks: true,
            spectral_teams: 1,
            busy_groups: 1,
            sharing,
            texels: true,
            activation_bytes: 256 << 20,
        };
        match kind {
            AdapterKind::Software => software,
            AdapterKind::Hardware => Self {
                channels: 8,
                block_wide: 32,
                block_span: 1,
                block_deep: 8,
                block_lines: 2,
                staged: true,
                spectral_teams: 4,
                busy_groups: 128,
                texels: false,
                ..software
            },
        }
    }

    /// Returns the tunings that differ from this one in one respect and work on the adapter, one list per
    /// respect.
    pub fn neighbours(&self, context: &Context) -> Vec<Vec<Self>> {
        // Also with as many channels per workgroup as before: with fewer, staged data is reused less.
        let channels = TILES.map(|channels| {
            let block_deep = (self.channels * self.block_deep as usize / channels).clamp(1, 16) as u32;
            [Self { channels, ..*self }, Self { channels, block_deep, ..*self }]
        });
        let channels = channels.as_flattened();
        let groups = [32, 64, 128, 256].map(|pointwise_group| Self { pointwise_group, ..*self });
        let widths = [8, 16, 32, 64].map(|block_wide| Self { block_wide, ..*self });
        let spans = [1, 2, 4].map(|block_span| Self { block_span, ..*self });
        let depths = [1, 2, 4, 8, 16].map(|block_deep| Self { block_deep, ..*self });
        let lines = [1, 2, 4].map(|block_lines| Self { block_lines, ..*self });
        let staged = [true, false].map(|staged| Self { staged, ..*self });
        let rows = [true, false].map(|rows_in_blocks| Self { rows_in_blocks, ..*self });
        let teams = [1, 2, 4].map(|spectral_teams| Self { spectral_teams, ..*self });
        let busy = [1, 8, 32, 128, 512].map(|busy_groups| Self { busy_groups, ..*self });
        let sizes = [4, 16, 64, 256, 1024].map(|mib| Self { activation_bytes: mib << 20, ..*self });
        let sharings = [Sharing::Loads, context.sharing()].map(|sharing| Self { sharing, ..*self });
        let texels = [true, false].map(|texels| Self { texels, ..*self });
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
            others(&lines),
            others(&widths),
            others(&spans),
            others(&groups),
            others(&rows),
            others(&teams),
            others(&busy),
            others(&sharings),
            others(&texels),
            others(&sizes),
        ]
    }

    /// Fails unless the tuning works on the adapter ([`Tuning::works`]).
    pub fn check(&self, context: &Context) -> Result<()> {
        if self.works(context) {
            return Ok(());
        }
        let expected = format!("tile sizes that the kernels support on {}", context.name());
        Err(Error::invalid("context", "tuning", expected, format!("{self:?}")))
    }

    /// Whether the kernels can be built with it on the adapter.
    pub fn works(&self, context: &Context) -> bool {
        // Operands are shared by whole subgroups, each within one row of a workgroup, with staging as well.
        let whole = [self.block_wide, self.pointwise_group].iter().all(|n| n.is_multiple_of(LANES as u32));
        let in_rows = self.sharing == Sharing::Loads || whole;
        let shared = in_rows && [Sharing::Loads, context.sharing()].contains(&self.sharing);
        let tile = TILES.contains(&self.channels);
        let fits = |n: u32| (1..=WORKGROUP_INVOCATIONS).contains(&n);
        let teams = (1..=WORKGROUP_INVOCATIONS / 64).contains(&self.spectral_teams);
        let groups = fits(self.pointwise_group) && teams && fits(self.block_wide);
        let depth = (1..=16).contains(&self.block_deep);
        let [spans, lines] = [self.block_span, self.block_lines].map(|n| (1..=4).contains(&n));
        shared && tile && groups && depth && spans && lines && self.activation_bytes > 0
    }

    /// Returns the largest number of samples, of `activations` activations each, that fit
    /// [`Tuning::activation_bytes`] and one binding; 0 if not even one does.
    pub(crate) fn most_samples(&self, context: &Context, activations: usize) -> usize {
        let binding = usize::try_from(context.largest_binding()).unwrap_or(usize::MAX);
        self.activation_bytes.min(binding) / (context.storage().bytes() * activations)
    }

    /// Whether blocks can have several rows per invocation: weights that a workgroup does not stage are read for one row.
    pub(crate) fn takes_lines(&self) -> bool {
        self.staged && self.sharing == Sharing::Loads
    }

    /// Returns how to unroll a kernel for a tile of this size.
    pub(crate) fn unroll(&self, tile: usize) -> Unroll {
        Unroll { sharing: self.sharing, ..tile.into() }
    }

    /// Returns the path of the adapter's tuning: in the folder named by `FNOPT_CACHE`, or else in `fnopt` in
    /// the user's cache directory. `None` if there is no such directory.
    pub fn path(context: &Context) -> Option<PathBuf> {
        context.cache_file("tuning", "json")
    }

    /// Returns the tuning that was measured on the adapter ([`crate::sim::tune`]) and stored; pass it to
    /// [`Context::with_tuning`]. A file that is damaged or belongs to something else is ignored with a
    /// warning.
    pub fn measured(context: &Context) -> Option<Self> {
        let path = Self::path(context)?;
        let bytes = std::fs::read(&path).ok()?;
        let problem = match serde_json::from_slice::<Stored>(&bytes) {
            Err(error) => error.to_string(),
            Ok(stored) if stored.adapter != context.name() => format!("measured on {}", stored.adapter),
            Ok(stored) if stored.version != env!("CARGO_PKG_VERSION") => {
                format!("version {}", stored.version)
            }
            Ok(stored) if !stored.tuning.works(context) => "sizes that the kernels do not support".into(),
            Ok(stored) => return Some(stored.tuning),
        };
        let path = path.display();
        tracing::warn!(
            "{path}: not a tuning for {} and this version ({problem}); using the built-in one",
            context.name()
        );
        None
    }

    /// Stores the tuning for the adapter, where [`Tuning::measured`] will find it, and returns the path of
    /// the file. Fails if there is no cache directory or the file cannot be written.
    pub fn store(&self, context: &Context) -> Result<PathBuf> {
        let nowhere =
            || Error::invalid("tuning", CACHE_FOLDER, "a folder, as the user has no cache directory", "none");
        let path = Self::path(context).ok_or_else(nowhere)?;
        let (adapter, version) = (context.name().to_owned(), env!("CARGO_PKG_VERSION").to_owned());
        let json = serde_json::to_vec_pretty(&Stored { adapter, version, tuning: *self });
        let json = json.expect("a tuning is plain data");
        io::write_atomic(&path, |file| file.write_all(&json))?;
        Ok(path)
    }
}
