//! `fnopt rollout`: the files it writes, and those it keeps when it ends early.

use super::command::{command, done, fnopt, json, quiet, refused, refused_cleanly, send, signals, text};
use std::path::Path;
use std::process::Stdio;

#[test]
fn a_file_in_place_of_the_output_folder_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("taken"), "").unwrap();
    refused_cleanly(
        folder.path(),
        &["rollout", "--device", "cpu", "--out", "taken/x"],
        &["taken", "cannot create"],
    );
}

#[test]
fn a_rollout_writes_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "rollout",
        "--device",
        "cpu",
        "--grid",
        "16",
        "12",
        "--frames",
        "6",
        "--format",
        "npz,pc2,mdd",
        "--json",
    ];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["frames"], 6);
    for path in summary["files"].as_array().unwrap() {
        assert!(folder.path().join(path.as_str().unwrap()).exists(), "{path}");
    }
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["per_frame"].as_array().unwrap().len(), 5);
    assert!(report["ms_per_frame"].as_f64().unwrap() > 0.0);
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(report["settings"]["precision"], "f32");
    assert_eq!((&report["status"], &summary["status"]), (&"done".into(), &"done".into()));
    let mut listed: Vec<&str> =
        report["files"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    let mut there: Vec<String> = std::fs::read_dir(folder.path().join("out"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    there.sort();
    listed.sort_unstable();
    assert_eq!(listed, there);
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/weights/fnopt.safetensors");
    let sum = crc32fast::hash(&std::fs::read(weights).unwrap());
    assert_eq!(report["weights_crc32"], format!("{sum:08x}"));
    for ending in ["png", "gif", "npz", "pc2", "mdd", "obj"] {
        let file = folder.path().join(format!("out/rollout.{ending}"));
        assert!(file.metadata().unwrap().len() > 1000, "{ending}");
    }
}

/// The default motion rests for half a second; a quarter of a second later its handles are on their way.
#[test]
fn handles_follow_the_motion() {
    let folder = tempfile::tempdir().unwrap();
    for (solver, iterations) in [("newton", "1"), ("fnopt", "10")] {
        let arguments =
            ["rollout", "--device", "cpu", "--solver", solver, "--iterations", iterations, "--grid"];
        let more = ["8", "--frames", "46", "--format", "npy", "--no-pictures"];
        done(quiet(folder.path(), &[&arguments[..], &more].concat()).output().unwrap());
        let x = fnopt::io::read_npy(folder.path().join("out/rollout.npy")).unwrap();
        assert_eq!(x.shape(), [46, 64, 3]);
        // Newton's method takes as many iterations as it needs.
        let settled = &json(&folder.path().join("out/report.json"))["settings"]["iterations"];
        assert_eq!(settled.as_u64(), (solver == "fnopt").then_some(10));
        let moved = 0.5 * (1.0 - std::f64::consts::FRAC_PI_4.cos()) / 2f64.sqrt();
        for handle in [56, 0] {
            for (c, expected) in [moved, 0.0, -moved].into_iter().enumerate() {
                let found = x[[45, handle, c]] - x[[0, handle, c]];
                assert!((found - expected).abs() < 1e-5, "{solver}: handle {handle}, axis {c}: {found}");
            }
        }
    }
}

#[test]
fn values_of_repulsion_follow_an_equals_sign() {
    let folder = tempfile::tempdir().unwrap();
    refused_cleanly(
        folder.path(),
        &["rollout", "--repulsion", "1,0.5"],
        &["--repulsion=1,0.5", "equals sign"],
    );
}

#[test]
fn a_rollout_takes_a_material_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let utf16: Vec<u8> = "\u{feff}{}".encode_utf16().flat_map(u16::to_le_bytes).collect();
    std::fs::write(folder.path().join("utf16.json"), utf16).unwrap();
    refused_cleanly(
        folder.path(),
        &["rollout", "--material", "utf16.json"],
        &["utf16.json: text: expected UTF-8, found UTF-16"],
    );
    let soft = r#"{"material": {"stretch_modulus": 280, "shear_modulus": 28, "bending_stiffness": 1e-5},
        "wind": {"density": 0.5}, "frame_time_s": 0.01, "fitted_to": "nothing"}"#;
    std::fs::write(folder.path().join("soft.json"), soft).unwrap();
    let arguments = [
        "rollout",
        "--device",
        "cpu",
        "--grid",
        "8",
        "8",
        "--frames",
        "2",
        "--solver",
        "gd",
        "--no-pictures",
        "--material",
        "soft.json",
    ];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let scene = &report["settings"]["scene"];
    assert_eq!(scene["material"]["stretch_modulus"], 280.0, "{report}");
    assert_eq!(scene["wind"]["density"], 0.5);
    assert_eq!(scene["frame_time_s"], 0.01);
}

#[test]
fn layers_are_kept_apart_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("s.json"), r#"{"repulsion": {"distance": 0.7}}"#).unwrap();
    let rollout = |more: &[&str]| {
        let few = ["rollout", "--device", "cpu", "--grid", "8", "--frames", "2", "--no-pictures"];
        fnopt(folder.path(), &[&few[..], more].concat())
    };
    for (more, strength, distance) in [
        (&["--repulsion", "--solver", "gd"][..], 1.0, 1.0),
        (&["--solver", "gd", "--repulsion=0.5,0.8"], 0.5, 0.8),
        (&["--solver", "gd", "s.json"], 1.0, 0.7),
        (&["--solver", "gd", "--repulsion", "s.json"], 1.0, 0.7),
    ] {
        let output = rollout(more);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let repulsion = &report["settings"]["scene"]["repulsion"];
        assert_eq!(repulsion["strength"], strength, "{more:?}");
        assert_eq!(repulsion["distance"], distance, "{more:?}");
        assert_eq!(report["per_frame"][0]["energy"]["repulsion"], 0.0, "nothing is near");
    }
    // A sheet contracted to about a third of its size.
    let vertices: Vec<[f64; 3]> =
        (0..64).map(|p| [f64::from(p % 8) * 0.05, 0.0, f64::from(p / 8) * 0.05]).collect();
    let scene = serde_json::json!({
        "grid": [8, 8], "start": { "vertices": vertices, "grid": [8, 8] }, "handles": [], "motion": "none", "frames": 2,
    });
    std::fs::write(folder.path().join("s.json"), scene.to_string()).unwrap();
    for (more, repels) in [(&["s.json"][..], false), (&["s.json", "--repulsion"], true)] {
        let few = ["rollout", "--device", "cpu", "--solver", "gd", "--iterations", "1", "--no-pictures"];
        let output = fnopt(folder.path(), &[&few[..], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let energy = report["per_frame"][0]["energy"]["repulsion"].as_f64().unwrap();
        assert_eq!(energy != 0.0, repels, "{energy}");
    }
    for (more, said) in [
        (&["--repulsion=1"][..], "--repulsion: value: expected two numbers"),
        (&["--repulsion=1,2"], "--repulsion: value.distance: expected 0.001 to 1 edges, found 2"),
    ] {
        let output = rollout(more);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
    }
}

#[test]
fn a_run_that_explodes_keeps_the_frames_before_and_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["rollout", "--device", "cpu", "--solver", "gd", "--material", "1e30,8,0.5", "--frames", "30"];
    let output = fnopt(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("non-finite"));
    for file in ["out/replay.npz", "out/rollout.npz", "out/report.json"] {
        assert!(folder.path().join(file).exists(), "{file}");
    }
    let report = json(&folder.path().join("out/report.json"));
    assert_eq!(report["status"], "non-finite");
    assert!(report["files"].as_array().unwrap().contains(&"replay.npz".into()), "{}", report["files"]);
    assert!(text(&output.stdout).contains("out/replay.npz"), "{}", text(&output.stdout));
    // The next run succeeds and leaves no replay behind that could be mistaken for its own.
    let good = ["rollout", "--device", "cpu", "--solver", "gd", "--frames", "2", "--no-pictures"];
    assert_eq!(fnopt(folder.path(), &good).status.code(), Some(0));
    assert!(!folder.path().join("out/replay.npz").exists());
}

/// A simulation that starts from the output of another one does not overwrite it.
#[test]
fn inputs_of_a_scene_are_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let rollout = |more: &[&str]| {
        let few = ["--device", "cpu", "--solver", "gd", "--grid", "8", "--frames", "2", "--no-pictures"];
        fnopt(folder.path(), &[&["rollout"], more, &few].concat())
    };
    assert_eq!(rollout(&[]).status.code(), Some(0));
    let [first, replay] = ["rollout.npz", "replay.npz"].map(|file| folder.path().join("out").join(file));
    std::fs::copy(&first, &replay).unwrap();
    let before = std::fs::read(&first).unwrap();
    for start in ["out/rollout.npz", "./out/replay.npz"] {
        std::fs::write(folder.path().join("next.json"), format!(r#"{{"start": "{start}"}}"#)).unwrap();
        let output = rollout(&["next.json"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains("--out"), "{}", text(&output.stderr));
        assert!(std::fs::read(&first).unwrap() == before && replay.is_file());
        assert_eq!(rollout(&["next.json", "--out", "next"]).status.code(), Some(0));
    }
    // Nor the scene itself, or its material.
    let report = folder.path().join("out/report.json");
    for (content, named) in [
        (r#"{"grid": [8, 8]}"#, &["out/report.json"][..]),
        (r#"{"material": {"stretch": 100, "shear": 1, "bend": 0.1}}"#, &["--material", "out/report.json"]),
    ] {
        std::fs::write(&report, content).unwrap();
        let output = rollout(named);
        assert_eq!(output.status.code(), Some(2));
        assert!(text(&output.stderr).contains("report.json"), "{}", text(&output.stderr));
        assert_eq!(std::fs::read_to_string(&report).unwrap(), content);
    }
    // A frame in a folder of frames would be overwritten, or removed as one of a longer run.
    assert_eq!(rollout(&["--format", "obj"]).status.code(), Some(0));
    let frame = folder.path().join("out/rollout_obj/00001.obj");
    let before = std::fs::read(&frame).unwrap();
    let next = r#"{"grid": [8, 8], "start": "out/rollout_obj/00001.obj"}"#;
    std::fs::write(folder.path().join("next.json"), next).unwrap();
    let output = rollout(&["next.json", "--format", "obj"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("--out"), "{}", text(&output.stderr));
    assert!(std::fs::read(&frame).unwrap() == before);
    assert_eq!(rollout(&["next.json"]).status.code(), Some(0));
}

/// A file that cannot be written once the frames are computed does not take others with it.
#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_is_full_takes_one_file_and_not_the_others() {
    let folder = tempfile::tempdir().unwrap();
    // Files are limited to 1000 blocks of 512 bytes. The archive is larger; the positions alone are not.
    let limited = format!(
        "ulimit -f 1000; exec '{}' rollout --device cpu --solver gd --frames 30 --no-pictures --format npz,npy",
        env!("CARGO_BIN_EXE_fnopt")
    );
    let output =
        std::process::Command::new("sh").args(["-c", &limited]).current_dir(folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    let said = text(&output.stderr);
    assert!(said.contains("rollout.npz: cannot write"), "{said}");
    assert!(said.contains("written all the same: rollout.npy, report.json"), "{said}");
    let out = folder.path().join("out");
    let kept = fnopt::io::Trajectory::read(out.join("rollout.npy"), &Default::default()).unwrap();
    assert_eq!(kept.frames(), 30);
    let mut names: Vec<_> =
        std::fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(names, ["report.json", "rollout.npy"]);
    // The report does not list files that an earlier run may have left there.
    let report = json(&out.join("report.json"));
    assert_eq!(report["files"], serde_json::json!(["rollout.npy", "report.json"]));
    assert_eq!(report["status"], "failed");
}

#[cfg(unix)]
#[test]
fn an_interrupted_rollout_keeps_the_frames_so_far() {
    use std::io::BufRead;
    // Unless these tests were told to survive a hangup (SIGHUP is signal 1), as the command then does.
    let hangup = signals("self", "SigIgn:").is_some_and(|ignored| ignored & 1 == 0).then_some("-HUP");
    for signal in ["-INT", "-TERM"].into_iter().chain(hangup) {
        let folder = tempfile::tempdir().unwrap();
        let rollout = ["rollout", "--device", "cpu", "--grid", "64", "64", "--no-pictures"];
        let mut child = command(folder.path(), &rollout).stderr(Stdio::piped()).spawn().unwrap();
        let mut log = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
        // The command handles signals once it has named the device.
        assert!(log.by_ref().map(Result::unwrap).any(|line| line.starts_with("device: ")));
        send(signal, &child);
        let rest: Vec<String> = log.map(Result::unwrap).collect();
        assert!(rest.iter().any(|line| line.starts_with("interrupted after frame ")), "{rest:?}");
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let frames = report["frames"].as_u64().unwrap() as usize;
        assert!((2..391).contains(&frames), "{frames} frames");
        assert_eq!(report["per_frame"].as_array().unwrap().len(), frames - 1);
        let kept = folder.path().join("out/rollout.npz");
        let kept = fnopt::io::Trajectory::read(kept, &Default::default()).unwrap();
        assert_eq!(kept.frames(), frames, "{signal}");
    }
}

#[test]
fn unsound_rollouts_and_other_sizes_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let log = |scene: &str, more: &[&str]| {
        std::fs::write(folder.path().join("s.json"), scene).unwrap();
        let few = ["rollout", "s.json", "--device", "cpu", "--no-pictures"];
        text(&command(folder.path(), &[&few[..], more].concat()).output().unwrap().stderr)
    };
    // Gradient descent does not follow the handles.
    let torn = log(r#"{"grid": [16, 16], "frames": 120}"#, &["--solver", "gd"]);
    assert!(torn.contains("away from the handles was stretched by"), "{torn}");
    assert!(torn.contains("of the energy's decrease in a frame undone"), "{torn}");
    let report = json(&folder.path().join("out/report.json"));
    assert_eq!(report["sound"], false);
    assert!(report["stretch_largest_free"].as_f64().unwrap() > 0.6, "{report}");
    let sound = log(r#"{"grid": [16, 16], "frames": 4}"#, &["--solver", "newton"]);
    assert!(!sound.contains("warning") && !sound.contains("WARN"), "{sound}");
    assert_eq!(json(&folder.path().join("out/report.json"))["sound"], true);
    // A half-metre sheet in a one-metre scene, and handles that start elsewhere: one line for each.
    let vertices: Vec<[f64; 3]> =
        (0..64).map(|p| [0.5 * f64::from(p % 8) / 7.0, 0.0, 0.5 * f64::from(p / 8) / 7.0]).collect();
    let motion: Vec<[f64; 3]> = vec![[9.0, 0.0, 0.0], [9.0, 9.0, 0.0]];
    let scene = serde_json::json!({
        "grid": [8, 8], "start": { "vertices": vertices, "grid": [8, 8] }, "motion": [motion, motion],
    });
    let log = log(&scene.to_string(), &["--solver", "gd", "--iterations", "1", "--frames", "2"]);
    for said in ["along the height are 0.500 times", "along the width", "2 of 2 handles do not begin where"] {
        assert_eq!(log.matches(said).count(), 1, "{said}: {log}");
    }
}

/// What is allowed, but as a rule a slip, is said once, with the field.
#[test]
fn doubtful_bodies_and_materials_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let ball = |rest: &str| format!(r#"{{"shape": "sphere", "radius_m": 0.1, {rest}}}"#);
    // Two cubes, one of which reaches into the other.
    let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2].map(|c| 0.2 * c as f64);
    let vertices: Vec<[f64; 3]> =
        (0..16).map(|k| if k < 8 { corner(k) } else { corner(k - 8).map(|c| c + 0.1) }).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces: Vec<[usize; 3]> = [0, 8]
        .into_iter()
        .flat_map(|from| quads.map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]].map(|t| t.map(|v| v + from))))
        .flatten()
        .collect();
    let cubes = serde_json::json!({"shape": "mesh", "vertices": vertices, "faces": faces, "position_m": [3, 0, 0], "cells": 16});
    let fields = [
        (
            r#""material": {"stretch_modulus": 2, "shear_modulus": 1, "bending_stiffness": 1e-5}"#.to_owned(),
            "material: a metre of it would stretch by",
        ),
        (
            r#""material": {"stretch_modulus": 200, "shear_modulus": 20, "bending_stiffness": 1000}"#
                .to_owned(),
            "material: a metre of it, clamped at one end, would not bend",
        ),
        (
            format!(r#""bodies": [{}]"#, ball(r#""position_m": [3, 0, 0], "thickness_m": 0.1"#)),
            "bodies[0]: the cloth stays",
        ),
        (
            format!(r#""bodies": [{}]"#, ball(r#""position_m": [0, 0, 0]"#)),
            "particles of the start were inside the sphere; they were moved out",
        ),
        (
            format!(r#""bodies": [{}]"#, ball(r#""position_m": [0, -0.5, 0]"#)),
            "1 handles begin inside the sphere",
        ),
        (
            format!(
                r#""bodies": [{}]"#,
                ball(
                    r#""motion": [{"time_s": 0, "position_m": [9, 0, 0]}, {"time_s": 0.016, "position_m": [5, 0, 0]}]"#
                )
            ),
            "bodies[0]: it moves by more than its size in frame 1",
        ),
        (format!(r#""bodies": [{cubes}]"#), "bodies[0]: parts of the mesh overlap"),
    ];
    for (field, said) in fields {
        let scene = format!(
            r#"{{"grid": [12, 12], "start": "flat", "motion": "none", "up": "z", "handles": [[0, 0], [11, 11]], {field}}}"#
        );
        std::fs::write(folder.path().join("s.json"), scene).unwrap();
        let arguments = [
            "rollout",
            "s.json",
            "--device",
            "cpu",
            "--solver",
            "spectral",
            "--frames",
            "2",
            "--no-pictures",
        ];
        let log = text(&command(folder.path(), &arguments).output().unwrap().stderr);
        assert_eq!(log.matches(said).count(), 1, "{said}: {log}");
        assert!(log.contains("s.json: "), "{log}");
    }
}

/// A link whose target cannot be written is noticed before the work.
#[cfg(unix)]
#[test]
fn a_dangling_link_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink("none/plot.png", folder.path().join("plot.png")).unwrap();
    let arguments = ["bench", "--device", "cpu", "--grid", "8", "--plot", "plot.png"];
    refused_cleanly(
        folder.path(),
        &arguments,
        &["plot.png: file: expected one in a folder that exists", "a link to"],
    );
}

/// A light cloth that is swung fast: drag is that at the end of the frame, so it stays finite.
#[test]
fn light_and_fast_cloths_stay_finite() {
    let folder = tempfile::tempdir().unwrap();
    let scene = serde_json::json!({
        "grid": [32, 32], "motion": "updown", "speed": 4, "frames": 22, "frame_time_s": 0.0416667,
        "areal_mass_kg_m2": 0.02, "wind": {"density": 1.2},
        "material": {"stretch_modulus": 280.2, "shear_modulus": 28, "bending_stiffness": 1.46e-5}
    });
    std::fs::write(folder.path().join("light.json"), scene.to_string()).unwrap();
    for solver in ["spectral", "newton"] {
        let rollout = ["rollout", "light.json", "--device", "cpu", "--solver", solver, "--no-pictures"];
        let output = command(folder.path(), &rollout).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{solver}: {}", text(&output.stderr));
    }
}

/// A rollout that was continued has the frames and the bits of one that was not interrupted.
#[test]
fn a_rollout_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    for (solver, more) in [
        ("fnopt", "cpu"),
        ("spectral", "cpu"),
        ("fnopt-paper", "cpu"),
        ("newton", "cpu"),
        ("fnopt", "llvmpipe"),
    ] {
        let device = match more {
            "cpu" => vec!["--device", "cpu"],
            adapter => vec!["--device", "gpu", "--adapter", adapter],
        };
        let run = |more: &[&str]| {
            let few = ["rollout", "--solver", solver, "--grid", "24", "--no-pictures"];
            fnopt(folder.path(), &[&few[..], &device, more].concat())
        };
        for (out, frames) in [("whole", "15"), ("half", "12")] {
            done(run(&["--out", out, "--frames", frames]));
        }
        // In place of the earlier one.
        done(run(&["--out", "half", "--frames", "15", "--continue", "half/rollout.npz"]));
        let read = |out: &str| std::fs::read(folder.path().join(out).join("rollout.npz")).unwrap();
        assert!(read("half") == read("whole"), "{solver} on {more}");
        let report = json(&folder.path().join("half/report.json"));
        assert_eq!((&report["status"], &report["frames"]), (&"done".into(), &15.into()));
        assert_eq!(report["per_frame"][0]["frame"], 12);
        let said = ["half/rollout.npz", "frames", "fewer than the 15"];
        refused(run(&["--frames", "15", "--continue", "half/rollout.npz"]), &said);
        refused(
            run(&["--continue", "half/rollout.npz", "--grid", "25"]),
            &["half/rollout.npz", "grid", "24x25"],
        );
        let other = [
            "rollout",
            "--solver",
            "gd",
            "--grid",
            "24",
            "--device",
            "cpu",
            "--continue",
            "half/rollout.npz",
        ];
        refused(fnopt(folder.path(), &other), &["half/rollout.npz", "solver", "expected gd"]);
    }
}

/// Each scene of several is compared with another solver's frames: exactly alike with the same, and near the exact motion with twenty iterations.
#[test]
fn rollouts_are_compared_with_another_solver() {
    let folder = tempfile::tempdir().unwrap();
    for (name, mask) in [("full", ""), ("round", r#", "mask": "disc""#)] {
        let scene = format!(r#"{{"grid": [12, 12], "handles": [[1, 3], [1, 8]], "frames": 8{mask}}}"#);
        std::fs::write(folder.path().join(format!("{name}.json")), scene).unwrap();
    }
    let run = |solver: &[&str], against: &str| {
        let scenes =
            ["rollout", "full.json", "round.json", "--device", "cpu", "--no-pictures", "--against", against];
        let output = fnopt(folder.path(), &[&scenes[..], solver].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert_eq!(text(&output.stdout).matches(&format!("mm from {against} on average")).count(), 2);
        ["full", "round"]
            .map(|name| json(&folder.path().join(format!("out/{name}/report.json")))["against"].clone())
    };
    let numbers = |values: &serde_json::Value| -> Vec<f64> {
        values.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    for against in run(&["--solver", "spectral", "--iterations", "4"], "spectral:4") {
        assert_eq!(numbers(&against["per_frame"]["mean_m"]), [0.0; 7]);
        assert_eq!(against["largest_m"], 0.0);
    }
    for (name, against) in ["full", "round"].iter().zip(run(&["--solver", "spectral"], "newton")) {
        let [mean, largest] = ["mean_m", "largest_m"].map(|which| numbers(&against["per_frame"][which]));
        assert!(mean.len() == 7 && mean.iter().zip(&largest).all(|(mean, largest)| mean <= largest));
        assert!(mean.iter().all(|&mean| 0.0 < mean && mean < 1e-3), "{name}: {mean:?}");
        let file = folder.path().join(format!("out/{name}/rollout.npz"));
        let kept = fnopt::io::read_npz_array(&file, "against_largest_m").unwrap().unwrap();
        assert_eq!(kept.iter().copied().collect::<Vec<_>>(), largest);
    }
    let again = ["rollout", "--against", "newton", "--continue", "out/full/rollout.npz"];
    refused(fnopt(folder.path(), &again), &["--against", "--continue"]);
    let folder = tempfile::tempdir().unwrap();
    refused_cleanly(folder.path(), &["rollout", "--against", "nwton"], &["--against", "did you mean newton"]);
    refused_cleanly(folder.path(), &["rollout", "--against", "spectral:0"], &["--against", "1 to"]);
}

/// A sheet that swings through itself is told to, and one that hangs has no intersections.
#[test]
fn intersections_are_counted_on_request() {
    let folder = tempfile::tempdir().unwrap();
    // Two halves that cross.
    let vertices: Vec<[f64; 3]> = (0..12 * 12)
        .map(|p| {
            let (i, j) = ((p / 12) as f64, (p % 12) as f64);
            let angle = 5.5 * j / 11.0;
            let radius = 0.3 - 0.02 * j + 0.001 * i;
            [radius * angle.cos() + 0.08 * j, radius * angle.sin(), i / 11.0]
        })
        .collect();
    let scene = format!(
        r#"{{"grid": [12, 12], "start": {{"vertices": {vertices:?}, "grid": [12, 12]}}, "motion": "none", "repulsion": true,
            "handles": [], "frames": 1}}"#
    );
    std::fs::write(folder.path().join("crossed.json"), scene).unwrap();
    for (scene, crossed) in [("crossed.json", true), ("flag", false)] {
        let arguments =
            ["rollout", scene, "--device", "cpu", "--frames", "1", "--no-pictures", "--intersections"];
        let output = command(folder.path(), &arguments).output().unwrap();
        let told = text(&output.stderr).contains("the cloth passes through itself");
        let report = json(&folder.path().join("out/report.json"));
        let pairs = report["intersections"]["edge_triangle_pairs"].as_u64().unwrap();
        assert_eq!((told, pairs > 0), (crossed, crossed), "{scene}: {pairs}");
        assert!(text(&output.stdout).contains("intersections "));
    }
    // The corner of a fold pokes through the layer below it: self-contact moves it out first.
    let vertices: Vec<[f64; 3]> = (0..20 * 24)
        .map(|p| {
            let (i, j) = ((p / 24) as f64, (p % 24) as f64);
            let upper = f64::from(u8::from(j > 11.5));
            let above = upper * (0.5 - 0.3 * (i + j - 35.0).max(0.0));
            [12.0 - (j - 11.5).abs() + 0.3 * upper, i + 0.4 * upper, above].map(|x| x / 19.0)
        })
        .collect();
    let scene = format!(
        r#"{{"grid": [20, 24], "start": {{"vertices": {vertices:?}, "grid": [20, 24]}}, "motion": "none", "self_contact": true,
            "handles": [], "frames": 12, "gravity": [0, 0, 0]}}"#
    );
    std::fs::write(folder.path().join("poking.json"), scene).unwrap();
    let arguments = ["rollout", "poking.json", "--device", "cpu", "--no-pictures", "--intersections"];
    let output = command(folder.path(), &arguments).output().unwrap();
    let log = text(&output.stderr);
    assert!(output.status.success() && log.contains("were moved out of each other, by 1."), "{log}");
    assert_eq!(json(&folder.path().join("out/report.json"))["intersections"]["edge_triangle_pairs"], 0);
    let without = ["rollout", "flag", "--device", "cpu", "--frames", "1", "--no-pictures"];
    done(fnopt(folder.path(), &without));
    assert!(json(&folder.path().join("out/report.json"))["intersections"].is_null());
}

#[test]
fn a_report_says_what_the_layers_did() {
    let folder = tempfile::tempdir().unwrap();
    let twist = ["rollout", "twist", "--self-contact", "--grid", "24", "--frames", "190", "--no-pictures"];
    // Fewer frames than those of the scene's events.
    done(fnopt(folder.path(), &[&twist[..], &["--device", "cpu", "--intersections"]].concat()));
    let report = json(&folder.path().join("out/report.json"));
    assert_eq!(report["intersections"]["edges"], 0);
    assert_eq!(report["settings"]["scene"]["self_contact"]["friction"], serde_json::Value::Null);
    let frames = report["per_frame"].as_array().unwrap();
    let touching = frames.iter().filter(|frame| frame["layers"]["touching"].as_u64().unwrap() > 0).count();
    assert!(touching > 5, "{touching}");
    let nearest = frames.iter().filter_map(|frame| frame["layers"]["nearest_m"].as_f64());
    let nearest = nearest.fold(f64::INFINITY, f64::min);
    assert!(nearest > 0.0 && nearest < 0.16 / 23.0, "{nearest}");
    // Without it there is nothing to say of layers.
    done(fnopt(folder.path(), &["rollout", "flag", "--device", "cpu", "--frames", "2", "--no-pictures"]));
    assert!(json(&folder.path().join("out/report.json"))["per_frame"][0].get("layers").is_none());
}

/// So does one in which hands let go and grab, whether it ended before or after they did.
#[test]
fn a_rollout_with_events_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"{
        "grid": [16, 16], "start": "hanging", "motion": "none", "frames": 50,
        "bodies": [{"shape": "sphere", "radius_m": 0.1, "motion": [
            {"time_s": 0.4, "position_m": [0.3, 0, 0]}, {"time_s": 0.8, "position_m": [0.4, 0.1, 0], "rotation": [90, 1, 0, 0]}]}],
        "events": [{"frame": 10, "release": [[0, 0]]}, {"frame": 20, "grab": [[3, 15], [0, 0]], "body": 0},
            {"frame": 30, "wind": {"velocity": [2, 0, 1]}, "hide": [0]}]
    }"#;
    std::fs::write(folder.path().join("hands.json"), text).unwrap();
    for device in [&["--device", "cpu"][..], &["--device", "gpu", "--adapter", "llvmpipe"]] {
        let run = |more: &[&str]| {
            let few = ["rollout", "hands.json", "--solver", "spectral", "--iterations", "5", "--no-pictures"];
            done(fnopt(folder.path(), &[&few[..], device, more].concat()));
        };
        run(&["--out", "whole"]);
        let read = |out: &str| std::fs::read(folder.path().join(out).join("rollout.npz")).unwrap();
        for frames in ["10", "20", "25", "40"] {
            run(&["--out", frames, "--frames", frames]);
            run(&["--out", frames, "--continue", &format!("{frames}/rollout.npz")]);
            assert!(read(frames) == read("whole"), "after {frames} frames, {device:?}");
        }
    }
}

/// Several scenes are simulated one after another, each into a folder of its own.
#[test]
fn several_scenes_have_a_folder_each() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (name, text) in
        [("a.json", r#"{"grid": [8, 8]}"#), ("b.json", r#"{"grid": [9, 9]}"#), ("c.json", r#"{"grid": 3}"#)]
    {
        std::fs::write(at.join(name), text).unwrap();
    }
    let few = ["--frames", "3", "--solver", "gd", "--device", "cpu", "--no-pictures"];
    done(fnopt(at, &[&["rollout", "a.json", "b.json"], &few[..]].concat()));
    for (name, grid) in [("a", "8"), ("b", "9")] {
        let report = json(&at.join("out").join(name).join("report.json"));
        assert_eq!(report["settings"]["scene"]["grid"][0].to_string(), grid);
    }
    // A wrong one is refused before the work on the others.
    std::fs::remove_dir_all(at.join("out")).unwrap();
    refused(fnopt(at, &[&["rollout", "a.json", "c.json"], &few[..]].concat()), &["c.json", "grid"]);
    refused(fnopt(at, &[&["rollout", "a.json", "./a.json"], &few[..]].concat()), &["another name", "a.json"]);
    assert!(!at.join("out").exists());
}
