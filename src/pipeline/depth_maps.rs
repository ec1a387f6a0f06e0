//! Depth maps of photos as points to start from.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use glam::DVec2;
use image::{DynamicImage, ImageReader};
use npyz::{DType, NpyFile, TypeChar};
use rayon::prelude::*;

use crate::scene::{Photo, Point, Resize, Scene, View};
use crate::wording::counted;

/// Most points of all maps together: one for so many pixels trained on, within these bounds. Growth needs room to put
/// Gaussians where they are needed.
const PIXELS_BY_POINT: u64 = 32;
const POINTS: (usize, usize) = (5_000, 100_000);
/// Steps of 16-bit maps in world units: millimetres, if these are metres.
const STEP: f32 = 1e-3;
/// Fewest points that tell a map's scale.
const FEWEST: usize = 8;
/// Median deviation from the scale, as a share of it, from which on a map does not fit the points.
const APART: f64 = 0.2;
/// Share of the depth by which neighbouring pixels differ at an edge, where no point is taken.
const EDGE: f32 = 0.05;

/// A decoded map, rows from the top.
struct Map {
    width: u32,
    height: u32,
    /// Along the camera's axis; not a positive number where there is none.
    depths: Vec<f32>,
}

/// Source of a map's scale.
enum Scale {
    /// The capture's points.
    Points(f64),
    /// Nothing: too few points lie in it.
    Unknown,
    /// The points contradict every scale.
    Apart,
}

/// Points from the depth maps of `views`, in coloured pixels of photos of this size, and what to tell of them; none without maps.
///
/// Each map has the scale at which it agrees with the scene's points, or, if too few of them lie in it, the other maps'.
/// Without any, its numbers are world units.
pub fn points(scene: &Scene, views: &[usize], resize: Resize) -> (Vec<Point>, Vec<String>) {
    let with: Vec<usize> =
        views.iter().copied().filter(|v| scene.views[*v].depth.is_some() && scene.views[*v].face.is_none()).collect();
    if with.is_empty() {
        return (Vec::new(), Vec::new());
    }
    let tracked = scene.points.iter().any(|point| !point.track.is_empty());
    let scaled = |v: &usize| {
        let view = &scene.views[*v];
        let map = read(view.depth.as_deref().unwrap_or(Path::new("")))?;
        if !view.lens.fits(map.width, map.height) {
            return Err(format!("is {} x {}, another shape than its photo", map.width, map.height));
        }
        let seen = scene.points.iter().filter(|point| !tracked || point.track.binary_search(&(*v as u32)).is_ok());
        Ok((scale(view, &map, seen), map))
    };
    let maps: Vec<Result<(Scale, Map), String>> = with.par_iter().map(scaled).collect();
    let mut notes = Vec::new();
    let mut known: Vec<f64> =
        maps.iter().flatten().filter_map(|(s, _)| if let Scale::Points(s) = s { Some(*s) } else { None }).collect();
    known.sort_by(f64::total_cmp);
    let usual = known.get(known.len() / 2).copied().unwrap_or(1.0);
    let pixels: u64 = views.iter().map(|v| scene.views[*v].camera_at(resize).pixels()).sum();
    let each = ((pixels / PIXELS_BY_POINT) as usize).clamp(POINTS.0, POINTS.1).div_ceil(with.len());
    let made = |(v, map): (&usize, &Result<(Scale, Map), String>)| match map {
        Ok((Scale::Points(scale), map)) => of_map(&scene.views[*v], map, (*scale, each), resize),
        Ok((Scale::Unknown, map)) => of_map(&scene.views[*v], map, (usual, each), resize),
        Ok((Scale::Apart, _)) | Err(_) => Vec::new(),
    };
    let points: Vec<Point> = with.par_iter().zip(&maps).flat_map_iter(made).collect();
    for (v, map) in with.iter().zip(&maps) {
        if let Err(what) = map {
            notes.push(format!("depth map of {} {what}; not used", scene.views[*v].name));
        }
    }
    let apart = maps.iter().flatten().filter(|(s, _)| matches!(s, Scale::Apart)).count();
    if apart > 0 {
        let maps = counted(apart, "depth map");
        notes.push(format!("{maps} at no scale near the points (inverse depths?); not used"));
    }
    let found = counted(points.len(), "point");
    let maps = counted(maps.iter().flatten().filter(|(s, _)| !matches!(s, Scale::Apart)).count(), "depth map");
    let scales = match (known.first(), known.last()) {
        (Some(low), Some(high)) => format!(", scales {low:.3} to {high:.3} by the capture's points"),
        _ => ", in world units".to_owned(),
    };
    notes.push(format!("{found} from {maps}{scales}"));
    (points, notes)
}

/// Reads a map: 16-bit pictures in thousandths, EXR and npy as they are.
fn read(path: &Path) -> Result<Map, String> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy")) {
        return read_npy(path);
    }
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(|e| e.to_string())?;
    let decoded = reader.decode().map_err(|e| format!("cannot be decoded: {e}"))?;
    let (width, height) = (decoded.width(), decoded.height());
    let depths = match decoded {
        DynamicImage::ImageLuma16(steps) => steps.into_raw().into_iter().map(|s| f32::from(s) * STEP).collect(),
        DynamicImage::ImageRgb32F(values) => values.pixels().map(|p| p.0[0]).collect(),
        DynamicImage::ImageRgba32F(values) => values.pixels().map(|p| p.0[0]).collect(),
        _ => return Err("has neither 16 bits nor floats".to_owned()),
    };
    Ok(Map { width, height, depths })
}

fn read_npy(path: &Path) -> Result<Map, String> {
    let file = File::open(path).map_err(|e| e.to_string())?;
    let bytes = file.metadata().map_err(|e| e.to_string())?.len();
    let npy = NpyFile::new(BufReader::new(file)).map_err(|e| format!("cannot be read: {e}"))?;
    let (height, width) = match *npy.shape() {
        [h, w] | [h, w, 1] | [1, h, w] => (h, w),
        ref other => return Err(format!("has the shape {other:?}, not height x width")),
    };
    // A claim of more numbers than the file can hold is damage.
    if width == 0 || height == 0 || width.checked_mul(height).is_none_or(|n| n > bytes) {
        return Err(format!("of {height} x {width} numbers is cut short"));
    }
    if npy.order() != npyz::Order::C {
        return Err("has columns first (Fortran's order)".to_owned());
    }
    let DType::Plain(kind) = npy.dtype() else { return Err("has records".to_owned()) };
    let cut = |e: std::io::Error| format!("is cut short: {e}");
    let depths: Vec<f32> = match (kind.type_char(), kind.num_bytes()) {
        (TypeChar::Float, Some(4)) => npy.into_vec::<f32>().map_err(cut)?,
        (TypeChar::Float, Some(8)) => npy.into_vec::<f64>().map_err(cut)?.into_iter().map(|v| v as f32).collect(),
        (TypeChar::Uint, Some(2)) => {
            npy.into_vec::<u16>().map_err(cut)?.into_iter().map(|v| f32::from(v) * STEP).collect()
        }
        _ => return Err(format!("has numbers of type {kind}, not f4, f8 or u2")),
    };
    Ok(Map { width: width as u32, height: height as u32, depths })
}

impl Map {
    /// The depth at a pixel, if there is one, and none of its neighbours lies at another.
    fn at(&self, x: u32, y: u32) -> Option<f64> {
        let value = |x: u32, y: u32| self.depths[y as usize * self.width as usize + x as usize];
        let depth = value(x, y);
        let (left, above) = (x.saturating_sub(1), y.saturating_sub(1));
        let (right, below) = ((x + 1).min(self.width - 1), (y + 1).min(self.height - 1));
        let around = [value(left, y), value(right, y), value(x, above), value(x, below)];
        let usable = depth > 0.0 && depth.is_finite() && around.iter().all(|d| (d - depth).abs() <= EDGE * depth);
        usable.then_some(f64::from(depth))
    }
}

/// The factor by which a map's depths become those of the points that it shows.
fn scale<'a>(view: &View, map: &Map, seen: impl Iterator<Item = &'a Point>) -> Scale {
    let lens = view.lens.resized(map.width, map.height);
    let ratio = |point: &Point| {
        let p = view.camera.rotation * point.position + view.camera.translation;
        let at = lens.project(p.truncate() / p.z);
        let inside =
            p.z > 0.0 && at.min_element() >= 0.0 && at.x < f64::from(map.width) && at.y < f64::from(map.height);
        if inside { map.at(at.x as u32, at.y as u32).map(|depth| p.z / depth) } else { None }
    };
    let mut ratios: Vec<f64> = seen.filter_map(ratio).collect();
    if ratios.len() < FEWEST {
        return Scale::Unknown;
    }
    let middle = |values: &mut [f64]| {
        let at = values.len() / 2;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let scale = middle(&mut ratios);
    let mut off: Vec<f64> = ratios.iter().map(|ratio| (ratio / scale - 1.0).abs()).collect();
    if middle(&mut off) > APART { Scale::Apart } else { Scale::Points(scale) }
}

/// At most about `most` points, evenly over a map.
fn of_map(view: &View, map: &Map, (scale, most): (f64, usize), resize: Resize) -> Vec<Point> {
    let Ok(photo) = view.load_photo(resize) else { return Vec::new() };
    let lens = view.lens.resized(map.width, map.height);
    let stride = (f64::from(map.width) * f64::from(map.height) / most as f64).sqrt().ceil().max(1.0) as u32;
    let places = (stride / 2..map.height).step_by(stride as usize);
    let places = places.flat_map(|y| (stride / 2..map.width).step_by(stride as usize).map(move |x| (x, y)));
    let point = |(x, y): (u32, u32)| {
        let depth = scale * map.at(x, y)?;
        let pixel = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let ray = lens.undistort((pixel - lens.principal) / lens.focal)?;
        let local = (ray * depth).extend(depth);
        let colour = seen_at(&photo, ray)?;
        let position = view.camera.rotation.transpose() * (local - view.camera.translation);
        Some(Point { position, colour, error: 0.0, track: Vec::new() })
    };
    places.filter_map(point).collect()
}

/// The colour that a photo has along a ray, unless it is hidden or transparent there.
fn seen_at(photo: &Photo, ray: DVec2) -> Option<[u8; 3]> {
    let camera = &photo.camera;
    let at = ray * camera.focal + camera.principal;
    let inside = at.min_element() >= 0.0 && at.x < f64::from(camera.width) && at.y < f64::from(camera.height);
    let pixel = if inside { at.y as usize * camera.width as usize + at.x as usize } else { return None };
    let [r, g, b, fourth] = photo.pixels.at(pixel).ok()?;
    (fourth >= 128).then_some([r, g, b])
}
