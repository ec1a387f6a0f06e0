//! Faces: the pinhole views into which panoramas and wide fisheyes are cut, because one pinhole cannot show their field of
//! view. They are faces of a cube around the camera; for a fisheye, the visible parts of them.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec2, DVec3};

use super::Scene;
use super::lens::ideal::WIDEST;
use super::lens::{Curve, Lens, LensModel};

/// Sample points along a side of a face, for the part that the lens sees.
const LOOKS: u32 = 64;
/// Minimum visible share of a face for a view.
const LEAST: f64 = 0.05;

/// Names of the faces, in the order of names, with the axes right, down and forward of each in those of the photo.
pub const CUBE: [(&str, [DVec3; 3]); 6] = [
    ("back", [DVec3::NEG_X, DVec3::Y, DVec3::NEG_Z]),
    ("down", [DVec3::X, DVec3::NEG_Z, DVec3::Y]),
    ("front", [DVec3::X, DVec3::Y, DVec3::Z]),
    ("left", [DVec3::Z, DVec3::Y, DVec3::NEG_X]),
    ("right", [DVec3::NEG_Z, DVec3::Y, DVec3::X]),
    ("up", [DVec3::X, DVec3::Z, DVec3::NEG_Y]),
];

/// A face of a photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Face {
    /// The photo's name.
    pub photo: String,
    /// Rotation from the photo's camera coordinates to the face's.
    pub turn: DMat3,
    /// Angle in radians around straight down within which the photo is masked, because it shows the photographer.
    pub pole: f64,
    /// Maximum angle in radians from the lens's axis that the photo shows.
    pub reach: f64,
    /// True if a face of the photo hides a part of itself.
    pub masked: bool,
}

/// A face without its photo: its name, its rotation, and its pinhole with the size in pixels.
pub(super) struct Cut {
    pub name: &'static str,
    pub turn: DMat3,
    pub size: [u32; 2],
    pub focal: f64,
    pub principal: DVec2,
    pub reach: f64,
    /// True if a face of the lens hides a part of itself.
    pub masked: bool,
}

/// The faces of a lens, in the order of their names; none if one pinhole suffices. The width of a whole face in pixels is that
/// of the photo over a quarter turn in its middle.
pub(super) fn of(lens: &Lens) -> Vec<Cut> {
    let Some(reach) = reach(lens) else { return Vec::new() };
    let middle = lens.distort(DVec2::new(1e-6, 0.0)).x / 1e-6;
    let per_radian = if lens.model == LensModel::Equirectangular { 1.0 } else { middle } * lens.focal.x;
    let side = (FRAC_PI_2 * per_radian + 1e-6).round().clamp(1.0, f64::from(lens.width.max(lens.height)));
    let face = |(name, axes): (_, [DVec3; 3])| {
        let turn = turn(axes);
        let ray = |at: DVec2| (2.0 * at / side - 1.0).extend(1.0);
        let (mut low, mut high, mut seen) = (DVec2::INFINITY, DVec2::NEG_INFINITY, 0);
        for n in 0..LOOKS * LOOKS {
            let cell = DVec2::new(f64::from(n % LOOKS), f64::from(n / LOOKS));
            let at = (cell + 0.5) * side / f64::from(LOOKS);
            if lens.sees(turn.transpose() * ray(at), reach) {
                let half = 0.5 * side / f64::from(LOOKS);
                (low, high, seen) = (low.min(at - half), high.max(at + half), seen + 1);
            }
        }
        let whole = seen == LOOKS * LOOKS;
        let (low, high) = (low.floor(), high.ceil().min(DVec2::splat(side)));
        let size = (high - low).to_array().map(|v| v as u32);
        let principal = 0.5 * side - low;
        let enough = f64::from(seen) >= LEAST * f64::from(LOOKS * LOOKS);
        enough.then_some(Cut { name, turn, size, focal: 0.5 * side, principal, reach, masked: !whole })
    };
    let mut cuts: Vec<Cut> = CUBE.into_iter().filter_map(face).collect();
    let masked = cuts.iter().any(|cut| cut.masked);
    for cut in &mut cuts {
        cut.masked = masked;
    }
    cuts
}

/// The rotation from the axes of a photo to a face's.
pub fn turn(axes: [DVec3; 3]) -> DMat3 {
    DMat3::from_cols(axes[0], axes[1], axes[2]).transpose()
}

/// The angle in radians from its axis to which a lens is drawn, if it sees more than a pinhole can show: twice the field of an
/// undistorted lens. Beyond a right angle, a fisheye sees as far as the nearest side of its photo: the corners around a
/// circle are black. Nothing counts from where the distortion folds: no ray arrives at the sides around a circle that lies
/// within the photo, of which a right angle is taken.
fn reach(lens: &Lens) -> Option<f64> {
    if lens.model == LensModel::Equirectangular {
        return Some(PI);
    }
    if lens.distortion.curve == Curve::Straight {
        return None;
    }
    let size = DVec2::new(f64::from(lens.width), f64::from(lens.height));
    let most = (WIDEST * 0.5 * size / lens.focal).to_array().map(f64::atan);
    let middle = |axis: usize, last: bool| {
        let mut pixel = 0.5 * size;
        pixel[axis] = if last { size[axis] - 0.5 } else { 0.5 };
        (axis, lens.angle_at(pixel))
    };
    let sides = [middle(0, false), middle(0, true), middle(1, false), middle(1, true)];
    let unfolded = lens.unfolded();
    if !sides.iter().any(|(axis, angle)| angle.unwrap_or(unfolded) > most[*axis]) {
        return None;
    }
    let nearest = sides.iter().filter_map(|(_, angle)| *angle).reduce(f64::min);
    Some(nearest.unwrap_or_default().max(FRAC_PI_2).min(unfolded))
}

/// The name of a face of a photo: `a/b.front.jpg` of `a/b.jpg`.
pub(super) fn name(photo: &str, face: &str) -> String {
    let file = photo.rfind('/').map_or(0, |at| at + 1);
    match photo[file..].rfind('.').filter(|at| *at > 0) {
        Some(dot) => format!("{}.{face}{}", &photo[..file + dot], &photo[file + dot..]),
        None => format!("{photo}.{face}"),
    }
}

impl Face {
    /// True if the face is masked along `ray` (in the face's camera coordinates, of any length).
    pub(super) fn hides(&self, lens: &Lens, ray: DVec3) -> bool {
        let ray = self.turn.transpose() * ray;
        ray.angle_between(DVec3::Y) < self.pole || !lens.sees(ray, self.reach)
    }
}

impl Scene {
    /// The view to show first instead of view `n`: the front of its photo, if that is cut into faces and has one.
    pub fn ahead(&self, n: usize) -> usize {
        let photo = self.views.get(n).and_then(|view| view.face.as_ref()).map(|face| &face.photo);
        let is_front = |face: &Face| Some(&face.photo) == photo && face.turn == DMat3::IDENTITY;
        self.views.iter().position(|view| view.face.as_ref().is_some_and(is_front)).unwrap_or(n)
    }
}

impl Lens {
    /// True if its photos are cut into faces, because it sees more than a pinhole can show.
    pub fn is_cut(&self) -> bool {
        !of(self).is_empty()
    }

    /// True if the photo shows a ray from the camera that is within `reach` (radians) of the axis.
    fn sees(&self, ray: DVec3, reach: f64) -> bool {
        let pixel = self.pixel_of(ray);
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        // A panorama wraps around: its left and right edges are no limits.
        let slack = 1e-9 * size.x;
        ray.angle_between(DVec3::Z) <= reach
            && pixel.cmpge(DVec2::splat(-slack)).all()
            && pixel.cmple(size + slack).all()
    }
}
