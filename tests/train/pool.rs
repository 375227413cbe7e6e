//! Pools: which cloths are drawn, how long frames last, when cloths start over, how handles move.

use super::support::outcome;
use fnopt::cloth::{Grid, Material};
use fnopt::train::{Batch, MAX_HANDLES, MotionRanges, Outcome, Pool, PoolConfig, ResetRules, Script};
use std::collections::HashSet;

const GRID: Grid = Grid { h: 9, w: 12 };

fn config(iterations: u32, cloths: usize, batch: usize) -> PoolConfig {
    PoolConfig { grid: GRID, iterations, cloths, batch, ..PoolConfig::default() }
}

fn pool(config: PoolConfig, reset: ResetRules) -> Pool {
    Pool::new(0, 5, config, (MotionRanges::default(), reset))
}

/// Draws and records a batch in which all cloths do well.
fn step(pool: &mut Pool, step: u64) -> Batch {
    let batch = pool.draw(step);
    pool.record(&batch, &vec![outcome(1.0); batch.cloths.len()]);
    pool.rotate(step);
    batch
}

#[test]
fn draws_are_distinct_repeat_with_the_seed_and_reach_every_cloth() {
    let run = |seed| {
        let rules = (MotionRanges::default(), ResetRules::default());
        let mut pool = Pool::new(2, seed, config(3, 40, 10), rules);
        (0..40).map(|k| step(&mut pool, k)).collect::<Vec<_>>()
    };
    let batches = run(1);
    assert_eq!(batches, run(1));
    assert_ne!(batches, run(2));
    for batch in &batches {
        assert_eq!((batch.pool, batch.cloths.iter().map(|c| c.slot).collect::<HashSet<_>>().len()), (2, 10));
    }
    let seen: HashSet<usize> = batches.iter().flat_map(|b| &b.cloths).map(|c| c.slot).collect();
    assert_eq!(seen.len(), 40);
}

#[test]
fn a_frame_ends_after_its_iterations_and_handles_move_on() {
    let mut pool = pool(config(3, 2, 2), ResetRules::default());
    let mut targets = Vec::new();
    for k in 0..9 {
        let batch = step(&mut pool, k);
        let cloth = batch.cloths.iter().find(|c| c.slot == 0).unwrap();
        assert_eq!(cloth.start.is_some(), k == 0, "a life starts once");
        assert_eq!(cloth.advance, k % 3 == 2, "step {k}");
        targets.push(cloth.targets.clone());
    }
    // Targets are constant within a frame and follow the script from frame to frame.
    assert!(targets[0] == targets[2] && targets[3] == targets[5]);
    let script = Script::new(5, &MotionRanges::default(), (0, pool.config()), (0, 0));
    assert_eq!(targets[0], script.targets(1));
    assert_eq!(targets[8], script.targets(3));
}

#[test]
fn cloths_are_reset_in_turn() {
    let rules = |sequence_length| ResetRules { sequence_length, ..ResetRules::default() };
    resets_in_turn(pool(config(3, 4, 2), rules(20)));
    // A pool's own lives come before those of all pools.
    resets_in_turn(pool(PoolConfig { sequence_length: Some(20), ..config(3, 4, 2) }, rules(50)));
}

/// A life of 20 frames of 3 iterations, with 2 cloths per step: one cloth starts over every 30 steps.
fn resets_in_turn(mut pool: Pool) {
    let mut starts = vec![Vec::new(); 4];
    for k in 0..400 {
        for cloth in step(&mut pool, k).cloths.iter().filter(|c| c.start.is_some()) {
            starts[cloth.slot].push(k);
        }
    }
    for (slot, starts) in starts.iter().enumerate() {
        // A new life starts when the cloth is next drawn.
        let due: Vec<u64> =
            (0..13).filter(|turn| turn % 4 == slot as u64).map(|turn| 30 * (turn + 1)).collect();
        assert!(starts[0] < 10 && starts.len() == due.len() + 1, "slot {slot}: {starts:?}, due {due:?}");
        for (start, due) in starts[1..].iter().zip(due) {
            assert!((due..due + 15).contains(start), "slot {slot}: {start}, due {due}");
        }
    }
}

#[test]
fn a_pool_drawn_from_seldom_rotates_and_lives_as_long() {
    // As above, but only every third step draws: one cloth every 90 steps.
    let config = PoolConfig { every: 3, ..config(3, 4, 2) };
    let mut pool = pool(config.clone(), ResetRules { sequence_length: 20, ..ResetRules::default() });
    let mut starts = 0;
    for k in 0..900 {
        if pool.takes_part(k) {
            let batch = pool.draw(k);
            pool.record(&batch, &[outcome(1.0); 2]);
            starts += batch.cloths.iter().filter(|c| c.start.is_some()).count();
        }
        pool.rotate(k);
    }
    // The first lives, and one per turn. The cloth of the last turn may not have been drawn yet.
    assert!((13..=14).contains(&starts), "{starts} lives");
    let rules = (MotionRanges::default(), ResetRules::default());
    let other = Pool::new(1, 5, config, rules);
    assert!((0..9).all(|k| pool.takes_part(k) == (k % 3 == 0) && other.takes_part(k) == (k % 3 == 2)));
}

#[test]
fn broken_cloths_are_reset_with_the_same_material() {
    let rules = ResetRules { scale: Some([1e-3, 10.0]), ..ResetRules::default() };
    let good = outcome(1.0);
    let stretched =
        Outcome { energy: fnopt::cloth::EnergyTerms { stretch: 20_001.0, ..good.energy }, ..good };
    let cases: [(Outcome, bool); 6] = [
        (good, false),
        (stretched, true),
        (outcome(f64::NAN), true),
        (outcome(f64::INFINITY), true),
        (Outcome { scale: [1.0, 1e-4, 1.0], ..good }, true),
        (Outcome { scale: [1.0, 1.0, f64::NAN], ..good }, true),
    ];
    for (outcome, wrong) in cases {
        let mut pool = pool(config(2, 1, 1), rules);
        let first = pool.draw(0);
        pool.record(&first, &[outcome]);
        let next = pool.draw(1);
        assert_eq!(next.cloths[0].start.is_some(), wrong, "{outcome:?}");
        assert_eq!(next.cloths[0].advance, !wrong, "{outcome:?}");
        assert_eq!(next.cloths[0].cloth.material, first.cloths[0].cloth.material);
        assert_eq!(next.cloths[0].cloth.gravity != first.cloths[0].cloth.gravity, wrong, "a new life");
    }
}

fn scripts(motion: MotionRanges, count: usize) -> Vec<Script> {
    let pool = config(1, count, 1);
    (0..count).map(|slot| Script::new(11, &motion, (0, &pool), (slot, 0))).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn materials_and_handles_are_those_of_the_paper() {
    let scripts = scripts(MotionRanges::default(), 400);
    let mut extra = 0;
    for script in &scripts {
        let cloth = &script.cloth;
        let m = cloth.material;
        assert!((100.0..=1000.0).contains(&m.stretch) && (1.0..=100.0).contains(&m.shear));
        assert!((0.01..=10.0).contains(&m.bend));
        assert_eq!(cloth.handles[..2], [0, 8 * 12]);
        assert_eq!(cloth.handles.iter().collect::<HashSet<_>>().len(), cloth.handles.len());
        assert!(cloth.handles.len() <= MAX_HANDLES && cloth.handles.iter().all(|&p| p < 108));
        extra += cloth.handles.len() - 2;
        // A sheet of 8 edges: gravity is 8 / 31 of the paper's.
        assert!((distance(cloth.gravity, [0.0; 3]) - 0.125 * 8.0 / 31.0).abs() < 1e-12);
        // The start is a rotation, so lengths are unchanged.
        let start = script.targets(0);
        assert!((distance(start[0], start[1]) - 8.0).abs() < 1e-12);
        let rotated = script.start().map(|row| row[1] * -4.0);
        assert!(distance(rotated, start[0]) < 1e-12);
    }
    // Each further handle has probability 1/2, so there is one on average. An error of 0.25 in the mean of
    // 400 is 3.5 standard deviations.
    assert!((extra as f64 / 400.0 - 1.0).abs() < 0.25, "{extra} further handles");
    // Log-uniform: the means of the logarithms are in the middle of their ranges, to 3.5 standard deviations.
    let mean = |of: fn(&Material) -> f64| {
        scripts.iter().map(|script| of(&script.cloth.material).log10()).sum::<f64>() / 400.0
    };
    let means = [mean(|m| m.stretch), mean(|m| m.shear), mean(|m| m.bend)];
    for (mean, (middle, range)) in means.iter().zip([(2.5, 1.0), (1.0, 2.0), (-0.5, 3.0)]) {
        assert!((mean - middle).abs() < 0.05 * range, "{means:?}");
    }
    let moving = scripts.iter().filter(|s| s.targets(0) != s.targets(7)).count();
    assert!((280..=360).contains(&moving), "{moving} of 400 move");
}

#[test]
fn sheets_along_the_axes_and_held_anywhere_are_drawn_when_asked_for() {
    let aligned = MotionRanges { aligned: 1.0, corners: 0.0, more_handles: 0.0, ..Default::default() };
    let mut held = HashSet::new();
    for script in scripts(aligned, 400) {
        assert_eq!(script.start(), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert_eq!(script.cloth.gravity.iter().filter(|&&g| g == 0.0).count(), 2);
        assert!((distance(script.cloth.gravity, [0.0; 3]) - 0.125 * 8.0 / 31.0).abs() < 1e-12);
        assert_eq!(script.cloth.handles.len(), 1);
        held.insert(script.cloth.handles[0]);
    }
    assert!(held.len() > 90, "{} of 108 particles", held.len());
    let some = scripts(MotionRanges { aligned: 0.3, ..Default::default() }, 400);
    let along = some.iter().filter(|s| s.cloth.gravity.contains(&0.0)).count();
    assert!((84..=156).contains(&along), "{along} of 400");
}

#[test]
fn a_pool_may_have_its_own_handles() {
    // The motion specifies two corners, the pool one particle anywhere. Material and start are unchanged.
    let motion = MotionRanges { more_handles: 0.0, ..Default::default() };
    let anywhere = PoolConfig { corners: Some(0.0), ..config(1, 50, 1) };
    for (slot, corners) in scripts(motion, 50).into_iter().enumerate() {
        let script = Script::new(11, &motion, (0, &anywhere), (slot, 0));
        assert_eq!((corners.cloth.handles.len(), script.cloth.handles.len()), (2, 1));
        assert_eq!(script.cloth.material, corners.cloth.material);
        assert_eq!(script.start(), corners.start());
    }
}

#[test]
fn lives_are_damped_when_asked_for_and_else_the_same() {
    let [free, damped] =
        [0.0, 0.05].map(|damping| scripts(MotionRanges { damping, ..Default::default() }, 200));
    assert!(free.iter().all(|script| script.damping == 0.0));
    let mean = damped.iter().map(|script| script.damping).sum::<f64>() / 200.0;
    assert!(
        damped.iter().all(|s| (0.0..0.05).contains(&s.damping)) && (mean - 0.025).abs() < 0.004,
        "{mean}"
    );
    for (free, mut damped) in free.into_iter().zip(damped) {
        damped.damping = 0.0;
        assert_eq!(damped, free);
    }
}

#[test]
fn handles_turn_translate_and_pinch_as_told() {
    let still = MotionRanges { moving: 1.0, rotation: 0.0, amplitude: 0.0, pinch: 0.0, ..Default::default() };
    for script in scripts(still, 10) {
        assert_eq!(script.targets(0), script.targets(13));
    }
    let largest = |motion: MotionRanges, what: &dyn Fn(&Script, u32) -> f64| {
        scripts(motion, 200).iter().flat_map(|s| (0..200).map(|f| what(s, f))).fold(0.0, f64::max)
    };
    // Translation: all handles move alike, within the amplitude on each axis, 8/31 of the paper's.
    let sway = |s: &Script, f: u32| {
        let (at, start) = (s.targets(f), s.targets(0));
        let moved = |k: usize| [0, 1, 2].map(|c| at[k][c] - start[k][c]);
        assert!(distance(moved(0), moved(1)) < 1e-9);
        moved(0).into_iter().fold(0.0, |a: f64, b| a.max(b.abs()))
    };
    let reached = largest(MotionRanges { amplitude: 10.0, ..still }, &sway);
    assert!(reached <= 10.0 * 8.0 / 31.0 && reached > 2.3, "{reached}");
    // Pinch: the corners, 8 apart, come as close as 0.2 of that.
    let gap = |s: &Script, f: u32| 8.0 - distance(s.targets(f)[0], s.targets(f)[1]);
    let reached = largest(MotionRanges { pinch: 0.4, ..still }, &gap);
    assert!(reached <= 0.8 * 8.0 + 1e-9 && reached > 0.78 * 8.0, "{reached}");
    // Rotation: by at most the increment about each of three axes; the corner is 4 from the axis.
    let turn = |s: &Script, f: u32| distance(s.targets(f)[0], s.targets(f + 1)[0]);
    let reached = largest(MotionRanges { rotation: 0.0628, ..still }, &turn);
    assert!(reached <= 4.0 * 3.0 * 0.0628 && reached > 0.2, "{reached}");
}
