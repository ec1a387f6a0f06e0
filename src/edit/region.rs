//! Regions of space that crops keep.

use super::Error;
use crate::scene::View;
use glam::DVec3;
use rayon::prelude::*;

/// A region of space.
#[derive(Clone, Debug, PartialEq)]
pub enum Region {
    /// An axis-aligned box, including its faces.
    Box {
        /// Minimum coordinates in world units.
        low: DVec3,
        /// Maximum coordinates in world units.
        high: DVec3,
    },
    /// A sphere, including its surface.
    Sphere {
        /// Its centre in world units.
        centre: DVec3,
        /// Its radius in world units.
        radius: f64,
    },
    /// Positions that at least this many photos show, occluded or not.
    Views {
        /// The views of each photo: several where it is cut into faces.
        photos: Vec<Vec<View>>,
        /// Minimum number of photos that show a position.
        least: usize,
    },
}

impl Region {
    /// A box by its minimum and maximum coordinates.
    ///
    /// # Errors
    /// [`Error::Numbers`] for a box without an inside.
    pub fn cube(low: DVec3, high: DVec3) -> Result<Self, Error> {
        if !low.cmple(high).all() {
            return Err(Error::Numbers("this box is empty: give the minimum x, y, z first, then the maximum".into()));
        }
        Ok(Self::Box { low, high })
    }

    /// A ball.
    ///
    /// # Errors
    /// [`Error::Numbers`] for a radius that is not above 0.
    pub fn ball(centre: DVec3, radius: f64) -> Result<Self, Error> {
        if !(centre.is_finite() && radius > 0.0) {
            return Err(Error::Numbers("a sphere has a finite centre and a radius above 0".into()));
        }
        Ok(Self::Sphere { centre, radius })
    }

    /// True if a point is in the region; false for NaN.
    pub fn holds(&self, point: DVec3) -> bool {
        match self {
            Self::Box { low, high } => point.cmpge(*low).all() && point.cmple(*high).all(),
            Self::Sphere { centre, radius } => point.distance_squared(*centre) <= radius * radius,
            Self::Views { photos, least } => {
                let show = |photo: &&Vec<View>| photo.iter().any(|view| view.shows(point));
                photos.iter().filter(show).take(*least).count() >= *least
            }
        }
    }

    /// For each point: true if it is in the region, or, with `outside`, if it is not; always false for NaN.
    pub(super) fn kept(&self, points: &[[f32; 3]], outside: bool) -> Vec<bool> {
        let kept = |point: &[f32; 3]| {
            let point = DVec3::from_array(point.map(f64::from));
            !point.is_nan() && self.holds(point) != outside
        };
        points.par_iter().map(kept).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;
    use crate::scene::lens::{Lens, LensModel};

    #[test]
    fn regions_hold_their_border_and_no_nan() {
        let cube = Region::Box { low: DVec3::splat(-1.0), high: DVec3::ONE };
        let ball = Region::Sphere { centre: DVec3::X, radius: 2.0 };
        for (region, inside) in [(&cube, [1.0, -1.0, 1.0]), (&ball, [3.0, 0.0, 0.0])] {
            let points = [inside, [1.0, 9.0, 0.0], [f32::NAN, 0.0, 0.0]];
            assert_eq!(region.kept(&points, false), [true, false, false]);
            assert_eq!(region.kept(&points, true), [false, true, false]);
        }
    }

    #[test]
    fn views_hold_what_enough_photos_show() {
        let lens = Lens::from_colmap(LensModel::SimplePinhole, 40, 40, &[80.0, 20.0, 20.0]).unwrap();
        let at = |eye: DVec3| {
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.5, 40, 40);
            View::new(String::new(), lens, (camera.rotation, camera.translation))
        };
        let views = [at(DVec3::new(0.0, 0.0, -4.0)), at(DVec3::new(4.0, 0.0, 0.0))];
        let photos: Vec<Vec<View>> = views.iter().map(|view| vec![view.clone()]).collect();
        let [one, two, three] = [1, 2, 3].map(|least| Region::Views { photos: photos.clone(), least });
        let beside_one = DVec3::new(0.0, 0.0, 2.0); // behind the middle for the first, aside for the second
        assert!(one.holds(DVec3::ZERO) && two.holds(DVec3::ZERO) && !three.holds(DVec3::ZERO));
        assert!(one.holds(beside_one) && !two.holds(beside_one));
        assert!(!one.holds(DVec3::new(0.0, 0.0, -9.0)), "behind the first camera");
        let of_one_photo = Region::Views { photos: vec![views.to_vec()], least: 2 };
        assert!(!of_one_photo.holds(DVec3::ZERO));
    }
}
