//! Normalises responses over the scene: rows of H from response descriptors.
//!
//! h = sqrt(x / median of the channel's positive values), clamped at its 99.9th percentile, so that P_ii = |H_i|^2 sums up
//! importance. The rows contain the weights of the channels: H = [sqrt(eta) Hr, sqrt(1 - eta) Ho].

use rayon::prelude::*;

use super::{CHANNELS, Row};

/// Number of rendering channels, which come first; the others are those of optimisation.
const RENDERING: usize = 4;
/// Largest values are clamped at this percentile, in thousandths.
const CLAMP_PERMILLE: usize = 999;

/// Rows of H (n x 8, weighted by `eta`) from descriptors (n x 8, not negative).
///
/// Values that are negative or not finite count as zero; a channel without positive values is zero everywhere.
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

/// Rows of W (m x 8) of one block from its rows of H: each group of channels is divided by the root of its trace.
///
/// W W^T = P = eta Hr Hr^T / (tr_r + epsilon) + (1 - eta) Ho Ho^T / (tr_o + epsilon), where Hr and Ho are without the
/// weights that `h` holds. W compares members of this block only.
pub fn within_block(h: &[Row], eta: f64, epsilon: f64) -> Vec<Row> {
    let eta = eta.clamp(0.0, 1.0);
    let trace = |channels: std::ops::Range<usize>| -> f64 {
        h.iter().map(|row| row[channels.clone()].iter().map(|x| x * x).sum::<f64>()).sum()
    };
    let factor = |trace: f64, weight: f64| if weight > 0.0 { (trace / weight + epsilon).sqrt().recip() } else { 0.0 };
    let (rendering, optimisation) = (factor(trace(0..RENDERING), eta), factor(trace(RENDERING..CHANNELS), 1.0 - eta));
    let scaled = |row: &Row| std::array::from_fn(|c| row[c] * if c < RENDERING { rendering } else { optimisation });
    h.iter().map(scaled).collect()
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
    fn a_block_has_trace_one() {
        let h = vec![[0.3; CHANNELS], [0.7; CHANNELS]];
        let w = within_block(&h, 0.75, 0.0);
        let trace: f64 = w.iter().flatten().map(|x| x * x).sum();
        assert!((trace - 1.0).abs() < 1e-12);
    }
}
