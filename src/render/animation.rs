//! Animated GIFs.

use super::{
    Bodies, Film, Image, Marks, View,
    body::NONE,
    palette::Palette,
    stage::{Size, Stage},
};
use crate::{Result, io::write_atomic};
use ::gif::{DisposalMethod, Encoder, Frame, Repeat};
use rayon::prelude::*;
use std::{
    borrow::Cow,
    io::{self, Write},
    path::Path,
};

/// Options of [`write_gif`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GifOptions<'a> {
    /// Width and height \[px\].
    pub size: usize,
    /// Largest number of frames per second [1/s]. Frames are skipped to stay below it, and the animation
    /// stays in real time.
    pub max_fps: f64,
    /// Largest number of pictures, at least 1; a longer run skips more frames.
    pub most: usize,
    /// The direction of view.
    pub view: View,
    /// The bodies that the cloth meets, which are drawn with it.
    pub bodies: &'a Bodies,
}

impl Default for GifOptions<'_> {
    fn default() -> Self {
        Self { size: 320, max_fps: 30.0, most: 1800, view: View::default(), bodies: &NONE }
    }
}

/// Number of frames drawn at a time, which bounds the memory for long trajectories.
const CHUNK: usize = 64;
/// Number of frames from which the palette is built, at most.
const SWATCHES: usize = 12;
/// How long the last picture stays before the animation begins again [1/100 s].
const PAUSE: f64 = 80.0;
/// Colour index that leaves a pixel unchanged.
const SAME: u8 = 255;

/// Writes the frames as an animation in real time, which pauses before it begins again; `handles` are the
/// vertices to mark. An empty trajectory gives a picture of the background. Panics if the size is not 1 to
/// 4096 pixels, `max_fps` or `most` allows no frames, a handle is not a vertex, or the upward direction is 0.
pub fn write_gif<'a>(
    path: impl AsRef<Path>,
    film: impl Into<Film<'a>>,
    handles: impl Into<Marks>,
    options: &GifOptions<'_>,
) -> Result<()> {
    let film = film.into();
    assert!((1..=4096).contains(&options.size), "an animation is 1 to 4096 pixels wide");
    assert!(options.max_fps > 0.0 && options.most > 0, "an animation has frames");
    let (marked, size) = ((handles.into(), options.bodies), Size::Fixed(options.size, options.size));
    let stage = Stage::new(film, marked, &options.view, size, 2);
    // A rate slightly above the limit, such as that of a frame time of 0.0333 s, counts as the limit.
    let every = (film.fps() / options.max_fps - 0.05).ceil().max(1.0) as usize;
    let every = every.max(film.frames().div_ceil(options.most));
    let shown: Vec<usize> = (0..film.frames()).step_by(every).collect();
    let draw = |&frame: &usize| stage.draw(film.number(frame), &film.frame(frame));
    let swatches: Vec<Image> = match shown.len().div_ceil(SWATCHES) {
        0 => vec![stage.draw_empty()],
        step => shown.par_iter().step_by(step).map(draw).collect(),
    };
    let palette = Palette::of(&swatches);
    // Hundredths of a second, rounded so that errors do not accumulate.
    let tick = |k: usize| (100.0 * (k * every) as f64 / film.fps()).round();
    let pause = |k: usize| if k + 1 == shown.len() && k > 0 { PAUSE } else { 0.0 };
    let delay = |k: usize| (tick(k + 1) - tick(k) + pause(k)).clamp(2.0, 65535.0) as u16;

    write_atomic(path, |w| {
        let mut animation = Animation::new(w, options.size as u16, &palette)?;
        for (chunk, frames) in shown.chunks(CHUNK).enumerate() {
            let pictures = frames.par_iter().map(|f| palette.index(&draw(f))).collect();
            animation.append(pictures, |k| delay(chunk * CHUNK + k))?;
        }
        if shown.is_empty() {
            animation.append(vec![palette.index(&swatches[0])], |_| 10)?;
        }
        animation.finish()
    })
}

/// An animation being written; frames hold only the changes.
struct Animation<'a, W: Write> {
    encoder: Encoder<W>,
    size: u16,
    palette: &'a Palette,
    last: Option<Vec<u8>>,
}

impl<'a, W: Write> Animation<'a, W> {
    fn new(writer: W, size: u16, palette: &'a Palette) -> io::Result<Self> {
        let mut colours = palette.colours.clone();
        // The index SAME needs an entry in the palette.
        colours.resize(usize::from(SAME) + 1, [0; 3]);
        let mut encoder =
            Encoder::new(writer, size, size, colours.as_flattened()).map_err(io::Error::other)?;
        encoder.set_repeat(Repeat::Infinite).map_err(io::Error::other)?;
        Ok(Self { encoder, size, palette, last: None })
    }

    /// Appends pictures, given as colour indices; `delay` returns how long each is shown [1/100 s].
    fn append(&mut self, mut pictures: Vec<Vec<u8>>, delay: impl Fn(usize) -> u16 + Sync) -> io::Result<()> {
        // Changes too small to be seen are dropped. They are measured against the picture shown, so they
        // cannot add up.
        for k in 0..pictures.len() {
            let (shown, rest) = pictures.split_at_mut(k);
            let Some(before) = shown.last().or(self.last.as_ref()) else { continue };
            for (now, &before) in rest[0].iter_mut().zip(before) {
                if *now != before && self.palette.alike(*now, before) {
                    *now = before;
                }
            }
        }
        let size = self.size;
        let encode = |k: usize| {
            let before = if k == 0 { self.last.as_ref() } else { Some(&pictures[k - 1]) };
            let mut frame = change(before.map(Vec::as_slice), &pictures[k], size);
            frame.delay = delay(k);
            frame.make_lzw_pre_encoded();
            frame
        };
        let frames: Vec<Frame<'static>> = (0..pictures.len()).into_par_iter().map(encode).collect();
        for frame in &frames {
            self.encoder.write_lzw_pre_encoded_frame(frame).map_err(io::Error::other)?;
        }
        self.last = pictures.pop();
        Ok(())
    }

    fn finish(self) -> io::Result<()> {
        self.encoder.into_inner().map(drop).map_err(io::Error::other)
    }
}

/// Returns the smallest rectangle that turns one picture into the next, with [`SAME`] where nothing changes.
fn change(before: Option<&[u8]>, now: &[u8], size: u16) -> Frame<'static> {
    let n = usize::from(size);
    let changed = |k: usize| before.is_none_or(|b| b[k] != now[k]);
    let rows = (0..n).filter(|y| (0..n).any(|x| changed(y * n + x)));
    let columns = (0..n).filter(|x| (0..n).any(|y| changed(y * n + x)));
    // A frame has at least one pixel, even if nothing moves.
    let range = |mut places: Box<dyn Iterator<Item = usize> + '_>| {
        let first = places.next().unwrap_or(0);
        (first, places.last().unwrap_or(first) + 1)
    };
    let ((top, bottom), (left, right)) = (range(Box::new(rows)), range(Box::new(columns)));
    let pixels = (top..bottom).flat_map(|y| (left..right).map(move |x| y * n + x));
    let buffer: Vec<u8> = pixels.map(|k| if changed(k) { now[k] } else { SAME }).collect();
    Frame {
        dispose: DisposalMethod::Keep,
        transparent: Some(SAME),
        top: top as u16,
        left: left as u16,
        width: (right - left) as u16,
        height: (bottom - top) as u16,
        buffer: Cow::Owned(buffer),
        ..Frame::default()
    }
}
