//! `--device`, `--adapter` and `--precision`.

use super::output::status;
use clap::ValueEnum;
use fnopt::device::Opened;
use fnopt::gpu::Storage;
use fnopt::{Device, DeviceChoice, DeviceKind, Error, Result};

/// Where to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// A hardware adapter if there is one, else the CPU
    #[default]
    Auto,
    /// The best adapter, which may be a software one
    Gpu,
    /// The CPU path
    Cpu,
}

impl From<Kind> for DeviceKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Auto => Self::Auto,
            Kind::Gpu => Self::Gpu,
            Kind::Cpu => Self::Cpu,
        }
    }
}

/// Options that choose a device.
#[derive(Clone, Debug, clap::Args)]
pub struct DeviceArgs {
    /// Device to run on: auto takes a hardware adapter if there is one, else the CPU; gpu also accepts a
    /// software adapter
    #[arg(long, value_enum, default_value_t)]
    device: Kind,
    /// Adapter to run on, by part of its name or by its index in `fnopt doctor`
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
}

impl DeviceArgs {
    /// Returns the choice.
    pub fn choice(&self) -> DeviceChoice {
        DeviceChoice { kind: self.device.into(), adapter: self.adapter.clone(), ..Default::default() }
    }
}

/// Returns the choice of a command that needs a GPU: this adapter, or the best.
pub fn gpu(adapter: &Option<String>) -> DeviceChoice {
    DeviceChoice { kind: DeviceKind::Gpu, adapter: adapter.clone(), ..Default::default() }
}

/// Says which device was opened.
pub fn told(opened: Result<Opened>) -> Result<Device> {
    let opened = opened.map_err(of_options)?;
    status!("device: {opened}");
    Ok(opened.device)
}

/// Makes an error about a choice of device one about the options.
pub fn of_options(error: Error) -> Error {
    match error {
        Error::Invalid { origin, field, expected, found } if origin == "device" => {
            Error::Invalid { origin: format!("--{field}"), field, expected, found }
        }
        other => other,
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
    on: DeviceArgs,
    /// How the network's activations and weights are stored
    #[arg(long, value_enum, default_value_t)]
    pub precision: Precision,
}

impl InferenceArgs {
    /// Returns the choice.
    pub fn choice(&self) -> DeviceChoice {
        let storage = match self.precision {
            Precision::F32 => Storage::F32,
            Precision::F16 => Storage::F16,
        };
        DeviceChoice { storage, ..self.on.choice() }
    }
}
