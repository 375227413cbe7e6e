//! `draw`, `advance` and `store` against their definitions.

use super::cloth::{field, iterate, model, targets, upload};
use crate::common::{ROUNDING, assert_close, context, device, noise, poisoned, read, run, tensor};
use fnopt::cloth::{Grid, Role, State};
use fnopt::gpu::Tensor;
use fnopt::kernels::cloth::StateTensors;
use fnopt::kernels::train::{Advance, BatchTensors, Draw, Drawn, PoolTensors, Store};

const GRID: Grid = Grid { h: 9, w: 13 };
/// Cloths of the pool, and the slots drawn: the middle one starts over, the last one ends its frame.
const CLOTHS: usize = 5;
const SLOTS: [usize; 3] = [4, 0, 2];

fn drawn() -> Tensor {
    let rotation = [[0.0, -1.0, 0.0, 9.0], [0.6, 0.0, 0.8, 9.0], [0.8, 0.0, -0.6, 9.0]];
    let drawn = SLOTS.map(|slot| Drawn {
        slot: slot as u32,
        begin: u32::from(slot == 0),
        advance: u32::from(slot == 2),
        keep: 0.75,
        rotation,
    });
    Tensor::from_slice(context(), "drawn", &[3, 16], &drawn).unwrap()
}

#[test]
fn cloths_leave_their_pool_and_come_back() {
    let _turn = device();
    let (draw, store) = (Draw::new(context()).unwrap(), Store::new(context()).unwrap());
    let n = GRID.particles();
    let (fields, scales) = (noise(CLOTHS * 15 * n, 131), noise(CLOTHS * 3, 132));
    let pool = tensor("pool", &[CLOTHS, 5, 3, n], &fields);
    let pool_scale = tensor("scale", &[CLOTHS, 3], &scales);
    let [x, v, a] = [(); 3].map(|()| poisoned("batch", &[3, 3, n]));
    let (hidden, scale) = (poisoned("hidden", &[2, 9, n]), poisoned("scale", &[9]));
    let batch = BatchTensors { x: &x, v: &v, a: &a, hidden: &hidden, scale: &scale };
    let tensors = PoolTensors { fields: &pool, scale: &pool_scale };
    let drawn = drawn();
    run(|schedule| draw.push(schedule, (GRID, 0.05), (&drawn, tensors), batch));
    // Field k of a slot in the pool.
    let of_pool = |fields: &[f32], k: usize, slot: usize| fields[(5 * slot + k) * 3 * n..][..3 * n].to_vec();
    let memory = read(&hidden);
    let (last_grad, last_step) = memory.split_at(9 * n);
    let found = [read(&x), read(&v), read(&a), last_grad.to_vec(), last_step.to_vec()];
    for (place, slot) in SLOTS.into_iter().enumerate().filter(|(_, slot)| *slot != 0) {
        for (k, found) in found.iter().enumerate() {
            assert_eq!(found[place * 3 * n..][..3 * n], of_pool(&fields, k, slot), "field {k}");
        }
        assert_eq!(read(&scale)[3 * place..][..3], scales[3 * slot..][..3]);
    }
    // A cloth that starts over: the positions are those of the sheet at rest, rotated; other fields are zero.
    let rest = State::<f64>::rest(GRID, 1).x;
    let rotated: Vec<f64> = [[0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]]
        .iter()
        .flat_map(|row| (0..n).map(|p| (0..3).map(|c| row[c] * rest[c * n + p]).sum()).collect::<Vec<f64>>())
        .collect();
    assert_close("start", &found[0][3 * n..][..3 * n], &rotated, (4.0 * ROUNDING, 4.0 * ROUNDING));
    assert!(found[1..].iter().all(|field| field[3 * n..][..3 * n].iter().all(|&v| v == 0.0)));
    assert_eq!(read(&scale)[3..6], [0.05; 3]);

    // Other values return to the same places, and nothing else changes.
    let next = [141, 142, 143, 144, 145].map(|seed| noise(9 * n, seed));
    for (tensor, values) in [&x, &v, &a].into_iter().zip(&next) {
        tensor.write(context(), values);
    }
    hidden.write(context(), &[&next[3][..], &next[4]].concat());
    let scale_next = noise(9, 146);
    scale.write(context(), &scale_next);
    run(|schedule| store.push(schedule, GRID, (&drawn, tensors), batch));
    let (mut fields, mut scales) = (fields, scales);
    for (place, slot) in SLOTS.into_iter().enumerate() {
        for (k, next) in next.iter().enumerate() {
            fields[(5 * slot + k) * 3 * n..][..3 * n].copy_from_slice(&next[place * 3 * n..][..3 * n]);
        }
        scales[3 * slot..][..3].copy_from_slice(&scale_next[3 * place..][..3]);
    }
    assert_eq!((read(&pool), read(&pool_scale)), (fields, scales));
}

/// Kernels run without bounds checks, so they bound slots themselves.
#[test]
fn slots_beyond_the_pool_are_the_last() {
    let _turn = device();
    let (draw, store) = (Draw::new(context()).unwrap(), Store::new(context()).unwrap());
    let n = GRID.particles();
    let (fields, scales) = (noise(CLOTHS * 15 * n, 131), noise(CLOTHS * 3, 132));
    let pool = tensor("pool", &[CLOTHS, 5, 3, n], &fields);
    let pool_scale = tensor("scale", &[CLOTHS, 3], &scales);
    let [x, v, a] = [(); 3].map(|()| poisoned("batch", &[3, 3, n]));
    let (hidden, scale) = (poisoned("hidden", &[2, 9, n]), poisoned("scale", &[9]));
    let batch = BatchTensors { x: &x, v: &v, a: &a, hidden: &hidden, scale: &scale };
    let tensors = PoolTensors { fields: &pool, scale: &pool_scale };
    let beyond = [CLOTHS as u32, 1 << 20, u32::MAX].map(|slot| Drawn {
        slot,
        begin: 0,
        advance: 0,
        keep: 1.0,
        rotation: [[0.0; 4]; 3],
    });
    let drawn = Tensor::from_slice(context(), "drawn", &[3, 16], &beyond).unwrap();
    run(|schedule| draw.push(schedule, (GRID, 0.05), (&drawn, tensors), batch));
    let last = (CLOTHS - 1) * 15 * n;
    assert!(read(&x).chunks_exact(3 * n).all(|cloth| cloth == &fields[last..][..3 * n]));
    // All three are stored in the same place, so they must be equal.
    let next = noise(3 * n, 141);
    [&x, &v, &a].iter().for_each(|tensor| tensor.write(context(), &next.repeat(3)));
    hidden.write(context(), &next.repeat(6));
    scale.write(context(), &[0.25f32; 9]);
    run(|schedule| store.push(schedule, GRID, (&drawn, tensors), batch));
    let (mut stored, mut stored_scales) = (fields, scales);
    stored[last..].copy_from_slice(&next.repeat(5));
    stored_scales[3 * (CLOTHS - 1)..].fill(0.25);
    assert_eq!((read(&pool), read(&pool_scale)), (stored, stored_scales));
}

#[test]
fn frames_end_where_they_are_due() {
    let _turn = device();
    let kernel = Advance::new(context()).unwrap();
    let model = model(GRID, 3);
    let (n, marks, targets) = (GRID.particles(), model.marks(), targets(&model));
    let [x, v, a, base] = [151, 152, 153, 154].map(|seed| field(&model, 1.0, seed));
    let [mut next_x, mut next_v, mut next_a] = [x.clone(), v.clone(), a.clone()];
    for k in 6 * n..9 * n {
        let role = marks[2 * n + k % n].role();
        next_a[k] = 0.0;
        let shift = base[k] + a[k];
        next_v[k] = if role == Role::Free { 0.75 * shift } else { 0.0 };
        next_x[k] = match role {
            Role::Handle(handle) => targets[handle][k / n % 3],
            Role::Free | Role::Outside => x[k] + shift,
        };
    }
    let iterate = iterate(&model);
    iterate.a.write(context(), &a);
    iterate.base.write(context(), &base);
    let [x, v] = [x, v].map(|values| upload("state", &model, &values));
    let targets = tensor("targets", &[model.handles(), 3], targets.as_flattened());
    let drawn = drawn();
    let state = StateTensors { x: &x, v: &v, targets: &targets };
    run(|schedule| kernel.push(schedule, &drawn, state, &iterate));
    assert_eq!((read(&x), read(&v), read(&iterate.a)), (next_x, next_v, next_a));
}
