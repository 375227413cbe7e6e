//! The camera: it circles a point and looks at it. Metres, z up.

use fnopt::glam::dcamera::rh::{proj::directx::perspective, view::look_at_mat4};
use fnopt::glam::{DMat4, DVec2, DVec3};

/// The angle between the middle of the canvas and its nearer pair of edges.
const HALF_FIELD: f64 = 0.35;
/// The camera stays this far from looking straight up or down.
const STEEPEST: f64 = 1.5;

/// A camera.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    centre: DVec3,
    /// Radius of the ball around the centre that fills the canvas.
    radius: f64,
    /// How many times nearer than that it is.
    zoom: f64,
    /// Its direction from the centre: around the vertical, and above the horizontal.
    turn: f64,
    rise: f64,
    /// Width of the canvas by its height.
    pub aspect: f64,
}

impl Camera {
    /// Returns a camera that sees all of these points, of which there is at least one.
    pub fn on(points: impl Iterator<Item = DVec3> + Clone, aspect: f64) -> Self {
        let low = points.clone().fold(DVec3::INFINITY, DVec3::min);
        let high = points.fold(DVec3::NEG_INFINITY, DVec3::max);
        let (centre, radius) = ((low + high) / 2.0, (high - low).length() / 2.0);
        Self { centre, radius: radius.max(0.1), zoom: 1.2, turn: 2.6, rise: 0.3, aspect }
    }

    /// Circles the centre by these angles \[rad\].
    pub fn orbit(&mut self, turn: f64, rise: f64) {
        self.turn = (self.turn + turn) % std::f64::consts::TAU;
        self.rise = (self.rise + rise).clamp(-STEEPEST, STEEPEST);
    }

    /// Comes nearer by this factor.
    pub fn zoom(&mut self, factor: f64) {
        self.zoom = (self.zoom * factor).clamp(0.2, 20.0);
    }

    /// Returns the radius of the ball that it was made to see.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Returns the direction from the centre to the camera.
    pub fn outward(&self) -> DVec3 {
        let ((sin, cos), (up, level)) = (self.turn.sin_cos(), self.rise.sin_cos());
        DVec3::new(level * cos, level * sin, up)
    }

    /// Returns its directions to the right and upwards on the canvas.
    pub fn axes(&self) -> [DVec3; 2] {
        let right = DVec3::Z.cross(self.outward()).normalize();
        [right, self.outward().cross(right)]
    }

    fn distance(&self) -> f64 {
        self.radius / HALF_FIELD.sin() / self.zoom
    }

    fn eye(&self) -> DVec3 {
        self.centre + self.distance() * self.outward()
    }

    /// Returns the tangent of the angle between the middle of the canvas and its upper edge.
    fn half_height(&self) -> f64 {
        HALF_FIELD.tan() / self.aspect.min(1.0)
    }

    /// Returns the matrix to clip space.
    pub fn clip(&self) -> DMat4 {
        let (near, far) = (0.02 * self.distance(), self.distance() + 20.0 * self.radius);
        let angle = 2.0 * self.half_height().atan();
        perspective(angle, self.aspect, near, far) * look_at_mat4(self.eye(), self.centre, DVec3::Z)
    }

    /// Returns where a point is on the canvas, as parts of its width from the left and of its height from above; `None`
    /// behind the camera.
    pub fn place(&self, p: DVec3) -> Option<DVec2> {
        let clip = self.clip() * p.extend(1.0);
        (clip.w > 0.0).then(|| DVec2::new(0.5 + 0.5 * clip.x / clip.w, 0.5 - 0.5 * clip.y / clip.w))
    }

    /// Returns the point at such a place of the canvas in the plane through `through` that faces the camera.
    pub fn point(&self, at: DVec2, through: DVec3) -> DVec3 {
        let [right, up] = self.axes();
        let half = self.half_height();
        let across = DVec2::new((2.0 * at.x - 1.0) * half * self.aspect, (1.0 - 2.0 * at.y) * half);
        let depth = (self.eye() - through).dot(self.outward());
        self.eye() + depth * (across.x * right + across.y * up - self.outward())
    }
}
