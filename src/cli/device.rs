//! `--device`, `--adapter` and `--precision`.

use clap::ValueEnum;
use fnopt::cloth::Model;
use fnopt::gpu::{AdapterChoice, AdapterKind, Context, Storage, Tuning};
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};
use fnopt::{Error, Result};
use std::sync::{Mutex, PoisonError};

/// Where to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DeviceKind {
    /// A hardware adapter if there is one, else the CPU
    #[default]
    Auto,
    /// The best adapter, which may be a software one
    Gpu,
    /// The CPU path
    Cpu,
}

/// Options that choose a device.
#[derive(Clone, Debug, clap::Args)]
pub struct DeviceArgs {
    /// Device to run on: auto takes a hardware adapter if there is one, else the CPU; gpu also accepts a
    /// software adapter
    #[arg(long, value_enum, default_value_t)]
    pub device: DeviceKind,
    /// Adapter to run on, by part of its name or by its index in `fnopt doctor`
    #[arg(long, value_name = "NAME|INDEX")]
    pub adapter: Option<String>,
}

impl DeviceArgs {
    /// Opens the device. Also returns a line that reports which device was chosen and why.
    pub fn open(&self) -> Result<(Device, String)> {
        self.open_for_process(0)
    }

    /// Like [`DeviceArgs::open`], for the process of this index among several on this machine, which take its
    /// hardware adapters in turn unless an adapter was asked for.
    pub fn open_for_process(&self, process: usize) -> Result<(Device, String)> {
        if let (DeviceKind::Cpu, Some(adapter)) = (self.device, &self.adapter) {
            return Err(Error::invalid("--adapter", "adapter", "none with --device cpu", adapter));
        }
        let context = match (&self.adapter, self.device) {
            (Some(name), _) => Context::headless(&AdapterChoice::parse(name))?,
            (None, DeviceKind::Gpu) => match Context::hardware(process) {
                Ok(Some(context)) => context,
                // Warns of hardware that cannot be opened.
                Ok(None) | Err(_) => Context::headless(&AdapterChoice::Best)?,
            },
            (None, DeviceKind::Auto) => match Context::hardware(process) {
                Ok(Some(context)) => context,
                Ok(None) => return Ok(cpu("no hardware adapter")),
                Err(error) => {
                    tracing::warn!("{error}");
                    return Ok(cpu("the hardware adapter cannot be used"));
                }
            },
            (None, DeviceKind::Cpu) => return Ok(cpu("asked for")),
        };
        let context = prepared(context)?;
        let why = match (&self.adapter, self.device, context.kind()) {
            (Some(_), ..) => "asked for",
            (_, DeviceKind::Auto, _) => "hardware adapter",
            (.., AdapterKind::Hardware) => "best adapter",
            (.., AdapterKind::Software) => "best adapter, a software one",
        };
        let line = format!("device: {} ({why})", context.name());
        Ok((Device::Gpu(context), line))
    }
}

/// Returns the context with the pipelines and the tuning that are stored for its device. What the command compiles on it
/// will be stored, too ([`store_pipelines`]).
pub fn prepared(context: Context) -> Result<Context> {
    let context = context.with_stored_pipelines()?;
    let context = match Tuning::measured(&context) {
        Some(tuning) => {
            let path = Tuning::path(&context).unwrap_or_default();
            tracing::info!("tuning: {}", path.display());
            context.with_tuning(tuning)?
        }
        None => {
            tracing::info!("tuning: built-in");
            context
        }
    };
    *OPENED.lock().unwrap_or_else(PoisonError::into_inner) = Some(context.clone());
    Ok(context)
}

/// The context that was [`prepared`] last.
static OPENED: Mutex<Option<Context>> = Mutex::new(None);

/// Stores the pipelines that the command has compiled, for the next command. A failure is only logged.
pub fn store_pipelines() {
    let opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(Err(error)) = opened.map(|context| context.store_pipelines()) {
        tracing::warn!("the next start will be as slow as this one: {error}");
    }
}

/// How the network's activations and weights are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32-bit floating point
    #[default]
    F32,
    /// 16-bit floating point with 32-bit sums, on GPUs that support it
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
    /// Opens the device. Also returns a line that reports which device was chosen and why.
    pub fn open(&self) -> Result<(Device, String)> {
        self.store(self.on.open()?)
    }

    /// Like [`InferenceArgs::open`], for an optimizer: `auto` chooses the CPU if the optimizer runs only
    /// there.
    pub fn open_for(&self, optimizer: &Optimizer) -> Result<(Device, String)> {
        match (self.on.device, &self.on.adapter) {
            (DeviceKind::Auto, None) if !optimizer.runs_on_gpu() => {
                self.store(cpu("the solver runs only on the CPU"))
            }
            _ => self.open(),
        }
    }

    /// Opens the device for a simulation and creates its simulator. Also returns a line that reports which
    /// device was chosen and why. If `auto` chose a GPU whose driver or memory is not up to it, falls back to the CPU, except
    /// in f16, which the CPU lacks.
    pub fn simulator(
        &self,
        model: &Model,
        solver: (&Optimizer, usize),
    ) -> Result<(Simulator, Device, String)> {
        let opened = self.open_for(solver.0)?;
        let falls_back_to_cpu = self.on.device == DeviceKind::Auto && self.on.adapter.is_none();
        simulator(opened, falls_back_to_cpu && self.precision == Precision::F32, model, solver)
    }

    fn store(&self, (device, line): (Device, String)) -> Result<(Device, String)> {
        match (device, self.precision) {
            (device, Precision::F32) => Ok((device, line)),
            (Device::Gpu(context), Precision::F16) => {
                let context = context.with_storage(Storage::F16)?;
                Ok((Device::Gpu(context), format!("{line}, network in f16")))
            }
            (Device::Cpu, Precision::F16) => {
                let expected = format!("f32 on {}", Device::Cpu.name());
                Err(Error::invalid("--precision", "precision", expected, "f16"))
            }
        }
    }
}

/// Creates the simulator on the opened device. A GPU that is not up to it is replaced by the CPU if
/// `falls_back_to_cpu` is set.
fn simulator(
    (device, line): (Device, String),
    falls_back_to_cpu: bool,
    model: &Model,
    (optimizer, iterations): (&Optimizer, usize),
) -> Result<(Simulator, Device, String)> {
    match Simulator::new(&device, model, optimizer, iterations) {
        Err(Error::Device(why) | Error::Lost(why))
            if falls_back_to_cpu && matches!(device, Device::Gpu(_)) =>
        {
            tracing::warn!("{why}");
            let (device, line) = cpu("the hardware adapter cannot run this");
            let simulator = Simulator::new(&device, model, optimizer, iterations)?;
            Ok((simulator, device, line))
        }
        created => created.map(|simulator| (simulator, device, line)),
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
    use fnopt::cloth::Grid;
    use fnopt::scene::Scene;

    /// Software adapters refuse L-BFGS on this many particles.
    #[test]
    fn a_gpu_that_cannot_run_a_simulation_gives_way_only_to_auto() {
        let mut scene = Scene::default();
        scene.regrid(Grid { h: 500, w: 500 }).unwrap();
        let model = scene.setup().unwrap().model;
        let device = Device::Gpu(Context::headless(&AdapterChoice::Name("llvmpipe".into())).unwrap());
        let created = |falls_back_to_cpu| {
            simulator((device.clone(), "opened".into()), falls_back_to_cpu, &model, (&Optimizer::lbfgs(), 1))
        };
        let (_, on, line) = created(true).unwrap();
        assert!(
            matches!(on, Device::Cpu) && line.ends_with("(the hardware adapter cannot run this)"),
            "{line}"
        );
        assert!(matches!(created(false), Err(Error::Device(_))));
    }
}
