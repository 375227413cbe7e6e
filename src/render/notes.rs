//! Where the notes next to the points of a chart find room.

use super::chart::{FINE, POINT};
use std::ops::Range;

/// How far from its point a note may be.
const NEAR: [f64; 3] = [5.0 * FINE as f64, 9.0 * FINE as f64, 14.0 * FINE as f64];

/// What notes keep clear of, in pixels of the whole picture.
pub(super) struct Taken {
    /// Columns and rows of the plot.
    pub inside: [Range<f64>; 2],
    /// Points, which no note covers.
    pub points: Vec<[f64; 2]>,
    /// The ends of straight strokes.
    pub strokes: Vec<[[f64; 2]; 2]>,
    /// Columns and rows of the notes so far.
    pub notes: Vec<[Range<f64>; 2]>,
}

impl Taken {
    /// Finds the place next to a point for a note of this width and height that covers no point and no other note
    /// and meets the fewest strokes, the nearest of several, and returns its upper left corner.
    pub fn place(&mut self, point: [f64; 2], size: [f64; 2]) -> Option<[f64; 2]> {
        // From the upper right all round.
        const AROUND: [[f64; 2]; 8] = [
            [1.0, -1.0],
            [1.0, 1.0],
            [-1.0, -1.0],
            [-1.0, 1.0],
            [0.0, -1.0],
            [0.0, 1.0],
            [1.0, 0.0],
            [-1.0, 0.0],
        ];
        let at = |distance: f64, side: &[f64; 2]| -> [Range<f64>; 2] {
            // As far from the point in every direction.
            let reach = distance / side[0].hypot(side[1]);
            std::array::from_fn(|k| {
                let middle = point[k] + side[k] * (reach + 0.5 * size[k]);
                middle - 0.5 * size[k]..middle + 0.5 * size[k]
            })
        };
        let all = NEAR.iter().flat_map(|&distance| AROUND.iter().map(move |side| at(distance, side)));
        let free = all.filter(|note| self.is_free(note));
        let met = |note: &[Range<f64>; 2]| self.strokes.iter().filter(|stroke| crosses(stroke, note)).count();
        let note = free.min_by_key(met)?;
        let corner = [note[0].start, note[1].start];
        self.notes.push(note);
        Some(corner)
    }

    fn is_free(&self, note: &[Range<f64>; 2]) -> bool {
        let covers = |point: &[f64; 2]| {
            let [x, y] = [0, 1].map(|k| point[k] - point[k].clamp(note[k].start, note[k].end));
            x.hypot(y) < (POINT + FINE) as f64
        };
        let overlaps = |other: &[Range<f64>; 2]| {
            (0..2).all(|k| note[k].start < other[k].end && other[k].start < note[k].end)
        };
        (0..2).all(|k| self.inside[k].start <= note[k].start && note[k].end <= self.inside[k].end)
            && !self.points.iter().any(covers)
            && !self.notes.iter().any(overlaps)
    }
}

/// Whether a straight stroke meets a rectangle of columns and rows.
fn crosses([a, b]: &[[f64; 2]; 2], rectangle: &[Range<f64>; 2]) -> bool {
    // The share of the stroke that is within the columns, then of that within the rows.
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for k in 0..2 {
        let Range { start, end } = &rectangle[k];
        let along = b[k] - a[k];
        if along == 0.0 {
            if a[k] < *start || a[k] > *end {
                return false;
            }
            continue;
        }
        let [enters, leaves] = [(start - a[k]) / along, (end - a[k]) / along];
        (from, to) = (from.max(enters.min(leaves)), to.min(enters.max(leaves)));
    }
    from <= to
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_takes_the_nearest_place_that_is_free() {
        let empty =
            || Taken { inside: [0.0..400.0, 0.0..400.0], points: vec![], strokes: vec![], notes: vec![] };
        let (point, size) = ([200.0, 200.0], [30.0, 20.0]);
        let mut free = empty();
        free.points.push(point);
        let first = free.place(point, size).unwrap();
        assert!(first[0] > 200.0 && first[1] + 20.0 < 200.0, "{first:?}");
        // The next one is elsewhere, and a stroke through a place makes another better.
        let second = free.place(point, size).unwrap();
        assert!(second[0] > 200.0 && second[1] > 200.0, "{second:?}");
        let mut struck = empty();
        struck.strokes.push([[200.0, 200.0], [400.0, 0.0]]);
        assert_eq!(struck.place(point, size), Some(second));
        // Wherever it is, it covers no point.
        let mut crowded = empty();
        crowded.points =
            (0..40).flat_map(|k| (0..40).map(move |l| [f64::from(10 * k), f64::from(10 * l)])).collect();
        assert_eq!(crowded.place(point, size), None);
        // In a corner it stays inside.
        let [left, top] = empty().place([399.0, 1.0], size).unwrap();
        assert!(left + 30.0 <= 400.0 && top >= 0.0, "{left}, {top}");
        let rectangle = [10.0..20.0, 10.0..20.0];
        let met = |a, b| crosses(&[a, b], &rectangle);
        assert!(
            met([0.0, 0.0], [30.0, 30.0])
                && met([15.0, 0.0], [15.0, 30.0])
                && met([12.0, 12.0], [13.0, 13.0])
        );
        assert!(
            !met([0.0, 0.0], [9.0, 9.0]) && !met([0.0, 15.0], [15.0, 30.1]) && !met([5.0, 0.0], [5.0, 30.0])
        );
    }
}
