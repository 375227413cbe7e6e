//! Vectors with three components.

use crate::cpu::Real;

/// Returns the vector of particle `p` in an array [3, n].
#[inline(always)]
pub(super) fn at<T: Real>(x: &[T], n: usize, p: usize) -> [T; 3] {
    [x[p], x[n + p], x[2 * n + p]]
}

#[inline(always)]
pub(super) fn add<T: Real>(u: [T; 3], w: [T; 3]) -> [T; 3] {
    [u[0] + w[0], u[1] + w[1], u[2] + w[2]]
}

#[inline(always)]
pub(super) fn sub<T: Real>(u: [T; 3], w: [T; 3]) -> [T; 3] {
    [u[0] - w[0], u[1] - w[1], u[2] - w[2]]
}

#[inline(always)]
pub(super) fn scaled<T: Real>(u: [T; 3], factor: T) -> [T; 3] {
    [u[0] * factor, u[1] * factor, u[2] * factor]
}

#[inline(always)]
pub(super) fn dot<T: Real>(u: [T; 3], w: [T; 3]) -> T {
    u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
}

#[inline(always)]
pub(super) fn cross<T: Real>(u: [T; 3], w: [T; 3]) -> [T; 3] {
    [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]]
}

#[inline(always)]
pub(super) fn length<T: Real>(u: [T; 3]) -> T {
    dot(u, u).sqrt()
}
