//! Culling on a real model: it saves pairs and does not change the picture.

#[path = "../../benches/engine/flowers.rs"]
mod flowers;

use crate::support::{device, finish, shared};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gaussians::{Gaussians, formats};
use qirf_vk::render::{Culling, Renderer, Settings};

fn flowers() -> Option<Gaussians> {
    Some(formats::read(&shared("models/flowers_lod2_93k_sh2.ply")?).expect("a model").gaussians)
}

#[test]
fn bin_lists_a_quarter_less_than_three_sigma_would() {
    let Some(model) = flowers() else { return };
    let cameras = flowers::orbit(&model, 1280, 720);
    let (exact, three_sigma) = flowers::pairs_at_16(&model, &cameras);
    let fewer = flowers::fewer(exact, three_sigma);
    println!("tiles of 16: {exact} against {three_sigma}, {fewer:.1} % fewer");
    assert!(fewer >= 25.0, "tiles of 16: {fewer:.1} %");

    let device = device();
    let resident = Resident::upload(&device, &model).unwrap();
    let count = |culling| -> u64 {
        let settings = Settings { culling, ..Settings::default() };
        let renderer = Renderer::new(&device, settings, model.len(), 1280, 720).unwrap();
        let pairs = |camera| {
            renderer.draw(&resident, camera).unwrap();
            u64::from(renderer.pairs().unwrap()) // the true number, even if it did not fit
        };
        cameras.iter().map(pairs).sum()
    };
    let (exact, three_sigma) = (count(Culling::Exact), count(Culling::ThreeSigma));
    let fewer = flowers::fewer(exact, three_sigma);
    println!("tiles of the device: {exact} against {three_sigma}, {fewer:.1} % fewer");
    assert!(exact > 0 && fewer >= 25.0, "tiles of the device: {fewer:.1} %");
    finish(&device);
}

#[test]
fn bin_loses_nothing_of_flowers() {
    let Some(model) = flowers() else { return };
    let device = device();
    let resident = Resident::upload(&device, &model).unwrap();
    // 30 tiles of side 8; each lists all Gaussians in front of the camera when culling is off.
    let cameras = flowers::orbit(&model, 48, 40);
    let pictures = |culling| {
        let settings = Settings { culling, ..Settings::default() };
        let mut renderer = Renderer::new(&device, settings, model.len(), 48, 40).unwrap();
        cameras.iter().map(|c| renderer.render(&resident, c).unwrap()).collect::<Vec<_>>()
    };
    let exact = pictures(Culling::Exact);
    assert!(exact.iter().all(|image| image.pixels.iter().any(|p| p[3] > 0.5)));
    assert!(exact == pictures(Culling::Off), "pictures differ");
    finish(&device);
}
