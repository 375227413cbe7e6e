//! Small captions: digits and capitals drawn as smooth strokes.

use super::Image;
use glam::{Vec2, vec2};

/// Height of a digit in units of its strokes; a digit is 4 wide.
const TALL: f32 = 6.0;
/// From one digit to the next.
const ADVANCE: f32 = 5.6;
/// Half the width of a stroke.
const HALF_STROKE: f32 = 0.36;
/// Colour of captions.
const INK: [f32; 3] = [70.0, 74.0, 80.0];

/// The strokes of a character, as lines through points (x right, y down, from the top left).
fn strokes(character: char) -> &'static [&'static [(f32, f32)]] {
    match character {
        '0' => &[&[(1., 0.), (3., 0.), (4., 1.), (4., 5.), (3., 6.), (1., 6.), (0., 5.), (0., 1.), (1., 0.)]],
        '1' => &[&[(0.6, 1.2), (2., 0.), (2., 6.)], &[(0.6, 6.), (3.4, 6.)]],
        '2' => &[&[(0., 1.), (1., 0.), (3., 0.), (4., 1.), (4., 2.2), (0., 6.), (4., 6.)]],
        '3' => &[
            &[(0., 0.8), (1., 0.), (3., 0.), (4., 1.), (4., 2.), (3., 2.9), (1.5, 2.9)],
            &[(3., 2.9), (4., 3.9), (4., 5.), (3., 6.), (1., 6.), (0., 5.2)],
        ],
        '4' => &[&[(3., 6.), (3., 0.), (0., 4.2), (4., 4.2)]],
        '5' => &[&[
            (4., 0.),
            (0.5, 0.),
            (0.2, 2.8),
            (1., 2.3),
            (3., 2.3),
            (4., 3.3),
            (4., 5.),
            (3., 6.),
            (1., 6.),
            (0., 5.2),
        ]],
        '6' => &[&[
            (3.6, 0.4),
            (3., 0.),
            (1., 0.),
            (0., 1.),
            (0., 5.),
            (1., 6.),
            (3., 6.),
            (4., 5.),
            (4., 3.7),
            (3., 2.7),
            (1., 2.7),
            (0., 3.7),
        ]],
        '7' => &[&[(0., 0.), (4., 0.), (1.4, 6.)]],
        '8' => &[
            &[(1., 0.), (3., 0.), (4., 0.9), (4., 2.), (3., 2.9), (1., 2.9), (0., 2.), (0., 0.9), (1., 0.)],
            &[(1., 2.9), (0., 3.9), (0., 5.), (1., 6.), (3., 6.), (4., 5.), (4., 3.9), (3., 2.9)],
        ],
        '9' => &[&[
            (4., 2.3),
            (3., 3.3),
            (1., 3.3),
            (0., 2.3),
            (0., 1.),
            (1., 0.),
            (3., 0.),
            (4., 1.),
            (4., 5.),
            (3., 6.),
            (1., 6.),
            (0.4, 5.6),
        ]],
        '.' => &[&[(0.3, 5.9), (0.3, 6.)]],
        's' => &[&[
            (3.2, 2.7),
            (2.6, 2.2),
            (0.9, 2.2),
            (0.2, 2.9),
            (0.2, 3.3),
            (0.9, 3.9),
            (2.5, 4.2),
            (3.3, 4.8),
            (3.3, 5.3),
            (2.6, 6.),
            (0.8, 6.),
            (0.1, 5.5),
        ]],
        _ => &[],
    }
}

/// The strokes of a letter or sign: points as pairs of digits, x right and y down; a space lifts the pen.
fn letter(character: char) -> &'static str {
    match character.to_ascii_uppercase() {
        'A' => "062046 1434",
        'B' => "06003041423303 3344453606",
        'C' => "413010010516 36451636",
        'D' => "00062644422000",
        'E' => "40000646 0333",
        'F' => "400006 0333",
        'G' => "41301001051636454323",
        'H' => "0006 4046 0343",
        'I' => "1030 2026 1636",
        'J' => "404536160504",
        'K' => "0006 4003 0346",
        'L' => "000646",
        'M' => "0600234046",
        'N' => "06004640",
        'O' => "103041453616050110",
        'P' => "06003041423303",
        'Q' => "103041453616050110 2446",
        'R' => "06003041423303 2346",
        'S' => "41301001021333444536160605",
        'T' => "0040 2026",
        'U' => "000516364540",
        'V' => "002640",
        'W' => "0016233640",
        'X' => "0046 4006",
        'Y' => "002340 2326",
        'Z' => "00400646",
        '-' => "0343",
        '+' => "0343 2125",
        '/' => "0640",
        '=' => "0242 0444",
        '_' => "0646",
        ',' => "1506",
        ':' => "0202 0606",
        '(' => "30121436",
        ')' => "10323416",
        '>' => "014305",
        '%' => "0640 0101 4545",
        _ => "",
    }
}

/// Width of `text` when it is written `height` pixels tall \[px\].
pub(super) fn width(text: &str, height: f32) -> f32 {
    height / TALL * text.chars().map(advance).sum::<f32>()
}

/// From the left of a character to the next, in units of its strokes.
fn advance(character: char) -> f32 {
    if matches!(character, '.' | ' ' | ':' | ',') { 0.4 * ADVANCE } else { ADVANCE }
}

/// Writes `text` (digits, letters as capitals except the 's' of seconds, signs and spaces) with its top left corner at `(x, y)` \[px\], `height` pixels tall.
pub(super) fn write(image: &mut Image, text: &str, [x, y]: [f32; 2], height: f32) {
    let unit = height / TALL;
    let mut left = x;
    for character in text.chars() {
        let corner = vec2(left, y);
        let place = |(x, y): (f32, f32)| corner + unit * vec2(x, y);
        let digits =
            strokes(character).iter().flat_map(|line| line.windows(2)).map(|p| (place(p[0]), place(p[1])));
        let point = |p: &[u8]| place((f32::from(p[0] - b'0'), f32::from(p[1] - b'0')));
        let letters = if strokes(character).is_empty() { letter(character) } else { "" };
        let letters = letters.split(' ').flat_map(|line| {
            let points: Vec<Vec2> = line.as_bytes().chunks_exact(2).map(point).collect();
            points.windows(2).map(|p| (p[0], p[1])).collect::<Vec<_>>()
        });
        let lines: Vec<(Vec2, Vec2)> = digits.chain(letters).collect();
        draw(image, &lines, corner, unit);
        left += unit * advance(character);
    }
}

fn draw(image: &mut Image, lines: &[(Vec2, Vec2)], corner: Vec2, unit: f32) {
    let span = |from: f32, length: f32, n: usize| {
        (from - unit).max(0.0) as usize..((from + length * unit + unit).ceil().max(0.0) as usize).min(n)
    };
    for py in span(corner.y, TALL, image.height) {
        for px in span(corner.x, 4.0, image.width) {
            let at = vec2(px as f32 + 0.5, py as f32 + 0.5);
            let distance = lines.iter().map(|&(a, b)| distance(at, a, b)).fold(f32::MAX, f32::min);
            let cover = (HALF_STROKE * unit + 0.5 - distance).clamp(0.0, 1.0);
            let pixel = &mut image.pixels[py * image.width + px];
            for (channel, ink) in pixel.iter_mut().zip(INK) {
                *channel = (f32::from(*channel) * (1.0 - cover) + ink * cover).round() as u8;
            }
        }
    }
}

/// The distance from a point to a line between two others.
pub(super) fn distance(p: Vec2, a: Vec2, b: Vec2) -> f32 {
    let along = (b - a).length_squared().max(1e-12);
    let t = ((p - a).dot(b - a) / along).clamp(0.0, 1.0);
    p.distance(a + t * (b - a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_character_has_its_own_picture_and_text_may_leave_the_image() {
        let picture = |text: &str| {
            let mut image = Image::new(14, 16);
            image.pixels.fill([255; 3]);
            write(&mut image, text, [2.0, 2.0], 12.0);
            image.pixels
        };
        let mut pictures: Vec<_> = "0123456789.s ABCDEFGHIJKLMNPQRSTUVWXYZ-+/=_,:()>%"
            .chars()
            .map(|c| picture(&c.to_string()))
            .collect();
        let count = pictures.len();
        pictures.sort();
        pictures.dedup();
        assert_eq!(pictures.len(), count);
        let mut image = Image::new(5, 5);
        write(&mut image, "8.88 s", [-3.0, -2.0], 30.0);
    }
}
