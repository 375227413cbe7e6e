//! Means over steps, as rows of `metrics.csv`.

use super::config::PoolConfig;
use super::learner::{Outcome, StepReport};
use super::table::Table;
use crate::Result;
use std::path::PathBuf;
use std::time::Duration;

/// Columns of each pool.
const OF_POOL: [&str; 7] = ["loss", "stretch", "shear", "bend", "inertia", "external", "log_gradient"];
/// Columns of the step.
const OF_STEP: [&str; 7] =
    ["step", "seconds", "steps_per_second", "rate", "skipped", "loss", "gradient_norm"];

/// Returns the name of a pool in files and plots.
pub(super) fn pool_name(index: usize, pool: &PoolConfig) -> String {
    format!("pool{index}_{}_n{}", pool.grid, pool.iterations)
}

/// Accumulates steps and writes their means.
pub(super) struct Metrics {
    table: Table,
    /// Sums of loss, gradient norm and the columns of each pool.
    sums: Vec<f64>,
    /// Number of steps in the sums.
    used: u64,
    /// Number of these steps that drew from each pool.
    drawn: Vec<u64>,
    /// Number of steps skipped since the last row.
    skipped: u64,
    /// Learning rate of the last step.
    rate: f64,
    /// Time taken by the steps, excluding work between them.
    took: Duration,
}

impl Metrics {
    /// Opens the table, dropping rows after `step`.
    pub fn open(path: PathBuf, pools: &[PoolConfig], step: u64) -> Result<Self> {
        let of_pools = pools.iter().enumerate().flat_map(|(index, pool)| {
            let name = pool_name(index, pool);
            OF_POOL.map(|column| format!("{name}_{column}"))
        });
        let columns: Vec<String> = OF_STEP.map(str::to_owned).into_iter().chain(of_pools).collect();
        let sums = vec![0.0; 2 + OF_POOL.len() * pools.len()];
        let table = Table::open(path, columns, step)?;
        let drawn = vec![0; pools.len()];
        Ok(Self { table, sums, used: 0, drawn, skipped: 0, rate: 0.0, took: Duration::ZERO })
    }

    /// Adds a step with its learning rate and duration; a skipped step is only counted.
    pub fn add(&mut self, report: &StepReport, rate: f64, took: Duration) {
        self.rate = rate;
        self.took += took;
        if !report.is_finite() {
            self.skipped += 1;
            return;
        }
        self.used += 1;
        let (of_step, of_pools) = self.sums.split_at_mut(2);
        let add = |sums: &mut [f64], values: &[f64]| sums.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        add(of_step, &[report.loss(), report.gradient_norm]);
        let pools = report.outcomes.iter().zip(of_pools.chunks_exact_mut(OF_POOL.len())).zip(&mut self.drawn);
        for ((outcomes, sums), drawn) in pools.filter(|((outcomes, _), _)| !outcomes.is_empty()) {
            let mean =
                |value: fn(&Outcome) -> f64| outcomes.iter().map(value).sum::<f64>() / outcomes.len() as f64;
            *drawn += 1;
            let values = [
                mean(|o| o.energy.total()),
                mean(|o| o.energy.stretch),
                mean(|o| o.energy.shear),
                mean(|o| o.energy.bend),
                mean(|o| o.energy.inertia),
                mean(|o| o.energy.external),
                mean(|o| o.log_gradient),
            ];
            add(sums, &values);
        }
    }

    /// Writes the row of the steps up to `step`, if there were any, and starts the next one. Columns of pools
    /// that were not drawn from are empty.
    pub fn flush(&mut self, step: u64, seconds: f64) -> Result<()> {
        if self.used + self.skipped == 0 {
            return Ok(());
        }
        let speed = (self.used + self.skipped) as f64 / self.took.as_secs_f64();
        let mut row = vec![step.to_string(), format!("{seconds:.1}"), format!("{speed:.3}")];
        row.extend([format!("{:.6e}", self.rate), self.skipped.to_string()]);
        let counts = self.drawn.iter().flat_map(|&drawn| [drawn; OF_POOL.len()]);
        let means = self.sums.iter().zip([self.used; 2].into_iter().chain(counts));
        row.extend(means.map(|(sum, count)| match count {
            0 => String::new(),
            _ => format!("{:.6e}", sum / count as f64),
        }));
        self.table.push(&row)?;
        self.sums.fill(0.0);
        self.drawn.fill(0);
        (self.used, self.skipped, self.took) = (0, 0, Duration::ZERO);
        Ok(())
    }

    /// Returns the table.
    pub fn table(&self) -> &Table {
        &self.table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::EnergyTerms;

    #[test]
    fn a_row_holds_means_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.csv");
        let pools = [PoolConfig::default(), PoolConfig::default()];
        let mut metrics = Metrics::open(path.clone(), &pools, 0).unwrap();
        let outcome = |stretch: f64, log_gradient| {
            let energy = EnergyTerms {
                stretch,
                shear: 2.0,
                bend: 3.0,
                inertia: 4.0,
                external: -5.0,
                ..Default::default()
            };
            Outcome { energy, log_gradient, scale: [0.05; 3] }
        };
        let second = Duration::from_secs(1);
        // The first pool has two cloths, the second one takes part in the first step only.
        let first = vec![vec![outcome(1.0, -1.0), outcome(2.0, -2.0)], vec![outcome(10.0, -7.0)]];
        metrics.add(&StepReport { gradient_norm: 0.5, outcomes: first }, 1e-3, second);
        let next = vec![vec![outcome(3.0, -3.0), outcome(6.0, -6.0)], vec![]];
        metrics.add(&StepReport { gradient_norm: 1.5, outcomes: next }, 2e-3, second);
        let unusable = vec![vec![outcome(f64::NAN, 0.0)], vec![]];
        metrics.add(&StepReport { gradient_norm: 9.0, outcomes: unusable }, 3e-3, 2 * second);
        metrics.flush(3, 7.0).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        let value = |column: &str| -> f64 {
            let at = rows[0].iter().position(|title| *title == column);
            rows[1][at.unwrap_or_else(|| panic!("no column {column}: {}", rows[0].join(",")))]
                .parse()
                .unwrap()
        };
        let close = |column: &str, expected: f64| {
            assert!((value(column) - expected).abs() < 1e-5, "{column}: {}, not {expected}", value(column));
        };
        for (column, expected) in [("step", 3.0), ("seconds", 7.0), ("skipped", 1.0), ("rate", 3e-3)] {
            close(column, expected);
        }
        // Three steps in four seconds.
        close("steps_per_second", 0.75);
        close("gradient_norm", 1.0);
        // Sums of the pools' means: 5.5 and 14 in the first step, 8.5 in the second.
        close("loss", (5.5 + 14.0 + 8.5) / 2.0);
        for (column, expected) in [("loss", 7.0), ("stretch", 3.0), ("shear", 2.0), ("bend", 3.0)] {
            close(&format!("pool0_32x32_n10_{column}"), expected);
        }
        for (column, expected) in [("inertia", 4.0), ("external", -5.0), ("log_gradient", -3.0)] {
            close(&format!("pool0_32x32_n10_{column}"), expected);
        }
        // Over the one step that drew from it.
        close("pool1_32x32_n10_stretch", 10.0);
        close("pool1_32x32_n10_log_gradient", -7.0);
    }
}
