//! NewTek's MDD (`.mdd`), big-endian throughout: the numbers of frames and points, the time of each frame \[s\], then the
//! positions of every point of every frame as `f32`.

use super::{clip::Clip, open, read_points, trajectory::Parts};
use crate::{Error, Result};
use std::{
    io::{self, BufReader, Read, Write},
    path::Path,
};

const HEADER_LEN: u64 = 8;

/// Writes the positions of a clip. The first is at time 0: later, single precision would lose the rate.
pub(super) fn write(clip: &Clip, writer: &mut impl Write) -> io::Result<()> {
    for n in [clip.count(), clip.topology.vertices()] {
        writer.write_all(&i32::try_from(n).map_err(io::Error::other)?.to_be_bytes())?;
    }
    for frame in 0..clip.count() {
        writer.write_all(&((frame as f64 / clip.fps()) as f32).to_be_bytes())?;
    }
    clip.write_positions(writer, f32::to_be_bytes)
}

/// Reads the positions of a cache, and the frames per second from the times of the first frame and the last.
pub(super) fn read(path: &Path) -> Result<Parts> {
    let origin = path.display().to_string();
    let (file, size) = open(path)?;
    let mut reader = BufReader::new(file);
    let mut word = || -> Result<[u8; 4]> {
        let mut word = [0; 4];
        reader
            .read_exact(&mut word)
            .map_err(|_| Error::invalid(&origin, "length", "a header and times", format!("{size} bytes")))?;
        Ok(word)
    };
    let [frames, points] = [word()?, word()?].map(|word| u64::from(u32::from_be_bytes(word)));
    let data = points.checked_mul(12).and_then(|bytes| frames.checked_mul(bytes + 4));
    if data.and_then(|data| data.checked_add(HEADER_LEN)) != Some(size) {
        let expected = format!("{frames} frames of {points} points");
        return Err(Error::invalid(&origin, "length", expected, format!("{size} bytes")));
    }
    let mut ends = [0.0; 2];
    for frame in 0..frames {
        let time = f64::from(f32::from_be_bytes(word()?));
        ends = [if frame == 0 { time } else { ends[0] }, time];
    }
    let (steps, time) = (frames.saturating_sub(1) as f64, ends[1] - ends[0]);
    let fps = steps / time;
    // Times are rounded to single precision: the round number that gives the same ones was meant.
    let round = (1e3 * fps).round() / 1e3;
    let fps = if (steps / round) as f32 == time as f32 { round } else { fps };
    let positions = read_points(&mut reader, points * frames, path, f32::from_be_bytes)?;
    // Times that say nothing are left to the reader's options.
    let fps = (fps.is_finite() && fps > 0.0).then_some(fps);
    Ok(Parts { shape: vec![frames as usize, points as usize, 3], positions, fps, ..Parts::default() })
}
