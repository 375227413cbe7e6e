//! Plots the curves of a run.

use super::config::PoolConfig;
use super::metrics::pool_name;
use super::table::Table;
use crate::Result;
use crate::render::{Chart, Curve, Image, Scale, charts};

/// Width and height of the picture \[px\].
const SIZE: (usize, usize) = (1200, 900);

/// Draws loss and log gradient of each pool, the gradient norm, and the energy gap of each validation scene,
/// over the steps.
pub(super) fn draw(metrics: &Table, pools: &[PoolConfig], validations: &Table) -> Result<Image> {
    let text = metrics.text()?;
    let curve = |column: &str, label: String| {
        let at = metrics.columns().iter().position(|name| name == column);
        let point =
            |row: &str| Some([row.split(',').next()?.parse().ok()?, row.split(',').nth(at?)?.parse().ok()?]);
        Curve { label, points: metrics.rows(&text).filter_map(point).collect() }
    };
    let of_pools = |what: &str| -> Vec<Curve> {
        let pools = pools.iter().enumerate();
        pools
            .map(|(index, pool)| {
                let label = format!("{}, N = {}", pool.grid, pool.iterations);
                curve(&format!("{}_{what}", pool_name(index, pool)), label)
            })
            .collect()
    };
    let mut scenes: Vec<Curve> = Vec::new();
    let text = validations.text()?;
    for row in validations.rows(&text) {
        let values: Vec<&str> = row.split(',').collect();
        let (Ok(step), Ok(gap)) = (values[0].parse(), values[2].parse::<f64>()) else { continue };
        // Logarithmic, because the gaps of diverging weights are larger by powers of ten.
        let value = gap.log10();
        match scenes.iter_mut().find(|curve| curve.label == values[1]) {
            Some(curve) => curve.points.push([step, value]),
            None => scenes.push(Curve { label: values[1].into(), points: vec![[step, value]] }),
        }
    }
    let norm = vec![curve("gradient_norm", "gradient norm".into())];
    let chart = |title: &str, curves| {
        let axes = ["step".into(), String::new()];
        Chart { title: title.into(), axes, curves, scale: Scale::Linear }
    };
    Ok(charts(
        &[
            chart("Loss", of_pools("loss")),
            chart("Logarithm of the mean gradient", of_pools("log_gradient")),
            chart("Norm of the gradient of the weights", norm),
            chart("Validation: energy gap, log10", scenes),
        ],
        SIZE,
    ))
}
