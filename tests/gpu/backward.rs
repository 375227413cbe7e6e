//! The backward pass of the network: against the CPU path for each parameter, with every tile, and in parts.

use crate::common::{by_rows, context, device, noise, pad, read, tunings, widened};
use crate::forward::random;
use crate::solver::starter;
use fnopt::cloth::Grid;
use fnopt::cpu::operator::Adjoint;
use fnopt::gpu::{Schedule, Tensor, Tuning};
use fnopt::network::{Backward, Config, Forward, Head, Keep, Parameters, Plan, TransposedWeights, Weights};

/// Input fields and cotangents of a pass.
struct Case {
    grid: Grid,
    samples: usize,
    fields: Vec<f32>,
    adj_field: Vec<f32>,
    adj_scalar: Vec<f32>,
}

impl Case {
    fn new(config: &Config, grid: Grid, samples: usize) -> Self {
        let n = grid.particles();
        let fields = noise(samples * config.fields * n, 181).iter().map(|v| 3.0 * v).collect();
        Self { grid, samples, fields, adj_field: noise(samples * n, 182), adj_scalar: noise(samples, 183) }
    }

    /// Returns the device's gradient in the order of the weights, accumulated over `passes` passes.
    fn gradient(&self, weights: &Weights, tuning: &Tuning, passes: usize) -> Vec<f32> {
        let (context, grid) = (context(), self.grid);
        let ran = context.checked(|| {
            let parameters = Parameters::new(context, weights, tuning)?;
            let gradient = Tensor::zeros(context, "gradient", parameters.flat.shape())?;
            let plan = Plan { grid, samples: self.samples, tuning: *tuning, keep: Keep::Adjoint };
            let forward = Forward::with_parameters(context, &parameters, &plan)?;
            let backward = Backward::new(context, &forward, &parameters, &gradient, tuning)?;
            let transposed = TransposedWeights::new(context, &parameters)?;
            forward.embedded.write(
                context,
                &by_rows(&self.embedded(&weights.config), weights.config.inputs(), grid, 0.0),
            );
            backward.adj_field.write(context, &pad(&self.adj_field, grid, 0.0));
            backward.adj_scalar.write(context, &self.adj_scalar);
            let mut schedule = Schedule::new(context);
            transposed.push(&mut schedule);
            forward.push(&mut schedule, None, Head::Store);
            backward.push(&mut schedule, &forward, &transposed);
            for _ in 0..passes {
                context.submit(|encoder| schedule.record(encoder));
            }
            Ok(parameters.layout().to_host(&read(&gradient)))
        });
        ran.unwrap()
    }

    fn embedded(&self, config: &Config) -> Vec<f32> {
        let (grid, n) = (self.grid, self.grid.particles());
        let mut embedded = Vec::new();
        for fields in self.fields.chunks_exact(config.fields * n) {
            embedded.extend_from_slice(fields);
            embedded.extend((0..n).map(|p| (p / grid.w) as f32 / (grid.h - 1) as f32));
            embedded.extend((0..n).map(|p| (p % grid.w) as f32 / (grid.w - 1) as f32));
        }
        embedded
    }

    /// Returns the gradient of one pass on the CPU in double precision.
    fn expected(&self, weights: &Weights) -> Vec<f64> {
        let mut adjoint = Adjoint::<f64>::new(weights, self.grid, self.samples).unwrap();
        let mut gradient = vec![0.0; weights.parameter_count()];
        let input = widened(&self.fields);
        adjoint.forward(&input);
        adjoint.backward(&input, (&widened(&self.adj_field), &widened(&self.adj_scalar)), &mut gradient);
        gradient
    }
}

/// Asserts that every parameter's gradient is accurate to 1e-4 of its norm.
fn check(weights: &Weights, (grid, samples): (Grid, usize)) {
    let case = Case::new(&weights.config, grid, samples);
    let expected = case.expected(weights);
    for tuning in tunings() {
        let found = case.gradient(weights, &tuning, 1);
        let mut at = 0;
        for (parameter, name) in weights.parameters().iter().zip(weights.parameter_names()) {
            let range = at..at + parameter.len();
            at = range.end;
            let norm = expected[range.clone()].iter().map(|e| e * e).sum::<f64>().sqrt();
            let errors = range.map(|k| (f64::from(found[k]) - expected[k]).powi(2));
            let error = errors.sum::<f64>().sqrt() / norm;
            assert!(error < 1e-4, "{name}, tile {}, {samples} x {grid}: {error:.1e}", tuning.channels);
        }
    }
}

#[test]
fn gradients_of_the_shipped_network_match_the_host() {
    let _turn = device();
    for shape in [(Grid { h: 8, w: 8 }, 3), (Grid { h: 31, w: 33 }, 3), (Grid { h: 48, w: 32 }, 6)] {
        check(starter(), shape);
    }
}

/// Channels that do not fill a tile, other modes, and one, two and five blocks: the scalar head reads the
/// last block or the one before it.
#[test]
fn gradients_of_networks_of_other_sizes_match_the_host() {
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
    for config in [odd, Config { layers: 1, ..odd }, Config { layers: 5, channels: 17, ..odd }] {
        check(&random(config), (Grid { h: 13, w: 11 }, 4));
    }
}

/// Computing the lifting's hidden layer in parts gives the same gradient, up to the order of a sum. Gradients
/// of several passes add up.
#[test]
fn parts_and_passes_add_up() {
    let _turn = device();
    let weights = random(Config { lifting: 40, channels: 12, projection: 20, ..Config::default() });
    let case = Case::new(&weights.config, Grid { h: 9, w: 14 }, 5);
    let own = context().tuning();
    let whole = case.gradient(&weights, &own, 1);
    assert_eq!(whole, case.gradient(&weights, &own, 1), "two runs have the same bits");
    let norm = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let twice = case.gradient(&weights, &own, 2);
    let apart: Vec<f64> =
        twice.iter().zip(&whole).map(|(&t, &w)| f64::from(t) - 2.0 * f64::from(w)).collect();
    assert!(norm(&apart) < 1e-6 * norm(&widened(&whole)));
    let one = 4 * 64 * 9 * 16;
    for activation_bytes in [0, 2 * one] {
        let parts = case.gradient(&weights, &Tuning { activation_bytes, ..own }, 1);
        let apart: Vec<f64> = parts.iter().zip(&whole).map(|(&p, &w)| f64::from(p) - f64::from(w)).collect();
        assert!(norm(&apart) < 1e-6 * norm(&widened(&whole)), "{activation_bytes} bytes");
    }
    // On the device channels are padded to whole tiles with zeros. Without them, the weights are the host's.
    let parameters = Parameters::new(context(), &weights, &own).unwrap();
    let padded = read(&parameters.flat);
    let zeros = padded.iter().filter(|&&weight| weight == 0.0).count();
    assert_eq!(parameters.layout().to_host(&padded), weights.flat());
    assert_eq!(zeros, padded.len() - weights.flat().len());
}
