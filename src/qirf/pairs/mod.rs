//! Merging by pairs: neighbours become one Gaussian wherever the pictures show it least (docs/method.md).
//!
//! [`Score`] measures each Gaussian's share in the pictures; from it `footprint` predicts, in closed form, the growth
//! of the squared error of all pictures if two Gaussians become one; `greedy` repeatedly merges the pair with the least
//! growth; `moments` replaces each cluster by one Gaussian with its mean, covariance, visible mass and colours.

mod footprint;
mod greedy;
mod moments;

use crate::gaussians::Gaussians;
use crate::response::Score;
use crate::scene::camera::Camera;
use footprint::Footprint;
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Largest number of cameras over which the size of a pixel is averaged.
const MOST_CAMERAS: usize = 32;

/// Result of merging a model's Gaussians by pairs.
#[derive(Clone, Debug, PartialEq)]
pub struct Pairs {
    /// Keep mask with exactly the wanted number, n. A cluster is kept at the index of the member with the greatest
    /// contribution to the pictures.
    pub keep: Vec<bool>,
    /// The model, n; the kept Gaussians represent their clusters.
    pub model: Gaussians,
    /// Number of each Gaussian's cluster, n; [`NO_CLUSTER`] for those in none.
    pub cluster: Vec<u32>,
    /// Counts of the merging.
    pub counts: PairCounts,
}

impl Pairs {
    /// The Gaussians that are kept, alone.
    pub fn kept(&self) -> Gaussians {
        let kept: Vec<usize> = (0..self.keep.len()).filter(|i| self.keep[*i]).collect();
        self.model.select(&kept)
    }
}

/// Cluster of a Gaussian that no picture shows or that had no neighbour left.
pub const NO_CLUSTER: u32 = u32::MAX;

/// Counts of a merging.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairCounts {
    /// Kept Gaussians that represent several.
    pub clusters: usize,
    /// Gaussians merged into others.
    pub merged: usize,
    /// Gaussians dropped, because no picture shows them or they had no neighbour left.
    pub dropped: usize,
}

/// Merges pairs of Gaussians until `target` are left: [`Sequence::new`] and [`Sequence::pairs`] at once.
///
/// # Panics
/// If there is not one score per Gaussian.
pub fn merge(model: &Gaussians, scores: &[Score], cameras: &[Camera], dilation: f32, target: usize) -> Pairs {
    Sequence::new(model, scores, (cameras, dilation), target).pairs(model, scores, target)
}

/// The merges of a model's pairs in their order. A prefix of them gives a model of any size.
pub struct Sequence {
    /// Indices of the Gaussians that have footprints.
    seen: Vec<usize>,
    merges: greedy::Sequence,
}

impl Sequence {
    /// Merges pairs of Gaussians until `least` are left. `cameras` are those of the scores' views, and `dilation` is
    /// the variance in square pixels that rendering adds to every Gaussian. Deterministic; equal costs are ordered by
    /// index.
    ///
    /// # Panics
    /// If there is not one score per Gaussian.
    pub fn new(model: &Gaussians, scores: &[Score], (cameras, dilation): (&[Camera], f32), least: usize) -> Self {
        let n = model.len();
        assert_eq!(scores.len(), n, "one score a Gaussian");
        let observe = |i: usize| {
            let widening = f64::from(dilation) * pixel_area(cameras, DVec3::from(model.means[i].map(f64::from)));
            Footprint::of(model, i, &scores[i], widening)
        };
        let observed: Vec<Option<Footprint>> = (0..n).into_par_iter().map(observe).collect();
        let (seen, footprints) =
            observed.into_iter().enumerate().filter_map(|(i, footprint)| Some((i, footprint?))).unzip();
        Self { seen, merges: greedy::Sequence::new(footprints, least) }
    }

    /// The same model, merged until `target` are left, which must not be below the `least` of the sequence.
    pub fn pairs(&self, model: &Gaussians, scores: &[Score], target: usize) -> Pairs {
        let n = model.len();
        let (keep, cluster) = (vec![false; n], vec![NO_CLUSTER; n]);
        let mut pairs = Pairs { keep, model: model.clone(), cluster, counts: PairCounts::default() };
        let made: Vec<_> = self
            .merges
            .clusters(target)
            .into_par_iter()
            .map(|mut cluster| {
                cluster.members.iter_mut().for_each(|k| *k = self.seen[*k]);
                (moments::merged(model, scores, &cluster), cluster.members)
            })
            .collect();
        for ((gaussian, members), number) in made.iter().zip(0..) {
            for i in members {
                pairs.cluster[*i] = number;
            }
            let place = moments::heaviest(scores, members);
            pairs.keep[place] = true;
            if let Some(gaussian) = gaussian {
                moments::store(&mut pairs.model, place, gaussian);
                pairs.counts.clusters += 1;
                pairs.counts.merged += members.len() - 1;
            }
        }
        // If fewer are visible than wanted, the first of the others are kept, too.
        let missing = target.min(n) - made.len();
        pairs.keep.iter_mut().filter(|keep| !**keep).take(missing).for_each(|keep| *keep = true);
        let kept = pairs.keep.iter().filter(|k| **k).count();
        pairs.counts.dropped = n - kept - pairs.counts.merged;
        pairs
    }
}

/// Area in square world units that a pixel covers at a point: the mean over the cameras that see it in front of them.
fn pixel_area(cameras: &[Camera], point: DVec3) -> f64 {
    let stride = cameras.len().div_ceil(MOST_CAMERAS).max(1);
    let (mut sum, mut count) = (0.0, 0.0);
    for camera in cameras.iter().step_by(stride) {
        let depth = camera.rotation.row(2).dot(point) + camera.translation.z;
        if depth > 0.0 {
            sum += depth * depth / (camera.focal.x * camera.focal.y);
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
