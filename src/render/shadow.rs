//! The soft shadow on the floor.

use super::surface::{DepthBuffer, NOTHING};
use glam::Vec3;

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
    /// Computes the shadow of `triangles`, which are given on the floor, as it appears in the picture, in units
    /// of [`PIXELS`] pixels.
    pub fn new(size: [usize; 2], triangles: impl Iterator<Item = [Vec3; 3]>) -> Self {
        let [width, height] = size.map(|n| n.div_ceil(PIXELS));
        let mut mask = DepthBuffer::new(width, height);
        triangles.for_each(|corners| mask.triangle(0, corners));
        let mut dark: Vec<f32> =
            mask.seen.iter().map(|&seen| if seen == NOTHING { 0.0 } else { 1.0 }).collect();
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

/// Returns the mean over `2 radius + 1` neighbours, with zeros outside.
fn running_mean(values: &[f32], radius: usize) -> Vec<f32> {
    let at = |k: Option<usize>| k.and_then(|k| values.get(k)).copied().unwrap_or(0.0);
    let mut sum: f32 = values.iter().take(radius).sum();
    let mut mean = |k: usize| {
        sum += at(k.checked_add(radius)) - at(k.checked_sub(radius + 1));
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
}
