//! What moves the acceleration: the learned update rule and the classical optimizers (paper sections 3.3 and 4.3).

pub mod adam;
pub mod cosine_order;
pub mod features;
pub mod gradient_descent;
pub mod lbfgs;
pub mod norms;
mod quasi_newton;
pub mod rest_modes;
pub mod update;
pub mod update_adj;

pub use adam::{Adam, AdamSettings};
pub use cosine_order::CosineOrder;
pub use features::{FeatureTensors, Features};
pub use gradient_descent::GradientDescent;
pub use lbfgs::{Lbfgs, LbfgsMemory, Part};
pub use norms::Norms;
pub use quasi_newton::QuasiNewton;
pub use rest_modes::RestModes;
pub use update::{Update, UpdateTensors};
pub use update_adj::{UpdateAdj, UpdateAdjTensors};

use crate::Result;
use crate::gpu::{Context, Tensor};

/// The unknown of a frame and what follows from it.
#[derive(Clone, Debug)]
pub struct Iterate {
    /// Gradient of the energy with respect to `a`, shape [B, 3, n].
    pub grad: Tensor,
    /// What `a = 0` moves the particles by: the velocity, or the way of a handle, shape [B, 3, n].
    pub base: Tensor,
    /// 0 for a free particle, else 1 + the place of its handle, shape [B, n].
    pub slots: Tensor,
    /// Acceleration, shape [B, 3, n].
    pub a: Tensor,
    /// What `a` moves the particles by, x(a) - x, shape [B, 3, n].
    pub shift: Tensor,
}

impl Iterate {
    /// Tensors for the cloths whose handle slots are `slots` [B, n].
    pub fn new(context: &Context, batch: usize, slots: &[u32]) -> Result<Self> {
        let n = slots.len() / batch;
        let field = |label| Tensor::zeros(context, label, &[batch, 3, n]);
        Ok(Self {
            grad: field("grad")?,
            base: field("base")?,
            slots: Tensor::from_slice(context, "slots", &[batch, n], slots)?,
            a: field("a")?,
            shift: field("shift")?,
        })
    }

    /// Number of samples, three to a cloth, and of particles. Panics when the tensors do not fit each other.
    pub fn samples_and_particles(&self) -> (usize, usize) {
        let Self { grad, base, slots, a, shift } = self;
        let &[batch, 3, n] = a.shape() else { panic!("an acceleration is [B, 3, n]: {:?}", a.shape()) };
        assert_eq!([grad, base, shift].map(Tensor::len), [a.len(); 3]);
        assert_eq!(slots.len(), batch * n);
        (3 * batch, n)
    }
}
