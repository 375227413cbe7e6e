//! Backward Euler: from accelerations to velocities and positions, with handles (paper section 3.3, Eqs. 8
//! and 9; dt = 1).

use crate::cloth::{Mark, Role};
use crate::cpu::Real;

/// The inputs of one frame of one cloth.
#[derive(Clone, Copy)]
pub struct Frame<'a, T> {
    /// What each particle is, shape [H, W].
    pub marks: &'a [Mark],
    /// Handle positions of all cloths at the end of the frame \[edges\].
    pub handles: &'a [[T; 3]],
    /// Trial accelerations [edges / frame^2], shape [3, H, W].
    pub a: &'a [T],
}

/// Computes the displacements at a trial acceleration: `shift = v + a`, or for a handle `target - x`; 0 outside of the cloth.
pub fn shifts<T: Real>(frame: Frame<'_, T>, x: &[T], v: &[T], shift: &mut [T]) {
    let n = frame.marks.len();
    shift.iter_mut().zip(v).zip(frame.a).for_each(|((shift, &v), &a)| *shift = v + a);
    for (p, mark) in frame.marks.iter().enumerate() {
        match mark.role() {
            Role::Free => {}
            Role::Handle(k) => (0..3).for_each(|c| shift[c * n + p] = frame.handles[k][c] - x[c * n + p]),
            Role::Outside => (0..3).for_each(|c| shift[c * n + p] = T::zero()),
        }
    }
}

/// Ends the frame: the accepted `shift` becomes the velocity, and `x <- x + v`. Handles end exactly at their
/// targets.
pub fn end_frame<T: Real>(frame: Frame<'_, T>, shift: &[T], x: &mut [T], v: &mut [T]) {
    let n = frame.marks.len();
    v.copy_from_slice(shift);
    for (component, x) in x.chunks_exact_mut(n).enumerate() {
        let shift = &shift[component * n..][..n];
        for p in 0..n {
            x[p] = match frame.marks[p].role() {
                Role::Handle(k) => frame.handles[k][component],
                Role::Free | Role::Outside => x[p] + shift[p],
            };
        }
    }
}
