//! The soft shadow on the floor.

use super::surface::{DepthBuffer, NOTHING};
use glam::{Vec2, Vec3, vec2};

/// Pixels of the picture per pixel of the shadow along each axis: a blurred shadow needs no higher
/// resolution.
pub(super) const PIXELS: usize = 2;

/// Darkness of the floor at each point of the picture, 0 to 1.
pub(super) struct Shadow {
    width: usize,
    height: usize,
    dark: Vec<f32>,
}

impl Shadow {
    /// Computes the shadow of `triangles`, which are given on the floor, as it appears in the picture, and of whatever
    /// else makes a place of the picture dark; all in units of [`PIXELS`] pixels.
    pub fn new(
        size: [usize; 2],
        triangles: impl Iterator<Item = [Vec3; 3]>,
        is_dark: impl Fn(Vec2) -> bool,
    ) -> Self {
        let [width, height] = size.map(|n| n.div_ceil(PIXELS));
        let mut mask = DepthBuffer::new(width, height);
        triangles.for_each(|corners| mask.triangle(0, corners));
        let place = |k: usize| vec2((k % width) as f32 + 0.5, (k / width) as f32 + 0.5);
        let is_light = |(k, &seen): (usize, &u32)| seen == NOTHING && !is_dark(place(k));
        let mut dark: Vec<f32> =
            mask.seen.iter().enumerate().map(|of| if is_light(of) { 0.0 } else { 1.0 }).collect();
        // Three running means approximate a smooth bell, flatter vertically because the floor is seen at a
        // low angle.
        for _ in 0..3 {
            let radius = (height / 40).max(1);
            let rows = dark.chunks(width).flat_map(|row| running_mean(row, radius)).collect::<Vec<f32>>();
            let columns = (0..width).map(|x| rows[x..].iter().step_by(width).copied().collect::<Vec<f32>>());
            for (x, column) in columns.enumerate() {
                let mean = running_mean(&column, radius.div_ceil(2));
                dark[x..].iter_mut().step_by(width).zip(mean).for_each(|(d, m)| *d = m);
            }
        }
        Self { width, height, dark }
    }

    /// Returns the darkness at a pixel of the picture.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        let place = |p: usize, n: usize| {
            let s = ((p as f32 + 0.5) / PIXELS as f32 - 0.5).clamp(0.0, (n - 1) as f32);
            let whole = s as usize;
            (whole, (whole + 1).min(n - 1), s - whole as f32)
        };
        let ((x0, x1, tx), (y0, y1, ty)) = (place(x, self.width), place(y, self.height));
        let row = |y: usize| {
            let row = &self.dark[y * self.width..];
            row[x0] + tx * (row[x1] - row[x0])
        };
        row(y0) + ty * (row(y1) - row(y0))
    }
}

/// Returns the mean over `2 radius + 1` neighbours, where the values at the ends go on outside: a shadow may leave the
/// picture.
fn running_mean(values: &[f32], radius: usize) -> Vec<f32> {
    // Neighbour 0 is `radius + 1` before the first value.
    let at = |k: usize| values[k.saturating_sub(radius + 1).min(values.len() - 1)];
    let mut sum: f32 = (0..2 * radius + 1).map(at).sum();
    let mut mean = |k: usize| {
        sum += at(k + 2 * radius + 1) - at(k);
        // Rounding must not leave a faint trace beyond the shadow.
        if sum < 1e-4 { 0.0 } else { sum / (2 * radius + 1) as f32 }
    };
    (0..values.len()).map(&mut mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_running_mean_keeps_the_sum_inside_and_the_symmetry() {
        let mut values = [0.0; 21];
        values[10] = 6.0;
        let mean = running_mean(&values, 2);
        assert!((mean.iter().sum::<f32>() - 6.0).abs() < 1e-5);
        assert!(mean[7] == 0.0 && mean[13] == 0.0);
        assert!((8..=12).all(|k| (mean[k] - 1.2).abs() < 1e-6));
    }

    #[test]
    fn a_running_mean_does_not_fade_at_the_ends() {
        let mean = running_mean(&[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], 1);
        let expected = [1.0, 1.0, 2.0 / 3.0, 1.0 / 3.0, 0.0, 0.0];
        assert!(mean.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{mean:?}");
        assert!(running_mean(&[0.5], 3).iter().all(|a| (a - 0.5).abs() < 1e-6));
    }
}
