//! Responses (Q2) of one view: eight channels of each Gaussian.

use glam::{DMat3, DQuat, DVec3};

use super::{Params, Rendered, Settings, gradients, rasterise::walk, render};
use crate::scene::camera::Camera;

/// Responses of a view whose loss has the gradient `dl_dimage` by its pixels, with a residual by pixel; n x 8.
///
/// Rendering: 1 if shown; sums over pixels of T alpha, of T alpha times the residual and of alpha, each divided by the
/// number of pixels. Optimisation: norms of the gradients by position in units of the Gaussian's own axes, by
/// log-scale, by logit, and by SH over all bands.
pub fn respond(
    params: &Params,
    camera: &Camera,
    settings: &Settings,
    dl_dimage: &[[f64; 3]],
    residual: &[f64],
) -> Vec<[f64; 8]> {
    let mut channels = vec![[0.0; 8]; params.len()];
    each_sample(params, camera, settings, |sample| {
        let c = &mut channels[sample.gaussian];
        c[0] = 1.0;
        c[1] += sample.weight;
        c[2] += sample.weight * residual[sample.pixel];
        c[3] += sample.alpha;
    });
    let pixels = f64::from(camera.width) * f64::from(camera.height);
    let by = gradients(params, camera, settings, dl_dimage, None).params;
    for (i, c) in channels.iter_mut().enumerate() {
        c[1..4].iter_mut().for_each(|v| *v /= pixels);
        let [w, x, y, z] = params.rotations[i];
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scale = DVec3::from(params.log_scales[i].map(f64::exp));
        c[4] = (scale * (axes.transpose() * DVec3::from(by.means[i]))).length();
        c[5] = DVec3::from(by.log_scales[i]).length();
        c[6] = by.opacity_logits[i].abs();
        let squares = by.sh.iter().enumerate().flat_map(|(l, band)| {
            let width = (2 * l + 1) * 3;
            band[i * width..(i + 1) * width].iter().map(|g| g * g)
        });
        c[7] = squares.sum::<f64>().sqrt();
    }
    channels
}

/// A Gaussian's contribution to a pixel.
pub(super) struct Sample {
    /// Index of the pixel.
    pub pixel: usize,
    /// Index of the Gaussian.
    pub gaussian: usize,
    /// Its opacity at the centre.
    pub opacity: f64,
    /// Its opacity here.
    pub alpha: f64,
    /// T, the transmittance before it.
    pub transmittance: f64,
    /// w = T alpha.
    pub weight: f64,
    /// w b, b the colour behind it.
    pub behind: DVec3,
    /// phi = w (c - b), the change of the pixel if it is removed.
    pub phi: DVec3,
}

/// Calls `each` for every contribution that a pixel blends, front to back.
pub(super) fn each_sample(params: &Params, camera: &Camera, settings: &Settings, mut each: impl FnMut(&Sample)) {
    let Rendered { projected, tiles, composite } = render(params, camera, settings);
    for t in 0..tiles.offsets.len() - 1 {
        let list = tiles.list(t);
        let (columns, rows) = tiles.pixels(t, camera.width, camera.height);
        for y in rows {
            for x in columns.clone() {
                let pixel = (y * camera.width + x) as usize;
                let mut left = DVec3::from(composite.image[pixel]);
                walk(list, &projected, (x, y), settings, |k, p, s, transmittance| {
                    let weight = transmittance * s.alpha;
                    left -= weight * p.colour;
                    let behind = left * (s.alpha / (1.0 - s.alpha));
                    each(&Sample {
                        pixel,
                        gaussian: list[k] as usize,
                        opacity: p.opacity,
                        alpha: s.alpha,
                        transmittance,
                        weight,
                        behind,
                        phi: weight * p.colour - behind,
                    });
                });
            }
        }
    }
}
