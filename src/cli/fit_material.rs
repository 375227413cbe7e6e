//! `fnopt fit-material`: fits the material to recorded trajectories.

use super::output::{output, status};
use super::{
    Ending, MOST_POINTS, SHIPPED_SEQUENCES, go_on, interrupt_flag, one_grid, sequences, trimmed,
    writable_file,
};
use anyhow::Result;
use fnopt::Error;
use fnopt::cloth::{Grid, Material};
use fnopt::eval::fit::{ErrorSurface, Fit, PARAMETERS, Point};
use fnopt::eval::{Physics, Sequence, Settings};
use fnopt::io::write_atomic;
use fnopt::scene::{Moduli, Stiffness};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Points of the surface that are printed.
const PRINTED: usize = 12;

/// Arguments of `fnopt fit-material`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of sequences, as for evaluate
    #[arg(long, default_value = SHIPPED_SEQUENCES, value_name = "DIR")]
    ground_truth: PathBuf,
    /// Sequences over which the error is averaged [default: all]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<String>, value_name = "NAME,..")]
    sequences: Option<Vec<String>>,
    /// Grid to simulate on
    #[arg(long, num_args = 1..=2, value_name = "N|HxW|H W", default_value = "32")]
    grid: Vec<String>,
    /// Frames of each sequence, including the start [default: all]
    #[arg(long, value_name = "F", value_parser = clap::value_parser!(u32).range(2..))]
    frames: Option<u32>,
    /// Points sampled from each surface
    #[arg(long, default_value_t = 3000, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MOST_POINTS))]
    points: u32,
    /// Range of the stretch coefficient, or one number to fix it
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<f64>, default_value = "300,10000", value_name = "LOW,HIGH")]
    stretch: Vec<f64>,
    /// Range of the shear coefficient
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<f64>, default_value = "1,100", value_name = "LOW,HIGH")]
    shear: Vec<f64>,
    /// Range of the bend coefficient
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<f64>, default_value = "0.03,10", value_name = "LOW,HIGH")]
    bend: Vec<f64>,
    /// Range of the density of the air [kg/m^3] [default: the first sequence's]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<f64>, value_name = "LOW,HIGH")]
    density: Option<Vec<f64>>,
    /// Range of the drag of the air [N s/m^3] [default: the first sequence's]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<f64>, value_name = "LOW,HIGH")]
    drag: Option<Vec<f64>>,
    /// Range of the frame time [s] [default: the first sequence's]
    #[arg(long, value_delimiter = ',', value_parser = trimmed::<f64>, value_name = "LOW,HIGH")]
    frame_time: Option<Vec<f64>>,
    /// Values per parameter in the coarse grid
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=50))]
    levels: u32,
    /// Rounds of refinement around the best point, halving the step in each
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=30))]
    rounds: u32,
    /// File of the errors (CSV); points that it already holds are not computed again. The best set is written
    /// next to it, with the extension json, for `evaluate --material`
    #[arg(long, default_value = "out/fit.csv", value_name = "FILE")]
    out: PathBuf,
}

pub fn run(args: &Args) -> Result<Ending> {
    let best = args.out.with_extension("json");
    if best == args.out {
        let expected = "an extension other than json, which the best set has";
        return Err(Error::invalid("--out", "file", expected, args.out.display()).into());
    }
    let sequences = sequences(&args.ground_truth, args.sequences.as_deref())?;
    let sequences = sequences.into_iter().collect::<fnopt::Result<Vec<_>>>()?;
    let kept = args.kept(&sequences)?;
    let ranges = args.ranges(kept)?;
    let fit = Fit {
        sequences: &sequences,
        grid: one_grid(&args.grid)?,
        settings: Settings {
            own_material: false,
            // Replaced by the physics of each point.
            physics: Physics::default(),
            points: args.points as usize,
            frames: args.frames.map_or(usize::MAX, |frames| frames as usize),
        },
        ranges,
        levels: args.levels as usize,
        rounds: args.rounds as usize,
    };
    writable_file(&args.out)?;
    writable_file(&best)?;
    check_is_a_set(&best)?;
    let mut surface = ErrorSurface::load(&args.out, &fit)?;
    let style = ProgressStyle::with_template("{spinner} {pos} points tried, {elapsed}  {msg}");
    let bar = ProgressBar::new_spinner().with_style(style.expect("the template is valid"));
    bar.set_position(fit.found(&surface).len() as u64);
    bar.enable_steady_tick(Duration::from_millis(200));
    let interrupted = interrupt_flag();
    let tick = || go_on(&interrupted);
    let outcome = fit.search(&mut surface, tick, |surface, left| {
        // Merged with what another search has found in the meantime.
        let mut all = ErrorSurface::load(&args.out, &fit)?;
        all.add(surface);
        all.write(&args.out)?;
        let sorted = fit.found(surface);
        bar.set_position(sorted.len() as u64);
        let best = sorted.first().map_or(f64::INFINITY, |best| best.1);
        bar.set_message(format!("{left} to go in this round, best e_CD {best:.3e}"));
        Ok(())
    });
    bar.finish_and_clear();
    outcome?;
    surface.add(&ErrorSurface::load(&args.out, &fit)?);
    // Of all points of the file: those outside this search's ranges are results too.
    let found = surface.sorted().first().copied().filter(|(_, error)| error.is_finite());
    if let Some((point, error)) = found {
        let mut document = args.document(&point, kept, (fit.grid, &sequences))?;
        document["fitted_to"] = fit.subject().into();
        document["e_cd"] = error.into();
        write_atomic(&best, |file| writeln!(file, "{document:#}"))?;
    }
    let mut out = output();
    let heads: String = PARAMETERS.iter().map(|name| format!("{name:>12}")).collect();
    writeln!(out, "{heads}  e_CD x 10^3")?;
    for (point, error) in fit.found(&surface).iter().take(PRINTED) {
        let values: String = point.iter().map(|v| format!("{v:>12.5}")).collect();
        writeln!(out, "{values}{:>13.3}", 1e3 * error)?;
    }
    writeln!(out, "all {} points: {}", surface.sorted().len(), args.out.display())?;
    if let Some((best_point, _)) = found {
        let elsewhere = match fit.found(&surface).iter().any(|(point, _)| *point == best_point) {
            true => "",
            false => ", outside the ranges of this search",
        };
        writeln!(out, "the best of them{elsewhere}: {}", best.display())?;
    }
    if tick().is_break() {
        status!("interrupted; run again to continue");
        return Ok(Ending::Interrupted);
    }
    Ok(Ending::Done)
}

/// Fails if the file exists and is anything but an earlier best set, which the new one replaces.
fn check_is_a_set(path: &Path) -> Result<()> {
    let Ok(content) = std::fs::read(path) else { return Ok(()) };
    let document: Option<serde_json::Value> = serde_json::from_slice(&content).ok();
    if document.is_some_and(|document| document.get("fitted_to").is_some()) {
        return Ok(());
    }
    let expected = format!("a name beside which {} is free or a best set of this command", path.display());
    Err(Error::invalid("--out", "file", expected, "another file there").into())
}

impl Args {
    /// Returns a point as physics: air and frame time are the point's if they are fitted or differ from those
    /// that are `kept`, else the sequences' own.
    fn physics(&self, &[stretch, shear, bend, density, drag, frame_time]: &Point, kept: [f64; 3]) -> Physics {
        let own =
            |fitted: bool, value: f64, kept: f64| (fitted || value as f32 != kept as f32).then_some(value);
        Physics {
            stiffness: Stiffness::Grid(Material { stretch, shear, bend, ..Material::PAPER }),
            density: own(self.density.is_some(), density, kept[0]),
            drag: own(self.drag.is_some(), drag, kept[1]),
            frame_time_s: own(self.frame_time.is_some(), frame_time, kept[2]),
        }
    }

    /// Returns a point in the format of `--material`: as moduli, which describe the same cloth on every grid,
    /// together with the coefficients, or as coefficients alone if the sequences differ in their cloth.
    fn document(
        &self,
        point: &Point,
        kept: [f64; 3],
        (grid, sequences): (Grid, &[Sequence]),
    ) -> fnopt::Result<serde_json::Value> {
        let physics = self.physics(point, kept);
        let document = physics.to_json();
        let [stretch, shear, bend, ..] = *point;
        let moduli = |sequence: &Sequence| -> fnopt::Result<Moduli> {
            Ok(sequence
                .scene(grid, &physics)?
                .setup()?
                .units
                .moduli(grid, Material { stretch, shear, bend, ..Material::PAPER }))
        };
        let all = sequences.iter().map(moduli).collect::<fnopt::Result<Vec<_>>>()?;
        if all.iter().any(|other| *other != all[0]) {
            return Ok(document);
        }
        let mut in_moduli = Physics { stiffness: Stiffness::Moduli(all[0]), ..physics }.to_json();
        in_moduli["coefficients"] = document["material"].clone();
        in_moduli["coefficients"]["grid"] = grid.to_string().into();
        Ok(in_moduli)
    }

    /// Returns the air and the frame time of the sequences. Fails if they differ and are not fitted: a point
    /// has one value of each.
    fn kept(&self, sequences: &[Sequence]) -> fnopt::Result<[f64; 3]> {
        let first = sequences[0].air_and_frame_time();
        let fitted = [&self.density, &self.drag, &self.frame_time].map(Option::is_some);
        for sequence in sequences {
            let own = sequence.air_and_frame_time();
            let names = ["density", "drag", "frame-time"];
            let differs = |&k: &usize| !fitted[k] && own[k] != first[k];
            if let Some(k) = (0..names.len()).find(differs) {
                let expected = format!("{}, as in {}, or --{}", first[k], sequences[0].name, names[k]);
                return Err(Error::invalid(&sequence.name, names[k], expected, own[k]));
            }
        }
        Ok(first)
    }

    /// Returns the smallest and largest value of each parameter. `kept` holds air and frame time, for those
    /// that are not fitted.
    fn ranges(&self, kept: [f64; 3]) -> fnopt::Result<[[f64; 2]; 6]> {
        let range = |name: &str, given: Option<&Vec<f64>>, kept: f64| {
            let Some(values) = given else { return Ok([kept; 2]) };
            let range = match values[..] {
                [value] => [value; 2],
                [low, high] => [low, high],
                _ => [f64::NAN; 2],
            };
            let positive = range[0] > 0.0 || (range[0] == range[1] && range[0] == 0.0);
            match positive && range[0] <= range[1] && range[1].is_finite() {
                true => Ok(range),
                false => {
                    let expected = "LOW,HIGH with 0 < LOW <= HIGH, or one number";
                    Err(Error::invalid("--".to_owned() + name, "range", expected, format!("{values:?}")))
                }
            }
        };
        Ok([
            range("stretch", Some(&self.stretch), 0.0)?,
            range("shear", Some(&self.shear), 0.0)?,
            range("bend", Some(&self.bend), 0.0)?,
            range("density", self.density.as_ref(), kept[0])?,
            range("drag", self.drag.as_ref(), kept[1])?,
            range("frame-time", self.frame_time.as_ref(), kept[2])?,
        ])
    }
}
