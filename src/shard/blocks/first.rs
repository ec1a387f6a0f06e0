//! The initial Gaussians of a block.

use crate::gaussians::Gaussians;
use crate::sample::spread;
use crate::scene::Point;
use crate::shard::kd_tree::Grown;
use crate::train::initialise::{self, Seed};

/// A cell begins with the coarse model if that has more than this many Gaussians in it per point.
const FEW: usize = 10;

/// The Gaussians that a block's training begins with, of those in its grown cell: the capture's points, at most `most` of them; `coarse`,
/// those of the coarse model, where there are few points. Points lead to better test photos (docs/decisions.md). `unit` is the scene's size in
/// usual ones.
pub(super) fn first(points: &[Point], unit: f64, grown: &Grown<'_>, coarse: Gaussians, most: usize) -> Gaussians {
    let seeds: Vec<Seed> = points.iter().map(Seed::from).collect();
    let inside = |i: &usize| grown.contains(seeds[*i].position.as_vec3().to_array());
    let rows: Vec<usize> = (0..seeds.len()).filter(inside).collect();
    if rows.len() * FEW < coarse.len() {
        return coarse;
    }
    // A Gaussian's size follows from its nearest points, which may lie outside the cell.
    let on_points = initialise::from_points_in(&seeds, unit).select(&spread(&rows, most));
    // In all bands at once, as the coarse model is.
    let mut model = Gaussians::zeroed(0, coarse.degree());
    model.append(&on_points);
    model
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shard::kd_tree::{Cells, Contraction};
    use glam::DVec3;

    #[test]
    fn blocks_begin_with_points_where_there_are_enough() {
        let point = |i: usize| Point {
            position: DVec3::new(i as f64 - 50.0, 0.0, 0.0),
            normal: None,
            colour: [9; 3],
            error: 0.0,
            track: Vec::new(),
        };
        let points: Vec<Point> = (0..100).map(point).collect();
        let mut coarse = Gaussians::zeroed(100, 2);
        for (mean, point) in coarse.means.iter_mut().zip(&points) {
            *mean = point.position.as_vec3().to_array();
        }
        let around = Contraction::around([DVec3::splat(-50.0), DVec3::splat(50.0)]);
        let cells = Cells::new(around, &coarse.means, &[1.0; 100], 2);
        let grown = cells.grown(0, 0.2);
        let inside = |points: &[Point]| {
            points
                .iter()
                .map(|p| p.position.as_vec3().to_array())
                .filter(|mean| grown.contains(*mean))
                .collect::<Vec<_>>()
        };
        let model = first(&points, 1.0, &grown, coarse.clone(), usize::MAX);
        assert!(model.len() > 50 && model.means == inside(&points), "{}", model.len());
        assert!(model.degree() == 2 && model.validate().is_ok());
        // Points outside the cell are neighbours, too: all have the same distance to the nearest.
        let all_equal = model.log_scales[1..].iter().all(|scale| scale == &model.log_scales[1]);
        assert!(all_equal, "{:?}", model.log_scales);
        assert_eq!(first(&points, 1.0, &grown, coarse.clone(), 20).len(), 20);

        let few = &points[..inside(&points).len() / 11];
        assert!(first(few, 1.0, &grown, coarse.select(&[3, 4]), usize::MAX).len() == few.len());
        let coarse = coarse.select(&(0..99).collect::<Vec<_>>());
        assert!(first(few, 1.0, &grown, coarse.clone(), usize::MAX) == coarse);
    }
}
