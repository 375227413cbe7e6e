//! A trajectory that is played back.

use super::draw::Mesh;
use crate::gpu::Context;
use crate::io::{Frames, Trajectory, vertex_normals};
use crate::sim::Vertices;
use std::cell::Cell;

/// The frames of a file, one of which is shown.
pub struct Playback {
    context: Context,
    trajectory: Trajectory,
    faces: Vec<[u32; 3]>,
    vertices: wgpu::Buffer,
    mesh: Mesh,
    frame: usize,
    /// The frame whose vertices are on the device.
    uploaded: Cell<Option<usize>>,
    /// Whether it begins again after the last frame.
    pub repeat: bool,
}

impl Playback {
    /// Shows the first frame of a trajectory.
    pub fn new(context: &Context, trajectory: Trajectory) -> Self {
        let faces: Vec<[u32; 3]> = trajectory.topology().triangles().collect();
        let vertices = context.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("playback"),
            size: Vertices::STRIDE * trajectory.grid().particles() as u64,
            usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let grid = [trajectory.grid().h, trajectory.grid().w];
        let mesh = Mesh::of_cloth(&context.device, vertices.clone(), &faces, Some(grid));
        let (context, uploaded) = (context.clone(), Cell::new(None));
        Self { context, trajectory, faces, vertices, mesh, frame: 0, uploaded, repeat: true }
    }

    /// Returns the trajectory.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Returns the number of the frame that is shown.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// Shows a frame; past the end, the last one.
    pub fn seek(&mut self, frame: usize) {
        self.frame = frame.min(self.trajectory.frames() - 1);
    }

    /// Goes so many frames on. Returns whether there are more.
    pub fn advance(&mut self, frames: usize) -> bool {
        let (all, wanted) = (self.trajectory.frames(), self.frame + frames);
        self.frame = if self.repeat { wanted % all } else { wanted.min(all - 1) };
        self.repeat || wanted < all
    }

    /// Returns the positions in the frame that is shown \[m\].
    pub fn positions(&self) -> &[[f32; 3]] {
        self.trajectory.frame(self.frame)
    }

    /// Returns what is drawn of the cloth, with the vertices of the frame that is shown.
    pub(super) fn mesh(&self) -> &Mesh {
        if self.uploaded.replace(Some(self.frame)) != Some(self.frame) {
            let positions = self.positions();
            let normals = vertex_normals(positions, &self.faces);
            let corners: Vec<[[f32; 3]; 2]> = positions.iter().zip(normals).map(|(&p, n)| [p, n]).collect();
            self.context.queue.write_buffer(&self.vertices, 0, bytemuck::cast_slice(&corners));
        }
        &self.mesh
    }
}
