//! The forward pass of the network: against the CPU path stage by stage, with every tile, and in parts.

use crate::common::{
    assert_close, by_rows, context, device, half, largest, narrow, noise, read, read_channels, read_unpadded,
    tunings, widened,
};
use crate::solver::starter;
use fnopt::cloth::Grid;
use fnopt::cpu::operator::{Network, Stage};
use fnopt::gpu::{Context, Schedule, Storage, Tensor, Tuning};
use fnopt::network::{Backward, Block, Config, Dense, Forward, Head, Keep, Parameters, Plan, Weights};

/// Returns random weights, scaled to keep activations at about 1.
pub fn random(config: Config) -> Weights {
    let values = |len: usize, inputs: usize, seed: u64| -> Vec<f32> {
        noise(len, seed).iter().map(|v| v * (3.0 / inputs as f32).sqrt()).collect()
    };
    let dense = |outputs: usize, inputs: usize, seed: u64| Dense {
        weight: values(outputs * inputs, inputs, seed),
        bias: values(outputs, 10, seed + 1),
    };
    let (l, c, p) = (config.lifting, config.channels, config.projection);
    let block = |k: u64| Block {
        spectral: values(c * c * config.modes() * 2, c, 10 * k + 1),
        bias: values(c, 10, 10 * k + 2),
        skip: values(c * c, c, 10 * k + 3),
    };
    Weights {
        config,
        lifting: [dense(l, config.inputs(), 101), dense(c, l, 103)],
        blocks: (0..config.layers as u64).map(block).collect(),
        projection: [dense(p, c, 105), dense(1, p, 107)],
        scalar: dense(1, c, 109),
    }
}

/// The results of the stages of a forward pass, without padding.
struct Pass {
    lifted: Vec<f32>,
    blocks: Vec<Vec<f32>>,
    field: Vec<f32>,
    scalar: Vec<f32>,
}

/// Returns the sum of the parts of a field, without padding.
fn added_up(field: &Tensor, grid: Grid) -> Vec<f32> {
    let parts = read_unpadded(field, grid);
    let one = parts.len() / field.shape()[0];
    (0..one).map(|at| parts[at..].iter().step_by(one).sum()).collect()
}

/// Builds a pass over `fields` and submits it.
fn submit_pass(
    weights: &Weights,
    tuning: &Tuning,
    shape: (Grid, usize),
    (fields, keep): (&[f32], Keep),
) -> Forward {
    submit_pass_on(context(), weights, tuning, shape, (fields, keep))
}

fn submit_pass_on(
    context: &Context,
    weights: &Weights,
    tuning: &Tuning,
    shape: (Grid, usize),
    (fields, keep): (&[f32], Keep),
) -> Forward {
    let (grid, samples) = shape;
    let plan = Plan { grid, samples, tuning: *tuning, keep };
    let pass = context.checked(|| Forward::new(context, weights, &plan)).unwrap();
    let n = grid.particles();
    let mut embedded = Vec::new();
    for fields in fields.chunks_exact(weights.config.fields * n) {
        embedded.extend_from_slice(fields);
        embedded.extend((0..n).map(|p| (p / grid.w) as f32 / (grid.h - 1) as f32));
        embedded.extend((0..n).map(|p| (p % grid.w) as f32 / (grid.w - 1) as f32));
    }
    pass.embedded.write_narrowed(context, &by_rows(&embedded, weights.config.inputs(), grid, 0.0));
    let mut schedule = Schedule::new(context);
    pass.push(&mut schedule, None, Head::Store);
    context.submit(|encoder| schedule.record(encoder));
    pass
}

fn forward(weights: &Weights, tuning: &Tuning, (grid, samples): (Grid, usize), fields: &[f32]) -> Pass {
    let (config, n) = (weights.config, grid.particles());
    let pass = submit_pass(weights, tuning, (grid, samples), (fields, Keep::Blocks));
    // Channels that pad a tile come last in each sample.
    let channels = |i: usize| -> Vec<f32> {
        let activation = pass.activation(i);
        let stored = activation.shape()[2] * n;
        let all = read_channels(activation, grid);
        all.chunks_exact(stored).flat_map(|sample| &sample[..config.channels * n]).copied().collect()
    };
    Pass {
        lifted: channels(0),
        blocks: (1..=config.layers).map(channels).collect(),
        field: read_unpadded(&pass.field, grid),
        scalar: read(&pass.scalar),
    }
}

/// Returns every `of`-th tuning from number `turn` on: each network is tried with some, each tuning on some networks.
fn in_turn(turn: usize, of: usize) -> impl Iterator<Item = Tuning> {
    tunings().into_iter().skip(turn % of).step_by(of)
}

/// Asserts that every stage is accurate to 2e-5 of its largest magnitude, as for the golden files.
fn check(weights: &Weights, (grid, samples): (Grid, usize), tunings: impl Iterator<Item = Tuning>) {
    let config = weights.config;
    let fields: Vec<f32> =
        noise(samples * config.fields * grid.particles(), 120).iter().map(|v| 3.0 * v).collect();
    let mut host = Network::<f64>::new(weights, grid, samples).unwrap();
    let mut stages = Vec::new();
    host.forward_observed(&widened(&fields), &mut |stage, values| stages.push((stage, values.to_vec())));
    for tuning in tunings {
        let found = forward(weights, &tuning, (grid, samples), &fields);
        let close = |name: &str, found: &[f32], expected: &[f64]| {
            let what = format!("{name} {} {samples} x {grid}", tuning.channels);
            assert_close(&what, found, expected, (2e-5 * largest(expected), 0.0));
        };
        for (stage, expected) in &stages {
            match *stage {
                Stage::Embedded => {}
                Stage::Lifted => close("lifted", &found.lifted, expected),
                Stage::Block(i) => close(&format!("block {i}"), &found.blocks[i], expected),
            }
        }
        close("field", &found.field, host.field());
        close("scalar", &found.scalar, host.scalar());
    }
}

/// Folding the projection into the last block, as solvers do, saves a layer and gives the same results.
#[test]
fn folded_networks_match_the_host() {
    let _turn = device();
    let (samples, wide) = (3, Grid { h: 8, w: 131 });
    let config = Config { lifting: 20, channels: 12, projection: 12, layers: 2, ..Config::default() };
    let grid = Grid { h: 31, w: 33 };
    let cases = [((**starter()).clone(), grid), (random(config), grid), (random(config), wide)];
    for (turn, (weights, grid)) in cases.into_iter().enumerate() {
        let fields: Vec<f32> = noise(samples * 3 * grid.particles(), 121).iter().map(|v| 3.0 * v).collect();
        let mut host = Network::<f64>::new(&weights, grid, samples).unwrap();
        host.forward(&widened(&fields));
        for tuning in in_turn(turn, 2) {
            let pass = submit_pass(&weights.folded(), &tuning, (grid, samples), (&fields, Keep::Nothing));
            let field = added_up(&pass.field, grid);
            assert_close("field", &field, host.field(), (2e-5 * largest(host.field()), 0.0));
            assert_close("scalar", &read(&pass.scalar), host.scalar(), (2e-5 * largest(host.scalar()), 0.0));
            if tuning.texels {
                let tuning = Tuning { texels: false, ..tuning };
                let buffers =
                    submit_pass(&weights.folded(), &tuning, (grid, samples), (&fields, Keep::Nothing));
                let both = |pass: &Forward| [&pass.field, &pass.scalar].map(read);
                assert_eq!(both(&pass), both(&buffers), "texels give the same bits as buffers");
            }
        }
    }
}

#[test]
fn a_trained_network_matches_the_host() {
    let _turn = device();
    let shapes = [(Grid { h: 8, w: 8 }, 3), (Grid { h: 31, w: 33 }, 3), (Grid { h: 48, w: 32 }, 9)];
    for (turn, shape) in shapes.into_iter().enumerate() {
        check(starter(), shape, in_turn(turn, 3));
    }
}

/// Rows that need a second workgroup if they are staged, rows too long for a lifting with all channels in one
/// workgroup, and rows too long for any workgroup.
#[test]
fn rows_longer_than_a_workgroup_match_the_host() {
    let _turn = device();
    for (turn, w) in [131, 1037].into_iter().enumerate() {
        check(starter(), (Grid { h: 8, w }, 2), in_turn(turn, 2));
    }
}

/// Channels that do not fill a tile, other modes, one, two and five blocks, and fewer fields than usual.
#[test]
fn networks_of_other_sizes_match_the_host() {
    let _turn = device();
    let odd = Config {
        lifting: 20,
        channels: 12,
        projection: 33,
        modes_h: 7,
        modes_w: 3,
        layers: 2,
        ..Config::default()
    };
    let others =
        [Config { layers: 1, ..odd }, Config { layers: 5, channels: 17, ..odd }, Config { fields: 1, ..odd }];
    for config in [odd].into_iter().chain(others) {
        check(&random(config), (Grid { h: 13, w: 11 }, 4), tunings().into_iter());
    }
}

/// If the lifting's hidden layer does not fit for all samples, samples are lifted in groups. If it does not
/// fit for one sample, its rows are. The bits are the same.
#[test]
fn lifting_in_parts_gives_the_same_bits() {
    let _turn = device();
    let (grid, samples) = (Grid { h: 9, w: 14 }, 9);
    let weights = starter();
    let fields = noise(samples * 3 * grid.particles(), 121);
    let own = context().tuning();
    // The backward pass needs the hidden layer, so the lifting's layers are not fused.
    let results = |tuning: &Tuning| {
        let pass = submit_pass(weights, tuning, (grid, samples), (&fields, Keep::Adjoint));
        [pass.activation(0), &pass.field, &pass.scalar].map(read)
    };
    let whole = results(&own);
    let one = 4 * weights.config.lifting * grid.h * 16;
    for activation_bytes in [0, one / 9, one / 2, one, 2 * one, 5 * one, 9 * one - 1] {
        assert_eq!(results(&Tuning { activation_bytes, ..own }), whole, "{activation_bytes} bytes");
    }
}

/// The hidden layer of all samples exceeds what the device binds at once, although their activations do not.
/// The forward pass then processes the samples in groups, to the same bits. The backward pass is only built.
#[test]
fn lifting_takes_no_more_than_the_device_binds() {
    let _turn = device();
    let (grid, samples) = (Grid { h: 9, w: 14 }, 60);
    let narrow = narrow(8 << 20);
    let one = 4 * starter().config.lifting * grid.h * 16;
    assert!((samples * one) as u64 > narrow.largest_binding());
    let fields = noise(samples * 3 * grid.particles(), 121);
    let tuning = Tuning::table(&narrow);
    let keep = Keep::Adjoint;
    let parts = submit_pass_on(&narrow, starter(), &tuning, (grid, samples), (&fields, keep));
    let whole = submit_pass(starter(), &tuning, (grid, samples), (&fields, keep));
    let field = parts.field.read::<f32>(&narrow).unwrap();
    assert_eq!(field, read(&whole.field));
    let parameters = Parameters::new(&narrow, starter(), &tuning).unwrap();
    let gradient = Tensor::zeros(&narrow, "gradient", parameters.flat.shape()).unwrap();
    let plan = Plan { grid, samples, tuning, keep: Keep::Adjoint };
    let forward = Forward::with_parameters(&narrow, &parameters, &plan).unwrap();
    Backward::new(&narrow, &forward, &parameters, &gradient, &tuning).unwrap();
}

/// The hidden layer of a single sample exceeds what the device binds at once.
#[test]
fn grids_are_larger_than_a_binding_of_the_hidden_layer() {
    let _turn = device();
    let (grid, samples) = (Grid { h: 101, w: 90 }, 1);
    let narrow = narrow(8 << 20);
    assert!((4 * starter().config.lifting * grid.h * 92) as u64 > narrow.largest_binding());
    let fields = noise(samples * 3 * grid.particles(), 122);
    let (tuning, keep) = (Tuning::table(&narrow), Keep::Adjoint);
    let parts = submit_pass_on(&narrow, starter(), &tuning, (grid, samples), (&fields, keep));
    let whole = submit_pass(starter(), &tuning, (grid, samples), (&fields, keep));
    assert_eq!(parts.field.read::<f32>(&narrow).unwrap(), read(&whole.field));
}

/// Activations and weights are stored in 16 bits, eleven of them significant. Every output is accurate to a
/// few of their roundings, with every tile on one of the grids, whether or not blocks transform their rows.
#[test]
fn networks_stored_in_half_precision_are_near_the_host() {
    let _turn = device();
    let Some(half) = half() else { return };
    let shapes = [(Grid { h: 8, w: 8 }, 3), (Grid { h: 31, w: 33 }, 3), (Grid { h: 48, w: 32 }, 9)];
    for (turn, shape) in shapes.into_iter().enumerate() {
        let (grid, samples) = shape;
        let fields: Vec<f32> = noise(samples * 3 * grid.particles(), 120).iter().map(|v| 3.0 * v).collect();
        for weights in [(**starter()).clone(), starter().folded(), Weights::shipped().folded()] {
            let mut host = Network::<f64>::new(&weights, grid, samples).unwrap();
            host.forward(&widened(&fields));
            for tuning in in_turn(turn, 3) {
                let pass = submit_pass_on(&half, &weights, &tuning, shape, (&fields, Keep::Nothing));
                assert_eq!((pass.embedded.storage(), pass.field.storage()), (Storage::F16, Storage::F32));
                let field = added_up(&pass.field, grid);
                let what = format!("f16 {} {samples} x {grid}", tuning.channels);
                assert_close(&what, &field, host.field(), (2e-3 * largest(host.field()), 0.0));
                assert_close(&what, &read(&pass.scalar), host.scalar(), (2e-3 * largest(host.scalar()), 0.0));
            }
        }
    }
}
