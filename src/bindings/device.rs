//! The choice of a solver and a device by name.

use crate::cloth::{Grid, Model};
use crate::gpu::{AdapterChoice, Context, Storage, Tuning};
use crate::network::Weights;
use crate::sim::Optimizer;
use crate::{Device, Error, Result, Simulator};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

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

/// Contexts that are open, so that the simulations of a process share a device and its compiled kernels; `None` where there is
/// no such adapter, which takes a while to find out.
static OPENED: Mutex<BTreeMap<String, Option<Context>>> = Mutex::new(BTreeMap::new());

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

    /// Creates the simulator, on the device that it also returns. If `auto` chose a GPU that is not up to it, falls back to
    /// the CPU, except in f16, which the CPU lacks.
    pub fn simulator(&self, model: &Model, optimizer: &Optimizer) -> Result<(Simulator, Device)> {
        let iterations = self.iterations(optimizer)?;
        self.check_grid(optimizer, model.grid)?;
        let half = self.half()?;
        let (device, falls_back) = self.open(optimizer)?;
        let device = match device {
            Device::Gpu(context) if half => Device::Gpu(context.with_storage(Storage::F16)?),
            Device::Cpu if half => {
                let expected = format!("f32 on {}", Device::Cpu.name());
                return Err(Error::invalid("precision", "precision", expected, "f16"));
            }
            device => device,
        };
        match Simulator::new(&device, model, optimizer, iterations) {
            Err(Error::Device(why) | Error::Lost(why)) if falls_back && !half => {
                tracing::warn!("the CPU computes what the GPU cannot: {why}");
                Ok((Simulator::new(&Device::Cpu, model, optimizer, iterations)?, Device::Cpu))
            }
            created => {
                let simulator = created?;
                if let Device::Gpu(context) = &device
                    && let Err(error) = context.store_pipelines()
                {
                    tracing::warn!("the next start will be as slow as this one: {error}");
                }
                Ok((simulator, device))
            }
        }
    }

    /// Fails, naming the weights, if the grid is too small for the network of the optimizer.
    fn check_grid(&self, optimizer: &Optimizer, grid: Grid) -> Result<()> {
        let file = self.checkpoint.as_deref().map(|path| path.display().to_string());
        let origin = file.unwrap_or_else(|| "the shipped weights".into());
        optimizer.weights().map_or(Ok(()), |weights| weights.config.check_grid(grid, &origin, "grid"))
    }

    fn half(&self) -> Result<bool> {
        match &*self.precision {
            "f32" => Ok(false),
            "f16" => Ok(true),
            name => Err(Error::unknown("precision", "precision", name, ["f32", "f16"])),
        }
    }

    /// Opens the device. Also returns whether the CPU may take its place.
    fn open(&self, optimizer: &Optimizer) -> Result<(Device, bool)> {
        let context = match (&*self.device, &self.adapter) {
            ("cpu", Some(adapter)) => {
                return Err(Error::invalid("adapter", "adapter", "none with the device cpu", adapter));
            }
            ("cpu", None) => return Ok((Device::Cpu, false)),
            ("auto" | "gpu", Some(adapter)) => {
                opened(adapter, || Context::headless(&AdapterChoice::parse(adapter)).map(Some))?
            }
            ("gpu", None) => opened("", || match Context::hardware(0) {
                Ok(Some(context)) => Ok(Some(context)),
                // Warns of hardware that cannot be opened.
                Ok(None) | Err(_) => Context::headless(&AdapterChoice::Best).map(Some),
            })?,
            ("auto", None) if !optimizer.runs_on_gpu() => None,
            ("auto", None) => match opened("auto hardware", || Context::hardware(0)) {
                Ok(found) => found,
                Err(error) => {
                    tracing::warn!("{error}");
                    None
                }
            },
            (name, _) => return Err(Error::unknown("device", "device", name, ["auto", "cpu", "gpu"])),
        };
        let falls_back = self.device == "auto" && self.adapter.is_none();
        Ok((context.map_or(Device::Cpu, Device::Gpu), falls_back))
    }
}

/// Returns the context that is open under this name, or opens it.
fn opened(name: &str, open: impl FnOnce() -> Result<Option<Context>>) -> Result<Option<Context>> {
    let mut all = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = all.get(name).filter(|known| !known.as_ref().is_some_and(Context::is_lost)) {
        return Ok(known.clone());
    }
    let opened = open()?.map(|context| {
        let context = context.with_stored_pipelines()?;
        match Tuning::measured(&context) {
            Some(tuning) => context.with_tuning(tuning),
            None => Ok(context),
        }
    });
    let opened = opened.transpose()?;
    all.insert(name.to_owned(), opened.clone());
    Ok(opened)
}

/// Returns a path that is valid wherever the report is read.
pub(super) fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}
