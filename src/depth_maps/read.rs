//! Files of depth maps: npy, 16-bit pictures, EXR, and COLMAP's own.

use std::io::{self, Cursor};
use std::path::Path;

use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, Text};
use glam::DVec2;
use half::f16;
use image::{DynamicImage, ImageReader};
use npyz::{DType, NpyFile, TypeChar};
use num_traits::{AsPrimitive, Bounded};
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult};

use crate::scene::unread_depth_map;

/// Steps of 16-bit maps in world units where nothing says them: millimetres, if these are metres.
const STEP: f64 = 1e-3;
/// Share of the depth by which neighbouring pixels differ at an edge, where no depth is taken.
const EDGE: f32 = 0.05;

/// Depth from which nothing was hit.
const NOTHING: f32 = 1e9;
/// Least share of a map that a background has.
const PLATEAU: f64 = 0.01;
/// Number of pixels that may be equally far by chance.
const FEW: f64 = 8.0;

/// A decoded map, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The depth of each pixel, row by row; not a positive number where there is none.
    pub depths: Vec<f32>,
    /// True if most pixels with a depth have a neighbour without: single points of a scanner, not a surface with holes.
    pub sparse: bool,
}

/// Reads a map, whose numbers are steps of this many world units; if none is given, whole numbers are thousandths, and floats units.
///
/// # Errors
/// A predicate that names the fault of the file.
pub fn read(path: &Path, step: Option<f64>) -> Result<Map, String> {
    let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
    let is_picture = || image::guess_format(&bytes).is_ok_and(|format| format.reading_enabled());
    let is_known = bytes.starts_with(EXR) || bytes.starts_with(NPY) || of_colmap(&bytes).is_some() || is_picture();
    match unread_depth_map(path).filter(|_| !is_known) {
        Some(what) => Err(what),
        None => of_bytes(&bytes, step),
    }
}

/// Reads a map from a file's bytes, see [`read`].
pub fn of_bytes(bytes: &[u8], step: Option<f64>) -> Result<Map, String> {
    let mut map = decoded(bytes, step)?;
    let any = |is: fn(&f32) -> bool| map.depths.iter().any(is);
    if any(|depth| *depth < 0.0) && !any(|depth| *depth > 0.0) {
        return Err("holds only negative depths: change their sign".to_owned());
    }
    map.drop_background();
    map.sparse = map.is_sparse();
    Ok(map)
}

fn decoded(bytes: &[u8], step: Option<f64>) -> Result<Map, String> {
    // The largest whole number of its kind says that nothing was hit.
    let length = |steps: f64, most: f64| if steps < most { (steps * step.unwrap_or(STEP)) as f32 } else { 0.0 };
    if bytes.starts_with(EXR) {
        return Ok(exr(bytes)?.in_units(step));
    }
    if bytes.starts_with(NPY) {
        return npy(bytes, length, step);
    }
    if let Some((sizes, numbers)) = of_colmap(bytes) {
        return Ok(colmap(sizes, numbers)?.in_units(step));
    }
    if let Some(map) = tiff(bytes) {
        return Ok(map.in_units(step));
    }
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let decoded = reader.decode().map_err(|e| format!("cannot be decoded: {e}"))?;
    let (width, height) = (decoded.width(), decoded.height());
    let floats = match decoded {
        DynamicImage::ImageLuma16(steps) => {
            let depths = steps.into_raw().into_iter().map(|v| length(v.into(), u16::MAX.into())).collect();
            return Ok(Map::new(width, height, depths));
        }
        DynamicImage::ImageRgb32F(values) => values.pixels().map(|p| p.0[0]).collect(),
        DynamicImage::ImageRgba32F(values) => values.pixels().map(|p| p.0[0]).collect(),
        _ => return Err("is neither one channel of 16 bits nor floats: save it as such, or as .npy".to_owned()),
    };
    Ok(Map::new(width, height, floats).in_units(step))
}

/// Width, height and channels of a map that COLMAP wrote, and the bytes after them; none for another file.
fn of_colmap(bytes: &[u8]) -> Option<([u32; 3], &[u8])> {
    let (mut sizes, mut rest) = ([0_u32; 3], bytes);
    for size in &mut sizes {
        // Ten digits at most.
        let end = rest.iter().take(11).position(|byte| *byte == b'&')?;
        *size = std::str::from_utf8(&rest[..end]).ok()?.parse().ok()?;
        rest = &rest[end + 1..];
    }
    Some((sizes, rest))
}

/// COLMAP's map of one channel, whose numbers are floats, row by row.
fn colmap([width, height, channels]: [u32; 3], numbers: &[u8]) -> Result<Map, String> {
    if channels != 1 || width == 0 || height == 0 {
        return Err(format!("holds {width} x {height} x {channels} numbers: give COLMAP's folder depth_maps"));
    }
    let (floats, rest) = numbers.as_chunks::<4>();
    if !rest.is_empty() || floats.len() as u64 != u64::from(width) * u64::from(height) {
        return Err(format!("has {} bytes, not {height} x {width} floats: copy it again", numbers.len()));
    }
    Ok(Map::new(width, height, floats.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()))
}

/// A TIFF with a single 32-bit float channel, which no picture has.
fn tiff(bytes: &[u8]) -> Option<Map> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).ok()?;
    let ((width, height), ColorType::Gray(32)) = (decoder.dimensions().ok()?, decoder.colortype().ok()?) else {
        return None;
    };
    let DecodingResult::F32(depths) = decoder.read_image().ok()? else { return None };
    Some(Map::new(width, height, depths))
}

/// First bytes of a file of NumPy.
const NPY: &[u8] = b"\x93NUMPY";
/// First bytes of an EXR file.
const EXR: &[u8] = &[0x76, 0x2f, 0x31, 0x01];
/// Last parts, in lower case, of the names that programs give to the channel of depths; colours have the same depth in each.
const CHANNELS: [&str; 5] = ["z", "depth", "v", "y", "r"];
/// Maximum number of values of a file, which may claim any.
const MOST_VALUES: usize = 1 << 28;

/// The channel of depths of an EXR file, or its only channel.
fn exr(bytes: &[u8]) -> Result<Map, String> {
    let damaged = |e: exr::error::Error| format!("cannot be decoded: {e}");
    let headers = MetaData::read_from_buffered(bytes, false).map_err(damaged)?.headers;
    let values = headers.iter().map(|h| h.layer_size.area().saturating_mul(h.channels.list.len()));
    if values.fold(0, usize::saturating_add) > MOST_VALUES {
        return Err("claims more values than a depth map has".to_owned());
    }
    let reader = exr::image::read::read().no_deep_data().largest_resolution_level().all_channels();
    let layers =
        reader.all_layers().all_attributes().non_parallel().from_buffered(Cursor::new(bytes)).map_err(damaged)?;
    let layers = layers.layer_data;
    let channels = || layers.iter().flat_map(|l| l.channel_data.list.iter().map(move |channel| (l.size, channel)));
    let last = |name: &Text| name.to_string().rsplit('.').next().unwrap_or_default().to_lowercase();
    let named = CHANNELS.iter().find_map(|wanted| channels().find(|(_, channel)| last(&channel.name) == *wanted));
    let only = channels().next().filter(|_| channels().count() == 1);
    let Some((size, channel)) = named.or(only) else {
        let names: Vec<String> = channels().map(|(_, channel)| channel.name.to_string()).collect();
        return Err(format!("has the channels {}, none of them Z, depth, V, Y or R", names.join(", ")));
    };
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    Ok(Map::new(side(size.0), side(size.1), channel.sample_data.values_as_f32().collect()))
}

fn npy(bytes: &[u8], length: impl Fn(f64, f64) -> f32, step: Option<f64>) -> Result<Map, String> {
    let npy = NpyFile::new(bytes).map_err(|e| format!("cannot be read: {e}"))?;
    let (height, width) = match *npy.shape() {
        [h, w] | [h, w, 1] | [1, h, w] | [1, 1, h, w] => (h, w),
        ref other => return Err(format!("has the shape {other:?}, not height x width")),
    };
    // A claim of more numbers than the file can hold is damage.
    if width == 0 || height == 0 || width.checked_mul(height).is_none_or(|n| n > bytes.len() as u64) {
        return Err(format!("of {height} x {width} numbers is cut short"));
    }
    let by_columns = npy.order() == npyz::Order::Fortran;
    let DType::Plain(kind) = npy.dtype() else { return Err("has records".to_owned()) };
    let is_float = matches!(kind.type_char(), TypeChar::Float);
    let cut = |e: io::Error| format!("is cut short: {e}");
    let depths: Vec<f32> = match (kind.type_char(), kind.num_bytes()) {
        (TypeChar::Float, Some(4)) => npy.into_vec::<f32>().map_err(cut)?,
        (TypeChar::Float, Some(8)) => npy.into_vec::<f64>().map_err(cut)?.into_iter().map(|v| v as f32).collect(),
        (TypeChar::Float, Some(2)) => npy.into_vec::<f16>().map_err(cut)?.into_iter().map(f16::to_f32).collect(),
        (TypeChar::Uint, Some(2)) => whole::<u16>(npy, length).map_err(cut)?,
        (TypeChar::Int, Some(2)) => whole::<i16>(npy, length).map_err(cut)?,
        (TypeChar::Uint, Some(4)) => whole::<u32>(npy, length).map_err(cut)?,
        (TypeChar::Int, Some(4)) => whole::<i32>(npy, length).map_err(cut)?,
        (TypeChar::Uint, Some(8)) => whole::<u64>(npy, length).map_err(cut)?,
        (TypeChar::Int, Some(8)) => whole::<i64>(npy, length).map_err(cut)?,
        _ => return Err(format!("has numbers of type {kind}, not f2, f4, f8, u2, u4, u8, i2, i4 or i8")),
    };
    let (width, height) = (width as usize, height as usize);
    let at = |i: usize| depths[i % width * height + i / width];
    let depths = if by_columns { (0..depths.len()).map(at).collect() } else { depths };
    let map = Map::new(width as u32, height as u32, depths);
    Ok(if is_float { map.in_units(step) } else { map })
}

/// Lengths of whole numbers, the largest of which says that nothing was hit.
fn whole<T: npyz::Deserialize + AsPrimitive<f64> + Bounded>(
    npy: NpyFile<&[u8]>,
    length: impl Fn(f64, f64) -> f32,
) -> io::Result<Vec<f32>> {
    let most = T::max_value().as_();
    Ok(npy.into_vec::<T>()?.into_iter().map(|steps| length(steps.as_(), most)).collect())
}

impl Map {
    /// A map as it was decoded.
    fn new(width: u32, height: u32, depths: Vec<f32>) -> Self {
        Self { width, height, depths, sparse: false }
    }

    /// A map of floats in world units, of which each number is a step of so many, if that is given.
    fn in_units(mut self, step: Option<f64>) -> Self {
        if let Some(step) = step {
            self.drop_nothing();
            self.depths.iter_mut().for_each(|depth| *depth = (f64::from(*depth) * step) as f32);
        }
        self
    }

    /// The depth of a pixel, and those left, right, above and below of it, or its own at the border.
    fn around(&self, x: u32, y: u32) -> (f32, [f32; 4]) {
        let value = |x: u32, y: u32| self.depths[y as usize * self.width as usize + x as usize];
        let (left, above) = (x.saturating_sub(1), y.saturating_sub(1));
        let (right, below) = ((x + 1).min(self.width - 1), (y + 1).min(self.height - 1));
        (value(x, y), [value(left, y), value(right, y), value(x, above), value(x, below)])
    }

    fn is_sparse(&self) -> bool {
        let pixels = (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y)));
        let mut counts = [0_usize; 2];
        for (depth, around) in pixels.map(|(x, y)| self.around(x, y)) {
            if depth > 0.0 {
                counts[usize::from(around.into_iter().all(|d| d > 0.0))] += 1;
            }
        }
        counts[0] > counts[1]
    }

    /// Removes the numbers by which renderers say that nothing was hit: the largest of a half, and a billion or more.
    fn drop_nothing(&mut self) {
        let largest_half = f16::MAX.to_f32();
        self.depths.iter_mut().filter(|d| **d >= NOTHING || **d == largest_half).for_each(|d| *d = 0.0);
    }

    /// Removes the background, which renderers write as such a number, or as a plateau at exactly the largest depth, far behind all others.
    fn drop_background(&mut self) {
        self.drop_nothing();
        let most = self.depths.iter().copied().filter(|d| d.is_finite()).fold(0.0, f32::max);
        let (mut count, mut next) = (0_usize, 0.0_f32);
        for depth in &self.depths {
            if *depth == most {
                count += 1;
            } else if *depth < most {
                next = next.max(*depth);
            }
        }
        if count as f64 > (PLATEAU * self.depths.len() as f64).max(FEW) && next > 0.0 && next < 0.5 * most {
            self.depths.iter_mut().filter(|d| **d == most).for_each(|d| *d = 0.0);
        }
    }

    /// The depth at a place in pixels, whose centres lie at halves: between the four pixels around it if they show one surface,
    /// else that of the place's own pixel. Inverse depths are averaged, which is exact on planes.
    pub fn between(&self, place: DVec2) -> Option<f64> {
        let own = self.at(place.x as u32, place.y as u32)?;
        let first = (place - 0.5).floor();
        let share = place - 0.5 - first;
        let corner = |x: f64, y: f64| {
            let at = |place: f64, size: u32| place.clamp(0.0, f64::from(size - 1)) as usize;
            let (x, y) = (at(first.x + x, self.width), at(first.y + y, self.height));
            let depth = self.depths[y * self.width as usize + x];
            ((f64::from(depth) - own).abs() <= 2.0 * f64::from(EDGE) * own).then(|| 1.0 / f64::from(depth))
        };
        let [a, b, c, d] = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(x, y)| corner(x, y));
        let along = |from: Option<f64>, to: Option<f64>, share: f64| Some(from? + share * (to? - from?));
        let inverse = along(along(a, b, share.x), along(c, d, share.x), share.y);
        Some(inverse.map_or(own, |inverse| 1.0 / inverse))
    }

    /// The depth at a pixel, if there is one, and none of its neighbours lies at another; neighbours without a depth do, unless
    /// the map is sparse.
    pub fn at(&self, x: u32, y: u32) -> Option<f64> {
        let (depth, around) = self.around(x, y);
        let agrees = |d: &f32| (self.sparse && (*d <= 0.0 || d.is_nan())) || (d - depth).abs() <= EDGE * depth;
        let usable = depth > 0.0 && depth.is_finite() && around.iter().all(agrees);
        usable.then_some(f64::from(depth))
    }
}
