//! Scores as tables, shaped like the paper's.

use super::repeats::mean_over_repeats;
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
pub(super) const DIVERGED: &str = "-";

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
                tables.extend(per_sequence(figure, grid, &here, &solvers));
            }
        }
    }
    let mut groups: Vec<Group> = Vec::new();
    for (grid, solver) in grids.iter().flat_map(|grid| solvers.iter().map(move |solver| (grid, solver))) {
        let own = || scores.iter().filter(|s| s.grid == *grid && s.column() == *solver);
        let of_sequence = |name: &String| own().filter(|s| s.sequence == *name).collect();
        let sequences: Vec<Vec<&Score>> =
            distinct(own().map(|s| s.sequence.clone())).iter().map(of_sequence).collect();
        if !sequences.is_empty() {
            groups.push(Group { name: format!("{grid} {solver}"), sequences });
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

/// Rows are sequences, each a mean over its repeats; where there are several, a second table has their deviations.
fn per_sequence(figure: &Figure, grid: &str, scores: &[&Score], solvers: &[String]) -> Vec<Table> {
    let sequences = distinct(scores.iter().map(|s| s.sequence.clone()));
    let of = |sequence: &str, solver: &str| -> Option<Spread> {
        let own = |s: &&&Score| s.sequence == sequence && s.column() == solver;
        let repeats: Vec<&Score> = scores.iter().filter(own).copied().collect();
        (!repeats.is_empty()).then(|| Spread::new(&repeats, figure))
    };
    let spreads: Vec<Vec<Option<Spread>>> =
        sequences.iter().map(|s| solvers.iter().map(|solver| of(s, solver)).collect()).collect();
    let columns: Vec<String> = std::iter::once("sequence".into()).chain(solvers.iter().cloned()).collect();
    let row = |(name, spreads): (&String, &Vec<Option<Spread>>)| {
        let means: Vec<_> = spreads.iter().map(|s| s.map(|s| s.mean)).collect();
        (name.clone(), cells(&means, figure.digits))
    };
    let mut rows: Vec<_> = sequences.iter().zip(&spreads).map(row).collect();
    // Of the sequences, all of which a solver must have passed.
    let summary = |solver: usize| -> Option<Option<(f64, f64)>> {
        let means: Vec<Option<f64>> = spreads.iter().filter_map(|s| s[solver]).map(|s| s.mean).collect();
        if means.is_empty() {
            return None;
        }
        Some(means.into_iter().collect::<Option<Vec<f64>>>().map(|v| mean_and_deviation(&v)))
    };
    let summaries: Vec<_> = (0..solvers.len()).map(summary).collect();
    let part = |of: fn((f64, f64)) -> f64| summaries.iter().map(|s| s.map(|s| s.map(of))).collect::<Vec<_>>();
    rows.push(("mean".into(), cells(&part(|s| s.0), figure.digits)));
    rows.push(("deviation".into(), unmarked(&part(|s| s.1), figure.digits)));
    let title = format!("{grid}: {}", figure.title);
    if spreads.iter().flatten().flatten().all(|s| s.repeats < 2) {
        return vec![Table { title, columns, rows }];
    }
    let row = |(name, spreads): (&String, &Vec<Option<Spread>>)| {
        let deviations: Vec<_> = spreads.iter().map(|s| s.and_then(|s| s.told_deviation())).collect();
        (name.clone(), unmarked(&deviations, figure.digits))
    };
    let mut of_repeats: Vec<_> = sequences.iter().zip(&spreads).map(row).collect();
    let all: Vec<_> =
        (0..solvers.len()).map(|solver| pooled(spreads.iter().filter_map(|s| s[solver]))).collect();
    of_repeats.push(("root mean square".into(), unmarked(&all, figure.digits)));
    vec![
        Table { title: format!("{title}, means over repeats"), columns: columns.clone(), rows },
        Table { title: format!("{title}, deviations over repeats"), columns, rows: of_repeats },
    ]
}

/// A figure of the repeats of a solver on a sequence: how many, their mean and their deviation, which there are none of where
/// one of them diverged.
#[derive(Clone, Copy)]
struct Spread {
    repeats: usize,
    mean: Option<f64>,
    deviation: Option<f64>,
}

impl Spread {
    fn new(repeats: &[&Score], figure: &Figure) -> Self {
        let both = mean_over_repeats(repeats, figure.of);
        Self {
            repeats: repeats.len(),
            mean: both.map(|(mean, _)| figure.factor * mean),
            deviation: both.map(|(_, apart)| figure.factor * apart),
        }
    }

    /// The deviation as a cell takes it: a single simulation tells nothing of it.
    fn told_deviation(self) -> Option<Option<f64>> {
        (self.repeats > 1).then_some(self.deviation)
    }
}

/// The deviation over repeats, as the root of the mean of its squares over the sequences that were repeated.
fn pooled(spreads: impl Iterator<Item = Spread>) -> Option<Option<f64>> {
    let deviations: Vec<Option<f64>> = spreads.filter_map(Spread::told_deviation).collect();
    let square = |v: Vec<f64>| (v.iter().map(|d| d * d).sum::<f64>() / v.len() as f64).sqrt();
    (!deviations.is_empty()).then(|| deviations.into_iter().collect::<Option<Vec<f64>>>().map(square))
}

/// The scores of one solver on one grid.
struct Group<'a> {
    name: String,
    /// The repeats of each sequence.
    sequences: Vec<Vec<&'a Score>>,
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

/// Means over the sequences, all of which a solver must have passed; of repeated ones, of their means.
fn summary(title: &str, groups: &[Group], means: &[Mean]) -> Table {
    let repeated = groups.iter().flat_map(|group| &group.sequences).any(|repeats| repeats.len() > 1);
    let of_group = |group: &Group, Mean { figure, deviation }: &Mean| {
        let spreads: Vec<Spread> = group.sequences.iter().map(|s| Spread::new(s, figure)).collect();
        // What no score can tell is left empty: another system has no time, and no energy.
        let mut all = group.sequences.iter().flatten();
        let told = all.any(|s| !s.stable || (figure.of)(s).is_some());
        let both =
            spreads.iter().map(|s| s.mean).collect::<Option<Vec<f64>>>().map(|v| mean_and_deviation(&v));
        let mut own = vec![told.then(|| both.map(|(mean, _)| mean))];
        if *deviation {
            own.push(both.filter(|_| spreads.len() > 1).map(|(_, apart)| Some(apart)));
            if repeated {
                own.push(pooled(spreads.into_iter()).filter(|_| told));
            }
        }
        unmarked(&own, figure.digits)
    };
    let heads = means.iter().flat_map(|Mean { figure, deviation }| {
        let deviations = [(*deviation, "±"), (*deviation && repeated, "± repeats")];
        let told = deviations.into_iter().filter_map(|(told, head)| told.then_some(head));
        std::iter::once(figure.title).chain(told)
    });
    let counts = ["sequences"].into_iter().chain(repeated.then_some("simulations"));
    let columns = ["solver"].into_iter().chain(counts).chain(heads).map(str::to_owned).collect();
    let row = |group: &Group| {
        let simulations = group.sequences.iter().map(Vec::len).sum::<usize>();
        let counts = [group.sequences.len()].into_iter().chain(repeated.then_some(simulations));
        let counts = counts.map(|count| Cell { text: count.to_string(), best: false });
        let cells = means.iter().flat_map(|mean| of_group(group, mean));
        (group.name.clone(), counts.chain(cells).collect())
    };
    Table { title: title.to_owned(), columns, rows: groups.iter().map(row).collect() }
}

/// Cells of numbers of which none is the best.
fn unmarked(values: &[Option<Option<f64>>], digits: usize) -> Vec<Cell> {
    let mut cells = cells(values, digits);
    cells.iter_mut().for_each(|cell| cell.best = false);
    cells
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
