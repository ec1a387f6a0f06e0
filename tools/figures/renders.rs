//! Three pictures of one held-out view, side by side: the photo, the dense model, the pruned model. They come from the
//! folder of a `qirf-vk compare --arms dense,default`, whose arms were trained equally long.

use super::Parts;
use super::measured::json;
use image::codecs::jpeg::JpegEncoder;
use image::{GenericImage, ImageEncoder, Rgb, RgbImage};
use qirf_vk::metrics::{Image, psnr};
use qirf_vk::report::format::{count, decimals};
use std::path::{Path, PathBuf};

/// Path of the picture from the repository's root.
pub const FILE: &str = "docs/figures/renders.jpg";
/// The comparison's arms, left to right after the photo.
const ARMS: [&str; 2] = ["dense", "default"];
/// White columns between two pictures, in pixels.
const GAP: u32 = 6;
/// JPEG quality, of 100.
const QUALITY: u8 = 88;

/// Photo, dense and pruned picture of one view, with the PSNR of the two renders in dB.
struct View {
    pictures: [RgbImage; 3],
    psnr: [f64; 2],
}

/// The composed picture as a JPEG file, and the part of README that shows it.
///
/// # Errors
/// A file that is absent, cannot be decoded or lacks a field, by its path; a comparison without both arms or held-out
/// views.
pub fn renders(comparison: &Path) -> Result<(Vec<u8>, Parts), String> {
    let view = typical(views(comparison)?)
        .ok_or_else(|| format!("{}: no photo of a held-out view; compare with views held out", comparison.display()))?;
    let gaussians = gaussians(&comparison.join("compare.json"))?;
    Ok((jpeg(&side_by_side(&view.pictures))?, vec![("renders", caption(&view, gaussians))]))
}

/// All views of which the comparison keeps a photo.
fn views(comparison: &Path) -> Result<Vec<View>, String> {
    let [dense, pruned] = ARMS.map(|arm| comparison.join("arms").join(arm).join("renders"));
    let photos = pruned.join("photos");
    let entries = std::fs::read_dir(&photos).map_err(|e| format!("{}: {e}; {}", photos.display(), asked()))?;
    let mut names: Vec<PathBuf> = entries.flatten().map(|e| PathBuf::from(e.file_name())).collect();
    names.sort();
    names.iter().map(|name| View::read(&[photos.join(name), dense.join(name), pruned.join(name)])).collect()
}

fn asked() -> String {
    format!("qirf-vk compare SCENE -o FOLDER --arms {} writes it", ARMS.join(","))
}

impl View {
    fn read(paths: &[PathBuf; 3]) -> Result<Self, String> {
        let open = |path: &PathBuf| {
            image::open(path).map(|p| p.to_rgb8()).map_err(|e| format!("{}: {e}; {}", path.display(), asked()))
        };
        let pictures = [open(&paths[0])?, open(&paths[1])?, open(&paths[2])?];
        let against =
            |k: usize| decibels(&pictures[0], &pictures[k]).map_err(|e| format!("{}: {e}", paths[k].display()));
        let psnr = [against(1)?, against(2)?];
        Ok(Self { pictures, psnr })
    }
}

fn decibels(photo: &RgbImage, render: &RgbImage) -> Result<f64, String> {
    let floats = |picture: &RgbImage| picture.iter().map(|v| f32::from(*v) / 255.0).collect::<Vec<_>>();
    let (a, b) = (floats(photo), floats(render));
    let image = |picture: &RgbImage, pixels| Image::new(picture.width() as usize, picture.height() as usize, pixels);
    let [a, b] = [image(photo, &a), image(render, &b)].map(|i| i.map_err(|e| e.to_string()));
    psnr(&a?, &b?).map_err(|e| e.to_string())
}

/// The view of median quality after pruning: neither the best nor the worst.
fn typical(mut views: Vec<View>) -> Option<View> {
    views.sort_by(|a, b| a.psnr[1].total_cmp(&b.psnr[1]));
    let middle = views.len() / 2;
    views.into_iter().nth(middle)
}

/// Gaussians of both arms.
fn gaussians(path: &Path) -> Result<[usize; 2], String> {
    let compared = json(path)?;
    let of = |arm: &str| {
        let arms = compared["arms"].as_array().map_or(&[][..], Vec::as_slice);
        let found = arms.iter().find(|a| a["name"] == arm).and_then(|a| a["gaussians"].as_u64());
        found.map(|n| n as usize).ok_or_else(|| format!("{}: no arm '{arm}'; {}", path.display(), asked()))
    };
    Ok([of(ARMS[0])?, of(ARMS[1])?])
}

fn side_by_side(pictures: &[RgbImage; 3]) -> RgbImage {
    let (w, h) = pictures[0].dimensions();
    let mut out = RgbImage::from_pixel(3 * w + 2 * GAP, h, Rgb([255; 3]));
    for (k, picture) in (0..).zip(pictures) {
        // Sizes are equal, since their PSNR was computed.
        let _ = out.copy_from(picture, k * (w + GAP), 0);
    }
    out
}

fn jpeg(picture: &RgbImage) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, QUALITY)
        .write_image(picture, picture.width(), picture.height(), image::ExtendedColorType::Rgb8)
        .map_err(|e| format!("{FILE}: {e}"))?;
    Ok(bytes)
}

fn caption(view: &View, [dense, pruned]: [usize; 2]) -> String {
    let [before, after] = view.psnr.map(|p| decimals(p, 1));
    format!(
        "![A photo of the demo scene, and the same view rendered from the dense and from the pruned model]({FILE})\n\n\
         *A held-out view of the synthetic demo scene. Left: the photo. Middle: the dense model, {} Gaussians, {before} dB. \
         Right: the model pruned to {} % of them, {} Gaussians, {after} dB. Both were trained equally long.*\n",
        count(dense),
        decimals(100.0 * pruned as f64 / dense as f64, 0),
        count(pruned),
    )
}
