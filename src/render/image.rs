//! Images in memory and as PNG files.

use crate::{Result, io::write_atomic};
use std::{io, path::Path};

/// An image of 8-bit sRGB pixels, opaque.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pixels row by row from the top left, `width * height` of them.
    pub pixels: Vec<[u8; 3]>,
}

impl Image {
    /// Creates a black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0; 3]; width * height] }
    }

    /// Returns the pixel in column `x` of row `y`.
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        self.pixels[y * self.width + x]
    }

    /// Returns the image with its width and height divided by `factor`, each pixel the mean of those that it
    /// replaces.
    pub(super) fn reduced(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let mean = |k: usize| {
            let (left, top) = (k % width * factor, k / width * factor);
            let all = (0..factor * factor).map(|k| self.at(left + k % factor, top + k / factor));
            let sum =
                all.fold([0; 3], |sum: [usize; 3], p| std::array::from_fn(|c| sum[c] + usize::from(p[c])));
            sum.map(|sum| (sum / (factor * factor)) as u8)
        };
        Self { width, height, pixels: (0..width * height).map(mean).collect() }
    }

    /// Copies `other` into this image with its top left corner at column `x` of row `y`.
    pub(super) fn paste(&mut self, other: &Image, [x, y]: [usize; 2]) {
        let rows = self.pixels.chunks_mut(self.width).skip(y);
        for (row, source) in rows.zip(other.pixels.chunks(other.width)) {
            row[x..x + other.width].copy_from_slice(source);
        }
    }
}

/// Writes an image as a PNG file, which appears only when it is complete.
pub fn write_png(path: impl AsRef<Path>, image: &Image) -> Result<()> {
    let (width, height) = (image.width as u32, image.height as u32);
    write_atomic(path, |w| {
        let mut encoder = png::Encoder::new(w, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header().map_err(io::Error::other)?;
        writer.write_image_data(image.pixels.as_flattened()).map_err(io::Error::other)?;
        writer.finish().map_err(io::Error::other)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reduced_image_holds_means() {
        let rows: [[u8; 4]; 2] = [[0, 4, 100, 200], [8, 12, 100, 201]];
        let pixels = rows.as_flattened().iter().map(|&v| [v, 255, 255 - v]).collect();
        let image = Image { width: 4, height: 2, pixels };
        let expected = vec![[6, 255, 249], [150, 255, 104]];
        assert_eq!(image.reduced(2), Image { width: 2, height: 1, pixels: expected });
    }
}
