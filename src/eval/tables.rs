//! Tables of scores, laid out like the paper's.

use super::repeats::mean_over_repeats;
use super::score::column;
use super::{Cell, Score, Table, mean_and_deviation};

/// The text of a cell whose solver diverged.
pub(super) const DIVERGED: &str = "-";

/// A numerical figure of a score.
struct Figure {
    title: &'static str,
    of: fn(&Score) -> Option<f64>,
    factor: f64,
    digits: usize,
}

const E_CD: Figure = Figure { title: "e_CD x 10^3 [m^2]", of: |s| s.e_cd, factor: 1e3, digits: 2 };
const E_3D: Figure = Figure { title: "e_3D x 10^2", of: |s| s.e_3d, factor: 1e2, digits: 2 };
const TIME: Figure = Figure { title: "ms/frame", of: |s| s.ms_per_frame, factor: 1.0, digits: 1 };

/// The figures that have one table per grid: rows are sequences, columns are solvers.
const BY_SEQUENCE: [Figure; 4] = [
    E_CD,
    E_3D,
    Figure { title: "|dL/da| at the end of the frame x 10^3", of: |s| s.gradient, factor: 1e3, digits: 3 },
    Figure {
        title: "largest stretch away from handles x 10^2",
        of: |s| s.stretch_largest,
        factor: 1e2,
        digits: 1,
    },
];

/// The energy and its terms, in grid units.
const ENERGY: [Figure; 7] = [
    Figure { title: "energy", of: |s| s.energy, factor: 1.0, digits: 4 },
    Figure { title: "stretch", of: |s| s.energy_terms.map(|e| e.stretch), factor: 1.0, digits: 4 },
    Figure { title: "shear", of: |s| s.energy_terms.map(|e| e.shear), factor: 1.0, digits: 4 },
    Figure { title: "bend", of: |s| s.energy_terms.map(|e| e.bend), factor: 1.0, digits: 4 },
    Figure { title: "inertia", of: |s| s.energy_terms.map(|e| e.inertia), factor: 1.0, digits: 4 },
    Figure { title: "external", of: |s| s.energy_terms.map(|e| e.external), factor: 1.0, digits: 4 },
    Figure { title: "mean stretch x 10^2", of: |s| s.stretch_mean, factor: 1e2, digits: 2 },
];

const REST: [Figure; 4] = [
    Figure { title: "repulsion", of: |s| s.repulsion.map(|r| r[0]), factor: 1.0, digits: 3 },
    Figure { title: "share > 0.1", of: |s| s.repulsion.map(|r| r[1]), factor: 1.0, digits: 3 },
    Figure { title: "share > 0.02", of: |s| s.repulsion.map(|r| r[2]), factor: 1.0, digits: 3 },
    Figure { title: "speed at the end [m/s]", of: |s| s.speed_at_end, factor: 1.0, digits: 3 },
];

/// Builds the tables of some scores: errors, gradient and stretch per sequence for each grid, with means and
/// deviations; errors and times by grid and number of iterations, if there are several; then, for every
/// solver on every grid, error and time, the energy and its terms, and the repulsion.
pub fn tables(scores: &[Score]) -> Vec<Table> {
    let groups = groups(scores);
    let mut tables = Vec::new();
    for grid in distinct(own(groups.iter()).map(|group| group.grid.clone())) {
        // Another system has a grid of its own, and is shown next to the solvers on every grid.
        let is_shown = |group: &&Group| group.grid == grid || group.is_imported();
        let here: Vec<&Group> = groups.iter().filter(is_shown).collect();
        for figure in &BY_SEQUENCE {
            // A column of those that diverged shows dashes.
            if here.iter().any(|group| group.scores().any(|s| !s.stable || (figure.of)(s).is_some())) {
                tables.extend(per_sequence(figure, &grid, &here));
            }
        }
    }
    tables.extend(by_iterations_and_grid(&groups));
    tables.push(summary("error and time", &groups, &[E_CD, E_3D, TIME], true));
    tables.push(summary("energy and stretch", &groups, &ENERGY, false));
    tables.push(summary("repulsion and rest", &groups, &REST, false));
    tables
}

/// The scores of one solver on one grid.
struct Group<'a> {
    grid: String,
    solver: String,
    iterations: usize,
    /// Name and repeats of each sequence.
    sequences: Vec<(String, Vec<&'a Score>)>,
}

impl<'a> Group<'a> {
    /// Returns the name of the solver's column, with its iterations if they are meaningful.
    fn column(&self) -> String {
        column(&self.solver, self.iterations)
    }

    /// Returns the name of that column in the table of a grid, with the group's own grid if that is another.
    fn column_on(&self, grid: &str) -> String {
        if self.grid == grid { self.column() } else { format!("{} ({})", self.column(), self.grid) }
    }

    /// Whether the scores are of another system.
    fn is_imported(&self) -> bool {
        self.scores().all(Score::is_imported)
    }

    fn scores(&self) -> impl Iterator<Item = &'a Score> {
        self.sequences.iter().flat_map(|(_, repeats)| repeats.iter().copied())
    }

    /// Returns the spread of a figure on a sequence; `None` if no score of it has the figure or diverged.
    fn spread(&self, sequence: &str, figure: &Figure) -> Option<Spread> {
        let (_, repeats) = self.sequences.iter().find(|(name, _)| name == sequence)?;
        let shown = repeats.iter().any(|s| !s.stable || (figure.of)(s).is_some());
        shown.then(|| Spread::new(repeats, figure))
    }

    /// Returns the spread of a figure on every sequence.
    fn spreads(&self, figure: &Figure) -> impl Iterator<Item = Spread> {
        self.sequences.iter().map(|(_, repeats)| Spread::new(repeats, figure))
    }

    /// Returns the mean of a figure over the sequences, and the deviation if there are several. A figure that
    /// no score has is left empty: another system has no time and no energy.
    fn mean_and_deviation(&self, figure: &Figure) -> [CellValue; 2] {
        let shown = self.scores().any(|s| !s.stable || (figure.of)(s).is_some());
        match over_sequences(self.spreads(figure)).when(shown) {
            CellValue::Nothing => [CellValue::Nothing; 2],
            CellValue::Diverged => [CellValue::Diverged, CellValue::Nothing],
            CellValue::Value((mean, apart)) => {
                [CellValue::Value(mean), CellValue::Value(apart).when(self.sequences.len() > 1)]
            }
        }
    }
}

/// The content of a cell.
#[derive(Clone, Copy)]
enum CellValue<T = f64> {
    /// Nothing: no score has the figure.
    Nothing,
    /// A mark that the solver diverged.
    Diverged,
    /// A figure.
    Value(T),
}

impl<T> CellValue<T> {
    /// Wraps the figure of a solver; `None` means that it diverged.
    fn of(figure: Option<T>) -> Self {
        figure.map_or(Self::Diverged, Self::Value)
    }

    /// Returns `self` if `shown`, otherwise `Nothing`.
    fn when(self, shown: bool) -> Self {
        if shown { self } else { Self::Nothing }
    }

    fn map<U>(self, of: impl FnOnce(T) -> U) -> CellValue<U> {
        match self {
            Self::Nothing => CellValue::Nothing,
            Self::Diverged => CellValue::Diverged,
            Self::Value(figure) => CellValue::Value(of(figure)),
        }
    }

    fn is_nothing(&self) -> bool {
        matches!(self, Self::Nothing)
    }
}

/// Groups scores by grid and solver, in order of first appearance. Other systems come last, each as one
/// group, whatever grids its sequences are on.
fn groups(scores: &[Score]) -> Vec<Group<'_>> {
    let mut groups = by_grid(scores);
    groups.sort_by_key(Group::is_imported);
    let mut joined: Vec<Group<'_>> = Vec::new();
    for group in groups {
        let same = |other: &&mut Group<'_>| {
            other.is_imported() && group.is_imported() && other.solver == group.solver
        };
        match joined.iter_mut().find(same) {
            Some(other) => {
                other.grid = format!("{}, {}", other.grid, group.grid);
                other.sequences.extend(group.sequences);
            }
            None => joined.push(group),
        }
    }
    joined
}

/// Returns the groups of our own solvers, or those of other systems if there are no others.
fn own<'g, 'a: 'g>(
    groups: impl Iterator<Item = &'g Group<'a>> + Clone,
) -> impl Iterator<Item = &'g Group<'a>> {
    let alone = groups.clone().all(Group::is_imported);
    groups.filter(move |group| alone || !group.is_imported())
}

fn by_grid(scores: &[Score]) -> Vec<Group<'_>> {
    let grids = distinct(scores.iter().map(|s| s.grid.clone()));
    let solvers = distinct(scores.iter().map(|s| (s.solver.clone(), s.iterations)));
    let mut groups = Vec::new();
    for (grid, (solver, iterations)) in grids.iter().flat_map(|grid| solvers.iter().map(move |s| (grid, s))) {
        let of_group = |s: &&Score| (&s.grid, &s.solver, &s.iterations) == (grid, solver, iterations);
        let own: Vec<&Score> = scores.iter().filter(of_group).collect();
        let repeats = |name: String| {
            let repeats = own.iter().copied().filter(|s| s.sequence == name).collect();
            (name, repeats)
        };
        let sequences: Vec<_> =
            distinct(own.iter().map(|s| s.sequence.clone())).into_iter().map(repeats).collect();
        if !sequences.is_empty() {
            groups.push(Group {
                grid: grid.clone(),
                solver: solver.clone(),
                iterations: *iterations,
                sequences,
            });
        }
    }
    groups
}

/// Returns the distinct values, in order of first appearance.
fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut found: Vec<T> = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

/// A figure by sequence, for each of some groups.
struct BySequence {
    digits: usize,
    groups: usize,
    rows: Vec<(String, Vec<Option<Spread>>)>,
}

impl BySequence {
    fn new(figure: &Figure, groups: &[&Group]) -> Self {
        let names = |group: &Group| group.sequences.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
        let row = |name: String| {
            let spreads = groups.iter().map(|group| group.spread(&name, figure)).collect();
            (name, spreads)
        };
        // Another system may have sequences that no solver has here.
        let rows = distinct(own(groups.iter().copied()).flat_map(names)).into_iter().map(row).collect();
        Self { digits: figure.digits, groups: groups.len(), rows }
    }

    /// Applies `of` to the sequences of each group.
    fn of_groups<T>(&self, of: fn(&mut dyn Iterator<Item = Spread>) -> T) -> Vec<T> {
        let spreads = |group| self.rows.iter().filter_map(move |(_, spreads)| spreads[group]);
        (0..self.groups).map(|group| of(&mut spreads(group))).collect()
    }

    /// Returns the means over the repeats of each sequence, then their mean and deviation.
    fn means(&self) -> Vec<(String, Vec<Cell>)> {
        let row = |(name, spreads): &(String, Vec<Option<Spread>>)| {
            let means: Vec<_> =
                spreads.iter().map(|s| s.map_or(CellValue::Nothing, |s| CellValue::of(s.mean))).collect();
            (name.clone(), cells(&means, self.digits))
        };
        let all = self.of_groups(|spreads| over_sequences(spreads));
        let counts = self.of_groups(|spreads| spreads.count());
        let mean: Vec<_> = all.iter().map(|both| both.map(|(mean, _)| mean)).collect();
        // A single sequence has no deviation.
        let several = all.iter().zip(&counts).map(|(both, &count)| both.when(count > 1));
        let deviation: Vec<_> = several.map(|both| both.map(|(_, apart)| apart)).collect();
        // Means over different sequences are not comparable, so none is marked.
        let alike = counts.iter().filter(|&&count| count > 0).all(|count| *count == self.rows.len());
        let mean = if alike { cells(&mean, self.digits) } else { unmarked(&mean, self.digits) };
        let last = [("mean".into(), mean), ("deviation".into(), unmarked(&deviation, self.digits))];
        self.rows.iter().map(row).chain(last).collect()
    }

    /// Returns the deviations over the repeats of each sequence, then their root mean square; `None` if no
    /// sequence was repeated.
    fn deviations(&self) -> Option<Vec<(String, Vec<Cell>)>> {
        let all = self.of_groups(|spreads| pooled(spreads));
        (!all.iter().all(CellValue::is_nothing)).then(|| {
            let row = |(name, spreads): &(String, Vec<Option<Spread>>)| {
                let deviations: Vec<_> =
                    spreads.iter().map(|s| s.map_or(CellValue::Nothing, Spread::deviation_cell)).collect();
                (name.clone(), unmarked(&deviations, self.digits))
            };
            let last = ("root mean square".into(), unmarked(&all, self.digits));
            self.rows.iter().map(row).chain([last]).collect()
        })
    }
}

/// Builds a table whose rows are sequences, each a mean over its repeats. If there are several repeats, a
/// second table holds their deviations.
fn per_sequence(figure: &Figure, grid: &str, groups: &[&Group]) -> Vec<Table> {
    let columns = || {
        std::iter::once("sequence".into()).chain(groups.iter().map(|group| group.column_on(grid))).collect()
    };
    let (figures, title) = (BySequence::new(figure, groups), format!("{grid}: {}", figure.title));
    let rows = figures.means();
    match figures.deviations() {
        None => vec![Table { title, columns: columns(), rows }],
        Some(deviations) => vec![
            Table { title: format!("{title}, means over repeats"), columns: columns(), rows },
            Table {
                title: format!("{title}, deviations over repeats"),
                columns: columns(),
                rows: deviations,
            },
        ],
    }
}

/// Builds, for each solver with several grids or numbers of iterations, a table of the errors by sequence
/// (the paper's Table 8), then one of the times and errors of all solvers (its Table 7).
fn by_iterations_and_grid(groups: &[Group]) -> Vec<Table> {
    let mut tables = Vec::new();
    for solver in distinct(groups.iter().map(|group| &group.solver)) {
        let mut own: Vec<&Group> = groups.iter().filter(|group| group.solver == *solver).collect();
        if own.len() > 1 {
            // Keep the order of the grids.
            let grids = distinct(own.iter().map(|group| &group.grid));
            own.sort_by_key(|group| (grids.iter().position(|grid| **grid == group.grid), group.iterations));
            tables.push(both_errors(solver, &own));
        }
    }
    if !tables.is_empty() {
        tables.push(times_and_errors(groups));
    }
    tables
}

/// Builds a table of both errors of a solver by sequence, those of the vertices in parentheses.
fn both_errors(solver: &str, groups: &[&Group]) -> Table {
    let pair = |(a, b): (Cell, Cell)| {
        let text =
            if a.text.is_empty() || a.text == DIVERGED { a.text } else { format!("{} ({})", a.text, b.text) };
        Cell { text, best: false }
    };
    let row = |((name, a), (_, b)): ((String, Vec<Cell>), (String, Vec<Cell>))| {
        (name, a.into_iter().zip(b).map(pair).collect())
    };
    let [a, b] = [&E_CD, &E_3D].map(|figure| BySequence::new(figure, groups).means());
    let heads = groups.iter().map(|group| column(&group.grid, group.iterations));
    Table {
        title: format!("{solver}: {} ({})", E_CD.title, E_3D.title),
        columns: std::iter::once("sequence".into()).chain(heads).collect(),
        rows: a.into_iter().zip(b).map(row).collect(),
    }
}

/// Builds a table of the means and deviations of time and error, with solvers and iterations as rows and
/// grids as columns.
fn times_and_errors(groups: &[Group]) -> Table {
    let figures = [&TIME, &E_CD];
    let grids = distinct(groups.iter().map(|group| &group.grid));
    let heads = figures.iter().flat_map(|figure| {
        grids.iter().flat_map(move |grid| [format!("{grid} {}", figure.title), "±".into()])
    });
    let solvers = distinct(groups.iter().map(|group| &group.solver));
    let place = |solver: &String| solvers.iter().position(|known| *known == solver);
    let mut all =
        distinct(groups.iter().map(|group| (place(&group.solver), group.iterations, group.column())));
    all.sort();
    let row = |(_, _, name): (Option<usize>, usize, String)| {
        let of = |figure: &Figure, grid: &String| {
            let group = groups.iter().find(|group| group.grid == *grid && group.column() == name);
            let both = group.map_or([CellValue::Nothing; 2], |group| group.mean_and_deviation(figure));
            unmarked(&both, figure.digits)
        };
        let cells =
            figures.iter().flat_map(|figure| grids.iter().flat_map(|grid| of(figure, grid))).collect();
        (name, cells)
    };
    Table {
        title: "time and error by iterations and grid".into(),
        columns: std::iter::once("solver".into()).chain(heads).collect(),
        rows: all.into_iter().map(row).collect(),
    }
}

/// A figure over the repeats of a solver on a sequence: the number of repeats, their mean and their
/// deviation, which are `None` if a repeat diverged or lacks the figure.
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

    /// Returns the deviation as the content of a cell: nothing for a single simulation.
    fn deviation_cell(self) -> CellValue {
        CellValue::of(self.deviation).when(self.repeats > 1)
    }
}

/// Returns the mean and deviation over sequences, on all of which a solver must have succeeded; nothing
/// without sequences.
fn over_sequences(spreads: impl Iterator<Item = Spread>) -> CellValue<(f64, f64)> {
    of_all(spreads.map(|s| s.mean).collect()).map(|means| mean_and_deviation(&means))
}

/// Returns the figures: `Diverged` if one is missing, `Nothing` if there are none.
fn of_all(figures: Vec<Option<f64>>) -> CellValue<Vec<f64>> {
    let some = !figures.is_empty();
    CellValue::of(figures.into_iter().collect()).when(some)
}

/// Returns the deviation over repeats: the root mean square over the sequences that were repeated.
fn pooled(spreads: impl Iterator<Item = Spread>) -> CellValue {
    let repeated = spreads.filter(|s| s.repeats > 1).map(|s| s.deviation);
    of_all(repeated.collect()).map(|v| (v.iter().map(|d| d * d).sum::<f64>() / v.len() as f64).sqrt())
}

/// Builds a table of means over the sequences, on all of which a solver must have succeeded; repeated
/// sequences count with their means. `deviations` adds those over sequences and repeats.
fn summary(title: &str, groups: &[Group], figures: &[Figure], deviations: bool) -> Table {
    let repeated = groups.iter().flat_map(|group| &group.sequences).any(|(_, repeats)| repeats.len() > 1);
    let shown = [true, deviations, deviations && repeated];
    let of_group = |group: &Group, figure: &Figure| {
        let [mean, apart] = group.mean_and_deviation(figure);
        let of_repeats = pooled(group.spreads(figure)).when(!mean.is_nothing());
        let values = shown.into_iter().zip([mean, apart, of_repeats]);
        let values: Vec<_> = values.filter_map(|(shown, value)| shown.then_some(value)).collect();
        unmarked(&values, figure.digits)
    };
    let heads = figures.iter().flat_map(|figure| {
        let heads = shown.into_iter().zip([figure.title, "±", "± repeats"]);
        heads.filter_map(|(shown, head)| shown.then_some(head))
    });
    let counts = ["sequences"].into_iter().chain(repeated.then_some("simulations"));
    let columns = ["solver"].into_iter().chain(counts).chain(heads).map(str::to_owned).collect();
    let row = |group: &Group| {
        let counts = [group.sequences.len()].into_iter().chain(repeated.then_some(group.scores().count()));
        let counts = counts.map(|count| Cell { text: count.to_string(), best: false });
        let cells = figures.iter().flat_map(|figure| of_group(group, figure));
        (format!("{} {}", group.grid, group.column()), counts.chain(cells).collect())
    };
    Table { title: title.to_owned(), columns, rows: groups.iter().map(row).collect() }
}

/// Builds cells of numbers without marking the best.
fn unmarked(values: &[CellValue], digits: usize) -> Vec<Cell> {
    let mut cells = cells(values, digits);
    cells.iter_mut().for_each(|cell| cell.best = false);
    cells
}

/// Builds the cells of a row of numbers, the smallest marked; a dash means that the solver diverged.
fn cells(values: &[CellValue], digits: usize) -> Vec<Cell> {
    let smallest = values.iter().fold(f64::INFINITY, |least, value| match value {
        CellValue::Value(v) => v.min(least),
        _ => least,
    });
    let cell = |value: &CellValue| match value {
        CellValue::Nothing => Cell { text: String::new(), best: false },
        CellValue::Diverged => Cell { text: DIVERGED.into(), best: false },
        CellValue::Value(v) => {
            Cell { text: format!("{v:.digits$}"), best: values.len() > 1 && *v == smallest }
        }
    };
    values.iter().map(cell).collect()
}
