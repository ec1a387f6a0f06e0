//! One Gaussian for a cluster: mean, covariance and colours are means weighted by contribution.

use super::footprint::covariance;
use super::greedy::Cluster;
use crate::gaussians::Gaussians;
use crate::qirf::dense::eigen3;
use crate::response::Score;
use glam::{DMat3, DQuat, DVec3};

/// Smallest axis of a merged Gaussian, as a share of its largest.
const THINNEST: f64 = 1e-6;

/// The member with the greatest contribution to the pictures, the first of equals.
pub(super) fn heaviest(scores: &[Score], members: &[usize]) -> usize {
    let weight = |i: usize| scores[i].contribution;
    members.iter().copied().reduce(|a, b| if weight(b) > weight(a) { b } else { a }).expect("a cluster has members")
}

/// The Gaussian that represents a cluster, as a model of one; `None` for a cluster of one, which stays unchanged.
pub(super) fn merged(model: &Gaussians, scores: &[Score], cluster: &Cluster) -> Option<Gaussians> {
    let Cluster { members, opacity } = cluster;
    if members.len() < 2 {
        return None;
    }
    let whole: f64 = members.iter().map(|&i| f64::from(scores[i].contribution)).sum();
    let share = |i: usize| f64::from(scores[i].contribution) / whole;
    let mean_of = |i: usize| DVec3::from(model.means[i].map(f64::from));
    let mean: DVec3 = members.iter().map(|&i| share(i) * mean_of(i)).sum();
    let mut spread = DMat3::ZERO;
    for &i in members {
        let d = mean_of(i) - mean;
        spread += share(i) * (covariance(model, i) + DMat3::from_cols(d * d.x, d * d.y, d * d.z));
    }
    let (variances, mut axes) = eigen3(&spread);
    if axes.determinant() < 0.0 {
        axes.z_axis = -axes.z_axis;
    }
    let rotation = DQuat::from_mat3(&axes);
    let least = (variances[2] * THINNEST * THINNEST).max(f64::MIN_POSITIVE);
    let sh = model.sh.iter().enumerate().map(|(l, band)| {
        let width = Gaussians::band_width(l);
        let sum = |c: usize| members.iter().map(|&i| share(i) * f64::from(band[width * i + c])).sum::<f64>();
        (0..width).map(|c| sum(c) as f32).collect()
    });
    Some(Gaussians {
        means: vec![mean.as_vec3().to_array()],
        log_scales: vec![std::array::from_fn(|k| (0.5 * variances[k].max(least).ln()) as f32)],
        rotations: vec![[rotation.w, rotation.x, rotation.y, rotation.z].map(|x| x as f32)],
        opacity_logits: vec![(opacity / (1.0 - opacity)).ln() as f32],
        sh: sh.collect(),
    })
}

/// Replaces Gaussian `i` of a model by that of a model of one.
pub(super) fn store(model: &mut Gaussians, i: usize, one: &Gaussians) {
    for (to, from) in model.attributes_mut().zip(one.attributes()).into_array() {
        to[from.len() * i..][..from.len()].copy_from_slice(from);
    }
}
