//! The end of a rollout, kept in `rollout.npz` beside its frames, from which another goes on to the same bits.

use anyhow::Result;
use fnopt::cloth::State;
use fnopt::io::{self, ReadOptions, Trajectory};
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

pub struct RolloutEnd<'a> {
    pub trajectory: Trajectory,
    pub state: State<f32>,
    pub memory: Memory,
    pub script: Script<'a>,
}

impl<'a> RolloutEnd<'a> {
    /// Reads it, and checks that the frames are those of the scene and the optimizer.
    pub fn read(file: &Path, setup: &'a Setup, optimizer: &Optimizer) -> Result<Self> {
        let origin = file.display().to_string();
        let trajectory = Trajectory::read(
            file,
            &ReadOptions { likely_grid: Some(setup.model.grid), ..Default::default() },
        )?;
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
        if trajectory.grid() != grid {
            return Err(invalid("grid", grid.to_string(), trajectory.grid().to_string()));
        }
        let rate = 1.0 / setup.units.frame_time_s;
        if (trajectory.fps() / rate - 1.0).abs() > 1e-9 {
            return Err(invalid("fps", format!("{rate}"), format!("{}", trajectory.fps())));
        }
        if trajectory.frames() >= setup.frames() {
            let expected = format!("fewer than the {} of the scene (--frames asks for more)", setup.frames());
            return Err(invalid("frames", expected, trajectory.frames().to_string()));
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
        let done = trajectory.frames() - 1;
        let script = match setup.changes.first().is_some_and(|change| change.frame <= done) {
            true => Script::resume(setup, done, &wide(ANCHORS)?).map_err(|error| error.of_file(file))?,
            false => Script::new(setup),
        };
        Ok(Self { trajectory, state: State { x, v }, memory, script })
    }
}

/// Puts it beside the frames of the trajectory.
pub fn keep(
    trajectory: &mut Trajectory,
    optimizer: &Optimizer,
    script: &Script<'_>,
    (state, memory): (&State<f32>, &Memory),
) {
    if !script.setup().changes.is_empty() {
        trajectory.put_beside(ANCHORS, ndarray::Array1::from(script.anchors().to_vec()).into_dyn());
    }
    let mut put = |name: &str, values: &[f32]| {
        let wide: Vec<f64> = values.iter().map(|&v| v.into()).collect();
        trajectory.put_beside(name, ndarray::Array1::from(wide).into_dyn());
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
