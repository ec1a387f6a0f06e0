//! Means in 16 bits, and the order of the Gaussians.
//!
//! A mean is stored as sign(x) ln(1 + |x|) between limits. The limits are free, so that every step is possible: they are
//! chosen such that the step wanted is a power of two of the 65,535, and the bits below it are zero.

use super::super::Gaussians;
use super::super::fault::Fault;
use super::super::weight::{size, weight};
use crate::gaussians::order::spread;
use crate::scene::median;
use rayon::prelude::*;

/// The share of its size by which the wanted step may move the median Gaussian: less than what is refused, as limits are rounded.
const MOST_MOVED: f64 = 0.9;
/// The greatest number that is stored.
const GREATEST: f64 = 65535.0;

/// Encoding of the coordinates of an axis: a number of steps from a minimum, shifted up.
#[derive(Clone, Copy)]
struct Axis {
    least: f64,
    step: f64,
    shift: u32,
}

/// Encoding of means.
pub(super) struct Means {
    axes: [Axis; 3],
}

/// ln(1 + |x|) with the sign of x.
fn logarithm(x: f32) -> f64 {
    f64::from(x).abs().ln_1p().copysign(f64::from(x))
}

/// The share of its size by which a step moves the median Gaussian at most; none without Gaussians.
fn median_move(model: &Gaussians, step: f64) -> Option<f64> {
    median(&mut (0..model.len()).map(|i| 0.5 * step / size(model, i, 2)).collect::<Vec<_>>())
}

impl Means {
    /// Chooses limits such that a step is `share` of the Gaussians' size, a mean by what pictures show of them.
    pub fn new(model: &Gaussians, share: f64) -> Result<Self, Fault> {
        let (weights, blurs) = (0..model.len())
            .map(|i| (weight(model, i), size(model, i, 1)))
            .filter(|(weight, size)| *weight > 0.0 && *size > 0.0)
            .fold((0.0, 0.0), |(all, blurs), (weight, size)| (all + weight, blurs + weight / (size * size)));
        let wanted = if blurs > 0.0 { share * (weights / blurs).sqrt() } else { 0.0 };
        // Where a few Gaussians near the origin show the most, their step may be too coarse for all others.
        let wanted = median_move(model, 1.0).map_or(wanted, |moved| wanted.min(MOST_MOVED / moved));
        let axes = [0, 1, 2].map(|axis| {
            let finite = model.means.iter().map(|m| logarithm(m[axis])).filter(|v| v.is_finite());
            let limits = finite.fold(None, |limits, v| {
                let (low, high) = limits.unwrap_or((v, v));
                Some((v.min(low), v.max(high)))
            });
            let (low, high) = limits.unwrap_or((0.0, 0.0));
            let least_step = if high > low { (high - low) / GREATEST } else { 1.0 / GREATEST };
            let shift = (wanted / least_step).log2().floor().clamp(0.0, 15.0) as u32;
            // As many steps as fit: a shifted number is at most 65,535.
            let most = f64::from(65535_u32 >> shift);
            Axis { least: low, step: wanted.max((high - low) / most).max(f64::MIN_POSITIVE), shift }
        });
        let means = Self { axes };
        means.refuse_coarse(model)?;
        Ok(means)
    }

    fn steps(&self, mean: [f32; 3]) -> [u32; 3] {
        std::array::from_fn(|a| {
            let Axis { least, step, shift } = self.axes[a];
            ((logarithm(mean[a]) - least) / step).round().clamp(0.0, f64::from(65535_u32 >> shift)) as u32
        })
    }

    /// Low and high byte of each coordinate.
    pub fn bytes(&self, mean: [f32; 3]) -> [[u8; 2]; 3] {
        let steps = self.steps(mean);
        std::array::from_fn(|a| ((steps[a] << self.axes[a].shift) as u16).to_le_bytes())
    }

    /// Least and greatest value that can be stored, by axis.
    pub fn limits(&self) -> [[f64; 3]; 2] {
        let greatest = |Axis { least, step, shift }: Axis| least + step * GREATEST / f64::from(1_u32 << shift);
        [self.axes.map(|axis| axis.least), self.axes.map(greatest)]
    }

    /// Refuses a model whose median Gaussian would move by more than its size.
    fn refuse_coarse(&self, model: &Gaussians) -> Result<(), Fault> {
        let step = self.axes.iter().fold(0.0, |step, axis| axis.step.max(step));
        if let Some(median) = median_move(model, step).filter(|median| *median > 1.0) {
            return Err(Fault::Unsupported(format!(
                "SOG's 16 bits would move the median Gaussian by {median:.1} of its size; remove far Gaussians, move the model to the origin, or write .ply"
            )));
        }
        Ok(())
    }

    /// The Gaussians along a Z-order curve, whose cells are cubes after the logarithm.
    pub fn order(&self, model: &Gaussians) -> Vec<u32> {
        let finest = self.axes.iter().fold(f64::INFINITY, |finest, axis| axis.step.min(finest));
        let key = |i: &u32| {
            let steps = self.steps(model.means[*i as usize]);
            let [x, y, z] = [0, 1, 2].map(|a| {
                let cubes = f64::from(steps[a]) * (self.axes[a].step / finest);
                spread(cubes.clamp(0.0, GREATEST) as u64)
            });
            (x | y << 1 | z << 2, *i)
        };
        let mut order: Vec<u32> = (0..model.len() as u32).collect();
        order.par_sort_by_cached_key(key);
        order
    }
}
