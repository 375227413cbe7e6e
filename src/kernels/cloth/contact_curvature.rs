//! Host side of `shaders/cloth/contact_curvature.wgsl`.

use super::{Trial, curvature};
use crate::Result;
use crate::gpu::{Context, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact_curvature",
    wgsl: include_str!("../../../shaders/cloth/contact_curvature.wgsl"),
    appended: &[
        terms::CONTACT,
        pieces::DISPLACED,
        pieces::PRODUCTS,
        pieces::PRODUCTS_PART,
        pieces::CONTACT_PRODUCTS,
    ],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    parts: u32,
    slot: u32,
}

/// Adds the second derivatives of contacts to the quadratic model of the energy.
#[derive(Clone, Debug)]
pub struct ContactCurvature {
    kernels: directions::ByCount,
}

impl ContactCurvature {
    /// Builds the kernels for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        Ok(Self { kernels: directions::ByCount::new(context, &SOURCE, &[("SLOTS", slots as f64)])? })
    }

    /// Adds to `parts` [B, parts, 24], which hold those of the other terms ([`super::Curvature`]), the second
    /// derivatives of `contacts` [B, slots n, 12] at `iterate.a` along `directions` ([`directions::shape`]), which are 0
    /// at handles.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        trial: Trial<'_>,
        contacts: &Tensor,
        [directions, parts]: [&Tensor; 2],
    ) {
        let kernel = self.kernels.of(directions);
        let (grid, batch, iterate) = (trial.grid, trial.batch(), trial.iterate);
        let shape @ [_, groups, _] = curvature::parts_shape(batch, grid);
        assert_eq!(parts.shape(), shape);
        let params = Params {
            particles: size(grid.particles()),
            parts: size(groups),
            slot: size(directions::slot(directions, iterate)),
        };
        let (given, ..) = &iterate.given();
        let tensors = [contacts, &iterate.a, given, directions, parts];
        schedule.dispatch(kernel, &params, &tensors, [size(groups), size(batch), 1]);
    }
}
