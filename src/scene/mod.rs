//! Scenes: what is simulated, in SI units, and how it becomes a [`Setup`] in grid units.

mod array;
mod authors;
mod file;
mod handles;
mod json;
mod motion;
mod obj;
mod setup;
mod start;
mod surface;
mod units;

pub use handles::{Handles, Placement};
pub use motion::{BuiltIn, Motion};
pub use setup::{Batch, Setup};
pub use start::{Start, StartFile, Transform};
pub use units::{Moduli, Units, UpAxis};

use crate::sim::{Grid, Material};
use crate::{Error, Result};

/// Gravity of a scene that does not say [m/s^2].
const GRAVITY_M_S2: f64 = 9.8;
/// How far the sides may be from square cells: more than rounding, less than one edge in any grid below 1000.
const SQUARE: f64 = 1e-3;

/// Lengths of the sheet's sides [m]. One rest length serves both directions, so cells are square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Side {
    /// The side along the height; the width follows from the grid.
    Height(f64),
    /// The sides along the height and the width, which must make cells square to 0.1 %.
    Both([f64; 2]),
}

impl Side {
    /// The side along the height [m].
    pub fn height(self) -> f64 {
        match self {
            Side::Height(height) | Side::Both([height, _]) => height,
        }
    }
}

/// Mass of the sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mass {
    /// Of the whole sheet [kg].
    Total(f64),
    /// By area [kg/m^2].
    Areal(f64),
}

impl Default for Mass {
    fn default() -> Self {
        Mass::Areal(0.187)
    }
}

impl Mass {
    /// Keeps the mass by area when the area becomes `ratio` times as large.
    fn scale_area(&mut self, ratio: f64) {
        if let Mass::Total(kg) = self {
            *kg *= ratio;
        }
    }
}

/// How stiff the sheet is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stiffness {
    /// Coefficients of the energy in grid units, used as they are: a finer grid is then a softer cloth.
    Grid(Material),
    /// Moduli in SI units: the same cloth on every grid.
    Moduli(Moduli),
}

impl Default for Stiffness {
    fn default() -> Self {
        Stiffness::Grid(Material::default())
    }
}

impl Stiffness {
    /// The coefficients of the energy.
    fn in_grid_units(self, units: &Units) -> Material {
        match self {
            Stiffness::Grid(material) => material,
            Stiffness::Moduli(moduli) => units.material(moduli),
        }
    }
}

/// The air and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wind {
    /// Velocity [m/s] in the scene's axes.
    pub velocity: [f64; 3],
    /// Density [kg/m^3]: resistance to motion across the sheet. 0 for a vacuum.
    pub density: f64,
    /// Drag [N s/m^3]: resistance to motion along the sheet.
    pub drag: f64,
}

impl Default for Wind {
    /// Still air of density 1 without drag, as in the reference data.
    fn default() -> Self {
        Self { velocity: [0.0; 3], density: 1.0, drag: 0.0 }
    }
}

/// A cloth, what acts on it and how its handles move, in SI units and the scene's axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Particles along the height and the width.
    pub grid: Grid,
    /// Side lengths [m].
    pub side_m: Side,
    /// Mass of the sheet.
    pub mass: Mass,
    /// Stiffness of the sheet.
    pub stiffness: Stiffness,
    /// Gravity [m/s^2].
    pub gravity: [f64; 3],
    /// The air.
    pub wind: Wind,
    /// Time of a frame [s].
    pub frame_time_s: f64,
    /// Number of frames, the start included; none for as many as the motion takes.
    pub frames: Option<usize>,
    /// Where the cloth starts, at rest.
    pub start: Start,
    /// The particles whose positions are given.
    pub handles: Handles,
    /// How the handles move.
    pub motion: Motion,
    /// How many times faster than recorded the motion is played; linear in time, so 2 takes half the frames.
    pub speed: f64,
    /// The axis that points up in this scene's vectors and files.
    pub up: UpAxis,
    /// Where the scene comes from, for errors.
    pub origin: String,
}

impl Default for Scene {
    /// The scene that the command runs: a square of 1 m on a 32x32 grid swings through `xy_v2` from its settled drape.
    fn default() -> Self {
        let up = UpAxis::Y;
        Self {
            grid: Grid { h: 32, w: 32 },
            side_m: Side::Height(1.0),
            mass: Mass::default(),
            stiffness: Stiffness::default(),
            gravity: up.down(GRAVITY_M_S2),
            wind: Wind::default(),
            frame_time_s: 1.0 / 60.0,
            frames: None,
            start: Start::default(),
            handles: Handles::Placement(Placement::Corners),
            motion: BuiltIn::named("xy_v2").map_or(Motion::Still, Motion::BuiltIn),
            speed: 1.0,
            up,
            origin: "scene".to_owned(),
        }
    }
}

impl Scene {
    /// Checks all numbers that need no file, and gives the units that follow from them.
    fn check(&self) -> Result<Units> {
        let grid = Grid::new(self.grid.h, self.grid.w, &self.origin)?;
        let height = self.side_m.height();
        self.positive("side_m", height)?;
        let length_m = height / (grid.h - 1) as f64;
        let width = length_m * (grid.w - 1) as f64;
        if let Side::Both([_, given]) = self.side_m {
            self.positive("side_m", given)?;
            if (given - width).abs() > SQUARE * width {
                let expected =
                    format!("a width of {width:.6} m: square cells on a {grid} grid {height} m high");
                return Err(Error::invalid(&self.origin, "side_m", expected, format!("{given} m")));
            }
        }
        let areal_mass_kg_m2 = match self.mass {
            Mass::Total(kg) => self.positive("mass_kg", kg)? / (height * width),
            Mass::Areal(kg_m2) => kg_m2,
        };
        self.positive("areal_mass_kg_m2", areal_mass_kg_m2)?;
        self.positive("frame_time_s", self.frame_time_s)?;
        self.positive("speed", self.speed)?;
        self.check_stiffness()?;
        self.not_negative("wind.density", self.wind.density)?;
        self.not_negative("wind.drag", self.wind.drag)?;
        for (field, vector) in [("gravity", self.gravity), ("wind.velocity", self.wind.velocity)] {
            if vector.iter().any(|c| !c.is_finite()) {
                return Err(Error::invalid(&self.origin, field, "finite numbers", format!("{vector:?}")));
            }
        }
        if self.frames == Some(0) {
            return Err(Error::invalid(&self.origin, "frames", "1 or more", 0));
        }
        Ok(Units { length_m, frame_time_s: self.frame_time_s, areal_mass_kg_m2 })
    }

    fn check_stiffness(&self) -> Result<()> {
        let fields = match self.stiffness {
            Stiffness::Grid(m) => [("stretch", m.stretch), ("shear", m.shear), ("bend", m.bend)],
            Stiffness::Moduli(m) => [
                ("stretch_modulus", m.stretch_modulus),
                ("shear_modulus", m.shear_modulus),
                ("bending_stiffness", m.bending_stiffness),
            ],
        };
        fields.iter().try_for_each(|(name, value)| self.not_negative(&format!("material.{name}"), *value))
    }

    fn positive(&self, field: &str, value: f64) -> Result<f64> {
        if value.is_finite() && value > 0.0 {
            return Ok(value);
        }
        Err(Error::invalid(&self.origin, field, "a finite number above 0", value))
    }

    fn not_negative(&self, field: &str, value: f64) -> Result<()> {
        if value.is_finite() && value >= 0.0 {
            return Ok(());
        }
        Err(Error::invalid(&self.origin, field, "a finite number, 0 or more", value))
    }
}
