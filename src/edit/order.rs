//! Order of Gaussians along a Z-order curve.

use crate::gaussians::Attributes;
use crate::gaussians::Gaussians;
use rayon::prelude::*;

/// Bits of an axis.
const BITS: u32 = 21;

/// Indices of the points in the order of a Z-order curve through their bounding box; points at equal places keep their order.
/// Points that are not finite count as the box's minimum.
pub(super) fn morton(points: &[[f32; 3]]) -> Vec<u32> {
    let finite = || points.iter().filter(|p| p.iter().all(|x| x.is_finite()));
    let low: [f64; 3] = std::array::from_fn(|a| finite().map(|p| f64::from(p[a])).fold(f64::INFINITY, f64::min));
    let high: [f64; 3] = std::array::from_fn(|a| finite().map(|p| f64::from(p[a])).fold(f64::NEG_INFINITY, f64::max));
    let steps = f64::from((1_u32 << BITS) - 1);
    let key = |point: &[f32; 3]| -> u64 {
        (0..3).fold(0, |key, a| {
            let share = (f64::from(point[a]) - low[a]) / (high[a] - low[a]).max(f64::MIN_POSITIVE);
            // NaN becomes 0.
            key | spread((share * steps) as u64 & ((1 << BITS) - 1)) << a
        })
    };
    let mut keyed: Vec<(u64, u32)> = points.par_iter().enumerate().map(|(i, p)| (key(p), i as u32)).collect();
    keyed.par_sort_unstable();
    keyed.into_par_iter().map(|(_, i)| i).collect()
}

/// Spreads the lowest 21 bits, with two zeros between neighbours.
fn spread(x: u64) -> u64 {
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Puts Gaussians in an order: number `order[i]` becomes number i. One attribute is copied at a time.
pub(super) fn reorder(model: &mut Gaussians, order: &[u32]) {
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
    use crate::edit::Edit;
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
        assert_eq!(Edit::MortonOrder.apply(&mut model), Ok(None));
        assert!(path(&model) < 0.4 * before, "{} {before}", path(&model));
        let whole =
            |i: usize| model.opacity_logits[i] == model.means[i][0] && model.sh[1][i * 9 + 4] == model.means[i][1];
        assert_eq!((0..500).filter(|i| whole(*i)).count(), 499);
        let again = model.clone();
        Edit::MortonOrder.apply(&mut model).unwrap();
        assert!(again.opacity_logits == model.opacity_logits, "an order is its own");
    }
}
