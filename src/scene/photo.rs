//! A photo for training and evaluation: its camera, its pixels, and the meaning of their fourth byte.

use std::io;
use std::sync::Arc;

use glam::DVec3;

use super::camera::Camera;
use super::pixels::Pixels;

/// Meaning of the fourth byte of a photo's pixels; the same for all photos of a capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum AlphaRole {
    /// No meaning: the byte is 255 throughout.
    #[default]
    Opaque,
    /// Opacity over the background.
    Alpha,
    /// Share of the pixel that counts; a mask hides the rest.
    Mask,
}

impl AlphaRole {
    /// The meaning that kernels must handle for these photos together: mask if any has one, else alpha, else none.
    pub fn of<'a>(photos: impl IntoIterator<Item = &'a Photo>) -> Self {
        photos.into_iter().map(|photo| photo.alpha_role).max().unwrap_or_default()
    }

    /// The background that such photos are usually trained and scored on: white with alpha, as Blender's scenes are, else black.
    pub fn usual_background(self) -> [f32; 3] {
        if self == Self::Alpha { [1.0; 3] } else { [0.0; 3] }
    }

    /// True if this byte can let the background show through: as opacity, or where a mask hides the photo.
    pub fn shows_background(self) -> bool {
        self != Self::Opaque
    }
}

/// Depths measured in a photo. A part of a photo has the whole one's.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Pixels per row; fewer than the photo has, maybe.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Width x height, from the top: along the axis of the photo's ideal camera; 0 where there is none.
    pub depths: Arc<[f32]>,
    /// Its unit in the world's.
    pub unit: f64,
}

impl DepthMap {
    /// The depth at a pixel in world units, if there is one.
    pub fn at(&self, x: u32, y: u32) -> Option<f64> {
        let depth = self.depths[y as usize * self.width as usize + x as usize];
        (depth > 0.0).then(|| f64::from(depth) * self.unit)
    }

    /// Bytes of its depths.
    pub fn bytes(&self) -> u64 {
        size_of_val(&*self.depths) as u64
    }
}

/// A photo at the working size.
#[derive(Clone, Debug)]
pub struct Photo {
    /// The ideal camera that took it, of the photo's size.
    pub camera: Camera,
    /// Width x height x RGBA, 8 bits each, rows from the top; colours are not multiplied by the fourth byte.
    pub pixels: Pixels,
    /// Meaning of the fourth byte of each pixel.
    pub alpha_role: AlphaRole,
    /// The depths measured in it, if any were.
    pub depth: Option<DepthMap>,
}

impl Photo {
    /// A photo without transparent or masked parts.
    pub fn opaque(camera: Camera, pixels: impl Into<Pixels>) -> Self {
        Self { camera, pixels: pixels.into(), alpha_role: AlphaRole::Opaque, depth: None }
    }

    /// The part of `size` pixels from `corner` on, in memory. In training it counts as much as it does within the whole photo: see
    /// [`Camera::share`].
    ///
    /// # Panics
    /// If the part is not within the photo.
    pub fn part(&self, corner: [u32; 2], size: [u32; 2]) -> io::Result<Self> {
        let camera = self.camera.part(corner, size);
        let [x, y, width, height] = [corner[0], corner[1], size[0], size[1]].map(|n| n as usize);
        let (row, pixels) = (4 * self.camera.width as usize, self.pixels.read()?);
        let rows = pixels.chunks_exact(row.max(1)).skip(y).take(height);
        let part: Vec<u8> = rows.flat_map(|row| &row[4 * x..4 * (x + width)]).copied().collect();
        Ok(Self { camera, pixels: part.into(), alpha_role: self.alpha_role, depth: self.depth.clone() })
    }

    /// Colour of a pixel in [0, 1], over black.
    pub fn colour(&self, [x, y]: [u32; 2]) -> io::Result<DVec3> {
        let [r, g, b, a] = self.pixels.at(y as usize * self.camera.width as usize + x as usize)?;
        let share = |byte: u8| f64::from(byte) / 255.0;
        Ok(DVec3::new(share(r), share(g), share(b)) * share(a))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::PhotoFile;
    use crate::scene::camera::Whole;

    #[test]
    fn parts_have_the_photos_pixels_and_know_the_whole() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, 7, 5);
        let bytes: Vec<u8> = (0..7 * 5 * 4).collect();
        let folder = tempfile::tempdir().unwrap();
        let filed = PhotoFile::new(folder.path()).unwrap().put(0, &bytes).unwrap();
        for pixels in [Pixels::from(bytes.clone()), filed] {
            let photo = Photo { camera: camera.clone(), pixels, alpha_role: AlphaRole::Mask, depth: None };
            let part = photo.part([2, 1], [4, 3]).unwrap();
            assert_eq!((part.camera.width, part.camera.height, part.alpha_role), (4, 3, AlphaRole::Mask));
            assert_eq!(part.camera.whole(), Whole { size: [7, 5], corner: [2, 1] });
            assert_eq!(part.camera.share(), 12.0 / 35.0);
            for (x, y) in [(0, 0), (3, 0), (1, 2), (3, 2)] {
                assert_eq!(part.pixels.at(y * 4 + x).unwrap(), photo.pixels.at((y + 1) * 7 + x + 2).unwrap());
            }
            assert_eq!(part.pixels.len(), 4 * 12);
            // A part of a part is a part of the whole.
            let inner = part.part([1, 1], [2, 2]).unwrap();
            assert_eq!(inner.camera.whole(), Whole { size: [7, 5], corner: [3, 2] });
            assert_eq!(inner.pixels.at(3).unwrap(), photo.pixels.at(3 * 7 + 4).unwrap());
            assert_eq!(photo.part([0, 0], [7, 5]).unwrap().camera.share(), 1.0);
        }
    }
}
