//! The colours that photos show where their poses place points, compared with those of other photos and of the points.

use super::training_set::Thumbnail;
use crate::sample::evenly;
use crate::scene::camera::Camera;
use crate::scene::{Front, Point, Reading, Scene, fronts, median};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Number of other photos that must show a point, and the largest number whose colours are compared.
const OTHERS: (usize, usize) = (2, 31);
/// Smallest number of common points for a correlation; the same for a photo whose points have no tracks.
const FEWEST: (usize, usize) = (30, 60);
/// Largest number of points with tracks.
const TRACKED: usize = 40_000;
/// Largest number of pairs of a photo and a point without tracks, and bounds of the number of such points.
pub(super) const PAIRS: usize = 4_000_000;
pub(super) const PROJECTED: (usize, usize) = (500, 10_000);
/// Number of photos by which [`Sights::smoothness`] is measured.
const SMOOTHNESS: usize = 16;

/// A change of all poses or all photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Poses have another meaning.
    Read(Reading),
    /// Photos are mirrored, left to right.
    Mirrored,
    /// Photos are turned by 180°.
    Turned,
    /// Each pose shows the next photo.
    Next,
    /// Each pose shows the photo before.
    Previous,
}

impl Change {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Read(Reading::CameraToWorld),
        Self::Read(Reading::OpenGl),
        Self::Read(Reading::ScalarLast),
        Self::Mirrored,
        Self::Turned,
        Self::Next,
        Self::Previous,
    ];
}

/// Agreement of a photo with what its pose should show: rank correlations over points, the highest of brightness, red,
/// green and blue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    /// Correlation with the medians of the other photos' colours.
    pub others: f64,
    /// Correlation with the points' own colours; -1 if these are all the same.
    pub colours: f64,
    /// Median difference in brightness from the other photos', apart from a common one; 0 to 1.
    pub residual: f64,
}

impl Fit {
    /// The better of both correlations.
    pub fn agreement(&self) -> f64 {
        self.others.max(self.colours)
    }
}

/// A view with its small copy.
struct Sight<'a> {
    thumbnail: &'a Thumbnail,
    /// Number of its photo.
    photo: usize,
    /// Points whose tracks name it.
    seen: Vec<usize>,
}

/// The photos of a scene, and the points by which they are compared.
pub(super) struct Sights<'a> {
    /// Names of the photos.
    pub photos: Vec<&'a str>,
    /// True if tracks tell which photos see which points; otherwise, those see them where nothing nearer hides them.
    pub tracked: bool,
    /// True if no photo is cut into several views.
    pub whole: bool,
    all: Vec<Sight<'a>>,
    points: Vec<&'a Point>,
    origin: DVec3,
}

/// A point's place in a view, and its colour there.
struct Look {
    point: usize,
    place: DVec2,
    colour: DVec3,
}

/// A point's place in a view and its colours: there, in the other photos, and its own.
#[derive(Clone, Copy)]
struct Pair {
    place: DVec2,
    shown: DVec3,
    others: DVec3,
    own: DVec3,
}

impl<'a> Sights<'a> {
    /// The views of a scene whose photos are there, without those of the photos `left_out`; `thumbnails` are those of the scene's views.
    pub fn of(scene: &'a Scene, thumbnails: &'a [Option<Thumbnail>], left_out: &BTreeSet<&str>) -> Self {
        let tracked = scene.points.iter().any(|point| !point.track.is_empty());
        let whole = scene.views.iter().all(|view| view.face.is_none());
        let (mut all, mut photos): (Vec<Sight<'a>>, Vec<&'a str>) = (Vec::new(), Vec::new());
        let mut sight_of: Vec<Option<usize>> = vec![None; scene.views.len()];
        for ((view, thumbnail), number) in scene.views.iter().zip(thumbnails).zip(&mut sight_of) {
            let name = view.photo_name();
            let Some(thumbnail) = thumbnail.as_ref().filter(|_| !left_out.contains(name)) else { continue };
            if photos.last() != Some(&name) {
                photos.push(name);
            }
            *number = Some(all.len());
            all.push(Sight { thumbnail, photo: photos.len() - 1, seen: Vec::new() });
        }
        let points: Vec<&'a Point> = if tracked {
            let long: Vec<&'a Point> = scene.points.iter().filter(|point| point.track.len() > OTHERS.0).collect();
            evenly(&long, TRACKED).copied().collect()
        } else {
            evenly(&scene.points, (PAIRS / all.len().max(1)).clamp(PROJECTED.0, PROJECTED.1)).collect()
        };
        for (k, point) in points.iter().enumerate() {
            for sight in point.track.iter().filter_map(|view| sight_of.get(*view as usize).copied().flatten()) {
                all[sight].seen.push(k);
            }
        }
        Self { photos, tracked, whole, all, points, origin: scene.origin }
    }

    /// How well each photo fits, if enough points tell; that of a photo with several views is the best of theirs.
    pub fn fits(&self, change: Option<Change>) -> Vec<Option<Fit>> {
        let looks: Vec<Vec<Look>> = (0..self.all.len()).into_par_iter().map(|i| self.looks(i, change)).collect();
        let mut colours: Vec<Vec<(usize, DVec3)>> = vec![Vec::new(); self.points.len()];
        for (sight, seen) in self.all.iter().zip(&looks) {
            for look in seen {
                colours[look.point].push((sight.photo, look.colour));
            }
        }
        let of = |(sight, seen): (&Sight<'_>, &Vec<Look>)| self.fit(sight.photo, seen, &colours);
        let fits: Vec<Option<Fit>> = self.all.par_iter().zip(&looks).map(of).collect();
        let mut best: Vec<Option<Fit>> = vec![None; self.photos.len()];
        for (sight, fit) in self.all.iter().zip(fits) {
            let known = best[sight.photo];
            if fit.is_some_and(|fit| known.is_none_or(|known| fit.agreement() > known.agreement())) {
                best[sight.photo] = fit;
            }
        }
        best
    }

    /// What a view shows of the points, after a change.
    fn looks(&self, i: usize, change: Option<Change>) -> Vec<Look> {
        let (sight, count) = (&self.all[i], self.all.len());
        let camera = match change {
            Some(Change::Read(reading)) => reread(&sight.thumbnail.camera, reading, self.origin),
            _ => sight.thumbnail.camera.clone(),
        };
        let shown = match change {
            Some(Change::Next) => (i + 1) % count,
            Some(Change::Previous) => (i + count - 1) % count,
            _ => i,
        };
        let flip = match change {
            Some(Change::Mirrored) => DVec2::new(-1.0, 1.0),
            Some(Change::Turned) => DVec2::NEG_ONE,
            _ => DVec2::ONE,
        };
        let photo = self.all[shown].thumbnail;
        let places: Vec<(usize, DVec2)> = if self.tracked {
            let place = |k: &usize| {
                let p = camera.rotation * self.points[*k].position + camera.translation;
                (p.z > 0.0).then(|| (*k, camera.project(p)))
            };
            sight.seen.iter().filter_map(place).collect()
        } else {
            fronts(&camera, self.points.len(), |k| self.points[k].position)
                .into_iter()
                .map(|front| (front.point, front.place))
                .collect()
        };
        let look = |(point, place): (usize, DVec2)| {
            let at = (flip * (place / size(&camera) - 0.5) + 0.5) * size(&photo.camera);
            photo.colour_at(at).map(|(colour, _)| Look { point, place, colour })
        };
        places.into_iter().filter_map(look).collect()
    }

    /// How well a view of a photo fits; `colours` are those of each point, with the photos' numbers.
    fn fit(&self, photo: usize, looks: &[Look], colours: &[Vec<(usize, DVec3)>]) -> Option<Fit> {
        let pair = |look: &Look| {
            let others = evenly(&colours[look.point], OTHERS.1 + 1).filter(|(other, _)| *other != photo);
            let others: Vec<DVec3> = others.map(|(_, colour)| *colour).collect();
            let own = DVec3::from(self.points[look.point].colour.map(f64::from));
            (others.len() >= OTHERS.0).then(|| Pair {
                place: look.place,
                shown: look.colour,
                others: middle(&others),
                own,
            })
        };
        let pairs: Vec<Pair> = looks.iter().filter_map(pair).collect();
        if !self.tracked && pairs.len() < FEWEST.1 {
            return None;
        }
        // What has no points may hide a part of the picture: any half and any quarter may tell.
        let sides: &[Option<bool>] = if self.tracked { &[None] } else { &[None, Some(true), Some(false)] };
        let half = |axis: usize| median(&mut pairs.iter().map(|pair| pair.place[axis]).collect::<Vec<_>>());
        let half = DVec2::new(half(0)?, half(1)?);
        let mut parts: Vec<Vec<Pair>> = Vec::new();
        for (x, y) in sides.iter().flat_map(|x| sides.iter().map(move |y| (*x, *y))) {
            let on = |side: Option<bool>, low: bool| side.is_none_or(|side| side == low);
            let inside = |pair: &&Pair| on(x, pair.place.x < half.x) && on(y, pair.place.y < half.y);
            parts.push(pairs.iter().filter(inside).copied().collect());
        }
        let best = |of: fn(&Pair) -> DVec3| parts.iter().filter_map(|part| correlation(part, of)).reduce(f64::max);
        let others = best(|pair| pair.others)?;
        Some(Fit { others, colours: best(|pair| pair.own).unwrap_or(-1.0), residual: residual(&pairs) })
    }

    /// How much the points' colours resemble those of their neighbours in the pictures, as a rank correlation: near 0 if they were
    /// drawn by lot.
    pub fn smoothness(&self) -> f64 {
        let of = |sight: &Sight<'_>| {
            let mut front = fronts(&sight.thumbnail.camera, self.points.len(), |k| self.points[k].position);
            front.sort_by_key(|front| front.cell);
            let bright = |front: &Front| self.points[front.point].colour.iter().map(|c| f64::from(*c)).sum::<f64>();
            let neighbours = front.windows(2).filter(|pair| pair[0].cell == pair[1].cell);
            let (a, b): (Vec<f64>, Vec<f64>) = neighbours.map(|pair| (bright(&pair[0]), bright(&pair[1]))).unzip();
            if a.len() < FEWEST.0 { None } else { rank_correlation(&a, &b) }
        };
        median(&mut evenly(&self.all, SMOOTHNESS).filter_map(of).collect::<Vec<_>>()).unwrap_or_default()
    }
}

/// Width and height of a camera's picture in pixels.
fn size(camera: &Camera) -> DVec2 {
    DVec2::new(f64::from(camera.width), f64::from(camera.height))
}

/// The camera whose pose in the world of the files, whose origin is at `-origin`, has another reading.
fn reread(camera: &Camera, reading: Reading, origin: DVec3) -> Camera {
    let given = camera.relative_to(-origin);
    let (rotation, translation) = reading.pose((given.rotation, given.translation));
    Camera { rotation, translation, ..given }.relative_to(origin)
}

/// The median of colours, by channel.
fn middle(colours: &[DVec3]) -> DVec3 {
    let channel = |c: usize| median(&mut evenly(colours, OTHERS.1).map(|colour| colour[c]).collect::<Vec<_>>());
    DVec3::from([0, 1, 2].map(|c| channel(c).unwrap_or_default()))
}

/// The highest rank correlation between what is shown and what should be, of brightness and the three channels.
fn correlation(pairs: &[Pair], of: fn(&Pair) -> DVec3) -> Option<f64> {
    let series: [fn(DVec3) -> f64; 4] = [DVec3::element_sum, |c| c.x, |c| c.y, |c| c.z];
    let one = |value: fn(DVec3) -> f64| {
        let shown: Vec<f64> = pairs.iter().map(|pair| value(pair.shown)).collect();
        let wanted: Vec<f64> = pairs.iter().map(|pair| value(of(pair))).collect();
        rank_correlation(&shown, &wanted)
    };
    if pairs.len() < FEWEST.0 { None } else { series.into_iter().filter_map(one).reduce(f64::max) }
}

/// Median difference in brightness between photo and others, apart from a common one.
fn residual(pairs: &[Pair]) -> f64 {
    let mut apart: Vec<f64> = pairs.iter().map(|pair| (pair.shown - pair.others).element_sum() / 3.0).collect();
    let common = median(&mut apart).unwrap_or_default();
    median(&mut apart.iter().map(|v| (v - common).abs()).collect::<Vec<_>>()).unwrap_or_default()
}

/// The correlation between the ranks of two series of equal length; none if one is constant.
fn rank_correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let (a, b) = (ranks(a), ranks(b));
    let sum = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let spread = sum(&a, &a) * sum(&b, &b);
    (spread > 0.0).then(|| sum(&a, &b) / spread.sqrt())
}

/// The ranks of values, less the mean of all; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_unstable_by(|i, j| values[*i].total_cmp(&values[*j]));
    let mean = 0.5 * (values.len() as f64 - 1.0);
    let (mut ranks, mut before) = (vec![0.0; values.len()], 0);
    for equal in order.chunk_by(|i, j| values[*i] == values[*j]) {
        for i in equal {
            ranks[*i] = before as f64 + 0.5 * (equal.len() as f64 - 1.0) - mean;
        }
        before += equal.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_do_not_mind_exposures() {
        assert_eq!(ranks(&[5.0, 1.0, 5.0, 9.0]), [0.0, -1.5, 0.0, 1.5]);
        let (a, constant): (Vec<f64>, _) = ((0..40).map(|k| f64::from(k * 17 % 40)).collect(), [3.0; 40]);
        let brighter: Vec<f64> = a.iter().map(|v| (0.1 * v).exp()).collect();
        let negative: Vec<f64> = a.iter().map(|v| -v).collect();
        let with = |b: &[f64]| rank_correlation(&a, b);
        assert!(with(&brighter).is_some_and(|r| (r - 1.0).abs() < 1e-12));
        assert!(with(&negative).is_some_and(|r| (r + 1.0).abs() < 1e-12));
        assert_eq!(with(&constant), None);
    }
}
