//! Comparisons of computed arrays with those of a golden file.

use super::golden::Golden;
use super::{Check, Finding, Precision, Stages, Verdict};
use crate::cloth::Grid;
use crate::network::Weights;
use crate::{Error, Result};
use std::path::Path;

/// Tolerance of network stages, relative to the array's largest magnitude. The golden arrays are in single
/// precision.
pub(super) const NETWORK: f64 = 2e-5;
/// Tolerance of network stages if activations and weights are stored in 16 bits, of which 11 are significant:
/// a few roundings.
const NETWORK_HALF: f64 = 2e-3;

/// Compares the results of stages with the arrays of a file, and reports each comparison.
pub(super) struct Checker<'a> {
    /// The file's name without its extension.
    pub file: &'a str,
    pub folder: &'a Path,
    pub stages: &'a mut dyn Stages,
    pub report: &'a mut dyn FnMut(Check),
}

impl Checker<'_> {
    /// Compares a network array by its largest error, relative to the array's largest magnitude.
    pub fn network_magnitude(&mut self, array: &str, expected: &[f64], found: &[f64]) {
        let tolerance = match self.stages.precision() {
            Precision::Double | Precision::Single => NETWORK,
            Precision::Half => NETWORK_HALF,
        };
        self.magnitude(array, expected, found, tolerance);
    }

    /// Returns a grid on which a cloth has an energy, though it may be too small for the network. Fails
    /// unless there are at least two particles per side.
    pub fn grid_with_cells(&self, h: usize, w: usize) -> Result<Grid> {
        let grid = Grid { h, w };
        match h.min(w) {
            0 | 1 => Err(Error::invalid(self.file, "positions", "at least two particles per side", grid)),
            _ => Ok(grid),
        }
    }

    /// Loads the weights from another file of the folder.
    pub fn weights(&self, name: &str) -> Result<Weights> {
        Weights::load(self.folder.join(format!("{name}.safetensors")))
    }

    /// Compares an array that only some files contain.
    pub fn optional(&mut self, golden: &Golden, name: &str, shape: &[usize], found: &[f64]) -> Result<()> {
        if golden.has(name) {
            self.network_magnitude(name, golden.shaped(name, shape)?, found);
        }
        Ok(())
    }

    /// Compares by the largest error, relative to the array's largest magnitude.
    pub fn magnitude(&mut self, array: &str, expected: &[f64], found: &[f64], tolerance: f64) {
        let scale = expected.iter().fold(0.0, |m: f64, e| m.max(e.abs()));
        let absolute = largest_error(expected, found);
        self.compared(array, (absolute, ratio(absolute, scale)), tolerance);
    }

    /// Compares by the norm of the error, relative to the norm of the array.
    pub fn in_norm(&mut self, array: &str, expected: &[f64], found: &[f64], tolerance: f64) {
        let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let relative = match expected.len() == found.len() {
            true => {
                let error = norm(&mut expected.iter().zip(found).map(|(e, f)| f - e));
                ratio(error, norm(&mut expected.iter().copied()))
            }
            false => f64::INFINITY,
        };
        self.compared(array, (largest_error(expected, found), relative), tolerance);
    }

    /// Reports whether the relative error is within the tolerance.
    pub fn compared(&mut self, array: &str, (absolute, relative): (f64, f64), tolerance: f64) {
        // A NaN does not pass: the comparison is false for it.
        let outcome = if relative <= tolerance { Verdict::Passed } else { Verdict::Failed };
        let array = array.to_owned();
        self.report(outcome, Finding::Comparison { array, absolute, relative, tolerance });
    }

    /// Reports an outcome without a comparison.
    pub fn verdict(&mut self, message: &str, outcome: Verdict) {
        self.report(outcome, Finding::Message { message: message.to_owned() });
    }

    fn report(&mut self, outcome: Verdict, finding: Finding) {
        let (file, device) = (self.file.to_owned(), self.stages.name());
        (self.report)(Check { file, device, outcome, finding });
    }
}

/// Returns the largest difference. It is infinite if the lengths differ or a difference is NaN.
pub(super) fn largest_error(expected: &[f64], found: &[f64]) -> f64 {
    if expected.len() != found.len() {
        return f64::INFINITY;
    }
    expected.iter().zip(found).fold(0.0, |m: f64, (e, f)| {
        let d = (e - f).abs();
        if d.is_nan() { f64::INFINITY } else { m.max(d) }
    })
}

fn ratio(error: f64, scale: f64) -> f64 {
    if error == 0.0 { 0.0 } else { error / scale }
}

#[cfg(test)]
mod tests {
    use super::super::{CpuStages, Finding};
    use super::*;

    #[test]
    fn results_of_another_length_do_not_pass() {
        let mut outcomes = Vec::new();
        let mut report = |check: Check| {
            let Finding::Comparison { relative, .. } = check.finding else { panic!("{check}") };
            outcomes.push((check.outcome, relative));
        };
        let mut stages = CpuStages::<f64>::new();
        let mut checker =
            Checker { file: "energy", folder: Path::new("."), stages: &mut stages, report: &mut report };
        checker.in_norm("gradient", &[1.0, 2.0], &[1.0, 2.0], 1e-9);
        for found in [&[1.0][..], &[], &[1.0, 2.0, 3.0]] {
            checker.in_norm("gradient", &[1.0, 2.0], found, 1e-9);
            checker.magnitude("total", &[1.0, 2.0], found, 1e-9);
        }
        let bad = (Verdict::Failed, f64::INFINITY);
        assert_eq!(outcomes, [vec![(Verdict::Passed, 0.0)], vec![bad; 6]].concat());
    }
}
