//! Summary statistics.

use std::num::NonZero;

/// Returns the median: the mean of the middle two for an even number of values, NaN for none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n => 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]),
    }
}

/// Number of frames excluded from the timing of a run: in these, drivers compile and caches fill.
pub const WARM_UP: usize = 3;

/// Returns the median frame time after the warm-up, or over all frames if the run is no longer than that.
pub fn median_time(times: &[f64]) -> f64 {
    median(if times.len() > WARM_UP { &times[WARM_UP..] } else { times })
}

/// Returns the mean and the sample standard deviation, which is 0 for a single value.
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
