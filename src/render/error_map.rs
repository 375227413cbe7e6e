//! Frames of several systems next to the truth, coloured by their distance from it.

use super::{
    Film, Image, View,
    body::NONE,
    shade,
    stage::{Size, Stage},
    text,
};
use crate::io::Trajectory;
use rayon::prelude::*;

/// The frames of one system.
#[derive(Clone, Debug)]
pub struct ErrorMap {
    /// Name.
    pub label: String,
    /// The frames, as many as of the truth.
    pub frames: Trajectory,
    /// Distance of each vertex of each frame from the truth \[m\].
    pub errors: Vec<Vec<f32>>,
}

/// Height of a panel \[px\].
const HEIGHT: usize = 300;
/// Height of captions \[px\].
const CAPTION: f32 = 17.0;
/// Space left of captions, and around the colour scale \[px\].
const LEFT: usize = 10;
/// Length and height of the colour scale \[px\].
const RAMP: [usize; 2] = [80, 12];
/// Share of the vertices of all maps that the colour scale spans; the rest take its darkest colour.
const SPAN: f64 = 0.98;

/// Draws a row of frames of the truth, at these times \[s\], and below it one row per map, all with one
/// colour scale, which the first panel shows. `handles` are the vertices of the truth to mark. Panics if the
/// truth has no frames or another number of times, a handle is not one of its vertices, or the upward
/// direction is 0.
pub fn error_maps(
    truth: &Trajectory,
    times: &[f64],
    handles: &[usize],
    maps: &[ErrorMap],
    view: &View,
) -> Image {
    assert!(truth.frames() > 0 && times.len() == truth.frames(), "there are frames to draw");
    let mut all: Vec<f32> = maps.iter().flat_map(|map| &map.errors).flatten().copied().collect();
    all.retain(|error| error.is_finite());
    all.sort_by(f32::total_cmp);
    let largest = all.get((all.len() as f64 * SPAN) as usize).copied().unwrap_or(1.0).max(1e-6);

    // All share one camera, whatever their grids.
    let others: Vec<Film> = maps.iter().map(|map| (&map.frames).into()).collect();
    let stage = Stage::with(truth.into(), &others, (handles.into(), &NONE), view, (Size::Height(HEIGHT), 3));
    let [width, _] = stage.size;
    let caption = |image: &mut Image, line: &str, [x, y]: [f32; 2]| {
        // Shrink captions that are too wide for the panel.
        let fits = (width as f32 - x - 4.0) / text::width(line, CAPTION);
        text::write(image, line, [x, y], CAPTION * fits.min(1.0));
    };
    let bottom = [LEFT as f32, HEIGHT as f32 - 24.0];
    let truths = (0..truth.frames()).into_par_iter().map(|frame| {
        let mut image = stage.draw(frame, truth.frame(frame));
        let name = if frame == 0 { "truth, " } else { "" };
        caption(&mut image, &format!("{name}{:.2} s", times[frame]), bottom);
        if frame == 0 {
            ramp(&mut image);
            caption(&mut image, &format!("0 to {largest:.2} m"), [(LEFT + RAMP[0] + 6) as f32, 10.0]);
        }
        image
    });
    let mut rows: Vec<Vec<Image>> = vec![truths.collect()];
    for map in maps {
        let own = stage.on(map.frames.grid());
        let draw = |frame: usize| {
            let heat: Vec<f32> = map.errors[frame].iter().map(|error| error / largest).collect();
            let mut image = own.draw_heat(frame, map.frames.frame(frame), &heat);
            let mean = map.errors[frame].iter().map(|&e| f64::from(e)).sum::<f64>() / heat.len() as f64;
            let name = if frame == 0 { format!("{}: ", map.label) } else { String::new() };
            caption(&mut image, &format!("{name}mean {mean:.3} m"), bottom);
            image
        };
        rows.push((0..truth.frames()).into_par_iter().map(draw).collect());
    }
    let mut image = Image::new(width * truth.frames(), HEIGHT * rows.len());
    for (y, row) in rows.iter().enumerate() {
        for (x, panel) in row.iter().enumerate() {
            image.paste(panel, [x * width, y * HEIGHT]);
        }
    }
    image
}

/// Draws the colour scale into the upper left corner.
fn ramp(image: &mut Image) {
    let [length, height] = RAMP;
    for (x, y) in (0..length.min(image.width - LEFT)).flat_map(|x| (0..height).map(move |y| (x, y))) {
        let colour = shade::to_srgb(shade::warmth(x as f32 / (length - 1) as f32));
        image.pixels[(LEFT + y) * image.width + LEFT + x] = colour;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::Grid;

    #[test]
    fn errors_are_darker() {
        let sheet = |grid: Grid, off: f32| {
            let at = |k: usize, n: usize| k as f32 / (n - 1) as f32;
            let place = |p: usize| [off, 1.0 - at(p / grid.w, grid.h), at(p % grid.w, grid.w)];
            let positions: Vec<[f32; 3]> = (0..grid.particles()).map(place).collect();
            let mut trajectory = Trajectory::new(grid, 60.0);
            trajectory.push(&positions, &positions);
            trajectory
        };
        let truth = sheet(Grid { h: 10, w: 10 }, 0.0);
        let map = |h: usize, off: f32| {
            let frames = sheet(Grid { h, w: h }, off);
            ErrorMap { label: "a".into(), errors: vec![vec![off; h * h]], frames }
        };
        let view = View { azimuth: Some(0.0), elevation: Some(0.0), ..View::default() };
        let image = error_maps(&truth, &[0.5], &[0], &[map(10, 0.0), map(17, 0.02)], &view);
        let row = |k: usize| {
            let middle = &image.pixels[image.width * (k * HEIGHT + HEIGHT / 2)..][..image.width];
            middle.iter().map(|p| u64::from(p[1])).sum::<u64>()
        };
        assert_eq!(image.height, 3 * HEIGHT);
        assert!(row(2) < row(1), "{} and {}", row(1), row(2));
    }
}
