//! A photo for training and evaluation: its camera, its pixels, and the meaning of their fourth byte.

use std::io;

use glam::DVec3;

use super::camera::Camera;
use super::pixels::Pixels;

/// Meaning of the fourth byte of a photo's pixels; the same for all photos of a capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum FourthByte {
    /// None: the byte is 255 throughout.
    #[default]
    Opaque,
    /// Opacity over the background.
    Alpha,
    /// Share of the pixel that counts; a mask hides the rest.
    Mask,
}

impl FourthByte {
    /// The meaning that kernels must handle for these photos together: mask if any has one, else alpha, else none.
    pub fn of<'a>(photos: impl IntoIterator<Item = &'a Photo>) -> Self {
        photos.into_iter().map(|photo| photo.fourth_byte).max().unwrap_or_default()
    }

    /// True if this byte can let the background show through: as opacity, or where a mask hides the photo.
    pub fn shows_background(self) -> bool {
        self != Self::Opaque
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
    pub fourth_byte: FourthByte,
}

impl Photo {
    /// A photo without transparent or masked parts.
    pub fn opaque(camera: Camera, pixels: impl Into<Pixels>) -> Self {
        Self { camera, pixels: pixels.into(), fourth_byte: FourthByte::Opaque }
    }

    /// Colour of a pixel in [0, 1], over black.
    ///
    /// # Errors
    /// If the photo lies in a file that cannot be read.
    pub fn colour(&self, [x, y]: [u32; 2]) -> io::Result<DVec3> {
        let [r, g, b, a] = self.pixels.at(y as usize * self.camera.width as usize + x as usize)?;
        let share = |byte: u8| f64::from(byte) / 255.0;
        Ok(DVec3::new(share(r), share(g), share(b)) * share(a))
    }
}
