//! The objective of a frame: the energy of each cloth of a batch as a function of its accelerations, and its
//! gradient.

use super::Real;
use super::cloth::{
    Approach, Contacts, Couples, CurvatureRows, Elements, Frame, GradientRows, Layers, LocalModel, NearPairs,
    SheetAxes, Trial, add_wind, end_frame, energy, gradient, local_model, masses, repulsion,
    repulsion_curvature, shifts, stretch,
};
use super::optim::norm;
use crate::cloth::{BodyStats, Control, EnergyTerms, LayerStats, Mark, Model, State, Sweep};
use crate::settings::{PARTING_ROUNDS, PARTINGS};
use crate::sim::MAX_DIRECTIONS;
use rayon::prelude::*;

/// The energies L(a) of a batch of cloths (paper section 3.2).
pub struct Objective<T> {
    pub(super) trial: Trials<T>,
    /// One per cloth.
    rows: Vec<GradientRows<T>>,
    /// External accelerations plus those of repulsion and contacts [edges / frame^2], shape [B, 3, H, W]; empty if no
    /// cloth repels or meets bodies.
    total_acceleration: Vec<T>,
    /// Gradient dL/da, shape [B, 3, H, W].
    pub(super) grad: Vec<T>,
    /// The norm of the gradient for each component of each cloth, shape [B, 3].
    pub(super) norms: Vec<f64>,
    /// The energy of the repulsion of each cloth where the gradient was computed, shape \[B\].
    repulsion_energy: Vec<f64>,
}

/// All cloths at their trial accelerations.
pub(super) struct Trials<T> {
    pub model: Model,
    /// Accelerations [edges / frame^2], shape [B, 3, H, W].
    pub a: Vec<T>,
    /// The displacements that they cause \[edges\], shape [B, 3, H, W].
    pub shift: Vec<T>,
    /// External accelerations [edges / frame^2], shape [B, 3, H, W].
    f: Vec<T>,
    /// What each particle is, shape [B, H, W].
    pub marks: Vec<Mark>,
    /// Masses of the particles over H W, shape [B, H, W].
    masses: Vec<T>,
    /// The edges and angles of each cloth that is not a full rectangle, shape \[B\].
    elements: Vec<Option<Elements<T>>>,
    /// Contacts of each cloth in this frame, shape \[B\].
    pub contacts: Vec<Contacts<T>>,
    /// Which particles of each cloth may be near each other, where it repels itself, shape \[B\].
    near: Vec<NearPairs<T>>,
    /// Couples of each cloth in this frame, shape \[B\].
    pub couples: Vec<Couples<T>>,
}

/// Whether the gradient sees forces that depend on the positions.
fn has_total(model: &Model) -> bool {
    model.repels() || model.touches_itself() || model.bodies() > 0 || model.has_rest_angles()
}

impl<T: Real> Objective<T> {
    /// Builds the objective for the cloths of `model`, at a = 0.
    pub fn new(model: &Model) -> Self {
        let zeros = || vec![T::zero(); model.batch() * 3 * model.grid.particles()];
        let total_acceleration = if has_total(model) { zeros() } else { Vec::new() };
        let mut trial = Trials {
            model: model.clone(),
            a: zeros(),
            shift: zeros(),
            f: zeros(),
            marks: Vec::new(),
            masses: Vec::new(),
            elements: Vec::new(),
            contacts: vec![Contacts::default(); model.batch()],
            near: vec![NearPairs::default(); model.batch()],
            couples: vec![Couples::default(); model.batch()],
        };
        trial.mark();
        Self {
            trial,
            rows: (0..model.batch()).map(|_| GradientRows::new(model.grid)).collect(),
            total_acceleration,
            grad: zeros(),
            norms: vec![0.0; 3 * model.batch()],
            repulsion_energy: vec![0.0; model.batch()],
        }
    }

    /// Replaces the cloths with as many others on the same grid. Panics if the sizes differ.
    pub fn set_model(&mut self, model: &Model) {
        let old = &mut self.trial.model;
        assert!(
            model.grid == old.grid && model.batch() == old.batch(),
            "grid and batch size must not change"
        );
        old.clone_from(model);
        self.repulsion_energy.fill(0.0);
        self.total_acceleration.resize(if has_total(model) { self.grad.len() } else { 0 }, T::zero());
        self.trial.mark();
        self.trial.contacts.fill(Contacts::default());
        self.trial.couples.fill(Couples::default());
    }

    /// Returns the cloths.
    pub fn model(&self) -> &Model {
        &self.trial.model
    }

    /// Returns the gradient dL/da of the last [`Objective::evaluate`], shape [B, 3, H, W].
    pub fn grad(&self) -> &[T] {
        &self.grad
    }

    /// Returns the norm of the gradient for each component of each cloth, shape [B, 3].
    pub fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// Returns the length of one cloth's arrays.
    pub fn cloth_len(&self) -> usize {
        3 * self.trial.model.grid.particles()
    }

    /// Starts a frame, during which gravity, wind and the external accelerations of `control` are constant, and bodies
    /// are planes. Panics if a length does not match the model.
    pub fn begin_frame(&mut self, state: &State<T>, control: &Control<T>) {
        let Trials { model, f, marks, contacts, couples, .. } = &mut self.trial;
        let (grid, batch, cloth) = (model.grid, model.batch(), 3 * model.grid.particles());
        let len = batch * cloth;
        assert!(state.x.len() == len && state.v.len() == len, "a state has shape [B, 3, H, W]");
        control.check(model).unwrap_or_else(|e| panic!("{e}"));
        for (b, (f, setting)) in f.chunks_exact_mut(cloth).zip(&model.cloths).enumerate() {
            for (f, &g) in f.chunks_exact_mut(cloth / 3).zip(&setting.gravity) {
                f.fill(T::of(g));
            }
            let at = b * cloth..(b + 1) * cloth;
            if !control.external.is_empty() {
                for (f, &external) in f.iter_mut().zip(&control.external[at.clone()]) {
                    *f = *f + external;
                }
            }
            let wind = control.wind.get(b).copied().unwrap_or([T::zero(); 3]);
            let marks = &marks[b * cloth / 3..][..cloth / 3];
            add_wind((grid, marks), setting.air, wind, (&state.x[at.clone()], &state.v[at.clone()]), f);
            let start = Approach {
                grid,
                cloth: setting,
                sweeps: &sweeps(model, control, b),
                x: &state.x[at.clone()],
                v: &state.v[at.clone()],
                marks,
                handles: &control.handles,
            };
            couples[b] = Couples::find(&start);
            if !setting.bodies.is_empty() || setting.self_contact.is_some() {
                contacts[b] = Contacts::find(start);
            }
        }
    }

    /// Changes the trial accelerations of particles that they lead into a body or through another layer, so that they stay
    /// outside. Calls `moved` with the cloth, the element and what was added.
    pub fn confine(&mut self, state: &State<T>, mut moved: impl FnMut(usize, usize, T)) {
        let cloth = self.cloth_len();
        let Trials { model, a, contacts, .. } = &mut self.trial;
        let fields = a.chunks_exact_mut(cloth).zip(state.v.chunks_exact(cloth));
        for (b, ((a, v), (contacts, setting))) in fields.zip(contacts.iter().zip(&model.cloths)).enumerate() {
            contacts.confine(&setting.bodies, v, a, |element, out| moved(b, element, out));
        }
    }

    /// Changes the trial accelerations at the end of a frame where they lead layers through each other.
    pub fn part_layers(&mut self, state: &State<T>, control: &Control<T>) {
        let cloth = self.cloth_len();
        let Trials { model, a, marks, contacts, .. } = &mut self.trial;
        for (b, (a, setting)) in a.chunks_exact_mut(cloth).zip(&model.cloths).enumerate() {
            let Some(settings) = setting.self_contact else { continue };
            contacts[b].part_layers(a);
            let at = b * cloth..(b + 1) * cloth;
            for _ in 0..PARTING_ROUNDS {
                let start = Approach {
                    grid: model.grid,
                    cloth: setting,
                    sweeps: &[],
                    x: &state.x[at.clone()],
                    v: &state.v[at.clone()],
                    marks: &marks[b * cloth / 3..][..cloth / 3],
                    handles: &control.handles,
                };
                let layers = Layers::find_missed(&start, settings, a);
                if !layers.part(PARTINGS, a) {
                    break;
                }
            }
        }
    }

    /// Sets the trial accelerations \[edges / frame^2\], shape [B, 3, H, W]. Panics if the length does not
    /// match the model.
    pub fn set_accelerations(&mut self, a: &[T]) {
        self.trial.a.copy_from_slice(a);
    }

    /// Moves the particles to where the trial accelerations lead.
    pub fn move_to_trial(&mut self, state: &State<T>, control: &Control<T>) {
        let cloth = self.cloth_len();
        let Trials { model, shift, a, marks, contacts, near, .. } = &mut self.trial;
        for (b, shift) in shift.chunks_exact_mut(cloth).enumerate() {
            let at = b * cloth..(b + 1) * cloth;
            let frame = frame(marks, a, control, (b, cloth / 3));
            shifts(frame, &state.x[at.clone()], &state.v[at.clone()], shift);
            contacts[b].move_to(shift);
            if let Some(of_cloth) = model.cloths[b].repulsion {
                let places = NearPairs::places(&marks[b * cloth / 3..][..cloth / 3], &state.x[at], shift);
                near[b].update(model.grid, &places, T::of(of_cloth.distance));
            }
        }
    }

    /// Moves the particles as [`Objective::move_to_trial`] does, then computes the gradient there and its norms.
    pub fn evaluate(&mut self, state: &State<T>, control: &Control<T>) {
        T::evaluate(self, state, control);
    }

    pub(super) fn generic_evaluate(&mut self, state: &State<T>, control: &Control<T>) {
        self.move_to_trial(state, control);
        let cloth = self.cloth_len();
        let Self { trial, rows, total_acceleration, grad, norms, repulsion_energy } = self;
        let each = total_acceleration.par_chunks_exact_mut(cloth).zip(repulsion_energy).enumerate();
        each.for_each(|(b, (total_acceleration, energy))| {
            let before = trial.cloth(state, b);
            *energy = match trial.model.cloths[b].repulsion {
                Some(of_cloth) => repulsion(&before, of_cloth, total_acceleration),
                None => {
                    total_acceleration.copy_from_slice(before.f);
                    0.0
                }
            };
            trial.contacts[b].add_accelerations(before.marks, total_acceleration);
            trial.couples[b].add_accelerations(&before, total_acceleration);
        });
        let of_cloth = |b: usize, grad: &mut [T], norms: &mut [f64], rows: &mut GradientRows<T>| {
            let mut of_gradient = trial.cloth(state, b);
            if !total_acceleration.is_empty() {
                // What depends on positions alone is an external force to the gradient.
                of_gradient.f = &total_acceleration[b * cloth..][..cloth];
            }
            gradient(&of_gradient, rows, grad);
            for (norm_of, grad) in norms.iter_mut().zip(grad.chunks_exact(cloth / 3)) {
                *norm_of = norm(grad);
            }
        };
        match &mut rows[..] {
            // A single cloth is not worth waking a thread for.
            [rows] => of_cloth(0, grad, norms, rows),
            rows => {
                let grads = grad.par_chunks_exact_mut(cloth).zip(norms.par_chunks_exact_mut(3));
                let each = grads.zip(rows).enumerate();
                each.for_each(|(b, ((grad, norms), rows))| of_cloth(b, grad, norms, rows));
            }
        }
    }

    /// Sets the accelerations of the handles to the external ones, which minimise their terms of the energy.
    /// Nothing else depends on them, since handles move to their targets regardless.
    pub(super) fn settle_handles(&mut self) {
        let Trials { model, a, f, .. } = &mut self.trial;
        let n = model.grid.particles();
        for (b, cloth) in model.cloths.iter().enumerate() {
            let fields = (3 * b * n..3 * (b + 1) * n).step_by(n);
            for at in fields.flat_map(|first| cloth.handles.iter().map(move |&p| first + p)) {
                a[at] = f[at];
            }
        }
    }

    /// Returns |dL/da| over the free particles of cloth 0 at the end of the frame, driven by `control`, that
    /// led from `before` to `after`.
    pub fn gradient_at_end(&mut self, before: &State<T>, after: &State<T>, control: &Control<T>) -> f64 {
        self.begin_frame(before, control);
        for (a, (&after, &before)) in self.trial.a.iter_mut().zip(after.v.iter().zip(&before.v)) {
            *a = after - before;
        }
        self.settle_handles();
        self.evaluate(before, control);
        self.norms[..3].iter().map(|norm| norm * norm).sum::<f64>().sqrt()
    }

    /// Returns the energy terms of cloth `b` at the current trial.
    pub fn energy(&self, state: &State<T>, b: usize) -> EnergyTerms {
        let trial = self.trial.cloth(state, b);
        let mut terms = energy(&trial);
        if let Some(of_cloth) = self.trial.model.cloths[b].repulsion {
            terms.repulsion = repulsion(&trial, of_cloth, &mut vec![T::zero(); self.cloth_len()]);
        }
        terms.contact = self.trial.contacts[b].energy();
        terms.bend += self.trial.couples[b].energy(&trial);
        terms
    }

    /// Returns the energy of cloth `b` at the trial of the last [`Objective::evaluate`], and its slopes and second
    /// derivatives along `directions` [K, 3, H, W], which are 0 at handles.
    pub fn local_model(
        &self,
        state: &State<T>,
        b: usize,
        (directions, rows): (&[T], &mut CurvatureRows<T>),
    ) -> LocalModel {
        let trial = self.trial.cloth(state, b);
        let grad = &self.grad[b * self.cloth_len()..][..self.cloth_len()];
        let mut model = local_model(&trial, rows, directions, grad);
        model.energy.repulsion = self.repulsion_energy[b];
        let mut add = |more: [[f64; MAX_DIRECTIONS]; MAX_DIRECTIONS]| {
            for (sums, more) in model.curvature.iter_mut().zip(more) {
                sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
            }
        };
        if let Some(of_cloth) = self.trial.model.cloths[b].repulsion {
            add(repulsion_curvature(&trial, of_cloth, directions));
        }
        add(self.trial.contacts[b].curvature(directions, self.cloth_len()));
        self.trial.couples[b].add_curvature(&trial, directions, &mut model.curvature);
        model.energy.contact = self.trial.contacts[b].energy();
        model.energy.bend += self.trial.couples[b].energy(&trial);
        model
    }

    /// Returns the energy terms of cloth `b` at the current trial, as [`Objective::local_model`] sums them.
    pub(super) fn energy_in_rows(
        &self,
        state: &State<T>,
        b: usize,
        rows: &mut CurvatureRows<T>,
    ) -> EnergyTerms {
        let trial = self.trial.cloth(state, b);
        let mut terms = local_model(&trial, rows, &[], &[]).energy;
        if let Some(of_cloth) = self.trial.model.cloths[b].repulsion {
            terms.repulsion = repulsion(&trial, of_cloth, &mut vec![T::zero(); self.cloth_len()]);
        }
        terms.contact = self.trial.contacts[b].energy();
        terms.bend += self.trial.couples[b].energy(&trial);
        terms
    }

    /// Sets the `axes` [16, H, W] of cloth `b` at the current trial.
    pub fn sheet_axes(&self, state: &State<T>, b: usize, (sheet, axes): (&mut SheetAxes<T>, &mut [T])) {
        sheet.compute(&self.trial.cloth(state, b), axes);
    }

    /// Shortens the axes [16, H, W] of cloth `b` where contacts hold its particles at the current trial.
    pub fn shorten_axes(&self, b: usize, axes: &mut [T]) {
        self.trial.contacts[b].shorten_axes(axes);
    }

    /// Returns what the bodies of cloth `b` do at the current trial.
    pub fn body_stats(&self, state: &State<T>, control: &Control<T>, b: usize) -> Vec<BodyStats> {
        let (trial, model) = (self.trial.cloth(state, b), &self.trial.model);
        let sweeps = sweeps(model, control, b);
        self.trial.contacts[b].stats(&model.cloths[b].bodies, &sweeps, trial.x, trial.shift)
    }

    /// Returns what the layers of cloth `b` do to each other at the current trial; `None` if they pass through each other.
    pub fn layer_stats(&self, state: &State<T>, b: usize) -> Option<LayerStats> {
        self.trial.contacts[b].layer_stats(self.trial.cloth(state, b).shift)
    }

    /// Returns the largest and the mean stretch of cloth `b` at the current trial.
    pub fn stretch(&self, state: &State<T>, b: usize) -> (f64, f64) {
        stretch(&self.trial.cloth(state, b))
    }

    /// Ends the frame: moves `state` to the current trial.
    pub fn end_frame(&self, state: &mut State<T>, control: &Control<T>) {
        let cloth = self.cloth_len();
        let parts = state.x.chunks_exact_mut(cloth).zip(state.v.chunks_exact_mut(cloth));
        for (b, (x, v)) in parts.enumerate() {
            let Trials { shift, a, marks, contacts, model, .. } = &self.trial;
            let frame = frame(marks, a, control, (b, cloth / 3));
            let shift = &shift[b * cloth..][..cloth];
            end_frame(frame, shift, x, v);
            contacts[b].end_frame(&model.cloths[b].bodies, x, v);
        }
    }
}

impl<T: Real> Trials<T> {
    /// Takes over which particles the cloths have, and which of them are handles.
    fn mark(&mut self) {
        let grid = self.model.grid;
        self.marks = self.model.marks();
        self.masses = masses(grid, &self.marks);
        let of_cloths = self.marks.chunks_exact(grid.particles());
        self.elements = of_cloths.map(|marks| Elements::of(grid, marks)).collect();
    }

    /// Returns the trial of cloth `b`.
    pub(super) fn cloth<'a>(&'a self, state: &'a State<T>, b: usize) -> Trial<'a, T> {
        let n = self.model.grid.particles();
        let at = 3 * n * b..3 * n * (b + 1);
        Trial {
            grid: self.model.grid,
            material: self.model.cloths[b].material,
            damping: self.model.cloths[b].damping,
            x: &state.x[at.clone()],
            shift: &self.shift[at.clone()],
            a: &self.a[at.clone()],
            f: &self.f[at],
            marks: &self.marks[n * b..n * (b + 1)],
            masses: &self.masses[n * b..n * (b + 1)],
            elements: self.elements[b].as_ref(),
            near: Some(&self.near[b]),
        }
    }
}

/// Returns how the bodies of cloth `b` move in the frame.
fn sweeps<T>(model: &Model, control: &Control<T>, b: usize) -> Vec<Sweep> {
    (0..model.cloths[b].bodies.len()).map(|k| control.sweep(model, b, k)).collect()
}

/// Returns the start of the frame for cloth `b` of `n` particles, given the marks and accelerations of all
/// cloths.
fn frame<'a, T>(
    marks: &'a [Mark],
    a: &'a [T],
    control: &'a Control<T>,
    (b, n): (usize, usize),
) -> Frame<'a, T> {
    Frame { marks: &marks[b * n..][..n], handles: &control.handles, a: &a[b * 3 * n..][..3 * n] }
}
