//! The schedule of the learning rate.

use std::f64::consts::PI;

/// The learning rate over the course of a run.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RateSchedule {
    /// Number of steps over which the rate initially rises linearly; 0 for no warm-up.
    pub warmup: u64,
    /// Decay after the warm-up.
    pub decay: Decay,
}

/// The decay of the learning rate.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Decay {
    /// No decay.
    #[default]
    None,
    /// Halving at each of these steps; the paper's recipe.
    Halvings(Vec<u64>),
    /// Half a cosine, from the end of the warm-up to the end of the run.
    Cosine {
        /// Rate at the end.
        #[serde(rename = "final")]
        last: f64,
    },
}

impl RateSchedule {
    /// Returns the learning rate of step `step` of `steps`, counted from 0; `rate` is the peak rate.
    pub fn rate(&self, rate: f64, step: u64, steps: u64) -> f64 {
        if step < self.warmup {
            return rate * (step + 1) as f64 / self.warmup as f64;
        }
        match &self.decay {
            Decay::None => rate,
            Decay::Halvings(at) => rate * 0.5f64.powi(at.iter().filter(|&&at| at <= step).count() as i32),
            Decay::Cosine { last } => {
                let span = steps.saturating_sub(self.warmup).max(1) as f64;
                let done = ((step - self.warmup) as f64 / span).min(1.0);
                last + (rate - last) * 0.5 * (1.0 + (PI * done).cos())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_and_falls_as_configured() {
        let paper = RateSchedule { warmup: 0, decay: Decay::Halvings(vec![10, 20, 30]) };
        let rates = [0, 9, 10, 19, 20, 30, 1000].map(|step| paper.rate(8.0, step, 40));
        assert_eq!(rates, [8.0, 8.0, 4.0, 4.0, 2.0, 1.0, 1.0]);
        let cosine = RateSchedule { warmup: 4, decay: Decay::Cosine { last: 2.0 } };
        let rates = [0, 1, 3, 4, 12, 20, 30].map(|step| cosine.rate(8.0, step, 20));
        assert_eq!(rates, [2.0, 4.0, 8.0, 8.0, 5.0, 2.0, 2.0]);
        assert_eq!(RateSchedule::default().rate(3.0, 7, 8), 3.0);
    }
}
