//! The subject of a viewer: models, and the capture from which they were made.

use crate::gaussians::Gaussians;
use crate::job::Error;
use crate::job::diagnostics::Diagnostics;
use crate::pipeline::evaluate::pictures::byte;
use crate::pipeline::evaluate::truth;
use crate::render::Style;
use crate::scene::camera::Camera;
use crate::scene::orbit::{Look, Outline};
use crate::scene::{AlphaRole, LoadOptions, Photo, Resize, Scene, Split, load_photos, near_at};
use glam::{DQuat, DVec2, DVec3};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use serde_json::{Value, json};
use std::collections::HashMap;

const PHOTO_QUALITY: u8 = 92;

/// A model that does not change.
pub struct Model {
    /// Name in the page's list.
    pub name: String,
    /// The Gaussians.
    pub gaussians: Gaussians,
    /// Local origin of the file's means, in the world.
    pub origin: [f64; 3],
    /// Translation added to the file's means to place the model where it is shown.
    pub shift: DVec3,
    /// The style to draw them in.
    pub style: Style,
    /// Diagnostics of their prune.
    pub facts: Option<Diagnostics>,
}

/// Purpose of a viewer, which determines the page's controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Job {
    /// Showing models.
    Show,
    /// Watching a run, which can be resumed.
    Run,
    /// Watching training after a prune, without checkpoints.
    Compression,
}

/// Models and their capture.
pub struct Subject {
    /// Title of the page.
    pub title: String,
    /// Purpose of the viewer.
    pub job: Job,
    /// The models, at least one; none while a job is watched, whose model changes.
    pub models: Vec<Model>,
    /// Colour behind the Gaussians.
    pub background: [f32; 3],
    /// Up direction of the world, if the user chose one.
    pub up: Option<DVec3>,
    /// Position and size of the first model; `None` if there is a capture.
    pub outline: Option<Outline>,
    /// Photos and their cameras.
    pub capture: Option<Capture>,
}

/// A capture at a working size.
pub struct Capture {
    /// Its views.
    pub scene: Scene,
    /// The working size.
    pub resize: Resize,
    /// Division into training views and held-out views.
    pub split: Split,
    /// Meaning of the fourth byte of the photos' pixels.
    pub alpha_role: AlphaRole,
    /// PSNR of held-out views in dB, by name; empty if unknown.
    pub psnr: HashMap<String, f64>,
}

impl Capture {
    /// The camera of photo `n` at the working size.
    pub fn camera(&self, n: usize) -> Option<Camera> {
        Some(self.scene.views.get(n)?.camera_at(self.resize))
    }

    /// Photo `n` at the working size.
    pub fn photo(&self, n: usize) -> Result<Photo, Error> {
        let view = self.scene.views.get(n).ok_or_else(|| Error::Usage(format!("there is no photo {n}")))?;
        // The capture decides on alpha, not the photo.
        let (alpha, masks) = (Some(self.alpha_role == AlphaRole::Alpha), self.alpha_role == AlphaRole::Mask);
        let options = LoadOptions { resize: self.resize, alpha, masks, ..LoadOptions::default() };
        let mut loaded = load_photos(&[view], &options, &|_| ()).map_err(Error::Scene)?;
        loaded.photos.remove(0).map_err(Error::Scene)
    }

    /// Photo `n` as JPEG, over a background.
    pub fn photo_jpeg(&self, n: usize, background: [f32; 3]) -> Result<Vec<u8>, Error> {
        let photo = self.photo(n)?;
        let bytes: Vec<u8> = truth(&photo, background)?.into_iter().map(byte).collect();
        jpeg(&bytes, photo.camera.width, photo.camera.height, PHOTO_QUALITY, SamplingFactor::F_1_1)
    }
}

/// Encodes red, green, blue bytes as JPEG.
pub(super) fn jpeg(
    rgb: &[u8],
    width: u32,
    height: u32,
    quality: u8,
    sampling: SamplingFactor,
) -> Result<Vec<u8>, Error> {
    let mut out = Vec::with_capacity(rgb.len() / 16);
    let mut encoder = Encoder::new(&mut out, quality);
    encoder.set_sampling_factor(sampling);
    let side = |n: u32| u16::try_from(n).unwrap_or(u16::MAX);
    encoder.encode(rgb, side(width), side(height), ColorType::Rgb).map_err(|e| Error::encoding("a JPEG picture", e))?;
    Ok(out)
}

/// Position, rotation (camera to world; w, x, y, z), vertical field of view in radians, shift and stretch of a camera. The shift is its
/// principal point from the middle of its picture, to the right and down, in heights of the picture; the stretch is its horizontal focal
/// length over the vertical one.
pub(super) fn pose(camera: &Camera) -> Value {
    let q = DQuat::from_mat3(&camera.rotation.transpose());
    let (size, corner) = (DVec2::new(camera.width.into(), camera.height.into()), camera.whole().corner);
    let fov = 2.0 * (0.5 * size.y / camera.focal.y).atan();
    let shift = (camera.principal - DVec2::from(corner.map(f64::from)) - 0.5 * size) / size.y;
    json!({
        "position": camera.centre().to_array(), "rotation": [q.w, q.x, q.y, q.z], "fov": fov, "shift": shift.to_array(),
        "stretch": camera.focal.x / camera.focal.y,
    })
}

impl Subject {
    /// Up direction of the world: the user's choice, that of the capture's cameras, or that of the outline.
    fn upwards(&self) -> DVec3 {
        let outline = || self.outline.as_ref().map_or(DVec3::NEG_Y, |o| o.up);
        self.up.unwrap_or_else(|| self.capture.as_ref().map_or_else(outline, |capture| capture.scene.up()))
    }

    /// The initial data of the page. A point of the page times `unit`, less a model's `shift`, is a point of that model's file.
    pub fn description(&self, device: &str, control: bool) -> Value {
        let model = |m: &Model| {
            json!({
                "name": m.name, "gaussians": m.gaussians.len(), "degree": m.gaussians.degree(),
                "mode": m.style.mode().to_string(), "pruned_by": m.facts.as_ref().map(|f| f.selector.to_string()),
                "participation": m.facts.as_ref().is_some_and(|f| !f.participation.is_empty()),
                "shift": m.shift.to_array(),
            })
        };
        let up = self.upwards();
        let look = Look::default();
        let (start, target) = match (&self.capture, &self.outline) {
            (Some(capture), _) => {
                let first = capture.scene.ahead(capture.split.test.first().copied().unwrap_or(0));
                let camera = capture.camera(first);
                let centre = capture.scene.centre(&(0..capture.scene.views.len()).collect::<Vec<_>>());
                let target = camera.as_ref().map_or(centre, |c| capture.scene.sight(c));
                (camera.as_ref().map(pose), target)
            }
            (None, Some(outline)) => {
                let target = outline.centre + up * outline.framing(&look).height;
                (Some(pose(&outline.camera(0.0, &look))), target)
            }
            (None, None) => (None, DVec3::ZERO),
        };
        let cameras: Vec<Value> = self.capture.as_ref().map_or_else(Vec::new, |capture| {
            let views = capture.scene.views.iter().enumerate();
            let of = |(n, view): (usize, &crate::scene::View)| {
                let camera = view.camera_at(capture.resize);
                let mut entry = pose(&camera);
                entry["name"] = json!(view.name);
                entry["size"] = json!([camera.width, camera.height]);
                entry["held_out"] = json!(capture.split.test.contains(&n));
                entry["psnr"] = json!(capture.psnr.get(&view.name));
                entry["photo"] = json!(view.image.is_file());
                entry
            };
            views.map(of).collect()
        });
        json!({
            "title": self.title, "device": device, "control": control,
            "live": self.job != Job::Show, "checkpoints": self.job == Job::Run,
            "models": self.models.iter().map(model).collect::<Vec<_>>(),
            "unit": self.capture.as_ref().map_or(1.0, |capture| capture.scene.unit),
            "background": self.background, "up": up.to_array(),
            "start": start, "target": target.to_array(), "cameras": cameras,
        })
    }

    /// The near plane in world units: that of the capture, or one that suits the model.
    pub fn near(&self, usual: f32) -> f32 {
        let of_model = |outline: &Outline| near_at(usual, outline.framing(&Look::default()).distance);
        let of_capture = self.capture.as_ref().map(|capture| capture.scene.near);
        of_capture.or(self.outline.as_ref().map(of_model)).unwrap_or(usual)
    }
}
