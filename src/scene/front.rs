//! Points of a cloud that nothing hides in a picture.

use super::camera::Camera;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Mean number of points in a cell of the picture: points hide what lies behind them in their cell and in those around it.
const PER_CELL: f64 = 8.0;
/// Largest depth of a visible point, as a multiple of the nearest one's there.
const DEPTH: f64 = 1.05;

/// Least number of points that a thread projects.
const LEAST_SHARED: usize = 4096;

/// A point that no other one hides: its index, its place in the picture in pixels, and its cell there.
pub struct Front {
    pub point: usize,
    pub place: DVec2,
    pub cell: usize,
}

/// The points of a cloud, of so many positions, that are in a camera's picture and not far behind the nearest ones around them.
pub fn fronts(camera: &Camera, count: usize, position: impl Fn(usize) -> DVec3 + Sync) -> Vec<Front> {
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let shown = |i: usize| {
        let p = camera.rotation * position(i) + camera.translation;
        let place = camera.project(p);
        let inside = p.z > 0.0 && place.cmpge(DVec2::ZERO).all() && place.cmplt(size).all();
        inside.then_some((i, (place, p.z)))
    };
    let inside: Vec<_> = (0..count).into_par_iter().with_min_len(LEAST_SHARED).filter_map(shown).collect();
    let (numbers, shown): (Vec<usize>, Vec<(DVec2, f64)>) = inside.into_iter().unzip();
    let front = numbers.into_iter().zip(&shown).zip(in_front(&shown, size));
    front.filter_map(|((point, (place, _)), cell)| Some(Front { point, place: *place, cell: cell? })).collect()
}

/// The cell of each point of a picture of this size that is not far behind the nearest ones around it; none for the others. Points have their
/// place in pixels and their depth. Pixels are square.
pub fn in_front(points: &[(DVec2, f64)], size: DVec2) -> Vec<Option<usize>> {
    let columns = ((points.len() as f64 / PER_CELL * size.x / size.y).sqrt() as usize).max(2);
    let rows = ((columns as f64 * size.y / size.x).round() as usize).max(1);
    // With a border of one cell.
    let cell = |place: DVec2| {
        let at = place / size * DVec2::new(columns as f64, rows as f64);
        (at.y as usize).min(rows - 1) * (columns + 2) + (at.x as usize).min(columns - 1)
    };
    let mut nearest = vec![f64::INFINITY; (columns + 2) * (rows + 2)];
    for (place, depth) in points {
        for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
            let around = &mut nearest[cell(*place) + row * (columns + 2) + column];
            *around = around.min(*depth);
        }
    }
    let middle = columns + 3;
    let front = |(place, depth): &(DVec2, f64)| {
        let cell = cell(*place);
        (*depth <= DEPTH * nearest[cell + middle]).then_some(cell)
    };
    points.iter().map(front).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Point;

    /// Of two walls, one behind the other, the front one is seen.
    #[test]
    fn what_lies_behind_other_points_is_hidden() {
        let point = |k: u32| {
            let (x, y, depth) = (k % 20, k / 20 % 20, if k < 400 { 4.0 } else { 6.0 });
            let position = DVec3::new(f64::from(x) * 0.1 - 0.95, f64::from(y) * 0.1 - 0.95, 1.0) * depth;
            Point { position, normal: None, colour: [0; 3], error: 0.0, track: Vec::new() }
        };
        let points: Vec<Point> = (0..800).map(point).collect();
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 2.0, 64, 48);
        let front = fronts(&camera, points.len(), |k| points[k].position);
        assert!(front.iter().map(|front| front.point).eq(0..400), "{}", front.len());
    }
}
