//! The library's error type.

use std::path::{Path, PathBuf};

/// An error, with the context needed to fix its cause: which file, which field, what was expected and what
/// was found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be opened, read, created or written.
    #[error("{}: {action}: {source}", plain(&path.to_string_lossy()))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The action that failed, as in "cannot read".
        action: &'static str,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// Data that was read, or a value that was given, is not valid.
    #[error("{}: {}: expected {expected}, found {}", plain(origin), plain(field), plain(found))]
    Invalid {
        /// The file that holds the data, or the option that set it.
        origin: String,
        /// The field, tensor or line inside `origin`.
        field: String,
        /// The values that would have been accepted.
        expected: String,
        /// The value found.
        found: String,
    },
    /// An unknown name, with the nearest known ones.
    #[error("{}: unknown {kind} '{name}'{}", plain(origin), plain(hint))]
    Unknown {
        /// The file or option that contains the name.
        origin: String,
        /// The kind of thing it names, as in "motion".
        kind: &'static str,
        /// The name.
        name: String,
        /// What to write instead, as it follows the name in the message: known names, the nearest first, or a sentence
        /// after a colon.
        hint: String,
    },
    /// No device can do the work: there is no adapter, its limits or the memory are too small, its driver
    /// refuses a kernel, or the machine cannot start what the work needs.
    #[error("device: {0}")]
    Device(String),
    /// The device was lost, together with everything on it. The work can be restarted on another device.
    #[error("device lost: {0}")]
    Lost(String),
    /// The simulation produced a non-finite number.
    #[error("frame {frame}: cloth {cloth} became non-finite")]
    NonFinite {
        /// Index of the first frame that is not finite; the start state is frame 0.
        frame: usize,
        /// Index of the cloth in its batch.
        cloth: usize,
    },
}

/// Fewer known names than this are all listed.
const FEW: usize = 10;

/// More of them are listed where none is near and the list is not longer than this, in bytes.
const LONGEST_LIST: usize = 300;

/// `Result` with the library's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Returns the error as one of this file, if it is about invalid data.
    pub fn of_file(self, path: &Path) -> Self {
        match self {
            Self::Invalid { field, expected, found, .. } => {
                Self::Invalid { origin: path.display().to_string(), field, expected, found }
            }
            other => other,
        }
    }

    /// Returns an [`Error::Io`]. `action` completes "PATH: ...", as in "cannot read".
    pub fn io(path: impl AsRef<Path>, action: &'static str, source: std::io::Error) -> Self {
        Error::Io { path: path.as_ref().to_owned(), action, source }
    }

    /// Returns an [`Error::Invalid`].
    pub fn invalid(
        origin: impl Into<String>,
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
    ) -> Self {
        Error::Invalid {
            origin: origin.into(),
            field: field.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    /// Returns an [`Error::Unknown`] that suggests the nearest of `known`, by edit distance: up to three of them, or all
    /// if there are fewer than ten, or if none is near and the list is short.
    pub fn unknown<'a>(
        origin: impl Into<String>,
        kind: &'static str,
        name: &str,
        known: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        let name = brief(name);
        let mut ranked: Vec<(usize, &str)> =
            known.into_iter().map(|k| (strsim::damerau_levenshtein(&name, k), k)).collect();
        ranked.sort();
        let names = |ranked: &[(usize, &str)]| ranked.iter().map(|r| r.1).collect::<Vec<_>>().join(", ");
        let near = ranked.first().map_or(0, |r| r.0).max(2) + 1;
        let nearest = ranked.iter().take(3).take_while(|r| r.0 <= near).count();
        let is_near = ranked.first().is_some_and(|r| r.0 <= (2 * name.chars().count() / 3).max(2));
        let hint = match (nearest, ranked.len()) {
            (_, 0) => String::new(),
            (0, 1..FEW) => format!(" (known: {})", names(&ranked)),
            (_, FEW..) if !is_near => {
                let mut all: Vec<&str> = ranked.iter().map(|r| r.1).collect();
                all.sort_unstable();
                let list = all.join(", ");
                if list.len() > LONGEST_LIST { String::new() } else { format!(" (known: {list})") }
            }
            (_, 1..FEW) if ranked.len() > nearest => {
                format!(
                    " (did you mean {}? others: {})",
                    names(&ranked[..nearest]),
                    names(&ranked[nearest..])
                )
            }
            _ => format!(" (did you mean {}?)", names(&ranked[..nearest])),
        };
        Error::Unknown { origin: origin.into(), kind, name, hint }
    }

    /// Returns an [`Error::Unknown`] for the name of something that does not exist here; `instead` is a sentence that
    /// says what to do.
    pub fn absent(origin: impl Into<String>, kind: &'static str, name: &str, instead: &str) -> Self {
        Error::Unknown { origin: origin.into(), kind, name: brief(name), hint: format!(": {instead}") }
    }
}

/// Makes a name fit for display: names in damaged files may be very long.
fn brief(name: &str) -> String {
    const MOST: usize = 80;
    let shown = plain(&name.chars().take(MOST).collect::<String>());
    if name.chars().nth(MOST).is_some() { shown + ".." } else { shown }
}

/// Replaces the control characters of untrusted text, which could move a terminal's cursor or change its
/// colours. Keeps line breaks.
fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_control() && c != '\n' { '?' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_shown_in_brief_and_without_control_characters() {
        let long = format!("grid\u{1b}[2J{}", "x".repeat(100_000));
        let message = Error::unknown("scene.json", "field", &long, ["grid"]).to_string();
        assert!(
            message.starts_with("scene.json: unknown field 'grid?[2Jxx") && message.contains("xx..'"),
            "{message}"
        );
        assert!(message.len() < 150 && !message.contains('\u{1b}'), "{message}");
        let message =
            Error::invalid("a\u{1b}[2J.obj", "line 3", "numbers", "\u{1b}[31mred\nand more").to_string();
        assert_eq!(message, "a?[2J.obj: line 3: expected numbers, found ?[31mred\nand more");
        let message = Error::io("a\u{7}.obj", "cannot read", std::io::Error::other("gone")).to_string();
        assert_eq!(message, "a?.obj: cannot read: gone");
        let message = Error::unknown("scene.json", "field", "grd", ["up", "grid"]).to_string();
        assert_eq!(message, "scene.json: unknown field 'grd' (did you mean grid, up?)");
        // Of many, the nearest by letters says nothing where none is near.
        let fabrics = ["b", "c", "d", "denim", "e", "f", "g", "h", "i", "jacket", "t-shirt"];
        let message = |name: &str| Error::unknown("--material", "material", name, fabrics).to_string();
        assert!(message("demin").ends_with("'demin' (did you mean denim?)"), "{}", message("demin"));
        assert!(
            message("cotton").ends_with("'cotton' (known: b, c, d, denim, e, f, g, h, i, jacket, t-shirt)")
        );
        let many: Vec<String> = (0..100).map(|k| format!("name {k}")).collect();
        let message = Error::unknown("a", "name", "x", many.iter().map(|name| &**name)).to_string();
        assert_eq!(message, "a: unknown name 'x'");
    }
}
