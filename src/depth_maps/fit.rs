//! Finds what a depth map's numbers measure from the points in it, and whether maps agree with each other.

use std::collections::HashMap;

use glam::{DMat3, DVec2, DVec3};

use super::read::Map;
use crate::scene::lens::Lens;
use crate::scene::{DepthMap, Point, Scene, View, in_front, median};

/// Minimum number of points for a map's scale.
const FEWEST: usize = 8;
/// Minimum number of points that tell other numbers from depths: of noisy maps with fewer, some seem to hold them.
const TELLING: usize = 20;
/// Median relative deviation from the scale above which a map does not fit the points.
pub(super) const APART: f64 = 0.2;
/// Share of the deviation of depths below which points that deviate from another meaning decide for it.
const CLEARLY: f64 = 0.5;
/// Inverse depths are used from this share of the points' smallest to the largest divided by it: beyond, a scale found by
/// points says little.
const BEYOND: f64 = 0.5;
/// Distances, in photos, between maps that are compared.
const STEPS: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Median deviation from their ratio up to which two maps show the same surface.
const SAME_SURFACE: f64 = 0.05;

/// The quantity that a map's numbers measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Meaning {
    /// Depths along the camera's axis; along rays for photos that are cut into faces.
    #[default]
    Depths,
    /// Lengths along rays, of photos that are not cut into faces.
    Rays,
    /// Depths along the axis of photos that are cut into faces.
    Axis,
    /// Inverse depths, or disparities: inverse depths of any scale and offset.
    Inverse,
}

impl Meaning {
    pub(super) const ALL: [Self; 4] = [Self::Depths, Self::Rays, Self::Axis, Self::Inverse];
}

/// A map's scale.
pub(super) enum Scale {
    /// The factor from its numbers to depths by the capture's points, which deviate by this share of the depth in the median.
    Points(f64, f64),
    /// No scale is known: too few points lie in the map.
    Unknown,
    /// The points contradict every scale.
    Apart,
}

/// A map with what is known of its numbers.
pub(super) struct Fitted {
    /// The map; of inverse depths, the depths in world units.
    pub map: Map,
    pub meaning: Meaning,
    pub scale: Scale,
}

/// The photo of a view; the photo of a face looks along another axis.
pub(super) struct Source {
    lens: Lens,
    /// From the view's camera coordinates to the photo's.
    pub back: DMat3,
    along_rays: bool,
}

impl Source {
    /// The photo at the size of its map.
    pub fn new(view: &View, map: &Map, meaning: Meaning) -> Self {
        let back = view.face.as_ref().map_or(DMat3::IDENTITY, |face| face.turn.transpose());
        let along_rays = match meaning {
            Meaning::Rays => true,
            Meaning::Axis => false,
            Meaning::Depths | Meaning::Inverse => view.face.is_some(),
        };
        Self { lens: view.lens.resized(map.width, map.height), back, along_rays }
    }

    /// The number that a map in world units has for `place`, in the photo's camera coordinates; not positive for what the map
    /// cannot show.
    pub fn depth(&self, place: DVec3) -> f64 {
        if self.along_rays { place.length() } else { place.z }
    }

    /// The value of a map in a direction, in the photo's camera coordinates.
    pub fn look(&self, map: &Map, direction: DVec3) -> Option<f64> {
        let at = self.lens.pixel_of(direction);
        let inside = at.min_element() >= 0.0 && at.x < f64::from(map.width) && at.y < f64::from(map.height);
        if inside { map.between(at) } else { None }
    }
}

/// A point in a map: the map's number, and the depth that it would have.
#[derive(Clone, Copy)]
struct Sample {
    number: f64,
    depth: f64,
}

/// The median of |ratio - 1|.
fn deviation(ratios: impl Iterator<Item = f64>) -> f64 {
    median(&mut ratios.map(|ratio| (ratio - 1.0).abs()).collect::<Vec<_>>()).unwrap_or(f64::INFINITY)
}

/// The factor from numbers to depths, and the samples' median deviation from it.
fn scale(samples: &[Sample]) -> (f64, f64) {
    let ratios = || samples.iter().map(|s| s.depth / s.number);
    let scale = median(&mut ratios().collect::<Vec<_>>()).unwrap_or(1.0);
    (scale, deviation(ratios().map(|ratio| ratio / scale)))
}

/// The median deviation of the samples from their median depth.
fn level(samples: &[Sample]) -> f64 {
    let middle = median(&mut samples.iter().map(|s| s.depth).collect::<Vec<_>>()).unwrap_or(1.0);
    deviation(samples.iter().map(|s| s.depth / middle))
}

/// The line from numbers to inverse depths through the medians of the samples' lowest and highest third, if it rises, and the
/// median deviation of the depths from it.
fn line(samples: &[Sample]) -> Option<([f64; 2], f64)> {
    let mut by_number = samples.to_vec();
    by_number.sort_by(|a, b| a.number.total_cmp(&b.number));
    let third = by_number.len().div_ceil(3);
    let middle = |part: &[Sample]| {
        let of = |value: fn(&Sample) -> f64| median(&mut part.iter().map(value).collect::<Vec<_>>());
        Some((of(|s| s.number)?, of(|s| 1.0 / s.depth)?))
    };
    let ((low, from), (high, to)) = (middle(&by_number[..third])?, middle(&by_number[by_number.len() - third..])?);
    let slope = (to - from) / (high - low);
    let offset = median(&mut samples.iter().map(|s| 1.0 / s.depth - slope * s.number).collect::<Vec<_>>())?;
    let off = deviation(samples.iter().map(|s| s.depth * (slope * s.number + offset)));
    (slope > 0.0 && slope.is_finite()).then_some(([slope, offset], off))
}

/// Points in a view's map.
pub(super) struct Samples {
    /// Samples under the assumption that the map measures depths.
    depths: Vec<Sample>,
    /// Samples under the assumption that it measures what maps of such photos should not: lengths along rays, or depths
    /// along the axis of a photo that is cut.
    others: Vec<Sample>,
    /// The meaning that `others` assumes.
    other: Meaning,
}

impl Samples {
    /// Samples of the points that lie in the map; if any may be `hidden`, of those that no other one hides.
    pub fn of<'a>(view: &View, map: &Map, points: impl Iterator<Item = &'a Point>, hidden: bool) -> Self {
        let other = if view.face.is_some() { Meaning::Axis } else { Meaning::Rays };
        let [depths, others] = [Meaning::Depths, other].map(|meaning| Source::new(view, map, meaning));
        let (mut found, mut places) = (Vec::new(), Vec::new());
        for point in points {
            let p = depths.back * (view.camera.rotation * point.position + view.camera.translation);
            if let Some(number) = Some(p).filter(|p| depths.depth(*p) > 0.0).and_then(|p| depths.look(map, p)) {
                found.push((p, number));
                places.push((depths.lens.pixel_of(p), depths.depth(p)));
            }
        }
        if hidden {
            let mut shown = in_front(&places, DVec2::new(map.width.into(), map.height.into())).into_iter();
            found.retain(|_| shown.next().flatten().is_some());
        }
        let mut samples = Self { depths: Vec::new(), others: Vec::new(), other };
        for (p, number) in found {
            samples.depths.push(Sample { number, depth: depths.depth(p) });
            samples.others.extend(Some(others.depth(p)).filter(|d| *d > 0.0).map(|depth| Sample { number, depth }));
        }
        samples
    }

    /// Their number.
    pub fn len(&self) -> usize {
        self.depths.len()
    }
}

/// Finds what a map's numbers measure from the points in it.
pub(super) fn fit(mut map: Map, samples: &Samples) -> Fitted {
    let Samples { depths: by_depth, others, other } = samples;
    if by_depth.len() < FEWEST {
        return Fitted { map, meaning: Meaning::Depths, scale: Scale::Unknown };
    }
    let (mut factor, mut off) = scale(by_depth);
    let (mut meaning, most) = (Meaning::Depths, if samples.len() >= TELLING { CLEARLY * off } else { 0.0 });
    let (by_others, off_others) = scale(others);
    if off_others < most && others.len() >= TELLING {
        (meaning, factor, off) = (*other, by_others, off_others);
    }
    // A line may be level: it has to tell more than one depth for all.
    let most = most.min(CLEARLY * level(by_depth)).min(off);
    if let Some(([slope, offset], off_line)) = line(by_depth).filter(|(_, off_line)| *off_line < most) {
        (meaning, factor, off) = (Meaning::Inverse, 1.0, off_line);
        let inverse = || by_depth.iter().map(|s| 1.0 / s.depth);
        let least = BEYOND * inverse().fold(f64::INFINITY, f64::min);
        let most = inverse().fold(0.0, f64::max) / BEYOND;
        map.depths.iter_mut().for_each(|number| {
            let inverse = slope * f64::from(*number) + offset;
            *number = if *number > 0.0 && (least..=most).contains(&inverse) { (1.0 / inverse) as f32 } else { 0.0 };
        });
    }
    Fitted { map, meaning, scale: if off > APART { Scale::Apart } else { Scale::Points(factor, off) } }
}

/// The fit to all points, or the fit to the `count` points that no other hides if that one is clearly closer.
pub(super) fn closer(all: Fitted, front: Fitted, count: usize) -> Fitted {
    let off = |fitted: &Fitted| if let Scale::Points(_, off) = fitted.scale { off } else { f64::INFINITY };
    if count >= TELLING && off(&front) < CLEARLY * off(&all) { front } else { all }
}

/// Median deviation of photos' maps from each other, as a share of the depth: of the points of each map from the next
/// photo's map, or of whole maps from later ones that show the same surface. None if too few points lie in two maps.
pub(super) fn agreement(scene: &Scene, maps: &[(usize, DepthMap)], points: &[Point]) -> Option<f64> {
    let name = |view: usize| scene.views[view].photo_name();
    let photos: Vec<&[(usize, DepthMap)]> = maps.chunk_by(|a, b| name(a.0) == name(b.0)).collect();
    let places: HashMap<&str, usize> =
        photos.iter().enumerate().rev().map(|(at, photo)| (name(photo[0].0), at)).collect();
    let seen = |point: &Point, photo: &[(usize, DepthMap)]| {
        photo.iter().find_map(|(v, map)| {
            let camera = scene.views[*v].camera.resized(map.width, map.height);
            let [x, y] = camera.pixel_of(point.position)?;
            Some(camera.depth(point.position) / map.at(x, y)?)
        })
    };
    // The track of a point in a map is the view that sees it.
    let own = |point: &Point| point.track.first().map(|v| name(*v as usize));
    let (mut next, mut further) = (Vec::new(), Vec::new());
    for points in points.chunk_by(|a, b| own(a) == own(b)) {
        let at = own(&points[0]).and_then(|name| places.get(name).copied());
        for (step, photo) in STEPS.iter().filter_map(|step| Some((*step, photos.get(at? + step)?))) {
            let mut ratios: Vec<f64> = points.iter().filter_map(|point| seen(point, photo)).collect();
            if step == 1 {
                next.extend(ratios.iter().map(|ratio| (ratio - 1.0).abs()));
            }
            let Some(middle) = median(&mut ratios).filter(|_| ratios.len() >= FEWEST) else { continue };
            if deviation(ratios.iter().map(|ratio| ratio / middle)) < SAME_SURFACE {
                further.push((middle - 1.0).abs());
            }
        }
    }
    let near = median(&mut next).filter(|_| next.len() >= FEWEST)?;
    Some(median(&mut further).map_or(near, |far| near.max(far)))
}
