//! Host side of `shaders/cloth/contact_curvature.wgsl`.

use super::{Trial, curvature};
use crate::Result;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::optim::directions;
use crate::kernels::{pieces, size, terms};

pub(crate) const SOURCE: Source = Source {
    name: "contact_curvature",
    wgsl: include_str!("../../../shaders/cloth/contact_curvature.wgsl"),
    appended: &[terms::CONTACT, pieces::DISPLACED, pieces::PRODUCTS, pieces::CONTACT_PRODUCTS],
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
    three: Kernel,
    four: Kernel,
}

impl ContactCurvature {
    /// Builds the kernels for so many contacts of a particle.
    pub fn new(context: &Context, slots: usize) -> Result<Self> {
        let kernel = |count: f64| Kernel::new(context, &SOURCE, 0, &[("K", count), ("SLOTS", slots as f64)]);
        Ok(Self { three: kernel(3.0)?, four: kernel(4.0)? })
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
        let kernel = match directions.shape()[0] {
            3 => &self.three,
            4 => &self.four,
            other => panic!("three or four directions, not {other}"),
        };
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
