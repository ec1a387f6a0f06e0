//! Backward pass of compositing: for each Gaussian the sums over pixels from which all its gradients follow.
//!
//! Let g be dL/dC of a pixel, gA its dL/dA, bg the background. C = sum w_k c_k + (1 - A) bg with A = sum w_k and
//! w_k = T_k alpha_k, so a contribution counts q_k = g . (c_k - bg) + gA, and the background needs no term of its own.
//! With R_0 = sum w_k q_k = g . (C - bg) + gA A, known from the forward pass, front to back
//!   R_k = R_{k-1} - w_k q_k   (what lies behind k),
//!   dL/dalpha_k = T_k q_k - R_k / (1 - alpha_k),   dL/dc_k = w_k g.
//! alpha = opacity exp(-power) makes every other gradient a moment of h = alpha dL/dalpha over offsets d (pixel less mean):
//!   dL/d ln opacity = sum h,   dL/dmean2D = conic sum h d,   dL/dcovariance2D = 1/2 conic (sum h d d^T) conic.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::{
    Settings,
    bin::Tiles,
    project::{Culled, Projected},
    rasterise::{Composite, walk},
};
use crate::scene::camera::Camera;

/// Sums over one Gaussian's pixels, in one tile or in all, with h = alpha dL/dalpha (zero where alpha is clamped) and d the
/// offset in pixels. The device's position sums are `zeroth` and `first`, its covariance sums `second`, its colour sums
/// `colour`.
///
/// The device sums moments of (t, dy) = L d instead, where L has the rows (1, -xy/yy) and (0, 1), since L d stays small.
/// conic = L^T D L with D = diag(yy/det, 1/yy), so dL/dmean2D = L^T D (sum h L d) and
/// dL/dcovariance2D = 1/2 L^T D (sum h L d d^T L^T) D L.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlotSums {
    /// Sum of h: the gradient by ln opacity.
    pub zeroth: f64,
    /// Sum of h d.
    pub first: DVec2,
    /// Sum of h d d^T: xx, xy, yy.
    pub second: [f64; 3],
    /// Gradient by the colour, after its clamp.
    pub colour: DVec3,
    /// Sum of T alpha.
    pub contribution: f64,
    /// Sum over tiles of the absolute gradient by the mean in pixels, component by component; zero in a single tile's
    /// sums.
    pub pull: DVec2,
}

impl SlotSums {
    /// Gradient by the mean in pixels: conic times the first moment.
    pub fn mean(&self, [a, b, c]: [f64; 3]) -> DVec2 {
        DVec2::new(a * self.first.x + b * self.first.y, b * self.first.x + c * self.first.y)
    }

    /// Gradient by the conic's xx, xy, yy, where power = 1/2 (xx dx^2 + yy dy^2) + xy dx dy.
    pub fn conic(&self) -> [f64; 3] {
        let [xx, xy, yy] = self.second;
        [-0.5 * xx, -xy, -0.5 * yy]
    }

    fn add(&mut self, other: &Self) {
        self.zeroth += other.zeroth;
        self.first += other.first;
        self.second.iter_mut().zip(other.second).for_each(|(a, b)| *a += b);
        self.colour += other.colour;
        self.contribution += other.contribution;
    }
}

/// A loss's derivatives, one entry per pixel, row by row.
#[derive(Clone, Copy)]
pub struct ImageGradient<'a> {
    /// By the pixels' red, green and blue.
    pub colour: &'a [[f64; 3]],
    /// By their opacities; `None` means zeros.
    pub alpha: Option<&'a [f64]>,
}

/// The sums of every Gaussian of the model, zero if it touches no pixel. The order of summation is fixed, as in the
/// forward pass.
pub fn rasterise_backward(
    projected: &[Result<Projected, Culled>],
    tiles: &Tiles,
    camera: &Camera,
    settings: &Settings,
    forward: &Composite,
    gradient: ImageGradient<'_>,
) -> Vec<SlotSums> {
    let background = DVec3::from(settings.background);
    let slots: Vec<Vec<SlotSums>> = (0..tiles.offsets.len() - 1)
        .into_par_iter()
        .map(|t| {
            let list = tiles.list(t);
            let mut slots = vec![SlotSums::default(); list.len()];
            let (columns, rows) = tiles.pixels(t, camera.width, camera.height);
            for y in rows {
                for x in columns.clone() {
                    let at = (y * camera.width + x) as usize;
                    let g = DVec3::from(gradient.colour[at]);
                    let ga = gradient.alpha.map_or(0.0, |v| v[at]);
                    let mut behind = g.dot(DVec3::from(forward.image[at]) - background) + ga * forward.alpha[at];
                    walk(list, projected, (x, y), settings, |k, p, s, transmittance| {
                        let weight = transmittance * s.alpha;
                        let worth = g.dot(p.colour - background) + ga;
                        behind -= weight * worth;
                        let slot = &mut slots[k];
                        slot.colour += weight * g;
                        slot.contribution += weight;
                        if s.clamped {
                            return;
                        }
                        let h = s.alpha * (transmittance * worth - behind / (1.0 - s.alpha));
                        let d = s.offset;
                        slot.zeroth += h;
                        slot.first += h * d;
                        slot.second[0] += h * d.x * d.x;
                        slot.second[1] += h * d.x * d.y;
                        slot.second[2] += h * d.y * d.y;
                    });
                }
            }
            slots
        })
        .collect();

    let mut sums = vec![SlotSums::default(); projected.len()];
    for (t, slots) in slots.iter().enumerate() {
        for (&i, slot) in tiles.list(t).iter().zip(slots) {
            sums[i as usize].add(slot);
            if let Ok(p) = &projected[i as usize] {
                sums[i as usize].pull += slot.mean(p.conic).abs();
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use glam::DMat2;

    use super::*;

    /// The moments of (t, dy) that the device sums give the same gradients as those of d.
    #[test]
    fn completed_square_gives_the_same_gradients() {
        let (xx, xy, yy) = (7.0, -2.5, 1.4);
        let det = xx * yy - xy * xy;
        let conic = DMat2::from_cols(DVec2::new(yy, -xy), DVec2::new(-xy, xx)) * (1.0 / det);
        let l = DMat2::from_cols(DVec2::new(1.0, 0.0), DVec2::new(-xy / yy, 1.0));
        let d = DMat2::from_diagonal(DVec2::new(yy / det, 1.0 / yy));
        let (mut first, mut second) = ([DVec2::ZERO; 2], [DMat2::ZERO; 2]);
        for (h, offset) in [(0.3, DVec2::new(1.5, -0.5)), (-0.7, DVec2::new(-2.0, 0.75)), (0.1, DVec2::new(0.2, 3.0))] {
            for (k, v) in [offset, l * offset].into_iter().enumerate() {
                first[k] += h * v;
                second[k] += DMat2::from_cols(v * v.x, v * v.y) * h;
            }
        }
        assert!((conic * first[0]).abs_diff_eq(l.transpose() * d * first[1], 1e-12));
        assert!((conic * second[0] * conic).abs_diff_eq(l.transpose() * d * second[1] * d * l, 1e-12));
    }
}
