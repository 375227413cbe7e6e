//! Recorded cloths whose vertices do not form a grid: their mesh at rest, and the grid that stands in for it.

use crate::cloth::{Grid, MIN_GRID};
use crate::io::{Trajectory, read_obj};
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::Path;

/// Tolerances: the distance of a mesh at rest from a plane, relative to its longer side, and the distance of
/// a corner of its bounding rectangle from the triangles, relative to their sides.
const FLAT: f64 = 1e-3;

/// A flat rectangular mesh at rest. Positions are measured from the corner where particle (0, 0) of a grid
/// would be: along the height, on which the first two handles lie and where i increases from the second to
/// the first, and along the width, which leads away from them.
#[derive(Clone, Debug)]
pub(super) struct FlatMesh {
    /// The triangles.
    pub faces: Vec<[u32; 3]>,
    origin: String,
    /// Position of each vertex along the height and the width \[m\].
    places: Vec<[f64; 2]>,
    /// Lengths of the sides \[m\].
    pub sides: [f64; 2],
}

impl FlatMesh {
    /// Reads an OBJ file of `vertices` vertices; `handles` are the vertex numbers of the handles.
    pub fn read(path: &Path, vertices: usize, handles: &[usize]) -> Result<Self> {
        let mesh = read_obj(path)?;
        let origin = path.display().to_string();
        if mesh.positions.len() != vertices {
            let expected = format!("{vertices}, as in cloth_pos.npy");
            return Err(Error::invalid(origin, "vertices", expected, mesh.positions.len()));
        }
        if mesh.faces.is_empty() {
            return Err(Error::invalid(origin, "faces", "at least one triangle", "none"));
        }
        if let Some(&handle) = handles.iter().find(|&&handle| handle >= vertices) {
            return Err(Error::invalid(origin, "handles", format!("vertices below {vertices}"), handle));
        }
        let of = |axis: usize| mesh.positions.iter().map(move |p| f64::from(p[axis]));
        let bounds = [0, 1, 2].map(|axis| {
            of(axis).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
        });
        let extent = bounds.map(|(low, high)| high - low);
        let mut axes = [0, 1, 2];
        axes.sort_by(|&a, &b| extent[b].total_cmp(&extent[a]));
        let [long, short, across] = axes;
        if extent[across] > FLAT * extent[long] || extent[short] <= FLAT * extent[long] {
            let expected = "a flat sheet, its sides along two of the axes";
            return Err(Error::invalid(origin, "vertices", expected, format!("a box of {extent:?} m")));
        }
        let at = |handle: usize, axis: usize| f64::from(mesh.positions[handle][axis]);
        let apart = |axis: usize| match handles {
            [first, second, ..] => at(*first, axis) - at(*second, axis),
            _ => 0.0,
        };
        let [height, width] =
            if apart(long).abs() >= apart(short).abs() { [long, short] } else { [short, long] };
        // Whether each side is measured from its upper bound.
        let down = apart(height) < 0.0;
        let away = handles.first().is_some_and(|&handle| {
            let (low, high) = bounds[width];
            2.0 * at(handle, width) > low + high
        });
        let place = |p: &[f32; 3]| {
            [(height, down), (width, away)].map(|(axis, reversed)| {
                let (low, high) = bounds[axis];
                if reversed { high - f64::from(p[axis]) } else { f64::from(p[axis]) - low }
            })
        };
        let places = mesh.positions.iter().map(place).collect();
        Ok(Self { faces: mesh.faces, origin, places, sides: [extent[height], extent[width]] })
    }

    /// Returns a grid of square cells with about as many particles as the mesh has vertices.
    pub fn grid(&self) -> Grid {
        let [height, width] = self.sides;
        let cells = (self.places.len() as f64).sqrt() - 1.0;
        let edges = |side: f64, other: f64| (cells * (side / other).sqrt()).round() as usize;
        let h = (edges(height, width) + 1).max(MIN_GRID);
        let w = (((h - 1) as f64 * width / height).round() as usize + 1).max(MIN_GRID);
        Grid { h, w }
    }

    /// Returns the particle (i, j) of a grid nearest to a vertex.
    pub fn cell(&self, grid: Grid, vertex: usize) -> [usize; 2] {
        let ends = [grid.h - 1, grid.w - 1];
        std::array::from_fn(|k| (self.places[vertex][k] / self.sides[k] * ends[k] as f64).round() as usize)
    }

    /// Builds the interpolation from the vertices to the particles of a grid.
    pub fn interpolation_to(&self, grid: Grid) -> Result<MeshInterpolation> {
        let place = |p: usize| {
            let at = [(p / grid.w, grid.h), (p % grid.w, grid.w)].map(|(k, n)| k as f64 / (n - 1) as f64);
            self.locate([at[0] * self.sides[0], at[1] * self.sides[1]])
        };
        Ok(MeshInterpolation((0..grid.particles()).into_par_iter().map(place).collect::<Result<_>>()?))
    }

    /// Finds the triangle that contains a point of the sheet, up to the tolerance [`FLAT`], and the
    /// barycentric coordinates of the point. Fails if there is none.
    fn locate(&self, at: [f64; 2]) -> Result<Barycentric> {
        let shares = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|k| self.places[k as usize]);
            let cross = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
            let from_a = |p: [f64; 2]| [p[0] - a[0], p[1] - a[1]];
            let (u, v, p) = (from_a(b), from_a(c), from_a(at));
            let area = cross(u, v);
            let [of_b, of_c] = [cross(p, v) / area, cross(u, p) / area];
            [1.0 - of_b - of_c, of_b, of_c]
        };
        let least = |shares: &[f64; 3]| shares.iter().copied().fold(f64::INFINITY, f64::min);
        let all = self.faces.iter().map(|face| (*face, shares(face)));
        // A triangle without area has no barycentric coordinates.
        let usable = all.filter(|(_, shares)| shares.iter().all(|share| share.is_finite()));
        let best = usable.max_by(|(_, a), (_, b)| least(a).total_cmp(&least(b)));
        best.filter(|(_, shares)| least(shares) > -FLAT).ok_or_else(|| {
            let expected = "a mesh that fills a rectangle";
            Error::invalid(&self.origin, "faces", expected, format!("none at {at:?} m from its corner"))
        })
    }
}

/// The corners of a triangle, and the barycentric coordinates of a point inside.
type Barycentric = ([u32; 3], [f64; 3]);

/// Interpolates positions from a mesh to a grid, linearly within each triangle.
pub(super) struct MeshInterpolation(Vec<Barycentric>);

impl MeshInterpolation {
    /// Returns the positions of the particles, given those of the vertices.
    pub fn apply(&self, vertices: &[[f32; 3]]) -> Vec<[f64; 3]> {
        let interpolate = |(face, shares): &Barycentric| {
            let part = |k: usize, c: usize| shares[k] * f64::from(vertices[face[k] as usize][c]);
            std::array::from_fn(|c| part(0, c) + part(1, c) + part(2, c))
        };
        self.0.iter().map(interpolate).collect()
    }

    /// Converts a trajectory of the vertices to one of the particles of `grid`, for which `self` was built;
    /// without velocities.
    pub fn trajectory(&self, vertices: &Trajectory, grid: Grid) -> Trajectory {
        let mut interpolated = Trajectory::new(grid, vertices.fps());
        for frame in 0..vertices.frames() {
            let positions = self.apply(vertices.frame(frame)).into_iter().map(|p| p.map(|c| c as f32));
            let positions: Vec<[f32; 3]> = positions.collect();
            interpolated.push(&positions, &vec![[0.0; 3]; positions.len()]);
        }
        interpolated
    }
}
