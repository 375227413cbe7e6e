//! `fnopt inspect`: shows the contents of a checkpoint or of a trajectory.

use super::Ending;
use super::output::output;
use anyhow::Result;
use fnopt::io::{Format, ReadOptions, Trajectory};
use fnopt::network::Checkpoint;
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `fnopt inspect`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A checkpoint (safetensors) or a trajectory (npz, npy, pc2, mdd or a folder of OBJ files)
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Ending> {
    let extension = args.file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    // Those that are written only are refused as such.
    if args.file.is_dir() || Format::ALL.iter().any(|format| format.name() == extension) {
        return trajectory(args);
    }
    let checkpoint = Checkpoint::open(&args.file)?;
    let description = checkpoint.describe();
    let weights = checkpoint.weights();
    let mut out = output();
    if args.json {
        let network = match &weights {
            Ok(w) => serde_json::json!({
                "config": w.config, "skip": description.skip(), "parameters": w.parameter_count(),
            }),
            Err(e) => serde_json::json!({ "error": e.to_string() }),
        };
        let all = serde_json::json!({
            "file": args.file.display().to_string(), "metadata": description.metadata,
            "tensors": description.tensors, "network": network,
        });
        writeln!(out, "{all:#}")?;
    } else {
        writeln!(out, "{description}")?;
        match &weights {
            Ok(w) => {
                let c = w.config;
                writeln!(
                    out,
                    "network: {} fields, lifting {}, {} blocks of {} channels, {}x{} modes, {} skips, projection {}",
                    c.fields,
                    c.lifting,
                    c.layers,
                    c.channels,
                    c.modes_h,
                    c.modes_w,
                    description.skip(),
                    c.projection
                )?;
                let gates = if description.skip() == "linear" { "" } else { ", gates counted as matrices" };
                writeln!(out, "{} parameters{gates}", w.parameter_count())?;
            }
            Err(e) => writeln!(out, "not a usable network: {e}")?,
        }
    }
    Ok(if weights.is_ok() { Ending::Done } else { Ending::CheckFailed })
}

/// Shows the size of a trajectory and where it goes.
fn trajectory(args: &Args) -> Result<Ending> {
    let trajectory = Trajectory::read(&args.file, &ReadOptions::default())?;
    let (mut least, mut most, mut fastest) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3], 0.0f32);
    for frame in 0..trajectory.frames() {
        for p in trajectory.frame(frame) {
            (least, most) = ([0, 1, 2].map(|c| least[c].min(p[c])), [0, 1, 2].map(|c| most[c].max(p[c])));
        }
        for v in trajectory.frame_velocities(frame) {
            fastest = fastest.max(v.iter().map(|c| c * c).sum::<f32>().sqrt());
        }
    }
    let (frames, fps, grid) = (trajectory.frames(), trajectory.fps(), trajectory.grid());
    let mut out = output();
    if args.json {
        let all = serde_json::json!({
            "file": args.file.display().to_string(), "frames": frames, "fps": fps, "grid": [grid.h, grid.w],
            "least_m": least, "most_m": most, "fastest_m_s": fastest,
        });
        writeln!(out, "{all:#}")?;
    } else {
        writeln!(out, "{frames} frames of {grid} particles at {fps:.3} frames a second")?;
        let range = |c: usize| format!("{} {:.3} to {:.3} m", ["x", "y", "z"][c], least[c], most[c]);
        writeln!(out, "{}, {}, {}; at most {fastest:.3} m/s", range(0), range(1), range(2))?;
    }
    Ok(Ending::Done)
}
