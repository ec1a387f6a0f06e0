//! Normalises responses over the scene (Q3): rows of H from response descriptors.
//!
//! h = sqrt(x / median of the channel's positive values), clamped at its 99.9th percentile, so that P_ii = |H_i|^2 sums up
//! importance. The rows contain the weights of the channels: H = [sqrt(eta) Hr, sqrt(1 - eta) Ho].

use rayon::prelude::*;

use super::{CHANNELS, RENDERING};

/// Percentile, in thousandths, at which the largest values are clamped.
const CLAMP_PERMILLE: usize = 999;

/// Rows of H (n x 8, weighted by `eta`) from descriptors (n x 8, not negative).
///
/// Values that are negative or not finite count as zero (see [`not_finite`]); a channel without positive values is zero
/// everywhere.
pub fn rows(descriptors: &[[f32; CHANNELS]], eta: f64) -> Vec<[f32; CHANNELS]> {
    let scales: Vec<(f64, f64)> = (0..CHANNELS).into_par_iter().map(|c| scale(descriptors, c)).collect();
    let eta = eta.clamp(0.0, 1.0);
    let weight = |c: usize| if c < RENDERING { eta.sqrt() } else { (1.0 - eta).sqrt() };
    let row = |x: &[f32; CHANNELS]| {
        std::array::from_fn(|c| {
            let (median, most) = scales[c];
            let positive = x[c].is_finite() && x[c] > 0.0 && median > 0.0;
            if positive { ((f64::from(x[c]) / median).sqrt().min(most) * weight(c)) as f32 } else { 0.0 }
        })
    };
    descriptors.par_iter().map(row).collect()
}

/// The first descriptor that is not finite: its Gaussian, its channel and its value.
pub fn not_finite(descriptors: &[[f32; CHANNELS]]) -> Option<(usize, usize, f32)> {
    let bad = |row: &[f32; CHANNELS]| row.iter().position(|x| !x.is_finite());
    let gaussian = descriptors.par_iter().position_first(|row| bad(row).is_some())?;
    let channel = bad(&descriptors[gaussian])?;
    Some((gaussian, channel, descriptors[gaussian][channel]))
}

/// Median of channel `c`'s positive values, and the clamp of h; zeros if there are none.
fn scale(descriptors: &[[f32; CHANNELS]], c: usize) -> (f64, f64) {
    let mut positive: Vec<f32> = descriptors.iter().map(|x| x[c]).filter(|x| x.is_finite() && *x > 0.0).collect();
    let n = positive.len();
    if n == 0 {
        return (0.0, 0.0);
    }
    let median = f64::from(*positive.select_nth_unstable_by((n - 1) / 2, f32::total_cmp).1);
    let at = (n * CLAMP_PERMILLE).div_ceil(1000).saturating_sub(1);
    let most = f64::from(*positive.select_nth_unstable_by(at, f32::total_cmp).1);
    (median, (most / median).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_becomes_one_and_silent_channels_stay_silent() {
        let mut descriptors = vec![[0.0_f32; CHANNELS]; 5];
        for (i, row) in descriptors.iter_mut().enumerate() {
            row[0] = i as f32; // positive values 1, 2, 3, 4: median 2
            row[5] = f32::NAN;
        }
        let h = rows(&descriptors, 0.75);
        assert_eq!(h[0], [0.0; CHANNELS]);
        assert!((f64::from(h[2][0]) - 0.75_f64.sqrt()).abs() < 1e-7);
        assert!(h.iter().all(|row| row[1..].iter().all(|&x| x == 0.0)));
    }

    #[test]
    fn the_greatest_thousandth_is_clamped() {
        let mut descriptors = vec![[1.0_f32; CHANNELS]; 10_000];
        descriptors[7][3] = 1e30;
        let h = rows(&descriptors, 0.5);
        assert_eq!(h[7], h[8]);
    }

    #[test]
    fn the_first_value_that_is_not_finite_is_found() {
        let mut descriptors = vec![[1.0_f32; CHANNELS]; 10_000];
        assert_eq!(not_finite(&descriptors), None);
        descriptors[9_000][1] = f32::NAN;
        descriptors[77][6] = f32::NEG_INFINITY;
        assert_eq!(not_finite(&descriptors), Some((77, 6, f32::NEG_INFINITY)));
    }
}
