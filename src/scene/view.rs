//! One view of a capture: its photo's file, the lens that took it, and the ideal camera that the engine renders.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::{DMat3, DVec2, DVec3};

use super::Error;
use super::camera::Camera;
use super::faces::{self, Cut, Face};
use super::image_size::image_size;
use super::lens::{Lens, Pinhole};
use super::misfit::Misfit;

/// Error message for a lens without an ideal pinhole.
pub(crate) const FOLDED: &str =
    "the lens's distortion folds the image: no part of it can be undistorted; check the calibration";

/// The role that the data set gives to a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Role {
    /// The data set does not say.
    #[default]
    Unsaid,
    /// The view trains the model.
    Train,
    /// The view serves validation while methods are tuned; it is held out if no view is marked for test, otherwise
    /// unused.
    Validation,
    /// The view is held out.
    Test,
}

/// The working size of images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resize {
    /// The photo's own size.
    #[default]
    Full,
    /// At most this many pixels wide, the height in proportion; photos are never enlarged.
    Width(u32),
    /// Width and height divided by this and rounded to nearest, at least one pixel.
    Divide(u32),
}

impl FromStr for Resize {
    type Err = String;

    /// Reads a width such as `800`, or a divisor such as `/4`.
    fn from_str(text: &str) -> Result<Self, String> {
        let number = |t: &str| t.parse::<u32>().ok().filter(|n| *n > 0);
        let read = match text.strip_prefix('/') {
            Some(k) => number(k).map(Self::Divide),
            None => number(text).map(Self::Width),
        };
        read.ok_or_else(|| format!("'{text}' is neither a width in pixels, such as 800, nor a divisor, such as /4"))
    }
}

impl Resize {
    /// The working size of an image of `width` x `height` pixels; zero means [`Resize::Full`].
    pub fn apply(self, width: u32, height: u32) -> (u32, u32) {
        let part = |n: u32, over: u32, of: u32| {
            let (n, over, of) = (u64::from(n), u64::from(over), u64::from(of));
            ((2 * n * over + of) / (2 * of)).max(1) as u32
        };
        match self {
            Self::Width(w) if w > 0 && w < width => (w, part(height, w, width)),
            Self::Divide(k) if k > 1 => (part(width, 1, k), part(height, 1, k)),
            _ => (width, height),
        }
    }
}

/// One view: a camera with its photo, which may be absent.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// The photo's name as the data set writes it, with extension if any, `/` between folders; a face's has the face before the
    /// extension.
    pub name: String,
    /// The photo's file, which may be absent.
    pub image: PathBuf,
    /// The mask's file, if there is one: black pixels are not trained on.
    pub mask: Option<PathBuf>,
    /// Radius of the circle around the principal point that the photo shows, as a share of its width, if the data set says it: the rest
    /// is masked.
    pub circle: Option<f64>,
    /// The depth map's file, if there is one: depths along the photo's axis, or, if the photo is cut into faces, along the rays.
    pub depth: Option<PathBuf>,
    /// The length in world units of a step of the map's numbers, if the data set says it.
    pub depth_step: Option<f64>,
    /// How far points are from where the photo's pose shows them, if that was measured.
    pub misfit: Option<Misfit>,
    /// The lens at the photo's size.
    pub lens: Lens,
    /// The ideal pinhole at the photo's size, which the engine renders: undistorted if [`View::undistorts`].
    pub camera: Camera,
    /// Views with equal numbers were taken by one physical camera (COLMAP's camera id, or counted from 0).
    pub camera_id: u32,
    /// The role that the data set gives to the view.
    pub role: Role,
    /// The part of its photo, if that is cut into several views.
    pub face: Option<Face>,
    /// The photo's real size, if a photo with a legible header was found.
    pub photo_size: Option<(u32, u32)>,
    pub(super) undistorts: bool,
}

/// True for the size of a whole equirectangular panorama, in pixels.
pub(crate) fn is_panorama((width, height): (u32, u32)) -> bool {
    u64::from(width) == 2 * u64::from(height)
}

impl View {
    /// A view at a pose (world to camera), whose photo is not undistorted.
    pub(crate) fn new(name: String, lens: Lens, pose: (DMat3, DVec3)) -> Self {
        let camera = Camera {
            rotation: pose.0,
            translation: pose.1,
            focal: lens.focal,
            principal: lens.principal,
            width: lens.width,
            height: lens.height,
            whole: None,
        };
        Self {
            name,
            image: PathBuf::new(),
            mask: None,
            circle: None,
            depth: None,
            depth_step: None,
            misfit: None,
            lens,
            camera,
            camera_id: 0,
            role: Role::Unsaid,
            face: None,
            photo_size: None,
            undistorts: false,
        }
    }

    /// The view of a face of this one's photo, without what is nearer than `pole` (radians) to straight down in the photo.
    pub(super) fn cut(&self, cut: &Cut, pole: f64) -> Self {
        let camera = Camera {
            rotation: cut.turn * self.camera.rotation,
            translation: cut.turn * self.camera.translation,
            focal: DVec2::splat(cut.focal),
            principal: cut.principal,
            width: cut.size[0],
            height: cut.size[1],
            whole: None,
        };
        let masked = pole > 0.0 || cut.masked;
        let face = Face { photo: self.name.clone(), turn: cut.turn, pole, reach: cut.reach, masked };
        Self { name: faces::name(&self.name, cut.name), camera, face: Some(face), ..self.clone() }
    }

    /// The views of the faces of a panorama without a pose, with the faces' names.
    ///
    /// # Errors
    /// [`Error::Photo`] for a file that is no picture twice as wide as high.
    pub fn of_panorama(photo: &Path, mask: Option<&Path>) -> Result<Vec<(&'static str, Self)>, Error> {
        let (width, height) = image_size(photo).map_err(|e| Error::io(photo, e))?;
        if !is_panorama((width, height)) {
            return Err(Error::photo(photo, format!("is {width} x {height}: a panorama is twice as wide as high")));
        }
        let lens = Lens::panorama(width.into(), height.into()).map_err(|what| Error::photo(photo, what))?;
        let name = photo.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut whole = Self::new(name, lens, (DMat3::IDENTITY, DVec3::ZERO));
        (whole.image, whole.mask) = (photo.to_owned(), mask.map(Path::to_owned));
        Ok(faces::of(&lens).iter().map(|cut| (cut.name, whole.cut(cut, 0.0))).collect())
    }

    /// The name of its photo, which it may share with others.
    pub fn photo_name(&self) -> &str {
        self.face.as_ref().map_or(&self.name, |face| &face.photo)
    }

    /// True if a part of the view may not be trained on: by a mask or a circle, or because the faces of its photo hide parts of
    /// themselves.
    pub fn is_masked(&self) -> bool {
        self.mask.is_some() || self.circle.is_some() || self.hides_itself()
    }

    /// True if it is a face of a photo whose faces hide parts of themselves: around straight down, or beyond a fisheye's rim.
    pub fn hides_itself(&self) -> bool {
        self.face.as_ref().is_some_and(|face| face.masked)
    }

    /// True if the view shows a point that neither the photo's circle nor a face hides, occluded or not; files of masks do not count.
    pub fn shows(&self, point: DVec3) -> bool {
        if !self.camera.shows(point) {
            return false;
        }
        let ray = self.camera.rotation * point + self.camera.translation;
        let hidden = self.face.as_ref().is_some_and(|face| face.masked && face.hides(&self.lens, ray));
        let within = |share: f64| {
            let ray = self.face.as_ref().map_or(ray, |face| face.turn.transpose() * ray);
            self.lens.pixel_of(ray).distance(self.lens.principal) <= share * f64::from(self.lens.width)
        };
        !hidden && self.circle.is_none_or(within)
    }

    /// True if the photo is resampled to one ideal pinhole rather than used as it is or cut into faces.
    pub fn undistorts(&self) -> bool {
        self.undistorts
    }

    /// Sets the lens. The camera gets the lens's size, and the intrinsics of `ideal`, or the lens's if there is none.
    pub(super) fn set_lens(&mut self, lens: Lens, ideal: Option<Pinhole>) {
        let Pinhole { focal, principal } = ideal.unwrap_or(Pinhole { focal: lens.focal, principal: lens.principal });
        self.camera = Camera { focal, principal, width: lens.width, height: lens.height, ..self.camera };
        self.undistorts = ideal.is_some();
        self.lens = lens;
    }

    /// The size of the photo found, if it differs from the lens's because its shape does not fit.
    pub(crate) fn mismatched(&self) -> Option<(u32, u32)> {
        self.photo_size.filter(|&size| size != (self.lens.width, self.lens.height))
    }

    /// The camera that the engine renders at a working size; the photo may be absent.
    #[must_use]
    pub fn camera_at(&self, resize: Resize) -> Camera {
        let (width, height) = resize.apply(self.camera.width, self.camera.height);
        self.camera.resized(width, height)
    }
}
