//! Files and pictures: what is written can be read back, and no file makes a reader panic.

mod damaged;
mod embedded;
mod gltf;
mod pictures;
mod scene_formats;
mod sinks;
mod trajectories;

use fnopt::{cloth::Grid, io::Trajectory};
use std::{fs, path::Path};

const GRID: Grid = Grid { h: 9, w: 12 };

/// Builds a sheet that waves and moves sideways, with y up.
fn waving(grid: Grid, frames: usize) -> Trajectory {
    let mut trajectory = Trajectory::new(grid, 60.0);
    trajectory.reserve(frames).unwrap();
    for f in 0..frames {
        let time = f as f32 / 60.0;
        let at = |p: usize| {
            let (u, v) = ((p % grid.w) as f32 / grid.w as f32, (p / grid.w) as f32 / grid.h as f32);
            [u + 0.3 * time, -v, 0.1 * (7.0 * u + 9.0 * time).sin() * v]
        };
        let positions: Vec<_> = (0..grid.particles()).map(at).collect();
        let velocities: Vec<_> = (0..grid.particles()).map(|p| [0.3, 0.0, p as f32 / 7.0]).collect();
        trajectory.push(&positions, &velocities);
    }
    trajectory
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}
