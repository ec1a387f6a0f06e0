//! The tiles that each Gaussian touches, and each tile's Gaussians front to back.

use super::{
    Settings,
    project::{Culled, Projected},
};
use crate::scene::camera::Camera;
use glam::DVec2;

/// Added to the extent, so that rounding never loses a pixel at its very edge; the device's is wider.
const EXTENT_SLACK: f64 = 1e-9;

/// Per-tile lists of Gaussians, front to back, tiles row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Tiles {
    /// Side of a tile in pixels.
    pub side: u32,
    /// Tiles per row.
    pub columns: u32,
    /// Rows of tiles.
    pub rows: u32,
    /// Tile `t` holds `gaussians[offsets[t]..offsets[t + 1]]`; one more entry than tiles.
    pub offsets: Vec<usize>,
    /// Indices into the model.
    pub gaussians: Vec<u32>,
}

impl Tiles {
    /// The Gaussians of tile `t`, front to back.
    pub fn list(&self, t: usize) -> &[u32] {
        &self.gaussians[self.offsets[t]..self.offsets[t + 1]]
    }

    /// Pixel ranges (x, y) of tile `t` in an image of `width` x `height`.
    pub fn pixels(&self, t: usize, width: u32, height: u32) -> (std::ops::Range<u32>, std::ops::Range<u32>) {
        let (x, y) = (t as u32 % self.columns * self.side, t as u32 / self.columns * self.side);
        (x..(x + self.side).min(width), y..(y + self.side).min(height))
    }
}

/// Visible Gaussians front to back; equal depths stay in index order.
pub fn depth_order(projected: &[Result<Projected, Culled>]) -> Vec<u32> {
    let mut seen: Vec<(f64, u32)> =
        projected.iter().enumerate().filter_map(|(i, p)| p.as_ref().ok().map(|p| (p.depth, i as u32))).collect();
    seen.sort_by(|a, b| a.0.total_cmp(&b.0));
    seen.into_iter().map(|(_, i)| i).collect()
}

/// Lists every tile's Gaussians in depth order, the picture's or the tile's own; with a smooth cut-off every Gaussian
/// is in every tile.
pub fn bin(projected: &[Result<Projected, Culled>], camera: &Camera, settings: &Settings) -> Tiles {
    let side = settings.tile;
    let (columns, rows) = (camera.width.div_ceil(side), camera.height.div_ceil(side));
    let order = if settings.depth_order { (0..projected.len() as u32).collect() } else { depth_order(projected) };
    let visit = |each: &mut dyn FnMut(usize, u32)| {
        for &i in &order {
            if let Ok(p) = &projected[i as usize] {
                touched(p, camera, settings, |t| each(t, i));
            }
        }
    };

    let mut offsets = vec![0; columns as usize * rows as usize + 1];
    visit(&mut |t, _| offsets[t + 1] += 1);
    for t in 1..offsets.len() {
        offsets[t] += offsets[t - 1];
    }
    let mut next = offsets.clone();
    let mut gaussians = vec![0; offsets[offsets.len() - 1]];
    visit(&mut |t, i| {
        gaussians[next[t]] = i;
        next[t] += 1;
    });
    if settings.depth_order {
        for t in 0..offsets.len() - 1 {
            let (x, y) = (t as u32 % columns, t as u32 / columns);
            let middle = (DVec2::new(f64::from(x), f64::from(y)) + 0.5) * f64::from(side);
            let ray = (middle - camera.principal) / camera.focal;
            let depth = |i: &u32| projected[*i as usize].as_ref().map_or(f64::INFINITY, |p| p.densest.depth_along(ray));
            gaussians[offsets[t]..offsets[t + 1]].sort_by(|a, b| depth(a).total_cmp(&depth(b)));
        }
    }
    Tiles { side, columns, rows, offsets, gaussians }
}

/// Calls `each` with every tile that the Gaussian's ellipse {power <= extent} touches, row by row.
///
/// Counting and emission both use it, so that they always agree.
pub fn touched(p: &Projected, camera: &Camera, settings: &Settings, mut each: impl FnMut(usize)) {
    let (side, all) = (settings.tile, settings.smooth_cutoff);
    let columns = camera.width.div_ceil(side);
    let extent = p.extent + EXTENT_SLACK;
    let reach = |variance: f64| if all { f64::INFINITY } else { (2.0 * extent * variance).max(0.0).sqrt() };
    let range = |centre: f64, reach: f64, pixels: u32| {
        // Casts saturate: far off the image both ends land on the same side.
        let tile = |edge: f64| ((edge - 0.5) / f64::from(side)).floor();
        let end = (tile(centre + reach) + 1.0) as u32;
        (tile(centre - reach) as u32)..end.min(pixels.div_ceil(side))
    };
    let across = range(p.mean.x, reach(p.covariance[0]), camera.width);
    for row in range(p.mean.y, reach(p.covariance[2]), camera.height) {
        for column in across.clone() {
            let centres = |tile: u32, pixels: u32, mean: f64| {
                let last = ((tile + 1) * side).min(pixels);
                (f64::from(tile * side) + 0.5 - mean, f64::from(last) - 0.5 - mean)
            };
            let x = centres(column, camera.width, p.mean.x);
            let y = centres(row, camera.height, p.mean.y);
            if all || least_power(p.conic, x, y) <= extent {
                each(row as usize * columns as usize + column as usize);
            }
        }
    }
}

/// Least power on the rectangle x, y (low, high), relative to the Gaussian's centre.
///
/// Power is convex with its minimum, zero, at the origin. If the rectangle does not contain the origin, the least point
/// lies on an edge that faces it: at most one vertical and one horizontal. On a line the minimum has a closed form.
pub fn least_power([a, b, c]: [f64; 3], x: (f64, f64), y: (f64, f64)) -> f64 {
    let power = |x: f64, y: f64| 0.5 * (a * x * x + c * y * y) + b * x * y;
    let nearest = (0f64.clamp(x.0, x.1), 0f64.clamp(y.0, y.1));
    let vertical = || power(nearest.0, (-b * nearest.0 / c).clamp(y.0, y.1));
    let horizontal = || power((-b * nearest.1 / a).clamp(x.0, x.1), nearest.1);
    match (nearest.0 == 0.0, nearest.1 == 0.0) {
        (true, true) => 0.0,
        (false, true) => vertical(),
        (true, false) => horizontal(),
        (false, false) => vertical().min(horizontal()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_power_is_the_minimum_of_a_fine_grid() {
        for (conic, x, y) in [
            ([0.5, 0.3, 0.25], (1.0, 4.0), (-3.0, 2.0)),
            ([0.5, -0.34, 0.25], (1.0, 4.0), (2.0, 5.0)),
            ([0.5, 0.34, 0.25], (-9.0, -4.0), (2.0, 5.0)),
            ([2.0, 0.0, 0.01], (-1.0, 4.0), (7.0, 8.0)),
            ([1.0, 0.5, 1.0], (-1.0, 1.0), (-1.0, 1.0)),
        ] {
            let mut least = f64::INFINITY;
            for i in 0..=1000 {
                for j in 0..=1000 {
                    let px = x.0 + (x.1 - x.0) * f64::from(i) / 1000.0;
                    let py = y.0 + (y.1 - y.0) * f64::from(j) / 1000.0;
                    least = least.min(0.5 * (conic[0] * px * px + conic[2] * py * py) + conic[1] * px * py);
                }
            }
            let exact = least_power(conic, x, y);
            assert!(exact <= least + 1e-12 && exact >= least - 1e-4, "{conic:?}: {exact} against {least}");
        }
    }
}
