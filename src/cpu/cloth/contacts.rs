//! The contacts of a cloth with bodies and with itself: found at the start of a frame, they are planes until its end
//! ([`Contact`](terms::Contact)).

use super::layers::Layers;
use super::touch::Touch;
use super::vector::{add, at, dot, scaled};
use super::{AXES, Coupling, Hessian, Trial};
use crate::cloth::terms::{self, Elastic};
use crate::cloth::{Body, BodyStats, Cloth, Grid, LayerStats, MAX_CONTACTS, Mark, Sweep};
use crate::cpu::Real;
use crate::settings::{HOLDING, PARTINGS};
use crate::sim::MAX_DIRECTIONS;
use glam::DVec3;
use rayon::prelude::*;

/// Particles per task.
const TASK: usize = 256;

/// A cloth at the start of a frame, before its contacts are known.
#[derive(Clone, Copy)]
pub struct Approach<'a, T> {
    /// The grid.
    pub grid: Grid,
    /// The constants of the cloth.
    pub cloth: &'a Cloth,
    /// How its bodies move in the frame.
    pub sweeps: &'a [Sweep],
    /// Positions \[edges\], shape [3, H, W].
    pub x: &'a [T],
    /// Velocities [edges / frame], shape [3, H, W].
    pub v: &'a [T],
    /// What each particle is, shape [H, W]. Handles go where they are told, whatever is there.
    pub marks: &'a [Mark],
    /// Handle positions of all cloths at the end of the frame \[edges\].
    pub handles: &'a [[T; 3]],
}

/// The contacts of a cloth in one frame.
#[derive(Clone, Debug, Default)]
pub struct Contacts<T> {
    /// Those with bodies, in the order of the particles.
    found: Vec<Found<T>>,
    /// Numbers of those that press or rub at the current displacements, and the displacements of their particles.
    active: Vec<(usize, [T; 3])>,
    /// Those with itself.
    layers: Option<Layers<T>>,
}

/// A contact of a particle with a body.
#[derive(Clone, Copy, Debug)]
struct Found<T> {
    particle: usize,
    /// Number of the body.
    body: usize,
    touch: Touch<T>,
}

impl<T: Real> Contacts<T> {
    /// Finds the contacts that may arise in a frame: those of particles that are nearer to a body than its thickness,
    /// twice their way in the frame relative to the body, and one edge together; and those of parts of the cloth that
    /// come near each other ([`Layers::find`]).
    pub fn find(start: Approach<'_, T>) -> Self {
        let particles: Vec<usize> =
            (0..start.grid.particles()).filter(|&p| start.marks[p].is_free()).collect();
        let elastic = Elastic::new(start.grid, start.cloth.material, start.cloth.damping);
        let of_task = |task: &[usize]| {
            let mut found = Vec::new();
            task.iter().for_each(|&p| start.find_at(p, elastic, &mut found));
            found
        };
        let tasks: Vec<Vec<Found<T>>> = particles.par_chunks(TASK).map(of_task).collect();
        let layers = start.cloth.self_contact.map(|settings| Layers::find(&start, settings));
        Self { found: tasks.into_iter().flatten().collect(), active: Vec::new(), layers }
    }

    /// Moves the particles by `shift` [3, H, W]: what follows is there.
    pub fn move_to(&mut self, shift: &[T]) {
        let n = shift.len() / 3;
        self.active.clear();
        self.active.extend(self.found.iter().enumerate().filter_map(|(k, contact)| {
            let y = at(shift, n, contact.particle);
            contact.touch.acts(y).then_some((k, y))
        }));
        if let Some(layers) = &mut self.layers {
            layers.move_to(shift);
        }
    }

    /// Iterates over those with bodies that press or rub, with how far their particles have moved.
    fn active(&self) -> impl Iterator<Item = (&Found<T>, [T; 3])> {
        self.active.iter().map(|&(k, y)| (&self.found[k], y))
    }

    /// Subtracts their gradient, divided by the weights of the particles with these `marks`, from the accelerations [3, H, W]: to
    /// the gradient of the other terms a contact is an external force.
    pub fn add_accelerations(&self, marks: &[Mark], accelerations: &mut [T]) {
        let n = marks.len();
        for (contact, y) in self.active() {
            let p = contact.particle;
            let per_weight = T::of(n as f64 / marks[p].mass());
            let gradient = contact.touch.gradient(y);
            (0..3).for_each(|c| {
                accelerations[c * n + p] = accelerations[c * n + p] - per_weight * gradient[c];
            });
        }
        if let Some(layers) = &self.layers {
            layers.add_accelerations(accelerations);
        }
    }

    /// Returns their energy.
    pub fn energy(&self) -> f64 {
        let of_bodies: f64 = self.active().map(|(contact, y)| contact.touch.energy(y).f64()).sum();
        of_bodies + self.layers.as_ref().map_or(0.0, Layers::energy)
    }

    /// Returns their second derivatives along each pair of `directions` [K, 3, H, W], of this length each.
    pub fn curvature(&self, directions: &[T], len: usize) -> [[f64; MAX_DIRECTIONS]; MAX_DIRECTIONS] {
        let (n, count) = (len / 3, directions.len() / len);
        let mut curvature = [[0.0; MAX_DIRECTIONS]; MAX_DIRECTIONS];
        for (contact, y) in self.active() {
            let along = |k: usize| at(&directions[k * len..], n, contact.particle);
            let curved = contact.touch.curved(y);
            for (i, sums) in curvature.iter_mut().enumerate().take(count) {
                let product = curved.times(along(i));
                for (j, sum) in sums.iter_mut().enumerate().take(count) {
                    *sum += dot(product, along(j)).f64();
                }
            }
        }
        if let Some(layers) = &self.layers {
            layers.add_curvature(directions, len, &mut curvature);
        }
        curvature
    }

    /// Shortens the axes of the sheet, the first nine of `axes` [16, H, W] ([`SheetAxes`](super::SheetAxes)), at the particles that
    /// contacts hold ([`HOLDING`]).
    pub fn shorten_axes(&self, axes: &mut [T]) {
        let n = axes.len() / AXES;
        let mut shorten = |resistances: Vec<T>| {
            let holding = T::of(HOLDING * n as f64);
            let shares: Vec<T> =
                resistances.into_iter().map(|r| (T::one() + holding * r).sqrt().recip()).collect();
            for field in axes.chunks_exact_mut(n).take(9) {
                field.iter_mut().zip(&shares).for_each(|(v, &share)| *v = *v * share);
            }
        };
        if !self.active.is_empty() {
            let mut resistances = vec![T::zero(); n];
            for (contact, y) in self.active() {
                let own = contact.touch.resistance(y);
                resistances[contact.particle] = resistances[contact.particle] + own;
            }
            shorten(resistances);
        }
        if let Some(layers) = &self.layers {
            shorten(layers.resistances(n));
        }
    }

    /// Moves particles out that their velocities `v` and accelerations `a` [3, H, W] lead nearer to a body's plane than
    /// [`terms::Contact::LEAST_GAP`] of its thickness, by adding to `a`. Calls `moved` with each element and what was
    /// added.
    pub fn confine(&self, bodies: &[Body], v: &[T], a: &mut [T], mut moved: impl FnMut(usize, T)) {
        let n = a.len() / 3;
        for contact in &self.found {
            let p = contact.particle;
            let y = add(at(v, n, p), at(a, n, p));
            if let Some(out) = contact.touch.way_out(bodies[contact.body].thickness, y) {
                for (c, out) in out.into_iter().enumerate() {
                    a[c * n + p] = a[c * n + p] + out;
                    moved(c * n + p, out);
                }
            }
        }
    }

    /// Takes back the slip of layers that stick ([`Layers::hold`]), then moves parts of the cloth away from each other
    /// ([`Layers::part`]).
    pub fn part_layers(&self, a: &mut [T]) {
        if let Some(layers) = &self.layers {
            layers.hold(a);
            layers.part(PARTINGS, a);
        }
    }

    /// Corrects the end of a frame, positions and velocities [3, H, W], of which the latter are the displacements:
    /// confines the particles ([`Contacts::confine`]), and takes back the slip of those that stick.
    pub fn end_frame(&self, bodies: &[Body], x: &mut [T], v: &mut [T]) {
        let n = v.len() / 3;
        for contact in &self.found {
            let p = contact.particle;
            let y = at(v, n, p);
            let back = contact.touch.slip_back(y);
            let out = contact.touch.way_out(bodies[contact.body].thickness, y);
            let correction = [back, out].into_iter().flatten().fold([T::zero(); 3], add);
            for c in 0..3 {
                x[c * n + p] = x[c * n + p] + correction[c];
                v[c * n + p] = v[c * n + p] + correction[c];
            }
        }
    }

    /// Returns what each body did in the frame that moved the particles by `shift` [3, H, W] from `x`.
    pub fn stats(&self, bodies: &[Body], sweeps: &[Sweep], x: &[T], shift: &[T]) -> Vec<BodyStats> {
        let n = shift.len() / 3;
        let mut stats = vec![BodyStats::default(); bodies.len()];
        for contact in &self.found {
            let (p, stats) = (contact.particle, &mut stats[contact.body]);
            let y = at(shift, n, p);
            let place = add(at(x, n, p), y).map(|c| c.f64());
            let own = sweeps[contact.body].to.inward(place.into());
            stats.deepest = stats.deepest.max(-bodies[contact.body].shape.distance(own).distance);
            let depth = contact.touch.depth(y);
            if depth > T::zero() {
                stats.touching += 1;
                let load = scaled(contact.touch.gradient, -T::of(3.0) * depth * depth);
                let slip = contact.touch.slip(y);
                let length = dot(slip, slip).sqrt().max(T::of(terms::Contact::STICKING));
                let rub = scaled(slip, contact.touch.friction / length);
                (0..3).for_each(|c| stats.load[c] += load[c].f64() + rub[c].f64());
                stats.friction_work += dot(rub, slip).f64();
            }
        }
        stats
    }

    /// Returns what the layers did to each other; `None` for a cloth that passes through itself.
    pub fn layer_stats(&self, shift: &[T]) -> Option<LayerStats> {
        self.layers.as_ref().map(|layers| layers.stats(shift))
    }
}

impl Contacts<f64> {
    /// Returns the second derivatives of the contacts of the cloth with itself.
    pub(in crate::cpu) fn couplings(&self, trial: &Trial<'_, f64>) -> Vec<Coupling> {
        self.layers.as_ref().map_or_else(Vec::new, |layers| layers.couplings(trial.shift))
    }

    /// Adds the second derivatives of those with bodies to the particles' own blocks of the Hessian.
    pub(in crate::cpu) fn add_own_blocks(&self, trial: &Trial<'_, f64>, hessian: &mut Hessian) {
        let n = trial.grid.particles();
        for contact in &self.found {
            let p = contact.particle;
            let block = contact.touch.curved(at(trial.shift, n, p)).block();
            for (column, values) in block.into_iter().enumerate() {
                // A number and its mirror image share a place.
                for (row, value) in values.into_iter().enumerate().skip(column) {
                    *hessian.at_mut((p, row), (p, column)) += value;
                }
            }
        }
    }
}

impl<T: Real> Approach<'_, T> {
    /// Appends the contacts of particle `p`.
    fn find_at(&self, p: usize, elastic: Elastic, found: &mut Vec<Found<T>>) {
        let n = self.grid.particles();
        let wide = |field: &[T]| DVec3::from(at(field, n, p).map(|c| c.f64()));
        let (x, v) = (wide(self.x), wide(self.v));
        let first = found.len();
        let mut gaps = [0.0; MAX_CONTACTS];
        for (number, (body, sweep)) in self.cloth.bodies.iter().zip(self.sweeps).enumerate() {
            let plane = body.present.then(|| Plane::find(body, sweep, x, x + v)).flatten();
            let Some(plane) = plane else { continue };
            let mut place = found.len() - first;
            if place == MAX_CONTACTS {
                let farthest =
                    (0..MAX_CONTACTS).fold(0, |most, k| if gaps[k] > gaps[most] { k } else { most });
                if gaps[farthest] <= plane.predicted {
                    continue;
                }
                place = farthest;
            }
            gaps[place] = plane.predicted;
            let contact = self.contact(p, plane, body, elastic);
            let contact = Found { particle: p, body: number, touch: Touch::new(contact) };
            match found.get_mut(first + place) {
                Some(other) => *other = contact,
                None => found.push(contact),
            }
        }
    }

    /// Returns the contact of particle `p` with a plane.
    fn contact(&self, p: usize, plane: Plane, body: &Body, elastic: Elastic) -> terms::Contact {
        let (n, h) = (self.grid.particles(), body.thickness);
        let mass = self.marks[p].mass() / n as f64;
        let own = self.elastic_along(p, plane.normal, elastic);
        // A particle that would go deep needs a stiff barrier in this very frame.
        let stiffness = terms::Contact::stiffness(own, mass, plane.before.min(plane.predicted), h);
        let before = terms::Contact::stiffness(own, mass, plane.before, h);
        // What pressed on the body at the start, or what stops a particle that meets it in this frame.
        let pressed = terms::Contact::load_at(before, plane.before, h);
        let stopped = mass * (h - plane.predicted).max(0.0);
        terms::Contact {
            drift: plane.drift,
            friction: body.friction * pressed.max(stopped),
            ..terms::Contact::new(plane.normal, plane.at_start, stiffness, h)
        }
    }

    /// Returns n . D n, with the block D of particle `p` in the Hessian of the stretch at the start of the frame, where
    /// compressed edges count as unstretched and all as stiff as the material. Shear and bend are weak beside it.
    pub(super) fn elastic_along(&self, p: usize, normal: DVec3, elastic: Elastic) -> f64 {
        let Grid { h, w } = self.grid;
        let (n, i, j) = (h * w, p / w, p % w);
        let place = |q: usize| DVec3::from(at(self.x, n, q).map(|c| c.f64()));
        let own = place(p);
        let vertical = [(i > 0).then(|| p - w), (i + 1 < h).then(|| p + w)].map(|q| (q, elastic.vertical));
        let horizontal =
            [(j > 0).then(|| p - 1), (j + 1 < w).then(|| p + 1)].map(|q| (q, elastic.horizontal));
        let edges = vertical.into_iter().chain(horizontal);
        edges
            .filter_map(|(q, term)| {
                let edge = place(q.filter(|&q| !self.marks[q].is_outside())?) - own;
                let length = edge.length();
                if length == 0.0 {
                    return None;
                }
                let along = (edge.dot(normal) / length).powi(2);
                let stiffened = (1.0 + term.damping) * along;
                Some(2.0 * term.factor * (stiffened + (1.0 - 1.0 / length).max(0.0) * (1.0 - along)))
            })
            .sum()
    }
}

/// The plane that stands for a body before one particle.
#[derive(Clone, Copy, Debug)]
struct Plane {
    /// Away from the body, at the end of the frame.
    normal: DVec3,
    /// Distance from the body at the start of the frame.
    before: f64,
    /// Distance above the plane of the particle's place at the start of the frame.
    at_start: f64,
    /// The same, of the place to which its velocity takes it.
    predicted: f64,
    /// Displacement of the body's point in the frame.
    drift: DVec3,
}

impl Plane {
    /// Finds the plane for a particle whose velocity takes it from `x` to `predicted`: where it meets the body on its
    /// way, else where it arrives. Returns `None` if it stays far away.
    fn find(body: &Body, sweep: &Sweep, x: DVec3, predicted: DVec3) -> Option<Self> {
        let (start, end) = (sweep.from.inward(x), sweep.to.inward(predicted));
        let way = end - start;
        let length = way.length();
        let near = body.thickness + 2.0 * length + 1.0;
        if start.length() > body.shape.reach() + near {
            return None;
        }
        let before = body.shape.distance(start).distance;
        if before > near {
            return None;
        }
        let mut place = end;
        if before > 0.0 && before <= length {
            let mut share = 0.0;
            for _ in 0..terms::Contact::STEPS {
                let here = start + share * way;
                let left = body.shape.distance(here).distance;
                if left <= 0.0 {
                    place = here;
                    break;
                }
                share += (left / length).max(terms::Contact::LEAST_ADVANCE);
                if share >= 1.0 {
                    break;
                }
            }
        }
        let surface = body.shape.distance(place);
        let normal = sweep.to.turned(surface.normal);
        let (at_place, distance) = (sweep.to.outward(place), surface.distance);
        let above = |point: DVec3| normal.dot(point - at_place) + distance;
        // The body's point that touches, where it was.
        let drift = sweep.to.outward(place) - sweep.from.outward(place);
        Some(Self { normal, before, at_start: above(x), predicted: above(predicted), drift })
    }
}
