//! Moves the layers of a cloth out of each other.

use super::{Cloth, Grid, Intersection, intersections};
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// Most passes; each moves a particle by up to [`STEP`].
const PASSES: usize = 1000;
/// Longest move of a particle in a pass \[edges\].
const STEP: f64 = 0.2;
/// Length of a gradient at which half of that is moved.
const HALF: f64 = 0.5;
/// Share of the difference to its neighbours' moves that a particle's move loses in a pass.
const SMOOTHING: f64 = 0.2;
/// Passes without fewer intersections after which it gives up.
const PATIENCE: usize = 200;

/// Moves the particles of a cloth so that no edge passes through a triangle ([`intersections`]), all but its handles, and
/// returns whether that succeeded. If not, nothing is changed. `x` are the places of the particles \[edges\],
/// shape \[3, H, W\].
///
/// Where an edge passes through a triangle, the planes of the triangle and of those beside the edge meet in lines. The edge
/// and the triangle move against each other in the direction in which these lines get shorter fastest, so that what
/// has passed through is drawn back over its border (intersection contour minimization: Volino and Magnenat-Thalmann
/// 2006). A start in which a part is wrapped around another in a way that no short move undoes stays as it is.
pub fn untangle(grid: Grid, cloth: &Cloth, x: &mut [f64]) -> bool {
    let n = grid.particles();
    let (faces, held) = (cloth.faces(grid), cloth.held());
    let third = corners_beside(&faces);
    let mut moved = x.to_vec();
    let (mut least, mut waited) = (usize::MAX, 0);
    for _ in 0..PASSES {
        let found = intersections(&faces, &moved);
        if found.is_empty() {
            x.copy_from_slice(&moved);
            return true;
        }
        waited = if found.len() < least { 0 } else { waited + 1 };
        least = least.min(found.len());
        if waited > PATIENCE {
            break;
        }
        let place = |p: u32| DVec3::new(moved[p as usize], moved[n + p as usize], moved[2 * n + p as usize]);
        let mut asked: BTreeMap<usize, (DVec3, f64)> = BTreeMap::new();
        let mut ask = |p: u32, weight: f64, way: DVec3| {
            let (sum, weights) = asked.entry(p as usize).or_default();
            *sum += weight * way;
            *weights += weight;
        };
        for Intersection { edge, face } in found {
            let ends = edge.map(place);
            let corners = faces[face as usize];
            let triangle = corners.map(place);
            let gradient = shortening(ends, triangle, third[&edge].iter().map(|&p| place(p)));
            let way = gradient * (STEP / (gradient.length_squared() + HALF * HALF).sqrt());
            let (share, weights) = crossing(ends, triangle);
            ask(edge[0], 1.0 - share, way);
            ask(edge[1], share, way);
            corners.into_iter().zip(weights).for_each(|(p, weight)| ask(p, weight, -way));
        }
        for p in &held {
            asked.remove(p);
        }
        for (&p, (sum, weights)) in &asked {
            let way = *sum / weights.max(1e-9);
            (0..3).for_each(|c| moved[c * n + p] += way[c]);
        }
        // What has moved takes its neighbours along, so that the sheet stays smooth.
        let around: BTreeSet<usize> =
            asked.keys().flat_map(|&p| grid.ring(p).chain([p])).filter(|p| !held.contains(p)).collect();
        let ways: Vec<f64> = moved.iter().zip(&*x).map(|(moved, x)| moved - x).collect();
        for p in around {
            let count = grid.ring(p).count() as f64;
            for c in 0..3 {
                let mean = grid.ring(p).map(|q| ways[c * n + q]).sum::<f64>() / count;
                moved[c * n + p] += SMOOTHING * (mean - ways[c * n + p]);
            }
        }
    }
    false
}

/// Returns for each edge, its lower particle first, the third corners of the triangles beside it.
fn corners_beside(faces: &[[u32; 3]]) -> BTreeMap<[u32; 2], Vec<u32>> {
    let mut beside: BTreeMap<_, Vec<u32>> = BTreeMap::new();
    for &[a, b, c] in faces {
        for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
            beside.entry([p.min(q), p.max(q)]).or_default().push(r);
        }
    }
    beside
}

/// Returns how to move an edge, and a triangle against it, to shorten the lines in which the triangles beside the edge, with
/// these third corners, meet the other one.
fn shortening([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3], beside: impl Iterator<Item = DVec3>) -> DVec3 {
    let along = (q - p).normalize_or_zero();
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let steepness = along.dot(normal);
    // An edge that grazes the triangle passes through it slowly.
    let steepness = steepness.abs().max(0.1).copysign(steepness);
    beside
        .map(|third| {
            let inward = (third - p).reject_from_normalized(along);
            let line = normal.cross((q - p).cross(third - p)).normalize_or_zero();
            let line = if line.dot(inward) < 0.0 { -line } else { line };
            line - normal * (2.0 * along.dot(line) / steepness)
        })
        .sum()
}

/// Returns where on an edge it meets a triangle, from 0 to 1, and the barycentric coordinates of that point.
fn crossing([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> (f64, [f64; 3]) {
    let normal = (b - a).cross(c - a);
    let (before, after) = (normal.dot(p - a), normal.dot(q - a));
    let share = (before / (before - after)).clamp(0.0, 1.0);
    let share = if share.is_finite() { share } else { 0.5 };
    let at = p + share * (q - p);
    let area = normal.length_squared();
    let of = |u: DVec3, v: DVec3| (normal.dot((u - at).cross(v - at)) / area).clamp(0.0, 1.0);
    (share, if area > 0.0 { [of(b, c), of(c, a), of(a, b)] } else { [1.0 / 3.0; 3] })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holding(handles: &[usize]) -> Cloth {
        Cloth { handles: handles.to_vec(), ..Cloth::default() }
    }

    const GRID: Grid = Grid { h: 20, w: 24 };

    fn field(place: impl Fn(f64, f64) -> DVec3) -> Vec<f64> {
        let all: Vec<_> =
            (0..GRID.particles()).map(|p| place((p / GRID.w) as f64, (p % GRID.w) as f64)).collect();
        (0..3).flat_map(|c| all.iter().map(move |place| place[c])).collect()
    }

    /// A folded sheet whose upper half is `apart(i, j)` above the lower one.
    fn folded(apart: impl Fn(f64, f64) -> f64) -> Vec<f64> {
        field(|i, j| {
            let beyond = j - 11.5;
            let upper = f64::from(u8::from(beyond > 0.0));
            DVec3::new(12.0 - beyond.abs() + 0.3 * upper, i + 0.4 * upper, apart(i, j) * upper)
        })
    }

    /// Returns the largest stretch of an edge, the largest move, and whether it succeeded.
    fn untangled(mut x: Vec<f64>, held: &[usize]) -> (f64, f64, bool) {
        let (before, n) = (x.clone(), GRID.particles());
        assert!(!intersections(&GRID.faces(), &x).is_empty());
        let succeeded = untangle(GRID, &holding(held), &mut x);
        assert_eq!(succeeded, intersections(&GRID.faces(), &x).is_empty());
        let place = |x: &[f64], p: u32| DVec3::new(x[p as usize], x[n + p as usize], x[2 * n + p as usize]);
        let edges = corners_beside(&GRID.faces());
        let length = |x: &[f64], [p, q]: [u32; 2]| (place(x, p) - place(x, q)).length();
        let stretch = edges.keys().map(|&edge| (length(&x, edge) - length(&before, edge)).abs());
        let off = (0..n as u32).map(|p| (place(&x, p) - place(&before, p)).length());
        for &p in held {
            assert_eq!(place(&x, p as u32), place(&before, p as u32));
        }
        (stretch.fold(0.0, f64::max), off.fold(0.0, f64::max), succeeded)
    }

    #[test]
    fn what_pokes_through_is_drawn_back() {
        let cases: [(&str, Vec<f64>); 4] = [
            ("a corner", folded(|i, j| 0.5 - 0.3 * (i + j - 35.0).max(0.0))),
            ("a border", folded(|_, j| 0.5 - 0.4 * (j - 20.0).max(0.0))),
            ("a bump", folded(|i, j| 0.5 - 1.2 * (-0.3 * ((i - 9.0).powi(2) + (j - 17.0).powi(2))).exp())),
            ("a wave", folded(|i, _| 0.1 + 0.3 * (i / 3.0).sin())),
        ];
        for (what, x) in cases {
            let (stretch, off, succeeded) = untangled(x, &[0, 5]);
            println!("{what}: edges differ by {stretch:.2}, moved by {off:.2}");
            assert!(succeeded && stretch < 0.6 && (0.1..2.0).contains(&off), "{what}");
        }
    }

    /// A sheet that is held everywhere cannot be untangled, and one that is not tangled does not move.
    #[test]
    fn what_does_not_succeed_changes_nothing() {
        let mut x = folded(|_, j| 0.5 - 0.4 * (j - 20.0).max(0.0));
        let before = x.clone();
        let held: Vec<usize> = (0..GRID.particles()).collect();
        assert!(!untangle(GRID, &holding(&held), &mut x) && x == before);
        let mut flat = folded(|_, _| 0.5);
        let before = flat.clone();
        assert!(untangle(GRID, &holding(&[]), &mut flat) && flat == before);
    }
}
