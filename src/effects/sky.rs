//! What photos show beyond all points: a sky, or a background too far away for points.

use super::decision::Decision;
use super::effect::Effect;
use super::quantile::quantile;
use super::training_set::{Thumbnail, TrainingSet};
use crate::sample::{evenly, spread};
use crate::scene::{AlphaRole, Point, median};
use crate::wording::counted;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashSet;

/// Share of what photos show, beyond all points, above which far Gaussians are added.
pub const SHARE: f64 = 0.02;
/// Number of directions that are looked at, and bounds of the number of points: of fewer, the size of each would be its distance from the
/// scene's.
const DIRECTIONS: usize = 1000;
const FEWEST: usize = 4;
const MOST: usize = 300;
/// Cells across a photo; one with a point, and those around it, show something near.
const CELLS: i32 = 16;
/// Largest number of the scene's points that are used.
const POINTS: usize = 20_000;
/// Number of photos that must show a direction.
const SEEN_BY: usize = 3;
/// Largest share of these photos in which it shows something near.
const NEAR: f64 = 0.1;
/// Median deviation of its brightness in them up to which it shows the same.
const ALIKE: f64 = 0.08;
/// Largest difference in a channel from the background, which needs no Gaussians.
const OF_BACKGROUND: f64 = 0.04;
/// Distance of the points, in distances that hold 95 % of the scene's points and all cameras.
const FARTHER: f64 = 10.0;

/// A direction in a photo.
struct Look {
    direction: usize,
    is_near: bool,
    colour: DVec3,
}

/// The decision, and points in the directions in which photos show nothing near. They have the photos' colours and no tracks, and lie around
/// the cameras' mean.
pub fn sky(set: &TrainingSet<'_>) -> (Decision, Vec<Point>) {
    let off = |why: &str| (Decision::plain(Effect::Sky, false, why.to_owned()), Vec::new());
    if set.scene.lacks_points().is_some() {
        return off("too few points tell what is near");
    }
    if set.photos.iter().any(|photo| photo.alpha_role == AlphaRole::Alpha) {
        return off("transparent photos show objects alone");
    }
    let centre = set.scene.centre(set.train);
    let mut lengths: Vec<f64> = set.scene.points.iter().map(|point| point.position.distance(centre)).collect();
    let distance = FARTHER * quantile(&mut lengths, 0.95).max(set.scene.extent(set.train));
    let places: Vec<DVec3> = (0..DIRECTIONS).map(|k| centre + distance * direction(k, DIRECTIONS)).collect();
    let points: Vec<&Point> = evenly(&set.scene.points, POINTS).collect();
    let looks: Vec<Vec<Look>> = set.photos.par_iter().map(|photo| looks(photo, &points, &places)).collect();
    let shown: usize = looks.iter().map(Vec::len).sum();
    let mut by_direction: Vec<Vec<Look>> = places.iter().map(|_| Vec::new()).collect();
    for look in looks.into_iter().flatten() {
        by_direction[look.direction].push(look);
    }
    let background = DVec3::from(set.background.map(f64::from));
    let mut beyond = 0;
    let mut found = Vec::new();
    for (place, looks) in places.iter().zip(&by_direction) {
        let Some(colour) = far_colour(looks) else { continue };
        if (colour - background).abs().max_element() > OF_BACKGROUND {
            beyond += looks.len();
            let colour = colour.to_array().map(|channel| (255.0 * channel).round() as u8);
            found.push(Point { position: *place, normal: None, colour, error: 0.0, track: Vec::new() });
        }
    }
    if found.len() < FEWEST {
        return off("photos show too little beyond the points");
    }
    let share = beyond as f64 / shown.max(1) as f64;
    let evidence = format!(
        "{:.1} % of what photos show lies beyond all points, and looks alike in most of them ({} of {DIRECTIONS})",
        100.0 * share,
        counted(found.len(), "direction"),
    );
    (Decision::by(Effect::Sky, share, SHARE, evidence), spread(&found, MOST))
}

/// The k-th of `count` directions that a spiral over the sphere spreads evenly.
pub(super) fn direction(k: usize, count: usize) -> DVec3 {
    let (t, turn) = ((k as f64 + 0.5) / count as f64, k as f64 * 2.399963229728653);
    let z = 1.0 - 2.0 * t;
    let side = (1.0 - z * z).sqrt();
    DVec3::new(side * turn.cos(), side * turn.sin(), z)
}

/// The directions that a photo shows, where it is neither masked nor at its edge.
fn looks(photo: &Thumbnail, points: &[&Point], places: &[DVec3]) -> Vec<Look> {
    let camera = &photo.camera;
    let cell = |[x, y]: [u32; 2]| {
        let of = |at: u32, size: u32| (f64::from(CELLS) * f64::from(at) / f64::from(size.max(1))) as i32;
        [of(x, camera.width), of(y, camera.height)]
    };
    let near: HashSet<[i32; 2]> = points.iter().filter_map(|point| camera.pixel_of(point.position)).map(cell).collect();
    let is_near = |[x, y]: [i32; 2]| (0..9).any(|k| near.contains(&[x + k % 3 - 1, y + k / 3 - 1]));
    let look = |(direction, place): (usize, &DVec3)| {
        let is_near = is_near(cell(camera.pixel_of(*place)?));
        Some(Look { direction, is_near, colour: photo.colour_of(*place)?.0 })
    };
    places.iter().enumerate().filter_map(look).collect()
}

/// The colour of a direction that enough photos show, if nearly none has anything near there and it looks alike in them.
fn far_colour(looks: &[Look]) -> Option<DVec3> {
    let near = looks.iter().filter(|look| look.is_near).count();
    if looks.len() < SEEN_BY || near as f64 > NEAR * looks.len() as f64 {
        return None;
    }
    let middle = |of: &dyn Fn(&Look) -> f64| median(&mut looks.iter().map(of).collect::<Vec<_>>());
    let bright = |look: &Look| look.colour.element_sum() / 3.0;
    let usual = middle(&bright)?;
    let deviation = middle(&|look| (bright(look) - usual).abs())?;
    let colour = [0, 1, 2].map(|c| middle(&|look| look.colour[c]).unwrap_or_default());
    (deviation <= ALIKE).then(|| DVec3::from(colour))
}
