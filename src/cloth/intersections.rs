//! Where a cloth has passed through itself: which edges of its triangulated grid run through which of its triangles.
//!
//! A tree of boxes around the triangles proposes pairs, and the signs of exact volumes decide about each. Nothing
//! depends on rounding, on the order of the work, or on the number of threads.

use glam::DVec3;
use rayon::prelude::*;
use robust::{Coord3D, orient3d};

/// Largest coordinate that takes part. The volumes of such places do not overflow.
const FARTHEST: f64 = 1e90;
/// The most faces of a node of the tree that is not divided further.
const LEAF: usize = 4;

/// An edge that passes through a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Intersection {
    /// The particles at the ends of the edge, the lower number first.
    pub edge: [u32; 2],
    /// The triangle, as its index into those of the cloth.
    pub face: u32,
}

/// Returns all edges of a cloth's triangles ([`Cloth::faces`](super::Cloth::faces)) that pass through one with which they
/// share no particle, in ascending order (edge, then face). `x` are the places of the particles, shape \[3, H, W\].
///
/// An edge passes through a triangle if its ends lie on different sides of the triangle's plane and its line runs
/// through the triangle's inside. Touching does not count: not an end in the plane, not an edge that meets the
/// triangle's border or a corner, and nothing that lies in one plane or has no area.
///
/// A cloth takes little more than linear time. Places without order, as after an explosion, have a fixed part of all
/// pairs of edges and triangles as their answer: at random 1 in 11, which are 10^8 for 128 x 128 particles.
///
/// The answer is exact as long as coordinates other than 0 are 1e-90 or more in magnitude, as all f32 numbers are.
/// Edges and triangles with a coordinate that is not a number or beyond 1e90 take no part.
pub fn intersections(triangles: &[[u32; 3]], x: &[f64]) -> Vec<Intersection> {
    let particles = x.len() / 3;
    let place = |p: usize| {
        let place = DVec3::new(x[p], x[particles + p], x[2 * particles + p]);
        // A comparison, unlike a maximum, sees what is not a number.
        place.abs().cmple(DVec3::splat(FARTHEST)).all().then_some(place)
    };
    let places: Vec<Option<DVec3>> = (0..particles).map(place).collect();

    let mut faces: Vec<Face> = (0..).zip(triangles).filter_map(|(i, v)| Face::new(i, *v, &places)).collect();
    let tree = Tree::new(&mut faces);

    let mut edges: Vec<[u32; 2]> =
        triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*a, *c]].map(ascending)).collect();
    edges.par_sort_unstable();
    edges.dedup();

    let through = |edge: &[u32; 2]| {
        let mut met = Vec::new();
        if let [Some(p), Some(q)] = edge.map(|vertex| places[vertex as usize]) {
            tree.visit(&Bounds::around(&[p, q]), &mut |face| {
                // One volume of those that share a particle is 0 anyway; this is faster.
                let apart = !face.vertices.iter().any(|vertex| edge.contains(vertex));
                if apart && passes(p, q, face.corners) {
                    met.push(Intersection { edge: *edge, face: face.index });
                }
            });
        }
        met.sort_unstable();
        met
    };
    // The results keep the order of the edges.
    edges.par_iter().flat_map_iter(through).collect()
}

/// Returns an edge with the lower number first.
fn ascending([p, q]: [u32; 2]) -> [u32; 2] {
    [p.min(q), p.max(q)]
}

/// Whether the edge from `p` to `q` passes through a triangle.
fn passes(p: DVec3, q: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    // The product of two small volumes could be 0, their signs cannot mislead.
    let opposite = |v: f64, w: f64| (v > 0.0 && w < 0.0) || (v < 0.0 && w > 0.0);
    if !opposite(volume(a, b, c, p), volume(a, b, c, q)) {
        return false;
    }
    // The line runs inside if it turns about all three sides in the same direction.
    let about = volume(p, q, a, b);
    opposite(about, volume(p, q, c, b)) && opposite(about, volume(p, q, a, c))
}

/// Returns the volume of a tetrahedron, six times and rounded, with its exact sign.
fn volume(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p.x, y: p.y, z: p.z });
    orient3d(a, b, c, d)
}

/// A box along the axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub low: DVec3,
    pub high: DVec3,
}

impl Bounds {
    /// The box around nothing, which meets no other.
    pub const NONE: Self = Self { low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };

    /// Returns the box around some places.
    pub fn around(places: &[DVec3]) -> Self {
        places.iter().fold(Self::NONE, |all, place| all.with(&Self { low: *place, high: *place }))
    }

    /// Returns the box around two boxes.
    pub fn with(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Whether what fills two boxes may cross. It may not if they only touch: where an edge passes through a triangle
    /// is in the middle of both, hence along each axis truly between the ends of each, or of one that is flat there.
    pub fn meets(&self, other: &Self) -> bool {
        (self.low.cmplt(other.high) & other.low.cmplt(self.high)).all()
    }
}

/// A triangle of the grid.
struct Face {
    index: u32,
    vertices: [u32; 3],
    corners: [DVec3; 3],
    bounds: Bounds,
}

impl Face {
    /// Returns a triangle, or nothing if one of its corners takes no part.
    fn new(index: u32, vertices: [u32; 3], places: &[Option<DVec3>]) -> Option<Self> {
        let [a, b, c] = vertices.map(|vertex| places[vertex as usize]);
        let corners = [a?, b?, c?];
        Some(Self { index, vertices, corners, bounds: Bounds::around(&corners) })
    }
}

/// A tree of boxes around faces.
struct Tree<'a> {
    bounds: Bounds,
    /// The faces of a leaf.
    faces: &'a [Face],
    /// What other nodes are made of.
    halves: Option<Box<[Self; 2]>>,
}

impl<'a> Tree<'a> {
    /// Divides the faces in halves of equal number, by their middles along the axis where these spread most. However
    /// faces are scattered, the tree is no deeper than the logarithm of their number.
    fn new(faces: &'a mut [Face]) -> Self {
        let bounds = faces.iter().fold(Bounds::NONE, |all, face| all.with(&face.bounds));
        if faces.len() <= LEAF {
            return Self { bounds, faces, halves: None };
        }
        // Twice the middle.
        let middle = |face: &Face| face.bounds.low + face.bounds.high;
        let low = faces.iter().map(middle).fold(DVec3::INFINITY, DVec3::min);
        let high = faces.iter().map(middle).fold(DVec3::NEG_INFINITY, DVec3::max);
        let axis = (high - low).max_position();
        let half = faces.len() / 2;
        faces.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
        let (left, right) = faces.split_at_mut(half);
        let (left, right) = rayon::join(|| Self::new(left), || Self::new(right));
        Self { bounds, faces: &[], halves: Some(Box::new([left, right])) }
    }

    /// Shows all faces whose boxes meet a box.
    fn visit(&self, bounds: &Bounds, show: &mut impl FnMut(&Face)) {
        if !self.bounds.meets(bounds) {
            return;
        }
        self.faces.iter().filter(|face| face.bounds.meets(bounds)).for_each(&mut *show);
        self.halves.iter().flat_map(|halves| halves.iter()).for_each(|half| half.visit(bounds, show));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::Grid;
    use std::collections::BTreeSet;

    /// Compares all edges with all triangles by a predicate on `p, q, a, b, c`.
    fn brute(grid: Grid, passes: impl Fn([usize; 5]) -> bool) -> Vec<Intersection> {
        let faces = grid.faces();
        let sides = faces.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
        let edges: BTreeSet<[u32; 2]> = sides.map(ascending).collect();
        let mut found = Vec::new();
        for edge in edges {
            for (face, [a, b, c]) in (0..).zip(&faces) {
                let five = [edge[0], edge[1], *a, *b, *c];
                let different = BTreeSet::from(five).len() == 5;
                if different && passes(five.map(|p| p as usize)) {
                    found.push(Intersection { edge, face });
                }
            }
        }
        found
    }

    /// The same predicate on all pairs, without boxes.
    fn all_pairs(grid: Grid, x: &[f64]) -> Vec<Intersection> {
        let n = grid.particles();
        brute(grid, |five| {
            let [p, q, a, b, c] = five.map(|p| DVec3::new(x[p], x[n + p], x[2 * n + p]));
            let takes_part = |p: DVec3| p.is_finite() && p.abs().max_element() <= FARTHEST;
            [p, q, a, b, c].into_iter().all(takes_part) && super::passes(p, q, [a, b, c])
        })
    }

    /// Returns places [3, H, W] from a function of (i, j).
    fn sheet(grid: Grid, place: impl Fn(f64, f64) -> [f64; 3]) -> Vec<f64> {
        let at = |p: usize| place((p / grid.w) as f64, (p % grid.w) as f64);
        (0..3)
            .flat_map(|axis| (0..grid.particles()).map(move |p| (axis, p)))
            .map(|(axis, p)| at(p)[axis])
            .collect()
    }

    /// Returns whole numbers below `bound`, the same for a seed.
    fn noise(seed: u64, n: usize, bound: u64) -> Vec<i64> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) % bound) as i64
        };
        (0..n).map(|_| next()).collect()
    }

    /// Returns a cloud in the cube from -1 to 1, in steps of 2^-20.
    fn cloud(seed: u64, grid: Grid) -> Vec<f64> {
        noise(seed, 3 * grid.particles(), 2 << 20)
            .iter()
            .map(|k| *k as f64 / f64::from(1 << 20) - 1.0)
            .collect()
    }

    /// A sheet rolled along i, whose layers cross because the roll also sways.
    fn crossing_roll(grid: Grid) -> Vec<f64> {
        sheet(grid, |i, j| {
            let angle = 0.37 * i;
            let radius = 3.0 + 0.9 * (0.81 * i).sin();
            [radius * angle.cos(), j + 0.21 * angle.sin(), radius * angle.sin() + 0.1 * (0.8 * j).cos()]
        })
    }

    /// Two layers one above the other, 8 x 8 in all: the rows i < 4 at z = 0 and, folded back, the others at z = 1. The
    /// particle (5, 3) of the upper layer, with six edges, is pulled down to `z`, above the middle of a lower triangle
    /// and below it where `z` is negative.
    fn pulled_through(z: f64) -> (Grid, Vec<f64>) {
        let grid = Grid { h: 8, w: 8 };
        let x = sheet(grid, |i, j| match (i as usize, j as usize) {
            (5, 3) => [3.25, 1.75, z],
            (0..=3, _) => [j, i, 0.0],
            _ => [j + 0.25, 6.75 - i, 1.0],
        });
        (grid, x)
    }

    #[test]
    fn sheets_without_crossings_have_none() {
        let grid = Grid { h: 24, w: 17 };
        let flat = sheet(grid, |i, j| [j, i, 0.0]);
        let turned = sheet(grid, |i, j| [0.6 * j - 0.3 * i, 0.7 * i + 0.1 * j, 0.2 * i - 0.9 * j]);
        let wavy = sheet(grid, |i, j| [j, i, (0.7 * i).sin() + (0.5 * j).cos()]);
        let rolled = sheet(grid, |i, j| {
            let radius = 2.0 + 0.2 * i;
            [radius * (0.4 * i).cos(), j, radius * (0.4 * i).sin()]
        });
        for x in [flat, turned, wavy, rolled] {
            assert_eq!(intersections(&grid.faces(), &x), []);
        }
    }

    #[test]
    fn the_edges_of_a_particle_pulled_through_a_triangle_pass_it() {
        let (grid, x) = pulled_through(-0.0625);
        let found = intersections(&grid.faces(), &x);
        // The triangle left of the diagonal, as seen with i upwards, of the cell (1, 3).
        let face = 2 * (7 + 3);
        assert_eq!(grid.faces()[face as usize], [11, 19, 20]);
        let edges = [[34, 43], [35, 43], [42, 43], [43, 44], [43, 51], [43, 52]];
        assert_eq!(found, edges.map(|edge| Intersection { edge, face }));
    }

    #[test]
    fn an_edge_that_ends_on_a_triangle_does_not_count() {
        for (z, count) in [(0.0, 0), (1e-70, 0), (-1e-70, 6)] {
            let (grid, x) = pulled_through(z);
            assert_eq!(intersections(&grid.faces(), &x).len(), count, "{z}");
        }
    }

    #[test]
    fn a_sheet_through_itself_has_what_all_pairs_have() {
        for (h, w) in [(34, 6), (40, 11)] {
            let grid = Grid { h, w };
            let x = crossing_roll(grid);
            let found = intersections(&grid.faces(), &x);
            assert!(found.len() > 50, "{}", found.len());
            assert_eq!(found, all_pairs(grid, &x));
            assert_eq!(found, intersections(&grid.faces(), &x));
        }
    }

    #[test]
    fn clouds_have_what_all_pairs_have() {
        for (seed, (h, w)) in (0..).zip([(8, 8), (9, 12), (12, 12), (10, 8), (2, 9), (12, 11)]) {
            let grid = Grid { h, w };
            let x = cloud(seed, grid);
            let found = intersections(&grid.faces(), &x);
            assert!(h == 2 || found.len() > 500, "{}", found.len());
            assert_eq!(found, all_pairs(grid, &x));
            assert_eq!(found, intersections(&grid.faces(), &x));
        }
    }

    /// On a few whole numbers most pairs touch, lie in one plane, or have no area, and integers are exact.
    #[test]
    fn degenerate_clouds_have_what_integers_say() {
        for (seed, bound) in (0..).zip([1, 2, 3, 4, 5, 7, 9, 13]) {
            let grid = Grid { h: 9, w: 10 };
            let n = grid.particles();
            let k = noise(seed, 3 * n, bound);
            let integers = brute(grid, |five| {
                let [p, q, a, b, c] = five.map(|p| [k[p], k[n + p], k[2 * n + p]]);
                let side = |a: [i64; 3], b: [i64; 3], c: [i64; 3], d: [i64; 3]| {
                    let [u, v, w] = [a, b, c].map(|e| [0, 1, 2].map(|axis| e[axis] - d[axis]));
                    let minor = |s: usize, t: usize| v[s] * w[t] - v[t] * w[s];
                    (u[0] * minor(1, 2) + u[1] * minor(2, 0) + u[2] * minor(0, 1)).signum()
                };
                let about = [side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)];
                side(a, b, c, p) * side(a, b, c, q) == -1 && about.iter().sum::<i64>().abs() == 3
            });
            let x: Vec<f64> = k.iter().map(|k| *k as f64 / 8.0 - 0.5).collect();
            assert_eq!(intersections(&grid.faces(), &x), integers, "{bound}");
            assert_eq!(integers.is_empty(), bound == 1, "{bound}");
        }
    }

    #[test]
    fn size_and_place_do_not_matter() {
        let grid = Grid { h: 11, w: 9 };
        let x = cloud(7, grid);
        let found = intersections(&grid.faces(), &x);
        for k in [-140, -20, 3, 100, 290] {
            let scaled: Vec<f64> = x.iter().map(|x| x * 2f64.powi(k)).collect();
            assert_eq!(intersections(&grid.faces(), &scaled), found, "{k}");
        }
        for offset in [-1.0, 4096.0, 2f64.powi(31)] {
            let moved: Vec<f64> = x.iter().map(|x| x + offset).collect();
            assert!(moved.iter().zip(&x).all(|(moved, x)| moved - offset == *x));
            assert_eq!(intersections(&grid.faces(), &moved), found, "{offset}");
        }
    }

    #[test]
    fn any_numbers_will_do() {
        let grid = Grid { h: 12, w: 10 };
        let odd = [f64::NAN, f64::INFINITY, -f64::INFINITY, f64::MAX, -1e91, 1e90, 1e30, -1e30, -0.0, 5e-324];
        for seed in 0..odd.len() as u64 {
            let mut x = cloud(seed, grid);
            let n = x.len();
            for (at, odd) in noise(seed, 20, n as u64).into_iter().zip(odd.iter().cycle()) {
                x[at as usize] = *odd;
            }
            assert_eq!(intersections(&grid.faces(), &x), all_pairs(grid, &x));
            assert_eq!(intersections(&grid.faces(), &vec![odd[seed as usize]; n]), []);
        }
        let far: Vec<f64> = cloud(3, grid).iter().map(|x| x * 1e30).collect();
        assert_eq!(intersections(&grid.faces(), &far), all_pairs(grid, &far));
        for (h, w) in [(0, 0), (1, 1), (1, 9), (9, 1), (2, 2)] {
            let grid = Grid { h, w };
            assert_eq!(intersections(&grid.faces(), &cloud(5, grid)), []);
        }
    }

    #[test]
    fn the_number_of_threads_does_not_matter() {
        let grid = Grid { h: 40, w: 12 };
        let x = crossing_roll(grid);
        let found = intersections(&grid.faces(), &x);
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| intersections(&grid.faces(), &x)), found);
        }
    }
}
