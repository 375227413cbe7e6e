//! Backward Euler: from accelerations to velocities and positions, with handles (paper section 3.2; dt = 1).

use crate::cpu::Real;

/// What one frame of one cloth starts from.
#[derive(Clone, Copy)]
pub struct Frame<'a, T> {
    /// Handle slots, shape [H, W], see [`crate::sim::Model::handle_slots`].
    pub slots: &'a [u32],
    /// Handle positions at the end of the frame [edges], of all cloths.
    pub handles: &'a [[T; 3]],
    /// Trial accelerations [edges / frame^2], shape [3, H, W].
    pub a: &'a [T],
}

/// Positions at the end of the frame for a trial acceleration, `trial = x + v + a`, or where the handles are.
pub fn trial_positions<T: Real>(frame: Frame<'_, T>, x: &[T], v: &[T], trial: &mut [T]) {
    let n = frame.slots.len();
    for (component, trial) in trial.chunks_exact_mut(n).enumerate() {
        let at = component * n..(component + 1) * n;
        let (x, v, a) = (&x[at.clone()], &v[at.clone()], &frame.a[at]);
        for p in 0..n {
            trial[p] = match frame.slots[p] {
                // The order of the sum is that of `end_frame`, so that both end at the same bits.
                0 => x[p] + (v[p] + a[p]),
                slot => frame.handles[slot as usize - 1][component],
            };
        }
    }
}

/// The end of the frame: `v <- v + a`, `x <- x + v`; handles go to their positions, and their velocity is the way there.
pub fn end_frame<T: Real>(frame: Frame<'_, T>, x: &mut [T], v: &mut [T]) {
    let n = frame.slots.len();
    for (component, (x, v)) in x.chunks_exact_mut(n).zip(v.chunks_exact_mut(n)).enumerate() {
        let a = &frame.a[component * n..][..n];
        for p in 0..n {
            let next = match frame.slots[p] {
                0 => x[p] + (v[p] + a[p]),
                slot => frame.handles[slot as usize - 1][component],
            };
            v[p] = if frame.slots[p] == 0 { v[p] + a[p] } else { next - x[p] };
            x[p] = next;
        }
    }
}
