//! Points of a cloud that nothing hides in a picture.

use glam::DVec2;

/// Mean number of points in a cell of the picture: points hide what lies behind them in their cell and in those around it.
const PER_CELL: f64 = 8.0;
/// Largest depth of a visible point, as a multiple of the nearest one's there.
const DEPTH: f64 = 1.05;

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
