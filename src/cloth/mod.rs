//! The cloth: its grid, its constants ([`Model`]), its state ([`State`]) and what drives a frame ([`Control`]), in
//! grid units. Everything that computes builds on this.

mod body;
mod distance_field;
mod embedding;
mod energy;
mod grid;
mod intersections;
mod mask;
mod model;
pub mod modes;
mod proximity;
mod rest_angles;
pub mod terms;
mod untangle;
mod view;
mod weave;

pub use body::{Body, BodyStats, Distance, LayerStats, MAX_BODIES, MAX_CONTACTS, Pose, Shape, Sweep};
pub use distance_field::{DistanceField, MeshFault};
pub use embedding::Embedding;
pub use energy::EnergyTerms;
pub use grid::{Grid, MAX_GRID, MIN_GRID};
pub(crate) use intersections::Bounds;
pub use intersections::{Intersection, intersections};
pub use mask::{Mark, Mask, Role};
pub(crate) use model::cast;
pub use model::{Air, Cloth, Control, Material, Model, Repulsion, SelfContact, State};
pub use proximity::{Nearest, Parts};
pub use rest_angles::RestAngles;
pub use untangle::untangle;
pub use view::VertexView;
pub use weave::{Map, Weave};
