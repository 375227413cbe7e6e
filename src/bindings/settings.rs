//! The choice of a solver and a device by name.

use crate::cloth::Grid;
use crate::gpu::Storage;
use crate::network::Weights;
use crate::scene::Scene;
use crate::sim::Optimizer;
use crate::{DeviceChoice, DeviceKind, Error, Result, Simulation, SimulationOptions};
use std::path::{Path, PathBuf};

/// Names of the solvers, those that a user needs first in front.
const SOLVERS: [&str; 9] = [
    "fnopt",
    "spectral",
    "newton",
    "fnopt-paper",
    "quasi-newton",
    "quasi-newton-exact",
    "lbfgs",
    "adam",
    "gd",
];

/// The most iterations of a frame.
const MOST_ITERATIONS: usize = 100_000;

/// Returns all solvers, each under its name.
pub(crate) fn solvers() -> Result<Vec<Optimizer>> {
    let weights = std::sync::Arc::new(Weights::shipped());
    let named = |name: &&str| match *name {
        "fnopt" => Ok(Optimizer::learned(weights.clone())),
        "fnopt-paper" => Ok(Optimizer::paper(weights.clone())),
        name => Optimizer::named(name, "solver", || Ok(Weights::shipped())),
    };
    SOLVERS.iter().map(named).collect()
}

/// What computes a simulation.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    /// Name of the solver.
    pub solver: String,
    /// Iterations per frame; `None` for what suits the solver.
    pub iterations: Option<usize>,
    /// Weights of the learned solvers; `None` for those that ship.
    pub checkpoint: Option<PathBuf>,
    /// `auto`, `cpu` or `gpu`.
    pub device: String,
    /// Part of the name of an adapter, or its index.
    pub adapter: Option<String>,
    /// How a GPU stores the network: `f32` or `f16`.
    pub precision: String,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            solver: "fnopt".into(),
            iterations: None,
            checkpoint: None,
            device: "auto".into(),
            adapter: None,
            precision: "f32".into(),
        }
    }
}

impl Settings {
    /// Returns the optimizer, with its weights read and checked.
    pub fn optimizer(&self) -> Result<Optimizer> {
        let weights = || self.checkpoint.as_deref().map_or_else(|| Ok(Weights::shipped()), Weights::load);
        let optimizer = Optimizer::named(&self.solver, "solver", weights)?;
        match &self.checkpoint {
            Some(path) if optimizer.weights().is_none() => {
                let expected = format!("none with the solver {}", self.solver);
                Err(Error::invalid("checkpoint", "weights", expected, path.display()))
            }
            _ => Ok(optimizer),
        }
    }

    /// Returns the iterations per frame of the optimizer.
    pub fn iterations(&self, optimizer: &Optimizer) -> Result<usize> {
        match self.iterations {
            Some(n) if !(1..=MOST_ITERATIONS).contains(&n) => {
                Err(Error::invalid("solver", "iterations", format!("1 to {MOST_ITERATIONS}"), n))
            }
            given => Ok(given.unwrap_or(optimizer.default_iterations())),
        }
    }

    /// Returns the choice of a device.
    pub fn device(&self) -> Result<DeviceChoice> {
        let storage = match &*self.precision {
            "f32" => Storage::F32,
            "f16" => Storage::F16,
            name => return Err(Error::unknown("precision", "precision", name, ["f32", "f16"])),
        };
        let kind = DeviceKind::named(&self.device)?;
        Ok(DeviceChoice { kind, adapter: self.adapter.clone(), storage, process: 0 })
    }

    /// Fails, naming the weights, if the grid is too small for the network of the optimizer.
    pub fn check_grid(&self, optimizer: &Optimizer, grid: Grid) -> Result<()> {
        let file = self.checkpoint.as_deref().map(|path| path.display().to_string());
        let origin = file.unwrap_or_else(|| "the shipped weights".into());
        optimizer.weights().map_or(Ok(()), |weights| weights.config.check_grid(grid, &origin, "grid"))
    }

    /// Sets up the scenes, whose cloths advance together, `copies` of each.
    pub fn simulation(&self, scenes: &[&Scene], copies: usize) -> Result<Simulation> {
        let optimizer = self.optimizer()?;
        let iterations = Some(self.iterations(&optimizer)?);
        scenes.iter().try_for_each(|scene| self.check_grid(&optimizer, scene.grid))?;
        Simulation::of(scenes, &optimizer, &SimulationOptions { iterations, device: self.device()?, copies })
    }
}

/// Returns a path that is valid wherever the report is read.
pub(super) fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}
