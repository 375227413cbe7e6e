//! Line charts.

use super::{Image, text};
use glam::{Vec2, vec2};

/// A chart: curves over one axis, with a title.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Title; letters appear as capitals.
    pub title: String,
    /// The curves.
    pub curves: Vec<Curve>,
    /// Of both axes.
    pub scale: Scale,
}

/// How an axis is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By ratios; what is not above 0 is left out.
    Logarithmic,
}

/// A curve of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub label: String,
    /// Points (x, y), x ascending. Where y is not finite the curve has a gap.
    pub points: Vec<[f64; 2]>,
}

/// Colours of the curves; more curves begin with them again, as broken lines. Told apart with most kinds of colour vision (after Okabe and Ito).
const COLOURS: [[u8; 3]; 7] = [
    [0, 114, 178],
    [230, 159, 0],
    [0, 158, 115],
    [204, 121, 167],
    [213, 94, 0],
    [86, 180, 233],
    [90, 90, 90],
];
const PAPER: [u8; 3] = [255; 3];
const LINES: [u8; 3] = [214, 218, 222];
/// Height of titles and of labels \[px\].
const TITLE: f32 = 11.0;
const LABEL: f32 = 8.0;
/// Space for the axes and the title \[px\]: left, top, right, bottom.
const MARGINS: [f32; 4] = [62.0, 30.0, 16.0, 26.0];
/// Space for what a legend has beside its labels \[px\].
const LEGEND: f32 = 28.0;
/// Length of a dash and of the gap after it \[px\].
const DASH: f32 = 4.0;
/// A curve of no more points than this shows each of them.
const FEW: usize = 14;
/// Share of the values at each end that may lie outside the chart, lest a spike flatten the rest.
const OUTSIDE: f64 = 0.005;

/// Draws charts in two columns on white, in an image of `width` x `height` pixels.
pub fn charts(charts: &[Chart], (width, height): (usize, usize)) -> Image {
    let mut image = Image::new(width, height);
    image.pixels.fill(PAPER);
    let rows = charts.len().div_ceil(2).max(1);
    let size = vec2(width as f32 / 2.0, (height / rows) as f32);
    for (k, chart) in charts.iter().enumerate() {
        let corner = vec2((k % 2) as f32, (k / 2) as f32) * size;
        draw(&mut image, chart, corner, size);
    }
    image
}

fn draw(image: &mut Image, chart: &Chart, corner: Vec2, size: Vec2) {
    let [left, top, right, bottom] = MARGINS;
    let labels = chart.curves.iter().map(|c| c.label.to_uppercase());
    let widest = labels.map(|label| text::width(&label, LABEL)).fold(0.0, f32::max);
    // The legend stands beside the curves.
    let right = right + LEGEND + widest;
    let low = corner + vec2(left, size.y - bottom);
    let high = corner + vec2(size.x - right, top);
    text::write(image, &chart.title.to_uppercase(), [low.x, corner.y + 8.0], TITLE);
    let shown = |p: &[f64; 2]| p.iter().all(|v| v.is_finite() && (chart.scale == Scale::Linear || *v > 0.0));
    let points = || chart.curves.iter().flat_map(|c| &c.points).filter(|p| shown(p));
    let x = Axis::over(points().map(|p| p[0]).collect(), 0.0, chart.scale);
    let y = Axis::over(points().map(|p| p[1]).collect(), OUTSIDE, chart.scale);
    for tick in x.ticks() {
        let at = low.x + (high.x - low.x) * x.place(tick);
        line(image, [vec2(at, low.y), vec2(at, high.y)], LINES, 0.5);
        let label = number(tick);
        text::write(image, &label, [at - text::width(&label, LABEL) / 2.0, low.y + 8.0], LABEL);
    }
    for tick in y.ticks() {
        let at = low.y + (high.y - low.y) * y.place(tick);
        line(image, [vec2(low.x, at), vec2(high.x, at)], LINES, 0.5);
        let label = number(tick);
        let place = [low.x - 6.0 - text::width(&label, LABEL), at - LABEL / 2.0];
        text::write(image, &label, place, LABEL);
    }
    for (k, curve) in chart.curves.iter().enumerate() {
        let place = |p: &[f64; 2]| {
            let inside = vec2(x.place(p[0]), y.place(p[1]).clamp(0.0, 1.0));
            shown(p).then(|| low + (high - low) * inside)
        };
        let places: Vec<Option<Vec2>> = curve.points.iter().map(place).collect();
        let mut stroke = Stroke::of(k, 0.9);
        for pair in places.windows(2) {
            match *pair {
                [Some(a), Some(b)] => stroke.to(image, [a, b]),
                _ => stroke.lift(),
            }
        }
        if places.len() <= FEW {
            places.iter().flatten().for_each(|&at| line(image, [at, at], stroke.colour, 2.6));
        }
    }
    for (k, curve) in chart.curves.iter().enumerate() {
        let (x, y) = (high.x + 8.0, high.y + 10.0 + 1.8 * LABEL * k as f32);
        Stroke::of(k, 1.2).to(image, [vec2(x, y), vec2(x + 14.0, y)]);
        text::write(image, &curve.label.to_uppercase(), [x + 20.0, y - LABEL / 2.0], LABEL);
    }
}

/// The line of a curve, drawn piece by piece.
struct Stroke {
    colour: [u8; 3],
    half: f32,
    broken: bool,
    /// How much of it is drawn \[px\].
    length: f32,
}

impl Stroke {
    /// Of the curve with this number, `half` its width.
    fn of(curve: usize, half: f32) -> Self {
        let broken = curve / COLOURS.len() % 2 == 1;
        Self { colour: COLOURS[curve % COLOURS.len()], half, broken, length: 0.0 }
    }

    /// Draws the next piece.
    fn to(&mut self, image: &mut Image, [a, b]: [Vec2; 2]) {
        if !self.broken {
            return line(image, [a, b], self.colour, self.half);
        }
        let (end, mut at) = (a.distance(b), 0.0);
        while at < end {
            // A dash and a gap are as long.
            let phase = (self.length + at) % (2.0 * DASH);
            let next = (at + if phase < DASH { DASH } else { 2.0 * DASH } - phase).max(at + 1e-2).min(end);
            if phase < DASH {
                line(image, [a.lerp(b, at / end), a.lerp(b, next / end)], self.colour, self.half);
            }
            at = next;
        }
        self.length += end;
    }

    /// Begins anew, after a gap.
    fn lift(&mut self) {
        self.length = 0.0;
    }
}

/// What one side of a chart spans.
struct Axis {
    low: f64,
    high: f64,
    scale: Scale,
}

impl Axis {
    /// Over these values, without the share `outside` at each end.
    fn over(mut values: Vec<f64>, outside: f64, scale: Scale) -> Self {
        values.sort_by(f64::total_cmp);
        let left_out = (values.len() as f64 * outside) as usize;
        let (Some(&low), Some(&high)) = (values.get(left_out), values.iter().nth_back(left_out)) else {
            return Self { low: 0.0, high: 1.0, scale: Scale::Linear };
        };
        match scale {
            // Room for the points at the ends.
            Scale::Logarithmic => {
                let room = (high / low).powf(0.04).max(1.1);
                Self { low: low / room, high: high * room, scale }
            }
            Scale::Linear => {
                let wide = if high > low { 0.0 } else { 0.5 * low.abs().max(1.0) };
                Self { low: low - wide, high: high + wide, scale }
            }
        }
    }

    /// Where a value lies, from 0 to 1.
    fn place(&self, value: f64) -> f32 {
        match self.scale {
            Scale::Logarithmic => ((value / self.low).ln() / (self.high / self.low).ln()) as f32,
            Scale::Linear => ((value - self.low) / (self.high - self.low)) as f32,
        }
    }

    /// Round numbers inside: three to seven of them, or the powers of ten, with their doubles and fives where those are few.
    fn ticks(&self) -> Vec<f64> {
        if self.scale == Scale::Logarithmic {
            let (first, last) = (self.low.log10().floor() as i32, self.high.log10().ceil() as i32);
            let steps: &[f64] = if self.high / self.low < 300.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
            let all = (first..=last).flat_map(|k| steps.iter().map(move |m| m * 10f64.powi(k)));
            let inside: Vec<f64> = all.filter(|tick| (self.low..=self.high).contains(tick)).collect();
            if inside.len() > 1 {
                return inside;
            }
        }
        let raw = (self.high - self.low) / 5.0;
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|&s| s >= raw).unwrap_or(raw);
        let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

/// A tick as text: short, without the rounding of its last place.
fn number(value: f64) -> String {
    let plain = format!("{value:.4}");
    let plain = plain.trim_end_matches('0').trim_end_matches('.');
    let small = value != 0.0 && value.abs() < 1e-3;
    if small || value.abs() >= 1e6 { format!("{value:.1e}") } else { plain.to_owned() }
}

/// Draws a smooth line, `half` its width.
fn line(image: &mut Image, ends: [Vec2; 2], colour: [u8; 3], half: f32) {
    let reach = Vec2::splat(half + 1.0);
    let (low, high) = (ends[0].min(ends[1]) - reach, ends[0].max(ends[1]) + reach);
    let span = |from: f32, to: f32, n: usize| from.max(0.0) as usize..(to.max(0.0) as usize + 1).min(n);
    for py in span(low.y, high.y, image.height) {
        for px in span(low.x, high.x, image.width) {
            let at = vec2(px as f32 + 0.5, py as f32 + 0.5);
            let cover = (half + 0.5 - text::distance(at, ends[0], ends[1])).clamp(0.0, 1.0);
            let pixel = &mut image.pixels[py * image.width + px];
            for (channel, ink) in pixel.iter_mut().zip(colour) {
                *channel = (f32::from(*channel) * (1.0 - cover) + f32::from(ink) * cover).round() as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_stay_in_their_charts_and_gaps_are_left_out() {
        let curve = |points: Vec<[f64; 2]>| Curve { label: "a".into(), points };
        let rising = curve((0..50).map(|k| [f64::from(k), f64::from(k * k)]).collect());
        let broken = curve(vec![[0.0, 0.0], [1.0, f64::NAN], [2.0, f64::INFINITY], [3.0, 1e300]]);
        let some = [vec![], vec![rising], vec![broken], vec![curve(vec![[5.0, 5.0]])]];
        let some = some.map(|curves| Chart { title: "t".into(), curves, scale: Scale::Linear });
        let image = charts(&some, (400, 300));
        let blue = |x: std::ops::Range<usize>, y: std::ops::Range<usize>| {
            y.flat_map(|y| x.clone().map(move |x| (x, y)))
                .filter(|&(x, y)| image.at(x, y) == COLOURS[0])
                .count()
        };
        assert_eq!(blue(0..200, 0..150), 0);
        assert!(blue(262..400, 34..124) > 20);
        assert_eq!(blue(200..260, 30..150), 0);
    }

    #[test]
    fn curves_beyond_the_colours_are_broken() {
        let count = |curve: usize| {
            let mut image = Image::new(100, 10);
            image.pixels.fill(PAPER);
            let mut stroke = Stroke::of(curve, 0.9);
            for k in 0..9 {
                stroke.to(&mut image, [k, k + 1].map(|k| vec2(10.0 * k as f32 + 3.0, 5.0)));
            }
            (0..100).filter(|&x| image.at(x, 4) != PAPER).count()
        };
        let (whole, broken) = (count(1), count(1 + COLOURS.len()));
        assert!((88..96).contains(&whole) && (50..75).contains(&broken), "{whole}, {broken}");
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let text = |axis: Axis| axis.ticks().into_iter().map(number).collect::<Vec<_>>().join(" ");
        let ticks = |low, high| text(Axis { low, high, scale: Scale::Linear });
        assert_eq!(ticks(0.0, 1.0), "0 0.2 0.4 0.6 0.8 1");
        assert_eq!(ticks(-3.7, 2.1), "-2 0 2");
        assert_eq!(ticks(100.0, 500_000.0), "100000 200000 300000 400000 500000");
        assert_eq!(ticks(0.0, 2e-4), "0 5.0e-5 1.0e-4 1.5e-4 2.0e-4");
        let decades = Axis { low: 0.02, high: 3000.0, scale: Scale::Logarithmic };
        assert!(
            ((decades.place(2.0) - decades.place(0.2)) - (decades.place(20.0) - decades.place(2.0))).abs()
                < 1e-6
        );
        assert_eq!(text(decades), "0.1 1 10 100 1000");
        assert_eq!(text(Axis { low: 30.0, high: 600.0, scale: Scale::Logarithmic }), "50 100 200 500");
        assert_eq!(
            text(Axis { low: 3724.0, high: 4506.0, scale: Scale::Logarithmic }),
            "3800 4000 4200 4400"
        );
    }
}
