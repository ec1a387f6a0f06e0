//! Culling saves pairs of a real model. Gaussians with many tiles are binned like others.

#[path = "../../benches/engine/flowers.rs"]
mod flowers;
#[path = "../../benches/training/imbalance.rs"]
mod imbalance;

use crate::support::{Random, device, finish, opened, shared};
use glam::DVec3;
use imbalance::{Distribution, Imbalance, steps};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gaussians::{Gaussians, formats};
use qirf_vk::gpu::{Groups, Recording};
use qirf_vk::kernels::render::{Bin, BinSpec};
use qirf_vk::primitives::WORKGROUP;
use qirf_vk::render::{Culling, LEAST_PAIRS, Renderer, Settings, Style, TrainingRenderer};
use qirf_vk::scene::camera::Camera;

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

/// Needles and discs from a pixel to the whole picture, more of them than a workgroup takes, half of them before the
/// camera.
pub fn crowd_of_all_sizes() -> Gaussians {
    let (mut r, n) = (Random(5), 600);
    let mut within = |low: f64, high: f64| (low + (high - low) * r.unit()) as f32;
    Gaussians {
        means: (0..n).map(|_| [within(-2.0, 2.0), within(-1.5, 1.5), within(-5.0, 3.0)]).collect(),
        log_scales: (0..n).map(|_| [within(-5.0, 0.5), within(-5.0, 0.5), within(-5.0, 0.5)]).collect(),
        rotations: (0..n)
            .map(|_| [within(-1.0, 1.0), within(-1.0, 1.0), within(-1.0, 1.0), within(-1.0, 1.0)])
            .collect(),
        opacity_logits: (0..n).map(|_| within(-4.0, 1.0)).collect(),
        sh: vec![(0..3 * n).map(|_| within(-1.0, 1.0)).collect()],
    }
}

/// Checked against the twin's lists. The counts explain times on devices whose lanes wait for one another.
#[test]
fn the_imbalance_of_a_picture_is_counted() {
    let model = crowd_of_all_sizes();
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, 333, 210);
    let settings = qirf_vk::reference::Settings::default();
    let twin = qirf_vk::reference::render(&qirf_vk::reference::Params::from(&model), &camera, &settings);
    let device = opened(|options| options.tuning = Some("gpu".parse().unwrap()));
    let resident = Resident::upload(&device, &model).unwrap();
    let size = [camera.width, camera.height];
    let mut renderer = TrainingRenderer::new(&device, Settings::default(), model.len(), size, LEAST_PAIRS).unwrap();
    renderer.render(&resident, &camera).unwrap();
    let counted = Imbalance::of(&device, &renderer.slots(&camera)).unwrap();
    println!("{counted:?}");
    let lists: Vec<usize> = (0..twin.tiles.offsets.len() - 1).map(|t| twin.tiles.list(t).len()).collect();
    let mut slots = vec![0; model.len()];
    (0..lists.len()).flat_map(|t| twin.tiles.list(t)).for_each(|i| slots[*i as usize] += 1);
    let (pairs, longest) = (lists.iter().sum::<usize>() as u64, lists.iter().max().copied().unwrap() as u32);
    // Float32 may list a Gaussian in a tile where its alpha stays below 1/255.
    let near = |got: u64, right: u64| got >= right && got <= right + right / 100;
    assert!(near(counted.tile.sum, pairs) && counted.gaussian.sum == counted.tile.sum, "{pairs} pairs");
    assert!(near(counted.tile.most.into(), longest.into()), "{longest} in the longest list");
    assert!(near(counted.gaussian.most.into(), slots.iter().max().copied().unwrap()));
    assert!(near(counted.gaussian.count, slots.iter().filter(|slots| **slots > 0).count() as u64));
    // No order has fewer steps than pairs.
    assert!(counted.project_backward_steps >= counted.gaussian.sum && counted.bin_steps >= counted.gaussian.sum);
    finish(&device);
}

#[test]
fn steps_and_distributions() {
    let mut slots = vec![1; 64];
    (slots[3], slots[40]) = (20, 100);
    assert_eq!(steps(&slots, 0), 32 * (20 + 100));
    assert_eq!(steps(&slots, 32), 32 * (20 + 1 + 4));
    let expected = Distribution { count: 4, sum: 110, p50: 3, p99: 4, most: 100 };
    assert_eq!(Distribution::of([0, 100, 3, 0, 4, 3].into_iter()), expected);
    assert_eq!(Distribution::of([0].into_iter()), Distribution::default());
}

/// Where counting found more tiles than binning does, as compilers may round differently, no gradient reads what nobody wrote:
/// the counts become what was listed.
#[test]
fn surplus_slots_are_taken_off_the_counts() {
    let model = crowd_of_all_sizes();
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, 333, 210);
    for many in [0, 7] {
        let device = opened(|options| options.tuning = Some(format!("gpu,bin_many={many}").parse().unwrap()));
        let resident = Resident::upload(&device, &model).unwrap();
        let size = [camera.width, camera.height];
        let mut renderer = TrainingRenderer::new(&device, Settings::default(), model.len(), size, LEAST_PAIRS).unwrap();
        renderer.render(&resident, &camera).unwrap();
        let slots = renderer.slots(&camera);
        let listed = slots.tile_counts.read_first(&device, model.len()).unwrap();
        // A surplus of 0 to 8 slots each.
        let counted: Vec<u32> =
            listed.iter().enumerate().map(|(i, n)| if *n > 0 { n + i as u32 % 9 } else { 0 }).collect();
        let order: Vec<u32> = (0..model.len() as u32).filter(|i| listed[*i as usize] > 0).collect();
        let ends: Vec<u32> = order.iter().scan(0, |end, i| (*end += counted[*i as usize], Some(*end)).1).collect();
        let offsets: Vec<u32> = order.iter().zip(&ends).map(|(i, end)| end - counted[*i as usize]).collect();
        let pairs = ends[ends.len() - 1];
        let tile_counts = device.upload("counts", &counted).unwrap();
        let words = |name| device.buffer::<u32>(name, pairs as usize).unwrap();
        let kernel = Bin {
            view: slots.view,
            count: &device.upload("visible", &[order.len() as u32]).unwrap(),
            pairs: &device.upload("pairs", &[pairs]).unwrap(),
            order: &device.upload("order", &order).unwrap(),
            offsets: &device.upload("offsets", &offsets).unwrap(),
            tile_counts: &tile_counts,
            geometry: slots.geometry,
            shape: slots.shape,
            keys: &words("keys"),
            slots: &words("slots"),
            owners: &words("owners"),
            first_slots: &device.buffer("first slots", model.len()).unwrap(),
            depths: &words("depths"),
            means: &resident.parameters.means,
            log_scales: &resident.parameters.log_scales,
            rotations: &resident.quaternions(),
            spec: BinSpec {
                workgroup: WORKGROUP,
                tile: slots.tile,
                culling: Culling::Exact as u32,
                depth_order: false,
                many,
            },
        };
        let mut recording = Recording::new();
        recording.dispatch(&kernel, Groups::Count((order.len() as u32).div_ceil(WORKGROUP)));
        device.run(recording).unwrap();
        assert!(tile_counts.read(&device).unwrap() == listed, "{many}");
        finish(&device);
    }
}

#[test]
fn subgroups_bin_what_invocations_would() {
    let model = crowd_of_all_sizes();
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, 333, 210);
    let [alone, others @ ..] = [0, 1, 7, 32].map(|many| {
        let tuning = Some(format!("gpu,bin_many={many}").parse().unwrap());
        let device = opened(|options| options.tuning = tuning);
        let resident = Resident::upload(&device, &model).unwrap();
        let drawn = [false, true].map(|depth_order| {
            let style = Style { depth_order, ..Style::default() };
            let settings = Settings { style, ..Settings::default() };
            let mut renderer = Renderer::new(&device, settings, model.len(), camera.width, camera.height).unwrap();
            (renderer.render(&resident, &camera).unwrap(), renderer.pairs().unwrap())
        });
        finish(&device);
        drawn
    });
    for (image, pairs) in &alone {
        assert!(*pairs > 15_000 && image.pixels.iter().any(|p| p[3] > 0.5), "{pairs} pairs");
    }
    for (k, other) in others.iter().enumerate() {
        assert!(*other == alone, "{k}: {} and {} pairs of {} and {}", other[0].1, other[1].1, alone[0].1, alone[1].1);
    }
}
