//! The couples of cloths that are not flat at rest, on a device.

use super::{Couple, CoupleCurvature, Trial};
use crate::Result;
use crate::cloth::{Cloth, Grid, Model};
use crate::gpu::{Context, Schedule, Tensor};

/// The angles at rest of a batch of cloths, and what computes with them.
#[derive(Clone, Debug)]
pub struct Couples {
    /// Shape [B, n, 2].
    pub rest_angles: Tensor,
    couple: Couple,
    curvature: CoupleCurvature,
}

impl Couples {
    /// Builds the kernels and the tensor for `batch` cloths on a grid, which are flat.
    pub fn new(context: &Context, batch: usize, grid: Grid) -> Result<Self> {
        Ok(Self {
            rest_angles: Tensor::zeros(context, "rest angles", &[batch, grid.particles(), 2])?,
            couple: Couple::new(context)?,
            curvature: CoupleCurvature::new(context)?,
        })
    }

    /// Sets the angles of the cloths of a model. Panics if the sizes do not match.
    pub fn set(&self, context: &Context, model: &Model) {
        let n = model.grid.particles();
        assert_eq!(self.rest_angles.shape(), [model.batch(), n, 2]);
        let of = |cloth: &Cloth, p: usize| cloth.rest_angles.as_ref().map_or([0.0; 2], |angles| angles.at(p));
        let angles: Vec<[f32; 2]> =
            model.cloths.iter().flat_map(|cloth| (0..n).map(move |p| of(cloth, p))).collect();
        self.rest_angles.write(context, angles.as_flattened());
    }

    /// Appends the accelerations by couples and their energy ([`Couple::push`]). One dispatch.
    pub fn push(&self, schedule: &mut Schedule, trial: Trial<'_>, after_others: bool, parts: &Tensor) {
        self.couple.push(schedule, trial, after_others, [&self.rest_angles, parts]);
    }

    /// Appends their second derivatives ([`CoupleCurvature::push`]). One dispatch.
    pub fn push_curvature(&self, schedule: &mut Schedule, trial: Trial<'_>, tensors: [&Tensor; 2]) {
        self.curvature.push(schedule, trial, &self.rest_angles, tensors);
    }
}
