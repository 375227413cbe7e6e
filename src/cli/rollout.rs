//! `fnopt rollout`: simulates a scene and writes what came of it.

use super::device::InferenceArgs;
use super::{Ending, SolverArgs, go_on, interrupt_flag, median};
use anyhow::Result;
use fnopt::io::{Format, Trajectory, write_atomic};
use fnopt::render::{GifOptions, StripOptions, View, strip, write_gif, write_png};
use fnopt::scene::{Motion, Scene, Setup, Stiffness, UpAxis};
use fnopt::sim::{Frame, Grid, Material, Simulator, State};
use fnopt::{Error, sim};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `fnopt rollout`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scene file (JSON) [default: a sheet hanging from two corners that move along xy_v2, in air]
    scene: Option<PathBuf>,
    /// Motion of the handles: a built-in name such as xy_v2, yz, rot_h0, updown_opp, `none`, or a .npy of [frames, handles, 3] metres
    #[arg(long, value_name = "M")]
    motion: Option<String>,
    /// Particles along the height and the width
    #[arg(long, num_args = 2, value_names = ["H", "W"])]
    grid: Option<Vec<usize>>,
    /// Grid coefficients of stretch, shear and bend
    #[arg(long, value_delimiter = ',', value_name = "KS,KH,KB")]
    material: Option<Vec<f64>>,
    /// Frames to simulate, the start included
    #[arg(long, value_name = "F")]
    frames: Option<usize>,
    #[command(flatten)]
    solver: SolverArgs,
    #[command(flatten)]
    device: InferenceArgs,
    /// Folder to write into
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Formats of the positions: npz, npy, obj, ply, pc2
    #[arg(long, value_delimiter = ',', default_value = "npz", value_name = "FORMAT,..")]
    format: Vec<Format>,
    /// Draw no pictures
    #[arg(long)]
    no_pictures: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Frames whose times do not count for the median.
const WARM_UP: usize = 3;
/// Name of the files that are written.
const NAME: &str = "rollout";

pub fn run(args: &Args) -> Result<Ending> {
    let scene = args.scene()?;
    let setup = scene.setup()?;
    let optimizer = args.solver.optimizer()?;
    let (device, line) = args.device.open()?;
    eprintln!("{line}");
    prepare(&args.out)?;

    let mut simulator = Simulator::new(&device, &setup.model, &optimizer, args.solver.iterations())?;
    let mut run = Run::new(&setup, &device.name());
    run.keep_start(&setup);
    simulator.set_state(&setup.start.cast());
    let interrupted = interrupt_flag();
    let bar = progress(setup.frames() - 1);
    let controls = (1..setup.frames()).map(|f| setup.control(f));
    let outcome = simulator.rollout(controls, |frame| {
        bar.inc(1);
        bar.set_message(format!("energy {:.4}", frame.stats[0].energy.total()));
        run.keep(&setup, &frame);
        go_on(&interrupted)
    });
    bar.finish_and_clear();
    let ending = match outcome {
        Ok(()) if run.per_frame.len() + 1 < setup.frames() => {
            eprintln!("interrupted after frame {}; the frames so far are kept", run.per_frame.len());
            Ending::Interrupted
        }
        Ok(()) => Ending::Done,
        Err(error @ Error::NonFinite { .. }) => {
            let replay = run.write_replay(&args.out)?;
            eprintln!(
                "error: {error}; the frames before it are kept, the last good state is {}",
                replay.display()
            );
            Ending::NonFinite
        }
        Err(error) => return Err(error.into()),
    };
    let written = run.write(args, &scene, &setup, &optimizer)?;
    run.summarise(args.json, &written)?;
    Ok(ending)
}

impl Args {
    /// The scene with what the command line changes in it.
    fn scene(&self) -> Result<Scene> {
        let mut scene = match &self.scene {
            Some(path) => Scene::load(path)?,
            None => Scene::default(),
        };
        if let Some(grid) = &self.grid {
            scene.regrid(Grid::new(grid[0], grid[1], "--grid")?)?;
        }
        if let Some(motion) = &self.motion {
            scene.motion = Motion::parse(motion, "--motion", Path::new(""))?;
        }
        if let Some(material) = &self.material {
            let &[stretch, shear, bend] = &material[..] else {
                let found = format!("{} numbers", material.len());
                return Err(Error::invalid("--material", "coefficients", "three numbers", found).into());
            };
            scene.stiffness = Stiffness::Grid(Material { stretch, shear, bend });
        }
        if self.frames.is_some() {
            scene.frames = self.frames;
        }
        Ok(scene)
    }
}

/// Makes sure that the folder can be written before anything is computed.
fn prepare(folder: &Path) -> fnopt::Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "cannot create the folder", e))?;
    tempfile::tempfile_in(folder).map_err(|e| Error::io(folder, "cannot write into the folder", e))?;
    Ok(())
}

/// A bar on stderr, hidden when that is no terminal.
fn progress(frames: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left  {msg}");
    ProgressBar::new(frames as u64).with_style(style.expect("the template is valid"))
}

/// What a run keeps of its frames.
struct Run {
    device: String,
    trajectory: Trajectory,
    per_frame: Vec<PerFrame>,
}

#[derive(serde::Serialize)]
struct PerFrame {
    frame: usize,
    ms: f64,
    energy_total: f64,
    #[serde(flatten)]
    stats: sim::FrameStats,
}

impl Run {
    fn new(setup: &Setup, device: &str) -> Self {
        let mut trajectory = Trajectory::new(setup.model.grid, 1.0 / setup.units.frame_time_s);
        trajectory.reserve(setup.frames());
        Self { device: device.to_owned(), trajectory, per_frame: Vec::with_capacity(setup.frames()) }
    }

    fn keep_start(&mut self, setup: &Setup) {
        self.push(setup, &setup.start.cast());
    }

    fn keep(&mut self, setup: &Setup, frame: &Frame) {
        self.push(setup, &frame.state);
        let stats = frame.stats[0];
        self.per_frame.push(PerFrame {
            frame: frame.index,
            ms: frame.wall.as_secs_f64() * 1e3,
            energy_total: stats.energy.total(),
            stats,
        });
    }

    fn push(&mut self, setup: &Setup, state: &State<f32>) {
        let single =
            |points: Vec<[f64; 3]>| points.into_iter().map(|p| p.map(|c| c as f32)).collect::<Vec<_>>();
        self.trajectory.push(&single(setup.vertices_m(&state.x)), &single(setup.velocities_m_s(&state.v)));
    }

    /// Median time after the warm-up, or of all frames when there are no more.
    fn ms_per_frame(&self) -> f64 {
        let times: Vec<f64> = self.per_frame.iter().map(|f| f.ms).collect();
        median(if times.len() > WARM_UP { &times[WARM_UP..] } else { &times })
    }

    /// The last good state as a trajectory of one frame.
    fn write_replay(&self, folder: &Path) -> fnopt::Result<PathBuf> {
        let mut last = Trajectory::new(self.trajectory.grid(), self.trajectory.fps());
        let frame = self.trajectory.frames() - 1;
        let velocities: Vec<[f32; 3]> = self
            .trajectory
            .velocities()
            .outer_iter()
            .nth(frame)
            .map(|v| v.outer_iter().map(|p| [p[0], p[1], p[2]]).collect())
            .unwrap_or_default();
        last.push(self.trajectory.frame(frame), &velocities);
        last.write(folder, "replay", Format::Npz)
    }

    fn write(
        &self,
        args: &Args,
        scene: &Scene,
        setup: &Setup,
        optimizer: &sim::Optimizer,
    ) -> fnopt::Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        for &format in &args.format {
            written.push(self.trajectory.write(&args.out, NAME, format)?);
        }
        let report = serde_json::json!({
            "settings": {
                "scene": scene.to_json(),
                "solver": optimizer.name(),
                "iterations": args.solver.iterations(),
                "checkpoint": args.solver.checkpoint,
            },
            "device": self.device,
            "frames": self.trajectory.frames(),
            "ms_per_frame": self.ms_per_frame(),
            "per_frame": self.per_frame,
        });
        let path = args.out.join("report.json");
        write_atomic(&path, |file| writeln!(file, "{report:#}"))?;
        written.push(path);
        if !args.no_pictures {
            let handles = &setup.model.cloths[0].handles;
            let up = match setup.up {
                UpAxis::Y => [0.0, 1.0, 0.0],
                UpAxis::Z => [0.0, 0.0, 1.0],
            };
            let view = View { up, ..Default::default() };
            let picture = args.out.join(format!("{NAME}.png"));
            let image = strip(&self.trajectory, handles, &StripOptions { view, ..Default::default() });
            write_png(&picture, &image)?;
            let animation = args.out.join(format!("{NAME}.gif"));
            write_gif(&animation, &self.trajectory, handles, &GifOptions { view, ..Default::default() })?;
            written.extend([picture, animation]);
        }
        Ok(written)
    }

    fn summarise(&self, json: bool, written: &[PathBuf]) -> Result<()> {
        let mut out = std::io::stdout().lock();
        let last = self.per_frame.last();
        let energy = last.map(|f| f.energy_total);
        let gradient = last.map(|f| f.stats.gradient_last);
        let stretch = self.per_frame.iter().map(|f| f.stats.stretch_largest).reduce(f64::max);
        if json {
            let summary = serde_json::json!({
                "device": self.device, "frames": self.trajectory.frames(), "ms_per_frame": self.ms_per_frame(),
                "energy": energy, "gradient": gradient, "largest_stretch": stretch, "written": written,
            });
            writeln!(out, "{summary:#}")?;
            return Ok(());
        }
        writeln!(out, "frames          {} at {}", self.trajectory.frames(), self.trajectory.grid())?;
        writeln!(out, "device          {}", self.device)?;
        if let (Some(energy), Some(gradient), Some(stretch)) = (energy, gradient, stretch) {
            writeln!(out, "ms/frame        {:.2}", self.ms_per_frame())?;
            writeln!(out, "energy          {energy:.5} (last frame, grid units)")?;
            writeln!(out, "|gradient|      {gradient:.2e} (last iteration of the last frame)")?;
            writeln!(out, "largest stretch {:.1} %", 100.0 * stretch)?;
        }
        for path in written {
            writeln!(out, "wrote           {}", path.display())?;
        }
        Ok(())
    }
}
