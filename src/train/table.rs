//! CSV files that a run appends to, also after it is resumed.

use crate::{Error, Result, io};
use std::io::Write;
use std::path::PathBuf;

/// A CSV table whose first column is the step.
#[derive(Debug)]
pub(super) struct Table {
    path: PathBuf,
    columns: Vec<String>,
}

impl Table {
    /// Opens the table at `path`. Drops rows after `step`, left by an interrupted session. Renames a file
    /// with other columns, as written by another version, out of the way.
    pub fn open(path: PathBuf, columns: Vec<String>, step: u64) -> Result<Self> {
        let table = Self { path, columns };
        let mut text = if table.path.exists() { table.text()? } else { String::new() };
        if text.lines().next().is_some_and(|titles| titles != table.columns.join(",")) {
            let aside = table.path.with_extension("csv.old");
            std::fs::rename(&table.path, &aside).map_err(|e| Error::io(&table.path, "cannot rename", e))?;
            tracing::warn!("{} has other columns; renamed it to {}", table.path.display(), aside.display());
            text.clear();
        }
        let is_kept =
            |row: &&str| row.split(',').next().is_some_and(|at| at.parse().is_ok_and(|at: u64| at <= step));
        io::write_atomic(&table.path, |file| {
            writeln!(file, "{}", table.columns.join(","))?;
            table.rows(&text).filter(is_kept).try_for_each(|row| writeln!(file, "{row}"))
        })?;
        Ok(table)
    }

    /// Appends a row.
    pub fn push(&self, row: &[String]) -> Result<()> {
        self.push_all(&[row.to_vec()])
    }

    /// Appends rows in a single write.
    pub fn push_all(&self, rows: &[Vec<String>]) -> Result<()> {
        assert!(rows.iter().all(|row| row.len() == self.columns.len()), "a row has every column");
        let rows: String = rows.iter().map(|row| row.join(",") + "\n").collect();
        let append = || {
            // Recreate a file that was removed.
            let mut file = std::fs::OpenOptions::new().create(true).append(true).open(&self.path)?;
            let titles = match file.metadata()?.len() {
                0 => format!("{}\n", self.columns.join(",")),
                _ => String::new(),
            };
            file.write_all(format!("{titles}{rows}").as_bytes())
        };
        append().map_err(|e| Error::io(&self.path, "cannot write", e))
    }

    /// Returns the names of the columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Returns the contents of the file.
    pub fn text(&self) -> Result<String> {
        Ok(String::from_utf8_lossy(&io::read_bytes(&self.path)?).into_owned())
    }

    /// Returns the complete rows of `text`, with comma-separated values; none if its columns differ.
    pub fn rows<'a>(&self, text: &'a str) -> impl Iterator<Item = &'a str> {
        let (titles, count) = (self.columns.join(","), self.columns.len());
        let same = text.lines().next() == Some(&titles);
        // A number may have been cut off in the last row of a run that was killed.
        let ended = text.split_inclusive('\n').skip(1).filter_map(|row| row.strip_suffix('\n'));
        let rows = ended.map(|row| row.trim_end_matches('\r'));
        rows.filter(move |row| same && row.split(',').count() == count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_that_was_cut_off_is_dropped() {
        let table = Table { path: PathBuf::new(), columns: vec!["step".into(), "loss".into()] };
        let rows = |text| table.rows(text).map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(rows("step,loss\n5,-8.9e-1\r\n10,-8.9"), ["5,-8.9e-1"]);
        assert_eq!(rows("step,loss\n5\n10,1.5\n"), ["10,1.5"]);
        assert!(rows("step,gap\n5,1\n").is_empty());
    }
}
