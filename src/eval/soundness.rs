//! Whether a rollout can be trusted: no edge stretched more than any cloth, no frame far from its minimum.

use super::FreeEdges;
use crate::Frame;
use crate::cloth::modes::SheetConstants;
use crate::cloth::{Control, Model, State};
use crate::cpu::cloth::{AXES, SheetAxes};
use crate::cpu::optim::{Cosines, InverseHessian, RestHessian, SheetHessian};
use crate::cpu::{Objective, free_fall};
use crate::scene::{Script, Setup};
use crate::statistics::median;
use std::fmt;
use std::sync::Arc;

/// Largest stretch of [`FreeEdges`] in a sound rollout.
pub const STRETCH_LIMIT: f64 = 0.6;
/// Largest stretch of any edge in a sound rollout. An edge at a handle that carries half of a fine sheet rightly
/// doubles its length.
pub const HELD_STRETCH_LIMIT: f64 = 3.0;
/// Largest median of the estimated energy gap ([`Verdict::gap_estimate`]) in a sound rollout. It tells optimizers that hardly
/// act on a scene from those that leave a few percent.
pub const GAP_LIMIT: f64 = 0.3;

/// Particles whose gradient is evaluated on the host for each frame of a rollout, on average: on finer grids the gap is
/// estimated in fewer frames.
const PARTICLES_PER_FRAME: usize = 4096;
/// Particles of the finest grid on which it is estimated at all, which takes 250 bytes each.
const MOST_PARTICLES: usize = 1 << 20;

/// What a rollout was like.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct Verdict {
    /// Largest `|edge| - 1` of the edges away from handles ([`FreeEdges`]); `None` if it is not finite, or without a
    /// frame after the start.
    pub stretch_largest_free: Option<f64>,
    /// The same of all edges.
    pub stretch_largest: Option<f64>,
    /// Median over the frames of the estimated energy gap: the share of the energy's decrease from a = 0 to the minimum
    /// that the optimizer left undone. Both are estimated from the gradient, with the inverse Hessian of the sheet at
    /// rest in the sheet's own axes and in those of space. In a quiet frame, the decrease counts as that of a free
    /// fall. `None` if it was not estimated, as on grids above 1024x1024.
    pub gap_estimate: Option<f64>,
    /// Number of frames in which Newton's method did not converge, and the first of them.
    pub unconverged: Option<[usize; 2]>,
}

/// What is not sound about a rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// An edge away from the handles was stretched by this, or a frame was not finite.
    Stretch(f64),
    /// An edge at a handle was stretched by this.
    HeldStretch(f64),
    /// The optimizer left this share of the energy's decrease undone.
    Gap(f64),
    /// Newton's method did not converge.
    Unconverged {
        /// Number of such frames.
        frames: usize,
        /// The first of them.
        first: usize,
    },
}

impl Verdict {
    /// Returns what is not sound.
    pub fn faults(&self) -> Vec<Fault> {
        let free = self.stretch_largest_free.filter(|&stretch| stretch > STRETCH_LIMIT).map(Fault::Stretch);
        let held =
            self.stretch_largest.filter(|&stretch| stretch > HELD_STRETCH_LIMIT).map(Fault::HeldStretch);
        let gap = self.gap_estimate.filter(|&gap| gap > GAP_LIMIT).map(Fault::Gap);
        let missed = self.unconverged.map(|[frames, first]| Fault::Unconverged { frames, first });
        free.or(held).into_iter().chain(gap).chain(missed).collect()
    }

    /// Whether nothing is wrong with it.
    pub fn is_sound(&self) -> bool {
        self.faults().is_empty()
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Stretch(by) => {
                write!(
                    f,
                    "an edge away from the handles was stretched by {:.0} %, more than any cloth",
                    100.0 * by
                )
            }
            Self::HeldStretch(by) => {
                write!(f, "an edge at a handle was stretched by {:.0} %, more than any cloth", 100.0 * by)
            }
            Self::Gap(gap) => write!(
                f,
                "the solver left about {:.0} % of the energy's decrease in a frame undone: it needs more iterations, or \
                 another solver, such as spectral, is needed",
                100.0 * gap.min(1.0)
            ),
            Self::Unconverged { frames, first } => {
                let plural = if frames == 1 { "" } else { "s" };
                write!(f, "newton did not converge in {frames} frame{plural}, first in frame {first}")
            }
        }
    }
}

/// Judges the frames of a rollout of one cloth, one after another.
pub struct Soundness<'a> {
    script: Script<'a>,
    edges: FreeEdges,
    estimate: Option<Estimate>,
    /// The frame before the next one.
    before: State<f32>,
    /// Largest stretches so far, of free and of all edges.
    stretches: Option<[f64; 2]>,
    gaps: Vec<f64>,
    unconverged: Option<[usize; 2]>,
}

impl<'a> Soundness<'a> {
    /// Prepares to judge the frames of a rollout from the start of `setup`.
    pub fn new(setup: &'a Setup) -> Self {
        Self::after(Script::new(setup), &setup.start.cast())
    }

    /// Prepares to judge the frames of a rollout that goes on from this state, where the course of the scene is at `script`.
    pub fn after(script: Script<'a>, start: &State<f32>) -> Self {
        let model = model_of(&script);
        Self {
            edges: FreeEdges::new(&model, 0),
            estimate: (model.grid.particles() <= MOST_PARTICLES).then(|| Estimate::new(&model)),
            script,
            before: start.clone(),
            stretches: None,
            gaps: Vec::new(),
            unconverged: None,
        }
    }

    /// Returns the setup of the scene.
    pub fn setup(&self) -> &'a Setup {
        self.script.setup()
    }

    /// Takes the next frame. Returns the largest stretch of its free edges, NaN if it is not finite.
    pub fn judge(&mut self, frame: &Frame) -> f64 {
        if self.script.enter(frame.index, &self.before).is_some() {
            let model = model_of(&self.script);
            self.edges = FreeEdges::new(&model, 0);
            self.estimate = self.estimate.take().map(|_| Estimate::new(&model));
        }
        let (stats, free) = (&frame.stats[0], self.edges.largest(&frame.state.x));
        let [most_free, most] = self.stretches.unwrap_or([f64::NEG_INFINITY; 2]);
        // NaN stays.
        let larger = |a: f64, b: f64| if a.is_nan() || a > b { a } else { b };
        self.stretches = Some([larger(free, most_free), larger(stats.stretch_largest, most)]);
        if stats.converged == Some(false) {
            let [frames, first] = self.unconverged.unwrap_or([0, frame.index]);
            self.unconverged = Some([frames + 1, first]);
        }
        let every = self.script.setup().model.grid.particles().div_ceil(PARTICLES_PER_FRAME);
        if let Some(estimate) = self.estimate.as_mut().filter(|_| frame.index.is_multiple_of(every)) {
            let control = self.script.control::<f32>(frame.index).cast();
            self.gaps.push(estimate.gap(&self.before.cast(), &frame.state.cast(), &control));
        }
        self.before.clone_from(&frame.state);
        free
    }

    /// Returns the verdict on the frames so far.
    pub fn verdict(&self) -> Verdict {
        let finite = |k: usize| self.stretches.map(|both| both[k]).filter(|stretch| stretch.is_finite());
        Verdict {
            stretch_largest_free: finite(0),
            stretch_largest: finite(1),
            gap_estimate: Some(median(&self.gaps)).filter(|gap| !self.gaps.is_empty() && gap.is_finite()),
            unconverged: self.unconverged,
        }
    }
}

/// Returns the model of the cloth as it is now.
fn model_of(script: &Script<'_>) -> Model {
    Model { grid: script.setup().model.grid, cloths: vec![script.cloth().clone()] }
}

/// Estimates the energy gap of a frame without its minimum.
struct Estimate {
    objective: Objective<f64>,
    in_space: RestHessian<f64>,
    in_sheet: SheetHessian<f64>,
    sheet: SheetAxes<f64>,
    /// Shape [16, H, W].
    axes: Vec<f64>,
    /// Shape [3, H, W].
    still: Vec<f64>,
    /// The decrease of the energy in a frame of free fall.
    of_fall: f64,
    /// Coefficient of the stretch.
    stretch: f64,
}

impl Estimate {
    fn new(model: &Model) -> Self {
        let grid = model.grid;
        let (cloth, n) = (&model.cloths[0], grid.particles());
        let cosines = Arc::new(Cosines::new(grid));
        Self {
            objective: Objective::new(model),
            in_space: RestHessian::with(&cosines, cloth),
            in_sheet: SheetHessian::new(&cosines, cloth, &SheetConstants::FLAT),
            sheet: SheetAxes::new(grid, &model.marks()),
            axes: vec![0.0; AXES * n],
            still: vec![0.0; 3 * n],
            of_fall: free_fall(model),
            stretch: cloth.material.stretch,
        }
    }

    /// Returns the estimated gap of the frame from `before` to `after`.
    fn gap(&mut self, before: &State<f64>, after: &State<f64>, control: &Control<f64>) -> f64 {
        self.objective.begin_frame(before, control);
        self.objective.set_accelerations(&self.still);
        self.objective.evaluate(before, control);
        self.objective.sheet_axes(before, 0, (&mut self.sheet, &mut self.axes));
        let all = self.decrease();
        self.objective.gradient_at_end(before, after, control);
        let left = self.decrease();
        // What the rounding of positions makes of the stiffest term.
        let extent = before.x.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let rounding = self.stretch * (f64::from(f32::EPSILON) * extent).powi(2);
        left / all.max(self.of_fall).max(rounding)
    }

    /// Returns how far the energy lies above its minimum, by the gradient where it was evaluated last.
    fn decrease(&mut self) -> f64 {
        let grad = self.objective.grad();
        let mut direction = grad.to_vec();
        self.in_space.apply(&mut direction);
        let half = |direction: &[f64]| 0.5 * grad.iter().zip(direction).map(|(g, d)| g * d).sum::<f64>();
        let in_space = half(&direction);
        direction.copy_from_slice(grad);
        self.in_sheet.apply_in_sheet(&self.axes, &mut direction);
        in_space.max(half(&direction))
    }
}
