//! Output of the commands: results on stdout, everything else on stderr. A reader that goes away does not
//! change how a command ends.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::{ErrorKind, Result, StdoutLock, Write};
use std::time::Duration;

/// Prints a line to stderr in a single write. Errors are ignored: a full disk under a log or a closed
/// terminal is no reason to end hours of work.
macro_rules! status {
    ($($line:tt)*) => {{
        let line = format!($($line)*) + "\n";
        let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
    }};
}
pub(crate) use status;

/// Returns a progress bar over `length` items on stderr, hidden if that is not a terminal. `of` names them,
/// as in "frames".
pub fn progress(length: u64, of: &str) -> ProgressBar {
    let template = format!("{{bar:30}} {{pos}}/{{len}} {of}, {{per_sec}}, {{eta}} left  {{msg}}");
    let style = ProgressStyle::with_template(&template).expect("the template is valid");
    let bar = ProgressBar::new(length).with_style(style);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Standard output. Once its reader has gone away (`fnopt inspect X | head`), further output is discarded.
pub struct Output {
    to: StdoutLock<'static>,
    closed: bool,
}

/// Locks standard output.
pub fn output() -> Output {
    Output { to: std::io::stdout().lock(), closed: false }
}

impl Output {
    /// Whether the reader has gone away.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    fn done(&mut self, written: Result<usize>, all: usize) -> Result<usize> {
        match written {
            // EIO: a terminal that closed.
            Err(e) if e.kind() == ErrorKind::BrokenPipe || cfg!(unix) && e.raw_os_error() == Some(5) => {
                self.closed = true;
                Ok(all)
            }
            Err(e) if e.kind() != ErrorKind::Interrupted => {
                Err(std::io::Error::new(e.kind(), format!("stdout: cannot write: {e}")))
            }
            other => other,
        }
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        if self.closed {
            return Ok(bytes.len());
        }
        let written = self.to.write(bytes);
        self.done(written, bytes.len())
    }

    fn flush(&mut self) -> Result<()> {
        let flushed = self.to.flush().map(|()| 0);
        self.done(flushed, 0).map(|_| ())
    }
}
