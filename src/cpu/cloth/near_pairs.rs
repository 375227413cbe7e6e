//! Which particles of a cloth may be near each other, found anew only after they have moved.

use super::cells::{Cells, Placed};
use super::vector::{add, at, dot, sub};
use crate::cloth::{Grid, Mark};
use crate::cpu::Real;
use rayon::prelude::*;

/// Number of particles per task.
const TASK: usize = 512;
/// How much farther than the distance that is asked for pairs are looked for, in shares of it: two particles may move
/// towards each other by half of that each.
const MARGIN: f64 = 0.5;

/// For each particle of a cloth those that come nearer to it than a distance, and others that are not much farther
/// away. Particles that an edge of the triangulated grid joins are left out.
#[derive(Clone, Debug)]
pub struct NearPairs<T> {
    distance: T,
    /// Where the particles were \[edges\]; infinitely far for those that the cloth doesn't have.
    places: Vec<[T; 3]>,
    /// How many particle p and those before it have together.
    ends: Vec<u32>,
    /// Those of one particle after another, by their numbers, which ascend.
    all: Vec<u32>,
}

impl<T: Real> Default for NearPairs<T> {
    /// Returns those of no particles.
    fn default() -> Self {
        Self { distance: T::zero(), places: Vec::new(), ends: Vec::new(), all: Vec::new() }
    }
}

impl<T: Real> NearPairs<T> {
    /// Returns the positions of the particles with these `marks` [H, W] at `x + shift`, both [3, H, W].
    pub fn places(marks: &[Mark], x: &[T], shift: &[T]) -> Vec<[T; 3]> {
        let n = marks.len();
        let place = |p: usize| match marks[p].is_outside() {
            true => [T::infinity(); 3],
            false => add(at(x, n, p), at(shift, n, p)),
        };
        (0..n).map(place).collect()
    }

    /// Makes them those of particles at these `places`, nearer than `distance` \[edges\], unless what was found
    /// before still holds. The bits of what is summed over pairs in range do not depend on when they were found.
    pub fn update(&mut self, grid: Grid, places: &[[T; 3]], distance: T) {
        if self.holds(places, distance) {
            return;
        }
        let reach = distance * T::of(1.0 + MARGIN);
        let cells = Cells::of(places.iter().copied(), reach);
        let of_task = |task: &[Placed<T>]| {
            let mut walk = cells.walk(&task[0]);
            let of_particle = |own: &Placed<T>| {
                let around = own.is_within_reach().then(|| walk.around(own));
                let is_near = |other: &&Placed<T>| {
                    let from = sub(own.place, other.place);
                    dot(from, from) < reach * reach && !grid.joined(own.particle, other.particle)
                };
                let near = around.into_iter().flatten().filter(is_near);
                let mut near: Vec<u32> = near.map(|other| other.particle as u32).collect();
                near.sort_unstable();
                (own.particle, near)
            };
            task.iter().map(of_particle).collect()
        };
        let tasks: Vec<Vec<(usize, Vec<u32>)>> = cells.sorted().par_chunks(TASK).map(of_task).collect();
        let mut of_particles = vec![&[][..]; places.len()];
        tasks.iter().flatten().for_each(|(p, near)| of_particles[*p] = near);
        self.all.clear();
        self.ends.clear();
        for near in of_particles {
            self.all.extend_from_slice(near);
            self.ends.push(self.all.len() as u32);
        }
        self.distance = distance;
        self.places.clear();
        self.places.extend_from_slice(places);
    }

    /// Whether they were found for this distance, and no particle has moved too far since, relative to all.
    fn holds(&self, places: &[[T; 3]], distance: T) -> bool {
        if self.distance != distance || self.places.len() != places.len() {
            return false;
        }
        // A particle that the cloth gains or loses has moved, one that it never had has not.
        let is_there = |place: &[T; 3]| place[0] != T::infinity();
        let moves =
            || self.places.iter().zip(places).filter(|(before, now)| is_there(before) || is_there(now));
        let (mut mean, mut count) = ([T::zero(); 3], T::zero());
        for (before, now) in moves() {
            mean = add(mean, sub(*now, *before));
            count = count + T::one();
        }
        let mean = mean.map(|sum| sum / count);
        // A little less than half the margin, for rounding.
        let most = T::of(0.49 * MARGIN) * distance;
        // Not a number is not near.
        moves().all(|(before, now)| {
            let own = sub(sub(*now, *before), mean);
            dot(own, own) < most * most
        })
    }

    /// Whether they are those of pairs nearer than this.
    pub fn are_within(&self, distance: T) -> bool {
        self.distance == distance
    }

    /// Returns those of particle `p`.
    pub fn of(&self, p: usize) -> &[u32] {
        let first = if p == 0 { 0 } else { self.ends[p - 1] };
        &self.all[first as usize..self.ends[p] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_hold_until_a_particle_has_moved() {
        let grid = Grid { h: 9, w: 11 };
        // A sheet folded in the middle, whose layers are half an edge apart.
        let place = |p: usize| {
            let (i, j) = (p / grid.w, p % grid.w);
            [j.min(10 - j) as f64, i as f64, if j > 5 { 0.5 } else { 0.0 }]
        };
        let mut places: Vec<[f64; 3]> = (0..grid.particles()).map(place).collect();
        let brute = |places: &[[f64; 3]], p: usize, distance: f64| -> Vec<u32> {
            let near = |q: &usize| {
                let from = sub(places[p], places[*q]);
                dot(from, from) < distance * distance && !grid.joined(p, *q) && p != *q
            };
            (0..grid.particles()).filter(near).map(|q| q as u32).collect()
        };
        let mut found = NearPairs::default();
        found.update(grid, &places, 0.8);
        let all =
            |found: &NearPairs<f64>| (0..grid.particles()).map(|p| found.of(p).to_vec()).collect::<Vec<_>>();
        let before = all(&found);
        assert!((0..grid.particles()).all(|p| found.of(p) == brute(&places, p, 1.2)));
        assert!(before.iter().any(|near| !near.is_empty()));
        // All together, and one a little: the same, in which all that are near are.
        places.iter_mut().for_each(|place| place[2] += 7.0);
        places[12][2] += 0.19;
        found.update(grid, &places, 0.8);
        assert_eq!(all(&found), before);
        for p in 0..grid.particles() {
            assert!(brute(&places, p, 0.8).iter().all(|q| found.of(p).contains(q)));
        }
        // Farther, another distance, or not a number.
        places[12][2] += 5.0;
        found.update(grid, &places, 0.8);
        assert!(
            (0..grid.particles()).all(|p| found.of(p) == brute(&places, p, 1.2)) && all(&found) != before
        );
        found.update(grid, &places, 0.4);
        assert!((0..grid.particles()).all(|p| found.of(p) == brute(&places, p, 0.6)));
        // What the cloth loses, never has, and gets back.
        let lost = std::mem::replace(&mut places[12], [f64::INFINITY; 3]);
        assert!(!found.holds(&places, 0.4));
        found.update(grid, &places, 0.4);
        assert!(found.of(12).is_empty() && found.holds(&places, 0.4));
        places[12] = lost;
        assert!(!found.holds(&places, 0.4));
        places[12][0] = f64::NAN;
        found.update(grid, &places, 0.4);
        assert!(found.of(12).is_empty() && !found.holds(&places, 0.4));
    }
}
