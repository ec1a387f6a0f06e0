//! Views of a model without photos: cameras all around it, and its own pictures as the ground truth.

use super::evaluate::pictures::byte;
use super::evaluate::rgb;
use super::pair_capacity;
use crate::gaussians::Gaussians;
use crate::gaussians::outline::outline;
use crate::gpu::{Buffer, Device, Recording};
use crate::job::session::Session;
use crate::job::{Error, Stage};
use crate::render::{Image, Painter, Renderer, Settings, Source, Style, Uses};
use crate::response::{self, HighPass, Responses, Views, Wanted, full_pass};
use crate::scene::camera::{self, Camera};
use crate::scene::orbit::Look;
use crate::scene::{Photo, Pixels, near_at};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::{Range, RangeInclusive};

/// Elevations of the cameras above the horizon, in radians: captures look level or down, seldom from below.
const ELEVATIONS: RangeInclusive<f64> = -0.35..=1.22;
/// Vertical field of view in radians.
const FIELD_OF_VIEW: f64 = 0.7;
/// Turn from one camera to the next, as a share of a full turn: the golden angle, which never repeats a direction.
const TURN: f64 = 0.381_966_011_250_105;
/// Every eighth view is held out, as of photos.
const HOLD_OUT: usize = 8;

/// All views held out.
pub const ALL: Range<usize> = 0..usize::MAX;

/// Parameters of virtual cameras.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VirtualCameras {
    /// Number of views, including those held out.
    pub views: u32,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// World direction that is up.
    pub up: DVec3,
}

impl Default for VirtualCameras {
    fn default() -> Self {
        Self { views: 48, size: (400, 400), up: DVec3::NEG_Y }
    }
}

impl VirtualCameras {
    /// Number of views held out.
    pub fn held_out(&self) -> usize {
        (self.views as usize).div_ceil(HOLD_OUT)
    }

    /// Cameras all around the model, and the settings of rendering in a style over a background of red, green and blue.
    pub fn views(&self, model: &Gaussians, background: [f32; 3], style: Style) -> (Vec<Camera>, Settings) {
        let (cameras, nearest) = self.cameras(model);
        let settings = style.over(background);
        // A model in small units must not lie in front of the near plane.
        (cameras, Settings { near: near_at(settings.near, nearest), ..settings })
    }

    /// Cameras spread evenly over a band of a sphere around the model, each near enough to fill its picture; and the
    /// least distance of a camera from the model's centre.
    fn cameras(&self, model: &Gaussians) -> (Vec<Camera>, f64) {
        let outline = outline(model, self.up);
        let mut nearest = f64::INFINITY;
        let (low, high) = (ELEVATIONS.start().sin(), ELEVATIONS.end().sin());
        let cameras = (0..self.views)
            .map(|i| {
                // Equal steps of the sine are equal areas of the sphere.
                let share = (f64::from(i) + 0.5) / f64::from(self.views);
                let elevation = (low + (high - low) * share).asin();
                let look = Look { fov: FIELD_OF_VIEW, elevation, size: self.size };
                let camera = outline.camera(f64::from(i) * TURN, &look);
                nearest = nearest.min(camera.centre().distance(outline.centre));
                camera
            })
            .collect();
        (cameras, nearest)
    }
}

/// A model's own pictures from all around it.
pub struct OwnPictures {
    /// Training views; without pixels unless those were requested.
    pub train: Vec<Photo>,
    /// Views held out, by name.
    pub test: Vec<(String, Photo)>,
}

impl OwnPictures {
    /// Draws the pictures, of the views held out those with these numbers; cameras and settings are those of
    /// [`VirtualCameras::views`].
    pub fn draw(
        session: &Session<'_>,
        model: Source<'_>,
        cameras: Vec<Camera>,
        settings: Settings,
        with_train_pixels: bool,
        held_out: Range<usize>,
    ) -> Result<Self, Error> {
        let mut painter = Painter::of(session.device, settings, model, camera::largest(&cameras))?;
        let (mut train, mut test) = (Vec::new(), Vec::new());
        for (i, camera) in cameras.into_iter().enumerate() {
            let test_view = i.is_multiple_of(HOLD_OUT);
            if test_view && !held_out.contains(&(i / HOLD_OUT)) {
                continue;
            }
            let pixels = if test_view || with_train_pixels {
                photo(&painter.render(model, &camera)?)
            } else {
                Pixels::from(Vec::new())
            };
            let view = Photo::opaque(camera, pixels);
            if test_view {
                test.push((format!("virtual_{i:03}"), view));
            } else {
                train.push(view);
            }
            session.watcher.unless_stopped()?;
        }
        Ok(Self { train, test })
    }
}

/// A picture as a photo: opaque, 8 bits a channel.
pub fn photo(image: &Image) -> Pixels {
    rgb(image).chunks_exact(3).flat_map(|p| [byte(p[0]), byte(p[1]), byte(p[2]), 255]).collect()
}

/// Responses of a model to its own pictures and scores, as `wanted`: a pass over the cameras. With `of`, they are a chunk of so many,
/// as [`Views::of`].
pub fn responses<'m>(
    session: &Session<'_>,
    model: impl Into<Source<'m>>,
    cameras: &[Camera],
    of: Option<usize>,
    settings: Settings,
    wanted: Wanted,
) -> Result<Responses, Error> {
    let Session { device, watcher, .. } = *session;
    let model = model.into();
    let follow = |done: usize| {
        watcher.progress(Stage::Responses, done, cameras.len());
        watcher.unless_stopped()
    };
    let wanted = Wanted { residual: false, ..wanted };
    let size = camera::largest(cameras);
    let pairs = pair_capacity::initial(device, model.len());
    let mut renderer = response::renderer(device, settings, model, size, pairs, wanted)?;
    let pixels = wanted.gradient_pixels(size);
    let gradient = device.buffer("image gradient", pixels)?;
    let high_pass = HighPass::new(device, pixels)?;
    let loss = |recording: &mut Recording, v: usize, image: &Buffer<[f32; 4]>, _| -> Result<(), Error> {
        high_pass.record(recording, image, &gradient, [cameras[v].width, cameras[v].height]);
        Ok(())
    };
    full_pass(&mut renderer, model, Views { cameras, follow, of }, &gradient, wanted, loss)
}

/// Bytes of device memory that [`responses`] takes besides the model and the results ([`Wanted::bytes`]).
pub fn bytes(device: &Device, gaussians: usize, size: [u32; 2], pairs: u32, style: Style, wanted: Wanted) -> u64 {
    let pixels = wanted.gradient_pixels(size);
    let pictures = device.bytes_of(|counts| {
        counts.buffer::<[f32; 4]>("image gradient", pixels)?;
        HighPass::new(counts, pixels)
    });
    let uses = Uses { purpose: wanted.purpose(), responses: true, style };
    Renderer::bytes(device, gaussians, size, pairs, uses) + pictures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_stand_all_round_and_look_at_the_model() {
        let mut model = Gaussians::zeroed(200, 0);
        for (i, mean) in model.means.iter_mut().enumerate() {
            let a = i as f32;
            *mean = [3.0 + a.cos(), (i % 7) as f32 * 0.1, -2.0 + a.sin()];
        }
        for up in [DVec3::NEG_Y, DVec3::Z] {
            let asked = VirtualCameras { views: 48, size: (80, 60), up };
            let (cameras, nearest) = asked.cameras(&model);
            assert!(cameras.len() == 48 && nearest > 0.0);
            let centre = DVec3::new(3.0, 0.3, -2.0);
            let directions: Vec<DVec3> = cameras.iter().map(|c| (c.centre() - centre).normalize()).collect();
            let mean: DVec3 = directions.iter().sum::<DVec3>() / 48.0;
            assert!(mean.reject_from(up).length() < 0.1, "no side is preferred: {mean}");
            for (i, a) in directions.iter().enumerate() {
                let next = directions.iter().enumerate().filter(|(k, _)| *k != i).map(|(_, b)| a.angle_between(*b));
                let next = next.fold(f64::INFINITY, f64::min);
                assert!((0.15..0.6).contains(&next), "{i}: {next}");
            }
            for camera in &cameras {
                let seen = camera.rotation * centre + camera.translation;
                let pixel = seen.truncate() / seen.z * camera.focal;
                assert!(seen.z > 0.5 * nearest && pixel.length() < 20.0, "{pixel}");
            }
        }
    }
}
