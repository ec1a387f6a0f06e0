//! Pictures embedded in a page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::{jpeg::JpegEncoder, png};
use image::imageops::{FilterType, resize};
use image::{ImageEncoder, RgbImage};
use std::path::Path;

/// Longest side in a page, in pixels.
const LONGEST: u32 = 800;
/// JPEG quality, of 100.
const QUALITY: u8 = 90;

/// A picture of a run at its own size; `None` if it is missing or cannot be decoded.
pub fn read(path: &Path) -> Option<RgbImage> {
    Some(image::open(path).ok()?.to_rgb8())
}

/// Absolute difference times `gain`; `None` if the sizes differ.
pub fn difference(a: &RgbImage, b: &RgbImage, gain: u8) -> Option<RgbImage> {
    (a.dimensions() == b.dimensions()).then(|| {
        let mut out = a.clone();
        out.iter_mut().zip(b.iter()).for_each(|(x, y)| *x = x.abs_diff(*y).saturating_mul(gain));
        out
    })
}

/// Width and height in a page, in pixels, of a picture of this size: it is scaled down to at most 800 pixels.
pub fn size_in_page(width: u32, height: u32) -> (u32, u32) {
    let longest = width.max(height);
    let side = |n: u32| ((u64::from(n) * u64::from(LONGEST) / u64::from(longest)) as u32).max(1);
    if longest > LONGEST { (side(width), side(height)) } else { (width, height) }
}

/// The picture as a `data:` URI, scaled down to at most 800 pixels: PNG or JPEG, whichever is smaller. `None` if it is
/// empty.
pub fn data_uri(picture: &RgbImage) -> Option<String> {
    let (w, h) = size_in_page(picture.width(), picture.height());
    let smaller = ((w, h) != picture.dimensions()).then(|| resize(picture, w, h, FilterType::CatmullRom));
    let picture = smaller.as_ref().unwrap_or(picture);
    let kind = image::ExtendedColorType::Rgb8;
    let as_png = || {
        let mut bytes: Vec<u8> = Vec::new();
        png::PngEncoder::new_with_quality(&mut bytes, png::CompressionType::Default, png::FilterType::Adaptive)
            .write_image(picture, w, h, kind)
            .map(|()| bytes)
    };
    let as_jpeg = || {
        let mut bytes: Vec<u8> = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, QUALITY).write_image(picture, w, h, kind).map(|()| bytes)
    };
    let (as_png, as_jpeg) = rayon::join(as_png, as_jpeg);
    let (as_png, as_jpeg) = (as_png.ok()?, as_jpeg.ok()?);
    let (name, bytes) = if as_png.len() <= as_jpeg.len() { ("png", as_png) } else { ("jpeg", as_jpeg) };
    Some(format!("data:image/{name};base64,{}", STANDARD.encode(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_become_uris_of_a_bounded_size() {
        let wide = RgbImage::from_fn(1000, 300, |x, y| image::Rgb([(x % 251) as u8, (y % 241) as u8, (x * y) as u8]));
        let uri = data_uri(&wide).unwrap();
        let bytes = STANDARD.decode(uri.split_once("base64,").unwrap().1).unwrap();
        assert_eq!(image::load_from_memory(&bytes).unwrap().to_rgb8().dimensions(), (800, 240));
        assert!(data_uri(&RgbImage::from_pixel(8, 8, image::Rgb([9; 3]))).unwrap().starts_with("data:image/png"));
        assert!(data_uri(&RgbImage::new(0, 0)).is_none());
    }

    #[test]
    fn differences_are_magnified_and_saturate() {
        let [a, b] = [10, 30].map(|v| RgbImage::from_pixel(2, 1, image::Rgb([v, 255, 0])));
        assert_eq!(difference(&a, &b, 4).unwrap().get_pixel(0, 0).0, [80, 0, 0]);
        assert_eq!(difference(&a, &b, 100).unwrap().get_pixel(1, 0).0, [255, 0, 0]);
        assert!(difference(&a, &RgbImage::new(1, 2), 4).is_none());
    }
}
