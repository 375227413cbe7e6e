//! `fnopt evaluate` and `fnopt fit-material`: options, materials, output files, and other systems.

use super::command::{done, evaluate, json, quiet, refused, scores, shipped};
use serde_json::Value;
use std::process::Stdio;

/// Each grid has a chart. Two charts fit in a row, so three grids need two rows.
#[test]
fn the_convergence_is_drawn_on_each_grid() {
    let folder = tempfile::tempdir().unwrap();
    let height = |grids: &str, plots: &str| {
        done(evaluate(
            folder.path(),
            &["--device", "cpu", "--solver", "gd:1", "--grid", grids, "--plots", plots],
        ));
        let png = std::fs::read(folder.path().join(plots).join("convergence.png")).unwrap();
        u32::from_be_bytes(png[20..24].try_into().unwrap())
    };
    assert_eq!(height("8,9,10", "three"), 2 * height("8", "one"));
}

/// Writing tables to a pipe used to replace the pipe with a file, if permissions allowed that.
#[cfg(target_os = "linux")]
#[test]
fn tables_go_into_a_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let short = ["--device", "cpu", "--solver", "gd:1", "--grid", "8"];
    let (printed, _) = done(evaluate(folder.path(), &[&short[..], &["--csv", "/dev/stdout"]].concat()));
    let csv = printed.find("table,row,column,value").expect("tables as CSV");
    let plain = printed.find("sequence  ").expect("tables for people");
    assert!(csv < plain, "{printed}");
}

/// Two outputs with the same name used to overwrite each other, so that only the last survived.
#[test]
fn files_of_one_name_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = evaluate(folder.path(), &["--solver", "gd:1", "--csv", "all", "--json", "all"]);
    refused(output, &["a file for each of --json, --csv and --markdown", "all twice"]);
    // However it is spelt.
    let output = evaluate(folder.path(), &["--solver", "gd:1", "--csv", "all", "--markdown", "./all"]);
    refused(output, &["a file for each of --json, --csv and --markdown", "all twice"]);
    assert!(!folder.path().join("all").exists());
}

/// Newton's method has no iteration count, but specifying one is not an error.
#[test]
fn numbers_of_iterations_are_columns_and_curves() {
    let folder = tempfile::tempdir().unwrap();
    let solvers = ["--device", "cpu", "--grid", "8", "--solver", "newton:3,gd:7,lbfgs"];
    let more = ["--iterations", "2,4", "--json", "--plots", "p"];
    let (printed, _) = done(evaluate(folder.path(), &[&solvers[..], &more].concat()));
    let scores: Value = serde_json::from_str(&printed).expect("standard output is the scores and no more");
    let column =
        |score: &Value| (score["solver"].as_str().unwrap().to_owned(), score["iterations"].as_u64().unwrap());
    let mut columns: Vec<_> = scores.as_array().unwrap().iter().map(column).collect();
    columns.sort();
    let expected = [("gd", 7), ("lbfgs", 2), ("lbfgs", 4), ("newton", 0)].map(|(s, n)| (s.to_owned(), n));
    assert_eq!(columns, expected);
    // One row per grid: the errors, and next to them the times.
    let more = ["--iterations", "2,4", "--grid", "8,9", "--plots", "two"];
    done(evaluate(folder.path(), &[&["--device", "cpu", "--solver", "lbfgs"], &more[..]].concat()));
    let height = |plots: &str| {
        let png = std::fs::read(folder.path().join(plots).join("iterations.png")).unwrap();
        u32::from_be_bytes(png[20..24].try_into().unwrap())
    };
    assert_eq!(height("two"), 2 * height("p"));
}

#[test]
fn a_material_reads_as_in_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let write = |name: &str, content: &str| std::fs::write(at.join(name), content).unwrap();
    write(
        "moduli.json",
        r#"{"material": {"stretch_modulus": 300, "shear_modulus": 20, "bending_stiffness": 1e-5}}"#,
    );
    write("mixed.json", r#"{"material": {"stretch_modulus": 300, "shear": 2}}"#);
    write("none.json", r#"{"units": "grid units"}"#);
    write("air.json", r#"{"material": {"bend": 0.1}, "wind": {"density": 2}, "fitted_to": "something"}"#);
    let with = |material: &str, more: &[&str]| {
        evaluate(
            at,
            &[&["--grid", "8", "--solver", "gd:2", "--json", "s.json", "--material", material], more]
                .concat(),
        )
    };
    done(with("moduli.json", &[]));
    assert_eq!(json(&at.join("s.json"))[0]["made_with"]["settings"]["material"]["stretch_modulus"], 300.0);
    done(with("air.json", &[]));
    let settings = json(&at.join("s.json"))[0]["made_with"]["settings"].clone();
    assert_eq!((&settings["density"], &settings["drag"]), (&2.0.into(), &Value::Null));
    assert_eq!(
        (&settings["material"]["bend"], &settings["material"]["stretch"]),
        (&0.1.into(), &1000.0.into())
    );
    done(with("air.json", &["--wind", "3"]));
    assert_eq!(json(&at.join("s.json"))[0]["made_with"]["settings"]["density"], 3.0);
    refused(with("1000,x,8,0.5", &[]), &["--material", "three numbers"]);
    refused(with("mixed.json", &[]), &["mixed.json", "material.shear", "not both"]);
    refused(with("none.json", &[]), &["none.json", "material"]);
    write("windy.json", r#"{"material": {"bend": 0.1}, "wind": {"velocity": [1, 0, 0]}}"#);
    refused(with("windy.json", &[]), &["windy.json", "wind.velocity"]);
    write("misspelt.json", r#"{"material": {"bend": 0.1}, "wnd": {"density": 2}}"#);
    refused(with("misspelt.json", &[]), &["misspelt.json", "wnd", "did you mean wind?"]);
    refused(evaluate(at, &["--wind=-1"]), &["--air-density", "density"]);
}

/// Everything is checked before anything is simulated.
#[test]
fn what_would_never_end_or_cannot_be_written_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let of = |more: &[&str]| evaluate(folder.path(), &[&["--grid", "8", "--out", "scores"], more].concat());
    refused(of(&["--solver", "gd:18446744073709551615"]), &["--solver", "gd", "1 to 100000"]);
    let truth = shipped();
    let many = ["evaluate", "--ground-truth", truth.to_str().unwrap(), "--points", "1000000000000"];
    refused(quiet(folder.path(), &many).output().unwrap(), &["--points", "10000000"]);
    std::fs::create_dir(folder.path().join("tables.csv")).unwrap();
    std::fs::write(folder.path().join("taken"), "").unwrap();
    // The recorded sheet is square.
    refused(of(&["--grid", "48x32"]), &["xy_v2", "grid", "48x48", "found 48x32"]);
    refused(of(&["--csv", "tables.csv"]), &["tables.csv", "a folder"]);
    refused(evaluate(folder.path(), &["--out", "taken/scores"]), &["taken", "cannot create"]);
    assert!(scores(&folder.path().join("scores")).is_empty());
}

#[test]
fn what_would_be_ignored_or_spoil_the_scores_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let needless = ["--solver", "gd:1", "--checkpoint", "missing.safetensors"];
    refused(evaluate(at, &needless), &["--checkpoint", "a solver that has weights", "missing.safetensors"]);
    let among = ["--solver", "gd:1", "--grid", "8", "--json", "out/evaluate/all.json"];
    refused(evaluate(at, &among), &["--json", "outside the folders of scores"]);
    let mut task = quiet(at, &["evaluate", "--suite", "motions"]);
    task.env("SLURM_ARRAY_TASK_ID", "1").env("SLURM_ARRAY_TASK_COUNT", "4");
    refused(task.output().unwrap(), &["--suite", "cannot be split", "4 of them"]);
}

#[test]
fn a_fit_writes_a_material_that_an_evaluation_reads() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let truth = shipped();
    let fit = |more: &[&str]| {
        let few = [
            "--frames",
            "3",
            "--points",
            "100",
            "--grid",
            "8",
            "8",
            "--ground-truth",
            truth.to_str().unwrap(),
        ];
        quiet(at, &[&["fit-material"], &few[..], more].concat()).output().unwrap()
    };
    let ranges =
        ["--stretch", "100,400", "--shear", "5", "--bend", "0.1", "--density", "1,2", "--levels", "2"];
    let (printed, _) = done(fit(&[&ranges[..], &["--rounds", "0"]].concat()));
    assert!(printed.contains("out/fit.json"), "{printed}");
    let best = json(&at.join("out/fit.json"));
    let lines = std::fs::read_to_string(at.join("out/fit.csv")).unwrap();
    let first: Vec<f64> = lines.lines().nth(2).unwrap().split(',').map(|v| v.parse().unwrap()).collect();
    // The file holds the moduli, and next to them the coefficients that were found.
    assert_eq!(best["coefficients"]["stretch"].as_f64().unwrap(), first[0]);
    assert_eq!(best["coefficients"]["grid"], "8x8");
    done(evaluate(
        at,
        &["--grid", "8", "--solver", "gd:2", "--json", "s.json", "--material", "out/fit.json"],
    ));
    let settings = json(&at.join("s.json"))[0]["made_with"]["settings"].clone();
    assert!(best["material"]["stretch_modulus"].is_number());
    assert_eq!(settings["material"], best["material"]);
    assert_eq!((settings["density"].as_f64(), &settings["drag"]), (Some(first[3]), &Value::Null));
    // A search of a worse range leaves the best set of the file, with the air that was fitted.
    let worse = ["--stretch", "5000", "--shear", "5", "--bend", "0.1", "--levels", "2", "--rounds", "0"];
    done(fit(&worse));
    assert_eq!(json(&at.join("out/fit.json")), best);
    // Any other file beside the points is kept.
    std::fs::write(at.join("scene.json"), "{}").unwrap();
    refused(fit(&[&worse[..], &["--out", "scene.csv"]].concat()), &["--out", "scene.json", "best set"]);
    assert_eq!(std::fs::read(at.join("scene.json")).unwrap(), b"{}");
    refused(fit(&["--levels", "50"]), &["levels", "at most 100000 points"]);
    // A point has the same air for all sequences, so `--density` must be given or the sequences must agree.
    for (name, density) in [("thin", "0.5"), ("thick", "1.5")] {
        let to = at.join("airs").join(name);
        std::fs::create_dir_all(&to).unwrap();
        for file in ["cloth_pos.npy", "handles.npy", "start.npy"] {
            std::fs::copy(shipped().join("xy_v2").join(file), to.join(file)).unwrap();
        }
        let mut meta = json(&shipped().join("xy_v2/meta.json"));
        meta["wind"]["density"] = density.parse::<f64>().unwrap().into();
        std::fs::write(to.join("meta.json"), meta.to_string()).unwrap();
    }
    let airs = ["fit-material", "--ground-truth", "airs", "--frames", "3", "--points", "100", "--grid", "8"];
    let refusal = quiet(at, &airs).output().unwrap();
    refused(refusal, &["thin", "density", "as in thick, or --density", "0.5"]);
    refused(fit(&["--out", "fit.json"]), &["--out", "an extension other than json"]);
}

/// A reader that reads nothing, such as `| head -0`, does not keep the files from being written.
#[test]
fn files_are_there_when_nobody_reads_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let truth = shipped();
    let few = ["--frames", "3", "--points", "100", "--grid", "8", "--solver", "gd:2", "--csv", "t.csv"];
    let arguments = [&["evaluate", "--ground-truth", truth.to_str().unwrap()], &few[..]].concat();
    let mut child = quiet(folder.path(), &arguments).stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let csv = std::fs::read_to_string(folder.path().join("t.csv")).unwrap();
    assert!(csv.contains("mean stretch") && csv.contains("inertia"), "{csv}");
}

/// Passes the ground truth itself as another system's result, in each format that can be read.
#[test]
fn other_systems_come_in_every_format() {
    use fnopt::io::{Format, Trajectory};
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let truth = fnopt::eval::Sequence::load(&shipped(), "xy_v2").unwrap().truth;
    let mut few = Trajectory::new(truth.grid(), truth.fps());
    (0..4).for_each(|f| few.push(truth.frame(f), truth.frame_velocities(f)));
    let mut arguments = vec!["--json", "--solver", "gd:1", "--grid", "8"];
    let formats = [("a", Format::Npz), ("b", Format::Npy), ("c", Format::Pc2), ("d", Format::Obj)];
    for (name, format) in formats {
        let written = few.write(at.join(name), "xy_v2", format).unwrap();
        if format == Format::Obj {
            std::fs::rename(written, at.join("d/xy_v2")).unwrap();
        }
    }
    for named in ["a=a", "b=b", "c=c", "d=d"] {
        arguments.extend(["--compare", named]);
    }
    let scores: Vec<Value> = serde_json::from_str(&done(evaluate(at, &arguments)).0).unwrap();
    let exact = scores.iter().filter(|score| score["e_3d"] == 0.0);
    let mut names: Vec<&str> = exact.map(|score| score["solver"].as_str().unwrap()).collect();
    names.sort_unstable();
    assert_eq!(names, ["a", "b", "c", "d"], "{scores:?}");
    refused(evaluate(at, &["--compare", "a=a", "--compare", "a=b"]), &["--compare", "no other column"]);
    refused(evaluate(at, &["--compare", "a"]), &["--compare", "NAME=DIR"]);
}

#[test]
fn lists_may_have_spaces() {
    let folder = tempfile::tempdir().unwrap();
    let lists = ["--grid", "8, 9", "--solver", " gd, lbfgs", "--iterations", "2, 3", "--sequences", "xy_v2 "];
    let (printed, _) = done(evaluate(folder.path(), &[&lists[..], &["--device", "cpu", "--json"]].concat()));
    assert_eq!(serde_json::from_str::<Vec<serde_json::Value>>(&printed).unwrap().len(), 8);
}

/// A disk that is full after the work.
#[cfg(target_os = "linux")]
#[test]
fn a_table_that_cannot_be_written_keeps_no_other_from_being_written() {
    let folder = tempfile::tempdir().unwrap();
    let few = ["--grid", "8", "--solver", "gd:2", "--device", "cpu"];
    let files = ["--json", "/dev/full", "--csv", "/dev/full", "--markdown", "t.md"];
    let of_full_disks = evaluate(folder.path(), &[&few[..], &["--json", "/dev/full"], &files[4..]].concat());
    refused(of_full_disks, &["/dev/full: cannot write"]);
    assert!(std::fs::read_to_string(folder.path().join("t.md")).unwrap().contains("| xy_v2 |"));
    // One file for two tables is noticed before.
    refused(evaluate(folder.path(), &[&few[..], &files].concat()), &["a file for each of"]);
}
