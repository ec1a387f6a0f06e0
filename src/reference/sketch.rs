//! What each Gaussian does in the pictures: the sums of products over all pixels, and the sketches that stand for them.

use glam::DVec3;

use super::densify::hash;
use super::{Params, Rendered, Settings, rasterise::walk, render};
use crate::response::{BUCKETS, ROWS};
use crate::scene::camera::Camera;

/// What a Gaussian does at one pixel: phi in three colours, and w = T alpha.
type Effect = [f64; 4];

/// Calls `body` for each pixel of a view and each Gaussian that it blends: with the tile, the pixel, the Gaussian, and what it
/// does there.
fn effects(params: &Params, camera: &Camera, settings: &Settings, mut body: impl FnMut([u32; 2], usize, Effect)) {
    let Rendered { projected, tiles, composite } = render(params, camera, settings);
    for t in 0..tiles.offsets.len() - 1 {
        let list = tiles.list(t);
        let (columns, rows) = tiles.pixels(t, camera.width, camera.height);
        for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
            let at = y * camera.width + x;
            let mut behind = DVec3::from(composite.image[at as usize]);
            walk(list, &projected, (x, y), settings, |k, p, s, transmittance| {
                let w = transmittance * s.alpha;
                behind -= w * p.colour;
                let phi = w * p.colour - behind * (s.alpha / (1.0 - s.alpha));
                body([t as u32, at], list[k] as usize, [phi.x, phi.y, phi.z, w]);
            });
        }
    }
}

/// Adds the sketches of view number `number` to those of earlier views, n x [`ROWS`].
pub fn sketch(params: &Params, camera: &Camera, settings: &Settings, number: u32, sketches: &mut [[Effect; ROWS]]) {
    effects(params, camera, settings, |[tile, pixel], i, effect| {
        let random = hash(pixel ^ hash(number));
        let bucket = hash(hash(number.wrapping_add(0x9e37_79b9)) ^ tile) as usize % BUCKETS;
        for (k, bit) in [random >> 16, random >> 24].into_iter().enumerate() {
            let sign = if bit & 1 == 1 { 1.0 } else { -1.0 };
            let row = &mut sketches[i][2 * bucket + k];
            row.iter_mut().zip(effect).for_each(|(sum, value)| *sum += sign * value);
        }
    });
}

/// Adds the sums over a view's pixels of the products of phi, and of w, for all pairs of Gaussians: two n x n matrices.
pub fn grams(params: &Params, camera: &Camera, settings: &Settings, [changes, weights]: [&mut [f64]; 2]) {
    let n = params.len();
    let mut at_pixel: Vec<(usize, Effect)> = Vec::new();
    let mut last = None;
    let mut add = |there: &mut Vec<(usize, Effect)>| {
        for (i, a) in &*there {
            for (j, b) in &*there {
                changes[i * n + j] += a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                weights[i * n + j] += a[3] * b[3];
            }
        }
        there.clear();
    };
    effects(params, camera, settings, |[_, pixel], i, effect| {
        if last != Some(pixel) {
            add(&mut at_pixel);
            last = Some(pixel);
        }
        at_pixel.push((i, effect));
    });
    add(&mut at_pixel);
}
