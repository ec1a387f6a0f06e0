//! Merging of duplicate points, which occur in clouds that were merged or exported twice, and of copies that lie a little aside.
//!
//! The initial size of a Gaussian is the gap to its neighbours, which would be zero for duplicates. Each copy would begin as a Gaussian.

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::Point;
use super::neighbours::Neighbours;

/// Points are duplicates if their distance is below this share of the mean gap.
const SAME: f64 = 4e-3;
/// Share of duplicates up to which they stay: reconstructions have 3 % of such pairs, and 40 % did no harm.
const FEW: f64 = 0.2;
/// Share of points that must have a copy a little aside before copies are merged: nearly all points of a cloud that was joined twice have one, and 69 %
/// of those on clean lines.
const COPIED: f64 = 0.75;
/// Side of a cell of the search, in maximum distances of duplicates.
const CELL: f64 = 8.0;
/// Share of the points beyond the bounds of the cloud, at each end of each axis: far ones, as of skies, must not count.
const OUTSIDE: f64 = 0.25;

/// The points without duplicates, in their order. The first of several keeps its position and colour, and is seen by all views
/// that see one of them. All points if few are duplicates.
pub(super) fn merge_repeated(points: Vec<Point>) -> Vec<Point> {
    let firsts = firsts(&points);
    let repeated = firsts.iter().enumerate().filter(|(i, first)| i != *first).count();
    let are_few = repeated as f64 <= FEW * points.len() as f64;
    if are_few { points } else { merged(points, &firsts) }
}

/// Variant of [`merge_repeated`] for copies that lie a little aside, which searches for the neighbours of points. Returns all points
/// unless most have a copy.
pub(super) fn merge_copies(points: Vec<Point>) -> Vec<Point> {
    let neighbours = Neighbours::of(points.iter().map(|point| point.position).collect());
    if neighbours.copied < COPIED { points } else { merged(points, &neighbours.firsts()) }
}

/// The points that are their own first ones, with the tracks of the others.
fn merged(points: Vec<Point>, firsts: &[usize]) -> Vec<Point> {
    let mut merged: Vec<Point> = Vec::new();
    let mut number = vec![0; points.len()];
    for (i, point) in points.into_iter().enumerate() {
        if firsts[i] == i {
            number[i] = merged.len();
            merged.push(point);
        } else {
            merged[number[firsts[i]]].track.extend(point.track);
        }
    }
    for point in &mut merged {
        point.track.sort_unstable();
        point.track.dedup();
    }
    merged
}

/// For each point, the index of the first point at its place.
fn firsts(points: &[Point]) -> Vec<usize> {
    if points.len() < 2 {
        return (0..points.len()).collect();
    }
    let near = distance(points);
    let cell = |p: DVec3| (p / (CELL * near)).floor().to_array().map(|v| v as i64);
    // The points of a cell are a chain: its last one, and before each the one before.
    let mut last: FxHashMap<[i64; 3], usize> = FxHashMap::default();
    let mut before: Vec<Option<usize>> = vec![None; points.len()];
    let mut firsts = Vec::with_capacity(points.len());
    for (number, point) in points.iter().enumerate() {
        let (low, high) = (cell(point.position - near), cell(point.position + near));
        let same = (low[0]..=high[0])
            .flat_map(|x| (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z])))
            .find_map(|place| {
                let mut at = last.get(&place).copied();
                while let Some(i) = at {
                    if points[i].position.distance(point.position) <= near {
                        break;
                    }
                    at = before[i];
                }
                at
            });
        if same.is_none() {
            before[number] = last.insert(cell(point.position), number);
        }
        firsts.push(same.unwrap_or(number));
    }
    firsts
}

/// The distance at which points are one: a share of the mean gap if they lay on a surface as large as the cloud, and at
/// least what float64 tells apart.
fn distance(points: &[Point]) -> f64 {
    let outside = (OUTSIDE * points.len() as f64) as usize;
    let spread = |axis: usize| {
        let mut places: Vec<f64> = points.iter().map(|point| point.position[axis]).collect();
        let end = places.len() - 1 - outside;
        let low = *places.select_nth_unstable_by(outside, f64::total_cmp).1;
        *places.select_nth_unstable_by(end, f64::total_cmp).1 - low
    };
    let size = DVec3::new(spread(0), spread(1), spread(2)).length();
    let farthest = points.iter().map(|point| point.position.abs().max_element()).fold(0.0, f64::max);
    (SAME * size / (points.len() as f64).sqrt()).max(1e-15 * farthest).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(position: DVec3, view: u32) -> Point {
        Point { position, normal: None, colour: [view as u8; 3], error: 0.0, track: vec![view] }
    }

    fn all_merged(points: Vec<Point>) -> Vec<Point> {
        merge_copies(merge_repeated(points))
    }

    fn place_of(i: u32) -> DVec3 {
        DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0)
    }

    /// A cloud of 400 points, and the same four times, at one place or a little aside, in any unit and anywhere.
    #[test]
    fn copies_become_one() {
        let place = |i: u32, unit: f64, origin: f64| {
            let (u, v) = (f64::from(i % 20), f64::from(i / 20));
            DVec3::new(u, v, (u * v).sin()) * unit + origin
        };
        for (unit, origin, apart) in
            [(0.5, 0.0, 0.0), (0.5, 0.0, 1e-4), (0.5, 0.0, 3e-3), (5e-5, 0.0, 1e-8), (0.5, 4.6e6, 0.0), (5e2, 0.0, 0.0)]
        {
            let once: Vec<Point> = (0..400).map(|i| point(place(i, unit, origin), i % 7)).collect();
            let again = (0..1600).map(|k| {
                let (i, copy) = (k % 400, k / 400);
                point(place(i, unit, origin) + apart * f64::from(copy), (i + copy) % 7)
            });
            let merged = all_merged(again.collect());
            assert_eq!(merged.len(), 400, "{unit} {origin} {apart}");
            assert!(merged.iter().zip(&once).all(|(a, b)| a.position == b.position && a.colour == b.colour));
            assert_eq!(merged[5].track, [0, 1, 5, 6]);
            assert_eq!(all_merged(once.clone()), once, "{unit} {origin}");
        }
        let some = |k: u32| point(place_of(k % 90), k);
        assert_eq!(
            [all_merged((0..100).map(some).collect()).len(), all_merged((0..180).map(some).collect()).len()],
            [100, 90]
        );
        // A fifth of the points far off, on one side.
        let far =
            |k: u32| point(place_of(k) + DVec3::X * if k.is_multiple_of(5) { 1e6 * f64::from(k + 1) } else { 0.0 }, k);
        assert_eq!(all_merged((0..100).map(far).collect()).len(), 100);
        let heap: Vec<Point> = (0..9).map(|i| point(DVec3::ONE, i)).collect();
        assert_eq!(all_merged(heap).len(), 1);
        assert_eq!(all_merged(vec![point(DVec3::ZERO, 0), point(DVec3::ZERO, 0)]).len(), 1);
    }

    /// Where half of the points have a near copy, all stay; where all have one, the copies go.
    #[test]
    fn near_copies_go_if_most_points_have_one() {
        let place = |i: u32| DVec3::new(f64::from(i % 20), f64::from(i / 20), 0.0);
        let cloud = |copied: u32| {
            let copies = (0..copied).map(|i| point(place(i) + 0.02, i));
            (0..400).map(|i| point(place(i), i)).chain(copies).collect()
        };
        assert_eq!([134, 400].map(|copied| all_merged(cloud(copied)).len()), [534, 400]);
        // The third of a chain is a copy of the second, which goes, and not of the first.
        let of_chain = |i: u32| {
            let turn = std::f64::consts::TAU * f64::from(i % 100) / 100.0;
            DVec3::new(16.0 * turn.cos(), 16.0 * turn.sin(), 0.15 * f64::from(i / 100))
        };
        let merged = all_merged((0..300).map(|i| point(of_chain(i), i)).collect());
        assert_eq!((merged.len(), merged[100].position), (200, of_chain(200)));
    }
}
