//! Scores of `fnopt evaluate`: kept, reused, sharded and merged.

use super::command::{done, evaluate, fnopt, json, quiet, refused, refused_cleanly, scores, shipped, text};
use serde_json::Value;
use std::path::Path;

/// Copies the shipped sequence.
fn copy_sequence(to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for file in ["cloth_pos.npy", "handles.npy", "start.npy", "meta.json"] {
        std::fs::copy(shipped().join("xy_v2").join(file), to.join(file)).unwrap();
    }
}

#[test]
fn an_evaluation_keeps_its_scores() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/ground_truth");
    let truth = truth.to_str().unwrap();
    let evaluate = |more: &[&str]| {
        let short =
            ["--frames", "6", "--points", "200", "--solver", "newton,gd,lbfgs", "--ground-truth", truth];
        let output = fnopt(at, &[&["evaluate"], &short[..], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let whole = evaluate(&["--plots", "plots", "--markdown", "t.md", "--csv", "t.csv", "--json", "t.json"]);
    let plotted = |file: &str| at.join(format!("plots/{file}.png")).is_file();
    for file in ["per_frame", "convergence", "gap_ms", "errors_xy_v2_32x32"] {
        assert!(plotted(file), "{file}");
    }
    // Nothing comes close, and each solver has one number of iterations.
    assert!(!plotted("repulsion") && !plotted("iterations"));
    for (file, says) in [("t.md", "| xy_v2 |"), ("t.csv", "xy_v2,"), ("t.json", "\"sequence\": \"xy_v2\"")] {
        assert!(std::fs::read_to_string(at.join(file)).unwrap().contains(says), "{file}");
    }
    // The times would differ if anything were simulated again.
    assert_eq!(evaluate(&[]), whole);

    evaluate(&["--iterations", "2,4", "--grid", "8", "--plots", "plots"]);
    assert!(plotted("iterations"));

    // Another system, here the ground truth itself, has a column next to the solvers.
    let other = evaluate(&["--compare", &format!("arcsim={truth}")]);
    assert!(other.contains("arcsim"), "{other}");

    let clean = tempfile::tempdir().unwrap();
    refused_cleanly(clean.path(), &["evaluate", "--suite", "motion"], &["motion", "did you mean motions?"]);
    let refused_cleanly = |arguments: &[&str], said: &[&str]| {
        refused_cleanly(clean.path(), &[&["evaluate", "--ground-truth", truth], arguments].concat(), said);
    };
    refused_cleanly(&["--solver", "newtn"], &["newtn", "did you mean newton?"]);
    refused_cleanly(&["--solver", "fnopt:x"], &["--solver", "NAME:ITERATIONS"]);
    refused_cleanly(&["--sequences", "xy_v3"], &["xy_v3", "did you mean xy_v2?"]);
    refused_cleanly(&["--grid", "4"], &["--grid", "8"]);
    refused_cleanly(&["--shard", "2/2"], &["--shard", "0 to 1"]);
    refused_cleanly(&["--material", "1,2"], &["--material", "three numbers or a file"]);
    refused_cleanly(&["--material", "1,2,-3"], &["--material", "not negative"]);
    std::fs::write(clean.path().join("m.json"), r#"{"material": {"stretch": 1, "shear": "8"}}"#).unwrap();
    refused_cleanly(&["--material", "m.json"], &["m.json", "material.shear", "a number"]);
    refused_cleanly(&["--compare", "ours=nowhere"], &["--compare", "a folder"]);
    std::fs::create_dir(clean.path().join("empty")).unwrap();
    refused_cleanly(&["--compare", "ours=empty"], &["empty", "xy_v2.npz"]);
}

#[test]
fn scores_are_those_of_the_files_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let to = at.join("truth/xy_v2");
    copy_sequence(&to);
    let run = || {
        let arguments = ["--frames", "4", "--points", "100", "--ground-truth", "truth", "--grid", "8"];
        let solver = ["--solver", "gd:3,lbfgs:3"];
        quiet(at, &[&["evaluate"], &arguments[..], &solver].concat()).output().unwrap()
    };
    let (first, _) = done(run());
    assert_eq!(done(run()).0, first);
    let meta = std::fs::read_to_string(to.join("meta.json")).unwrap();
    std::fs::write(to.join("meta.json"), meta.replace("0.187", "0.5")).unwrap();
    assert_ne!(done(run()).0, first);
    assert_eq!(scores(&at.join("out/evaluate")).len(), 4);
    // A score whose frames are missing or incomplete is computed again, with its frames.
    for damage in [(|file: &Path| std::fs::remove_file(file).unwrap()) as fn(&Path), |file| {
        let frames = fnopt::io::Trajectory::read(file, &Default::default()).unwrap();
        let mut one = fnopt::io::Trajectory::new(frames.grid(), 1.0);
        one.push(frames.frame(0), frames.frame_velocities(0));
        one.write(
            file.parent().unwrap(),
            file.file_stem().unwrap().to_str().unwrap(),
            fnopt::io::Format::Npy,
        )
        .unwrap();
    }] {
        let all = scores(&at.join("out/evaluate")).into_iter().map(|score| score.with_extension("npy"));
        let all: Vec<_> = all.collect();
        let before: Vec<_> = all.iter().map(|file| std::fs::read(file).unwrap()).collect();
        all.iter().for_each(|file| damage(file));
        done(run());
        let same = all
            .iter()
            .zip(&before)
            .filter(|(file, before)| std::fs::read(file).is_ok_and(|found| found == **before));
        // Two of the four are back: those of the earlier ground truth are not computed again.
        assert_eq!(same.count(), 2);
        all.iter().zip(&before).for_each(|(file, before)| std::fs::write(file, before).unwrap());
    }
    // An unreadable score is reported, after the finished scores are printed.
    let damaged =
        scores(&at.join("out/evaluate")).into_iter().filter(|f| f.to_string_lossy().contains("lbfgs"));
    damaged.for_each(|file| std::fs::write(file, "{").unwrap());
    let failed = run();
    assert!(text(&failed.stdout).contains("8x8 gd, N = 3"), "{}", text(&failed.stdout));
    refused(failed, &["lbfgs", "a score written by this program"]);
}

#[test]
fn repeats_are_kept_and_merged_as_other_scores_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = |more: &[&str]| {
        let few = ["--grid", "8", "--solver", "gd:3,lbfgs:3", "--device", "cpu", "--json", "s.json"];
        evaluate(at, &[&few[..], more].concat())
    };
    let written = || json(&at.join("s.json")).as_array().unwrap().clone();
    done(run(&[]));
    let once = written();
    assert!(once.iter().all(|score| score.get("over_repeats").is_none()));
    let (repeated, _) = done(run(&["--repeats", "3"]));
    assert!(repeated.contains("means over repeats") && repeated.contains("± repeats"), "{repeated}");
    let all = written();
    assert_eq!((all.len(), scores(&at.join("out/evaluate")).len()), (6, 6));
    for (k, first) in once.iter().enumerate() {
        // The time is equal, too: it was not simulated again.
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
    let merged = quiet(at, &["evaluate", "--merge", "shares", "--json", "s.json"]).output().unwrap();
    assert!(done(merged).0.contains("means over repeats"));
    let over: Vec<Value> =
        written().into_iter().filter_map(|mut s| s.get_mut("over_repeats").map(Value::take)).collect();
    assert!(over.len() == 2 && over.iter().all(|over| over["repeats"] == 3), "{over:?}");
    for count in ["0", "1001", "x"] {
        refused(run(&["--repeats", count]), &["--repeats", count]);
    }
    refused(
        quiet(at, &["evaluate", "--suite", "speeds", "--repeats", "2"]).output().unwrap(),
        &["--repeats"],
    );
    refused(
        quiet(at, &["evaluate", "--merge", "shares", "--repeats", "2"]).output().unwrap(),
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
        |arguments: &[&str]| quiet(at, &[&["evaluate", "--merge"], arguments].concat()).output().unwrap();
    let (tables, _) = done(merge(&["a", "b", "--plots", "p"]));
    assert!(tables.contains("gd, N = 3") && tables.contains("lbfgs, N = 3"), "{tables}");
    assert!(at.join("p/per_frame.png").is_file());
    // Named by the field that differs.
    let said = ["a/xy_v2_8x8_gd_3", "soft/xy_v2_8x8_adam_3", "settings.material"];
    refused(merge(&["a", "soft"]), &said);
    run("windy", &["--solver", "adam:3", "--wind", "2"]);
    refused(merge(&["a", "windy"]), &["settings.density: expected null", ", as in a/", "found 2"]);
    // Tables may be printed as they would be written.
    let (csv, _) = done(merge(&["a", "--csv", "-"]));
    assert!(csv.starts_with("table,row,column,value\n") && csv.contains(",xy_v2,"), "{csv}");
    assert!(!at.join("-").exists());
    refused(merge(&["a", "--csv", "-", "--json"]), &["a file for each of"]);
    refused(merge(&["a", "again"]), &["a/xy_v2_8x8_gd_3", "again/xy_v2_8x8_gd_3", "the only score of"]);
    for option in [["--compare", "x=a"], ["--air-density", "2"], ["--device", "cpu"], ["--solver", "gd"]] {
        refused(merge(&[&["a"], &option[..]].concat()), &["cannot be used with", option[0]]);
    }
}

/// Jobs run in parallel, up to one per core. Their results do not depend on each other.
#[test]
fn parallel_jobs_have_the_results_of_single_ones() {
    let folder = tempfile::tempdir().unwrap();
    let evaluated = |out: &str, threads: &str, solvers: &str| {
        let more = ["--device", "cpu", "--grid", "8,12", "--solver", solvers, "--json", "--out", out];
        let truth = shipped();
        let few = ["--frames", "4", "--points", "100", "--ground-truth", truth.to_str().unwrap()];
        let mut command = quiet(folder.path(), &[&["evaluate"], &few[..], &more].concat());
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
    let (together, devices) = evaluated("together", "3", all);
    // Eight jobs on three threads: one thread each.
    assert_eq!(devices, ["cpu, 1 thread"; 8]);
    assert_eq!(evaluated("one", "1", all).0, together);
    // Two jobs on five threads: two threads each.
    let (alone, devices) = evaluated("alone", "5", "fnopt:2");
    assert_eq!(devices, ["cpu, 2 threads"; 2]);
    assert!(alone.iter().all(|figures| together.contains(figures)), "{alone:?} in {together:?}");
}

/// Slurm arrays may start at any index and have any stride.
#[test]
fn a_task_of_an_array_does_its_share_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let array = |id: &str, count: &str| {
        let truth = shipped();
        let few = ["--grid", "8,9,10", "--solver", "gd:1,gd:2", "--frames", "3", "--device", "cpu"];
        let whose = ["evaluate", "--ground-truth", truth.to_str().unwrap()];
        let mut command = quiet(folder.path(), &[&whose[..], &few].concat());
        let of_slurm = [("ID", id), ("MIN", "1"), ("STEP", "2"), ("COUNT", count)];
        command.envs(of_slurm.map(|(name, value)| (format!("SLURM_ARRAY_TASK_{name}"), value)));
        command.output().unwrap()
    };
    for (id, share) in [("1", 0), ("3", 1), ("5", 2)] {
        let output = array(id, "3");
        let log = text(&output.stderr);
        done(output);
        assert!(log.contains(&format!("share {share} of 3")), "{log}");
        assert_eq!(scores(&folder.path().join("out/evaluate")).len(), 2 * (share + 1));
    }
    refused(array("7", "3"), &["SLURM_ARRAY_TASK_ID", "0 to 2", "--shard I/N in an array with gaps"]);
    // A task that was submitted again on its own.
    let output = array("1", "1");
    assert!(
        text(&output.stderr).contains("the only task of its Slurm array does all the work"),
        "{output:?}"
    );
    refused(evaluate(folder.path(), &["--shard", "0/0"]), &["--shard", "a share of 1 or more"]);
}

/// Means over other sequences than the next column's are pointed out.
#[test]
fn a_merge_names_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let few = ["--device", "cpu", "--out", "kept"];
    let run = |more: &[&str]| done(evaluate(folder.path(), &[&few[..], more].concat()));
    run(&["--grid", "8,9", "--solver", "gd:1"]);
    run(&["--grid", "8", "--solver", "gd:2"]);
    let merge = || done(quiet(folder.path(), &["evaluate", "--merge", "kept"]).output().unwrap());
    assert!(!merge().1.contains("no score"), "{}", merge().1);
    copy_sequence(&folder.path().join("truth/other"));
    let truth = folder.path().join("truth");
    let other = ["evaluate", "--ground-truth", truth.to_str().unwrap(), "--grid", "9", "--solver", "gd:1"];
    let same = ["--frames", "4", "--points", "100"];
    done(quiet(folder.path(), &[&other[..], &same, &few].concat()).output().unwrap());
    let expected = "warning: no score of gd, N = 1 on other, 8x8; gd, N = 2 on other, 8x8\n";
    assert!(merge().1.contains(expected), "{}", merge().1);
}

/// A damaged sequence, or another system's damaged trajectory, is reported and does not affect the others.
#[test]
fn damaged_sequences_leave_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ["good", "torn"].iter().for_each(|name| copy_sequence(&at.join("truth").join(name)));
    let run = |more: &[&str]| {
        let few = ["evaluate", "--ground-truth", "truth", "--frames", "4", "--points", "100", "--grid", "8"];
        quiet(at, &[&few[..], &["--solver", "gd:3", "--device", "cpu"], more].concat()).output().unwrap()
    };
    std::fs::create_dir(at.join("theirs")).unwrap();
    std::fs::copy(at.join("truth/good/cloth_pos.npy"), at.join("theirs/good.npy")).unwrap();
    std::fs::write(at.join("theirs/torn.npy"), "nothing").unwrap();
    let output = run(&["--compare", "them=theirs"]);
    let printed = text(&output.stdout);
    assert!(
        printed.contains("good") && printed.contains("torn") && printed.contains("them (32x32)"),
        "{printed}"
    );
    refused(output, &["theirs/torn.npy"]);

    std::fs::write(at.join("truth/torn/cloth_pos.npy"), "nothing").unwrap();
    let output = run(&[]);
    let printed = text(&output.stdout);
    assert!(printed.contains("good") && !printed.contains("torn"), "{printed}");
    refused(output, &["torn/cloth_pos.npy"]);
    refused(run(&["--sequences", "torn"]), &["torn/cloth_pos.npy"]);
}

/// Another system's trajectory appears in the table of every grid, whatever its own grid is, and in the
/// tables of merged scores.
#[test]
fn other_systems_are_columns_next_to_the_solvers() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rollout = ["rollout", "--device", "cpu", "--solver", "gd", "--grid", "16", "--frames", "4"];
    let written = ["--no-pictures", "--format", "npy", "--out", "theirs"];
    done(quiet(at, &[&rollout[..], &written].concat()).output().unwrap());
    let file = at.join("theirs/xy_v2.npy");
    std::fs::rename(at.join("theirs/rollout.npy"), &file).unwrap();
    let few = ["--grid", "8,9", "--solver", "gd:3", "--device", "cpu"];
    let compared =
        |more: &[&str]| done(evaluate(at, &[&few[..], &["--compare", "A b=theirs"], more].concat())).0;
    for grid in ["8x8", "9x9"] {
        let printed = compared(&[]);
        let table = printed.split("\n\n").find(|table| table.starts_with(&format!("{grid}: e_CD"))).unwrap();
        assert!(table.lines().nth(1).unwrap().contains("gd, N = 3  A b (16x16)"), "{table}");
    }
    compared(&["--out", "shares", "--shard", "0/2"]);
    // The second of two shares has one grid of the only sequence; the third of three has nothing.
    compared(&["--out", "shares", "--shard", "1/2"]);
    let nothing = compared(&["--out", "none", "--shard", "2/3", "--json"]);
    assert_eq!(nothing.trim(), "[]");
    let merged = done(quiet(at, &["evaluate", "--merge", "shares"]).output().unwrap()).0;
    assert!(merged.contains("gd, N = 3  A b (16x16)"), "{merged}");

    // A sequence or grid that is named twice appears once.
    let once = compared(&["--sequences", "xy_v2", "--json", "--out", "once"]);
    let twice = ["--sequences", "xy_v2,xy_v2", "--grid", "9", "--json", "--out", "once"];
    let count = |printed: &str| serde_json::from_str::<Vec<Value>>(printed).unwrap().len();
    assert_eq!((count(&once), count(&compared(&twice))), (3, 3));
    // This name would clash with the column of a solver.
    let compare = ["--compare", "gd=theirs"];
    refused(evaluate(at, &[&few[..], &compare].concat()), &["--compare", "no other column has"]);

    // A non-finite trajectory counts as diverged.
    let mut bytes = std::fs::read(&file).unwrap();
    let end = bytes.len() - 4;
    bytes[end..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&file, bytes).unwrap();
    let scores: Vec<Value> = serde_json::from_str(&compared(&["--json"])).unwrap();
    let theirs = scores.iter().find(|score| score["solver"] == "A b").unwrap();
    assert_eq!((&theirs["stable"], &theirs["e_cd"]), (&Value::Bool(false), &Value::Null));
}

/// A trajectory that is compared again replaces its own score, and not that of a sequence whose name begins alike.
#[test]
fn a_system_that_is_compared_again_replaces_its_own_score() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("theirs")).unwrap();
    for sequence in ["xy", "xy_v2"] {
        copy_sequence(&at.join("truth").join(sequence));
        let own = at.join("truth").join(sequence).join("cloth_pos.npy");
        std::fs::copy(own, at.join(format!("theirs/{sequence}.npy"))).unwrap();
    }
    let compared = |more: &[&str]| {
        let few =
            ["evaluate", "--ground-truth", "truth", "--grid", "8", "--solver", "gd:3", "--points", "100"];
        done(quiet(at, &[&few[..], &["--compare", "other=theirs"], more].concat()).output().unwrap());
        let names = scores(&at.join("out/evaluate")).into_iter();
        let names = names.map(|path| path.file_name().unwrap().to_str().unwrap().to_owned());
        names.filter(|name| name.contains("_compared_")).collect::<Vec<_>>()
    };
    let first = compared(&["--frames", "4"]);
    let of = |names: &[String], sequence: &str| -> Vec<String> {
        names.iter().filter(|name| name.starts_with(&format!("{sequence}_32x32"))).cloned().collect()
    };
    assert_eq!((of(&first, "xy").len(), of(&first, "xy_v2").len(), first.len()), (1, 1, 2), "{first:?}");
    let second = compared(&["--frames", "3", "--sequences", "xy"]);
    assert_eq!((of(&second, "xy").len(), second.len()), (1, 2), "{second:?}");
    assert_ne!(of(&second, "xy"), of(&first, "xy"));
    assert_eq!(of(&second, "xy_v2"), of(&first, "xy_v2"));
}

/// Merged shares have the figures of a single run over everything, score by score.
#[test]
fn shares_together_are_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let figures = |printed: &str| {
        let scores: Vec<Value> = serde_json::from_str(printed).unwrap();
        let of = |score: &Value| {
            let keys = ["sequence", "grid", "solver", "iterations", "e_cd", "e_3d", "energy", "gradient"];
            keys.map(|key| score[key].to_string())
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
    let merge = || quiet(folder.path(), &["evaluate", "--merge", "shares", "--json"]).output().unwrap();
    assert_eq!(figures(&done(merge()).0), whole);
    // In the order of a run's tables, and numbers as numbers.
    run(&["--out", "shares", "--solver", "gd:10"]);
    let scores: Vec<Value> = serde_json::from_str(&done(merge()).0).unwrap();
    let columns: Vec<String> =
        scores[..4].iter().map(|score| format!("{} {}", score["solver"], score["iterations"])).collect();
    assert_eq!(columns, ["\"lbfgs\" 3", "\"adam\" 3", "\"gd\" 3", "\"gd\" 10"]);
}

/// A solver added later runs on as many threads as the earlier ones, whose times are kept.
#[test]
fn times_in_one_table_are_of_as_many_threads() {
    let folder = tempfile::tempdir().unwrap();
    let truth = shipped();
    let devices = |solvers: &str| {
        let few =
            ["evaluate", "--device", "cpu", "--grid", "8", "--frames", "4", "--points", "100", "--json"];
        let more = ["--ground-truth", truth.to_str().unwrap(), "--solver", solvers];
        let mut command = quiet(folder.path(), &[&few[..], &more].concat());
        let printed = done(command.env("RAYON_NUM_THREADS", "2").output().unwrap()).0;
        let scores: Vec<Value> = serde_json::from_str(&printed).unwrap();
        scores.iter().map(|score| score["made_with"]["device"].to_string()).collect::<Vec<_>>()
    };
    let two = devices("gd:2,lbfgs:2");
    assert_eq!(two[0], two[1]);
    assert_eq!(devices("gd:2,lbfgs:2,adam:2"), vec![two[0].clone(); 3]);
}
