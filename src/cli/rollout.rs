//! `fnopt rollout`: simulates a scene and writes the results.

use super::device::{InferenceArgs, of_options};
use super::output::{output, progress, status};
use super::rollout_against::Against;
use super::rollout_end::{self, Kept, RolloutEnd};
use super::{
    Ending, SolverArgs, go_on, interrupt_flag, load_scene, material, numbers, one_grid, writable_file,
    writable_folder,
};
use anyhow::Result;
use fnopt::cloth::State;
use fnopt::eval::{FrameReport, Soundness, Verdict, median_time};
use fnopt::io::{Format, Frames, Recording, Trajectory, WriteOptions, write_atomic};
use fnopt::render::{Bodies, Film, GifOptions, Marks, StripOptions, View, strip, write_gif, write_png};
use fnopt::scene::{MAX_FRAMES, Motion, RepulsionSettings, Scene, Script, Setup, UpAxis};
use fnopt::sim::Optimizer;
use fnopt::{Error, Frame, Simulator, io};
use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Arguments of `fnopt rollout`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Scene files (JSON), names of scenes that come with the program (`fnopt scenes` lists them), or `-` for the standard
    /// input; of several, each is written into a folder of its own name in --out [default: a sheet hanging from two
    /// corners that move along xy_v2, in air]
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Motion of the handles: a built-in one such as xy_v2, yz, rot_h0 or updown_opp, `none`, or a .npy of
    /// [frames, handles, 3] metres
    #[arg(long, value_name = "M")]
    motion: Option<String>,
    /// Particles along the height and the width. With moduli, which are the default, it is the same cloth on every
    /// grid; energy coefficients make a finer grid a softer one
    #[arg(long, num_args = 1..=2, value_name = "N|HxW|H W")]
    grid: Option<Vec<String>>,
    /// A fabric (`fnopt fabrics` lists them), whose mass per area replaces the scene's, `paper` for the paper's coefficients, energy coefficients stretch, shear, bend, or a JSON file with coefficients or moduli under "material"
    /// as in a scene; its "frame_time_s" and the density and drag of its "wind" apply too
    #[arg(long, value_name = "FABRIC|paper|KS,KH,KB|FILE")]
    material: Option<String>,
    /// Let the cloth touch itself, as "self_contact" in a scene does, instead of passing through itself
    #[arg(long)]
    self_contact: bool,
    /// Keep the layers of the cloth apart, as "repulsion" in a scene does, with these values or else the
    /// scene's or the default ones
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "", value_name = "STRENGTH,DISTANCE")]
    repulsion: Option<String>,
    /// Frames to simulate, including the start
    #[arg(long, value_name = "F", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES as i64))]
    frames: Option<u32>,
    /// Go on from the last frame of an earlier rollout of the same scene (its rollout.npz), to the same bits as if it had
    /// not ended; the file that is written has the earlier frames, too
    #[arg(long, value_name = "FILE.npz")]
    r#continue: Option<PathBuf>,
    #[command(flatten)]
    solver: SolverArgs,
    /// Simulate the scene with another solver, too, on the CPU, and say how far apart the particles of both are in each frame, in
    /// the report and beside the frames in npz; newton is the exact motion
    #[arg(long, value_name = "NAME[:N]", conflicts_with = "continue")]
    against: Option<String>,
    #[command(flatten)]
    device: InferenceArgs,
    /// Folder to write to
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Formats of the positions: npz, npy, obj, ply, pc2, mdd, usda, glb
    #[arg(long, value_delimiter = ',', default_value = "npz", value_name = "FORMAT,..")]
    format: Vec<Format>,
    /// Keep every N-th frame, from frame 0 on, in files and pictures
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES as i64))]
    every: u32,
    /// Frames per second that the files name [default: as many as a second of the simulation has]
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Number of the first frame in files that number them: pc2, usda, obj, ply [default: 0]
    #[arg(long, value_name = "F", value_parser = clap::value_parser!(u32).range(..=MAX_FRAMES as i64))]
    start_frame: Option<u32>,
    /// Write npz and npy in 16 bits: half the size, and 0.5 mm between neighbouring numbers near 1 m
    #[arg(long)]
    half: bool,
    /// Deflate npz
    #[arg(long)]
    compress: bool,
    /// Draw no pictures
    #[arg(long)]
    no_pictures: bool,
    /// Count, exactly, the edges of the cloth that pass through triangles of it in the last frame
    #[arg(long)]
    intersections: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Base name of the output files.
const NAME: &str = "rollout";
/// Name of the report.
const REPORT: &str = "report.json";
/// Base name of the file of the last good state.
const REPLAY: &str = "replay";

pub fn run(args: &Args) -> Result<Ending> {
    if args.scenes.len() < 2 {
        return simulate(args);
    }
    let each = args.each()?;
    // Wrong scenes are refused before the work on others.
    each.iter().try_for_each(|args| args.scene().and_then(|scene| Ok(scene.setup().map(drop)?)))?;
    let mut exploded = false;
    for args in &each {
        status!("{}: {}", args.scenes[0].display(), args.out.display());
        match simulate(args)? {
            Ending::NonFinite => exploded = true,
            Ending::Done => {}
            ended => return Ok(ended),
        }
    }
    Ok(if exploded { Ending::NonFinite } else { Ending::Done })
}

/// Simulates a single scene.
fn simulate(args: &Args) -> Result<Ending> {
    let scene = args.scene()?;
    let setup = scene.setup()?;
    tracing::info!("scene: {}, {} frames of {}", scene.origin, setup.frames(), setup.model.grid);
    let optimizer = args.solver.optimizer()?;
    args.solver.check_grid(&optimizer, setup.model.grid)?;
    args.check_inputs_are_kept(&scene)?;
    args.check_formats(&setup)?;
    let earlier = match &args.r#continue {
        Some(file) => Some(RolloutEnd::read(file, &setup, &optimizer, args.kept(&setup))?),
        None => None,
    };
    let against = args.against.as_deref();
    let against = against.map(|text| Against::new(text, args.solver.checkpoint(), &setup)).transpose()?;
    let iterations = args.solver.iterations(&optimizer);
    let (mut simulator, opened) =
        Simulator::on(&args.device.choice(), &setup.model, &optimizer, iterations).map_err(of_options)?;
    let interrupted = interrupt_flag();
    status!("device: {opened}");
    writable_folder(&args.out)?;
    args.files().iter().chain([&args.replay()]).try_for_each(|file| writable_file(file))?;
    args.folders().iter().try_for_each(|folder| writable_folder(folder))?;

    let mut recording = args.recording(&setup)?;
    let mut script = Script::new(&setup);
    let (mut last, mut start) = (0, setup.start.cast());
    simulator.set_state(&start);
    if let (Some(earlier), Some(file)) = (earlier, &args.r#continue) {
        (script, start, last) = (earlier.script, earlier.state, earlier.frame);
        simulator.set_cloths(std::slice::from_ref(script.cloth()))?;
        simulator.resume(last, &start, &earlier.memory).map_err(|error| error.of_file(file))?;
        recording.extend_from(file)?;
    } else {
        let [positions, velocities] = setup.particles(&start);
        recording.push(&positions, &velocities)?;
    }
    let soundness = Soundness::after(script.clone(), &start);
    let mut run = Run::new(args, (&scene, soundness), &optimizer, (opened.device.name(), recording));
    (run.frames, run.last, run.against) = (last + 1, start, against);
    let bar = progress((setup.frames() - run.frames) as u64, "frames");
    let mut kept = Ok(());
    let played = simulator.play(&mut script, |_, frame| {
        bar.inc(1);
        bar.set_message(format!("energy {:.4}", frame.stats[0].energy.total()));
        kept = run.keep(frame);
        if kept.is_err() { ControlFlow::Break(()) } else { go_on(&interrupted) }
    });
    bar.finish_and_clear();
    // A GPU that was interrupted has gone a frame further than the recording.
    if simulator.frame() + 1 == run.frames {
        let state = (&simulator.state()?, &simulator.memory()?);
        let kept = (run.frames - 1, args.kept(&setup));
        rollout_end::keep(&mut run.recording, (&optimizer, &script), kept, state);
    }
    if let Some(against) = &run.against {
        against.keep(&mut run.recording);
    }
    run.end(played.and(kept))
}

impl Args {
    /// Returns the arguments of each of several scenes. Fails if two would share a folder.
    fn each(&self) -> Result<Vec<Self>> {
        let mut each: Vec<Self> = Vec::new();
        for scene in &self.scenes {
            let out = self.out.join(scene.file_stem().unwrap_or_default());
            if let Some(other) = each.iter().find(|other| other.out == out) {
                let expected = format!("another name than that of {}", other.scenes[0].display());
                return Err(Error::invalid("rollout", "SCENE", expected, scene.display()).into());
            }
            each.push(Self { scenes: vec![scene.clone()], out, ..self.clone() });
        }
        Ok(each)
    }

    /// Returns the scene with the changes made on the command line.
    fn scene(&self) -> Result<Scene> {
        let mut scene = match self.scenes.first() {
            Some(path) if self.repulsion.is_some() && numbers::<2>(&path.to_string_lossy()).is_some() => {
                let expected = format!("an equals sign before it, as in --repulsion={}", path.display());
                return Err(Error::invalid("--repulsion", "value", expected, "a space").into());
            }
            Some(path) => load_scene(path)?,
            None => Scene::default(),
        };
        if let Some(motion) = &self.motion {
            scene.motion = Motion::parse(motion, "--motion", &absolute(Path::new(".")))?;
        }
        if let Some(grid) = &self.grid {
            scene.regrid(one_grid(grid)?)?;
        }
        if let Some(text) = &self.material {
            material::apply(text, &mut scene)?;
        }
        if self.self_contact {
            scene.self_contact.get_or_insert_default();
        }
        if let Some(text) = &self.repulsion {
            scene.repulsion = Some(repulsion(text, scene.repulsion)?);
        }
        if self.frames.is_some() {
            scene.frames = self.frames.map(|frames| frames as usize);
            // Fewer frames than the scene has are a part of it.
            scene.events.retain(|event| self.frames.is_some_and(|frames| event.frame < frames as usize));
        }
        Ok(scene)
    }

    /// Returns which frames the files have.
    fn kept(&self, setup: &Setup) -> Kept {
        let every = self.every as usize;
        Kept {
            every,
            half: self.half,
            fps: self.fps.unwrap_or(1.0 / (every as f64 * setup.units.frame_time_s)),
        }
    }

    /// Returns what the files are to be like.
    fn options(&self, setup: &Setup) -> WriteOptions {
        WriteOptions {
            fps: self.fps,
            start_frame: self.start_frame.unwrap_or_default(),
            z_up: setup.up == UpAxis::Z,
            half: self.half,
            compress: self.compress,
        }
    }

    /// Returns the recording of a run, at the rate of the simulation.
    fn recording(&self, setup: &Setup) -> fnopt::Result<Recording> {
        let fps = 1.0 / (f64::from(self.every) * setup.units.frame_time_s);
        Recording::new(&self.out, setup.particle_topology(), fps)
    }

    /// Fails if a format cannot hold the frames, or an option has no format that it is about.
    fn check_formats(&self, setup: &Setup) -> fnopt::Result<()> {
        if let Some(fps) = self.fps.filter(|fps| !(fps.is_finite() && *fps > 0.0)) {
            return Err(Error::invalid("--fps", "value", "a number above 0", fps));
        }
        if let Some((name, expected)) = self.options(setup).unheeded(&self.format) {
            let name = format!("--{}", name.replace('_', "-"));
            let found = self.format.iter().map(|format| format.name()).collect::<Vec<_>>().join(",");
            return Err(Error::invalid(name, "--format", expected, found));
        }
        let topology = setup.topology();
        let frames = (setup.frames() - 1) / self.every as usize + 1;
        self.format.iter().try_for_each(|format| format.check_capacity(&topology, frames, "--format"))
    }

    /// Returns an error if the output would overwrite a file that the simulation reads, or could remove it from
    /// a folder of frames.
    fn check_inputs_are_kept(&self, scene: &Scene) -> Result<()> {
        let same =
            |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
        let (written, folders) = ([self.files(), vec![self.replay()]].concat(), self.folders());
        let overwritten = |read: &Path| {
            let in_folder = |folder: &PathBuf| {
                read.canonicalize().is_ok_and(|read| read.parent().is_some_and(|own| same(own, folder)))
            };
            written.iter().any(|file| same(read, file)) || folders.iter().any(in_folder)
        };
        let named = [
            self.scenes.first().map(PathBuf::as_path),
            self.material.as_deref().map(Path::new),
            self.solver.checkpoint.as_deref(),
        ];
        match scene.files().chain(named.into_iter().flatten()).find(|read| overwritten(read)) {
            Some(read) => {
                let expected = "one in which no file that the simulation reads is overwritten";
                Err(Error::invalid("--out", "folder", expected, read.display()).into())
            }
            None => Ok(()),
        }
    }

    /// The files that will be written, except those in folders of frames.
    fn files(&self) -> Vec<PathBuf> {
        let endings = |format: &Format| match format {
            folder if folder.is_folder() => vec![],
            // With the mesh that it moves.
            cache if cache.is_vertex_cache() => vec![cache.name(), "obj"],
            single => vec![single.name()],
        };
        let pictures: &[&str] = if self.no_pictures { &[] } else { &["png", "gif"] };
        let named = self.format.iter().flat_map(endings).chain(pictures.iter().copied());
        let named = named.map(|ending| self.out.join(format!("{NAME}.{ending}")));
        named.chain([self.out.join(REPORT)]).collect()
    }

    /// The folders of frames that will be written.
    fn folders(&self) -> Vec<PathBuf> {
        let frames = |format: &&Format| format.is_folder();
        self.format.iter().filter(frames).map(|format| self.out.join(format!("{NAME}_{format}"))).collect()
    }

    /// Where the last good state is kept if the simulation becomes non-finite.
    fn replay(&self) -> PathBuf {
        self.out.join(format!("{REPLAY}.npz"))
    }
}

/// Parses `--repulsion`. Without numbers, returns the scene's repulsion or the default one.
fn repulsion(text: &str, of_scene: Option<RepulsionSettings>) -> Result<RepulsionSettings> {
    if text.is_empty() {
        return Ok(of_scene.unwrap_or_default());
    }
    let [strength, distance] = numbers(text)
        .ok_or_else(|| Error::invalid("--repulsion", "value", "two numbers, STRENGTH,DISTANCE", text))?;
    let settings = RepulsionSettings { strength, distance };
    settings.check("--repulsion", "value")?;
    Ok(settings)
}

/// A run and what it keeps of each frame.
struct Run<'a> {
    args: &'a Args,
    scene: &'a Scene,
    setup: &'a Setup,
    optimizer: &'a Optimizer,
    device: String,
    /// Every [`Args::every`]-th frame.
    recording: Recording,
    /// Number of frames so far, including the start.
    frames: usize,
    /// The last of them.
    last: State<f32>,
    per_frame: Vec<FrameReport>,
    /// See [`Run::intersections`]; counted when first asked for, once all frames are there.
    intersections: OnceCell<Option<[usize; 2]>>,
    soundness: Soundness<'a>,
    /// The other solver of `--against`.
    against: Option<Against<'a>>,
}

/// How a simulation ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
enum Status {
    Done,
    Interrupted,
    NonFinite,
    Failed,
}

impl<'a> Run<'a> {
    fn new(
        args: &'a Args,
        (scene, soundness): (&'a Scene, Soundness<'a>),
        optimizer: &'a Optimizer,
        (device, recording): (String, Recording),
    ) -> Self {
        let setup = soundness.setup();
        Self {
            args,
            scene,
            setup,
            optimizer,
            device,
            recording,
            frames: 1,
            last: setup.start.cast(),
            per_frame: Vec::new(),
            intersections: OnceCell::new(),
            soundness,
            against: None,
        }
    }

    /// Takes a frame. Fails, and leaves it out, if the disk is full.
    fn keep(&mut self, frame: Frame) -> fnopt::Result<()> {
        if frame.index.is_multiple_of(self.args.every as usize) {
            let [positions, velocities] = self.setup.particles(&frame.state);
            self.recording.push(&positions, &velocities)?;
        }
        self.soundness.judge(&frame);
        if let Some(against) = &mut self.against {
            against.step(&frame);
        }
        self.per_frame.push(FrameReport::new(&frame, 0, self.setup));
        (self.frames, self.last) = (frame.index + 1, frame.state);
        Ok(())
    }

    /// Returns a frame by itself.
    fn alone(&self, state: &State<f32>) -> Trajectory {
        let alone = Trajectory::new(self.setup.model.grid, 1.0 / self.setup.units.frame_time_s);
        let mut alone = alone.with_mask(self.setup.model.cloths[0].mask.clone());
        self.setup.push(&mut alone, state);
        alone
    }

    /// Writes the frames, however the run ended, and reports how it ended.
    fn end(&self, outcome: fnopt::Result<()>) -> Result<Ending> {
        let status = match &outcome {
            Ok(()) if self.frames < self.setup.frames() => Status::Interrupted,
            Ok(()) => Status::Done,
            Err(Error::NonFinite { .. }) => Status::NonFinite,
            Err(_) => Status::Failed,
        };
        let (written, mut trouble) = self.write(status);
        if !trouble.is_empty() && !written.is_empty() {
            status!("written all the same: {}", names(&written).collect::<Vec<_>>().join(", "));
        }
        let returned = if outcome.is_ok() { trouble.pop() } else { None };
        for error in &trouble {
            status!("error: {error}");
        }
        if let Some(error) = returned {
            return Err(error.into());
        }
        let last = self.frames - 1;
        let ending = match outcome {
            Ok(()) if status == Status::Interrupted => {
                status!("interrupted after frame {last}; the frames so far are kept");
                Ending::Interrupted
            }
            Ok(()) => Ending::Done,
            Err(error @ Error::NonFinite { .. }) if written.contains(&self.args.replay()) => {
                let replay = self.args.replay().display().to_string();
                status!("error: {error}; the frames before it are kept; the last good state is in {replay}");
                Ending::NonFinite
            }
            Err(error) => {
                if !written.is_empty() {
                    status!("stopped after frame {last}; the frames so far are kept");
                }
                return Err(error.into());
            }
        };
        for fault in self.verdict().faults() {
            status!("warning: the rollout is not sound: {fault}");
        }
        self.summarise(status, &written)?;
        Ok(ending)
    }

    /// Returns what the frames were like.
    fn verdict(&self) -> Verdict {
        self.soundness.verdict()
    }

    /// Returns what is not sound about them, in words.
    fn unsound(&self) -> Vec<String> {
        self.verdict().faults().iter().map(ToString::to_string).collect()
    }

    /// Returns the median time per frame after the warm-up, or of all frames if there are no others.
    fn ms_per_frame(&self) -> f64 {
        let times: Vec<f64> = self.per_frame.iter().map(|f| f.ms).collect();
        median_time(&times)
    }

    /// Writes the last good state as a trajectory of one frame.
    fn write_replay(&self) -> fnopt::Result<Vec<PathBuf>> {
        Ok(vec![self.alone(&self.last).write(&self.args.out, REPLAY, Format::Npz)?])
    }

    /// Writes all files, after removing report and replay of an earlier run, which would be taken for this
    /// run's if it ended in between. A file that cannot be written does not keep the others from being
    /// written. Returns the written files and the errors.
    fn write(&self, status: Status) -> (Vec<PathBuf>, Vec<Error>) {
        let removed =
            [self.args.out.join(REPORT), self.args.replay()].iter().try_for_each(|file| io::remove(file));
        let (mut written, mut trouble) = (Vec::new(), Vec::from_iter(removed.err()));
        let mut note = |result: fnopt::Result<Vec<PathBuf>>| match result {
            Ok(paths) => written.extend(paths),
            Err(error) => trouble.push(error),
        };
        let formats: BTreeSet<Format> = self.args.format.iter().copied().collect();
        let out = &self.args.out;
        let embedded = self.setup.embedding.as_ref().map(|mesh| mesh.frames(&self.recording));
        let particles: &dyn Frames = &self.recording;
        let mesh: &dyn Frames = embedded.as_ref().map_or(particles, |embedded| embedded);
        for &format in &formats {
            let frames = if format.holds_particles() { particles } else { mesh };
            let options = self.args.options(self.setup);
            note(io::write(frames, out, NAME, format, &options).map(|path| vec![path]));
        }
        if formats.iter().any(|format| format.is_vertex_cache()) {
            // The mesh that it moves.
            let path = out.join(format!("{NAME}.obj"));
            note(io::write_mesh(mesh, &path).map(|()| vec![path]));
        }
        if !self.args.no_pictures {
            note(self.write_picture());
            note(self.write_animation());
        }
        if status == Status::NonFinite {
            note(self.write_replay());
        }
        // The report goes last and lists the files of this run, because files of an earlier run may be left
        // over.
        let status = if status == Status::Done && !trouble.is_empty() { Status::Failed } else { status };
        match self.write_report(status, &written) {
            Ok(report) => written.push(report),
            Err(error) => trouble.push(error),
        }
        (written, trouble)
    }

    fn write_report(&self, status: Status, written: &[PathBuf]) -> fnopt::Result<PathBuf> {
        let path = self.args.out.join(REPORT);
        write_atomic(&path, |file| writeln!(file, "{:#}", self.report(status, written)))?;
        Ok(path)
    }

    fn write_picture(&self) -> fnopt::Result<Vec<PathBuf>> {
        let path = self.args.out.join(format!("{NAME}.png"));
        let (view, crossings) = (self.view(), self.shows_crossings());
        let options = StripOptions { view, bodies: &self.bodies(), crossings, ..Default::default() };
        write_png(&path, &strip(self.film(), self.handles(), &options))?;
        Ok(vec![path])
    }

    fn write_animation(&self) -> fnopt::Result<Vec<PathBuf>> {
        let path = self.args.out.join(format!("{NAME}.gif"));
        let options = GifOptions { view: self.view(), bodies: &self.bodies(), ..Default::default() };
        write_gif(&path, self.film(), self.handles(), &options)?;
        Ok(vec![path])
    }

    fn film(&self) -> Film<'_> {
        Film { grid: self.setup.model.grid, frames: &self.recording, every: self.args.every as usize }
    }

    fn view(&self) -> View {
        View { up: self.setup.up.down(-1.0).map(|c| c as f32), ..Default::default() }
    }

    fn bodies(&self) -> Bodies {
        let setup = self.setup;
        let mut bodies = Bodies::new(&setup.model.cloths[0].bodies, &setup.poses, &setup.vertex_view());
        setup.changes.iter().for_each(|change| bodies.change(change.frame, &change.cloth.bodies));
        bodies
    }

    fn handles(&self) -> Marks {
        let mut marks = Marks::from(&self.setup.model.cloths[0].handles);
        self.setup.changes.iter().for_each(|change| marks.change(change.frame, &change.cloth.handles));
        marks
    }

    fn report(&self, status: Status, written: &[PathBuf]) -> serde_json::Value {
        let SolverArgs { checkpoint, .. } = &self.args.solver;
        // Newton's method takes as many as it needs.
        let iterates = !self.optimizer.converges();
        serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"),
            "settings": {
                "scene": self.scene.to_json(),
                "solver": self.optimizer.name(),
                "iterations": iterates.then(|| self.args.solver.iterations(self.optimizer)),
                "checkpoint": checkpoint.as_deref().map(absolute).map(|path| path.display().to_string()),
                "precision": self.args.device.precision,
                "every": self.args.every,
                "fps": self.args.kept(self.setup).fps,
            },
            "weights_crc32": self.optimizer.weights_crc32(),
            "device": self.device,
            "status": status,
            "sound": status != Status::NonFinite && self.verdict().is_sound(),
            "unsound": self.unsound(),
            "stretch_largest_free": self.verdict().stretch_largest_free,
            "gap_estimate": self.verdict().gap_estimate,
            "steps_shortened": self.per_frame.iter().map(|frame| frame.stats.steps.shortened).sum::<usize>(),
            "directions_dropped": self.directions_dropped(),
            "intersections": self.intersections().map(|[edges, pairs]| {
                serde_json::json!({ "frame": self.frames - 1, "edges": edges, "edge_triangle_pairs": pairs })
            }),
            "against": self.against.as_ref().map(Against::report),
            "files": names(written).chain([REPORT.into()]).collect::<Vec<_>>(),
            "frames": self.frames,
            "ms_per_frame": self.ms_per_frame(),
            "per_frame": self.per_frame,
        })
    }

    /// The edges that pass through triangles of the cloth in the last frame and how often they do, if asked for.
    fn intersections(&self) -> Option<[usize; 2]> {
        *self.intersections.get_or_init(|| self.count_intersections())
    }

    fn count_intersections(&self) -> Option<[usize; 2]> {
        let found = self.args.intersections.then(|| self.alone(&self.last).intersections(0))?;
        Some([found.iter().map(|one| one.edge).collect::<BTreeSet<_>>().len(), found.len()])
    }

    /// Whether a picture is to show where the cloth passes through itself: if asked for, or if it should not, but does from
    /// the start.
    fn shows_crossings(&self) -> bool {
        let stays_apart = self.setup.model.repels() || self.setup.model.touches_itself();
        self.args.intersections
            || stays_apart && !self.alone(&self.setup.start.cast()).intersections(0).is_empty()
    }

    /// Directions that were not finite and were left out, in all frames.
    fn directions_dropped(&self) -> usize {
        self.per_frame.iter().map(|frame| frame.stats.steps.dropped).sum()
    }

    fn summarise(&self, status: Status, written: &[PathBuf]) -> Result<()> {
        let mut out = output();
        let last = self.per_frame.last();
        let energy = last.map(|f| f.energy_total);
        let gradient = last.map(|f| f.stats.gradient_last);
        let stretch = self.per_frame.iter().map(|f| f.stats.stretch_largest).reduce(f64::max);
        if self.args.json {
            let files: Vec<_> = written.iter().map(|path| path.display().to_string()).collect();
            let summary = serde_json::json!({
                "device": self.device, "status": status, "frames": self.frames, "ms_per_frame": self.ms_per_frame(),
                "energy_total": energy, "gradient_last": gradient, "stretch_largest": stretch,
                "stretch_largest_free": self.verdict().stretch_largest_free, "gap_estimate": self.verdict().gap_estimate,
                "sound": status != Status::NonFinite && self.verdict().is_sound(), "unsound": self.unsound(),
                "against": self.against.as_ref().map(Against::report), "files": files,
            });
            writeln!(out, "{summary:#}")?;
            return Ok(());
        }
        let kept = match self.args.every {
            1 => String::new(),
            _ => format!(", {} of them in the files", self.recording.frames()),
        };
        writeln!(out, "frames          {} at {}{kept}", self.frames, self.setup.model.grid)?;
        writeln!(out, "device          {}", self.device)?;
        if let (Some(energy), Some(gradient), Some(stretch)) = (energy, gradient, stretch) {
            writeln!(out, "ms/frame        {:.2}", self.ms_per_frame())?;
            writeln!(out, "energy          {energy:.5} (last frame, grid units)")?;
            writeln!(out, "|gradient|      {gradient:.2e} (last iteration of the last frame)")?;
            writeln!(out, "largest stretch {:.1} % (of all edges, including at handles)", 100.0 * stretch)?;
            if let Some(gap) = self.verdict().gap_estimate {
                writeln!(out, "energy gap      {:.2} % (estimated; median of the frames)", 100.0 * gap)?;
            }
            if self.directions_dropped() > 0 {
                let name = "left out";
                writeln!(out, "{name:<15} {} directions that were not finite", self.directions_dropped())?;
            }
        }
        if let Some([edges, pairs]) = self.intersections() {
            let name = "intersections";
            writeln!(out, "{name:<15} {edges} edges pass through triangles, {pairs} times (last frame)")?;
        }
        if let Some(against) = &self.against {
            writeln!(out, "against         {}", against.summary())?;
        }
        for path in written {
            writeln!(out, "wrote           {}", path.display())?;
        }
        Ok(())
    }
}

/// Returns a path that is valid wherever the report is read.
fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Returns the names of files without their folders.
fn names(files: &[PathBuf]) -> impl Iterator<Item = Cow<'_, str>> {
    files.iter().filter_map(|path| path.file_name()).map(|name| name.to_string_lossy())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use fnopt::Device;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_device_that_fails_in_mid_run_leaves_the_frames_before() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().to_str().unwrap();
        let Alone { args } = Alone::parse_from(["rollout", "--solver", "gd", "--no-pictures", "--out", out]);
        let (scene, optimizer) = (args.scene().unwrap(), args.solver.optimizer().unwrap());
        let setup = scene.setup().unwrap();
        let mut recording = args.recording(&setup).unwrap();
        let [positions, velocities] = setup.particles(&setup.start.cast());
        recording.push(&positions, &velocities).unwrap();
        let scene = (&scene, Soundness::new(&setup));
        let mut run = Run::new(&args, scene, &optimizer, (String::new(), recording));
        let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &optimizer, 1).unwrap();
        simulator.set_state(&setup.start.cast());
        run.keep(simulator.step(&setup.control(1)).unwrap()).unwrap();
        let Err(error) = run.end(Err(Error::Device("lost".into()))) else { panic!("the run did not fail") };
        assert_eq!(error.to_string(), "device: lost");
        let kept = Trajectory::read(folder.path().join("rollout.npz"), &Default::default()).unwrap();
        assert_eq!(kept.frames(), 2);
    }
}
