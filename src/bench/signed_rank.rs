//! Wilcoxon's signed-rank test ("Individual comparisons by ranking methods", 1945).

/// Most differences for which the distribution is counted out; beyond, it is taken as normal.
const EXACT: usize = 100;

/// The two-sided probability that differences which favour neither sign come out as lopsided as
/// `differences`. Zeros are left out, ties share their ranks; 1 when nothing is left.
pub fn signed_rank(differences: &[f64]) -> f64 {
    let mut kept: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0 && !d.is_nan()).collect();
    kept.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let ranks = doubled_ranks(&kept);
    let positive: usize = kept.iter().zip(&ranks).filter(|(d, _)| **d > 0.0).map(|(_, rank)| rank).sum();
    let total: usize = ranks.iter().sum();
    let tail = positive.min(total - positive);
    let p = if kept.len() <= EXACT { exact_tail(&ranks, tail) } else { normal_tail(&ranks, tail) };
    (2.0 * p).min(1.0)
}

/// Twice the rank of each value by magnitude, so that shared ranks are whole numbers, too.
fn doubled_ranks(sorted: &[f64]) -> Vec<usize> {
    let mut ranks = Vec::with_capacity(sorted.len());
    while ranks.len() < sorted.len() {
        let first = ranks.len();
        let tied = sorted[first..].iter().take_while(|d| d.abs() == sorted[first].abs()).count();
        // The mean of first + 1 to first + tied, doubled.
        ranks.extend(std::iter::repeat_n(2 * first + 1 + tied, tied));
    }
    ranks
}

/// The probability that a sum over a random half of `ranks` is at most `tail`.
fn exact_tail(ranks: &[usize], tail: usize) -> f64 {
    let mut chance = vec![0.0; tail + 1];
    chance[0] = 1.0;
    for &rank in ranks {
        for sum in (0..=tail).rev() {
            let with = if sum >= rank { chance[sum - rank] } else { 0.0 };
            chance[sum] = 0.5 * (chance[sum] + with);
        }
    }
    chance.iter().sum()
}

/// The same by the normal distribution with half a rank's correction.
fn normal_tail(ranks: &[usize], tail: usize) -> f64 {
    let mean = 0.5 * ranks.iter().sum::<usize>() as f64;
    let deviation = 0.5 * ranks.iter().map(|rank| (rank * rank) as f64).sum::<f64>().sqrt();
    let z = (tail as f64 + 1.0 - mean) / deviation;
    0.5 * complementary_error(-z.min(0.0) / std::f64::consts::SQRT_2)
}

/// erfc of a number not below zero (Abramowitz and Stegun 7.1.26, within 1.5e-7).
fn complementary_error(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let sum = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592]
        .iter()
        .fold(0.0, |sum, coefficient| sum * t + coefficient);
    sum * t * (-x * x).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_probabilities() {
        // All of one sign: 2 of 2^n arrangements.
        let rising = |n: usize| (1..=n).map(|k| k as f64).collect::<Vec<_>>();
        assert!((signed_rank(&rising(6)) - 2.0 / 64.0).abs() < 1e-15);
        assert!((signed_rank(&rising(20)) - 2.0 / 1_048_576.0).abs() < 1e-15);
        assert_eq!(signed_rank(&[]), 1.0);
        assert_eq!(signed_rank(&[0.0, 0.0]), 1.0);
        assert_eq!(signed_rank(&[1.0, -1.0]), 1.0);
        // R: wilcox.test(c(1.83,.50,1.62,2.48,1.68,1.88,1.55,3.06,1.30),
        //                c(.878,.647,.598,2.05,1.06,1.29,1.06,3.14,1.29), paired = TRUE): p = 0.03906.
        let depression = [0.952, -0.147, 1.022, 0.43, 0.62, 0.59, 0.49, -0.08, 0.01];
        assert!((signed_rank(&depression) - 0.039_062_5).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn it_is_the_count_over_all_signs(values in prop::collection::vec(-4..=4_i32, 1..9)) {
            let values: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
            let kept: Vec<f64> = values.iter().copied().filter(|v| *v != 0.0).collect();
            let magnitude = |value: f64| {
                let below = kept.iter().filter(|v| v.abs() < value.abs()).count() as f64;
                let same = kept.iter().filter(|v| v.abs() == value.abs()).count() as f64;
                below + 0.5 * (same + 1.0)
            };
            let ranks: Vec<f64> = kept.iter().map(|v| magnitude(*v)).collect();
            let lopsided = |positive: f64| (positive - 0.5 * ranks.iter().sum::<f64>()).abs();
            let seen = lopsided(kept.iter().zip(&ranks).filter(|(v, _)| **v > 0.0).map(|(_, r)| r).sum());
            let all = 1_usize << kept.len();
            let as_much = (0..all).filter(|signs| {
                let sum: f64 = ranks.iter().enumerate().filter(|(k, _)| signs >> k & 1 == 1).map(|(_, r)| r).sum();
                lopsided(sum) >= seen - 1e-9
            });
            let expected = as_much.count() as f64 / all as f64;
            prop_assert!((signed_rank(&values) - expected).abs() < 1e-12);
        }

        #[test]
        fn the_normal_tail_is_near_the_exact_one(values in prop::collection::vec(-1.0..1.2_f64, 60..90)) {
            let mut kept = values;
            kept.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
            let ranks = doubled_ranks(&kept);
            let positive: usize = kept.iter().zip(&ranks).filter(|(d, _)| **d > 0.0).map(|(_, r)| r).sum();
            let tail = positive.min(ranks.iter().sum::<usize>() - positive);
            prop_assert!((exact_tail(&ranks, tail) - normal_tail(&ranks, tail)).abs() < 0.01);
        }
    }
}
