//! Tables of a suite.

use fnopt::eval::Format;
use fnopt::eval::suite::{CaseScore, Suite, table};
use serde_json::json;

/// Builds a score with a stretch and, if requested, a gap, both in percent.
fn score(case: &str, grid: &str, stretch: f64, gap: Option<f64>) -> CaseScore {
    let settings = json!({ "gap": gap.is_some() });
    let made_with = json!({
        "version": "0", "truth": null, "settings": settings, "device": "cpu", "kind": "cpu", "weights": null,
    });
    serde_json::from_value(json!({
        "case": case, "grid": grid, "iterations": 10, "finite": true, "stretch_largest": stretch / 100.0,
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
    // A non-finite gap counts as larger than any other. The summary has a gap only if all cases have one.
    let diverged = case("d", 5.0, Some(f64::INFINITY));
    assert_eq!(
        last(&[&three[..], std::slice::from_ref(&diverged)].concat()),
        "all 4 12x12 10 3 of 4 70.0 5.50 2.0"
    );
    assert_eq!(last(&[three[0].clone(), diverged]), "all 2 12x12 10 2 of 2 5.0 - 2.0");
    assert_eq!(last(&[three[0].clone(), case("d", 5.0, None)]), "all 2 12x12 10 2 of 2 5.0  2.0");
}
