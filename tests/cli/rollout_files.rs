//! What the files of `fnopt rollout` hold: which frames, at which rate, and how exactly.

use super::command::{done, fnopt, json, refused, refused_cleanly};
use fnopt::io::Trajectory;
use std::path::Path;
use std::process::Output;

const FEW: [&str; 8] =
    ["rollout", "--device", "cpu", "--solver", "spectral", "--no-pictures", "--grid", "12"];

fn rollout(folder: &Path, more: &[&str]) -> Output {
    fnopt(folder, &[&FEW[..], more].concat())
}

fn read(path: impl AsRef<Path>) -> Trajectory {
    Trajectory::read(path, &Default::default()).unwrap()
}

#[test]
fn files_hold_every_nth_frame() {
    let folder = tempfile::tempdir().unwrap();
    let at = |file: &str| folder.path().join(file);
    done(rollout(folder.path(), &["--frames", "50", "--out", "all"]));
    let some = ["--frames", "50", "--every", "4", "--format", "npz,pc2,mdd,obj,usda,glb", "--out", "some"];
    let (said, _) = done(rollout(folder.path(), &some));
    assert!(said.contains("50 at 12x12, 13 of them in the files"), "{said}");
    let all = read(at("all/rollout.npz"));
    for file in ["rollout.npz", "rollout.mdd", "rollout.pc2", "rollout_obj"] {
        let kept = read(at("some").join(file));
        assert_eq!(kept.frames(), 13, "{file}");
        (0..13).for_each(|k| assert_eq!(kept.frame(k), all.frame(4 * k), "{file}"));
        // Other formats do not know.
        let fps = if file.ends_with("npz") || file.ends_with("mdd") { 15.0 } else { 60.0 };
        assert!((kept.fps() - fps).abs() < 1e-6, "{file}: {}", kept.fps());
    }
    let report = json(&at("some/report.json"));
    assert_eq!((&report["frames"], &report["settings"]["every"]), (&50.into(), &4.into()));
    assert_eq!(report["per_frame"].as_array().unwrap().len(), 49);
    for file in ["rollout.usda", "rollout.glb"] {
        assert!(report["files"].as_array().unwrap().contains(&file.into()), "{file}");
    }
    let usd = std::fs::read_to_string(at("some/rollout.usda")).unwrap();
    assert!(usd.contains("timeCodesPerSecond = 15\n") && usd.contains("endTimeCode = 12\n"));

    // The rate is what the files say, and the first frame has the number that they say.
    let rate = [
        "--fps",
        "24",
        "--start-frame",
        "1001",
        "--frames",
        "3",
        "--format",
        "npz,usda,obj",
        "--out",
        "rate",
    ];
    done(rollout(folder.path(), &rate));
    assert_eq!(read(at("rate/rollout.npz")).fps(), 24.0);
    let usd = std::fs::read_to_string(at("rate/rollout.usda")).unwrap();
    assert!(usd.contains("timeCodesPerSecond = 24\n") && usd.contains("startTimeCode = 1001\n"));
    assert!(at("rate/rollout_obj/01003.obj").exists());
}

/// Whatever the file leaves out, a rollout goes on from where it ended.
#[test]
fn a_rollout_of_every_nth_frame_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let at = |file: &str| folder.path().join(file);
    for (name, options) in
        [("every", &["--every", "4"][..]), ("half", &["--every", "3", "--half", "--compress", "--fps", "24"])]
    {
        let run = |more: &[&str]| rollout(folder.path(), &[options, more].concat());
        let (whole, half) = (format!("{name}/whole"), format!("{name}/half"));
        done(run(&["--frames", "50", "--out", &whole]));
        // Ends at a frame that is not in the file.
        done(run(&["--frames", "36", "--out", &half]));
        let file = format!("{half}/rollout.npz");
        for (wrong, said) in [
            (&["--every", "7"][..], &["every: expected 7 (--every), found"][..]),
            (&["--fps", "10"], &["fps: expected 10, found"]),
        ] {
            // The last one given counts.
            let command: Vec<&str> =
                [&FEW[..], &["--frames", "50", "--continue", &file, "--out", "no"], wrong].concat();
            let others: Vec<&str> =
                options.chunks(2).filter(|pair| pair[0] != wrong[0]).flatten().copied().collect();
            refused(fnopt(folder.path(), &[&command[..], &others].concat()), said);
        }
        done(run(&["--frames", "50", "--continue", &file, "--out", &half]));
        let bytes = |out: &str| std::fs::read(at(out).join("rollout.npz")).unwrap();
        assert!(bytes(&half) == bytes(&whole), "{name}");
        let report = json(&at(&half).join("report.json"));
        assert_eq!((&report["frames"], &report["per_frame"][0]["frame"]), (&50.into(), &36.into()));
    }
    let file = at("half/half/rollout.npz").display().to_string();
    let exact = ["--every", "3", "--fps", "24", "--frames", "60", "--continue", &file];
    refused(rollout(folder.path(), &exact), &["numbers: expected 32 bits (without --half), found 16 bits"]);
}

/// Before anything is simulated or written.
#[test]
fn options_that_do_not_fit_the_formats_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (more, said) in [
        (
            &["--frames", "3000", "--format", "glb"][..],
            &["--format: glb: expected at most 2049 frames", "3000"][..],
        ),
        (
            &["--grid", "512", "--format", "npz,glb"],
            &["--format: glb: expected at most 1.0 GiB", "found 2.3 GiB"],
        ),
        (
            &["--half", "--format", "pc2"],
            &["--half: --format: expected npz or npy, which it is about, found pc2"],
        ),
        (&["--compress", "--format", "npy"], &["--compress: --format: expected npz"]),
        (&["--start-frame", "1"], &["--start-frame: --format: expected pc2 or usda or obj or ply", "npz"]),
        (&["--fps", "0"], &["--fps: value: expected a number above 0, found 0"]),
        (&["--every", "0"], &["0 is not in 1..=1000000"]),
        (&["--format", "usd"], &["unknown format 'usd' (did you mean usda"]),
        (&["--format", "gltf"], &["unknown format 'gltf' (did you mean glb"]),
    ] {
        let few: Vec<&str> = FEW[..6].iter().chain(more).copied().collect();
        refused_cleanly(folder.path(), &few, said);
    }
    // With fewer frames it fits.
    done(rollout(folder.path(), &["--frames", "2100", "--every", "2000", "--format", "glb"]));
    refused(
        fnopt(folder.path(), &["inspect", "out/rollout.glb"]),
        &["rollout.glb", "glb, which is written only"],
    );
}

/// Files for other programs have the mesh that the cloth carries along; those that simulations go on from the particles.
#[test]
fn files_hold_the_mesh_that_the_cloth_carries() {
    let folder = tempfile::tempdir().unwrap();
    let at = |file: &str| folder.path().join(file);
    let write = |file: &str, text: &str| std::fs::write(at(file), text).unwrap();
    let flag = "v 0 0 0\nv 0 0 1\nv 1 0 1\nv 1 0 0\nv 2 0 0\n\
        vt 1 0\nvt 1 1\nvt 0.5 1\nvt 0.5 0\nvt 0 0.5\nf 1/1 2/2 3/3 4/4\nf 4/4 3/3 5/5\n";
    write("flag.obj", flag);
    write("flag.json", r#"{"mesh": "flag.obj", "grid": [12, 12], "frames": 6}"#);
    let run = |more: &[&str]| fnopt(folder.path(), &[&["rollout", "flag.json"], &FEW[1..6], more].concat());
    let formats = "npz,obj,ply,usda,glb,pc2";
    done(run(&["--format", formats, "--out", "whole"]));
    let whole = read(at("whole/rollout.npz"));
    assert_eq!(whole.positions().shape(), [6, 144, 3]);
    let obj = fnopt::io::RenderMesh::read(at("whole/rollout_obj/00005.obj")).unwrap();
    assert_eq!(obj.topology().faces().collect::<Vec<_>>(), [&[0, 1, 2, 3][..], &[3, 2, 4]]);
    // Its second vertex is particle (0, 0), the first is (0, 11), and the last lies between rows.
    assert_eq!(obj.positions()[1], whole.frame(5)[0]);
    assert_eq!(obj.positions()[0], whole.frame(5)[11]);
    let usd = std::fs::read_to_string(at("whole/rollout.usda")).unwrap();
    assert!(usd.contains("faceVertexCounts = [4, 3]"));
    assert!(usd.contains("primvars:st = [(1, 0), (1, 1), (0.5, 1), (0.5, 0), (0, 0.5)]"));
    assert_eq!(std::fs::metadata(at("whole/rollout.pc2")).unwrap().len(), 32 + 6 * 5 * 12);
    let cached = fnopt::io::RenderMesh::read(at("whole/rollout.obj")).unwrap();
    assert_eq!(cached.topology(), obj.topology());

    // It goes on to the same bits, and the mesh with it.
    done(run(&["--frames", "3", "--out", "half"]));
    done(run(&["--continue", "half/rollout.npz", "--format", formats, "--out", "half"]));
    for file in ["rollout.npz", "rollout.usda", "rollout.glb", "rollout.pc2", "rollout_ply/00005.ply"] {
        let bytes = |out: &str| std::fs::read(at(out).join(file)).unwrap();
        assert!(bytes("half") == bytes("whole"), "{file}");
    }
    // A mesh is not overwritten by the files of a run that reads it.
    write("rollout.obj", flag);
    write("own.json", r#"{"mesh": "rollout.obj", "grid": [12, 12], "frames": 2}"#);
    let own = ["rollout", "own.json", "--format", "pc2", "--out", "."];
    refused(fnopt(folder.path(), &own), &["--out: folder", "rollout.obj"]);
    write("bare.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n");
    write("bare.json", r#"{"mesh": "bare.obj"}"#);
    refused(fnopt(folder.path(), &["rollout", "bare.json"]), &["bare.obj", "a mesh without UVs"]);
}
