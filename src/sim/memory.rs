//! What an optimizer carries from one frame to the next.

use crate::{Error, Result};

/// What an optimizer carries from one frame of a batch to the next, besides the state of the cloths: a simulation goes
/// on to the same bits from both, on the same device. The parts that an optimizer does not have are empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Memory {
    /// The accelerations of the last frame and of the frame before it [edges / frame^2], shape [2, B, 3, H, W], where a frame
    /// starts near them.
    pub accelerations: Vec<f32>,
    /// The last gradient and the last step of a network, shape [2, B, 3, H, W].
    pub hidden: Vec<f32>,
    /// The scale of a network's steps for each component of each cloth, shape [B, 3].
    pub scales: Vec<f32>,
}

impl Memory {
    /// Fails if a part has another length than the same part of `expected`, or a number that is not finite.
    pub(crate) fn check(&self, expected: &Self) -> Result<()> {
        let parts = [
            ("accelerations", &self.accelerations, &expected.accelerations),
            ("hidden", &self.hidden, &expected.hidden),
            ("scales", &self.scales, &expected.scales),
        ];
        for (name, found, expected) in parts {
            if found.len() != expected.len() {
                let expected = format!("{} numbers for this optimizer", expected.len());
                return Err(Error::invalid("memory", name, expected, found.len()));
            }
            if let Some(value) = found.iter().find(|value| !value.is_finite()) {
                return Err(Error::invalid("memory", name, "finite numbers", value));
            }
        }
        Ok(())
    }
}
