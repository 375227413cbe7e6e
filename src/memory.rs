//! What memory there is: a system that promises more than it has ends whoever takes it at its word.

use crate::{Error, Result};
use std::path::Path;

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

/// Bytes that are left here, where that is told: of the machine or, where that is less, of what a container or a batch system grants.
fn available() -> Option<u64> {
    [of_machine(), of_control_groups()].into_iter().flatten().min()
}

/// Bytes that the control groups of this process leave it, the narrowest of them and of those around them; none where none has a
/// limit.
fn of_control_groups() -> Option<u64> {
    let told = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let of_line = |line: &str| {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        let (root, files) = match controllers {
            "" => ("/sys/fs/cgroup", ["memory.max", "memory.current", "inactive_file "]),
            _ if controllers.split(',').any(|name| name == "memory") => {
                let files = ["memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file "];
                ("/sys/fs/cgroup/memory", files)
            }
            _ => return None,
        };
        // The last one is the root itself, which is all that a container sees.
        let around = Path::new(path.trim_start_matches('/')).ancestors();
        around.filter_map(|path| left_by(&Path::new(root).join(path), files)).min()
    };
    told.lines().filter_map(of_line).min()
}

/// Bytes that a control group leaves, of which the page cache of files counts as left; none without a limit, which may also be the
/// word `max`.
fn left_by(group: &Path, [limit, used, cached]: [&str; 3]) -> Option<u64> {
    let number = |file: &str| std::fs::read_to_string(group.join(file)).ok()?.trim().parse::<u64>().ok();
    let (limit, used) = (number(limit)?, number(used)?);
    let statistics = std::fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
    let cached = statistics.lines().find_map(|line| line.strip_prefix(cached)?.trim().parse().ok());
    Some(limit.saturating_sub(used.saturating_sub(cached.unwrap_or(0))))
}

/// Bytes that the machine has left, swap included, where it tells.
fn of_machine() -> Option<u64> {
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
    fn a_control_group_leaves_what_it_has_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["memory.max", "memory.current", "inactive_file "];
        let write = |file: &str, text: &str| std::fs::write(folder.path().join(file), text).unwrap();
        assert_eq!(left_by(folder.path(), files), None);
        write("memory.current", "700\n");
        write("memory.max", "max\n");
        assert_eq!(left_by(folder.path(), files), None);
        write("memory.max", "1000\n");
        assert_eq!(left_by(folder.path(), files), Some(300));
        write("memory.stat", "anon 500\ninactive_file 100\nactive_file 50\n");
        assert_eq!(left_by(folder.path(), files), Some(400));
    }

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
