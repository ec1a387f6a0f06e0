//! Colours of the reconstruction's points in the photos that see them.

use super::training_set::TrainingSet;
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
            let thumbnail = set.photos.get(photo)?;
            let (colour, contrast) = thumbnail.colour_of(point.position)?;
            let direction = (point.position - thumbnail.camera.centre()).try_normalize()?;
            Some(Observation { photo, colour, direction, contrast })
        });
        seen.collect::<Vec<_>>()
    };
    (0..count).into_par_iter().map(of).filter(|seen| seen.len() >= SEEN_BY).collect()
}
