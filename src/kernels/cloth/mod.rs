//! The cloth: forces, energies, their gradient and the time step (paper sections 3.2 and 3.3).

pub mod cell_count;
pub mod cell_fill;
pub mod cell_order;
pub mod cell_scan;
mod cells;
pub mod contact;
pub mod contact_axes;
pub mod contact_confine;
pub mod contact_curvature;
pub mod contact_end;
pub mod contact_find;
pub mod contact_report;
mod contacts;
pub mod couple;
pub mod couple_curvature;
mod couples;
pub mod curvature;
pub mod embed;
pub mod energy;
pub mod energy_sum;
pub mod external_force;
mod force;
pub mod gradient;
pub mod integrate;
pub mod layer_axes;
pub mod layer_curvature;
pub mod layer_find;
pub mod layer_force;
pub mod layer_list;
pub mod layer_motion;
pub mod layer_order;
pub mod layer_part;
pub mod layer_place;
pub mod layer_press;
pub mod layer_report;
mod layers;
mod objective;
pub mod predict;
pub mod repulsion;
pub mod repulsion_curvature;
pub mod sheet_axes;
pub mod vertices;

pub use cell_count::CellCount;
pub use cell_fill::CellFill;
pub use cell_order::CellOrder;
pub use cell_scan::CellScan;
pub use cells::{Cells, buckets};
pub use contact::Contact;
pub use contact_axes::ContactAxes;
pub use contact_confine::ContactConfine;
pub use contact_curvature::ContactCurvature;
pub use contact_end::ContactEnd;
pub use contact_find::ContactFind;
pub use contact_report::{ClothContacts, ContactReport};
pub use contacts::{BodyParams, CONTACT, Contacts, Fields};
pub use couple::Couple;
pub use couple_curvature::CoupleCurvature;
pub use couples::Couples;
pub use curvature::Curvature;
pub use embed::Embed;
pub use energy::Energy;
pub use energy_sum::{ClothTerms, EnergySum, TERMS};
pub use external_force::{ExternalForce, ExternalForceTensors};
pub use gradient::Gradient;
pub use integrate::Integrate;
pub use layer_axes::LayerAxes;
pub use layer_curvature::LayerCurvature;
pub use layer_find::{Finds, LayerFind};
pub use layer_force::LayerForce;
pub use layer_list::LayerList;
pub use layer_motion::{LayerMotion, Way};
pub use layer_order::LayerOrder;
pub use layer_part::LayerPart;
pub use layer_place::LayerPlace;
pub use layer_press::{LayerPress, Tells};
pub use layer_report::{ClothLayers, LayerReport};
pub use layers::{Layers, MOST_MISSED, MOST_PAIRS, PairParams, Pairs};
pub use objective::{Begin, Objective, Room};
pub use predict::Predict;
pub use repulsion::Repulsion;
pub use repulsion_curvature::RepulsionCurvature;
pub use sheet_axes::SheetAxes;
pub use vertices::Vertices;

use crate::cloth::{Cloth, Grid, Model};
use crate::gpu::Tensor;
use crate::kernels::optim::Iterate;

/// The cloths of a batch at trial accelerations: everything that their energies depend on.
#[derive(Clone, Copy, Debug)]
pub struct Trial<'a> {
    /// The grid of all cloths.
    pub grid: Grid,
    /// Constants of the cloths, see [`ClothParams`].
    pub cloths: &'a Tensor,
    /// Positions at the start of the frame, shape [B, 3, H, W].
    pub x: &'a Tensor,
    /// The accelerations, and what else moves the particles.
    pub iterate: &'a Iterate,
}

/// The state of the cloths and the targets of their handles.
#[derive(Clone, Copy, Debug)]
pub struct StateTensors<'a> {
    /// Positions, shape [B, 3, n].
    pub x: &'a Tensor,
    /// Velocities, shape [B, 3, n].
    pub v: &'a Tensor,
    /// Handle targets, shape [handles, 3].
    pub targets: &'a Tensor,
}

/// One element of the WGSL's `array<Cloth>`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ClothParams {
    material: [f32; 4],
    weave: [f32; 4],
    gravity: [f32; 4],
    air: [f32; 4],
    repulsion: [f32; 4],
    layers: [f32; 4],
}

impl ClothParams {
    /// Number of `f32` values in an element.
    pub const LEN: usize = size_of::<Self>() / size_of::<f32>();

    /// Returns the constants of each cloth.
    pub fn all(model: &Model) -> Vec<Self> {
        model.cloths.iter().map(Self::new).collect()
    }

    fn new(cloth: &Cloth) -> Self {
        let m = cloth.material;
        let ([down, across], [bend_down, bend_across]) = (m.weave.stretch, m.weave.bend);
        // Without repulsion, cells are one edge wide and are not searched.
        let [strength, distance, per_edge] =
            cloth.repulsion.map_or([0.0, 0.0, 1.0], |r| [r.strength, r.distance, r.distance.recip()]);
        let [thickness, friction] = cloth.self_contact.map_or([0.0; 2], |s| [s.thickness, s.friction]);
        let [gx, gy, gz] = cloth.gravity.map(|g| g as f32);
        Self {
            material: [m.stretch, m.shear, m.bend, cloth.contact_curvature()].map(|k| k as f32),
            weave: [down, across, bend_down, bend_across].map(|k| k as f32),
            gravity: [gx, gy, gz, cloth.damping as f32],
            air: [cloth.air.density as f32, cloth.air.drag as f32, 0.0, 0.0],
            repulsion: [strength as f32, distance as f32, per_edge as f32, 0.0],
            layers: [thickness as f32, friction as f32, 0.0, 0.0],
        }
    }
}

impl Trial<'_> {
    /// Returns the number of cloths. Panics if the tensors do not fit each other.
    fn batch(&self) -> usize {
        let (samples, n) = self.iterate.samples_and_particles();
        assert_eq!((n, self.x.len()), (self.grid.particles(), samples * n));
        assert_eq!(self.cloths.bytes() as usize, samples / 3 * size_of::<ClothParams>());
        samples / 3
    }
}
