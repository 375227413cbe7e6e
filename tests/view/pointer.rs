//! What the pointer does beside the panel.

use super::{FRAME, HANGING, Screen, apart, changed};
use fnopt::view::Action;
use fnopt::view::egui::{
    Event, Modifiers, MouseWheelSource, MouseWheelUnit, PointerButton, TouchPhase, vec2,
};

/// Presses a button on a particle, moves the pointer by so many pixels and lets some frames pass.
fn drag(screen: &mut Screen, particle: usize, by: [f32; 2]) -> [f32; 2] {
    let [x, y] = screen.place(particle);
    let to = [x + by[0], y + by[1]];
    screen.button(PointerButton::Primary, [x, y], true);
    (0..40).for_each(|_| screen.move_to(to));
    screen.viewer.settle().unwrap();
    to
}

#[test]
fn a_handle_follows_the_pointer_and_stays_where_it_is_let_go() {
    let mut screen = Screen::of(HANGING);
    let handle = screen.live().handles()[0];
    let to = drag(&mut screen, handle, [-40.0, 30.0]);
    assert!(apart(screen.place(handle), to) < 1.0, "{:?} {to:?}", screen.place(handle));
    screen.button(PointerButton::Primary, to, false);
    screen.move_to([5.0, 5.0]);
    screen.pass(5);
    assert!(apart(screen.place(handle), to) < 1.0);
    assert_eq!(screen.live().handles().len(), 2);
}

#[test]
fn any_particle_can_be_dragged_and_is_free_again() {
    let mut screen = Screen::of(HANGING);
    let particle = 8 * 16 + 12;
    let before = screen.place(particle);
    let to = drag(&mut screen, particle, [0.0, -60.0]);
    let [held] = screen.live().handles()[2..] else { panic!("{:?}", screen.live().handles()) };
    assert!(apart(screen.place(held), to) < 12.0, "the pointer takes the nearest particle");
    let at = screen.place(held);
    screen.button(PointerButton::Primary, to, false);
    assert_eq!(screen.live().handles().len(), 2);
    screen.pass(30);
    assert!(screen.place(held)[1] > at[1] + 15.0, "it falls: {at:?} {:?} {before:?}", screen.place(held));
}

#[test]
fn what_is_pinned_stays_until_all_is_let_go() {
    let mut screen = Screen::of(HANGING);
    screen.viewer.act(Action::Pin(true)).unwrap();
    let to = drag(&mut screen, 8 * 16 + 12, [20.0, -40.0]);
    screen.button(PointerButton::Primary, to, false);
    screen.pass(20);
    let [pinned] = screen.live().handles()[2..] else { panic!("{:?}", screen.live().handles()) };
    assert!(apart(screen.place(pinned), to) < 1.0, "{:?} {to:?}", screen.place(pinned));
    assert!(screen.live().has_pinned());
    screen.viewer.act(Action::Unpin).unwrap();
    screen.pass(1);
    assert_eq!((screen.live().handles().len(), screen.live().has_pinned()), (2, false));
}

#[test]
fn a_button_beside_the_cloth_turns_and_the_wheel_zooms() {
    let mut screen = Screen::of(HANGING);
    screen.viewer.act(Action::Play(false)).unwrap();
    let (first, orbit) = (screen.image(), *screen.viewer.orbit());
    assert_eq!(changed(&screen, &first, &screen.picture.image().unwrap()), 0.0);
    for (button, from) in [(PointerButton::Primary, [6.0, 6.0]), (PointerButton::Secondary, [200.0, 200.0])] {
        screen.button(button, from, true);
        screen.move_to([from[0] + 60.0, from[1] + 20.0]);
        screen.button(button, [from[0] + 60.0, from[1] + 20.0], false);
        let turned = *screen.viewer.orbit();
        assert!(
            (turned.azimuth - orbit.azimuth).abs() > 0.3 && turned.distance == orbit.distance,
            "{turned:?}"
        );
        let image = screen.image();
        assert!(changed(&screen, &first, &image) > 0.05);
        screen.viewer.act(Action::Look).unwrap();
        assert_eq!(*screen.viewer.orbit(), orbit);
    }
    screen.button(PointerButton::Middle, [200.0, 200.0], true);
    screen.move_to([230.0, 180.0]);
    screen.button(PointerButton::Middle, [230.0, 180.0], false);
    let moved = *screen.viewer.orbit();
    assert!(moved.target != orbit.target && moved.azimuth == orbit.azimuth, "{moved:?}");
    let wheel = Event::MouseWheel {
        unit: MouseWheelUnit::Point,
        delta: vec2(0.0, 120.0),
        phase: TouchPhase::Move,
        source: MouseWheelSource::Wheel,
        modifiers: Modifiers::default(),
    };
    screen.events(vec![wheel], FRAME);
    (0..20).for_each(|_| screen.events(Vec::new(), FRAME));
    assert!(screen.viewer.orbit().distance < 0.9 * orbit.distance, "{:?}", screen.viewer.orbit());
}
