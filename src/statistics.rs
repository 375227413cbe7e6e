//! What is told of several numbers.

use std::num::NonZero;

/// The median, the mean of the middle two of an even number; not a number of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n => 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]),
    }
}

/// Frames before the times of a run count: drivers compile then, and caches fill.
pub const WARM_UP: usize = 3;

/// Median of the times of a run's frames after the warm-up, or of all frames where there are no more.
pub fn median_time(times: &[f64]) -> f64 {
    median(if times.len() > WARM_UP { &times[WARM_UP..] } else { times })
}

/// Mean and standard deviation (of the sample; 0 of a single number).
pub fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, NonZero::new(values.len().saturating_sub(1)).map_or(0.0, |n| (square / n.get() as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::{median, median_time};

    #[test]
    fn an_even_number_has_two_in_the_middle() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 3.0, 2.0]), 2.5);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn the_first_times_count_where_there_are_no_others() {
        assert_eq!(median_time(&[9.0, 8.0, 7.0]), 8.0);
        assert_eq!(median_time(&[9.0, 8.0, 7.0, 1.0]), 1.0);
        assert!(median_time(&[]).is_nan());
    }
}
