//! The energy of a cloth as plain sums over its elements: short, slow, and what the vectorised forms are checked
//! against.

use super::Trial;
use super::vector::at;
use crate::cloth::EnergyTerms;
use crate::cloth::terms::{Angle, Edge, Elastic, Ends, bends, corners, edges, particles};
use glam::{DMat3, DVec3};

/// The energy L of a cloth at a trial acceleration, its gradient, and its second derivatives along directions.
#[derive(Clone, Debug, PartialEq)]
pub struct PlainTotal {
    /// The energy terms, except the repulsion.
    pub energy: EnergyTerms,
    /// `dL/da`, shape [3, H, W].
    pub gradient: Vec<f64>,
    /// `p_i . (d2L/da2) p_j` for the directions p, shape [K, K].
    pub curvature: Vec<Vec<f64>>,
}

/// Sums the [local terms](crate::cloth::terms) of one cloth, with the second derivatives along `directions`
/// [K, 3, H, W]. Handles move to their targets whatever a is, so only inertia and external work depend on theirs.
pub fn plain_total(trial: &Trial<'_, f64>, directions: &[f64]) -> PlainTotal {
    let mut sum = Sum::new(*trial, directions);
    let has = |ends: &Ends| ends.iter().all(|&p| !trial.marks[p].is_outside());
    let elastic = Elastic::new(trial.grid, trial.material, trial.damping);
    for (ends, edge) in edges(trial.grid, elastic, trial.marks).into_iter().filter(|(ends, _)| has(ends)) {
        let e = sum.edge(ends);
        let edge = Edge { before: sum.edge_before(ends).length(), ..edge };
        sum.total.energy.stretch += edge.energy(e);
        sum.add_elastic([ends], [edge.gradient(e)], [[edge.hessian(e)]]);
    }
    let has = |(pair, _): &([Ends; 2], Angle)| pair.iter().all(has);
    for (pair, angle) in corners(trial.grid, elastic, trial.marks).into_iter().filter(has) {
        sum.total.energy.shear += sum.add_angle(pair, angle);
    }
    for (pair, angle) in bends(trial.grid, elastic, trial.marks).into_iter().filter(has) {
        sum.total.energy.bend += sum.add_angle(pair, angle);
    }
    for (p, particle) in particles(trial.marks, trial.f).into_iter().enumerate() {
        let a = DVec3::from(at(trial.a, trial.grid.particles(), p));
        sum.total.energy.inertia += particle.inertia(a);
        sum.total.energy.external += particle.work(a);
        sum.add_gradient(p, particle.gradient(a));
        let changes: Vec<DVec3> = directions.chunks_exact(trial.x.len()).map(|d| vector(d, p)).collect();
        sum.add_curvature(&changes, &changes, particle.hessian());
    }
    sum.total
}

struct Sum<'a> {
    trial: Trial<'a, f64>,
    /// Shape [K, 3, H, W].
    directions: &'a [f64],
    total: PlainTotal,
}

impl<'a> Sum<'a> {
    fn new(trial: Trial<'a, f64>, directions: &'a [f64]) -> Self {
        let (len, energy) = (trial.x.len(), EnergyTerms::default());
        let count = directions.len() / len;
        let curvature = vec![vec![0.0; count]; count];
        Self { trial, directions, total: PlainTotal { energy, gradient: vec![0.0; len], curvature } }
    }

    /// Returns the edge between two particles at the trial.
    fn edge(&self, [p, q]: Ends) -> DVec3 {
        self.trial.edge(p, q).into()
    }

    /// Returns the edge between two particles at the start of the frame.
    fn edge_before(&self, [p, q]: Ends) -> DVec3 {
        vector(self.trial.x, q) - vector(self.trial.x, p)
    }

    /// Adds the derivatives of the energy of an angle, and returns the energy.
    fn add_angle(&mut self, pair: [Ends; 2], angle: Angle) -> f64 {
        let [u, w] = pair.map(|ends| self.edge(ends));
        self.add_elastic(pair, angle.gradient(u, w), angle.hessian(u, w));
        angle.energy(u, w)
    }

    /// Adds the derivatives of an energy of V edges, given those with respect to the edges.
    fn add_elastic<const V: usize>(
        &mut self,
        edges: [Ends; V],
        gradient: [DVec3; V],
        hessian: [[DMat3; V]; V],
    ) {
        for ([begin, end], gradient) in edges.into_iter().zip(gradient) {
            for (p, gradient) in [(begin, -gradient), (end, gradient)] {
                if self.trial.marks[p].is_free() {
                    self.add_gradient(p, gradient);
                }
            }
        }
        let changes = edges.map(|ends| self.changes(ends));
        for (of_row, hessian) in changes.iter().zip(hessian) {
            for (of_column, block) in changes.iter().zip(hessian) {
                self.add_curvature(of_row, of_column, block);
            }
        }
    }

    /// Returns by how much each direction changes an edge.
    fn changes(&self, [begin, end]: Ends) -> Vec<DVec3> {
        let moved =
            |d: &[f64], p: usize| if self.trial.marks[p].is_free() { vector(d, p) } else { DVec3::ZERO };
        let fields = self.directions.chunks_exact(self.trial.x.len());
        fields.map(|d| moved(d, end) - moved(d, begin)).collect()
    }

    fn add_gradient(&mut self, p: usize, gradient: DVec3) {
        let n = self.trial.grid.particles();
        (0..3).for_each(|c| self.total.gradient[c * n + p] += gradient[c]);
    }

    /// Adds the product of a block of second derivatives with the changes of its two variables along each pair of
    /// directions.
    fn add_curvature(&mut self, of_row: &[DVec3], of_column: &[DVec3], block: DMat3) {
        for (sums, one) in self.total.curvature.iter_mut().zip(of_row) {
            for (sum, other) in sums.iter_mut().zip(of_column) {
                *sum += one.dot(block * *other);
            }
        }
    }
}

/// Returns the vector of particle `p` in a field [3, H, W].
fn vector(field: &[f64], p: usize) -> DVec3 {
    at(field, field.len() / 3, p).into()
}
