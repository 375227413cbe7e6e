//! Scenes that run, recordings, and their playback.

use super::{FRAME, HANGING, Screen, changed, context, covered};
use fnopt::io::Trajectory;
use fnopt::scene::Moduli;
use fnopt::view::egui::{Event, Key, Modifiers};
use fnopt::view::{Action, Changes, Content, Playback};
use std::time::Duration;

/// The height of the lowest particle.
fn lowest(screen: &Screen) -> f32 {
    screen.live().positions().iter().map(|p| p[1]).fold(f32::MAX, f32::min)
}

fn key(screen: &mut Screen, key: Key) {
    let pressed = |pressed| Event::Key {
        key,
        physical_key: None,
        pressed,
        repeat: false,
        modifiers: Modifiers::default(),
    };
    screen.events(vec![pressed(true), pressed(false)], Duration::ZERO);
}

#[test]
fn a_picture_shows_the_cloth_and_the_cloth_moves() {
    let mut screen = Screen::of(
        r#"{"grid": [16, 16], "start": "flat", "motion": "none", "bodies":
        [{"shape": "sphere", "radius_m": 0.2, "position_m": [0.5, -0.5, 0]}]}"#,
    );
    let first = screen.image();
    let area = screen.viewer.area().size;
    let share = covered(&screen, &first) as f32 / (area[0] * area[1]);
    assert!((0.03..0.7).contains(&share), "{share}");
    // In the middle of the cloth, beside its handles.
    let at = |screen: &Screen| screen.place(8 * 16 + 8).map(|x| x as usize);
    let [x, y] = at(&screen);
    assert_ne!(first.at(x, y), first.at(0, y), "{x} {y}");
    screen.pass(30);
    let later = screen.image();
    assert_eq!(screen.live().frame(), 30);
    assert!(changed(&screen, &first, &later) > 0.02);
    let [x, y] = at(&screen);
    assert_ne!(later.at(x, y), later.at(0, y), "{x} {y}");
    let stats = screen.live().stats().unwrap();
    assert_eq!(stats.bodies.len(), 1);
    assert_eq!(screen.viewer.history().energy.values().count(), 30);
}

#[test]
fn a_softer_cloth_sags_and_no_gravity_lifts_it() {
    let mut screen = Screen::of(HANGING);
    screen.pass(20);
    let before = lowest(&screen);
    let values = screen.live().values();
    let moduli = Moduli { stretch_modulus: values.moduli.stretch_modulus / 50.0, ..values.moduli };
    let changes = Changes { moduli: Some(moduli), ..Changes::default() };
    screen.viewer.act(Action::Change(changes)).unwrap();
    screen.pass(40);
    assert!(lowest(&screen) < before - 0.02, "{before} {}", lowest(&screen));
    assert_eq!(screen.live().values().moduli, moduli);
    screen
        .viewer
        .act(Action::Change(Changes { gravity: Some(0.0), wind: Some([0.0, 8.0, 0.0]), ..changes }))
        .unwrap();
    let sagged = lowest(&screen);
    screen.pass(40);
    assert!(lowest(&screen) > sagged + 0.02, "{sagged} {}", lowest(&screen));
    // What is not valid changes nothing.
    let wrong = Changes { gravity: Some(f64::INFINITY), ..changes };
    assert!(screen.viewer.act(Action::Change(wrong)).is_err());
    assert_eq!(screen.live().changes().gravity, Some(0.0));
}

#[test]
fn a_pause_stops_frames_and_a_step_makes_one() {
    let mut screen = Screen::of(HANGING);
    screen.pass(3);
    key(&mut screen, Key::Space);
    assert!(!screen.viewer.clock().playing);
    screen.pass(5);
    assert_eq!(screen.live().frame(), 3);
    key(&mut screen, Key::ArrowRight);
    screen.pass(5);
    assert_eq!(screen.live().frame(), 4);
    key(&mut screen, Key::Space);
    screen.viewer.act(Action::Speed(0.5)).unwrap();
    screen.pass(6);
    assert_eq!(screen.live().frame(), 7);
    let start: Vec<[f32; 3]> =
        screen.live().setup().particles(&screen.live().setup().start.cast())[0].clone();
    screen.viewer.act(Action::Reset).unwrap();
    assert_eq!((screen.live().frame(), screen.live().positions()), (0, start));
}

#[test]
fn another_solver_goes_on_from_where_the_cloth_is() {
    let mut screen = Screen::of(HANGING);
    screen.viewer.act(Action::Change(Changes { wind: Some([3.0, 0.0, 0.0]), ..Changes::default() })).unwrap();
    screen.pass(10);
    let before = screen.live().positions();
    screen.viewer.act(Action::Solve { name: "gd".into(), iterations: Some(3) }).unwrap();
    assert_eq!(screen.live().solver(), ("gd", 3));
    assert_eq!(screen.live().positions(), before);
    screen.pass(1);
    assert_eq!(screen.live().frame(), 11);
    let moved =
        screen.live().positions().iter().zip(&before).map(|(a, b)| (a[0] - b[0]).abs()).fold(0.0, f32::max);
    assert!(moved > 1e-5 && moved < 0.1, "{moved}");
    let refused = screen.viewer.act(Action::Solve { name: "newton".into(), iterations: None }).unwrap_err();
    assert!(refused.to_string().contains("runs on a GPU"), "{refused}");
    assert_eq!(screen.live().solver(), ("gd", 3));
}

#[test]
fn events_of_the_scene_come_while_it_runs() {
    let mut screen = Screen::of(
        r#"{"grid": [16, 16], "motion": "none", "events": [{"frame": 5, "release": [[0, 0]]}, {"frame": 8, "grab": [[15, 15]]}]}"#,
    );
    let handles = |screen: &Screen| screen.live().handles();
    assert_eq!(handles(&screen), [15 * 16, 0]);
    screen.pass(5);
    assert_eq!(handles(&screen), [15 * 16]);
    screen.pass(3);
    assert_eq!(handles(&screen), [15 * 16, 15 * 16 + 15]);
    let before = screen.live().positions();
    screen.pass(5);
    let after = screen.live().positions();
    assert!((0..3).all(|c| (after[255][c] - before[255][c]).abs() < 1e-5));
    assert!(after[0][1] < before[0][1], "the other falls");
}

#[test]
fn a_cloth_that_becomes_non_finite_ends_the_simulation_until_it_is_reset() {
    let mut screen = Screen::of(HANGING);
    screen.viewer.act(Action::Change(Changes { gravity: Some(1e30), ..Changes::default() })).unwrap();
    screen.pass(12);
    let broken = screen.live().broken().expect("nothing survives that");
    assert!(!screen.viewer.clock().playing && broken <= 12);
    screen.viewer.act(Action::Step).unwrap();
    assert!(screen.live().positions().iter().flatten().all(|c| c.is_finite()));
    screen.viewer.act(Action::Change(Changes::default())).unwrap();
    screen.viewer.act(Action::Reset).unwrap();
    screen.viewer.act(Action::Play(true)).unwrap();
    screen.pass(3);
    assert_eq!((screen.live().frame(), screen.live().broken()), (3, None));
}

#[test]
fn a_recording_has_the_frames_that_were_made_and_plays_back() {
    let mut screen = Screen::of(r#"{"grid": [16, 16], "start": "flat", "motion": "none"}"#);
    screen.pass(2);
    screen.viewer.act(Action::Record(true)).unwrap();
    screen.pass(12);
    screen.viewer.act(Action::Record(false)).unwrap();
    screen.viewer.act(Action::Record(true)).unwrap();
    screen.pass(1);
    screen.viewer.act(Action::Reset).unwrap();
    let [file, other] = screen.viewer.files() else { panic!("{:?}", screen.viewer.files()) };
    assert_eq!((file, other), (&screen.out.path().join("view.npz"), &screen.out.path().join("view-2.npz")));
    assert!(screen.viewer.note().contains("view-2.npz"), "{}", screen.viewer.note());
    let kept = Trajectory::read(file, &Default::default()).unwrap();
    assert_eq!(
        (kept.frames(), kept.grid(), kept.fps().round()),
        (12, screen.live().setup().model.grid, 60.0)
    );
    assert_eq!(Trajectory::read(other, &Default::default()).unwrap().frames(), 1);
    screen.pass(14);
    assert_eq!(kept.frame(11), screen.live().positions());
    let seen = screen.live().positions();
    drop(screen);

    let mut screen = Screen::showing(|_| {
        Content::Playback(Box::new(Playback::new(context(), kept.clone())), [0.0, 1.0, 0.0])
    });
    screen.viewer.act(Action::Seek(11)).unwrap();
    let last = screen.image();
    assert_eq!(screen.viewer.playback().unwrap().positions(), seen);
    let drawn = |at: [f32; 3]| {
        let [x, y] = screen.viewer.place_of(at).unwrap().map(|x| x as usize);
        last.at(x, y) != last.at(0, y)
    };
    // Particles inside of the cloth's outline.
    assert!([3 * 16 + 8, 8 * 16 + 8, 12 * 16 + 5].iter().all(|&p| drawn(seen[p])));
    screen.viewer.act(Action::Seek(0)).unwrap();
    let first = screen.image();
    assert!(changed(&screen, &first, &last) > 0.02);
    screen.viewer.act(Action::Play(true)).unwrap();
    (0..5).for_each(|_| screen.events(Vec::new(), FRAME));
    assert_eq!(screen.viewer.playback().unwrap().frame(), 5);
    screen.viewer.act(Action::Repeat(false)).unwrap();
    (0..20).for_each(|_| screen.events(Vec::new(), FRAME));
    assert_eq!((screen.viewer.playback().unwrap().frame(), screen.viewer.clock().playing), (11, false));
}

#[test]
fn a_picture_is_written_as_it_is_shown() {
    let mut screen = Screen::of(HANGING);
    let shown = screen.image();
    screen.viewer.act(Action::Picture).unwrap();
    let [file] = screen.viewer.files() else { panic!("{:?}", screen.viewer.files()) };
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(file).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width as usize, info.height as usize), (shown.width, shown.height));
    assert_eq!(pixels, shown.pixels.as_flattened());
}
