//! Tables of text, and their output formats.

/// Columns of a terminal: wider tables are split into parts.
const WIDTH: usize = 120;

/// A table of text cells, in which the best number of each row may be marked.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Title.
    pub title: String,
    /// Column headings, starting with that of the row names.
    pub columns: Vec<String>,
    /// Name and cells of each row.
    pub rows: Vec<(String, Vec<Cell>)>,
}

/// A cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Text of the cell.
    pub text: String,
    /// Whether the number is the best of its row.
    pub best: bool,
}

/// The output format of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Aligned columns, the best number in bold if requested.
    Text {
        /// Whether to use escape sequences for bold.
        bold: bool,
    },
    /// Markdown, the best number in bold.
    Markdown,
    /// Comma-separated values, without the title.
    Csv,
}

impl Table {
    /// Returns the table as text.
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
            // As many columns as fit, but at least one.
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
        let row = |cells: Vec<String>| {
            let cells: Vec<String> = cells.into_iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let mut text = format!("**{}**\n\n{}", self.title, row(self.columns.clone()));
        text += &format!("|---|{}\n", "---:|".repeat(self.columns.len() - 1));
        for (name, cells) in &self.rows {
            let marked = |c: &Cell| if c.best { format!("**{}**", c.text) } else { c.text.clone() };
            text += &row(std::iter::once(name.clone()).chain(cells.iter().map(marked)).collect());
        }
        text
    }

    /// Returns the cells of all tables as one table of comma-separated values, a line each: `table,row,column,value`,
    /// with the text of the cells.
    pub fn cells_as_csv(tables: &[Self]) -> String {
        let mut text = "table,row,column,value\n".to_owned();
        for table in tables {
            for (name, cells) in &table.rows {
                for (column, cell) in table.columns[1..].iter().zip(cells) {
                    let fields = [&table.title, name, column, &cell.text].map(|field| quoted(field));
                    text += &format!("{}\n", fields.join(","));
                }
            }
        }
        text
    }

    fn csv(&self) -> String {
        let line = |fields: Vec<String>| format!("{}\n", fields.join(","));
        let mut text = String::new();
        text += &line(self.columns.iter().map(|c| quoted(c)).collect());
        for (name, cells) in &self.rows {
            let fields = std::iter::once(name.as_str()).chain(cells.iter().map(|c| c.text.as_str()));
            text += &line(fields.map(quoted).collect());
        }
        text
    }
}

/// Returns a field of a line of comma-separated values.
fn quoted(field: &str) -> String {
    match field.contains([',', '"']) {
        true => format!("\"{}\"", field.replace('"', "\"\"")),
        false => field.to_owned(),
    }
}
