//! A photo's camera, moved until the model's picture fits the photo best: Gauss-Newton steps by the picture's slopes and
//! depths (Lucas and Kanade 1981; Baker and Matthews 2004). Every other square of the photo is fitted, the rest is scored.

use super::evaluator::Comparison;
use crate::job::Error;
use crate::metrics::round_trip_8bit;
use crate::render::Image;
use crate::scene::Photo;
use crate::scene::camera::Camera;
use crate::solve;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Largest number of steps.
const STEPS: usize = 10;
/// Step in pixels below which the camera stays where it is.
const STILL: f64 = 0.02;
/// Largest distance from the given camera, as a share of the picture's longer side: a model that hardly shows the scene
/// fits as well from elsewhere.
const FURTHEST: f64 = 0.05;
/// Share by which the diagonal of the normal equations grows: keeps motions that the picture hardly determines small.
const DAMPING: f64 = 1e-3;
/// Number of pixels of a photo that are looked at, about: half of them are fitted, half scored.
const PIXELS: usize = 1 << 18;
/// Depth in world units at which what shows no Gaussian is assumed.
const FAR: f64 = 1e12;
/// Side in pixels of the squares that are fitted and scored in turn.
pub const SIDE: usize = 8;
/// Numbers of a motion: a turn about the camera's centre and a shift.
const SIZE: usize = 6;

/// A photo, and the model's depths in its picture.
pub struct CameraFit<'a> {
    /// The photo.
    pub photo: &'a Photo,
    /// Its red, green and blue in [0, 1] over the background, row by row.
    pub truth: Vec<f32>,
    /// Share of each of these values that a mask lets count, 0 to 1; none without a mask.
    pub weights: Option<Vec<f32>>,
    /// Depth of each pixel along the camera's axis; infinite where the model shows nothing.
    pub depths: &'a [f32],
    /// How pictures are compared with the photo.
    pub comparison: Comparison,
}

/// A camera that was fitted.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// How far the fit moves the picture, in pixels: root mean square.
    pub pixels: f64,
    /// PSNR of the photo's scored squares with the given camera and with the fitted one, in dB.
    pub psnr: [f64; 2],
}

impl CameraFit<'_> {
    /// Fits the camera; `draw` gives the model's picture by a camera.
    pub fn run(&self, draw: &mut dyn FnMut(&Camera) -> Result<Image, Error>) -> Result<Fitted, Error> {
        let given = &self.photo.camera;
        let weights = self.weights.as_deref();
        let mut picture =
            |camera: &Camera| draw(camera).map(|image| self.comparison.picture(&image, &self.truth, weights));
        let first = picture(given)?;
        let scale = self.mean_square(&first, true).max(f64::MIN_POSITIVE);
        let (mut camera, mut best, mut error) = (given.clone(), first.clone(), self.error(&first, scale));
        for _ in 0..STEPS {
            let [a, b, c, x, y, z] = self.step(&camera, &best, scale);
            let next = camera.moved(DVec3::new(a, b, c), DVec3::new(x, y, z));
            let apart = self.distance(given, &next);
            if apart > FURTHEST * f64::from(given.width.max(given.height)) || !apart.is_finite() {
                break;
            }
            let drawn = picture(&next)?;
            let reached = self.error(&drawn, scale);
            if reached >= error || !reached.is_finite() {
                break;
            }
            let still = self.distance(&camera, &next) < STILL;
            (camera, best, error) = (next, drawn, reached);
            if still {
                break;
            }
        }
        let psnr = [&first, &best].map(|picture| -10.0 * self.mean_square(&round_trip_8bit(picture), false).log10());
        Ok(Fitted { pixels: self.distance(given, &camera), psnr })
    }

    fn width(&self) -> usize {
        self.photo.camera.width as usize
    }

    /// Columns of a row that are looked at, some of each row of a large photo: those that are fitted, or those that are scored.
    fn columns(&self, y: usize, fitted: bool) -> impl Iterator<Item = usize> + use<> {
        let (width, pixels) = (self.width(), self.photo.camera.pixels() as usize);
        let every = pixels.div_ceil(PIXELS).max(1);
        (y % every..width).step_by(every).filter(move |x| is_fitted(*x, y) == fitted)
    }

    /// The sum of a function of the differences' squares in the squares that are fitted, or those that are scored, and the
    /// number of these differences that masks leave.
    fn sum(&self, rendered: &[f32], fitted: bool, of: impl Fn(f64) -> f64 + Sync) -> (f64, f64) {
        let width = 3 * self.width();
        let rows = rendered.par_chunks_exact(width).zip(self.truth.par_chunks_exact(width)).enumerate();
        let row = |(y, (a, b)): (usize, (&[f32], &[f32]))| {
            let values = self.columns(y, fitted).flat_map(|x| 3 * x..3 * x + 3);
            let counts = |k: usize| self.weights.as_ref().map_or(1.0, |w| f64::from(w[y * width + k]).powi(2));
            values
                .fold((0.0, 0.0), |(sum, n), k| (sum + of((f64::from(a[k]) - f64::from(b[k])).powi(2)), n + counts(k)))
        };
        let rows: Vec<(f64, f64)> = rows.map(row).collect();
        (rows.iter().map(|row| row.0).sum(), rows.iter().map(|row| row.1).sum())
    }

    fn mean_square(&self, rendered: &[f32], fitted: bool) -> f64 {
        let (sum, count) = self.sum(rendered, fitted, |square| square);
        sum / count.max(f64::MIN_POSITIVE)
    }

    /// The error that steps reduce. Large differences, which no camera explains, have little weight.
    fn error(&self, rendered: &[f32], scale: f64) -> f64 {
        self.sum(rendered, true, |square| (1.0 + square / scale).ln()).0
    }

    fn depth(&self, pixel: usize) -> f64 {
        Some(f64::from(self.depths[pixel])).filter(|depth| *depth < FAR).unwrap_or(FAR)
    }

    /// The motion by which a picture by `camera` comes closest to the photo, to first order.
    fn step(&self, camera: &Camera, rendered: &[f32], scale: f64) -> [f64; SIZE] {
        let (width, height) = (self.width(), self.photo.camera.height as usize);
        let (right, bottom) = (width.saturating_sub(1), height.saturating_sub(1));
        let row = |y: usize| {
            let mut sums = ([[0.0; SIZE]; SIZE], [0.0; SIZE]);
            for x in self.columns(y, true).filter(|x| (1..right).contains(x)) {
                let pixel = y * width + x;
                let motions = flow(camera, DVec2::new(x as f64, y as f64) + 0.5, self.depth(pixel));
                for channel in 0..3 {
                    let at = |pixel: usize| f64::from(rendered[3 * pixel + channel]);
                    let slope = DVec2::new(at(pixel + 1) - at(pixel - 1), at(pixel + width) - at(pixel - width)) / 2.0;
                    let surplus = at(pixel) - f64::from(self.truth[3 * pixel + channel]);
                    let parts = motions.map(|motion| slope.dot(motion));
                    let weight = 1.0 / (1.0 + surplus * surplus / scale);
                    for i in 0..SIZE {
                        (0..SIZE).for_each(|j| sums.0[i][j] += weight * parts[i] * parts[j]);
                        sums.1[i] += weight * parts[i] * surplus;
                    }
                }
            }
            sums
        };
        let rows: Vec<_> = (1..bottom).into_par_iter().map(row).collect();
        let (mut a, mut b) = ([[0.0; SIZE]; SIZE], [0.0; SIZE]);
        for (squares, surpluses) in rows {
            for i in 0..SIZE {
                (0..SIZE).for_each(|j| a[i][j] += squares[i][j]);
                b[i] += surpluses[i];
            }
        }
        (0..SIZE).for_each(|i| a[i][i] = (1.0 + DAMPING) * a[i][i] + f64::MIN_POSITIVE);
        let motion = solve::positive(a, b);
        if motion.iter().all(|v| v.is_finite()) { motion } else { [0.0; SIZE] }
    }

    /// Root mean square of how far a picture moves from one camera to another, in pixels.
    fn distance(&self, from: &Camera, to: &Camera) -> f64 {
        let (width, height) = (self.width(), self.photo.camera.height as usize);
        let pixels: Vec<usize> = (0..height).flat_map(|y| self.columns(y, true).map(move |x| y * width + x)).collect();
        let moved = |pixel: &usize| {
            let at = DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5;
            let seen = from.ray(at) * self.depth(*pixel);
            let point = from.rotation.transpose() * (seen - from.translation);
            to.project(to.rotation * point + to.translation).distance_squared(at)
        };
        (pixels.iter().map(moved).sum::<f64>() / pixels.len().max(1) as f64).sqrt()
    }
}

/// Returns true for pixels of the squares that are fitted; the others are scored.
pub fn is_fitted(x: usize, y: usize) -> bool {
    (x / SIDE + y / SIDE).is_multiple_of(2)
}

/// How a picture's content moves at a pixel, in pixels, by a unit of each motion of [`Camera::moved`].
fn flow(camera: &Camera, at: DVec2, depth: f64) -> [DVec2; SIZE] {
    let ray = camera.ray(at);
    let seen = |displacement: DVec3| (displacement.truncate() - ray.truncate() * displacement.z) * camera.focal;
    let axes = [0, 1, 2].map(|k| camera.rotation.col(k));
    let turns = axes.map(|axis| seen(axis.cross(ray)));
    let shifts = axes.map(|axis| seen(axis / depth));
    std::array::from_fn(|k| if k < 3 { turns[k] } else { shifts[k - 3] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flow_is_the_slope_of_what_a_camera_shows() {
        let camera = Camera::look_at(DVec3::new(1.0, -2.0, -3.0), DVec3::new(0.3, 0.1, 0.2), DVec3::Y, 0.9, 64, 48);
        let (at, depth) = (DVec2::new(20.0, 33.0), 2.5);
        let point = camera.rotation.transpose() * (camera.ray(at) * depth - camera.translation);
        let seen = |camera: &Camera| camera.project(camera.rotation * point + camera.translation);
        assert!(seen(&camera).distance(at) < 1e-9);
        for (k, motion) in flow(&camera, at, depth).into_iter().enumerate() {
            let mut unit = [0.0; SIZE];
            unit[k] = 1e-6;
            let [a, b, c, x, y, z] = unit;
            let slope = (seen(&camera.moved(DVec3::new(a, b, c), DVec3::new(x, y, z))) - at) / 1e-6;
            assert!(slope.distance(motion) < 1e-3 * (1.0 + motion.length()), "{k}: {slope} {motion}");
        }
    }
}
