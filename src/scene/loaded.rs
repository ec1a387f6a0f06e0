//! Loaded photos, and what users should know of their alpha and masks.

use super::decode::{ALPHA_SHARE, NOTHING};
use super::{Error, Photo};
use crate::wording::counted;

/// Loaded photos, with notes for the user.
pub struct LoadedPhotos {
    /// The photos, in the order of the views; a damaged photo fails alone.
    pub photos: Vec<Result<Photo, Error>>,
    /// Faults of alpha and masks, for the user.
    pub notes: Vec<String>,
    /// How alpha is used, for the user.
    pub choices: Vec<String>,
    /// Views whose mask cannot be used, ascending.
    pub without_mask: Vec<usize>,
}

/// The result of loading one view.
pub(super) struct Loaded {
    pub photo: Result<Photo, Error>,
    /// Sum of its pixels' transparencies, if its alpha is used.
    pub transparent: f64,
    /// True if it has transparent pixels, and its alpha is not used since other photos' faces are masked.
    pub unused: bool,
    /// The fault of its mask, if that cannot be used.
    pub no_mask: Option<String>,
    /// True if its mask hides all of it.
    pub hidden: bool,
    /// True if its photo has the same alpha everywhere.
    pub even: bool,
}

impl Loaded {
    /// A photo that cannot be read.
    pub fn damaged(error: Error) -> Self {
        Self { photo: Err(error), transparent: 0.0, unused: false, no_mask: None, hidden: false, even: false }
    }

    /// The number of its pixels; 0 without a photo.
    pub fn pixels(&self) -> f64 {
        self.photo.as_ref().map_or(0.0, |photo| photo.camera.pixels() as f64)
    }
}

/// A share in per cent with so many decimals, as far as it is not less than one unit of the last.
fn percent(share: f64, decimals: usize) -> String {
    let least = 0.1_f64.powi(decimals as i32);
    if 100.0 * share < least {
        format!("less than {least:.decimals$}")
    } else {
        format!("{:.decimals$}", 100.0 * share)
    }
}

/// A note on alpha that does not count, if this share of the pixels is transparent.
pub(super) fn without_alpha(share: f64) -> Option<String> {
    if share > NOTHING {
        return Some("all of the photos' pixels are transparent: taken as opaque".to_owned());
    }
    let (told, most) = (percent(share, 2), 100.0 * ALPHA_SHARE);
    let note = format!("{told} % of the photos' pixels are transparent, under {most} %: taken as opaque, on black");
    (share > 0.0).then_some(note)
}

/// A note on photos whose alpha is not used, since parts of other photos' faces are masked.
pub(super) fn unused_alpha(photos: usize) -> Option<String> {
    let what = "with alpha that is ignored, because faces cut from other photos are masked in part: give masks instead";
    told(photos, what)
}

/// A number of photos, with what is told of them; none for no photos.
fn told(photos: usize, what: &str) -> Option<String> {
    (photos > 0).then(|| format!("{} {what}", counted(photos, "photo")))
}

/// Faults of alpha and masks, for the user: that masks are `unused`, and the numbers of photos that are `hidden` as a whole or `blank`.
pub(super) fn notes(unused: bool, hidden: usize, blank: usize) -> Vec<String> {
    let unused = unused.then(|| "the photos have alpha, which counts: their masks are not used".to_owned());
    let hidden = told(hidden, "hidden as a whole by their masks: what is black in a mask does not count");
    let blank = told(blank, "transparent everywhere");
    unused.into_iter().chain(hidden).chain(blank).collect()
}

/// How alpha is used, for the user: the number of photos that have the same alpha everywhere (`even`), and, if alpha counts without
/// having been requested, the share of transparent pixels, with true if these are masked.
pub(super) fn choices(even: usize, transparent: Option<(f64, bool)>) -> Vec<String> {
    let counts = transparent.map(|(share, masked)| {
        let used = if masked {
            "masked in faces of panoramas and wide fisheyes, as are the parts that these hide"
        } else {
            "alpha is used; the background is white unless --background is given"
        };
        format!("{} % of the photos' pixels are transparent: {used}", percent(share, if masked { 2 } else { 1 }))
    });
    told(even, "with the same alpha everywhere: taken as opaque").into_iter().chain(counts).collect()
}
