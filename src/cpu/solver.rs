//! The frame on the CPU (paper sections 3.2 and 3.3).

use super::Real;
use super::cloth::{Frame, GradientRows, Trial, add_wind, end_frame, energy, gradient, shifts, stretch};
use super::optim::{Minimizer, minimizer, norm};
use crate::Result;
use crate::sim::{Control, FrameStats, Iterations, Model, Optimizer, State};

/// Advances a batch of cloths frame by frame.
pub struct Solver<T: Real> {
    model: Model,
    iterations: usize,
    minimizer: Box<dyn Minimizer<T>>,
    log: Iterations,
    trial: Fields<T>,
    rows: GradientRows<T>,
    /// Gradient dL/da, shape [B, 3, H, W].
    grad: Vec<T>,
    /// Norm of each component of the gradient, shape [B, 3].
    norms: Vec<f64>,
}

/// All cloths at a trial acceleration.
struct Fields<T> {
    /// What the trial moves the particles by, shape [B, 3, H, W].
    shift: Vec<T>,
    /// Accelerations, shape [B, 3, H, W].
    a: Vec<T>,
    /// External accelerations, shape [B, 3, H, W].
    f: Vec<T>,
    /// Handle slots, shape [B, H, W].
    slots: Vec<u32>,
}

impl<T: Real> Fields<T> {
    /// Cloth `b`.
    fn cloth<'a>(&'a self, model: &Model, state: &'a State<T>, b: usize) -> Trial<'a, T> {
        let n = model.grid.particles();
        let at = 3 * n * b..3 * n * (b + 1);
        Trial {
            grid: model.grid,
            material: model.cloths[b].material,
            x: &state.x[at.clone()],
            shift: &self.shift[at.clone()],
            a: &self.a[at.clone()],
            f: &self.f[at],
            slots: &self.slots[n * b..n * (b + 1)],
        }
    }
}

impl<T: Real> Solver<T> {
    /// A solver with `iterations` steps of the optimizer per frame; an error if the grid does not suit the network.
    pub fn new(model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        assert!(iterations > 0, "a frame needs an iteration");
        let (grid, batch) = (model.grid, model.batch());
        let zeros = || vec![T::zero(); batch * 3 * grid.particles()];
        Ok(Self {
            model: model.clone(),
            iterations,
            minimizer: minimizer(optimizer, grid, batch)?,
            log: Iterations::default(),
            trial: Fields { shift: zeros(), a: zeros(), f: zeros(), slots: model.handle_slots() },
            rows: GradientRows::new(grid),
            grad: zeros(),
            norms: vec![0.0; 3 * batch],
        })
    }

    /// Advances `state` by one frame driven by `control`; statistics of each cloth.
    ///
    /// Panics when a length is not the model's.
    pub fn step(&mut self, state: &mut State<T>, control: &Control<T>) -> Vec<FrameStats> {
        let len = self.grad.len();
        assert!(state.x.len() == len && state.v.len() == len, "a state has shape [B, 3, H, W]");
        assert_eq!(control.handles.len(), self.model.handles(), "every handle needs a position");
        self.external(state, control);
        self.trial.a.fill(T::zero());
        self.log.gradient_norms.clear();
        self.log.scales.clear();
        self.minimizer.begin_frame();
        for _ in 0..self.iterations {
            self.place(state, control);
            self.gradient(state);
            self.minimizer.step(&self.grad, &self.norms, &mut self.trial.a);
            self.log.gradient_norms.extend(&self.norms);
            self.log.scales.extend(self.minimizer.scales().iter().map(|s| s.f64()));
        }
        self.place(state, control);
        let stats = self.stats(state);
        let cloth = self.cloth_len();
        let parts = state.x.chunks_exact_mut(cloth).zip(state.v.chunks_exact_mut(cloth));
        for (b, (x, v)) in parts.enumerate() {
            let frame = frame(&self.trial.slots, &self.trial.a, control, (b, cloth / 3));
            end_frame(frame, &self.trial.shift[b * cloth..][..cloth], x, v);
        }
        stats
    }

    /// Forgets the optimizer's memory, as when a scene starts again.
    pub fn reset(&mut self) {
        self.minimizer.reset();
    }

    /// What the optimizer did in the last frame.
    pub fn iterations(&self) -> &Iterations {
        &self.log
    }

    /// Accelerations that the last frame accepted [edges / frame^2], shape [B, 3, H, W].
    pub fn accelerations(&self) -> &[T] {
        &self.trial.a
    }

    /// Numbers in one cloth's arrays.
    fn cloth_len(&self) -> usize {
        3 * self.model.grid.particles()
    }

    /// Gravity, wind and the forces of `control`: they stay the same during a frame.
    fn external(&mut self, state: &State<T>, control: &Control<T>) {
        let (grid, batch, cloth) = (self.model.grid, self.model.batch(), self.cloth_len());
        assert!(control.wind.is_empty() || control.wind.len() == batch, "wind has shape [B]");
        assert!(
            control.forces.is_empty() || control.forces.len() == self.grad.len(),
            "forces have shape [B, 3, H, W]"
        );
        for (b, (f, setting)) in self.trial.f.chunks_exact_mut(cloth).zip(&self.model.cloths).enumerate() {
            for (f, &g) in f.chunks_exact_mut(cloth / 3).zip(&setting.gravity) {
                f.fill(T::of(g));
            }
            let at = b * cloth..(b + 1) * cloth;
            if !control.forces.is_empty() {
                for (f, &force) in f.iter_mut().zip(&control.forces[at.clone()]) {
                    *f = *f + force;
                }
            }
            let wind = control.wind.get(b).copied().unwrap_or([T::zero(); 3]);
            add_wind(grid, setting.air, wind, (&state.x[at.clone()], &state.v[at]), f);
        }
    }

    /// Sets what the current accelerations move the particles by.
    fn place(&mut self, state: &State<T>, control: &Control<T>) {
        let cloth = self.cloth_len();
        let Fields { shift, a, slots, .. } = &mut self.trial;
        for (b, shift) in shift.chunks_exact_mut(cloth).enumerate() {
            let at = b * cloth..(b + 1) * cloth;
            let frame = frame(slots, a, control, (b, cloth / 3));
            shifts(frame, &state.x[at.clone()], &state.v[at], shift);
        }
    }

    /// Sets the gradient at the trial, and its norms.
    fn gradient(&mut self, state: &State<T>) {
        let cloth = self.cloth_len();
        for (b, grad) in self.grad.chunks_exact_mut(cloth).enumerate() {
            gradient(&self.trial.cloth(&self.model, state, b), &mut self.rows, grad);
        }
        for (norm_of, grad) in self.norms.iter_mut().zip(self.grad.chunks_exact(cloth / 3)) {
            *norm_of = norm(grad);
        }
    }

    fn stats(&self, state: &State<T>) -> Vec<FrameStats> {
        let batch = self.model.batch();
        let norms = &self.log.gradient_norms;
        let norm_at = |iteration: usize, b: usize| norm(&norms[iteration * 3 * batch + 3 * b..][..3]);
        let cloth = |b: usize| {
            let trial = self.trial.cloth(&self.model, state, b);
            let (stretch_largest, stretch_mean) = stretch(&trial);
            FrameStats {
                energy: energy(&trial),
                gradient_first: norm_at(0, b),
                gradient_last: norm_at(self.iterations - 1, b),
                stretch_largest,
                stretch_mean,
            }
        };
        (0..batch).map(cloth).collect()
    }
}

/// What the frame of cloth `b` of `n` particles starts from, given the slots and accelerations of all cloths.
fn frame<'a, T>(
    slots: &'a [u32],
    a: &'a [T],
    control: &'a Control<T>,
    (b, n): (usize, usize),
) -> Frame<'a, T> {
    Frame { slots: &slots[b * n..][..n], handles: &control.handles, a: &a[b * 3 * n..][..3 * n] }
}
