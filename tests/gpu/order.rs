//! No result depends on the order in which a device runs invocations and workgroups.

use crate::common::{context, device, half, noise, poisoned, read, run, tensor};
use crate::folding::bent;
use crate::repelling::crowded;
use crate::solver::{assert_same, starter, step, tuned, varied_batch};
use crate::touching::{GRID, touching};
use fnopt::cloth::{Grid, State};
use fnopt::gpu::{Context, Order, Sharing, Tuning};
use fnopt::kernels::fft::{Fields, RealFft2};
use fnopt::settings::Norm;
use fnopt::sim::{Optimizer, Solver};

/// The device's order and the others.
pub const ORDERS: [Order; 3] = [Order::Natural, Order::Reversed, Order::Scattered];

/// Frames of all optimizers, with repulsion, with self-contact, with angles at rest, with rows longer than a workgroup, and in 16 bits.
#[test]
fn frames_have_the_same_bits_in_every_order() {
    let _turn = device();
    let compare =
        |context: &Context, (model, start, control), optimizer: &Optimizer, tuning: Option<Tuning>| {
            let context =
                tuning.map_or_else(|| context.clone(), |tuning| context.with_tuning(tuning).unwrap());
            // Where operands are broadcast, a block sums rows over subgroups, and so in another order.
            let broadcast = context.tuning().sharing == Sharing::Broadcast;
            let sums_differ = broadcast && optimizer.weights().is_some();
            let orders = if sums_differ { &ORDERS[..2] } else { &ORDERS[..] };
            let mut ends = orders.iter().map(|&order| {
                let solver = Solver::new(&context.with_order(order), &model, optimizer, 3).unwrap();
                solver.set_state(&start);
                step(&solver, &control);
                let end = step(&solver, &control);
                let what = format!("{} on {}, {order:?}", optimizer.name(), model.grid);
                (what, [end.x, end.v].into_iter().chain(solver.statistics_tensors().map(read)).collect())
            });
            let (_, natural): (String, Vec<Vec<f32>>) = ends.next().unwrap();
            for (what, end) in ends {
                end.iter().zip(&natural).for_each(|(other, natural)| assert_same(&what, other, natural));
            }
        };
    for (optimizer, tuning) in tuned() {
        compare(context(), varied_batch(), &optimizer, Some(tuning));
    }
    for optimizer in [Optimizer::spectral(), Optimizer::gradient_descent()] {
        compare(context(), crowded(), &optimizer, None);
    }
    compare(context(), touching(GRID), &Optimizer::spectral(), None);
    compare(context(), bent(GRID), &Optimizer::spectral(), None);
    let learned = Optimizer::paper(starter().clone());
    let long = Grid { h: 9, w: 1100 };
    let (mut model, _, mut control) = varied_batch();
    let start = State::rest(long, 3);
    model.grid = long;
    for cloth in &mut model.cloths {
        (cloth.mask, cloth.density, cloth.stiffness) = (None, None, None);
        cloth.handles.clear();
    }
    (control.handles, control.external) = (vec![], vec![]);
    compare(context(), (model, start, control), &learned, None);
    if let Some(half) = half() {
        compare(&half, varied_batch(), &learned, None);
    }
}

#[test]
fn transforms_have_the_same_bits_in_every_order() {
    let _turn = device();
    for [h, w] in [[33, 47], [64, 64], [3, 1009], [100, 100]] {
        let fields = Fields { batch: 2, h, w };
        let x = tensor("x", &[2, h, w], &noise(2 * h * w, 8));
        let [natural, others @ ..] = ORDERS.map(|order| {
            let plan = RealFft2::new(&context().with_order(order), fields, Norm::Forward).unwrap();
            let (spectrum, again) =
                (poisoned("spectrum", &plan.spectrum_shape()), poisoned("again", &[2, h, w]));
            run(|schedule| {
                plan.push_forward(schedule, &x, &spectrum);
                plan.push_inverse(schedule, &spectrum, &again);
            });
            [read(&spectrum), read(&again)]
        });
        for (order, other) in ORDERS[1..].iter().zip(others) {
            let pairs = other.iter().zip(&natural);
            pairs.for_each(|(other, natural)| assert_same(&format!("{h}x{w}, {order:?}"), other, natural));
        }
    }
}
