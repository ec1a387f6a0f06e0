//! A device's fingerprint: its results for the embedded scene, bit for bit. Two machines with equal fingerprints may
//! share the tasks of a job whose result must have the same bytes everywhere.

use super::backward::{there_and_back, weights};
use super::random::Kind;
use super::rasterise::{MILD, camera};
use crate::gaussians::Gaussians;
use crate::gaussians::formats::crc32;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::job::Error;
use crate::qirf::pairs;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};
use crate::qirf::study::{Basis, Observed, Study};
use crate::random::Random;
use crate::render::Settings;
use crate::response::{Responses, Score, Wanted};
use crate::scene::Photo;
use crate::scene::camera::Camera;
use crate::train::{Options, Trainer};
use std::ops::ControlFlow;

/// The variable that replaces the fingerprint, for tests of the errors on a foreign device.
const STAND_IN: &str = "QIRF_FINGERPRINT";
/// Iterations of training in the fingerprint.
const ITERATIONS: u32 = 3;

/// The results of `device` for the embedded scene with its tuning, as six checksums (CRC-32 of all bits) in hexadecimal
/// digits: of a picture, of gradients, of three iterations of training, of responses and scores, of the choices in
/// solved blocks, and of merged blocks and pairs.
pub fn fingerprint(device: &Device) -> Result<String, Error> {
    if let Some(text) = std::env::var(STAND_IN).ok().filter(|text| !text.is_empty()) {
        return Ok(text);
    }
    let model = Kind { log_scale: [-3.2, -1.6], logit: [-2.0, 3.0], ..MILD }.model();
    let (near, far) = (camera(96, 64), camera(61, 47));
    let drawn = there_and_back(device, &model, &near, Settings::default(), &weights(&near, 31))?;

    let photos = [near, far].into_iter().enumerate();
    let photos = photos.map(|(i, camera)| photo(camera, i as u64)).collect();
    let options = Options { degree: model.degree(), ..Options::default() };
    let mut trainer = Trainer::new(device, &model, photos, 2.0, options)?;
    trainer.run_until(ITERATIONS, |_, _| ControlFlow::Continue(()))?;
    let trained = trainer.download()?;
    let responses = trainer.responses(Wanted::BOTH)?;
    drop(trainer);

    let sums = [
        crc32([bytemuck::cast_slice(&drawn.image.pixels)]),
        crc32(drawn.gradients.bytes()),
        crc32(trained.bytes()),
        of_responses(&responses),
    ];
    let sums = sums.into_iter().chain(blocks(device, &trained, &responses)?);
    Ok(sums.map(|sum| format!("{sum:08x}")).collect::<Vec<_>>().join("-"))
}

/// A photo of noise, seeded with its number.
fn photo(camera: Camera, number: u64) -> Photo {
    let mut r = Random(97 + number);
    let pixels: Vec<u8> =
        (0..4 * camera.pixels()).map(|i| if i % 4 == 3 { 255 } else { r.within(0.0, 256.0) as u8 }).collect();
    Photo::opaque(camera, pixels)
}

/// Checksums of the choices in solved blocks, and of merged blocks and pairs.
fn blocks(device: &Device, model: &Gaussians, responses: &Responses) -> Result<[u32; 2], Error> {
    let resident = Resident::upload(device, model)?;
    let observed = Observed { resident: &resident, model, responses };
    let asked = [Selector::Css, Selector::Gnso];
    let study = Study::new(device, observed, &Basis::default(), &asked, 1)?;
    let keep = asked.map(|selector| study.choose(selector, Budget::PerBlock, Keep::Share(Keep::SHARE), 0.0).keep);
    let marks: Vec<u8> = keep.iter().flatten().map(|kept| u8::from(*kept)).collect();
    let mut merged = model.clone();
    study.merge(device, &resident, &mut merged, &keep[0])?;
    let Responses { scores, cameras, dilation, .. } = responses;
    let pairs = pairs::merge(model, scores, cameras, *dilation, model.len() / 2);
    Ok([crc32([marks.as_slice()]), crc32(merged.bytes().chain(pairs.model.bytes()))])
}

fn of_responses(responses: &Responses) -> u32 {
    crc32([bytemuck::cast_slice(&responses.channels), bytemuck::cast_slice::<Score, u8>(&responses.scores)])
}
