//! What is said and written once there are scores.

use super::{Args, STDOUT};
use crate::cli::output::{output, status};
use anyhow::Result;
use fnopt::Error;
use fnopt::eval::{Conditions, Format, OverRepeats, Score, Table};
use fnopt::io::write_atomic;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{IsTerminal, Write};
use std::path::Path;

impl Args {
    /// Writes the requested files and prints the tables, unless one of the files is the standard output. If the
    /// files fail, the tables are still printed.
    pub(super) fn write_tables(&self, tables: &[Table], scores: &[impl serde::Serialize]) -> Result<()> {
        let content = |what: Written| match what {
            Written::Scores => as_json(scores) + "\n",
            Written::Tables(Format::Csv) => Table::cells_as_csv(tables),
            Written::Tables(format) => text(tables, format),
        };
        let is_printed = |file: &Path| file == Path::new(STDOUT);
        let mut printed = Written::Tables(Format::Text { bold: std::io::stdout().is_terminal() });
        let mut failed: Vec<Error> = Vec::new();
        for (what, file) in self.files() {
            match file {
                Some(file) if is_printed(file) => printed = what,
                Some(file) => {
                    let written = write_atomic(file, |to| to.write_all(content(what).as_bytes()));
                    failed.extend(written.err());
                }
                None => {}
            }
        }
        write!(output(), "{}", content(printed))?;
        let mut failed = failed.into_iter();
        let first = failed.next();
        failed.for_each(|error| status!("error: {error}"));
        first.map_or(Ok(()), |error| Err(error.into()))
    }
}

/// What is written into a file or printed.
#[derive(Clone, Copy)]
pub(super) enum Written {
    /// The scores as JSON.
    Scores,
    /// The tables.
    Tables(Format),
}

/// A score as written to JSON.
#[derive(serde::Serialize)]
pub(super) struct Document<'a> {
    #[serde(flatten)]
    score: &'a Score,
    /// Means over all repeats, only with the score from the recorded start and if there are several repeats.
    #[serde(skip_serializing_if = "Option::is_none")]
    over_repeats: Option<OverRepeats>,
}

pub(super) fn documents(scores: &[Score]) -> Vec<Document<'_>> {
    let over_repeats = |score: &Score| {
        let first = score.made_with.nudge.is_none();
        first.then(|| OverRepeats::of(score, scores)).filter(|all| all.repeats > 1)
    };
    scores.iter().map(|score| Document { score, over_repeats: over_repeats(score) }).collect()
}

/// Warns if times were measured in ways that do not compare: stored scores may come from another number of
/// threads or another GPU.
pub(super) fn tell_devices<'a>(timed: impl Iterator<Item = (&'a Conditions, Option<f64>)>) {
    let mut devices: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (made_with, _) in timed.filter(|(_, ms)| ms.is_some()) {
        if let (Some(kind), Some(device)) = (&made_with.kind, &made_with.device) {
            devices.entry(kind).or_default().insert(device);
        }
    }
    for several in devices.values().filter(|devices| devices.len() > 1) {
        let several: Vec<_> = several.iter().copied().collect();
        let others = several.join(", others on ");
        status!("ms/frame values are not all comparable: some were measured on {others}");
    }
}

/// Returns what [`tell_devices`] takes of scores.
pub(super) fn timed(scores: &[Score]) -> impl Iterator<Item = (&Conditions, Option<f64>)> {
    scores.iter().map(|score| (&score.made_with, score.ms_per_frame))
}

fn as_json(scores: &[impl serde::Serialize]) -> String {
    serde_json::to_string_pretty(scores).expect("scores are plain data")
}

fn text(tables: &[Table], format: Format) -> String {
    tables.iter().map(|table| table.write(format)).collect::<Vec<_>>().join("\n")
}

/// Lists up to this many of what is missing or went wrong.
const LISTED: usize = 5;

/// Says which sequences a solver on a grid lacks, so that its means are not over the same ones as others'.
pub(super) fn tell_missing(scores: &[Score]) {
    let own: Vec<&Score> = scores.iter().filter(|score| !score.is_imported()).collect();
    let name = |column: &str, sequence: &str, grid: &str| format!("{column} on {sequence}, {grid}");
    let there: BTreeSet<_> = own.iter().map(|s| name(&s.column(), &s.sequence, &s.grid)).collect();
    let columns: BTreeSet<_> = own.iter().map(|s| (&s.grid, s.column())).collect();
    let sequences: BTreeSet<_> = own.iter().map(|s| &s.sequence).collect();
    let all = columns.iter().flat_map(|(grid, column)| sequences.iter().map(|s| name(column, s, grid)));
    tell_list("no score of", all.filter(|name| !there.contains(name)).collect());
}

/// Says which scores of Newton's method are not of converged frames.
pub(super) fn tell_unconverged(scores: &[Score]) {
    let missed = scores.iter().filter_map(|score| {
        let count = score.unconverged.filter(|&count| count > 0)?;
        Some(format!("{count} of {} frames of {}, {}", score.frames, score.sequence, score.grid))
    });
    tell_list("newton did not converge in", missed.collect());
}

fn tell_list(what: &str, all: Vec<String>) {
    if all.is_empty() {
        return;
    }
    let more = match all.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    status!("warning: {what} {}{more}", all[..all.len().min(LISTED)].join("; "));
}
