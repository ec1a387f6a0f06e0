//! The map of all space into a cube.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Coordinates of contracted space are at most this far from its centre.
const REACH: f64 = 2.0;

/// A map of all space into a cube of side 4: the cube around `centre` keeps its shape, and the rest of the world lies in
/// the shell around it (as in mip-NeRF 360, with the largest coordinate as the norm).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contraction {
    /// The cube's centre in world units.
    pub(super) centre: [f64; 3],
    /// Half the cube's side in world units.
    pub(super) half_side: f64,
}

impl Contraction {
    /// A contraction that keeps the shape of the cube around these points, such as the cameras' centres. Points that
    /// are not finite do not count; without any, or with equal ones only, the cube has half side 1.
    pub fn around(points: impl IntoIterator<Item = DVec3>) -> Self {
        let mut finite = points.into_iter().filter(|p| p.is_finite());
        let first = finite.next().unwrap_or(DVec3::ZERO);
        let (low, high) = finite.fold((first, first), |(low, high), p| (low.min(p), high.max(p)));
        let half = 0.5 * (high - low).max_element();
        Self { centre: (low + 0.5 * (high - low)).to_array(), half_side: if half > 0.0 { half } else { 1.0 } }
    }

    /// The contracted position of a position in world units, each coordinate within -2..=2; NaN if one of its
    /// coordinates is.
    pub fn of(&self, position: [f32; 3]) -> [f64; 3] {
        let p: [f64; 3] = std::array::from_fn(|i| (f64::from(position[i]) - self.centre[i]) / self.half_side);
        if p.iter().any(|x| x.is_nan()) {
            return [f64::NAN; 3];
        }
        let most = p.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        if most <= 1.0 {
            return p;
        }
        if most == f64::INFINITY {
            return p.map(|x| if x.is_infinite() { REACH * x.signum() } else { 0.0 });
        }
        let factor = REACH - 1.0 / most;
        p.map(|x| factor * (x / most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INFINITE: f32 = f32::INFINITY;

    #[test]
    fn the_unit_cube_keeps_its_shape_and_infinity_is_two_away() {
        let c = Contraction { centre: [1.0, -2.0, 0.5], half_side: 3.0 };
        assert_eq!(c.of([1.0, -2.0, 0.5]), [0.0; 3]);
        assert_eq!(c.of([4.0, -5.0, 2.0]), [1.0, -1.0, 0.5]);
        // p = (4, 2, 0): 2 - 1/4 along the largest coordinate.
        assert_eq!(c.of([13.0, 4.0, 0.5]), [1.75, 0.875, 0.0]);
        assert_eq!(c.of([INFINITE, -INFINITE, 9.0]), [2.0, -2.0, 0.0]);
        assert!(c.of([f32::NAN, 0.0, 0.0]).iter().all(|x| x.is_nan()));
        let largest = c.of([f32::MAX, -f32::MAX, 0.0]);
        assert!(largest[0] <= 2.0 && largest[1] >= -2.0 && largest[0] > 1.99, "{largest:?}");
    }

    #[test]
    fn the_cube_encloses_the_cameras() {
        let points = [DVec3::new(-1.0, 0.0, 2.0), DVec3::new(5.0, 2.0, 2.0), DVec3::splat(f64::NAN)];
        assert_eq!(Contraction::around(points), Contraction { centre: [2.0, 1.0, 2.0], half_side: 3.0 });
        for few in [vec![], vec![DVec3::ONE; 2]] {
            assert_eq!(Contraction::around(few).half_side, 1.0);
        }
    }
}
