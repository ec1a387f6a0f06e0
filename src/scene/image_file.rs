//! Files of photos and masks, decoded to bytes.

mod tags;

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, RgbaImage};

use super::error::Error;
use super::image_size::{Frame, picture_reader};
use super::jpeg::lacks_data;

/// Decodes a photo or a mask.
///
/// # Errors
/// [`Error::Io`]; [`Error::Photo`] for what is damaged or cut short; [`Error::Unread`] for a format that is not read.
pub(super) fn decode(path: &Path) -> Result<DynamicImage, Error> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    if let Some(format) = unread(&bytes) {
        let name = path.file_name().unwrap_or_default().display();
        let remedy = if format == GZIPPED {
            format!("unpack it by `gzip -dc < {name} > unpacked && mv unpacked {name}`")
        } else {
            format!("convert it, with ImageMagick: `magick mogrify -format jpg -quality 95 {name}`")
        };
        return Err(Error::unread(path, format!("is {format}, which is not read: {remedy}")));
    }
    if bytes.starts_with(LFS_POINTER) {
        return Err(Error::unread(path, IS_LFS_POINTER));
    }
    if bytes.is_empty() {
        return Err(Error::photo(path, "is empty: copy it again"));
    }
    if bytes.trim_ascii_start().starts_with(b"<") {
        return Err(Error::photo(path, "is text, perhaps a web page: download the photo again"));
    }
    let name = path.file_name().unwrap_or_default().display();
    let convert = || format!("convert it, with ImageMagick: `magick mogrify -format png {name}`");
    if let Some(kind) = Frame::of(Cursor::new(&bytes)).and_then(|frame| frame.unread()) {
        return Err(Error::unread(path, format!("is a JPEG {kind}, an encoding that is not read: {}", convert())));
    }
    let reader = picture_reader(Cursor::new(&bytes)).map_err(|e| Error::io(path, e))?;
    let format = reader.format();
    let (is_known, is_exr, is_tiff) =
        (format.is_some(), format == Some(ImageFormat::OpenExr), format == Some(ImageFormat::Tiff));
    let decoded = reader.decode().map_err(|e| {
        if is_known && matches!(e, image::ImageError::Unsupported(_)) {
            return Error::unread(path, format!("is in an encoding that is not read ({e}): {}", convert()));
        }
        if is_exr && e.to_string().contains("rgb channels") {
            let save = "save one layer (in Blender as OpenEXR, not OpenEXR MultiLayer)";
            return Error::unread(path, format!("has no channels R, G and B, perhaps those of several layers: {save}"));
        }
        let told = if is_known { e.to_string() } else { "its format is unknown".to_owned() };
        Error::photo(path, format!("cannot be decoded: {told}; copy it again"))
    })?;
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(Error::photo(path, "has no pixels"));
    }
    if bytes.starts_with(&[0xff, 0xd8]) && lacks_data(&bytes) {
        return Err(Error::photo(path, "is a JPEG that is cut short: a part of its data is missing; copy it again"));
    }
    let is_whole = || tags::first(&bytes, tags::SAMPLE_FORMAT) != Some(tags::FLOATS);
    if is_tiff && matches!(decoded, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) && is_whole() {
        return Err(Error::unread(path, "holds whole numbers of 32 bits: save it with 8 or 16 bits"));
    }
    let is_multiplied = is_exr || is_tiff && tags::first(&bytes, tags::EXTRA_SAMPLES) == Some(tags::MULTIPLIED);
    let decoded = if is_multiplied { straight(decoded) } else { decoded };
    if too_bright(&decoded) {
        let convert = "scale its values to 0 to 1, or save it with 8 or 16 bits";
        return Err(Error::unread(path, format!("holds floats, most of them above 1, which is white: {convert}")));
    }
    Ok(decoded)
}

/// A picture whose colours are not multiplied by alpha, of one whose colours are.
fn straight(mut decoded: DynamicImage) -> DynamicImage {
    match &mut decoded {
        DynamicImage::ImageRgba32F(floats) => {
            for pixel in floats.pixels_mut() {
                let [r, g, b, a] = pixel.0;
                if a > 0.0 && a < 1.0 {
                    pixel.0 = [r / a, g / a, b / a, a];
                }
            }
        }
        DynamicImage::ImageRgba8(picture) => divide(picture, 4),
        DynamicImage::ImageRgba16(picture) => divide(picture, 4),
        DynamicImage::ImageLumaA8(picture) => divide(picture, 2),
        DynamicImage::ImageLumaA16(picture) => divide(picture, 2),
        _ => {}
    }
    decoded
}

/// Divides the colours of pixels, of so many numbers each, by their alpha, which comes last.
fn divide<T: image::Primitive + Into<u32> + TryFrom<u32>>(numbers: &mut [T], channels: usize) {
    let white: u32 = T::DEFAULT_MAX_VALUE.into();
    for pixel in numbers.chunks_exact_mut(channels) {
        let Some((alpha, colours)) = pixel.split_last_mut() else { continue };
        let alpha: u32 = (*alpha).into();
        for colour in colours.iter_mut().filter(|_| alpha > 0) {
            let multiplied: u32 = (*colour).into();
            *colour = T::try_from((multiplied * white + alpha / 2) / alpha).unwrap_or(T::DEFAULT_MAX_VALUE);
        }
    }
}

/// True for floats most of which would be white.
fn too_bright(decoded: &DynamicImage) -> bool {
    let most = |above: usize, all: usize| 2 * above > all;
    match decoded {
        DynamicImage::ImageRgb32F(floats) => most(floats.iter().filter(|v| **v > 1.0).count(), floats.len()),
        DynamicImage::ImageRgba32F(floats) => {
            let colours = floats.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2]]);
            most(colours.filter(|v| *v > 1.0).count(), 3 * floats.len() / 4)
        }
        _ => false,
    }
}

/// A photo in 8 bits a channel, as it is trained on, if it has more; not every program reads those.
#[cfg(feature = "pose")]
pub(crate) fn in_eight_bits(path: &Path) -> Result<Option<DynamicImage>, Error> {
    let is_deep = |kind: &ColorType| kind.bytes_per_pixel() > kind.channel_count();
    let Some(kind) = color_type(path).filter(is_deep) else { return Ok(None) };
    let image = DynamicImage::from(to_bytes(decode(path)?));
    Ok(Some(if kind.has_alpha() { image } else { image.into_rgb8().into() }))
}

/// The first bytes of a Git LFS pointer, which stands for a file.
pub(super) const LFS_POINTER: &[u8] = b"version https://git-lfs";
/// The fault of such a file, and the remedy.
pub(super) const IS_LFS_POINTER: &str = "is a Git LFS pointer, without the file's contents: run `git lfs pull`";

/// The channels that a picture's header announces.
pub(super) fn color_type(path: &Path) -> Option<ColorType> {
    let reader = File::open(path).and_then(|file| picture_reader(BufReader::new(file))).ok()?;
    Some(reader.into_decoder().ok()?.color_type())
}

/// True if a picture's header announces greys alone, with or without alpha; none if it announces nothing.
pub(super) fn is_grey(path: &Path) -> Option<bool> {
    // A JPEG's decoder would read the whole file.
    let jpeg = File::open(path).ok().and_then(Frame::of).map(|frame| frame.channels == 1);
    jpeg.or_else(|| color_type(path).map(|kind| !kind.has_color()))
}

/// True for a TIFF whose header announces floats.
pub(super) fn holds_floats(path: &Path) -> bool {
    std::fs::read(path).is_ok_and(|bytes| tags::first(&bytes, tags::SAMPLE_FORMAT) == Some(tags::FLOATS))
}

/// True for a PNG whose header announces a palette.
pub(super) fn is_indexed(path: &Path) -> bool {
    let mut start = Vec::new();
    let header = File::open(path).and_then(|file| file.take(26).read_to_end(&mut start));
    header.is_ok() && start.starts_with(b"\x89PNG") && start.get(25) == Some(&3)
}

/// True if a photo's header tells a format that is not read, or, of a TIFF or JPEG, an encoding that is not.
pub(super) fn is_unread(path: &Path) -> bool {
    let Ok(mut file) = File::open(path) else { return false };
    let mut start = Vec::new();
    if (&file).take(16).read_to_end(&mut start).is_err() || file.rewind().is_err() {
        return false;
    }
    unread(&start).is_some()
        || match image::guess_format(&start) {
            // A TIFF's header tells its encoding; a JPEG's decoder would read the whole file.
            Ok(ImageFormat::Tiff) => color_type(path).is_none(),
            Ok(ImageFormat::Jpeg) => Frame::of(file).is_some_and(|frame| frame.unread().is_some()),
            Ok(format) => !format.reading_enabled(),
            Err(_) => false,
        }
}

/// The bytes of a mask: grey, or, where that is the same throughout or a picture, alpha; else both together. Alpha that is the same
/// throughout says nothing. Masks of small numbers, and those in colours, which name objects, hide where they are 0; the others'
/// largest number is white. Numbers are those of the file, of 8 or 16 bits.
pub(super) fn counting(mask: DynamicImage) -> Vec<u8> {
    let bytes_of_channel = mask.color().bytes_per_pixel() / mask.color().channel_count();
    let labels = labels(&mask);
    let (pixels, white): (Vec<u16>, u16) = if bytes_of_channel == 1 {
        (mask.into_luma_alpha8().into_raw().into_iter().map(u16::from).collect(), 255)
    } else {
        (mask.into_luma_alpha16().into_raw(), u16::MAX)
    };
    let pixels = pixels.as_chunks::<2>().0;
    let share = |v: u16, alpha: u16, of: u16| (u32::from(v) * u32::from(alpha) / u32::from(of)) as u16;
    let [plain, even] = [0, 1].map(|channel| pixels.iter().all(|pixel| pixel[channel] == pixels[0][channel]));
    let is_picture = !even && {
        let mut seen = vec![false; 1 << 16];
        pixels.iter().filter(|[_, alpha]| *alpha > 0).for_each(|[grey, _]| seen[usize::from(*grey)] = true);
        seen.into_iter().filter(|seen| *seen).count() > MOST_GREYS
    };
    if let Some(labels) = labels.filter(|_| !is_picture) {
        let most = pixels.iter().map(|[_, alpha]| *alpha).max().unwrap_or(white);
        let opaque = |alpha: u16| even || 2 * u32::from(alpha) > u32::from(most);
        return labels.into_iter().zip(pixels).map(|(byte, [_, alpha])| byte * u8::from(opaque(*alpha))).collect();
    }
    let shown = |[grey, alpha]: &[u16; 2]| match even {
        true => *grey,
        false if plain || is_picture => *alpha,
        false => share(*grey, *alpha, white),
    };
    let shown: Vec<u16> = pixels.iter().map(shown).collect();
    let most = shown.iter().copied().max().unwrap_or(0);
    // A file of 16 bits may hold numbers of 8.
    let half = if most < 256 { 128 } else { 1 << 15 };
    let byte = |v: u16| if most < half { 255 * u8::from(v > 0) } else { share(v, 255, most) as u8 };
    shown.into_iter().map(byte).collect()
}

/// More greys than this are a picture's, and not a mask's.
const MOST_GREYS: usize = 32;
/// More colours than this are a picture's, or those of a scale, and no labels.
const MOST_LABELS: usize = 64;
/// Least difference of a pixel's colours, of 255, for it to be a colour and no grey that a JPEG has changed.
const COLOURED: u8 = 64;
/// Least colour, of 255, that is not black.
const NOT_BLACK: u8 = 16;

/// White where a mask in a few colours, black and another among them, is not black; none for other masks.
fn labels(mask: &DynamicImage) -> Option<Vec<u8>> {
    if !mask.color().has_color() {
        return None;
    }
    let colours = mask.to_rgb8();
    let mut kinds = HashSet::new();
    // Stops at a picture, which has more than a few.
    let few = colours.pixels().all(|pixel| !kinds.insert(pixel.0) || kinds.len() <= MOST_LABELS);
    let ends = |pixel: &[u8; 3]| pixel.iter().fold((255, 0), |(low, high), v| (low.min(*v), high.max(*v)));
    // Grey masks have some in colour, at most.
    let is_coloured = |(low, high): (u8, u8)| high - low > COLOURED;
    let coloured = 2 * kinds.iter().map(ends).filter(|ends| is_coloured(*ends)).count() + 1 >= kinds.len();
    let black = kinds.iter().any(|pixel| ends(pixel).1 <= NOT_BLACK);
    let shown = |pixel: &image::Rgb<u8>| 255 * u8::from(ends(&pixel.0).1 > NOT_BLACK);
    (few && kinds.len() > 1 && coloured && black).then(|| colours.pixels().map(shown).collect())
}

/// True for the masks of instant-ngp, dynamic_mask_x.png, which hide what is not black.
pub(super) fn hides_where_white(mask: &Path) -> bool {
    mask.file_name().is_some_and(|name| name.to_string_lossy().to_lowercase().starts_with("dynamic_mask_"))
}

/// Red, green, blue and alpha in bytes. Floats, as of EXR, are linear in the amount of light: they get the curve of sRGB.
pub(super) fn to_bytes(decoded: DynamicImage) -> RgbaImage {
    if !matches!(decoded, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        return decoded.into_rgba8();
    }
    let floats = decoded.into_rgba32f();
    let curve = |v: f32| if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8; // NaN gives 0
    RgbaImage::from_fn(floats.width(), floats.height(), |x, y| {
        let [r, g, b, a] = floats.get_pixel(x, y).0;
        image::Rgba([byte(curve(r)), byte(curve(g)), byte(curve(b)), byte(a)])
    })
}

/// The name of gzip's format, which programs that convert photos do not read.
const GZIPPED: &str = "compressed by gzip";

/// The name of a format that is not read, by the first bytes of a file.
fn unread(bytes: &[u8]) -> Option<&'static str> {
    let brand = if bytes.get(4..8) == Some(b"ftyp") { bytes.get(8..12) } else { None };
    match (bytes, brand) {
        (_, Some(b"avif" | b"avis")) => Some("AVIF"),
        (_, Some(b"crx ")) => Some("a raw photo (CR3)"),
        (_, Some(_)) => Some("HEIC or a video"),
        ([0xff, 0x0a, ..] | [0, 0, 0, 12, b'J', b'X', b'L', b' ', ..], _) => Some("JPEG XL"),
        ([0, 0, 0, 12, b'j', b'P', ..] | [0xff, 0x4f, 0xff, 0x51, ..], _) => Some("JPEG 2000"),
        ([b'B', b'M', ..], _) => Some("BMP"),
        ([0x1f, 0x8b, ..], _) => Some(GZIPPED),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_are_straight_and_not_all_white() {
        let picture =
            |pixels: Vec<f32>| DynamicImage::ImageRgba32F(image::Rgba32FImage::from_raw(2, 1, pixels).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        picture(vec![0.1, 0.2, 0.3, 0.5, 2.0, 0.1, 0.1, 1.0]).save(&path).unwrap();
        let read = to_bytes(decode(&path).unwrap());
        // The curve of 0.2, 0.4, 0.6; a light may be brighter than white.
        assert_eq!(read.get_pixel(0, 0).0, [124, 170, 203, 128]);
        assert_eq!(read.get_pixel(1, 0).0[0], 255);
        picture(vec![90.0, 120.0, 130.0, 1.0, 20.0, 30.0, 0.5, 1.0]).save(&path).unwrap();
        assert!(decode(&path).unwrap_err().to_string().contains("which is white"));
    }
}
