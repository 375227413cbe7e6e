//! Files that appear complete or not at all.

use crate::{Error, Result};
use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
};

/// What the name of a file begins with until all of it is written.
pub(crate) const UNFINISHED: &str = ".writing-";

/// Writes a file through `fill`, so that `path` holds either what it held before or all of the new content.
///
/// The bytes go to a temporary file in the same folder, which takes the name `path` when `fill` has succeeded and is
/// removed when it has not. The folder is created if it does not exist. What a link names is replaced, not the link; a device or a
/// pipe is written into.
pub fn write_atomic(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let dir = folder_of(path.as_ref());
    std::fs::create_dir_all(dir).map_err(|e| Error::io(dir, "cannot create the folder", e))?;
    replace(path, fill)
}

/// [`write_atomic`] into a folder that exists: for files of the user's own naming, where a folder that is missing is
/// more likely misspelt.
pub(crate) fn replace(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    // The file that a link names, not the link.
    let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let written = (|| {
        if is_stream(path) {
            let mut writer = BufWriter::new(File::options().append(true).open(path)?);
            fill(&mut writer)?;
            return writer.flush();
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(UNFINISHED);
        // Temporary files are private by default; the finished file is to be as readable as any other the user makes.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let (file, temporary) = builder.tempfile_in(folder_of(&target))?.into_parts();
        let mut writer = BufWriter::with_capacity(1 << 16, file);
        fill(&mut writer)?;
        writer.flush()?;
        // Else a crash of the machine could leave the new name with none of the new content.
        writer.get_ref().sync_all()?;
        drop(writer);
        temporary.persist(&target).map_err(|e| e.error)
    })();
    written.map_err(|e| Error::io(path, "cannot write", e))
}

/// Whether `path` is written into, as no other file can take its place: a device, a pipe, or what the process has open, even where
/// that is a file.
pub fn is_stream(path: &Path) -> bool {
    let open = ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc"].iter().any(|open| path.starts_with(open));
    path.metadata().is_ok_and(|found| !found.is_dir() && (open || !found.is_file()))
}

fn folder_of(path: &Path) -> &Path {
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
    }

    /// Both used to be replaced by a file of their name.
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
