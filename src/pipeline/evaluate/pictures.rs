//! Pictures on disk: their names, and PNG and NPY files written whole or not at all.

use crate::extension::has_extension;
use crate::gaussians::formats::write_atomically;
use crate::job::Error;
use crate::render::Image;
use image::{ColorType, ImageEncoder, codecs::png};
use npyz::WriterBuilder;
use std::collections::HashSet;
use std::io;
use std::path::{Component, Path, PathBuf};

/// Longest name of a picture in bytes, without its extension.
const LONGEST: usize = 220;

/// File formats of pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Format {
    /// 8 bits a channel, sRGB values as trained
    #[default]
    Png,
    /// NumPy: float32, height x width x 4, RGB and alpha
    Npy,
}

impl Format {
    /// The file extension.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Npy => "npy",
        }
    }
}

/// Relative paths for pictures of these names: folders kept, extensions replaced, each path unique.
///
/// `a/left.jpg` becomes `a/left.png`; if `a/left.tif` exists too, that becomes `a/left.tif.png`.
pub fn names<'a>(views: impl Iterator<Item = &'a str>, extension: &str) -> Vec<PathBuf> {
    let mut taken = HashSet::new();
    views
        .map(|view| {
            let view = view.replace('\\', "/");
            // Absolute paths and `..` must not lead out of the folder.
            let mut safe: PathBuf =
                Path::new(&view).components().filter(|c| matches!(c, Component::Normal(_))).collect();
            if safe.as_os_str().is_empty() {
                safe.push("picture");
            }
            let pictures = ["png", "jpg", "jpeg", "webp", "tif", "tiff", "bmp", "exr", "npy", "ppm"];
            let mut stem = if has_extension(&safe, &pictures) { safe.with_extension("") } else { safe.clone() };
            [&mut stem, &mut safe].into_iter().for_each(shorten);
            let with = |stem: &Path, more: &str| {
                let mut name = stem.as_os_str().to_owned();
                name.push(more);
                PathBuf::from(name)
            };
            let mut path = with(&stem, &format!(".{extension}"));
            let mut number = 1;
            while !taken.insert(path.clone()) {
                path = if number == 1 {
                    with(&safe, &format!(".{extension}"))
                } else {
                    with(&safe, &format!("-{number}.{extension}"))
                };
                number += 1;
            }
            path
        })
        .collect()
}

/// Cuts a file's name that leaves no room for a longer extension and a number: systems allow 255 bytes.
fn shorten(path: &mut PathBuf) {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if name.len() > LONGEST {
        let fits = name.char_indices().take_while(|(at, c)| at + c.len_utf8() <= LONGEST);
        path.set_file_name(fits.map(|(_, c)| c).collect::<String>());
    }
}

/// Writes one picture; with `transparent` a PNG keeps alpha, and its colours are divided by it.
pub fn write(path: &Path, image: &Image, format: Format, transparent: bool) -> Result<(), Error> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
    }
    write_atomically(path, |out| match format {
        Format::Png => write_png(out, image, transparent),
        Format::Npy => {
            let shape = [u64::from(image.height), u64::from(image.width), 4];
            npy(out, &shape, image.pixels.as_flattened())
        }
    })
    .map_err(Error::writing)
}

/// The nearest step of eight bits to a value in [0, 1]; values beyond are clamped.
pub fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Encodes a picture as PNG; with `transparent` as [`write()`] does.
pub fn write_png(out: &mut dyn io::Write, image: &Image, transparent: bool) -> io::Result<()> {
    let (bytes, kind): (Vec<u8>, _) = if transparent {
        let pixel = |p: &[f32; 4]| {
            let over = if p[3] > 0.0 { 1.0 / p[3] } else { 0.0 };
            [byte(p[0] * over), byte(p[1] * over), byte(p[2] * over), byte(p[3])]
        };
        (image.pixels.iter().flat_map(pixel).collect(), ColorType::Rgba8)
    } else {
        (image.pixels.iter().flat_map(|p| [byte(p[0]), byte(p[1]), byte(p[2])]).collect(), ColorType::Rgb8)
    };
    png::PngEncoder::new_with_quality(out, png::CompressionType::Fast, png::FilterType::Adaptive)
        .write_image(&bytes, image.width, image.height, kind.into())
        .map_err(|e| match e {
            image::ImageError::IoError(e) => e,
            other => io::Error::other(other),
        })
}

/// Writes an array of this shape as NPY, its values row by row.
pub fn npy(out: &mut dyn io::Write, shape: &[u64], values: &[f32]) -> io::Result<()> {
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(out).begin_nd()?;
    writer.extend(values.iter().copied())?;
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_inside_and_never_meet() {
        let views =
            ["a/left.JPG", "a/left.tif", "./test/r_0", "../../etc/x.png", "/root.png", "v1.5", "a/left.tif", ""];
        let expected = [
            "a/left.png",
            "a/left.tif.png",
            "test/r_0.png",
            "etc/x.png",
            "root.png",
            "v1.5.png",
            "a/left.tif-2.png",
            "picture.png",
        ];
        assert_eq!(names(views.into_iter(), "png"), expected.map(PathBuf::from));
        let long = ["x", "y"].map(|end| format!("a/{}{end}.jpg", "\u{e9}".repeat(124)));
        let cut = names(long.iter().map(String::as_str), "png");
        assert_eq!(cut[0], PathBuf::from(format!("a/{}.png", "\u{e9}".repeat(110))));
        assert_eq!(cut[1], PathBuf::from(format!("a/{}-2.png", "\u{e9}".repeat(110))));
    }
}
