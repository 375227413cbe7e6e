//! `fnopt evaluate --suite`: measures how far solvers generalise.

use super::Args;
use super::report::tell_devices;
use crate::cli::output::{progress, status};
use crate::cli::{Ending, go_on, interrupt_flag, material, writable_folder};
use anyhow::Result;
use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::eval::suite::{self, Case, CaseScore, Prepared, Suite};
use fnopt::eval::{Entry, Table};
use fnopt::render::{StripOptions, View, strip, write_png};
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
    fn cases(&self, suite: Suite, grids: &[Grid]) -> fnopt::Result<Vec<Case>> {
        let given = self.material.as_deref().map(material::read).transpose()?;
        if let (Suite::Materials, Some(text)) = (suite, &self.material) {
            let expected = "none with --suite materials, which has its own";
            return Err(Error::invalid("--material", "coefficients", expected, text));
        }
        let all = grids.iter().map(|&grid| suite.cases(grid)).collect::<fnopt::Result<Vec<_>>>()?;
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
            scene.wind.density = self.wind.unwrap_or(scene.wind.density);
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
            if let Some(kept) = CaseScore::read(&file).ok().filter(|kept| kept.made_with.checksum() == wanted)
            {
                return Ok(Some(kept));
            }
        }
        let Some((score, trajectory)) = prepared.run(solver, device, !self.no_gap, tick)? else {
            return Ok(None);
        };
        // Never leave an earlier score next to this picture.
        io::remove(&file)?;
        let view = View { up: [0.0, 1.0, 0.0], ..Default::default() };
        let options = StripOptions { view, ..Default::default() };
        write_png(picture, &strip(&trajectory, &prepared.setup.model.cloths[0].handles, &options))?;
        // The score is written last: if it exists, so does its picture.
        score.write(&file)?;
        Ok(Some(score))
    }

    /// Runs the cases of a suite with each solver on each grid.
    pub(super) fn run_suite(&self, suite: Suite, mut entries: Vec<Entry>, grids: &[Grid]) -> Result<Ending> {
        for (own, given, option) in [
            (Suite::Grids, self.grid.is_some(), "--grid"),
            (Suite::Iterations, self.iterations.is_some(), "--iterations"),
        ] {
            if suite == own && given {
                let expected = "none with a suite that has its own";
                return Err(Error::invalid("--suite", option, expected, "some").into());
            }
        }
        if entries.iter().any(|entry| entry.coarse) {
            let expected = "solvers other than this in a suite";
            return Err(Error::invalid("--solver", "interpolation", expected, "interpolation").into());
        }
        let fixed = |entry: &&Entry| entry.name == "single-pass" || entry.optimizer.converges();
        if let (Suite::Iterations, Some(entry)) = (suite, entries.iter().find(fixed)) {
            let expected = "solvers whose iterations can vary in this suite";
            return Err(Error::invalid("--solver", "iterations", expected, &entry.name).into());
        }
        let mut known = BTreeSet::new();
        entries.retain(|entry| known.insert((entry.name.clone(), entry.iterations)));
        let cases = self.cases(suite, grids)?;
        let device = self.open(&entries)?;
        writable_folder(&self.out)?;
        self.writable()?;
        let frames = self.most_frames();
        let bar = progress((cases.len() * entries.len()) as u64, "cases");
        let interrupted = interrupt_flag();
        let tick = || go_on(&interrupted);
        // With the index of the entry, because one solver may take part with several numbers of iterations.
        let mut scores: Vec<(usize, CaseScore)> = Vec::new();
        let mut work = || -> Result<bool> {
            for case in &cases {
                // All solvers of a case run before the next case: they share its converged frames.
                let prepared = Prepared::new(case.clone(), frames)?;
                for (number, entry) in entries.iter().enumerate() {
                    bar.set_message(format!("{} {} {}", entry.name, case.scene.grid, case.name));
                    if !prepared.takes(&entry.optimizer) {
                        status!(
                            "{} does not take part in {}: it cannot keep layers apart",
                            entry.name,
                            case.name
                        );
                        bar.inc(1);
                        continue;
                    }
                    let Some(score) = self.score(&prepared, entry, &device, tick)? else { return Ok(false) };
                    scores.push((number, score));
                    bar.inc(1);
                }
            }
            Ok(true)
        };
        let ending = work();
        bar.finish_and_clear();
        let of = |(number, entry): (usize, &Entry)| {
            let own: Vec<CaseScore> =
                scores.iter().filter(|(of, _)| *of == number).map(|(_, score)| score.clone()).collect();
            suite::table(&entry.name, suite, &own)
        };
        let tables: Vec<Table> = entries.iter().enumerate().map(of).collect();
        let named: Vec<_> = scores
            .iter()
            .map(|(number, score)| Document { solver: &entries[*number].name, sound: score.sound(), score })
            .collect();
        // Finished work is reported however the run ended.
        let written = self.write_tables(&tables, &named);
        tell_devices(scores.iter().map(|(_, score)| (&score.made_with, score.ms_per_frame)));
        let complete = ending?;
        written?;
        if complete && scores.is_empty() {
            let expected = "a solver that takes part in one of the cases";
            return Err(Error::invalid("--suite", "solver", expected, "none").into());
        }
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
