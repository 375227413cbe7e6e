//! Repeats from starts that differ minimally from the recorded one.

use crate::common::{PHYSICS, SETTINGS, shipped};
use fnopt::Device;
use fnopt::cloth::Grid;
use fnopt::eval::{Conditions, Entry, Nudge, Score, Sequence, Settings, belong_together, run};
use fnopt::sim::Optimizer;
use std::ops::ControlFlow;
use std::path::Path;

#[test]
fn a_nudge_is_of_the_stated_size_and_leaves_handles_alone() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let recorded = sequence.scene(Grid { h: 24, w: 24 }, &PHYSICS).unwrap().setup().unwrap();
    assert_eq!(Nudge::of(0), None);
    let nudged = |repeat: u64| {
        let mut setup = recorded.clone();
        Nudge::of(repeat).unwrap().apply(&mut setup);
        assert_eq!((&setup.start.v, &setup.handles), (&recorded.start.v, &recorded.handles));
        setup.start.x
    };
    let (first, second) = (nudged(1), nudged(2));
    assert_eq!(first, nudged(1), "the same for the same repeat");
    let handles = &recorded.model.cloths[0].handles;
    let mut sum = 0.0;
    for (k, ((a, b), x)) in first.iter().zip(&second).zip(&recorded.start.x).enumerate() {
        if handles.contains(&(k % 576)) {
            assert_eq!((a, b), (x, x), "handle {}", k % 576);
        } else {
            assert!(a != b && (a - x).abs() <= 1.0001e-5, "{a}, {b}, {x}");
            sum += (a - x).abs();
        }
    }
    // Half of the largest, as for uniform numbers.
    let mean = sum / (3 * (576 - handles.len())) as f64;
    assert!((mean / 5e-6 - 1.0).abs() < 0.1, "{mean}");
}

#[test]
fn the_first_repeat_is_not_nudged() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let entry = Entry { name: "lbfgs".into(), optimizer: Optimizer::lbfgs(), iterations: 5, coarse: false };
    let (grid, settings) = (Grid { h: 12, w: 12 }, Settings { frames: 8, ..SETTINGS });
    let of = |repeat: u64| {
        let tick = || ControlFlow::Continue(());
        let around = (&Device::Cpu, &settings);
        let (score, found) =
            run((&sequence, Nudge::of(repeat)), grid, &entry, around, tick).unwrap().unwrap();
        // Times differ between runs and are left out.
        (Score { ms_per_frame: None, ..score }, found)
    };
    let [first, again, second, third] = [0, 1, 1, 2].map(of);
    assert_eq!((&again.0, again.1.frame(7)), (&second.0, second.1.frame(7)), "the same for the same repeat");
    assert!(first.1.frame(0) != second.1.frame(0) && second.1.frame(0) != third.1.frame(0));
    let apart = |a: f64, b: f64| (a / b - 1.0).abs();
    assert!(first.0.e_cd != second.0.e_cd && apart(first.0.e_cd.unwrap(), second.0.e_cd.unwrap()) < 1e-2);
    // Kept scores of the recorded start stay valid: their keys are unchanged.
    let keys = |score: &Score| -> Vec<String> {
        let document = serde_json::to_value(&score.made_with).unwrap();
        document.as_object().unwrap().keys().cloned().collect()
    };
    let mut expected = vec!["device", "kind", "settings", "truth_crc32", "version", "weights_crc32"];
    assert_eq!(keys(&first.0), expected);
    expected.insert(2, "nudge");
    assert_eq!(keys(&second.0), expected);
    assert_ne!(second.0.made_with.checksum(), third.0.made_with.checksum());
    let unmoved = Conditions::of((&sequence, None), &entry, (&Device::Cpu, &settings));
    assert_eq!(first.0.made_with, unmoved);
    // Each repeat appears once in a table.
    let path = Path::new("a.json");
    assert!(belong_together(&[(path, &first.0), (path, &second.0), (path, &third.0)]).is_ok());
    let error = belong_together(&[(path, &second.0), (path, &again.0)]).unwrap_err().to_string();
    assert!(error.contains("the only score of xy_v2 12x12 lbfgs, N = 5, repeat 1"), "{error}");
}
