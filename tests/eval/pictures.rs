//! Pictures against small references. After a change of what is drawn, these tests write the references anew if
//! `FNOPT_WRITE_VECTORS` is set; look at them before you commit them.

use fnopt::render::{Chart, Curve, Image, Line, Scale, StripOptions, View, charts, strip, write_png};
use fnopt::scene::Scene;
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};
use std::ops::ControlFlow;
use std::path::Path;

/// Asserts that a picture differs from the reference by at most `most` levels of 255, on average over all pixels.
fn looks_like(image: &Image, name: &str, most: f64) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    if std::env::var_os("FNOPT_WRITE_VECTORS").is_some() {
        write_png(&path, image).unwrap();
    }
    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width as usize, info.height as usize), (image.width, image.height), "{name}");
    let found = image.pixels.as_flattened();
    assert_eq!(found.len(), pixels.len(), "{name}");
    let apart: f64 = found.iter().zip(&pixels).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    let mean = apart / found.len() as f64;
    assert!(mean < most, "{name}: {mean:.2} levels");
}

/// The exact motion of the default scene, which is the same on every machine, as a strip.
#[test]
fn the_default_scene_looks_as_before() {
    let setup = Scene::default().setup().unwrap();
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::newton(), 1).unwrap();
    simulator.set_state(&setup.start.cast());
    let mut trajectory = setup.trajectory().unwrap();
    let controls = (1..setup.frames()).map(|frame| setup.control(frame));
    simulator
        .rollout(controls, |frame| {
            setup.push(&mut trajectory, &frame.state);
            ControlFlow::Continue(())
        })
        .unwrap();
    let view = View { up: setup.up.down(-1.0).map(|c| c as f32), ..View::default() };
    let options = StripOptions { panels: 6, height: 120, view, ..StripOptions::default() };
    let image = strip(&trajectory, &setup.model.cloths[0].handles, &options);
    looks_like(&image, "strip.png", 1.0);
    // Another frame rate of panels is another picture.
    let other = strip(&trajectory, &[], &options);
    assert_ne!(image, other);
}

#[test]
fn a_chart_looks_as_before() {
    let curve = |label: &str, colour: usize, by: f64| Curve {
        label: label.into(),
        colour,
        points: (0..6).map(|k| [2f64.powi(k), by / 3f64.powi(k)]).collect(),
        notes: (0..6).map(|k| (k + 1).to_string()).collect(),
    };
    let chart = Chart {
        title: "energy gap".into(),
        axes: ["ms per frame".into(), "gap [%]".into()],
        curves: vec![curve("spectral", 0, 10.0), curve("fnopt", 1, 40.0)],
        lines: vec![Line { label: "newton".into(), colour: 2, at: 10.0 }],
        scales: [Scale::Logarithmic; 2],
    };
    looks_like(&charts(&[chart], (320, 240)), "chart.png", 1.0);
}
