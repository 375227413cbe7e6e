//! `embed` against the CPU path.

use crate::common::{assert_close, cases, context, device, noise, poisoned, read, run, tensor, widened};
use fnopt::cloth::{Embedding, Grid};
use fnopt::cpu;
use fnopt::gpu::Tensor;
use fnopt::kernels::cloth::Embed;

/// Scatters vertices over the sheet, the first of them in its corners.
fn scattered(grid: Grid, count: usize) -> Embedding {
    let inside = noise(2 * count, 91).into_iter().map(|v| 0.5 + 0.5 * v).collect::<Vec<f32>>();
    let mut uv: Vec<[f32; 2]> = inside.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
    uv[..4].copy_from_slice(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]);
    Embedding::new(grid, None, &uv, "a test").unwrap()
}

#[test]
fn embedded_vertices_match() {
    let _turn = device();
    let kernel = Embed::new(context()).unwrap();
    for (grid, batch) in cases() {
        let (n, vertices) = (grid.particles(), 333);
        let embedding = scattered(grid, vertices);
        // Normals within a cone, so that none cancel, but in the first cell, whose vertices have none.
        let mut from = noise(6 * batch * n, 92);
        for (k, particle) in from.chunks_exact_mut(6).enumerate() {
            particle[5] += 2.0;
            if [0, 1, grid.w, grid.w + 1].contains(&(k % n)) {
                particle[3..].fill(0.0);
            }
        }
        let particles: Vec<[f64; 6]> =
            widened(&from).chunks_exact(6).map(|particle| particle.try_into().unwrap()).collect();
        let expected: Vec<f64> = particles
            .chunks_exact(n)
            .flat_map(|cloth| cpu::cloth::embed(&embedding, cloth))
            .flatten()
            .collect();
        let cells = Tensor::from_slice(context(), "cells", &[vertices], embedding.cells()).unwrap();
        let weights: Vec<f32> =
            embedding.weights().as_flattened().iter().map(|&weight| weight as f32).collect();
        let weights = tensor("weights", &[vertices, 2], &weights);
        let interleaved = tensor("vertices", &[batch, n, 6], &from);
        let embedded = poisoned("embedded", &[batch, vertices, 6]);
        run(|schedule| kernel.push(schedule, grid, (&cells, &weights, &interleaved), &embedded));
        let found = read(&embedded);
        // Numbers of about 1, each of eight roundings.
        assert_close(&format!("embed {batch} x {grid}"), &found, &expected, (1e-6, 1e-6));
        // Particle (0, 0) is the corner (1, 1).
        assert_eq!(found[3 * 6..4 * 6], [from[0], from[1], from[2], 0.0, 0.0, 0.0]);
    }
}
