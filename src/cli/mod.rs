//! Subcommands and the code they share.

mod bench;
mod device;
mod doctor;
mod evaluate;
mod fabrics;
mod fit_material;
mod inspect;
mod material;
pub mod output;
mod predict;
mod rollout;
mod rollout_against;
mod rollout_end;
mod scenes;
mod train;
mod tune;
mod verify;
#[cfg(feature = "view")]
mod view;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use fnopt::cloth::Grid;
use fnopt::device::{close_all, store_pipelines};
use fnopt::eval::{Sequence, median};
use fnopt::io::{create_folder, folder_of, is_stream, target_of};
use fnopt::network::Weights;
use fnopt::scene::{Batch, NamedScene, Scene, Setup};
use fnopt::sim::Optimizer;
use fnopt::{Error, Result};
use output::status;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag as signals;
use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use tracing_subscriber::{EnvFilter, filter::LevelFilter};

/// Simulate cloth with a Fourier neural operator trained as an optimizer
///
/// Exit codes: 0 success; 1 a check failed (verify, doctor, inspect, evaluate --suite); 2 bad input or
/// environment; 3 the simulation or the loss became non-finite; 130 interrupted (finished work is kept,
/// except by tune). Logs go to stderr; FNOPT_LOG=info also logs the scene, weights and tuning in use.
#[derive(Debug, Parser)]
#[command(name = "fnopt", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// Parses the command line; exits with a message if it is not valid. A negative number is taken for the
    /// value that it is meant to be and refused as such, not for an unknown option.
    pub fn from_command_line() -> Self {
        let negative = |arg: clap::Arg| match arg.get_action().takes_values() {
            true => arg.allow_negative_numbers(true),
            false => arg,
        };
        let mut command = Self::command().mut_subcommands(|command| command.mut_args(negative));
        let matches = command.try_get_matches_from_mut(std::env::args_os()).unwrap_or_else(|error| {
            let unknown = match error.get(ContextKind::InvalidArg) {
                Some(ContextValue::String(name)) if error.kind() == ErrorKind::UnknownArgument => {
                    name.clone()
                }
                _ => error.exit(),
            };
            match ABSENT_OPTIONS.iter().find(|(name, _)| *name == unknown) {
                Some((name, instead)) => {
                    status!("error: unknown option '{name}': {instead}");
                    std::process::exit(2)
                }
                None => error.exit(),
            }
        });
        Self::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulate a scene and write positions, a report and pictures
    Rollout(rollout::Args),
    /// Open a window in which a scene runs, or recorded frames are played back
    #[cfg(feature = "view")]
    View(view::Args),
    /// Say how to build the window
    #[cfg(not(feature = "view"))]
    #[command(hide = true, disable_help_flag = true)]
    View {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        _any: Vec<std::ffi::OsString>,
    },
    /// List the scenes that come with the program, or print one
    Scenes(scenes::Args),
    /// List the fabrics that a material may name, or measure how they bend and drape
    Fabrics(fabrics::Args),
    /// Train weights for the learned optimizer
    Train(train::Args),
    /// Compare solvers with recorded trajectories and print tables
    Evaluate(Box<evaluate::Args>),
    /// Find the material that brings the converged simulation closest to recorded trajectories
    FitMaterial(fit_material::Args),
    /// Check every stage against a folder of golden files
    ///
    /// On the CPU, each file is checked in double and in single precision; --device auto also checks on a
    /// hardware adapter if there is one.
    Verify(verify::Args),
    /// List the devices of this machine, test them and time them
    Doctor(doctor::Args),
    /// Show the contents of a checkpoint
    Inspect(inspect::Args),
    /// Time frames, kernels and command recording
    Bench(bench::Args),
    /// Say how long frames would take on some cards, by a model of their kernels
    Predict(predict::Args),
    /// Find and store the fastest tile sizes for this machine's adapter
    Tune(tune::Args),
}

/// How a subcommand that did not fail ended.
pub enum Ending {
    /// All done.
    Done,
    /// A check failed.
    CheckFailed,
    /// The simulation or the loss became non-finite. This has been reported, and the results before it are
    /// kept.
    NonFinite,
    /// Ctrl-C, SIGTERM or the loss of the terminal; finished work is kept, except by `tune`.
    Interrupted,
}

/// Most points sampled from a surface.
const MOST_POINTS: i64 = 10_000_000;
/// Most iterations per frame.
const MOST_ITERATIONS: i64 = 100_000;
/// Most particles, over all cloths, that are timed together: the host keeps some 200 bytes per particle.
const MOST_PARTICLES: usize = 1 << 26;

/// The environment variable that sets the number of threads of the CPU path, and the most that it may ask for.
const THREADS: &str = "RAYON_NUM_THREADS";
const MOST_THREADS: usize = 4096;

/// The environment variable that selects what is logged.
const LOG: &str = "FNOPT_LOG";

/// Options that are fields of a scene, and what to do instead.
const ABSENT_OPTIONS: [(&str, &str); 9] = [
    (
        "--wind",
        "it is a field of a scene, {\"wind\": {\"velocity\": [x, y, z]}}; `-` reads a scene from the standard input",
    ),
    ("--gravity", "it is a field of a scene, {\"gravity\": 9.8}; `-` reads a scene from the standard input"),
    (
        "--fps",
        "it is a field of a scene, {\"frame_time_s\": 0.02}; `-` reads a scene from the standard input",
    ),
    (
        "--handles",
        "they are a field of a scene, {\"handles\": \"corners\"}; `-` reads a scene from the standard input",
    ),
    ("--start", "it is a field of a scene, {\"start\": \"flat\"}; `-` reads a scene from the standard input"),
    ("--mass", "it is a field of a scene, {\"mass_kg\": 0.2}; `-` reads a scene from the standard input"),
    ("--speed", "it is a field of a scene, {\"speed\": 2}; `-` reads a scene from the standard input"),
    ("--output", "it is called --out"),
    ("--steps", "iterations in a frame are --iterations, and the frames are --frames"),
];

/// Starts logging to stderr what `FNOPT_LOG` selects, or warnings if it is not set. wgpu's own messages,
/// which go through the `log` crate, are not included.
pub fn log_to_stderr() -> Result<()> {
    let wanted = std::env::var_os(LOG).filter(|wanted| !wanted.is_empty());
    // The windows' library warns of what desktops lack.
    let wanted = wanted.unwrap_or("warn,winit=error".into());
    let invalid = |found| Error::invalid(LOG, "filter", "a level such as info, or TARGET=LEVEL,..", found);
    let text = wanted.to_str().ok_or_else(|| invalid(wanted.display().to_string()))?;
    // EnvFilter takes a word that is not a level for the name of a module, and only our own modules log.
    let is_known = |word: &str| {
        word.contains(['=', '[']) || word.starts_with("fnopt") || word.parse::<LevelFilter>().is_ok()
    };
    if let Some(word) = text.split(',').map(str::trim).find(|word| !is_known(word)) {
        return Err(Error::unknown(LOG, "level", word, ["off", "error", "warn", "info", "debug", "trace"]));
    }
    let filter = EnvFilter::try_new(text).map_err(|e| invalid(format!("'{text}' ({e})")))?;
    let colours =
        std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
    let log =
        tracing_subscriber::fmt().with_writer(std::io::stderr).with_ansi(colours).log_internal_errors(false);
    log.with_target(false).without_time().with_env_filter(filter).init();
    Ok(())
}

/// Runs the command line and returns its exit code.
pub fn run(cli: Cli) -> ExitCode {
    if let Err(error) = start_threads() {
        status!("error: {error}");
        return ExitCode::from(2);
    }
    #[cfg(target_os = "linux")]
    report_full_files();
    // `tune` compiles pipelines for many tunings, most of which are never used again.
    let stores = !matches!(cli.command, Command::Tune(_));
    let ending = match cli.command {
        Command::Rollout(args) => rollout::run(&args),
        #[cfg(feature = "view")]
        Command::View(args) => view::run(&args),
        #[cfg(not(feature = "view"))]
        Command::View { .. } => {
            let instead = "it is built with `cargo install --path . --features view`";
            Err(Error::absent("fnopt", "command", "view", instead).into())
        }
        Command::Scenes(args) => scenes::run(&args),
        Command::Fabrics(args) => fabrics::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Evaluate(args) => evaluate::run_command(&args),
        Command::FitMaterial(args) => fit_material::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Predict(args) => predict::run(&args),
        Command::Tune(args) => tune::run(&args),
    };
    if stores {
        store_pipelines();
    }
    close_all();
    match ending {
        Ok(Ending::Done) => ExitCode::SUCCESS,
        Ok(Ending::CheckFailed) => ExitCode::from(1),
        Ok(Ending::NonFinite) => ExitCode::from(3),
        Ok(Ending::Interrupted) => ExitCode::from(130),
        Err(error) => {
            status!("error: {error}");
            ExitCode::from(if matches!(error.downcast_ref(), Some(Error::NonFinite { .. })) { 3 } else { 2 })
        }
    }
}

/// Makes a write beyond the limit on the size of files fail like one on a full disk, instead of ending the process.
#[cfg(target_os = "linux")]
fn report_full_files() {
    if let Err(error) = signals::register(signal_hook::consts::SIGXFSZ, Arc::default()) {
        tracing::warn!("the limit on the size of files will end the process: {error}");
    }
}

/// Starts the threads of the CPU path, one per core or as many as the environment asks for. If a container or
/// batch system does not grant them, this is reported before anything waits for them.
fn start_threads() -> Result<()> {
    let asked = std::env::var_os(THREADS).map(|count| count.display().to_string()).unwrap_or_default();
    // Rayon ignores what is not a number, and starting more threads than this takes a system down.
    if !asked.is_empty() && !asked.parse().is_ok_and(|count: usize| count <= MOST_THREADS) {
        let expected = format!("a number of threads up to {MOST_THREADS}, or 0 for one per core");
        return Err(Error::invalid(THREADS, "threads", expected, format!("'{asked}'")));
    }
    rayon::ThreadPoolBuilder::new().build_global().map_err(|error| {
        let count = match &*asked {
            "" | "0" => format!("one thread per core (set {THREADS} for fewer)"),
            count => format!("{count} threads ({THREADS})"),
        };
        Error::Device(format!("cannot start {count}: {error}"))
    })
}

/// Options that choose the optimizer, its weights and its iterations.
#[derive(Clone, Debug, clap::Args)]
pub struct SolverArgs {
    /// Optimizer for each frame: fnopt (learned), fnopt-paper (as published), spectral, gd, adam, lbfgs or
    /// quasi-newton; on the CPU only, quasi-newton-exact or newton, which runs to convergence whatever the number of
    /// iterations
    #[arg(long, default_value = "fnopt", value_name = "S")]
    solver: String,
    /// Weights of the learned optimizer, a safetensors file [default: the weights that ship with the program]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Iterations per frame [default: what suits the solver: 20 for fnopt, spectral and quasi-newton-exact, 10 for
    /// fnopt-paper and gd, 40 for quasi-newton, 100 for lbfgs and adam]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MOST_ITERATIONS))]
    iterations: Option<u32>,
}

impl SolverArgs {
    /// Returns the optimizer, with its weights read and checked.
    pub fn optimizer(&self) -> Result<Optimizer> {
        let weights = || load_weights(self.checkpoint.as_deref());
        let optimizer = Optimizer::named(&self.solver, "--solver", weights)?;
        match (optimizer.weights(), &self.checkpoint) {
            (Some(_), _) | (_, None) => Ok(optimizer),
            (_, Some(path)) => {
                let expected = format!("none with --solver {}", self.solver);
                Err(Error::invalid("--checkpoint", "weights", expected, path.display()))
            }
        }
    }

    /// Fails, naming the weights, if the grid is too small for the network of the optimizer.
    pub fn check_grid(&self, optimizer: &Optimizer, grid: Grid) -> Result<()> {
        let file = self.checkpoint.as_deref().map(|path| path.display().to_string());
        let origin = file.unwrap_or_else(|| "the shipped weights".into());
        optimizer.weights().map_or(Ok(()), |weights| weights.config.check_grid(grid, &origin, "--grid"))
    }

    /// The file of the weights, if one was given.
    pub fn checkpoint(&self) -> Option<&Path> {
        self.checkpoint.as_deref()
    }

    /// Iterations per frame of the optimizer.
    pub fn iterations(&self, optimizer: &Optimizer) -> usize {
        self.iterations.map_or(optimizer.default_iterations(), |count| count as usize)
    }
}

/// A solver of a list.
pub struct ListedSolver {
    pub name: String,
    pub optimizer: Optimizer,
    /// The number of iterations given with it.
    pub iterations: Option<usize>,
}

impl ListedSolver {
    /// Reads one given to `flag` as `NAME` or `NAME:ITERATIONS`; `single-pass` is the published step, taken once.
    pub fn parse(
        text: &str,
        flag: &str,
        weights: impl FnOnce() -> fnopt::Result<Weights>,
    ) -> fnopt::Result<Self> {
        let invalid = |name: &str, expected: &str| Err(Error::invalid(flag, name, expected, text));
        let (name, iterations) = match text.split_once(':') {
            None => (text, None),
            Some((name, n)) => match n.parse() {
                Ok(n) => (name, Some(n)),
                Err(_) => return invalid(name, "NAME or NAME:ITERATIONS"),
            },
        };
        let (known, iterations) = match (name, iterations) {
            ("single-pass", None | Some(1)) => ("fnopt-paper", Some(1)),
            ("single-pass", _) => return invalid(name, "no number of iterations other than 1"),
            _ => (name, iterations),
        };
        if let Some(n) = iterations.filter(|n| !(1..=MOST_ITERATIONS as usize).contains(n)) {
            let expected = format!("1 to {MOST_ITERATIONS} iterations");
            return Err(Error::invalid(flag, name, expected, n));
        }
        let optimizer = Optimizer::named(known, flag, weights)?;
        Ok(Self { name: name.to_owned(), optimizer, iterations })
    }
}

/// Reads the solvers of `--solver` ([`ListedSolver::parse`]). Fails if there is a file of weights that none of them needs.
pub fn listed_solvers(texts: &[String], checkpoint: Option<&Path>) -> fnopt::Result<Vec<ListedSolver>> {
    let mut weights: Option<Weights> = None;
    let mut listed = Vec::new();
    for text in texts {
        let load = || match &weights {
            Some(weights) => Ok(weights.clone()),
            None => Ok(weights.insert(load_weights(checkpoint)?).clone()),
        };
        listed.push(ListedSolver::parse(text, "--solver", load)?);
    }
    match checkpoint {
        Some(path) if weights.is_none() => {
            let expected = "a solver that has weights, such as fnopt";
            Err(Error::invalid("--checkpoint", "solver", expected, format!("none for {}", path.display())))
        }
        _ => Ok(listed),
    }
}

/// Loads the weights from a file, or those that ship with the program.
pub fn load_weights(path: Option<&Path>) -> Result<Weights> {
    let weights = match path {
        Some(path) => Weights::load(path)?,
        None => Weights::shipped(),
    };
    let from = path.map_or("shipped with the program".into(), |path| path.display().to_string());
    tracing::info!("weights: {from}, {} parameters", weights.parameter_count());
    Ok(weights)
}

/// Takes an element of a comma-separated list, which may stand between spaces.
pub fn trimmed<T: FromStr>(text: &str) -> Result<T, T::Err> {
    text.trim().parse()
}

/// Parses a grid option: `32` for 32x32, or `48x32`.
pub fn grid(text: &str) -> fnopt::Result<Grid> {
    let (h, w) = text.split_once(['x', 'X']).unwrap_or((text, text));
    match (h.trim().parse(), w.trim().parse()) {
        (Ok(h), Ok(w)) => Grid::new(h, w, "--grid"),
        _ => Err(Error::invalid("--grid", "grid", "N or HxW", format!("'{text}'"))),
    }
}

/// Parses several grids and drops duplicates.
pub fn grids(texts: &[String]) -> fnopt::Result<Vec<Grid>> {
    let mut grids: Vec<Grid> = Vec::new();
    for text in texts {
        let grid = grid(text)?;
        if !grids.contains(&grid) {
            grids.push(grid);
        }
    }
    Ok(grids)
}

/// Parses exactly `N` comma-separated numbers. Returns `None` for any other text.
pub fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// Parses a single grid, whose height and width may also be two values.
pub fn one_grid(values: &[String]) -> fnopt::Result<Grid> {
    if let [_, width] = values
        && width.parse::<usize>().is_err()
    {
        let expected = "N, HxW or H W, with any file name before --grid";
        return Err(Error::invalid("--grid", "grid", expected, values.join(" ")));
    }
    grid(&values.join("x"))
}

/// Folder of the sequence that ships, relative to the root of a checkout.
pub const SHIPPED_SEQUENCES: &str = "assets/ground_truth";

/// Loads the named sequences of a folder, or all of them. A sequence that cannot be loaded does not affect
/// the others.
pub fn sequences(folder: &Path, named: Option<&[String]>) -> fnopt::Result<Vec<fnopt::Result<Sequence>>> {
    if folder == Path::new(SHIPPED_SEQUENCES) && !folder.exists() {
        let expected = "a folder of sequences (the default is relative to the root of a checkout)";
        return Err(Error::invalid(
            "--ground-truth",
            "folder",
            expected,
            format!("no {SHIPPED_SEQUENCES} here"),
        ));
    }
    Sequence::load_all(folder, named)
}

/// Returns the scene that a SCENE argument asks for: `-` for the standard input, a file, or the name of a scene that comes
/// with the program. A file that exists goes before a scene of the same name.
pub fn load_scene(argument: &Path) -> fnopt::Result<Scene> {
    if argument == Path::new("-") {
        let text = std::io::read_to_string(std::io::stdin())
            .map_err(|e| Error::io("standard input", "cannot read", e))?;
        let here = std::path::absolute(".").map_err(|e| Error::io(".", "cannot find", e))?;
        return Scene::parse(&text, "standard input", &here);
    }
    let is_file = argument.exists() && !argument.is_dir();
    match argument.to_str() {
        Some(name) if !is_file && !name.contains(['.', '/', '\\']) => match NamedScene::find(name, "SCENE") {
            // It may have been meant as a file.
            Err(Error::Unknown { origin, kind, name, hint }) => {
                let hint = format!("{hint}, and no file of this name; `fnopt scenes` lists the scenes");
                Err(Error::Unknown { origin, kind, name, hint })
            }
            found => found?.scene(),
        },
        _ => Scene::load(argument),
    }
}

/// Sets up a batch of copies of the default sheet on a grid, let go at one corner, so that every frame has work to do. Fails if they have too many particles.
pub fn default_scenes(grid: Grid, batch: usize) -> Result<Batch> {
    let most = MOST_PARTICLES / grid.particles();
    if batch > most {
        return Err(Error::invalid("--batch", "cloths", format!("at most {most} of {grid}"), batch));
    }
    let mut scene = Scene::released();
    scene.regrid(grid)?;
    Setup::batch(&vec![scene.setup()?; batch])
}

/// Creates a folder if necessary, and checks before any computation that files can be written into it.
pub fn writable_folder(folder: &Path) -> Result<()> {
    create_folder(folder)?;
    tempfile::tempfile_in(folder).map_err(|e| Error::io(folder, "cannot write into the folder", e))?;
    Ok(())
}

/// Applies [`writable_folder`] to the folder of a file; a device or pipe is accepted as it is. Fails if the
/// path itself is a folder.
pub fn writable_file(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Error::invalid(path.display().to_string(), "type", "a file", "a folder"));
    }
    if is_stream(path) {
        return Ok(());
    }
    // A link may lead to a file that does not exist yet.
    let target = target_of(path);
    match folder_of(&target) {
        folder if path.is_symlink() && !folder.is_dir() => {
            let found = format!("a link to {}", target.display());
            Err(Error::invalid(path.display().to_string(), "file", "one in a folder that exists", found))
        }
        folder => writable_folder(folder),
    }
}

/// Applies [`writable_file`] to the file of an option that takes a PNG, and checks its name.
pub fn picture_file(path: &Path, option: &str) -> Result<()> {
    writable_file(path)?;
    let is_png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    if !is_png && !is_stream(path) {
        return Err(Error::invalid(option, "file", "a name that ends in .png", path.display()));
    }
    Ok(())
}

/// Returns `Break` once Ctrl-C has set the flag.
pub fn go_on(interrupted: &AtomicBool) -> ControlFlow<()> {
    if interrupted.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// Returns a flag that is set by Ctrl-C, by SIGTERM, which batch systems and launchers send to end a process,
/// and on Linux by the loss of the terminal, unless the process was told to survive that. A second Ctrl-C or
/// SIGTERM ends the process at once.
pub fn interrupt_flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    FLAG.get_or_init(install_interrupts).clone()
}

fn install_interrupts() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    let warn = |signal, error| tracing::warn!("signal {signal} will discard the results so far: {error}");
    for signal in [SIGINT, SIGTERM] {
        // In this order, so that the first signal finds the flag unset.
        let installed = signals::register_conditional_shutdown(signal, 130, flag.clone())
            .and_then(|_| signals::register(signal, flag.clone()));
        if let Err(error) = installed {
            warn(signal, error);
        }
    }
    // A terminal that closes may say so twice, through the shell and through the kernel.
    #[cfg(target_os = "linux")]
    if !survives_hangup() {
        use signal_hook::consts::SIGHUP;
        if let Err(error) = signals::register(SIGHUP, flag.clone()) {
            warn(SIGHUP, error);
        }
    }
    #[cfg(unix)]
    if let Err(error) = acknowledge_ctrl_c() {
        tracing::warn!("Ctrl-C will not be acknowledged at once: {error}");
    }
    flag
}

/// Whether the process ignores SIGHUP, as `nohup` makes it.
#[cfg(target_os = "linux")]
fn survives_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    ignored.is_none_or(|mask| mask >> (signal_hook::consts::SIGHUP - 1) & 1 == 1)
}

/// Acknowledges Ctrl-C on stderr if the process has not ended within a second: a frame of many iterations, or
/// a step of a large run, may take long.
#[cfg(unix)]
fn acknowledge_ctrl_c() -> std::io::Result<()> {
    use std::io::Read;
    let (mut heard, signalled) = std::os::unix::net::UnixStream::pair()?;
    signal_hook::low_level::pipe::register(SIGINT, signalled)?;
    std::thread::Builder::new().name("ctrl-c".into()).spawn(move || {
        if heard.read_exact(&mut [0]).is_ok() {
            std::thread::sleep(std::time::Duration::from_secs(1));
            status!("interrupted: finishing the work in progress; Ctrl-C again to end at once");
        }
    })?;
    Ok(())
}
