//! The signed distance of a closed triangle mesh as a regular grid of samples.
//!
//! It is built once, in units of a cell: the mesh is checked, lines through the nodes tell which nodes are inside, and
//! exact distances near the surface are carried outwards from node to node. After that only the samples matter, and
//! they are f32 numbers, so that a CPU and a GPU see the same body.

use super::Distance;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::fmt;

/// Largest coordinate of a mesh, and the inverse of its smallest size: well within single precision.
const FARTHEST: f64 = 1e30;
/// How far the lines that count crossings run beside the nodes \[cells\]. Nodes often lie in a mesh's own planes and
/// edges; the lines then meet neither.
const BESIDE: DVec3 =
    DVec3::new(1e-9 * std::f64::consts::SQRT_2, 1e-9 * std::f64::consts::E, -1e-9 * std::f64::consts::PI);

/// Number of words before the distances in [`DistanceField::words`].
const HEAD: usize = 8;

/// Why a mesh has no inside, or none that a grid can hold. Vertices and faces are numbered as given, from 0.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshFault {
    /// There are no faces.
    Empty,
    /// A face names a vertex that does not exist.
    Missing {
        /// The face.
        face: usize,
        /// The vertex that it names.
        vertex: usize,
    },
    /// A coordinate is not a number, or beyond 1e30.
    NotFinite {
        /// The first such vertex.
        vertex: usize,
    },
    /// Edges that belong to one face only (or to an odd number of faces): the surface has a hole or a rim.
    Open {
        /// Number of such edges.
        edges: usize,
        /// The vertices of one of them.
        first: [usize; 2],
    },
    /// Edges whose faces run through them in the same direction: one shows its front where the other shows its back.
    Inconsistent {
        /// Number of such edges.
        edges: usize,
        /// The vertices of one of them.
        first: [usize; 2],
    },
    /// The surface is closed but holds no volume.
    Flat,
    /// The mesh is so far from its origin, for its size, that single precision does not resolve the cells.
    Far,
}

impl fmt::Display for MeshFault {
    /// Completes the sentence "found ...".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => write!(f, "no faces"),
            Self::Missing { face, vertex } => {
                write!(f, "face {face} with vertex {vertex}, which does not exist (counted from 0)")
            }
            Self::NotFinite { vertex } => {
                write!(
                    f,
                    "a coordinate that is not finite or beyond 1e30 in vertex {vertex} (counted from 0)"
                )
            }
            Self::Open { edges, first: [a, b] } => write!(
                f,
                "a surface that is not closed: {edges} of its edges lack a face, as that between vertices {a} and \
                 {b} (counted from 0)"
            ),
            Self::Inconsistent { edges, first: [a, b] } => write!(
                f,
                "faces that are oriented differently: their fronts change sides at {edges} edges, as that between \
                 vertices {a} and {b} (counted from 0)"
            ),
            Self::Flat => write!(f, "a surface that encloses no volume"),
            Self::Far => write!(f, "a mesh too far from its origin for its size"),
        }
    }
}

/// The signed distance of a closed triangle mesh, sampled at the nodes of a regular grid around it. All lengths are in the
/// mesh's own unit.
///
/// Between the nodes the error is a few hundredths of a cell where the surface is smooth; edges are rounded by a
/// fraction of a cell, and so are the ridges of the distance, in the middle of the body. Parts of the mesh that overlap
/// count as their union, but surfaces inside of the union still count as surfaces: points near them have the right
/// sign, and a distance that is too small.
#[derive(Clone, Debug, PartialEq)]
pub struct DistanceField {
    /// Place of node (0, 0, 0); holds in single precision, as `cell` and `least` do.
    origin: DVec3,
    /// Side of a cell, a cube.
    cell: f64,
    /// Number of nodes along x, y and z.
    nodes: [usize; 3],
    /// Signed distance of each node, x fastest.
    values: Vec<f32>,
    /// Gap between the mesh's bounding box and the grid's boundary, hence no more than any distance there.
    least: f64,
    /// Radius of the ball around (0, 0, 0) that holds the mesh.
    reach: f64,
    /// Volume of the mesh.
    volume: f64,
    /// Whether parts of the mesh overlap.
    overlaps: bool,
}

impl DistanceField {
    /// Number of empty cells around the mesh on each side.
    pub const MARGIN_CELLS: usize = 2;

    /// Samples the distance of a mesh with `cells` cells along the longest side of its bounding box. `vertices` are
    /// places, shape \[n, 3\], and `faces` their numbers from 0. The mesh may be inside out, and vertices may
    /// repeat, as at the seams of a texture. Fails if it is not closed.
    pub fn new(vertices: &[[f64; 3]], faces: &[[u32; 3]], cells: usize) -> Result<Self, MeshFault> {
        let faces = welded(vertices, faces)?;
        check_closed(&faces)?;

        let corners = || faces.iter().flatten().map(|vertex| DVec3::from(vertices[*vertex]));
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        let longest = (high - low).max_element();
        // All faces may have been dropped.
        if faces.is_empty() || longest < 1.0 / FARTHEST {
            return Err(MeshFault::Flat);
        }
        // A little more than it takes, so that the number of cells survives rounding.
        let cell = single(longest / cells as f64 * (1.0 + f64::from(f32::EPSILON)));
        if low.abs().max(high.abs()).max_element() * f64::from(f32::EPSILON) > cell / 16.0 {
            return Err(MeshFault::Far);
        }
        let spans = ((high - low) / cell).ceil() + DVec3::splat(2.0 * Self::MARGIN_CELLS as f64);
        let origin = DVec3::from(((low + high - spans * cell) / 2.0).to_array().map(single));
        let nodes = spans.to_array().map(|span| span as usize + 1);
        let gap = ((low - origin) / cell).min(spans - (high - origin) / cell).min_element();

        let mut faces: Vec<[DVec3; 3]> = faces
            .iter()
            .map(|face| face.map(|vertex| (DVec3::from(vertices[vertex]) - origin) / cell))
            .collect();
        let volume = faces.iter().map(|[a, b, c]| a.dot(b.cross(*c))).sum::<f64>() / 6.0;
        if volume.abs() <= 1e-12 * (longest / cell).powi(3) {
            return Err(MeshFault::Flat);
        }
        if volume < 0.0 {
            faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
        let facets: Vec<Facet> = faces.iter().filter_map(Facet::new).collect();
        if facets.is_empty() {
            return Err(MeshFault::Flat);
        }

        let (distances, windings) = rayon::join(|| distances(&facets, nodes), || windings(&faces, nodes));
        let signed = |(distance, winding): (f64, &i16)| {
            let distance = if *winding == 0 { distance } else { -distance };
            (distance * cell) as f32
        };
        Ok(Self {
            origin,
            cell,
            nodes,
            values: distances.into_iter().zip(&windings).map(signed).collect(),
            least: single(gap * cell),
            reach: corners().map(DVec3::length).fold(0.0, f64::max),
            volume: volume.abs() * cell.powi(3),
            overlaps: windings.iter().any(|winding| !(0..=1).contains(winding)),
        })
    }

    /// Returns the signed distance of a point and its direction of ascent. Outside of the grid that distance
    /// is a lower bound, but for the error of the samples between nodes; it is continuous at the grid's boundary. A
    /// point that is not a number has a distance that is none.
    pub fn distance(&self, p: DVec3) -> Distance {
        let place = (p - self.origin) / self.cell;
        let [x, y, z] = [0, 1, 2].map(|axis| {
            // `clamp` would keep what is not a number.
            let last = (self.nodes[axis] - 1) as f64;
            if place[axis] > 0.0 { place[axis].min(last) } else { 0.0 }
        });
        let nearest = DVec3::new(x, y, z);
        let at_nearest = self.interpolated(nearest);
        if place == nearest {
            return at_nearest;
        }
        let beyond = (place - nearest) * self.cell;
        let away = beyond.length();
        // The straight way to the mesh crosses the grid's boundary, `away` from here or farther, and then the gap.
        let bound = away + self.least;
        // And no distance changes faster than the place.
        let other = at_nearest.distance - away;
        if other > bound {
            return Distance { distance: other, ..at_nearest };
        }
        Distance { distance: bound, normal: beyond.normalize_or(DVec3::Z) }
    }

    /// Returns the radius of a ball around (0, 0, 0) that holds the mesh.
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Returns the volume of the mesh; what lies in several parts counts several times.
    pub fn volume(&self) -> f64 {
        self.volume
    }

    /// Returns whether parts of the mesh overlap: whether a node was found inside more than once, or inside a part that
    /// is inside out.
    pub fn overlaps(&self) -> bool {
        self.overlaps
    }

    /// Returns two opposite corners of the box that holds the mesh.
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let extent = DVec3::from(self.nodes.map(|nodes| (nodes - 1) as f64)) * self.cell;
        [self.origin + self.least, self.origin + extent - self.least].map(|corner| corner.to_array())
    }

    /// Returns the number of [`DistanceField::words`].
    pub fn len_in_words(&self) -> usize {
        HEAD + self.values.len()
    }

    /// Returns the field as a GPU reads it, shape \[8 + nx ny nz\]: the place of node (0, 0, 0), the side of a cell,
    /// the numbers of nodes nx, ny, nz, the gap between mesh and boundary, and the distances, x fastest.
    pub fn words(&self) -> Vec<f32> {
        let [x, y, z] = self.origin.to_array();
        let [nx, ny, nz] = self.nodes.map(|nodes| nodes as f64);
        let head = [x, y, z, self.cell, nx, ny, nz, self.least];
        head.into_iter().map(|word| word as f32).chain(self.values.iter().copied()).collect()
    }

    /// The trilinear interpolant at a place in the grid \[cells from node (0, 0, 0)\].
    fn interpolated(&self, place: DVec3) -> Distance {
        // The last node of an axis belongs to the cell before it.
        let [x, y, z] = [0, 1, 2].map(|axis| (place[axis] as usize).min(self.nodes[axis] - 2));
        let part = place - DVec3::new(x as f64, y as f64, z as f64);
        // The cell's four edges along x, each as its value and its slope.
        let edges = [(y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1)].map(|(y, z)| {
            let node = x + self.nodes[0] * (y + self.nodes[1] * z);
            let [low, high] = [self.values[node], self.values[node + 1]].map(f64::from);
            (low + part.x * (high - low), high - low)
        });
        let mix = |low: f64, high: f64, part: f64| low + part * (high - low);
        let [(a, along_a), (b, along_b), (c, along_c), (d, along_d)] = edges;
        let (low, high) = (mix(a, b, part.y), mix(c, d, part.y));
        let gradient = DVec3::new(
            mix(mix(along_a, along_b, part.y), mix(along_c, along_d, part.y), part.z),
            mix(b - a, d - c, part.z),
            high - low,
        );
        Distance { distance: mix(low, high, part.z), normal: gradient.normalize_or(DVec3::Z) }
    }
}

/// Rounds to a number that single precision holds.
fn single(x: f64) -> f64 {
    f64::from(x as f32)
}

/// Returns the faces with each vertex replaced by the first at the same place, less those with two corners at one
/// place.
fn welded(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> Result<Vec<[usize; 3]>, MeshFault> {
    if faces.is_empty() {
        return Err(MeshFault::Empty);
    }
    let within = |place: &[f64; 3]| place.iter().all(|x| x.abs() <= FARTHEST);
    if let Some(vertex) = vertices.iter().position(|place| !within(place)) {
        return Err(MeshFault::NotFinite { vertex });
    }
    let mut at = HashMap::new();
    // Adding 0 turns -0, which has other bits, into 0.
    let first =
        |(vertex, place): (usize, &[f64; 3])| *at.entry(place.map(|x| (x + 0.0).to_bits())).or_insert(vertex);
    let first: Vec<usize> = vertices.iter().enumerate().map(first).collect();
    let mut kept = Vec::with_capacity(faces.len());
    for (face, corners) in faces.iter().enumerate() {
        let corners = corners.map(|vertex| vertex as usize);
        if let Some(&vertex) = corners.iter().find(|vertex| **vertex >= first.len()) {
            return Err(MeshFault::Missing { face, vertex });
        }
        let [a, b, c] = corners.map(|vertex| first[vertex]);
        if a != b && b != c && c != a {
            kept.push([a, b, c]);
        }
    }
    Ok(kept)
}

/// Fails unless faces run through each edge as often in one direction as in the other.
fn check_closed(faces: &[[usize; 3]]) -> Result<(), MeshFault> {
    let mut surplus = BTreeMap::<[usize; 2], isize>::new();
    for [a, b, c] in faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *surplus.entry([*from.min(to), *from.max(to)]).or_default() += if from < to { 1 } else { -1 };
        }
    }
    let edges = |bad: fn(isize) -> bool| {
        let mut edges = surplus.iter().filter(|(_, surplus)| bad(**surplus)).map(|(edge, _)| *edge);
        edges.next().map(|first| (1 + edges.count(), first))
    };
    if let Some((edges, first)) = edges(|surplus| surplus % 2 != 0) {
        return Err(MeshFault::Open { edges, first });
    }
    if let Some((edges, first)) = edges(|surplus| surplus != 0) {
        return Err(MeshFault::Inconsistent { edges, first });
    }
    Ok(())
}

/// Returns for each node how often the surface winds around it: 1 inside, 0 outside. Corners in cells.
///
/// Lines along each of the axes count it, and the median of the three holds, should one meet the surface at a very
/// small angle.
fn windings(faces: &[[DVec3; 3]], nodes: [usize; 3]) -> Vec<i16> {
    let counts: Vec<_> = (0..3).into_par_iter().map(|axis| windings_along(axis, faces, nodes)).collect();
    let median = |a: i16, b: i16, c: i16| a.max(b).min(c).max(a.min(b));
    (0..counts[0].len()).map(|node| median(counts[0][node], counts[1][node], counts[2][node])).collect()
}

/// Returns for each node how many more faces its line, along an axis, has entered by than left by before it.
fn windings_along(axis: usize, faces: &[[DVec3; 3]], nodes: [usize; 3]) -> Vec<i16> {
    let strides = [1, nodes[0], nodes[0] * nodes[1]];
    let mut winding = vec![0i16; nodes.iter().product()];
    // The lines stand on the plane of the next two axes, in rows along `u`.
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    for corners in faces {
        // Moving the faces is as good as moving the lines, which then stand on whole numbers.
        let [a, b, c] = corners.map(|corner| corner - BESIDE);
        let normal = (b - a).cross(c - a);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        for row in low[v].ceil() as usize..high[v].ceil() as usize {
            let at = row as f64;
            // The number of lines in the row before an edge. It must be the same for both faces of the edge, to the
            // last bit: then all that enters also leaves. Therefore the edge runs from its lower end here.
            let before = |low: DVec3, high: DVec3| {
                (low[u] + (at - low[v]) / (high[v] - low[v]) * (high[u] - low[u])).ceil() as usize
            };
            // A face that meets the row does so with an edge that goes up and one that goes down.
            let (mut up, mut down) = (0, 0);
            for (from, to) in [(a, b), (b, c), (c, a)] {
                if from[v] <= at && at < to[v] {
                    up = before(from, to);
                } else if to[v] <= at && at < from[v] {
                    down = before(to, from);
                }
            }
            // Seen against the axis the face turns left if its edge on the right goes up: there the line leaves.
            let (lines, turn) = if down < up { (down..up, -1) } else { (up..down, 1) };
            for line in lines {
                let place =
                    a[axis] - (normal[u] * (line as f64 - a[u]) + normal[v] * (at - a[v])) / normal[axis];
                // A face that the line lies in has any place along it; `max` drops what is not a number.
                let node = place.max(low[axis]).min(high[axis]).ceil() as usize;
                let count = &mut winding[node * strides[axis] + line * strides[u] + row * strides[v]];
                *count = i16::saturating_add(*count, turn);
            }
        }
    }
    for node in 0..winding.len() {
        if !(node / strides[axis]).is_multiple_of(nodes[axis]) {
            winding[node] = winding[node].saturating_add(winding[node - strides[axis]]);
        }
    }
    winding
}

/// A triangle, prepared for distances.
struct Facet {
    /// Its corners \[cells\].
    corners: [DVec3; 3],
    /// The edge from each corner to the next.
    edges: [DVec3; 3],
    /// In the triangle's plane, across each edge, to the inside.
    inward: [DVec3; 3],
    /// Of length 1.
    normal: DVec3,
}

impl Facet {
    /// Prepares a triangle, unless it is so thin that it hardly differs from its edges, which are edges of other
    /// triangles too, and that its normal is mostly rounding.
    fn new(corners: &[DVec3; 3]) -> Option<Self> {
        let [a, b, c] = *corners;
        let edges = [b - a, c - b, a - c];
        let normal = edges[0].cross(edges[1]);
        let longest = edges.map(DVec3::length_squared).into_iter().fold(0.0, f64::max);
        let area = normal.length();
        if area <= 1e-9 * longest {
            return None;
        }
        let normal = normal / area;
        Some(Self { corners: *corners, edges, inward: edges.map(|edge| normal.cross(edge)), normal })
    }

    /// Returns the distance of a point to the triangle.
    fn distance(&self, p: DVec3) -> f64 {
        let mut nearest = f64::INFINITY;
        for side in 0..3 {
            let from = p - self.corners[side];
            // The nearest point is on an edge that has the point on its outer side, if there is one.
            if self.inward[side].dot(from) < 0.0 {
                let edge = self.edges[side];
                let share = (from.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
                nearest = nearest.min((from - share * edge).length_squared());
            }
        }
        if nearest < f64::INFINITY { nearest.sqrt() } else { self.normal.dot(p - self.corners[0]).abs() }
    }
}

/// Returns the distance of each node to the surface, without its sign. All in cells.
///
/// It is exact near the surface. Farther out a node tries the triangles that are nearest to its neighbours, in sweeps
/// through the grid in all directions: the distance is exact to one triangle, and very seldom is another one nearer.
fn distances(facets: &[Facet], nodes: [usize; 3]) -> Vec<f64> {
    /// Nodes within this distance of a triangle's bounding box try it \[cells\].
    const BAND: f64 = 1.0;
    /// Number of directions to sweep in: each axis forwards or backwards.
    const ORDERS: u8 = 8;
    let strides = [1, nodes[0], nodes[0] * nodes[1]];
    let place = |[x, y, z]: [usize; 3]| DVec3::new(x as f64, y as f64, z as f64);
    let mut distance = vec![f64::INFINITY; nodes.iter().product()];
    let mut nearest = vec![u32::MAX; distance.len()];
    // The sweep that last changed a node.
    let mut changed = vec![0u8; distance.len()];

    for (number, facet) in (0u32..).zip(facets) {
        let [a, b, c] = facet.corners;
        let low = (a.min(b).min(c) - BAND).floor().to_array().map(|x| x as usize);
        let high = (a.max(b).max(c) + BAND).ceil().to_array().map(|x| x as usize);
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let (p, node) = (place([x, y, z]), x + strides[1] * y + strides[2] * z);
                    // Most of the bounding box of a large slanted triangle is far from its plane.
                    if facet.normal.dot(p - a).abs() < distance[node].min(2.0 * BAND) {
                        let found = facet.distance(p);
                        if found < distance[node] {
                            (distance[node], nearest[node]) = (found, number);
                        }
                    }
                }
            }
        }
    }

    for sweep in 0..2 * ORDERS {
        let backwards = [0, 1, 2].map(|axis| sweep >> axis & 1 == 1);
        // The neighbours that the sweep has passed before a node, as steps from it, and how far they are.
        let neighbours: [(isize, f64); 7] = std::array::from_fn(|number| {
            let axes = (0..3).filter(|axis| (number + 1) >> axis & 1 == 1);
            let step = |axis: usize| strides[axis] as isize * if backwards[axis] { 1 } else { -1 };
            (axes.clone().map(step).sum(), (axes.count() as f64).sqrt())
        });
        // The first node of each line has no such neighbours; a sweep in the other direction reaches it.
        let along = |axis: usize| {
            let last = nodes[axis] - 1;
            (1..=last).map(move |step| if backwards[axis] { last - step } else { step })
        };
        for z in along(2) {
            for y in along(1) {
                for x in along(0) {
                    let (p, node) = (place([x, y, z]), x + strides[1] * y + strides[2] * z);
                    for (step, length) in neighbours {
                        let neighbour = node.wrapping_add_signed(step);
                        let number = nearest[neighbour];
                        // A round of sweeps has tried all neighbours. And a triangle is nearer to the node than to
                        // the neighbour by the way between them at most.
                        if sweep < changed[neighbour] + ORDERS
                            && number != nearest[node]
                            && distance[neighbour] - length < distance[node]
                        {
                            let found = facets[number as usize].distance(p);
                            if found < distance[node] {
                                (distance[node], nearest[node], changed[node]) = (found, number, sweep);
                            }
                        }
                    }
                }
            }
        }
    }
    distance
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    type Mesh = (Vec<[f64; 3]>, Vec<[u32; 3]>);

    /// Points that fill the box from `-half` to `half` evenly.
    fn points(half: f64) -> impl Iterator<Item = DVec3> {
        // Multiples of powers of the root of x^4 = x + 1.
        let step = DVec3::new(0.819_172_513_396, 0.671_043_606_704, 0.549_700_477_901);
        (1..4000).map(move |number| ((step * f64::from(number)).fract() * 2.0 - 1.0) * half)
    }

    fn cuboid(low: [f64; 3], high: [f64; 3]) -> Mesh {
        let vertices = (0..8).map(|v| [0, 1, 2].map(|axis| [low, high][v >> axis & 1][axis])).collect();
        let squares = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        (vertices, squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect())
    }

    /// The meshes together.
    fn joined(mut first: Mesh, second: Mesh) -> Mesh {
        let shift = first.0.len() as u32;
        first.0.extend(second.0);
        first.1.extend(second.1.iter().map(|face| face.map(|vertex| vertex + shift)));
        first
    }

    /// A sheet of `n` by `2 n` squares, sewn up by vertices that are given twice, as at the seams of a texture.
    fn sheet(n: usize, place: impl Fn(usize, usize) -> DVec3) -> Mesh {
        let vertices = (0..=n).flat_map(|i| (0..=2 * n).map(move |j| (i, j % (2 * n))));
        let vertices = vertices.map(|(i, j)| place(i, j).to_array()).collect();
        let face = |i: usize, j: usize| {
            let at = |i, j| (i * (2 * n + 1) + j) as u32;
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        };
        (vertices, (0..n).flat_map(|i| (0..2 * n).flat_map(move |j| face(i, j))).collect())
    }

    fn ball(n: usize, radius: f64) -> Mesh {
        sheet(n, |i, j| {
            let (across, around) = (TAU / 2.0 * i as f64 / n as f64, TAU * j as f64 / (2 * n) as f64);
            // The poles are single points; the faces there have two corners in one.
            let ring = if i % n == 0 { 0.0 } else { across.sin() };
            radius * DVec3::new(ring * around.cos(), ring * around.sin(), across.cos())
        })
    }

    /// A tube with radius 1 around a circle with radius 2 in the plane z = 0.
    fn torus(n: usize) -> Mesh {
        sheet(n, |i, j| {
            let (along, around) = (TAU * (i % n) as f64 / n as f64, TAU * j as f64 / (2 * n) as f64);
            let ring = 2.0 + along.cos();
            DVec3::new(ring * around.cos(), ring * around.sin(), -along.sin())
        })
    }

    fn flipped((vertices, faces): Mesh) -> Mesh {
        (vertices, faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect())
    }

    fn field((vertices, faces): &Mesh, cells: usize) -> DistanceField {
        DistanceField::new(vertices, faces, cells).unwrap()
    }

    fn fault((vertices, faces): &Mesh) -> MeshFault {
        DistanceField::new(vertices, faces, 8).unwrap_err()
    }

    /// The exact distance of a box around the origin.
    fn box_distance(p: DVec3, half: DVec3) -> f64 {
        let beyond = p.abs() - half;
        beyond.max(DVec3::ZERO).length() + beyond.max_element().min(0.0)
    }

    fn torus_distance(p: DVec3) -> Distance {
        let ring = p.with_z(0.0).normalize() * 2.0;
        Distance { distance: p.distance(ring) - 1.0, normal: (p - ring).normalize() }
    }

    #[test]
    fn a_box_has_its_exact_distance_but_for_rounded_edges() {
        let half = DVec3::new(1.0, 0.7, 0.45);
        let field = field(&cuboid((-half).into(), half.into()), 32);
        assert_eq!(field.nodes, [37, 28, 20]);
        assert!((field.volume() - 8.0 * half.element_product()).abs() < 1e-9);
        assert!((field.reach() - half.length()).abs() < 1e-12 && !field.overlaps());
        let cell = field.cell;
        let (mut worst, mut worst_flat, mut flat) = (0f64, 0f64, 0);
        for p in points(1.0).map(|p| p * (half + 1.9 * cell)) {
            let error = (field.distance(p).distance - box_distance(p, half)).abs() / cell;
            worst = worst.max(error);
            // Whether the whole cell sees the same face, be it from inside or from outside.
            let mut beyond = (p.abs() - half).to_array();
            beyond.sort_by(f64::total_cmp);
            if beyond[2] > -0.3 && beyond[1] + 2.0 * cell < beyond[2].min(0.0) {
                (worst_flat, flat) = (worst_flat.max(error), flat + 1);
            }
        }
        assert!(
            flat > 1000 && worst_flat < 1e-5 && worst < 0.5,
            "{flat} points, {worst_flat}, {worst} cells"
        );
    }

    #[test]
    fn a_ball_and_a_torus_have_their_distances_and_normals() {
        let ball_distance = |p: DVec3| Distance { distance: p.length() - 1.5, normal: p.normalize() };
        type Exact = fn(DVec3) -> Distance;
        let shapes: [(_, _, Exact, _); 2] =
            [("ball", ball(96, 1.5), ball_distance, 1.5), ("torus", torus(96), torus_distance, 3.0)];
        for (name, mesh, exact, half) in shapes {
            let field = field(&mesh, 64);
            let (mut worst, mut worst_normal) = (0f64, 0f64);
            for p in points(half).filter(|p| exact(*p).distance < 2.0 * field.cell) {
                let (found, exact) = (field.distance(p), exact(p));
                // Normals turn at the centre of the ball and in the middle and at the axis of the torus.
                if exact.distance > -0.5 && p.truncate().length() > 0.3 {
                    worst = worst.max((found.distance - exact.distance).abs() / field.cell);
                    worst_normal = worst_normal.max(found.normal.distance(exact.normal));
                }
            }
            assert!(worst < 0.1 && worst_normal < 0.1, "{name}: {worst} cells, normal {worst_normal}");
        }
    }

    /// How often the mesh winds around a point, from the solid angles of its faces.
    fn winding(p: DVec3, triangles: &[[DVec3; 3]]) -> f64 {
        let angle = |corners: &[DVec3; 3]| {
            let [a, b, c] = corners.map(|corner| (corner - p).normalize());
            2.0 * a.dot(b.cross(c)).atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
        };
        triangles.iter().map(angle).sum::<f64>() / (2.0 * TAU)
    }

    #[test]
    fn the_nodes_have_the_sign_and_the_distance_of_all_triangles() {
        // Turned, so that nothing lies along the grid.
        let turn = glam::DMat3::from_euler(glam::EulerRot::XYZ, 0.3, 0.5, 0.7);
        for (vertices, faces) in [torus(10), cuboid([-1.0, -2.0, -0.2], [1.0, 2.0, 0.2])] {
            let vertices: Vec<_> = vertices.iter().map(|v| (turn * DVec3::from(*v)).to_array()).collect();
            let field = field(&(vertices.clone(), faces.clone()), 24);
            let corners = |face: &[u32; 3]| face.map(|vertex| DVec3::from(vertices[vertex as usize]));
            // Two corners of some are at one place.
            let (triangles, facets): (Vec<_>, Vec<_>) =
                faces.iter().map(corners).filter_map(|face| Some((face, Facet::new(&face)?))).unzip();
            let (mut worst, mut wrong) = (0f64, 0);
            for (node, value) in field.values.iter().enumerate() {
                let [nx, ny, _] = field.nodes;
                let at = [node % nx, node / nx % ny, node / nx / ny].map(|x| x as f64);
                let p = field.origin + DVec3::from(at) * field.cell;
                let exact = facets.iter().map(|facet| facet.distance(p)).fold(f64::INFINITY, f64::min);
                let error = (f64::from(value.abs()) - exact).abs() / field.cell;
                assert_eq!(*value < 0.0, winding(p, &triangles) > 0.5, "{p}: {value}");
                worst = worst.max(error);
                wrong += usize::from(error > 1e-5);
            }
            // A few nodes far inside or outside miss their nearest triangle.
            assert!(worst < 0.05 && wrong * 100 < field.values.len(), "{worst} cells, {wrong} nodes");
        }
    }

    #[test]
    fn outside_of_the_grid_it_is_a_continuous_lower_bound() {
        let half = DVec3::new(1.0, 0.7, 0.45);
        let field = field(&cuboid((-half).into(), half.into()), 16);
        let (low, high) = (-half - 2.0 * field.cell, half + 2.0 * field.cell);
        let mut outside = 0;
        for p in points(4.0).filter(|p| p.cmplt(low - field.cell).any() || p.cmpgt(high + field.cell).any()) {
            let (found, exact) = (field.distance(p), box_distance(p, half));
            assert!(found.distance <= exact + 1e-6, "{p}: {} above {exact}", found.distance);
            assert!(found.distance > 0.5 * exact && (found.normal.length() - 1.0).abs() < 1e-12, "{p}");
            outside += 1;
        }
        assert!(outside > 1000);
        for p in points(1.0) {
            // Across the boundary.
            let p = p / p.abs().max_element();
            let reach = DVec3::from(field.nodes.map(|nodes| (nodes - 1) as f64)) * field.cell / 2.0;
            let [inner, outer] =
                [1.0 - 1e-7, 1.0 + 1e-7].map(|share| field.distance(share * p * reach).distance);
            assert!((inner - outer).abs() < 1e-5, "{p}: {inner} and {outer}");
        }
    }

    #[test]
    fn equal_surfaces_have_equal_fields() {
        let mesh = torus(12);
        let once = field(&mesh, 16);
        assert_eq!(field(&mesh, 16), once);
        assert_eq!(field(&flipped(mesh.clone()), 16), once);
        // Each face with vertices of its own.
        let apart = mesh.1.iter().flatten().map(|vertex| mesh.0[*vertex as usize]).collect();
        let numbers = (0..mesh.1.len() as u32).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
        assert_eq!(field(&(apart, numbers), 16), once);
        let words = once.words();
        assert_eq!(words.len(), 8 + once.nodes.iter().product::<usize>());
        assert_eq!(words[..8].iter().map(|word| f64::from(*word)).collect::<Vec<_>>()[3..], {
            let [nx, ny, nz] = once.nodes.map(|nodes| nodes as f64);
            [once.cell, nx, ny, nz, once.least]
        });
        assert_eq!(DVec3::from([0, 1, 2].map(|axis| f64::from(words[axis]))), once.origin);
    }

    #[test]
    fn overlapping_parts_are_a_union_and_a_hollow_is_outside() {
        let cube = |half: f64| cuboid([-half; 3], [half; 3]);
        let beside = cuboid([0.5, -0.6, -0.6], [2.0, 0.6, 0.6]);
        let both = field(&joined(cube(1.0), beside), 24);
        let sign = |field: &DistanceField, x| field.distance(DVec3::new(x, 0.0, 0.0)).distance.signum();
        assert!(both.overlaps());
        assert_eq!([-1.2, -0.8, 0.75, 1.5, 2.2].map(|x| sign(&both, x)), [1.0, -1.0, -1.0, -1.0, 1.0]);
        assert!(both.distance(DVec3::new(1.5, 0.8, 0.0)).distance > 0.19);
        let hollow = field(&joined(cube(1.0), flipped(cube(0.5))), 24);
        assert!(!hollow.overlaps() && (hollow.volume() - 7.0).abs() < 1e-9);
        assert_eq!([-1.2, -0.75, 0.0, 0.75].map(|x| sign(&hollow, x)), [1.0, -1.0, 1.0, -1.0]);
    }

    #[test]
    fn a_mesh_without_an_inside_is_refused() {
        let (vertices, faces) = cuboid([0.0; 3], [1.0, 2.0, 3.0]);
        let open = fault(&(vertices.clone(), faces[2..].to_vec()));
        assert_eq!(open, MeshFault::Open { edges: 4, first: [0, 2] });
        assert!(open.to_string().ends_with("between vertices 0 and 2 (counted from 0)"), "{open}");
        let mut turned = faces.clone();
        turned[0].swap(0, 1);
        assert_eq!(fault(&(vertices.clone(), turned)), MeshFault::Inconsistent { edges: 3, first: [0, 4] });
        assert_eq!(fault(&(vertices.clone(), vec![])), MeshFault::Empty);
        assert_eq!(fault(&(vertices.clone(), vec![[0, 0, 1]])), MeshFault::Flat);
        assert_eq!(fault(&(vertices.clone(), vec![[0, 1, 2], [0, 2, 1]])), MeshFault::Flat);
        assert_eq!(fault(&(vertices.clone(), vec![[0, 1, 8]])), MeshFault::Missing { face: 0, vertex: 8 });
        for bad in [f64::NAN, f64::INFINITY, -1e31] {
            let mut vertices = vertices.clone();
            vertices[5][2] = bad;
            assert_eq!(fault(&(vertices, faces.clone())), MeshFault::NotFinite { vertex: 5 });
        }
        assert_eq!(fault(&cuboid([1e6; 3], [1e6 + 1.0; 3])), MeshFault::Far);
    }

    #[test]
    fn an_edge_may_end_on_another_if_a_triangle_without_area_closes_the_gap() {
        // A vertex in the middle of an edge, on one of the edge's sides only.
        let (mut vertices, mut faces) = cuboid([0.0; 3], [1.0; 3]);
        let split = faces.iter().position(|face| face.contains(&0) && face.contains(&1)).unwrap();
        let whole = faces[split];
        let at = whole.iter().position(|vertex| *vertex < 2).unwrap();
        let at = if whole[(at + 1) % 3] < 2 { at } else { (at + 2) % 3 };
        let [a, b, c] = [0, 1, 2].map(|step| whole[(at + step) % 3]);
        vertices.push([0.5, 0.0, 0.0]);
        faces[split] = [a, 8, c];
        faces.extend([[8, b, c], [a, b, 8]]);
        let plain = field(&cuboid([0.0; 3], [1.0; 3]), 16);
        let split = field(&(vertices, faces), 16);
        let worst = plain.values.iter().zip(&split.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-6, "{worst}");
    }

    #[test]
    fn no_point_is_refused() {
        let field = field(&ball(8, 1.0), 8);
        let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 1e-300, -0.0, 0.5, f64::MAX];
        for (x, y, z) in odd.iter().flat_map(|x| odd.iter().flat_map(move |y| odd.map(|z| (*x, *y, z)))) {
            let found = field.distance(DVec3::new(x, y, z));
            assert_eq!(found.distance.is_nan(), x.is_nan() || y.is_nan() || z.is_nan());
            assert!((found.normal.length() - 1.0).abs() < 1e-9, "{found:?}");
        }
    }
}
