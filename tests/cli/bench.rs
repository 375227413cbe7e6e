//! `fnopt bench`: what it reports, and what is kept when a size fails.

use super::command::{exploding_bench, fnopt, refused_cleanly, text};

fn parsed(output: &[u8]) -> serde_json::Value {
    serde_json::from_slice(output).unwrap_or_else(|e| panic!("{e}: {}", text(output)))
}

#[test]
fn results_say_what_made_them() {
    let folder = tempfile::tempdir().unwrap();
    let on_cpu = |arguments: &[&str]| {
        let output =
            fnopt(folder.path(), &[&["bench", "--device", "cpu", "--frames", "2"], arguments].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        output.stdout
    };
    let learned = parsed(&on_cpu(&["--grid", " 8,12X8,8", "--iterations", "3", "--plot", "p.png", "--json"]));
    assert_eq!(learned["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!((&learned["solver"], &learned["frames"]), (&"fnopt".into(), &2.into()));
    assert_eq!((&learned["precision"], &learned["tuning"]), (&"f32".into(), &serde_json::Value::Null));
    assert_eq!(learned["weights_crc32"].as_str().unwrap().len(), 8);
    let rows = learned["rows"].as_array().unwrap();
    assert_eq!(rows.iter().map(|row| row["grid"].as_str().unwrap()).collect::<Vec<_>>(), ["8x8", "12x8"]);
    for row in rows {
        assert_eq!(row["iterations"], 3);
        let (rate, peak) =
            (row["gflop_per_s"].as_f64().unwrap(), learned["peak_gflop_per_s"].as_f64().unwrap());
        assert!(0.0 < rate && rate < 1.05 * peak, "{rate} of {peak} GFLOP/s");
    }
    assert!(folder.path().join("p.png").is_file());
    assert_eq!(rows[0]["ms_frames"].as_array().unwrap().len(), 2);

    let file = folder.path().join("before.json");
    std::fs::write(&file, learned.to_string()).unwrap();
    let again = ["--grid", "8,16", "--iterations", "3", "--against", "before.json", "--json"];
    let again = parsed(&on_cpu(&again));
    let ratio = again["rows"][0]["ratio"].as_f64().unwrap();
    let times = [&again, &learned].map(|all| all["rows"][0]["ms_per_frame"].as_f64().unwrap());
    assert!((ratio - times[0] / times[1]).abs() < 1e-9 && again["rows"][1]["ratio"].is_null(), "{again}");

    // Several solvers take turns at each size.
    let both = [
        "--grid",
        "8,12",
        "--solver",
        "gd:2, lbfgs,gd:2",
        "--iterations",
        "3",
        "--json",
        "--plot",
        "both.png",
    ];
    let both = parsed(&on_cpu(&both));
    let (of, rows) = (&both["solver"], both["rows"].as_array().unwrap());
    let kinds: Vec<_> = rows.iter().map(|row| [&row["grid"], &row["solver"], &row["iterations"]]).collect();
    let expected =
        |grid: &str| [("gd:2", 2), ("lbfgs", 3)].map(|(name, n)| [grid.into(), name.into(), n.into()]);
    let expected: Vec<[serde_json::Value; 3]> = ["8x8", "12x12"].into_iter().flat_map(expected).collect();
    assert_eq!(kinds, expected.iter().map(|kind| kind.each_ref()).collect::<Vec<_>>());
    assert_eq!(of, "gd:2,lbfgs");
    // Each is compared with itself, in any order.
    std::fs::write(folder.path().join("both.json"), both.to_string()).unwrap();
    let later = on_cpu(&[
        "--grid",
        "8",
        "--solver",
        "lbfgs,spectral",
        "--iterations",
        "3",
        "--against",
        "both.json",
        "--json",
    ]);
    let later = parsed(&later);
    let ratio = later["rows"][0]["ratio"].as_f64().unwrap();
    let times = [&later["rows"][0], &both["rows"][1]].map(|row| row["ms_per_frame"].as_f64().unwrap());
    assert!((ratio - times[0] / times[1]).abs() < 1e-9 && later["rows"][1]["ratio"].is_null(), "{later}");
    let printed = on_cpu(&["--grid", "8", "--solver", "gd:1,lbfgs:1"]);
    assert!(text(&printed).starts_with("gd:1 on 8x8 batch 1, 1 iteration: "), "{}", text(&printed));

    let newton = on_cpu(&["--grid", "8", "--solver", "newton"]);
    assert!(text(&newton).starts_with("8x8 batch 1, to convergence: "), "{}", text(&newton));
    let newton = parsed(&on_cpu(&["--grid", "8", "--solver", "newton", "--json", "--plot", "newton.png"]));
    let row = &newton["rows"][0];
    assert!(row["iterations"].is_null() && row["gflop_per_s"].is_null() && newton["weights_crc32"].is_null());
    assert!(folder.path().join("newton.png").is_file());
}

#[test]
fn an_earlier_bench_must_have_a_size_in_common() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("none.json"), r#"{"rows": [{"grid": "9x9", "batch": 1}]}"#).unwrap();
    std::fs::write(
        folder.path().join("other.json"),
        r#"{"rows": [{"grid": "9x9", "batch": 1, "ms_per_frame": 1}]}"#,
    )
    .unwrap();
    for (file, said) in [
        ("none.json", "each with \"ms_per_frame\""),
        ("other.json", "a row of 1 x 8x8"),
        ("no", "no: cannot read"),
    ] {
        refused_cleanly(
            folder.path(),
            &["bench", "--device", "cpu", "--grid", "8", "--against", file],
            &[said],
        );
    }
}

/// An adapter's peak bounds what a frame reaches there.
#[test]
fn an_adapter_is_measured_with_its_tuning() {
    let folder = tempfile::tempdir().unwrap();
    let on = ["--device", "gpu", "--adapter", "llvmpipe", "--grid", "16", "--frames", "2", "--json"];
    let output = fnopt(folder.path(), &[&["bench"], &on[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let all = parsed(&output.stdout);
    assert_eq!(all["tuning"]["texels"], true, "{all}");
    let (rate, peak) =
        (all["rows"][0]["gflop_per_s"].as_f64().unwrap(), all["peak_gflop_per_s"].as_f64().unwrap());
    assert!(0.0 < rate && rate < peak, "{rate} of {peak} GFLOP/s");
}

#[test]
fn a_size_that_fails_is_reported_once_and_the_others_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let output = fnopt(folder.path(), &[exploding_bench("64x8,8x64"), vec!["--json"]].concat());
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("error: 1 of 2 sizes could not be timed"), "{said}");
    assert_eq!(said.matches("became non-finite").count(), 1, "{said}");
    let all = parsed(&output.stdout);
    assert_eq!(all["rows"].as_array().unwrap().len(), 1, "{all}");
    let failure = &all["failures"][0];
    assert!(failure["error"].as_str().unwrap().contains("became non-finite"), "{all}");
    assert_eq!((&failure["batch"], all["failures"].as_array().unwrap().len()), (&1.into(), 1));
    // Also if no size is left.
    let output = fnopt(folder.path(), &[exploding_bench("64x8"), vec!["--json"]].concat());
    let all = parsed(&output.stdout);
    let counts = ["rows", "failures"].map(|what| all[what].as_array().unwrap().len());
    assert_eq!((output.status.code(), counts), (Some(3), [0, 1]), "{all}");
}
