//! The vertices that are marked in pictures.

/// Vertices to mark in pictures, such as handles, which may change from frame to frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Marks {
    /// The first frame with them, in order, and the vertices.
    from: Vec<(usize, Vec<usize>)>,
}

impl Marks {
    /// Marks these vertices from `frame` on in place of others. Frames are given in order.
    pub fn change(&mut self, frame: usize, vertices: &[usize]) {
        self.from.push((frame, vertices.to_vec()));
    }

    /// Returns the vertices to mark in a frame.
    pub(super) fn at(&self, frame: usize) -> &[usize] {
        self.from.iter().rfind(|from| from.0 <= frame).map_or(&[], |from| &from.1)
    }

    /// Returns the vertices of all frames.
    pub(super) fn all(&self) -> impl Iterator<Item = usize> {
        self.from.iter().flat_map(|from| from.1.iter().copied())
    }
}

impl From<&[usize]> for Marks {
    /// Marks the same vertices in every frame.
    fn from(vertices: &[usize]) -> Self {
        Self { from: vec![(0, vertices.to_vec())] }
    }
}

impl From<&Vec<usize>> for Marks {
    fn from(vertices: &Vec<usize>) -> Self {
        vertices[..].into()
    }
}

impl<const N: usize> From<&[usize; N]> for Marks {
    fn from(vertices: &[usize; N]) -> Self {
        vertices[..].into()
    }
}
