//! A photo as training and evaluation use it: its camera, its pixels, and what their fourth byte means.

use std::io;

use glam::DVec3;

use super::camera::Camera;
use super::pixels::Pixels;

/// What the fourth byte of a photo's pixels means; all photos of a capture share one meaning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum FourthByte {
    /// Nothing: it is 255 throughout.
    #[default]
    Opaque,
    /// Opacity over the background.
    Alpha,
    /// How much of the pixel counts; the rest is hidden by a mask.
    Mask,
}

impl FourthByte {
    /// The meaning that kernels must allow for over all these photos: masks before alpha before none.
    pub fn of<'a>(photos: impl IntoIterator<Item = &'a Photo>) -> Self {
        photos.into_iter().map(|photo| photo.fourth_byte).max().unwrap_or_default()
    }

    /// Whether the background shows through the photo by this byte: as opacity, or where a mask hides the photo.
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
    /// What the fourth byte of each pixel means.
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
    /// A photo that lies in a file which cannot be read.
    pub fn colour(&self, [x, y]: [u32; 2]) -> io::Result<DVec3> {
        let [r, g, b, a] = self.pixels.at(y as usize * self.camera.width as usize + x as usize)?;
        let share = |byte: u8| f64::from(byte) / 255.0;
        Ok(DVec3::new(share(r), share(g), share(b)) * share(a))
    }
}
