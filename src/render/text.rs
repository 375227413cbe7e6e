//! Captions.

use super::Image;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::sync::Once;

/// DejaVu Sans 2.37, reduced to Latin and Greek with `pyftsubset --no-hinting --layout-features=`.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) const FONT: &[u8] = include_bytes!("../../assets/fonts/DejaVuSans.ttf");
/// How far above the given position plotters draws the top of capitals, and the height of capitals, as
/// fractions of the line height.
pub(super) const RAISED: f32 = 1.0 / 6.0;
pub(super) const CAPITALS: f32 = 2.0 / 3.0;
/// Colour of captions.
pub(super) const INK: RGBColor = RGBColor(70, 74, 80);

/// Returns the style of captions with this line height \[px\], positioned by their upper left corner (see
/// [`RAISED`]).
pub(super) fn style(height: f32) -> TextStyle<'static> {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        // In a browser, plotters measures with the fonts of the page.
        #[cfg(not(target_arch = "wasm32"))]
        assert!(
            plotters::style::register_font("sans-serif", FontStyle::Normal, FONT).is_ok(),
            "the font is one"
        );
    });
    TextStyle::from(("sans-serif", height).into_font()).color(&INK).pos(Pos::new(HPos::Left, VPos::Top))
}

/// Writes a line of text of this height \[px\], with the upper left corner of its capitals at column and row
/// `[x, y]`.
pub(super) fn write(image: &mut Image, text: &str, [x, y]: [f32; 2], height: f32) {
    let size = (image.width as u32, image.height as u32);
    let mut backend = BitMapBackend::with_buffer(image.pixels.as_flattened_mut(), size);
    let place = (x as i32, (y + RAISED * height).round() as i32);
    let drawn = backend.draw_text(text, &style(height), place);
    drawn.expect("the font is there, and memory takes what is drawn");
}

/// Returns the width of a line of text of this height \[px\].
pub(super) fn width(text: &str, height: f32) -> f32 {
    let ((left, _), (right, _)) = style(height).font.layout_box(text).expect("the font is there");
    (right - left) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captions_are_as_wide_as_measured_and_stay_in_their_line() {
        for text in ["0.50 s", "newton, N = 10", "\u{3b1} \u{b7} 10\u{b3}"] {
            let mut image = Image::new(400, 60);
            write(&mut image, text, [20.0, 10.0], 24.0);
            let inked = |p: &(usize, usize)| image.at(p.0, p.1) != [0; 3];
            let all: Vec<_> = (0..400).flat_map(|x| (0..60).map(move |y| (x, y))).filter(inked).collect();
            let (left, right) =
                (all.iter().map(|p| p.0).min().unwrap(), all.iter().map(|p| p.0).max().unwrap());
            assert!(left >= 20 && right as f32 <= 21.0 + width(text, 24.0), "{text}: {left} to {right}");
            assert!(right as f32 > 14.0 + width(text, 24.0), "{text}: {right}");
            let (top, bottom) =
                (all.iter().map(|p| p.1).min().unwrap(), all.iter().map(|p| p.1).max().unwrap());
            assert!((9..=11).contains(&top) && (25..=32).contains(&bottom), "{text}: {top} to {bottom}");
        }
    }

    #[test]
    fn what_does_not_fit_is_cut_off() {
        let mut image = Image::new(10, 10);
        write(&mut image, "wide", [-3.0, 4.0], 24.0);
        write(&mut image, "far", [400.0, 400.0], 24.0);
        write(&mut image, "", [0.0, 0.0], 24.0);
        assert!(image.pixels.iter().any(|p| *p != [0; 3]));
    }
}
