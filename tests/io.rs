//! Files and pictures: what is written can be read back, and no file makes a reader panic.

use fnopt::{
    Error,
    cloth::{Body, Grid, Pose, Shape, VertexView},
    io::{Format, ReadOptions, Trajectory, read_npy, read_obj},
    render::{Bodies, GifOptions, Image, StripOptions, View, strip, write_gif, write_png},
};
use ndarray::{Array2, ArrayD, array};
use ndarray_npy::{NpzReader, NpzWriter};
use proptest::prelude::*;
use std::{fs, path::Path};

const GRID: Grid = Grid { h: 9, w: 12 };

/// Builds a sheet that waves and moves sideways, with y up.
fn waving(grid: Grid, frames: usize) -> Trajectory {
    let mut trajectory = Trajectory::new(grid, 60.0);
    trajectory.reserve(frames).unwrap();
    for f in 0..frames {
        let time = f as f32 / 60.0;
        let at = |p: usize| {
            let (u, v) = ((p % grid.w) as f32 / grid.w as f32, (p / grid.w) as f32 / grid.h as f32);
            [u + 0.3 * time, -v, 0.1 * (7.0 * u + 9.0 * time).sin() * v]
        };
        let positions: Vec<_> = (0..grid.particles()).map(at).collect();
        let velocities: Vec<_> = (0..grid.particles()).map(|p| [0.3, 0.0, p as f32 / 7.0]).collect();
        trajectory.push(&positions, &velocities);
    }
    trajectory
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

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

/// Passes `bytes` to every reader. Readers may refuse, but not panic.
fn read_all(bytes: &[u8]) {
    let dir = tempfile::tempdir().unwrap();
    for format in Format::SINGLE_FILES {
        let path = dir.path().join(format!("x.{format}"));
        fs::write(&path, bytes).unwrap();
        let _ = Trajectory::read(&path, &ReadOptions::default());
        let _ = read_npy(&path);
        let _ = read_obj(&path);
    }
    let frames = dir.path().join("frames");
    fs::create_dir(&frames).unwrap();
    fs::write(frames.join("00000.obj"), bytes).unwrap();
    let _ = Trajectory::read(&frames, &ReadOptions::default());
}

/// Returns a small file of each kind.
fn samples() -> Vec<Vec<u8>> {
    let dir = tempfile::tempdir().unwrap();
    let trajectory = waving(Grid { h: 3, w: 3 }, 2);
    let path = |format| trajectory.write(dir.path(), "s", format).unwrap();
    let obj = path(Format::Obj).join("00000.obj");
    let others = Format::SINGLE_FILES.map(path);
    [obj, "tests/data/compressed.npz".into()]
        .into_iter()
        .chain(others)
        .map(|p| fs::read(p).unwrap())
        .collect()
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        read_all(&bytes);
    }

    #[test]
    fn arbitrary_headers_never_panic(text in "[{}()'<>f48i:, a-z0-9]{0,80}", version in 0u8..4) {
        let mut bytes = b"\x93NUMPY".to_vec();
        bytes.extend([version, 0]);
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.bytes());
        read_all(&bytes);
    }

    #[test]
    fn arbitrary_meshes_never_panic(text in "(v( -?[0-9]{1,2}){2,4}\n|f( -?[0-9]{1,2}(/[0-9]?)?){0,5}\n|[a-z0-9# ]{0,9}\n){0,30}") {
        read_all(text.as_bytes());
    }

    #[test]
    fn mutated_files_never_panic(
        kind in 0usize..5,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        from_end in any::<bool>(),
        length in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        thread_local!(static SAMPLES: Vec<Vec<u8>> = samples());
        let mut bytes = SAMPLES.with(|s| s[kind].clone());
        for (at, value) in changes {
            // Headers lie at the start and, in archives, at the end.
            let at = at.index(bytes.len().min(if from_end { 300 } else { 2000 }));
            let at = if from_end { bytes.len() - 1 - at } else { at };
            bytes[at] = value;
        }
        if cut {
            bytes.truncate(length.index(bytes.len()));
        }
        read_all(&bytes);
    }
}

#[test]
fn a_strip_has_a_panel_per_frame_and_repeats_byte_for_byte() {
    let trajectory = waving(GRID, 20);
    let options = StripOptions { height: 160, ..StripOptions::default() };
    let image = strip(&trajectory, &[0, 11], &options);
    assert_eq!(image, strip(&trajectory, &[0, 11], &options));
    assert_eq!((image.height, image.width % 8), (160, 0));
    let panel = image.width / 8;
    for k in 0..8 {
        // Every panel holds cloth, two markers and its time, and nothing touches its edges.
        let pixels = || (0..160).flat_map(|y| (k * panel..(k + 1) * panel).map(move |x| (x, y)));
        let count = |wanted: fn([u8; 3]) -> bool| pixels().filter(|&(x, y)| wanted(image.at(x, y))).count();
        assert!(count(|[r, _, b]| b.abs_diff(r) > 40) > 800, "panel {k}: cloth");
        assert!(count(|[r, g, b]| r > 200 && g < 160 && b < 120) > 8, "panel {k}: handles");
        let ink = |p: [u8; 3]| p.iter().all(|&c| c < 130) && p[0].abs_diff(p[2]) < 16;
        assert!(
            (130..160)
                .flat_map(|y| (0..panel).map(move |x| (x, y)))
                .any(|(x, y)| ink(image.at(k * panel + x, y)))
        );
        for y in 0..160 {
            for x in [k * panel, (k + 1) * panel - 1] {
                let [r, _, b] = image.at(x, y);
                assert!(r.abs_diff(b) < 12, "panel {k}: cloth at the edge");
            }
        }
    }
    assert_eq!(strip(&waving(GRID, 3), &[], &options).width % 3, 0);
}

#[test]
fn a_png_file_holds_the_pixels() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("p.png");
    let image = strip(&waving(GRID, 2), &[0], &StripOptions { panels: 2, height: 40, ..Default::default() });
    write_png(&path, &image).unwrap();
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap())).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    assert_eq!(pixels, image.pixels.as_flattened());
}

/// Returns the frames of an animation as displayed, and its length in seconds.
fn play(path: &Path) -> (Vec<Image>, f64) {
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::Indexed);
    let mut decoder = options.read_info(fs::File::open(path).unwrap()).unwrap();
    let palette: Vec<[u8; 3]> = decoder.global_palette().unwrap().as_chunks().0.to_vec();
    let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
    let (mut canvas, mut frames, mut time) = (Image::new(width, height), Vec::new(), 0);
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        let columns = usize::from(frame.width);
        for (k, &colour) in frame.buffer.iter().enumerate() {
            if Some(colour) != frame.transparent {
                let (x, y) = (usize::from(frame.left) + k % columns, usize::from(frame.top) + k / columns);
                canvas.pixels[y * width + x] = palette[usize::from(colour)];
            }
        }
        frames.push(canvas.clone());
        time += usize::from(frame.delay);
    }
    (frames, time as f64 / 100.0)
}

#[test]
fn an_animation_runs_in_real_time_and_shows_what_a_picture_shows() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (dir.path().join("a.gif"), dir.path().join("b.gif"));
    // More frames than are drawn at a time.
    let trajectory = waving(GRID, 150);
    let options = GifOptions { size: 96, ..GifOptions::default() };
    write_gif(&a, &trajectory, &[0, 11], &options).unwrap();
    write_gif(&b, &trajectory, &[0, 11], &options).unwrap();
    assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap());
    let (frames, seconds) = play(&a);
    assert_eq!(frames.len(), 75);
    // With a pause of 0.8 s at the end.
    assert!((seconds - 2.5 - 0.8).abs() < 0.02, "{seconds} s");

    // Differences between frames add up to whole frames: at another rate, the same moment looks the same.
    let view = View { azimuth: Some(70.0), ..View::default() };
    let options = GifOptions { view, ..options };
    write_gif(&a, &trajectory, &[0, 11], &options).unwrap();
    let (frames, _) = play(&a);
    let middle = &frames[37];
    let all = GifOptions { max_fps: 60.0, ..options };
    write_gif(&b, &trajectory, &[0, 11], &all).unwrap();
    let (dense, _) = play(&b);
    let error = |x: &Image, y: &Image| {
        let pairs = x.pixels.as_flattened().iter().zip(y.pixels.as_flattened());
        pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (3 * 96 * 96) as f64
    };
    assert!(error(middle, &dense[74]) < 1.5, "{}", error(middle, &dense[74]));
    assert!(error(middle, &frames[0]) > 3.0);
    // Fewer pictures of a long run, in the same time.
    write_gif(&b, &trajectory, &[0, 11], &GifOptions { most: 40, ..options }).unwrap();
    let (frames, seconds) = play(&b);
    assert_eq!(frames.len(), 38);
    assert!((seconds - 38.0 * 4.0 / 60.0 - 0.8).abs() < 0.02, "{seconds} s");
}

const BALL: Shape = Shape::Sphere { radius: 0.15 };

/// Returns a body that moves across before the cloth of [`waving`], and a floor below it.
fn moving(shape: Shape, frames: usize) -> Bodies {
    let pose = |position| Pose { position, ..Pose::default() };
    let body =
        |shape| Body { shape, pose: pose([0.0, 0.0, -1.4]), thickness: 0.01, friction: 0.0, present: true };
    let path = (0..frames).map(|f| pose([0.1 + 0.8 * f as f64 / frames as f64, -0.4, -0.3])).collect();
    // z up becomes y up.
    let transform = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]];
    Bodies::new(&[body(shape), body(Shape::Plane)], &[path], &VertexView { transform, time: 1.0 })
}

#[test]
fn bodies_move_through_strips_and_animations() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.gif");
    let (trajectory, bodies) = (waving(GRID, 40), moving(BALL, 40));
    // From the side of the positive z axis.
    let view = View { azimuth: Some(-90.0), elevation: Some(10.0), ..View::default() };
    let options = StripOptions { height: 120, panels: 4, view, bodies: &bodies, crossings: false };
    let image = strip(&trajectory, &[], &options);
    assert_eq!(image, strip(&trajectory, &[], &options));
    // Planes have no part in the framing.
    let [floors, none] = [moving(Shape::Plane, 40), Bodies::default()]
        .map(|bodies| strip(&trajectory, &[], &StripOptions { bodies: &bodies, ..options }));
    assert!(floors.width == none.width && floors != none);
    let gif = GifOptions { size: 96, view, bodies: &bodies, ..GifOptions::default() };
    write_gif(&path, &trajectory, &[], &gif).unwrap();
    let (frames, _) = play(&path);
    let width = image.width / 4;
    let panel = |k: usize| {
        let row = |y: usize| (0..width).map(move |x| (x, y)).map(|(x, y)| image.at(k * width + x, y));
        Image { width, height: 120, pixels: (0..120).flat_map(row).collect() }
    };
    // The ball is the one thing that is dark and not coloured; captions are at the bottom.
    let column = |image: &Image| {
        let rows = image.pixels.chunks(image.width).take(image.height * 3 / 4);
        let grey = |p: &[u8; 3]| p.iter().all(|&c| c < 165) && p[0].abs_diff(p[2]) < 16;
        let columns: Vec<usize> =
            rows.flat_map(|row| row.iter().enumerate().filter(|(_, p)| grey(p)).map(|(x, _)| x)).collect();
        assert!(columns.len() > 40, "{} pixels of a ball", columns.len());
        columns.iter().sum::<usize>() as f64 / columns.len() as f64 / image.width as f64
    };
    for places in [[0, 1, 2, 3].map(|k| column(&panel(k))), [0, 6, 13, 19].map(|f| column(&frames[f]))] {
        let steps: Vec<f64> = places.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step > 0.05), "{places:?}");
    }
}

#[test]
fn cloths_that_cannot_be_drawn_do_not_stop_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.gif");
    let gif = GifOptions { size: 48, ..GifOptions::default() };
    let options = StripOptions { height: 48, ..StripOptions::default() };
    let mut bad = waving(GRID, 3);
    for value in [f32::NAN, f32::INFINITY, f32::MAX, 1e5, 0.0] {
        bad.push(&[[value; 3]; 108], &[[0.0; 3]; 108]);
    }
    let mut point = Trajectory::new(GRID, 60.0);
    point.push(&[[1.0; 3]; 108], &[[0.0; 3]; 108]);
    for trajectory in [&bad, &point, &Trajectory::new(GRID, 60.0)] {
        for up in [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]] {
            let (view, bodies) = (View { up, ..View::default() }, &moving(BALL, 3));
            strip(trajectory, &[0, 107], &StripOptions { view, bodies, ..options });
            write_gif(&path, trajectory, &[0, 107], &GifOptions { view, bodies, ..gif }).unwrap();
        }
    }
    assert_eq!(play(&path).0.len(), 1);
}

/// One panel used to be fitted to what an explosion left of a cloth, in which the frames before it were dots.
#[test]
fn the_camera_stays_with_the_cloth_when_it_explodes() {
    let options = StripOptions { height: 64, ..StripOptions::default() };
    let with = |last: f32| {
        let mut trajectory = waving(GRID, 7);
        let frame: Vec<[f32; 3]> = trajectory.frame(6).iter().map(|p| p.map(|c| last * c)).collect();
        trajectory.push(&frame, &[[0.0; 3]; 108]);
        strip(&trajectory, &[0, 107], &options)
    };
    let [whole, exploded] = [1.0, 1e3].map(with);
    assert_eq!(whole.width, exploded.width);
    let first = |image: &Image| {
        let rows = image.pixels.chunks_exact(image.width);
        rows.flat_map(|row| row[..image.width / 8].to_vec()).collect::<Vec<_>>()
    };
    assert!(first(&whole) == first(&exploded), "the camera has moved");
    assert!(whole.pixels != exploded.pixels);
}
