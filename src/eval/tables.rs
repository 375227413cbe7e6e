//! Scores as tables, shaped like the paper's.

use super::{Score, mean_and_deviation};

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
    Figure { title: "|dL/da| at the end of a frame x 10^3", of: |s| s.gradient, factor: 1e3, digits: 3 },
    Figure {
        title: "largest stretch away from handles x 10^2",
        of: |s| s.stretch_largest,
        factor: 1e2,
        digits: 1,
    },
];

/// The tables of some scores: errors, gradient and stretch per sequence for each grid, with means and deviations; then error
/// and time of every solver on every grid; and the repulsion.
pub fn tables(scores: &[Score]) -> Vec<Table> {
    let grids = distinct(scores.iter().map(|s| s.grid.clone()));
    let solvers = distinct(scores.iter().map(column));
    let mut tables = Vec::new();
    for grid in &grids {
        let here: Vec<&Score> = scores.iter().filter(|s| s.grid == *grid).collect();
        for figure in &FIGURES {
            if here.iter().any(|s| (figure.of)(s).is_some()) {
                tables.push(per_sequence(figure, grid, &here, &solvers));
            }
        }
    }
    tables.push(overview(scores, &grids, &solvers));
    tables.push(repulsion(scores, &grids, &solvers));
    tables
}

/// Name of the column of a score: the solver and its iterations.
fn column(score: &Score) -> String {
    match score.iterations {
        0 => score.solver.clone(),
        n => format!("{}, N = {n}", score.solver),
    }
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
        let score = scores.iter().find(|s| s.sequence == sequence && column(s) == solver)?;
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

/// Mean error and median time of each solver on each grid.
fn overview(scores: &[Score], grids: &[String], solvers: &[String]) -> Table {
    let mut columns = vec!["solver".to_owned()];
    columns.extend(grids.iter().flat_map(|g| [format!("{g} e_CD x 10^3"), format!("{g} ms/frame")]));
    let mean = |grid: &String, solver: &String, of: fn(&Score) -> Option<f64>| -> Option<Option<f64>> {
        let here: Vec<&Score> = scores.iter().filter(|s| s.grid == *grid && column(s) == *solver).collect();
        if here.is_empty() {
            return None;
        }
        let values: Option<Vec<f64>> = here.iter().map(|s| of(s).filter(|_| s.stable)).collect();
        Some(values.map(|values| mean_and_deviation(&values).0))
    };
    let row = |solver: &String| {
        let of_grid = |grid: &String| {
            let mut both = cells(&[mean(grid, solver, |s| s.e_cd.map(|e| 1e3 * e))], 2);
            both.extend(cells(&[mean(grid, solver, |s| s.ms_per_frame)], 1));
            both.iter_mut().for_each(|cell| cell.best = false);
            both
        };
        (solver.clone(), grids.iter().flat_map(of_grid).collect())
    };
    Table { title: "error and time".into(), columns, rows: solvers.iter().map(row).collect() }
}

/// Mean repulsion energy, shares of frames above 0.1 and 0.02, and the speed at the end.
fn repulsion(scores: &[Score], grids: &[String], solvers: &[String]) -> Table {
    let mut rows = Vec::new();
    for grid in grids {
        for solver in solvers {
            let here: Vec<&Score> =
                scores.iter().filter(|s| s.grid == *grid && column(s) == *solver).collect();
            let mean = |of: &dyn Fn(&Score) -> Option<f64>| {
                let values: Option<Vec<f64>> = here.iter().map(|s| of(s)).collect();
                Some(values.filter(|v| !v.is_empty()).map(|v| mean_and_deviation(&v).0))
            };
            if here.is_empty() {
                continue;
            }
            let mut row: Vec<Cell> = [0, 1, 2]
                .into_iter()
                .flat_map(|k| cells(&[mean(&|s| s.repulsion.map(|r| r[k]))], 3))
                .collect();
            row.extend(cells(&[mean(&|s| s.speed_at_end)], 3));
            row.iter_mut().for_each(|cell| cell.best = false);
            rows.push((format!("{grid} {solver}"), row));
        }
    }
    let columns = ["solver", "repulsion", "share > 0.1", "share > 0.02", "speed at the end [m/s]"];
    Table { title: "repulsion and rest".into(), columns: columns.map(str::to_owned).to_vec(), rows }
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
        let heads = self.columns[1..].iter().zip(&widths[1..]).map(|(c, width)| format!("  {c:>width$}"));
        text += &format!("{}{}\n", first(&self.columns[0]), heads.collect::<String>());
        for (name, cells) in &self.rows {
            text += &first(name);
            for (cell, width) in cells.iter().zip(&widths[1..]) {
                let padded = format!("{:>width$}", cell.text);
                text += &match bold && cell.best {
                    true => format!("  \x1b[1m{padded}\x1b[0m"),
                    false => format!("  {padded}"),
                };
            }
            text.push('\n');
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
