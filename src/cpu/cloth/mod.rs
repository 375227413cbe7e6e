//! The cloth on the CPU: energies, their gradient, wind and the end of a frame, for one cloth at a time
//! (paper section 3).
//!
//! [`energy()`], [`gradient()`], [`local_model`] and [`Hessian`] are vectorised along rows, with their sums in another order
//! each. What they sum is defined in [`terms`], and [`plain_total`] sums it plainly: the tests check
//! the vectorised forms against it.

mod cells;
mod contacts;
mod couples;
mod curvature;
mod elements;
mod embed;
mod energy;
mod flat_tiles;
mod gradient;
mod hessian;
mod integrate;
mod layers;
mod near_pairs;
mod particles;
mod patch_tree;
mod plain;
mod repulsion;
mod rows;
mod sheet_axes;
mod stretch;
mod touch;
mod vector;
mod vertices;
mod wind;

pub use cells::{Cells, Placed, Walk};
pub use contacts::{Approach, Contacts};
pub use couples::Couples;
pub(super) use curvature::generic_local_model;
pub use curvature::{CurvatureRows, LocalModel, local_model};
pub use elements::Elements;
pub use embed::embed;
pub use energy::energy;
pub(super) use energy::generic_energy;
pub(super) use gradient::generic_gradient;
pub use gradient::{GradientRows, gradient};
pub use hessian::{AFTER, Block, Coupling, Hessian, Projection, neighbours};
pub use integrate::{Frame, end_frame, shifts};
pub use layers::Layers;
pub use near_pairs::NearPairs;
pub(super) use particles::add_own_block;
pub use particles::masses;
pub use plain::{PlainTotal, plain_total};
pub use repulsion::{RepellingPair, repelling_pairs, repulsion, repulsion_curvature};
pub use sheet_axes::{AXES, SheetAxes};
pub use stretch::stretch;
pub use vertices::vertices;
pub use wind::add_wind;

use super::Real;
use crate::cloth::terms::{self, Elastic};
use crate::cloth::{Grid, Mark, Material};
use elements::Element;
use vector::{add, at, sub};

/// One cloth at a trial acceleration: everything that its energy depends on.
#[derive(Clone, Copy)]
pub struct Trial<'a, T> {
    /// The grid.
    pub grid: Grid,
    /// Energy coefficients.
    pub material: Material,
    /// Damping of the stretch of its edges \[frames\].
    pub damping: f64,
    /// Positions at the start of the frame \[edges\], shape [3, H, W].
    pub x: &'a [T],
    /// Displacements of the trial \[edges\], shape [3, H, W]. They are kept separate from `x`: in single
    /// precision a sum would round an edge by the size of the coordinates, and the stiff edges would turn
    /// that into noise in the gradient.
    pub shift: &'a [T],
    /// Trial accelerations [edges / frame^2], shape [3, H, W].
    pub a: &'a [T],
    /// External accelerations [edges / frame^2], shape [3, H, W].
    pub f: &'a [T],
    /// What each particle is, shape [H, W].
    pub marks: &'a [Mark],
    /// Its mass over their number ([`masses`]), shape [H, W].
    pub masses: &'a [T],
    /// The edges and angles that the cloth has, unless it has those of the whole grid, all evenly stiff ([`Elements::of`]).
    pub elements: Option<&'a Elements<T>>,
    /// Which particles may be near each other; they are searched for if that is not known.
    pub near: Option<&'a NearPairs<T>>,
}

impl<'a, T: Real> Trial<'a, T> {
    /// Returns the vector from particle p to q at the trial acceleration.
    #[inline(always)]
    fn edge(&self, p: usize, q: usize) -> [T; 3] {
        let n = self.grid.particles();
        add(sub(at(self.x, n, q), at(self.x, n, p)), sub(at(self.shift, n, q), at(self.shift, n, p)))
    }

    /// Returns the terms of one vertical edge, one horizontal edge, one corner and one bend along either axis.
    fn terms(&self) -> Terms<T> {
        let elastic = Elastic::new(self.grid, self.material, self.damping);
        Terms {
            vertical: T::of(elastic.vertical.factor),
            horizontal: T::of(elastic.horizontal.factor),
            shear: Angle::new(elastic.shear),
            vertical_bend: Angle::new(elastic.vertical_bend),
            horizontal_bend: Angle::new(elastic.horizontal_bend),
        }
    }

    /// Returns how stiff the elements of one kind are that begin in row `i`, shape \[W'\]; `None` if all are as the material.
    fn stiffness(&self, i: usize, element: Element) -> Option<&'a [T]> {
        self.elements.map(|elements| elements.row(i, element))
    }
}

/// The numbers of [`Elastic`] in the precision of the cloth.
struct Terms<T> {
    vertical: T,
    horizontal: T,
    shear: Angle<T>,
    vertical_bend: Angle<T>,
    horizontal_bend: Angle<T>,
}

/// The energy of an angle, `factor (angle - rest)^2`.
#[derive(Clone, Copy)]
struct Angle<T> {
    factor: T,
    rest: T,
    /// Value of `(angle - rest) / sine` for parallel edges. For antiparallel ones it is 0.
    parallel: T,
}

impl<T: Real> Angle<T> {
    fn new(angle: terms::Angle) -> Self {
        Self { factor: T::of(angle.factor), rest: T::of(angle.rest), parallel: T::of(angle.parallel()) }
    }
}
