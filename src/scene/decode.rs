//! Decoding of photos: packed 8-bit RGBA at the working size, undistorted if the view requires it.
//!
//! Protocol: EXIF orientation is ignored, as COLMAP ignores it (its poses are those of the stored pixels). Photos are
//! reduced by the exact area average of the stored 8-bit values. If a view undistorts, one resampling does both (see
//! [`lens`](super::lens)).

use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::{DynamicImage, ImageDecoder, ImageReader};
use rayon::prelude::*;

use super::camera::Camera;
use super::error::Error;
use super::photo::{AlphaRole, Photo};
use super::pixels::{PhotoFile, Pixels};
use super::resample::{Raster, area_average, undistort};
use super::view::{Resize, View};

/// Options of loading photos.
#[derive(Clone, Copy, Debug)]
pub struct LoadOptions<'a> {
    /// The working size.
    pub resize: Resize,
    /// True to use alpha; otherwise every photo is opaque.
    pub alpha: bool,
    /// True to use masks.
    pub masks: bool,
    /// Memory for the decoded pixels.
    pub memory: PhotoMemory<'a>,
}

impl Default for LoadOptions<'_> {
    /// At full size with alpha and masks, in memory.
    fn default() -> Self {
        Self { resize: Resize::Full, alpha: true, masks: true, memory: PhotoMemory::default() }
    }
}

/// Limit on the host's memory for decoded photos.
#[derive(Clone, Copy, Debug)]
pub struct PhotoMemory<'a> {
    /// Bytes for all photos together; if they need more, all go to a temporary file as they are decoded.
    pub bytes: u64,
    /// Folder of the temporary file.
    pub folder: &'a Path,
}

impl Default for PhotoMemory<'_> {
    /// Without a limit.
    fn default() -> Self {
        Self { bytes: u64::MAX, folder: Path::new("") }
    }
}

/// Decodes the photos of many views in parallel, in the order of the views; a damaged photo fails alone.
///
/// The fourth byte has the same meaning in all photos: a mask if any view has one, unless some photo's header announces
/// alpha, which takes precedence over masks.
///
/// `progress` is called from any thread after each photo, with the number done so far.
///
/// # Errors
/// [`Error::Store`] where the temporary file cannot be written.
pub fn load_photos(
    views: &[&View],
    options: &LoadOptions<'_>,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<Result<Photo, Error>>, Error> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera_at(options.resize)).collect();
    let store = Store::new(&cameras, options.memory)?;
    let masked = options.masks
        && views.iter().any(|view| view.mask.is_some())
        && (!options.alpha || !views.par_iter().any(|view| view.announces_alpha()));
    let done = AtomicUsize::new(0);
    let load = |(at, (view, camera)): (usize, (&&View, Camera))| {
        let decoded = view.decode(options.resize);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        // A damaged photo fails alone; a full disk ends everything.
        Ok(match decoded {
            Ok(decoded) => {
                let (alpha_role, pixels) = decoded.settle(options.alpha, masked);
                Ok(Photo { camera, pixels: store.put(at, pixels)?, alpha_role })
            }
            Err(damaged) => Err(damaged),
        })
    };
    let mut photos: Vec<Result<Photo, Error>> =
        views.par_iter().zip(cameras).enumerate().map(load).collect::<Result<_, Error>>()?;
    let alpha_role = AlphaRole::of(photos.iter().flatten());
    photos.iter_mut().flatten().for_each(|photo| photo.alpha_role = alpha_role);
    Ok(photos)
}

/// Storage of decoded pixels: the host's memory, or a file with a place for every photo.
struct Store<'a> {
    file: Option<PhotoFile>,
    folder: &'a Path,
    /// First byte of each photo in the file.
    starts: Vec<u64>,
}

impl<'a> Store<'a> {
    fn new(cameras: &[Camera], PhotoMemory { bytes, folder }: PhotoMemory<'a>) -> Result<Self, Error> {
        let mut all = 0;
        let mut starts = Vec::with_capacity(cameras.len());
        for camera in cameras {
            starts.push(all);
            all += 4 * camera.pixels();
        }
        if all <= bytes {
            return Ok(Self { file: None, folder, starts });
        }
        tracing::info!("{all} bytes of photos are more than {bytes}: they go to a file in {}", folder.display());
        let file = PhotoFile::new(folder).map_err(|source| Error::store(folder, source))?;
        Ok(Self { file: Some(file), folder, starts })
    }

    fn put(&self, photo: usize, pixels: Vec<u8>) -> Result<Pixels, Error> {
        match &self.file {
            Some(file) => file.put(self.starts[photo], &pixels).map_err(|source| Error::store(self.folder, source)),
            None => Ok(pixels.into()),
        }
    }
}

/// Decoded photo and mask of one view, at the working size.
struct Decoded {
    /// Width x height x RGBA, 8 bits each.
    pixels: Vec<u8>,
    /// True if some pixel of the file is not opaque.
    has_alpha: bool,
    /// The mask, if the view has one: width x height bytes, 255 where the pixel counts, 0 where not, between where
    /// mixed.
    mask: Option<Vec<u8>>,
}

impl Decoded {
    /// The pixels and the meaning of their fourth byte: the mask if `masked` (255 throughout without one); otherwise
    /// alpha if `alpha` is set and some pixel is not opaque; otherwise 255.
    fn settle(self, alpha: bool, masked: bool) -> (AlphaRole, Vec<u8>) {
        let Self { mut pixels, has_alpha, mask } = self;
        let fourth = |pixels: &mut [u8], byte: &dyn Fn(usize) -> u8| {
            pixels.iter_mut().skip(3).step_by(4).enumerate().for_each(|(i, fourth)| *fourth = byte(i));
        };
        if masked {
            fourth(&mut pixels, &|i| mask.as_ref().and_then(|m| m.get(i).copied()).unwrap_or(255));
            return (AlphaRole::Mask, pixels);
        }
        if has_alpha && !alpha {
            fourth(&mut pixels, &|_| 255);
        }
        (if has_alpha && alpha { AlphaRole::Alpha } else { AlphaRole::Opaque }, pixels)
    }
}

impl View {
    /// Loads the view's photo with its alpha or mask, at a working size: that of [`View::camera_at`].
    ///
    /// # Errors
    /// [`Error::Io`] where a file cannot be read; [`Error::Photo`] where it is damaged or does not have the camera's
    /// shape.
    pub fn load_photo(&self, resize: Resize) -> Result<Photo, Error> {
        let mut photos = load_photos(&[self], &LoadOptions { resize, ..LoadOptions::default() }, &|_| ())?;
        photos.remove(0)
    }

    /// True if the photo's header announces an alpha channel.
    pub fn announces_alpha(&self) -> bool {
        let reader = ImageReader::open(&self.image).and_then(ImageReader::with_guessed_format).ok();
        reader.and_then(|r| r.into_decoder().ok()).is_some_and(|d| d.color_type().has_alpha())
    }

    /// Decodes the view's photo and its mask.
    fn decode(&self, resize: Resize) -> Result<Decoded, Error> {
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
        let pixels = self.resample(source, resize, has_alpha).pixels;
        let mask = self.mask.as_deref().map(|path| self.decode_mask(path, resize)).transpose()?;
        Ok(Decoded { pixels, has_alpha, mask })
    }

    fn decode_mask(&self, path: &Path, resize: Resize) -> Result<Vec<u8>, Error> {
        let grey = decode(path)?.into_luma8();
        let mask = Raster::<1> { width: grey.width(), height: grey.height(), pixels: grey.into_raw() };
        if !self.lens.fits(mask.width, mask.height) {
            let what = format!("the mask is {} x {}: not its photo's shape", mask.width, mask.height);
            return Err(Error::photo(path, what));
        }
        Ok(self.resample(mask, resize, false).pixels)
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

/// True if an end marker follows the image data: decoders silently fill missing data with grey.
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
