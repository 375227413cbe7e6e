//! What memory there is: a system that promises more than it has ends whoever takes it at its word.

/// Makes room in `values` for `more`, exactly; whether there is any. (A reservation alone tells little where memory is
/// promised that is not there, as on most Linux systems.)
pub(crate) fn reserve<T>(values: &mut Vec<T>, more: usize) -> bool {
    let bytes = more.saturating_mul(size_of::<T>()) as u64;
    available().is_none_or(|available| bytes <= available) && values.try_reserve_exact(more).is_ok()
}

/// Bytes that the machine has left, where it tells.
fn available() -> Option<u64> {
    let told = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = told.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
    Some(1024 * kilobytes)
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
