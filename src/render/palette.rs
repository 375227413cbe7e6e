//! One palette for all frames of an animation.

use super::Image;
use rayon::prelude::*;

/// Bits per channel of the lookup tables: finer than the steps of a palette.
const BITS: u32 = 6;
const LEVELS: usize = 1 << BITS;
/// Rounds of k-means refinement of the colours.
const ROUNDS: usize = 6;
/// Peak-to-peak amplitude of the dither [levels of 256].
const DITHER: f32 = 4.0;
/// A [`distance`] too small to be seen: about two levels of 256 in each channel.
const ALIKE: f32 = 35.0;

/// Up to 255 colours, and a table of the nearest of them to any colour.
pub(super) struct Palette {
    /// The colours.
    pub colours: Vec<[u8; 3]>,
    nearest: Vec<u8>,
}

/// The colour of a table cell, and its weight.
#[derive(Clone, Copy)]
struct Tone {
    colour: [f32; 3],
    weight: f32,
}

fn cell(colour: [u8; 3]) -> usize {
    colour.iter().fold(0, |at, &c| at << BITS | usize::from(c >> (8 - BITS)))
}

fn cell_colour(cell: usize) -> [f32; 3] {
    let channel =
        |shift: u32| ((cell >> shift) % LEVELS) as f32 * (256 / LEVELS) as f32 + 128.0 / LEVELS as f32;
    [channel(2 * BITS), channel(BITS), channel(0)]
}

/// Returns a distance between colours that roughly follows the eye: green counts most.
fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    2.0 * d[0] * d[0] + 4.0 * d[1] * d[1] + 1.5 * d[2] * d[2]
}

impl Palette {
    /// Builds a palette for pictures like `images`.
    pub fn of(images: &[Image]) -> Self {
        let mut sums = vec![[0u64; 4]; LEVELS.pow(3)];
        for pixel in images.iter().flat_map(|i| &i.pixels) {
            let sum = &mut sums[cell(*pixel)];
            (0..3).for_each(|k| sum[k] += u64::from(pixel[k]));
            sum[3] += 1;
        }
        // A cell stands for the mean of the pixels in it: its centre would tint greys.
        let mean = |(k, &[r, g, b, n]): (usize, &[u64; 4])| match n {
            0 => cell_colour(k),
            _ => [r, g, b].map(|c| c as f32 / n as f32),
        };
        let cells: Vec<[f32; 3]> = sums.iter().enumerate().map(mean).collect();
        // The square root keeps the large background from taking most of the colours.
        let tone = |(sum, &colour): (&[u64; 4], _)| Tone { colour, weight: (sum[3] as f32).sqrt() };
        let tones: Vec<Tone> = sums.iter().zip(&cells).map(tone).filter(|t| t.weight > 0.0).collect();
        let mut colours = median_cut(tones.clone(), 255);
        for _ in 0..ROUNDS {
            let owners: Vec<usize> = tones.par_iter().map(|t| nearest(&colours, t.colour)).collect();
            let mut sums = vec![[0.0f32; 4]; colours.len()];
            for (tone, owner) in tones.iter().zip(owners) {
                for (sum, c) in sums[owner].iter_mut().zip(tone.colour) {
                    *sum += tone.weight * c;
                }
                sums[owner][3] += tone.weight;
            }
            for (colour, [r, g, b, n]) in colours.iter_mut().zip(sums) {
                if n > 0.0 {
                    *colour = [r / n, g / n, b / n];
                }
            }
        }
        let nearest = cells.par_iter().map(|&colour| nearest(&colours, colour) as u8);
        Self {
            nearest: nearest.collect(),
            colours: colours.iter().map(|c| c.map(|x| x.round() as u8)).collect(),
        }
    }

    /// Whether two colours, given by index, are so close that one may stay where the next picture has the
    /// other.
    pub fn alike(&self, a: u8, b: u8) -> bool {
        let colour = |k: u8| self.colours[usize::from(k)].map(f32::from);
        distance(colour(a), colour(b)) < ALIKE
    }

    /// Returns the colour index of each pixel. The dither is a fixed pattern, so pixels that do not change
    /// between two frames have the same index in both.
    pub fn index(&self, image: &Image) -> Vec<u8> {
        const BAYER: [[f32; 4]; 4] =
            [[0., 8., 2., 10.], [12., 4., 14., 6.], [3., 11., 1., 9.], [15., 7., 13., 5.]];
        let index = |(k, pixel): (usize, &[u8; 3])| {
            let shift = DITHER * ((BAYER[k / image.width % 4][k % image.width % 4] + 0.5) / 16.0 - 0.5);
            self.nearest[cell(pixel.map(|c| (f32::from(c) + shift + 0.5) as u8))]
        };
        image.pixels.iter().enumerate().map(index).collect()
    }
}

fn nearest(colours: &[[f32; 3]], to: [f32; 3]) -> usize {
    let mut best = (f32::MAX, 0);
    for (k, &colour) in colours.iter().enumerate() {
        let d = distance(colour, to);
        if d < best.0 {
            best = (d, k);
        }
    }
    best.1
}

/// Splits the box with the widest weighted spread at its median until there are `count` boxes, and returns
/// their mean colours.
fn median_cut(tones: Vec<Tone>, count: usize) -> Vec<[f32; 3]> {
    let mut boxes = vec![tones];
    while boxes.len() < count {
        let spread = |tones: &Vec<Tone>| {
            let axis = (0..3).map(|k| (variance(tones, k), k)).max_by(|a, b| a.0.total_cmp(&b.0));
            axis.expect("three axes")
        };
        let widest = boxes.iter().map(spread).enumerate().max_by(|a, b| a.1.0.total_cmp(&b.1.0));
        // A box of one tone has no spread: if no box has any, there is nothing left to split.
        let Some((at, (_, axis))) = widest.filter(|w| w.1.0 > 0.0) else { break };
        let mut tones = boxes.swap_remove(at);
        tones.sort_by(|a, b| a.colour[axis].total_cmp(&b.colour[axis]));
        let half = tones.iter().map(|t| t.weight).sum::<f32>() / 2.0;
        let mut sum = 0.0;
        let middle = tones.iter().position(|t| {
            sum += t.weight;
            sum >= half
        });
        let rest = tones.split_off((middle.unwrap_or(0) + 1).min(tones.len() - 1));
        boxes.extend([tones, rest]);
    }
    boxes.iter().filter(|b| !b.is_empty()).map(|b| [0, 1, 2].map(|k| mean(b, k))).collect()
}

fn mean(tones: &[Tone], axis: usize) -> f32 {
    let weight: f32 = tones.iter().map(|t| t.weight).sum();
    tones.iter().map(|t| t.weight * t.colour[axis]).sum::<f32>() / weight
}

/// Returns the variance of a box along an axis, times its weight.
fn variance(tones: &[Tone], axis: usize) -> f32 {
    let mean = mean(tones, axis);
    tones.iter().map(|t| t.weight * (t.colour[axis] - mean).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_are_kept_and_many_are_approached() {
        let few = Image { width: 2, height: 1, pixels: vec![[250, 10, 10], [10, 10, 250]] };
        let palette = Palette::of(std::slice::from_ref(&few));
        let back = |palette: &Palette, image: &Image| -> f32 {
            let shown = palette.index(image).into_iter().map(|k| palette.colours[usize::from(k)]);
            let error = |(a, b): ([u8; 3], &[u8; 3])| (0..3).map(|k| a[k].abs_diff(b[k])).max().unwrap();
            shown.zip(&image.pixels).map(|p| f32::from(error(p))).sum::<f32>() / image.pixels.len() as f32
        };
        assert_eq!(palette.colours.len(), 2);
        assert!(back(&palette, &few) <= 2.0);

        let ramp = (0..4096).map(|k| [(k % 64 * 4) as u8, (k / 64 * 4) as u8, 128]).collect();
        let many = Image { width: 64, height: 64, pixels: ramp };
        let palette = Palette::of(std::slice::from_ref(&many));
        assert!(palette.colours.len() > 200 && back(&palette, &many) < 8.0);
    }
}
