//! The arrays of a pool on the CPU, and how they change before and after a training step.

use super::checkpoint::Tensors;
use super::config::PoolConfig;
use super::learner::Batch;
use crate::Result;
use crate::cloth::{Grid, State};
use crate::cpu::Real;
use crate::cpu::cloth::{Frame, end_frame, shifts};
use crate::cpu::optim::Hidden;
use crate::sim::INITIAL_SCALE;

/// State and hidden state of all cloths of a pool or of a batch. C is the number of cloths and S = 3 C that
/// of samples.
#[derive(Clone, Debug)]
pub struct Arrays<T> {
    grid: Grid,
    /// Positions and velocities at the start of the frame, shape [C, 3, H, W].
    pub state: State<T>,
    /// Accelerations so far [edges / frame^2], shape [C, 3, H, W].
    pub a: Vec<T>,
    /// Hidden state and persistent scale of the update rule: shapes [S, H, W] and \[S\].
    pub hidden: Hidden<T>,
}

impl<T: Real> Arrays<T> {
    /// Allocates arrays for this many cloths, not yet started.
    pub fn new(grid: Grid, cloths: usize) -> Self {
        let zeros = || vec![T::zero(); cloths * 3 * grid.particles()];
        let scale = vec![T::of(INITIAL_SCALE.into()); 3 * cloths];
        let hidden = Hidden { last_grad: zeros(), last_step: zeros(), scale };
        Self { grid, state: State { x: zeros(), v: zeros() }, a: zeros(), hidden }
    }

    /// Returns the grid of the cloths.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Allocates the arrays of a pool.
    pub fn of_pool(pool: &PoolConfig) -> Self {
        Self::new(pool.grid, pool.cloths)
    }

    /// Returns the fields of shape [C, 3, H, W] and [S, H, W], which have the same memory layout.
    pub(super) fn fields(&mut self) -> [&mut Vec<T>; 5] {
        let Hidden { last_grad, last_step, .. } = &mut self.hidden;
        [&mut self.state.x, &mut self.state.v, &mut self.a, last_grad, last_step]
    }

    /// Starts a life of a cloth: rotates the sheet at rest by `rotation` and resets everything else.
    fn begin(&mut self, slot: usize, rotation: [[f64; 3]; 3]) {
        let n = self.grid.particles();
        for field in self.fields() {
            field[slot * 3 * n..][..3 * n].fill(T::zero());
        }
        self.hidden.scale[3 * slot..][..3].fill(T::of(INITIAL_SCALE.into()));
        let (grid, x) = (self.grid, &mut self.state.x[slot * 3 * n..][..3 * n]);
        for p in 0..n {
            let rest = grid.rest(p);
            for (component, row) in rotation.iter().enumerate() {
                x[component * n + p] = T::of(row.iter().zip(rest).map(|(r, x)| r * x).sum());
            }
        }
    }

    /// Starts the cloths of `batch` that begin a life, and copies all cloths of `batch`, in its order, into
    /// `to`.
    pub fn draw(&mut self, batch: &Batch, to: &mut Self) {
        for drawn in &batch.cloths {
            if let Some(rotation) = drawn.start {
                self.begin(drawn.slot, rotation);
            }
        }
        copy(self, to, |place, slot| (slot, place), batch);
    }

    /// Stores the cloths of `batch` from `from` after their step, ending the frame of those that completed
    /// it.
    pub fn store(&mut self, batch: &Batch, from: &mut Self) {
        from.end_frames(batch);
        copy(from, self, |place, slot| (place, slot), batch);
    }

    /// Ends frames: v <- v + a, x <- x + v, a <- 0, handles at their targets with velocity 0 (paper
    /// section 3.3), v damped.
    fn end_frames(&mut self, batch: &Batch) {
        let n = self.grid.particles();
        let (marks, control) = (batch.model(self.grid).marks(), batch.control());
        let mut shift = vec![T::zero(); 3 * n];
        for (place, drawn) in batch.cloths.iter().enumerate().filter(|(_, drawn)| drawn.advance) {
            let at = place * 3 * n..(place + 1) * 3 * n;
            let marks = &marks[place * n..][..n];
            let frame = Frame { marks, handles: &control.handles, a: &self.a[at.clone()] };
            let State { x, v } = &mut self.state;
            let (x, v) = (&mut x[at.clone()], &mut v[at.clone()]);
            shifts(frame, x, v, &mut shift);
            end_frame(frame, &shift, x, v);
            let keep = T::of(1.0 - drawn.damping);
            v.iter_mut().for_each(|v| *v = keep * *v);
            for &p in &drawn.cloth.handles {
                (0..3).for_each(|component| v[component * n + p] = T::zero());
            }
            self.a[at].fill(T::zero());
        }
    }
}

/// Copies the cloths of a batch. `ends` maps a place in the batch and a slot of the pool to source and
/// target.
fn copy<T: Real>(
    from: &mut Arrays<T>,
    to: &mut Arrays<T>,
    ends: impl Fn(usize, usize) -> (usize, usize),
    batch: &Batch,
) {
    let cloth = 3 * from.grid.particles();
    for (place, drawn) in batch.cloths.iter().enumerate() {
        let (source, target) = ends(place, drawn.slot);
        for (from, to) in from.fields().into_iter().zip(to.fields()) {
            to[target * cloth..][..cloth].copy_from_slice(&from[source * cloth..][..cloth]);
        }
        to.hidden.scale[3 * target..][..3].copy_from_slice(&from.hidden.scale[3 * source..][..3]);
    }
}

/// Names of [`Arrays::fields`] in checkpoints.
const FIELDS: [&str; 5] = ["x", "v", "a", "last_grad", "last_step"];

impl Arrays<f32> {
    /// Adds the arrays to the tensors that a learner saves, with names starting with `name`.
    pub fn save(&self, name: &str, tensors: &mut Tensors) {
        let Grid { h, w } = self.grid;
        let cloths = self.hidden.scale.len() / 3;
        for (field, values) in FIELDS.iter().zip(self.clone().fields()) {
            tensors.insert(format!("{name}.{field}"), &[cloths, 3, h, w], std::mem::take(values));
        }
        tensors.insert(format!("{name}.scale"), &[cloths, 3], self.hidden.scale.clone());
    }

    /// Loads the arrays saved under `name`.
    pub fn load(&mut self, name: &str, tensors: &Tensors) -> Result<()> {
        let Grid { h, w } = self.grid;
        let cloths = self.hidden.scale.len() / 3;
        for (field, values) in FIELDS.iter().zip(self.fields()) {
            values.copy_from_slice(tensors.get(&format!("{name}.{field}"), &[cloths, 3, h, w])?);
        }
        self.hidden.scale.copy_from_slice(tensors.get(&format!("{name}.scale"), &[cloths, 3])?);
        Ok(())
    }
}
