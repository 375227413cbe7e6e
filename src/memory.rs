//! Available memory. A system that overcommits kills the process that uses more than there is. So what is large is
//! taken before the work begins ([`reserve`]), and what consists of many parts is estimated ([`check`]).

use crate::{Error, Result};
use std::path::Path;

/// Reserves room in `values` for exactly `more` elements of `what`, and takes it from the system at once: later
/// requests then see what is left. Fails if there is not enough memory.
pub(crate) fn reserve<T: Default>(values: &mut Vec<T>, more: usize, what: &str) -> Result<()> {
    reserve_each([values], more, what)
}

/// Applies [`reserve`] to several vectors, for which there must be enough memory together.
pub(crate) fn reserve_each<T: Default, const N: usize>(
    values: [&mut Vec<T>; N],
    more: usize,
    what: &str,
) -> Result<()> {
    let bytes = more.saturating_mul(size_of::<T>()).saturating_mul(N);
    check(bytes, what)?;
    for values in values {
        values.try_reserve_exact(more).map_err(|_| missing(bytes, what))?;
        // A page that was never written to counts as available, whoever it belongs to.
        let room = values.spare_capacity_mut().iter_mut().take(more);
        room.step_by((PAGE / size_of::<T>().max(1)).max(1)).for_each(|first| {
            first.write(T::default());
        });
    }
    Ok(())
}

/// Smallest unit in which systems hand out memory, in bytes.
const PAGE: usize = 4096;

/// Fails if fewer than `bytes` of memory are available for `what`. Where the amount is unknown, everything is
/// accepted.
pub(crate) fn check(bytes: usize, what: &str) -> Result<()> {
    match available().is_none_or(|available| bytes as u64 <= available) {
        true => Ok(()),
        false => Err(missing(bytes, what)),
    }
}

fn missing(bytes: usize, what: &str) -> Error {
    let there = available().map_or_else(String::new, |there| format!(", of {}", readable(there as usize)));
    Error::Device(format!("cpu: not enough memory: {what}: {}{there}", readable(bytes)))
}

/// Returns the available bytes, if known: the smaller of what the machine has left and what a container or
/// batch system still grants.
fn available() -> Option<u64> {
    [of_machine(), of_control_groups()].into_iter().flatten().min()
}

/// Returns the bytes that this process's control groups leave it: the least over its groups and their
/// ancestors, or `None` if none has a limit.
fn of_control_groups() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/cgroup").ok()?;
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
        // The last ancestor is the root itself, which is all that a container sees.
        let around = Path::new(path.trim_start_matches('/')).ancestors();
        around.filter_map(|path| left_by(&Path::new(root).join(path), files)).min()
    };
    text.lines().filter_map(of_line).min()
}

/// Returns the bytes that a control group leaves, counting its inactive page cache as available. Returns
/// `None` without a limit, which may be written as the word `max`.
fn left_by(group: &Path, [limit, used, cached]: [&str; 3]) -> Option<u64> {
    let number = |file: &str| std::fs::read_to_string(group.join(file)).ok()?.trim().parse::<u64>().ok();
    let (limit, used) = (number(limit)?, number(used)?);
    let statistics = std::fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
    let cached = statistics.lines().find_map(|line| line.strip_prefix(cached)?.trim().parse().ok());
    Some(limit.saturating_sub(used.saturating_sub(cached.unwrap_or(0))))
}

/// Returns the bytes that the machine has left, swap included, if known.
fn of_machine() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let bytes = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
        Some(1024 * kilobytes)
    };
    Some(bytes("MemAvailable:")? + bytes("SwapFree:").unwrap_or(0))
}

/// Formats a number of bytes for display.
pub(crate) fn readable(bytes: usize) -> String {
    let mib = bytes as f64 / f64::from(1 << 20);
    if mib < 1000.0 { format!("{mib:.0} MiB") } else { format!("{:.1} GiB", mib / 1024.0) }
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
    fn memory_that_is_not_there_is_refused() {
        let mut values: Vec<u8> = Vec::new();
        reserve(&mut values, 1000, "nothing").unwrap();
        assert!(values.capacity() >= 1000);
        assert!(reserve(&mut Vec::<u64>::new(), usize::MAX, "everything").is_err());
        if let Some(available) = available() {
            let error = reserve(&mut values, 2 * available as usize, "bytes").unwrap_err().to_string();
            assert!(error.contains("not enough memory: bytes: ") && error.contains(" GiB, of "), "{error}");
            // Each of them would fit.
            let part = (available / 3 * 2) as usize;
            check(part, "a part").unwrap();
            assert!(reserve_each([&mut Vec::<u8>::new(), &mut Vec::new()], part, "both parts").is_err());
        }
    }
}
