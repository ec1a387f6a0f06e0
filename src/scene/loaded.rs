//! Loaded photos, and what users should know of their alpha and masks.

use super::decode::{ALPHA_SHARE, NOTHING};
use super::{Error, Photo};
use crate::wording::counted;

/// Loaded photos, with notes for the user.
pub struct LoadedPhotos {
    /// In the order of the views; a damaged photo fails alone.
    pub photos: Vec<Result<Photo, Error>>,
    /// Notes for the user.
    pub notes: Vec<String>,
    /// Views whose mask cannot be used, ascending.
    pub without_mask: Vec<usize>,
}

/// What became of one view.
pub(super) struct Loaded {
    pub photo: Result<Photo, Error>,
    /// Sum of its pixels' transparencies.
    pub transparent: f64,
    /// The fault of its mask, if that cannot be used.
    pub no_mask: Option<String>,
    /// True if its mask hides all of it.
    pub hidden: bool,
    /// True if its photo has the same alpha everywhere.
    pub even: bool,
}

impl Loaded {
    /// The number of its pixels; 0 without a photo.
    pub fn pixels(&self) -> f64 {
        self.photo.as_ref().map_or(0.0, |photo| photo.camera.pixels() as f64)
    }
}

/// A note on alpha that does not count, if this share of the pixels is transparent.
pub(super) fn without_alpha(share: f64) -> Option<String> {
    if share > NOTHING {
        return Some("all of the photos' pixels are transparent: taken as opaque".to_owned());
    }
    let percent = 100.0 * share;
    let told = if percent < 0.01 { "less than 0.01".to_owned() } else { format!("{percent:.2}") };
    let most = 100.0 * ALPHA_SHARE;
    let note = format!("{told} % of the photos' pixels are transparent, under {most} %: taken as opaque, on black");
    (share > 0.0).then_some(note)
}

/// What users should know of alpha and masks: that `masks` are not used, the numbers of photos that are `hidden` as a whole, have the
/// same alpha everywhere (`even`) or are `blank`, and the share of transparent pixels if alpha counts without having been requested.
pub(super) fn notes(masks: bool, hidden: usize, even: usize, transparent: Option<f64>, blank: usize) -> Vec<String> {
    let photos = |count: usize, what: &str| (count > 0).then(|| format!("{} {what}", counted(count, "photo")));
    let counts = transparent.map(|share| {
        let share = 100.0 * share;
        format!(
            "{share:.1} % of the photos' pixels are transparent: alpha counts, on white unless another background is given"
        )
    });
    let blank = counts.as_ref().and_then(|_| photos(blank, "transparent everywhere"));
    masks
        .then(|| "the photos have alpha, which counts: their masks are not used".to_owned())
        .into_iter()
        .chain(photos(hidden, "hidden as a whole by their masks: what is black in a mask does not count"))
        .chain(photos(even, "with the same alpha everywhere: taken as opaque"))
        .chain(counts)
        .chain(blank)
        .collect()
}
