//! Frames of a mesh that a cloth carries along.

use super::{Frames, Topology};
use crate::cloth::Embedding;
use std::{borrow::Cow, io};

/// The frames of a mesh that is embedded in a cloth, made from those of the cloth as they are asked for: a run keeps the
/// particles, and [`write()`](super::write) writes the mesh that they carry.
pub struct Embedded<'a> {
    frames: &'a dyn Frames,
    topology: &'a Topology,
    embedding: &'a Embedding,
}

impl<'a> Embedded<'a> {
    /// Describes the mesh `topology` that the cloth of `frames` carries. Panics if the embedding has other numbers of
    /// vertices and particles than they have.
    pub fn new(frames: &'a dyn Frames, topology: &'a Topology, embedding: &'a Embedding) -> Self {
        assert_eq!(embedding.vertices(), topology.vertices(), "the embedding is that of the mesh");
        assert_eq!(
            embedding.grid().particles(),
            frames.topology().vertices(),
            "the embedding is in the cloth"
        );
        Self { frames, topology, embedding }
    }
}

impl Frames for Embedded<'_> {
    fn topology(&self) -> Cow<'_, Topology> {
        Cow::Borrowed(self.topology)
    }

    fn fps(&self) -> f64 {
        self.frames.fps()
    }

    fn frames(&self) -> usize {
        self.frames.frames()
    }

    fn positions_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        Ok(self.embedding.positions(&self.frames.positions_of(frame)?).into())
    }

    fn velocities_of(&self, frame: usize) -> io::Result<Cow<'_, [[f32; 3]]>> {
        Ok(self.embedding.positions(&self.frames.velocities_of(frame)?).into())
    }
}
