//! The forward pass on the device, against golden pictures and the float64 twin.

use crate::support::golden::Case;
use crate::support::{Random, device, finish, greatest_difference};
use glam::{DVec2, DVec3};
use qirf_vk::gaussians::{Gaussians, resident::Resident};
use qirf_vk::gpu::Device;
use qirf_vk::kernels::constants::blending::float64::ALPHA_MIN;
use qirf_vk::reference::bin::{bin, depth_order};
use qirf_vk::reference::rasterise::{rasterise, sample};
use qirf_vk::reference::{self, Rendered};
use qirf_vk::render::{Image, Renderer, Settings};
use qirf_vk::scene::camera::Camera;

/// Renders one picture with its own renderer.
pub(crate) fn render(device: &Device, model: &Gaussians, camera: &Camera, settings: Settings) -> Image {
    let resident = Resident::upload(device, model).unwrap();
    let mut renderer = Renderer::new(device, settings, model.len(), camera.width, camera.height).unwrap();
    renderer.render(&resident, camera).unwrap()
}

/// Largest error of float32 against the twin at a pixel: 1e-5 for blending, and the rounding of positions, by which
/// alpha changes by at most 1.1 per pixel (a Gaussian no wider than the dilation) and a colour of up to 2 by twice
/// that. Positions are rounded relative to their distance from the picture's middle, and rays relative to 1, which is a
/// focal length in pixels.
fn allowed(camera: &Camera, [x, y]: [u32; 2]) -> f64 {
    let from = |at: u32, size: u32| (f64::from(at) - f64::from(size / 2)).abs();
    1e-5 + 2.2 * 2_f64.powi(-24) * (from(x, camera.width) + from(y, camera.height) + camera.focal.max_element())
}

/// Additional error allowed at a pixel because one of the twin's contributions is so near 1/255, or a transmittance so
/// near the stop, that float32 may decide differently.
fn undecided(twin: &Rendered, camera: &Camera, settings: &reference::Settings, [x, y]: [u32; 2]) -> f64 {
    let all = reference::Settings { smooth_cutoff: true, ..settings.clone() };
    // Positions as above, six times steeper: the logarithm of alpha where it falls to 1/255.
    let near = |ratio: f64| ratio.ln().abs() < 1e-5 + 6.0 * allowed(camera, [x, y]);
    let (mut t, mut slack) = (1.0, 0.0);
    for i in depth_order(&twin.projected) {
        let Ok(p) = &twin.projected[i as usize] else { continue };
        let Some(s) = sample(p, x, y, &all) else { continue };
        let (drawn, worth) = (s.alpha >= ALPHA_MIN, 2.0 * p.colour.max_element().max(1.0));
        if near(s.alpha / ALPHA_MIN) {
            slack += t * s.alpha * worth;
        }
        if drawn && near(t * (1.0 - s.alpha) / settings.transmittance_stop) {
            slack += t * s.alpha * worth;
        }
        if drawn && t * (1.0 - s.alpha) < settings.transmittance_stop {
            break;
        }
        t *= if drawn { 1.0 - s.alpha } else { 1.0 };
    }
    slack
}

/// Fails if a pixel's error is neither within [`allowed`] nor that of a contribution that is [`undecided`]. Returns the
/// largest error among the decided pixels, and the number of undecided ones.
fn decided(
    name: &str,
    image: &Image,
    expected: &[[f64; 3]],
    twin: &Rendered,
    camera: &Camera,
    settings: &reference::Settings,
) -> (f64, usize) {
    let (mut largest, mut exempt) = (0_f64, 0);
    for (n, (got, right)) in image.pixels.iter().zip(expected).enumerate() {
        let error = (0..3).fold(0.0, |m: f64, c| m.max((f64::from(got[c]) - right[c]).abs()));
        let at = [n as u32 % camera.width, n as u32 / camera.width];
        let allowed = allowed(camera, at);
        if error <= allowed {
            largest = largest.max(error);
            continue;
        }
        let slack = undecided(twin, camera, settings, at);
        assert!(error <= allowed + slack, "{name}, pixel {at:?}: {error:.2e} > {allowed:.2e} + {slack:.2e}");
        exempt += 1;
    }
    (largest, exempt)
}

/// Mean error, share beyond 1e-4, largest error.
fn errors(got: impl Iterator<Item = f32>, expected: &[f64]) -> (f64, f64, f64) {
    let (mut sum, mut beyond, mut largest, mut n) = (0.0, 0, 0_f64, 0);
    for (g, e) in got.zip(expected) {
        let error = (f64::from(g) - e).abs();
        sum += error;
        beyond += usize::from(error > 1e-4);
        largest = largest.max(error);
        n += 1;
    }
    assert_eq!(n, expected.len());
    (sum / n as f64, beyond as f64 / n as f64, largest)
}

#[test]
fn golden_pictures() {
    let device = device();
    for case in Case::all() {
        let settings = case.device_settings();
        for (v, camera) in case.views.iter().enumerate() {
            let image = render(&device, &case.model, camera, settings);
            let rgb = image.pixels.iter().flat_map(|p| p[..3].to_vec());
            let alpha = image.pixels.iter().map(|p| p[3]);
            for (what, (mean, share, largest)) in [
                ("image", errors(rgb, &case.expected_view("images", v))),
                ("alpha", errors(alpha, &case.expected_view("alphas", v))),
            ] {
                println!(
                    "{} view {v} {what}: mean {mean:.2e}, beyond 1e-4 {share:.1e}, largest {largest:.1e}",
                    case.name
                );
                // A contribution that float32 puts on the other side of 1/255 moves a pixel by up to 4e-3; nothing else
                // may.
                assert!(mean < 5e-6 && share <= 3e-4 && largest < 8e-3, "{} view {v} {what}", case.name);
            }
            let name = format!("{} view {v}", case.name);
            let twin = reference::render(&reference::Params::from(&case.model), camera, &case.settings);
            let golden = case.expected_view("images", v);
            let golden: Vec<[f64; 3]> = golden.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
            let (largest, exempt) = decided(&name, &image, &golden, &twin, camera, &case.settings);
            println!("{name}: {largest:.1e} but for {exempt} undecided");
            assert!(exempt <= 2, "{name}");
        }
    }
    finish(&device);
}

/// Gaussians of many shapes: needles, discs and dust before a camera, some behind it, some covering the picture.
fn crowd(n: usize, seed: u64) -> Gaussians {
    let mut r = Random(seed);
    let mut model = Gaussians { sh: vec![Vec::new(), Vec::new()], ..Gaussians::default() };
    for i in 0..n {
        let size = if i % 97 == 0 { 1.0 } else { -2.5 };
        model.means.push([0, 1, 2].map(|_| r.within(-2.0, 2.0) as f32));
        model.log_scales.push([0, 1, 2].map(|_| (r.within(-4.0, 1.0) + size) as f32));
        model.rotations.push([0, 1, 2, 3].map(|_| r.within(-1.0, 1.0) as f32));
        model.opacity_logits.push(r.within(-6.0, 6.0) as f32);
        model.sh[0].extend([0, 1, 2].map(|_| r.within(-1.0, 2.0) as f32));
        model.sh[1].extend([0; 9].map(|_| r.within(-0.3, 0.3) as f32));
    }
    model
}

fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(0.5, -0.7, -3.0), DVec3::ZERO, DVec3::NEG_Y, 0.9, width, height)
}

/// The counts of blended Gaussians: for a stack all, for opaque layers those before the stop, for a crowd the twin's.
#[test]
fn pixels_count_what_they_blend() {
    let device = device();
    let settings = reference::Settings::default();
    let counts = |model: &Gaussians, camera: &Camera| -> (Vec<u32>, Vec<u32>) {
        let resident = Resident::upload(&device, model).unwrap();
        let mut renderer = Renderer::new(&device, Settings::default(), model.len(), 8, 8).unwrap();
        let before = renderer.render(&resident, camera).unwrap();
        let counted = renderer.count_blended(&resident, camera).unwrap();
        assert_eq!(renderer.render(&resident, camera).unwrap(), before, "counting leaves no trace");
        (counted, reference::render(&reference::Params::from(model), camera, &settings).composite.blended)
    };
    let straight = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.1, 8, 8);
    for (logit, expected) in [(-2.0, 20), (20.0, 1)] {
        let means = (0..20).map(|i| [0.0, 0.0, 2.0 + 0.1 * i as f32]).collect();
        let stack = Gaussians { sh: vec![vec![0.5; 60]], ..Gaussians::balls(means, 0.0, logit, 0) };
        let (counted, twin) = counts(&stack, &straight);
        assert_eq!((&counted, counted[0]), (&twin, expected), "layers of logit {logit}");
    }
    for (width, height) in [(1, 1), (17, 3), (90, 61)] {
        let (counted, twin) = counts(&crowd(400, 5), &camera(width, height));
        // A contribution so near 1/255 that float32 decides differently changes the count by one.
        let apart: Vec<u32> = counted.iter().zip(&twin).map(|(a, b)| a.abs_diff(*b)).filter(|d| *d > 0).collect();
        println!(
            "{width}x{height}: {} of {} pixels apart, up to {} blended",
            apart.len(),
            twin.len(),
            twin.iter().max().unwrap()
        );
        assert!(apart.len() <= 2 && apart.iter().all(|d| *d == 1), "{width}x{height}: {apart:?}");
        assert!(width < 10 || counted.iter().max() > counted.iter().min(), "{width}x{height}");
    }
    finish(&device);
}

/// Buffers still contain results of a view with more Gaussians behind the count of the next one.
#[test]
fn a_view_of_fewer_gaussians_follows_one_of_more() {
    let device = device();
    let (model, most) = (crowd(1000, 11), camera(64, 48));
    // A camera that sees the Gaussians nearest to the other camera.
    let few = Camera::look_at(DVec3::ZERO, DVec3::new(0.0, 0.0, -3.0), DVec3::NEG_Y, 0.9, 64, 48);
    let drawn = |camera| {
        let settings = reference::Settings::default();
        reference::render(&reference::Params::from(&model), camera, &settings).projected.iter().flatten().count()
    };
    assert!(drawn(&few) > 50 && drawn(&most) > 2 * drawn(&few), "{} and {}", drawn(&few), drawn(&most));
    let resident = Resident::upload(&device, &model).unwrap();
    let renderer = || Renderer::new(&device, Settings::default(), model.len(), 64, 48).unwrap();
    let mut used = renderer();
    used.render(&resident, &most).unwrap();
    assert_eq!(used.render(&resident, &few).unwrap(), renderer().render(&resident, &few).unwrap());
    drop((used, resident));
    finish(&device);
}

#[test]
fn the_twin_agrees_at_any_size() {
    let device = device();
    let model = crowd(400, 5);
    let params = reference::Params::from(&model);
    for (width, height) in [(1, 1), (17, 3), (90, 61), (4096, 16), (1_048_592, 1)] {
        let camera = camera(width, height);
        // The widest has more tiles of 16, let alone of 8, than a dispatch has groups in one dimension.
        let image = render(&device, &model, &camera, Settings::default());
        let settings = reference::Settings::default();
        let twin = reference::render(&params, &camera, &settings);
        let name = format!("{width}x{height}");
        let (largest, exempt) = decided(&name, &image, &twin.composite.image, &twin, &camera, &settings);
        println!("{name}: largest {largest:.1e}, undecided {exempt}");
        assert!(exempt <= 2, "{name}");
        assert!(width < 10 || image.pixels.iter().filter(|p| p[3] > 0.0).count() >= 7, "{name}: something is drawn");

        // The error if positions were relative to the picture's corner: they round to 1/16 pixel in the middle of the
        // widest.
        let mut from_the_corner = twin.projected.clone();
        for p in from_the_corner.iter_mut().flatten() {
            p.mean = p.mean.as_vec2().as_dvec2();
        }
        let tiles = bin(&from_the_corner, &camera, &settings);
        let drawn = rasterise(&from_the_corner, &tiles, &camera, &settings).image;
        let naive = greatest_difference(drawn.as_flattened(), twin.composite.image.as_flattened());
        println!("{name}: largest {naive:.1e} with positions from the corner");
        assert!(width < 1_000_000 || naive > 1e-3, "an origin in the middle is no longer needed");
    }
    finish(&device);
}

/// Far away, float32 resolves positions to a thousandth of a unit; the camera's centre lies between two float32 values,
/// and is not rounded to one.
#[test]
fn far_from_the_origin() {
    let device = device();
    let away = DVec3::new(10_000.123, -4_321.77, 8_765.4);
    let mut model = crowd(400, 5);
    for mean in &mut model.means {
        *mean = (DVec3::from(mean.map(f64::from)) + away).as_vec3().to_array();
    }
    let mut camera = camera(320, 200);
    camera.translation -= camera.rotation * away;
    let image = render(&device, &model, &camera, Settings::default());
    let settings = reference::Settings::default();
    let twin = reference::render(&reference::Params::from(&model), &camera, &settings);
    let (largest, exempt) = decided("far", &image, &twin.composite.image, &twin, &camera, &settings);
    println!("far from the origin: largest {largest:.1e}, undecided {exempt}");
    assert!(exempt <= 2 && image.pixels.iter().any(|p| p[3] > 0.5));

    // The result for a centre stored in a single float32.
    let mut rounded = camera.clone();
    rounded.translation = -(rounded.rotation * camera.centre().as_vec3().as_dvec3());
    let naive = reference::render(&reference::Params::from(&model), &rounded, &settings).composite.image;
    let naive = greatest_difference(naive.as_flattened(), twin.composite.image.as_flattened());
    println!("far from the origin: largest {naive:.1e} with the centre rounded");
    assert!(naive > 10.0 * largest);
    finish(&device);
}

/// Gaussians as small as the dilation all over pictures of any width: they suffer most from rounded positions, and are
/// lost first if rounded bounds leave out tiles.
#[test]
fn dust_all_over_wide_pictures() {
    let device = device();
    for (width, height) in [(512, 64), (1920, 64), (4096, 64), (16_384, 64), (64, 16_384)] {
        let ratio = f64::from(height) / f64::from(width);
        let fov = 2.0 * (0.577 * ratio.min(1.0)).atan(); // 60 degrees along the longer side
        let mut camera = Camera::look_at(DVec3::new(0.5, -0.7, -3.0), DVec3::ZERO, DVec3::NEG_Y, fov, width, height);
        camera.principal += DVec2::new(0.37, -0.61);
        let mut r = Random(3);
        let mut mean = || {
            let z = r.within(2.0, 6.0);
            let pixel = DVec2::new(r.within(0.0, width.into()), r.within(0.0, height.into()));
            let ray = ((pixel - camera.principal) / camera.focal).extend(1.0);
            (camera.rotation.transpose() * (ray * z - camera.translation)).as_vec3().to_array()
        };
        let means = (0..2000).map(|_| mean()).collect();
        let model = Gaussians { sh: vec![vec![1.0; 3 * 2000]], ..Gaussians::balls(means, -16.0, 3.0, 0) };
        let image = render(&device, &model, &camera, Settings::default());
        let settings = reference::Settings::default();
        let twin = reference::render(&reference::Params::from(&model), &camera, &settings);
        let name = format!("dust {width}x{height}");
        let (largest, exempt) = decided(&name, &image, &twin.composite.image, &twin, &camera, &settings);
        println!("{name}: largest {largest:.1e}, undecided {exempt}");
        assert!(exempt <= 60 && image.pixels.iter().filter(|p| p[3] > 0.5).count() > 500, "{name}: {exempt}");
    }
    finish(&device);
}

#[test]
fn hard_gaussians_stay_finite() {
    hard_gaussians(&device());
}

pub fn hard_gaussians(device: &Device) {
    let mut model = Gaussians { sh: vec![Vec::new()], ..Gaussians::default() };
    let mut add = |mean: [f32; 3], log_scale: [f32; 3], rotation: [f32; 4], logit: f32| {
        model.means.push(mean);
        model.log_scales.push(log_scale);
        model.rotations.push(rotation);
        model.opacity_logits.push(logit);
        model.sh[0].extend([1.0, 0.5, 0.0]);
    };
    let upright = [1.0, 0.0, 0.0, 0.0];
    for z in [-5.0, 0.0, 0.199, 0.2, 0.2000001, 0.21, 1e6] {
        add([0.0, 0.0, z], [-3.0; 3], upright, 1.0);
    }
    for s in [-30.0, -13.8, 0.0, 10.0, 20.0, 60.0] {
        add([0.1, 0.1, 3.0], [s; 3], upright, -2.0);
        add([0.1, 0.1, 3.0], [s, -13.8, -2.0], [0.3, 0.5, -0.2, 0.1], -2.0);
    }
    for q in [[0.0; 4], [1e-20; 4], [1e20; 4], [-1.0, 0.0, 0.0, 0.0], [1e-7, 0.0, 0.0, 0.0], [f32::MAX, 0.0, 0.0, 1.0]]
    {
        add([0.0, 0.0, 2.0], [-2.0; 3], q, 0.0);
    }
    for logit in [f32::NEG_INFINITY, f32::INFINITY, 40.0, -40.0, f32::NAN] {
        add([0.0, 0.1, 2.0], [-2.0; 3], upright, logit);
    }
    for mean in [[f32::NAN, 0.0, 2.0], [f32::INFINITY, 0.0, 2.0], [0.0, 0.0, f32::INFINITY], [1e30, 0.0, 2.0]] {
        add(mean, [-2.0; 3], upright, 1.0);
    }
    let image = render(device, &model, &qirf_vk::selftest::project::ahead(), Settings::default());
    assert!(image.pixels.as_flattened().iter().all(|v| v.is_finite()));
    assert!(image.pixels.iter().all(|p| (0.0..=1.0).contains(&p[3])));
    finish(device);
}

#[test]
fn an_empty_model_shows_the_background() {
    let device = device();
    let empty = Gaussians { sh: vec![Vec::new()], ..Gaussians::default() };
    let settings = Settings { background: [0.25, 0.5, 0.75], ..Settings::default() };
    let image = render(&device, &empty, &camera(20, 10), settings);
    assert!(image.pixels.iter().all(|p| *p == [0.25, 0.5, 0.75, 0.0]));
    finish(&device);
}
