//! Colours of the reconstruction's points in the photos that saw them.

use super::{Shot, Subject};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Points looked at, evenly over the list.
const POINTS: usize = 4000;
/// Views that must have seen a point.
const SEEN_BY: usize = 3;
/// Bytes of alpha, or of a mask, below which a pixel tells nothing.
const OPAQUE: u8 = 250;

/// One photo's colour of a point.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Index of the photo.
    pub shot: usize,
    /// Red, green, blue in [0, 1].
    pub colour: DVec3,
    /// Unit vector from the camera to the point.
    pub direction: DVec3,
    /// Range of brightness in the 4 x 4 pixels round it.
    pub contrast: f64,
}

/// By point: its colours in at least three training photos.
pub fn observations(subject: &Subject<'_>) -> Vec<Vec<Observation>> {
    let mut shot_of = vec![None; subject.scene.views.len()];
    for (shot, view) in subject.train.iter().enumerate() {
        if let Some(slot) = shot_of.get_mut(*view) {
            *slot = Some(shot);
        }
    }
    let long: Vec<_> = subject.scene.points.iter().filter(|p| p.track.len() >= SEEN_BY).collect();
    let count = long.len().min(POINTS);
    let of = |k: usize| {
        let point = long[k * long.len() / count];
        let seen = point.track.iter().filter_map(|view| {
            let shot = shot_of.get(*view as usize).copied().flatten()?;
            let photo = subject.shots.get(shot)?;
            let (colour, contrast) = photo.colour_of(point.position)?;
            let direction = (point.position - photo.camera.centre()).try_normalize()?;
            Some(Observation { shot, colour, direction, contrast })
        });
        seen.collect::<Vec<_>>()
    };
    (0..count).into_par_iter().map(of).filter(|seen| seen.len() >= SEEN_BY).collect()
}

impl Shot {
    /// Colour of a world point, between the four pixels round it, and the range of brightness among sixteen; none near
    /// the photo's rim or where it is not opaque.
    fn colour_of(&self, position: DVec3) -> Option<(DVec3, f64)> {
        let p = self.camera.rotation * position + self.camera.translation;
        if p.z <= 0.0 {
            return None;
        }
        let at = p.truncate() / p.z * self.camera.focal + self.camera.principal - 0.5;
        let (w, h) = (self.camera.width as usize, self.camera.height as usize);
        let inside = at.cmpge(DVec2::ONE).all() && at.x < w as f64 - 2.0 && at.y < h as f64 - 2.0;
        if !inside {
            return None;
        }
        let (x, y, part) = (at.x as usize, at.y as usize, at.fract());
        let (mut sum, mut low, mut high) = (DVec3::ZERO, f64::INFINITY, f64::NEG_INFINITY);
        for (dx, dy) in (0..4).flat_map(|dy| (0..4).map(move |dx| (dx, dy))) {
            let pixel = self.pixels.get(4 * ((y + dy - 1) * w + x + dx - 1)..)?.first_chunk::<4>()?;
            if pixel[3] < OPAQUE {
                return None;
            }
            let colour = DVec3::from([pixel[0], pixel[1], pixel[2]].map(|c| f64::from(c) / 255.0));
            let bright = colour.element_sum() / 3.0;
            (low, high) = (low.min(bright), high.max(bright));
            let share = |k: usize, f: f64| match k {
                1 => 1.0 - f,
                2 => f,
                _ => 0.0,
            };
            sum += colour * share(dx, part.x) * share(dy, part.y);
        }
        Some((sum, high - low))
    }
}
