//! Density control's decisions: which Gaussians are pruned, cloned or split.

use super::Params;
use super::project::rotation;
use glam::DVec3;
use std::f64::consts::TAU;

/// Ratio of a parent's scales to those of its halves after a split.
pub const SHRINK: f64 = 1.6;

/// One half after a split along its parent's longest axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lengthwise {
    /// Mean, in world units.
    pub mean: DVec3,
    /// Log-scales.
    pub log_scales: [f64; 3],
    /// Opacity logit.
    pub logit: f64,
}

/// Thresholds of density control.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// Mean gradient norm of the 2D mean, in NDC units, at which a Gaussian grows.
    pub gradient: f64,
    /// Largest axis, as a share of the reach, above which a growing Gaussian is split instead of being cloned.
    pub clone_scale: f64,
    /// Opacity below which a Gaussian is pruned.
    pub opacity: f64,
    /// Largest axis, as a share of the reach, above which a Gaussian is pruned; `None` while large Gaussians are kept.
    pub scale: Option<f64>,
    /// The scene's extent in world units: the smallest reach.
    pub extent: f64,
    /// Mean of the cameras' centres: a Gaussian farther from it than the extent has that distance as its reach.
    pub cameras: DVec3,
}

/// Origin of a row of the new model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A Gaussian of the old model.
    Kept,
    /// A copy of a kept Gaussian.
    Clone,
    /// One of the two halves that replace their parent.
    Half,
}

/// Source row and kind of each row of the new model. `growth` holds for each Gaussian the sum of its gradient norms and
/// the number of views that saw it.
pub fn densify(params: &Params, growth: &[[f64; 2]], thresholds: &Thresholds) -> Vec<(usize, Kind)> {
    let mut rows = Vec::new();
    for (i, &[sum, views]) in growth.iter().enumerate() {
        let (mean, scales) = (params.means[i], params.log_scales[i]);
        let stored = [&mean[..], &scales, &params.rotations[i], &[params.opacity_logits[i]]].concat();
        let opacity = 1.0 / (1.0 + (-params.opacity_logits[i]).exp());
        if !stored.iter().all(|v| v.is_finite()) || opacity < thresholds.opacity {
            continue;
        }
        let reach = (DVec3::from(mean) - thresholds.cameras).length().max(thresholds.extent);
        let largest = scales.into_iter().fold(f64::MIN, f64::max).exp() / reach;
        let grows = views > 0.0 && sum / views >= thresholds.gradient;
        let splits = grows && largest > thresholds.clone_scale;
        // A split is judged by the resulting halves.
        let left = if splits { largest / SHRINK } else { largest };
        if thresholds.scale.is_some_and(|most| left > most) {
            continue;
        }
        if splits {
            rows.extend([(i, Kind::Half); 2]);
        } else {
            rows.push((i, Kind::Kept));
            rows.extend(grows.then_some((i, Kind::Clone)));
        }
    }
    rows
}

/// The 32-bit random number of a key: PCG's output permutation over one linear congruential step.
pub(super) fn hash(x: u32) -> u32 {
    let x = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let x = ((x >> ((x >> 28) + 4)) ^ x).wrapping_mul(277_803_737);
    (x >> 22) ^ x
}

/// Two independent standard normals (Box and Muller).
pub(super) fn normals(key: [u32; 4]) -> [f64; 2] {
    let first = key.into_iter().rev().fold(0, |h, k| hash(k ^ h));
    let unit = |h: u32| f64::from(h >> 8);
    let (radius, turn) = ((-2.0 * ((unit(first) + 1.0) / 16_777_217.0).ln()).sqrt(), unit(hash(first)) / 16_777_216.0);
    [radius * (TAU * turn).cos(), radius * (TAU * turn).sin()]
}

/// Offset, in world units, of the half that becomes row `row` of the new model, from its parent `parent`.
pub fn offset_of_half(params: &Params, parent: usize, row: u32, seed: u32, iteration: u32) -> DVec3 {
    let [x, y] = normals([seed, iteration, row, 0]);
    let scales = DVec3::from(params.log_scales[parent].map(f64::exp));
    let stored = params.rotations[parent];
    let length = stored.iter().map(|q| q * q).sum::<f64>().sqrt();
    rotation(stored.map(|q| q / length)) * (scales * DVec3::new(x, y, normals([seed, iteration, row, 1])[0]))
}

/// The two halves of Gaussian `i` along its longest axis, the first among equal axes. They end where the parent's three
/// deviations end; across the axis they are thinner, and they are fainter (Improved-GS's values).
pub fn lengthwise(params: &Params, i: usize) -> [Lengthwise; 2] {
    const SHARE: f64 = 0.45;
    let (stored, log_scales) = (params.rotations[i], params.log_scales[i]);
    let length = stored.iter().map(|q| q * q).sum::<f64>().sqrt();
    let longest = (1..3).fold(0, |a, b| if log_scales[b] > log_scales[a] { b } else { a });
    let axis = rotation(stored.map(|q| q / length)).col(longest) * log_scales[longest].exp();
    let opacity = 0.6 / (1.0 + (-params.opacity_logits[i]).exp());
    let mut shrunk = log_scales.map(|s| s + (1.0 - SHARE * SHARE).sqrt().ln());
    shrunk[longest] = log_scales[longest] + (1.0 - SHARE).ln();
    [1.0, -1.0].map(|side| Lengthwise {
        mean: DVec3::from(params.means[i]) + side * 3.0 * SHARE * axis,
        log_scales: shrunk,
        logit: (opacity / (1.0 - opacity)).ln(),
    })
}
