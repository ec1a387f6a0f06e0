//! What a scene calls for, decided on the photos that a run trains on, and what follows for the run.

use super::config::RunConfig;
use super::prepare::Prepared;
use crate::effects::{self, Decision, Effect, Overrides, Shot, Subject};
use crate::error::Error;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::Timings;
use crate::scene::{EVAL_EVERY, Resize, Scene};
use crate::train;
use crate::train::photos::TrainView;
use rayon::prelude::*;

/// Width that photos are looked at with, at most.
const LOOKED_AT: u32 = 480;

/// Decides on the effects of a prepared scene, from its training views alone; also gives the gains of those views, red,
/// green and blue, against each other.
///
/// # Errors
/// Photos in a file that cannot be read.
pub fn decide(prepared: &Prepared, config: &RunConfig) -> Result<(Vec<Decision>, Vec<[f32; 3]>), Error> {
    let split = prepared.scene.split(config.eval_every);
    let shots: Vec<Shot> =
        prepared.train.par_iter().map(|view| shot(view, prepared.masked)).collect::<Result<_, Error>>()?;
    let subject = Subject { scene: &prepared.scene, train: &split.train, shots: &shots };
    let (decisions, gains) = effects::decide(&subject, &config.effects, config.sh_degree);
    Ok((decisions, gains.believed()))
}

/// What a scene on disk calls for; photos that are absent or damaged are left out.
pub fn of_scene(scene: &Scene) -> Vec<Decision> {
    let mut scene = scene.clone();
    let mut shots = Vec::new();
    let resize = Resize::Width(LOOKED_AT);
    if scene.require_photos().is_ok() {
        let train = scene.split(EVAL_EVERY).train;
        let mut keep = vec![true; scene.views.len()];
        let photos: Vec<_> = train.par_iter().map(|i| scene.views[*i].load_photo(resize).ok()).collect();
        let any_alpha = photos.iter().flatten().any(|p| p.has_alpha);
        let masked = !any_alpha && photos.iter().flatten().any(|p| p.mask.is_some());
        for (i, photo) in train.into_iter().zip(photos) {
            let Some(mut photo) = photo else {
                keep[i] = false;
                continue;
            };
            if masked {
                photo.fold_mask();
            }
            shots.push(Shot { camera: scene.views[i].camera_at(resize), pixels: photo.pixels, masked });
        }
        // Those left out must not shift which are held out: what was trained on stays so.
        let train: Vec<usize> = scene.split(EVAL_EVERY).train.into_iter().filter(|i| keep[*i]).collect();
        return effects::decide(
            &Subject { scene: &scene, train: &train, shots: &shots },
            &Overrides::default(),
            MAX_SH_DEGREE,
        )
        .0;
    }
    let train: Vec<usize> = scene.split(EVAL_EVERY).train;
    effects::decide(&Subject { scene: &scene, train: &train, shots: &shots }, &Overrides::default(), MAX_SH_DEGREE).0
}

/// What a model's pictures call for, of a model without photos: the SH bands that turn a colour by 1/255 or more.
pub fn of_model(model: &Gaussians) -> Decision {
    let degree = model.degree_in_effect();
    let bands: Vec<_> = model.most_by_band().iter().map(|most| format!("{:.1}", 255.0 * most)).collect();
    let stored = model.degree();
    let evidence = match stored {
        0 => "the file has no band above 0".to_owned(),
        _ if degree < stored => format!(
            "bands 1 to {stored} turn colours by {} of 255 at most: pictures are drawn with degree {degree}, the file keeps all",
            bands.join(", ")
        ),
        _ => format!("bands 1 to {stored} turn colours by {} of 255 at most", bands.join(", ")),
    };
    Decision::of_degree(degree, evidence)
}

/// A photo made small by averaging squares of pixels.
fn shot(view: &TrainView, masked: bool) -> Result<Shot, Error> {
    let bytes = view.pixels.read().map_err(train::Error::Photos)?;
    let (w, h) = (view.camera.width, view.camera.height);
    let side = w.div_ceil(LOOKED_AT).max(1);
    let (small_w, small_h) = (w.div_ceil(side), h.div_ceil(side));
    let mut pixels = Vec::with_capacity(4 * small_w as usize * small_h as usize);
    for y in 0..small_h {
        for x in 0..small_w {
            let (rows, columns) = (y * side..((y + 1) * side).min(h), x * side..((x + 1) * side).min(w));
            let mut sum = [0_u32; 4];
            for row in rows.clone() {
                for column in columns.clone() {
                    let at = 4 * (row as usize * w as usize + column as usize);
                    for (s, b) in sum.iter_mut().zip(&bytes[at..at + 4]) {
                        *s += u32::from(*b);
                    }
                }
            }
            let n = (rows.len() * columns.len()).max(1) as u32;
            pixels.extend(sum.map(|s| ((s + n / 2) / n) as u8));
        }
    }
    // Pixels of the rim may be parts of squares: the scale is that of whole ones.
    let mut camera = view.camera.clone();
    let scale = f64::from(side);
    (camera.focal, camera.principal) = (camera.focal / scale, camera.principal / scale);
    (camera.width, camera.height) = (small_w, small_h);
    Ok(Shot { camera, pixels, masked })
}

impl RunConfig {
    /// The configuration with what was decided: what `config.toml` holds, so that the model can be rendered as it was
    /// trained.
    #[must_use]
    pub fn decided(&self, decisions: &[Decision]) -> Self {
        let degree = decisions.iter().find(|d| d.name == Effect::ViewDependence).and_then(|d| d.degree);
        Self {
            sh_degree: degree.unwrap_or(self.sh_degree).min(self.sh_degree),
            antialias: effects::is_on(decisions, Effect::Antialias),
            depth_order: effects::is_on(decisions, Effect::DepthOrder),
            exposure: effects::is_on(decisions, Effect::Exposure),
            ..self.clone()
        }
    }
}

/// A line that says which effects are on, and which may as well be otherwise.
pub fn summary(decisions: &[Decision]) -> String {
    let list = |wanted: &dyn Fn(&Decision) -> bool| {
        let names: Vec<_> = decisions.iter().filter(|d| wanted(d)).map(|d| d.name.name()).collect();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    };
    let near = if decisions.iter().any(|d| d.near_threshold) {
        format!("; near a threshold: {}", list(&|d| d.near_threshold))
    } else {
        String::new()
    };
    format!("effects: {}{near}", list(&|d| d.on))
}

/// The decisions with the time that each effect took in training.
#[must_use]
pub fn timed(mut decisions: Vec<Decision>, timings: &Timings) -> Vec<Decision> {
    for d in decisions.iter_mut().filter(|d| d.on) {
        let scope = d.name.scope();
        d.seconds = timings.iter().find(|(name, ..)| Some(*name) == scope).map(|(_, seconds, _)| seconds);
    }
    decisions
}
