//! `cell_count`, `cell_scan`, `cell_fill` and `cell_order` against the CPU path.

use super::cloth::{Doubles, OnDevice, crumpled, field, model, repelling};
use crate::common::{ROUNDING, cases, context, device, run};
use fnopt::cpu::cloth;
use fnopt::kernels::cloth::{Cells, buckets};

/// Every particle appears once, at the position of the trial, in its cell's bucket, which is sorted by
/// number.
#[test]
fn particles_are_sorted_by_cells() {
    let _turn = device();
    for (grid, batch) in cases() {
        let (model, n) = (repelling(&model(grid, batch)), grid.particles());
        let (a, base) = (field(&model, 0.1, 73), field(&model, 0.1, 79));
        let x = crumpled(&model, 0.4);
        let on_device = OnDevice::new(&model, [&x, &base, &a, &a]);
        let cells = Cells::new(context(), batch, grid).unwrap();
        cells.ends.write(context(), &vec![u32::MAX; cells.ends.len()]);
        cells.sorted.write(context(), &vec![f32::NAN; cells.sorted.len()]);
        // Twice, since nothing of the first run may be left.
        (0..2).for_each(|_| run(|schedule| cells.push(schedule, on_device.trial())));
        let sorted = cells.sorted.read::<[f32; 4]>(context()).unwrap();
        let ends = cells.ends.read::<u32>(context()).unwrap();
        let doubles = Doubles::new(&model, [&x, &base, &a, &a]);
        for b in 0..batch {
            let what = format!("cloth {b} of {batch} x {grid}");
            let (sorted, ends) = (&sorted[b * n..][..n], &ends[b * buckets(grid)..][..buckets(grid)]);
            assert!(ends.is_sorted() && ends[buckets(grid) - 1] as usize == n, "{what}");
            let side = model.cloths[b].repulsion.map_or(1.0, |repulsion| repulsion.distance);
            let expected = cloth::Cells::new(&doubles.cloth(b), side);
            let mut bucket_of = vec![None; n];
            let begins = [0].into_iter().chain(ends.iter().copied());
            for (bucket, (begin, &end)) in begins.zip(ends).enumerate() {
                let numbers: Vec<u32> =
                    sorted[begin as usize..end as usize].iter().map(|p| p[3].to_bits()).collect();
                assert!(numbers.is_sorted(), "bucket {bucket} of {what}: {numbers:?}");
                numbers
                    .iter()
                    .for_each(|&p| assert_eq!(bucket_of[p as usize].replace(bucket), None, "{what}"));
            }
            let mut place_of = vec![[0.0; 3]; n];
            sorted.iter().for_each(|p| place_of[p[3].to_bits() as usize] = [p[0], p[1], p[2]]);
            for pair in expected.sorted().windows(2) {
                let [one, next] = [&pair[0], &pair[1]];
                // A particle at the border of its cell may be rounded into the next one.
                let inside = |p: &cloth::Placed<f64>| {
                    p.place.iter().all(|x| ((x / side) - (x / side).round()).abs() > 1e-4)
                };
                if one.cell == next.cell && inside(one) && inside(next) {
                    assert_eq!(bucket_of[one.particle], bucket_of[next.particle], "{what}");
                }
                for (&found, expected) in place_of[one.particle].iter().zip(one.place) {
                    let off = (f64::from(found) - expected).abs();
                    assert!(
                        off <= 2.0 * ROUNDING * (expected.abs() + 1.0),
                        "{what}: {found}, not {expected}"
                    );
                }
            }
        }
    }
}
