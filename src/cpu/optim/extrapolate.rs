//! The start of a frame near the accelerations of the two frames before.

use crate::cloth::Grid;
use crate::cpu::Real;
use crate::cpu::cloth::LocalModel;
use crate::settings::{SMOOTHING, WARMEST};

/// Rows and columns that a smooth value takes from, on each side.
const REACH: usize = SMOOTHING.len() - 1;

/// Extrapolates the accelerations of one cloth, with its working memory.
pub struct Extrapolation<T> {
    grid: Grid,
    /// A row and its mirror images, shape [W + 2 REACH].
    padded: Vec<T>,
    /// One component, smooth along the rows; shape [H, W].
    along_rows: Vec<T>,
    /// One over the weight of the free particles around each, 0 where no free particle is; shape [H, W].
    shares: Vec<T>,
}

impl<T: Real> Extrapolation<T> {
    /// Allocates working memory for a cloth on this grid, of which particles `held` are not free.
    pub fn new(grid: Grid, held: &[usize]) -> Self {
        let zeros = |len| vec![T::zero(); len];
        let [padded, along_rows] = [grid.w + 2 * REACH, grid.particles()].map(zeros);
        let mut new = Self { grid, padded, along_rows, shares: vec![T::one(); grid.particles()] };
        let mut free = vec![T::one(); grid.particles()];
        held.iter().for_each(|&p| free[p] = T::zero());
        let mut weights = zeros(grid.particles());
        new.add_up(|p| free[p], &mut weights);
        for ((share, &weight), &free) in new.shares.iter_mut().zip(&weights).zip(&free) {
            *share = if free > T::zero() { weight.recip() } else { T::zero() };
        }
        new
    }

    /// Sets `to` to the smooth part S of `(2 - WARMEST) last - earlier`, where `last` are the accelerations of the last
    /// frame and `earlier` those of the frame before it, all [3, H, W] and 0 at held particles. With [`WARMEST`] times the last ones that makes
    /// 2 last - earlier where they are smooth, and leaves the share where they are not.
    ///
    /// S takes the mean over the free particles around each, with the weights [`SMOOTHING`] along the rows and the columns; at a border
    /// the sheet goes on as its mirror image. So a sheet that falls freely goes on doing so.
    pub fn smooth(&mut self, [last, earlier]: [&[T]; 2], to: &mut [T]) {
        let n = self.grid.particles();
        let share = T::of(2.0 - WARMEST);
        for (c, to) in to.chunks_exact_mut(n).enumerate() {
            let (last, earlier) = (&last[c * n..][..n], &earlier[c * n..][..n]);
            self.add_up(|p| share * last[p] - earlier[p], to);
            to.iter_mut().zip(&self.shares).for_each(|(to, &share)| *to = *to * share);
        }
    }

    /// Sets `to` [H, W] to the sum of the values around each particle, with their weights.
    fn add_up(&mut self, value: impl Fn(usize) -> T, to: &mut [T]) {
        let Self { grid: Grid { h, w }, padded, along_rows, .. } = self;
        let (h, w) = (*h, *w);
        let weights = SMOOTHING.map(T::of);
        for (i, smooth) in along_rows.chunks_exact_mut(w).enumerate() {
            padded[REACH..][..w].iter_mut().enumerate().for_each(|(j, to)| *to = value(i * w + j));
            for k in 0..REACH {
                padded[k] = padded[REACH + mirrored(k, w)];
                padded[REACH + w + k] = padded[REACH + mirrored(REACH + w + k, w)];
            }
            add_runs(smooth, weights, |from| &padded[from..]);
        }
        for (i, to) in to.chunks_exact_mut(w).enumerate() {
            add_runs(to, weights, |from| &along_rows[w * mirrored(i + from, h)..]);
        }
    }
}

/// Returns the row or column, of `count`, that stands for number `at`, counted from [`REACH`] ahead of the first.
fn mirrored(at: usize, count: usize) -> usize {
    let inside = if at < REACH { REACH - 1 - at } else { at - REACH };
    if inside < count { inside } else { (2 * count - 1).saturating_sub(inside) }
}

/// Sets `to` to the weighted sum of 2 REACH + 1 runs of numbers as long as itself.
fn add_runs<'a, T: Real>(to: &mut [T], weights: [T; REACH + 1], run: impl Fn(usize) -> &'a [T]) {
    let middle = &run(REACH)[..to.len()];
    to.iter_mut().zip(middle).for_each(|(to, &value)| *to = weights[0] * value);
    for (k, &weight) in weights.iter().enumerate().skip(1) {
        let [before, behind] = [REACH - k, REACH + k].map(|from| &run(from)[..to.len()]);
        let both = before.iter().zip(behind);
        to.iter_mut().zip(both).for_each(|(to, (&before, &behind))| *to = *to + weight * (before + behind));
    }
}

/// Returns the factors of the last frame's accelerations p and of what extrapolates them, s
/// ([`Extrapolation::smooth`]), for which the quadratic model along both, in this order, is least: `h WARMEST p + f s`
/// with 0 <= f <= h <= 1. Where f <= 1/2 no mode is pumped; beyond, soft ones are not ([`WARMEST`]).
pub fn best_start(model: &LocalModel) -> [f64; 2] {
    let (b, a) = (model.slopes, model.curvature);
    let slopes = [WARMEST * b[0], b[1]];
    let curvature = [WARMEST * WARMEST * a[0][0], WARMEST * a[0][1], a[1][1]];
    let value = |[h, f]: [f64; 2]| {
        let [hh, hf, ff] = curvature;
        slopes[0] * h + slopes[1] * f + 0.5 * (hh * h * h + 2.0 * hf * h * f + ff * f * f)
    };
    let [hh, hf, ff] = curvature;
    let determinant = hh * ff - hf * hf;
    let inside = [hf * slopes[1] - ff * slopes[0], hf * slopes[0] - hh * slopes[1]].map(|v| v / determinant);
    let is_least = hh > 0.0 && determinant > 0.0 && inside[1] >= 0.0;
    let best = if is_least && inside[1] <= inside[0] && inside[0] <= 1.0 {
        inside
    } else {
        // The least point of each side. As everywhere, a curvature counts by its magnitude.
        let least = |slope: f64, curvature: f64| {
            let best = -slope / curvature.abs();
            if best.is_finite() { best.clamp(0.0, 1.0) } else { 0.0 }
        };
        let along_last = least(slopes[0], hh);
        let between = least(slopes[1] + hf, ff);
        let along_both = least(slopes[0] + slopes[1], hh + 2.0 * hf + ff);
        let sides = [[along_last, 0.0], [1.0, between], [along_both, along_both]];
        let none = ([0.0; 2], 0.0);
        let lower = |best: ([f64; 2], f64), side| {
            let value = value(side);
            // False for NaN, too.
            if value < best.1 { (side, value) } else { best }
        };
        sides.into_iter().fold(none, lower).0
    };
    [WARMEST * best[0], best[1]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the largest displacement of a mode in the last quarter of 4000 frames of backward Euler, over that at their start, where the
    /// iterations leave the share `left` of the error with which a frame starts: at `start` times the accelerations of the
    /// last frame and of the one before.
    fn growth(stiffness: f64, left: f64, start: [f64; 2]) -> f64 {
        let (mut x, mut v, mut a) = (1.0, 0.0, [0.0; 2]);
        let mut largest = 0.0_f64;
        for frame in 0..4000 {
            let exact = -stiffness * (x + v) / (1.0 + stiffness);
            let begun = start[0] * a[0] + start[1] * a[1];
            a = [exact + left * (begun - exact), a[0]];
            v += a[0];
            x += v;
            if x.abs() > 1e100 {
                return f64::INFINITY;
            }
            largest = if frame < 3000 { 0.0 } else { largest.max(x.abs()) };
        }
        largest
    }

    /// Why accelerations are extrapolated where they are smooth, and halved where they are not ([`WARMEST`]).
    #[test]
    fn starts_pump_no_mode() {
        let shares = [0.0, 0.2, 0.4, 0.6, 0.8, 0.9];
        let stiffnesses = [1e-4, 1e-3, 1e-2, 0.02, 0.1, 1.0, 10.0, 100.0];
        for (left, stiffness) in shares.into_iter().flat_map(|left| stiffnesses.map(|k| (left, k))) {
            let what = format!("{left} of a mode of stiffness {stiffness} is left");
            let share = growth(stiffness, left, [WARMEST, 0.0]);
            assert!(share <= 1.0, "{what}: half of the accelerations, {share}");
            let extrapolated = growth(stiffness, left, [2.0, -1.0]);
            if stiffness <= 0.02 || left <= 0.2 {
                assert!(extrapolated <= 1.0, "{what}: extrapolated accelerations, {extrapolated}");
            }
            // The accelerations as they were, and extrapolated ones of short waves.
            if left >= 0.6 && stiffness > 3e-3 {
                assert!(growth(stiffness, left, [1.0, 0.0]) > 10.0, "{what}: the accelerations");
            }
            if left >= 0.6 && stiffness > 0.3 {
                assert!(extrapolated > 10.0, "{what}: extrapolated accelerations, {extrapolated}");
            }
        }
    }

    /// Every value of a smooth field is the mean over the free particles around it, with mirror images beyond the borders.
    #[test]
    fn smooth_fields_are_weighted_means() {
        let grid = Grid { h: 9, w: 13 };
        let n = grid.particles();
        let held = [0, 1, 15, 60, 61, n - 1];
        let field = |seed: usize| {
            let value =
                |k: usize| if held.contains(&(k % n)) { 0.0 } else { ((k * k + seed) % 17) as f64 - 8.0 };
            (0..3 * n).map(value).collect::<Vec<_>>()
        };
        let (last, earlier) = (field(1), field(5));
        let mut found = vec![f64::NAN; 3 * n];
        let mut extrapolation = Extrapolation::new(grid, &held);
        extrapolation.smooth([&last, &earlier], &mut found);
        let mirror = |k: isize, count: usize| {
            let k = if k < 0 { -1 - k } else { k } as usize;
            if k < count { k } else { 2 * count - 1 - k }
        };
        let weight = |k: isize| SMOOTHING[k.unsigned_abs()];
        for (at, found) in found.iter().enumerate() {
            let (c, i, j) = (at / n, at % n / grid.w, at % grid.w);
            let (mut sum, mut all) = (0.0, 0.0);
            for (k, l) in (-4..=4).flat_map(|k| (-4..=4).map(move |l| (k, l))) {
                let p = mirror(i as isize + k, grid.h) * grid.w + mirror(j as isize + l, grid.w);
                let weight = if held.contains(&p) { 0.0 } else { weight(k) * weight(l) };
                sum += weight * (1.5 * last[c * n + p] - earlier[c * n + p]);
                all += weight;
            }
            let expected = if held.contains(&(at % n)) { 0.0 } else { sum / all };
            assert!((found - expected).abs() < 1e-12, "{at}: {found}, not {expected}");
        }
        // What is the same everywhere is smooth already.
        let even = |value: f64| {
            let of = |k: usize| if held.contains(&(k % n)) { 0.0 } else { value };
            (0..3 * n).map(of).collect::<Vec<_>>()
        };
        extrapolation.smooth([&even(2.0), &even(1.0)], &mut found);
        for (found, expected) in found.iter().zip(even(2.0)) {
            assert!((found - expected).abs() < 1e-14, "{found}, not {expected}");
        }
    }

    /// No point of the triangle is lower, and slopes and curvatures that are not finite leave the start alone.
    #[test]
    fn the_best_start_is_the_least_point_of_the_triangle() {
        let mut inside = 0;
        for seed in 0..200_u32 {
            let random = |k: u32| {
                let mixed =
                    (seed * 8 + k).wrapping_mul(0x9e37_79b1).rotate_left(13).wrapping_mul(0x85eb_ca6b);
                f64::from(mixed >> 8) / f64::from(1 << 23) - 1.0
            };
            let mut model = LocalModel::default();
            // Positive definite.
            let (p, q, r) = (random(1), random(2), random(3));
            model.curvature[0][0] = 4.0 * (p * p + 0.1);
            model.curvature[0][1] = 2.0 * p * q;
            model.curvature[1][0] = model.curvature[0][1];
            model.curvature[1][1] = q * q + r * r + 0.1;
            // The minimum is in or near the triangle.
            let least = [WARMEST * (0.5 + 0.7 * random(4)), 0.5 + 0.7 * random(5)];
            for (slope, row) in model.slopes.iter_mut().zip(&model.curvature).take(2) {
                *slope = -(row[0] * least[0] + row[1] * least[1]);
            }
            let value = |[c, d]: [f64; 2]| {
                let [a, b] = [model.curvature, [model.slopes; 4]];
                b[0][0] * c + b[0][1] * d + 0.5 * (a[0][0] * c * c + 2.0 * a[0][1] * c * d + a[1][1] * d * d)
            };
            let found = best_start(&model);
            let [h, f] = [found[0] / WARMEST, found[1]];
            assert!((-1e-12..=h + 1e-12).contains(&f) && h <= 1.0 + 1e-12, "{found:?}");
            inside += usize::from(f > 0.01 && f < h - 0.01 && h < 0.99);
            for (h, f) in
                (0..=40).flat_map(|h| (0..=h).map(move |f| (f64::from(h) / 40.0, f64::from(f) / 40.0)))
            {
                assert!(value(found) <= value([WARMEST * h, f]) + 1e-12, "{seed}: {found:?}, not {h} {f}");
            }
        }
        assert!((20..180).contains(&inside), "{inside} starts are inside of the triangle");
        let mut broken = LocalModel::default();
        assert_eq!(best_start(&broken), [0.0; 2], "nothing to start from");
        broken.slopes[0] = -1.0;
        broken.curvature[0][0] = 1.0;
        (broken.slopes[1], broken.curvature[1][1]) = (f64::NAN, f64::NAN);
        assert!(best_start(&broken)[1] == 0.0, "a direction that is not finite");
    }
}
