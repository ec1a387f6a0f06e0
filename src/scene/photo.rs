//! Photos as the trainer takes them: packed 8-bit RGBA at the working size, undistorted where the view calls for it.
//!
//! Protocol: EXIF orientation is ignored, as COLMAP ignores it (its poses are those of the stored pixels). Reduction is
//! the exact area average in the stored 8-bit values. A view that undistorts is resampled once, for both purposes (see
//! [`lens`](super::lens)).

use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::{DynamicImage, ImageDecoder, ImageReader};
use rayon::prelude::*;

use super::resample::{Raster, area_average, undistort};
use super::{Error, Resize, View};

/// A decoded photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Width x height x RGBA, 8 bits each, rows from the top; colours are not multiplied by alpha.
    pub pixels: Vec<u8>,
    /// Whether any pixel is not opaque.
    pub has_alpha: bool,
    /// Where the view has a mask: width x height bytes, 255 where the pixel counts, 0 where not, between where mixed.
    pub mask: Option<Vec<u8>>,
}

impl View {
    /// Decodes the view's photo, and its mask, at a working size: the size of [`View::camera_at`].
    ///
    /// # Errors
    /// [`Error::Io`] where a file cannot be read; [`Error::Photo`] where it is damaged or not of the camera's shape.
    pub fn load_photo(&self, resize: Resize) -> Result<Photo, Error> {
        let decoded = decode(&self.image)?;
        let (width, height) = (decoded.width(), decoded.height());
        if !self.lens.fits(width, height) {
            return Err(Error::photo(
                &self.image,
                format!(
                    "it is {width} x {height}, its camera {} x {}: another shape. EXIF rotation is ignored, as COLMAP \
                     does; store the photo as the camera saw it",
                    self.lens.width, self.lens.height
                ),
            ));
        }
        let transparent = decoded.color().has_alpha();
        let pixels = decoded.into_rgba8().into_raw();
        let source = Raster::<4> { width, height, pixels };
        let has_alpha = transparent && source.pixels.iter().skip(3).step_by(4).any(|&a| a < 255);
        let Raster { width, height, pixels } = self.resample(source, resize, has_alpha);
        let mask = match &self.mask {
            Some(path) => {
                let grey = decode(path)?.into_luma8();
                let mask = Raster::<1> { width: grey.width(), height: grey.height(), pixels: grey.into_raw() };
                if !self.lens.fits(mask.width, mask.height) {
                    let what = format!("the mask is {} x {}: not its photo's shape", mask.width, mask.height);
                    return Err(Error::photo(path, what));
                }
                Some(self.resample(mask, resize, false).pixels)
            }
            None => None,
        };
        Ok(Photo { width, height, pixels, has_alpha, mask })
    }

    /// Whether the photo's header announces an alpha channel.
    pub fn announces_alpha(&self) -> bool {
        let reader = ImageReader::open(&self.image).and_then(ImageReader::with_guessed_format).ok();
        reader.and_then(|r| r.into_decoder().ok()).is_some_and(|d| d.color_type().has_alpha())
    }

    fn resample<const C: usize>(&self, source: Raster<C>, resize: Resize, alpha: bool) -> Raster<C> {
        let camera = self.camera_at(resize);
        if self.undistorts() {
            undistort(&source, &self.lens.resized(source.width, source.height), &camera, alpha)
        } else if (source.width, source.height) == (camera.width, camera.height) {
            source
        } else {
            area_average(&source, camera.width, camera.height, alpha)
        }
    }
}

impl Photo {
    /// Puts the mask into the fourth byte, which then says how much of a pixel counts; all of it without a mask.
    pub fn fold_mask(&mut self) {
        let mask = self.mask.take();
        for (i, pixel) in self.pixels.chunks_exact_mut(4).enumerate() {
            pixel[3] = mask.as_ref().and_then(|m| m.get(i).copied()).unwrap_or(255);
        }
    }
}

/// Loads the photos of many views in parallel, in their order; a damaged photo fails alone.
///
/// `progress` is called with the number done so far after each photo, from any thread.
pub fn load_photos(views: &[&View], resize: Resize, progress: &(dyn Fn(usize) + Sync)) -> Vec<Result<Photo, Error>> {
    let done = AtomicUsize::new(0);
    views
        .par_iter()
        .map(|view| {
            let photo = view.load_photo(resize);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            photo
        })
        .collect()
}

fn decode(path: &Path) -> Result<DynamicImage, Error> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    if bytes.starts_with(&[0xff, 0xd8]) && !jpeg_ends(&bytes) {
        return Err(Error::photo(path, "the JPEG is cut short (no end marker); copy it again"));
    }
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| Error::io(path, e))?;
    let decoded = reader.decode().map_err(|e| Error::photo(path, format!("cannot be decoded: {e}; copy it again")))?;
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(Error::photo(path, "has no pixels"));
    }
    Ok(decoded)
}

/// Whether an end marker follows the image data: decoders fill what is missing with grey and say nothing.
///
/// Entropy-coded data never hold the marker's bytes; embedded previews lie in segments before them, which are skipped.
fn jpeg_ends(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = bytes.get(at..at + 4) {
        match marker {
            0xda => return bytes[at + 4..].windows(2).any(|w| w == [0xff, 0xd9]),
            0xff => at += 1,
            _ => at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2),
        }
    }
    false
}
