//! Folders with a file per frame.

use super::atomic::UNFINISHED;
use super::clip::Clip;
use super::trajectory::Parts;
use super::{Format, create_folder, entries, obj, ply, read_obj, remove, write_atomic};
use crate::{Error, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Writes a file per frame, and removes those of a longer run. Returns the folder.
pub(super) fn write(clip: &Clip, folder: PathBuf, format: Format) -> Result<PathBuf> {
    let name = |f: usize| format!("{f:05}.{format}");
    let numbers = || (0..clip.count()).map(|f| clip.start() + f);
    create_folder(&folder)?;
    // Only names that a run would have written are replaced: `7.obj` belongs to the user.
    let mut earlier = frame_files(&folder, format)?;
    earlier.retain(|(_, f, path)| path.file_name().is_some_and(|found| *found == *name(*f)));
    let earlier: Vec<PathBuf> = earlier.into_iter().map(|(.., path)| path).collect();
    let new = numbers().map(|f| folder.join(name(f)));
    if let Some(in_the_way) = new.chain(earlier.iter().cloned()).find(|path| path.is_dir()) {
        return Err(Error::invalid(in_the_way.display().to_string(), "type", "a file", "a folder"));
    }
    // Frames of two runs in one folder would be read as one sequence, so none is in its place before all
    // are written. What a run that was killed has left is of no use.
    for left in unfinished(&folder)? {
        std::fs::remove_dir_all(&left).map_err(|e| Error::io(&left, "cannot remove", e))?;
    }
    let unfinished = tempfile::Builder::new().prefix(UNFINISHED).tempdir_in(&folder);
    let unfinished = unfinished.map_err(|e| Error::io(&folder, "cannot create a folder", e))?;
    let rest = if format == Format::Ply { ply::rest(clip.topology) } else { obj::rest(clip.topology) };
    (0..clip.count()).into_par_iter().try_for_each(|f| {
        write_atomic(unfinished.path().join(name(clip.start() + f)), |writer| {
            let positions = clip.frames.positions_of(f)?;
            match format {
                Format::Ply => ply::write(clip.topology, &positions, &rest, writer),
                _ => obj::write(&positions, &rest, writer),
            }
        })
    })?;
    earlier.iter().try_for_each(|path| remove(path))?;
    for f in numbers() {
        let to = folder.join(name(f));
        std::fs::rename(unfinished.path().join(name(f)), &to)
            .map_err(|e| Error::io(&to, "cannot write", e))?;
    }
    Ok(folder)
}

/// Returns the numbered files of a folder of frames, in order, each with the beginning of its name, its number,
/// and its path: `cloth_0007.obj` begins with `cloth_` and has number 7.
fn frame_files(folder: &Path, format: Format) -> Result<Vec<(String, usize, PathBuf)>> {
    let mut files = Vec::new();
    for path in entries(folder)? {
        let of_format = path.extension().is_some_and(|e| e == format.name());
        let stem = path.file_stem().and_then(|s| s.to_str()).filter(|_| of_format).unwrap_or_default();
        let name = stem.trim_end_matches(|c: char| c.is_ascii_digit());
        if let Ok(number) = stem[name.len()..].parse() {
            files.push((name.to_owned(), number, path));
        }
    }
    files.sort();
    Ok(files)
}

/// Returns the folders of frames that a run has not put into their place. Only one that was killed leaves any.
fn unfinished(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = entries(folder)?;
    let is_prefixed = |path: &PathBuf| {
        path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with(UNFINISHED))
    };
    found.retain(|path| is_prefixed(path) && path.is_dir());
    Ok(found)
}

/// Reads a sequence of OBJ files with consecutive numbers, which may begin anywhere.
pub(super) fn read(folder: &Path) -> Result<Parts> {
    // The files beside it may be a part of one run, or parts of two.
    if let Some(left) = unfinished(folder)?.first() {
        let expected = format!("all frames in their place; {} is of a run that was killed", left.display());
        return Err(Error::invalid(folder.display().to_string(), "frames", expected, "perhaps a part"));
    }
    let mut files = frame_files(folder, Format::Obj)?;
    // Next to files that are called by their number alone, others are not frames.
    if files.first().is_some_and(|(name, ..)| name.is_empty()) {
        files.retain(|(name, ..)| name.is_empty());
    }
    let mut parts = Parts::default();
    for (k, (name, number, path)) in files.iter().enumerate() {
        let bad = |field: &str, expected: String, found: String| {
            Err(Error::invalid(path.display().to_string(), field, expected, found))
        };
        let (first_name, first, _) = &files[0];
        if name != first_name {
            let expected = format!("'{first_name}' and a number, as in the other files");
            return bad("name", expected, format!("'{name}'"));
        }
        if *number != first + k {
            return bad("number", (first + k).to_string(), number.to_string());
        }
        let mesh = read_obj(path)?;
        if k == 0 {
            parts.shape = vec![files.len(), mesh.positions.len(), 3];
            parts.faces = mesh.faces;
        } else if mesh.positions.len() != parts.shape[1] {
            return bad(
                "vertices",
                format!("{} as in the first file", parts.shape[1]),
                mesh.positions.len().to_string(),
            );
        }
        parts.positions.extend(mesh.positions);
    }
    if files.is_empty() {
        let expected = "numbered OBJ files such as 00000.obj";
        return Err(Error::invalid(folder.display().to_string(), "content", expected, "none"));
    }
    Ok(parts)
}
