//! What pictures are drawn from.

use crate::{
    cloth::Grid,
    io::{Frames, Trajectory},
};
use std::borrow::Cow;

/// The frames of a cloth, to be drawn.
#[derive(Clone, Copy)]
pub struct Film<'a> {
    /// The grid of particles.
    pub grid: Grid,
    /// The frames.
    pub frames: &'a dyn Frames,
    /// How many frames of bodies and marks go by from one of these frames to the next: more than 1 if others were left
    /// out.
    pub every: usize,
}

impl<'a> From<&'a Trajectory> for Film<'a> {
    fn from(trajectory: &'a Trajectory) -> Self {
        Self { grid: trajectory.grid(), frames: trajectory, every: 1 }
    }
}

impl<'a> Film<'a> {
    pub(super) fn frames(&self) -> usize {
        self.frames.frames()
    }

    pub(super) fn fps(&self) -> f64 {
        self.frames.fps()
    }

    /// Returns the frame of bodies and marks that belongs to a frame.
    pub(super) fn number(&self, frame: usize) -> usize {
        frame * self.every
    }

    /// Returns the positions of a frame, of which nothing is drawn if they cannot be read back.
    pub(super) fn frame(&self, frame: usize) -> Cow<'a, [[f32; 3]]> {
        self.frames.positions_of(frame).unwrap_or_else(|error| {
            tracing::warn!("frame {frame} cannot be drawn: {error}");
            vec![[f32::NAN; 3]; self.grid.particles()].into()
        })
    }
}
