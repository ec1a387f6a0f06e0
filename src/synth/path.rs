//! Cameras of the photos: positions, devices and exposures.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec3};

use super::{
    Effect, Error, Kind, SynthOptions,
    geometry::{Ray, Solid},
    lens::Lens,
    materials::Paint,
    plaza,
    random::{Random, Stream},
    terrain,
};
use crate::scene;
use crate::scene::camera::Camera;
use crate::scene::lens::LensModel;

/// Elevations of the three rings above the target, in degrees.
const RINGS: [f64; 3] = [6.0, 18.0, 34.0];
/// Distance from the target in metres. Far, with a long lens: the footprints of a point then differ little.
const DISTANCE: f64 = 9.2;
/// Distance from the middle from which panoramas are taken, in metres: between the objects and the fence, and outside.
const WALK: f64 = 3.0;
/// Field of view of the shorter side in degrees.
const FIELD: f64 = 26.0;
/// Distances of the near, middle and far cameras of [`Effect::Scales`].
const SCALES: [f64; 3] = [0.45, 1.0, 2.2];

/// Moves the corners of a picture inwards by about 7 pixels of 240.
pub(super) const OPENCV: Lens =
    Lens::Front(LensModel::OpenCv, [-0.2, 0.05, 0.005, -0.004, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
/// Nearly equidistant.
pub(super) const FISHEYE: Lens =
    Lens::Front(LensModel::OpenCvFisheye, [-0.02, 0.008, -0.002, 0.0005, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);

/// Size and intrinsics of a device that took photos.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Device {
    pub width: u32,
    pub height: u32,
    /// Focal lengths in pixels.
    pub focal: DVec2,
    /// Principal point in pixels from the upper left corner.
    pub principal: DVec2,
    pub lens: Lens,
}

/// One photo to be taken.
pub(super) struct View {
    /// File name; the order of names is the order of views.
    pub name: String,
    /// Index in the list of devices.
    pub device: usize,
    pub camera: Camera,
    pub lens: Lens,
    /// Factors on the finished red, green and blue.
    pub gain: [f32; 3],
    /// The object that stands at another place in every photo.
    pub mover: Vec<(Solid, Paint)>,
}

impl View {
    /// True if the evaluation protocol (every 8th name) holds this view out.
    pub const fn is_test(index: usize) -> bool {
        index.is_multiple_of(8)
    }

    /// Pixel of a world point; none behind the camera or outside the picture.
    pub fn project(&self, p: DVec3) -> Option<DVec2> {
        let local = self.camera.rotation * p + self.camera.translation;
        let pixel = self.lens.image(local)? * self.camera.focal + self.camera.principal;
        let size = DVec2::new(f64::from(self.camera.width), f64::from(self.camera.height));
        (pixel.cmpge(DVec2::ONE).all() && pixel.cmple(size - 1.0).all()).then_some(pixel)
    }

    /// The ray through a position in the picture, in pixels.
    pub fn ray(&self, pixel: DVec2) -> Ray {
        let local = self.lens.direction((pixel - self.camera.principal) / self.camera.focal);
        let world = self.camera.rotation.transpose() * local;
        Ray { origin: self.camera.centre().as_vec3(), direction: world.normalize().as_vec3() }
    }
}

/// The devices that the options require.
pub(super) fn devices(options: &SynthOptions) -> Result<Vec<Device>, Error> {
    if let Some(calibration) = &options.lens {
        let (width, height) = (options.width, options.height);
        let (focal, principal, lens) = calibration.device(width, height)?;
        return Ok(vec![Device { width, height, focal, principal, lens }]);
    }
    let (lens, field) = if options.has(Effect::Fisheye) {
        (FISHEYE, FIELD * 1.3)
    } else {
        let field = if options.kind == Kind::Terrain { terrain::FIELD } else { FIELD };
        (if options.has(Effect::Distortion) { OPENCV } else { Lens::PINHOLE }, field)
    };
    if options.kind == Kind::Panorama {
        let (width, height) = (options.width, options.height);
        let whole = scene::lens::Lens::panorama(width.into(), height.into()).map_err(Error::Lens)?;
        let (focal, principal) = (whole.focal, whole.principal);
        return Ok(vec![Device { width, height, focal, principal, lens: Lens::Panorama }]);
    }
    let device = |width: u32, height: u32, zoom: f64, shift: DVec2| {
        let (w, h) = (f64::from(width), f64::from(height));
        // A portrait is as wide as three quarters of a landscape.
        let side = h.min(1.2 * w);
        let half = 0.5 * field.to_radians();
        let reach = if options.has(Effect::Fisheye) { half } else { half.tan() };
        let focal = DVec2::splat(zoom * 0.5 * side / reach);
        Device { width, height, focal, principal: DVec2::new(w, h) * (DVec2::splat(0.5) + shift), lens }
    };
    let (w, h) = (options.width, options.height);
    if !options.has(Effect::Cameras) {
        return Ok(vec![device(w, h, 1.0, DVec2::ZERO)]);
    }
    let small = |n: u32| (n * 3 / 4).max(16);
    Ok(vec![
        device(w, h, 1.0, DVec2::ZERO),
        device(h, w, 0.95, DVec2::new(0.01, -0.015)),
        device(small(w), small(h), 1.15, DVec2::new(-0.02, 0.01)),
    ])
}

/// All views: a drone's lines over the terrain, or three interleaved rings round the plaza, so that every 8th view falls on each ring
/// in turn.
pub(super) fn views(options: &SynthOptions, devices: &[Device]) -> Vec<View> {
    (0..options.views).map(|i| view(options, devices, i)).collect()
}

fn view(options: &SynthOptions, devices: &[Device], i: usize) -> View {
    // Differs from the ring's index, so that each ring has all distances and devices.
    let third = (i + i / 3) % 3;
    let ([eye, target, up], turn) = match options.kind {
        Kind::Plaza => ring(options, i),
        Kind::Terrain => (terrain::pose(options, i), 0.0),
        Kind::Panorama | Kind::Dots => (walk(options, i), 0.0),
    };
    let device_index = if devices.len() > 1 { third } else { 0 };
    let device = &devices[device_index];
    let mut camera = Camera::look_at(eye, target, up, 1.0, device.width, device.height);
    camera.focal = device.focal;
    camera.principal = device.principal;

    let mut random = Random::new(options.seed, Stream::Exposure, i as u64);
    let mut gain = [1.0f32; 3];
    if options.has(Effect::Exposure) {
        let all = random.between(-0.15, 0.15);
        gain = gain.map(|_| (all + random.between(-0.03, 0.03)).exp() as f32);
    }
    let mut random = Random::new(options.seed, Stream::Mover, i as u64);
    let mover = if options.has(Effect::Masks) {
        // On the near side, where it is visible, between the objects in the middle and the fence.
        let (place, reach) = (turn + random.between(-1.2, 1.2), random.between(2.05, 2.3));
        plaza::mover(Vec3::new((place.cos() * reach) as f32, (place.sin() * reach) as f32, 0.0))
    } else {
        Vec::new()
    };
    View { name: file_name(i), device: device_index, camera, lens: device.lens, gain, mover }
}

/// Position, target and up direction of view `i` of the rings, and its angle around the scene.
fn ring(options: &SynthOptions, i: usize) -> ([DVec3; 3], f64) {
    let mut random = Random::new(options.seed, Stream::Path, i as u64);
    let mut jitter = |size: f64| random.between(-size, size);
    let (ring, step) = (i % 3, (i / 3) as f64);
    let per_ring = options.views.div_ceil(3) as f64;
    let turn = TAU * (step + ring as f64 / 3.0 + jitter(0.12)) / per_ring;
    let rise = (RINGS[ring] + jitter(1.2)).to_radians();
    let mut distance = DISTANCE * (1.0 + jitter(0.02));
    if options.has(Effect::Scales) {
        distance *= SCALES[(i + i / 3) % 3];
    }
    if options.has(Effect::Fisheye) {
        distance *= 0.8;
    }
    let target = DVec3::new(jitter(0.06), jitter(0.06), 0.8 + jitter(0.05));
    let eye = target + DVec3::new(rise.cos() * turn.cos(), rise.cos() * turn.sin(), rise.sin()) * distance;
    ([eye, target, DVec3::Z], turn)
}

/// Where panorama `i` is taken, what its middle looks at, and the direction that is up: from someone who walks round the plaza with the
/// camera on a stick, never quite upright.
fn walk(options: &SynthOptions, i: usize) -> [DVec3; 3] {
    let mut random = Random::new(options.seed, Stream::Path, i as u64);
    let mut jitter = |size: f64| random.between(-size, size);
    let turn = TAU * (i as f64 + jitter(0.2)) / options.views as f64;
    let height = [0.9, 1.5, 2.1][i % 3] + jitter(0.1);
    let eye = DVec3::new(turn.cos(), turn.sin(), 0.0) * (WALK + jitter(0.25)) + DVec3::Z * height;
    let heading = TAU * jitter(0.5);
    let up = DVec3::new(jitter(0.08), jitter(0.08), 1.0).normalize();
    [eye, eye + DVec3::new(heading.cos(), heading.sin(), 0.0).reject_from(up), up]
}

/// Name of the photo with this index.
pub(super) fn file_name(index: usize) -> String {
    format!("view_{index:04}.png")
}
