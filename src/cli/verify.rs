//! `fnopt verify`: checks every stage against golden files.

use super::Ending;
use super::device::{InferenceArgs, told};
use super::output::output;
use anyhow::Result;
use fnopt::verify::{Check, CpuStages, GpuStages, Stages, Verdict, verify_folder};
use fnopt::{Device, Error};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `fnopt verify`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of golden files (*.safetensors); the default is relative to the root of a checkout
    #[arg(default_value = GOLDEN)]
    folder: PathBuf,
    #[command(flatten)]
    device: InferenceArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// The golden files that ship.
const GOLDEN: &str = "tests/golden";

pub fn run(args: &Args) -> Result<Ending> {
    if args.folder == Path::new(GOLDEN) && !args.folder.exists() {
        let expected = "a folder of golden files, such as tests/golden in a checkout of the source";
        return Err(Error::invalid("verify", "folder", expected, format!("no {GOLDEN} here")).into());
    }
    let choice = args.device.choice();
    let device = told(choice.open())?;
    let mut stages: Vec<Box<dyn Stages>> = Vec::new();
    if matches!(device, Device::Cpu) || choice.is_open() {
        stages.push(Box::new(CpuStages::<f64>::new()));
        stages.push(Box::new(CpuStages::<f32>::new()));
    }
    if let Device::Gpu(context) = &device {
        stages.push(Box::new(GpuStages::new(context)));
    }
    let mut checks: Vec<Check> = Vec::new();
    let mut out = output();
    for stages in &mut stages {
        let mut written = Ok(());
        verify_folder(&args.folder, stages.as_mut(), &mut |check| {
            if !args.json && written.is_ok() {
                written = writeln!(out, "{check}");
            }
            checks.push(check);
        })?;
        written?;
    }
    let count = |outcome| checks.iter().filter(|c| c.outcome == outcome).count();
    let (passed, failed, skipped) = (count(Verdict::Passed), count(Verdict::Failed), count(Verdict::Skipped));
    if args.json {
        let all = serde_json::json!({
            "device": device.name(), "passed": passed, "failed": failed, "skipped": skipped, "checks": checks,
        });
        writeln!(out, "{all:#}")?;
    } else {
        writeln!(out, "{passed} passed, {failed} failed, {skipped} skipped")?;
    }
    Ok(if failed == 0 { Ending::Done } else { Ending::CheckFailed })
}
