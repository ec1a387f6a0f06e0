//! Depth order by tile: two intersecting discs, for which no single order of the whole picture is right.

use crate::support::runs::config;
use crate::support::{device, finish, new_device};
use glam::{DQuat, DVec3};
use qirf_vk::effects::{Choice, Effect};
use qirf_vk::gaussians::{Gaussians, resident::Resident};
use qirf_vk::gpu::Device;
use qirf_vk::job::{Output, RunConfig, Session};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::run;
use qirf_vk::reference::{self, Params};
use qirf_vk::render::{Image, Renderer, Style};
use qirf_vk::scene::camera::Camera;
use qirf_vk::synth::{SynthOptions, write};

const SIZE: [u32; 2] = [100, 64];

/// A red and a blue disc that cross like the leaves of a revolving door; the distances of their middles differ by less
/// than 1 part in 1000.
fn crossed() -> Gaussians {
    let mut model = Gaussians::zeroed(2, 0);
    for (i, turn) in [0.7, -0.7].into_iter().enumerate() {
        let q = DQuat::from_rotation_y(turn);
        model.means[i] = [0.0, 0.0, 0.004 * i as f32];
        model.log_scales[i] = [0.0, 0.0, -6.0];
        model.rotations[i] = [q.w, q.x, q.y, q.z].map(|v| v as f32);
        model.opacity_logits[i] = 4.0;
        model.sh[0][3 * i..3 * i + 3].copy_from_slice(if i == 0 { &[1.7, -1.7, -1.7] } else { &[-1.7, -1.7, 1.7] });
    }
    model
}

/// A camera straight ahead, turned by an angle.
fn camera(turn: f64) -> Camera {
    let eye = DQuat::from_rotation_y(turn) * DVec3::new(0.0, 0.0, -4.0);
    Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 0.8, SIZE[0], SIZE[1])
}

fn draw(device: &Device, model: &Gaussians, camera: &Camera, depth_order: bool) -> (Image, Vec<String>, u32) {
    let resident = Resident::upload(device, model).unwrap();
    let settings = Style { depth_order, ..Style::default() }.over([0.0; 3]);
    let mut renderer = Renderer::new(device, settings, 2, camera.width, camera.height).unwrap();
    let (image, timings, _) = renderer.render_timed(&resident, camera).unwrap();
    (image, timings.iter().map(|(name, ..)| name.to_owned()).collect(), renderer.tile())
}

/// Mean absolute difference of red, green and blue.
fn apart(a: impl Iterator<Item = [f64; 3]>, b: impl Iterator<Item = [f64; 3]>) -> f64 {
    let pixels = f64::from(SIZE[0] * SIZE[1]);
    a.zip(b).map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>()).sum::<f64>() / (3.0 * pixels)
}

fn colours(image: &Image) -> impl Iterator<Item = [f64; 3]> {
    image.pixels.iter().map(|p| [p[0], p[1], p[2]].map(f64::from))
}

/// The twin's picture, with tiles of side `tile` in pixels.
fn twin(model: &Gaussians, camera: &Camera, tile: u32, depth_order: bool) -> Vec<[f64; 3]> {
    let settings = reference::Settings { tile, depth_order, ..Default::default() };
    reference::render(&Params::from(model), camera, &settings).composite.image
}

/// Two discs whose densest points on the rays through most tiles lie before the near plane.
#[test]
fn what_is_densest_before_the_near_plane_has_an_order() {
    let device = device();
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.8, SIZE[0], SIZE[1]);
    let mut model = crossed();
    for (i, (mean, size)) in [([-4.0, 0.0, 1.0], 4.0_f32), ([-3.0, 0.0, 0.6], 3.0)].into_iter().enumerate() {
        model.means[i] = mean;
        model.log_scales[i] = [size.ln(); 3];
        model.rotations[i] = [1.0, 0.0, 0.0, 0.0];
        model.opacity_logits[i] = 2.0;
    }
    let (image, _, tile) = draw(&device, &model, &camera, true);
    let (turned, ..) = draw(&device, &model.select(&[1, 0]), &camera, true);
    assert!(image.pixels == turned.pixels, "the order in the file decides");
    let off = apart(colours(&image), twin(&model, &camera, tile, true).into_iter());
    assert!(off < 1e-6, "{off:e} from the twin's");
    finish(&device);
}

/// With depth order the picture is far closer to that of an order per pixel than without it.
#[test]
fn leaves_of_a_door_are_both_before_each_other() {
    let device = device();
    let camera = camera(0.0);
    let exact = twin(&crossed(), &camera, 1, true);
    let mut off = [0.0; 2];
    for (off, depth_order) in off.iter_mut().zip([false, true]) {
        let (image, scopes, tile) = draw(&device, &crossed(), &camera, depth_order);
        assert_eq!(scopes.iter().any(|s| s == "depth order"), depth_order, "{scopes:?}");
        let like = apart(colours(&image), twin(&crossed(), &camera, tile, depth_order).into_iter());
        assert!(like < 1e-6, "{like:e} from the twin's");
        *off = apart(colours(&image), exact.iter().copied());
    }
    println!("off by {:.4} with one order, by {:.4} with one a tile", off[0], off[1]);
    assert!(off[1] < 0.2 * off[0], "{off:?}");
    finish(&device);
}

/// Neither leaf pops before the other when the camera turns past the angle at which the order of the middles changes.
#[test]
fn nothing_pops() {
    let device = device();
    let mut most = [0.0_f64; 2];
    for (most, depth_order) in most.iter_mut().zip([false, true]) {
        let frames: Vec<Image> =
            (0..=16).map(|k| draw(&device, &crossed(), &camera(1.47 + 0.0125 * f64::from(k)), depth_order).0).collect();
        for pair in frames.windows(2) {
            *most = most.max(apart(colours(&pair[0]), colours(&pair[1])));
        }
    }
    println!("pictures change by {:.4} at most with one order, by {:.4} with one a tile", most[0], most[1]);
    assert!(most[1] < 0.3 * most[0], "{most:?}");
    finish(&device);
}

/// A run with depth order stays within its memory estimate, reports the cost of the order, and its model is always
/// rendered with it.
#[test]
fn runs_are_trained_in_that_order() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 300, ..Default::default() };
    write(&scene, &options, &|_| ()).expect("a synthetic scene");
    let device = new_device(); // its peak of memory belongs to this run alone
    for choice in [Choice::Auto, Choice::On] {
        let mut config = config(&scene, 60);
        config.effects.set(Effect::DepthOrder, choice);
        let output = Output::new(&folder.path().join(format!("{choice:?}"))).unwrap();
        let networks = Networks::default();
        let results = run::run(&Session::new(&device, &networks), &config, &output, false).unwrap();
        let decision = results.effects.iter().find(|d| d.name == Effect::DepthOrder).unwrap();
        let on = choice == Choice::On;
        assert_eq!((decision.on, decision.seconds.is_some()), (on, on));
        assert!(results.memory.peak_bytes <= results.memory.estimated_bytes);
        let written = RunConfig::read(&output.folder().join("config.toml")).unwrap();
        assert_eq!(written.style.depth_order, on);
    }
    finish(&device);
}
