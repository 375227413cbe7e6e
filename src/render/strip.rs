//! Frames side by side.

use super::{
    Bodies, Film, Image, Marks, View,
    body::NONE,
    stage::{Size, Stage},
    text,
};
use crate::io::intersections_of;
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
    /// Whether a cloth that passes through itself is drawn pale, and dark where it does.
    pub crossings: bool,
}

impl Default for StripOptions<'_> {
    fn default() -> Self {
        Self { panels: 8, height: 420, view: View::default(), bodies: &NONE, crossings: false }
    }
}

/// Draws frames, evenly spread over the trajectory from the first to the last, side by side with their times
/// in seconds. `handles` are the vertices to mark. An empty trajectory gives an empty panel. Panics if
/// `panels` or `height` is 0, a handle is not a vertex, or the upward direction is 0.
pub fn strip<'a>(film: impl Into<Film<'a>>, handles: impl Into<Marks>, options: &StripOptions<'_>) -> Image {
    let film = film.into();
    assert!(options.panels > 0 && options.height > 0, "a strip has panels and a height");
    let marked = (handles.into(), options.bodies);
    let stage = Stage::new(film, marked, &options.view, Size::Height(options.height), 3);
    let faces: Vec<[u32; 3]> = film.frames.topology().triangles().collect();
    let count = options.panels.min(film.frames()).max(1);
    // As many decimals as it takes to tell the panels apart.
    let step = film.frames() as f64 / film.fps() / count as f64;
    let decimals = (-step.log10()).ceil().clamp(2.0, 9.0) as usize;
    let draw = |panel: usize| {
        let last = film.frames().saturating_sub(1);
        let frame = (panel * last + (count - 1) / 2).checked_div(count - 1).unwrap_or(0);
        if frame >= film.frames() {
            return stage.draw_empty();
        }
        let positions = film.frame(frame);
        let heat = if options.crossings { crossings(&faces, &positions) } else { Vec::new() };
        let mut image = stage.draw_heat(film.number(frame), &positions, &heat);
        // Still legible where a strip is shown at half its size.
        let height = (options.height as f32 / 14.0).max(12.0);
        let diverged = if stage.is_whole(&positions) { "" } else { ", diverged" };
        let caption = format!("{:.decimals$} s{diverged}", frame as f64 / film.fps());
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

/// Returns 1 at the vertices of the edges and triangles that pass through each other, 0 elsewhere; nothing if none do.
fn crossings(faces: &[[u32; 3]], positions: &[[f32; 3]]) -> Vec<f32> {
    let found = intersections_of(faces, positions);
    let mut heat = if found.is_empty() { Vec::new() } else { vec![0.0; positions.len()] };
    for one in found {
        let face = faces[one.face as usize];
        one.edge.into_iter().chain(face).for_each(|v| heat[v as usize] = 1.0);
    }
    heat
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::Grid;
    use crate::io::Trajectory;

    #[test]
    fn a_cloth_that_passes_through_itself_shows_where() {
        let grid = Grid { h: 12, w: 12 };
        let picture = |curl: f32, crossings: bool| {
            // A loop, whose ends pass through each other if it is curled far enough.
            let at = |p: usize| {
                let (i, j) = ((p / 12) as f32, (p % 12) as f32);
                let radius = 3.0 - 0.2 * j + 0.01 * i;
                [radius * (curl * j).cos() + 0.8 * j, radius * (curl * j).sin(), i]
            };
            let positions: Vec<[f32; 3]> = (0..144).map(at).collect();
            let mut trajectory = Trajectory::new(grid, 60.0);
            trajectory.push(&positions, &vec![[0.0; 3]; 144]);
            let options = StripOptions { panels: 1, height: 80, crossings, ..StripOptions::default() };
            (strip(&trajectory, &[], &options).pixels, super::crossings(&grid.faces(), &positions))
        };
        let [(plain, _), (marked, heat)] = [false, true].map(|crossings| picture(0.5, crossings));
        assert!(heat.contains(&1.0) && heat.contains(&0.0), "{heat:?}");
        assert_ne!(plain, marked);
        // One that does not looks as ever.
        let [(plain, _), (marked, heat)] = [false, true].map(|crossings| picture(0.1, crossings));
        assert!(heat.is_empty());
        assert_eq!(plain, marked);
    }
}
