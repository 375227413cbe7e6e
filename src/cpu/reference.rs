//! The converged minimum of a frame, and how far above it an optimizer stays.
//!
//! Handles are not unknowns of a frame: they move to their targets, whatever accelerations an optimizer
//! writes there. Here these count as 0; otherwise the little that they add to inertia and external work would
//! outweigh the rest in a quiet frame.

use super::objective::Trials;
use super::optim::{History, RestHessian, dot, norm};
use super::{FactoredHessian, Objective};
use crate::cloth::{Cloth, Control, Model, State};
use crate::statistics::median;
use crate::{Error, Result};

/// A step must achieve this share of the decrease that its slope predicts (Armijo).
const SUFFICIENT: f64 = 1e-4;
/// Halvings of a step before the search gives up, because no step decreases the energy any more.
const HALVINGS: usize = 30;
/// Number of steps with the Hessian at rest. They cost next to nothing and leave less work for those that
/// follow.
const AT_REST: usize = 10;
/// Number of recent steps that correct an inverse Hessian.
const HISTORY: usize = 8;
/// How often the gradient norm may rise before the Hessian is factored again, which costs as much as a dozen
/// steps.
const RISES: usize = 2;

/// A frame whose energy decreases by less than this share of what it does in free fall is one of a cloth at rest.
const AT_REST_GAIN: f64 = 1e-6;

/// Finds the minimum of a frame of one cloth in double precision by Newton's method with line search. The
/// Hessian is projected where it is not positive definite. Factorisation dominates the cost, so the method
/// begins with a few quasi-Newton steps, and afterwards uses each factorisation as the initial Hessian of
/// such steps for as long as it helps.
///
/// The gradient of a repulsion jumps where a pair enters its range. Layers that only just touch rest there, with the
/// gradient on one side pushing them apart and that on the other pressing them together: such a frame ends near its
/// minimum, but does not count as converged.
pub struct Reference {
    objective: Objective<f64>,
    hessian: FactoredHessian,
    history: History<f64>,
    rest: RestHessian<f64>,
    /// Norm of the gradient at which a frame counts as converged.
    pub tolerance: f64,
    /// Maximum number of iterations.
    pub iterations: usize,
}

/// The inverse Hessian that the next step starts from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Inverse {
    /// That of the sheet at rest.
    AtRest,
    /// None yet: the Hessian must be factored.
    Missing,
    /// That of this iterate.
    Here,
    /// That of an earlier iterate, corrected by the steps since.
    Earlier,
}

/// The result of [`Reference::minimise`].
#[derive(Clone, Debug, PartialEq)]
pub struct Minimum {
    /// Accelerations [edges / frame^2], shape [3, H, W].
    pub a: Vec<f64>,
    /// The energy L there.
    pub energy: f64,
    /// Norms over the free particles of the three components of dL/da there.
    pub norms: [f64; 3],
    /// Iterations taken.
    pub iterations: usize,
    /// Whether the gradient norm is within the tolerance.
    pub converged: bool,
}

impl Minimum {
    /// Returns |dL/da| there, over the free particles.
    pub fn gradient(&self) -> f64 {
        norm(&self.norms)
    }
}

impl Reference {
    /// Builds the reference for one cloth, with |dL/da| <= 1e-8 in at most 2000 iterations, of which few frames need more than
    /// a hundred. Returns an error
    /// if the model is invalid ([`Model::check`]) or holds several cloths, or if there is not enough memory.
    pub fn new(model: &Model) -> Result<Self> {
        model.check()?;
        if model.batch() != 1 {
            return Err(Error::invalid("model", "cloths", "one", model.batch()));
        }
        let hessian = FactoredHessian::new(model.grid)?;
        let history = History::new(HISTORY, 3 * model.grid.particles());
        let objective = Objective::new(model);
        let rest = RestHessian::new(model.grid, &model.cloths[0]);
        Ok(Self { objective, hessian, rest, history, tolerance: 1e-8, iterations: 2000 })
    }

    /// Replaces the cloth by another on the same grid.
    pub(super) fn set_cloth(&mut self, cloth: &Cloth) {
        let grid = self.objective.model().grid;
        self.rest = RestHessian::new(grid, cloth);
        self.objective.set_model(&Model { grid, cloths: vec![cloth.clone()] });
    }

    /// Returns L at the accelerations `a` [3, H, W], in the frame that `control` drives from `state`. Panics
    /// if a length does not match the model, as [`Reference::minimise`] does.
    pub fn energy(&mut self, state: &State<f64>, control: &Control<f64>, a: &[f64]) -> f64 {
        begin(&mut self.objective, state, control, a);
        energy_here(&mut self.objective, state, control)
    }

    /// Finds the minimum of the frame that `control` drives from `state`, starting at the accelerations `a`
    /// [3, H, W].
    pub fn minimise(&mut self, state: &State<f64>, control: &Control<f64>, a: &[f64]) -> Minimum {
        begin(&mut self.objective, state, control, a);
        let mut grad = self.gradient(state, control);
        let mut energy = energy_here(&mut self.objective, state, control);
        // The result for a frame must not depend on the frames before it.
        self.hessian.reset();
        self.history.clear();
        let (mut inverse, mut iterations, mut rises) = (Inverse::AtRest, 0, 0);
        while norm(&grad) > self.tolerance && iterations < self.iterations {
            if inverse == Inverse::Missing {
                let Trials { model, contacts, couples, .. } = &self.objective.trial;
                let trial = self.objective.trial.cloth(state, 0);
                if self
                    .hessian
                    .factor(&trial, model.cloths[0].repulsion, (&contacts[0], &couples[0]))
                    .is_err()
                {
                    break;
                }
                self.history.clear();
                (inverse, rises) = (Inverse::Here, 0);
            }
            self.history.remember(&grad, 0.0);
            match inverse {
                Inverse::AtRest => self.history.compute_direction(Some(&mut self.rest)),
                _ => self.history.compute_direction(Some(&mut self.hessian)),
            }
            let Some(lower) = self.search(energy, &grad, (state, control)) else {
                if inverse == Inverse::Here {
                    break;
                }
                inverse = Inverse::Missing;
                continue;
            };
            energy = lower;
            let before = norm(&grad);
            grad = self.gradient(state, control);
            iterations += 1;
            rises += usize::from(norm(&grad) > before);
            inverse = match inverse {
                Inverse::AtRest if iterations < AT_REST => Inverse::AtRest,
                Inverse::Here | Inverse::Earlier if rises <= RISES => Inverse::Earlier,
                _ => Inverse::Missing,
            };
        }
        let converged = norm(&grad) <= self.tolerance;
        let n = grad.len() / 3;
        let norms = [0, 1, 2].map(|axis| norm(&grad[axis * n..][..n]));
        // A search that failed has left the particles elsewhere.
        self.objective.move_to_trial(state, control);
        let a = self.objective.trial.a.clone();
        Minimum { a, energy, norms, iterations, converged }
    }

    /// Ends the frame at the minimum that was found last: advances `state` to the next one.
    pub fn end_frame(&self, state: &mut State<f64>, control: &Control<f64>) {
        self.objective.end_frame(state, control);
    }

    /// Takes a step against the direction that decreases the energy enough, and returns the energy there.
    /// Returns `None`, with the accelerations unchanged, if there is no such step.
    fn search(
        &mut self,
        energy: f64,
        grad: &[f64],
        (state, control): (&State<f64>, &Control<f64>),
    ) -> Option<f64> {
        let slope = dot(grad, &self.history.direction);
        if slope <= 0.0 {
            // Rounding has turned the direction uphill.
            return None;
        }
        let before = self.objective.trial.a.clone();
        let mut length = 1.0;
        for _ in 0..HALVINGS {
            self.history.step(length, &mut self.objective.trial.a);
            self.objective.move_to_trial(state, control);
            let terms = self.objective.energy(state, 0);
            let lower = terms.total();
            // Close to the minimum a step gains less than the rounding error of the terms, of which external
            // work is negative.
            let cancelled = self.objective.trial.couples[0].cancelled();
            let rounding = 4.0 * f64::EPSILON * (terms.magnitude() + cancelled);
            if lower <= energy - SUFFICIENT * length * slope + rounding {
                return Some(lower);
            }
            self.objective.set_accelerations(&before);
            length *= 0.5;
        }
        None
    }

    /// Returns the gradient over the free particles, 0 at handles.
    fn gradient(&mut self, state: &State<f64>, control: &Control<f64>) -> Vec<f64> {
        self.objective.evaluate(state, control);
        let mut grad = self.objective.grad().to_vec();
        hold(self.objective.model(), &mut grad);
        grad
    }
}

/// The frames of a converged simulation, on which optimizers are compared: each gets the same frames to
/// minimise. In its own simulation, an optimizer would also be judged by what it left undone in earlier
/// frames.
pub struct Track {
    model: Model,
    /// The state before each frame and its control.
    frames: Vec<(State<f32>, Control<f32>)>,
    /// Energies in the frames that converged and in which something moves: frame number, L at a = 0, L at the minimum.
    probes: Vec<(usize, f64, f64)>,
    /// Number of frames at rest. Their energies differ by roundings, so they have no gap.
    still: usize,
    unconverged: usize,
}

impl Track {
    /// Simulates one cloth from `start` through the frames of `controls`. Fails as [`Reference::new`] does.
    /// Panics if a length does not match the model.
    pub fn new(
        model: &Model,
        start: State<f64>,
        controls: impl IntoIterator<Item = Control<f64>>,
    ) -> Result<Self> {
        let mut reference = Reference::new(model)?;
        let (mut state, mut frames, mut probes) = (start, Vec::new(), Vec::new());
        let (mut at_rest, mut unconverged) = (0, 0);
        let still = vec![0.0; state.x.len()];
        let least = AT_REST_GAIN * free_fall(model);
        for (frame, control) in controls.into_iter().enumerate() {
            // The optimizers get a frame in single precision, and the energies belong to that very frame: in a
            // cloth at rest, rounding its state changes them as much as an optimizer does.
            let (single, control) = (state.cast::<f32>(), control.cast::<f32>());
            state = single.cast();
            frames.push((single, control.clone()));
            let control = control.cast::<f64>();
            let nothing = reference.energy(&state, &control, &still);
            let minimum = reference.minimise(&state, &control, &still);
            unconverged += usize::from(!minimum.converged);
            if minimum.converged && nothing - minimum.energy > least {
                probes.push((frame, nothing, minimum.energy));
            } else if minimum.converged {
                at_rest += 1;
            }
            reference.end_frame(&mut state, &control);
        }
        Ok(Self { model: model.clone(), frames, probes, still: at_rest, unconverged })
    }

    /// Returns the median of the energy gaps `(L(a) - L_ref) / (L(0) - L_ref)` over the frames with a
    /// reference in which something moves; 0 if all are at rest, and infinite if one of them is not finite, or if there
    /// are none. `accelerations` is called for
    /// one frame after another with its state and control, and computes a [3, H, W]. As soon as it returns
    /// `None`, so does this function.
    pub fn median_gap(
        &self,
        mut accelerations: impl FnMut(&State<f32>, &Control<f32>) -> Result<Option<Vec<f32>>>,
    ) -> Result<Option<f64>> {
        let mut objective = Objective::new(&self.model);
        let mut probes = self.probes.iter().peekable();
        let (mut gaps, mut finite) = (Vec::with_capacity(self.probes.len()), true);
        for (frame, (before, control)) in self.frames.iter().enumerate() {
            let Some(a) = accelerations(before, control)? else { return Ok(None) };
            finite &= a.iter().all(|a| a.is_finite());
            if let Some(&(_, nothing, minimum)) = probes.next_if(|probe| probe.0 == frame) {
                let a: Vec<f64> = a.into_iter().map(f64::from).collect();
                let (state, control) = (before.cast(), control.cast());
                begin(&mut objective, &state, &control, &a);
                let reached = energy_here(&mut objective, &state, &control);
                gaps.push((reached - minimum) / (nothing - minimum));
            }
        }
        Ok(Some(match gaps.iter().all(|gap| gap.is_finite()) {
            true if !gaps.is_empty() => median(&gaps),
            true if finite && self.still > 0 => 0.0,
            _ => f64::INFINITY,
        }))
    }

    /// Returns the model of the cloth.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Returns the number of frames without a reference, because Newton's method did not converge.
    pub fn unconverged(&self) -> usize {
        self.unconverged
    }
}

/// Returns the decrease of the energy in a frame in which the cloth falls freely from rest.
pub(crate) fn free_fall(model: &Model) -> f64 {
    let square: f64 = model.cloths[0].gravity.iter().map(|g| g * g).sum();
    // The masses of the particles add up to (H-1)(W-1), and the energy is a mean over H W.
    0.5 * square * ((model.grid.h - 1) * (model.grid.w - 1)) as f64 / model.grid.particles() as f64
}

/// Begins a frame at the accelerations `a` [3, H, W], with those of handles set to 0, and outside the bodies.
fn begin(objective: &mut Objective<f64>, state: &State<f64>, control: &Control<f64>, a: &[f64]) {
    objective.begin_frame(state, control);
    objective.set_accelerations(a);
    let Trials { model, a, .. } = &mut objective.trial;
    hold(model, a);
    objective.confine(state, |_, _, _| ());
}

/// Returns L where the accelerations lead.
fn energy_here(objective: &mut Objective<f64>, state: &State<f64>, control: &Control<f64>) -> f64 {
    objective.move_to_trial(state, control);
    objective.energy(state, 0).total()
}

/// Zeroes a field [3, H, W] where no free particle is.
pub(super) fn hold(model: &Model, field: &mut [f64]) {
    let held = model.cloths[0].held();
    for component in field.chunks_exact_mut(model.grid.particles()) {
        held.iter().for_each(|&p| component[p] = 0.0);
    }
}
