//! A vertex buffer of the cloths, for rendering.

use super::Solver;
use crate::cloth::{Embedding, VertexView};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels;
use crate::{Error, Result};

/// Interleaved positions and normals of all cloths of a [`Solver`], computed on its device
/// ([`Solver::vertices`]).
///
/// [`Vertices::record`] updates them in the caller's encoder, after [`Solver::record`]. Nothing is read back
/// or copied. The vertices of cloth b begin at vertex `b H W`, so one index buffer
/// ([`Grid::faces`](crate::cloth::Grid::faces)) serves all cloths, with a base vertex for each.
///
/// They are those of the particles, or those of a mesh that each cloth carries along ([`Solver::embedded_vertices`]), of
/// which cloth b begins at vertex `b V`.
#[derive(Debug)]
pub struct Vertices {
    context: Context,
    view: Tensor,
    interleaved: Tensor,
    schedule: Schedule,
}

impl Vertices {
    /// Bytes from one vertex to the next: the position is `Float32x3` at offset 0, the normal at 12.
    pub const STRIDE: u64 = 24;

    /// Builds the vertices of `solver`; see [`Solver::vertices`] and [`Solver::embedded_vertices`].
    pub(super) fn new(context: &Context, solver: &Solver, embedding: Option<&Embedding>) -> Result<Self> {
        if let Some(embedding) = embedding {
            let (grid, found) = (solver.model().grid, embedding.grid());
            if grid != found {
                return Err(Error::invalid("embedding", "grid", grid.to_string(), found));
            }
            if embedding.vertices() == 0 {
                return Err(Error::invalid("embedding", "vertices", "at least one", 0));
            }
        }
        context.checked(|| {
            let (grid, batch) = (solver.model().grid, solver.model().batch());
            let views = VertexView::default().to_rows().repeat(batch);
            let view = Tensor::from_slice(context, "view", &[batch, 4, 4], &views)?;
            let interleaved = Tensor::zeros(context, "vertices", &[batch, grid.particles(), 6])?;
            let mut schedule = Schedule::new(context);
            let from = (solver.marks(), &view, solver.positions(), solver.velocities());
            kernels::cloth::Vertices::new(context)?.push(&mut schedule, grid, from, &interleaved);
            let interleaved = match embedding {
                None => interleaved,
                Some(embedding) => {
                    let vertices = embedding.vertices();
                    let weights: Vec<[f32; 2]> = embedding
                        .weights()
                        .iter()
                        .map(|weights| weights.map(|weight| weight as f32))
                        .collect();
                    let cells = Tensor::from_slice(context, "cells", &[vertices], embedding.cells())?;
                    let weights = Tensor::from_slice(context, "weights", &[vertices, 2], &weights)?;
                    let embedded = Tensor::zeros(context, "embedded", &[batch, vertices, 6])?;
                    let from = (&cells, &weights, &interleaved);
                    kernels::cloth::Embed::new(context)?.push(&mut schedule, grid, from, &embedded);
                    embedded
                }
            };
            Ok(Self { context: context.clone(), view, interleaved, schedule: schedule.finish()? })
        })
    }

    /// Sets the view of all cloths, ahead of the next submission.
    pub fn set_view(&self, view: &VertexView) {
        self.view.write(&self.context, &view.to_rows().repeat(self.view.shape()[0]));
    }

    /// Sets the view of cloth `b` alone, ahead of the next submission, in a batch whose cloths differ in
    /// scale or are drawn at different places. Panics if there is no cloth `b`.
    pub fn set_cloth_view(&self, b: usize, view: &VertexView) {
        self.view.write_at(&self.context, 16 * b, view.to_rows().as_flattened());
    }

    /// Sets the time of all cloths' views and leaves their transforms, ahead of the next submission: 0 is the
    /// start of the last frame, 1 its end ([`VertexView::time`]).
    pub fn set_time(&self, time: f32) {
        for b in 0..self.view.shape()[0] {
            self.view.write_at(&self.context, 16 * b + 12, &[time]);
        }
    }

    /// Records the update of the vertices to the positions present when the encoder runs.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder) {
        self.schedule.record(encoder);
    }

    /// Returns the vertices, shape [B, H W, 6], or [B, V, 6] of a mesh of V vertices: position, then unit normal, which is zero if those of the
    /// triangles around a particle vanish or cancel. Their buffer can be bound as a vertex buffer and for
    /// storage.
    pub fn tensor(&self) -> &Tensor {
        &self.interleaved
    }
}
