//! Repeats from starts that are all but the recorded one.

use crate::{PHYSICS, SETTINGS, newton, shipped};
use fnopt::eval::{Conditions, Entry, Format, Nudge, OverRepeats, Score, Sequence, Settings};
use fnopt::eval::{belong_together, compare, run, tables};
use fnopt::sim::{Device, Grid, Optimizer};
use std::ops::ControlFlow;
use std::path::Path;

#[test]
fn a_nudge_is_of_the_stated_size_and_leaves_handles_alone() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let recorded = sequence.scene(Grid { h: 24, w: 20 }, &PHYSICS).unwrap().setup().unwrap();
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
        if handles.contains(&(k % 480)) {
            assert_eq!((a, b), (x, x), "handle {}", k % 480);
        } else {
            assert!(a != b && (a - x).abs() <= 1.0001e-5, "{a}, {b}, {x}");
            sum += (a - x).abs();
        }
    }
    // Half of the largest, as of uniform numbers.
    let mean = sum / (3 * (480 - handles.len())) as f64;
    assert!((mean / 5e-6 - 1.0).abs() < 0.1, "{mean}");
}

#[test]
fn the_first_of_several_repeats_is_the_one_without() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let entry = Entry { name: "lbfgs".into(), optimizer: Optimizer::lbfgs(), iterations: 5, coarse: false };
    let (grid, settings) = (Grid { h: 12, w: 12 }, Settings { frames: 8, ..SETTINGS });
    let of = |repeat: u64| {
        let tick = || ControlFlow::Continue(());
        let around = (&Device::Cpu, &settings);
        let (score, found) =
            run((&sequence, Nudge::of(repeat)), grid, &entry, around, tick).unwrap().unwrap();
        // Times are of no repeat.
        (Score { ms_per_frame: None, ..score }, found)
    };
    let [first, again, second, third] = [0, 1, 1, 2].map(of);
    assert_eq!((&again.0, again.1.frame(7)), (&second.0, second.1.frame(7)), "the same for the same repeat");
    assert!(first.1.frame(0) != second.1.frame(0) && second.1.frame(0) != third.1.frame(0));
    let apart = |a: f64, b: f64| (a / b - 1.0).abs();
    assert!(first.0.e_cd != second.0.e_cd && apart(first.0.e_cd.unwrap(), second.0.e_cd.unwrap()) < 1e-2);
    // Kept scores of the recorded start stay valid: their key has nothing new in it.
    let keys = |score: &Score| -> Vec<String> {
        let document = serde_json::to_value(&score.made_with).unwrap();
        document.as_object().unwrap().keys().cloned().collect()
    };
    let mut expected = vec!["device", "kind", "settings", "truth", "version", "weights"];
    assert_eq!(keys(&first.0), expected);
    expected.insert(2, "nudge");
    assert_eq!(keys(&second.0), expected);
    assert_ne!(second.0.made_with.checksum(), third.0.made_with.checksum());
    let unmoved = Conditions::of((&sequence, None), &entry, (&Device::Cpu, &settings));
    assert_eq!(first.0.made_with, unmoved);
    // Each stands in a table once.
    let path = Path::new("a.json");
    assert!(belong_together(&[(path, &first.0), (path, &second.0), (path, &third.0)]).is_ok());
    let error = belong_together(&[(path, &second.0), (path, &again.0)]).unwrap_err().to_string();
    assert!(error.contains("the only score of xy_v2 12x12 lbfgs, N = 5, repeat 1"), "{error}");
}

/// Deviations over repeats are told apart from those over sequences.
#[test]
fn tables_have_means_over_repeats() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let itself = compare(&sequence, "arcsim", &sequence.truth, &SETTINGS).unwrap();
    let score = |name: &str, repeat: u64, e_cd: f64| {
        let mut score =
            Score { sequence: name.into(), solver: newton().name, e_cd: Some(1e-3 * e_cd), ..itself.clone() };
        score.made_with.nudge = Nudge::of(repeat);
        score
    };
    let mut scores =
        vec![score("a", 0, 1.0), score("b", 0, 5.0), score("a", 1, 3.0), score("b", 1, 5.0), itself.clone()];
    let written = |scores: &[Score]| -> Vec<String> {
        tables(scores).iter().map(|table| table.write(Format::Csv)).collect()
    };
    let csv = written(&scores);
    assert_eq!(
        csv[0],
        "# 32x32: e_CD x 10^3 [m^2], means over repeats\nsequence,newton,arcsim\na,2.00,\nb,5.00,\n\
         xy_v2,,"
            .to_owned()
            + &format!("{:.2}\n", 1e3 * itself.e_cd.unwrap())
            + &format!("mean,3.50,{:.2}\ndeviation,2.12,0.00\n", 1e3 * itself.e_cd.unwrap())
    );
    // Of 1 and 3 it is the root of 2; what was simulated once has none.
    assert_eq!(
        csv[1],
        "# 32x32: e_CD x 10^3 [m^2], deviations over repeats\nsequence,newton,arcsim\na,1.41,\nb,0.00,\n\
         xy_v2,,\nroot mean square,1.00,\n"
    );
    let overview = csv.iter().find(|text| text.starts_with("# error and time")).unwrap();
    assert!(overview.contains("solver,sequences,simulations,e_CD x 10^3 [m^2],±,± repeats,"), "{overview}");
    assert!(overview.contains("32x32 newton,2,4,3.50,2.12,1.00,"), "{overview}");
    let told = OverRepeats::of(&scores[0], &scores);
    assert_eq!((told.repeats, told.gradient), (2, None));
    let [mean, deviation] = told.e_cd.unwrap();
    assert!((mean - 2e-3).abs() < 1e-12 && (deviation - 2f64.sqrt() * 1e-3).abs() < 1e-12);
    // One repeat that diverged leaves no number.
    scores[2] = Score { stable: false, e_cd: None, ..scores[2].clone() };
    let csv = written(&scores);
    assert!(csv[0].contains("\na,-,\n") && csv[0].contains("\nmean,-,"), "{}", csv[0]);
    assert!(csv[1].contains("\na,-,\nb,0.00,\n") && csv[1].contains("square,-,"), "{}", csv[1]);
    // Without repeats nothing is told of them.
    scores.retain(|s| s.made_with.nudge.is_none());
    assert!(written(&scores).iter().all(|text| !text.contains("repeats")));
}
