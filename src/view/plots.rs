//! Curves of what frames were like.

use egui::{Color32, Pos2, Sense, Stroke, Ui, pos2, vec2};
use std::collections::VecDeque;

/// Most values of a curve: ten seconds at 60 a second.
const MOST: usize = 600;
/// Height of a plot \[points\].
const HEIGHT: f32 = 46.0;

/// The last values of a quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    values: VecDeque<f32>,
}

impl Series {
    /// Appends a value, and drops the oldest if there are too many.
    pub fn push(&mut self, value: f32) {
        if self.values.len() == MOST {
            self.values.pop_front();
        }
        self.values.push_back(value);
    }

    /// Forgets all values.
    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// Returns the values, the oldest first.
    pub fn values(&self) -> impl Iterator<Item = f32> + '_ {
        self.values.iter().copied()
    }

    /// Returns the last value.
    pub fn last(&self) -> Option<f32> {
        self.values.back().copied()
    }

    /// Returns the mean of up to `count` of the last values; `None` if there are none.
    pub fn mean(&self, count: usize) -> Option<f32> {
        let count = count.min(self.values.len());
        (count > 0).then(|| self.values.iter().rev().take(count).sum::<f32>() / count as f32)
    }
}

/// How values become heights.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Axis {
    /// From 0, or less, upwards.
    Linear,
    /// Powers of ten.
    Logarithmic,
}

/// Draws a curve with its name, its last value and its largest one.
pub(super) fn plot(ui: &mut Ui, (name, unit): (&str, &str), series: &Series, axis: Axis) {
    let last = series.last().map_or("-".into(), |last| format!("{} {unit}", brief(f64::from(last))));
    ui.horizontal(|ui| {
        ui.label(name);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| ui.monospace(last));
    });
    let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), HEIGHT), Sense::hover());
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
    let scaled = |value: f32| if axis == Axis::Logarithmic { value.max(1e-12).log10() } else { value };
    let heights: Vec<f32> = series.values().map(scaled).filter(|height| height.is_finite()).collect();
    let Some((low, high)) = range(&heights, axis) else { return };
    let place = |(k, height): (usize, &f32)| -> Pos2 {
        let x = (k as f32 + 0.5 + (MOST - heights.len()) as f32) / MOST as f32;
        let y = (height - low) / (high - low);
        pos2(rect.left() + x * rect.width(), rect.bottom() - 2.0 - y * (rect.height() - 4.0))
    };
    let line: Vec<Pos2> = heights.iter().enumerate().map(place).collect();
    painter.line(line, Stroke::new(1.5, Color32::from_rgb(56, 150, 200)));
    let most = if axis == Axis::Logarithmic { 10f32.powf(high) } else { high };
    let text = brief(f64::from(most));
    let font = egui::FontId::proportional(9.0);
    painter.text(
        rect.left_top() + vec2(3.0, 1.0),
        egui::Align2::LEFT_TOP,
        text,
        font,
        ui.visuals().weak_text_color(),
    );
}

/// Returns the ends of the axis for these heights; `None` if there are none.
fn range(heights: &[f32], axis: Axis) -> Option<(f32, f32)> {
    let ends = |(low, high): (f32, f32), &height: &f32| (low.min(height), high.max(height));
    let (low, high) = heights.iter().fold((f32::INFINITY, f32::NEG_INFINITY), ends);
    let low = if axis == Axis::Linear { low.min(0.0) } else { low.floor() };
    let high = if axis == Axis::Linear { high } else { high.ceil() };
    (low <= high).then_some((low, if high > low { high } else { low + 1.0 }))
}

/// Returns a number with three digits.
pub(super) fn brief(number: f64) -> String {
    match number.abs() {
        0.0 => "0".into(),
        size if !(1e-2..1e5).contains(&size) => format!("{number:.2e}"),
        size if size >= 100.0 => format!("{number:.0}"),
        size if size >= 10.0 => format!("{number:.1}"),
        size if size >= 1.0 => format!("{number:.2}"),
        _ => format!("{number:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_keeps_the_last_values() {
        let mut series = Series::default();
        assert_eq!((series.last(), series.mean(5)), (None, None));
        (0..MOST + 7).for_each(|k| series.push(k as f32));
        assert_eq!(series.values().next(), Some(7.0));
        assert_eq!(series.values().count(), MOST);
        assert_eq!(series.mean(3), Some((MOST + 5) as f32));
    }

    #[test]
    fn axes_hold_all_values() {
        assert_eq!(range(&[1.0, 3.0], Axis::Linear), Some((0.0, 3.0)));
        assert_eq!(range(&[-1.2, 0.3], Axis::Logarithmic), Some((-2.0, 1.0)));
        assert_eq!(range(&[0.0], Axis::Linear), Some((0.0, 1.0)));
        assert_eq!(range(&[], Axis::Linear), None);
        assert_eq!([0.0, 1e-6, 0.5, 12.34, 1492.9].map(brief), ["0", "1.00e-6", "0.500", "12.3", "1493"]);
    }
}
