//! Host side of `shaders/cloth/external_force.wgsl`.

use crate::Result;
use crate::cloth::Grid;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::{common, size};

pub(crate) const SOURCE: Source = Source {
    name: "external_force",
    wgsl: include_str!("../../../shaders/cloth/external_force.wgsl"),
    appended: &[common::CLOTH, common::MARK],
};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    rows: u32,
    columns: u32,
}

/// Computes the external acceleration: gravity, the control's accelerations, and air.
#[derive(Clone, Debug)]
pub struct ExternalForce {
    kernel: Kernel,
}

/// Inputs of the external forces.
#[derive(Clone, Copy, Debug)]
pub struct ExternalForceTensors<'a> {
    /// Constants of the cloths, see [`super::ClothParams`].
    pub cloths: &'a Tensor,
    /// What each particle is, shape [B, n].
    pub marks: &'a Tensor,
    /// Wind velocities, shape [B, 3].
    pub wind: &'a Tensor,
    /// Positions, shape [B, 3, H, W].
    pub x: &'a Tensor,
    /// Velocities, shape [B, 3, H, W].
    pub v: &'a Tensor,
    /// Accelerations of the control, shape [B, 3, H, W].
    pub control_accelerations: &'a Tensor,
}

impl ExternalForce {
    /// Builds the kernel.
    pub fn new(context: &Context) -> Result<Self> {
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &[])? })
    }

    /// Sets `external` [B, 3, H, W] from `tensors`.
    pub fn push(
        &self,
        schedule: &mut Schedule,
        grid: Grid,
        tensors: ExternalForceTensors<'_>,
        external: &Tensor,
    ) {
        let ExternalForceTensors { cloths, marks, wind, x, v, control_accelerations } = tensors;
        let batch = external.len() / (3 * grid.particles());
        assert_eq!(
            [external, x, v, control_accelerations].map(Tensor::len),
            [batch * 3 * grid.particles(); 4]
        );
        assert_eq!(cloths.bytes() as usize, batch * size_of::<super::ClothParams>());
        assert_eq!(wind.shape(), [batch, 3]);
        let params = Params { rows: size(grid.h), columns: size(grid.w) };
        let count = self.kernel.groups([grid.w, grid.h, batch]);
        let tensors = [cloths, marks, wind, x, v, control_accelerations, external];
        schedule.dispatch(&self.kernel, &params, &tensors, count);
    }
}
