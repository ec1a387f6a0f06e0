//! Photos that do not show what the points of their poses look like.

use super::sights::{Change, Fit, Sights};
use super::training_set::{OPAQUE, Thumbnail};
use crate::checksum::crc32;
use crate::scene::camera::Camera;
use crate::scene::{AlphaRole, Scene, View, median};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Smallest number of photos that are compared.
const FEWEST: usize = 5;
/// Agreement of a capture from which on single photos are doubted, and below which changes of all photos and poses are tried. Of sound
/// captures (king, snowmiku, eight synthetic ones), the least was 0.94 with tracks and 0.87 without.
const USUAL: f64 = 0.8;
/// Agreement of doubted photos: at most this, and at least so far below that of the capture. Of sound photos, the least was 0.84 with
/// tracks and 0.69 without; of photos that were swapped, the median 0.0 to 0.3 and 0.2 to 0.5.
const DOUBTED: (f64, f64) = (0.5, 0.3);
/// Least difference from the other photos of a doubted one, in medians of all photos: that of a plain wall has no pattern to compare.
const APART: f64 = 1.5;
/// Agreement that a change of all photos and poses must reach, and gain.
const CHANGED: (f64, f64) = (0.7, 0.15);
/// Agreement below which a capture's photos have nothing in common where tracks say that they see the same.
const LOST: f64 = 0.3;
/// The same without tracks: with each other, with the points' colours, and the smoothness of these from which on they tell. Of sound
/// captures, the least were 0.87, 0.64 and 0.28; clouds turned by 90° had 0.55 to 0.67 and 0.32 to 0.54, and points drawn by lot a
/// smoothness of 0.03.
const LOST_WITHOUT_TRACKS: (f64, f64, f64) = (0.7, 0.45, 0.2);
/// Range of a channel, in steps of 8 bits, up to which a photo has a single colour; the share of pixels left out at either end, and the
/// least share of pixels that count.
const SINGLE: (usize, f64, f64) = (3, 0.005, 0.2);
/// Angle in degrees, and distance in extents of the cameras, up to which poses are the same.
const SAME_POSE: (f64, f64) = (2.0, 0.02);

/// The views of a photo, with their small copies; never empty.
type Views<'a> = Vec<(&'a View, &'a Thumbnail)>;

/// What a capture's photos tell about their names and poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Agreement {
    /// The median over photos of the rank correlation of their pixels with those of other photos, or with the points' colours, at the
    /// same points, whichever is higher; none if too few photos share enough points.
    pub usual: Option<f64>,
    /// Photos for which it is far lower, with it, worst first.
    pub doubted: Vec<(String, f64)>,
    /// The change of all photos or poses that makes it far higher, and its median then.
    pub change: Option<(Change, f64)>,
    /// True if photos and points have nothing in common, and no change that was tried helps.
    pub lost: bool,
    /// Photos of a single colour.
    pub single_colour: Vec<String>,
    /// Groups of photos with the same pixels and different poses.
    pub equal: Vec<Vec<String>>,
    /// Groups of photos with the same pixels and the same pose.
    pub copies: Vec<Vec<String>>,
}

impl Agreement {
    /// Compares photos; `thumbnails` are those of the scene's views, as far as their photos can be read.
    pub fn of(scene: &Scene, thumbnails: &[Option<Thumbnail>]) -> Self {
        let (single, rest): (Vec<Views<'_>>, Vec<Views<'_>>) =
            by_photo(scene, thumbnails).into_par_iter().partition(|photo| is_single_colour(photo));
        let left_out: BTreeSet<&str> = single.iter().map(|photo| photo[0].0.photo_name()).collect();
        let single_colour = left_out.iter().map(|name| (*name).to_owned()).collect();
        let [equal, copies] = equal(scene, &rest);
        let mut found = Self { single_colour, equal, copies, ..Self::default() };
        found.compare(&Sights::of(scene, thumbnails, &left_out));
        found
    }

    /// Compares the photos by their points.
    fn compare(&mut self, sights: &Sights<'_>) {
        let fits = sights.fits(None);
        self.usual = usual(&fits, FEWEST, Fit::agreement);
        if let Some(agreement) = self.usual.filter(|usual| *usual >= USUAL) {
            let limit = DOUBTED.0.min(agreement - DOUBTED.1);
            let least = APART * usual(&fits, FEWEST, |fit| fit.residual).unwrap_or_default();
            let known = sights.photos.iter().zip(&fits).filter_map(|(name, fit)| Some((name, (*fit)?)));
            let doubted = known.filter(|(_, fit)| fit.agreement() < limit && fit.residual >= least);
            self.doubted = doubted.map(|(name, fit)| ((*name).to_owned(), fit.agreement())).collect();
            self.doubted.sort_by(|(_, a), (_, b)| a.total_cmp(b));
            return;
        }
        self.change = if sights.whole { change(sights, self.usual.unwrap_or_default()) } else { None };
        self.lost = self.change.is_none() && lost(sights, &fits);
    }
}

/// The photos that can be read.
fn by_photo<'a>(scene: &'a Scene, thumbnails: &'a [Option<Thumbnail>]) -> Vec<Views<'a>> {
    let there = scene.views.iter().zip(thumbnails).filter_map(|(view, small)| Some((view, small.as_ref()?)));
    let there: Views<'a> = there.collect();
    there.chunk_by(|(a, _), (b, _)| a.photo_name() == b.photo_name()).map(<[_]>::to_vec).collect()
}

/// The median over photos of a measure of their fits; none if fewer than `least` have one.
fn usual(fits: &[Option<Fit>], least: usize, of: impl Fn(&Fit) -> f64) -> Option<f64> {
    let mut known: Vec<f64> = fits.iter().flatten().map(of).collect();
    if known.len() < least { None } else { median(&mut known) }
}

/// The change under which most photos agree far better than they do now, with the agreement then.
fn change(sights: &Sights<'_>, now: f64) -> Option<(Change, f64)> {
    let least = FEWEST.max(sights.photos.len().div_ceil(2));
    let changed = |change: Change| Some((change, usual(&sights.fits(Some(change)), least, Fit::agreement)?));
    let tried = Change::ALL.into_iter().filter_map(changed);
    tried.filter(|(_, then)| *then >= CHANGED.0.max(now + CHANGED.1)).max_by(|(_, a), (_, b)| a.total_cmp(b))
}

/// True if most photos have nothing in common with the others, nor with points whose colours tell.
fn lost(sights: &Sights<'_>, fits: &[Option<Fit>]) -> bool {
    let least = FEWEST.max(sights.photos.len().div_ceil(2));
    let below = |limit: f64, of: fn(&Fit) -> f64| usual(fits, least, of).is_some_and(|usual| usual < limit);
    if sights.tracked {
        return below(LOST, Fit::agreement);
    }
    let (others, colours, smooth) = LOST_WITHOUT_TRACKS;
    below(others, |fit| fit.others) && below(colours, |fit| fit.colours) && sights.smoothness() >= smooth
}

/// True if what is visible of a photo, which may have several views, has the same colour everywhere.
fn is_single_colour(photo: &[(&View, &Thumbnail)]) -> bool {
    // A transparent photo shows an object's shape.
    if photo.iter().any(|(_, small)| small.alpha_role == AlphaRole::Alpha) {
        return false;
    }
    let mut counts = [[0_usize; 256]; 3];
    let (mut visible, mut all) = (0_u32, 0_u32);
    for pixel in photo.iter().flat_map(|(_, small)| small.pixels.as_chunks::<4>().0) {
        all += 1;
        if pixel[3] >= OPAQUE {
            visible += 1;
            counts.iter_mut().zip(pixel).for_each(|(count, value)| count[usize::from(*value)] += 1);
        }
    }
    let (range, outside, least) = SINGLE;
    let narrow = |count: &[usize; 256]| {
        let enough = |sum: &mut usize, n: usize| {
            *sum += n;
            *sum as f64 > outside * f64::from(visible)
        };
        let (mut below, mut above) = (0, 0);
        let low = count.iter().position(|n| enough(&mut below, *n)).unwrap_or(0);
        let high = count.iter().rposition(|n| enough(&mut above, *n)).unwrap_or(0);
        high.saturating_sub(low) <= range
    };
    visible > 0 && f64::from(visible) >= least * f64::from(all) && counts.iter().all(narrow)
}

/// Groups of photos whose first views have the same pixels: under different poses, and under the same one.
fn equal(scene: &Scene, photos: &[Views<'_>]) -> [Vec<Vec<String>>; 2] {
    let views: Vec<usize> = (0..scene.views.len()).collect();
    let near = SAME_POSE.1 * scene.extent(&views);
    let sums: Vec<u32> = photos.par_iter().map(|photo| crc32([photo[0].1.pixels.as_slice()])).collect();
    let mut by_sum: BTreeMap<u32, Views<'_>> = BTreeMap::new();
    for (sum, photo) in sums.iter().zip(photos) {
        // An object may be out of sight in several transparent pictures.
        if photo[0].1.pixels.as_chunks::<4>().0.windows(2).any(|pixels| pixels[0] != pixels[1]) {
            by_sum.entry(*sum).or_default().push(photo[0]);
        }
    }
    let twins = |a: &(&View, &Thumbnail), b: &(&View, &Thumbnail), differ: bool| {
        moved(&a.0.camera, &b.0.camera, near) == differ
            && a.1.camera.width == b.1.camera.width
            && a.1.pixels == b.1.pixels
    };
    [true, false].map(|differ| {
        let mut groups: Vec<Vec<String>> = Vec::new();
        for group in by_sum.values() {
            let mut left = group.clone();
            while let Some((first, rest)) = left.split_first() {
                let (same, others): (Views<'_>, Views<'_>) = rest.iter().partition(|other| twins(first, other, differ));
                let names = [first].into_iter().chain(&same).map(|(view, _)| view.photo_name().to_owned());
                groups.extend((!same.is_empty()).then(|| names.collect()));
                // Of photos under different poses, one group tells.
                left = if differ { Vec::new() } else { others };
            }
        }
        groups.sort();
        groups
    })
}

/// True if two poses differ by more than any two that were found for the same photo.
fn moved(a: &Camera, b: &Camera, near: f64) -> bool {
    let turn = a.rotation * b.rotation.transpose();
    let cosine = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
    cosine < SAME_POSE.0.to_radians().cos() || a.centre().distance(b.centre()) > near
}
