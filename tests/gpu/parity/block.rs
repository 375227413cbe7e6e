//! `block` against its formula: inverse rows, skip, bias and activation. What it computes from its rows is
//! compared with the formulas of the kernels that do only that.

use super::features::sums;
use super::operator::{MODES, activate, activations, config, copies, dense, head, layer, turn};
use crate::common::{
    self, ROUNDING, assert_close, cases, cases_in_turn, context, device, largest, noise, poisoned, read,
    read_channels, read_unpadded, run, tensor,
};
use fnopt::cloth::{Grid, Mark};
use fnopt::gpu::{Tensor, Tuning};
use fnopt::kernels::operator::block::{hidden_units, with_head};
use fnopt::kernels::operator::{Block, BlockTensors, Epilogue, Inputs, Layer, LayerSize, Lifting};
use fnopt::kernels::optim::{FeatureInputs, Features, Iterate};
use fnopt::kernels::padded;
use fnopt::network::tables;

const CHANNELS: usize = 64;

/// Adds the inverse transform of the rows `r` [S, H, 2 modes_w, C] to `y` [S, C, H, W].
fn add_inverse_rows(y: &mut [f64], r: &[f32], modes_w: usize, grid: Grid) {
    let Grid { h, w } = grid;
    for (index, y) in y.iter_mut().enumerate() {
        let (j, i, c, s) = (index % w, index / w % h, index / (w * h) % CHANNELS, index / (w * h * CHANNELS));
        let r = |k: usize| f64::from(r[((s * h + i) * 2 * modes_w + k) * CHANNELS + c]);
        for m in 0..modes_w {
            let (cos, sin) = turn(m as i64, j, w);
            *y += copies(m, w) * (r(2 * m) * cos - r(2 * m + 1) * sin);
        }
    }
}

/// Returns the tunings with activations in buffers, which can be read back.
fn tunings() -> [Tuning; 5] {
    common::tunings().map(|tuning| Tuning { texels: false, ..tuning })
}

/// Returns the size of a block on `grid`.
fn size(grid: Grid, modes_w: usize) -> LayerSize {
    LayerSize { row_quads: padded(grid.w) / 4, modes_w, channels: CHANNELS, lifting: None }
}

#[test]
fn blocks_of_all_tiles_match() {
    let _turn = device();
    for tuning in tunings() {
        for (gelu, modes) in [(false, MODES[1]), (true, MODES[0])] {
            for (grid, batch) in cases() {
                let config = config(modes, CHANNELS);
                let columns = 2 * config.modes_w;
                let (x, x_tensor) = activations(batch, CHANNELS, grid, 0.5);
                let (weight, bias, skip) = layer(CHANNELS, CHANNELS, tuning.channels);
                let r = noise(batch * grid.h * columns * CHANNELS, 21);
                let mut expected = dense(&weight, &bias, &x, grid.particles());
                add_inverse_rows(&mut expected, &r, config.modes_w, grid);
                activate(&mut expected, gelu);
                let w = padded(grid.w);
                let table = tensor("table", &[columns, w], &tables::inverse_rows(&config, grid.w));
                let r = tensor("r", &[batch, grid.h, columns, CHANNELS], &r);
                let y = poisoned("y", &[batch, grid.h, CHANNELS, w]);
                let epilogue = Epilogue { gelu, ..Epilogue::default() };
                let kernel = Block::new(context(), &tuning, size(grid, config.modes_w), epilogue).unwrap();
                let tensors = BlockTensors {
                    x: Inputs::Stored(&x_tensor),
                    r: &r,
                    y: &y,
                    rows_or_field: None,
                    rows_max: None,
                };
                run(|schedule| kernel.push(schedule, &skip, (&table, grid.w), tensors));
                let what = format!("block {} gelu {gelu} {batch} x {grid}", tuning.channels);
                // One rounding per product, of sums about as large as the result.
                let atol = (7.0 * ROUNDING + if gelu { 3e-7 } else { 0.0 }) * largest(&expected);
                assert_close(&what, &read_channels(&y, grid), &expected, (atol, ROUNDING));
                assert!(read(&y).iter().all(|y| y.is_finite()), "the padding stays finite");
            }
        }
    }
}

/// Returns the spectra [S, H, 2 modes_w, C] and the maxima [S, H, C] of the rows of `y` [S, C, H, W].
fn of_rows(y: &[f32], modes_w: usize, grid: Grid) -> (Vec<f64>, Vec<f32>) {
    let Grid { h, w } = grid;
    let samples = y.len() / (CHANNELS * h * w);
    let (mut spectra, mut largest) = (Vec::new(), Vec::new());
    for (s, i) in (0..samples).flat_map(|s| (0..h).map(move |i| (s, i))) {
        let row = |c: usize| &y[((s * CHANNELS + c) * h + i) * w..][..w];
        for k in 0..2 * modes_w {
            spectra.extend((0..CHANNELS).map(|c| {
                let wave = |j: usize| {
                    let (cos, sin) = turn((k / 2) as i64, j, w);
                    if k % 2 == 0 { cos } else { -sin }
                };
                let sum: f64 = row(c).iter().enumerate().map(|(j, &y)| f64::from(y) * wave(j)).sum();
                sum / (h * w) as f64
            }));
        }
        largest.extend((0..CHANNELS).map(|c| row(c).iter().copied().fold(f32::NEG_INFINITY, f32::max)));
    }
    (spectra, largest)
}

/// Blocks that also transform and pool their rows have the same output to the bit, and the spectra and maxima
/// that the other kernels would compute from it.
#[test]
fn blocks_that_take_rows_match() {
    let _turn = device();
    let variants = [(true, false, MODES[1]), (true, true, MODES[0]), (false, true, MODES[0])];
    for (turn, tuning) in tunings().into_iter().enumerate() {
        let tuning = Tuning { rows_in_blocks: true, ..tuning };
        for (variant, (rows, pool, modes)) in variants.into_iter().enumerate() {
            for (grid, batch) in cases_in_turn(turn + variant, 1) {
                let config = config(modes, CHANNELS);
                let (columns, w) = (2 * config.modes_w, padded(grid.w));
                let size = size(grid, config.modes_w);
                assert!(Block::takes_rows(context(), &tuning, &size), "{grid} fits a workgroup");
                let (_, x) = activations(batch, CHANNELS, grid, 0.5);
                let (_, _, skip) = layer(CHANNELS, CHANNELS, tuning.channels);
                let shape = [batch, grid.h, columns, CHANNELS];
                let r = tensor("r", &shape, &noise(shape.iter().product(), 21));
                let inverse = tables::inverse_rows(&config, grid.w);
                let table = tensor("table", &[columns, w], &inverse);
                let both = [inverse, tables::forward_rows(&config, grid.h, grid.w)].concat();
                let both = tensor("tables", &[2, columns, w], &both);
                let [alone, y] = [(); 2].map(|()| poisoned("y", x.shape()));
                let spectra = poisoned("rows", &shape);
                let most = poisoned("rows_max", &[batch, grid.h, CHANNELS]);
                let none = BlockTensors {
                    x: Inputs::Stored(&x),
                    r: &r,
                    y: &alone,
                    rows_or_field: None,
                    rows_max: None,
                };
                let (wanted, maxima) = (rows.then_some(&spectra), pool.then_some(&most));
                let some = BlockTensors { y: &y, rows_or_field: wanted, rows_max: maxima, ..none };
                for (epilogue, tables, tensors) in [
                    (Epilogue { gelu: true, ..Epilogue::default() }, &table, none),
                    (
                        Epilogue { gelu: true, rows, pool, field: false },
                        if rows { &both } else { &table },
                        some,
                    ),
                ] {
                    let kernel = Block::new(context(), &tuning, size, epilogue).unwrap();
                    run(|schedule| kernel.push(schedule, &skip, (tables, grid.w), tensors));
                }
                let what = format!("block {} with rows {batch} x {grid}", tuning.channels);
                assert_eq!(read(&y), read(&alone), "{what}");
                let (expected, expected_most) = of_rows(&read_channels(&y, grid), config.modes_w, grid);
                if rows {
                    let atol = ROUNDING * (grid.w as f64).sqrt() * largest(&expected);
                    assert_close(&what, &read(&spectra), &expected, (atol, 0.0));
                }
                if pool {
                    assert_eq!(read(&most), expected_most, "{what}");
                }
            }
        }
    }
}

/// A lifting and a block that write texels, and blocks that read them, compute the same bits as in buffers.
#[test]
fn activations_in_texels_are_the_same() {
    let _turn = device();
    const HIDDEN: usize = 32;
    let [software, hardware, ..] = tunings();
    for (turn, tuning) in [software, hardware].into_iter().enumerate() {
        for (grid, batch) in cases_in_turn(2 * turn, 2) {
            let config = config(MODES[0], CHANNELS);
            let (columns, w) = (2 * config.modes_w, padded(grid.w));
            let (_, _, outer) = layer(CHANNELS, HIDDEN, tuning.channels);
            let (_, _, skip) = layer(CHANNELS, CHANNELS, tuning.channels);
            let (_, x) = activations(batch, 5, grid, 0.0);
            let units = hidden_units(&noise(HIDDEN * 5, 15), &noise(HIDDEN, 16));
            let units = tensor("hidden units", &[HIDDEN, units.len() / HIDDEN], &units);
            let shape = [batch, grid.h, columns, CHANNELS];
            let r = tensor("r", &shape, &noise(shape.iter().product(), 21));
            let table = tensor("table", &[columns, w], &tables::inverse_rows(&config, grid.w));
            let size = size(grid, config.modes_w);
            let lifting = Some(Lifting { hidden: HIDDEN, inputs: 5, of_fields: false });
            let head = layer(1, CHANNELS, 1).2.weight.read(context()).unwrap();
            let with_head = with_head(&noise(CHANNELS, 13), (&head, 0.1));
            let with_head = Layer {
                bias: tensor("bias and head", &[with_head.len()], &with_head),
                weight: skip.weight.clone(),
            };
            let fields = [false, true].map(|texels| {
                let tuning = Tuning { texels, ..tuning };
                let built = |size, epilogue| Block::new(context(), &tuning, size, epilogue).unwrap();
                let lifted = built(LayerSize { lifting, ..size }, Epilogue::default());
                let plain = built(size, Epilogue { gelu: true, ..Epilogue::default() });
                let last = built(size, Epilogue { gelu: true, field: true, ..Epilogue::default() });
                let y: [Tensor; 3] = [(); 3].map(|()| match texels {
                    true => Tensor::texels(context(), "y", &[batch, grid.h, CHANNELS, w]),
                    false => poisoned("y", &[batch, grid.h, CHANNELS, w]),
                });
                let field = poisoned("field", &[last.field_parts(), batch, grid.h, w]);
                let of = |x, r, y| BlockTensors { x, r, y, rows_or_field: None, rows_max: None };
                run(|schedule| {
                    let tables = (&table, grid.w);
                    lifted.push(schedule, &outer, tables, of(Inputs::Stored(&x), &units, &y[0]));
                    plain.push(schedule, &skip, tables, of(Inputs::Stored(&y[0]), &r, &y[1]));
                    let tensors = of(Inputs::Stored(&y[1]), &r, &y[2]);
                    let tensors = BlockTensors { rows_or_field: Some(&field), ..tensors };
                    last.push(schedule, &with_head, tables, tensors);
                });
                read_unpadded(&field, grid)
            });
            assert_eq!(fields[0], fields[1], "{} {batch} x {grid}", tuning.channels);
            assert!(fields[0].iter().all(|value| value.is_finite()), "{} {batch} x {grid}", tuning.channels);
        }
    }
}

/// Blocks that end in the field head: the parts add up to the head's layer applied to the block's output.
#[test]
fn blocks_with_the_field_head_match() {
    let _turn = device();
    for tuning in tunings() {
        for (grid, batch) in cases() {
            let config = config(MODES[0], CHANNELS);
            let (columns, w) = (2 * config.modes_w, padded(grid.w));
            let (_, x) = activations(batch, CHANNELS, grid, 0.5);
            let (_, bias, skip) = layer(CHANNELS, CHANNELS, tuning.channels);
            let (head, head_bias, _) = head(CHANNELS);
            let shape = [batch, grid.h, columns, CHANNELS];
            let r = tensor("r", &shape, &noise(shape.iter().product(), 21));
            let table = tensor("table", &[columns, w], &tables::inverse_rows(&config, grid.w));
            let y = poisoned("y", x.shape());
            let alone = Epilogue { gelu: true, ..Epilogue::default() };
            let [alone, fused] = [alone, Epilogue { field: true, ..alone }].map(|epilogue| {
                Block::new(context(), &tuning, size(grid, config.modes_w), epilogue).unwrap()
            });
            let tensors =
                BlockTensors { x: Inputs::Stored(&x), r: &r, y: &y, rows_or_field: None, rows_max: None };
            run(|schedule| alone.push(schedule, &skip, (&table, grid.w), tensors));
            let with_head = with_head(&bias, (&head, head_bias));
            let with_head = Layer {
                bias: tensor("bias and head", &[with_head.len()], &with_head),
                weight: skip.weight.clone(),
            };
            let parts = fused.field_parts();
            let field = poisoned("field", &[parts, batch, grid.h, w]);
            let tensors = BlockTensors { rows_or_field: Some(&field), ..tensors };
            run(|schedule| fused.push(schedule, &with_head, (&table, grid.w), tensors));
            let expected = dense(&head, &[head_bias], &read_channels(&y, grid), grid.particles());
            let found = read_unpadded(&field, grid);
            let sum = |at: usize| found[at..].iter().step_by(expected.len()).sum::<f32>();
            let sums: Vec<f32> = (0..expected.len()).map(sum).collect();
            let what = format!("block {} with the field head in {parts} {batch} x {grid}", tuning.channels);
            let atol = ROUNDING * (CHANNELS as f64).sqrt() * largest(&expected);
            assert_close(&what, &sums, &expected, (atol, 0.0));
        }
    }
}

/// The fused lifting agrees with the formulas of its two pointwise layers, and the spectra of its rows with
/// that of its output.
#[test]
fn liftings_match() {
    let _turn = device();
    const HIDDEN: usize = 64;
    let mut with_rows = 0;
    // Without staging, registers hold an embedded quad, always of five channels.
    let counts =
        |tuning: Tuning| if tuning.staged { vec![(tuning, 5), (tuning, 3)] } else { vec![(tuning, 5)] };
    for (turn, (tuning, inputs)) in tunings().into_iter().flat_map(counts).enumerate() {
        for (grid, batch) in cases_in_turn(turn, 2) {
            let config = config(MODES[0], CHANNELS);
            let (columns, w) = (2 * config.modes_w, padded(grid.w));
            let (x, x_tensor) = activations(batch, inputs, grid, 0.0);
            let (inner, inner_bias) = (noise(HIDDEN * inputs, 15), noise(HIDDEN, 16));
            let (weight, bias, outer) = layer(CHANNELS, HIDDEN, tuning.channels);
            let mut hidden = dense(&inner, &inner_bias, &x, grid.particles());
            activate(&mut hidden, true);
            let hidden: Vec<f32> = hidden.iter().map(|&v| v as f32).collect();
            let expected = dense(&weight, &bias, &hidden, grid.particles());
            let units = hidden_units(&inner, &inner_bias);
            let units = tensor("hidden units", &[HIDDEN, units.len() / HIDDEN], &units);
            let table = tables::forward_rows(&config, grid.h, grid.w);
            let table = tensor("table", &[w / 4, columns, 4], &table);
            let y = poisoned("y", &[batch, grid.h, CHANNELS, w]);
            let spectra = poisoned("rows", &[batch, grid.h, columns, CHANNELS]);
            let lifting = Lifting { hidden: HIDDEN, inputs, of_fields: false };
            let size = LayerSize { lifting: Some(lifting), ..size(grid, config.modes_w) };
            let rows = Block::takes_rows(context(), &tuning, &size);
            let epilogue = Epilogue { rows, ..Epilogue::default() };
            let kernel = Block::new(context(), &tuning, size, epilogue).unwrap();
            let rows_or_field = rows.then_some(&spectra);
            let tensors = BlockTensors {
                x: Inputs::Stored(&x_tensor),
                r: &units,
                y: &y,
                rows_or_field,
                rows_max: None,
            };
            run(|schedule| kernel.push(schedule, &outer, (&table, grid.w), tensors));
            let what = format!("lifting {} of {inputs} {batch} x {grid}", tuning.channels);
            let atol = (8.0 * ROUNDING + 3e-7) * largest(&expected);
            assert_close(&what, &read_channels(&y, grid), &expected, (atol, ROUNDING));
            if rows {
                with_rows += 1;
                let (expected, _) = of_rows(&read_channels(&y, grid), config.modes_w, grid);
                let atol = ROUNDING * (grid.w as f64).sqrt() * largest(&expected);
                assert_close(&what, &read(&spectra), &expected, (atol, 0.0));
            }
        }
    }
    assert!(with_rows > 0, "no lifting transforms its rows");
}

/// Liftings that embed their input agree with liftings of features that another kernel embeds.
#[test]
fn liftings_of_fields_match() {
    let _turn = device();
    const HIDDEN: usize = 64;
    let features = Features::new(context()).unwrap();
    let mut with_rows = 0;
    let staged = tunings().into_iter().find(|tuning| tuning.staged).unwrap();
    // Several workgroups per row, each with some of the channels.
    let narrow = Tuning { rows_in_blocks: false, block_wide: 8, block_deep: 2, ..staged };
    for (turn, tuning) in tunings().into_iter().chain([narrow]).enumerate() {
        for (grid, batch) in cases_in_turn(turn, 2) {
            let config = config(MODES[0], CHANNELS);
            let (columns, w, n, samples) = (2 * config.modes_w, padded(grid.w), grid.particles(), 3 * batch);
            let iterate = Iterate::with_hidden(context(), batch, &vec![Mark::default(); batch * n]).unwrap();
            let [grad, hidden] = [noise(samples * n, 17), noise(2 * samples * n, 18)];
            iterate.grad.write(context(), &grad);
            iterate.hidden_state().write(context(), &hidden);
            let squares = sums(grid, samples, [&grad, &hidden[samples * n..]]);
            let shape = [samples, squares.len() / samples / 2, 2];
            // A view, like the rows of a solver's iterations.
            let rows = tensor("sums", &[64 + squares.len()], &[vec![f32::NAN; 64], squares].concat());
            let sums = &rows.view(64, &shape);
            let inner = hidden_units(&noise(HIDDEN * 5, 15), &noise(HIDDEN, 16));
            let units = tensor("hidden units", &[HIDDEN, inner.len() / HIDDEN], &inner);
            let (_, _, outer) = layer(CHANNELS, HIDDEN, tuning.channels);
            let table = tables::forward_rows(&config, grid.h, grid.w);
            let table = tensor("table", &[w / 4, columns, 4], &table);
            for (first, count) in [(0, samples), (1, samples - 2)] {
                let from = FeatureInputs { iterate: &iterate, sums, first };
                let embedded = poisoned("embedded", &[count, grid.h, 5, w]);
                run(|schedule| features.push(schedule, grid, from, &embedded));
                let results = [Inputs::Stored(&embedded), Inputs::Fields(from)].map(|x| {
                    let of_fields = matches!(x, Inputs::Fields(_));
                    let lifting = Lifting { hidden: HIDDEN, inputs: 5, of_fields };
                    let size = LayerSize { lifting: Some(lifting), ..size(grid, config.modes_w) };
                    let rows = Block::takes_rows(context(), &tuning, &size);
                    let kernel =
                        Block::new(context(), &tuning, size, Epilogue { rows, ..Epilogue::default() })
                            .unwrap();
                    let y = poisoned("y", &[count, grid.h, CHANNELS, w]);
                    let spectra = poisoned("rows", &[count, grid.h, columns, CHANNELS]);
                    let rows_or_field = rows.then_some(&spectra);
                    let tensors = BlockTensors { x, r: &units, y: &y, rows_or_field, rows_max: None };
                    run(|schedule| kernel.push(schedule, &outer, (&table, grid.w), tensors));
                    with_rows += usize::from(rows && of_fields);
                    (read(&y), if rows { read(&spectra) } else { Vec::new() })
                });
                let [(y, spectra), (found, found_spectra)] = results;
                let what = format!("lifting of fields {} {first} {batch} x {grid}", tuning.channels);
                let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
                let close = |found: &[f32], expected: &[f32]| {
                    let expected = wide(expected);
                    assert_close(&what, found, &expected, (8.0 * ROUNDING * largest(&expected), 0.0));
                };
                close(&found, &y);
                close(&found_spectra, &spectra[..found_spectra.len()]);
            }
        }
    }
    assert!(with_rows > 0, "no lifting of fields transforms its rows");
}
