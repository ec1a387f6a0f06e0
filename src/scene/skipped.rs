//! Unusable parts of a scene, counted, with a few of their names.

use super::{Error, LoadedPhotos, View};
use crate::wording::counted;
use std::fmt;

use serde::{Deserialize, Serialize};

/// Number of names kept as examples.
const EXAMPLES: usize = 5;

/// A count with its first few names.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Names {
    /// Their number.
    pub count: usize,
    /// The first five.
    pub examples: Vec<String>,
    /// The last one: the faces of a photo count once.
    #[serde(skip)]
    pub last: Option<String>,
}

impl Names {
    /// Counts one more.
    pub(crate) fn add(&mut self, name: &str) {
        self.count += 1;
        if self.examples.len() < EXAMPLES {
            self.examples.push(name.to_owned());
        }
    }

    /// Counts a view's photo, once for all views in a row that it is cut into.
    pub(crate) fn add_photo(&mut self, view: &View) {
        let name = view.photo_name();
        if view.face.is_none() || self.last.as_deref() != Some(name) {
            self.last = Some(name.to_owned());
            self.add(name);
        }
    }
}

impl fmt::Display for Names {
    /// The names, of which many are only counted.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let more = if self.count > self.examples.len() { ", ..." } else { "" };
        write!(f, "{}{more}", self.examples.join(", "))
    }
}

/// Everything left out of a scene since it was opened.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Skipped {
    /// Views whose photo does not exist.
    pub missing_images: Names,
    /// Views whose photo has another shape than their camera.
    pub mismatched_images: Names,
    /// Views of `mismatched_images` whose photo would have the camera's shape if it were turned by 90°.
    pub turned_images: Names,
    /// Views whose photo is damaged.
    pub damaged_images: Names,
    /// Views whose photo is in a format that is not read, or only stands for a photo.
    pub unread_images: Names,
    /// Views whose pose is not finite or not a rotation.
    pub bad_poses: Names,
    /// Views whose pose mirrors the world.
    pub mirrored_poses: Names,
    /// Views listed twice with the same fields.
    pub repeated_views: Names,
    /// Photos beside the others that no view names.
    pub unposed_images: Names,
    /// Masks that the capture names and that do not exist.
    pub missing_masks: Names,
    /// Masks that cannot be used.
    pub damaged_masks: Names,
    /// Depth maps that the capture names and that do not exist.
    pub missing_depths: Names,
    /// Points whose position is not finite.
    pub bad_points: usize,
    /// Points that repeat another one's position or lie close to another.
    pub repeated_points: usize,
    /// Entries of points' tracks that name no view of the scene.
    pub track_entries: usize,
    /// Sentences on what is left out or ignored, and on photos, cameras and poses that need a look.
    pub notes: Vec<String>,
    /// Sentences on choices, such as between several files, by which nothing is lost.
    pub choices: Vec<String>,
}

impl Skipped {
    /// Counts the views whose photo or mask could not be loaded, and adds the notes and choices on those that were.
    pub(crate) fn add_loaded(&mut self, loaded: &LoadedPhotos, views: &[&View]) {
        for at in &loaded.without_mask {
            self.damaged_masks.add_photo(views[*at]);
        }
        self.notes.extend(loaded.notes.iter().cloned());
        self.choices.extend(loaded.choices.iter().cloned());
        for (photo, view) in loaded.photos.iter().zip(views) {
            if let Err(error) = photo {
                self.add_failed(view, error);
            }
        }
    }

    /// Counts a view whose photo cannot be loaded, for this cause; the first cause is reported.
    fn add_failed(&mut self, view: &View, error: &Error) {
        let is_unread = matches!(error, Error::Unread { .. });
        let names = if is_unread { &mut self.unread_images } else { &mut self.damaged_images };
        self.notes.extend((names.count == 0).then(|| error.to_string()));
        names.add_photo(view);
    }

    /// A phrase for points that repeat others, then the choices: by none of these anything is lost.
    pub fn chosen(&self) -> Vec<String> {
        let (points, how) = (self.repeated_points, "merged with others at the same place or close to it");
        let merged = (points > 0).then(|| format!("{} {how}", counted(points, "point")));
        merged.into_iter().chain(self.choices.iter().cloned()).collect()
    }

    /// The lines of [`Self::losses`], then those of [`Self::chosen`].
    pub fn summary(&self) -> Vec<String> {
        [self.losses(), self.chosen()].concat()
    }

    /// A phrase for each kind of part left out, then the notes; none if everything was used.
    pub fn losses(&self) -> Vec<String> {
        let masks = if self.damaged_masks.count == 1 {
            "damaged or of another shape than its photo, not used"
        } else {
            "damaged or of another shape than their photos, not used"
        };
        // Turned photos are a part of the mismatched ones.
        let mismatched = match self.turned_images.count {
            0 => "of another shape than the camera".to_owned(),
            1 => "of another shape than the camera, 1 of these turned by 90° against its camera".to_owned(),
            n => format!("of another shape than the camera, {n} of these turned by 90° against their cameras"),
        };
        let named = [
            (&self.missing_images, "photo", "listed but absent"),
            (&self.mismatched_images, "photo", mismatched.as_str()),
            (&self.damaged_images, "photo", "damaged"),
            (&self.unread_images, "photo", "not read"),
            (&self.bad_poses, "view", "without a usable pose"),
            (
                &self.mirrored_poses,
                "pose",
                "mirrored, as of left-handed axes: flip one axis of the cameras in all of them",
            ),
            (&self.repeated_views, "view", "listed twice"),
            (&self.unposed_images, "photo", "without a pose, not used"),
            (&self.missing_masks, "mask file", "listed but absent"),
            (&self.damaged_masks, "mask file", masks),
            (&self.missing_depths, "depth map", "listed but absent"),
        ];
        let mut lines: Vec<String> = named
            .iter()
            .filter(|(names, ..)| names.count > 0)
            .map(|(names, noun, what)| format!("{} {what} ({names})", counted(names.count, noun)))
            .collect();
        let points = self.bad_points;
        lines.extend((points > 0).then(|| format!("{} not finite", counted(points, "point"))));
        lines.extend(match self.track_entries {
            0 => None,
            1 => Some("1 track entry without a view".to_owned()),
            n => Some(format!("{n} track entries without a view")),
        });
        lines.extend(self.notes.iter().cloned());
        lines
    }
}
