//! What memory there is: a system that promises more than it has ends whoever takes it at its word.

use crate::{Error, Result};

/// Makes room in `values` for `more` of `what`, exactly; an error if there is none. (A reservation alone tells little where memory
/// is promised that is not there, as on most Linux systems.)
pub(crate) fn reserve<T>(values: &mut Vec<T>, more: usize, what: &str) -> Result<()> {
    let bytes = more.saturating_mul(size_of::<T>());
    if holds(bytes) && values.try_reserve_exact(more).is_ok() {
        return Ok(());
    }
    Err(Error::Device(format!("cpu: no memory for {} of {what}", gib(bytes))))
}

/// Whether the machine has so many bytes left, as far as it tells. What is only reserved still counts as left: ask for all at once.
pub(crate) fn holds(bytes: usize) -> bool {
    available().is_none_or(|available| bytes as u64 <= available)
}

/// Bytes that the machine has left, swap included, where it tells.
fn available() -> Option<u64> {
    let told = std::fs::read_to_string("/proc/meminfo").ok()?;
    let bytes = |name: &str| {
        let line = told.lines().find_map(|line| line.strip_prefix(name))?;
        let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
        Some(1024 * kilobytes)
    };
    Some(bytes("MemAvailable:")? + bytes("SwapFree:").unwrap_or(0))
}

/// Bytes as people read them.
pub(crate) fn gib(bytes: usize) -> String {
    format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_there_is_not_promised() {
        let mut values: Vec<u8> = Vec::new();
        reserve(&mut values, 1000, "nothing").unwrap();
        assert!(values.capacity() >= 1000);
        assert!(reserve(&mut Vec::<u64>::new(), usize::MAX, "everything").is_err());
        if let Some(available) = available() {
            let error = reserve(&mut values, 2 * available as usize, "bytes").unwrap_err().to_string();
            assert!(error.contains("no memory for") && error.ends_with("GiB of bytes"), "{error}");
        }
    }
}
