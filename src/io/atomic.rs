//! Files that appear complete or not at all.

use crate::{Error, Result};
use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    thread,
    time::Duration,
};
use tempfile::{PathPersistError as PersistError, TempPath};

/// Prefix of the name of a file that is not completely written yet.
pub(crate) const UNFINISHED: &str = ".writing-";

/// Writes a file through `fill`, so that `path` holds either its previous contents or all of the new ones.
///
/// The bytes go to a temporary file in the same folder, which is renamed to `path` if `fill` succeeds and
/// removed if it fails. The folder is created if it does not exist. A link is followed and its target
/// replaced. A device or a pipe is written to directly, and a file that is mounted by itself, which cannot be
/// replaced, is overwritten at the end.
pub fn write_atomic(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let dir = folder_of(path.as_ref());
    super::create_folder(dir)?;
    replace(path, fill)
}

/// Writes like [`write_atomic`], but does not create the folder: for paths given by the user, where a missing
/// folder is more likely a typo.
pub(crate) fn replace(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    let target = target_of(path);
    let written = (|| {
        if is_stream(path) {
            let mut writer = BufWriter::new(File::options().append(true).open(path)?);
            fill(&mut writer)?;
            return writer.flush();
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(UNFINISHED);
        // Temporary files are private by default; the finished file gets the same permissions as any other.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let (file, temporary) = builder.tempfile_in(folder_of(&target))?.into_parts();
        // A file that its owner has made private stays so. Where the file system knows no modes, both are the
        // same, and setting them fails.
        if let Ok(before) = target.metadata()
            && before.permissions() != file.metadata()?.permissions()
        {
            file.set_permissions(before.permissions())?;
        }
        let mut writer = BufWriter::with_capacity(1 << 16, file);
        fill(&mut writer)?;
        writer.flush()?;
        // Otherwise a system crash could leave the new name without the new contents.
        writer.get_ref().sync_all().or_else(|e| if is_unsupported(&e) { Ok(()) } else { Err(e) })?;
        drop(writer);
        rename(temporary, &target)
    })();
    written.map_err(|e| Error::io(path, "cannot write", e))
}

/// Whether a file system does not offer what failed. Network volumes may be unable to flush a file.
fn is_unsupported(error: &io::Error) -> bool {
    // ENOTTY and ENOTSUP of macOS.
    let of_macos = cfg!(target_os = "macos") && matches!(error.raw_os_error(), Some(25 | 45));
    of_macos || matches!(error.kind(), io::ErrorKind::Unsupported | io::ErrorKind::InvalidInput)
}

/// Renames a finished file to `target`.
fn rename(mut finished: TempPath, target: &Path) -> io::Result<()> {
    for milliseconds in [10, 20, 50, 100, 200, 500] {
        let Err(PersistError { error, path }) = finished.persist(target) else { return Ok(()) };
        match error.raw_os_error() {
            // A file that is mounted into a container cannot be replaced, only filled.
            _ if error.kind() == io::ErrorKind::ResourceBusy => {
                let mut mounted = File::options().write(true).truncate(true).open(target)?;
                io::copy(&mut File::open(&path)?, &mut mounted)?;
                return mounted.sync_all();
            }
            // On Windows, scanners and indexers hold a new file open for a moment.
            Some(5 | 32 | 33) if cfg!(windows) => thread::sleep(Duration::from_millis(milliseconds)),
            _ => return Err(error),
        }
        finished = path;
    }
    finished.persist(target).map_err(|e| e.error)
}

/// Returns the file to replace: the target of a link instead of the link, even if it does not exist yet.
pub fn target_of(path: &Path) -> PathBuf {
    let mut target = path.to_owned();
    // A system follows as many links at most.
    for _ in 0..40 {
        if let Ok(found) = std::fs::canonicalize(&target) {
            return found;
        }
        match std::fs::read_link(&target) {
            Ok(next) => target = folder_of(&target).join(next),
            Err(_) => break,
        }
    }
    target
}

/// Returns whether `path` must be written to directly, because no other file can replace it: a device, a
/// pipe, or a descriptor that the process holds open, even if that is a regular file.
pub fn is_stream(path: &Path) -> bool {
    if cfg!(windows) {
        let name = path.as_os_str().to_string_lossy();
        return name.eq_ignore_ascii_case("nul") || name.starts_with(r"\\.\");
    }
    let open = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc"].iter().any(|open| path.starts_with(open));
    path.metadata().is_ok_and(|found| !found.is_dir() && (open || !found.is_file()))
}

/// Returns the folder of a file.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(dir: &Path) -> Vec<String> {
        let entry = |e: io::Result<std::fs::DirEntry>| e.unwrap().file_name().into_string().unwrap();
        std::fs::read_dir(dir).unwrap().map(entry).collect()
    }

    #[test]
    fn a_failed_write_keeps_the_old_file_and_leaves_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a/b.txt");
        write_atomic(&path, |w| w.write_all(b"first")).unwrap();
        let failed = write_atomic(&path, |w| {
            w.write_all(b"half of the seco")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("b.txt: cannot write: disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(names(path.parent().unwrap()), ["b.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn the_file_is_as_readable_as_an_ordinary_one() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("plain"), "").unwrap();
        write_atomic(dir.path().join("atomic"), |_| Ok(())).unwrap();
        let mode = |n: &str| std::fs::metadata(dir.path().join(n)).unwrap().permissions().mode();
        assert_eq!(mode("atomic"), mode("plain"));
        let private = std::fs::Permissions::from_mode(0o600);
        std::fs::set_permissions(dir.path().join("atomic"), private).unwrap();
        write_atomic(dir.path().join("atomic"), |_| Ok(())).unwrap();
        assert_eq!(mode("atomic") & 0o777, 0o600);
    }

    /// Both used to be replaced by a regular file.
    #[cfg(unix)]
    #[test]
    fn links_and_pipes_stay_what_they_are() {
        let dir = tempfile::tempdir().unwrap();
        let [link, file, pipe] = ["link", "file", "pipe"].map(|name| dir.path().join(name));
        std::fs::write(&file, "before").unwrap();
        std::os::unix::fs::symlink("file", &link).unwrap();
        write_atomic(&link, |w| w.write_all(b"after")).unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"after");
        assert!(link.symlink_metadata().unwrap().is_symlink());

        // The target may not exist yet.
        std::fs::remove_file(&file).unwrap();
        write_atomic(&link, |w| w.write_all(b"again")).unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"again");
        assert!(link.symlink_metadata().unwrap().is_symlink());

        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::read(pipe).unwrap()
        });
        write_atomic(&pipe, |w| w.write_all(b"through")).unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        assert!(!pipe.metadata().unwrap().is_file());
        assert_eq!(names(dir.path()).len(), 3);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("file"), "").unwrap();
        let error = write_atomic(dir.path().join("file/x"), |_| Ok(())).unwrap_err().to_string();
        assert!(error.contains("file: cannot"), "{error}");
    }
}
