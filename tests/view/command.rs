//! `fnopt view`.

use std::path::Path;
use std::process::{Command, Output};

fn view(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fnopt"));
    command.current_dir(folder).arg("view").args(arguments).env("FNOPT_CACHE", folder.join("cache"));
    for name in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"] {
        command.env_remove(name);
    }
    command.output().unwrap()
}

#[test]
fn a_screenshot_needs_no_window() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shot.png");
    let arguments =
        ["--screenshot", "shot.png", "--frames", "2", "--size", "640x360", "--adapter", "llvmpipe"];
    let scene = ["scene.json", "--solver", "spectral", "--iterations", "2"];
    std::fs::write(folder.path().join("scene.json"), r#"{"grid": [16, 16]}"#).unwrap();
    let output = view(folder.path(), &[&scene[..], &arguments].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.width, info.height), (640, 360));
    // The cloth is petrol blue or sand, the background grey.
    let coloured = pixels.chunks_exact(3).filter(|p| p[0].abs_diff(p[2]) > 40).count();
    assert!(coloured > 2_000, "{coloured}");
}

#[test]
fn what_cannot_be_shown_is_refused_before_a_window_opens() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bad.npz"), b"PK").unwrap();
    let cases: [(&[&str], &[&str]); 8] = [
        (&["spere"], &["did you mean sphere"]),
        (&["none.json"], &["none.json", "cannot read"]),
        (&["bad.npz"], &["bad.npz"]),
        (&["--solver", "newton"], &["--solver", "runs on a GPU", "newton"]),
        (&["--size", "640"], &["--size", "WxH", "640"]),
        (&["--size", "640x0"], &["--size", "1 to 8192"]),
        (&["sphere", "--up", "z"], &["--up", "none for a scene"]),
        (&["--frames", "3"], &["--screenshot"]),
    ];
    for (arguments, expected) in cases {
        let output = view(folder.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(expected.iter().all(|part| text.contains(part)), "{arguments:?}: {text}");
    }
    // The folder has what was written into it, and nothing else.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
#[cfg(target_os = "linux")]
fn without_a_display_the_command_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let output = view(folder.path(), &[]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("cannot open a window") && text.contains("--screenshot"), "{text}");
    assert!(!text.contains("panicked") && !text.contains(".rs:"), "{text}");
}
