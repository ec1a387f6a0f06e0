//! How far points are from where a photo's pose and lens show them, and what would bring them nearer.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::lens::{Lens, LensModel};
use super::median::{median, weighted_quantile};

/// Misfit of sound photos, in pixels and as a share of the picture's diagonal, whichever is more.
const SOUND: (f64, f64) = (1.0, 0.003);

/// Another meaning of a pose's numbers, world to camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// The numbers lead from the camera to the world.
    CameraToWorld,
    /// The camera's y axis points up and its z axis backwards.
    OpenGl,
    /// The quaternion is x, y, z, w, and was read as w, x, y, z.
    ScalarLast,
}

impl Reading {
    /// All of them, in their order.
    pub const ALL: [Self; 3] = [Self::CameraToWorld, Self::OpenGl, Self::ScalarLast];

    /// The pose in the engine's convention, if the numbers of this one have the other meaning.
    pub fn pose(self, (rotation, translation): (DMat3, DVec3)) -> (DMat3, DVec3) {
        match self {
            Self::CameraToWorld => (rotation.transpose(), -(rotation.transpose() * translation)),
            Self::OpenGl => {
                let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
                (flip * rotation, flip * translation)
            }
            Self::ScalarLast => {
                let read = DQuat::from_mat3(&rotation);
                (DMat3::from_quat(DQuat::from_xyzw(read.w, read.x, read.y, read.z)), translation)
            }
        }
    }
}

/// Distances in pixels between where points were found in a photo and where its pose and lens show them: medians over the points. A
/// point that the lens does not show is as far off as the picture is wide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// The distance, in pixels of the photo's camera.
    pub px: f64,
    /// The diagonal of the camera's picture in pixels.
    pub diagonal: f64,
    /// True if the lens does not show most of the points: they lie behind the camera.
    pub behind: bool,
    /// The distances with the other readings of the pose, in the order of [`Reading::ALL`]; infinite if `px` is that of a sound photo.
    pub reread: [f64; Reading::ALL.len()],
    /// The factor of the focal lengths that fits the points best, and the distance with it.
    pub zoomed: (f64, f64),
}

impl Misfit {
    /// The misfit of a photo of this lens and pose, world to camera; `marks` are places in the photo, in pixels, and the points found
    /// there. None without any.
    pub fn of(lens: &Lens, pose: (DMat3, DVec3), marks: &[(DVec2, DVec3)]) -> Option<Self> {
        let px = distance(lens, pose, 1.0, marks)?;
        let diagonal = DVec2::new(f64::from(lens.width), f64::from(lens.height)).length();
        let unseen = marks.iter().filter(|(_, point)| !lens.pixel_of(pose.0 * *point + pose.1).is_finite()).count();
        let behind = 2 * unseen > marks.len();
        let mut misfit = Self { px, diagonal, behind, reread: [f64::INFINITY; Reading::ALL.len()], zoomed: (1.0, px) };
        if misfit.excess() <= 1.0 {
            return Some(misfit);
        }
        misfit.reread = Reading::ALL.map(|reading| distance(lens, reading.pose(pose), 1.0, marks).unwrap_or(px));
        if lens.model != LensModel::Equirectangular {
            let factor = zoom(lens, pose, marks);
            misfit.zoomed = (factor, distance(lens, pose, factor, marks).unwrap_or(px));
        }
        Some(misfit)
    }

    /// The distance as a share of the picture's diagonal.
    pub fn share(&self) -> f64 {
        self.px / self.diagonal
    }

    /// The distance as a multiple of what sound photos have at most: 1 pixel or 0.3 % of the diagonal.
    pub fn excess(&self) -> f64 {
        self.px / SOUND.0.max(SOUND.1 * self.diagonal)
    }
}

/// The median distance, with focal lengths multiplied by `factor`.
fn distance(lens: &Lens, pose: (DMat3, DVec3), factor: f64, marks: &[(DVec2, DVec3)]) -> Option<f64> {
    let off = |(found, point): &(DVec2, DVec3)| {
        let shown = lens.pixel_of(pose.0 * *point + pose.1);
        let off = (lens.principal + (shown - lens.principal) * factor).distance(*found);
        if off.is_finite() { off } else { f64::from(lens.width) }
    };
    median(&mut marks.iter().map(off).collect::<Vec<_>>())
}

/// The factor of the focal lengths that fits the points best: the median, weighted by the distances from the principal point.
fn zoom(lens: &Lens, pose: (DMat3, DVec3), marks: &[(DVec2, DVec3)]) -> f64 {
    let factor = |(found, point): &(DVec2, DVec3)| {
        let shown = lens.pixel_of(pose.0 * *point + pose.1) - lens.principal;
        let factor = (*found - lens.principal).dot(shown) / shown.length_squared();
        factor.is_finite().then(|| (factor, shown.length()))
    };
    let mut factors: Vec<(f64, f64)> = marks.iter().filter_map(factor).collect();
    weighted_quantile(&mut factors, 0.5).filter(|factor| *factor > 0.0).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(focal: f64, size: u64) -> Lens {
        let half = 0.5 * size as f64;
        Lens::from_colmap(LensModel::Pinhole, size, size, &[focal, focal, half, half]).unwrap()
    }

    /// A pose, and points with the places where a lens shows them.
    fn marked(lens: &Lens) -> ((DMat3, DVec3), Vec<(DVec2, DVec3)>) {
        let pose = (DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.7), DVec3::new(0.3, -0.2, 4.0));
        let seen = (0..60).map(|k| {
            DVec3::new(f64::from(k % 10) * 0.2 - 0.9, f64::from(k / 10) * 0.3 - 0.8, 3.0 + 0.1 * f64::from(k % 7))
        });
        let marks = seen.map(|p| (lens.pixel_of(p), pose.0.transpose() * (p - pose.1))).collect();
        (pose, marks)
    }

    #[test]
    fn a_wrong_reading_and_a_wrong_focal_length_are_found() {
        let own = lens(500.0, 640);
        let (pose, marks) = marked(&own);
        let sound = Misfit::of(&own, pose, &marks).unwrap();
        assert!(sound.px < 1e-9 && !sound.behind, "{sound:?}");
        for (k, reading) in Reading::ALL.into_iter().enumerate() {
            // After four times, each reading gives the pose again.
            let misread = (0..3).fold(pose, |pose, _| reading.pose(pose));
            let wrong = Misfit::of(&own, misread, &marks).unwrap();
            assert!(wrong.excess() > 10.0 && wrong.reread[k] < 1e-9, "{reading:?}: {wrong:?}");
        }
        let zoomed = Misfit::of(&lens(550.0, 640), pose, &marks).unwrap();
        assert!((zoomed.zoomed.0 - 1.0 / 1.1).abs() < 1e-6 && zoomed.zoomed.1 < 1e-6, "{zoomed:?}");
        assert!(zoomed.excess() > 1.0);
        assert_eq!(Misfit::of(&own, pose, &[]), None);
    }

    #[test]
    fn what_is_tolerated_grows_with_the_picture() {
        let excess = |size: u64, off: f64| {
            let lens = lens(size as f64, size);
            let (pose, mut marks) = marked(&lens);
            for (at, _) in &mut marks {
                at.x += off;
            }
            Misfit::of(&lens, pose, &marks).unwrap().excess()
        };
        assert!(excess(6400, 4.5) < 1.0 && excess(100, 3.9) > 1.0 && excess(100, 0.9) < 1.0);
    }
}
