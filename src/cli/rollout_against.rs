//! Another solver on the scene of a rollout, frame by frame beside it, and how far apart their particles are.

use super::output::status;
use super::{ListedSolver, load_weights};
use fnopt::cloth::State;
use fnopt::eval::median_time;
use fnopt::io::Recording;
use fnopt::scene::{Script, Setup};
use fnopt::{Device, Frame, Result, Simulator, ndarray};
use std::ops::ControlFlow;
use std::path::Path;

/// Names of the arrays beside the frames.
const ARRAYS: [&str; 2] = ["against_mean_m", "against_largest_m"];

/// The other solver, on the CPU path, and the distances of its frames from the rollout's.
pub struct Against<'a> {
    text: String,
    simulator: Simulator,
    script: Script<'a>,
    ms: Vec<f64>,
    /// Mean over the particles and the largest of them \[m\], of each frame from frame 1 on.
    distances: Vec<[f64; 2]>,
    /// Whether it broke down, and the distances end there.
    ended: bool,
}

impl<'a> Against<'a> {
    /// Builds the solver given as `text` to `--against`, at the start of the scene.
    pub fn new(text: &str, checkpoint: Option<&Path>, setup: &'a Setup) -> Result<Self> {
        let solver = ListedSolver::parse(text, "--against", || load_weights(checkpoint))?;
        let iterations = solver.iterations.unwrap_or(solver.optimizer.default_iterations());
        let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &solver.optimizer, iterations)?;
        simulator.set_state(&setup.start.cast());
        let script = Script::new(setup);
        Ok(Self {
            text: text.to_owned(),
            simulator,
            script,
            ms: Vec::new(),
            distances: Vec::new(),
            ended: false,
        })
    }

    /// Computes the frame that the rollout has computed, and compares them.
    pub fn step(&mut self, frame: &Frame) {
        if self.ended {
            return;
        }
        let mut other = None;
        let played = self.simulator.play(&mut self.script, |_, frame| {
            other = Some(frame);
            ControlFlow::Break(())
        });
        if let Err(error) = played {
            status!("warning: --against {}: {error}; the distances end there", self.text);
            self.ended = true;
        } else if let Some(other) = other {
            self.ms.push(other.wall.as_secs_f64() * 1e3);
            self.distances.push(distances(self.script.setup(), [&frame.state, &other.state]));
        }
    }

    /// Puts the distances beside the frames.
    pub fn keep(&self, recording: &mut Recording) {
        for (which, name) in ARRAYS.iter().enumerate() {
            recording.put_beside(name, ndarray::Array1::from(self.column(which)).into_dyn());
        }
    }

    /// Returns what a report says of it.
    pub fn report(&self) -> serde_json::Value {
        let [mean, largest] = self.over_all().map_or([None; 2], |both| both.map(Some));
        serde_json::json!({
            "solver": self.text,
            "ms_per_frame": median_time(&self.ms),
            "mean_m": mean,
            "largest_m": largest,
            "per_frame": { "mean_m": self.column(0), "largest_m": self.column(1) },
        })
    }

    /// Returns the line of a summary.
    pub fn summary(&self) -> String {
        let text = &self.text;
        match self.over_all() {
            Some([mean, largest]) => {
                format!("{:.3} mm from {text} on average, at most {:.2} mm", 1e3 * mean, 1e3 * largest)
            }
            None => format!("no frame of {text}"),
        }
    }

    /// Returns the mean over all frames and particles, and the largest distance.
    fn over_all(&self) -> Option<[f64; 2]> {
        let frames = self.distances.len() as f64;
        let sum = self.distances.iter().copied().reduce(|[a, b], [c, d]| [a + c, b.max(d)])?;
        Some([sum[0] / frames, sum[1]])
    }

    fn column(&self, which: usize) -> Vec<f64> {
        self.distances.iter().map(|both| both[which]).collect()
    }
}

/// Returns the mean and the largest distance of the particles of two states \[m\].
fn distances(setup: &Setup, states: [&State<f32>; 2]) -> [f64; 2] {
    let [one, other] = states.map(|state| setup.vertices_m(&state.x));
    let (mut sum, mut largest, mut count) = (0.0, 0.0_f64, 0);
    let mask = setup.model.cloths[0].mask.as_ref();
    for (_, (a, b)) in
        one.iter().zip(&other).enumerate().filter(|&(p, _)| mask.is_none_or(|mask| mask.contains(p)))
    {
        let distance = (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
        (sum, largest, count) = (sum + distance, largest.max(distance), count + 1);
    }
    [sum / f64::from(count), largest]
}
