//! Tables of scores.

use crate::common::{SETTINGS, newton, shipped};
use fnopt::Device;
use fnopt::eval::Table;
use fnopt::eval::{Entry, Format, Nudge, OverRepeats, Score, Sequence, compare, run, tables};
use fnopt::sim::Optimizer;
use std::ops::ControlFlow;

#[test]
fn a_solver_that_diverges_has_no_numbers() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let descent = Optimizer::descent(1e3);
    let entry = Entry { name: "gd".into(), optimizer: descent, iterations: 10, coarse: false };
    let tick = || ControlFlow::Continue(());
    let (diverged, _) =
        run((&sequence, None), sequence.grid(), &entry, (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap();
    assert!(!diverged.stable && diverged.e_cd.is_none() && diverged.ms_per_frame.is_none());
    let (good, _) =
        run((&sequence, None), sequence.grid(), &newton(), (&Device::Cpu, &SETTINGS), tick).unwrap().unwrap();
    // Many columns are split into parts.
    let many: Vec<Score> = (1..12).map(|n| Score { iterations: 1000 * n, ..good.clone() }).collect();
    for table in tables(&many) {
        let text = table.write(Format::Text { bold: false });
        assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
    }
    // Alone, it has dashes, too.
    let alone = tables(std::slice::from_ref(&diverged));
    let text = alone[0].write(Format::Text { bold: false });
    let row = text.lines().find(|line| line.starts_with("xy_v2")).unwrap();
    assert!(alone[0].title.contains("e_CD") && row.ends_with('-'), "{text}");
    assert_eq!((good.unconverged, diverged.unconverged), (Some(0), None));
    let tables = tables(&[good.clone(), diverged]);
    let text = tables[0].write(Format::Text { bold: true });
    let row = text.lines().find(|line| line.starts_with("xy_v2")).unwrap();
    assert!(row.ends_with('-') && row.contains("\x1b[1m"), "{row}");
    let markdown = tables[0].write(Format::Markdown);
    assert!(
        markdown.contains("| sequence | newton | gd, N = 10 |") && markdown.contains("| - |"),
        "{markdown}"
    );
    let csv = tables[0].write(Format::Csv);
    assert!(csv.contains("sequence,newton,\"gd, N = 10\""), "{csv}");
    // The means over the sequences, and the terms of the energy.
    let of =
        |title: &str| tables.iter().find(|t| t.title == title).unwrap().write(Format::Text { bold: false });
    let overview = of("error and time");
    assert!(overview.contains("±") && overview.contains("ms/frame"), "{overview}");
    let energy = of("energy and stretch");
    assert!(["bend", "inertia", "mean stretch"].iter().all(|head| energy.contains(head)), "{energy}");
    let terms = good.energy_terms.unwrap();
    assert!((terms.total() / good.energy.unwrap() - 1.0).abs() < 1e-9 && good.stretch_mean.unwrap() > 0.0);
}

/// Deviations over repeats are distinguished from those over sequences.
#[test]
fn tables_have_means_over_repeats() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let itself = compare(&sequence, "arcsim", &sequence.truth, &SETTINGS).unwrap();
    let score = |name: &str, repeat: u64, e_cd: f64| {
        let mut score =
            Score { sequence: name.into(), solver: newton().name, e_cd: Some(1e-3 * e_cd), ..itself.clone() };
        score.made_with.nudge = Nudge::of(repeat);
        score
    };
    let mut scores =
        vec![score("a", 0, 1.0), score("b", 0, 5.0), score("a", 1, 3.0), score("b", 1, 5.0), itself.clone()];
    let written = |scores: &[Score]| -> Vec<String> {
        tables(scores)
            .iter()
            .map(|table| format!("# {}\n{}", table.title, table.write(Format::Csv)))
            .collect()
    };
    let csv = written(&scores);
    assert_eq!(
        csv[0],
        "# 32x32: e_CD x 10^3 [m^2], means over repeats\nsequence,newton,arcsim\na,2.00,\nb,5.00,\n\
         xy_v2,,"
            .to_owned()
            + &format!("{:.2}\n", 1e3 * itself.e_cd.unwrap())
            + &format!("mean,3.50,{:.2}\ndeviation,2.12,\n", 1e3 * itself.e_cd.unwrap())
    );
    // The deviation of 1 and 3 is the root of 2. A single simulation has none.
    assert_eq!(
        csv[1],
        "# 32x32: e_CD x 10^3 [m^2], deviations over repeats\nsequence,newton,arcsim\na,1.41,\nb,0.00,\n\
         xy_v2,,\nroot mean square,1.00,\n"
    );
    let overview = csv.iter().find(|text| text.starts_with("# error and time")).unwrap();
    assert!(overview.contains("solver,sequences,simulations,e_CD x 10^3 [m^2],±,± repeats,"), "{overview}");
    assert!(overview.contains("32x32 newton,2,4,3.50,2.12,1.00,"), "{overview}");
    let over = OverRepeats::of(&scores[0], &scores);
    assert_eq!((over.repeats, over.gradient), (2, None));
    let [mean, deviation] = over.e_cd.unwrap();
    assert!((mean - 2e-3).abs() < 1e-12 && (deviation - 2f64.sqrt() * 1e-3).abs() < 1e-12);
    // If one repeat diverged, there is no number.
    scores[2] = Score { stable: false, e_cd: None, ..scores[2].clone() };
    let csv = written(&scores);
    assert!(csv[0].contains("\na,-,\n") && csv[0].contains("\nmean,-,"), "{}", csv[0]);
    assert!(csv[1].contains("\na,-,\nb,0.00,\n") && csv[1].contains("square,-,"), "{}", csv[1]);
    // Without repeats, the tables do not mention them.
    scores.retain(|s| s.made_with.nudge.is_none());
    assert!(written(&scores).iter().all(|text| !text.contains("repeats")));
}

/// As in Tables 7 and 8 of the paper, if there are several grids or iteration counts.
#[test]
fn errors_stand_by_iterations_and_grid() {
    let sequence = Sequence::load(&shipped(), "xy_v2").unwrap();
    let itself = compare(&sequence, "itself", &sequence.truth, &SETTINGS).unwrap();
    let score = |name: &str, (grid, iterations): (&str, usize), e_cd: f64| Score {
        sequence: name.into(),
        grid: grid.into(),
        solver: "lbfgs".into(),
        iterations,
        e_cd: Some(1e-3 * e_cd),
        e_3d: Some(1e-2 * (e_cd + 1.0)),
        ms_per_frame: Some(iterations as f64),
        ..itself.clone()
    };
    let mut scores = Vec::new();
    // Merged files are ordered by name: 10 before 5.
    for (grid, error) in [("32x32", 0.0), ("64x64", 4.0)] {
        for (name, more) in [("a", 1.0), ("b", 3.0)] {
            for iterations in [10, 5] {
                scores.push(score(name, (grid, iterations), error + more + 10.0 / iterations as f64));
            }
        }
    }
    scores.push(Score { stable: false, e_cd: None, e_3d: None, ..score("b", ("64x64", 20), 0.0) });
    let newton = Score { solver: "newton".into(), ..score("a", ("32x32", 0), 1.0) };
    scores.push(newton.clone());
    let written = |scores: &[Score], start: &str| {
        let all = tables(scores);
        let text = |table: &Table| format!("# {}\n{}", table.title, table.write(Format::Csv));
        all.iter().map(text).find(|text| text.starts_with(start))
    };
    assert_eq!(
        written(&scores, "# lbfgs: ").unwrap(),
        "# lbfgs: e_CD x 10^3 [m^2] (e_3D x 10^2)\n\
         sequence,\"32x32, N = 5\",\"32x32, N = 10\",\"64x64, N = 5\",\"64x64, N = 10\",\"64x64, N = 20\"\n\
         a,3.00 (4.00),2.00 (3.00),7.00 (8.00),6.00 (7.00),\n\
         b,5.00 (6.00),4.00 (5.00),9.00 (10.00),8.00 (9.00),-\n\
         mean,4.00 (5.00),3.00 (4.00),8.00 (9.00),7.00 (8.00),-\n\
         deviation,1.41 (1.41),1.41 (1.41),1.41 (1.41),1.41 (1.41),\n"
    );
    assert_eq!(
        written(&scores, "# time and error").unwrap(),
        "# time and error by iterations and grid\n\
         solver,32x32 ms/frame,±,64x64 ms/frame,±,32x32 e_CD x 10^3 [m^2],±,64x64 e_CD x 10^3 [m^2],±\n\
         \"lbfgs, N = 5\",5.0,0.0,5.0,0.0,4.00,1.41,8.00,1.41\n\
         \"lbfgs, N = 10\",10.0,0.0,10.0,0.0,3.00,1.41,7.00,1.41\n\
         \"lbfgs, N = 20\",,,-,,,,-,\n\
         newton,0.0,,,,1.00,,,\n"
    );
    // With a single iteration count on a single grid there is neither table.
    assert_eq!(written(&scores, "# newton: "), None);
    assert_eq!(written(&[newton, scores[0].clone()], "# time and error"), None);
}
