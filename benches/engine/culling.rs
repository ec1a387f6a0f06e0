//! `culling`: pairs and milliseconds per picture by culling method, over an orbit of `flowers_lod2` at 1280 x 720.

use super::flowers::{self, VIEWS, fewer};
use super::{device, facts, group, row, time_of_picture};
use criterion::{BenchmarkId, Criterion};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gaussians::{Gaussians, formats};
use qirf_vk::render::{Culling, Renderer, Settings};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Rungs without culling off, which lists every Gaussian in all tiles.
const RUNGS: [(&str, Culling); 2] = [("exact", Culling::Exact), ("3-sigma", Culling::ThreeSigma)];

/// The model `flowers_lod2` of the shared data; `None` if it is missing.
fn flowers() -> Option<Gaussians> {
    let shared = std::env::var_os("QIRF_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    let path = shared.join("models/flowers_lod2_93k_sh2.ply");
    if !path.is_file() {
        println!("skipped: no shared data");
        return None;
    }
    Some(formats::read(&path).expect("a model").gaussians)
}

/// An iteration is the mean picture of the orbit.
pub fn culling(criterion: &mut Criterion) {
    let Some(model) = flowers() else { return };
    let device = device();
    let cameras = flowers::orbit(&model, 1280, 720);
    let (exact, three_sigma) = flowers::pairs_at_16(&model, &cameras);
    println!(
        "culling, tiles of 16 (float64 twin): exact {} pairs an image, 3-sigma {}: {:.1} % fewer",
        exact / u64::from(VIEWS),
        three_sigma / u64::from(VIEWS),
        fewer(exact, three_sigma)
    );
    let resident = Resident::upload(device, &model).unwrap();
    let mut group = group(criterion, "culling");
    let mut all_pairs = Vec::new();
    for (name, culling) in RUNGS {
        let settings = Settings { culling, ..Settings::default() };
        let mut renderer = Renderer::new(device, settings, model.len(), 1280, 720).unwrap();
        let mut pairs = 0;
        for camera in &cameras {
            pairs += u64::from(renderer.render_timed(&resident, camera).unwrap().2);
        }
        all_pairs.push(pairs);
        println!(
            "culling/{name}: {} pairs an image, tiles of {} on this device; exact has {:.1} % fewer",
            pairs / u64::from(VIEWS),
            renderer.tile(),
            fewer(all_pairs[0], pairs)
        );
        let each = |all: u64| all as f64 / f64::from(VIEWS);
        let numbers = [
            ("gaussians", model.len() as f64),
            ("pairs", each(pairs)),
            ("tile", f64::from(renderer.tile())),
            ("exact_pairs_at_16", each(exact)),
            ("three_sigma_pairs_at_16", each(three_sigma)),
        ];
        facts::note("culling", &[name], &numbers);
        let picture = |camera| {
            let start = Instant::now();
            time_of_picture(&renderer.draw(&resident, camera).unwrap(), start)
        };
        let run = || cameras.iter().map(picture).sum::<Duration>() / VIEWS;
        row(&mut group, BenchmarkId::from_parameter(name), run);
    }
    group.finish();
}
