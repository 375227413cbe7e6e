//! The local terms of the energy of a frame (paper section 3.2), each defined once, in plain double precision:
//! [`Edge`] (stretch), [`Angle`] (shear and bend), [`Particle`] (inertia and external work) and [`Contact`] (barrier and friction
//! of a body).
//!
//! A term depends on one element: an edge vector, two of them, or a particle's acceleration. It has an energy, a
//! derivative and second derivatives with respect to these. The functions [`edges`], [`corners`], [`bends`] and
//! [`particles`] list the elements of a cloth with their coefficients, and [`plain_total`](crate::cpu::cloth::plain_total)
//! sums over them.
//!
//! These definitions are for reading and for tests. What runs, on either device, are vectorised forms of them, checked
//! against the plain ones. The repulsion is not local: [`repulsion`](crate::cpu::cloth::repulsion()).
//!
//! Everything is in grid units: lengths in edges, times in frames, energies in (mass of a cell) edges^2 / frame^2, per
//! particle. Since dt = 1, the derivative with respect to a free particle's acceleration is that with respect to its
//! position.

mod angle;
mod contact;
mod edge;
mod particle;

pub use angle::Angle;
pub use contact::Contact;
pub use edge::Edge;
pub use particle::Particle;

use super::{Grid, Mark, Material};
use std::f64::consts::FRAC_PI_2;

/// The terms of one vertical edge, one horizontal edge, one corner of a cell and one bend: the coefficients of a
/// material, divided by the number of terms that they average over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elastic {
    /// An edge from (i, j) to (i+1, j).
    pub vertical: Edge,
    /// An edge from (i, j) to (i, j+1).
    pub horizontal: Edge,
    /// The angle between two edges of a cell that meet in a corner.
    pub shear: Angle,
    /// The angle between two consecutive vertical edges.
    pub vertical_bend: Angle,
    /// The angle between two consecutive horizontal edges.
    pub horizontal_bend: Angle,
}

impl Elastic {
    /// Returns the terms of a material, whose edges have this damping \[frames\], on a grid of at least 2 x 2 particles. The
    /// edges are taken to have length 1 at the start of the frame.
    pub fn new(Grid { h, w }: Grid, material: Material, damping: f64) -> Self {
        let ([down, across], n) = (material.stretches(), (h * w) as f64);
        let bend = |coefficient: f64| Angle { factor: coefficient / n, rest: 0.0 };
        let [vertical_bend, horizontal_bend] = material.bends().map(bend);
        Self {
            vertical: Edge { factor: down / ((h - 1) * w) as f64, damping, before: 1.0 },
            horizontal: Edge { factor: across / (h * (w - 1)) as f64, damping, before: 1.0 },
            shear: Angle { factor: material.shear / n, rest: FRAC_PI_2 },
            vertical_bend,
            horizontal_bend,
        }
    }
}

/// The numbers of the particles where an edge begins and ends.
pub type Ends = [usize; 2];

/// Returns all edges of a cloth with their stretch, given the marks of its particles [H, W].
pub fn edges(grid: Grid, elastic: Elastic, marks: &[Mark]) -> Vec<(Ends, Edge)> {
    let mut edges = Vec::new();
    let of_ends = |p: usize, q: usize, edge: Edge| {
        let stiffness = 0.5 * (marks[p].stiffness() + marks[q].stiffness());
        ([p, q], Edge { factor: stiffness * edge.factor, ..edge })
    };
    for p in 0..grid.particles() {
        if let Some(q) = below(grid, p) {
            edges.push(of_ends(p, q, elastic.vertical));
        }
        if let Some(q) = right(grid, p) {
            edges.push(of_ends(p, q, elastic.horizontal));
        }
    }
    edges
}

/// Returns the four corners of each cell of a cloth, the pairs of a vertical and a horizontal edge, with their shear.
pub fn corners(grid: Grid, elastic: Elastic, marks: &[Mark]) -> Vec<([Ends; 2], Angle)> {
    let mut corners = Vec::new();
    for p in 0..grid.particles() {
        let (Some(q), Some(r)) = (right(grid, p), below(grid, p)) else { continue };
        let opposite = r + 1;
        for (side, vertical) in [[p, r], [q, opposite]].into_iter().enumerate() {
            for horizontal in [[p, q], [r, opposite]] {
                let stiffness = marks[horizontal[side]].stiffness();
                corners.push(([vertical, horizontal], elastic.shear.times(stiffness)));
            }
        }
    }
    corners
}

/// Returns the pairs of consecutive edges of the same direction of a cloth, with their bend.
pub fn bends(grid: Grid, elastic: Elastic, marks: &[Mark]) -> Vec<([Ends; 2], Angle)> {
    type Next = fn(Grid, usize) -> Option<usize>;
    let axes: [(Next, Angle); 2] = [(below, elastic.vertical_bend), (right, elastic.horizontal_bend)];
    let mut bends = Vec::new();
    for p in 0..grid.particles() {
        for (next, bend) in axes {
            let Some(q) = next(grid, p) else { continue };
            let Some(r) = next(grid, q) else { continue };
            bends.push(([[p, q], [q, r]], bend.times(marks[q].stiffness())));
        }
    }
    bends
}

/// Returns the particles with these marks [H, W] under the external accelerations `f` [3, H, W].
pub fn particles(marks: &[Mark], f: &[f64]) -> Vec<Particle> {
    let n = marks.len();
    let particle = |p: usize| Particle {
        mass: marks[p].mass() / n as f64,
        external: [f[p], f[n + p], f[2 * n + p]].into(),
    };
    (0..n).map(particle).collect()
}

/// Returns the particle after `p` along the height, (i+1, j).
fn below(grid: Grid, p: usize) -> Option<usize> {
    (p + grid.w < grid.particles()).then_some(p + grid.w)
}

/// Returns the particle after `p` along the width, (i, j+1).
fn right(grid: Grid, p: usize) -> Option<usize> {
    (p % grid.w + 1 < grid.w).then_some(p + 1)
}
