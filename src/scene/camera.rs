//! Ideal pinhole cameras in the engine's convention: COLMAP's. The camera looks along +z, x right, y down; the centre
//! of pixel (i, j) lies at (i + 0.5, j + 0.5).

use glam::{DMat3, DVec2, DVec3};

/// A pinhole camera: its pose and its intrinsics.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Rotation from world to camera coordinates.
    pub rotation: DMat3,
    /// Translation from world to camera coordinates: `x_camera = rotation * x_world + translation`.
    pub translation: DVec3,
    /// Focal lengths in pixels.
    pub focal: DVec2,
    /// Principal point in pixels, measured from the upper left corner of the whole image.
    pub principal: DVec2,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// The whole image, if this camera takes only a part of it.
    pub whole: Option<Whole>,
}

/// The image that another one is a part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Whole {
    /// Its width and height in pixels.
    pub size: [u32; 2],
    /// Upper left corner of the part in it, in pixels.
    pub corner: [u32; 2],
}

impl Camera {
    /// The camera's centre in world coordinates.
    pub fn centre(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The camera that sees the world moved: turned about the camera's centre by `turn`, an axis times an angle in
    /// radians, then shifted by `shift`; both in world axes and units.
    #[must_use]
    pub fn moved(&self, turn: DVec3, shift: DVec3) -> Self {
        let axis = turn.try_normalize().unwrap_or(DVec3::X);
        let rotation = self.rotation * DMat3::from_axis_angle(axis, turn.length());
        let translation = self.rotation * shift - rotation * self.centre();
        Self { rotation, translation, ..self.clone() }
    }

    /// The same camera in coordinates that are relative to this local origin.
    #[must_use]
    pub fn relative_to(&self, origin: DVec3) -> Self {
        Self { translation: self.translation + self.rotation * origin, ..self.clone() }
    }

    /// A point's depth along the camera's axis, in world units; negative behind the camera.
    pub fn depth(&self, point: DVec3) -> f64 {
        (self.rotation * point + self.translation).z
    }

    /// The place in the picture, in pixels, of what the camera sees at `seen`, in its own axes and at a depth above 0.
    pub fn project(&self, seen: DVec3) -> DVec2 {
        seen.truncate() / seen.z * self.focal + self.principal
    }

    /// The ray through a place in the picture, in the camera's own axes, up to depth 1.
    pub fn ray(&self, place: DVec2) -> DVec3 {
        ((place - self.principal) / self.focal).extend(1.0)
    }

    /// The column and the row of the pixel that shows a point; none if it lies behind the camera or outside of the image.
    pub fn pixel_of(&self, point: DVec3) -> Option<[u32; 2]> {
        let p = self.rotation * point + self.translation;
        let at = self.project(p);
        let shown =
            p.z > 0.0 && at.min_element() >= 0.0 && at.x < f64::from(self.width) && at.y < f64::from(self.height);
        shown.then_some([at.x as u32, at.y as u32])
    }

    /// True if a point lies before the camera and within the image.
    pub fn shows(&self, point: DVec3) -> bool {
        self.pixel_of(point).is_some()
    }

    /// Number of the image's pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// The whole image that this camera's is a part of; that is itself, from corner 0, unless it was made by [`Camera::part`].
    pub fn whole(&self) -> Whole {
        self.whole.unwrap_or(Whole { size: [self.width, self.height], corner: [0, 0] })
    }

    /// The share of the whole image's pixels that this one has, 0..=1.
    pub fn share(&self) -> f64 {
        let [width, height] = self.whole().size;
        self.pixels() as f64 / (f64::from(width) * f64::from(height))
    }

    /// The camera of a part of this one's image, `size` pixels from `corner` on. It renders the pixels of the whole image, bit
    /// for bit, if `corner` is a multiple of the tile's side.
    ///
    /// # Panics
    /// If the part is not within the image.
    #[must_use]
    pub fn part(&self, corner: [u32; 2], size: [u32; 2]) -> Self {
        let inside = corner[0] + size[0] <= self.width && corner[1] + size[1] <= self.height;
        assert!(inside, "{size:?} pixels from {corner:?} are part of {} x {}", self.width, self.height);
        let whole = self.whole();
        let corner = [whole.corner[0] + corner[0], whole.corner[1] + corner[1]];
        Self { width: size[0], height: size[1], whole: Some(Whole { size: whole.size, corner }), ..self.clone() }
    }

    /// The same view at another image size; focal lengths and principal point scale per axis. It is a whole image.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let ratio = DVec2::new(f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        let [x, y] = self.whole().corner.map(f64::from);
        let principal = (self.principal - DVec2::new(x, y)) * ratio;
        Self { focal: self.focal * ratio, principal, width, height, whole: None, ..self.clone() }
    }

    /// A camera at `eye` looking at `target`, principal point centred, with the given vertical field of view (radians).
    ///
    /// `up` is the world direction that points up in the picture; another is used if it is parallel to the view.
    #[must_use]
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, fov_y: f64, width: u32, height: u32) -> Self {
        let forward = direction(target - eye).unwrap_or(DVec3::Z);
        let right = direction(forward.cross(up)).unwrap_or_else(|| forward.any_orthonormal_vector());
        let down = forward.cross(right);
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        let focal = 0.5 * f64::from(height) / (0.5 * fov_y).tan();
        Self {
            rotation,
            translation: -(rotation * eye),
            focal: DVec2::splat(focal),
            principal: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
            width,
            height,
            whole: None,
        }
    }
}

/// The unit vector in the direction of `v`, also if the square of its length over- or underflows; none without a direction.
fn direction(v: DVec3) -> Option<DVec3> {
    if v.length_squared().is_normal() { v.try_normalize() } else { (v / v.abs().max_element()).try_normalize() }
}

/// Largest width and largest height of the cameras' pictures; 1 x 1 without cameras.
pub fn largest<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> [u32; 2] {
    cameras.into_iter().fold([1, 1], |[w, h], c| [w.max(c.width), h.max(c.height)])
}

/// Mean of the cameras' centres, in world units; the origin without cameras.
pub fn mean_centre<'a>(cameras: impl Iterator<Item = &'a Camera>) -> DVec3 {
    let (sum, count) = cameras.fold((DVec3::ZERO, 0), |(sum, n), c| (sum + c.centre(), n + 1));
    sum / f64::from(count.max(1))
}

/// The scene extent of 3DGS: 1.1 times the largest distance of a camera from the mean of all, in world units.
pub fn extent<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone) -> f64 {
    let centre = mean_centre(cameras.clone());
    1.1 * cameras.map(|c| c.centre().distance(centre)).fold(0.0, f64::max)
}
