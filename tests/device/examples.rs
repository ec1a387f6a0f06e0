//! The programs of `tools/examples`, run as a reader would.

#[path = "../../tools/examples/kernel.rs"]
#[allow(dead_code)] // partly used by its main alone
mod kernel;
#[path = "../../tools/examples/render.rs"]
#[allow(dead_code)] // as above
mod render;
#[path = "../../tools/examples/train.rs"]
#[allow(dead_code)] // as above
mod train;

use crate::support::source;
use qirf_vk::gaussians::formats;
use qirf_vk::synth::{self, SynthOptions};
use std::path::PathBuf;

/// The model that the examples draw by default.
fn ring() -> PathBuf {
    source("tools/examples/ring.ply")
}

/// Eight pictures, each with different bright pixels.
#[test]
fn a_model_is_rendered_from_eight_sides() {
    let folder = tempfile::tempdir().unwrap();
    let mut seen = Vec::new();
    for path in render::render(&ring(), folder.path()).unwrap() {
        let picture = image::open(&path).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (640, 480));
        let lit = picture.pixels().filter(|p| p.0.iter().any(|c| *c > 100)).count();
        assert!((5_000..200_000).contains(&lit), "{lit} bright pixels in {}", path.display());
        assert!(!seen.contains(&picture), "{}", path.display());
        seen.push(picture);
    }
    assert_eq!(seen.len(), 8);
}

#[test]
fn a_kernel_of_ones_own_takes_the_colour_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grey.png");
    let (coloured, grey) = kernel::grey(&ring(), &path).unwrap();
    assert!(coloured > 0.01 && grey < 1e-6, "{coloured} {grey}");
    assert_eq!(image::open(&path).unwrap().color(), image::ColorType::L8);
}

#[test]
fn a_scene_is_trained_and_the_loss_falls() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, model) = (folder.path().join("scene"), folder.path().join("model.ply"));
    let options = SynthOptions { views: 6, width: 48, height: 36, points: 300, ..SynthOptions::default() };
    synth::write(&scene, &options, &|_| {}).unwrap();
    let mut losses = Vec::new();
    train::train(&scene, &model, 200, |at| losses.push(at.loss)).unwrap();
    assert_eq!(losses.len(), 10);
    // Each loss belongs to one photo; the mean of three is significant.
    let (first, last) = (losses[..3].iter().sum::<f32>(), losses[7..].iter().sum::<f32>());
    assert!(last < 0.8 * first, "{losses:?}");
    assert!(formats::read(&model).unwrap().gaussians.len() >= 100);
}
