//! The couples that bend a cloth to its angles at rest.

use super::vector::{add, at, cross, dot, scaled, sub};
use super::{Approach, Coupling, Projection, Trial};
use crate::cloth::Role;
use crate::cloth::terms::Elastic;
use crate::cpu::Real;
use crate::sim::MAX_DIRECTIONS;

/// Least squared lever arm of a couple \[edges^2\]: on an edge that comes nearer to the axis, its force stays finite.
const NEAREST: f64 = 1e-2;

/// The couples of a cloth in one frame. With the rest angle r of a particle and the coefficient c of its bend, the
/// energy of the paper, `c t^2`, becomes `c (t - r)^2`, where the angle t has the sign of the side to which the sheet
/// turns ([`RestAngles`](crate::cloth::RestAngles)).
///
/// The sign needs an axis about which it turns: the direction d of the other axis of the grid at the particle, where
/// the velocities lead, which stays the same for the frame. About it, with the edges u before and w after the particle,
/// `t = atan2(d . (u x w), u . w - (d . u) (d . w))`, and the couple's energy is `c (r^2 - 2 r t)`.
#[derive(Clone, Debug, Default)]
pub struct Couples<T> {
    hinges: Vec<Hinge<T>>,
}

/// A particle and the two edges along an axis of the grid that meet there.
#[derive(Clone, Copy, Debug)]
struct Hinge<T> {
    /// The particles: before, the middle, after.
    particles: [usize; 3],
    /// The axis d, of length 1.
    axis: [T; 3],
    /// The angle r at rest.
    angle: T,
    /// The moment, 2 c r.
    moment: T,
}

impl<T: Real> Couples<T> {
    /// Finds them at the start of a frame; none for a cloth that is flat at rest.
    pub fn find(start: &Approach<'_, T>) -> Self {
        let Some(angles) = &start.cloth.rest_angles else { return Self { hinges: Vec::new() } };
        let (grid, marks, n) = (start.grid, start.marks, start.grid.particles());
        let elastic = Elastic::new(grid, start.cloth.material, start.cloth.damping);
        let bends = [elastic.vertical_bend, elastic.horizontal_bend];
        let predicted = |p: usize| match marks[p].role() {
            Role::Free => add(at(start.x, n, p), at(start.v, n, p)),
            Role::Handle(k) => start.handles[k],
            Role::Outside => at(start.x, n, p),
        };
        let hinge = |p: usize, axis: usize| {
            let angle = angles.at(p)[axis];
            if angle == 0.0 || marks[p].is_outside() {
                return None;
            }
            let places = [(p / grid.w, grid.h, grid.w), (p % grid.w, grid.w, 1)];
            // The particles before and after it.
            let around = |(index, count, step): (usize, usize, usize)| {
                let before = (index > 0).then(|| p - step);
                let after = (index + 1 < count).then(|| p + step);
                [before, after].map(|q| q.filter(|&q| !marks[q].is_outside()))
            };
            let [Some(before), Some(after)] = around(places[axis]) else { return None };
            let [first, last] = around(places[1 - axis]).map(|q| predicted(q.unwrap_or(p)));
            // Along the height, the front is where the sheet turns the other way.
            let across = if axis == 0 { sub(first, last) } else { sub(last, first) };
            let length = dot(across, across).sqrt();
            (length > T::of(1e-12)).then(|| Hinge {
                particles: [before, p, after],
                axis: scaled(across, length.recip()),
                angle: T::of(angle.into()),
                moment: T::of(2.0 * bends[axis].factor * marks[p].stiffness() * f64::from(angle)),
            })
        };
        let each = (0..n).flat_map(|p| [0, 1].map(|axis| hinge(p, axis)));
        Self { hinges: each.flatten().collect() }
    }

    /// Subtracts their gradient at a trial, divided by the weights of the particles, from the accelerations [3, H, W], as
    /// [`Contacts::add_accelerations`](super::Contacts::add_accelerations) does.
    pub fn add_accelerations(&self, trial: &Trial<'_, T>, accelerations: &mut [T]) {
        let (marks, n) = (trial.marks, trial.marks.len());
        let mut push = |p: usize, force: [T; 3]| {
            if marks[p].is_free() {
                let per_weight = T::of(n as f64 / marks[p].mass());
                (0..3).for_each(|c| {
                    accelerations[c * n + p] = accelerations[c * n + p] + per_weight * force[c];
                });
            }
        };
        for hinge in &self.hinges {
            let [before, own, after] = hinge.particles;
            let [first, second] = hinge.edges(trial).map(|edge| {
                let lever = hinge.lever(edge);
                scaled(lever.across, hinge.moment * lever.inverse)
            });
            push(before, first);
            push(own, scaled(add(first, second), -T::one()));
            push(after, second);
        }
    }

    /// Returns their energy.
    pub fn energy(&self, trial: &Trial<'_, T>) -> f64 {
        let of_hinge = |hinge: &Hinge<T>| {
            let [u, w] = hinge.edges(trial);
            let sine = dot(hinge.axis, cross(u, w));
            let cosine = dot(u, w) - dot(hinge.axis, u) * dot(hinge.axis, w);
            let turn = sine.f64().atan2(cosine.f64());
            hinge.moment.f64() * (0.5 * hinge.angle.f64() - turn)
        };
        self.hinges.iter().map(of_hinge).sum()
    }

    /// Returns about as much energy as cancels between them and the bend of the paper where the cloth has its shape:
    /// the rounding of both is a share of it.
    pub fn cancelled(&self) -> f64 {
        self.hinges.iter().map(|hinge| (hinge.moment * hinge.angle).f64().abs()).sum()
    }

    /// Adds their second derivatives along each pair of `directions` [K, 3, H, W], which are 0 at handles.
    pub fn add_curvature(
        &self,
        trial: &Trial<'_, T>,
        directions: &[T],
        curvature: &mut [[f64; MAX_DIRECTIONS]; MAX_DIRECTIONS],
    ) {
        let len = trial.x.len();
        for hinge in &self.hinges {
            let [before, own, after] = hinge.particles;
            let edges = hinge.edges(trial);
            for (edge, [p, q], moment) in
                [(edges[0], [before, own], -hinge.moment), (edges[1], [own, after], hinge.moment)]
            {
                let lever = hinge.lever(edge);
                let factor = moment * lever.inverse * lever.inverse;
                let mut along = [[T::zero(); 2]; MAX_DIRECTIONS];
                for (along, field) in along.iter_mut().zip(directions.chunks_exact(len)) {
                    let change = sub(at(field, len / 3, q), at(field, len / 3, p));
                    *along = [dot(lever.arm, change), dot(lever.across, change)];
                }
                for (sums, [arm, across]) in curvature.iter_mut().zip(along) {
                    for (sum, [other_arm, other_across]) in sums.iter_mut().zip(along) {
                        *sum += (factor * (arm * other_across + across * other_arm)).f64();
                    }
                }
            }
        }
    }
}

impl Couples<f64> {
    /// Returns their second derivatives, with this share of the negative curvature removed.
    pub(in crate::cpu) fn couplings(
        &self,
        trial: &Trial<'_, f64>,
        Projection(share): Projection,
    ) -> Vec<Coupling> {
        let of_edge = |hinge: &Hinge<f64>, k: usize, moment: f64| {
            let lever = hinge.lever(hinge.edges(trial)[k]);
            // arm across' + across arm' is 1 along their sum and -1 along their difference, over their lengths.
            let half = 0.5 * moment.abs() * lever.inverse * lever.inverse;
            let [convex, concave] =
                [moment.signum(), -moment.signum()].map(|sign| add(lever.arm, scaled(lever.across, sign)));
            let block = [0, 1, 2].map(|r| {
                [0, 1, 2].map(|c| half * (convex[r] * convex[c] - (1.0 - share) * concave[r] * concave[c]))
            });
            let [p, q] = [hinge.particles[k], hinge.particles[k + 1]];
            Coupling { particles: [p, q, p, q], weights: [-1.0, 1.0, 0.0, 0.0], block }
        };
        self.hinges
            .iter()
            .flat_map(|hinge| [of_edge(hinge, 0, -hinge.moment), of_edge(hinge, 1, hinge.moment)])
            .collect()
    }
}

/// An edge as the lever of a couple.
struct Lever<T> {
    /// The part of the edge across the axis.
    arm: [T; 3],
    /// The axis times the edge: where the edge turns to.
    across: [T; 3],
    /// One over the square of the length of both.
    inverse: T,
}

impl<T: Real> Hinge<T> {
    /// Returns the edges before and after the particle.
    fn edges(&self, trial: &Trial<'_, T>) -> [[T; 3]; 2] {
        let [before, own, after] = self.particles;
        [trial.edge(before, own), trial.edge(own, after)]
    }

    fn lever(&self, edge: [T; 3]) -> Lever<T> {
        let arm = sub(edge, scaled(self.axis, dot(self.axis, edge)));
        Lever { arm, across: cross(self.axis, edge), inverse: dot(arm, arm).max(T::of(NEAREST)).recip() }
    }
}
