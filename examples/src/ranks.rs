//! Numbers by their rank: the middle of times that were measured again and again, and the magnitude that the colours of a
//! picture are scaled by.

/// The middle of some numbers, the larger one of two; `None` if there are none.
pub fn median(numbers: &[f64]) -> Option<f64> {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// The value below which the share `q` of the finite magnitudes lies; zero if there are none.
pub fn percentile(values: &[f64], q: f64) -> f64 {
    let mut sorted: Vec<f64> = values
        .iter()
        .map(|v| v.abs())
        .filter(|v| v.is_finite())
        .collect();
    sorted.sort_by(f64::total_cmp);
    let at = (q * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_those_of_sorted_numbers() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0]), Some(4.0));
        assert_eq!(median(&[]), None);
        let values: Vec<f64> = (0..=100).map(|i| f64::from(50 - i)).collect();
        assert_eq!(percentile(&values, 0.0), 0.0);
        assert_eq!(percentile(&values, 0.5), 25.0);
        assert_eq!(percentile(&values, 1.0), 50.0);
        assert_eq!(percentile(&[f64::NAN, -2.0], 0.99), 2.0);
        assert_eq!(percentile(&[], 0.99), 0.0);
    }
}
