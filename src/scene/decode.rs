//! Decoding of photos: packed 8-bit RGBA at the working size, undistorted if the view requires it.
//!
//! Protocol: EXIF orientation is ignored, as COLMAP ignores it (its poses are those of the stored pixels). Photos are
//! reduced by the exact area average of the stored 8-bit values. If a view undistorts, one resampling does both (see
//! [`lens`](super::lens)).

use std::path::Path;
use std::sync::Mutex;

use glam::DVec2;
use image::ColorType;
use rayon::prelude::*;

use super::camera::Camera;
use super::error::Error;
use super::image_file::{color_type, counting, decode, hides_where_white, to_bytes};
use super::loaded::{Loaded, LoadedPhotos, choices, notes, unused_alpha, without_alpha};
use super::photo::{AlphaRole, Photo};
use super::pixels::{PhotoFile, Pixels};
use super::resample::{MASKED, Raster, area_average, cut, undistort};
use super::view::{Resize, View};
use crate::lock::lock;

/// Options of loading photos.
#[derive(Clone, Copy, Debug)]
pub struct LoadOptions<'a> {
    /// The working size.
    pub resize: Resize,
    /// True to use alpha, however little there is, false to take every photo as opaque; if not given, the photos decide.
    pub alpha: Option<bool>,
    /// True to use masks.
    pub masks: bool,
    /// Memory for the decoded pixels.
    pub memory: PhotoMemory<'a>,
}

impl Default for LoadOptions<'_> {
    /// At full size with alpha and masks, in memory.
    fn default() -> Self {
        Self { resize: Resize::Full, alpha: None, masks: true, memory: PhotoMemory::default() }
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

/// Transparency of all pixels together, from 0 (none) to 1, below which alpha does not count: photos that something once
/// saved with an alpha channel have a few such pixels, and all of 254 of 255 is 0.4 %.
pub const ALPHA_SHARE: f64 = 0.005;

/// Share of transparency from which on nothing would be visible; alpha is then ignored, too.
pub(super) const NOTHING: f64 = 0.9999;

/// Decodes the photos of many views in parallel.
///
/// The fourth byte has the same meaning in all photos: alpha if more than [`ALPHA_SHARE`] of all pixels is transparent;
/// otherwise a mask if any view has one. Where faces of a photo hide parts of themselves, it is a mask unless alpha is requested, and
/// hides what is transparent in such a photo: what a lens or a stitcher does not show. A mask that cannot be used hides nothing.
///
/// `progress` is called after each photo with the number done so far, from any thread, but never by two at
/// once, so that the numbers rise.
pub fn load_photos(
    views: &[&View],
    options: &LoadOptions<'_>,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<LoadedPhotos, Error> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera_at(options.resize)).collect();
    let store = Store::new(&cameras, options.memory)?;
    let has_masks = options.masks && views.iter().any(|view| view.is_masked());
    let announced = announced(views, options);
    let masked = has_masks && (!announced || masks_by_alpha(views, options));
    let done = Mutex::new(0);
    // A damaged photo fails alone; a full disk ends everything.
    let load_one = |at: usize, source: Result<&mut Source, Error>| {
        let whole = views[at].face.is_none();
        let even = source.as_ref().is_ok_and(|source| source.even && whole);
        let decoded = source.map(|source| source.view(views[at], options.resize, masked));
        count(&done, progress);
        Ok(match decoded {
            Ok(decoded) => {
                let unused = masked && announced && decoded.transparent > 0.0 && !views[at].hides_itself();
                let transparent = if unused { 0.0 } else { decoded.transparent };
                let hides_all = |mask: &[u8]| mask.iter().all(|byte| *byte == 0);
                let hidden = masked && whole && decoded.mask.as_deref().is_some_and(hides_all);
                let no_mask = decoded.no_mask.clone().filter(|_| masked);
                let (alpha_role, pixels) = decoded.settle(announced, masked);
                let camera = cameras[at].clone();
                let photo = Ok(Photo { camera, pixels: store.put(at, pixels)?, alpha_role, depth: None });
                Loaded { photo, transparent, unused, no_mask, hidden, even }
            }
            Err(damaged) => Loaded::damaged(damaged),
        })
    };
    // A photo that was cut is decoded once.
    let groups: Vec<&[&View]> = views.chunk_by(|a, b| a.face.is_some() && a.image == b.image).collect();
    let firsts = groups.iter().scan(0, |next, group| Some(std::mem::replace(next, *next + group.len())));
    let firsts: Vec<usize> = firsts.collect();
    let loaded: Vec<Loaded> = groups
        .par_iter()
        .zip(firsts)
        .flat_map_iter(|(group, first)| {
            let mut source = group[0].decode();
            let rest = |error: &Error| match error {
                Error::Unread { path, .. } => Error::unread(path, "is not read"),
                _ => Error::photo(&group[0].image, "cannot be used"),
            };
            let mut each = |at: usize| {
                // The first view has the reason.
                load_one(at, source.as_mut().map_err(|error| std::mem::replace(error, rest(error))))
            };
            let of_group: Vec<_> = (first..first + group.len()).map(&mut each).collect();
            of_group
        })
        .collect::<Result<_, Error>>()?;
    let pixels: f64 = loaded.iter().map(Loaded::pixels).sum();
    let share = loaded.iter().map(|one| one.transparent).sum::<f64>() / pixels.max(1.0);
    if options.alpha.is_none()
        && announced
        && !masked
        && (share > NOTHING || share < ALPHA_SHARE && (share > 0.0 || has_masks))
    {
        drop((loaded, store));
        let mut again = load_photos(views, &LoadOptions { alpha: Some(false), ..*options }, progress)?;
        let told = if share > NOTHING { &mut again.notes } else { &mut again.choices };
        told.extend(without_alpha(share));
        return Ok(again);
    }
    let without_mask = (0..loaded.len()).filter(|at| loaded[*at].no_mask.is_some()).collect();
    // Only the message of the first mask at fault is shown.
    let no_mask = loaded.iter().find_map(|one| one.no_mask.clone());
    let number = |is: fn(&Loaded) -> bool| loaded.iter().filter(|one| is(one)).count();
    let (hidden, even, unused) = (number(|one| one.hidden), number(|one| one.even), number(|one| one.unused));
    let blank = number(|one| one.photo.is_ok() && one.transparent >= one.pixels());
    let mut photos: Vec<_> = loaded.into_iter().map(|one| one.photo).collect();
    let alpha_role = AlphaRole::of(photos.iter().flatten());
    photos.iter_mut().flatten().for_each(|photo| photo.alpha_role = alpha_role);
    let counts = alpha_role == AlphaRole::Alpha || announced && masked && share > 0.0;
    let share = Some((share, masked)).filter(|_| counts && options.alpha.is_none());
    let mut notes = notes(has_masks && !masked, hidden, share.map_or(0, |_| blank));
    notes.extend(unused_alpha(unused));
    notes.extend(no_mask);
    Ok(LoadedPhotos { photos, notes, choices: choices(even, share), without_mask })
}

/// Tells that one photo more is done.
fn count(done: &Mutex<usize>, progress: &(dyn Fn(usize) + Sync)) {
    let mut done = lock(done);
    *done += 1;
    progress(*done);
}

/// True if a photo has an alpha channel that may count.
fn announced(views: &[&View], options: &LoadOptions<'_>) -> bool {
    options.alpha != Some(false) && views.par_iter().any(|view| view.announces_alpha())
}

/// True if transparent pixels are masked, as faces of a photo hide parts of themselves.
fn masks_by_alpha(views: &[&View], options: &LoadOptions<'_>) -> bool {
    options.masks && options.alpha != Some(true) && views.iter().any(|view| view.hides_itself())
}

/// Meaning of the fourth byte of many views' photos together, as [`load_photos`] decides; decodes them only if one has an alpha channel.
///
/// # Errors
/// [`Error::Store`] where the temporary file cannot be written.
pub fn alpha_role(views: &[&View], options: &LoadOptions<'_>) -> Result<AlphaRole, Error> {
    if masks_by_alpha(views, options) || !announced(views, options) {
        let masked = options.masks && views.iter().any(|view| view.is_masked());
        return Ok(if masked { AlphaRole::Mask } else { AlphaRole::Opaque });
    }
    let loaded = load_photos(views, options, &|_| ())?;
    Ok(AlphaRole::of(loaded.photos.iter().flatten()))
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
    /// Sum of the pixels' transparencies, each from 0 (opaque) to 1.
    transparent: f64,
    /// Width x height bytes, 255 where the pixel counts, 0 where not, between where mixed; none without a mask.
    mask: Option<Vec<u8>>,
    /// The fault of a file of a mask that cannot be used.
    no_mask: Option<String>,
    /// True if alpha is a part of the mask.
    by_alpha: bool,
}

impl Decoded {
    /// The pixels and the meaning of their fourth byte: the mask if `masked` (255 throughout without one); otherwise
    /// alpha if `alpha` is set and some pixel is not opaque; otherwise 255.
    fn settle(self, alpha: bool, masked: bool) -> (AlphaRole, Vec<u8>) {
        let Self { mut pixels, transparent, mask, by_alpha, .. } = self;
        let has_alpha = transparent > 0.0;
        if masked {
            let mask = mask.unwrap_or_default();
            for (i, pixel) in pixels.as_chunks_mut::<4>().0.iter_mut().enumerate() {
                let byte = mask.get(i).copied().unwrap_or(255);
                pixel[3] = if by_alpha { byte.min(pixel[3]) } else { byte };
            }
            return (AlphaRole::Mask, pixels);
        }
        if has_alpha && !alpha {
            pixels.iter_mut().skip(3).step_by(4).for_each(|fourth| *fourth = 255);
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
        let mut loaded = load_photos(&[self], &LoadOptions { resize, ..LoadOptions::default() }, &|_| ())?;
        loaded.photos.remove(0)
    }

    /// True if the photo's header announces an alpha channel.
    pub fn announces_alpha(&self) -> bool {
        color_type(&self.image).is_some_and(ColorType::has_alpha)
    }

    /// Decodes the view's photo and its mask.
    fn decode(&self) -> Result<Source, Error> {
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
        let mut pixels = to_bytes(decoded).into_raw();
        let first = pixels.get(3).copied().unwrap_or(255);
        // One alpha throughout says nothing of what is transparent, unless that is all of the photo, which no mask should hide.
        let says_nothing = (1..255).contains(&first) || first == 0 && self.hides_itself();
        let even = transparent && says_nothing && pixels.iter().skip(3).step_by(4).all(|a| *a == first);
        if even {
            pixels.iter_mut().skip(3).step_by(4).for_each(|a| *a = 255);
        }
        let alpha = transparent && pixels.iter().skip(3).step_by(4).any(|&a| a < 255);
        let (mask, no_mask) = match self.mask.as_deref().map(|path| self.decode_mask(path)).transpose() {
            Ok(mask) => (mask, None),
            // Masks are decoded as photos are, whose errors name a photo.
            Err(Error::Photo { path, what } | Error::Unread { path, what }) => {
                (None, Some(format!("mask {} {what}", path.display())))
            }
            Err(other) => (None, Some(other.to_string())),
        };
        let around = || self.circle.map(|_| Raster::<1> { width, height, pixels: vec![255; pixels.len() / 4] });
        let mut mask = mask.or_else(around);
        if let Some(mask) = &mut mask {
            self.hide_around(mask);
        }
        Ok(Source { photo: Raster { width, height, pixels }, alpha, even, mask, no_mask, both: None })
    }

    /// Hides in a mask of the photo what lies around the circle that it shows, if the data set says it.
    fn hide_around(&self, mask: &mut Raster<1>) {
        let Some(share) = self.circle else { return };
        let (lens, radius) = (self.lens.resized(mask.width, mask.height), share * f64::from(mask.width));
        for (n, byte) in mask.pixels.iter_mut().enumerate() {
            let pixel = DVec2::new(f64::from(n as u32 % mask.width), f64::from(n as u32 / mask.width)) + 0.5;
            *byte = if pixel.distance(lens.principal) > radius { 0 } else { *byte };
        }
    }

    fn decode_mask(&self, path: &Path) -> Result<Raster<1>, Error> {
        let decoded = decode(path)?;
        let (width, height) = (decoded.width(), decoded.height());
        let mut pixels = counting(decoded);
        if hides_where_white(path) {
            for byte in &mut pixels {
                *byte = 255 - *byte;
            }
        }
        let mask = Raster::<1> { width, height, pixels };
        if !self.lens.fits(mask.width, mask.height) {
            let (own, photo) = ([mask.width, mask.height], [self.lens.width, self.lens.height]);
            let what = format!("is {} x {}, its photo {} x {}: another shape", own[0], own[1], photo[0], photo[1]);
            return Err(Error::photo(path, what));
        }
        Ok(mask)
    }

    /// True if the view's pixels are not those of its photo.
    fn resamples(&self, photo: &Raster<4>, resize: Resize) -> bool {
        let camera = self.camera_at(resize);
        self.face.is_some() || self.undistorts() || (photo.width, photo.height) != (camera.width, camera.height)
    }

    /// The part of a photo that the view shows. Pixels that are used as they are leave `source`: no other view shares them.
    fn resample<const C: usize>(&self, source: &mut Raster<C>, resize: Resize, alpha: bool) -> Raster<C> {
        let camera = self.camera_at(resize);
        let lens = self.lens.resized(source.width, source.height);
        if let Some(face) = &self.face {
            cut(source, (&lens, face), &camera, alpha)
        } else if self.undistorts() {
            undistort(source, &lens, &camera, alpha)
        } else if (source.width, source.height) == (camera.width, camera.height) {
            Raster { pixels: std::mem::take(&mut source.pixels), ..*source }
        } else {
            area_average(source, camera.width, camera.height, alpha)
        }
    }

    /// The mask of what its face hides, if that is anything, upon another.
    fn hide(&self, mask: Option<Vec<u8>>, resize: Resize) -> Option<Vec<u8>> {
        let Some(face) = self.face.as_ref().filter(|face| face.masked) else { return mask };
        let camera = self.camera_at(resize);
        let mut mask = mask.unwrap_or_else(|| vec![255; camera.pixels() as usize]);
        for (n, byte) in mask.iter_mut().enumerate() {
            let (x, y) = (n as u32 % camera.width, n as u32 / camera.width);
            let ray = camera.ray(DVec2::new(f64::from(x), f64::from(y)) + 0.5);
            *byte = if face.hides(&self.lens, ray) { 0 } else { *byte };
        }
        Some(mask)
    }
}

/// A decoded photo with its mask, at their own size.
struct Source {
    photo: Raster<4>,
    /// True if a pixel is not opaque.
    alpha: bool,
    /// True if all pixels had the same alpha, which does not count.
    even: bool,
    mask: Option<Raster<1>>,
    /// The fault of a file of a mask that cannot be used.
    no_mask: Option<String>,
    /// The photo with its mask as a fifth channel, once a view needs it.
    both: Option<Raster<MASKED>>,
}

impl Source {
    /// The part that a view shows, with colours weighted by the mask if it counts; see [`View::resample`].
    fn view(&mut self, view: &View, resize: Resize, masked: bool) -> Decoded {
        let pixels = match &self.mask {
            Some(mask) if masked && view.resamples(&self.photo, resize) => {
                let both = self.both.get_or_insert_with(|| self.photo.masked(mask));
                view.resample(both, resize, self.alpha).unmasked().pixels
            }
            _ => view.resample(&mut self.photo, resize, self.alpha).pixels,
        };
        let missing = |pixels: &[u8]| pixels.iter().skip(3).step_by(4).map(|&a| f64::from(255 - a) / 255.0).sum();
        let transparent = if self.alpha { missing(&pixels) } else { 0.0 };
        let listed = self.mask.as_mut().map(|mask| view.resample(mask, resize, false).pixels);
        let no_mask = self.no_mask.clone();
        Decoded { pixels, transparent, mask: view.hide(listed, resize), no_mask, by_alpha: view.hides_itself() }
    }
}
