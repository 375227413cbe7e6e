//! The end of a rollout, kept in `rollout.npz` beside its frames, from which another goes on to the same bits.

use anyhow::Result;
use fnopt::cloth::State;
use fnopt::io::{self, ReadOptions, Recording, Trajectory};
use fnopt::scene::{Script, Setup};
use fnopt::sim::{Memory, Optimizer};
use fnopt::{Error, ndarray};
use std::path::Path;

/// Names of the arrays, in grid units: positions and velocities of the last frame, what the optimizer remembers, and
/// its name.
const STATE: [&str; 2] = ["last_positions", "last_velocities"];
const MEMORY: [&str; 3] = ["memory_accelerations", "memory_hidden", "memory_scales"];
const SOLVER: &str = "solver";
/// Name of the array of what holds the handles ([`Script::anchors`]).
const ANCHORS: &str = "handle_anchors";
/// Names of the number of the last frame that was simulated, of that of frames from one in the file to the next, and of
/// whether they are rounded to 16 bits (1) or not (0).
const LAST: &str = "last_frame";
const EVERY: &str = "every";
const HALF: &str = "half";

/// Which frames of a rollout are in its file, how exactly, and at which rate it says they are.
#[derive(Clone, Copy)]
pub struct Kept {
    pub every: usize,
    pub half: bool,
    pub fps: f64,
}

pub struct RolloutEnd<'a> {
    /// Number of the last frame that was simulated.
    pub frame: usize,
    pub state: State<f32>,
    pub memory: Memory,
    pub script: Script<'a>,
}

impl<'a> RolloutEnd<'a> {
    /// Reads it, and checks that the frames are those of the scene and the optimizer.
    pub fn read(file: &Path, setup: &'a Setup, optimizer: &Optimizer, kept: Kept) -> Result<Self> {
        let origin = file.display().to_string();
        let options = ReadOptions { likely_grid: Some(setup.model.grid), ..Default::default() };
        let (outline, frames) = Trajectory::read_outline(file, &options)?;
        let invalid = |field: &str, expected: String, found: String| {
            anyhow::Error::from(Error::invalid(&origin, field, expected, found))
        };
        let wide = |name: &str| -> Result<Vec<f64>> {
            let array = io::read_npz_array(file, name)?;
            let array = array.ok_or_else(|| {
                invalid(name, "an array, as rollout writes beside the frames".into(), "none".into())
            })?;
            Ok(array.into_iter().collect())
        };
        let numbers = |name: &str| {
            Ok::<_, anyhow::Error>(wide(name)?.into_iter().map(|v| v as f32).collect::<Vec<_>>())
        };
        let grid = setup.model.grid;
        if outline.grid() != grid {
            return Err(invalid("grid", grid.to_string(), outline.grid().to_string()));
        }
        // Files of earlier versions have every frame and do not say so.
        let number = |name: &str, default: usize| -> Result<usize> {
            match io::read_npz_array(file, name)? {
                None => Ok(default),
                Some(array) => match array.iter().copied().collect::<Vec<_>>()[..] {
                    [x] if x >= 0.0 && x.fract() == 0.0 => Ok(x as usize),
                    ref other => Err(invalid(name, "a whole number".into(), format!("{other:?}"))),
                },
            }
        };
        let every = number(EVERY, 1)?;
        if every != kept.every {
            return Err(invalid(EVERY, format!("{} (--every)", kept.every), every.to_string()));
        }
        let half = number(HALF, 0)? == 1;
        if half != kept.half {
            let bits = |half| if half { "16 bits (--half)" } else { "32 bits (without --half)" };
            return Err(invalid("numbers", bits(kept.half).into(), bits(half).into()));
        }
        if (outline.fps() / kept.fps - 1.0).abs() > 1e-9 {
            return Err(invalid("fps", format!("{}", kept.fps), format!("{}", outline.fps())));
        }
        let done = number(LAST, frames - 1)?;
        if done / every + 1 != frames {
            let expected = format!("{}, up to frame {done}", done / every + 1);
            return Err(invalid("frames", expected, frames.to_string()));
        }
        if done + 1 >= setup.frames() {
            let expected = format!("fewer than the {} of the scene (--frames asks for more)", setup.frames());
            return Err(invalid("frames", expected, (done + 1).to_string()));
        }
        let name: String = numbers(SOLVER)?.iter().map(|&c| c as u8 as char).collect();
        if name != identity(optimizer) {
            return Err(invalid(SOLVER, identity(optimizer), name));
        }
        let [x, v] = [numbers(STATE[0])?, numbers(STATE[1])?];
        let len = 3 * grid.particles();
        for (name, values) in STATE.iter().zip([&x, &v]) {
            if values.len() != len || !values.iter().all(|v| v.is_finite()) {
                return Err(invalid(
                    name,
                    format!("{len} finite numbers"),
                    format!("{} numbers", values.len()),
                ));
            }
        }
        let memory = Memory {
            accelerations: numbers(MEMORY[0])?,
            hidden: numbers(MEMORY[1])?,
            scales: numbers(MEMORY[2])?,
        };
        let script = match setup.changes.first().is_some_and(|change| change.frame <= done) {
            true => Script::resume(setup, done, &wide(ANCHORS)?).map_err(|error| error.of_file(file))?,
            false => Script::new(setup),
        };
        Ok(Self { frame: done, state: State { x, v }, memory, script })
    }
}

/// Puts it beside the frames of a rollout.
pub fn keep(
    recording: &mut Recording,
    (optimizer, script): (&Optimizer, &Script<'_>),
    (frame, kept): (usize, Kept),
    (state, memory): (&State<f32>, &Memory),
) {
    for (name, number) in [(LAST, frame), (EVERY, kept.every), (HALF, usize::from(kept.half))] {
        recording.put_beside(name, ndarray::arr0(number as f64).into_dyn());
    }
    if !script.setup().changes.is_empty() {
        recording.put_beside(ANCHORS, ndarray::Array1::from(script.anchors().to_vec()).into_dyn());
    }
    let mut put = |name: &str, values: &[f32]| {
        let wide: Vec<f64> = values.iter().map(|&v| v.into()).collect();
        recording.put_beside(name, ndarray::Array1::from(wide).into_dyn());
    };
    put(STATE[0], &state.x);
    put(STATE[1], &state.v);
    put(MEMORY[0], &memory.accelerations);
    put(MEMORY[1], &memory.hidden);
    put(MEMORY[2], &memory.scales);
    put(SOLVER, &identity(optimizer).bytes().map(f32::from).collect::<Vec<_>>());
}

/// Returns the name of an optimizer, with the checksum of its weights.
fn identity(optimizer: &Optimizer) -> String {
    match optimizer.weights_crc32() {
        Some(weights) => format!("{} {weights}", optimizer.name()),
        None => optimizer.name().to_owned(),
    }
}
