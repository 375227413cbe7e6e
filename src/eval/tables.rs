//! Scores as tables, shaped like the paper's.

use super::{Score, mean_and_deviation};

/// Columns of a terminal: a wider table is written in parts.
const WIDTH: usize = 120;

/// A table of texts, in which the best number of each row may be marked.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Heads of the columns, that of the row names first.
    pub columns: Vec<String>,
    /// Name and cells of each row.
    pub rows: Vec<(String, Vec<Cell>)>,
}

/// A cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// What it says.
    pub text: String,
    /// Whether it is the best of its row.
    pub best: bool,
}

/// How a table is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Aligned columns; the best in bold where asked for.
    Text {
        /// Whether escapes for bold are understood.
        bold: bool,
    },
    /// Markdown, the best in bold.
    Markdown,
    /// Comma-separated values, the title as a comment.
    Csv,
}

/// What stands where a solver diverged.
const DIVERGED: &str = "-";

/// A figure of a score.
struct Figure {
    title: &'static str,
    of: fn(&Score) -> Option<f64>,
    factor: f64,
    digits: usize,
}

/// The figures that have a table of their own for each grid: rows are sequences, columns are solvers.
const FIGURES: [Figure; 4] = [
    Figure { title: "e_CD x 10^3 [m^2]", of: |s| s.e_cd, factor: 1e3, digits: 2 },
    Figure { title: "e_3D x 10^2", of: |s| s.e_3d, factor: 1e2, digits: 2 },
    Figure { title: "|dL/da| in the last iteration x 10^3", of: |s| s.gradient, factor: 1e3, digits: 3 },
    Figure {
        title: "largest stretch away from handles x 10^2",
        of: |s| s.stretch_largest,
        factor: 1e2,
        digits: 1,
    },
];

/// The tables of some scores: errors, gradient and stretch per sequence for each grid, with means and deviations; then, of every
/// solver on every grid, error and time, the energy and how it is made up, and the repulsion.
pub fn tables(scores: &[Score]) -> Vec<Table> {
    let grids = distinct(scores.iter().map(|s| s.grid.clone()));
    let solvers = distinct(scores.iter().map(Score::column));
    let mut tables = Vec::new();
    for grid in &grids {
        let here: Vec<&Score> = scores.iter().filter(|s| s.grid == *grid).collect();
        for figure in &FIGURES {
            if here.iter().any(|s| (figure.of)(s).is_some()) {
                tables.push(per_sequence(figure, grid, &here, &solvers));
            }
        }
    }
    let mut groups: Vec<Group> = Vec::new();
    for (grid, solver) in grids.iter().flat_map(|grid| solvers.iter().map(move |solver| (grid, solver))) {
        let scores: Vec<&Score> =
            scores.iter().filter(|s| s.grid == *grid && s.column() == *solver).collect();
        if !scores.is_empty() {
            groups.push(Group { name: format!("{grid} {solver}"), scores });
        }
    }
    let summaries: [(&str, &[Mean]); 3] =
        [("error and time", &ERROR_AND_TIME), ("energy and stretch", &ENERGY), ("repulsion and rest", &REST)];
    tables.extend(summaries.map(|(title, means)| summary(title, &groups, means)));
    tables
}

/// The values, each once, in the order of their first appearance.
fn distinct(values: impl Iterator<Item = String>) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

fn per_sequence(figure: &Figure, grid: &str, scores: &[&Score], solvers: &[String]) -> Table {
    let sequences = distinct(scores.iter().map(|s| s.sequence.clone()));
    let value = |sequence: &str, solver: &str| -> Option<Option<f64>> {
        let score = scores.iter().find(|s| s.sequence == sequence && s.column() == solver)?;
        Some((figure.of)(score).filter(|_| score.stable).map(|v| figure.factor * v))
    };
    let row = |sequence: &String| {
        let values: Vec<_> = solvers.iter().map(|solver| value(sequence, solver)).collect();
        (sequence.clone(), cells(&values, figure.digits))
    };
    let mut rows: Vec<_> = sequences.iter().map(row).collect();
    // Of the sequences, all of which a solver must have passed.
    let summary = |solver: &String| -> Option<Option<(f64, f64)>> {
        let values: Vec<Option<f64>> = sequences.iter().filter_map(|s| value(s, solver)).collect();
        if values.is_empty() {
            return None;
        }
        Some(values.into_iter().collect::<Option<Vec<f64>>>().map(|v| mean_and_deviation(&v)))
    };
    let summaries: Vec<_> = solvers.iter().map(summary).collect();
    let part = |of: fn((f64, f64)) -> f64| summaries.iter().map(|s| s.map(|s| s.map(of))).collect::<Vec<_>>();
    rows.push(("mean".into(), cells(&part(|s| s.0), figure.digits)));
    let mut deviations = cells(&part(|s| s.1), figure.digits);
    deviations.iter_mut().for_each(|cell| cell.best = false);
    rows.push(("deviation".into(), deviations));
    let columns = std::iter::once("sequence".into()).chain(solvers.iter().cloned()).collect();
    Table { title: format!("{grid}: {}", figure.title), columns, rows }
}

/// The scores of one solver on one grid.
struct Group<'a> {
    name: String,
    scores: Vec<&'a Score>,
}

/// A mean over the sequences, and whether its deviation stands beside it.
struct Mean {
    figure: Figure,
    deviation: bool,
}

const fn mean(
    title: &'static str,
    of: fn(&Score) -> Option<f64>,
    (factor, digits): (f64, usize),
    deviation: bool,
) -> Mean {
    Mean { figure: Figure { title, of, factor, digits }, deviation }
}

const ERROR_AND_TIME: [Mean; 3] = [
    mean("e_CD x 10^3 [m^2]", |s| s.e_cd, (1e3, 2), true),
    mean("e_3D x 10^2", |s| s.e_3d, (1e2, 2), true),
    mean("ms/frame", |s| s.ms_per_frame, (1.0, 1), true),
];

/// In grid units.
const ENERGY: [Mean; 7] = [
    mean("energy", |s| s.energy, (1.0, 4), false),
    mean("stretch", |s| s.energy_terms.map(|e| e.stretch), (1.0, 4), false),
    mean("shear", |s| s.energy_terms.map(|e| e.shear), (1.0, 4), false),
    mean("bend", |s| s.energy_terms.map(|e| e.bend), (1.0, 4), false),
    mean("inertia", |s| s.energy_terms.map(|e| e.inertia), (1.0, 4), false),
    mean("external", |s| s.energy_terms.map(|e| e.external), (1.0, 4), false),
    mean("mean stretch x 10^2", |s| s.stretch_mean, (1e2, 2), false),
];

const REST: [Mean; 4] = [
    mean("repulsion", |s| s.repulsion.map(|r| r[0]), (1.0, 3), false),
    mean("share > 0.1", |s| s.repulsion.map(|r| r[1]), (1.0, 3), false),
    mean("share > 0.02", |s| s.repulsion.map(|r| r[2]), (1.0, 3), false),
    mean("speed at the end [m/s]", |s| s.speed_at_end, (1.0, 3), false),
];

/// Means over the sequences, all of which a solver must have passed.
fn summary(title: &str, groups: &[Group], means: &[Mean]) -> Table {
    let of_group = |group: &Group, Mean { figure, deviation }: &Mean| {
        let values = group.scores.iter().map(|s| (figure.of)(s).filter(|_| s.stable));
        // What no score can tell is left empty: another system has no time, and no energy.
        let told = group.scores.iter().any(|s| !s.stable || (figure.of)(s).is_some());
        let both = values.collect::<Option<Vec<f64>>>().map(|values| mean_and_deviation(&values));
        let mut own = cells(&[told.then(|| both.map(|(mean, _)| figure.factor * mean))], figure.digits);
        if *deviation {
            let several =
                both.filter(|_| group.scores.len() > 1).map(|(_, apart)| Some(figure.factor * apart));
            own.extend(cells(&[several], figure.digits));
        }
        own
    };
    let heads = means
        .iter()
        .flat_map(|Mean { figure, deviation }| [figure.title].into_iter().chain(deviation.then_some("±")));
    let columns = ["solver", "sequences"].into_iter().chain(heads).map(str::to_owned).collect();
    let row = |group: &Group| {
        let count = Cell { text: group.scores.len().to_string(), best: false };
        let cells = means.iter().flat_map(|mean| of_group(group, mean));
        (group.name.clone(), std::iter::once(count).chain(cells).collect())
    };
    Table { title: title.to_owned(), columns, rows: groups.iter().map(row).collect() }
}

/// Cells of a row of numbers, the smallest marked; empty where there was none, a dash where a solver diverged.
fn cells(values: &[Option<Option<f64>>], digits: usize) -> Vec<Cell> {
    let smallest = values.iter().flatten().flatten().copied().fold(f64::INFINITY, f64::min);
    let cell = |value: &Option<Option<f64>>| match value {
        None => Cell { text: String::new(), best: false },
        Some(None) => Cell { text: DIVERGED.into(), best: false },
        Some(Some(v)) => Cell { text: format!("{v:.digits$}"), best: values.len() > 1 && *v == smallest },
    };
    values.iter().map(cell).collect()
}

impl Table {
    /// The table as text.
    pub fn write(&self, format: Format) -> String {
        match format {
            Format::Text { bold } => self.aligned(bold),
            Format::Markdown => self.markdown(),
            Format::Csv => self.csv(),
        }
    }

    fn aligned(&self, bold: bool) -> String {
        let mut widths: Vec<usize> = self.columns.iter().map(|c| c.chars().count()).collect();
        for (name, cells) in &self.rows {
            widths[0] = widths[0].max(name.chars().count());
            for (width, cell) in widths[1..].iter_mut().zip(cells) {
                *width = (*width).max(cell.text.chars().count());
            }
        }
        let mut text = format!("{}\n", self.title);
        let first = |name: &str| format!("{name:<width$}", width = widths[0]);
        let mut from = 1;
        while from < widths.len() {
            // As many columns as fit, one at least.
            let mut until = from + 1;
            let width = |until: usize| widths[0] + widths[from..until].iter().map(|w| w + 2).sum::<usize>();
            while until < widths.len() && width(until + 1) <= WIDTH {
                until += 1;
            }
            let part = from..until;
            let heads = self.columns[part.clone()].iter().zip(&widths[part.clone()]);
            let heads = heads.map(|(c, width)| format!("  {c:>width$}")).collect::<String>();
            text += &format!("{}{heads}\n", first(&self.columns[0]));
            for (name, cells) in &self.rows {
                text += &first(name);
                for (cell, width) in cells[from - 1..until - 1].iter().zip(&widths[part.clone()]) {
                    let padded = format!("{:>width$}", cell.text);
                    text += &match bold && cell.best {
                        true => format!("  \x1b[1m{padded}\x1b[0m"),
                        false => format!("  {padded}"),
                    };
                }
                text.push('\n');
            }
            from = until;
        }
        text
    }

    fn markdown(&self) -> String {
        let mut text = format!("**{}**\n\n| {} |\n", self.title, self.columns.join(" | "));
        text += &format!("|---|{}\n", "---:|".repeat(self.columns.len() - 1));
        for (name, cells) in &self.rows {
            let marked = |c: &Cell| if c.best { format!("**{}**", c.text) } else { c.text.clone() };
            text += &format!("| {name} | {} |\n", cells.iter().map(marked).collect::<Vec<_>>().join(" | "));
        }
        text
    }

    fn csv(&self) -> String {
        let quoted = |field: &str| match field.contains([',', '"']) {
            true => format!("\"{}\"", field.replace('"', "\"\"")),
            false => field.to_owned(),
        };
        let line = |fields: Vec<String>| format!("{}\n", fields.join(","));
        let mut text = format!("# {}\n", self.title);
        text += &line(self.columns.iter().map(|c| quoted(c)).collect());
        for (name, cells) in &self.rows {
            let fields = std::iter::once(name.as_str()).chain(cells.iter().map(|c| c.text.as_str()));
            text += &line(fields.map(quoted).collect());
        }
        text
    }
}
