//! Ctrl-C ends what would take minutes of Newton's method.

use super::command::{quiet, send, shipped};
use std::io::BufRead;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Waits until a child listens to Ctrl-C, and a little more, so that it is at work.
fn at_work(child: Child) -> Child {
    let begun = Instant::now();
    let listens = || {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        // The second bit is that of SIGINT.
        caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 2 != 0)
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

/// A frame is not cut short, so that what is kept is whole; but it is said, and the second time nothing is waited for.
#[test]
fn ctrl_c_is_heard_within_a_frame_too() {
    let folder = tempfile::tempdir().unwrap();
    let slow = ["rollout", "--grid", "64", "--iterations", "100000", "--device", "cpu", "--no-pictures"];
    let mut command = quiet(folder.path(), &slow);
    let mut child =
        at_work(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the command starts"));
    send("-INT", &child);
    let mut told = std::io::BufReader::new(child.stderr.take().unwrap()).lines();
    let said = told.any(|line| line.unwrap().contains("again to end at once"));
    assert!(said && child.try_wait().unwrap().is_none(), "nothing is said, or the frame was over");
    send("-INT", &child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

/// Each of these has minutes of Newton's method before it.
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
