//! What each Gaussian does in the pictures: the sums of products over all pixels, and the sketches that stand for them.

use super::densify::hash;
use super::respond::{Sample, each_sample};
use super::{Params, Settings};
use crate::response::{BUCKETS, ROWS};
use crate::scene::camera::Camera;

/// What a Gaussian does at one pixel: phi in three colours, and w = T alpha.
type Effect = [f64; 4];

fn effect(Sample { phi, weight, .. }: &Sample) -> Effect {
    [phi.x, phi.y, phi.z, *weight]
}

/// Adds the sketches of view number `number` to those of earlier views, n x [`ROWS`].
pub fn sketch(params: &Params, camera: &Camera, settings: &Settings, number: u32, sketches: &mut [[Effect; ROWS]]) {
    each_sample(params, camera, settings, |sample| {
        let random = hash(sample.pixel as u32 ^ hash(number));
        let bucket = hash(hash(number.wrapping_add(0x9e37_79b9)) ^ sample.tile as u32) as usize % BUCKETS;
        for (k, bit) in [random >> 16, random >> 24].into_iter().enumerate() {
            let sign = if bit & 1 == 1 { 1.0 } else { -1.0 };
            let row = &mut sketches[sample.gaussian][2 * bucket + k];
            row.iter_mut().zip(effect(sample)).for_each(|(sum, value)| *sum += sign * value);
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
    each_sample(params, camera, settings, |sample| {
        if last != Some(sample.pixel) {
            add(&mut at_pixel);
            last = Some(sample.pixel);
        }
        at_pixel.push((sample.gaussian, effect(sample)));
    });
    add(&mut at_pixel);
}
