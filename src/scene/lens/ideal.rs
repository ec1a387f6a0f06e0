//! The ideal pinhole that replaces a lens (the protocol is in the module above), and how far a lens is from one.

use glam::DVec2;

use super::Lens;
use super::distortion::Distortion;

/// Samples along one image edge when a lens is examined.
const EDGE_SAMPLES: u32 = 128;

/// Largest half-width of the ideal image, in units of the half-width seen by an undistorted lens of the same focal
/// length.
pub(in crate::scene) const WIDEST: f64 = 2.0;

/// The pinhole that replaces a lens: focal lengths and principal point in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal lengths in pixels.
    pub focal: DVec2,
    /// Principal point in pixels from the upper left corner.
    pub principal: DVec2,
}

impl Lens {
    /// The largest displacement, in pixels, against a pinhole image of the same intrinsics (129 x 129 grid over the
    /// image, edges included); infinite if a pixel shows no ray. A pixel that such a pinhole shows and the lens does not is
    /// compared with the ray that the lens shows at it.
    pub fn max_displacement(&self) -> f64 {
        if self.distortion == Distortion::default() {
            return 0.0;
        }
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let mut farthest = 0.0_f64;
        for j in 0..=EDGE_SAMPLES {
            for i in 0..=EDGE_SAMPLES {
                let pixel = size * DVec2::new(f64::from(i), f64::from(j)) / f64::from(EDGE_SAMPLES);
                let ideal = (pixel - self.principal) / self.focal;
                let shown = || self.undistort(ideal).map_or(f64::INFINITY, |ray| ((ray - ideal) * self.focal).length());
                let moved = (self.project(ideal) - pixel).length();
                farthest = farthest.max(if moved.is_nan() { shown() } else { moved });
            }
        }
        farthest
    }

    /// The ideal pinhole for an image of the same size (see the module's protocol); none if the distortion folds the
    /// image so that it covers no rectangle entirely.
    pub fn ideal(&self) -> Option<Pinhole> {
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let reach = WIDEST * 0.5 * size / self.focal;
        let (mut low, mut high) = (-reach, reach);
        let last = size - 0.5;
        let steps = |n: u32| (0..=n.min(EDGE_SAMPLES)).map(move |i| f64::from(i) / f64::from(n.min(EDGE_SAMPLES)));
        let ray = |x: f64, y: f64| self.undistort((DVec2::new(x, y) - self.principal) / self.focal);
        for t in steps(self.height) {
            let y = 0.5 + t * (last.y - 0.5);
            low.x = ray(0.5, y).map_or(low.x, |p| low.x.max(p.x));
            high.x = ray(last.x, y).map_or(high.x, |p| high.x.min(p.x));
        }
        for t in steps(self.width) {
            let x = 0.5 + t * (last.x - 0.5);
            low.y = ray(x, 0.5).map_or(low.y, |p| low.y.max(p.y));
            high.y = ray(x, last.y).map_or(high.y, |p| high.y.min(p.y));
        }
        // A single pixel has no extent between centres: its width on the plane is one pixel's.
        let span = (high - low) + DVec2::select(size.cmple(DVec2::ONE), 1.0 / self.focal, DVec2::ZERO);
        if !span.is_finite() || span.min_element() <= 0.0 {
            return None;
        }
        let fitting = (size - 1.0).max(DVec2::ONE) / span;
        let centre = 0.5 * (low + high);
        let mut zoom = (fitting / self.focal).max_element();
        for _ in 0..100 {
            let focal = self.focal * zoom;
            let pinhole = Pinhole { focal, principal: 0.5 * size - centre * focal };
            if self.covers(&pinhole) {
                return Some(pinhole);
            }
            zoom *= 1.02;
        }
        None
    }

    /// True if every pixel centre of `pinhole`'s image (a grid of them, border included) has its source in the photo,
    /// on the unfolded branch: a fold between the axis and a point lies on the way to one of the border, too.
    fn covers(&self, pinhole: &Pinhole) -> bool {
        let size = DVec2::new(f64::from(self.width), f64::from(self.height));
        let slack = 1e-6 * size.max_element();
        let point = |i: u32, j: u32| {
            let share = DVec2::new(f64::from(i), f64::from(j)) / f64::from(EDGE_SAMPLES);
            (0.5 + share * (size - 1.0) - pinhole.principal) / pinhole.focal
        };
        let is_inside = |point: DVec2| {
            let source = self.project(point);
            source.cmpge(DVec2::splat(0.5 - slack)).all() && source.cmple(size - 0.5 + slack).all()
        };
        let on_border = (0..=EDGE_SAMPLES).flat_map(|k| [(k, 0), (k, EDGE_SAMPLES), (0, k), (EDGE_SAMPLES, k)]);
        on_border
            .map(|(i, j)| point(i, j))
            .all(|p| is_inside(p) && self.distortion.is_unfolded(self.distortion.curved(p)))
            && (1..EDGE_SAMPLES)
                .flat_map(|j| (1..EDGE_SAMPLES).map(move |i| (i, j)))
                .map(|(i, j)| point(i, j))
                .all(|p| is_inside(p) && self.distortion.jacobian(self.distortion.curved(p)).determinant() > 0.0)
    }
}
