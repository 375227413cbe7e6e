//! The best step among a few directions: the minimum of the energy's local quadratic model over them.

use super::passes::Pass;
use super::rest_hessian::{Cosines, hold};
use super::{Extrapolation, SheetSteps, Update, best_start};
use crate::Result;
use crate::cloth::modes::SheetConstants;
use crate::cloth::{Cloth, Control, EnergyTerms, Mark, Model, State};
use crate::cpu::cloth::{AXES, CurvatureRows, LocalModel, SheetAxes};
use crate::cpu::{Objective, Real};
use crate::settings::LEARNED_ITERATIONS;
use crate::sim::{Direction, MAX_DIRECTIONS, Optimizer, StepCounts};
use rayon::prelude::*;
use std::sync::Arc;

/// An eigenvalue of the curvature counts as at least this share of the largest one, so that a singular model gives
/// a finite step.
const LEAST_EIGENVALUE: f64 = 1e-7;
/// Sweeps of Jacobi's method. Four directions need five for single precision and six for double.
const SWEEPS: usize = 8;
/// Energies that differ by less than this share of their terms' magnitude, in units of the precision, count as
/// equal.
const ROUNDINGS: f64 = 8.0;

/// Minimises a frame of a batch of cloths by steps in a subspace.
///
/// A frame starts at the best point near the accelerations of the two frames before ([`best_start`]). Each iteration
/// first checks the step before: where it raised the energy, it is shortened and the iteration ends there. So the
/// energy never rises from one accepted iterate to the next.
pub struct Subspace<T: Real> {
    directions: Vec<Direction>,
    network: Option<Update<T>>,
    cloths: Vec<OfCloth<T>>,
    /// Accelerations of all cloths after a step, shape [B, 3, H, W].
    moved: Vec<T>,
    /// Norms of the gradient at a = 0 for each component of each cloth, shape [B, 3].
    norms_at_start: Vec<f64>,
}

/// The state of one cloth.
struct OfCloth<T> {
    /// Shape [K, 3, H, W], with room for the two directions of the start.
    directions: Vec<T>,
    /// The step that was taken last, or at the start of a frame the accelerations of the frame before, 0 at
    /// handles; shape [3, H, W].
    last: Vec<T>,
    /// The accelerations of the last frame, at its end those of the frame before it, 0 at handles; shape [3, H, W].
    earlier: Vec<T>,
    extrapolation: Extrapolation<T>,
    sheet: SheetAxes<T>,
    axes: Vec<T>,
    /// If the spectral or the co-rotated direction is among them.
    steps_of_sheet: Option<SheetSteps<T>>,
    rows: CurvatureRows<T>,
    accepted: Accepted,
    steps: StepCounts,
    held: Vec<usize>,
}

/// The energy of the iterate that was accepted last, and the sum of its terms' magnitudes.
#[derive(Clone, Copy, Debug)]
struct Accepted {
    energy: f64,
    magnitude: f64,
    /// The slope of the energy along the step from there.
    slope: f64,
}

impl<T: Real> Subspace<T> {
    /// Builds the minimizer for the cloths of `model`. Fails if the grid does not suit the network or there is not
    /// enough memory.
    pub fn new(optimizer: &Optimizer, model: &Model) -> Result<Self> {
        let directions = optimizer.directions.clone();
        let network = match optimizer.weights() {
            Some(weights) => Some(super::update(weights, model)?),
            None => None,
        };
        let moved = vec![T::zero(); 3 * model.batch() * model.grid.particles()];
        let norms_at_start = vec![0.0; 3 * model.batch()];
        let mut new = Self { directions, network, cloths: Vec::new(), moved, norms_at_start };
        new.set_cloths(model);
        Ok(new)
    }

    /// Takes the materials and handles of other cloths. The memory of frames before stays if their number does.
    pub fn set_cloths(&mut self, model: &Model) {
        let cosines = Arc::new(Cosines::new(model.grid));
        let old = std::mem::take(&mut self.cloths);
        let needs_steps =
            self.directions.iter().any(|d| matches!(d, Direction::Spectral | Direction::CoRotated));
        let n = model.grid.particles();
        let zeros = |fields: usize| vec![T::zero(); fields * n];
        let marks = model.marks();
        let new = |(cloth, marks): (&Cloth, &[Mark])| {
            let held = cloth.held();
            OfCloth {
                directions: zeros(3 * self.directions.len().max(2)),
                last: zeros(3),
                earlier: zeros(3),
                extrapolation: Extrapolation::new(model.grid, &held),
                sheet: SheetAxes::new(model.grid, marks),
                axes: zeros(AXES),
                steps_of_sheet: needs_steps
                    .then(|| SheetSteps::new(&cosines, cloth, &SheetConstants::FITTED)),
                rows: CurvatureRows::new(model.grid),
                accepted: Accepted { energy: f64::INFINITY, magnitude: 0.0, slope: 0.0 },
                steps: StepCounts::default(),
                held,
            }
        };
        self.cloths = model.cloths.iter().zip(marks.chunks_exact(n)).map(new).collect();
        for (new, old) in self.cloths.iter_mut().zip(old) {
            (new.last, new.earlier) = (old.last, old.earlier);
        }
    }

    /// Starts a frame of `objective`, which has begun it and still holds the accelerations of the frame before;
    /// they become 0.
    pub fn begin_frame(&mut self, objective: &mut Objective<T>, (state, control): (&State<T>, &Control<T>)) {
        let len = objective.cloth_len();
        for (cloth, a) in self.cloths.iter_mut().zip(objective.trial.a.chunks_exact_mut(len)) {
            cloth.steps = StepCounts::default();
            // Taken at the end of the last frame; handles accelerate as they are told.
            hold(&cloth.held, &mut cloth.last);
            hold(&cloth.held, &mut cloth.earlier);
            a.fill(T::zero());
        }
        objective.move_to_trial(state, control);
        {
            let objective = &*objective;
            let each = self.cloths.par_iter_mut().enumerate().filter(|(_, own)| own.steps_of_sheet.is_some());
            each.for_each(|(b, own)| {
                objective.sheet_axes(state, b, (&mut own.sheet, &mut own.axes));
                objective.shorten_axes(b, &mut own.axes);
            });
        }
        objective.confine(state, |_, _, _| ());
        self.start_warm(objective, (state, control));
    }

    /// Adds the best start near the accelerations of the two frames before.
    fn start_warm(&mut self, objective: &mut Objective<T>, (state, control): (&State<T>, &Control<T>)) {
        let starts_warm = self.directions.iter().any(|direction| matches!(direction, Direction::Last));
        objective.evaluate(state, control);
        self.norms_at_start.copy_from_slice(&objective.norms);
        {
            let objective = &*objective;
            self.cloths.par_iter_mut().enumerate().for_each(|(b, cloth)| {
                let along = if starts_warm { cloth.set_directions_of_start() } else { 0 };
                let along = &cloth.directions[..along];
                let model = objective.local_model(state, b, (along, &mut cloth.rows));
                cloth.accepted = Accepted::of(&model.energy);
                cloth.last.fill(T::zero());
                if starts_warm {
                    cloth.take(&best_start(&model), &model.slopes);
                }
            });
        }
        let len = objective.cloth_len();
        for (cloth, a) in self.cloths.iter().zip(objective.trial.a.chunks_exact_mut(len)) {
            Pass::Add(a, T::one(), &cloth.last).run();
        }
        self.end_step(objective, state);
    }

    /// Ends a step: moves particles out of the bodies, which counts as part of it, and tells the network.
    fn end_step(&mut self, objective: &mut Objective<T>, state: &State<T>) {
        let Self { network, cloths, .. } = self;
        objective.confine(state, |b, element, out| {
            let last = &mut cloths[b].last[element];
            *last = *last + out;
        });
        if let Some(network) = network {
            cloths.iter().enumerate().for_each(|(b, cloth)| network.took(b, &cloth.last));
        }
    }

    /// Adds the step of `iteration`, counted from 0, to the accelerations of `objective`, which has been evaluated
    /// there.
    pub fn step(&mut self, objective: &mut Objective<T>, state: &State<T>, iteration: usize) {
        let Self { directions, network, cloths, moved, .. } = self;
        let count = directions.len();
        let proposed = match network {
            Some(network) if iteration < LEARNED_ITERATIONS => {
                network.hidden_mut().scale_to_step();
                network.propose(&objective.grad, &objective.norms)
            }
            _ => &[],
        };
        let len = objective.cloth_len();
        // The steps go to a copy, which then changes places with the accelerations.
        moved.copy_from_slice(&objective.trial.a);
        {
            let objective = &*objective;
            let each = cloths.par_iter_mut().zip(moved.par_chunks_exact_mut(len)).enumerate();
            each.for_each(|(b, (cloth, a))| {
                let grad = &objective.grad[b * len..][..len];
                for (p, kind) in cloth.directions.chunks_exact_mut(len).zip(&*directions) {
                    match kind {
                        Direction::Last => p.copy_from_slice(&cloth.last),
                        // Later its last proposal stays.
                        Direction::Network(_) if proposed.is_empty() => continue,
                        Direction::Network(_) => p.copy_from_slice(&proposed[b * len..][..len]),
                        _ => Pass::Negate(p, grad).run(),
                    }
                    match (kind, &mut cloth.steps_of_sheet) {
                        (Direction::Spectral, Some(steps)) => steps.in_space(&cloth.axes, p),
                        (Direction::CoRotated, Some(steps)) => steps.in_sheet(&cloth.axes, p),
                        _ => hold(&cloth.held, p),
                    }
                }
                let along = &cloth.directions[..count * len];
                let model = objective.local_model(state, b, (along, &mut cloth.rows));
                cloth.advance(&model, count, a);
            });
        }
        std::mem::swap(&mut objective.trial.a, moved);
        self.end_step(objective, state);
    }

    /// Takes the last step back if it raised the energy of `objective`, which has moved to where it led.
    pub fn check_last_step(&mut self, objective: &mut Objective<T>, state: &State<T>) {
        let len = objective.cloth_len();
        for (b, cloth) in self.cloths.iter_mut().enumerate() {
            let energy = objective.energy_in_rows(state, b, &mut cloth.rows);
            let a = &mut objective.trial.a[b * len..][..len];
            if !cloth.accepted.allows::<T>(&Accepted::of(&energy)) {
                cloth.steps.shortened += 1;
                a.iter_mut().zip(&cloth.last).for_each(|(a, &step)| *a = *a - step);
            }
        }
    }

    /// Ends a frame: the next one begins with its accelerations.
    pub fn end_frame(&mut self, objective: &Objective<T>) {
        let accelerations = objective.trial.a.chunks_exact(objective.cloth_len());
        for (cloth, a) in self.cloths.iter_mut().zip(accelerations) {
            cloth.last.copy_from_slice(a);
            if !a.iter().all(|a| a.is_finite()) {
                cloth.last.fill(T::zero());
            }
        }
    }

    /// Returns what became of the steps of cloth `b` in this frame.
    pub fn step_counts(&self, b: usize) -> StepCounts {
        self.cloths[b].steps
    }

    /// Returns the norms of the gradient at the start of this frame, at a = 0, for each component of each cloth.
    pub fn norms_at_start(&self) -> &[f64] {
        &self.norms_at_start
    }

    /// Clears the memory of earlier frames for this cloth.
    pub fn reset_memory_of(&mut self, cloth: usize) {
        self.cloths[cloth].last.fill(T::zero());
        self.cloths[cloth].earlier.fill(T::zero());
        if let Some(network) = &mut self.network {
            super::Minimizer::reset_memory_of(network, cloth);
        }
    }

    /// Returns the accelerations of the last frame and of the frame before it, of each cloth.
    pub fn last_accelerations(&mut self) -> impl Iterator<Item = [&mut [T]; 2]> {
        self.cloths.iter_mut().map(|cloth| [&mut cloth.last[..], &mut cloth.earlier])
    }

    /// Returns the update rule of the network among the directions.
    pub fn network(&mut self) -> Option<&mut Update<T>> {
        self.network.as_mut()
    }

    /// Returns the scale of the network's steps for each sample, shape \[S\]; empty without a network.
    pub fn scales(&self) -> &[T] {
        self.network.as_ref().map_or(&[], |network| super::Minimizer::scales(network))
    }
}

impl Accepted {
    fn of(energy: &EnergyTerms) -> Self {
        Self { energy: energy.total(), magnitude: energy.magnitude(), slope: 0.0 }
    }

    /// Whether an iterate after this one may be accepted: its energy is not higher, but for rounding.
    fn allows<T: Real>(&self, next: &Self) -> bool {
        let rounding = ROUNDINGS * T::epsilon().f64() * self.magnitude.max(next.magnitude);
        next.energy.is_finite() && next.energy <= self.energy + rounding
    }

    /// Returns the fraction to which the step shortens if it raised the energy to that of `next`: where the parabola
    /// through both energies and the slope is least, 0.1 to 0.5.
    fn fraction(&self, next: &Self) -> f64 {
        let rise = next.energy - self.energy;
        let least = -0.5 * self.slope / (rise - self.slope);
        if rise.is_finite() && least.is_finite() { least.clamp(0.1, 0.5) } else { 0.1 }
    }
}

impl<T: Real> OfCloth<T> {
    /// Sets two directions to the accelerations of the last frame and to what extrapolates them, and returns the number of
    /// elements of both. The last frame's are the earlier ones from then on.
    fn set_directions_of_start(&mut self) -> usize {
        let Self { directions, last, earlier, extrapolation, .. } = self;
        let (near, rest) = directions[..2 * last.len()].split_at_mut(last.len());
        near.copy_from_slice(last);
        extrapolation.smooth([last, earlier], rest);
        earlier.copy_from_slice(last);
        2 * last.len()
    }

    /// Adds the directions times these factors to the last step, and their slopes to that along it.
    fn take(&mut self, factors: &[f64], slopes: &[f64]) {
        let directions = self.directions.chunks_exact(self.last.len());
        for ((&factor, &slope), p) in factors.iter().zip(slopes).zip(directions) {
            // A direction that is left out may hold NaN.
            if factor != 0.0 {
                self.accepted.slope += factor * slope;
                let factor = T::of(factor);
                Pass::Add(&mut self.last, factor, p).run();
            }
        }
    }

    /// Adds the next step to the accelerations `a`: the best one in the model of `count` directions, or, if the step before raised the
    /// energy, the way back to a fraction of it.
    fn advance(&mut self, model: &LocalModel, count: usize, a: &mut [T]) {
        let here = Accepted::of(&model.energy);
        if !self.accepted.allows::<T>(&here) {
            let fraction = self.accepted.fraction(&here);
            self.steps.shortened += 1;
            self.accepted.slope *= fraction;
            let fraction = T::of(fraction);
            for (a, step) in a.iter_mut().zip(&mut self.last) {
                let kept = fraction * *step;
                *a = *a - (*step - kept);
                *step = kept;
            }
            return;
        }
        let best = best_step(model, count);
        self.steps.dropped += best.dropped;
        self.accepted = here;
        self.last.fill(T::zero());
        self.take(&best.factors[..count], &model.slopes);
        Pass::Add(a, T::one(), &self.last).run();
    }
}

/// The minimum of a local model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BestStep {
    /// The factor of each direction.
    pub factors: [f64; MAX_DIRECTIONS],
    /// Directions that are not finite, and do not take part.
    pub dropped: usize,
}

/// Returns the minimum of `b.c + c.A.c / 2` over the factors c of the first `count` directions of a model.
///
/// The directions are scaled to length 1 first. With `A = V diag(l) V'`, each l counts as the larger of `|l|` and
/// 1e-7 of the largest, so an indefinite or singular A gives a direction of descent.
pub fn best_step(model: &LocalModel, count: usize) -> BestStep {
    let mut best = BestStep::default();
    let mut scale = [0.0; MAX_DIRECTIONS];
    for (k, scale) in scale.iter_mut().enumerate().take(count) {
        let is_finite =
            [model.squares[k], model.slopes[k], model.curvature[k][k]].iter().all(|v| v.is_finite());
        best.dropped += usize::from(!is_finite);
        if is_finite && model.squares[k] > 0.0 {
            *scale = model.squares[k].sqrt().recip();
        }
    }
    let zero_if_left_out = |v: f64, scale: f64| if scale == 0.0 || !v.is_finite() { 0.0 } else { v * scale };
    let mut a = [[0.0; MAX_DIRECTIONS]; MAX_DIRECTIONS];
    let mut slopes = [0.0; MAX_DIRECTIONS];
    for i in 0..count {
        slopes[i] = zero_if_left_out(model.slopes[i], scale[i]);
        for j in 0..count {
            a[i][j] = zero_if_left_out(model.curvature[i][j], scale[i] * scale[j]);
        }
    }
    let (values, vectors) = eigen(a);
    let largest = values.iter().fold(0.0_f64, |largest, l| largest.max(l.abs()));
    if !(largest > 0.0 && largest.is_finite()) {
        return best;
    }
    for (l, vector) in values.iter().zip(vectors) {
        let along: f64 = vector.iter().zip(slopes).map(|(v, b)| v * b).sum();
        let factor = -along / l.abs().max(LEAST_EIGENVALUE * largest);
        for k in 0..count {
            best.factors[k] += factor * vector[k] * scale[k];
        }
    }
    // A step that overflows could never be taken back.
    if !best.factors.iter().all(|factor| factor.is_finite()) {
        best.factors = [0.0; MAX_DIRECTIONS];
    }
    best
}

/// Returns the eigenvalues of a symmetric matrix and its eigenvectors, one per row, by cyclic Jacobi rotations.
fn eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut vectors: [[f64; N]; N] =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for _ in 0..SWEEPS {
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = (t * t + 1.0).sqrt().recip();
                let s = t * c;
                for row in &mut a {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
                for k in 0..N {
                    (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
                    (vectors[p][k], vectors[q][k]) =
                        (c * vectors[p][k] - s * vectors[q][k], s * vectors[p][k] + c * vectors[q][k]);
                }
            }
        }
    }
    (std::array::from_fn(|k| a[k][k]), vectors)
}
