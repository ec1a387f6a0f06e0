//! Input of the detectors: the scene, and small copies of its training photos.

use super::Effect;
use crate::scene::camera::Camera;
use crate::scene::{AlphaRole, Photo, Scene, View};
use glam::{DVec2, DVec3};
use std::io;

/// Greatest width of a thumbnail in pixels.
pub const THUMBNAIL_WIDTH: u32 = 480;
/// Smallest fourth byte of a pixel whose colour is used.
pub(super) const OPAQUE: u8 = 250;

/// A scene and the photos that are trained on.
pub struct TrainingSet<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Indices of the training views.
    pub train: &'a [usize],
    /// Their photos, in the same order.
    pub photos: &'a [Thumbnail],
    /// The depth maps among them.
    pub depths: DepthEvidence,
    /// Background colour of the pictures.
    pub background: [f32; 3],
    /// Size of the pictures trained on as a share of the photos' on disk.
    pub scale: f64,
    /// Length of the run.
    pub iterations: u32,
}

impl<'a> TrainingSet<'a> {
    /// The training views.
    pub fn views(&self) -> impl Iterator<Item = &'a View> + use<'a> {
        let views = &self.scene.views;
        self.train.iter().map(|i| &views[*i])
    }
}

/// Evidence on the depth maps of a scene's photos.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthEvidence {
    /// Photos with a map that can be used.
    pub maps: usize,
    /// The source of `deviation`.
    pub by: DepthWitness,
    /// Median deviation from the maps, as a share of the depth, after their scales were found; none if too little lies in them.
    pub deviation: Option<f64>,
}

/// Reference that depth maps are compared with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthWitness {
    /// The scene's points.
    #[default]
    Points,
    /// Other depth maps.
    Maps,
}

/// A photo reduced in size: undistorted, with the camera of that size.
pub struct Thumbnail {
    /// Its camera.
    pub camera: Camera,
    /// Width x height x RGBA, 8 bits each, colours not multiplied by the fourth byte.
    pub pixels: Vec<u8>,
    /// Meaning of the fourth byte of each pixel.
    pub alpha_role: AlphaRole,
}

impl TrainingSet<'_> {
    /// True if the photos have what an effect needs: nothing can be simulated without it.
    pub(super) fn has_input(&self, effect: Effect) -> bool {
        match effect {
            Effect::Depth => self.depths.maps > 0,
            Effect::Masks => self.views().any(View::is_masked),
            Effect::Distortion => self.views().any(|view| view.face.is_some() || view.lens.max_displacement() > 0.0),
            _ => true,
        }
    }
}

impl Thumbnail {
    /// Averages squares of a photo's pixels, so that the width is at most [`THUMBNAIL_WIDTH`].
    pub fn of(photo: &Photo) -> io::Result<Self> {
        let bytes = photo.pixels.read()?;
        let (w, h) = (photo.camera.width, photo.camera.height);
        let side = w.div_ceil(THUMBNAIL_WIDTH).max(1);
        let (width, height) = (w.div_ceil(side), h.div_ceil(side));
        let mut pixels = Vec::with_capacity(4 * width as usize * height as usize);
        for y in 0..height {
            for x in 0..width {
                let (rows, columns) = (y * side..((y + 1) * side).min(h), x * side..((x + 1) * side).min(w));
                let mut sum = [0_u32; 4];
                for row in rows.clone() {
                    for column in columns.clone() {
                        let at = 4 * (row as usize * w as usize + column as usize);
                        for (s, b) in sum.iter_mut().zip(&bytes[at..at + 4]) {
                            *s += u32::from(*b);
                        }
                    }
                }
                let n = (rows.len() * columns.len()).max(1) as u32;
                pixels.extend(sum.map(|s| ((s + n / 2) / n) as u8));
            }
        }
        // Squares at the edge may be cut off: the scale is that of whole ones.
        let scale = f64::from(side);
        let Camera { focal, principal, .. } = photo.camera;
        let camera =
            Camera { focal: focal / scale, principal: principal / scale, width, height, ..photo.camera.clone() };
        Ok(Self { camera, pixels, alpha_role: photo.alpha_role })
    }

    /// The colour at a world point, and the range of brightness around it: those at its place in the picture.
    pub(super) fn colour_of(&self, position: DVec3) -> Option<(DVec3, f64)> {
        let p = self.camera.rotation * position + self.camera.translation;
        if p.z > 0.0 { self.colour_at(self.camera.project(p)) } else { None }
    }

    /// The colour at a place in pixels, interpolated between the four nearest pixels, and the range of brightness of the
    /// nearest sixteen; `None` near the photo's edge or if one of them is not opaque.
    pub(super) fn colour_at(&self, place: DVec2) -> Option<(DVec3, f64)> {
        let at = place - 0.5;
        let (w, h) = (self.camera.width as usize, self.camera.height as usize);
        let inside = at.cmpge(DVec2::ONE).all() && at.x < w as f64 - 2.0 && at.y < h as f64 - 2.0;
        if !inside {
            return None;
        }
        let (x, y, part) = (at.x as usize, at.y as usize, at.fract());
        let (mut sum, mut low, mut high) = (DVec3::ZERO, f64::INFINITY, f64::NEG_INFINITY);
        for (dx, dy) in (0..4).flat_map(|dy| (0..4).map(move |dx| (dx, dy))) {
            let pixel = self.pixels.get(4 * ((y + dy - 1) * w + x + dx - 1)..)?.first_chunk::<4>()?;
            if pixel[3] < OPAQUE {
                return None;
            }
            let colour = DVec3::from([pixel[0], pixel[1], pixel[2]].map(|c| f64::from(c) / 255.0));
            let bright = colour.element_sum() / 3.0;
            (low, high) = (low.min(bright), high.max(bright));
            let share = |k: usize, f: f64| match k {
                1 => 1.0 - f,
                2 => f,
                _ => 0.0,
            };
            sum += colour * share(dx, part.x) * share(dy, part.y);
        }
        Some((sum, high - low))
    }
}
