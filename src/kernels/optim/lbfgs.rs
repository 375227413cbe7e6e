//! Host side of `shaders/optim/lbfgs.wgsl`.

use super::Iterate;
use crate::Error;
use crate::Result;
use crate::gpu::AdapterKind;
use crate::gpu::{Context, Kernel, Schedule, Source, Tensor};
use crate::kernels::size;
use crate::settings::{LONGEST, LbfgsSettings, MAX_HISTORY, SHORTEST};

pub(crate) const SOURCE: Source =
    Source { name: "lbfgs", wgsl: include_str!("../../../shaders/optim/lbfgs.wgsl"), appended: &[] };

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    particles: u32,
    first: u32,
}

/// The part of a step that a dispatch performs. If the initial inverse Hessian is not a multiple of the
/// identity, it is applied to the direction between two dispatches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The whole step.
    Whole,
    /// The part before the initial inverse Hessian.
    Before,
    /// The part after it.
    After,
}

/// Limited-memory BFGS.
#[derive(Clone, Debug)]
pub struct Lbfgs {
    kernel: Kernel,
    history: usize,
}

/// What L-BFGS remembers within a frame.
#[derive(Clone, Debug)]
pub struct LbfgsMemory {
    /// Pairs, shape [B, history, 2, 3 n].
    pub history: Tensor,
    /// Last gradient and last step, shape [B, 2, 3 n]. Between the parts of a step the direction replaces
    /// the last step.
    pub last: Tensor,
    /// Number of pairs, index of the newest, 1 / y.s of each pair, alpha of the first loop, and the length of steps
    /// along secants, shape [B, 2 history + 3].
    pub pairs: Tensor,
}

impl LbfgsMemory {
    /// Allocates the memory for `batch` cloths of `particles` particles.
    pub fn new(context: &Context, batch: usize, particles: usize, history: usize) -> Result<Self> {
        let n = 3 * particles;
        Ok(Self {
            history: Tensor::zeros(context, "lbfgs.history", &[batch, history, 2, n])?,
            last: Tensor::zeros(context, "lbfgs.last", &[batch, 2, n])?,
            pairs: Tensor::zeros(context, "lbfgs.pairs", &[batch, 2 * history + 3])?,
        })
    }
}

impl Lbfgs {
    /// Builds the kernel for steps of length 1. Panics if the history is not 1 to [`MAX_HISTORY`] pairs.
    pub fn new(context: &Context, settings: LbfgsSettings) -> Result<Self> {
        Self::build(context, settings, (Part::Whole, false))
    }

    /// Builds the kernel for a part of a step along a secant ([`Length::Secant`](crate::sim::Length::Secant)),
    /// otherwise like [`Lbfgs::new`].
    pub fn along_secants(context: &Context, settings: LbfgsSettings, part: Part) -> Result<Self> {
        Self::build(context, settings, (part, true))
    }

    fn build(context: &Context, settings: LbfgsSettings, (part, secant): (Part, bool)) -> Result<Self> {
        let LbfgsSettings { history, curvature } = settings;
        assert!((1..=MAX_HISTORY).contains(&history), "a history of 1 to {MAX_HISTORY} pairs, not {history}");
        let constants = [
            ("HISTORY", history as f64),
            ("CURVATURE", curvature),
            ("SECANT", f64::from(u8::from(secant))),
            ("LONGEST", LONGEST),
            ("SHORTEST", SHORTEST),
            ("PART", f64::from(part as u8)),
        ];
        Ok(Self { kernel: Kernel::new(context, &SOURCE, 0, &constants)?, history })
    }

    /// Fails on software adapters if the loops of one invocation might exceed 65,535 iterations, after which
    /// llvmpipe stops them silently.
    pub fn check_size(&self, context: &Context, particles: usize) -> Result<()> {
        let iterations = (3 * particles).div_ceil(256) * (4 * self.history + 4) + 16 * self.history;
        if context.kind() == AdapterKind::Software && iterations > 65_000 {
            return Err(Error::Device(format!(
                "{}: L-BFGS with history {} on {particles} particles exceeds the loop limit of software adapters; use the CPU",
                context.name(),
                self.history
            )));
        }
        Ok(())
    }

    /// Moves `iterate` by the step of `iteration`, counted from 0.
    pub fn push(&self, schedule: &mut Schedule, iteration: usize, iterate: &Iterate, memory: &LbfgsMemory) {
        let (samples, n) = iterate.samples_and_particles();
        let batch = samples / 3;
        assert_eq!(memory.history.shape(), [batch, self.history, 2, 3 * n]);
        assert_eq!((memory.last.len(), memory.pairs.len()), (batch * 6 * n, batch * (2 * self.history + 3)));
        let params = Params { particles: size(n), first: u32::from(iteration == 0) };
        let LbfgsMemory { history, last, pairs } = memory;
        let tensors = [&iterate.grad, history, last, pairs, &iterate.a];
        schedule.dispatch(&self.kernel, &params, &tensors, [size(batch), 1, 1]);
    }
}
