//! The choice of a device, opened with what is stored for it.

use crate::gpu::{AdapterChoice, AdapterKind, Context, Storage, Tuning};
use crate::sim::Optimizer;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The device that runs a simulation.
#[derive(Clone, Debug)]
pub enum Device {
    /// The host's processor, in single precision, with all threads of the current rayon pool.
    Cpu,
    /// A wgpu device.
    Gpu(Context),
}

impl Device {
    /// Returns the name of the device, and the storage of networks on it if it is not single precision.
    pub fn name(&self) -> String {
        match self {
            Self::Cpu => match rayon::current_num_threads() {
                1 => "cpu, 1 thread".into(),
                threads => format!("cpu, {threads} threads"),
            },
            Self::Gpu(context) => match context.storage() {
                Storage::F32 => context.name().to_owned(),
                Storage::F16 => format!("{}, network in f16", context.name()),
            },
        }
    }
}

/// Kinds of devices to choose from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceKind {
    /// A hardware adapter if there is one that is up to the simulation, else the CPU.
    #[default]
    Auto,
    /// The best adapter, which may be a software one.
    Gpu,
    /// The CPU path.
    Cpu,
}

impl DeviceKind {
    /// Returns the kind called `auto`, `gpu` or `cpu`.
    pub fn named(name: &str) -> Result<Self> {
        match name {
            "auto" => Ok(Self::Auto),
            "gpu" => Ok(Self::Gpu),
            "cpu" => Ok(Self::Cpu),
            _ => Err(Error::unknown("device", "device", name, ["auto", "cpu", "gpu"])),
        }
    }
}

/// Which device to open.
///
/// ```
/// use fnopt::DeviceChoice;
///
/// let opened = DeviceChoice::cpu().open()?;
/// assert!(opened.to_string().ends_with("(asked for)"));
/// # Ok::<(), fnopt::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceChoice {
    /// The kind of device.
    pub kind: DeviceKind,
    /// An adapter, by part of its name or by its index in [`adapters`](crate::gpu::adapters); `None` for the best of the kind.
    pub adapter: Option<String>,
    /// How a GPU stores the network.
    pub storage: Storage,
    /// The number of this process among several on a machine, which take its hardware adapters in turn; 0 for a single one.
    pub process: usize,
}

/// A device, and why it was chosen. It is written as `name (why)`.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Opened {
    /// The device.
    pub device: Device,
    /// Why this one.
    pub why: &'static str,
}

impl fmt::Display for Opened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.device.name(), self.why)
    }
}

impl DeviceChoice {
    /// The CPU path.
    pub fn cpu() -> Self {
        Self { kind: DeviceKind::Cpu, ..Self::default() }
    }

    /// Opens the device, with the pipelines and the tuning that are stored for it. Devices stay open, so that the simulations of a
    /// process share one and its compiled kernels.
    ///
    /// Fails if the choice contradicts itself, there is no such adapter, or it cannot be opened. With [`DeviceKind::Auto`] the CPU
    /// takes the place of hardware that cannot be opened, with a warning.
    pub fn open(&self) -> Result<Opened> {
        let found = match (self.kind, &self.adapter) {
            (DeviceKind::Cpu, Some(adapter)) => {
                return Err(Error::invalid("device", "adapter", "none with the device cpu", adapter));
            }
            (DeviceKind::Cpu, None) => return self.on_cpu("asked for"),
            (_, Some(name)) => self.once(|| Context::headless(&AdapterChoice::parse(name)).map(Some)),
            (DeviceKind::Gpu, None) => self.once(|| match Context::hardware(self.process) {
                Ok(Some(context)) => Ok(Some(context)),
                // Warns of hardware that cannot be opened.
                Ok(None) | Err(_) => Context::headless(&AdapterChoice::Best).map(Some),
            }),
            (DeviceKind::Auto, None) => self.once(|| Context::hardware(self.process)),
        };
        let context = match found {
            Ok(Some(context)) => context,
            Ok(None) => return self.on_cpu("no hardware adapter"),
            Err(error) if self.is_open() => {
                tracing::warn!("{error}");
                return self.on_cpu("the hardware adapter cannot be used");
            }
            Err(error) => return Err(error),
        };
        let why = match (&self.adapter, self.kind, context.kind()) {
            (Some(_), ..) => "asked for",
            (_, DeviceKind::Auto, _) => "hardware adapter",
            (.., AdapterKind::Hardware) => "best adapter",
            (.., AdapterKind::Software) => "best adapter, a software one",
        };
        let context = match self.storage {
            Storage::F32 => context,
            Storage::F16 => context.with_storage(Storage::F16)?,
        };
        Ok(Opened { device: Device::Gpu(context), why })
    }

    /// Opens the device for an optimizer as [`DeviceChoice::open`] does, but where the choice is open and the optimizer runs only on the
    /// CPU, that one.
    pub fn open_for(&self, optimizer: &Optimizer) -> Result<Opened> {
        match self.is_open() && !optimizer.runs_on_gpu() {
            true => self.on_cpu("the solver runs only on the CPU"),
            false => self.open(),
        }
    }

    /// Whether any device will do.
    pub fn is_open(&self) -> bool {
        self.kind == DeviceKind::Auto && self.adapter.is_none()
    }

    fn on_cpu(&self, why: &'static str) -> Result<Opened> {
        let device = Device::Cpu;
        match self.storage {
            Storage::F32 => Ok(Opened { device, why }),
            Storage::F16 => {
                let expected = format!("f32 on {}", device.name());
                Err(Error::invalid("device", "precision", expected, "f16"))
            }
        }
    }

    /// Returns the context that is open for such a choice, or opens it.
    fn once(&self, open: impl FnOnce() -> Result<Option<Context>>) -> Result<Option<Context>> {
        let name = format!("{:?} {:?} {}", self.kind, self.adapter, self.process);
        let mut all = contexts();
        if let Some(known) = all.get(&name).filter(|known| !known.as_ref().is_some_and(Context::is_lost)) {
            return Ok(known.clone());
        }
        let context = open()?.map(with_what_is_stored).transpose()?;
        all.insert(name, context.clone());
        Ok(context)
    }
}

/// The contexts that are open; `None` where there is no such adapter, which takes a while to find out.
fn contexts() -> MutexGuard<'static, BTreeMap<String, Option<Context>>> {
    static OPEN: Mutex<BTreeMap<String, Option<Context>>> = Mutex::new(BTreeMap::new());
    OPEN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn with_what_is_stored(context: Context) -> Result<Context> {
    let context = context.with_stored_pipelines()?;
    match Tuning::measured(&context) {
        Some(tuning) => {
            let path = Tuning::path(&context).unwrap_or_default();
            tracing::info!("tuning: {}", path.display());
            context.with_tuning(tuning)
        }
        None => {
            tracing::info!("tuning: built-in");
            Ok(context)
        }
    }
}

/// Returns a context of the caller's with the pipelines and the tuning that are stored for its device. [`store_pipelines`] stores what is
/// compiled on it, too.
pub fn prepared(context: Context) -> Result<Context> {
    let context = with_what_is_stored(context)?;
    contexts().insert("the caller's".into(), Some(context.clone()));
    Ok(context)
}

/// Stores what was compiled on the devices that are open, for the next process. A failure is only logged.
pub fn store_pipelines() {
    for context in contexts().values().flatten() {
        if let Err(error) = context.store_pipelines() {
            tracing::warn!("the next start will be as slow as this one: {error}");
        }
    }
}

/// Forgets the devices that are open; those still in use stay open.
pub fn close_all() {
    contexts().clear();
}
