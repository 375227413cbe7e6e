//! Pictures and arrays that lie on the sheet: masks and maps.

use crate::cloth::Grid;
use crate::{Error, Result, io};
use std::path::Path;

/// Numbers that lie evenly on the sheet.
pub(super) struct Picture {
    /// Shape [rows, columns]: those of the particles, or from the top of a picture on.
    values: Vec<f64>,
    rows: usize,
    columns: usize,
    is_upright: bool,
}

impl Picture {
    /// Reads a `.png`, whose values are how bright and opaque it is, 0 to 1, or a `.npy` of shape [H', W']. `field` is what it
    /// is for. Fails if the file is neither, or cannot be read.
    pub fn read(path: &Path, field: &str) -> Result<Self> {
        let origin = path.display().to_string();
        match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase) {
            Some(e) if e == "npy" => {
                let array = io::read_npy(path)?;
                let refused =
                    |expected| Error::invalid(&origin, "shape", expected, format!("{:?}", array.shape()));
                let &[rows, columns] = array.shape() else { return Err(refused("[H, W]")) };
                if rows * columns == 0 {
                    return Err(refused("at least one number"));
                }
                Ok(Self { values: array.iter().copied().collect(), rows, columns, is_upright: false })
            }
            Some(e) if e == "png" => read_png(path, field),
            _ => Err(Error::invalid(origin, field, "a .png or .npy file", "another extension")),
        }
    }

    /// Whether it is a picture and no array.
    pub fn is_png(path: &Path) -> bool {
        path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
    }

    /// Returns the value that is nearest to each particle.
    pub fn nearest(&self, grid: Grid) -> Vec<f64> {
        self.sample(grid, |values, [down, across]| values(down.round() as usize, across.round() as usize))
    }

    /// Returns the values at the particles, interpolated.
    pub fn interpolated(&self, grid: Grid) -> Vec<f64> {
        self.sample(grid, |values, [down, across]| {
            let (i, j) = (down as usize, across as usize);
            let (s, t) = (down - i as f64, across - j as f64);
            let above = (1.0 - t) * values(i, j) + t * values(i, j + 1);
            let below = (1.0 - t) * values(i + 1, j) + t * values(i + 1, j + 1);
            (1.0 - s) * above + s * below
        })
    }

    /// Returns what `take` makes, at each particle, of the values and its place among them, each 0 to their number less 1.
    fn sample(&self, grid: Grid, take: impl Fn(&dyn Fn(usize, usize) -> f64, [f64; 2]) -> f64) -> Vec<f64> {
        let values =
            |i: usize, j: usize| self.values[i.min(self.rows - 1) * self.columns + j.min(self.columns - 1)];
        let share = |k: usize, n: usize| k as f64 / (n - 1) as f64;
        let place = |p: usize| {
            let (down, across) = (share(p / grid.w, grid.h), share(p % grid.w, grid.w));
            if self.is_upright {
                // On a sheet that hangs from j = 0: u = 1 - i / (H - 1) to the right, v = 1 - j / (W - 1) up. A pixel covers
                // an area.
                let pixel = |part: f64, n: usize| (part * n as f64 - 0.5).clamp(0.0, (n - 1) as f64);
                [pixel(across, self.rows), pixel(1.0 - down, self.columns)]
            } else {
                [down * (self.rows - 1) as f64, across * (self.columns - 1) as f64]
            }
        };
        (0..grid.particles()).map(|p| take(&values, place(p))).collect()
    }
}

#[cfg(not(feature = "render"))]
fn read_png(path: &Path, field: &str) -> Result<Picture> {
    let origin = path.display().to_string();
    Err(Error::invalid(origin, field, "a .npy, as the feature `render` is off", "a .png"))
}

#[cfg(feature = "render")]
fn read_png(path: &Path, _field: &str) -> Result<Picture> {
    use crate::memory;
    let (origin, bytes) = (path.display().to_string(), io::read_bytes(path)?);
    let failed = |e: png::DecodingError| Error::invalid(path.display().to_string(), "picture", "a PNG", e);
    let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(failed)?;
    let size = reader.output_buffer_size().unwrap_or(usize::MAX);
    let mut pixels = Vec::new();
    memory::reserve(&mut pixels, size, &origin)?;
    pixels.resize(size, 0);
    let info = reader.next_frame(&mut pixels).map_err(failed)?;
    let samples = info.color_type.samples();
    let value = |pixel: &[u8]| {
        let part = |k: usize| f64::from(pixel[k]) / 255.0;
        match samples {
            1 => part(0),
            2 => part(0) * part(1),
            3 => (part(0) + part(1) + part(2)) / 3.0,
            _ => (part(0) + part(1) + part(2)) / 3.0 * part(3),
        }
    };
    let pixels = &pixels[..info.buffer_size()];
    let mut values = Vec::new();
    memory::reserve(&mut values, pixels.len() / samples, &origin)?;
    values.extend(pixels.chunks_exact(samples).map(value));
    Ok(Picture { values, rows: info.height as usize, columns: info.width as usize, is_upright: true })
}
