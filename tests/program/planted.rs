//! Floaters planted in the shared models: which go, and what else. `make floaters` prints the table of docs/edit.md.

use super::ended::{qirf, works};
use crate::support::shared;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats;
use qirf_vk::glam::{DVec2, DVec3};
use qirf_vk::pipeline::virtual_views::{VirtualCameras, VirtualViews};
use qirf_vk::random::Random;
use qirf_vk::render::Style;
use qirf_vk::scene::camera::Camera;
use std::ops::Range;
use std::path::Path;

const PLANTED: usize = 500;
/// Depths of three kinds, relative to the median depth: near a camera, in empty space, behind the scene; and the size of each.
const KINDS: [(Range<f64>, f64); 3] = [(0.05..0.2, 0.3), (0.3..0.7, 1.0), (1.5..4.0, 1.0)];

#[test]
#[ignore = "minutes: make floaters"]
fn planted_floaters_go_and_the_models_stay() {
    println!("| model | Gaussians | untouched: removed | PSNR | planted: own removed | near | space | behind | PSNR |");
    println!("|---|---:|---:|---:|---:|---:|---:|---:|---:|");
    for name in ["playbot_lod3_31k_sh2.ply", "guitar_91k_sh0.ply", "flowers_lod2_93k_sh2.ply", "biker.spz"] {
        let Some(original) = shared(&format!("models/{name}")) else { return };
        let folder = tempfile::tempdir().unwrap();
        let loaded = formats::read(&original).unwrap();
        let own = loaded.gaussians.len();
        let at = |name: &str| folder.path().join(name);
        let removed = |from: &Path, to: &Path| -> Vec<usize> {
            let edit = ["edit", "--remove", "floaters", "--json", "-o"];
            let steps = works(qirf(edit).arg(to).arg(from)).json()["steps"][0]["ranges"].clone();
            let ranges: Vec<[usize; 2]> = serde_json::from_value(steps).unwrap();
            ranges.into_iter().flat_map(|[first, last]| first..=last).collect()
        };
        let psnr = |model: &Path| -> String {
            let test = works(qirf(["eval", "--json", "--against"]).arg(&original).arg(model)).json()["test"].clone();
            test["psnr"].as_f64().map_or("equal".to_owned(), |psnr| format!("{psnr:.1}"))
        };
        let untouched = removed(&original, &at("clean.ply")).len();
        let mut model = loaded.gaussians.clone();
        model.append(&floaters(&loaded.gaussians));
        formats::write(&at("dirty.ply"), &model, loaded.mode).unwrap();
        let gone = removed(&at("dirty.ply"), &at("cleaned.ply"));
        let of_own = gone.iter().filter(|i| **i < own).count();
        let of_kind = |kind: usize| gone.iter().filter(|i| **i >= own && (**i - own) % KINDS.len() == kind).count();
        let planted: Vec<usize> = (0..KINDS.len()).map(of_kind).collect();
        let percent = |n: usize| format!("{n} ({:.2} %)", 100.0 * n as f64 / own as f64);
        println!(
            "| {} | {own} | {} | {} | {} | {} | {} | {} | {} to {} |",
            name.split('_').next().unwrap().trim_end_matches(".spz"),
            percent(untouched),
            psnr(&at("clean.ply")),
            percent(of_own),
            planted[0],
            planted[1],
            planted[2],
            psnr(&at("dirty.ply")),
            psnr(&at("cleaned.ply")),
        );
        assert!(200 * untouched <= own, "{name}: {untouched} of {own}");
        assert!(100 * planted.iter().sum::<usize>() >= 95 * PLANTED, "{name}: {planted:?}");
    }
}

/// Floaters of the three kinds, one after the other, in the pictures of the model's virtual cameras: 0.2 to 3 % of the median depth in
/// size, opacities of 0.27 to 0.95, any colour.
fn floaters(model: &Gaussians) -> Gaussians {
    let VirtualViews { around: cameras, .. } = VirtualCameras::default().views(model, [0.0; 3], Style::default());
    let medians: Vec<f64> = cameras.iter().map(|camera| median_depth(model, camera)).collect();
    let mut random = Random(1);
    let mut floaters = Gaussians::zeroed(PLANTED, model.degree());
    for i in 0..PLANTED {
        let k = random.word() as usize % cameras.len();
        let (camera, (depths, size)) = (&cameras[k], &KINDS[i % KINDS.len()]);
        let depth = medians[k] * random.within(depths.start, depths.end);
        let [x, y] = [camera.width, camera.height].map(|side| f64::from(side) * random.within(0.05, 0.95));
        let on_plane = (DVec2::new(x, y) - camera.principal) / camera.focal;
        let seen = DVec3::new(on_plane.x, on_plane.y, 1.0) * depth;
        floaters.means[i] = (camera.rotation.transpose() * (seen - camera.translation)).as_vec3().to_array();
        let longest = size * medians[k] * 0.002 * 15_f64.powf(random.unit());
        floaters.log_scales[i] = [0; 3].map(|_| (longest * random.within(0.3, 1.0)).ln() as f32);
        floaters.rotations[i] = [0; 4].map(|_| random.within(-1.0, 1.0) as f32);
        let opacity = random.within(0.27, 0.95);
        floaters.opacity_logits[i] = (opacity / (1.0 - opacity)).ln() as f32;
        floaters.sh[0][3 * i..3 * i + 3].fill_with(|| random.within(-1.7, 1.7) as f32);
    }
    floaters
}

fn median_depth(model: &Gaussians, camera: &Camera) -> f64 {
    let depth = |m: &[f32; 3]| (camera.rotation * DVec3::from(m.map(f64::from)) + camera.translation).z;
    let mut depths: Vec<f64> = model.means.iter().map(depth).filter(|depth| *depth > 0.0).collect();
    depths.sort_by(f64::total_cmp);
    depths[depths.len() / 2]
}
