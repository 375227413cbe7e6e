//! `fnopt evaluate --suite`: how far solvers generalise.

use super::Args;
use crate::cli::{Ending, go_on, interrupt_flag};
use anyhow::Result;
use fnopt::Error;
use fnopt::eval::suite::{self, Case, CaseScore, Prepared, Suite};
use fnopt::eval::{Entry, Table};
use fnopt::render::{StripOptions, View, strip, write_png};
use fnopt::sim::Grid;
use indicatif::{ProgressBar, ProgressStyle};

impl Args {
    /// The cases of a suite that take part.
    fn cases(&self, suite: Suite, grid: Grid) -> fnopt::Result<Vec<Case>> {
        let cases = suite.cases(grid)?;
        let Some(names) = &self.sequences else { return Ok(cases) };
        let known = || cases.iter().map(|case| case.name.as_str());
        if let Some(name) = names.iter().find(|name| !known().any(|known| known == *name)) {
            return Err(Error::unknown("--sequences", "case", name, known()));
        }
        Ok(cases.iter().filter(|case| names.contains(&case.name)).cloned().collect())
    }

    /// Runs the cases of a suite with each solver on each grid.
    pub(super) fn run_suite(
        &self,
        suite: Suite,
        entries: &[Entry],
        grids: &[Grid],
        frames: usize,
    ) -> Result<Ending> {
        if entries.iter().any(|entry| entry.coarse) {
            let expected = "solvers of the grid itself in a suite";
            return Err(Error::invalid("--solver", "interpolation", expected, "interpolation").into());
        }
        let (device, line) = self.device.open()?;
        eprintln!("{line}");
        let cases = grids.iter().map(|&grid| self.cases(suite, grid)).collect::<fnopt::Result<Vec<_>>>()?;
        let cases = cases.concat();
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} cases, {eta} left  {msg}");
        let bar = ProgressBar::new((cases.len() * entries.len()) as u64)
            .with_style(style.expect("the template is valid"));
        let interrupted = interrupt_flag();
        let tick = || go_on(&interrupted);
        // With the number of the entry: one solver may take part with several numbers of iterations.
        let mut scores: Vec<(usize, CaseScore)> = Vec::new();
        let mut complete = true;
        'cases: for case in &cases {
            // All solvers of a case in turn: they share its converged frames.
            let prepared = Prepared::new(case, frames)?;
            for (number, entry) in entries.iter().enumerate() {
                bar.set_message(format!("{} {} {}", entry.name, case.scene.grid, case.name));
                let solver = (&entry.optimizer, entry.iterations);
                let Some((score, trajectory)) = prepared.run(solver, &device, !self.no_gap, tick)? else {
                    complete = false;
                    break 'cases;
                };
                let view = View { up: [0.0, 1.0, 0.0], ..Default::default() };
                let options = StripOptions { view, ..Default::default() };
                let image = strip(&trajectory, &prepared.setup.model.cloths[0].handles, &options);
                let CaseScore { grid, iterations, case, .. } = &score;
                let file = format!("{}_{iterations}_{grid}_{case}.png", entry.name).replace(' ', "_");
                write_png(self.out.join(file), &image)?;
                scores.push((number, score));
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        let of = |(number, entry): (usize, &Entry)| {
            let own: Vec<CaseScore> =
                scores.iter().filter(|(of, _)| *of == number).map(|(_, score)| score.clone()).collect();
            suite::table(&entry.name, &own)
        };
        let tables: Vec<Table> = entries.iter().enumerate().map(of).collect();
        let named: Vec<_> = scores
            .iter()
            .map(|(number, score)| serde_json::json!({"solver": entries[*number].name, "score": score}))
            .collect();
        self.write_tables(&tables, &named)?;
        if !complete {
            eprintln!("interrupted; the cases so far are above");
        }
        let sound = scores.iter().all(|(_, score)| score.sound());
        Ok(match (complete, sound) {
            (false, _) => Ending::Interrupted,
            (true, false) => Ending::CheckFailed,
            (true, true) => Ending::Done,
        })
    }
}
