//! Gusts: wind that changes at random, and alike in every run.

use super::{Units, UpAxis, Wind};
use crate::io::Node;
use crate::{Error, Result};

/// How a wind's velocity changes.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Gusts {
    /// Root mean square of the velocity that is added to the wind's [m/s].
    pub speed_m_s: f64,
    /// How often that takes a new direction [1/s].
    pub frequency_hz: f64,
    /// Another number gives other gusts of the same kind.
    pub seed: u64,
}

impl Gusts {
    pub(super) fn read(node: &Node) -> Result<Self> {
        node.deny_unknown(&["speed_m_s", "frequency_hz", "seed"])?;
        let speed = node.get("speed_m_s").ok_or_else(|| node.invalid("a \"speed_m_s\""))?;
        Ok(Self {
            speed_m_s: speed.number()?,
            frequency_hz: node.get_or("frequency_hz", 1.0, Node::number)?,
            seed: node.get_or("seed", 0, |node| Ok(node.count()? as u64))?,
        })
    }

    /// Fails if a number is out of range; `origin` and `field` name its source in the error.
    pub(super) fn check(&self, origin: &str, field: &str) -> Result<()> {
        for (part, number) in [("speed_m_s", self.speed_m_s), ("frequency_hz", self.frequency_hz)] {
            if !(number.is_finite() && number >= 0.0) {
                let field = format!("{field}.{part}");
                return Err(Error::invalid(origin, field, "a finite number, 0 or greater", number));
            }
        }
        Ok(())
    }
}

/// The velocity of a wind in every frame, in grid units, z up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Airflow {
    /// Its mean [edges / frame].
    pub velocity: [f64; 3],
    /// Root mean square of what gusts add [edges / frame].
    pub gusts: f64,
    /// New directions of gusts per frame.
    pub turns: f64,
    /// Tells gusts of the same kind apart.
    pub seed: u64,
}

impl Airflow {
    /// Converts a scene's wind.
    pub(super) fn new(wind: &Wind, units: &Units, up: UpAxis) -> Self {
        let velocity = units.velocity(up.to_z_up(wind.velocity));
        let Some(gusts) = wind.gusts else { return Self { velocity, ..Self::default() } };
        let [speed, ..] = units.velocity([gusts.speed_m_s, 0.0, 0.0]);
        Self { velocity, gusts: speed, turns: gusts.frequency_hz * units.frame_time_s, seed: gusts.seed }
    }

    /// Returns the velocity in the step that ends at `frame` [edges / frame].
    ///
    /// Each component of a gust is a curve through random values at equal times, of the variance of one third, which a
    /// cubic joins that is level there. Between them it varies less; the scale makes up for that.
    pub fn at(&self, frame: usize) -> [f64; 3] {
        if self.gusts == 0.0 {
            return self.velocity;
        }
        // The mean over t of (1 - s)^2 + s^2 with s = t^2 (3 - 2 t).
        const MEAN_SQUARE: f64 = 26.0 / 35.0;
        let time = frame as f64 * self.turns;
        let (before, t) = (time.floor(), time.fract());
        let s = t * t * (3.0 - 2.0 * t);
        let component = |c: usize| {
            let value = |at: f64| uniform(self.seed, at as u64, c as u64);
            (1.0 - s) * value(before) + s * value(before + 1.0)
        };
        let gust = [0, 1, 2].map(|c| self.gusts / MEAN_SQUARE.sqrt() * component(c));
        [0, 1, 2].map(|c| self.velocity[c] + gust[c])
    }
}

/// Returns a number from -1 to 1, evenly distributed: the variance is one third.
fn uniform(seed: u64, at: u64, component: u64) -> f64 {
    let mixed = mix(mix(mix(seed) ^ at) ^ component);
    (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Mixes the bits of a number (SplitMix64: Steele, Lea and Flood 2014).
fn mix(number: u64) -> u64 {
    let z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gusts_have_their_speed_and_no_direction() {
        let flow = Airflow { velocity: [1.0, 0.0, -2.0], gusts: 0.5, turns: 0.37, seed: 3 };
        let frames = 200_000;
        let (mut mean, mut square) = ([0.0; 3], 0.0);
        for frame in 0..frames {
            let gust = flow.at(frame);
            let added = [0, 1, 2].map(|c| gust[c] - flow.velocity[c]);
            square += added.iter().map(|c| c * c).sum::<f64>() / frames as f64;
            (0..3).for_each(|c| mean[c] += added[c] / frames as f64);
        }
        assert!((square.sqrt() / 0.5 - 1.0).abs() < 0.01, "{square}");
        assert!(mean.iter().all(|c| c.abs() < 0.01), "{mean:?}");
    }

    #[test]
    fn gusts_are_smooth_and_repeat() {
        let flow = Airflow { gusts: 1.0, turns: 0.01, seed: 9, ..Airflow::default() };
        for frame in 0..1000 {
            let [before, after] = [flow.at(frame), flow.at(frame + 1)];
            // At most the steepest slope of the cubic, 1.5 per turn, over the full range.
            let step = [0, 1, 2].map(|c| (after[c] - before[c]).abs());
            assert!(step.iter().all(|step| *step < 0.01 * 1.5 * 2.0 * 1.2), "{frame}: {step:?}");
            assert_eq!(before, flow.at(frame));
        }
        let other = Airflow { seed: 10, ..flow };
        assert_ne!(flow.at(5), other.at(5));
        let calm = Airflow { velocity: [0.0, 3.0, 0.0], ..Airflow::default() };
        assert_eq!(calm.at(17), [0.0, 3.0, 0.0]);
    }
}
