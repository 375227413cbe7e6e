//! Formats that are read, too.

use super::{GRID, names, waving};
use fnopt::{
    Error,
    cloth::Grid,
    io::{Format, ReadOptions, Trajectory, read_npy, read_obj},
};
use ndarray::{Array2, ArrayD, array};
use ndarray_npy::{NpzReader, NpzWriter};
use std::fs;

#[test]
fn frames_that_no_memory_holds_are_an_error() {
    // 402 TB, more than a process can address.
    let error = Trajectory::new(Grid { h: 4096, w: 4096 }, 60.0).reserve(1_000_000).unwrap_err().to_string();
    assert!(error.contains("not enough memory: 1000000 frames of 4096x4096: 375000.0 GiB"), "{error}");
    assert!(Trajectory::new(GRID, 60.0).reserve(usize::MAX).is_err());
}

#[test]
fn positions_come_back_bit_for_bit_from_every_format_that_is_read() {
    let dir = tempfile::tempdir().unwrap();
    let written = waving(GRID, 5);
    for format in Format::SINGLE_FILES.into_iter().chain([Format::Obj]) {
        let path = written.write(dir.path().join("new/folder"), "cloth", format).unwrap();
        let grid = (!matches!(format, Format::Npz | Format::Obj)).then_some(GRID);
        let read = Trajectory::read(&path, &ReadOptions { grid, ..ReadOptions::default() }).unwrap();
        assert_eq!((read.grid(), read.frames(), read.fps()), (GRID, 5, 60.0), "{format}");
        assert_eq!(read.positions(), written.positions(), "{format}");
        match format {
            Format::Npz => assert_eq!(read, written),
            // Velocities are differences of positions: 0.3 m/s across.
            _ => assert!((read.velocities()[[3, 7, 0]] - 0.3).abs() < 1e-4),
        }
    }
    // The mesh that a point cache animates.
    let mesh = dir.path().join("new/folder/cloth.obj");
    written.write_mesh(&mesh).unwrap();
    let mesh = read_obj(&mesh).unwrap();
    assert_eq!((&mesh.positions[..], mesh.faces), (written.frame(0), GRID.faces()));
    // No temporary files are left.
    assert_eq!(
        names(&dir.path().join("new/folder")),
        ["cloth.mdd", "cloth.npy", "cloth.npz", "cloth.obj", "cloth.pc2", "cloth_obj"]
    );
}

#[test]
fn an_archive_holds_what_is_documented() {
    let dir = tempfile::tempdir().unwrap();
    let path = waving(GRID, 3).write(dir.path(), "cloth", Format::Npz).unwrap();
    let mut npz = NpzReader::new(fs::File::open(path).unwrap()).unwrap();
    assert_eq!(npz.names().unwrap(), ["vertices_seq", "velocities_seq", "faces", "vertices_uv", "fps"]);
    let faces: ArrayD<i32> = npz.by_name("faces").unwrap();
    assert_eq!(faces.shape(), [2 * 8 * 11, 3]);
    let uv: ArrayD<f32> = npz.by_name("vertices_uv").unwrap();
    assert_eq!((uv[[11, 0]], uv[[11, 1]], uv[[12, 1]], uv[[107, 0]]), (1.0, 0.0, 1.0, 0.0));
    let fps: ArrayD<f64> = npz.by_name("fps").unwrap();
    assert_eq!((fps.ndim(), fps.sum()), (0, 60.0));
}

#[test]
fn a_ply_file_has_its_header_and_length() {
    let dir = tempfile::tempdir().unwrap();
    let folder = waving(GRID, 2).write(dir.path(), "cloth", Format::Ply).unwrap();
    let bytes = fs::read(folder.join("00001.ply")).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = str::from_utf8(&bytes[..end]).unwrap();
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\nelement vertex 108\n"));
    assert_eq!(bytes.len() - end, 108 * 24 + 176 * 13);
    assert!(header.contains("float x\nproperty float y\nproperty float z\nproperty float nx\n"), "{header}");
    let float = |at: usize| f32::from_le_bytes(bytes[end + at..][..4].try_into().unwrap());
    for (p, expected) in waving(GRID, 2).frame(1).iter().enumerate() {
        assert_eq!([0, 4, 8].map(|k| float(24 * p + k)), *expected, "vertex {p}");
    }
    for (k, face) in GRID.faces().iter().enumerate() {
        let record = &bytes[end + 108 * 24 + 13 * k..][..13];
        assert_eq!((record[0], &record[1..]), (3, bytemuck::cast_slice::<u32, u8>(face)), "face {k}");
    }
    let normal = [12, 16, 20].map(float);
    assert!((normal.map(|x| x * x).iter().sum::<f32>() - 1.0).abs() < 1e-5);
}

#[test]
fn a_shorter_run_leaves_no_frames_of_a_longer_one() {
    let dir = tempfile::tempdir().unwrap();
    let folder = waving(GRID, 4).write(dir.path(), "cloth", Format::Obj).unwrap();
    // No run gives its frames such names.
    for own in ["notes.txt", "7.obj"] {
        fs::write(folder.join(own), "mine").unwrap();
    }
    waving(GRID, 2).write(dir.path(), "cloth", Format::Obj).unwrap();
    assert_eq!(names(&folder), ["00000.obj", "00001.obj", "7.obj", "notes.txt"]);
}

/// Killed while frames are renamed, a run leaves a part of them, which would read as a whole sequence.
#[test]
fn frames_of_a_killed_run_are_not_read_and_the_next_run_removes_them() {
    let dir = tempfile::tempdir().unwrap();
    let folder = waving(GRID, 4).write(dir.path(), "cloth", Format::Obj).unwrap();
    let left = folder.join(".writing-x1y2z3");
    fs::create_dir(&left).unwrap();
    for frame in ["00002.obj", "00003.obj"] {
        fs::rename(folder.join(frame), left.join(frame)).unwrap();
    }
    let error = Trajectory::read(&folder, &ReadOptions::default()).unwrap_err().to_string();
    assert!(
        error.contains("frames: expected all frames in their place") && error.contains(".writing-x1y2z3"),
        "{error}"
    );
    waving(GRID, 3).write(dir.path(), "cloth", Format::Obj).unwrap();
    assert_eq!(names(&folder), ["00000.obj", "00001.obj", "00002.obj"]);
    assert_eq!(Trajectory::read(&folder, &ReadOptions::default()).unwrap().frames(), 3);
}

#[test]
fn a_folder_in_the_way_of_a_frame_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let folder = waving(GRID, 2).write(dir.path(), "cloth", Format::Ply).unwrap();
    let before = fs::read(folder.join("00000.ply")).unwrap();
    fs::create_dir(folder.join("00002.ply")).unwrap();
    // Among the new frames, and among those of a longer run.
    for frames in [3, 1] {
        let error = waving(Grid { h: 3, w: 3 }, frames).write(dir.path(), "cloth", Format::Ply).unwrap_err();
        assert!(error.to_string().contains("00002.ply: type: expected a file"), "{error}");
        assert_eq!(names(&folder), ["00000.ply", "00001.ply", "00002.ply"]);
        assert_eq!(fs::read(folder.join("00000.ply")).unwrap(), before);
    }
}

#[test]
fn a_sequence_of_meshes_may_have_names_and_begin_anywhere() {
    let dir = tempfile::tempdir().unwrap();
    let written = waving(GRID, 3);
    let folder = written.write(dir.path(), "cloth", Format::Obj).unwrap();
    let read = || Trajectory::read(&folder, &ReadOptions::default());
    let rename = |from: &str, to: &str| fs::rename(folder.join(from), folder.join(to)).unwrap();
    for (k, to) in ["flag_8.obj", "flag_09.obj", "flag_10.obj"].iter().enumerate() {
        rename(&format!("{k:05}.obj"), to);
    }
    fs::write(folder.join("rest.obj"), "no frame").unwrap();
    assert_eq!(read().unwrap().positions(), written.positions());
    rename("flag_10.obj", "flag_11.obj");
    let error = read().unwrap_err().to_string();
    assert!(error.contains("flag_11.obj: number: expected 10, found 11"), "{error}");
    rename("flag_11.obj", "other_10.obj");
    let error = read().unwrap_err().to_string();
    assert!(error.contains("other_10.obj: name: expected 'flag_' and a number"), "{error}");
    rename("other_10.obj", "1.obj");
    assert_eq!(read().unwrap().frames(), 1);
}

/// The cloth used to be assembled with the rows of the requested grid.
#[test]
fn a_grid_that_contradicts_the_faces_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = waving(GRID, 2).write(dir.path(), "cloth", Format::Npz).unwrap();
    let transposed = ReadOptions { grid: Some(Grid { h: GRID.w, w: GRID.h }), ..ReadOptions::default() };
    let error = Trajectory::read(&path, &transposed).unwrap_err().to_string();
    assert!(error.contains(&format!("faces: expected those of {}x{}", GRID.w, GRID.h)), "{error}");
    assert!(error.ends_with(&format!("found those of {GRID}")), "{error}");
}

#[test]
fn an_output_folder_that_is_a_file_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("taken");
    fs::write(&file, "").unwrap();
    for format in Format::ALL {
        let error = waving(GRID, 1).write(&file, "cloth", format).unwrap_err();
        assert!(matches!(&error, Error::Io { path, .. } if path.starts_with(&file)), "{error}");
    }
}

#[test]
fn arrays_in_both_orders_are_read_as_f64() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.npy");
    let a = array![[1.5f32, 2.0, 3.0], [4.0, 5.0, 6.0]];
    ndarray_npy::write_npy(&path, &a).unwrap();
    assert_eq!(read_npy(&path).unwrap(), a.mapv(f64::from).into_dyn());
    ndarray_npy::write_npy(&path, &a.mapv(f64::from).t()).unwrap();
    assert_eq!(read_npy(&path).unwrap(), a.t().mapv(f64::from).into_dyn());
    ndarray_npy::write_npy(&path, &array![1i32, 2]).unwrap();
    let error = read_npy(&path).unwrap_err().to_string();
    assert!(error.contains("dtype: expected floating-point") && error.contains("found 'i4'"), "{error}");
}

/// Face indices in NumPy's unsigned types, and an OBJ file that starts with a byte-order mark, are accepted.
#[test]
fn files_of_other_programs_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let original = waving(GRID, 2);
    let path = dir.path().join("theirs.npz");
    let mut npz = NpzWriter::new(fs::File::create(&path).unwrap());
    npz.add_array("vertices_seq", &original.positions()).unwrap();
    let faces: Vec<[u32; 3]> = original.grid().faces();
    npz.add_array("faces", &Array2::from(faces.clone())).unwrap();
    npz.finish().unwrap();
    let found = Trajectory::read(&path, &ReadOptions::default()).unwrap();
    assert_eq!((found.grid(), found.positions()), (GRID, original.positions()));
    let mut npz = NpzWriter::new(fs::File::create(&path).unwrap());
    npz.add_array("vertices_seq", &original.positions()).unwrap();
    let long: Vec<[u64; 3]> = faces.iter().map(|f| f.map(u64::from)).collect();
    npz.add_array("faces", &Array2::from(long)).unwrap();
    npz.finish().unwrap();
    assert_eq!(Trajectory::read(&path, &ReadOptions::default()).unwrap().grid(), GRID);

    // Faces of 16-bit integers, and the axes of the grid instead of one of vertices.
    let mut npz = NpzWriter::new(fs::File::create(&path).unwrap());
    let positions = original.positions().to_shape((2, GRID.h, GRID.w, 3)).unwrap().to_owned();
    npz.add_array("vertices_seq", &positions).unwrap();
    let short: Vec<[i16; 3]> = faces.iter().map(|f| f.map(|k| k as i16)).collect();
    npz.add_array("faces", &Array2::from(short)).unwrap();
    npz.finish().unwrap();
    let found = Trajectory::read(&path, &ReadOptions::default()).unwrap();
    assert_eq!((found.grid(), found.positions()), (GRID, original.positions()));
    let path = dir.path().join("axes.npy");
    ndarray_npy::write_npy(&path, &positions).unwrap();
    assert_eq!(Trajectory::read(&path, &ReadOptions::default()).unwrap().grid(), GRID);
    let other = ReadOptions { grid: Some(Grid { h: GRID.w, w: GRID.h }), ..ReadOptions::default() };
    let error = Trajectory::read(&path, &other).unwrap_err().to_string();
    assert!(error.contains("shape: expected those of 12x9, found those of 9x12"), "{error}");

    // From numpy.savez_compressed, of big-endian numbers.
    let found = Trajectory::read(
        "tests/data/compressed.npz",
        &ReadOptions { grid: Some(Grid { h: 8, w: 9 }), ..Default::default() },
    )
    .unwrap();
    assert_eq!((found.frames(), found.fps()), (2, 24.0));
    let positions: Vec<[f32; 3]> = (0..72).map(|p| [(p % 9) as f32, -((p / 9) as f32), 0.0]).collect();
    assert_eq!(found.frame(0), positions);
    let moved: Vec<_> = positions.iter().map(|[x, y, _]| [x + 0.25, *y, 0.5]).collect();
    assert_eq!(found.frame(1), moved);

    let mesh = dir.path().join("mesh.obj");
    original.write_mesh(&mesh).unwrap();
    let plain = read_obj(&mesh).unwrap();
    fs::write(&mesh, [b"\xef\xbb\xbf".to_vec(), fs::read(&mesh).unwrap()].concat()).unwrap();
    let marked = read_obj(&mesh).unwrap();
    assert_eq!((marked.positions, marked.faces), (plain.positions, plain.faces));
}

#[test]
fn readers_name_what_is_missing_or_wrong() {
    let dir = tempfile::tempdir().unwrap();
    let options = ReadOptions::default();
    let missing = Trajectory::read(dir.path().join("none.npz"), &options).unwrap_err();
    assert!(matches!(missing, Error::Io { .. }));

    let path = waving(GRID, 3).write(dir.path(), "cloth", Format::Npy).unwrap();
    let error = Trajectory::read(&path, &options).unwrap_err().to_string();
    assert!(error.contains("vertices: expected those of a square grid, found 108"), "{error}");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    assert!(Trajectory::read(&path, &options).unwrap_err().to_string().contains("cloth.npy: length"));

    let mut broken = Trajectory::new(GRID, 60.0);
    let mut positions = vec![[0.0; 3]; 108];
    positions[30][1] = f32::NAN;
    broken.push(&positions, &positions);
    let path = broken.write(dir.path(), "nan", Format::Npz).unwrap();
    let error = Trajectory::read(&path, &options).unwrap_err().to_string();
    assert!(error.contains("frame 0, vertex 30: expected finite numbers"), "{error}");
}

/// Positions that were rounded to whole numbers by mistake are not positions.
#[test]
fn whole_numbers_are_not_positions() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("whole.npz");
    let mut npz = NpzWriter::new(fs::File::create(&path).unwrap());
    npz.add_array("vertices_seq", &waving(GRID, 2).positions().mapv(|x| x as i64)).unwrap();
    npz.finish().unwrap();
    let error = Trajectory::read(&path, &ReadOptions::default()).unwrap_err().to_string();
    assert!(
        error.contains("vertices_seq: dtype: expected floating-point") && error.contains("'i8'"),
        "{error}"
    );
}

#[test]
fn a_damaged_archive_is_noticed() {
    let dir = tempfile::tempdir().unwrap();
    let path = waving(GRID, 3).write(dir.path(), "cloth", Format::Npz).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    bytes[400] ^= 1;
    fs::write(&path, bytes).unwrap();
    let error = Trajectory::read(&path, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("vertices_seq") && error.contains("checksum"), "{error}");
}

/// The bytes that other programs expect, and the rate of the frames from their times.
#[test]
fn an_mdd_holds_what_is_documented() {
    let dir = tempfile::tempdir().unwrap();
    let written = waving(Grid { h: 3, w: 3 }, 4);
    let path = written.write(dir.path(), "cloth", Format::Mdd).unwrap();
    let bytes = fs::read(&path).unwrap();
    let word = |k: usize| <[u8; 4]>::try_from(&bytes[4 * k..][..4]).unwrap();
    assert_eq!([0, 1].map(|k| i32::from_be_bytes(word(k))), [4, 9]);
    for frame in 0..4 {
        assert!((f32::from_be_bytes(word(2 + frame)) - frame as f32 / 60.0).abs() < 1e-6);
        let first = [0, 1, 2].map(|c| f32::from_be_bytes(word(6 + 27 * frame + c)));
        assert_eq!(first, written.frame(frame)[0]);
    }
    assert_eq!(bytes.len(), 4 * (2 + 4 + 4 * 27));
    let read = Trajectory::read(&path, &ReadOptions { fps: 10.0, ..ReadOptions::default() }).unwrap();
    assert_eq!(read.fps(), 60.0);
    // Times that are all the same say nothing, and a length that does not fit is an error.
    let mut still = bytes.clone();
    still[8..24].fill(0);
    fs::write(&path, &still).unwrap();
    assert_eq!(
        Trajectory::read(&path, &ReadOptions { fps: 10.0, ..ReadOptions::default() }).unwrap().fps(),
        10.0
    );
    for (what, bytes) in
        [("short", &bytes[..bytes.len() - 1]), ("headless", &bytes[..6]), ("timeless", &bytes[..12])]
    {
        fs::write(&path, bytes).unwrap();
        let error = Trajectory::read(&path, &ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains("cloth.mdd") && error.contains("length"), "{what}: {error}");
    }
}
