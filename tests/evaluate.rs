//! `fnopt evaluate` and `fnopt fit-material` as a script meets them: devices, scores that are used again or put together,
//! materials, files, and how they end early.

mod command;

use command::text;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = command::command(folder, arguments);
    command.env("FNOPT_LOG", "off");
    command
}

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/ground_truth")
}

/// A few frames of the shipped sequence on a small grid.
fn evaluate(folder: &Path, more: &[&str]) -> Output {
    let truth = shipped();
    let few = ["--frames", "4", "--points", "100", "--ground-truth", truth.to_str().unwrap()];
    command(folder, &[&["evaluate"], &few[..], more].concat()).output().unwrap()
}

fn done(output: Output) -> (String, String) {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    (text(&output.stdout), text(&output.stderr))
}

fn refused(output: Output, said: &[&str]) {
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    said.iter().for_each(|part| assert!(message.contains(part), "no '{part}' in: {message}"));
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The files of scores in a folder.
fn scores(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|e| e == "json")).collect()
}

/// On the software adapter that the tests need anyway.
#[test]
fn solvers_that_only_the_cpu_has_run_there() {
    let folder = tempfile::tempdir().unwrap();
    let gpu = ["--adapter", "llvmpipe", "--grid", "8", "--solver", "newton,quasi-newton-exact:2,gd:2"];
    let (_, log) = done(evaluate(folder.path(), &[&gpu[..], &["--json", "s.json", "--plots", "p"]].concat()));
    assert!(log.contains("on the CPU, as no other device has them: newton, quasi-newton-exact"), "{log}");
    assert!(folder.path().join("p/convergence.png").is_file());
    let scores = json(&folder.path().join("s.json"));
    let made_with = |k: usize, field: &str| scores[k]["made_with"][field].as_str().unwrap().to_owned();
    for (k, device, kind) in [(0, "cpu", "cpu"), (1, "cpu", "cpu"), (2, "llvmpipe", "gpu")] {
        assert!(made_with(k, "device").contains(device), "{scores}");
        assert_eq!(made_with(k, "kind"), kind);
    }
    let suite = [
        "evaluate",
        "--suite",
        "handles",
        "--sequences",
        "corners drape",
        "--frames",
        "3",
        "--json",
        "s.json",
    ];
    done(command(folder.path(), &[&suite[..], &gpu].concat()).output().unwrap());
    let scores = json(&folder.path().join("s.json"));
    assert!(scores[0]["score"]["made_with"]["device"].as_str().unwrap().starts_with("cpu"), "{scores}");
}

#[test]
fn scores_are_those_of_the_files_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let to = at.join("truth/xy_v2");
    std::fs::create_dir_all(&to).unwrap();
    for file in ["cloth_pos.npy", "handles.npy", "start.npy", "meta.json"] {
        std::fs::copy(shipped().join("xy_v2").join(file), to.join(file)).unwrap();
    }
    let run = || {
        let arguments = ["--frames", "4", "--points", "100", "--ground-truth", "truth", "--grid", "8"];
        let solver = ["--solver", "gd:3,lbfgs:3"];
        command(at, &[&["evaluate"], &arguments[..], &solver].concat()).output().unwrap()
    };
    let (first, _) = done(run());
    assert_eq!(done(run()).0, first);
    let meta = std::fs::read_to_string(to.join("meta.json")).unwrap();
    std::fs::write(to.join("meta.json"), meta.replace("0.187", "0.5")).unwrap();
    assert_ne!(done(run()).0, first);
    assert_eq!(scores(&at.join("out/evaluate")).len(), 4);
    // One that cannot be read is told, after what is finished.
    let damaged =
        scores(&at.join("out/evaluate")).into_iter().filter(|f| f.to_string_lossy().contains("lbfgs"));
    damaged.for_each(|file| std::fs::write(file, "{").unwrap());
    let failed = run();
    assert!(text(&failed.stdout).contains("8x8 gd, N = 3"), "{}", text(&failed.stdout));
    refused(failed, &["lbfgs", "one that was kept"]);
}

#[test]
fn repeats_are_kept_and_merged_as_other_scores_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = |more: &[&str]| {
        let few = ["--grid", "8", "--solver", "gd:3,lbfgs:3", "--device", "cpu", "--json", "s.json"];
        evaluate(at, &[&few[..], more].concat())
    };
    let told = || json(&at.join("s.json")).as_array().unwrap().clone();
    done(run(&[]));
    let once = told();
    assert!(once.iter().all(|score| score.get("over_repeats").is_none()));
    let (repeated, _) = done(run(&["--repeats", "3"]));
    assert!(repeated.contains("means over repeats") && repeated.contains("± repeats"), "{repeated}");
    let all = told();
    assert_eq!((all.len(), scores(&at.join("out/evaluate")).len()), (6, 6));
    for (k, first) in once.iter().enumerate() {
        // Its time too: it was not simulated again.
        assert_eq!(
            (&all[k]["per_frame"], &all[k]["ms_per_frame"]),
            (&first["per_frame"], &first["ms_per_frame"])
        );
        let over = &all[k]["over_repeats"];
        let mean = (0..3).map(|r| all[2 * r + k]["e_cd"].as_f64().unwrap()).sum::<f64>() / 3.0;
        assert!(
            over["repeats"] == 3 && (over["e_cd"][0].as_f64().unwrap() / mean - 1.0).abs() < 1e-9,
            "{over}"
        );
        assert!(over["e_cd"][1].as_f64().unwrap() > 0.0);
    }
    let nudges: Vec<&Value> = all.iter().map(|score| &score["made_with"]["nudge"]["repeat"]).collect();
    assert_eq!(nudges, [&Value::Null, &Value::Null, &1.into(), &1.into(), &2.into(), &2.into()]);
    assert_eq!(done(run(&["--repeats", "3"])).0, repeated);
    for share in ["0/2", "1/2"] {
        done(run(&["--repeats", "3", "--shard", share, "--out", "shares"]));
    }
    assert_eq!(scores(&at.join("shares")).len(), 6);
    let merged = command(at, &["evaluate", "--merge", "shares", "--json", "s.json"]).output().unwrap();
    assert!(done(merged).0.contains("means over repeats"));
    let over: Vec<Value> =
        told().into_iter().filter_map(|mut s| s.get_mut("over_repeats").map(Value::take)).collect();
    assert!(over.len() == 2 && over.iter().all(|over| over["repeats"] == 3), "{over:?}");
    for count in ["0", "1001", "x"] {
        refused(run(&["--repeats", count]), &["--repeats", count]);
    }
    refused(
        command(at, &["evaluate", "--suite", "speeds", "--repeats", "2"]).output().unwrap(),
        &["--repeats"],
    );
    refused(
        command(at, &["evaluate", "--merge", "shares", "--repeats", "2"]).output().unwrap(),
        &["--repeats"],
    );
}

#[test]
fn only_scores_that_belong_together_are_merged() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = |out: &str, more: &[&str]| {
        done(evaluate(at, &[&["--grid", "8", "--out", out, "--device", "cpu"], more].concat()));
    };
    run("a", &["--solver", "gd:3"]);
    run("b", &["--solver", "lbfgs:3"]);
    run("soft", &["--solver", "adam:3", "--material", "100,1,0.01"]);
    run("again", &["--solver", "gd:3"]);
    let merge =
        |arguments: &[&str]| command(at, &[&["evaluate", "--merge"], arguments].concat()).output().unwrap();
    let (tables, _) = done(merge(&["a", "b", "--plots", "p"]));
    assert!(tables.contains("gd, N = 3") && tables.contains("lbfgs, N = 3"), "{tables}");
    assert!(at.join("p/per_frame.png").is_file());
    refused(merge(&["a", "soft"]), &["a/xy_v2_8x8_gd_3", "soft/xy_v2_8x8_adam_3", "settings"]);
    refused(merge(&["a", "again"]), &["a/xy_v2_8x8_gd_3", "again/xy_v2_8x8_gd_3", "the only score of"]);
    for option in [["--compare", "x=a"], ["--wind", "2"], ["--device", "cpu"], ["--solver", "gd"]] {
        refused(merge(&[&["a"], &option[..]].concat()), &["cannot be used with", option[0]]);
    }
}

/// A chart for each grid: two side by side, so that three need two rows.
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

/// Newton's method takes no number of iterations, but to be asked for one is no error.
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
    // A row for each grid: the errors, and beside them the times.
    let more = ["--iterations", "2,4", "--grid", "8,9", "--plots", "two"];
    done(evaluate(folder.path(), &[&["--device", "cpu", "--solver", "lbfgs"], &more[..]].concat()));
    let height = |plots: &str| {
        let png = std::fs::read(folder.path().join(plots).join("iterations.png")).unwrap();
        u32::from_be_bytes(png[20..24].try_into().unwrap())
    };
    assert_eq!(height("two"), 2 * height("p"));
}

/// As many as there are cores: what each of them comes to does not depend on the others.
#[test]
fn jobs_side_by_side_come_to_what_they_come_to_alone() {
    let folder = tempfile::tempdir().unwrap();
    let told = |out: &str, threads: &str, solvers: &str| {
        let more = ["--device", "cpu", "--grid", "8,12", "--solver", solvers, "--json", "--out", out];
        let truth = shipped();
        let few = ["--frames", "4", "--points", "100", "--ground-truth", truth.to_str().unwrap()];
        let mut command = command(folder.path(), &[&["evaluate"], &few[..], &more].concat());
        let (printed, _) = done(command.env("RAYON_NUM_THREADS", threads).output().unwrap());
        let scores: Vec<Value> = serde_json::from_str(&printed).unwrap();
        let figures = |s: &Value| {
            [&s["grid"], &s["solver"], &s["e_cd"], &s["energy"], &s["gradient"]].map(Value::clone)
        };
        let devices: Vec<_> =
            scores.iter().map(|s| s["made_with"]["device"].as_str().unwrap().to_owned()).collect();
        (scores.iter().map(figures).collect::<Vec<_>>(), devices)
    };
    let all = "newton,fnopt:2,lbfgs:3,adam:5";
    let (together, devices) = told("together", "3", all);
    // Eight jobs on three threads: one each.
    assert_eq!(devices, ["cpu, 1 threads"; 8]);
    assert_eq!(told("one", "1", all).0, together);
    // Two jobs on five threads: two each.
    let (alone, devices) = told("alone", "5", "fnopt:2");
    assert_eq!(devices, ["cpu, 2 threads"; 2]);
    assert!(alone.iter().all(|figures| together.contains(figures)), "{alone:?} in {together:?}");
}

#[test]
fn a_material_is_what_a_scene_takes() {
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
    refused(evaluate(at, &["--wind=-1"]), &["wind.density"]);
}

/// Before anything is simulated.
#[test]
fn what_would_never_end_or_cannot_be_written_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let of = |more: &[&str]| evaluate(folder.path(), &[&["--grid", "8", "--out", "scores"], more].concat());
    refused(of(&["--solver", "gd:18446744073709551615"]), &["--iterations", "gd", "1 to 100000"]);
    let truth = shipped();
    let many = ["evaluate", "--ground-truth", truth.to_str().unwrap(), "--points", "1000000000000"];
    refused(command(folder.path(), &many).output().unwrap(), &["--points", "10000000"]);
    std::fs::create_dir(folder.path().join("tables.csv")).unwrap();
    std::fs::write(folder.path().join("taken"), "").unwrap();
    // The sheet that was recorded is square.
    refused(of(&["--grid", "48x32"]), &["xy_v2", "grid", "48x48", "found 48x32"]);
    refused(of(&["--csv", "tables.csv"]), &["tables.csv", "a folder"]);
    refused(evaluate(folder.path(), &["--out", "taken/scores"]), &["taken", "cannot create"]);
    assert!(scores(&folder.path().join("scores")).is_empty());
}

/// Arrays of Slurm may begin anywhere and count in steps.
#[test]
fn a_task_of_an_array_does_its_share_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let array = |id: &str, count: &str| {
        let truth = shipped();
        let few = ["--grid", "8", "--solver", "gd:1,gd:2,gd:3", "--frames", "3", "--device", "cpu"];
        let whose = ["evaluate", "--ground-truth", truth.to_str().unwrap()];
        let mut command = command(folder.path(), &[&whose[..], &few].concat());
        let of_slurm = [("ID", id), ("MIN", "1"), ("STEP", "2"), ("COUNT", count)];
        command.envs(of_slurm.map(|(name, value)| (format!("SLURM_ARRAY_TASK_{name}"), value)));
        command.output().unwrap()
    };
    for (id, share) in [("1", 0), ("3", 1), ("5", 2)] {
        let output = array(id, "3");
        let told = text(&output.stderr);
        done(output);
        assert!(told.contains(&format!("share {share} of 3")), "{told}");
        assert_eq!(scores(&folder.path().join("out/evaluate")).len(), share + 1);
    }
    refused(array("7", "3"), &["SLURM_ARRAY_TASK_ID", "0 to 2"]);
}

#[test]
fn a_suite_honours_its_options_or_refuses_them() {
    let folder = tempfile::tempdir().unwrap();
    let suite = |name: &str, more: &[&str]| {
        let few = ["--frames", "3", "--no-gap", "--solver", "lbfgs:2", "--device", "cpu", "--json", "s.json"];
        command(folder.path(), &[&["evaluate", "--suite", name], &few[..], more].concat()).output().unwrap()
    };
    // The scores, which are of this run and of no other.
    let scores = |name: &str, more: &[&str]| {
        let file = folder.path().join("s.json");
        let _ = std::fs::remove_file(&file);
        let output = suite(name, more);
        assert!(matches!(output.status.code(), Some(0 | 1)), "{output:?}");
        json(&file).as_array().unwrap().clone()
    };
    let largest = |more: &[&str]| {
        let scores = scores("speeds", &[&["--sequences", "speed 1", "--grid", "12"], more].concat());
        assert_eq!(scores[0]["score"]["case"], "speed 1");
        scores[0]["score"]["stretch_largest"].as_f64().unwrap()
    };
    let usual = largest(&[]);
    assert_eq!(usual, largest(&["--material", "1000,8,0.5"]));
    assert_ne!(usual, largest(&["--material", "10,8,0.5"]));
    assert_ne!(usual, largest(&["--wind", "50"]));
    // The suite of grids has its own, once.
    let of_grids = scores("grids", &["--sequences", "48x32"]);
    assert_eq!((of_grids.len(), &of_grids[0]["score"]["grid"]), (1, &"48x32".into()));
    let five = ["--sequences", "5 iterations", "--grid", "12", "--solver", "lbfgs:2,lbfgs:3"];
    let of_five = scores("iterations", &five);
    assert_eq!((of_five.len(), &of_five[0]["score"]["iterations"]), (1, &5.into()));
    refused(suite("grids", &["--grid", "32,64"]), &["--grid", "has its own"]);
    refused(suite("iterations", &["--iterations", "3"]), &["--iterations", "has its own"]);
    refused(suite("iterations", &["--solver", "single-pass"]), &["--solver", "single-pass"]);
    refused(suite("materials", &["--material", "1,2,3"]), &["--material", "which has its own"]);
    refused(suite("speeds", &["--points", "3"]), &["cannot be used with", "--points"]);
    refused(suite("speeds", &["--ground-truth", "."]), &["cannot be used with", "--ground-truth"]);
}

#[test]
fn cases_of_a_suite_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let suite = |more: &[&str]| -> Vec<Value> {
        let few = ["--sequences", "speed 1,speed 2", "--grid", "12", "--solver", "lbfgs:2,gd:2"];
        let rest = ["--device", "cpu", "--json", "s.json"];
        let arguments = [&["evaluate", "--suite", "speeds"], &few[..], &rest, more].concat();
        done(command(at, &arguments).output().unwrap());
        json(&at.join("s.json")).as_array().unwrap().iter().map(|s| s["score"].clone()).collect()
    };
    let usual = ["--frames", "3"];
    let first = suite(&usual);
    // Times would differ if anything were simulated again.
    assert_eq!((first.len(), suite(&usual)), (4, first.clone()));
    // What is damaged, or without a picture, is made again; the other two are those that were kept.
    let [png, kept] = ["gd_2_12x12_speed_1.png", "cases/lbfgs_2_12x12_speed_1.json"].map(|file| {
        let path = at.join("out/evaluate").join(file);
        assert!(path.is_file(), "{file}");
        path
    });
    std::fs::write(&kept, "{").unwrap();
    std::fs::remove_file(&png).unwrap();
    assert_eq!(suite(&usual)[2..], first[2..]);
    assert!(png.is_file() && json(&kept)["case"] == "speed 1");
    // All that a score depends on is looked at.
    for other in [&["--material", "10,8,0.5"], &["--wind", "50"], &["--frames", "4"]] {
        let others =
            suite(&if other[0] == "--frames" { other.to_vec() } else { [&usual[..], other].concat() });
        assert!(others.iter().zip(&first).all(|(other, first)| other["made_with"] != first["made_with"]));
    }
    assert_eq!(suite(&usual)[0]["stretch_largest"], first[0]["stretch_largest"]);
    // One without the gap is not one with it.
    let without = suite(&[&usual[..], &["--no-gap"]].concat());
    assert!(
        without[0]["gap"].is_null()
            && suite(&usual)[0]["gap"] == first[0]["gap"]
            && first[0]["gap"].is_number()
    );
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
        command(at, &[&["fit-material"], &few[..], more].concat()).output().unwrap()
    };
    let ranges =
        ["--stretch", "100,400", "--shear", "5", "--bend", "0.1", "--density", "1,2", "--levels", "2"];
    let (told, _) = done(fit(&[&ranges[..], &["--rounds", "0"]].concat()));
    assert!(told.contains("out/fit.json"), "{told}");
    let best = json(&at.join("out/fit.json"));
    let lines = std::fs::read_to_string(at.join("out/fit.csv")).unwrap();
    let first: Vec<f64> = lines.lines().nth(2).unwrap().split(',').map(|v| v.parse().unwrap()).collect();
    assert_eq!(best["material"]["stretch"].as_f64().unwrap(), first[0]);
    done(evaluate(
        at,
        &["--grid", "8", "--solver", "gd:2", "--json", "s.json", "--material", "out/fit.json"],
    ));
    let settings = json(&at.join("s.json"))[0]["made_with"]["settings"].clone();
    assert_eq!(settings["material"]["stretch"], best["material"]["stretch"]);
    assert_eq!((settings["density"].as_f64(), &settings["drag"]), (Some(first[3]), &Value::Null));
    refused(fit(&["--levels", "50"]), &["levels", "at most 100000 points"]);
    // A point has one air for all sequences: it is asked for, or theirs must be the same.
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
    let refusal = command(at, &airs).output().unwrap();
    refused(refusal, &["thin", "density", "as in thick, or --density", "0.5"]);
    refused(fit(&["--out", "fit.json"]), &["--out", "another ending"]);
}

/// A reader that reads nothing, as `| head -0`, leaves the files.
#[test]
fn files_are_there_when_nobody_reads_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let truth = shipped();
    let few = ["--frames", "3", "--points", "100", "--grid", "8", "--solver", "gd:2", "--csv", "t.csv"];
    let arguments = [&["evaluate", "--ground-truth", truth.to_str().unwrap()], &few[..]].concat();
    let mut child = command(folder.path(), &arguments).stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let csv = std::fs::read_to_string(folder.path().join("t.csv")).unwrap();
    assert!(csv.contains("mean stretch") && csv.contains("inertia"), "{csv}");
}

/// The figures of shares that are put together are those of one run over all, score by score.
#[test]
fn shares_together_are_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let figures = |printed: &str| {
        let scores: Vec<Value> = serde_json::from_str(printed).unwrap();
        let of = |score: &Value| {
            let told = ["sequence", "grid", "solver", "iterations", "e_cd", "e_3d", "energy", "gradient"];
            told.map(|key| score[key].to_string())
        };
        let mut all: Vec<_> = scores.iter().map(of).collect();
        all.sort();
        all
    };
    let run = |more: &[&str]| {
        let few = ["--device", "cpu", "--grid", "8,9", "--solver", "gd:3,lbfgs:3,adam:3", "--json"];
        done(evaluate(folder.path(), &[&few[..], more].concat())).0
    };
    let whole = figures(&run(&["--out", "whole"]));
    assert_eq!(whole.len(), 6);
    for share in ["0/4", "1/4", "2/4", "3/4"] {
        run(&["--out", "shares", "--shard", share]);
    }
    let merged = command(folder.path(), &["evaluate", "--merge", "shares", "--json"]).output().unwrap();
    assert_eq!(figures(&done(merged).0), whole);
}

/// A solver that is added later runs on as many threads as those before it, whose times are kept.
#[test]
fn times_in_one_table_are_of_as_many_threads() {
    let folder = tempfile::tempdir().unwrap();
    let truth = shipped();
    let devices = |solvers: &str| {
        let few =
            ["evaluate", "--device", "cpu", "--grid", "8", "--frames", "4", "--points", "100", "--json"];
        let more = ["--ground-truth", truth.to_str().unwrap(), "--solver", solvers];
        let mut command = command(folder.path(), &[&few[..], &more].concat());
        let printed = done(command.env("RAYON_NUM_THREADS", "2").output().unwrap()).0;
        let scores: Vec<Value> = serde_json::from_str(&printed).unwrap();
        scores.iter().map(|score| score["made_with"]["device"].to_string()).collect::<Vec<_>>()
    };
    let two = devices("gd:2,lbfgs:2");
    assert_eq!(two[0], two[1]);
    assert_eq!(devices("gd:2,lbfgs:2,adam:2"), vec![two[0].clone(); 3]);
}

#[test]
fn what_would_be_ignored_or_spoil_the_scores_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let needless = ["--solver", "gd:1", "--checkpoint", "missing.safetensors"];
    refused(evaluate(at, &needless), &["--checkpoint", "a solver that has weights", "missing.safetensors"]);
    let among = ["--solver", "gd:1", "--grid", "8", "--json", "out/evaluate/all.json"];
    refused(evaluate(at, &among), &["--json", "outside --out"]);
    let mut task = command(at, &["evaluate", "--suite", "motions"]);
    task.env("SLURM_ARRAY_TASK_ID", "1").env("SLURM_ARRAY_TASK_COUNT", "4");
    refused(task.output().unwrap(), &["--suite", "not shared out", "4 of them"]);
}

/// The truth itself as another system's result, in each format that is read.
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

#[cfg(target_os = "linux")]
mod interrupted {
    use super::command::send;
    use super::{command, shipped};
    use std::process::{Child, Stdio};
    use std::time::{Duration, Instant};

    /// Waits until a child listens to Ctrl-C, and a little more, so that it is at work.
    fn at_work(child: Child) -> Child {
        let begun = Instant::now();
        let listens = || {
            let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
            let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
            // The second bit is that of SIGINT.
            caught
                .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
                .is_some_and(|mask| mask & 2 != 0)
        };
        while !listens() {
            assert!(begun.elapsed() < Duration::from_secs(60), "no handler of Ctrl-C within a minute");
            std::thread::sleep(Duration::from_millis(20));
        }
        std::thread::sleep(Duration::from_secs(2));
        child
    }

    /// Waits for a child that was interrupted: it must end soon, and say how.
    fn ends_soon(mut child: Child) {
        send("-INT", &child);
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if begun.elapsed() > Duration::from_secs(20) {
                child.kill().unwrap();
                panic!("still at work 20 s after Ctrl-C");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(child.wait().unwrap().code(), Some(130));
    }

    /// Each of these has minutes of Newton's method before it.
    #[test]
    fn ctrl_c_ends_whatever_is_simulated() {
        let folder = tempfile::tempdir().unwrap();
        let truth = shipped();
        let truth = truth.to_str().unwrap();
        let spawn = |arguments: &[&str]| {
            let mut command = command(folder.path(), arguments);
            command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
        };
        let suite = spawn(&[
            "evaluate",
            "--suite",
            "motions",
            "--sequences",
            "xy_v2",
            "--solver",
            "gd:1",
            "--grid",
            "64",
        ]);
        ends_soon(at_work(suite));
        let fit = spawn(&["fit-material", "--ground-truth", truth]);
        ends_soon(at_work(fit));
        // Between the plots of the scores and the one of the convergence.
        let plots = ["--solver", "gd:1", "--grid", "64", "--frames", "41", "--plots", "p"];
        let mut plots = spawn(&[&["evaluate", "--ground-truth", truth], &plots[..]].concat());
        let (first, begun) = (folder.path().join("p/errors_xy_v2_64x64.png"), Instant::now());
        while !first.is_file() {
            if begun.elapsed() > Duration::from_secs(100) {
                plots.kill().unwrap();
                panic!("no plots");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        ends_soon(plots);
        assert!(!folder.path().join("p/convergence.png").exists());
    }
}
