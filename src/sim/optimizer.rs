//! The optimizers that minimise the energy of a frame.

use crate::kernels::optim::lbfgs::MAX_HISTORY;
use crate::kernels::optim::{AdamSettings, LbfgsSettings};
use crate::network::Weights;
use crate::{Error, Result};
use std::sync::Arc;

/// An optimizer of a frame's energy. All of them start from `a = 0`, and all but the quasi-Newton and Newton
/// methods see only the gradient.
#[derive(Clone, Debug)]
pub enum Optimizer {
    /// The learned optimizer (paper sections 3.3 and 4).
    Learned(Arc<Weights>),
    /// Gradient descent, `a -= rate g`.
    GradientDescent {
        /// Learning rate.
        rate: f64,
    },
    /// Adam with bias correction.
    Adam(AdamSettings),
    /// L-BFGS: two-loop recursion with step 1. The history is cleared every frame.
    Lbfgs(LbfgsSettings),
    /// L-BFGS that starts from the Hessian of the sheet at rest, with step 1 (after Liu, Bouaziz and Kavan
    /// 2017). The classical baseline.
    QuasiNewton {
        /// Settings of the L-BFGS.
        lbfgs: LbfgsSettings,
        /// Whether the Hessian is factored with the handles held, sparsely and in double precision (CPU
        /// only), instead of inverted by a cosine transform as if the handles were free.
        factored: bool,
    },
    /// Newton's method with sparse Cholesky factors and line search, in double precision until it converges
    /// ([`crate::cpu::Reference`]), whatever the number of iterations: the exact physics, for comparison. CPU
    /// only.
    Newton,
}

/// Name of the learned optimizer.
const LEARNED: &str = "fnopt";
/// Settings of L-BFGS in the paper's comparison.
const LBFGS: LbfgsSettings = LbfgsSettings { history: 5, curvature: 1e-12 };

impl Optimizer {
    /// Returns the learned optimizer with these weights.
    pub fn learned(weights: Weights) -> Self {
        Self::Learned(Arc::new(weights))
    }

    /// Returns gradient descent as in the paper's comparison (section 4.3): rate 0.01.
    pub fn gradient_descent() -> Self {
        Self::GradientDescent { rate: 0.01 }
    }

    /// Returns Adam as in the paper's comparison: rate 0.1, decays 0.9 and 0.999.
    pub fn adam() -> Self {
        Self::Adam(AdamSettings { rate: 0.1, beta1: 0.9, beta2: 0.999, epsilon: 1e-8 })
    }

    /// Returns L-BFGS as in the authors' comparison: history 5, step 1, pairs with `y.s > 1e-12`.
    pub fn lbfgs() -> Self {
        Self::Lbfgs(LBFGS)
    }

    /// Returns the quasi-Newton method: history 5, step 1, pairs with `y.s > 1e-12`.
    pub fn quasi_newton() -> Self {
        Self::QuasiNewton { lbfgs: LBFGS, factored: false }
    }

    /// Returns the quasi-Newton method with exact factors of the Hessian at rest.
    pub fn quasi_newton_exact() -> Self {
        Self::QuasiNewton { lbfgs: LBFGS, factored: true }
    }

    /// Returns the classical optimizer called `name`, with the paper's settings, or the learned one with the
    /// result of `weights`. `origin` names the source of the name in errors.
    pub fn named(name: &str, origin: &str, weights: impl FnOnce() -> Result<Weights>) -> Result<Self> {
        if name == LEARNED {
            return Ok(Self::learned(weights()?));
        }
        let classical = [
            Self::gradient_descent(),
            Self::adam(),
            Self::lbfgs(),
            Self::quasi_newton(),
            Self::quasi_newton_exact(),
            Self::Newton,
        ];
        let known = std::iter::once(LEARNED).chain(classical.iter().map(Self::name));
        let unknown = Error::unknown(origin, "solver", name, known);
        classical.into_iter().find(|optimizer| optimizer.name() == name).ok_or(unknown)
    }

    /// Fails if the weights of a learned optimizer belong to a network whose inputs are not the update rule's
    /// fields, or if a history is empty or too long for the kernels.
    pub(crate) fn check(&self) -> Result<()> {
        match *self {
            Self::Learned(ref weights) => weights.config.check_fields("optimizer", "network"),
            Self::Lbfgs(LbfgsSettings { history, .. })
            | Self::QuasiNewton { lbfgs: LbfgsSettings { history, .. }, .. }
                if !(1..=MAX_HISTORY).contains(&history) =>
            {
                let expected = format!("1 to {MAX_HISTORY} pairs");
                Err(Error::invalid("optimizer", "history", expected, history))
            }
            _ => Ok(()),
        }
    }

    /// Whether it has GPU kernels; the others run on the CPU only.
    pub fn runs_on_gpu(&self) -> bool {
        !matches!(self, Self::Newton | Self::QuasiNewton { factored: true, .. })
    }

    /// Returns the checksum of the weights ([`Weights::checksum`]) in hexadecimal digits; `None` for the
    /// classical optimizers.
    pub fn weights_crc32(&self) -> Option<String> {
        match self {
            Self::Learned(weights) => Some(format!("{:08x}", weights.checksum())),
            _ => None,
        }
    }

    /// Returns the optimizer's name on command lines and in reports.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Learned(_) => LEARNED,
            Self::GradientDescent { .. } => "gd",
            Self::Adam(_) => "adam",
            Self::Lbfgs(_) => "lbfgs",
            Self::QuasiNewton { factored: false, .. } => "quasi-newton",
            Self::QuasiNewton { factored: true, .. } => "quasi-newton-exact",
            Self::Newton => "newton",
        }
    }
}
