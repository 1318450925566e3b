//! Shares of work and weights of pixels with the least variance.

/// Work is not split for less than this gain in efficiency: pilots are noisy themselves.
const WORTHWHILE: f64 = 1.1;
/// Members with less of the work than this are left out.
const LEAST: f64 = 0.05;

/// Variance per unit of work of a weighted sum: member `k` has the variance `variance[k][b]` per unit of
/// its work in block `b`, and gets the share `shares[k]` of the work. The weights in each block are the best ones,
/// inversely proportional to the variances.
fn combined(variance: &[&[f64]], shares: &[f64]) -> f64 {
    (0..variance[0].len())
        .map(|b| 1.0 / precision(variance, shares, b))
        .sum()
}

fn precision(variance: &[&[f64]], shares: &[f64], b: usize) -> f64 {
    variance.iter().zip(shares).map(|(v, s)| s / v[b]).sum()
}

/// The shares that minimise the variance of the sum, and that variance. Entries are positive, infinite for what
/// is of no use.
///
/// The objective is convex and homogeneous of degree -1 in the shares, so at the minimum its derivative is
/// the same for all that are not zero; each step scales shares by the root of that derivative.
fn minimum(variance: &[&[f64]]) -> (Vec<f64>, f64) {
    let mut shares = vec![1.0 / variance.len() as f64; variance.len()];
    for _ in 0..500 {
        let inverse: Vec<f64> = (0..variance[0].len())
            .map(|b| precision(variance, &shares, b).recip())
            .collect();
        for (s, v) in shares.iter_mut().zip(variance) {
            let slope: f64 = v.iter().zip(&inverse).map(|(v, a)| a * (a / v)).sum();
            *s *= slope.sqrt();
        }
        let sum: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|s| *s /= sum);
    }
    let found = combined(variance, &shares);
    (shares, found)
}

/// Shares of the work, zero for those that do not pay, and the variance per unit of work.
pub(super) fn best(variance: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let alone = |k: usize| variance[k].iter().sum::<f64>();
    let Some(single) = (0..variance.len()).min_by(|&a, &b| alone(a).total_cmp(&alone(b))) else {
        return (Vec::new(), f64::INFINITY);
    };
    let mut members: Vec<usize> = (0..variance.len()).collect();
    loop {
        let chosen: Vec<&[f64]> = members.iter().map(|&k| &variance[k][..]).collect();
        let (shares, found) = minimum(&chosen);
        let mut out = vec![0.0; variance.len()];
        let least = (0..members.len()).min_by(|&a, &b| shares[a].total_cmp(&shares[b]));
        match least {
            Some(k) if shares[k] < LEAST => {
                members.remove(k);
            }
            _ if found * WORTHWHILE > alone(single) => {
                out[single] = 1.0;
                return (out, alone(single));
            }
            _ => {
                for (&k, s) in members.iter().zip(shares) {
                    out[k] = s;
                }
                return (out, found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Equal estimators everywhere: nothing to gain. One better in each half: half of the work each, and
    /// (v + 1/v)-like gains by hand.
    #[test]
    fn shares_by_hand() {
        let (shares, v) = best(&[vec![1.0, 1.0], vec![1.0, 1.0]]);
        assert_eq!((shares.iter().filter(|s| **s > 0.0).count(), v), (1, 2.0));
        let (shares, v) = best(&[vec![0.01, 1.0], vec![1.0, 0.01]]);
        assert!((shares[0] - 0.5).abs() < 1e-9, "{shares:?}");
        // Per block: 1 / (0.5 / 0.01 + 0.5 / 1).
        assert!((v - 2.0 / 50.5).abs() < 1e-12, "{v}");
    }

    /// No other shares on a fine grid are better.
    #[test]
    fn the_minimum_is_one() {
        let variance = [[1.0, 9.0, 0.3], [4.0, 0.2, 1.0], [2.0, 2.0, 0.1]];
        let slices: Vec<&[f64]> = variance.iter().map(|v| &v[..]).collect();
        let (_, found) = minimum(&slices);
        let n = 60;
        for i in 0..=n {
            for j in 0..=n - i {
                let shares = [i, j, n - i - j].map(|x| x as f64 / n as f64);
                assert!(
                    combined(&slices, &shares) > found * (1.0 - 1e-9),
                    "{shares:?}"
                );
            }
        }
    }

    /// A member that is far worse everywhere gets nothing.
    #[test]
    fn what_does_not_pay_gets_nothing() {
        let (shares, v) = best(&[vec![1.0, 2.0], vec![1e3, 2e3]]);
        assert_eq!((shares, v), (vec![1.0, 0.0], 3.0));
    }
}
