//! Vectors of three components, and the angle between two edges.

use crate::cpu::Real;

/// Particle `p` of an array [3, n].
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

/// The angle between two edges, `atan2(|u x w|, u . w)`: unlike the arc cosine it keeps small angles.
#[inline(always)]
pub(super) fn angle<T: Real>(u: [T; 3], w: [T; 3]) -> T {
    length(cross(u, w)).atan2(dot(u, w))
}

/// The gradient of `(angle - rest)^2` with respect to both edges.
///
/// With `c = u x w` and the angle t, `dt/du = u x c / (|c| |u|^2)` and `dt/dw = c x w / (|c| |w|^2)`. For parallel edges
/// `(t - rest) / |c|` has the limit `1 / (u . w)` if rest = 0; elsewhere the direction is undefined and the gradient
/// taken to be 0, as it is for an edge without length.
#[inline(always)]
pub(super) fn angle_gradient<T: Real>(u: [T; 3], w: [T; 3], rest: T) -> ([T; 3], [T; 3]) {
    let c = cross(u, w);
    let (sine, cosine) = (length(c), dot(u, w));
    let (uu, ww) = (dot(u, u), dot(w, w));
    let zero = T::zero();
    let ratio = if sine > zero {
        (sine.atan2(cosine) - rest) / sine
    } else if rest == zero && cosine > T::min_positive_value() {
        cosine.recip()
    } else {
        zero
    };
    // The smallest normal number keeps 0 / 0 out where an edge has no length, and dividing first keeps the product of two
    // large factors out where it has hardly any.
    let along = |v: [T; 3], square: T| {
        let square = square.max(T::min_positive_value());
        scaled([v[0] / square, v[1] / square, v[2] / square], ratio + ratio)
    };
    (along(cross(u, c), uu), along(cross(c, w), ww))
}
