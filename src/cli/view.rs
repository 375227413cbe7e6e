//! `fnopt view`: a window in which a scene runs or a trajectory is played back.

use super::device::{gpu, told};
use super::output::{output, status};
use super::{Ending, SolverArgs, interrupt_flag, load_scene, picture_file};
use anyhow::Result;
use clap::ValueEnum;
use fnopt::device::prepared;
use fnopt::gpu::{AdapterChoice, Context};
use fnopt::io::{ReadOptions, Trajectory};
use fnopt::render::write_png;
use fnopt::scene::{MAX_FRAMES, Scene, Setup};
use fnopt::sim::Optimizer;
use fnopt::view::{self, Content, FORMAT, Live, Offscreen, Playback, Viewer};
use fnopt::{Device, Error};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Arguments of `fnopt view`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene as `fnopt rollout` takes it, or frames to play back: an npz, npy, pc2 or mdd file or a folder of OBJ files
    /// [default: a sheet hanging from two corners that move]
    #[arg(value_name = "SCENE|FRAMES")]
    shown: Option<PathBuf>,
    #[command(flatten)]
    solver: SolverArgs,
    /// Adapter to run and draw on, by part of its name or by its index in `fnopt doctor`
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    /// Folder of the recordings and pictures that the panel asks for
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Upward axis of frames that are played back
    #[arg(long, value_enum, value_name = "AXIS")]
    up: Option<Up>,
    /// Width and height of the window, in points, or of the picture, in pixels
    #[arg(long, default_value = "1280x800", value_name = "WxH")]
    size: String,
    /// Open no window and write a picture of what it would show after --frames frames
    #[arg(long, value_name = "FILE.png")]
    screenshot: Option<PathBuf>,
    /// Frames before the picture of --screenshot
    #[arg(long, default_value_t = 60, requires = "screenshot", value_name = "F", value_parser = clap::value_parser!(u32).range(0..=MAX_FRAMES as i64))]
    frames: u32,
}

/// The axis that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Up {
    Y,
    Z,
}

/// Largest side of a window or picture: that of a picture on the smallest devices.
const MOST_PIXELS: u32 = 8192;

/// What is to be shown, read and checked before a window opens.
enum Source {
    Scene(Box<Setup>, Optimizer),
    Frames(Box<Trajectory>),
}

pub fn run(args: &Args) -> Result<Ending> {
    let size = args.size()?;
    let source = args.source()?;
    match &args.screenshot {
        Some(path) => args.write_screenshot(path, size, source),
        None => args.open_window(size, source),
    }
}

impl Args {
    fn size(&self) -> fnopt::Result<[u32; 2]> {
        let sides = self.size.split_once(['x', 'X']).map(|(w, h)| (w.trim().parse(), h.trim().parse()));
        match sides {
            Some((Ok(width), Ok(height)))
                if [width, height].iter().all(|n| (1..=MOST_PIXELS).contains(n)) =>
            {
                Ok([width, height])
            }
            _ => {
                let expected = format!("WxH, each 1 to {MOST_PIXELS}");
                Err(Error::invalid("--size", "size", expected, format!("'{}'", self.size)))
            }
        }
    }

    fn source(&self) -> fnopt::Result<Source> {
        if let Some(path) = self.shown.as_deref().filter(|path| holds_frames(path)) {
            return Ok(Source::Frames(Box::new(Trajectory::read(path, &ReadOptions::default())?)));
        }
        if let Some(up) = self.up {
            let expected = "none for a scene, whose \"up\" says it";
            return Err(Error::invalid("--up", "axis", expected, format!("{up:?}").to_lowercase()));
        }
        let scene = self.shown.as_deref().map_or_else(|| Ok(Scene::default()), load_scene)?;
        let setup = scene.setup()?;
        let optimizer = self.solver.optimizer()?;
        self.solver.check_grid(&optimizer, setup.model.grid)?;
        if !optimizer.runs_on_gpu() {
            let expected = format!("one that runs on a GPU: {}", view::SOLVERS.join(", "));
            return Err(Error::invalid("--solver", "solver", expected, optimizer.name()));
        }
        Ok(Source::Scene(Box::new(setup), optimizer))
    }

    fn content(&self, context: &Context, source: Source) -> fnopt::Result<Content> {
        match source {
            Source::Scene(setup, optimizer) => {
                let iterations = self.solver.iterations(&optimizer);
                Ok(Content::Live(Box::new(Live::new(context, *setup, optimizer, iterations)?)))
            }
            Source::Frames(trajectory) => {
                let up = if self.up == Some(Up::Z) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
                Ok(Content::Playback(Box::new(Playback::new(context, *trajectory)), up))
            }
        }
    }

    fn open_window(&self, size: [u32; 2], source: Source) -> Result<Ending> {
        let shown = self.shown.as_deref().and_then(Path::file_name).map(|name| name.to_string_lossy());
        let title = shown.map_or("fnopt".into(), |shown| format!("{shown} - fnopt"));
        let adapter = self.adapter.as_deref().map_or_else(AdapterChoice::default, AdapterChoice::parse);
        let closing = interrupt_flag();
        let open = |context: Context| {
            let context = prepared(context)?;
            status!("device: {}", context.name());
            let content = self.content(&context, source)?;
            Ok((context, content))
        };
        let written = view::run((&title, size), &adapter, &self.out, &closing, open)?;
        let mut out = output();
        for path in written {
            writeln!(out, "wrote           {}", path.display())?;
        }
        Ok(Ending::Done)
    }

    fn write_screenshot(&self, path: &Path, size: [u32; 2], source: Source) -> Result<Ending> {
        picture_file(path, "--screenshot")?;
        let device = told(gpu(&self.adapter).open())?;
        let Device::Gpu(context) = device else { unreachable!("a GPU was asked for") };
        let content = self.content(&context, source)?;
        let mut viewer = Viewer::new(&context, content, (FORMAT, size), &self.out)?;
        viewer.act(view::Action::Play(false))?;
        viewer.skip(self.frames as usize)?;
        let mut picture = Offscreen::new(&context, size)?;
        // The panel takes its sizes from the picture before.
        for _ in 0..2 {
            picture.frame(&mut viewer, Vec::new(), Duration::ZERO)?;
        }
        write_png(path, &picture.image()?)?;
        writeln!(output(), "wrote           {}", path.display())?;
        match viewer.live().and_then(Live::broken) {
            Some(frame) => Err(Error::NonFinite { frame, cloth: 0 }.into()),
            None => Ok(Ending::Done),
        }
    }
}

/// Whether an argument names frames and not a scene.
fn holds_frames(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    path.is_dir() || ["npz", "npy", "pc2", "mdd"].iter().any(|known| extension == *known)
}
