//! How near two parts of a cloth are to each other: a particle and a triangle, or two edges.

use super::Grid;
use glam::DVec3;

/// Tolerance of the comparisons that decide which of two neighbouring triangles tells of a border \[edges^2\].
const LEVEL: f64 = 1e-6;
/// Two edges count as parallel if the square of the sine between them is below this.
const PARALLEL: f64 = 1e-6;

/// Two parts of a triangulated grid that share no particle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parts {
    /// A particle, and a triangle as its index into [`Grid::faces`].
    Vertex(usize, usize),
    /// The ends of two edges.
    Edges([usize; 2], [usize; 2]),
}

/// Where two parts are nearest to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// With which weights the places of [`Parts::particles`] make the separation. They sum to 0.
    pub weights: [f64; 4],
    /// The vector from the point of the second part to that of the first.
    pub separation: DVec3,
}

impl Parts {
    /// Returns a particle and a triangle, unless that contains it.
    pub fn vertex(grid: Grid, particle: usize, face: usize) -> Option<Self> {
        (!grid.face(face).contains(&particle)).then_some(Self::Vertex(particle, face))
    }

    /// Returns two edges, unless they meet.
    pub fn edges(first: [usize; 2], second: [usize; 2]) -> Option<Self> {
        (!first.iter().any(|p| second.contains(p))).then_some(Self::Edges(first, second))
    }

    /// Returns the particles: one and the corners of a triangle, or the ends of one edge and those of the other.
    pub fn particles(self, grid: Grid) -> [usize; 4] {
        match self {
            Self::Vertex(p, face) => {
                let [a, b, c] = grid.face(face);
                [p, a, b, c]
            }
            Self::Edges([a, b], [c, d]) => [a, b, c, d],
        }
    }

    /// Returns the distance between the parts, given the places of [`Parts::particles`].
    pub fn distance(self, places: &[DVec3; 4]) -> f64 {
        let [a, b, c, d] = *places;
        match self {
            Self::Vertex(..) => {
                let corners = [b - a, c - a, d - a];
                let weights = nearest_on_triangle(corners);
                corners
                    .into_iter()
                    .zip(weights)
                    .map(|(corner, weight)| weight * corner)
                    .sum::<DVec3>()
                    .length()
            }
            Self::Edges(..) => {
                let (u, v, r) = (b - a, d - c, a - c);
                let (uu, vv, uv) = (u.dot(u), v.dot(v), u.dot(v));
                let along =
                    |top: f64, bottom: f64| if bottom > 0.0 { (top / bottom).clamp(0.0, 1.0) } else { 0.0 };
                // Of parallel edges any point is as good to begin with.
                let first = nearest_on_lines([u, v, r]).map_or(0.0, |[s, _]| s.clamp(0.0, 1.0));
                let t = along(uv * first + v.dot(r), vv);
                let s = along(uv * t - u.dot(r), uu);
                let t = along(uv * s + v.dot(r), vv);
                (r + s * u - t * v).length()
            }
        }
    }

    /// Returns where the parts are nearest. `None` if another pair of parts tells the same: edges that are nearest at an end of
    /// one, and triangles on whose border the nearest point is although a neighbour is nearer, or is the one to tell. `has`
    /// says which particles of the grid the cloth has.
    pub fn nearest(
        self,
        (grid, has): (Grid, impl Fn(usize) -> bool),
        place: impl Fn(usize) -> DVec3,
    ) -> Option<Nearest> {
        match self {
            Self::Vertex(p, face) => {
                let corners = grid.face(face);
                // From the particle: single precision then rounds the separation, not the place.
                let seen = |q: usize| place(q) - place(p);
                let [a, b, c] = nearest_on_triangle(corners.map(seen));
                let separation = -(a * seen(corners[0]) + b * seen(corners[1]) + c * seen(corners[2]));
                let sheet = (grid, &has);
                let tells = match [a, b, c].map(|weight| weight > 0.0) {
                    [true, true, true] => true,
                    [true, false, false] => tells_of_corner(sheet, face, 0, separation, seen),
                    [false, true, false] => tells_of_corner(sheet, face, 1, separation, seen),
                    [false, false, true] => tells_of_corner(sheet, face, 2, separation, seen),
                    [true, true, false] => tells_of_side(sheet, face, 0, separation, seen),
                    [false, true, true] => tells_of_side(sheet, face, 1, separation, seen),
                    [true, false, true] => tells_of_side(sheet, face, 2, separation, seen),
                    [false, false, false] => false,
                };
                tells.then_some(Nearest { weights: [1.0, -a, -b, -c], separation })
            }
            Self::Edges(first, second) => {
                let [a, b] = first.map(&place);
                let [c, d] = second.map(place);
                let (u, v, r) = (b - a, d - c, a - c);
                let [s, t] = nearest_on_lines([u, v, r])?;
                let is_inside = s > 0.0 && s < 1.0 && t > 0.0 && t < 1.0;
                let separation = r + s * u - t * v;
                is_inside.then_some(Nearest { weights: [1.0 - s, s, t - 1.0, -t], separation })
            }
        }
    }
}

/// Returns how far along u and v two lines that begin r apart are nearest to each other; `None` if they are parallel.
fn nearest_on_lines([u, v, r]: [DVec3; 3]) -> Option<[f64; 2]> {
    let (uu, vv, uv) = (u.dot(u), v.dot(v), u.dot(v));
    let (ur, vr) = (u.dot(r), v.dot(r));
    let determinant = uu * vv - uv * uv;
    (determinant > PARALLEL * uu * vv)
        .then(|| [uv * vr - vv * ur, uu * vr - uv * ur].map(|top| top / determinant))
}

/// Returns the barycentric coordinates of the point of a triangle that is nearest to the origin, by the regions of its
/// corners and sides.
fn nearest_on_triangle([a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (-ab.dot(a), -ac.dot(a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (-ab.dot(b), -ac.dot(b));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let of_c = d1 * d4 - d3 * d2;
    if of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let share = d1 / (d1 - d3);
        return [1.0 - share, share, 0.0];
    }
    let (d5, d6) = (-ab.dot(c), -ac.dot(c));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let of_b = d5 * d2 - d1 * d6;
    if of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let share = d2 / (d2 - d6);
        return [1.0 - share, 0.0, share];
    }
    let of_a = d3 * d6 - d5 * d4;
    if of_a <= 0.0 && d4 >= d3 && d5 >= d6 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - share, share];
    }
    let sum = of_a + of_b + of_c;
    [of_a / sum, of_b / sum, of_c / sum]
}

/// Whether a triangle is the one that tells of a point on its side from corner `side` to the next: if the triangle across
/// is not nearer, the one of the two that comes first in its cell.
fn tells_of_side(
    (grid, has): (Grid, &impl Fn(usize) -> bool),
    face: usize,
    side: usize,
    separation: DVec3,
    seen: impl Fn(usize) -> DVec3,
) -> bool {
    match grid.across(face, side).filter(|&(other, _)| grid.cell_of(other).into_iter().all(has)) {
        None => true,
        // Of two triangles with a side in common one is the first of its cell, and the other the second.
        Some((_, other)) => face.is_multiple_of(2) && separation.dot(seen(other) + separation) <= LEVEL,
    }
}

/// Whether a triangle is the one that tells of its corner: if no edge from there leads nearer, one of those around it.
fn tells_of_corner(
    (grid, has): (Grid, &impl Fn(usize) -> bool),
    face: usize,
    corner: usize,
    separation: DVec3,
    seen: impl Fn(usize) -> DVec3,
) -> bool {
    let p = grid.face(face)[corner];
    let w = grid.w;
    let (up, down, left, right) = (p >= w, p + w < grid.particles(), p % w > 0, p % w + 1 < w);
    let whole = |is_there: bool, a: usize| is_there && [a, a + 1, a + w, a + w + 1].into_iter().all(has);
    let after = || whole(down && right, p);
    let above = || whole(up && right, p.wrapping_sub(w));
    let before = || whole(up && left, p.wrapping_sub(w + 1));
    // The first triangle of the cell that begins there, or else of the one above it, or before that; or the second of the
    // one to the left.
    let tells = match (face.is_multiple_of(2), corner) {
        (true, 0) => true,
        (true, 1) => !after(),
        (true, _) => !after() && !above(),
        (false, 2) => !after() && !above() && !before(),
        (false, _) => false,
    };
    let is_joined = |q: usize| match p.abs_diff(q) == w + 1 {
        true => whole(true, p.min(q)),
        false => has(q),
    };
    tells && grid.ring(p).filter(|&q| is_joined(q)).all(|q| separation.dot(seen(q) + separation) <= LEVEL)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(k: usize) -> f64 {
        ((k as f64 * 12.9898).sin() * 43758.5453).fract()
    }

    fn point(k: usize) -> DVec3 {
        DVec3::new(noise(3 * k), noise(3 * k + 1), noise(3 * k + 2))
    }

    #[test]
    fn weights_sum_to_zero_and_make_the_separation() {
        let grid = Grid { h: 8, w: 9 };
        for seed in 0..200 {
            let place = |p: usize| 3.0 * point(100 * seed + p);
            let pairs = [Parts::vertex(grid, 40, 3), Parts::edges([0, 1], [20, 30])];
            for parts in pairs.into_iter().flatten() {
                let Some(Nearest { weights, separation }) = parts.nearest((grid, |_| true), place) else {
                    continue;
                };
                let made: DVec3 =
                    parts.particles(grid).into_iter().zip(weights).map(|(p, w)| w * place(p)).sum();
                assert!((made - separation).length() < 1e-12);
                assert!(weights.iter().sum::<f64>().abs() < 1e-12);
            }
        }
    }

    #[test]
    fn no_sample_of_a_triangle_is_nearer() {
        for seed in 0..300 {
            let corners = [0, 1, 2].map(|k| point(4 * seed + k));
            let at = |[a, b, c]: [f64; 3]| a * corners[0] + b * corners[1] + c * corners[2];
            let least = at(nearest_on_triangle(corners)).length();
            for (s, t) in (0..=20).flat_map(|i| (0..=20 - i).map(move |j| (i as f64 / 20.0, j as f64 / 20.0)))
            {
                assert!(at([1.0 - s - t, s, t]).length() > least - 1e-12);
            }
        }
    }

    /// The triangles of a sheet whose places a particle far along the normal sees, and the distance that they tell.
    fn seen_from(grid: Grid, place: impl Fn(usize) -> DVec3, from: DVec3) -> Vec<f64> {
        // A particle that no triangle nearby contains.
        let observer = grid.particles() - 1;
        let place = |p: usize| if p == observer { from } else { place(p) };
        let faces = 0..2 * (grid.h - 1) * (grid.w - 1);
        let pairs =
            faces.filter_map(|face| Parts::vertex(grid, observer, face)?.nearest((grid, |_| true), place));
        pairs.map(|nearest| nearest.separation.length()).collect()
    }

    #[test]
    fn one_triangle_tells_of_each_point_of_a_sheet() {
        let grid = Grid { h: 8, w: 8 };
        let flat = |p: usize| DVec3::new((p % 8) as f64, (p / 8) as f64, 0.0);
        // Inside of triangles, on sides of each kind, on corners, and beyond the border.
        for at in
            [[2.3, 3.1], [2.0, 3.4], [2.6, 3.0], [2.5, 3.5], [3.0, 3.0], [0.0, 2.0], [0.0, 0.0], [5.0, -0.2]]
        {
            let from = DVec3::new(at[0], at[1], 0.2);
            let expected = DVec3::new(0.0, at[1].min(0.0), 0.2).length();
            let told = seen_from(grid, flat, from);
            assert_eq!(told.len(), 1, "{at:?}: {told:?}");
            assert!((told[0] - expected).abs() < 1e-12);
        }
        // A ridge is told of once, from above; in a valley both sides are.
        for (slope, count) in [(-1.0, 1), (1.0, 2)] {
            let folded = |p: usize| {
                let flat = flat(p);
                flat + DVec3::new(0.0, 0.0, slope * (flat.x - 3.0).abs())
            };
            let told = seen_from(grid, folded, DVec3::new(3.0, 2.5, 0.2));
            assert_eq!(told.len(), count, "{slope}: {told:?}");
        }
    }
}
