//! Pictures of a cloth: a small software rasteriser, so that every run can show its result on any machine.
//!
//! [`strip()`] draws frames side by side, and [`write_gif`] an animation. Both show the whole trajectory from
//! one fixed [`View`]. The cloth is petrol blue in front and sand at the back, handles are orange spheres,
//! [`Bodies`] are grey, and a soft shadow lies on the floor. Vertices that are not finite are left out, along with
//! their triangles. [`charts`] draws curves.

mod animation;
mod body;
mod camera;
mod chart;
mod error_map;
mod film;
mod image;
mod look;
mod marks;
mod notes;
mod palette;
mod shade;
mod shadow;
mod stage;
mod strip;
mod surface;
mod text;

pub use animation::{GifOptions, write_gif};
pub use body::Bodies;
pub use camera::View;
pub use chart::{Chart, Curve, Line, Scale, charts};
pub use error_map::{ErrorMap, error_maps};
pub use film::Film;
pub use image::{Image, write_png};
pub use marks::Marks;
pub use strip::{StripOptions, strip};

/// What the viewer shares with pictures.
#[cfg(feature = "view")]
pub(crate) mod shared {
    pub(crate) use super::camera::{Camera, TANGENT};
    pub(crate) use super::shade::{BACK, BACKGROUND, BODY, FRONT, HANDLE, Lights, PLANE, fields_per_edge};
    pub(crate) use super::stage::MARKER;
    pub(crate) use super::text::FONT;
}
