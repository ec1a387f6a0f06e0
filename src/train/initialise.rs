//! Initial models: Gaussians on reconstructed points, or on random points that several cameras see.

use super::error::{Error, Result};
use crate::gaussians::Gaussians;
use crate::kernels::constants::sh::float64::SH_C0;
use crate::random::uniform;
use crate::render::Settings;
use crate::scene::camera::Camera;
use crate::scene::{Front, Neighbours, ONE_PLACE, Photo, Point, Scene, USUAL_DISTANCE, fronts, median};
use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;
use std::io;

/// Initial opacity.
const OPACITY: f64 = 0.1;
/// Thickness of a Gaussian on a point with a normal, as a share of its width.
const FLATNESS: f64 = 0.1;
/// Floor of the mean squared distance to the nearest neighbours, in square world units.
const LEAST_SQUARED_DISTANCE: f64 = 1e-7;
/// Least initial colour of a channel: at 0, where a Gaussian draws nothing, it has no gradient.
const LEAST_COLOUR: f64 = 1.0 / 255.0;
/// Number of photos by which a point without a colour is coloured.
const LOOKS: usize = 8;
/// Number of points times number of photos in which they are searched for, at most, unless that means fewer than so many photos.
const SEARCHED: (usize, usize) = (400_000_000, 64);
/// Number of points of all photos that are looked at together, which bounds memory up to as many points.
const TOGETHER: usize = 8_000_000;
/// Smallest fourth byte of a pixel that colours a point.
const OPAQUE: u8 = 250;
/// Share of points with copies beyond which these do not count as neighbours.
const COPIED: f64 = 0.3;
/// Depths tried along a random ray; the one at which the photos agree best is taken.
const DEPTHS: u64 = 12;
/// Number of views that must see a random point, or the number of places of the cameras, if there are fewer: the faces of a
/// panorama see no point in common.
const SEEN_BY: usize = 3;
/// Least depth of the focus, as a share of the cameras' spread, for a camera to look at it; panoramas look everywhere.
const ASIDE: f64 = 0.1;
/// Number of views in which a random point's colour is compared.
const COMPARED: usize = 8;
/// Half the side of the cube that contains Blender scenes (the reference's).
const BLENDER_CUBE: f64 = 1.3;
/// Rays tried before the search gives up: per point asked for, and at least.
const TRIES: (u64, u64) = (50, 20_000);
/// Largest number of rays drawn at a time, which bounds memory.
const ROUND: u64 = 1 << 20;
/// Margin beyond the near plane: rounding to 32 bits must not move a point across it.
const NEAR_LEEWAY: f64 = 1.001;

/// A point with a colour in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    /// World coordinates.
    pub position: DVec3,
    /// Unit normal of the surface there; none if it is not known.
    pub normal: Option<DVec3>,
    /// Red, green, blue.
    pub colour: DVec3,
}

impl From<&Point> for Seed {
    fn from(point: &Point) -> Self {
        let colour = DVec3::from(point.colour.map(f64::from)) / 255.0;
        Self { position: point.position, normal: point.normal, colour }
    }
}

/// The points of a scene. Those without a colour of their own have the median colour of the photos in which no other point hides them;
/// those that no photo shows, that of all others.
///
/// # Errors
/// Photos in a file that cannot be read.
pub fn of_scene(scene: &Scene, photos: &[Photo]) -> Result<Vec<Seed>> {
    let mut seeds: Vec<Seed> = scene.points.iter().map(Seed::from).collect();
    let Some(plain) = scene.plain else { return Ok(seeds) };
    let mut shown: Vec<Vec<[u8; 3]>> = vec![Vec::new(); seeds.len()];
    // By chance: even steps could meet the same face of every panorama, or one camera of a rig.
    let mut order: Vec<(f64, &Photo)> = (0..).zip(photos).map(|(i, photo)| (uniform(&[i]), photo)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = seeds.len().max(1);
    order.truncate((SEARCHED.0 / count).max(SEARCHED.1));
    let mut idle = 0;
    for group in order.chunks((TOGETHER / count).clamp(1, LOOKS)) {
        idle += group.len();
        let found: io::Result<Vec<Vec<Look>>> = group.par_iter().map(|(_, photo)| looks(photo, &seeds)).collect();
        for (i, colour) in found?.into_iter().flatten() {
            if shown[i].len() < LOOKS {
                shown[i].push(colour);
                idle = 0;
            }
        }
        // All points have their colours, or no further photo shows the others.
        if idle >= SEARCHED.1 || shown.iter().all(|colours| colours.len() == LOOKS) {
            break;
        }
    }
    let usual = median_colour(&shown.iter().filter_map(|colours| colours.first().copied()).collect::<Vec<_>>());
    for ((seed, point), shown) in seeds.iter_mut().zip(&scene.points).zip(&shown) {
        if let (Some(colour), true) = (median_colour(shown).or(usual), point.colour == plain) {
            seed.colour = colour;
        }
    }
    Ok(seeds)
}

/// The median of each channel, from 0 to 1; none of no colour.
fn median_colour(colours: &[[u8; 3]]) -> Option<DVec3> {
    let channel = |c: usize| median(&mut colours.iter().map(|rgb| f64::from(rgb[c]) / 255.0).collect::<Vec<_>>());
    Some(DVec3::new(channel(0)?, channel(1)?, channel(2)?))
}

/// The index of a point, and its colour in a photo.
type Look = (usize, [u8; 3]);

/// The points in a photo that no other one hides, where it is opaque.
fn looks(photo: &Photo, points: &[Seed]) -> io::Result<Vec<Look>> {
    let (width, pixels) = (photo.camera.width as usize, photo.pixels.read()?);
    let look = |Front { point, place, .. }: Front| {
        let pixel = 4 * (place.y as usize * width + place.x as usize);
        let [r, g, b, fourth] = *pixels.get(pixel..)?.first_chunk::<4>()?;
        (fourth >= OPAQUE).then_some((point, [r, g, b]))
    };
    let shown = fronts(&photo.camera, points.len(), |k| points[k].position);
    Ok(shown.into_iter().filter_map(look).collect())
}

/// Gaussians of [`from_points_in`], in a scene of usual size.
pub fn from_points(points: &[Seed]) -> Gaussians {
    from_points_in(points, 1.0)
}

/// Mean squared distance of a point to the three nearest neighbours, not counting copies, or fewer if there are not more; none for a
/// single point.
fn gap(points: &[Seed], neighbours: &Neighbours, i: usize) -> Option<f64> {
    let mean = |gaps: &[f64]| (!gaps.is_empty()).then(|| gaps.iter().sum::<f64>() / gaps.len() as f64);
    if neighbours.copied > COPIED {
        let (near, apart) = neighbours.around(i);
        let mut chosen: Vec<(DVec3, f64)> = Vec::new();
        for (other, d) in near {
            let at = points[other].position;
            let is_new = d >= apart && chosen.iter().all(|(other, _)| other.distance_squared(at) >= apart);
            chosen.extend(is_new.then_some((at, d)));
        }
        if let Some(three) = chosen.get(..3) {
            return mean(&[three[0].1, three[1].1, three[2].1]);
        }
    }
    mean(&neighbours.nearest(i).take(3).map(|(_, d)| d).collect::<Vec<_>>())
}

/// Gaussians on points: their scale is the distance of the three nearest neighbours, opacity 0.1, SH degree 0. They are balls, or, on
/// points with a normal, flat along it. `unit` is the scene's size in usual ones.
pub fn from_points_in(points: &[Seed], unit: f64) -> Gaussians {
    let least = LEAST_SQUARED_DISTANCE * unit * unit;
    let neighbours = Neighbours::of(points.iter().map(|p| p.position).collect());
    let log_scale = |i: usize, p: &Seed| -> f32 {
        if !p.position.is_finite() {
            return 0.5 * (least as f32).ln(); // density control removes it
        }
        // A single point has no neighbour that could give its size.
        let gap = gap(points, &neighbours, i).unwrap_or(1e-4 * unit * unit);
        (0.5 * gap.max(least).ln()) as f32
    };
    let logit = (OPACITY / (1.0 - OPACITY)).ln() as f32;
    let means = points.iter().map(|p| p.position.as_vec3().to_array()).collect();
    let scales = |(i, p): (usize, &Seed)| {
        let scale = log_scale(i, p);
        [scale, scale, scale + if p.normal.is_some() { FLATNESS.ln() as f32 } else { 0.0 }]
    };
    let turn = |p: &Seed| {
        let turn = p.normal.map_or(DQuat::IDENTITY, |normal| DQuat::from_rotation_arc(DVec3::Z, normal)).as_quat();
        [turn.w, turn.x, turn.y, turn.z]
    };
    let colour = |p: &Seed| ((p.colour.max(DVec3::splat(LEAST_COLOUR)) - 0.5) / SH_C0).as_vec3().to_array();
    Gaussians {
        log_scales: points.par_iter().enumerate().map(scales).collect(),
        rotations: points.iter().map(turn).collect(),
        sh: vec![points.iter().flat_map(colour).collect()],
        ..Gaussians::balls(means, 0.0, logit, 0)
    }
}

/// Points of [`random_in`], in a scene of usual size.
pub fn random(photos: &[Photo], count: usize, blender: bool, seed: u64) -> Result<Vec<Seed>> {
    random_in(photos, count, (blender, Settings::default().near), seed)
}

/// Random points for a scene without points. They lie on rays through random pixels, between a fifth of and three times the
/// distance at which the cameras' axes meet, where at least three cameras see them. `DEPTHS` depths are tried on a ray, and
/// the one on whose colour the photos agree best is taken: a plane sweep of random planes, which costs a second and starts
/// training near the surfaces. In Blender scenes points lie within the cube. No point lies between a camera that sees it and
/// the near plane, which is `near` world units away. Cameras at one place look at points as far away as in a scene of usual size.
///
/// Rays without a suitable depth are replaced until there are `count` points; the same seed gives the same points.
///
/// # Errors
/// [`Error::NoViews`]; [`Error::Points`] if too few rays have a suitable depth; photos in a file that cannot be read.
pub fn random_in(photos: &[Photo], count: usize, (blender, near): (bool, f32), seed: u64) -> Result<Vec<Seed>> {
    if photos.is_empty() {
        return Err(Error::NoViews);
    }
    let near = f64::from(near) * NEAR_LEEWAY;
    let blender = blender && near == f64::from(Settings::default().near) * NEAR_LEEWAY;
    let seen_by = places(photos.iter().map(|p| &p.camera), ONE_PLACE * near);
    let (focus, spread) = focus(photos.iter().map(|p| &p.camera), near);
    let search = Search { photos, focus, spread, near, blender, seen_by };
    let most = (count as u64).saturating_mul(TRIES.0).max(TRIES.1);
    let (mut found, mut tried) = (Vec::with_capacity(count), 0);
    while found.len() < count {
        if tried >= most {
            let found = found.len();
            return Err(Error::Points { found, asked: count, tries: tried, near, cameras: seen_by });
        }
        let missing = (count - found.len()) as u64;
        // As many rays as the success rate so far suggests, and a few more.
        let round =
            if tried == 0 { missing } else { missing * tried / (found.len() as u64).max(tried / 64).max(1) + 64 };
        let round = round.min(ROUND).min(most - tried);
        let rays = tried..tried + round;
        let drawn: Vec<Option<Seed>> =
            rays.into_par_iter().map(|i| search.on_ray(&[seed, 0x696e_6974, i])).collect::<io::Result<_>>()?;
        found.extend(drawn.into_iter().flatten().take(missing as usize));
        tried += round;
    }
    Ok(found)
}

/// The space searched for random points.
struct Search<'a> {
    photos: &'a [Photo],
    focus: DVec3,
    /// Distance at which cameras look that do not look at the focus.
    spread: f64,
    near: f64,
    blender: bool,
    /// Number of views that must see a point.
    seen_by: usize,
}

impl Search<'_> {
    /// The point on one random ray; `None` if no depth is suitable.
    fn on_ray(&self, key: &[u64]) -> io::Result<Option<Seed>> {
        let draw = |n: u64| uniform(&[key[0], key[1], key[2], n]);
        let camera = &self.photos[(draw(0) * self.photos.len() as f64) as usize].camera;
        let pixel = DVec2::new(draw(1) * f64::from(camera.width), draw(2) * f64::from(camera.height));
        let ray = camera.ray(pixel);
        let distance = camera.depth(self.focus);
        let distance = if distance > ASIDE * self.spread { distance } else { self.spread };
        // Points lie beyond the near plane even if the cameras' axes meet before it, or nowhere.
        let low = (self.near / distance).max(0.2);
        let high = (5.0 * low).max(3.0);
        let mut best: Option<(f64, Seed)> = None;
        for n in 0..DEPTHS {
            let depth = distance * (low.ln() + draw(3 + n) * (high / low).ln()).exp();
            let position = camera.rotation.transpose() * (ray * depth - camera.translation);
            if self.blender && position.abs().max_element() > BLENDER_CUBE {
                continue;
            }
            let Some((disagreement, colour)) = self.agreement(position, key)? else { continue };
            if best.as_ref().is_none_or(|(least, _)| disagreement < *least) {
                best = Some((disagreement, Seed { position, normal: None, colour }));
            }
        }
        // A point that one camera sees well may lie right before the lens of another.
        let clear = |seed: &Seed| self.photos.iter().all(|p| !before_lens(&p.camera, seed.position, self.near));
        Ok(best.map(|(_, seed)| seed).filter(clear))
    }

    /// (variance of the colours, mean colour) of a point in the photos that see it; `None` if too few do.
    fn agreement(&self, position: DVec3, key: &[u64]) -> io::Result<Option<(f64, DVec3)>> {
        let photos = self.photos;
        let start = (uniform(&[key[0], key[1], key[2], 999]) * photos.len() as f64) as usize;
        let (mut n, mut sum, mut squares) = (0_usize, DVec3::ZERO, 0.0);
        for k in 0..photos.len() {
            let photo = &photos[(start + k) % photos.len()];
            let Some((at, depth)) = project(&photo.camera, position) else { continue };
            if depth < self.near {
                continue;
            }
            let colour = photo.colour(at)?;
            n += 1;
            sum += colour;
            squares += colour.length_squared();
            if n == COMPARED {
                break;
            }
        }
        if n < self.seen_by {
            return Ok(None);
        }
        let mean = sum / n as f64;
        Ok(Some((squares / n as f64 - mean.length_squared(), mean)))
    }
}

/// Returns true if a world point lies within the picture but before the near plane.
fn before_lens(camera: &Camera, position: DVec3, near: f64) -> bool {
    project(camera, position).is_some_and(|(_, depth)| depth < near)
}

/// Pixel and depth of a world point; `None` if it lies outside the picture or behind the camera.
fn project(camera: &Camera, position: DVec3) -> Option<([u32; 2], f64)> {
    camera.pixel_of(position).map(|pixel| (pixel, camera.depth(position)))
}

/// The number of places, further than `apart` from each other, at which cameras are; at most [`SEEN_BY`].
fn places<'a>(cameras: impl Iterator<Item = &'a Camera>, apart: f64) -> usize {
    let mut found: Vec<DVec3> = Vec::new();
    for centre in cameras.map(Camera::centre) {
        if found.len() < SEEN_BY && found.iter().all(|place| place.distance(centre) > apart) {
            found.push(centre);
        }
    }
    found.len()
}

/// The point nearest to all cameras' axes; if the axes are parallel, the cameras' centre moved along their mean direction. Then the
/// largest distance of a camera from that centre.
fn focus<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone, near: f64) -> (DVec3, f64) {
    let (mut a, mut b, mut centre, mut forward, mut n) = (DMat3::ZERO, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, 0.0);
    for camera in cameras.clone() {
        let axis = camera.rotation.row(2);
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        a += across;
        b += across * camera.centre();
        centre += camera.centre();
        forward += axis;
        n += 1.0;
    }
    centre /= n;
    let spread = cameras.clone().map(|c| c.centre().distance(centre)).fold(0.0, f64::max);
    let spread = if spread > ONE_PLACE * near { spread } else { USUAL_DISTANCE * near };
    let met = if a.determinant() > 1e-6 * n { a.inverse() * b } else { centre + forward.normalize_or_zero() * spread };
    let in_front = cameras.filter(|c| (c.rotation * met + c.translation).z > 0.0).count();
    // The axes of cameras that look outward meet behind them.
    (if in_front as f64 > 0.5 * n { met } else { centre + forward.normalize_or_zero() * spread }, spread)
}
