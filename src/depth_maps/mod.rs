//! Depth maps of photos: their resampling to the views, their scale by the scene's points, and initial points from them.

mod fit;
pub mod read;

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use glam::DVec2;
use rayon::prelude::*;

use crate::effects::geometry::DEPTHS_AGREE;
use crate::effects::{DepthEvidence, DepthWitness};
use crate::sample::evenly;
use crate::scene::camera::Camera;
use crate::scene::{AlphaRole, DepthMap, Names, Photo, Point, Resize, Scene, View, median};
use crate::wording::counted;
use fit::{APART, Fitted, Meaning, Samples, Scale, Source, agreement, closer, fit};
use read::Map;

/// Most points of all maps together: one for so many pixels trained on, within these bounds. Growth needs room to put
/// Gaussians where they are needed.
const PIXELS_BY_POINT: u64 = 32;
const POINTS: (usize, usize) = (5_000, 100_000);
/// Most of a scene's points, evenly taken, that are looked up in each map where no track says which points a photo sees; and the number
/// of them in the map below which all points are looked up.
const WITNESSES: (usize, usize) = (32_768, 256);
/// Maximum number of pixels of a map: it shows shapes, not texture.
const MOST_PIXELS: f64 = 65_536.0;

/// The depth maps of a scene's views, before its photos are read.
#[derive(Clone, Debug, Default)]
pub struct DepthMaps {
    /// By the view's name.
    maps: HashMap<String, DepthMap>,
    /// Evidence on the maps, from the scene's points or from other maps.
    pub evidence: DepthEvidence,
    /// Points in the maps; their track is the view that sees them, and their colour is not known yet.
    pub points: Vec<Point>,
    /// Notes for the user on maps that are not used or doubtful.
    pub notes: Vec<String>,
    /// Notes for the user on how the others are used.
    pub choices: Vec<String>,
}

/// Evidence about all maps from those with enough points.
struct Known {
    /// Factors to depths, ascending, of the maps that measure what most do and agree with the points; maps may have steps or units of
    /// their own.
    scales: Vec<f64>,
    /// Median over the maps of the points' median deviation from each; none if too few points lie in every map.
    deviation: Option<f64>,
    /// Meaning of most maps' numbers.
    meaning: Meaning,
    /// True if more maps contradict the points than fit them: those fit by chance.
    doubted: bool,
    /// True if most maps contradict the points.
    contradicted: bool,
}

impl Known {
    fn of(found: &[Found]) -> Self {
        let fitted = || found.iter().filter_map(|f| f.map.as_ref().ok());
        let mut known: Vec<(Meaning, f64, f64)> = fitted()
            .filter_map(|f| if let Scale::Points(scale, off) = f.scale { Some((f.meaning, scale, off)) } else { None })
            .collect();
        let apart = fitted().filter(|f| matches!(f.scale, Scale::Apart)).count();
        let doubted = apart > known.len();
        if doubted {
            known.clear();
        }
        let count = |meaning: &Meaning| known.iter().filter(|k| k.0 == *meaning).count();
        let meaning = Meaning::ALL.into_iter().rev().max_by_key(count).unwrap_or_default();
        known.retain(|k| k.0 == meaning);
        let tells = |k: &&(Meaning, f64, f64)| meaning != Meaning::Inverse && k.2 <= DEPTHS_AGREE;
        let mut scales: Vec<f64> = known.iter().filter(tells).map(|k| k.1).collect();
        scales.sort_by(f64::total_cmp);
        let deviation = median(&mut known.iter().map(|k| k.2).collect::<Vec<_>>());
        Self { scales, deviation, meaning, doubted, contradicted: 2 * apart > fitted().count() }
    }

    /// The median scale of the maps that agree with the points.
    fn usual(&self) -> Option<f64> {
        self.scales.get(self.scales.len() / 2).copied()
    }

    /// The median scale of the others, if these are alike, for a map of its own scale from which the points deviate too much.
    fn lent(&self, scale: &Scale) -> Option<f64> {
        let alike = matches!(self.scales[..], [low, .., high] if high <= low * (1.0 + DEPTHS_AGREE));
        self.usual().filter(|_| alike && matches!(scale, Scale::Points(_, off) if *off > DEPTHS_AGREE))
    }

    /// The meaning and the scale by which a map is used; none if it is not, as where it seems to mean something else than most. A map
    /// with too few points, or too far from them where the others are alike, is like these; inverse depths have a scale of their own in each.
    fn use_of(&self, fitted: &Fitted) -> Option<(Meaning, f64)> {
        match fitted.scale {
            Scale::Points(..) if self.doubted || fitted.meaning != self.meaning => None,
            Scale::Points(scale, _) => Some((fitted.meaning, self.lent(&fitted.scale).unwrap_or(scale))),
            Scale::Unknown if self.contradicted || self.meaning == Meaning::Inverse => None,
            Scale::Unknown => Some((self.meaning, self.usual().unwrap_or(1.0))),
            Scale::Apart => None,
        }
    }
}

/// The views of one photo with its map.
struct Found {
    views: Vec<usize>,
    map: Result<Fitted, String>,
}

/// The depth maps of `views`, for pictures of this size.
///
/// Each map is scaled to fit the scene's points, or, if too few of them lie in it, by the scale of the other maps. Without any
/// scale, its numbers are world units. The points also tell lengths along rays, depths along the axis and inverse depths from
/// each other. Maps that deviate too much to be trained on give no points.
pub fn of_views(scene: &Scene, views: &[usize], resize: Resize) -> DepthMaps {
    let with: Vec<usize> = views.iter().copied().filter(|v| scene.views[*v].depth.is_some()).collect();
    if with.is_empty() {
        return DepthMaps::default();
    }
    let tracks = Tracks::of(scene);
    let same = |a: &usize, b: &usize| scene.views[*a].depth == scene.views[*b].depth;
    let photos: Vec<&[usize]> = with.chunk_by(same).collect();
    let found: Vec<Found> = photos.par_iter().map(|views| find(scene, views, tracks.as_ref())).collect();
    let known = Known::of(&found);
    let shown = |f: &Found| -> Vec<(usize, DepthMap)> {
        let used = f.map.as_ref().ok().and_then(|fitted| Some((&fitted.map, known.use_of(fitted)?)));
        let Some((map, (meaning, scale))) = used else { return Vec::new() };
        f.views.iter().map(|v| (*v, seen(&scene.views[*v], map, meaning, scale, resize))).collect()
    };
    let maps: Vec<(usize, DepthMap)> = found.par_iter().flat_map_iter(shown).collect();
    let pixels: u64 = views.iter().map(|v| scene.views[*v].camera_at(resize).pixels()).sum();
    let each = ((pixels / PIXELS_BY_POINT) as usize).clamp(POINTS.0, POINTS.1).div_ceil(with.len());
    let points: Vec<Point> =
        maps.par_iter().flat_map_iter(|(v, map)| points(*v, &scene.views[*v], map, each)).collect();
    let usable = found.iter().filter_map(|f| known.use_of(f.map.as_ref().ok()?)).count();
    let (by, deviation) = match known.deviation {
        None => (DepthWitness::Maps, agreement(scene, &maps, &points)),
        off => (DepthWitness::Points, off),
    };
    let unseen = by == DepthWitness::Maps && deviation.is_none() && usable > 1;
    if let (DepthWitness::Maps, Some(apart)) = (by, deviation.filter(|deviation| *deviation > APART)) {
        let notes = vec![format!(
            "depth maps show the same places at depths {:.0} % apart in the median, and no points tell their scale (inverse depths? \
             another unit?); not used",
            100.0 * apart
        )];
        let evidence = DepthEvidence { maps: 0, by, deviation };
        return DepthMaps { evidence, notes, ..DepthMaps::default() };
    }
    let evidence = DepthEvidence { maps: usable, by, deviation };
    let points = if apart(&evidence).is_some() { Vec::new() } else { points };
    let mut notes = notes(scene, &found, &known);
    let mut choices = converted(&found, &known);
    let list = if unseen || apart(&evidence).is_some() { &mut notes } else { &mut choices };
    list.extend((usable > 0).then(|| yielded(&evidence, &known.scales, points.len(), unseen)));
    let maps = maps.into_iter().map(|(v, map)| (scene.views[v].name.clone(), map)).collect();
    DepthMaps { maps, evidence, points, notes, choices }
}

/// The deviation of maps that is too large for them to be trained on, or to give points.
fn apart(evidence: &DepthEvidence) -> Option<f64> {
    evidence.deviation.filter(|deviation| *deviation > DEPTHS_AGREE)
}

/// A note on the number of points from maps, and on their scales; `unseen` if no other map shows what one does.
fn yielded(evidence: &DepthEvidence, scales: &[f64], points: usize, unseen: bool) -> String {
    let maps = counted(evidence.maps, "depth map");
    if let Some(apart) = apart(evidence) {
        let what = match evidence.by {
            DepthWitness::Points => "the capture's points deviate from them",
            DepthWitness::Maps => "they deviate from each other",
        };
        let [apart, most] = [apart, DEPTHS_AGREE].map(|share| 100.0 * share);
        return format!("no points from {maps}: {what} by {apart:.1} % of the depth (median), more than {most:.0} %");
    }
    let scales = match (scales.first(), scales.last()) {
        (Some(low), Some(high)) => format!(", scales {low:.3} to {high:.3} by the capture's points"),
        _ if evidence.by == DepthWitness::Points => String::new(),
        _ if unseen => ", in world units, which no other photo's map confirms".to_owned(),
        _ => ", in world units".to_owned(),
    };
    format!("{} from {maps}{scales}", counted(points, "point"))
}

/// Notes for the user on maps that are not used, with reasons, or have the scale of others.
fn notes(scene: &Scene, found: &[Found], known: &Known) -> Vec<String> {
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
    let with = |what: &dyn Fn(&Fitted) -> bool| found.iter().filter(|f| f.map.as_ref().is_ok_and(what)).count();
    for (count, told) in [
        (with(&|f| matches!(f.scale, Scale::Apart)), "at no scale near the points; not used"),
        (
            with(&|f| matches!(f.scale, Scale::Points(..)) && known.use_of(f).is_none()),
            if known.doubted {
                "near the points, but most maps are not; not used"
            } else {
                "with other numbers than most (depths along the axis, inverse depths or lengths along rays); not used"
            },
        ),
        (
            with(&|f| matches!(f.scale, Scale::Unknown) && known.use_of(f).is_none()),
            if known.contradicted {
                "with too few points to tell whether they are better than the others; not used"
            } else {
                "with too few points to tell a scale, as inverse depths have one each; not used"
            },
        ),
        (
            with(&|f| known.lent(&f.scale).is_some() && known.use_of(f).is_some()),
            "too far from the points to tell a scale, used at the median scale of the others",
        ),
    ] {
        if count > 0 {
            notes.push(format!("{} {told}", counted(count, "depth map")));
        }
    }
    notes
}

/// Notes for the user on maps of other numbers than depths.
fn converted(found: &[Found], known: &Known) -> Vec<String> {
    let used = |f: &Found| Some(known.use_of(f.map.as_ref().ok()?)?.0);
    let told = |(meaning, told): (Meaning, &str)| {
        let count = found.iter().filter(|f| used(f) == Some(meaning)).count();
        (count > 0).then(|| format!("{} {told}", counted(count, "depth map")))
    };
    let meanings = [
        (Meaning::Inverse, "of inverse depths, converted by the points that each shows"),
        (Meaning::Rays, "of lengths along rays, not of depths; used as such"),
        (Meaning::Axis, "of depths along the photo's axis, not of lengths along rays; used as such"),
    ];
    meanings.into_iter().filter_map(told).collect()
}

/// The points that each view sees.
struct Tracks {
    /// The index in `points` at which each view's points begin, and their number at the end.
    starts: Vec<usize>,
    /// Numbers, in the scene, of the points that each view sees, view by view.
    points: Vec<u32>,
}

impl Tracks {
    /// The points of each view; none if no track names a view of the scene.
    fn of(scene: &Scene) -> Option<Self> {
        let entries = || {
            let points = scene.points.iter().zip(0_u32..);
            let seen = points.flat_map(|(point, number)| point.track.iter().map(move |view| (*view as usize, number)));
            seen.filter(|(view, _)| *view < scene.views.len())
        };
        let mut starts = vec![0; scene.views.len() + 1];
        entries().for_each(|(view, _)| starts[view + 1] += 1);
        (1..starts.len()).for_each(|view| starts[view] += starts[view - 1]);
        let mut points = vec![0; *starts.last()?];
        let mut next = starts.clone();
        for (view, number) in entries() {
            points[next[view]] = number;
            next[view] += 1;
        }
        (!points.is_empty()).then_some(Self { starts, points })
    }

    /// The numbers of the points that one of these views sees, ascending.
    fn seen(&self, views: &[usize]) -> Vec<u32> {
        let mut seen: Vec<u32> =
            views.iter().flat_map(|v| &self.points[self.starts[*v]..self.starts[v + 1]]).copied().collect();
        seen.sort_unstable();
        seen.dedup();
        seen
    }
}

/// The map of the photo that these views show, and what its numbers are.
fn find(scene: &Scene, views: &[usize], tracks: Option<&Tracks>) -> Found {
    let view = &scene.views[views[0]];
    let samples = |map: &Map, hidden: bool| {
        if let Some(tracks) = tracks {
            let seen = tracks.seen(views);
            return Samples::of(view, map, seen.iter().map(|number| &scene.points[*number as usize]), false);
        }
        let step = scene.points.len().div_ceil(WITNESSES.0).max(1);
        let some = Samples::of(view, map, scene.points.iter().step_by(step), hidden);
        if step == 1 || some.len() >= WITNESSES.1 { some } else { Samples::of(view, map, scene.points.iter(), hidden) }
    };
    let map = view.depth.as_deref().ok_or_else(String::new).and_then(|path| read::read(path, view.depth_step));
    let map = map.and_then(|map| {
        if !view.lens.fits(map.width, map.height) {
            return Err(format!("is {} x {}, another shape than its photo", map.width, map.height));
        }
        if tracks.is_some() {
            let seen = samples(&map, false);
            return Ok(fit(map, &seen));
        }
        // Without tracks, points may be hidden, or stray before what the photo shows.
        let [all, front] = [false, true].map(|hidden| samples(&map, hidden));
        Ok(closer(fit(map.clone(), &all), fit(map, &front), front.len()))
    });
    Found { views: views.to_vec(), map }
}

/// A view's camera at the size of its map.
fn camera(view: &View, resize: Resize) -> Camera {
    let camera = view.camera_at(resize);
    let smaller = (MOST_PIXELS / camera.pixels() as f64).sqrt().min(1.0);
    let [width, height] = [camera.width, camera.height].map(|n| ((f64::from(n) * smaller) as u32).max(1));
    camera.resized(width, height)
}

/// The depths that a view sees of its photo's map, pixel by pixel.
fn seen(view: &View, map: &Map, meaning: Meaning, scale: f64, resize: Resize) -> DepthMap {
    let (camera, source) = (camera(view, resize), Source::new(view, map, meaning));
    let depth = |n: u32| {
        let pixel = DVec2::new(f64::from(n % camera.width), f64::from(n / camera.width)) + 0.5;
        let ray = source.back * camera.ray(pixel);
        let unit = source.depth(ray);
        source.look(map, ray).filter(|_| unit > 0.0).map_or(0.0, |measured| (measured / unit) as f32)
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
        places = evenly(&measured(1), most).copied().collect();
    }
    let point = |(x, y): (u32, u32)| {
        let depth = map.at(x, y)?;
        let pixel = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let position = camera.rotation.transpose() * (camera.ray(pixel) * depth - camera.translation);
        Some(Point { position, normal: None, colour: [0; 3], error: 0.0, track: vec![v as u32] })
    };
    places.into_iter().filter_map(point).collect()
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
