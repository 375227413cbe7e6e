//! CSV files that a run appends to and takes up again.

use crate::{Error, Result, io};
use std::io::Write;
use std::path::PathBuf;

/// A table whose first column is the step.
#[derive(Debug)]
pub(super) struct Table {
    path: PathBuf,
    columns: Vec<String>,
}

impl Table {
    /// Opens the table at `path`. Rows of steps after `step`, which a broken run has left, and a file with other columns
    /// are given up.
    pub fn open(path: PathBuf, columns: Vec<String>, step: u64) -> Result<Self> {
        let table = Self { path, columns };
        let is_kept = |row: &Vec<String>| row[0].parse().is_ok_and(|at: u64| at <= step);
        let kept: Vec<Vec<String>> = if table.path.exists() {
            table.rows()?.into_iter().filter(is_kept).collect()
        } else {
            Vec::new()
        };
        io::write_atomic(&table.path, |file| {
            writeln!(file, "{}", table.columns.join(","))?;
            kept.iter().try_for_each(|row| writeln!(file, "{}", row.join(",")))
        })?;
        Ok(table)
    }

    /// Appends a row.
    pub fn push(&self, row: &[String]) -> Result<()> {
        assert_eq!(row.len(), self.columns.len(), "a row has every column");
        let append = || {
            let mut file = std::fs::OpenOptions::new().append(true).open(&self.path)?;
            file.write_all(format!("{}\n", row.join(",")).as_bytes())
        };
        append().map_err(|e| Error::io(&self.path, "cannot write", e))
    }

    /// Names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// All whole rows of a file with these columns.
    pub fn rows(&self) -> Result<Vec<Vec<String>>> {
        let bytes = io::read_bytes(&self.path)?;
        let text = String::from_utf8_lossy(&bytes);
        let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let same = lines.next().is_some_and(|columns| columns == self.columns);
        Ok(if same { lines.filter(|row| row.len() == self.columns.len()).collect() } else { Vec::new() })
    }
}
