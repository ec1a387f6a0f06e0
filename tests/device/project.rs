//! Signs of quaternions; hard Gaussians one by one are cases of the selftest.

use crate::support::{device, finish};
use qirf_vk::render::Settings;
use qirf_vk::selftest::backward::{there_and_back, weights};
use qirf_vk::selftest::project::{ahead, rotations};

/// q and -q are the same rotation: the same picture to the bit, and opposite gradients for the quaternion alone.
#[test]
fn a_quaternion_and_its_negative() {
    let device = device();
    let model = |sign: f32| {
        let hard = &rotations()[3];
        qirf_vk::gaussians::Gaussians {
            means: vec![hard.mean],
            log_scales: vec![hard.log_scale],
            rotations: vec![hard.rotation.map(|q| sign * q)],
            opacity_logits: vec![hard.logit],
            sh: vec![vec![0.5; 3]],
        }
    };
    let camera = ahead();
    let weights = weights(&camera, 5);
    let draw = |sign| there_and_back(&device, &model(sign), &camera, Settings::default(), &weights).unwrap();
    let (plus, minus) = (draw(1.0), draw(-1.0));
    assert_eq!(plus.image, minus.image);
    assert_eq!(plus.gradients.means, minus.gradients.means);
    assert_eq!(plus.gradients.log_scales, minus.gradients.log_scales);
    assert_eq!(plus.gradients.rotations[0], minus.gradients.rotations[0].map(|g| -g));
    assert!(plus.gradients.rotations[0].iter().any(|g| *g != 0.0));
    finish(&device);
}
