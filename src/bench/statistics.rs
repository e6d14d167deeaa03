//! Means and percentiles.

/// The `share` percentile (0 to 1) of `values`, interpolated between neighbours in order; `None`
/// without values. Infinite values stand for what did not happen and take part.
pub fn percentile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| !value.is_nan()).collect();
    sorted.sort_by(f64::total_cmp);
    let place = share.clamp(0.0, 1.0) * sorted.len().checked_sub(1)? as f64;
    let (below, above) = (sorted.get(place.floor() as usize)?, sorted.get(place.ceil() as usize)?);
    let part = place.fract();
    // Without arithmetic on infinities where there is nothing between.
    Some(if part == 0.0 || below == above { *below } else { below + part * (above - below) })
}

/// The middle one of `values`.
pub fn median(values: &[f64]) -> Option<f64> {
    percentile(values, 0.5)
}

/// The distribution of some values in a few numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// How many values.
    pub count: usize,
    /// Their mean.
    pub mean: f64,
    /// Percentiles 10, 25, 50, 75 and 90.
    pub percentiles: [f64; 5],
}

impl Summary {
    /// The summary of `values`; `None` without values.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut percentiles = [0.0; 5];
        for (place, share) in percentiles.iter_mut().zip([0.1, 0.25, 0.5, 0.75, 0.9]) {
            *place = percentile(values, share)?;
        }
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Some(Self { count: values.len(), mean, percentiles })
    }

    /// The middle value.
    pub fn median(&self) -> f64 {
        self.percentiles[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_percentiles() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(median(&values), Some(2.5));
        assert_eq!(percentile(&values, 0.0), Some(1.0));
        assert_eq!(percentile(&values, 1.0), Some(4.0));
        assert_eq!(percentile(&values, 0.25), Some(1.75));
        assert_eq!(median(&[]), None);
        assert_eq!(median(&[1.0, f64::INFINITY, f64::INFINITY]), Some(f64::INFINITY));
        assert_eq!(median(&[1.0, 2.0, f64::INFINITY]), Some(2.0));
        assert_eq!(median(&[1.0, f64::INFINITY]), Some(f64::INFINITY));
        let summary = Summary::of(&[1.0, 2.0, 6.0]).unwrap();
        assert_eq!((summary.count, summary.mean, summary.median()), (3, 3.0, 2.0));
    }

    proptest! {
        #[test]
        fn percentiles_rise_and_stay_within(values in prop::collection::vec(-1e3..1e3_f64, 1..40)) {
            let at: Vec<f64> = (0..=10).map(|k| percentile(&values, f64::from(k) / 10.0).unwrap()).collect();
            prop_assert!(at.windows(2).all(|pair| pair[0] <= pair[1]));
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            prop_assert_eq!((at[0], at[10]), (least, most));
            let below = values.iter().filter(|value| **value <= at[5]).count();
            prop_assert!(2 * below >= values.len());
        }
    }
}
