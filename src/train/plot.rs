//! The curves of a run as a picture.

use super::config::PoolConfig;
use super::metrics::pool_name;
use super::table::Table;
use crate::Result;
use crate::render::{Chart, Curve, Image, Scale, charts};

/// Width and height of the picture \[px\].
const SIZE: (usize, usize) = (1200, 900);

/// Draws loss and log gradient of each pool, the gradient norm, and the validation of each scene, over the steps.
pub(super) fn draw(metrics: &Table, pools: &[PoolConfig], validations: &Table) -> Result<Image> {
    let rows = metrics.rows()?;
    let curve = |column: &str, label: String| {
        let at = metrics.columns().iter().position(|name| name == column);
        let points = rows.iter().filter_map(|row| Some([row[0].parse().ok()?, row[at?].parse().ok()?]));
        Curve { label, points: points.collect() }
    };
    let of_pools = |what: &str| -> Vec<Curve> {
        let pools = pools.iter().enumerate();
        pools
            .map(|(index, pool)| {
                let label = format!("{} n {}", pool.grid, pool.iterations);
                curve(&format!("{}_{what}", pool_name(index, pool)), label)
            })
            .collect()
    };
    let mut scenes: Vec<Curve> = Vec::new();
    for row in validations.rows()? {
        let (Ok(step), Ok(value)) = (row[0].parse(), row[2].parse()) else { continue };
        match scenes.iter_mut().find(|curve| curve.label == row[1]) {
            Some(curve) => curve.points.push([step, value]),
            None => scenes.push(Curve { label: row[1].clone(), points: vec![[step, value]] }),
        }
    }
    let norm = vec![curve("gradient_norm", "gradient norm".into())];
    let chart = |title: &str, curves| Chart { title: title.into(), curves, scale: Scale::Linear };
    Ok(charts(
        &[
            chart("loss", of_pools("loss")),
            chart("log mean gradient", of_pools("log_gradient")),
            chart("norm of the gradient of the weights", norm),
            chart("validation: energy gap", scenes),
        ],
        SIZE,
    ))
}
