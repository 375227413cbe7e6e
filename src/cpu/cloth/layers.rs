//! The contacts of a cloth with itself: between its particles and its triangles, and between its edges.

use super::contacts::Approach;
use super::flat_tiles::FlatTiles;
use super::patch_tree::PatchTree;
use super::touch::Touch;
use super::vector::{add, at, dot, scaled};
use super::{Block, Coupling};
use crate::cloth::terms::{Contact, Elastic};
use crate::cloth::{Bounds, Grid, LayerStats, Nearest, Parts, Role, SelfContact};
use crate::cpu::Real;
use crate::sim::MAX_DIRECTIONS;
use glam::DVec3;
use rayon::prelude::*;

/// Fewer pairs than this are not worth waking a thread for.
const ALONE: usize = 2048;

/// Pairs of parts of a cloth that may touch in a frame. For the frame each is a plane between the parts ([`Contact`]), and
/// their points that are nearest to each other stay the same: so all is a function of one vector for each pair, and the
/// forces on its four particles sum to zero.
#[derive(Clone, Debug)]
pub struct Layers<T> {
    pairs: Vec<Pair<T>>,
    /// Numbers of the pairs that press or rub at the current displacements, and how far these part them.
    active: Vec<(usize, [T; 3])>,
    /// Distance at which they begin to press \[edges\].
    thickness: f64,
    /// Whether there were too many pairs, of which none was kept.
    overflow: bool,
}

/// Two parts, and the contact that their relative displacement `y = sum w_k y_k` has.
#[derive(Clone, Copy, Debug)]
struct Pair<T> {
    particles: [usize; 4],
    /// The weights w, which sum to 0.
    weights: [T; 4],
    /// What a force accelerates each particle by: its weight over the particle's mass over H W; 0 for handles.
    response: [T; 4],
    /// The relative displacement by the velocities, and of handles.
    base: [T; 3],
    touch: Touch<T>,
}

impl<T: Real> Pair<T> {
    /// Returns the difference that a field [3, n] has between the parts.
    #[inline(always)]
    fn across(&self, field: &[T], n: usize) -> [T; 3] {
        let part = |k: usize| scaled(at(field, n, self.particles[k]), self.weights[k]);
        add(add(part(0), part(1)), add(part(2), part(3)))
    }

    /// Returns the relative displacement that accelerations lead to.
    fn reached(&self, a: &[T], n: usize) -> [T; 3] {
        let mut y = self.base;
        for k in (0..4).filter(|&k| self.response[k] != T::zero()) {
            y = add(y, scaled(at(a, n, self.particles[k]), self.weights[k]));
        }
        y
    }
}

impl<T: Real> Layers<T> {
    /// Finds the pairs that come nearer to each other than the thickness and a quarter of an edge if all particles go
    /// on with their velocities.
    ///
    /// A pair is looked at where it first comes nearer than half its thickness on that way, else where the way ends: seen
    /// from there the direction between its nearest points is the plane's normal. Up to there the parts have not passed
    /// through each other, however fast they are. Their layers may have, nearby: then they meet from the wrong side, and would
    /// hold together what other pairs part. So a pair that begins behind its plane is left out.
    pub fn find(start: &Approach<'_, T>, settings: SelfContact) -> Self {
        Search::new(start, settings, None).run(vec![true; start.grid.particles()])
    }

    /// Finds the pairs that come nearer to each other than half the thickness on the way on which the accelerations `a`
    /// [3, H, W] have led, among those that [`Layers::find`] may have missed.
    ///
    /// It has seen all pairs that come within `r`, the thickness and the margin. So two particles that have both left the
    /// way on which it looked by less than `0.85 r / 2` have not met anything else: that is the budget of a particle.
    pub fn find_missed(start: &Approach<'_, T>, settings: SelfContact, a: &[T]) -> Self {
        let n = start.grid.particles();
        let search = Search::new(start, settings, Some(a));
        let budget = SelfContact::BUDGET * 0.5 * (settings.thickness + SelfContact::MARGIN);
        let mean = (0..n).map(|p| search.way[p] - search.base[p]).sum::<DVec3>() / n as f64;
        let has_left = |p: usize| (search.way[p] - search.base[p] - mean).length() > budget;
        let of_patch: Vec<bool> = (0..n).map(|p| corners(start.grid, p).any(has_left)).collect();
        search.run(of_patch)
    }

    /// Iterates over the pairs: the particles of [`Parts::particles`], and the weights with which their displacements make the
    /// relative one.
    pub fn pairs(&self) -> impl Iterator<Item = ([usize; 4], [T; 4])> {
        self.pairs.iter().map(|pair| (pair.particles, pair.weights))
    }

    /// Moves the particles by `shift` [3, H, W]: what follows is there.
    pub fn move_to(&mut self, shift: &[T]) {
        let n = shift.len() / 3;
        let Self { pairs, active, .. } = self;
        let moved = |(k, pair): (usize, &Pair<T>)| {
            let y = pair.across(shift, n);
            pair.touch.acts(y).then_some((k, y))
        };
        match pairs.len() < ALONE {
            true => {
                active.clear();
                active.extend(pairs.iter().enumerate().filter_map(moved));
            }
            false => *active = pairs.par_iter().enumerate().filter_map(moved).collect(),
        }
    }

    /// Iterates over the pairs that press or rub, with how far their parts have moved relative to each other.
    fn active(&self) -> impl Iterator<Item = (&Pair<T>, [T; 3])> {
        self.active.iter().map(|&(k, y)| (&self.pairs[k], y))
    }

    /// Subtracts their gradient from the accelerations [3, H, W], as
    /// [`Contacts::add_accelerations`](super::Contacts::add_accelerations) does.
    pub fn add_accelerations(&self, accelerations: &mut [T]) {
        let n = accelerations.len() / 3;
        for (pair, y) in self.active() {
            let gradient = pair.touch.gradient(y);
            for (p, response) in pair.particles.into_iter().zip(pair.response) {
                (0..3).for_each(|c| {
                    accelerations[c * n + p] = accelerations[c * n + p] - response * gradient[c];
                });
            }
        }
    }

    /// Returns what the pairs of each of `n` particles resist to it.
    pub fn resistances(&self, n: usize) -> Vec<T> {
        let mut resistances = vec![T::zero(); n];
        for (pair, y) in self.active() {
            let resistance = pair.touch.resistance(y);
            for (p, weight) in pair.particles.into_iter().zip(pair.weights) {
                resistances[p] = resistances[p] + weight * weight * resistance;
            }
        }
        resistances
    }

    /// Returns their energy.
    pub fn energy(&self) -> f64 {
        self.active().map(|(pair, y)| pair.touch.energy(y).f64()).sum()
    }

    /// Adds their second derivatives along each pair of `directions` [K, 3, H, W], of this length each.
    pub fn add_curvature(
        &self,
        directions: &[T],
        len: usize,
        curvature: &mut [[f64; MAX_DIRECTIONS]; MAX_DIRECTIONS],
    ) {
        let (n, count) = (len / 3, directions.len() / len);
        for (pair, y) in self.active() {
            let curved = pair.touch.curved(y);
            let mut along = [[T::zero(); 3]; MAX_DIRECTIONS];
            for (along, direction) in along.iter_mut().zip(directions.chunks_exact(len)) {
                *along = pair.across(direction, n);
            }
            for (i, sums) in curvature.iter_mut().enumerate().take(count) {
                let product = curved.times(along[i]);
                for (sum, along) in sums.iter_mut().zip(&along).take(count) {
                    *sum += dot(product, *along).f64();
                }
            }
        }
    }

    /// Moves parts away from each other that the accelerations `a` [3, H, W] lead nearer together than
    /// [`Contact::LEAST_GAP`] of the thickness, by adding to `a`. Returns whether there are any.
    ///
    /// In each pass every such pair asks for what would part it, and a particle moves by the mean of what its pairs ask for.
    pub fn part(&self, passes: usize, a: &mut [T]) -> bool {
        let n = a.len() / 3;
        for pass in 0..passes {
            let ways = self.pairs.iter().filter_map(|pair| {
                pair.touch.way_out(self.thickness, pair.reached(a, n)).map(|out| (pair, out))
            });
            let ways: Vec<_> = ways.collect();
            if ways.is_empty() {
                return pass > 0;
            }
            move_by_means(ways, a);
        }
        passes > 0
    }

    /// Takes back the slip of parts that press on each other and stick where the accelerations `a` [3, H, W] lead, by adding to
    /// `a`: each such pair asks for that, as in a pass of [`Layers::part`].
    pub fn hold(&self, a: &mut [T]) {
        let n = a.len() / 3;
        let backs = self
            .pairs
            .iter()
            .filter_map(|pair| pair.touch.slip_back(pair.reached(a, n)).map(|back| (pair, back)));
        let backs: Vec<_> = backs.collect();
        if !backs.is_empty() {
            move_by_means(backs, a);
        }
    }

    /// Returns what they do at the displacements `shift` [3, H, W].
    pub fn stats(&self, shift: &[T]) -> LayerStats {
        let n = shift.len() / 3;
        let pairs = self.pairs.len();
        let overflow = self.overflow.then_some(SelfContact::MOST_PAIRS);
        let mut stats = LayerStats { pairs, overflow, ..LayerStats::default() };
        for pair in &self.pairs {
            let gap = pair.touch.gap(self.thickness, pair.across(shift, n));
            stats.touching += usize::from(gap < self.thickness);
            stats.nearest = stats.nearest.min(gap);
        }
        stats
    }
}

impl Layers<f64> {
    /// Returns their second derivatives at the displacements `shift` [3, H, W].
    pub fn couplings(&self, shift: &[f64]) -> Vec<Coupling> {
        let n = shift.len() / 3;
        let coupling = |pair: &Pair<f64>| {
            let block: Block = pair.touch.curved(pair.across(shift, n)).block();
            Coupling { particles: pair.particles, weights: pair.weights, block }
        };
        self.pairs.iter().map(coupling).collect()
    }
}

/// The search for the pairs of a frame.
struct Search<'a, T> {
    start: &'a Approach<'a, T>,
    settings: SelfContact,
    elastic: Elastic,
    /// Places at the start of the frame \[edges\].
    x: Vec<DVec3>,
    /// Displacements by the velocities, and of the handles \[edges\].
    base: Vec<DVec3>,
    /// The way that each particle takes in the frame as far as it is known \[edges\].
    way: Vec<DVec3>,
    /// One for each particle, where most are looked at.
    patches: Option<Vec<Patch>>,
    tiles: FlatTiles,
    /// Distance within which pairs are contacts.
    range: f64,
}

/// A particle with its triangles and edges towards the larger numbers: the parts that lie in the cell behind it. Balls around
/// them answer for most that they are far from others; of parts that do not exist they are nowhere.
#[derive(Clone, Copy, Debug)]
struct Patch {
    all: Ball,
    particle: Ball,
    faces: [Ball; 2],
    edges: [Ball; 3],
    /// Half of each edge.
    halves: [DVec3; 3],
}

/// A ball that moves evenly in the frame.
#[derive(Clone, Copy, Debug)]
struct Ball {
    centre: DVec3,
    /// How it moves.
    way: DVec3,
    /// Radius at the start.
    radius: f64,
    /// How much of their way the points inside may go off that of the ball.
    spread: f64,
}

impl Ball {
    const NOWHERE: Self = Self { centre: DVec3::ZERO, way: DVec3::ZERO, radius: f64::NAN, spread: 0.0 };

    /// Returns one around points that move evenly.
    fn around(points: &[(DVec3, DVec3)]) -> Self {
        let count = points.len() as f64;
        let centre = points.iter().map(|(x, _)| *x).sum::<DVec3>() / count;
        let way = points.iter().map(|(_, way)| *way).sum::<DVec3>() / count;
        let largest = |lengths: &mut dyn Iterator<Item = DVec3>| {
            lengths.map(DVec3::length_squared).fold(0.0, f64::max).sqrt()
        };
        let radius = largest(&mut points.iter().map(|(x, _)| *x - centre));
        let spread = largest(&mut points.iter().map(|(_, of)| *of - way));
        Self { centre, way, radius, spread }
    }

    /// Whether two balls come as near to each other as this.
    fn meets(&self, other: &Self, range: f64) -> bool {
        let (from, way) = (other.centre - self.centre, other.way - self.way);
        let (square, ahead) = (way.length_squared(), -from.dot(way));
        let share = if ahead <= 0.0 {
            0.0
        } else if ahead >= square {
            1.0
        } else {
            ahead / square
        };
        let reach = self.radius + self.spread + other.radius + other.spread + range;
        (from + share * way).length_squared() < reach * reach
    }
}

/// Where a pair of parts meets on its way.
#[derive(Clone, Copy, Debug)]
struct Met {
    nearest: Nearest,
    /// The distance at the start.
    before: f64,
}

impl<'a, T: Real> Search<'a, T> {
    /// Prepares the search on the way by the velocities, or by these accelerations, too.
    fn new(start: &'a Approach<'a, T>, settings: SelfContact, a: Option<&[T]>) -> Self {
        let (grid, n) = (start.grid, start.grid.particles());
        let wide = |field: [T; 3]| DVec3::from(field.map(|c| c.f64()));
        let x: Vec<DVec3> = (0..n).map(|p| wide(at(start.x, n, p))).collect();
        let mut base: Vec<DVec3> = (0..n)
            .map(|p| match start.marks[p].role() {
                Role::Free => wide(at(start.v, n, p)),
                Role::Handle(k) => wide(start.handles[k]) - x[p],
                Role::Outside => DVec3::ZERO,
            })
            .collect();
        let mut way: Vec<DVec3> = match a {
            None => base.clone(),
            Some(a) => (0..n)
                .map(|p| if start.marks[p].is_free() { base[p] + wide(at(a, n, p)) } else { base[p] })
                .collect(),
        };
        // Relative to the mean motion, they move least.
        let mean = way.iter().sum::<DVec3>() / n as f64;
        way.iter_mut().for_each(|way| *way -= mean);
        base.iter_mut().for_each(|base| *base -= mean);
        let range = match a {
            None => settings.thickness + SelfContact::MARGIN,
            Some(_) => SelfContact::NEAR * settings.thickness,
        };
        let elastic = Elastic::new(grid, start.cloth.material, start.cloth.damping);
        let tiles = FlatTiles::new(grid, &x, &way, range);
        let search = Self { start, settings, elastic, x, base, way, patches: None, tiles, range };
        let patches = a.is_none().then(|| (0..n).into_par_iter().map(|p| search.patch(p)).collect());
        Self { patches, ..search }
    }

    /// Finds the pairs of which at least one part lies in a patch that is `wanted`.
    fn run(self, wanted: Vec<bool>) -> Layers<T> {
        let thickness = self.settings.thickness;
        let none = |overflow| Layers { pairs: Vec::new(), active: Vec::new(), thickness, overflow };
        if !wanted.contains(&true) {
            return none(false);
        }
        let particles = self.start.grid.particles();
        let boxes = (0..particles).into_par_iter().map(|p| self.bounds(p)).collect();
        let most = SelfContact::MOST_PAIRS * particles;
        let show = |found: &mut Vec<_>, [p, q]: [usize; 2]| {
            let [p, q] = [p.min(q), p.max(q)];
            match &self.patches {
                Some(patches) => self.between([p, q], [&patches[p], &patches[q]], found),
                None => self.between([p, q], [&self.patch(p), &self.patch(q)], found),
            }
            found.len() <= most
        };
        let tasks = PatchTree::new(self.start.grid, boxes, wanted).visit(&self.tiles, Vec::new, show);
        if tasks.iter().map(Vec::len).sum::<usize>() > most {
            return none(true);
        }
        let mut parts: Vec<_> = tasks.into_iter().flatten().collect();
        // An order that depends on nothing but the parts.
        parts.par_sort_unstable_by_key(|(parts, _)| *parts);
        let pairs = parts.into_par_iter().filter_map(|(parts, met)| self.pair(parts, met)).collect();
        Layers { pairs, ..none(false) }
    }

    /// Returns the patch of a particle.
    fn patch(&self, p: usize) -> Patch {
        let grid = self.start.grid;
        let ball = |particles: &[usize]| {
            let mut points = [(DVec3::ZERO, DVec3::ZERO); 4];
            points.iter_mut().zip(particles).for_each(|(point, &q)| *point = (self.x[q], self.way[q]));
            Ball::around(&points[..particles.len()])
        };
        let own = !self.start.marks[p].is_outside();
        let (below, right) = (p / grid.w + 1 < grid.h, p % grid.w + 1 < grid.w);
        let [q, r, s] = [p + 1, p + grid.w, p + grid.w + 1];
        let exists = |is_there: bool, q: usize| own && is_there && !self.start.marks[q].is_outside();
        let (below, right, opposite) = (exists(below, r), exists(right, q), exists(below && right, s));
        let whole = below && right && opposite;
        let has = |has: bool, particles: &[usize]| if has { ball(particles) } else { Ball::NOWHERE };
        Patch {
            all: match (below, right) {
                _ if whole => ball(&[p, q, r, s]),
                (true, true) => ball(&[p, q, r]),
                (true, false) => ball(&[p, r]),
                (false, true) => ball(&[p, q]),
                (false, false) => has(own, &[p]),
            },
            particle: has(own, &[p]),
            faces: [has(whole, &[p, r, s]), has(whole, &[p, s, q])],
            edges: [has(right, &[p, q]), has(below, &[p, r]), has(whole, &[p, s])],
            halves: [(right, q), (below, r), (whole, s)]
                .map(|(has, q)| if has { 0.5 * (self.x[q] - self.x[p]) } else { DVec3::ZERO }),
        }
    }

    /// Returns the box around a patch on its way, and half the range around that.
    fn bounds(&self, p: usize) -> Bounds {
        let (grid, marks) = (self.start.grid, &self.start.marks);
        if marks[p].is_outside() {
            return Bounds::NONE;
        }
        let ends = corners(grid, p)
            .filter(|&q| !marks[q].is_outside())
            .map(|q| Bounds::around(&[self.x[q], self.x[q] + self.way[q]]));
        let all = ends.fold(Bounds::NONE, |all, of_corner| all.with(&of_corner));
        let margin = DVec3::splat(0.5 * self.range);
        let is_somewhere = all.low.is_finite() && all.high.is_finite();
        if is_somewhere { Bounds { low: all.low - margin, high: all.high + margin } } else { Bounds::NONE }
    }

    /// Appends the pairs of a patch with another one that are near.
    fn between(&self, [p, q]: [usize; 2], [one, other]: [&Patch; 2], found: &mut Vec<(Parts, Met)>) {
        if !one.all.meets(&other.all, self.range) {
            return;
        }
        let grid = self.start.grid;
        let mut look = |parts: Option<Parts>| {
            found.extend(parts.and_then(|parts| Some((parts, self.meet(parts)?))));
        };
        for (particle, own, face, others) in [(p, one, q, other), (q, other, p, one)] {
            for (k, ball) in others.faces.iter().enumerate() {
                if own.particle.meets(ball, self.range) {
                    look(Parts::vertex(grid, particle, grid.first_face(face) + k));
                }
            }
        }
        let ends = [1, grid.w, grid.w + 1];
        for (k, l) in (0..9).map(|both| (both / 3, both % 3)) {
            let (first, second) = (&one.edges[k], &other.edges[l]);
            // Seen along the line between their middles, edges side by side are thin.
            let from = second.centre - first.centre;
            let extent = one.halves[k].dot(from).abs() + other.halves[l].dot(from).abs();
            let reach = self.range + (second.way - first.way).length() + first.spread + second.spread;
            let square = from.length_squared();
            if square - extent <= reach * square.sqrt() && first.meets(second, self.range) {
                look(Parts::edges([p, p + ends[k]], [q, q + ends[l]]));
            }
        }
    }

    /// Returns where two parts meet, unless they stay out of range.
    fn meet(&self, parts: Parts) -> Option<Met> {
        let grid = self.start.grid;
        let particles = parts.particles(grid);
        let [x, way] = [&self.x, &self.way].map(|field| particles.map(|p| field[p]));
        let split = if matches!(parts, Parts::Vertex(..)) { 1 } else { 2 };
        let relative = |one: DVec3| way[split..].iter().map(move |other| (one - *other).length_squared());
        let fastest = way[..split].iter().flat_map(|one| relative(*one)).fold(0.0, f64::max).sqrt();
        let before = parts.distance(&x);
        // What is left at least.
        if before - fastest >= self.range {
            return None;
        }
        let near = SelfContact::NEAR * self.settings.thickness;
        let mut share = 0.0;
        let mut left = before;
        if fastest > 0.0 {
            for _ in 0..Contact::STEPS {
                if left <= near || share >= 1.0 {
                    break;
                }
                let step = (left - 0.5 * near) / fastest;
                share = f64::min(share + step.max(Contact::LEAST_ADVANCE), 1.0);
                left = parts.distance(&[0, 1, 2, 3].map(|k| x[k] + share * way[k]));
            }
        }
        if left >= self.range {
            return None;
        }
        let has = |p: usize| !self.start.marks[p].is_outside();
        let nearest = parts.nearest((grid, has), |p| self.x[p] + share * self.way[p])?;
        Some(Met { nearest, before })
    }

    /// Returns the pair of two parts that meet; `None` between handles, and where they begin behind its plane.
    fn pair(&self, parts: Parts, Met { nearest, before }: Met) -> Option<Pair<T>> {
        let (grid, h) = (self.start.grid, self.settings.thickness);
        let (particles, weights, n) = (parts.particles(grid), nearest.weights, grid.particles());
        let across = |field: &[DVec3]| -> DVec3 {
            particles.into_iter().zip(weights).map(|(p, weight)| weight * field[p]).sum()
        };
        let normal = nearest.separation.try_normalize().unwrap_or(DVec3::Z);
        let [at_start, way] = [&self.x, &self.way].map(|field| across(field));
        let predicted = normal.dot(at_start + way);
        let mut response = [0.0; 4];
        let (mut per_mass, mut elastic) = (0.0, 0.0);
        for (k, (p, weight)) in particles.into_iter().zip(weights).enumerate() {
            if self.start.marks[p].is_free() {
                response[k] = weight * n as f64 / self.start.marks[p].mass();
                per_mass += weight * response[k];
                elastic += weight * weight * self.start.elastic_along(p, normal, self.elastic);
            }
        }
        let begins = normal.dot(at_start);
        if per_mass <= 0.0 || begins < -Contact::LEAST_GAP * h {
            return None;
        }
        let mass = per_mass.recip();
        let stiffness = Contact::stiffness(elastic, mass, before.min(predicted), h);
        let pressed = Contact::load_at(Contact::stiffness(elastic, mass, before, h), before, h);
        let stopped = mass * (h - predicted).max(0.0);
        let contact = Contact {
            friction: self.settings.friction * pressed.max(stopped),
            ..Contact::new(normal, begins, stiffness, h)
        };
        let single = |v: [f64; 4]| v.map(T::of);
        Some(Pair {
            particles,
            weights: single(weights),
            response: single(response),
            base: across(&self.base).to_array().map(T::of),
            touch: Touch::new(contact),
        })
    }
}

/// Adds to the accelerations `a` [3, H, W] what pairs ask their parts to move by relative to each other: a particle moves by the
/// mean of what its pairs ask for.
fn move_by_means<T: Real>(ways: Vec<(&Pair<T>, [T; 3])>, a: &mut [T]) {
    let n = a.len() / 3;
    let mut asked = vec![([T::zero(); 3], T::zero()); n];
    for (pair, way) in ways {
        let weighted = (0..4).map(|k| pair.weights[k] * pair.response[k]);
        let share = weighted.fold(T::zero(), |sum, k| sum + k).recip();
        for (p, response) in pair.particles.into_iter().zip(pair.response) {
            if response != T::zero() {
                let (sum, count) = &mut asked[p];
                *sum = add(*sum, scaled(way, response * share));
                *count = *count + T::one();
            }
        }
    }
    for (p, (sum, count)) in asked.into_iter().enumerate().filter(|(_, (_, count))| *count > T::zero()) {
        for (c, way) in scaled(sum, count.recip()).into_iter().enumerate() {
            a[c * n + p] = a[c * n + p] + way;
        }
    }
}

/// Returns the particles of the cell behind a particle, as far as there are any.
fn corners(grid: Grid, p: usize) -> impl Iterator<Item = usize> + Clone {
    let (is_last_row, is_last_column) = (p / grid.w + 1 == grid.h, p % grid.w + 1 == grid.w);
    let has = [true, !is_last_column, !is_last_row, !is_last_row && !is_last_column];
    [p, p + 1, p + grid.w, p + grid.w + 1].into_iter().zip(has).filter_map(|(q, has)| has.then_some(q))
}
