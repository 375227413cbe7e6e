//! `fnopt evaluate --suite`.

use super::command::{done, fnopt, json, quiet, refused, text};
use serde_json::Value;

#[test]
fn a_suite_fails_when_a_case_is_not_sound() {
    let folder = tempfile::tempdir().unwrap();
    let suite = |solver: &str| {
        let arguments = ["--suite", "handles", "--sequences", "corners flat", "--grid", "12", "--no-gap"];
        fnopt(folder.path(), &[&["evaluate", "--frames", "30", "--solver", solver], &arguments[..]].concat())
    };
    let good = suite("newton");
    assert_eq!(good.status.code(), Some(0), "{}", text(&good.stderr));
    let picture = folder.path().join("out/evaluate/newton_1_12x12_corners_flat.png");
    assert!(picture.is_file());
    assert_eq!(suite("interpolation").status.code(), Some(2));
    // Two iteration counts give two tables.
    let both = suite("lbfgs:50,lbfgs:100");
    let rows = text(&both.stdout).lines().filter(|line| line.starts_with("corners flat")).count();
    assert_eq!(rows, 2, "{}", text(&both.stdout));
    // A step of gradient descent hardly acts.
    let bad = suite("gd:1");
    assert_eq!(bad.status.code(), Some(1), "{}", text(&bad.stdout));
}

#[test]
fn a_suite_honours_its_options_or_refuses_them() {
    let folder = tempfile::tempdir().unwrap();
    let suite = |name: &str, more: &[&str]| {
        let few = ["--frames", "40", "--no-gap", "--device", "cpu", "--json", "s.json"];
        let solver = if more.contains(&"--solver") { vec![] } else { vec!["--solver", "lbfgs:2"] };
        quiet(folder.path(), &[&["evaluate", "--suite", name], &few[..], &solver, more].concat())
            .output()
            .unwrap()
    };
    // Returns the scores of this run. Those of an earlier one are removed first.
    let scores = |name: &str, more: &[&str]| {
        let file = folder.path().join("s.json");
        let _ = std::fs::remove_file(&file);
        let output = suite(name, more);
        assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
        json(&file).as_array().unwrap().clone()
    };
    let largest = |more: &[&str]| {
        let scores = scores("speeds", &[&["--sequences", "speed 1", "--grid", "12"], more].concat());
        assert_eq!(scores[0]["case"], "speed 1");
        scores[0]["stretch_largest_free"].as_f64().unwrap()
    };
    let usual = largest(&[]);
    let paper = largest(&["--material", "1000,8,0.5"]);
    assert_eq!(paper, largest(&["--material", "paper"]));
    assert_ne!(usual, largest(&["--material", "10,8,0.5"]));
    assert_ne!(usual, largest(&["--wind", "50"]));
    // One that leaves the numbers has no stretch, and the verdict is in the file.
    let few = ["--sequences", "speed 1", "--grid", "12", "--solver", "lbfgs:100"];
    assert_eq!(scores("speeds", &few)[0]["sound"], true);
    let wild = ["--material", "1e9,8,0.5", "--sequences", "speed 1", "--grid", "12", "--solver", "gd:300"];
    let wild = &scores("speeds", &wild)[0];
    assert_eq!((&wild["stable"], &wild["sound"]), (&false.into(), &false.into()), "{wild}");
    assert!(wild["stretch_largest_free"].is_null(), "{wild}");
    // The suite `grids` has its own grids, and runs each once.
    let of_grids = scores("grids", &["--sequences", "48x32"]);
    assert_eq!((of_grids.len(), &of_grids[0]["grid"]), (1, &"48x32".into()));
    let five = ["--sequences", "5 iterations", "--grid", "12", "--solver", "lbfgs,lbfgs"];
    let of_five = scores("iterations", &five);
    assert_eq!((of_five.len(), &of_five[0]["iterations"]), (1, &5.into()));
    refused(suite("grids", &["--grid", "32,64"]), &["--grid", "has its own"]);
    refused(suite("iterations", &["--solver", "interpolation"]), &["--solver", "interpolation"]);
    refused(suite("iterations", &["--solver", "lbfgs:0"]), &["--solver", "lbfgs", "1 to 100000"]);
    refused(suite("iterations", &["--iterations", "3,x"]), &["--iterations", "x"]);
    // There are the cases of the numbers that were given.
    let other = ["--sequences", "5 iterations", "--iterations", "3,4"];
    refused(
        suite("iterations", &[&other[..], &["--solver", "lbfgs"]].concat()),
        &["--sequences", "5 iterations", "4 iterations"],
    );
    refused(suite("speeds", &["--plots", "p"]), &["--plots", "other than iterations"]);
    refused(suite("iterations", &["--plots", "p"]), &["--plots", "--no-gap"]);
    assert!(!folder.path().join("p").exists());
    refused(suite("materials", &["--material", "1,2,3"]), &["--material", "which has its own"]);
    refused(suite("speeds", &["--points", "3"]), &["cannot be used with", "--points"]);
    refused(suite("speeds", &["--ground-truth", "."]), &["cannot be used with", "--ground-truth"]);
}

/// Without repulsion, a sheet that folds on a single handle intersects itself.
#[test]
fn repulsion_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let cases = "single-mid-edge without,single-mid-edge with";
    // The sheet begins to meet itself in about frame 74.
    let few = ["--sequences", cases, "--frames", "100", "--grid", "16"];
    let rest = ["--solver", "fnopt-paper", "--device", "cpu", "--json", "s.json"];
    let arguments = [&["evaluate", "--suite", "repulsion"], &few[..], &rest].concat();
    let (printed, _) = done(quiet(folder.path(), &arguments).output().unwrap());
    assert!(["repulsion", "share > 0.1", "share > 0.02"].iter().all(|c| printed.contains(c)), "{printed}");
    let scores = json(&folder.path().join("s.json"));
    let figure = |k: usize, name: &str| scores[k][name].clone();
    let [without, with] = [0, 1].map(|k| figure(k, "repulsion")[0].as_f64().unwrap());
    assert!(without > 1.0 && with < 0.01 * without, "{without} without, {with} with");
    assert!(figure(0, "gap").is_number() && figure(1, "gap").is_number());
    let row = |name: &str| printed.lines().find(|line| line.starts_with(name)).unwrap().to_owned();
    assert!(!row("single-mid-edge with ").contains(" - "), "{printed}");
    // All default solvers run the cases, Newton's method too.
    let few = ["--frames", "2", "--grid", "8", "--no-gap", "--device", "cpu", "--json", "all.json"];
    let output = fnopt(folder.path(), &[&["evaluate", "--suite", "repulsion"], &few[..]].concat());
    // On a grid this coarse not all cases are sound.
    assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
    let scores = json(&folder.path().join("all.json"));
    let of = |case: &str| scores.as_array().unwrap().iter().filter(|s| s["case"] == case).count();
    assert_eq!((of("corner-center without"), of("corner-center with")), (6, 6));
    // Without `--solver`, the suite `iterations` takes the solvers that have an iteration count.
    let few = ["--frames", "2", "--grid", "12", "--sequences", "3 iterations", "--no-gap", "--device", "cpu"];
    let output = fnopt(folder.path(), &[&["evaluate", "--suite", "iterations", "--json"], &few[..]].concat());
    assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
    let scores: Value = serde_json::from_slice(&output.stdout).unwrap();
    let solvers: Vec<_> = scores.as_array().unwrap().iter().map(|s| s["solver"].as_str().unwrap()).collect();
    assert_eq!(solvers, ["fnopt", "spectral", "quasi-newton", "lbfgs", "adam"]);
    // If no case has repulsion, the tables do not mention it.
    let speeds = ["--suite", "speeds", "--grid", "8", "--frames", "3", "--solver", "gd:1", "--no-gap"];
    let (printed, _) = done(quiet(folder.path(), &[&["evaluate"], &speeds[..]].concat()).output().unwrap());
    assert!(!printed.contains("repulsion"), "{printed}");
}

#[test]
fn cases_of_a_suite_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let suite = |more: &[&str]| -> Vec<Value> {
        let few = ["--sequences", "speed 1,speed 2", "--grid", "12", "--solver", "lbfgs:2,gd:2"];
        let rest = ["--device", "cpu", "--json", "s.json"];
        let arguments = [&["evaluate", "--suite", "speeds"], &few[..], &rest, more].concat();
        done(quiet(at, &arguments).output().unwrap());
        json(&at.join("s.json")).as_array().unwrap().clone()
    };
    let usual = ["--frames", "3"];
    let first = suite(&usual);
    // The times would differ if anything were simulated again.
    assert_eq!((first.len(), suite(&usual)), (4, first.clone()));
    // A score that is damaged or lacks its picture is computed again; the other two are reused.
    let [png, kept] = ["gd_2_12x12_speed_1.png", "cases/lbfgs_2_12x12_speed_1.json"].map(|file| {
        let path = at.join("out/evaluate").join(file);
        assert!(path.is_file(), "{file}");
        path
    });
    std::fs::write(&kept, "{").unwrap();
    std::fs::remove_file(&png).unwrap();
    assert_eq!(suite(&usual)[2..], first[2..]);
    assert!(png.is_file() && json(&kept)["case"] == "speed 1");
    // Everything that a score depends on is compared.
    for other in [&["--material", "10,8,0.5"], &["--wind", "50"], &["--frames", "4"]] {
        let others =
            suite(&if other[0] == "--frames" { other.to_vec() } else { [&usual[..], other].concat() });
        assert!(others.iter().zip(&first).all(|(other, first)| other["made_with"] != first["made_with"]));
    }
    assert_eq!(suite(&usual)[0]["stretch_largest_free"], first[0]["stretch_largest_free"]);
    // A score without the gap is not taken for one with it.
    let without = suite(&[&usual[..], &["--no-gap"]].concat());
    assert!(
        without[0]["gap"].is_null()
            && suite(&usual)[0]["gap"] == first[0]["gap"]
            && first[0]["gap"].is_number()
    );
}

/// Every number of iterations is a point, with a gap and a time, of the tables and of the plot.
#[test]
fn gaps_are_compared_at_equal_time() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let suite = |more: &[&str]| {
        let few = ["--suite", "iterations", "--frames", "45", "--device", "cpu", "--iterations", "2,30"];
        let solvers = ["--solver", "newton,lbfgs,gd:4,lbfgs:4,lbfgs", "--json", "s.json"];
        let output = fnopt(at, &[&["evaluate"], &few[..], &solvers, more].concat());
        // On a grid this coarse not all cases are sound.
        assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
        (text(&output.stdout), json(&at.join("s.json")).as_array().unwrap().clone())
    };
    let (printed, first) = suite(&["--grid", "8", "--plots", "p"]);
    let name = |score: &Value| format!("{} {}", score["solver"].as_str().unwrap(), score["iterations"]);
    let names: Vec<String> = first.iter().map(name).collect();
    assert_eq!(names, ["lbfgs 2", "gd 4", "lbfgs 4", "lbfgs 30", "newton 0"]);
    let figure = |score: &Value, of: &str| score[of].as_f64().unwrap();
    assert!(first.iter().all(|score| figure(score, "gap_ms_per_frame") > 0.0), "{first:?}");
    assert!(figure(&first[0], "gap") > figure(&first[3], "gap") && figure(&first[4], "gap").abs() < 1e-3);
    // One table for each solver, with all its numbers, then those of all solvers.
    let titles = ["newton", "lbfgs", "gd", "8x8: energy gap and time of a frame alone"];
    let places = titles.map(|title| printed.lines().position(|line| line == title));
    assert!(places.iter().all(Option::is_some) && places.is_sorted(), "{places:?} in {printed}");
    assert_eq!(printed.lines().filter(|line| line.starts_with("lbfgs, N = ")).count(), 3, "{printed}");
    let size = || {
        let png = std::fs::read(at.join("p/gap_ms.png")).unwrap();
        [16, 20].map(|k| u32::from_be_bytes(png[k..k + 4].try_into().unwrap()))
    };
    let alone = size();
    // The times would differ if anything were simulated again. Two grids have a chart each.
    let (_, both) = suite(&["--grid", "8,9", "--plots", "p"]);
    assert_eq!((both.len(), &both[..5], size()), (10, &first[..], [2 * alone[0], alone[1]]));
    // A score of an earlier version, whose gap has no time, is computed again.
    let kept = at.join("out/evaluate/cases/lbfgs_4_8x8_4_iterations.json");
    let mut untimed = json(&kept);
    untimed.as_object_mut().unwrap().remove("gap_ms_per_frame").unwrap();
    std::fs::write(&kept, untimed.to_string()).unwrap();
    let (_, again) = suite(&["--grid", "8"]);
    assert!(figure(&again[2], "gap_ms_per_frame") > 0.0);
    assert_eq!((&again[..2], &again[2]["gap"]), (&first[..2], &first[2]["gap"]));
    // Without gaps there is nothing to compare.
    let (printed, without) = suite(&["--grid", "8", "--no-gap"]);
    assert!(without.iter().all(|score| score["gap_ms_per_frame"].is_null()));
    assert!(!printed.contains("at equal time") && !printed.contains("alone"), "{printed}");
}
