//! The optimizers, which move the acceleration: the learned update rule and the classical ones (paper
//! sections 3.3 and 4.3).

pub mod adam;
pub mod answer_rows;
pub mod cosine_columns;
pub mod cosine_order;
pub mod cosine_rows;
pub mod directions;
pub mod extrapolate;
pub mod features;
pub mod gradient_descent;
pub mod lbfgs;
mod quasi_newton;
mod reacting;
pub mod rest_modes;
pub mod sheet_steps;
mod subspace;
pub mod subspace_step;
pub mod update;
pub mod update_adj;

pub use adam::Adam;
pub use answer_rows::AnswerRows;
pub use cosine_columns::{CosineColumns, Fields};
pub use cosine_order::CosineOrder;
pub use cosine_rows::CosineRows;
pub use extrapolate::Extrapolate;
pub use features::{FeatureInputs, Features};
pub use gradient_descent::GradientDescent;
pub use lbfgs::{Lbfgs, LbfgsMemory, Part};
pub use quasi_newton::QuasiNewton;
pub use reacting::Reacting;
pub use rest_modes::RestModes;
pub use sheet_steps::SheetSteps;
pub use subspace::Subspace;
pub use subspace_step::{SubspaceStep, When};
pub use update::{Update, UpdateTensors};
pub use update_adj::{UpdateAdj, UpdateAdjTensors};

use crate::Result;
use crate::cloth::Mark;
use crate::gpu::{Context, Tensor};

/// The unknown of a frame, and what is derived from it.
#[derive(Clone, Debug)]
pub struct Iterate {
    /// Gradient of the energy with respect to `a`, shape [B, 3, n].
    pub grad: Tensor,
    /// What the learned optimizer remembers: last gradient and last step, shape [2, S, n]. It is in one
    /// buffer with `grad`, so that kernels that write either can bind both as one.
    pub hidden: Option<Tensor>,
    /// What `a = 0` moves the particles by, shape [B, 3, n]: the velocity, or the displacement of a handle to
    /// its target. A trial moves free particles by `base + a`, and handles by `base`.
    pub base: Tensor,
    /// External accelerations [edges / frame^2], shape [B, 3, n]. They follow `base` in one buffer, so that kernels
    /// that read both can bind them as one.
    pub external: Tensor,
    /// The external accelerations plus those of repulsion, contacts and couples, shape [B, 3, n], in the same buffer;
    /// `None` where there are none of them. To the gradient they are external forces, since they depend on positions
    /// alone.
    pub total: Option<Tensor>,
    /// What each particle is ([`Mark`]), shape [B, n].
    pub marks: Tensor,
    /// Acceleration, shape [B, 3, n].
    pub a: Tensor,
}

impl Iterate {
    /// Allocates the tensors for cloths whose particles have these `marks` [B, n].
    pub fn new(context: &Context, batch: usize, marks: &[Mark]) -> Result<Self> {
        let grad = Tensor::zeros(context, "grad", &[batch, 3, marks.len() / batch])?;
        Self::of(context, marks, grad, None)
    }

    /// As [`Iterate::new`], with a hidden state of zeros.
    pub fn with_hidden(context: &Context, batch: usize, marks: &[Mark]) -> Result<Self> {
        let (samples, n) = (3 * batch, marks.len() / batch);
        let first = (samples * n).next_multiple_of(Tensor::VIEW_ALIGNMENT);
        let fields = Tensor::zeros(context, "grad and hidden state", &[first + 2 * samples * n])?;
        let hidden = fields.view(first, &[2, samples, n]);
        Self::of(context, marks, fields.view(0, &[batch, 3, n]), Some(hidden))
    }

    fn of(context: &Context, marks: &[Mark], grad: Tensor, hidden: Option<Tensor>) -> Result<Self> {
        let &[batch, _, n] = grad.shape() else { unreachable!("a gradient has three axes") };
        let [base, external] = fields_in_one(context, "base and external", grad.shape())?;
        let a = Tensor::zeros(context, "a", grad.shape())?;
        let marks = Tensor::from_slice(context, "marks", &[batch, n, 2], marks)?;
        Ok(Self { grad, hidden, base, external, total: None, marks, a })
    }

    /// Makes room for the accelerations of a repulsion. `base` and `external` begin anew, as zeros.
    pub fn with_total(self, context: &Context) -> Result<Self> {
        let [base, external, total] = fields_in_one(context, "base, external and total", self.grad.shape())?;
        Ok(Self { base, external, total: Some(total), ..self })
    }

    /// Returns the hidden state. Panics if the iterate has none.
    pub fn hidden_state(&self) -> &Tensor {
        self.hidden.as_ref().expect("the iterate of a learned optimizer has a hidden state")
    }

    /// Returns the number of samples, three per cloth, and of particles. Panics if the tensors do not fit
    /// each other.
    pub fn samples_and_particles(&self) -> (usize, usize) {
        let Self { grad, hidden, base, external, total, marks, a } = self;
        let &[batch, 3, n] = a.shape() else { panic!("an acceleration is [B, 3, n]: {:?}", a.shape()) };
        assert_eq!([grad, base, external].map(Tensor::len), [a.len(); 3]);
        assert!(total.as_ref().is_none_or(|total| total.len() == a.len()));
        assert_eq!(marks.len(), 2 * batch * n);
        assert!(hidden.as_ref().is_none_or(|hidden| hidden.shape() == [2, 3 * batch, n]));
        (3 * batch, n)
    }

    /// Returns the buffer that begins with the gradient, and the element at which the hidden state begins in
    /// it, if there is one.
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

    /// Returns the buffer that begins with `base`, and the elements at which `external` and `total` begin in it.
    pub(crate) fn given(&self) -> (Tensor, usize, Option<usize>) {
        let ((given, of_base), (same, external)) = (self.base.whole(), self.external.whole());
        assert_eq!((given.buffer(), of_base), (same.buffer(), 0), "base and external are in one buffer");
        let total = self.total.as_ref().map(|total| {
            let (same, total) = total.whole();
            assert_eq!(given.buffer(), same.buffer(), "base and total are in one buffer");
            total
        });
        (given, external, total)
    }
}

/// Allocates fields of one shape that share a buffer, as views of it.
fn fields_in_one<const N: usize>(
    context: &Context,
    label: &'static str,
    shape: &[usize],
) -> Result<[Tensor; N]> {
    let stride = shape.iter().product::<usize>().next_multiple_of(Tensor::VIEW_ALIGNMENT);
    let all = Tensor::zeros(context, label, &[N * stride])?;
    Ok(std::array::from_fn(|k| all.view(k * stride, shape)))
}
