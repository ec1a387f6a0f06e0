//! Views of a model without photos: cameras all around it, and its own pictures as the ground truth.

use super::evaluate::pictures::byte;
use super::evaluate::rgb;
use super::pair_capacity;
use crate::gaussians::outline::outline;
use crate::gaussians::{Gaussians, opacity};
use crate::gpu::{Buffer, Device, Recording};
use crate::job::{Error, Session, Stage};
use crate::kernels::constants::blending::float64::ALPHA_MIN;
use crate::render::{Image, Painter, Renderer, Settings, Source, Style, Uses};
use crate::response::{self, HighPass, Responses, Views, Wanted, full_pass};
use crate::scene::camera::{self, Camera};
use crate::scene::orbit::{Look, Outline};
use crate::scene::{Photo, Pixels, near_at};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::ops::{Range, RangeInclusive};

/// Elevations of the cameras above the horizon, in radians: captures look level or down, seldom from below.
const ELEVATIONS: RangeInclusive<f64> = -0.35..=1.22;
/// Vertical field of view in radians.
const FIELD_OF_VIEW: f64 = 0.7;
/// Turn from one camera to the next, as a share of a full turn: the golden angle, which never repeats a direction.
const TURN: f64 = 0.381_966_011_250_105;
/// Every eighth view is held out, as of photos.
const HOLD_OUT: usize = 8;
/// Share of the visible Gaussians that no training view frames, above which further views look outwards.
const UNFRAMED: f64 = 0.01;
/// Number of these views: along both directions of three axes.
pub const OUTWARD: usize = 6;
/// Their field of view in radians: wider than the faces of a cube, since the cameras stand apart.
const OUTWARD_FIELD: f64 = 110.0 * PI / 180.0;

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

    /// Views around the model, rendered in a style over a background of red, green and blue.
    pub fn views(&self, model: &Gaussians, background: [f32; 3], style: Style) -> VirtualViews {
        self.outlined(model, background, style).0
    }

    /// The same, and for training the views that look outwards where those around the model do not frame it.
    pub fn framing_views(&self, model: &Gaussians, background: [f32; 3], style: Style) -> VirtualViews {
        let (views, outline, nearest) = self.outlined(model, background, style);
        let trained: Vec<&Camera> =
            (0..).zip(&views.around).filter(|(i, _)| !is_held_out(*i)).map(|(_, camera)| camera).collect();
        let visible = |i: &usize| opacity(model.opacity_logits[*i]) >= ALPHA_MIN;
        let framed = |i: usize| {
            let mean = DVec3::from_array(model.means[i].map(f64::from));
            trained.iter().any(|camera| camera.shows(mean))
        };
        let count = |i: usize| [1, usize::from(!framed(i))];
        let sums = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
        let [all, unframed] = (0..model.len()).into_par_iter().filter(visible).map(count).reduce(|| [0; 2], sums);
        let outward =
            if unframed as f64 > UNFRAMED * all as f64 { self.outward(&outline, nearest) } else { Vec::new() };
        VirtualViews { outward, ..views }
    }

    /// Views around the model, its outline, and the least distance of a camera from its centre.
    fn outlined(&self, model: &Gaussians, background: [f32; 3], style: Style) -> (VirtualViews, Outline, f64) {
        let outline = outline(model, self.up);
        let (around, nearest) = self.around(&outline);
        let settings = style.over(background);
        // A model in small units must not lie in front of the near plane.
        let settings = Settings { near: near_at(settings.near, nearest), ..settings };
        (VirtualViews { around, outward: Vec::new(), settings }, outline, nearest)
    }

    /// Cameras that look away from the model's centre, from this distance: together they see all that is beyond ten times as far.
    fn outward(&self, outline: &Outline, distance: f64) -> Vec<Camera> {
        let side = self.size.0.min(self.size.1);
        let axes = [self.up, self.up.any_orthonormal_vector(), self.up.cross(self.up.any_orthonormal_vector())];
        let camera = |direction: DVec3, up: DVec3| {
            let eye = outline.centre + distance * direction;
            Camera::look_at(eye, eye + distance * direction, up, OUTWARD_FIELD, side, side)
        };
        (0..3).flat_map(|k| [1.0, -1.0].map(|sign| camera(sign * axes[k], axes[(k + 1) % 3]))).collect()
    }

    /// Cameras spread evenly over a band of a sphere around the model, each near enough to fill its picture; and the
    /// least distance of a camera from the model's centre.
    fn around(&self, outline: &Outline) -> (Vec<Camera>, f64) {
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

/// True for the view around a model with this number if it is held out.
fn is_held_out(view: usize) -> bool {
    view.is_multiple_of(HOLD_OUT)
}

/// Views of a model.
pub struct VirtualViews {
    /// Cameras all around it that look at it; every eighth is held out.
    pub around: Vec<Camera>,
    /// Cameras that look away from it, for training: six where those around it do not frame all of it, such as a sky; else none.
    pub outward: Vec<Camera>,
    /// Settings of their pictures.
    pub settings: Settings,
}

/// A model's own pictures.
pub struct OwnPictures {
    /// Training views; without pixels unless those were requested.
    pub train: Vec<Photo>,
    /// Views held out, by name.
    pub test: Vec<(String, Photo)>,
}

impl OwnPictures {
    /// Draws the pictures, of the views held out those with these numbers.
    pub fn draw(
        session: &Session<'_>,
        model: Source<'_>,
        views: VirtualViews,
        with_train_pixels: bool,
        held_out: Range<usize>,
    ) -> Result<Self, Error> {
        let VirtualViews { around, outward, settings } = views;
        let mut painter = Painter::of(session.device, settings, model, camera::largest(&around))?;
        let (mut train, mut test) = (Vec::new(), Vec::new());
        let number = around.len();
        for (i, camera) in around.into_iter().chain(outward).enumerate() {
            let test_view = i < number && is_held_out(i);
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
    let follow = |done: usize| watcher.step(Stage::Responses, done, cameras.len());
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
            let (cameras, nearest) = asked.around(&outline(&model, up));
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

    /// A ball, and one with a sky of which the cameras around the ball frame a part.
    #[test]
    fn a_sky_is_framed_by_cameras_that_look_away() {
        let point = |i: u32, radius: f64| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 500.0;
            let (sin, cos) = (f64::from(i) * 2.4).sin_cos();
            let r = (1.0 - z * z).sqrt();
            (radius * DVec3::new(r * cos, r * sin, z)).as_vec3().to_array()
        };
        let ball = (0..500).map(|i| point(i, 1.0));
        let views = |means: Vec<[f32; 3]>| {
            VirtualCameras::default().framing_views(&Gaussians::balls(means, -4.0, 3.0, 0), [0.0; 3], Style::default())
        };
        assert!(views(ball.clone().collect()).outward.is_empty());
        for radius in [40.0, 400.0] {
            let sky: Vec<[f32; 3]> = (0..500).step_by(3).map(|i| point(i, radius)).collect();
            let VirtualViews { around, outward, .. } = views(ball.clone().chain(sky.iter().copied()).collect());
            assert_eq!(outward.len(), OUTWARD);
            for place in sky.iter().map(|mean| DVec3::from_array(mean.map(f64::from))) {
                assert!(around.iter().chain(&outward).any(|camera| camera.shows(place)), "{place}");
            }
        }
    }
}
