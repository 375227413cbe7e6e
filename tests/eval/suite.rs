//! Tables of a suite.

use fnopt::cloth::{Grid, Material};
use fnopt::eval::suite::{CaseScore, Suite, table};
use fnopt::eval::{Format, Verdict};
use fnopt::scene::{BuiltIn, Motion, Start, Stiffness};
use serde_json::json;

/// Builds a score with a stretch and, if requested, a gap, both in percent.
fn score(case: &str, grid: &str, stretch: f64, gap: Option<f64>) -> CaseScore {
    let settings = json!({ "gap": gap.is_some() });
    let made_with = json!({
        "version": "0", "truth_crc32": null, "settings": settings, "device": "cpu", "kind": "cpu", "weights_crc32": null,
    });
    serde_json::from_value(json!({
        "case": case, "grid": grid, "iterations": 10, "stable": true,
        "stretch_largest_free": stretch / 100.0, "stretch_largest": stretch / 100.0,
        "gap": gap.filter(|gap| gap.is_finite()).map(|gap| gap / 100.0), "ms_per_frame": 2.0, "made_with": made_with,
    }))
    .unwrap()
}

fn rows(scores: &[CaseScore]) -> Vec<Vec<String>> {
    let csv = table("fnopt", Suite::Motions, scores).write(Format::Csv);
    csv.lines()
        .map(|line| line.split(',').map(str::to_owned).collect())
        .filter(|row: &Vec<_>| row.len() > 1)
        .collect()
}

#[test]
fn cases_of_a_grid_are_summed_up_in_a_row() {
    let case = |name, stretch, gap| score(name, "12x12", stretch, gap);
    let three = [case("a", 4.0, Some(1.0)), case("b", 70.0, Some(9.0)), case("c", 5.0, Some(2.0))];
    let one = score("a", "13x12", 6.0, Some(3.0));
    let last = |scores: &[CaseScore]| rows(scores).pop().unwrap().join(" ");
    // The only case on its grid has no summary row.
    let all = [&three[..], &[one]].concat();
    assert_eq!((rows(&all).len(), last(&all)), (1 + 4 + 1, "all 3 12x12 10 2 of 3 70.0 2.00 2.0".to_owned()));
    assert_eq!(last(&three[..1]), "a 12x12 10 yes 4.0 1.00 2.0");
    // A rollout that is not finite is not sound, however small its last stretch.
    let exploded = CaseScore { stable: false, ..case("e", 5.0, Some(2.0)) };
    assert!(!exploded.sound() && three[0].sound() && !three[1].sound());
    let found = rows(&[three[0].clone(), three[2].clone(), exploded]);
    assert_eq!(found[3][2..4], ["10".to_owned(), "diverged".to_owned()]);
    assert!(found[4].join(" ").contains("2 of 3"), "{found:?}");
    // One that left the numbers has no largest stretch, and so has its grid.
    let verdict = Verdict { stretch_largest_free: None, ..Verdict::default() };
    let burst = CaseScore { stable: false, verdict, ..case("n", 5.0, None) };
    // Nor is one that stays far from its minimum, or in which newton did not converge.
    let far = Verdict { gap_estimate: Some(0.9), ..three[0].verdict };
    let far = CaseScore { verdict: far, ..three[0].clone() };
    assert!(!far.sound() && last(std::slice::from_ref(&far)).contains("far from minimum"));
    let missed = Verdict { unconverged: Some([2, 7]), ..three[0].verdict };
    assert!(missed.faults()[0].to_string().contains("2 frames, first in frame 7"));
    assert!(!burst.sound());
    assert_eq!(last(std::slice::from_ref(&burst)), "n 12x12 10 diverged -  2.0");
    assert_eq!(last(&[three[0].clone(), burst]), "all 2 12x12 10 1 of 2 -  2.0");
    // A non-finite gap counts as larger than any other. The summary has a gap only if all cases have one.
    let diverged = case("d", 5.0, Some(f64::INFINITY));
    assert_eq!(
        last(&[&three[..], std::slice::from_ref(&diverged)].concat()),
        "all 4 12x12 10 3 of 4 70.0 5.50 2.0"
    );
    assert_eq!(last(&[three[0].clone(), diverged]), "all 2 12x12 10 2 of 2 5.0 - 2.0");
    assert_eq!(last(&[three[0].clone(), case("d", 5.0, None)]), "all 2 12x12 10 2 of 2 5.0  2.0");
}

/// What a case is called is what it is.
#[test]
fn cases_are_what_they_are_called() {
    let grid = Grid { h: 32, w: 32 };
    let case = |suite: Suite, name: &str| {
        let cases = suite.cases(grid).unwrap();
        cases.into_iter().find(|case| case.name == name).unwrap_or_else(|| panic!("no case {name}"))
    };
    let frames = |name: &str| case(Suite::Speeds, name).scene.setup().unwrap().frames();
    // 391 frames hold 390 steps.
    assert_eq!([frames("speed 1"), frames("speed 2"), frames("speed 1.5")], [391, 196, 261]);
    let soft = case(Suite::Materials, "stretch 300 bend 0.1").scene.stiffness;
    assert_eq!(soft, Stiffness::Grid(Material { stretch: 300.0, shear: 8.0, bend: 0.1, ..Material::PAPER }));
    let start = |name: &str| case(Suite::Handles, name).scene.start;
    assert!(matches!(start("corners flat"), Start::Flat) && matches!(start("corners drape"), Start::Settled));
    let motion = |name: &str| case(Suite::Motions, name).scene.motion;
    for name in ["xyz_v4_opp", "rot_h1"] {
        assert_eq!(motion(name), Motion::BuiltIn(BuiltIn::named(name).unwrap()));
    }
    let wide = case(Suite::Grids, "32x100").scene.setup().unwrap();
    assert_eq!(wide.model.grid, Grid { h: 32, w: 100 });
    assert_eq!(case(Suite::Iterations, "15 iterations").iterations, Some(15));
    assert!(case(Suite::Repulsion, "corner-center with").scene.repulsion.is_some());
    assert!(case(Suite::Repulsion, "corner-center without").scene.repulsion.is_none());

    // Scenes keep their proportions; those with events are none, since converged frames are of a cloth that stays as it is.
    let flag = case(Suite::Scenes, "flag").scene;
    assert_eq!((flag.grid, flag.bodies.len()), (Grid { h: 32, w: 24 }, 1));
    let scenes = Suite::Scenes.cases(Grid { h: 32, w: 32 }).unwrap();
    assert!(scenes.len() > 5 && scenes.iter().all(|case| case.name != "twist"));
}
