//! Small scenes that take every branch of the renderer, and difference quotients over all their parameters.

use super::Random;
use glam::{DVec2, DVec3};
use qirf_vk::{gaussians::Gaussians, reference::Params, scene::camera::Camera};

/// A rotated camera with unequal focal lengths and a shifted principal point, looking near the origin from 4 units.
pub fn small_camera(width: u32, height: u32) -> Camera {
    let mut camera =
        Camera::look_at(DVec3::new(0.3, -0.4, -4.0), DVec3::new(0.1, 0.2, 0.0), DVec3::NEG_Y, 0.9, width, height);
    camera.focal.y *= 1.1;
    camera.principal += DVec2::new(1.3, -0.7);
    camera
}

/// 24 Gaussians before `camera`, unnormalised quaternions, SH 3: most in view, and some for the rare branches: beyond
/// the Jacobian's clamp in x, in y and in both, opaque ones (clamped alpha), dark ones (clamped colour), and some so
/// small that the anti-aliasing factor is at its floor.
pub fn random_scene(camera: &Camera, seed: u64) -> Params {
    let mut random = Random(seed);
    let mut params = Params { sh: vec![Vec::new(); 4], ..Params::default() };
    for i in 0..24 {
        let z = random.within(2.0, 6.0);
        let slope = |random: &mut Random, beyond: bool| {
            if beyond {
                random.within(0.75, 0.9) * if random.unit() < 0.5 { -1.0 } else { 1.0 }
            } else {
                random.within(-0.4, 0.4)
            }
        };
        let x = slope(&mut random, i % 4 == 1 && i < 12);
        let y = slope(&mut random, i % 4 == 2 && i < 12 || i == 1);
        let inside = camera.rotation.transpose() * (DVec3::new(x * z, y * z, z) - camera.translation);
        params.means.push(inside.to_array());
        let size = match i {
            11 => 3.0, // and opaque, even after the anti-aliasing factor
            0..12 => 0.9,
            20..24 => 1e-3,
            _ => 0.25,
        };
        params.log_scales.push([0; 3].map(|_| (size * random.within(0.3, 1.5)).ln()));
        params.rotations.push([0; 4].map(|_| random.within(-2.0, 2.0)));
        params.opacity_logits.push(if i % 6 == 5 { 7.0 } else { random.within(-3.0, 1.5) });
        for l in 0..4 {
            let shift = if l == 0 && i % 5 == 3 { -2.5 } else { 0.0 };
            params.sh[l].extend((0..(2 * l + 1) * 3).map(|_| shift + random.within(-0.6, 0.6)));
        }
    }
    params
}

/// Derivative of `f` by every parameter: central differences of fourth order, error about h^4.
pub fn difference_quotients(params: &Params, h: f64, f: impl Fn(&Params) -> f64) -> Params {
    let mut moved = params.clone();
    let mut out = params.zeros_like();
    for (group, values) in out.groups_mut().into_iter().enumerate() {
        for (k, quotient) in values.1.iter_mut().enumerate() {
            let kept = moved.groups_mut()[group].1[k];
            let mut at = |step: f64| {
                moved.groups_mut()[group].1[k] = kept + step * h;
                f(&moved)
            };
            *quotient = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h);
            moved.groups_mut()[group].1[k] = kept;
        }
    }
    out
}

/// Balls scattered over a cube of 2 units about the origin, of equal colours.
pub fn scattered(n: usize, degree: usize, log_scale: f32) -> Gaussians {
    let means = (0..n).map(|i| [0, 1, 2].map(|k| scatter(i, k))).collect();
    let mut model = Gaussians::balls(means, log_scale, 0.0, degree);
    model.sh.iter_mut().for_each(|band| band.fill(0.1));
    model
}

/// A number in [-1, 1], spread by its indices.
pub fn scatter(i: usize, k: usize) -> f32 {
    ((i * 31 + k * 17) % 101) as f32 / 50.0 - 1.0
}

/// One ordinary Gaussian, the basis of the hard cases.
pub fn one(camera: &Camera, position: DVec3) -> Params {
    Params {
        means: vec![(camera.rotation.transpose() * (position - camera.translation)).to_array()],
        log_scales: vec![[-1.0, -1.5, -2.0]],
        rotations: vec![[0.9, 0.1, -0.3, 0.2]],
        opacity_logits: vec![1.0],
        sh: (0..4).map(|l| vec![0.2; (2 * l + 1) * 3]).collect(),
    }
}

/// A scene's parameters in a model's storage format.
pub fn narrowed(wide: &Params) -> Gaussians {
    Gaussians {
        means: wide.means.iter().map(|m| m.map(|v| v as f32)).collect(),
        log_scales: wide.log_scales.iter().map(|m| m.map(|v| v as f32)).collect(),
        rotations: wide.rotations.iter().map(|m| m.map(|v| v as f32)).collect(),
        opacity_logits: wide.opacity_logits.iter().map(|v| *v as f32).collect(),
        sh: wide.sh.iter().map(|b| b.iter().map(|v| *v as f32).collect()).collect(),
    }
}
