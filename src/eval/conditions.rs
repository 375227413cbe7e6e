//! The conditions of a score, so that only comparable scores are compared.

use super::{Entry, Nudge, Score, Sequence, Settings};
use crate::Device;
use crate::gpu::Storage;
use crate::{Error, Result};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::path::Path;

/// Revision of the solvers' results within a version, incremented with each change that alters them. Scores
/// of different revisions are not tabulated together, nor reused.
const REVISION: u32 = 8;

/// Returns the version recorded in scores.
pub(super) fn version() -> String {
    format!("{}+{REVISION}", env!("CARGO_PKG_VERSION"))
}

/// The conditions of a score.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Conditions {
    /// Version of this program and revision of its solvers' results.
    pub version: String,
    /// Checksum of the recorded trajectory's files ([`Sequence::checksum`]) in hexadecimal digits; `None` if a
    /// scene is simulated without one.
    pub truth_crc32: Option<String>,
    /// Material, air, points and frames ([`Settings::to_json`]), or a whole scene.
    pub settings: Value,
    /// Name of the device of the simulation; `None` for another system's trajectory.
    pub device: Option<String>,
    /// Kind of device and storage of networks: `cpu`, `gpu`, or `gpu, f16`.
    pub kind: Option<String>,
    /// Checksum of the weights of a learned optimizer
    /// ([`Optimizer::weights_crc32`](crate::sim::Optimizer::weights_crc32)).
    pub weights_crc32: Option<String>,
    /// Perturbation of the start, for a repeat after the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nudge: Option<Nudge>,
}

impl Conditions {
    /// Returns the conditions of another system's trajectory.
    pub(super) fn new(sequence: &Sequence, settings: &Settings) -> Self {
        let truth_crc32 = Some(format!("{:08x}", sequence.checksum()));
        Self { truth_crc32, ..Self::of_settings(settings.to_json()) }
    }

    fn of_settings(settings: Value) -> Self {
        Self {
            version: version(),
            truth_crc32: None,
            settings,
            device: None,
            kind: None,
            weights_crc32: None,
            nudge: None,
        }
    }

    /// Returns the conditions of a solver on a device; a solver without a GPU implementation runs on the CPU.
    pub fn of(
        (sequence, nudge): (&Sequence, Option<Nudge>),
        entry: &Entry,
        (device, settings): (&Device, &Settings),
    ) -> Self {
        Self { nudge, ..Self::new(sequence, settings).by(entry, device) }
    }

    /// Returns the conditions of a solver on a scene without a recording; `settings` holds everything that
    /// matters about the scene.
    pub(super) fn of_scene(settings: Value, entry: &Entry, device: &Device) -> Self {
        Self::of_settings(settings).by(entry, device)
    }

    fn by(self, entry: &Entry, device: &Device) -> Self {
        let device = entry.device(device);
        let weights_crc32 = entry.optimizer.weights_crc32();
        // Storage concerns the network alone.
        let (kind, name) = match device {
            Device::Gpu(context) if weights_crc32.is_none() => ("gpu", context.name().to_owned()),
            Device::Gpu(context) if context.storage() == Storage::F16 => ("gpu, f16", device.name()),
            Device::Gpu(_) => ("gpu", device.name()),
            Device::Cpu => ("cpu", device.name()),
        };
        let (device, kind) = (Some(name), Some(kind.to_owned()));
        Self { device, kind, weights_crc32, ..self }
    }

    /// Returns a checksum of everything that the results depend on, which on a CPU does not include the
    /// number of threads.
    pub fn checksum(&self) -> u32 {
        let device = self.device.clone().filter(|_| self.kind.as_deref() != Some("cpu"));
        let relevant = Self { device, ..self.clone() };
        crc32fast::hash(&serde_json::to_vec(&relevant).expect("conditions are plain data"))
    }
}

/// Returns where two values of a field differ first, and how: inside, if both are documents with the same keys.
fn first_difference(field: &str, a: &str, b: &str) -> (String, String, String) {
    let objects = [a, b].map(|text| serde_json::from_str::<Map<String, Value>>(text).ok());
    let [Some(in_a), Some(in_b)] = objects else { return (field.into(), a.into(), b.into()) };
    match in_a.iter().find(|(key, value)| in_b.get(*key) != Some(value)) {
        Some((key, value)) if in_b.contains_key(key) => {
            first_difference(&format!("{field}.{key}"), &value.to_string(), &in_b[key].to_string())
        }
        _ => (field.into(), a.into(), b.into()),
    }
}

/// Checks that scores, each with the file it comes from, belong in one table. They must come from one version
/// with the same settings, each sequence must be the same, each column of a grid must have the same weights
/// on the same kind of device, and no score may occur twice.
pub fn belong_together(scores: &[(&Path, &Score)]) -> Result<()> {
    /// A property of a score, as text.
    type Property = fn(&Score) -> String;
    let rules: [(&str, Property, Property); 5] = [
        ("version", |_| String::new(), |s| s.made_with.version.clone()),
        ("settings", |_| String::new(), |s| s.made_with.settings.to_string()),
        ("truth_crc32", |s| s.sequence.clone(), |s| s.made_with.truth_crc32.clone().unwrap_or_default()),
        ("device", of_column, |s| s.made_with.kind.clone().unwrap_or_default()),
        ("weights_crc32", of_column, |s| s.made_with.weights_crc32.clone().unwrap_or_default()),
    ];
    for (field, group, property) in rules {
        let mut firsts: BTreeMap<String, (&Path, String)> = BTreeMap::new();
        for &(path, score) in scores {
            let found = property(score);
            let (other, expected) = firsts.entry(group(score)).or_insert_with(|| (path, found.clone()));
            if *expected != found {
                let (at, expected, found) = first_difference(field, expected, &found);
                let expected = format!("{expected}, as in {}", other.display());
                return Err(Error::invalid(path.display().to_string(), at, expected, found));
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

/// Returns the grid and the column of a score.
fn of_column(score: &Score) -> String {
    format!("{} {}", score.grid, score.column())
}
