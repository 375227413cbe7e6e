//! Strips and animations.

use super::{GRID, waving};
use fnopt::{
    cloth::{Body, Pose, Shape, VertexView},
    io::Trajectory,
    render::{Bodies, GifOptions, Image, StripOptions, View, strip, write_gif, write_png},
};
use std::{fs, path::Path};

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
