//! The plan of a quasi-Newton step: L-BFGS along secants that starts from the Hessian of a flat sheet.

use super::{CosineOrder, Iterate, Lbfgs, LbfgsMemory, Part, RestModes};
use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::fft::{Fields, RealFft2};
use crate::settings::{LbfgsSettings, Norm};

/// L-BFGS along secants with the initial inverse Hessian `P C^T diag(1 / lambda) C P`: the cosine transform C (DCT-II)
/// nearly diagonalises the Hessian of a sheet at rest, and P zeroes the handles (after Liu, Bouaziz and Kavan
/// 2017).
///
/// The cosine transform is computed as a Fourier transform of the reordered field.
#[derive(Clone, Debug)]
pub struct QuasiNewton {
    before: Lbfgs,
    order: CosineOrder,
    fft: RealFft2,
    modes: RestModes,
    restore: CosineOrder,
    after: Lbfgs,
    /// The direction, in the order of the transform, shape [3 B, H, W].
    ordered: Tensor,
    /// Spectra before and after the division by lambda, shape [3 B, H, W / 2 + 1, 2].
    spectra: [Tensor; 2],
}

impl QuasiNewton {
    /// Builds the kernels and tensors for `batch` cloths on a grid.
    pub fn new(context: &Context, settings: LbfgsSettings, (grid, batch): (Grid, usize)) -> Result<Self> {
        let fields = Fields { batch: 3 * batch, h: grid.h, w: grid.w };
        let fft = RealFft2::new(context, fields, Norm::Backward)?;
        let spectrum = || Tensor::zeros(context, "quasi-newton.spectrum", &fft.spectrum_shape());
        let spectra = [spectrum()?, spectrum()?];
        Ok(Self {
            before: Lbfgs::along_secants(context, settings, Part::Before)?,
            order: CosineOrder::new(context, false)?,
            modes: RestModes::new(context, grid)?,
            restore: CosineOrder::new(context, true)?,
            after: Lbfgs::along_secants(context, settings, Part::After)?,
            ordered: Tensor::zeros(context, "quasi-newton.ordered", &[3 * batch, grid.h, grid.w])?,
            spectra,
            fft,
        })
    }

    /// Checks the size like [`Lbfgs::check_size`].
    pub fn check_size(&self, context: &Context, particles: usize) -> Result<()> {
        self.before.check_size(context, particles)
    }

    /// Moves `iterate` by the step of `iteration`, counted from 0, with the materials of `cloths` \[B\].
    pub fn push(
        &self,
        schedule: &mut Schedule,
        iteration: usize,
        (iterate, cloths): (&Iterate, &Tensor),
        memory: &LbfgsMemory,
    ) {
        let [spectrum, divided] = &self.spectra;
        self.before.push(schedule, iteration, iterate, memory);
        self.order.push(schedule, iterate, memory, &self.ordered);
        self.fft.push_forward(schedule, &self.ordered, spectrum);
        self.modes.push(schedule, cloths, spectrum, divided);
        self.fft.push_inverse(schedule, divided, &self.ordered);
        self.restore.push(schedule, iterate, memory, &self.ordered);
        self.after.push(schedule, iteration, iterate, memory);
    }
}
