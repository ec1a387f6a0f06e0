//! One hard Gaussian at a time, forward and backward, against the float64 twin.

use super::Allowed::{Exact, Rounding};
use super::Measure;
use super::backward::{expected, least, relative, there_and_back, weights};
use super::overlap::worse;
use super::rasterise;
use crate::gaussians::Gaussians;
use crate::gpu::{Device, Result};
use crate::reference::{self, Params};
use crate::render::{Settings, Style};
use crate::scene::camera::Camera;
use glam::{DMat3, DVec2, DVec3};

/// A Gaussian and its difficulty.
pub struct Hard {
    /// The difficulty.
    pub name: String,
    /// World units; the camera stands at the origin and looks along +z.
    pub mean: [f32; 3],
    /// Logarithms of world units.
    pub log_scale: [f32; 3],
    /// w, x, y, z.
    pub rotation: [f32; 4],
    /// Opacity logit.
    pub logit: f32,
}

const TURNED: [f32; 4] = [0.3, 0.5, -0.2, 0.1];
const NEAR: f32 = 0.2;

fn hard(name: impl Into<String>, mean: [f32; 3], log_scale: [f32; 3], rotation: [f32; 4], logit: f32) -> Hard {
    Hard { name: name.into(), mean, log_scale, rotation, logit }
}

/// Gaussians around the near plane, inside the camera, far away, beside the view, larger than the screen, smaller than
/// a pixel.
pub fn places() -> Vec<Hard> {
    let at = |name: &str, mean: [f32; 3], log_scale: f32| {
        hard(name, mean, [log_scale, log_scale - 0.5, log_scale + 0.3], TURNED, 1.0)
    };
    vec![
        at("behind", [0.1, 0.0, -5.0], -2.0),
        at("a hair behind the near plane", [0.01, 0.0, NEAR.next_down()], -4.0),
        at("on the near plane", [0.01, 0.0, NEAR], -4.0),
        at("a hair in front of the near plane", [0.01, 0.0, NEAR.next_up()], -4.0),
        at("the camera's own centre", [0.0; 3], -2.0),
        at("round the camera", [0.1, -0.1, 0.3], 2.0),
        at("1e6 away, a pixel wide", [1e4, -2e4, 1e6], 10.0),
        at("1e6 away, sub-pixel", [1e4, 0.0, 1e6], -3.0),
        at("1e6 aside", [1e6, 0.0, 1.0], 12.0),
        at("the whole screen", [0.2, 0.1, 3.0], 5.0),
        at("sub-pixel", [0.2, 0.1, 3.0], -9.0),
    ]
}

/// Scales from e^-30 to e^20, alone and as one axis of three, and an axis of 1e-6.
pub fn scales() -> Vec<Hard> {
    let mut all = vec![hard("one axis 1e-6", [0.1, 0.1, 3.0], [-1.0, 1e-6_f32.ln(), -1.5], TURNED, 1.0)];
    for s in [-30.0, -20.0, -10.0, 0.0, 5.0, 10.0, 15.0, 20.0] {
        all.push(hard(format!("e^{s} round"), [0.1, 0.1, 3.0], [s; 3], TURNED, -1.0));
        all.push(hard(format!("e^{s} long"), [0.1, 0.1, 3.0], [-2.0, s, -2.5], TURNED, -1.0));
        all.push(hard(format!("e^{s} flat"), [0.1, 0.1, 3.0], [s, s, -13.8], TURNED, -1.0));
    }
    all
}

/// Quaternions that are not rotations, and rotations of any length.
pub fn rotations() -> Vec<Hard> {
    let lengths = [0.0, 1e-20, 1e-6, 1e-3, 1e20, -1.0, -1e20];
    lengths
        .map(|l| hard(format!("length {l:e}"), [0.1, 0.0, 2.0], [-1.5, -2.5, -3.5], TURNED.map(|q| q * l), 1.0))
        .into()
}

/// Opacity logits at both ends of the range.
pub fn logits() -> Vec<Hard> {
    let logits = [f32::NEG_INFINITY, -40.0, -5.5, 40.0, 100.0, f32::INFINITY];
    logits.map(|l| hard(format!("logit {l}"), [0.1, 0.0, 2.0], [-1.5, -1.2, -2.0], TURNED, l)).into()
}

/// A camera of 32 x 32 pixels that looks along +z from the origin, so that depths are the means' own z to the last bit.
pub fn ahead() -> Camera {
    Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        focal: DVec2::splat(40.0),
        principal: DVec2::splat(16.0),
        width: 32,
        height: 32,
        whole: None,
    }
}

/// Errors of a hard Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct CaseErrors {
    /// Largest error of a pixel's red, green, blue or alpha.
    pub picture: f64,
    /// True if only one of device and twin draws it.
    pub differs: bool,
    /// Largest alpha.
    pub alpha: f32,
    /// Error of its gradients, relative to the twin's, but at least to a millionth of the largest that the weights can
    /// cause.
    pub gradient: f64,
    /// Updates skipped.
    pub skipped: u32,
}

/// Draws a hard Gaussian alone.
pub fn case_errors(device: &Device, hard: &Hard, antialias: bool) -> Result<CaseErrors> {
    let camera = ahead();
    let settings = Settings { near: NEAR, ..Style { antialias, ..Style::default() }.over([0.0; 3]) };
    let model = Gaussians {
        means: vec![hard.mean],
        log_scales: vec![hard.log_scale],
        rotations: vec![hard.rotation],
        opacity_logits: vec![hard.logit],
        sh: vec![vec![1.0, 0.3, -0.4], vec![0.2; 9]],
    };
    let weights = weights(&camera, 72);
    let mut drawn = there_and_back(device, &model, &camera, settings, &weights)?;
    let twin = reference::render(&Params::from(&model), &camera, &rasterise::twin(settings)).composite;
    let mut picture = 0.0;
    for (p, (rgb, alpha)) in drawn.image.pixels.iter().zip(twin.image.iter().zip(&twin.alpha)) {
        for (g, e) in p.iter().zip([rgb[0], rgb[1], rgb[2], *alpha]) {
            picture = worse(picture, (f64::from(*g) - e).abs());
        }
    }
    let alpha = drawn.image.pixels.iter().fold(0.0, |m: f32, p| m.max(p[3]));
    let differs = (alpha > 0.0) != twin.alpha.iter().any(|a| *a > 0.0);
    let mut slopes = expected(&model, &camera, settings, &weights);
    let gradient = relative(&mut drawn.gradients, &mut slopes, least(&weights));
    Ok(CaseErrors { picture, differs, alpha, gradient, skipped: drawn.skipped })
}

/// Compares hard Gaussians, drawn one by one, with the twin; `allowed` bounds the relative error of gradients.
pub(super) fn all(device: &Device, cases: &[Hard], allowed: f64) -> Result<Vec<Measure>> {
    let (mut picture, mut gradient, mut differing, mut skipped, mut alpha) = (0.0, 0.0, 0, 0, 0.0_f64);
    for hard in cases {
        for antialias in [false, true] {
            let errors = case_errors(device, hard, antialias)?;
            picture = worse(picture, errors.picture);
            gradient = worse(gradient, errors.gradient);
            differing += usize::from(errors.differs);
            skipped += errors.skipped;
            alpha = alpha.max(f64::from(errors.alpha));
        }
    }
    Ok(vec![
        // A pixel at the very edge may fall on the other side of 1/255.
        ("picture, largest", picture, Rounding(4e-3)),
        ("drawn by one alone", differing as f64, Exact(0.0)),
        ("largest alpha", alpha, Exact(0.99 + 1e-6)),
        ("gradients, relative", gradient, Rounding(allowed)),
        ("rows skipped", f64::from(skipped), Exact(0.0)),
    ])
}
