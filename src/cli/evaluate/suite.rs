//! `fnopt evaluate --suite`: measures how far solvers generalise.

use super::report::tell_devices;
use super::{Args, plots};
use crate::cli::output::{progress, status};
use crate::cli::{Ending, go_on, interrupt_flag, material, writable_folder};
use anyhow::Result;
use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::eval::suite::{self, Case, CaseScore, Prepared, Suite};
use fnopt::eval::{Entry, Table, gap_curves, gap_tables};
use fnopt::render::{Bodies, StripOptions, View, strip, write_png};
use fnopt::{Error, io};
use std::collections::BTreeSet;
use std::ops::ControlFlow;

/// A score as written to JSON.
#[derive(serde::Serialize)]
struct Document<'a> {
    solver: &'a str,
    sound: bool,
    #[serde(flatten)]
    score: &'a CaseScore,
}

impl Args {
    /// Returns the selected cases of a suite, each once, with the cloth and the air that were asked for.
    fn cases(&self, suite: Suite, (grids, entries): (&[Grid], &[Entry])) -> fnopt::Result<Vec<Case>> {
        let given = self.material.as_deref().map(material::read).transpose()?;
        if let (Suite::Materials, Some(text)) = (suite, &self.material) {
            let expected = "none with --suite materials, which has its own";
            return Err(Error::invalid("--material", "coefficients", expected, text));
        }
        let on = |&grid| match suite {
            Suite::Iterations => suite::cases_of_iterations(grid, entries),
            _ => suite.cases(grid),
        };
        let all = grids.iter().map(on).collect::<fnopt::Result<Vec<_>>>()?;
        let mut cases = all.concat();
        let mut known = BTreeSet::new();
        // The suite of grids has the same cases for every grid.
        cases.retain(|case| known.insert((case.name.clone(), case.scene.grid.to_string())));
        if let Some(names) = &self.sequences {
            let known = || cases.iter().map(|case| case.name.as_str());
            if let Some(name) = names.iter().find(|name| !known().any(|known| known == *name)) {
                return Err(Error::unknown("--sequences", "case", name, known()));
            }
            cases.retain(|case| names.contains(&case.name));
        }
        for Case { scene, .. } in &mut cases {
            if let Some(physics) = given {
                physics.apply(scene);
            }
            scene.wind.density = self.air_density.unwrap_or(scene.wind.density);
            // Report errors in a scene before the work.
            scene.setup()?;
        }
        Ok(cases)
    }

    /// Returns the score of a solver in a case: the stored one, if it was made in the same way and its
    /// picture exists, else a new one. Each solver has one score and one picture per case: a run with another
    /// material replaces both. Returns `None` if `tick` ended the simulation.
    fn score(
        &self,
        prepared: &Prepared,
        entry: &Entry,
        device: &Device,
        tick: impl FnMut() -> ControlFlow<()>,
    ) -> Result<Option<CaseScore>> {
        let solver = (&entry.optimizer, entry.iterations);
        let name = prepared.name(&entry.name, entry.iterations).replace(' ', "_");
        let picture = self.out.join(format!("{name}.png"));
        // Kept apart from the scores of sequences, which --merge reads.
        let file = self.out.join("cases").join(format!("{name}.json"));
        if file.is_file() && picture.is_file() {
            // On a CPU, the number of threads does not matter.
            let wanted = prepared.conditions(solver.0, device, !self.no_gap).checksum();
            // A score stored by another version may have other fields.
            let fits = |kept: &CaseScore| kept.made_with.checksum() == wanted && kept.is_whole();
            if let Some(kept) = CaseScore::read(&file).ok().filter(fits) {
                return Ok(Some(kept));
            }
        }
        let Some((score, trajectory)) = prepared.run(solver, device, !self.no_gap, tick)? else {
            return Ok(None);
        };
        // Never leave an earlier score next to this picture.
        io::remove(&file)?;
        let view = View { up: [0.0, 1.0, 0.0], ..Default::default() };
        let setup = &prepared.setup;
        let cloth = &setup.model.cloths[0];
        let bodies = Bodies::new(&cloth.bodies, &setup.poses, &setup.vertex_view());
        let options = StripOptions { view, bodies: &bodies, ..Default::default() };
        write_png(picture, &strip(&trajectory, &cloth.handles, &options))?;
        // The score is written last: if it exists, so does its picture.
        score.write(&file)?;
        Ok(Some(score))
    }

    /// Runs the cases of a suite with each solver on each grid.
    pub(super) fn run_suite(&self, suite: Suite, mut entries: Vec<Entry>, grids: &[Grid]) -> Result<Ending> {
        if suite == Suite::Grids && self.grid.is_some() {
            let expected = "none with a suite that has its own";
            return Err(Error::invalid("--suite", "--grid", expected, "some").into());
        }
        if self.plots.is_some() && suite != Suite::Iterations {
            let expected = "none with a suite other than iterations";
            return Err(Error::invalid("--suite", "--plots", expected, "some").into());
        }
        if self.plots.is_some() && self.no_gap {
            let expected = "none with --no-gap, as the gap is what is drawn";
            return Err(Error::invalid("--suite", "--plots", expected, "some").into());
        }
        if entries.iter().any(|entry| entry.coarse) {
            let expected = "solvers other than this in a suite";
            return Err(Error::invalid("--solver", "interpolation", expected, "interpolation").into());
        }
        let mut known = BTreeSet::new();
        entries.retain(|entry| known.insert((entry.name.clone(), entry.iterations)));
        let cases = self.cases(suite, (grids, &entries))?;
        let device = self.open(&entries)?;
        writable_folder(&self.out)?;
        self.writable()?;
        let frames = self.most_frames();
        // In the suite iterations a number of iterations is a case, and otherwise all solvers take part in all cases.
        let is_of = |case: &Case, entry: &Entry| suite != Suite::Iterations || case.is_of(entry);
        let count = |case: &Case| entries.iter().filter(|entry| is_of(case, entry)).count();
        let bar = progress(cases.iter().map(count).sum::<usize>() as u64, "cases");
        let interrupted = interrupt_flag();
        let tick = || go_on(&interrupted);
        // With the index of the entry, because one solver may take part with several numbers of iterations.
        let mut scores: Vec<(usize, CaseScore)> = Vec::new();
        let mut work = || -> Result<bool> {
            let mut before: Option<Prepared> = None;
            for case in &cases {
                // All solvers of a case run before the next case: they share its converged frames. So do cases that
                // differ in the number of iterations alone.
                let prepared = Prepared::new(case.clone(), frames)?;
                let prepared = match before.take() {
                    Some(before) => prepared.after(before),
                    None => prepared,
                };
                for (number, entry) in entries.iter().enumerate().filter(|(_, entry)| is_of(case, entry)) {
                    bar.set_message(format!("{} {} {}", entry.name, case.scene.grid, case.name));
                    let Some(score) = self.score(&prepared, entry, &device, tick)? else { return Ok(false) };
                    scores.push((number, score));
                    bar.inc(1);
                }
                before = Some(prepared);
            }
            Ok(true)
        };
        let ending = work();
        bar.finish_and_clear();
        // A table for each entry, and in the suite iterations for each solver with all its numbers.
        let together = |a: usize, b: usize| match suite {
            Suite::Iterations => entries[a].name == entries[b].name,
            _ => a == b,
        };
        let firsts = (0..entries.len()).filter(|&number| !(0..number).any(|other| together(other, number)));
        let of = |first: usize| {
            let own = scores.iter().filter(|(number, _)| together(*number, first));
            let own: Vec<CaseScore> = own.map(|(_, score)| score.clone()).collect();
            suite::table(&entries[first].name, suite, &own)
        };
        let mut tables: Vec<Table> = firsts.map(of).collect();
        let gaps = match suite {
            Suite::Iterations => {
                gap_curves(scores.iter().map(|(number, score)| (&*entries[*number].name, score)))
            }
            _ => Vec::new(),
        };
        tables.extend(gap_tables(&gaps));
        let named: Vec<_> = scores
            .iter()
            .map(|(number, score)| Document { solver: &entries[*number].name, sound: score.sound(), score })
            .collect();
        // Finished work is reported however the run ended.
        let written = self.write_tables(&tables, &named);
        let drawn = self.plots.as_ref().map_or(Ok(()), |folder| plots::gaps_over_time(folder, &gaps));
        tell_devices(scores.iter().map(|(_, score)| (&score.made_with, score.ms_per_frame)));
        let complete = ending?;
        written?;
        drawn?;
        if !complete {
            status!("interrupted; the finished cases are above and kept in {}", self.out.display());
        }
        let sound = scores.iter().all(|(_, score)| score.sound());
        Ok(match (complete, sound) {
            (false, _) => Ending::Interrupted,
            (true, false) => Ending::CheckFailed,
            (true, true) => Ending::Done,
        })
    }
}
