//! Renders a model from eight sides: `cargo run --release --example render -- flowers.ply pictures`.
//!
//! Without arguments it renders the ring of `tools/examples/ring.ply` into the folder `ring`.

use qirf_vk::gaussians::formats::{self, Loaded};
use qirf_vk::gaussians::outline::outline;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Device, DeviceOptions};
use qirf_vk::render::{Image, Renderer, Style};
use qirf_vk::scene::orbit::{Look, UP};
use std::error::Error;
use std::path::{Path, PathBuf};

const RING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tools/examples/ring.ply");

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let model = arguments.next().unwrap_or_else(|| RING.into());
    let folder = arguments.next().unwrap_or_else(|| "ring".into());
    for picture in render(&model, &folder)? {
        println!("{}", picture.display());
    }
    Ok(())
}

/// Writes eight pictures of a model into a folder.
pub(crate) fn render(model: &Path, folder: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let Loaded { gaussians, mode, .. } = formats::read(model)?;
    let cameras = outline(&gaussians, UP).cameras(8, &Look { size: (640, 480), ..Look::default() });
    let device = Device::open(&DeviceOptions::from_env()?)?;
    let resident = Resident::upload(&device, &gaussians)?;
    // Anti-aliased or plain, as the file says; over black.
    let settings = Style::of(mode).over([0.0; 3]);
    let mut renderer = Renderer::new(&device, settings, gaussians.len(), 640, 480)?;

    std::fs::create_dir_all(folder)?;
    let mut written = Vec::new();
    for (number, camera) in cameras.iter().enumerate() {
        let path = folder.join(format!("{number}.png"));
        picture(&renderer.render(&resident, camera)?).save(&path)?;
        written.push(path);
    }
    Ok(written)
}

/// The image with eight bits a channel.
fn picture(image: &Image) -> image::RgbImage {
    let bytes = image.pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).map(|v| (v.clamp(0.0, 1.0) * 255.0).round());
    image::RgbImage::from_raw(image.width, image.height, bytes.map(|v| v as u8).collect()).expect("three bytes a pixel")
}
