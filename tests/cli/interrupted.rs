//! Ctrl-C ends runs that would spend minutes in Newton's method.

use super::command::{quiet, send, shipped, signals};
use std::io::BufRead;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Waits until a child handles Ctrl-C, and then a little longer, so that it is at work.
fn at_work(child: Child) -> Child {
    let begun = Instant::now();
    // SIGINT is signal 2, and so the second bit.
    let listens = || signals(&child.id().to_string(), "SigCgt:").is_some_and(|caught| caught & 2 != 0);
    while !listens() {
        assert!(begun.elapsed() < Duration::from_secs(60), "no handler of Ctrl-C within a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_secs(2));
    child
}

/// Interrupts a child and asserts that it ends soon, with the exit code for an interrupt.
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

/// The current frame is completed, so that the frames kept are whole. The first Ctrl-C is acknowledged at
/// once; the second ends the command without waiting.
#[test]
fn ctrl_c_is_heard_within_a_frame_too() {
    let folder = tempfile::tempdir().unwrap();
    let slow = ["rollout", "--grid", "64", "--iterations", "100000", "--device", "cpu", "--no-pictures"];
    let mut command = quiet(folder.path(), &slow);
    let mut child =
        at_work(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the command starts"));
    send("-INT", &child);
    let mut lines = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
    let said = lines.any(|line| line.unwrap().contains("again to end at once"));
    assert!(
        said && child.try_wait().unwrap().is_none(),
        "Ctrl-C was not acknowledged, or the frame had ended already"
    );
    send("-INT", &child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

/// Each of these runs has minutes of Newton's method ahead of it.
#[test]
fn ctrl_c_ends_whatever_is_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let truth = shipped();
    let truth = truth.to_str().unwrap();
    let spawn = |arguments: &[&str]| {
        let mut command = quiet(folder.path(), arguments);
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
    // Between the plots of the scores and the convergence plot.
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

/// The sizes that were timed until then are printed and plotted.
#[test]
fn ctrl_c_keeps_the_sizes_that_a_bench_has_timed() {
    // The first size takes a moment, the second half a minute; on a machine that is busy, each takes many times as long.
    for longer in [0, 5, 20, 60] {
        let folder = tempfile::tempdir().unwrap();
        let sizes = ["--device", "cpu", "--grid", "8,256", "--frames", "300", "--iterations", "1"];
        let mut bench = quiet(folder.path(), &[&["bench", "--json", "--plot", "p.png"], &sizes[..]].concat());
        let child = at_work(bench.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
        std::thread::sleep(Duration::from_secs(longer));
        send("-INT", &child);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130));
        let all: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let done: Vec<_> = all["rows"].as_array().unwrap().iter().map(|row| &row["grid"]).collect();
        assert!(all["failures"].as_array().unwrap().is_empty(), "{all}");
        if !done.is_empty() {
            assert_eq!(done, ["8x8"], "{all}");
            assert!(folder.path().join("p.png").is_file());
            return;
        }
    }
    panic!("the first size was not timed within a minute");
}
