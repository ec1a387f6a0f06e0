//! Order of Gaussians along a Z-order curve.

use super::{Attributes, Gaussians};
use rayon::prelude::*;

/// Bits of an axis.
const BITS: u32 = 21;

/// Indices of Gaussians in the order of a Z-order curve through the box of their centres; those at equal places keep their
/// order. Centres that are not finite count as the box's minimum.
pub(crate) fn z_order(model: &Gaussians) -> Vec<u32> {
    let (low, high) = model.bounds().unwrap_or_default();
    let [low, high] = [low, high].map(|corner| corner.map(f64::from));
    let steps = f64::from((1_u32 << BITS) - 1);
    let key = |mean: &[f32; 3]| -> u64 {
        if !mean.iter().all(|x| x.is_finite()) {
            return 0;
        }
        (0..3).fold(0, |key, a| {
            let share = (f64::from(mean[a]) - low[a]) / (high[a] - low[a]).max(f64::MIN_POSITIVE);
            key | spread((share * steps) as u64) << a
        })
    };
    let mut keyed: Vec<(u64, u32)> =
        model.means.par_iter().enumerate().map(|(i, mean)| (key(mean), i as u32)).collect();
    keyed.par_sort_unstable();
    keyed.into_par_iter().map(|(_, i)| i).collect()
}

/// Spreads the lowest 21 bits, with two zeros between neighbours.
pub(super) fn spread(x: u64) -> u64 {
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Puts Gaussians in an order: number `order[i]` becomes number i. One attribute is copied at a time.
pub(crate) fn reorder(model: &mut Gaussians, order: &[u32]) {
    let widths = Attributes::widths(model.degree());
    for (values, width) in model.attributes_mut().zip(widths).into_array() {
        if values.is_empty() || width == 0 {
            continue;
        }
        let old = values.to_vec();
        values.par_chunks_exact_mut(width).zip(order).for_each(|(row, i)| {
            row.copy_from_slice(&old[*i as usize * width..][..width]);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn bits_are_spread() {
        assert_eq!(spread(0b1011), 0b001_000_001_001);
        assert_eq!(spread((1 << 21) - 1), 0x1249_2492_4924_9249);
    }

    #[test]
    fn all_gaussians_stay_whole_and_neighbours_come_together() {
        let mut random = Random(1);
        let mut model = Gaussians::zeroed(500, 1);
        for (i, mean) in model.means.iter_mut().enumerate() {
            *mean = [0; 3].map(|_| random.within(-3.0, 8.0) as f32);
            model.opacity_logits[i] = mean[0];
            model.sh[1][i * 9 + 4] = mean[1];
        }
        model.means[7] = [f32::NAN, 0.0, f32::INFINITY];
        let path = |model: &Gaussians| -> f64 {
            let steps =
                model.means.windows(2).map(|w| (0..3).map(|a| f64::from(w[0][a] - w[1][a]).powi(2)).sum::<f64>());
            steps.filter(|s| s.is_finite()).map(f64::sqrt).sum()
        };
        let before = path(&model);
        let order = z_order(&model);
        reorder(&mut model, &order);
        assert!(path(&model) < 0.4 * before, "{} {before}", path(&model));
        let whole =
            |i: usize| model.opacity_logits[i] == model.means[i][0] && model.sh[1][i * 9 + 4] == model.means[i][1];
        assert_eq!((0..500).filter(|i| whole(*i)).count(), 499);
        assert!(z_order(&model).into_iter().eq(0..500), "an order is its own");
    }

    #[test]
    fn centres_that_are_not_finite_come_first() {
        let mut model = Gaussians::zeroed(4, 0);
        model.means = vec![[1.0; 3], [f32::INFINITY, 9.0, 9.0], [2.0; 3], [9.0, f32::NEG_INFINITY, f32::NAN]];
        assert_eq!(z_order(&model), [0, 1, 3, 2]);
        model.means.swap(0, 1);
        assert_eq!(z_order(&model), [0, 1, 3, 2]);
        model.means.fill([f32::INFINITY; 3]);
        assert_eq!(z_order(&model), [0, 1, 2, 3]);
        assert!(z_order(&Gaussians::default()).is_empty());
    }
}
