//! The readers of the corpus: each accepts a file, and what it gives is consistent, or refuses it with a message.

use super::corpus::{Input, Reader};
use super::writers::write;
use qirf_vk::depth_maps::read;
use qirf_vk::edit::Similarity;
use qirf_vk::gaussians::formats::{self, Loaded, Repairs};
use qirf_vk::glam::DVec3;
use qirf_vk::job::RunConfig;
use qirf_vk::pose::Rig;
use qirf_vk::scene::walk::{self, Frame};
use qirf_vk::scene::{LoadOptions, OpenOptions, Resize, Scene, read_text};
use qirf_vk::train::checkpoint::Snapshot;
use std::fs;
use std::io::Write;
use std::path::Path;

impl Input {
    /// Writes the good files beside the damaged one.
    pub fn prepare(&self, folder: &Path) {
        write(folder, self.beside.iter().map(|(name, bytes)| (name.as_str(), bytes.clone())));
        fs::create_dir_all(folder.join(&self.file).parent().unwrap()).unwrap();
    }

    /// Reads the damaged file in its folder. Returns true if it was accepted; panics if the result is inconsistent.
    pub fn read(&self, bytes: &[u8], folder: &Path) -> bool {
        let path = folder.join(&self.file);
        match self.reader {
            Reader::Model => model(bytes.len(), formats::read_bytes(bytes, Path::new(&self.file)), folder),
            Reader::Gzipped => {
                let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
                encoder.write_all(bytes).unwrap();
                let packed = encoder.finish().unwrap();
                model(bytes.len(), formats::read_bytes(&packed, Path::new(&self.file)), folder)
            }
            Reader::SogPart => {
                fs::write(&path, bytes).unwrap();
                model(usize::MAX, formats::read(folder), folder)
            }
            Reader::GltfPart => {
                fs::write(&path, bytes).unwrap();
                let all = fs::metadata(folder.join("m.gltf")).unwrap().len()
                    + fs::metadata(folder.join("m.bin")).unwrap().len();
                model(all as usize, formats::read(&folder.join("m.gltf")), folder)
            }
            Reader::Scene => {
                fs::write(&path, bytes).unwrap();
                scene(folder)
            }
            Reader::ScenePng => {
                let mut bytes = bytes.to_vec();
                right_checksums(&mut bytes);
                fs::write(&path, bytes).unwrap();
                scene(folder)
            }
            Reader::Georeference => {
                fs::write(&path, bytes).unwrap();
                let read = formats::read(&folder.join("model.ply"));
                assert!(read.as_ref().map_or(true, |model| model.origin.iter().all(|x| x.is_finite())));
                model(usize::MAX, read, folder)
            }
            Reader::Rigs => {
                fs::write(&path, bytes).unwrap();
                let names = ["left/a.png", "right/a.png"].map(str::to_owned);
                said(Rig::of(folder, &names, false)).flatten().is_some_and(|rig| {
                    assert!(rig.cameras.iter().all(|prefix| names.iter().any(|name| name.starts_with(prefix))));
                    assert!(
                        names.iter().all(|name| rig.camera_of(name).is_none_or(|camera| camera < rig.cameras.len()))
                    );
                    true
                })
            }
            Reader::Depth => said(depth_map(bytes)).is_some(),
            Reader::Path => {
                fs::write(&path, bytes).unwrap();
                let frame = Frame { size: (64, 48), asked: false, fov: 0.7, up: DVec3::NEG_Y };
                said(walk::read(&path, &frame)).is_some_and(|read| {
                    let cameras = walk::walk(&read.cameras, 5);
                    assert!(cameras.iter().all(|c| c.rotation.is_finite() && c.focal.is_finite()));
                    cameras.len() == 5
                })
            }
            Reader::Matrix => {
                fs::write(&path, bytes).unwrap();
                let read = said(read_text(&path)).and_then(|text| said(Similarity::of_text(&text)));
                read.is_some_and(|similarity| {
                    assert!(similarity.scale > 0.0 && similarity.rotation.is_finite());
                    true
                })
            }
            Reader::Config => {
                fs::write(&path, bytes).unwrap();
                said(RunConfig::read(&path)).is_some_and(|config| {
                    let (length, schedule) = (config.schedule.iterations, &config.schedule);
                    assert!([1, length / 2, length].iter().all(|&i| schedule.rates(i, 1.0).means.is_finite()));
                    assert!(config.written().is_ok());
                    assert!(config.prune.iter().flat_map(|p| p.iterations(length)).all(|at| at <= length));
                    true
                })
            }
            Reader::Checkpoint => {
                fs::write(&path, bytes).unwrap();
                said(Snapshot::read(&path)).is_some_and(|snapshot| snapshot.model.validate().is_ok())
            }
        }
    }
}

/// A depth map, whose every pixel can be asked for.
fn depth_map(bytes: &[u8]) -> Result<(), String> {
    let map = read::of_bytes(bytes, None).map_err(|what| format!("depth map of a photo {what}"))?;
    assert_eq!(map.depths.len(), map.width as usize * map.height as usize);
    for (x, y) in (0..map.width.min(99)).flat_map(|x| (0..map.height.min(99)).map(move |y| (x, y))) {
        assert!(map.at(x, y).is_none_or(|depth| depth > 0.0 && depth.is_finite()));
    }
    Ok(())
}

/// The result, if any; a refusal must have a message.
fn said<T, E: std::fmt::Display>(read: Result<T, E>) -> Option<T> {
    match read {
        Ok(value) => Some(value),
        Err(error) => {
            let said = error.to_string();
            assert!(said.len() > 20 && said.len() < 20_000, "a message of {} bytes: {said:.300}", said.len());
            None
        }
    }
}

/// Checks that every value is finite, omissions are counted, and the model can be written and read again.
fn model<E: std::fmt::Display>(bytes: usize, read: Result<Loaded, E>, folder: &Path) -> bool {
    let Some(Loaded { gaussians: m, repairs, .. }) = said(read) else { return false };
    m.validate().unwrap();
    let main = [m.means.as_flattened(), m.log_scales.as_flattened(), m.rotations.as_flattened(), &m.opacity_logits];
    assert!(main.into_iter().chain(m.sh.iter().map(Vec::as_slice)).flatten().all(|x| x.is_finite()));
    assert!(m.rotations.iter().all(|q| *q != [0.0; 4]));
    let all = m.len() + repairs.non_finite_rows + repairs.zero_quaternions;
    assert!(all <= bytes, "{all} Gaussians of {bytes} bytes");
    let copy = folder.join("copy.ply");
    formats::write(&copy, &m, formats::RenderMode::Plain).unwrap();
    let again = formats::read(&copy).unwrap();
    let doubts = Repairs { huge_scales: repairs.huge_scales, ..Repairs::default() };
    assert!(again.gaussians == m && again.repairs == doubts);
    true
}

/// Checks for finite cameras, tracks within the views, and photos with their cameras' sizes. Returns true if every photo and mask was used.
fn scene(folder: &Path) -> bool {
    let Some(mut scene) = said(Scene::open(folder, &OpenOptions::default())) else { return false };
    for view in &scene.views {
        assert!(
            view.camera.centre().is_finite() && view.camera.focal.is_finite() && view.camera.focal.min_element() > 0.0
        );
        assert!(view.camera.principal.is_finite() && view.camera.rotation.is_finite());
    }
    let n = scene.views.len() as u32;
    assert!(scene.points.iter().all(|p| p.position.is_finite() && p.track.iter().all(|&v| v < n)));
    let split = scene.split(8);
    assert!(scene.extent(&split.train).is_finite());
    if said(scene.require_photos()).is_none() {
        return true; // most scenes here come without photos
    }
    let listed = scene.views.len() + scene.skipped.missing_images.count + scene.skipped.mismatched_images.count;
    let Some(photos) =
        said(scene.load_photos(&LoadOptions { resize: Resize::Width(9), ..LoadOptions::default() }, &|_| {}))
    else {
        return false;
    };
    assert_eq!(
        photos.len() + scene.skipped.damaged_images.count + scene.skipped.unread_images.count,
        listed - absent(&scene),
        "each is counted"
    );
    for (photo, view) in photos.iter().zip(&scene.views) {
        let camera = view.camera_at(Resize::Width(9));
        assert_eq!(photo.camera, camera);
        assert_eq!(photo.pixels.len(), 4 * (camera.width * camera.height) as usize);
    }
    photos.len() == listed && scene.skipped.damaged_masks.count == 0
}

/// Views that were dropped before any photo was decoded.
fn absent(scene: &Scene) -> usize {
    scene.skipped.missing_images.count + scene.skipped.mismatched_images.count
}

/// Gives every chunk of a PNG the checksum of its content, so that damage gets past the checksums.
fn right_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]) as usize) {
        let Some(end) = length.checked_add(at + 8).filter(|end| end + 4 <= bytes.len()) else { return };
        let mut crc = flate2::Crc::new();
        crc.update(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&crc.sum().to_be_bytes());
        at = end + 4;
    }
}
