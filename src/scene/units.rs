//! Conversion between SI units outside and grid units inside.

use super::RepulsionSettings;
use crate::cloth::{Air, Grid, Material, Repulsion, Weave};

/// The axis of a scene's positions, vectors and files that points up. Internally, everything is z up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// y up: (X, Y, Z) is (X, -Z, Y) internally.
    #[default]
    Y,
    /// z up, as internally.
    Z,
}

impl UpAxis {
    /// Rotates a position or vector from these axes to z up.
    pub fn to_z_up(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            UpAxis::Y => [x, -z, y],
            UpAxis::Z => [x, y, z],
        }
    }

    /// Rotates a position or vector from z up to these axes.
    pub fn from_z_up(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            UpAxis::Y => [x, z, -y],
            UpAxis::Z => [x, y, z],
        }
    }

    /// Returns the vector of length `size` that points down in these axes.
    pub fn down(self, size: f64) -> [f64; 3] {
        match self {
            UpAxis::Y => [0.0, -size, 0.0],
            UpAxis::Z => [0.0, 0.0, -size],
        }
    }
}

/// Elastic moduli of a sheet in SI units: the same cloth on every grid.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Moduli {
    /// Stretch modulus Y [N/m].
    pub stretch_modulus: f64,
    /// Shear modulus G [N/m].
    pub shear_modulus: f64,
    /// Bending stiffness D [N m].
    pub bending_stiffness: f64,
    /// How stretch and bend differ between the axes of the grid.
    #[serde(skip_serializing_if = "Weave::is_even")]
    pub weave: Weave,
}

/// Size of the grid units in SI units: the length of an edge, the duration of a frame, and the mass per area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Units {
    /// Rest length l of a grid edge \[m\].
    pub length_m: f64,
    /// Duration T of a frame \[s\].
    pub frame_time_s: f64,
    /// Mass per area rho of the sheet [kg/m^2].
    pub areal_mass_kg_m2: f64,
}

fn scale(v: [f64; 3], by: f64) -> [f64; 3] {
    v.map(|c| c * by)
}

impl Units {
    /// Converts a position from \[m\] to \[edges\].
    pub fn position(&self, m: [f64; 3]) -> [f64; 3] {
        scale(m, 1.0 / self.length_m)
    }

    /// Converts a position from \[edges\] to \[m\].
    pub fn position_m(&self, edges: [f64; 3]) -> [f64; 3] {
        scale(edges, self.length_m)
    }

    /// Converts a velocity from [m/s] to [edges / frame].
    pub fn velocity(&self, m_s: [f64; 3]) -> [f64; 3] {
        scale(m_s, self.frame_time_s / self.length_m)
    }

    /// Converts a velocity from [edges / frame] to [m/s].
    pub fn velocity_m_s(&self, grid: [f64; 3]) -> [f64; 3] {
        scale(grid, self.length_m / self.frame_time_s)
    }

    /// Converts an acceleration from [m/s^2] to [edges / frame^2].
    pub fn acceleration(&self, m_s2: [f64; 3]) -> [f64; 3] {
        scale(m_s2, self.frame_time_s * self.frame_time_s / self.length_m)
    }

    /// Converts an acceleration from [edges / frame^2] to [m/s^2].
    pub fn acceleration_m_s2(&self, grid: [f64; 3]) -> [f64; 3] {
        scale(grid, self.length_m / (self.frame_time_s * self.frame_time_s))
    }

    /// Converts the density [kg/m^3] and drag [N s/m^3] of air to grid units.
    pub fn air(&self, density: f64, drag: f64) -> Air {
        // A force density A v^2 on a cell's mass rho l^2, with A = a l^2 and v = u l / T, is the acceleration
        // density l / rho a u^2 [edges / frame^2]; likewise drag A v is drag T / rho a u.
        Air {
            density: density * self.length_m / self.areal_mass_kg_m2,
            drag: drag * self.frame_time_s / self.areal_mass_kg_m2,
        }
    }

    /// Converts air in grid units to its density [kg/m^3] and drag [N s/m^3]: the inverse of [`Units::air`].
    pub fn air_si(&self, air: Air) -> (f64, f64) {
        let density = air.density * self.areal_mass_kg_m2 / self.length_m;
        (density, air.drag * self.areal_mass_kg_m2 / self.frame_time_s)
    }

    /// Converts repulsion to grid units: an energy per unit mass [m^2/s^2] becomes [edges^2 / frame^2].
    pub fn repulsion(&self, settings: RepulsionSettings) -> Repulsion {
        let edge_per_frame = self.length_m / self.frame_time_s;
        let RepulsionSettings { strength, distance } = settings;
        Repulsion { strength: strength / (edge_per_frame * edge_per_frame), distance }
    }

    /// Returns the grid coefficients that give a sheet on this grid these moduli.
    pub fn material(&self, grid: Grid, moduli: Moduli) -> Material {
        let [y, g, d] = self.moduli_of_unit_coefficients(grid);
        Material {
            stretch: moduli.stretch_modulus / y,
            shear: moduli.shear_modulus / g,
            bend: moduli.bending_stiffness / d,
            weave: moduli.weave,
        }
    }

    /// Returns the moduli that these coefficients give a sheet on this grid.
    pub fn moduli(&self, grid: Grid, material: Material) -> Moduli {
        let [y, g, d] = self.moduli_of_unit_coefficients(grid);
        Moduli {
            stretch_modulus: y * material.stretch,
            shear_modulus: g * material.shear,
            bending_stiffness: d * material.bend,
            weave: material.weave,
        }
    }

    /// Converts an energy in grid units (a term of `L`, paper section 3.2, which is a mean over the
    /// `particles` of a cloth) to joules.
    pub fn energy_j(&self, energy: f64, particles: usize) -> f64 {
        // The inertia term 1/2 mean(M |a|^2) is 1/2 sum(m |a|^2) T^2 with m = M rho l^2 and a in l / T^2.
        let Units { length_m: l, frame_time_s: t, areal_mass_kg_m2: rho } = *self;
        energy * particles as f64 * rho * l.powi(4) / (t * t)
    }

    /// Returns Y [N/m], G [N/m] and D [N m] for the coefficients (1, 1, 1): 2 rho l^2 / T^2, 8 rho l^2 / T^2 and
    /// 2 rho l^4 / T^2, times what the energy's means make of them. It averages stretch over H - 1 of H rows, and W
    /// columns of edges stand side by side in a sheet as wide as W - 1 cells; likewise along the rows. Bends are
    /// averaged over all particles, so only the number of columns or rows side by side counts: W for bends along a
    /// column, H along a row, of which there is one coefficient, their geometric mean.
    fn moduli_of_unit_coefficients(&self, Grid { h, w }: Grid) -> [f64; 3] {
        let Units { length_m: l, frame_time_s: t, areal_mass_kg_m2: rho } = *self;
        let membrane = rho * l * l / (t * t);
        let beside = |count: usize| count as f64 / (count - 1) as f64;
        let both = beside(h) * beside(w);
        [2.0 * membrane * both, 8.0 * membrane, 2.0 * membrane * l * l * both.sqrt()]
    }
}
