//! How much of the photos a scene's points show.

use super::camera::Camera;
use super::{Point, Scene, median};
use crate::sample::evenly;
use std::collections::BTreeSet;

/// Cells across a photo.
const GRID: u32 = 8;
/// Largest numbers of photos and points that are used.
const MOST: (usize, usize) = (64, 10_000);
/// Share of the middle photo's cells with a point below which points without tracks do not show the scene.
const COVERED: f64 = 0.05;

impl Scene {
    /// The share of the middle photo that points without tracks fall into, if it is too small for them to show the scene.
    pub(super) fn uncovered(&self) -> Option<f64> {
        if self.points.iter().any(|point| !point.track.is_empty()) {
            return None;
        }
        let points: Vec<&Point> = evenly(&self.points, MOST.1).collect();
        let mut shares: Vec<f64> = evenly(&self.views, MOST.0).map(|view| share(&view.camera, &points)).collect();
        median(&mut shares).filter(|share| *share < COVERED)
    }
}

/// The share of a photo's cells that points fall into.
fn share(camera: &Camera, points: &[&Point]) -> f64 {
    let cell = |[x, y]: [u32; 2]| [x * GRID / camera.width.max(1), y * GRID / camera.height.max(1)];
    let shown = points.iter().filter_map(|point| camera.pixel_of(point.position));
    shown.map(cell).collect::<BTreeSet<_>>().len() as f64 / f64::from(GRID * GRID)
}
