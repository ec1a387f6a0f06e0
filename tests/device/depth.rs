//! Expected and median depths: two layers whose depths follow from their opacities, the float64 twin, and parts.

use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{device, finish};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::kernels::constants::sh::float64::SH_C0;
use qirf_vk::pipeline::depth::{DepthPainter, Depths};
use qirf_vk::reference::{self, Params};
use qirf_vk::render::Settings;
use qirf_vk::scene::camera::Camera;

/// Wide layers before the camera, at these depths with these opacities.
fn layers(layers: &[(f32, f32)]) -> Gaussians {
    let mut model = Gaussians::zeroed(layers.len(), 0);
    for (i, (depth, opacity)) in layers.iter().enumerate() {
        model.means[i] = [0.0, 0.0, *depth];
        model.log_scales[i] = [3.0, 3.0, -6.0];
        model.rotations[i] = [1.0, 0.0, 0.0, 0.0];
        model.opacity_logits[i] = (opacity / (1.0 - opacity)).ln();
    }
    model
}

fn middle(model: &Gaussians) -> (f32, f32) {
    let device = device();
    let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.1, 9, 9);
    let mut painter = DepthPainter::new(&device, model, Settings::default(), [9, 9], true).unwrap();
    let Depths { expected, median, .. } = painter.draw(&camera).unwrap();
    finish(&device);
    (expected[40], median[40])
}

#[test]
fn layers_have_the_depths_that_follow_from_their_opacities() {
    let near = |got: f32, expected: f32| (got - expected).abs() < 1e-3 * expected;
    // 0.3 of the light stops at 2, 0.7 * 0.6 at 3, and 0.28 * 0.5 at 5.
    let (expected, median) = middle(&layers(&[(5.0, 0.5), (2.0, 0.3), (3.0, 0.6)]));
    assert!(near(expected, (0.3 * 2.0 + 0.42 * 3.0 + 0.14 * 5.0) / 0.86) && near(median, 3.0), "{expected} {median}");
    // Less than half is stopped: there is a mean, and no median.
    let (expected, median) = middle(&layers(&[(4.0, 0.3), (8.0, 0.2)]));
    assert!(near(expected, (0.3 * 4.0 + 0.14 * 8.0) / 0.44) && median == f32::INFINITY, "{expected} {median}");
    let (expected, median) = middle(&layers(&[(-4.0, 0.9)]));
    assert_eq!((expected, median), (f32::INFINITY, f32::INFINITY), "nothing lies before the camera");
}

/// What lies far away, and outside the picture, changes no depth in it.
#[test]
fn far_gaussians_spoil_no_depth() {
    let alone = middle(&layers(&[(5.0, 0.9)]));
    let mut model = layers(&[(5.0, 0.9), (1e9, 0.9)]);
    model.means[1][0] = 2e9;
    assert_eq!(middle(&model), alone);
    let (expected, median) = middle(&layers(&[(5.0, 0.9), (1e9, 0.9)]));
    assert!((expected / (0.09e9 / 0.99) - 1.0).abs() < 1e-3 && median == alone.1, "{expected} {median}");
}

#[test]
fn depths_are_the_twins_also_in_parts() {
    let device = device();
    for size in [[17, 3], [90, 61]] {
        let camera = small_camera(size[0], size[1]);
        let model = narrowed(&random_scene(&camera, 5));
        let settings = Settings::default();
        let draw = |whole| DepthPainter::new(&device, &model, settings, size, whole).unwrap().draw(&camera).unwrap();
        let depths = draw(true);
        assert_eq!(depths, draw(false));
        // The twin blends depths as colours.
        let mut coloured = model.clone();
        let depth = |mean: &[f32; 3]| (camera.rotation * DVec3::from_array(mean.map(f64::from)) + camera.translation).z;
        let colour = |mean: &[f32; 3]| [((depth(mean) - 0.5) / SH_C0) as f32; 3];
        coloured.sh = vec![model.means.iter().flat_map(colour).collect()];
        let twin = reference::render(&Params::from(&coloured), &camera, &reference::Settings::default()).composite;
        let (mut apart, mut off_median) = (0, 0);
        let off = |got: f32, exact: f64| (f64::from(got) - exact).abs() > 1e-3 * exact;
        for n in 0..depths.expected.len() {
            let (expected, median) = (twin.image[n][0] / twin.alpha[n], twin.medians[n]);
            // A contribution so near 1/255, or a transmittance so near a half, that float32 decides differently.
            apart += usize::from(twin.alpha[n] > 0.02 && off(depths.expected[n], expected));
            off_median +=
                usize::from(if median == 0.0 { depths.median[n].is_finite() } else { off(depths.median[n], median) });
        }
        let found = depths.median.iter().filter(|d| d.is_finite()).count();
        assert!(apart <= 2 && off_median <= 2, "{size:?}: {apart} means and {off_median} medians apart");
        assert!(size[0] < 20 || found > 100, "{found} medians");
    }
    finish(&device);
}
