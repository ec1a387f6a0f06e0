//! Depth maps of photos: their resampling to the views, their scale by the scene's points, and initial points from them.

pub mod read;

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::effects::{DepthEvidence, DepthWitness};
use crate::scene::camera::Camera;
use crate::scene::lens::Lens;
use crate::scene::{AlphaRole, DepthMap, Names, Photo, Point, Resize, Scene, View, median};
use crate::wording::counted;
use read::Map;

/// Most points of all maps together: one for so many pixels trained on, within these bounds. Growth needs room to put
/// Gaussians where they are needed.
const PIXELS_BY_POINT: u64 = 32;
const POINTS: (usize, usize) = (5_000, 100_000);
/// Minimum number of points for a map's scale.
const FEWEST: usize = 8;
/// Median relative deviation from the scale above which a map does not fit the points.
const APART: f64 = 0.2;
/// Maximum number of pixels of a map: it shows shapes, not texture.
const MOST_PIXELS: f64 = 65_536.0;

/// The depth maps of a scene's views, before its photos are read.
#[derive(Clone, Debug, Default)]
pub struct DepthMaps {
    /// By the view's name.
    maps: HashMap<String, DepthMap>,
    /// Evidence on them: the scene's points, or each other.
    pub evidence: DepthEvidence,
    /// Points in the maps; their track is the view that sees them, and their colour is not known yet.
    pub points: Vec<Point>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Source of a map's scale.
enum Scale {
    /// The capture's points, which deviate by this share of the depth in the median.
    Points(f64, f64),
    /// None: too few points lie in it.
    Unknown,
    /// The points contradict every scale.
    Apart,
}

/// The views of one photo with its map.
struct Found {
    views: Vec<usize>,
    map: Result<(Scale, Map), String>,
}

/// The depth maps of `views`, for pictures of this size.
///
/// Each map is scaled to fit the scene's points, or, if too few of them lie in it, by the scale of the other maps. Without any
/// scale, its numbers are world units.
pub fn of_views(scene: &Scene, views: &[usize], resize: Resize) -> DepthMaps {
    let with: Vec<usize> = views.iter().copied().filter(|v| scene.views[*v].depth.is_some()).collect();
    if with.is_empty() {
        return DepthMaps::default();
    }
    let tracked = scene.points.iter().any(|point| !point.track.is_empty());
    let same = |a: &usize, b: &usize| scene.views[*a].depth == scene.views[*b].depth;
    let photos: Vec<&[usize]> = with.chunk_by(same).collect();
    let found: Vec<Found> = photos.par_iter().map(|views| find(scene, views, tracked)).collect();
    let mut known: Vec<[f64; 2]> = found
        .iter()
        .filter_map(|f| if let Ok((Scale::Points(scale, off), _)) = f.map { Some([scale, off]) } else { None })
        .collect();
    known.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let usual = known.get(known.len() / 2).map_or(1.0, |[scale, _]| *scale);
    let shown = |f: &Found| {
        let scale = match f.map {
            Ok((Scale::Points(scale, _), _)) => scale,
            Ok((Scale::Unknown, _)) => usual,
            Ok((Scale::Apart, _)) | Err(_) => return Vec::new(),
        };
        let Ok((_, map)) = &f.map else { return Vec::new() };
        f.views.iter().map(|v| (*v, seen(&scene.views[*v], map, scale, resize))).collect()
    };
    let maps: Vec<(usize, DepthMap)> = found.par_iter().flat_map_iter(shown).collect();
    let pixels: u64 = views.iter().map(|v| scene.views[*v].camera_at(resize).pixels()).sum();
    let each = ((pixels / PIXELS_BY_POINT) as usize).clamp(POINTS.0, POINTS.1).div_ceil(with.len());
    let points: Vec<Point> =
        maps.par_iter().flat_map_iter(|(v, map)| points(*v, &scene.views[*v], map, each)).collect();
    let usable = found.iter().filter(|f| !matches!(f.map, Ok((Scale::Apart, _)) | Err(_))).count();
    let mut off: Vec<f64> = known.iter().map(|[_, off]| *off).collect();
    let (by, deviation) = match median(&mut off) {
        None => (DepthWitness::Maps, agreement(scene, &maps, &points)),
        off => (DepthWitness::Points, off),
    };
    let unseen = by == DepthWitness::Maps && deviation.is_none() && usable > 1;
    let notes = notes(scene, &found, &known, (usable, points.len(), unseen));
    if let (DepthWitness::Maps, Some(apart)) = (by, deviation.filter(|deviation| *deviation > APART)) {
        let notes = vec![format!(
            "depth maps show the same places at depths {:.0} % apart in the median, and no points tell their scale (inverse depths? \
             another unit?); not used",
            100.0 * apart
        )];
        let evidence = DepthEvidence { maps: 0, by, deviation };
        return DepthMaps { evidence, notes, ..DepthMaps::default() };
    }
    let maps = maps.into_iter().map(|(v, map)| (scene.views[v].name.clone(), map)).collect();
    DepthMaps { maps, evidence: DepthEvidence { maps: usable, by, deviation }, points, notes }
}

/// Notes for the user: unused maps with reasons, and the number of points from the others.
fn notes(
    scene: &Scene,
    found: &[Found],
    known: &[[f64; 2]],
    (usable, points, unseen): (usize, usize, bool),
) -> Vec<String> {
    let mut unread: BTreeMap<&str, Names> = BTreeMap::new();
    for f in found {
        if let Err(what) = &f.map {
            unread.entry(what).or_default().add(scene.views[f.views[0]].photo_name());
        }
    }
    let told = |(what, names): (&str, Names)| {
        let each = if names.count == 1 { "it" } else { "each" };
        format!("{} not used: {each} {what} ({names})", counted(names.count, "depth map"))
    };
    let mut notes: Vec<String> = unread.into_iter().map(told).collect();
    let apart = found.iter().filter(|f| matches!(f.map, Ok((Scale::Apart, _)))).count();
    if apart > 0 {
        let maps = counted(apart, "depth map");
        notes.push(format!("{maps} at no scale near the points (inverse depths?); not used"));
    }
    let scales = match (known.first(), known.last()) {
        (Some([low, _]), Some([high, _])) => format!(", scales {low:.3} to {high:.3} by the capture's points"),
        _ if unseen => ", in world units, which no other photo's map confirms".to_owned(),
        _ => ", in world units".to_owned(),
    };
    notes.push(format!("{} from {}{scales}", counted(points, "point"), counted(usable, "depth map")));
    notes
}

/// The map of the photo that these views show, with its scale.
fn find(scene: &Scene, views: &[usize], tracked: bool) -> Found {
    let view = &scene.views[views[0]];
    let sees = |v: &usize, point: &Point| point.track.binary_search(&(*v as u32)).is_ok();
    let seen = scene.points.iter().filter(|point| !tracked || views.iter().any(|v| sees(v, point)));
    let map =
        view.depth.as_deref().ok_or_else(String::new).and_then(|path| read::read(path, view.depth_step)).and_then(
            |map| {
                if view.lens.fits(map.width, map.height) {
                    Ok((scale(view, &map, seen), map))
                } else {
                    Err(format!("is {} x {}, another shape than its photo", map.width, map.height))
                }
            },
        );
    Found { views: views.to_vec(), map }
}

/// The photo of a view; the photo of a face looks along another axis.
struct Source {
    lens: Lens,
    /// From the view's camera coordinates to the photo's.
    back: DMat3,
    /// True if depths are measured along rays, as for photos that are cut into faces.
    along_rays: bool,
}

impl Source {
    fn new(view: &View, map: &Map) -> Self {
        let back = view.face.as_ref().map_or(DMat3::IDENTITY, |face| face.turn.transpose());
        Self { lens: view.lens.resized(map.width, map.height), back, along_rays: view.face.is_some() }
    }

    /// The map's value divided by the depth at `place`, in the photo's camera coordinates.
    fn depth(&self, place: DVec3) -> f64 {
        if self.along_rays { place.length() } else { place.z }
    }

    /// The value of a map in a direction, in the photo's camera coordinates.
    fn look(&self, map: &Map, direction: DVec3) -> Option<f64> {
        let at = self.lens.pixel_of(direction);
        let inside = at.min_element() >= 0.0 && at.x < f64::from(map.width) && at.y < f64::from(map.height);
        if inside { map.at(at.x as u32, at.y as u32) } else { None }
    }
}

/// The factor from a map's values to the depths of the points that it shows.
fn scale<'a>(view: &View, map: &Map, seen: impl Iterator<Item = &'a Point>) -> Scale {
    let source = Source::new(view, map);
    let ratio = |point: &Point| {
        let p = source.back * (view.camera.rotation * point.position + view.camera.translation);
        let depth = source.depth(p);
        if depth > 0.0 { source.look(map, p).map(|measured| depth / measured) } else { None }
    };
    let mut ratios: Vec<f64> = seen.filter_map(ratio).collect();
    let Some(scale) = median(&mut ratios).filter(|_| ratios.len() >= FEWEST) else { return Scale::Unknown };
    let mut off: Vec<f64> = ratios.iter().map(|ratio| (ratio / scale - 1.0).abs()).collect();
    let off = median(&mut off).unwrap_or_default();
    if off > APART { Scale::Apart } else { Scale::Points(scale, off) }
}

/// A view's camera at the size of its map.
fn camera(view: &View, resize: Resize) -> Camera {
    let camera = view.camera_at(resize);
    let smaller = (MOST_PIXELS / camera.pixels() as f64).sqrt().min(1.0);
    let [width, height] = [camera.width, camera.height].map(|n| ((f64::from(n) * smaller) as u32).max(1));
    camera.resized(width, height)
}

/// The depths that a view sees of its photo's map, pixel by pixel.
fn seen(view: &View, map: &Map, scale: f64, resize: Resize) -> DepthMap {
    let (camera, source) = (camera(view, resize), Source::new(view, map));
    let depth = |n: u32| {
        let pixel = DVec2::new(f64::from(n % camera.width), f64::from(n / camera.width)) + 0.5;
        let ray = source.back * camera.ray(pixel);
        source.look(map, ray).map_or(0.0, |measured| (measured / source.depth(ray)) as f32)
    };
    let depths: Arc<[f32]> = (0..camera.width * camera.height).map(depth).collect();
    DepthMap { width: camera.width, height: camera.height, depths, unit: scale }
}

/// About `most` points at most, evenly distributed over the part of the map that view `v` sees.
fn points(v: usize, view: &View, map: &DepthMap, most: usize) -> Vec<Point> {
    let camera = view.camera.resized(map.width, map.height);
    let grid = |stride: u32| {
        let rows = (stride / 2..map.height).step_by(stride as usize);
        rows.flat_map(move |y| (stride / 2..map.width).step_by(stride as usize).map(move |x| (x, y)))
    };
    let stride = (f64::from(map.width) * f64::from(map.height) / most as f64).sqrt().ceil().max(1.0) as u32;
    let measured = |stride: u32| grid(stride).filter(|(x, y)| map.at(*x, *y).is_some()).collect::<Vec<_>>();
    let mut places = measured(stride);
    if places.len() < most / 8 {
        // A grid misses most of the few depths of a scanner.
        let all = measured(1);
        places = all.iter().copied().step_by(all.len().div_ceil(most).max(1)).collect();
    }
    let point = |(x, y): (u32, u32)| {
        let depth = map.at(x, y)?;
        let pixel = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let position = camera.rotation.transpose() * (camera.ray(pixel) * depth - camera.translation);
        Some(Point { position, normal: None, colour: [0; 3], error: 0.0, track: vec![v as u32] })
    };
    places.into_iter().filter_map(point).collect()
}

/// The median distance of the points of each map from the next photo's map, as a share of the depth; none if too few lie in it.
fn agreement(scene: &Scene, maps: &[(usize, DepthMap)], points: &[Point]) -> Option<f64> {
    let photos: Vec<&[(usize, DepthMap)]> =
        maps.chunk_by(|a, b| scene.views[a.0].photo_name() == scene.views[b.0].photo_name()).collect();
    let apart = |point: &Point| {
        let own = *point.track.first()? as usize;
        let next = photos.iter().find(|views| views[0].0 > own)?;
        let seen = |(v, map): &(usize, DepthMap)| {
            let camera = scene.views[*v].camera.resized(map.width, map.height);
            let [x, y] = camera.pixel_of(point.position)?;
            Some((camera.depth(point.position) / map.at(x, y)? - 1.0).abs())
        };
        next.iter().find_map(seen)
    };
    let mut apart: Vec<f64> = points.iter().filter_map(apart).collect();
    median(&mut apart).filter(|_| apart.len() >= FEWEST)
}

impl DepthMaps {
    /// Bytes of the maps in memory.
    pub fn bytes(&self) -> u64 {
        self.maps.values().map(DepthMap::bytes).sum()
    }

    /// The map of a view.
    pub fn of(&self, view: &str) -> Option<&DepthMap> {
        self.maps.get(view)
    }

    /// The map of a view without the masked or transparent pixels of its photo; none if the photo cannot be read.
    pub fn shown(&self, view: &str, photo: &Photo) -> Option<DepthMap> {
        let map = self.maps.get(view)?;
        if photo.alpha_role == AlphaRole::Opaque {
            return Some(map.clone());
        }
        let pixels = photo.pixels.read().ok()?;
        let [width, height] = [photo.camera.width, photo.camera.height].map(|n| n as usize);
        let scaled = |at: usize, from: u32, to: usize| (2 * at + 1) * to / (2 * from as usize);
        let depth = |(n, depth): (usize, &f32)| {
            let (x, y) = (n % map.width as usize, n / map.width as usize);
            let pixel = scaled(y, map.height, height) * width + scaled(x, map.width, width);
            if pixels.get(4 * pixel + 3).is_some_and(|fourth| *fourth >= 128) { *depth } else { 0.0 }
        };
        Some(DepthMap { depths: map.depths.iter().enumerate().map(depth).collect(), ..map.clone() })
    }
}

/// Colours the points of a scene from index `from` on by the photos of their views, and removes those that a mask hides or
/// whose photo is lost.
pub fn colour(scene: &mut Scene, from: usize, photos: &[Photo]) {
    let coloured = |mut point: Point| {
        let photo = photos.get(*point.track.first()? as usize)?;
        let [x, y] = photo.camera.pixel_of(point.position)?;
        let [r, g, b, fourth] = photo.pixels.at(y as usize * photo.camera.width as usize + x as usize).ok()?;
        (point.colour, point.track) = ([r, g, b], Vec::new());
        (fourth >= 128).then_some(point)
    };
    let measured = scene.points.split_off(from.min(scene.points.len()));
    scene.points.extend(measured.into_iter().filter_map(coloured));
}
