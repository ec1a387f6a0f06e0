//! Unusable parts of a scene, counted, with a few of their names.

use crate::wording::counted;
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
}

impl Names {
    /// Counts one more.
    pub(crate) fn add(&mut self, name: &str) {
        self.count += 1;
        if self.examples.len() < EXAMPLES {
            self.examples.push(name.to_owned());
        }
    }
}

/// Everything left out of a scene since it was opened.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Skipped {
    /// Views whose photo does not exist.
    pub missing_images: Names,
    /// Views whose photo has another shape than their camera.
    pub mismatched_images: Names,
    /// Views whose photo cannot be decoded.
    pub damaged_images: Names,
    /// Views whose pose is not finite or not a rotation.
    pub bad_poses: Names,
    /// Views listed twice with the same fields.
    pub repeated_views: Names,
    /// Points whose position is not finite.
    pub bad_points: usize,
    /// Entries of points' tracks that name no view of the scene.
    pub track_entries: usize,
}

impl Skipped {
    /// A phrase for each kind of part left out; none if everything was used.
    pub fn summary(&self) -> Vec<String> {
        let named = [
            (&self.missing_images, "photo", "listed but absent"),
            (&self.mismatched_images, "photo", "of another shape than the camera"),
            (&self.damaged_images, "photo", "damaged"),
            (&self.bad_poses, "view", "without a usable pose"),
            (&self.repeated_views, "view", "listed twice"),
        ];
        let mut lines: Vec<String> = named
            .iter()
            .filter(|(names, ..)| names.count > 0)
            .map(|(names, noun, what)| {
                let more = if names.count > names.examples.len() { ", ..." } else { "" };
                format!("{} {what} ({}{more})", counted(names.count, noun), names.examples.join(", "))
            })
            .collect();
        let points = self.bad_points;
        lines.extend((points > 0).then(|| format!("{} not finite", counted(points, "point"))));
        lines.extend(match self.track_entries {
            0 => None,
            1 => Some("1 track entry without a view".to_owned()),
            n => Some(format!("{n} track entries without a view")),
        });
        lines
    }
}
