//! How a cloth is shown.

/// The transform and the time at which [`Vertices`](crate::sim::Vertices) shows the cloths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexView {
    /// Rows of the affine transform `[A | c]` from positions \[edges\], z up, to vertices. A mirroring
    /// transform reverses the winding of the triangles, and with it the normals.
    pub transform: [[f32; 4]; 3],
    /// Time between the previous frame (0) and the current one (1), for a host with another frame rate.
    pub time: f32,
}

impl Default for VertexView {
    /// Returns the identity transform, at the end of the frame.
    fn default() -> Self {
        Self { transform: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], time: 1.0 }
    }
}

impl VertexView {
    /// Returns the view as the kernel reads it, shape [4, 4].
    pub fn to_rows(&self) -> [[f32; 4]; 4] {
        let [a, b, c] = self.transform;
        [a, b, c, [self.time, 0.0, 0.0, 0.0]]
    }
}
