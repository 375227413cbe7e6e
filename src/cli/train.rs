//! `fnopt train`: trains weights in a folder.

use super::device::{DeviceArgs, of_options};
use super::output::{output, progress, status};
use super::{Ending, interrupt_flag};
use anyhow::Result;
use fnopt::Error;
use fnopt::network::Weights;
use fnopt::train::{Config, End, Limits, Progress, Ranks, Run, SceneScore, initial_weights, learner, ranks};
use fnopt::{Device, DeviceChoice};
use indicatif::ProgressBar;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Instant;

/// Arguments of `fnopt train`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Configuration (TOML) [default: the paper's recipe, assets/training/paper.toml]
    config: Option<PathBuf>,
    /// Folder for a new run
    #[arg(long, default_value = "out", value_name = "DIR", conflicts_with = "resume")]
    out: PathBuf,
    /// Folder of a run to continue; a CONFIG given as well must be the run's
    #[arg(long, value_name = "DIR")]
    resume: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Stop once the run has done N steps in all; it can be resumed
    #[arg(long, value_name = "N")]
    steps: Option<u64>,
    /// Stop after M minutes; the run can be resumed
    #[arg(long, value_name = "M", value_parser = minutes)]
    minutes: Option<f64>,
}

/// The configuration if none is given.
const PAPER: &str = include_str!("../../assets/training/paper.toml");
/// Its name in errors.
const PAPER_NAME: &str = "assets/training/paper.toml";

pub fn run(args: &Args) -> Result<Ending> {
    let ranks = ranks()?;
    train(args, &ranks).inspect_err(|error| ranks.abort(error))
}

/// Trains as one of the ranks; only rank 0 reports progress.
fn train(args: &Args, ranks: &Rc<dyn Ranks>) -> Result<Ending> {
    let first = ranks.rank() == 0;
    let given = args.config.as_deref().map(Config::load).transpose()?;
    let mut run = match &args.resume {
        Some(folder) => {
            let run = args.resumed(folder, given.map(|(_, config)| config), ranks)?;
            args.check(run.config())?;
            run
        }
        None => {
            let (text, config) = match given {
                Some(given) => given,
                None => (PAPER.to_owned(), Config::parse(PAPER, Path::new(PAPER_NAME))?),
            };
            args.check(&config)?;
            let weights = initial_weights(&config, &**ranks)?;
            let learner = learner(&args.opened(&**ranks)?, &config, &weights)?;
            Run::create(&args.out, &text, config, learner, ranks.clone())?
        }
    };
    let folder = args.resume.as_ref().unwrap_or(&args.out).display();
    let interrupted = interrupt_flag();
    let limits = Limits { steps: args.steps, minutes: args.minutes, interrupted: Some(&interrupted) };
    let bar = match first {
        true => {
            let to = limits.steps.unwrap_or(u64::MAX).min(run.config().steps);
            let bar = progress(to, "steps").with_position(run.step());
            bar.reset_eta();
            bar
        }
        false => ProgressBar::hidden(),
    };
    let begun = Instant::now();
    let end = run.train(&limits, |progress| {
        let left = args.minutes.map(|minutes| minutes - begun.elapsed().as_secs_f64() / 60.0);
        show(&bar, progress, left);
        ControlFlow::Continue(())
    })?;
    bar.finish_and_clear();
    let skipped = match run.skipped() {
        0 => String::new(),
        n => format!(", {n} skipped because they were not finite"),
    };
    let line =
        format!("{} of {} steps done{skipped}; {folder} holds the run", run.step(), run.config().steps);
    if first {
        say_end(end, &line)?;
    }
    Ok(match end {
        End::Done => Ending::Done,
        End::Interrupted => Ending::Interrupted,
        End::NonFinite => Ending::NonFinite,
    })
}

/// Reports how the run ended; `line` counts its steps and names its folder.
fn say_end(end: End, line: &str) -> std::io::Result<()> {
    match end {
        End::Done => writeln!(output(), "{line}")?,
        End::Interrupted => status!("interrupted: {line}; continue with --resume"),
        End::NonFinite => {
            status!(
                "error: the loss stayed non-finite, or the weights became so: {line}, with the last finite weights, if any"
            )
        }
    }
    Ok(())
}

impl Args {
    /// Returns an error if `--steps` asks for more steps than the run has.
    fn check(&self, config: &Config) -> fnopt::Result<()> {
        match self.steps {
            Some(steps) if steps > config.steps => {
                let expected = format!("at most {}, the number in the configuration", config.steps);
                Err(Error::invalid("options", "--steps", expected, steps))
            }
            _ => Ok(()),
        }
    }

    fn resumed(&self, folder: &Path, given: Option<Config>, ranks: &Rc<dyn Ranks>) -> Result<Run> {
        let learner =
            |config: &Config| learner(&self.opened(&**ranks)?, config, &Weights::zeros(config.network));
        let (run, passed_over) = Run::resume(folder, given.as_ref(), learner, ranks.clone())?;
        for error in passed_over {
            status!("warning: skipped a damaged checkpoint: {error}");
        }
        if ranks.rank() == 0 {
            status!("continuing after step {}", run.step());
        }
        Ok(run)
    }

    /// Opens the device of this rank.
    fn opened(&self, ranks: &dyn Ranks) -> fnopt::Result<Device> {
        let opened = DeviceChoice { process: ranks.local_rank(), ..self.device.choice() }
            .open()
            .map_err(of_options)?;
        match ranks.count() {
            1 => status!("device: {opened}"),
            count => status!("rank {} of {count}: device: {opened}", ranks.rank()),
        }
        Ok(opened.device)
    }
}

/// Parses a number of minutes.
fn minutes(text: &str) -> std::result::Result<f64, String> {
    let minutes = text.parse().ok().filter(|m: &f64| m.is_finite() && *m > 0.0);
    minutes.ok_or_else(|| "expected a number above 0".into())
}

/// Shows a step, with the minutes left if `--minutes` is given.
fn show(bar: &ProgressBar, progress: &Progress<'_>, minutes: Option<f64>) {
    bar.set_position(progress.step);
    let limit =
        minutes.map_or_else(String::new, |left| format!(", at most {:.0} minutes left", left.max(0.0)));
    if let Some(report) = progress.report {
        bar.set_message(format!("loss {:.4}{limit}", report.loss()));
    }
    for SceneScore { scene, gap, stretch_largest, sound } in progress.validation.into_iter().flatten() {
        let sound = if *sound { "sound" } else { "UNSOUND" };
        let gap = gap.map_or_else(String::new, |gap| match gap >= SceneScore::MOST_GAP {
            true => format!(", energy gap {:.0} % or more", 100.0 * SceneScore::MOST_GAP),
            false => format!(", energy gap {:.2} %", 100.0 * gap),
        });
        let stretch = stretch_largest.map_or_else(
            || ", not finite".into(),
            |stretch| format!(", largest stretch {:.1} %", 100.0 * stretch),
        );
        let step = progress.step;
        // Printed even if the bar is hidden, as in a batch job's log.
        bar.suspend(|| status!("step {step}: {scene}: {sound}{gap}{stretch}"));
    }
}
