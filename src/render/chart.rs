//! Line charts.

use super::notes::Taken;
use super::{Image, text};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use rayon::prelude::*;
use std::error::Error;
use std::ops::Range;

/// A chart: curves over a common axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Title.
    pub title: String,
    /// Labels of the horizontal and the vertical axis.
    pub axes: [String; 2],
    /// The curves.
    pub curves: Vec<Curve>,
    /// Vertical lines across the chart.
    pub lines: Vec<Line>,
    /// The scales of the horizontal and the vertical axis.
    pub scales: [Scale; 2],
}

/// A vertical line across a chart, at something that has a place on the horizontal axis alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Name in the legend.
    pub label: String,
    /// Number of its colour, as of curves.
    pub colour: usize,
    /// Its place on the horizontal axis.
    pub at: f64,
}

/// The scale of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Linear.
    Linear,
    /// Logarithmic; values that are not above 0 are left out.
    Logarithmic,
}

/// A curve of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub label: String,
    /// Number of its colour. One that stands for the same thing in several charts has the same in all.
    pub colour: usize,
    /// Points (x, y), joined in their order. A y that is not finite leaves a gap in the curve.
    pub points: Vec<[f64; 2]>,
    /// Short notes next to the points, in their order; there may be fewer. One that finds no place where it covers
    /// no point is left out.
    pub notes: Vec<String>,
}

/// Colours of the curves, distinguishable with most kinds of colour vision (after Okabe and Ito). Higher
/// numbers reuse them with dashed lines.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(213, 94, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];
const LINES: RGBColor = RGBColor(214, 218, 222);
/// Charts are drawn this many times as large along each axis and then averaged: the library puts letters and
/// lines on whole pixels. All other lengths are in the pixels that it draws.
pub(super) const FINE: usize = 3;
/// Height of titles and of labels.
const TITLE: f32 = 18.0 * FINE as f32;
const LABEL: f32 = 14.0 * FINE as f32;
/// Height of the notes next to points.
const NOTE: f32 = 11.0 * FINE as f32;
/// Room for the labels below and left of a chart.
const BELOW: usize = 40 * FINE;
const LEFT: usize = 64 * FINE;
/// Length of a legend's line, and the space around its labels.
const SAMPLE: i32 = 14 * FINE as i32;
const SPACE: i32 = 6 * FINE as i32;
/// Width of a line, and radius of a point.
const WIDTH: u32 = 2 * FINE as u32;
pub(super) const POINT: usize = 3 * FINE;
/// Length of a dash and of the gap after it.
const DASH: u32 = 5 * FINE as u32;
/// A curve with no more points than this marks each of them.
const FEW: usize = 14;
/// Share of the values at each end that may lie outside the chart, so that a spike does not flatten the rest,
/// and how many times as large the span must be with them.
const OUTSIDE: f64 = 0.005;
const SPIKE: f64 = 2.0;
/// Magnitude from which on values are not drawn: no measurement, and near the end of the numbers the library looks for
/// ticks without end.
const LARGEST: f64 = 1e301;
/// Approximate number of ticks along an axis.
const TICKS: usize = 7;

/// The part of a picture that a chart occupies.
type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

/// Draws charts on white, each `width` x `height` pixels; several are in two columns.
pub fn charts(charts: &[Chart], (width, height): (usize, usize)) -> Image {
    let columns = charts.len().clamp(1, 2);
    let mut image = Image::new(columns * width, charts.len().div_ceil(columns).max(1) * height);
    image.pixels.fill([255; 3]);
    let all: Vec<Image> = charts.par_iter().map(|chart| alone(chart, (width, height))).collect();
    for (k, chart) in all.iter().enumerate() {
        image.paste(chart, [k % columns * width, k / columns * height]);
    }
    image
}

/// Draws one chart on white.
fn alone(chart: &Chart, (width, height): (usize, usize)) -> Image {
    let mut fine = Image::new(FINE * width, FINE * height);
    {
        let size = (fine.width as u32, fine.height as u32);
        let whole = BitMapBackend::with_buffer(fine.pixels.as_flattened_mut(), size).into_drawing_area();
        let draw = || -> Result<(), Box<dyn Error>> {
            whole.fill(&WHITE)?;
            draw(&whole, chart)?;
            Ok(whole.present()?)
        };
        draw().expect("the font is there, and memory takes what is drawn");
    }
    fine.reduced(FINE)
}

fn draw(area: &Area<'_>, chart: &Chart) -> Result<(), Box<dyn Error>> {
    let (title, label) = (text::style(TITLE), text::style(LABEL));
    // The legend is to the right of the curves.
    let labels = || chart.curves.iter().map(|c| &c.label).chain(chart.lines.iter().map(|line| &line.label));
    let widest = labels().map(|label| text::width(label, LABEL) as i32).fold(0, i32::max);
    let (left, legend) = area.split_horizontally(area.dim_in_pixel().0 as i32 - SAMPLE - 3 * SPACE - widest);
    let shown = |p: &[f64; 2]| p.iter().zip(chart.scales).all(|(v, scale)| scale.shows(*v));
    let values = |k: usize| {
        let points = chart.curves.iter().flat_map(|c| &c.points).filter(|p| shown(p));
        points.map(|p| p[k]).collect::<Vec<f64>>()
    };
    let at = chart.lines.iter().map(|line| line.at).filter(|&at| chart.scales[0].shows(at));
    let x = Axis::over(values(0).into_iter().chain(at.clone()).collect(), 0.0, chart.scales[0]);
    let y = Axis::over(values(1), OUTSIDE, chart.scales[1]);
    let mut plot = ChartBuilder::on(&left)
        .caption(&chart.title, title)
        .margin(SPACE)
        .x_label_area_size(BELOW as u32)
        .y_label_area_size(LEFT as u32)
        .build_cartesian_2d(x, y)?;
    plot.configure_mesh()
        .axis_style(LINES.stroke_width(FINE as u32))
        .bold_line_style(LINES.stroke_width(FINE as u32))
        .set_all_tick_mark_size(5 * FINE as i32)
        .light_line_style(TRANSPARENT)
        .label_style(label.clone())
        .axis_desc_style(label.clone())
        .x_desc(&chart.axes[0])
        .y_desc(&chart.axes[1])
        .draw()?;
    let in_legend = |k: usize| {
        let middle = (TITLE + 2.0 * SPACE as f32 + 1.3 * LABEL * (k as f32 + 0.5)) as i32;
        let line = [(SPACE, middle), (SPACE + SAMPLE, middle)];
        let place =
            (2 * SPACE + SAMPLE, middle - ((0.5 * text::CAPITALS - text::RAISED) * LABEL).round() as i32);
        (line, place)
    };
    // First the lines, so that they cover no curve.
    for (k, line) in chart.lines.iter().enumerate() {
        let style = COLOURS[line.colour % COLOURS.len()].stroke_width(WIDTH);
        let Range { start, end } = plot.y_range();
        if chart.scales[0].shows(line.at) {
            let ends = [(line.at, start), (line.at, end)];
            plot.draw_series(DashedLineSeries::new(ends, DASH, DASH, style))?;
        }
        let (sample, place) = in_legend(chart.curves.len() + k);
        legend.draw(&DashedPathElement::new(sample, DASH, DASH, style))?;
        legend.draw(&Text::new(&*line.label, place, label.clone()))?;
    }
    for (k, curve) in chart.curves.iter().enumerate() {
        let style = COLOURS[curve.colour % COLOURS.len()].stroke_width(WIDTH);
        let is_broken = curve.colour / COLOURS.len() % 2 == 1;
        for part in curve.points.split(|p| !shown(p)) {
            let places = part.iter().map(|p| (p[0], p[1]));
            match is_broken {
                true => plot.draw_series(DashedLineSeries::new(places.clone(), DASH, DASH, style))?,
                // Segment by segment: the library extends sharp corners of a path far beyond its points.
                false => plot.draw_series(
                    part.windows(2)
                        .map(|ends| PathElement::new([ends[0], ends[1]].map(|p| (p[0], p[1])), style)),
                )?,
            };
            if curve.points.len() <= FEW {
                plot.draw_series(places.map(|at| Circle::new(at, POINT as i32, style.filled())))?;
            }
        }
        let (line, place) = in_legend(k);
        match is_broken {
            true => legend.draw(&DashedPathElement::new(line, DASH, DASH, style))?,
            false => legend.draw(&PathElement::new(line, style))?,
        }
        legend.draw(&Text::new(&*curve.label, place, label.clone()))?;
    }
    let pixel = |x: f64, y: f64| {
        let (column, row) = plot.plotting_area().map_coordinate(&(x, y));
        [f64::from(column), f64::from(row)]
    };
    let (columns, rows) = plot.plotting_area().get_pixel_range();
    let inside = [columns, rows].map(|Range { start, end }| f64::from(start)..f64::from(end));
    let [_, Range { start: top, end: bottom }] = inside.clone();
    let mut taken = Taken { inside, points: Vec::new(), strokes: Vec::new(), notes: Vec::new() };
    for curve in &chart.curves {
        for part in curve.points.split(|p| !shown(p)) {
            let places: Vec<[f64; 2]> = part.iter().map(|p| pixel(p[0], p[1])).collect();
            taken.strokes.extend(places.windows(2).map(|ends| [ends[0], ends[1]]));
            taken.points.extend(places);
        }
    }
    let lowest = plot.y_range().start;
    taken.strokes.extend(at.map(|at| pixel(at, lowest)[0]).map(|column| [[column, top], [column, bottom]]));
    for curve in &chart.curves {
        let style = text::style(NOTE).color(&COLOURS[curve.colour % COLOURS.len()]);
        for (p, note) in curve.points.iter().zip(&curve.notes).filter(|(p, _)| shown(p)) {
            let size = [text::width(note, NOTE), text::CAPITALS * NOTE].map(f64::from);
            let Some([left, top]) = taken.place(pixel(p[0], p[1]), size) else { continue };
            let place = (left.round() as i32, (top + f64::from(text::RAISED * NOTE)).round() as i32);
            area.draw(&Text::new(&**note, place, style.clone()))?;
        }
    }
    Ok(())
}

/// The span of one axis, in values or, on a logarithmic scale, in their logarithms.
struct Axis {
    span: Range<f64>,
    scale: Scale,
}

impl Axis {
    /// Returns an axis over these values, without the share `outside` at each end.
    fn over(mut values: Vec<f64>, outside: f64, scale: Scale) -> Self {
        values.iter_mut().for_each(|value| *value = scale.of(*value));
        values.sort_by(f64::total_cmp);
        let ends = |left_out: usize| Some((*values.get(left_out)?, *values.iter().nth_back(left_out)?));
        let left_out = (values.len() as f64 * outside) as usize;
        let (Some(inner), Some(outer)) = (ends(left_out), ends(0)) else {
            return Self { span: 0.0..1.0, scale: Scale::Linear };
        };
        let is_spike = outer.1 - outer.0 > SPIKE * (inner.1 - inner.0);
        let (low, high) = if is_spike { inner } else { outer };
        // Leave room for the points at the ends of short curves, and for ticks if all values are alike.
        let least = 1e-6 * low.abs().max(high.abs());
        let room = match scale {
            Scale::Logarithmic => (0.04 * (high - low)).max(0.05),
            Scale::Linear if high - low > least => 0.0,
            Scale::Linear => 0.5 * low.abs().max(1.0),
        };
        Self { span: low - room..high + room, scale }
    }

    /// Returns round numbers within the span: on a logarithmic scale the powers of ten, with numbers in between
    /// if those are few.
    fn ticks(&self) -> Vec<f64> {
        let Range { start, end } = self.span;
        if self.scale == Scale::Logarithmic {
            let inside = |steps: &[f64]| -> Vec<f64> {
                let decades = start.floor() as i32..=end.ceil() as i32;
                let all = decades.flat_map(|k| steps.iter().map(move |m| m * 10f64.powi(k)));
                all.filter(|tick| self.span.contains(&tick.log10())).collect()
            };
            let steps: [&[f64]; 3] = [&[1.0], &[1.0, 2.0, 5.0], &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0]];
            if let Some(enough) = steps.into_iter().map(inside).find(|ticks| ticks.len() > 2) {
                return enough;
            }
        }
        let [low, high] = [start, end].map(|at| self.scale.at(at));
        RangedCoordf64::from(low..high).key_points(TICKS)
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    /// Returns the position of a value, clamped to the axis.
    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let Range { start, end } = self.span;
        let share = (self.scale.of(*value).clamp(start, end) - start) / (end - start);
        first + (share * f64::from(last - first)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks()
    }

    fn range(&self) -> Range<f64> {
        self.scale.at(self.span.start)..self.scale.at(self.span.end)
    }
}

impl ValueFormatter<f64> for Axis {
    fn format(value: &f64) -> String {
        number(*value)
    }
}

impl Scale {
    /// Whether a value has a position.
    fn shows(self, value: f64) -> bool {
        value.abs() < LARGEST && (self == Self::Linear || value > 0.0)
    }

    /// Maps a value to its position on a uniform axis.
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Logarithmic => value.log10(),
        }
    }

    /// Returns the value at a position: the inverse of [`Scale::of`].
    fn at(self, place: f64) -> f64 {
        match self {
            Self::Linear => place,
            Self::Logarithmic => 10f64.powf(place),
        }
    }
}

/// Formats a tick: short, without the rounding error of its last digit.
fn number(value: f64) -> String {
    let plain = format!("{value:.4}");
    let plain = plain.trim_end_matches('0').trim_end_matches('.');
    let small = value.abs() < 1e-3 && value.abs() > 1e-12;
    if small || value.abs() >= 1e6 {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    if plain == "-0" { "0".to_owned() } else { plain.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(curves: Vec<Curve>, scale: Scale) -> Chart {
        let axes = ["x".into(), "y".into()];
        Chart { title: "t".into(), axes, curves, lines: Vec::new(), scales: [scale; 2] }
    }

    fn curve(points: Vec<[f64; 2]>) -> Curve {
        Curve { label: "a".into(), colour: 0, points, notes: Vec::new() }
    }

    fn count(image: &Image, colour: RGBColor, (x, y): (Range<usize>, Range<usize>)) -> usize {
        let places = y.flat_map(|y| x.clone().map(move |x| (x, y)));
        // The edges of lines are blended with the background.
        let near = |p: [u8; 3]| p.iter().zip([colour.0, colour.1, colour.2]).all(|(p, c)| p.abs_diff(c) < 70);
        places.filter(|&(x, y)| near(image.at(x, y))).count()
    }

    #[test]
    fn curves_stay_in_their_charts_and_gaps_are_left_out() {
        let rising = curve((0..50).map(|k| [f64::from(k), f64::from(k * k)]).collect());
        let broken = curve(vec![[0.0, 0.0], [1.0, f64::NAN], [2.0, f64::INFINITY], [3.0, 1e300]]);
        let some = [vec![], vec![rising], vec![broken], vec![curve(vec![[5.0, 5.0]])]];
        let image = charts(&some.map(|curves| chart(curves, Scale::Linear)), (400, 300));
        let blue = |x, y| count(&image, COLOURS[0], (x, y));
        assert_eq!(blue(0..400, 0..300), 0);
        assert!(blue(470..740, 30..260) > 100);
        // Two points and the legend, and nothing between them.
        assert!(blue(0..400, 300..600) > 40);
        assert_eq!(blue(120..300, 300..600), 0);
    }

    /// The library's own paths extend sharp corners far beyond their points.
    #[test]
    fn sharp_corners_stay_in_their_charts() {
        let zigzag = curve((0..500).map(|k| [f64::from(k), f64::from(k % 2)]).collect());
        let some = [vec![zigzag], vec![], vec![], vec![]];
        let image = charts(&some.map(|curves| chart(curves, Scale::Linear)), (400, 300));
        let blue = |x, y| count(&image, COLOURS[0], (x, y));
        assert!(blue(0..400, 30..270) > 1000);
        assert_eq!((blue(0..400, 0..20), blue(0..800, 290..600)), (0, 0));
    }

    /// Any measured values: none, one, nearly equal ones, the largest and the smallest numbers.
    #[test]
    fn any_numbers_make_a_chart() {
        let tiny = f64::MIN_POSITIVE;
        let all: [&[f64]; 8] = [
            &[],
            &[3.0],
            &[0.0, 0.0],
            &[1e16, 1e16 + 2.0],
            &[1.0, 1.0 + f64::EPSILON],
            &[-1e300, 1e300],
            &[tiny / 8.0, tiny],
            &[f64::NAN, f64::NEG_INFINITY],
        ];
        for values in all {
            let points = values.iter().enumerate().map(|(k, &v)| [k as f64 + 1.0, v]).collect::<Vec<_>>();
            for scale in [Scale::Linear, Scale::Logarithmic] {
                let axis = Axis::over(values.iter().copied().filter(|v| v.is_finite()).collect(), 0.0, scale);
                if scale == Scale::Linear {
                    assert!(axis.ticks().len() < 30, "{values:?}");
                }
                charts(&[chart(vec![curve(points.clone())], scale)], (500, 300));
            }
        }
        // Too small for the title and labels of a chart.
        charts(&[chart(vec![curve(vec![[0.0, 0.0], [1.0, 1.0]])], Scale::Linear)], (60, 20));
    }

    #[test]
    fn a_curve_has_its_own_colour_wherever_it_stands() {
        let rising = Curve { colour: 1, ..curve((0..50).map(|k| [f64::from(k), f64::from(k)]).collect()) };
        let image = charts(&[chart(vec![rising], Scale::Linear)], (400, 300));
        let of = |k: usize| count(&image, COLOURS[k], (70..340, 30..250));
        assert!(of(1) > 100 && of(0) == 0, "{} and {}", of(1), of(0));
    }

    #[test]
    fn curves_beyond_the_colours_are_broken() {
        let level =
            |k: usize| Curve { colour: k, ..curve((0..50).map(|x| [f64::from(x), k as f64]).collect()) };
        let image = charts(&[chart((0..8).map(level).collect(), Scale::Linear)], (400, 400));
        let row = |k: usize| {
            let rows = (0..400).map(|y| count(&image, COLOURS[k], (80..380, y..y + 1)));
            rows.filter(|&n| n > 20).collect::<Vec<_>>()
        };
        // The first and the eighth share a colour.
        let (first, second) = (row(0), row(1));
        let [whole, broken] = [first.iter().max(), first.iter().min()].map(|n| *n.unwrap());
        assert!(first.len() >= 2 && second.iter().max() >= Some(&whole), "{first:?}, {second:?}");
        assert!((0.4..0.75).contains(&(broken as f64 / whole as f64)), "{first:?}");
    }

    #[test]
    fn a_line_crosses_the_chart_at_its_place() {
        let far = |at| Line { label: "there".into(), colour: 4, at };
        let bare = chart(vec![curve(vec![[1.0, 1.0], [10.0, 10.0]])], Scale::Logarithmic);
        let image = charts(&[Chart { lines: vec![far(100.0), far(-1.0)], ..bare }], (400, 300));
        let red = |x, y| count(&image, COLOURS[4], (x, y));
        // The axis reaches as far as the line, which is dashed from the bottom to the top.
        let column = (200..330).max_by_key(|&x| red(x..x + 2, 30..255)).unwrap();
        let near = column - 2..column + 4;
        assert!(column > 280 && red(near.clone(), 30..255) > 60, "{column}");
        assert!(red(near.clone(), 32..50) > 0 && red(near, 235..255) > 0);
        assert_eq!(red(70..column - 2, 30..255), 0);
        // Both are in the legend, also the one without a place.
        assert!(red(330..400, 30..90) > 10);
    }

    /// Two curves close to each other, with points on top of each other, and one that ends in the corner.
    #[test]
    fn notes_cover_no_point_and_no_other_note() {
        let curves: Vec<Curve> = (0..4)
            .map(|c| {
                let points: Vec<_> = (0..6).map(|k| [f64::from(k), f64::from(k * c) + 0.1]).collect();
                Curve { colour: c as usize, notes: vec!["30".into(); 6], ..curve(points) }
            })
            .collect();
        let bare = curves.iter().map(|c| Curve { notes: Vec::new(), ..c.clone() }).collect();
        let [noted, bare] = [curves, bare].map(|curves| charts(&[chart(curves, Scale::Linear)], (500, 400)));
        let is_point = |p: [u8; 3]| COLOURS.iter().any(|c| p == [c.0, c.1, c.2]);
        let changed: Vec<_> =
            (0..noted.pixels.len()).filter(|&k| noted.pixels[k] != bare.pixels[k]).collect();
        assert!(changed.len() > 500, "{}", changed.len());
        // Strokes may be met where there is no room, but not by many.
        let covered = changed.iter().filter(|&&k| is_point(bare.pixels[k])).count();
        assert!(10 * covered < changed.len(), "{covered} of {}", changed.len());
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let text = |low: f64, high: f64, scale: Scale| {
            let axis = Axis { span: scale.of(low)..scale.of(high), scale };
            axis.ticks().into_iter().map(number).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(text(0.0, 1.0, Scale::Linear), "0 0.2 0.4 0.6 0.8 1");
        assert_eq!(text(0.0, 2e-4, Scale::Linear), "0 5e-5 1e-4 1.5e-4 2e-4");
        assert_eq!(text(-3e6, 3e6, Scale::Linear), "-3e6 -2e6 -1e6 0 1e6 2e6 3e6");
        assert_eq!(text(0.02, 3000.0, Scale::Logarithmic), "0.1 1 10 100 1000");
        assert_eq!(text(0.0, 9e300, Scale::Linear), "0 2e300 4e300 6e300 8e300");
        assert!(
            !Scale::Linear.shows(-9e307)
                && !Scale::Logarithmic.shows(9e307)
                && !Scale::Linear.shows(f64::NAN)
        );
        assert_eq!(text(30.0, 600.0, Scale::Logarithmic), "50 100 200 500");
        assert_eq!(text(3.5, 16.0, Scale::Logarithmic), "5 7 10 15");
        assert_eq!(text(0.03, 35.0, Scale::Logarithmic), "0.1 1 10");
        assert_eq!(text(3724.0, 4506.0, Scale::Logarithmic), "3800 4000 4200 4400");
    }
}
