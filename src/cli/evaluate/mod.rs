//! `fnopt evaluate`: compares solvers with recorded trajectories.

mod jobs;
mod plots;
mod report;
mod suite;

use super::device::{InferenceArgs, told};
use super::output::status;
use super::{
    Ending, MOST_ITERATIONS, MOST_POINTS, SHIPPED_SEQUENCES, go_on, grids, interrupt_flag, listed_solvers,
    material, sequences, trimmed, writable_file, writable_folder,
};
use anyhow::Result;
use fnopt::Device;
use fnopt::Error;
use fnopt::eval::suite::{ITERATIONS, Suite};
use fnopt::eval::{Entry, Format, Physics, Score, Sequence, Settings, tables};
use fnopt::io::folder_of;
use jobs::{Kept, Plan, with_valid_scenes};
use report::{Written, documents, tell_devices, tell_missing, tell_unconverged, timed};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// The file name that stands for standard output.
const STDOUT: &str = "-";

/// The solver that simulates a coarse grid and interpolates.
const INTERPOLATION: &str = "interpolation";

/// The solvers that take part if none are named, and those if a suite sets the number of iterations.
const SOLVERS: [&str; 6] = ["newton", "fnopt", "spectral", "quasi-newton", "lbfgs:100", "adam:500"];
const SOLVERS_OF_ITERATIONS_SUITE: [&str; 5] = ["fnopt", "spectral", "quasi-newton", "lbfgs", "adam"];

/// Arguments of `fnopt evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of sequences, each a folder with cloth_pos.npy and optionally meta.json (properties of the
    /// cloth), handles.npy, start.npy, and mesh.obj if the vertices do not form a grid
    #[arg(long, default_value = SHIPPED_SEQUENCES, value_name = "DIR")]
    ground_truth: PathBuf,
    /// Sequences, or cases of a suite, to simulate [default: all]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<String>, value_name = "NAME,..")]
    sequences: Option<Vec<String>>,
    /// Grids to simulate on: HxW, or N for NxN; they must have the proportions of the cloth [default: 32]
    #[arg(long, value_delimiter = ',', value_name = "N|HxW,..")]
    grid: Option<Vec<String>>,
    /// Solvers: fnopt, fnopt-paper, spectral, gd, adam, lbfgs, quasi-newton; quasi-newton-exact and newton, which run
    /// on the CPU whatever the device; single-pass, which is fnopt-paper:1; interpolation, which is fnopt-paper on 32 rows,
    /// interpolated to the grid. A number of iterations may follow after a colon [default:
    /// newton,fnopt,spectral,quasi-newton,lbfgs:100,adam:500; in the suite iterations
    /// fnopt,spectral,quasi-newton,lbfgs,adam, and newton only if it is named]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<String>, value_name = "NAME[:N],..")]
    solver: Option<Vec<String>>,
    /// Iterations per frame for solvers given without a number [default: what suits each, as in rollout; in the suite iterations
    /// 3,5,8,10,15,20,25,30]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<usize>, value_name = "N,..")]
    iterations: Option<Vec<usize>>,
    /// Weights of the learned optimizer, a safetensors file [default: the weights that ship with the program]
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Energy coefficients stretch, shear, bend, or a JSON file with coefficients or moduli under "material"
    /// as in a scene, such as fit-material writes; its "frame_time_s" and the density and drag of its "wind"
    /// apply too [default: "material" in a sequence's meta.json, otherwise the moduli fitted to three trajectories
    /// of ARCSim, assets/materials/arcsim.json; in a suite the default scene's]
    #[arg(long, value_name = "KS,KH,KB|FILE")]
    material: Option<String>,
    /// Density of the air [kg/m^3], formerly --wind [default: the sequence's, or in a suite the default scene's]
    #[arg(long, value_name = "DENSITY", alias = "wind", alias = "density")]
    air_density: Option<f64>,
    /// Frames of each sequence, including the start [default: all]
    #[arg(long, value_name = "F", value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Points sampled from each surface for e_CD
    #[arg(long, default_value_t = 10_000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MOST_POINTS))]
    points: u32,
    /// Simulations of each sequence by each solver: the first from the recorded start, the others with every
    /// particle except the handles moved at random by up to 1e-5 edges, in the same way for all solvers.
    /// Tables show the means, and the deviations over repeats separately from those over sequences: if a
    /// solver stops short of convergence, chance decides which way a fold goes
    #[arg(long, default_value_t = 1, value_name = "K", value_parser = clap::value_parser!(u64).range(1..=1000))]
    repeats: u64,
    /// Another system's trajectories: DIR/SEQUENCE.npz, .npy, .pc2 or .mdd, or folders of OBJ files, on any grid or
    /// on the sequence's mesh; may be given more than once. Its scores are kept with those of the solvers
    #[arg(long, value_name = "NAME=DIR")]
    compare: Vec<String>,
    /// Folder for the scores; those already there are reused
    #[arg(long, default_value = "out/evaluate", value_name = "DIR")]
    out: PathBuf,
    /// Do only every N-th piece of the work, starting with the I-th (from 0); a piece is a sequence on a grid
    /// with all solvers, or another system's trajectory [default: SLURM_ARRAY_TASK_ID of
    /// SLURM_ARRAY_TASK_COUNT if these are set]
    #[arg(long, value_name = "I/N")]
    shard: Option<String>,
    /// Simulate nothing; print the tables of all scores in these folders, which must be made with the same
    /// settings
    #[arg(long, value_name = "DIR", num_args = 1.., conflicts_with_all = [
        "ground_truth", "sequences", "grid", "solver", "iterations", "checkpoint", "material", "air_density", "frames", "points",
        "repeats", "compare", "out", "shard", "device", "adapter", "precision",
    ])]
    merge: Vec<PathBuf>,
    /// Instead of comparing with recorded trajectories, measure how far each solver generalises from the
    /// default scene: motions, handles, speeds, grids, materials or iterations; the suite repulsion measures
    /// how close the layers of a folding sheet come to each other without and with it, and the suite scenes runs those that
    /// come with the program and have no events, with as many rows as --grid. The suite iterations also tabulates the energy gap over the time of a frame, and the gaps of all solvers at equal time: at the time
    /// that each takes for ten iterations. Prints tables; the score and a picture of each case are kept in --out
    /// and reused
    #[arg(long, value_name = "SUITE", conflicts_with_all = [
        "repeats", "compare", "shard", "merge", "points", "ground_truth",
    ])]
    suite: Option<String>,
    /// Omit the energy gap from a suite; its converged simulation takes most of the time
    #[arg(long)]
    no_gap: bool,
    /// Write the scores as JSON to FILE or, without FILE, print them in place of the tables
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = STDOUT)]
    json: Option<PathBuf>,
    /// Write the cells of all tables as one CSV table: table, row, column, value; `-` prints it in place of the tables
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the tables as Markdown; `-` prints it in place of the tables
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Folder for plots (PNG): errors per frame and over iterations and maps of them, and the energy gap over the
    /// number of iterations (convergence.png) and over the time of a frame (gap_ms.png); --merge leaves out the
    /// error maps and both of the gap, --shard only the latter. With the suite iterations gap_ms.png alone: for
    /// each grid the gap [%] against ms per frame, both logarithmic, a line per solver with its numbers of
    /// iterations at the points, and newton's time as a vertical line. Other suites have no plots
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    #[command(flatten)]
    device: InferenceArgs,
}

pub fn run_command(args: &Args) -> Result<Ending> {
    if !args.merge.is_empty() {
        let scores = jobs::merged(&args.merge)?;
        args.writable()?;
        let drawn = args.plots.as_ref().map_or(Ok(()), |folder| plots::draw(folder, &scores));
        args.write_tables(&tables(&scores), &documents(&scores))?;
        tell_devices(timed(&scores));
        tell_missing(&scores);
        tell_unconverged(&scores);
        return Ok(drawn.map(|()| Ending::Done)?);
    }
    let settings = args.settings()?;
    let suite = args.suite.as_deref().map(|name| Suite::named(name, "--suite")).transpose()?;
    if args.no_gap && suite.is_none() {
        // The parser lets it pass beside an option that conflicts with --suite.
        return Err(Error::invalid("--no-gap", "option", "--suite beside it", "none").into());
    }
    let entries = args.entries(suite)?;
    let grids = grids(args.grid.as_deref().unwrap_or(&["32".into()]))?;
    if let Some(suite) = suite {
        if let Some((_, count)) = share_of_slurm().filter(|&(_, count)| count > 1) {
            let found = format!("{count} of them (SLURM_ARRAY_TASK_COUNT)");
            return Err(Error::invalid("--suite", "tasks", "one, as a suite cannot be split", found).into());
        }
        return args.run_suite(suite, entries, &grids);
    }
    // An error in one sequence, or in another system's trajectory of it, does not affect the others.
    let mut wrong: Vec<Error> = Vec::new();
    let read = sequences(&args.ground_truth, args.sequences.as_deref())?;
    let coarse = entries.iter().any(|entry| entry.coarse);
    let sequences: Vec<Sequence> = read
        .into_iter()
        .map(|read| read.and_then(|sequence| with_valid_scenes(sequence, (&grids, coarse), &settings)))
        .filter_map(|read| read.map_err(|error| wrong.push(error)).ok())
        .collect();
    let (index, count) = args.shard()?;
    // Other systems' trajectories first, so that errors in them are reported before the work and not after
    // it.
    let systems = args.imported((&sequences, &entries), (index, count), &settings, &mut wrong)?;
    if sequences.is_empty() && !wrong.is_empty() {
        let first = wrong.remove(0);
        wrong.iter().for_each(|error| status!("error: {error}"));
        return Err(first.into());
    }
    wrong.iter().for_each(|error| status!("error: {error}; continuing with the rest"));
    args.tell_materials(&sequences);
    let device = args.open(&entries)?;
    let plan = Plan {
        sequences: &sequences,
        grids: &grids,
        entries: &entries,
        device: &device,
        settings,
        repeats: args.repeats,
    };
    let mut jobs = plan.jobs(&args.out);
    jobs.retain(|job| job.piece % count == index);
    if jobs.is_empty() {
        status!("share {index} of {count} has nothing to do: there are fewer pieces of work than shares");
    }
    if args.plots.is_some() && count > 1 {
        status!("the convergence is not plotted, as the work is split into shares");
    }
    writable_folder(&args.out)?;
    args.writable()?;
    systems.iter().try_for_each(|system| system.keep_imported(&args.out))?;

    let interrupted = interrupt_flag();
    let (mut all, ending) = plan.work(&jobs, &interrupted);
    all.extend(systems);
    // Finished work is reported however the run ended.
    let complete = matches!(ending, Ok(ControlFlow::Continue(()))) && count == 1;
    let printed_json = args.json.is_some() && args.json_file().is_none();
    let written = match all.is_empty() && !jobs.is_empty() && !printed_json {
        true => Ok(()),
        false => args.write(&all, &plan, (complete, &interrupted)),
    };
    if ending?.is_break() || go_on(&interrupted).is_break() {
        status!("interrupted; the scores so far are kept in {}", args.out.display());
        return written.map(|()| Ending::Interrupted);
    }
    written?;
    wrong.into_iter().next().map_or(Ok(Ending::Done), |first| Err(first.into()))
}

impl Args {
    fn settings(&self) -> fnopt::Result<Settings> {
        if let Some(frames) = self.frames.filter(|&frames| frames < 2) {
            return Err(Error::invalid("--frames", "frames", "at least 2", frames));
        }
        let physics = self.material.as_deref().map_or_else(material::fitted, material::read)?;
        if let Some(density) = self.air_density.filter(|density| !(density.is_finite() && *density >= 0.0)) {
            return Err(Error::invalid("--air-density", "density", "a finite number, 0 or greater", density));
        }
        let physics = Physics { density: self.air_density.or(physics.density), ..physics };
        let own_material = self.material.is_none();
        Ok(Settings { physics, own_material, points: self.points as usize, frames: self.most_frames() })
    }

    /// Says which material is used.
    fn tell_materials(&self, sequences: &[Sequence]) {
        if let Some(material) = &self.material {
            return status!("material: {material}");
        }
        let (own, fitted): (Vec<&Sequence>, Vec<&Sequence>) =
            sequences.iter().partition(|sequence| sequence.stiffness().is_some());
        let names =
            |of: &[&Sequence]| of.iter().map(|sequence| &*sequence.name).collect::<Vec<_>>().join(", ");
        if !own.is_empty() {
            status!("material: that of meta.json for {}", names(&own));
        }
        if !fitted.is_empty() {
            status!("material: the one fitted to ARCSim's trajectories for {}", names(&fitted));
        }
    }

    /// Returns the largest number of frames to simulate of a sequence, or of a case of a suite.
    fn most_frames(&self) -> usize {
        self.frames.map_or(usize::MAX, |frames| frames as usize)
    }

    /// Checks, before the work, that the requested files can be written after it.
    fn writable(&self) -> fnopt::Result<()> {
        // --merge reads every JSON file in a folder of scores.
        if let Some(file) = self.json_file() {
            let folder = folder_of(file).canonicalize().ok();
            let mut kept = self.merge.iter().chain([&self.out]).map(|scores| scores.canonicalize().ok());
            if folder.is_some() && kept.any(|scores| scores == folder) {
                let expected = "a file outside the folders of scores";
                return Err(Error::invalid("--json", "file", expected, file.display()));
            }
        }
        let files: Vec<&Path> = self.files().into_iter().filter_map(|(_, file)| file).collect();
        let place = |file: &Path| {
            let folder = folder_of(file).canonicalize().unwrap_or_else(|_| folder_of(file).to_owned());
            file.canonicalize().unwrap_or_else(|_| folder.join(file.file_name().unwrap_or_default()))
        };
        for (k, file) in files.iter().enumerate() {
            if files[..k].iter().any(|other| place(other) == place(file)) {
                let expected = "a file for each of --json, --csv and --markdown";
                return Err(Error::invalid(
                    "evaluate",
                    "files",
                    expected,
                    format!("{} twice", file.display()),
                ));
            }
            if *file != Path::new(STDOUT) {
                writable_file(file)?;
            }
        }
        self.plots.iter().try_for_each(|folder| writable_folder(folder))
    }

    /// Returns the files of the scores and the tables.
    fn files(&self) -> [(Written, Option<&Path>); 3] {
        [
            (Written::Scores, self.json.as_deref()),
            (Written::Tables(Format::Csv), self.csv.as_deref()),
            (Written::Tables(Format::Markdown), self.markdown.as_deref()),
        ]
    }

    /// Returns the file to write the scores to as JSON, unless they are printed.
    fn json_file(&self) -> Option<&Path> {
        self.json.as_deref().filter(|file| *file != Path::new(STDOUT))
    }

    /// Opens the device and reports which. Solvers that exist only for the CPU run there.
    fn open(&self, entries: &[Entry]) -> Result<Device> {
        let device = told(self.device.choice().open())?;
        let mut names: Vec<&str> = Vec::new();
        if matches!(device, Device::Gpu(_)) {
            let elsewhere = entries.iter().filter(|entry| matches!(entry.device(&device), Device::Cpu));
            names.extend(elsewhere.map(|entry| &*entry.name));
            names.dedup();
        }
        if !names.is_empty() {
            status!("running on the CPU, as they have no GPU version: {}", names.join(", "));
        }
        Ok(device)
    }

    /// Returns the solvers, each with every number of iterations asked for.
    fn entries(&self, suite: Option<Suite>) -> fnopt::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        let any = suite == Some(Suite::Iterations);
        let usual: &[&str] = if any { &SOLVERS_OF_ITERATIONS_SUITE } else { &SOLVERS };
        let named = self.solver.clone().unwrap_or_else(|| usual.iter().map(|&name| name.into()).collect());
        let allowed = 1..=MOST_ITERATIONS as usize;
        if let Some(n) = self.iterations.iter().flatten().find(|n| !allowed.contains(n)) {
            return Err(Error::invalid("--iterations", "number", format!("1 to {MOST_ITERATIONS}"), n));
        }
        // On a coarse grid it is the published step.
        let coarse = |text: &String| match text.strip_prefix(INTERPOLATION) {
            Some(rest) if rest.is_empty() || rest.starts_with(':') => Some(format!("fnopt-paper{rest}")),
            _ => None,
        };
        let texts: Vec<String> =
            named.iter().map(|text| coarse(text).unwrap_or_else(|| text.clone())).collect();
        for (solver, text) in listed_solvers(&texts, self.checkpoint.as_deref())?.into_iter().zip(&named) {
            let coarse = coarse(text).is_some();
            let name = if coarse { INTERPOLATION.to_owned() } else { solver.name };
            let all = match solver.iterations {
                // Newton's method converges whatever the number.
                _ if solver.optimizer.converges() => vec![1],
                Some(n) => vec![n],
                None => self.iterations.clone().unwrap_or_else(|| match any {
                    true => ITERATIONS.to_vec(),
                    false => vec![solver.optimizer.default_iterations()],
                }),
            };
            let of = |iterations| Entry {
                name: name.clone(),
                optimizer: solver.optimizer.clone(),
                iterations,
                coarse,
            };
            entries.extend(all.into_iter().map(of));
        }
        Ok(entries)
    }

    /// Returns the names and folders of the systems to compare with. Fails if a name is that of a solver or
    /// another column.
    fn systems(&self, entries: &[Entry]) -> fnopt::Result<Vec<(String, PathBuf)>> {
        let mut columns: Vec<String> =
            entries.iter().flat_map(|entry| [entry.column(), entry.name.clone()]).collect();
        let mut parse = |text: &String| {
            let (name, folder) = text
                .split_once('=')
                .ok_or_else(|| Error::invalid("--compare", "system", "NAME=DIR", text))?;
            let folder = PathBuf::from(folder);
            if !folder.is_dir() {
                return Err(Error::invalid("--compare", name, "a folder", folder.display()));
            }
            if name.is_empty() || columns.iter().any(|column| column == name) {
                return Err(Error::invalid("--compare", "name", "one that no other column has", text));
            }
            columns.push(name.to_owned());
            Ok((name.to_owned(), folder))
        };
        self.compare.iter().map(&mut parse).collect()
    }

    /// Returns the scores of other systems on every `count`-th sequence from `index` on. Adds errors in
    /// single trajectories to `wrong`.
    fn imported(
        &self,
        (sequences, entries): (&[Sequence], &[Entry]),
        (index, count): (usize, usize),
        settings: &Settings,
        wrong: &mut Vec<Error>,
    ) -> Result<Vec<Kept>> {
        let mut all = Vec::new();
        for (name, folder) in self.systems(entries)? {
            let mine = sequences.iter().skip(index).step_by(count);
            for (sequence, path) in mine.filter_map(|s| Some((s, trajectory(&folder, s)?))) {
                let read = sequence.read_other(&path);
                let kept = read.and_then(|found| {
                    let kept = Kept::imported(sequence, &name, &found, settings);
                    kept.map_err(|error| error.of_file(&path))
                });
                all.extend(kept.map_err(|error| wrong.push(error)));
            }
            let lacking = sequences.iter().filter(|sequence| trajectory(&folder, sequence).is_none());
            let missing: Vec<&str> = lacking.map(|sequence| &*sequence.name).collect();
            match missing.first() {
                Some(first) if missing.len() == sequences.len() => {
                    let expected = format!(
                        "{first}.npz, .npy, .pc2 or .mdd, or a folder {first} of OBJ files or with the output of a rollout"
                    );
                    let folder = folder.display().to_string();
                    return Err(Error::invalid(folder, "trajectory", expected, "none of them").into());
                }
                Some(_) => status!("{name} lacks {}: those cells stay empty", missing.join(", ")),
                None => {}
            }
        }
        Ok(all)
    }

    /// Returns the index of this share and the number of shares. Reports the share if it was not given
    /// explicitly.
    fn shard(&self) -> fnopt::Result<(usize, usize)> {
        let (origin, (index, count)) = match &self.shard {
            None => ("SLURM_ARRAY_TASK_ID", share_of_slurm().unwrap_or((0, 1))),
            Some(text) => {
                let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
                let invalid = || Error::invalid("--shard", "share", "I/N, as in 0/4", text);
                ("--shard", parts.ok_or_else(invalid)?)
            }
        };
        if count == 0 {
            return Err(Error::invalid(origin, "share", "a share of 1 or more", "of 0"));
        }
        if index >= count {
            let hint = if self.shard.is_none() { "; give --shard I/N in an array with gaps" } else { "" };
            let expected = format!("0 to {} of {count}{hint}", count - 1);
            return Err(Error::invalid(origin, "share", expected, index));
        }
        match (&self.shard, count) {
            (Some(_), _) => {}
            (None, 1) if std::env::var_os("SLURM_ARRAY_TASK_ID").is_some() => {
                status!(
                    "the only task of its Slurm array does all the work; --shard I/N takes a share of it"
                );
            }
            (None, 1) => {}
            (None, _) => {
                status!(
                    "share {index} of {count}, from SLURM_ARRAY_TASK_ID; --merge prints the tables of all"
                );
            }
        }
        Ok((index, count))
    }

    /// Writes the requested files and prints the tables. Unless `simulate` is set, plots that need further
    /// simulations are left out.
    fn write(&self, all: &[Kept], plan: &Plan, (simulate, interrupted): (bool, &AtomicBool)) -> Result<()> {
        let scores: Vec<Score> = all.iter().map(|kept| kept.score.clone()).collect();
        let written = self.write_tables(&tables(&scores), &documents(&scores));
        tell_devices(timed(&scores));
        tell_unconverged(&scores);
        // The tables come first, so that they are there whatever becomes of the plots.
        let drawn = self.plots.as_ref().map_or(Ok(()), |folder| {
            plots::draw(folder, &scores)?;
            for sequence in plan.sequences {
                plots::error_maps(folder, sequence, (all, plan.settings.frames))?;
            }
            if simulate { plots::convergence(folder, plan, || go_on(interrupted)) } else { Ok(()) }
        });
        written.and(Ok(drawn?))
    }
}

/// Returns the index of this task in a Slurm array, from 0, and the number of tasks, if there is such an
/// array.
fn share_of_slurm() -> Option<(usize, usize)> {
    let number = |name: &str| std::env::var(format!("SLURM_ARRAY_TASK_{name}")).ok()?.parse::<usize>().ok();
    let (first, step) = (number("MIN").unwrap_or(0), number("STEP").unwrap_or(1).max(1));
    Some((number("ID")?.checked_sub(first)? / step, number("COUNT")?))
}

/// Returns the file or folder of another system's trajectory of a sequence, if there is one.
fn trajectory(folder: &Path, sequence: &Sequence) -> Option<PathBuf> {
    let names = fnopt::io::Format::SINGLE_FILES.map(|format| format!("{}.{format}", sequence.name));
    let rollouts = fnopt::io::Format::SINGLE_FILES.map(|format| format!("rollout.{format}"));
    let inside = rollouts.into_iter().chain(["rollout_obj", "cloth_pos.npy"].map(String::from));
    let inside = inside.map(|file| format!("{}/{file}", sequence.name));
    let all = names.into_iter().chain(inside).chain([sequence.name.clone()]).map(|name| folder.join(name));
    all.into_iter().find(|path| path.exists())
}
