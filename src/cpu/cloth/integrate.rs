//! Backward Euler: from accelerations to velocities and positions, with handles (paper section 3.2; dt = 1).

use crate::cpu::Real;

/// What one frame of one cloth starts from.
#[derive(Clone, Copy)]
pub struct Frame<'a, T> {
    /// Handle slots, shape [H, W], see [`crate::sim::Model::handle_slots`].
    pub slots: &'a [u32],
    /// Handle positions at the end of the frame \[edges\], of all cloths.
    pub handles: &'a [[T; 3]],
    /// Trial accelerations [edges / frame^2], shape [3, H, W].
    pub a: &'a [T],
}

/// What a trial acceleration moves the particles by: `shift = v + a`, or the way to where the handle is to be.
pub fn shifts<T: Real>(frame: Frame<'_, T>, x: &[T], v: &[T], shift: &mut [T]) {
    let n = frame.slots.len();
    for (component, shift) in shift.chunks_exact_mut(n).enumerate() {
        let at = component * n..(component + 1) * n;
        let (x, v, a) = (&x[at.clone()], &v[at.clone()], &frame.a[at]);
        for p in 0..n {
            shift[p] = match frame.slots[p] {
                0 => v[p] + a[p],
                slot => frame.handles[slot as usize - 1][component] - x[p],
            };
        }
    }
}

/// The end of the frame: the accepted `shift` is the velocity, `x <- x + v`; handles are exactly where they are to be.
pub fn end_frame<T: Real>(frame: Frame<'_, T>, shift: &[T], x: &mut [T], v: &mut [T]) {
    let n = frame.slots.len();
    v.copy_from_slice(shift);
    for (component, x) in x.chunks_exact_mut(n).enumerate() {
        let shift = &shift[component * n..][..n];
        for p in 0..n {
            x[p] = match frame.slots[p] {
                0 => x[p] + shift[p],
                slot => frame.handles[slot as usize - 1][component],
            };
        }
    }
}
