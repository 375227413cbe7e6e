//! Frames side by side.

use super::{
    Bodies, Image, Marks, View,
    body::NONE,
    stage::{Size, Stage},
    text,
};
use crate::io::Trajectory;
use rayon::prelude::*;

/// Options of [`strip()`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripOptions<'a> {
    /// Number of frames; fewer if the trajectory has fewer.
    pub panels: usize,
    /// Height \[px\]; the width of a panel follows from the shape of the trajectory.
    pub height: usize,
    /// The direction of view.
    pub view: View,
    /// The bodies that the cloth meets, which are drawn with it.
    pub bodies: &'a Bodies,
}

impl Default for StripOptions<'_> {
    fn default() -> Self {
        Self { panels: 8, height: 420, view: View::default(), bodies: &NONE }
    }
}

/// Draws frames, evenly spread over the trajectory from the first to the last, side by side with their times
/// in seconds. `handles` are the vertices to mark. An empty trajectory gives an empty panel. Panics if
/// `panels` or `height` is 0, a handle is not a vertex, or the upward direction is 0.
pub fn strip(trajectory: &Trajectory, handles: impl Into<Marks>, options: &StripOptions<'_>) -> Image {
    assert!(options.panels > 0 && options.height > 0, "a strip has panels and a height");
    let marked = (handles.into(), options.bodies);
    let stage = Stage::new(trajectory, marked, &options.view, Size::Height(options.height), 3);
    let count = options.panels.min(trajectory.frames()).max(1);
    // As many decimals as it takes to tell the panels apart.
    let step = trajectory.frames() as f64 / trajectory.fps() / count as f64;
    let decimals = (-step.log10()).ceil().clamp(2.0, 9.0) as usize;
    let draw = |panel: usize| {
        let last = trajectory.frames().saturating_sub(1);
        let frame = (panel * last + (count - 1) / 2).checked_div(count - 1).unwrap_or(0);
        if frame >= trajectory.frames() {
            return stage.draw_empty();
        }
        let positions = trajectory.frame(frame);
        let mut image = stage.draw(frame, positions);
        // Still legible where a strip is shown at half its size.
        let height = (options.height as f32 / 14.0).max(12.0);
        let diverged = if stage.is_whole(positions) { "" } else { ", diverged" };
        let caption = format!("{:.decimals$} s{diverged}", frame as f64 / trajectory.fps());
        text::write(&mut image, &caption, [0.7 * height, options.height as f32 - 1.6 * height], height);
        image
    };
    let panels: Vec<Image> = (0..count).into_par_iter().map(draw).collect();
    let width = panels[0].width;
    let mut image = Image::new(width * count, options.height);
    for (k, panel) in panels.iter().enumerate() {
        image.paste(panel, [k * width, 0]);
    }
    image
}
