//! Visibility: the nearest triangle or marker at each sample of a picture.

use glam::{Vec2, Vec3, vec2, vec3};

/// A depth buffer: for each sample, the number of the nearest object, or [`NOTHING`].
pub(super) struct DepthBuffer {
    pub width: usize,
    pub height: usize,
    /// Number of the object seen, row by row.
    pub seen: Vec<u32>,
    /// Reciprocal of its distance [1/m].
    nearness: Vec<f32>,
    /// Number of samples that triangles may still visit.
    budget: usize,
}

/// How often triangles may visit each sample, on average. A cloth folded many times needs a few visits. One
/// that has burst into triangles as large as the picture would take minutes, so triangles beyond the budget
/// are not drawn.
const VISITS: usize = 16;

/// Marks a sample without an object.
pub(super) const NOTHING: u32 = u32::MAX;

/// Returns twice the signed area of a triangle in the picture; positive if it runs counter-clockwise as seen,
/// y down.
fn area(a: Vec3, b: Vec3, x: f32, y: f32) -> f32 {
    (b.y - a.y) * (x - a.x) - (b.x - a.x) * (y - a.y)
}

impl DepthBuffer {
    pub fn new(width: usize, height: usize) -> Self {
        let samples = width * height;
        Self {
            width,
            height,
            seen: vec![NOTHING; samples],
            nearness: vec![0.0; samples],
            budget: VISITS * samples,
        }
    }

    /// Returns the samples along one axis whose centres lie between two coordinates.
    fn span(low: f32, high: f32, n: usize) -> std::ops::Range<usize> {
        // Casts saturate, so coordinates far outside the picture are harmless.
        (low - 0.5).ceil().max(0.0) as usize..((high - 0.5).floor() + 1.0).clamp(0.0, n as f32) as usize
    }

    fn put(&mut self, x: usize, y: usize, object: u32, nearness: f32) {
        let at = y * self.width + x;
        if nearness > self.nearness[at] {
            self.nearness[at] = nearness;
            self.seen[at] = object;
        }
    }

    /// Draws a triangle given its projected corners (picture coordinates and distance); both sides are
    /// visible.
    pub fn triangle(&mut self, object: u32, [a, b, c]: [Vec3; 3]) {
        let whole = area(a, b, c.x, c.y);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        // Written so that NaN fails.
        if !(whole.abs() > 1e-6 && low.z > 0.0 && high.is_finite()) {
            return;
        }
        let (near_a, near_b, near_c) = (1.0 / (a.z * whole), 1.0 / (b.z * whole), 1.0 / (c.z * whole));
        let sign = whole.signum();
        let (columns, rows) = (Self::span(low.x, high.x, self.width), Self::span(low.y, high.y, self.height));
        let Some(left) = self.budget.checked_sub(columns.len() * rows.len()) else { return };
        self.budget = left;
        for y in rows {
            for x in columns.clone() {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let (u, v, w) = (area(b, c, px, py), area(c, a, px, py), area(a, b, px, py));
                if (sign * u).min(sign * v).min(sign * w) >= 0.0 {
                    self.put(x, y, object, u * near_a + v * near_b + w * near_c);
                }
            }
        }
    }

    /// Draws what lies within a rectangle of the picture, given by two corners. `distance` returns how far away it is at
    /// a point.
    pub fn solid(&mut self, object: u32, [low, high]: [Vec2; 2], distance: impl Fn(Vec2) -> Option<f32>) {
        for y in Self::span(low.y, high.y, self.height) {
            for x in Self::span(low.x, high.x, self.width) {
                if let Some(distance) = distance(vec2(x as f32 + 0.5, y as f32 + 0.5)) {
                    self.put(x, y, object, 1.0 / distance);
                }
            }
        }
    }

    /// Draws a disc about a projected centre.
    pub fn disc(&mut self, object: u32, centre: Vec3, radius: f32) {
        if !(centre.is_finite() && centre.z > 0.0) {
            return;
        }
        for y in Self::span(centre.y - radius, centre.y + radius, self.height) {
            for x in Self::span(centre.x - radius, centre.x + radius, self.width) {
                let (dx, dy) = (x as f32 + 0.5 - centre.x, y as f32 + 0.5 - centre.y);
                if dx * dx + dy * dy <= radius * radius {
                    self.put(x, y, object, 1.0 / centre.z);
                }
            }
        }
    }
}

/// Returns the perspective-correct weights of the corners of a triangle at a point of the picture.
pub(super) fn weights([a, b, c]: [Vec3; 3], x: f32, y: f32) -> Vec3 {
    let w = vec3(area(b, c, x, y) / a.z, area(c, a, x, y) / b.z, area(a, b, x, y) / c.z);
    w / w.element_sum()
}

/// Whether the visible side of a triangle is the one from which its corners run counter-clockwise.
pub(super) fn is_front([a, b, c]: [Vec3; 3]) -> bool {
    area(a, b, c.x, c.y) > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_of_two_triangles_is_covered_once_and_the_nearer_wins() {
        let mut s = DepthBuffer::new(20, 10);
        let p = |x, y, z| vec3(x, y, z);
        s.triangle(0, [p(2.0, 2.0, 1.0), p(12.0, 2.0, 1.0), p(12.0, 8.0, 1.0)]);
        s.triangle(1, [p(2.0, 2.0, 1.0), p(12.0, 8.0, 1.0), p(2.0, 8.0, 1.0)]);
        assert_eq!(s.seen.iter().filter(|&&t| t != NOTHING).count(), 60);
        s.triangle(2, [p(-50.0, -50.0, 2.0), p(90.0, -50.0, 2.0), p(5.0, 90.0, 2.0)]);
        assert_eq!(s.seen.iter().filter(|&&t| t < 2).count(), 60);
        s.disc(3, p(7.0, 5.0, 0.5), 1.1);
        assert_eq!(s.seen[5 * 20 + 7], 3);
    }

    #[test]
    fn impossible_corners_are_left_out() {
        let mut s = DepthBuffer::new(4, 4);
        for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY] {
            s.triangle(0, [vec3(bad, 0.0, 1.0), vec3(4.0, 0.0, 1.0), vec3(0.0, 4.0, 1.0)]);
            s.triangle(0, [vec3(0.0, 0.0, bad), vec3(4.0, 0.0, 1.0), vec3(0.0, 4.0, 1.0)]);
            s.disc(0, vec3(bad, 0.0, 1.0), 2.0);
        }
        s.triangle(0, [vec3(0.0, 0.0, -1.0), vec3(4.0, 0.0, 1.0), vec3(0.0, 4.0, 1.0)]);
        assert!(s.seen.iter().all(|&t| t == NOTHING));
        s.triangle(0, [vec3(-1e30, -1e30, 1.0), vec3(1e30, -1e30, 1.0), vec3(0.0, 1e30, 1.0)]);
    }

    #[test]
    fn a_burst_cloth_does_not_take_forever() {
        let mut s = DepthBuffer::new(8, 8);
        for k in 0..100 {
            let z = 2.0 - k as f32 / 100.0;
            s.triangle(k, [vec3(-9.0, -9.0, z), vec3(30.0, -9.0, z), vec3(-9.0, 30.0, z)]);
        }
        assert!(s.seen.iter().all(|&seen| seen == VISITS as u32 - 1));
    }
}
