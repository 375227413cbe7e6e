//! `--device`, `--adapter` and `--precision`.

use clap::ValueEnum;
use fnopt::gpu::{AdapterChoice, AdapterKind, Context, Storage};
use fnopt::kernels::Tuning;
use fnopt::sim::{Device, Model, Optimizer, Simulator};
use fnopt::{Error, Result};
use std::sync::{Mutex, PoisonError};

/// Where to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DeviceKind {
    /// A hardware adapter if there is one, else the CPU
    #[default]
    Auto,
    /// The best adapter, a software one included
    Gpu,
    /// The CPU path
    Cpu,
}

/// Options that choose a device.
#[derive(Clone, Debug, clap::Args)]
pub struct DeviceArgs {
    /// Where to run: auto takes a hardware adapter if there is one, else the CPU; gpu takes a software adapter too
    #[arg(long, value_enum, default_value_t)]
    pub device: DeviceKind,
    /// Adapter to run on, by part of its name or by its number in `fnopt doctor`
    #[arg(long, value_name = "NAME|INDEX")]
    pub adapter: Option<String>,
}

impl DeviceArgs {
    /// Opens the device and says in one line which and why.
    pub fn open(&self) -> Result<(Device, String)> {
        self.open_in_turn(0)
    }

    /// The same for one of several processes on this machine, which share its hardware adapters out unless one is asked for.
    pub fn open_in_turn(&self, turn: usize) -> Result<(Device, String)> {
        if let (DeviceKind::Cpu, Some(adapter)) = (self.device, &self.adapter) {
            return Err(Error::invalid("--adapter", "adapter", "none with --device cpu", adapter));
        }
        let context = match (&self.adapter, self.device) {
            (Some(name), _) => Context::headless(&AdapterChoice::parse(name))?,
            (None, DeviceKind::Gpu) => match Context::hardware(turn)? {
                Some(context) => context,
                None => Context::headless(&AdapterChoice::Best)?,
            },
            (None, DeviceKind::Auto) => match Context::hardware(turn) {
                Ok(Some(context)) => context,
                Ok(None) => return Ok(cpu("no hardware adapter")),
                Err(error) => {
                    tracing::warn!("{error}");
                    return Ok(cpu("the hardware adapter cannot be used"));
                }
            },
            (None, DeviceKind::Cpu) => return Ok(cpu("asked for")),
        };
        let context = context.with_stored_pipelines()?;
        let context = match Tuning::measured(&context) {
            Some(tuning) => context.with_tuning(tuning)?,
            None => context,
        };
        let why = match (&self.adapter, self.device, context.kind()) {
            (Some(_), ..) => "asked for",
            (_, DeviceKind::Auto, _) => "hardware adapter",
            (.., AdapterKind::Hardware) => "best adapter",
            (.., AdapterKind::Software) => "best adapter, a software one",
        };
        let line = format!("device: {} ({why})", context.name());
        match Tuning::path(&context).filter(|path| path.is_file()) {
            Some(path) => tracing::info!("tuning file: {}", path.display()),
            None => tracing::info!("tuning file: none for this adapter"),
        }
        *OPENED.lock().unwrap_or_else(PoisonError::into_inner) = Some(context.clone());
        Ok((Device::Gpu(context), line))
    }
}

/// The context that [`DeviceArgs::open`] opened last.
static OPENED: Mutex<Option<Context>> = Mutex::new(None);

/// Stores the pipelines that the command has compiled, for the next one. It is no failure of the command where that fails.
pub fn store_pipelines() {
    let opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(Err(error)) = opened.map(|context| context.store_pipelines()) {
        tracing::warn!("the next start will be as slow as this one: {error}");
    }
}

/// How the network is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32-bit floating point
    #[default]
    F32,
    /// 16-bit floating point, summed up in 32 bits; on GPUs that have it
    F16,
}

/// Options that choose a device and how it stores the network.
#[derive(Clone, Debug, clap::Args)]
pub struct InferenceArgs {
    #[command(flatten)]
    pub on: DeviceArgs,
    /// How the network's activations and weights are stored
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
}

impl InferenceArgs {
    /// Opens the device and says in one line which and why.
    pub fn open(&self) -> Result<(Device, String)> {
        self.store(self.on.open()?)
    }

    /// The same for an optimizer: `auto` is the CPU for one that runs there alone.
    pub fn open_for(&self, optimizer: &Optimizer) -> Result<(Device, String)> {
        match (self.on.device, &self.on.adapter) {
            (DeviceKind::Auto, None) if !optimizer.runs_on_gpu() => {
                self.store(cpu("the solver runs there alone"))
            }
            _ => self.open(),
        }
    }

    /// Opens the device for a simulation and makes its simulator there; also says in one line which device and why. A GPU that
    /// `auto` chose, and whose driver or memory is not up to it, gives way to the CPU.
    pub fn simulator(
        &self,
        model: &Model,
        solver: (&Optimizer, usize),
    ) -> Result<(Simulator, Device, String)> {
        let opened = self.open_for(solver.0)?;
        let gives_way = self.on.device == DeviceKind::Auto && self.on.adapter.is_none();
        simulator(opened, gives_way && self.precision == Precision::F32, model, solver)
    }

    fn store(&self, (device, line): (Device, String)) -> Result<(Device, String)> {
        match (device, self.precision) {
            (device, Precision::F32) => Ok((device, line)),
            (Device::Gpu(context), Precision::F16) => {
                let context = context.with_storage(Storage::F16)?;
                Ok((Device::Gpu(context), format!("{line}, the network in f16")))
            }
            (Device::Cpu, Precision::F16) => {
                let expected = format!("f32 on {}", Device::Cpu.name());
                Err(Error::invalid("--precision", "precision", expected, "f16"))
            }
        }
    }
}

/// Makes the simulator on the device that was opened; on the CPU where that is a GPU which is not up to it and gives way.
fn simulator(
    (device, line): (Device, String),
    gives_way: bool,
    model: &Model,
    (optimizer, iterations): (&Optimizer, usize),
) -> Result<(Simulator, Device, String)> {
    match Simulator::new(&device, model, optimizer, iterations) {
        Err(Error::Device(why) | Error::Lost(why)) if gives_way && matches!(device, Device::Gpu(_)) => {
            tracing::warn!("{why}");
            let (device, line) = cpu("the hardware adapter cannot run this");
            let simulator = Simulator::new(&device, model, optimizer, iterations)?;
            Ok((simulator, device, line))
        }
        made => made.map(|simulator| (simulator, device, line)),
    }
}

fn cpu(why: &str) -> (Device, String) {
    let device = Device::Cpu;
    let line = format!("device: {} ({why})", device.name());
    (device, line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fnopt::scene::Scene;
    use fnopt::sim::Grid;

    /// Software adapters have no L-BFGS on so many particles.
    #[test]
    fn a_gpu_that_cannot_run_a_simulation_gives_way_only_to_auto() {
        let mut scene = Scene::default();
        scene.regrid(Grid { h: 500, w: 500 }).unwrap();
        let model = scene.setup().unwrap().model;
        let device = Device::Gpu(Context::headless(&AdapterChoice::Name("llvmpipe".into())).unwrap());
        let made = |gives_way| {
            simulator((device.clone(), "opened".into()), gives_way, &model, (&Optimizer::lbfgs(), 1))
        };
        let (_, on, line) = made(true).unwrap();
        assert!(
            matches!(on, Device::Cpu) && line.ends_with("(the hardware adapter cannot run this)"),
            "{line}"
        );
        assert!(matches!(made(false), Err(Error::Device(_))));
    }
}
