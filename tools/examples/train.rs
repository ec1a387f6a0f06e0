//! Trains a scene for 500 iterations and prints the loss: `cargo run --release --example train -- capture model.ply`.
//!
//! Without arguments it makes the embedded scene in the folder `capture` and writes `model.ply`.

use qirf_vk::gaussians::formats;
use qirf_vk::gpu::{Device, DeviceOptions};
use qirf_vk::scene::{LoadOptions, OpenOptions, Resize, Scene, camera};
use qirf_vk::synth::{self, SynthOptions};
use qirf_vk::train::initialise::{self, Seed};
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Progress, Trainer};
use std::error::Error;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let scene = match arguments.next() {
        Some(scene) => scene,
        None => embedded("capture".into())?,
    };
    let model = arguments.next().unwrap_or_else(|| "model.ply".into());
    train(&scene, &model, 500, |at| {
        println!("iteration {}: loss {:.4}, {} Gaussians", at.iteration, at.loss, at.gaussians);
    })
}

/// Makes the embedded scene in a folder.
fn embedded(folder: PathBuf) -> Result<PathBuf, synth::Error> {
    synth::write(&folder, &SynthOptions::default(), &|_| {})?;
    Ok(folder)
}

/// Trains on all photos of a scene at 160 pixels' width, and writes the model; calls `follow` after every tenth of the
/// run.
pub(crate) fn train(
    scene: &Path,
    model: &Path,
    iterations: u32,
    mut follow: impl FnMut(Progress),
) -> Result<(), Box<dyn Error>> {
    let mut scene = Scene::open(scene, &OpenOptions::default())?;
    scene.require_photos()?;
    let photos = scene.load_photos(&LoadOptions { resize: Resize::Width(160), ..LoadOptions::default() }, &|_| {})?;
    let mut seeds: Vec<Seed> = scene.points.iter().map(Seed::from).collect();
    if seeds.is_empty() {
        seeds = initialise::random(&photos, 5000, false, 1)?;
    }
    let extent = camera::extent(photos.iter().map(|photo| &photo.camera));
    let options = Options { schedule: Schedule::of(iterations), ..Options::default() };

    let device = Device::open(&DeviceOptions::from_env()?)?;
    let mut trainer = Trainer::new(&device, &initialise::from_points(&seeds), photos, extent, options)?;
    for tenth in 1..=10 {
        follow(trainer.run_until(iterations * tenth / 10, |_, _| ControlFlow::Continue(()))?);
    }
    formats::write(model, &trainer.download()?, formats::RenderMode::Plain)?;
    Ok(())
}
