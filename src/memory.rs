//! What memory there is: a system that promises more than it has ends whoever takes it at its word.

/// Makes room in `values` for `more`, exactly; whether there is any. (A reservation alone tells little where memory is
/// promised that is not there, as on most Linux systems.)
pub(crate) fn reserve<T>(values: &mut Vec<T>, more: usize) -> bool {
    holds(more.saturating_mul(size_of::<T>())) && values.try_reserve_exact(more).is_ok()
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
        assert!(reserve(&mut values, 1000) && values.capacity() >= 1000);
        assert!(!reserve(&mut values, usize::MAX) && !reserve(&mut Vec::<u64>::new(), usize::MAX));
        if let Some(available) = available() {
            assert!(!reserve(&mut values, 2 * available as usize));
        }
    }
}
