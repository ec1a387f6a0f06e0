//! Colours of the reconstruction's points in the photos that see them.

use super::sights::{PAIRS, PROJECTED};
use super::training_set::{Thumbnail, TrainingSet};
use crate::sample::evenly;
use crate::scene::{Front, Point, fronts};
use glam::DVec3;
use rayon::prelude::*;

/// Number of points used, evenly spread over the list.
const POINTS: usize = 4000;
/// Number of views that must see a point.
const SEEN_BY: usize = 3;

/// One photo's colour of a point.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Index of the photo.
    pub photo: usize,
    /// Red, green, blue in [0, 1].
    pub colour: DVec3,
    /// Unit vector from the camera to the point.
    pub direction: DVec3,
    /// Range of brightness of the nearest 4 x 4 pixels.
    pub contrast: f64,
}

/// For each point of a scene without tracks, its colours in at least three training photos in which nothing nearer hides it; none
/// if they are too few, or show too little of the scene.
pub fn projected(set: &TrainingSet<'_>) -> Vec<Vec<Observation>> {
    if set.scene.lacks_points().is_some() {
        return Vec::new();
    }
    let points: Vec<&Point> =
        evenly(&set.scene.points, (PAIRS / set.photos.len().max(1)).clamp(PROJECTED.0, PROJECTED.1)).collect();
    let mut by_point: Vec<Vec<Observation>> = vec![Vec::new(); points.len()];
    let looks = |(photo, thumbnail): (usize, &Thumbnail)| {
        let seen = fronts(&thumbnail.camera, points.len(), |k| points[k].position).into_iter();
        let look = |front: Front| Some((front.point, observe(photo, thumbnail, points[front.point].position)?));
        seen.filter_map(look).collect::<Vec<_>>()
    };
    let looks: Vec<_> = set.photos.par_iter().enumerate().map(|(photo, thumbnail)| looks((photo, thumbnail))).collect();
    for (point, observation) in looks.into_iter().flatten() {
        by_point[point].push(observation);
    }
    by_point.retain(|seen| seen.len() >= SEEN_BY);
    by_point
}

/// A photo's colour of a point.
fn observe(photo: usize, thumbnail: &Thumbnail, position: DVec3) -> Option<Observation> {
    let (colour, contrast) = thumbnail.colour_of(position)?;
    let direction = (position - thumbnail.camera.centre()).try_normalize()?;
    Some(Observation { photo, colour, direction, contrast })
}

/// For each point, its colours in at least three training photos.
pub fn observations(set: &TrainingSet<'_>) -> Vec<Vec<Observation>> {
    let mut photo_of = vec![None; set.scene.views.len()];
    for (photo, view) in set.train.iter().enumerate() {
        if let Some(slot) = photo_of.get_mut(*view) {
            *slot = Some(photo);
        }
    }
    let long: Vec<_> = set.scene.points.iter().filter(|p| p.track.len() >= SEEN_BY).collect();
    let count = long.len().min(POINTS);
    let of = |k: usize| {
        let point = long[k * long.len() / count];
        let seen = point.track.iter().filter_map(|view| {
            let photo = photo_of.get(*view as usize).copied().flatten()?;
            observe(photo, set.photos.get(photo)?, point.position)
        });
        seen.collect::<Vec<_>>()
    };
    (0..count).into_par_iter().map(of).filter(|seen| seen.len() >= SEEN_BY).collect()
}
