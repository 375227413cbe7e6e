//! Plots the curves of a run.

use super::config::PoolConfig;
use super::metrics::pool_name;
use super::table::Table;
use super::validation::SceneScore;
use crate::Result;
use crate::render::{Chart, Curve, Image, Scale, charts};

/// Width and height of a chart \[px\].
const SIZE: (usize, usize) = (600, 450);

/// Draws the loss and the geometric mean of the gradient of each pool, the norm of the weights' gradient, and
/// the energy gap of each validation scene, over the steps.
pub(super) fn draw(metrics: &Table, pools: &[PoolConfig], validations: &Table) -> Result<Image> {
    let text = metrics.text()?;
    let curve = |column: &str, label: String| {
        let at = metrics.columns().iter().position(|name| name == column);
        let point =
            |row: &str| Some([row.split(',').next()?.parse().ok()?, row.split(',').nth(at?)?.parse().ok()?]);
        let points = metrics.rows(&text).filter_map(point).collect();
        Curve { label, colour: 0, points, notes: Vec::new() }
    };
    let of_pools = |what: &str| -> Vec<Curve> {
        let pools = pools.iter().enumerate();
        pools
            .map(|(index, pool)| {
                let label = format!("{}, N = {}", pool.grid, pool.iterations);
                Curve { colour: index, ..curve(&format!("{}_{what}", pool_name(index, pool)), label) }
            })
            .collect()
    };
    let mut scenes: Vec<Curve> = Vec::new();
    let text = validations.text()?;
    for row in validations.rows(&text) {
        let values: Vec<&str> = row.split(',').collect();
        let (Ok(step), Ok(gap)) = (values[0].parse(), values[2].parse::<f64>()) else { continue };
        let colour = scenes.len();
        match scenes.iter_mut().find(|curve| curve.label == values[1]) {
            Some(curve) => curve.points.push([step, gap]),
            None => {
                let (label, points) = (values[1].into(), vec![[step, gap]]);
                scenes.push(Curve { label, colour, points, notes: Vec::new() });
            }
        }
    }
    let mut gradients = of_pools("log_gradient");
    gradients.iter_mut().flat_map(|curve| &mut curve.points).for_each(|point| point[1] = point[1].exp());
    let norm = vec![curve("gradient_norm", "all pools".into())];
    let chart = |title: &str, axis: String, curves, scale| {
        let axes = ["step".into(), axis];
        Chart { title: title.into(), axes, curves, lines: Vec::new(), scales: [Scale::Linear, scale] }
    };
    // An unsound rollout counts as the largest gap.
    let gap = format!("energy gap ({} if unsound)", SceneScore::MOST_GAP);
    Ok(charts(
        &[
            chart("Loss", "energy".into(), of_pools("loss"), Scale::Linear),
            chart(
                "Gradient of the cloths",
                "geometric mean of |dL/da|".into(),
                gradients,
                Scale::Logarithmic,
            ),
            chart("Gradient of the weights", "norm".into(), norm, Scale::Logarithmic),
            chart("Validation", gap, scenes, Scale::Logarithmic),
        ],
        SIZE,
    ))
}
