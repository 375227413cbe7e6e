//! What moves the acceleration: the learned update rule and the classical optimizers (paper sections 3.3 and 4.3).

pub mod adam;
pub mod cosine_order;
pub mod features;
pub mod gradient_descent;
pub mod lbfgs;
mod quasi_newton;
pub mod rest_modes;
pub mod update;
pub mod update_adj;

pub use adam::{Adam, AdamSettings};
pub use cosine_order::CosineOrder;
pub use features::{Features, Fields};
pub use gradient_descent::GradientDescent;
pub use lbfgs::{Lbfgs, LbfgsMemory, Part};
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
    /// What the learned optimizer remembers: last gradient and last step, shape [2, S, n]. It lies in one buffer with `grad`, so that
    /// a kernel can bind both as one, whichever of them it writes.
    pub hidden: Option<Tensor>,
    /// What `a = 0` moves the particles by: the velocity, or the way of a handle, shape [B, 3, n]. A trial moves free particles
    /// by `base + a`, and handles by `base`.
    pub base: Tensor,
    /// 0 for a free particle, else 1 + the place of its handle, shape [B, n].
    pub slots: Tensor,
    /// Acceleration, shape [B, 3, n].
    pub a: Tensor,
}

impl Iterate {
    /// Tensors for the cloths whose handle slots are `slots` [B, n].
    pub fn new(context: &Context, batch: usize, slots: &[u32]) -> Result<Self> {
        let n = slots.len() / batch;
        let field = |label| Tensor::zeros(context, label, &[batch, 3, n]);
        Ok(Self {
            grad: field("grad")?,
            hidden: None,
            base: field("base")?,
            slots: Tensor::from_slice(context, "slots", &[batch, n], slots)?,
            a: field("a")?,
        })
    }

    /// The same with a hidden state, of zeros.
    pub fn with_hidden(context: &Context, batch: usize, slots: &[u32]) -> Result<Self> {
        let iterate = Self::new(context, batch, slots)?;
        let (samples, n) = iterate.samples_and_particles();
        let first = (samples * n).next_multiple_of(Tensor::VIEW_ALIGNMENT);
        let fields = Tensor::zeros(context, "grad and hidden state", &[first + 2 * samples * n])?;
        let grad = fields.view(0, &[batch, 3, n]);
        Ok(Self { grad, hidden: Some(fields.view(first, &[2, samples, n])), ..iterate })
    }

    /// Number of samples, three to a cloth, and of particles. Panics when the tensors do not fit each other.
    pub fn samples_and_particles(&self) -> (usize, usize) {
        let Self { grad, hidden, base, slots, a } = self;
        let &[batch, 3, n] = a.shape() else { panic!("an acceleration is [B, 3, n]: {:?}", a.shape()) };
        assert_eq!([grad, base].map(Tensor::len), [a.len(); 2]);
        assert_eq!(slots.len(), batch * n);
        assert!(hidden.as_ref().is_none_or(|hidden| hidden.shape() == [2, 3 * batch, n]));
        (3 * batch, n)
    }

    /// The buffer that begins with the gradient, and the element of it that the hidden state begins with, if there is one.
    pub(crate) fn fields(&self) -> (Tensor, Option<usize>) {
        let Some(hidden) = &self.hidden else { return (self.grad.clone(), None) };
        let ((fields, of_grad), (same, first)) = (self.grad.whole(), hidden.whole());
        assert_eq!(
            (fields.buffer(), of_grad),
            (same.buffer(), 0),
            "gradient and hidden state are in one buffer"
        );
        (fields, Some(first))
    }

    /// The same where there must be a hidden state.
    pub(crate) fn fields_with_hidden(&self) -> (Tensor, usize) {
        let (fields, hidden) = self.fields();
        (fields, hidden.expect("the iterate of a learned optimizer has a hidden state"))
    }
}
