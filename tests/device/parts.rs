//! Pictures drawn in parts, from the Gaussians that each part may show: the same bits as the whole.

use super::rasterise::render as whole;
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish, opened};
use bytemuck::cast_slice;
use glam::{DVec2, DVec3};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Buffer, Device, Error, Limits, Recording};
use qirf_vk::render::{Beside, Image, Painter, Parts, Renderer, Settings, Source, Style, Uses, capacity, visible};
use qirf_vk::response::{self, CHUNK, HighPass, Responses, Term, Views, Wanted, full_pass};
use qirf_vk::scene::camera::Camera;

/// A cloud of `n` Gaussians around the origin: most of them small, some needles, some that fill a picture.
fn cloud(n: usize, seed: u64) -> Gaussians {
    let mut random = Random(seed);
    let mut model = Gaussians::zeroed(n, 1);
    for i in 0..n {
        model.means[i] = [0; 3].map(|_| random.within(-2.0, 2.0) as f32);
        let size = if i % 50 == 0 { 1.5 } else { 0.04 };
        model.log_scales[i] = [0; 3].map(|_| (size * random.within(0.1, 1.0)).ln() as f32);
        if i % 7 == 0 {
            model.log_scales[i][1] += 2.5;
        }
        model.rotations[i] = [0; 4].map(|_| random.within(-1.0, 1.0) as f32);
        model.opacity_logits[i] = random.within(-3.0, 3.0) as f32;
    }
    for value in model.sh.iter_mut().flatten() {
        *value = random.within(-0.5, 0.5) as f32;
    }
    model
}

/// Cameras outside the cloud, within it, and close to one of its needles.
fn cameras() -> Vec<Camera> {
    let look = |eye: [f64; 3], at: [f64; 3], fov, size: [u32; 2]| {
        Camera::look_at(DVec3::from(eye), DVec3::from(at), DVec3::NEG_Y, fov, size[0], size[1])
    };
    let mut aside = look([0.2, 0.1, -0.3], [1.0, 0.3, 1.0], 0.8, [173, 99]);
    aside.principal.x += 400.0;
    vec![
        look([0.5, -0.7, -6.0], [0.0; 3], 0.9, [173, 99]),
        look([0.1, 0.2, -0.3], [1.0, 0.5, 0.2], 1.2, [64, 130]),
        look([-1.9, 1.9, 1.9], [0.0, 2.5, -1.0], 0.3, [40, 8]),
        aside,
    ]
}

fn same(a: &Image, b: &Image) -> bool {
    let bits = |image: &Image| image.pixels.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
    (a.width, a.height) == (b.width, b.height) && bits(a) == bits(b)
}

#[test]
fn parts_have_the_pixels_of_the_whole() {
    let device = device();
    let model = cloud(2000, 3);
    let styles = [
        Style::default(),
        Style { antialias: true, ..Style::default() },
        Style { depth_order: true, ..Style::default() },
    ];
    let mut several = 0;
    for style in styles {
        let settings = style.over([0.1, 0.2, 0.3]);
        for (c, camera) in cameras().iter().enumerate() {
            let right = whole(&device, &model, camera, settings);
            assert!(right.pixels.iter().any(|p| p[3] > 0.1), "camera {c} sees the cloud");
            for most in [150, 400, 2000] {
                let mut renderer = Renderer::new(&device, settings, most, 8, 8).unwrap();
                let mut parts = Parts::new(&model, most);
                let image = match parts.render(&mut renderer, camera) {
                    Ok(image) => image,
                    // A single tile may show more than the smallest limit.
                    Err(Error::TooLarge { .. }) if most == 150 => continue,
                    Err(error) => panic!("{error}"),
                };
                println!("{style:?}, camera {c}, at most {most}: {} parts", parts.drawn);
                assert!(same(&image, &right), "{style:?}, camera {c}, at most {most}");
                assert!(parts.drawn == 1 || most < 2000);
                several += u32::from(parts.drawn > 1);
            }
        }
    }
    assert!(several > 9, "{several}");
    finish(&device);
}

/// Part of a photo, with a camera of its own whose principal point lies outside, as crops and faces of fisheyes have.
#[test]
fn crops_have_the_pixels_of_the_whole() {
    let device = device();
    let mut model = cloud(2000, 3);
    model.log_scales.iter_mut().flatten().for_each(|s| *s = s.min(-3.0));
    let camera = &cameras()[0];
    for settings in [Settings::default(), Style { antialias: true, ..Style::default() }.over([0.1, 0.2, 0.3])] {
        let right = whole(&device, &model, camera, settings);
        for corner in [[0, 0], [109, 35], [60, 20]] {
            let mut crop = Camera { width: 64, height: 64, ..camera.clone() };
            crop.principal -= DVec2::new(f64::from(corner[0]), f64::from(corner[1]));
            let image = whole(&device, &model, &crop, settings);
            let pixel = |k: usize| {
                let (x, y) = (k as u32 % 64 + corner[0], k as u32 / 64 + corner[1]);
                right.pixels[(y * right.width + x) as usize]
            };
            let apart = |k: usize| (0..4).map(|c| (image.pixels[k][c] - pixel(k)[c]).abs()).fold(0.0, f32::max);
            let most = (0..image.pixels.len()).map(apart).fold(0.0, f32::max);
            // With slopes clamped about the axis it was 0.2.
            assert!(most < 1e-4, "the crop at {corner:?} is {most} off");
        }
    }
    finish(&device);
}

#[test]
fn what_a_picture_may_show_is_few_and_enough() {
    let device = device();
    let (model, settings) = (cloud(2000, 8), Settings::default());
    let all: Vec<u32> = (0..2000).collect();
    let mut random = Random(5);
    let mut shares = Vec::new();
    for _ in 0..12 {
        let mut place = || DVec3::from([0; 3].map(|_| random.within(-3.0, 3.0)));
        let camera = Camera::look_at(place(), place(), DVec3::NEG_Y, 0.7, 50, 40);
        let members = visible(&model, &all, &camera, &settings);
        let picked: Vec<usize> = members.iter().map(|i| *i as usize).collect();
        let right = whole(&device, &model, &camera, settings);
        let drawn =
            if picked.is_empty() { None } else { Some(whole(&device, &model.select(&picked), &camera, settings)) };
        assert!(drawn.is_none_or(|drawn| same(&drawn, &right)));
        shares.push(members.len() as f64 / 2000.0);
    }
    println!("shares of the cloud: {shares:.2?}");
    assert!(shares.iter().any(|s| *s < 0.2) && shares.iter().all(|s| *s < 0.9));
    finish(&device);
}

/// NaN values are left to the kernels: such Gaussians are never left out.
#[test]
fn odd_gaussians_are_kept() {
    let camera = small_camera(48, 32);
    let mut model = narrowed(&random_scene(&camera, 2));
    model.means[0][1] = f32::NAN;
    model.means[1][0] = f32::INFINITY;
    model.log_scales[2][2] = f32::INFINITY;
    model.log_scales[3][0] = f32::NAN;
    let all: Vec<u32> = (0..model.len() as u32).collect();
    let members = visible(&model, &all, &camera, &Settings::default());
    assert!([0, 1, 2].iter().all(|i| members.contains(i)), "{members:?}");
}

/// A device whose largest buffer has `bytes` bytes.
fn small(bytes: u64) -> Device {
    let limits = Limits { buffer_bytes: bytes, ..Limits::NONE };
    opened(|options| options.harness.limits = Some(limits))
}

/// The largest buffer can hold a tenth of the model.
#[test]
fn models_larger_than_the_device_are_drawn() {
    let model = cloud(20_000, 4);
    let camera = &cameras()[1];
    let right = {
        let device = device();
        let image = whole(&device, &model, camera, Settings::default());
        finish(&device);
        image
    };
    let device = small(128 << 10);
    assert!(matches!(Resident::upload(&device, &model), Err(Error::TooLarge { .. })));
    let size = [camera.width, camera.height];
    let most = capacity(&device, 1, size, Uses::default(), Beside::default());
    assert!((2000..model.len() / 2).contains(&most), "{most}");
    let mut painter = Painter::of(&device, Settings::default(), Source::Host(&model), size).unwrap();
    assert!(same(&painter.render(Source::Host(&model), camera).unwrap(), &right));
    finish(&device);
}

/// Responses and scores of a model on the host, or on the device, over more views than one chunk.
fn evidence(device: &Device, model: &Gaussians, wanted: Wanted, on_host: bool) -> Responses {
    let cameras: Vec<Camera> = (0..CHUNK + 3)
        .map(|v| {
            let turn = 0.7 * v as f64;
            let eye = DVec3::new(turn.sin(), 0.1, turn.cos()) * if v % 2 == 0 { 1.5 } else { 5.0 };
            Camera::look_at(eye, DVec3::new(0.3, 0.1, 0.0), DVec3::NEG_Y, 0.6, 90, 70)
        })
        .collect();
    let settings = Settings::default();
    let resident = (!on_host).then(|| Resident::upload(device, model).unwrap());
    let source = resident.as_ref().map_or(Source::Host(model), Source::Device);
    let mut renderer = response::renderer(device, settings, source, [90, 70], 1 << 14, wanted).unwrap();
    let pixels = wanted.gradient_pixels([90, 70]);
    let (gradient, high_pass) =
        (device.buffer("image gradient", pixels).unwrap(), HighPass::new(device, pixels).unwrap());
    let loss = |r: &mut Recording, _: usize, image: &Buffer<[f32; 4]>, _: Term| -> Result<(), Error> {
        high_pass.record(r, image, &gradient, [90, 70]);
        Ok(())
    };
    let views = Views { cameras: &cameras, follow: |_| Ok(()), of: None };
    full_pass(&mut renderer, source, views, &gradient, wanted, loss).unwrap()
}

#[test]
fn responses_of_models_larger_than_the_device_have_the_same_bits() {
    let model = cloud(3000, 6);
    let bits = |r: &Responses| {
        let scores: &[f32] = cast_slice(&r.scores);
        r.channels.as_flattened().iter().chain(scores).map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    // Scores are computed part by part; gradients need everything that a view shows.
    for (wanted, bytes) in [(Wanted::SCORES, 64 << 10), (Wanted::BOTH, 210_000)] {
        let right = {
            let device = device();
            let right = evidence(&device, &model, wanted, false);
            finish(&device);
            right
        };
        assert!(bits(&right).iter().any(|b| *b != 0));
        let device = small(bytes);
        let tight = evidence(&device, &model, wanted, true);
        assert_eq!(bits(&tight), bits(&right), "{wanted:?}");
        assert!(tight.cameras == right.cameras && tight.dilation == right.dilation);
        finish(&device);
    }
}
