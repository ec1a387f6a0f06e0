//! The near plane of a scene, independent of its unit of length.

use super::{Point, Scene, View};
use crate::kernels::constants::view::NEAR;
use crate::sample::evenly;

/// Median depth of the points in a scene of usual size, in near planes: 9.2 where that is 3DGS's 0.2.
pub const USUAL_DISTANCE: f64 = 9.2 / 0.2;
/// Cameras nearer to each other than this, in near planes, are at one place, from where nothing shows how far away things are.
pub const ONE_PLACE: f64 = 5e-3;
/// Maximum ratio of a scene's own near plane to 3DGS's for which 3DGS's is used, because models are trained with it.
const USUAL: f64 = 2.5;
/// Near plane of a camera that looks at a model alone, as a share of its distance.
const OF_DISTANCE: f64 = 0.02;
/// Number of views for the depths of points without a track.
const LOOKS: usize = 20;

/// The near plane in world units, in proportion to the scene's [`size`]; 3DGS's for scenes of usual or unknown size.
pub(super) fn near(size: f64) -> f32 {
    let own = size / USUAL_DISTANCE;
    let usual = f64::from(NEAR);
    if own == 0.0 || (usual / USUAL..=usual * USUAL).contains(&own) { NEAR } else { own as f32 }
}

/// The near plane of a camera at this distance from a model, in world units: the usual one unless the model is small, for which
/// it is nearer, or very large.
pub fn near_at(usual: f32, distance: f64) -> f32 {
    let own = (OF_DISTANCE * distance) as f32;
    if own > USUAL as f32 * usual { own } else { own.min(usual) }
}

impl Scene {
    /// Rescales a scene of unusual size by a power of ten, so that captures in other units become the same numbers. Returns the new
    /// unit in old units; 1 if nothing changes.
    pub fn use_usual_unit(&mut self) -> f64 {
        let ratio = f64::from(self.near) / f64::from(NEAR);
        if (1.0 / USUAL..=USUAL).contains(&ratio) {
            return 1.0;
        }
        let unit = 10_f64.powi(ratio.log10().round() as i32);
        for view in &mut self.views {
            view.camera.translation /= unit;
        }
        for point in &mut self.points {
            point.position /= unit;
        }
        self.near = (f64::from(self.near) / unit) as f32;
        self.unit *= unit;
        unit
    }
}

/// The median depth of the points in the views that see them, or the 10th percentile for panoramas, which see near and far at
/// once; without points, the median distance of the cameras from their mean.
pub(super) fn size(views: &[View], points: &[Point]) -> f64 {
    let few = evenly(views, LOOKS);
    let depth = |view: &View, point: &Point| view.camera.depth(point.position);
    let depths = points.iter().flat_map(|point| {
        let seen = point.track.iter().filter_map(|v| views.get(*v as usize));
        // A photo that was cut is in front of everything by one of its parts.
        let looks = few
            .clone()
            .filter(|view| point.track.is_empty() && (view.face.is_none() || view.camera.shows(point.position)));
        seen.chain(looks).map(|view| depth(view, point)).filter(|z| *z > 0.0)
    });
    let mut lengths: Vec<f64> = depths.collect();
    if lengths.is_empty() {
        let mean = super::camera::mean_centre(views.iter().map(|view| &view.camera));
        lengths = views.iter().map(|view| view.camera.centre().distance(mean)).collect();
    }
    let around = views.iter().any(|view| view.face.is_some());
    let rank = lengths.len() / if around { 10 } else { 2 };
    if lengths.is_empty() { 0.0 } else { *lengths.select_nth_unstable_by(rank, f64::total_cmp).1 }
}
