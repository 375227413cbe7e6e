//! Cloths that are not a full rectangle, and what each particle of a grid is.

use super::{Cloth, Grid};
use crate::{Error, Result};
use bytemuck::{Pod, Zeroable};
use half::f16;
use std::collections::VecDeque;
use std::sync::Arc;

/// Which particles of a grid a cloth has. The others have no mass, take part in no term of the energy, touch nothing
/// and stay where they start.
///
/// A cloth consists of whole cells: those whose four corners it has. An edge of the grid belongs to it if both ends do, and
/// an angle if both edges do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    grid: Grid,
    /// Shape [H, W].
    inside: Arc<[bool]>,
    /// For each particle the nearest one that the cloth has, itself if that is it; shape [H, W].
    stand_ins: Arc<[u32]>,
}

impl Mask {
    /// Returns the cloth of the whole cells whose corners are all `wanted`, shape [H, W]: particles that belong to no
    /// such cell are left out. Fails if the length is not the grid's, or nothing is left; `origin` names its source.
    pub fn new(grid: Grid, wanted: &[bool], origin: &str) -> Result<Self> {
        if wanted.len() != grid.particles() {
            let expected = format!("{} numbers, a particle each", grid.particles());
            return Err(Error::invalid(origin, "mask", expected, wanted.len()));
        }
        let mut inside = vec![false; grid.particles()];
        for [a, b, c, d] in cells(grid) {
            if [a, b, c, d].iter().all(|&p| wanted[p]) {
                [a, b, c, d].into_iter().for_each(|p| inside[p] = true);
            }
        }
        if !inside.contains(&true) {
            let count = wanted.iter().filter(|&&wanted| wanted).count();
            let expected = format!("a shape that covers at least one cell of the grid of {grid}");
            return Err(Error::invalid(origin, "mask", expected, format!("{count} particles and no cell")));
        }
        let stand_ins = stand_ins(grid, &inside).into();
        Ok(Self { grid, inside: inside.into(), stand_ins })
    }

    /// Returns the grid that it belongs to.
    pub fn grid(&self) -> Grid {
        self.grid
    }

    /// Whether the cloth has particle `p`. Panics if the grid has no such particle.
    pub fn contains(&self, p: usize) -> bool {
        self.inside[p]
    }

    /// Returns which particles the cloth has, shape [H, W].
    pub fn inside(&self) -> &[bool] {
        &self.inside
    }

    /// Returns the triangles of the cloth, as [`Grid::faces`] does those of the whole grid.
    pub fn faces(&self) -> Vec<[u32; 3]> {
        let is_whole = |cell: &[[u32; 3]]| cell.as_flattened().iter().all(|&p| self.contains(p as usize));
        let faces = self.grid.faces();
        faces.chunks_exact(2).filter(|cell| is_whole(cell)).flatten().copied().collect()
    }

    /// Returns the particle of the cloth that is the fewest edges of the grid away from particle `p`. Panics if the grid has
    /// no such particle.
    pub fn nearest(&self, p: usize) -> usize {
        self.stand_ins[p] as usize
    }

    /// Whether the cloth has the cell that begins at particle `p`, which must not be on the far borders.
    fn has_cell(&self, p: usize) -> bool {
        [p, p + 1, p + self.grid.w, p + self.grid.w + 1].iter().all(|&p| self.contains(p))
    }

    /// Returns how many of the four cells around particle `p` the cloth has.
    fn cells_around(&self, p: usize) -> u32 {
        let (Grid { h, w }, i, j) = (self.grid, p / self.grid.w, p % self.grid.w);
        let mut count = 0;
        for (i, j) in [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)] {
            if (1..h).contains(&i) && (1..w).contains(&j) {
                count += u32::from(self.has_cell((i - 1) * w + j - 1));
            }
        }
        count
    }
}

/// Returns for each particle the nearest one inside, along edges of the grid.
fn stand_ins(grid: Grid, inside: &[bool]) -> Vec<u32> {
    const NONE: u32 = u32::MAX;
    let (n, w) = (grid.particles(), grid.w);
    let mut nearest: Vec<u32> = (0..n).map(|p| if inside[p] { p as u32 } else { NONE }).collect();
    let mut reached: VecDeque<usize> = (0..n).filter(|&p| inside[p]).collect();
    while let Some(p) = reached.pop_front() {
        let around = [
            (p >= w).then(|| p - w),
            (p + w < n).then_some(p + w),
            (p % w > 0).then(|| p - 1),
            (p % w + 1 < w).then_some(p + 1),
        ];
        for q in around.into_iter().flatten() {
            if nearest[q] == NONE {
                nearest[q] = nearest[p];
                reached.push_back(q);
            }
        }
    }
    nearest
}

/// Iterates over the corners of the cells of a grid.
fn cells(grid: Grid) -> impl Iterator<Item = [usize; 4]> {
    let Grid { h, w } = grid;
    (1..h).flat_map(move |i| (1..w).map(move |j| i * w + j)).map(move |q| [q - w - 1, q - w, q - 1, q])
}

/// What a particle is, in two words that both devices read. The first holds the number of cells around it, whether it is free,
/// a handle, or no part of the cloth, and whether the cloth has the cell from it to the particle diagonally behind it; the second
/// the factors of its mass and of its stiffness ([`Map`](super::Map)).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Mark {
    word: u32,
    /// In half precision, the density in the lower bits.
    factors: u32,
}

/// How a particle moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// By its acceleration.
    Free,
    /// As the control says: the index of its position in [`Control::handles`](super::Control::handles).
    Handle(usize),
    /// Not at all: it is no part of the cloth ([`Mask`]).
    Outside,
}

impl Mark {
    /// The number of cells around the particle is in the bits from here on.
    const MASS: u32 = 29;
    /// Set if the cloth has the cell from this particle (i, j) to (i + 1, j + 1).
    const CELL: u32 = 1 << (Self::MASS - 1);
    /// The slot: 0 for a free particle, 1 + the index of a handle, or this for none.
    const SLOT: u32 = Self::CELL - 1;
    /// Two factors of 1.
    const EVEN: u32 = 0x3c00_3c00;

    /// Returns the mark of a particle of density and stiffness 1.
    fn new(quarters: u32, begins_cell: bool, role: Role) -> Self {
        let slot = match role {
            Role::Free => 0,
            Role::Handle(k) => k as u32 + 1,
            Role::Outside => Self::SLOT,
        };
        let word = quarters << Self::MASS | if begins_cell { Self::CELL } else { 0 } | slot;
        Self { word, factors: Self::EVEN }
    }

    /// Returns the marks of the particles of one cloth, whose handles have the positions from `first` on.
    pub(super) fn of_cloth(grid: Grid, cloth: &Cloth, first: usize) -> Vec<Self> {
        let Cloth { mask, handles, density, stiffness, .. } = cloth;
        let full = |p: usize| (4.0 * grid.mass(p / grid.w, p % grid.w)) as u32;
        let is_last = |p: usize| p / grid.w + 1 == grid.h || p % grid.w + 1 == grid.w;
        let mark = |p: usize| match mask {
            None => Self::new(full(p), !is_last(p), Role::Free),
            Some(mask) if mask.contains(p) => {
                let has_cell = !is_last(p) && mask.has_cell(p);
                Self::new(mask.cells_around(p), has_cell, Role::Free)
            }
            Some(_) => Self::new(0, false, Role::Outside),
        };
        let mut marks: Vec<Self> = (0..grid.particles()).map(mark).collect();
        for (k, &p) in handles.iter().enumerate() {
            marks[p] =
                Self::new(marks[p].word >> Self::MASS, marks[p].begins_cell(), Role::Handle(first + k));
        }
        if density.is_some() || stiffness.is_some() {
            for (p, mark) in marks.iter_mut().enumerate() {
                let [density, stiffness] = [density, stiffness]
                    .map(|map| map.as_ref().map_or(f16::ONE, |map| map.stored(p)).to_bits());
                mark.factors = u32::from(stiffness) << 16 | u32::from(density);
            }
        }
        marks
    }

    /// Returns how the particle moves.
    #[inline]
    pub fn role(self) -> Role {
        match self.word & Self::SLOT {
            0 => Role::Free,
            Self::SLOT => Role::Outside,
            slot => Role::Handle(slot as usize - 1),
        }
    }

    /// Whether it moves by its acceleration.
    #[inline]
    pub fn is_free(self) -> bool {
        self.word & Self::SLOT == 0
    }

    /// Whether it moves as the control says.
    #[inline]
    pub fn is_handle(self) -> bool {
        !self.is_free() && !self.is_outside()
    }

    /// Whether it is no part of the cloth.
    #[inline]
    pub fn is_outside(self) -> bool {
        self.word & Self::SLOT == Self::SLOT
    }

    /// Whether the cloth has the cell from this particle (i, j) to (i + 1, j + 1).
    #[inline]
    pub fn begins_cell(self) -> bool {
        self.word & Self::CELL != 0
    }

    /// Returns its mass: a quarter of each cell around it, 1 inside a sheet, times its density; 0 outside of the cloth.
    #[inline]
    pub fn mass(self) -> f64 {
        let area = f64::from(self.word >> Self::MASS) / 4.0;
        if self.factors == Self::EVEN { area } else { area * f16::from_bits(self.factors as u16).to_f64() }
    }

    /// Returns the factor of the stiffness at the particle.
    #[inline]
    pub fn stiffness(self) -> f64 {
        match self.factors {
            Self::EVEN => 1.0,
            factors => f16::from_bits((factors >> 16) as u16).to_f64(),
        }
    }

    /// Whether the stiffness at the particle is that of the material.
    pub(crate) fn is_even(self) -> bool {
        self.factors >> 16 == Self::EVEN >> 16
    }
}

#[cfg(test)]
mod tests {
    use super::super::Map;
    use super::*;

    const GRID: Grid = Grid { h: 9, w: 11 };

    fn marks(mask: Option<Mask>, handles: Vec<usize>, first: usize) -> Vec<Mark> {
        Mark::of_cloth(GRID, &Cloth { mask, handles, ..Cloth::default() }, first)
    }

    fn mask(wanted: impl Fn(usize, usize) -> bool) -> Result<Mask> {
        let wanted: Vec<bool> = (0..GRID.particles()).map(|p| wanted(p / GRID.w, p % GRID.w)).collect();
        Mask::new(GRID, &wanted, "a test")
    }

    #[test]
    fn particles_without_a_cell_are_left_out() {
        // A block of 3 x 3 particles, a tail of one edge, and a particle by itself.
        let mask =
            mask(|i, j| (2..5).contains(&i) && (3..6).contains(&j) || i == 3 && j < 8 || (i, j) == (8, 10));
        let mask = mask.unwrap();
        assert_eq!(mask.inside().iter().filter(|&&inside| inside).count(), 9);
        assert_eq!(mask.faces().len(), 8);
        assert_eq!(mask.nearest(0), 2 * GRID.w + 3);
    }

    #[test]
    fn masses_are_those_of_the_cells() {
        let hole = mask(|i, j| (i, j) != (4, 5)).unwrap();
        let masses: Vec<f64> = marks(Some(hole.clone()), vec![0], 0).iter().map(|m| m.mass()).collect();
        assert_eq!(masses.iter().sum::<f64>(), (8 * 10 - 4) as f64);
        assert_eq!([masses[0], masses[4 * GRID.w + 5], masses[4 * GRID.w + 4]], [0.25, 0.0, 0.5]);
        assert_eq!(hole.faces().len(), 2 * (8 * 10 - 4));
    }

    #[test]
    fn a_mask_of_all_particles_changes_no_mark() {
        let all = mask(|_, _| true).unwrap();
        let handles = vec![0, 37];
        assert_eq!(marks(Some(all.clone()), handles.clone(), 5), marks(None, handles, 5));
        assert_eq!(all.faces(), GRID.faces());
    }

    #[test]
    fn marks_tell_roles_apart() {
        for role in [Role::Free, Role::Handle(0), Role::Handle(123_456), Role::Outside] {
            let mark = Mark::new(3, role == Role::Free, role);
            assert_eq!((mark.role(), mark.mass(), mark.begins_cell()), (role, 0.75, role == Role::Free));
            assert_eq!((mark.is_free(), mark.is_outside()), (role == Role::Free, role == Role::Outside));
        }
    }

    #[test]
    fn maps_scale_masses_and_stiffness() {
        let factors: Vec<f64> = (0..GRID.particles()).map(|p| 0.5 + p as f64 / 64.0).collect();
        let map = |factors: &[f64]| Some(Map::new(GRID, factors, "a test", "a map").unwrap());
        let cloth = Cloth { density: map(&factors), handles: vec![3], ..Cloth::default() };
        let heavy = Mark::of_cloth(GRID, &cloth, 0);
        let even = Mark::of_cloth(GRID, &Cloth { handles: vec![3], ..Cloth::default() }, 0);
        for (p, (heavy, even)) in heavy.iter().zip(&even).enumerate() {
            assert_eq!((heavy.mass(), heavy.stiffness()), (factors[p] * even.mass(), 1.0));
            assert_eq!((heavy.role(), heavy.begins_cell()), (even.role(), even.begins_cell()));
        }
        let stiff = Mark::of_cloth(GRID, &Cloth { stiffness: map(&factors), density: None, ..cloth }, 0);
        for (p, stiff) in stiff.iter().enumerate() {
            assert_eq!(
                (stiff.mass(), stiff.stiffness(), stiff.is_even()),
                (even[p].mass(), factors[p], factors[p] == 1.0)
            );
        }
    }

    #[test]
    fn a_mask_that_leaves_nothing_is_refused() {
        let error = mask(|_, j| j % 2 == 0).unwrap_err().to_string();
        assert!(
            error.contains("covers at least one cell") && error.contains("54 particles and no cell"),
            "{error}"
        );
    }
}
