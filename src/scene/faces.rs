//! Faces: the pinhole views into which a photo is cut that sees more than one pinhole can show, as a panorama does. They are
//! faces of a cube around the camera, which share its place.

use glam::{DMat3, DVec2, DVec3};

use super::lens::{Lens, LensModel};

/// Pixels of a panorama's width by pixels of a face's side.
const WIDTH_BY_SIDE: f64 = 4.0;

/// Names of the faces, in the order of names, with the axes right, down and forward of each in those of the photo.
const CUBE: [(&str, [DVec3; 3]); 6] = [
    ("back", [DVec3::NEG_X, DVec3::Y, DVec3::NEG_Z]),
    ("down", [DVec3::X, DVec3::NEG_Z, DVec3::Y]),
    ("front", [DVec3::X, DVec3::Y, DVec3::Z]),
    ("left", [DVec3::Z, DVec3::Y, DVec3::NEG_X]),
    ("right", [DVec3::NEG_Z, DVec3::Y, DVec3::X]),
    ("up", [DVec3::X, DVec3::Z, DVec3::NEG_Y]),
];

/// A face's place in its photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Face {
    /// The photo's name.
    pub photo: String,
    /// Rotation from the photo's camera coordinates to the face's.
    pub turn: DMat3,
    /// Angle in radians: the photo is masked within it of straight down, where the photographer stands.
    pub pole: f64,
}

/// A face without its photo: its name, its rotation, its side and its focal length in pixels.
pub(super) struct Cut {
    pub name: &'static str,
    pub turn: DMat3,
    pub side: u32,
    pub focal: f64,
}

/// The faces of a lens, in the order of their names; none if one pinhole shows what it sees.
pub(super) fn of(lens: &Lens) -> Vec<Cut> {
    if lens.model != LensModel::Equirectangular {
        return Vec::new();
    }
    let side = (f64::from(lens.width) / WIDTH_BY_SIDE).round().max(1.0);
    let face = |(name, axes): (_, [DVec3; 3])| {
        let turn = DMat3::from_cols(axes[0], axes[1], axes[2]).transpose();
        Cut { name, turn, side: side as u32, focal: 0.5 * side }
    };
    CUBE.map(face).into()
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
    /// True if what the face's camera sees along `ray` (its coordinates, any length) is not trained on.
    pub(super) fn hides(&self, ray: DVec3) -> bool {
        (self.turn.transpose() * ray).angle_between(DVec3::Y) < self.pole
    }
}

impl Lens {
    /// The pixel at which the lens shows a ray from the camera.
    pub(super) fn pixel_of(&self, ray: DVec3) -> DVec2 {
        DVec2::new(ray.x.atan2(ray.z), ray.y.atan2(DVec2::new(ray.x, ray.z).length())) * self.focal + self.principal
    }
}
