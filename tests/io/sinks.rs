//! Frames on disk, and what files are to be like.

use super::{GRID, names, waving};
use fnopt::{
    cloth::Grid,
    io::{Format, Frames, ReadOptions, Recording, Trajectory, WriteOptions, write},
    render::{Film, GifOptions, Marks, StripOptions, strip, write_gif},
};
use std::{fs, path::PathBuf};

/// Both ways to the files give the same bytes, and the recording leaves no file of its own.
#[test]
fn a_recording_writes_what_a_trajectory_writes() {
    let [memory, disk] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let trajectory = waving(GRID, 7);
    let mut recording = Recording::new(disk.path(), GRID, 60.0).unwrap();
    for frame in 0..7 {
        recording.push(trajectory.frame(frame), trajectory.frame_velocities(frame)).unwrap();
    }
    assert_eq!(recording.frames(), 7);
    for format in Format::ALL {
        let options = WriteOptions::default();
        let a = trajectory.write(memory.path(), "cloth", format).unwrap();
        let b = recording.write(disk.path(), "cloth", format, &options).unwrap();
        let files = |path: &PathBuf| match path.is_dir() {
            true => names(path).iter().map(|name| path.join(name)).collect(),
            false => vec![path.clone()],
        };
        for (a, b) in files(&a).iter().zip(files(&b)) {
            assert!(fs::read(a).unwrap() == fs::read(b).unwrap(), "{}", a.display());
        }
    }
    assert_eq!(names(memory.path()), names(disk.path()));
    let film = Film { grid: GRID, frames: &recording, every: 1 };
    let options = StripOptions { height: 60, ..StripOptions::default() };
    assert_eq!(strip(film, &[0], &options), strip(&trajectory, &[0], &options));
    let options = GifOptions { size: 48, ..GifOptions::default() };
    let [a, b] = [memory.path().join("a.gif"), disk.path().join("b.gif")];
    write_gif(&a, &trajectory, &[0], &options).unwrap();
    write_gif(&b, film, &[0], &options).unwrap();
    assert_eq!(fs::read(a).unwrap(), fs::read(b).unwrap());
}

#[test]
fn a_recording_needs_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    let error = Recording::new(dir.path().join("none"), GRID, 60.0).err().unwrap().to_string();
    assert!(error.contains("none: cannot create a temporary file"), "{error}");
}

/// As `--continue` does, without ever holding all frames.
#[test]
fn a_recording_goes_on_from_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let trajectory = waving(GRID, 5);
    let path = trajectory.write(dir.path(), "before", Format::Npz).unwrap();
    let mut recording = Recording::new(dir.path(), GRID, 60.0).unwrap();
    recording.extend_from(&path).unwrap();
    recording.push(trajectory.frame(0), trajectory.frame_velocities(0)).unwrap();
    let mut longer = trajectory.clone();
    longer.push(trajectory.frame(0), trajectory.frame_velocities(0));
    let written = recording.write(dir.path(), "after", Format::Npz, &WriteOptions::default()).unwrap();
    assert_eq!(Trajectory::read(written, &ReadOptions::default()).unwrap(), longer);
    let (outline, frames) = Trajectory::read_outline(&path, &ReadOptions::default()).unwrap();
    assert_eq!((outline.grid(), outline.fps(), outline.frames(), frames), (GRID, 60.0, 0, 5));

    // A file that does not fit adds nothing.
    let mut other = Recording::new(dir.path(), Grid { h: 9, w: 11 }, 60.0).unwrap();
    let error = other.extend_from(&path).unwrap_err().to_string();
    assert!(error.contains("before.npz: vertices: expected 99, found 108"), "{error}");
    let mut broken = Trajectory::new(GRID, 60.0);
    broken.push(trajectory.frame(0), &[[f32::NAN; 3]; 108]);
    let path = broken.write(dir.path(), "broken", Format::Npz).unwrap();
    let error = recording.extend_from(path).unwrap_err().to_string();
    assert!(error.contains("broken.npz: frame 0, vertex 0: expected finite numbers"), "{error}");
    assert_eq!(recording.frames(), 6);
}

/// Where formats say which frame comes first.
#[test]
fn the_first_frame_has_the_number_that_was_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let trajectory = waving(GRID, 3);
    let options = WriteOptions { start_frame: 1001, ..Default::default() };
    let written = |format| write(&trajectory, dir.path(), "cloth", format, &options).unwrap();
    let word = |bytes: &[u8], at: usize| <[u8; 4]>::try_from(&bytes[at..][..4]).unwrap();
    let pc2 = fs::read(written(Format::Pc2)).unwrap();
    // Start, frames per sample and number of samples.
    assert_eq!([20, 24].map(|at| f32::from_le_bytes(word(&pc2, at))), [1001.0, 1.0]);
    assert_eq!(i32::from_le_bytes(word(&pc2, 28)), 3);
    let mdd = fs::read(written(Format::Mdd)).unwrap();
    for frame in 0..3 {
        let time = f32::from_be_bytes(word(&mdd, 8 + 4 * frame));
        assert!((time - frame as f32 / 60.0).abs() < 1e-6, "{time}");
    }
    let obj = written(Format::Obj);
    assert_eq!(names(&obj), ["01001.obj", "01002.obj", "01003.obj"]);
    for path in [dir.path().join("cloth.mdd"), obj.clone()] {
        let read = Trajectory::read(path, &ReadOptions { grid: Some(GRID), ..Default::default() }).unwrap();
        assert_eq!((read.positions(), read.fps()), (trajectory.positions(), 60.0));
    }
    // Files of another range are those of another run.
    trajectory.write(dir.path(), "cloth", Format::Obj).unwrap();
    assert_eq!(names(&obj), ["00000.obj", "00001.obj", "00002.obj"]);
}

#[test]
fn archives_in_16_bits_or_deflated_are_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let trajectory = waving(GRID, 4);
    let read = |name: &str, format, options: WriteOptions| {
        let path = write(&trajectory, dir.path(), name, format, &options).unwrap();
        let read = Trajectory::read(&path, &ReadOptions { grid: Some(GRID), ..Default::default() }).unwrap();
        (read, fs::metadata(path).unwrap().len())
    };
    let (plain, all) = read("plain", Format::Npz, WriteOptions::default());
    let (deflated, smaller) =
        read("deflated", Format::Npz, WriteOptions { compress: true, ..Default::default() });
    assert_eq!((&deflated, &plain), (&trajectory, &trajectory));
    assert!(smaller < all, "{smaller} of {all} bytes");
    let half = WriteOptions { half: true, fps: Some(12.0), ..Default::default() };
    let (rounded, fewer) = read("half", Format::Npz, half);
    let frames = 2 * 4 * 3 * 4 * GRID.particles() as u64;
    assert_eq!(all - fewer, frames / 2);
    assert_eq!(rounded.fps(), 12.0);
    let (positions, _) = read("half", Format::Npy, half);
    for (found, exact) in [
        (rounded.positions(), trajectory.positions()),
        (rounded.velocities(), trajectory.velocities()),
        (positions.positions(), trajectory.positions()),
    ] {
        assert!(found.iter().zip(exact).all(|(a, b)| (a - b).abs() <= b.abs() / 2048.0 + 1e-7));
        assert!(found != exact);
    }
    // Both together, and to the same bits when written again.
    let both = WriteOptions { compress: true, ..half };
    let again = write(&rounded, dir.path(), "again", Format::Npz, &both).unwrap();
    let other = write(&trajectory, dir.path(), "other", Format::Npz, &both).unwrap();
    assert_eq!(fs::read(again).unwrap(), fs::read(other).unwrap());
    // 70 km away.
    let mut far = Trajectory::new(Grid { h: 1, w: 1 }, 60.0);
    far.push(&[[7e4, 0.0, 0.0]], &[[0.0; 3]]);
    let error = write(&far, dir.path(), "far", Format::Npz, &half).unwrap_err().to_string();
    assert!(error.contains("far.npz: cannot write: frame 0: 70000 is beyond"), "{error}");
    let error =
        write(&far, dir.path(), "far", Format::Npz, &WriteOptions { fps: Some(0.0), ..half }).unwrap_err();
    assert!(error.to_string().contains("fps: expected a number above 0, found 0"), "{error}");
    assert!(!names(dir.path()).contains(&"far.npz".to_owned()));
}

/// Handles and bodies are those of the frames that were left in.
#[test]
fn pictures_of_every_nth_frame_keep_the_time() {
    let trajectory = waving(GRID, 6);
    let options = StripOptions { height: 60, panels: 6, ..StripOptions::default() };
    let picture = |every: usize| {
        let mut marks = Marks::from(&[0]);
        marks.change(2 * every, &[0, 50]);
        strip(Film { grid: GRID, frames: &trajectory, every }, marks, &options)
    };
    assert_eq!(picture(1), picture(4));
    assert_ne!(picture(1), strip(&trajectory, &[0], &options));
}
