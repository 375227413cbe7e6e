//! What a score was made with, so that only scores that belong together are compared.

use super::{Entry, Nudge, Score, Sequence, Settings};
use crate::gpu::Storage;
use crate::sim::{Device, Optimizer};
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Counts the changes after which solvers come to other results, beside the version: scores of other counts stand in no table
/// together, and are not used again.
const REVISION: u32 = 5;

/// The version that scores tell.
pub(super) fn version() -> String {
    format!("{}+{REVISION}", env!("CARGO_PKG_VERSION"))
}

/// What a score was made with.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Conditions {
    /// Version of this program, and of what its solvers come to.
    pub version: String,
    /// Checksum of the recorded trajectory's files ([`Sequence::checksum`]); none where a scene is simulated for itself.
    pub truth: Option<u32>,
    /// Material, air, points and frames ([`Settings::to_json`]), or all of a scene.
    pub settings: serde_json::Value,
    /// Name of the device that simulated; none of another system.
    pub device: Option<String>,
    /// Its kind and how it stores networks: `cpu`, `gpu`, or `gpu, f16`.
    pub kind: Option<String>,
    /// Checksum of the weights of a learned optimizer.
    pub weights: Option<u32>,
    /// What moved the start, of a repeat beyond the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nudge: Option<Nudge>,
}

impl Conditions {
    /// Those of another system's trajectory.
    pub(super) fn new(sequence: &Sequence, settings: &Settings) -> Self {
        Self { truth: Some(sequence.checksum()), ..Self::of_settings(settings.to_json()) }
    }

    fn of_settings(settings: serde_json::Value) -> Self {
        Self {
            version: version(),
            truth: None,
            settings,
            device: None,
            kind: None,
            weights: None,
            nudge: None,
        }
    }

    /// Those of a solver on a device; one that only the CPU has runs there.
    pub fn of(
        (sequence, nudge): (&Sequence, Option<Nudge>),
        entry: &Entry,
        (device, settings): (&Device, &Settings),
    ) -> Self {
        Self { nudge, ..Self::new(sequence, settings).by(entry, device) }
    }

    /// Those of a solver on a scene of its own, of which `settings` tells all that matters.
    pub(super) fn of_scene(settings: serde_json::Value, entry: &Entry, device: &Device) -> Self {
        Self::of_settings(settings).by(entry, device)
    }

    fn by(self, entry: &Entry, device: &Device) -> Self {
        let device = entry.device(device);
        let kind = match device {
            Device::Cpu => "cpu",
            Device::Gpu(context) => match context.storage() {
                Storage::F32 => "gpu",
                Storage::F16 => "gpu, f16",
            },
        };
        let weights = match &entry.optimizer {
            Optimizer::Learned(weights) => Some(weights.checksum()),
            _ => None,
        };
        let (device, kind) = (Some(device.name()), Some(kind.to_owned()));
        Self { device, kind, weights, ..self }
    }

    /// A checksum of all that the results depend on: on a CPU not of the number of threads.
    pub fn checksum(&self) -> u32 {
        let device = self.device.clone().filter(|_| self.kind.as_deref() != Some("cpu"));
        let told = Self { device, ..self.clone() };
        crc32fast::hash(&serde_json::to_vec(&told).expect("conditions are plain data"))
    }
}

/// Checks that scores, each with the file it comes from, belong in one table: made by one version with the same settings,
/// each sequence the same, each column of a grid with the same weights on the same kind of device, and none there twice.
pub fn belong_together(scores: &[(&Path, &Score)]) -> Result<()> {
    /// What is told of a score, and must be the same in some of them.
    type Told = fn(&Score) -> String;
    fn sum(sum: Option<u32>) -> String {
        sum.map_or_else(String::new, |sum| format!("{sum:08x}"))
    }
    let rules: [(&str, Told, Told); 5] = [
        ("version", |_| String::new(), |s| s.made_with.version.clone()),
        ("settings", |_| String::new(), |s| s.made_with.settings.to_string()),
        ("truth", |s| s.sequence.clone(), |s| sum(s.made_with.truth)),
        ("device", of_column, |s| s.made_with.kind.clone().unwrap_or_default()),
        ("weights", of_column, |s| sum(s.made_with.weights)),
    ];
    for (field, group, told) in rules {
        let mut firsts: BTreeMap<String, (&Path, String)> = BTreeMap::new();
        for &(path, score) in scores {
            let found = told(score);
            let (other, expected) = firsts.entry(group(score)).or_insert_with(|| (path, found.clone()));
            if *expected != found {
                let expected = format!("{expected}, as in {}", other.display());
                return Err(Error::invalid(path.display().to_string(), field, expected, found));
            }
        }
    }
    let mut known: BTreeMap<String, &Path> = BTreeMap::new();
    for &(path, score) in scores {
        let repeat =
            score.made_with.nudge.map_or_else(String::new, |nudge| format!(", repeat {}", nudge.repeat));
        let what = format!("{} {}{repeat}", score.sequence, of_column(score));
        if let Some(other) = known.insert(what.clone(), path) {
            let expected = format!("the only score of {what}");
            let found = format!("another in {}", other.display());
            return Err(Error::invalid(path.display().to_string(), "score", expected, found));
        }
    }
    Ok(())
}

/// The grid and the column in which a score stands.
fn of_column(score: &Score) -> String {
    format!("{} {}", score.grid, score.column())
}
