//! Effects that a scene calls for, decided on a run's training photos, and their consequences for the run.

use super::prepare::{Prepared, usual_background};
use super::start::Start;
use crate::depth_maps;
use crate::effects::{
    self, Agreement, Decision, Doubts, Effect, Overrides, THUMBNAIL_WIDTH, Thumbnail, Told, TrainingSet,
};
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::Timings;
use crate::job::records::{CameraErrors, Trial};
use crate::job::{Error, Init, RunConfig, Silent};
use crate::render::Style;
use crate::scene::{EVAL_EVERY, LoadOptions, Photo, Point, Resize, Scene, Skipped, View, load_photos, median};
use crate::train::{self, schedule::Schedule};
use rayon::prelude::*;
use std::io;

/// Decides on the effects of a prepared scene, from its training photos alone. Also returns a line on each fault of any photo, camera or
/// pose, with a remedy.
pub fn decide(prepared: &Prepared, config: &RunConfig) -> Result<(Told, Vec<String>), Error> {
    let Prepared { scene, train: to_train, test: held_out, depths, background, .. } = prepared;
    let split = scene.split(config.eval_every);
    let photos = to_train.iter().chain(held_out.iter().map(|(_, photo)| photo));
    let views: Vec<(usize, &Photo)> = split.train.iter().chain(&split.test).copied().zip(photos).collect();
    let small = |(view, photo): &(usize, &Photo)| Ok((*view, Thumbnail::of(photo)?));
    let small: Vec<(usize, Thumbnail)> =
        views.par_iter().map(small).collect::<io::Result<_>>().map_err(train::Error::Photos)?;
    let mut thumbnails: Vec<Option<Thumbnail>> = scene.views.iter().map(|_| None).collect();
    for (view, small) in small {
        thumbnails[view] = Some(small);
    }
    let advice = Doubts::of(scene, Agreement::of(scene, &thumbnails)).advice();
    let photos: Vec<Thumbnail> = split.train.iter().filter_map(|view| thumbnails[*view].take()).collect();
    let sizes = to_train.first().zip(split.train.first());
    let scale = sizes
        .map_or(1.0, |(photo, view)| f64::from(photo.camera.width) / f64::from(scene.views[*view].camera.width.max(1)));
    let iterations = config.schedule.iterations;
    let (train, depths, background) = (split.train.as_slice(), *depths, *background);
    let set = TrainingSet { scene, train, photos: &photos, depths, background, scale, iterations };
    Ok((effects::decide(&set, &config.effects, config.sh_degree), advice))
}

/// Decides on the effects of a scene on disk; also returns everything that a run would leave out of it or say about it, damaged photos
/// included, and what the photos tell about their names and poses.
pub fn examine(scene: &Scene) -> Result<(Vec<Decision>, Skipped, Agreement), Error> {
    let mut scene = scene.clone();
    // Without any photo the detectors still name what is missing.
    let _ = scene.require_photos();
    // Damaged photos must not change which are held out: the split comes first.
    let split = scene.split(EVAL_EVERY).train;
    let views: Vec<&View> = scene.views.iter().collect();
    let options = LoadOptions { resize: Resize::Width(THUMBNAIL_WIDTH), ..LoadOptions::default() };
    let loaded = load_photos(&views, &options, &|_| ())?;
    let mut skipped = scene.skipped.clone();
    skipped.add_loaded(&loaded, &views);
    let small = loaded.photos.par_iter().map(|photo| photo.as_ref().ok().map(Thumbnail::of).transpose());
    let mut thumbnails: Vec<Option<Thumbnail>> = small.collect::<io::Result<_>>().map_err(train::Error::Photos)?;
    let sound: Vec<Photo> = loaded.photos.iter().filter_map(|photo| photo.as_ref().ok().cloned()).collect();
    let background = usual_background(&sound, &Silent)?;
    drop((loaded, sound));
    let agreement = Agreement::of(&scene, &thumbnails);
    let kept = split.into_iter().filter_map(|view| Some((view, thumbnails[view].take()?)));
    let (train, photos): (Vec<usize>, Vec<Thumbnail>) = kept.unzip();
    let maps = depth_maps::of_views(&scene, &train, Resize::Width(THUMBNAIL_WIDTH));
    skipped.notes.extend(maps.notes);
    skipped.choices.extend(maps.choices);
    let (depths, iterations) = (maps.evidence, Schedule::default().iterations);
    let set = TrainingSet { scene: &scene, train: &train, photos: &photos, depths, background, scale: 1.0, iterations };
    let mut decisions = effects::decide(&set, &Overrides::default(), MAX_SH_DEGREE).decisions;
    if let Some(d) = decisions.iter_mut().find(|d| d.name == Effect::Antialias && d.on) {
        d.on = false;
        d.evidence +=
            ": it would help, but is on request only (--effect antialias=on), as most viewers draw plain models";
    }
    if let Some(length) = effects::trial_length(iterations, train.len()) {
        let tried = [Effect::Exposure, Effect::Poses];
        for d in decisions.iter_mut().filter(|d| tried.contains(&d.name) && d.is_untold()) {
            d.evidence += &format!("; a run begins with a trial of {length} iterations that decides");
        }
    }
    Ok((decisions, skipped, agreement))
}

/// Decides on view dependence for a model without photos: the SH bands that change a colour by 1/255 or more.
pub fn of_model(model: &Gaussians) -> Decision {
    let degree = model.degree_in_effect();
    let bands: Vec<_> = model.most_by_band().iter().map(|most| format!("{:.1}", 255.0 * most)).collect();
    let stored = model.degree();
    let evidence = match stored {
        0 => "the file has no band above 0".to_owned(),
        _ if degree < stored => format!(
            "bands 1 to {stored} change colours by at most {} of 255: pictures are drawn with degree {degree}, the file keeps all",
            bands.join(", ")
        ),
        _ => format!("bands 1 to {stored} change colours by at most {} of 255", bands.join(", ")),
    };
    Decision::of_degree(degree, evidence)
}

impl RunConfig {
    /// The configuration with the decisions filled in: written to `config.toml`, so that the model can be rendered as
    /// it was trained.
    #[must_use]
    pub fn decided(&self, decisions: &[Decision]) -> Self {
        let degree = decisions.iter().find(|d| d.name == Effect::ViewDependence).and_then(|d| d.degree);
        Self {
            sh_degree: degree.unwrap_or(self.sh_degree).min(self.sh_degree),
            style: Style { dilation: self.style.dilation, ..style(|effect| effects::is_on(decisions, effect)) },
            exposure: effects::is_on(decisions, Effect::Exposure),
            poses: effects::is_on(decisions, Effect::Poses),
            dropout: effects::is_on(decisions, Effect::Dropout),
            depth_loss: effects::is_on(decisions, Effect::Depth),
            ..self.clone()
        }
    }

    /// The effects that are on or off in this configuration, by their keys in config.toml.
    pub fn switches(&self) -> [(&'static str, Effect, bool); 6] {
        [
            ("antialias", Effect::Antialias, self.style.antialias),
            ("depth_order", Effect::DepthOrder, self.style.depth_order),
            ("exposure", Effect::Exposure, self.exposure),
            ("poses", Effect::Poses, self.poses),
            ("dropout", Effect::Dropout, self.dropout),
            ("depth_loss", Effect::Depth, self.depth_loss),
        ]
    }

    /// The keys of effects that are set here and not in the same configuration with the decisions: `[effects]` and the scene decide.
    pub fn overruled(&self, decided: &Self) -> Vec<&'static str> {
        let both = self.switches().into_iter().zip(decided.switches());
        both.filter(|((.., set), (.., on))| *set && !on).map(|((key, ..), _)| key).collect()
    }
}

/// The style of a model with these effects.
pub fn style(on: impl Fn(Effect) -> bool) -> Style {
    Style { antialias: on(Effect::Antialias), depth_order: on(Effect::DepthOrder), dilation: None }
}

/// A line with the effects that are on, and those whose decision was close.
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

/// Decides by a trial on exposures and poses, if nothing else told.
pub fn try_out(decisions: &mut [Decision], trial: &Trial) {
    let exposure = trial.exposures.map(effects::exposure_by_trial);
    let cameras = trial.cameras.filter(CameraErrors::tells);
    let poses = cameras.map(|c| effects::poses_by_trial(c.pixels, [c.psnr, c.fitted_psnr]));
    for tried in [exposure, poses].into_iter().flatten() {
        decisions.iter_mut().filter(|d| d.name == tried.name && d.is_untold()).for_each(|d| *d = tried.clone());
    }
}

/// Keeps the bands of an initial model, of this SH degree, where the degree was measured and not asked for.
pub fn keep_bands(decisions: &mut [Decision], degree: usize) {
    let measured = decisions.iter_mut().find(|d| d.name == Effect::ViewDependence && !d.forced);
    if let Some(d) = measured.filter(|d| d.degree.is_some_and(|lower| lower < degree)) {
        d.evidence += &format!("; the initial model has degree {degree}, and keeps its bands");
        (d.degree, d.on) = (Some(degree), true);
    }
}

/// Adds the points of a sky to those that training starts from, or started from; a run that starts from others has no such effect.
pub fn add_sky(decisions: &mut [Decision], sky: Vec<Point>, (config, start): (&RunConfig, &Start), scene: &mut Scene) {
    let from_points = match start {
        Start::Points(_) => true,
        Start::Resumed(_) => matches!(config.init, Init::Points) && scene.lacks_points().is_none(),
        Start::Random(_) | Start::Model(_) => false,
    };
    if from_points {
        scene.points.extend(sky);
    } else if let Some(d) = decisions.iter_mut().find(|d| d.name == Effect::Sky) {
        d.evidence += "; the run does not start from the capture's points";
        (d.on, d.near_threshold) = (false, false);
    }
}

/// The decisions with how far the run moved the cameras, in pixels, if it did.
#[must_use]
pub fn moved(mut decisions: Vec<Decision>, pixels: Option<Vec<f64>>) -> Vec<Decision> {
    let poses = decisions.iter_mut().find(|d| d.name == Effect::Poses);
    let mut pixels = pixels.unwrap_or_default();
    if let (Some(poses), Some(middle)) = (poses, median(&mut pixels)) {
        let most = pixels.iter().copied().fold(0.0, f64::max);
        poses.evidence += &format!("; cameras were moved by {middle:.2} pixels (median; {most:.2} at most)");
    }
    decisions
}

/// The decisions with the time of each effect in training.
#[must_use]
pub fn timed(mut decisions: Vec<Decision>, timings: &Timings) -> Vec<Decision> {
    for d in decisions.iter_mut().filter(|d| d.on) {
        let scope = d.name.scope();
        d.seconds = timings.iter().find(|(name, ..)| Some(*name) == scope).map(|(_, seconds, _)| seconds);
    }
    decisions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::config::Preset;

    #[test]
    fn a_trial_decides_only_what_nothing_else_told() {
        let trial = |gain: f64, pixels, psnr: f64| {
            let cameras = Some(CameraErrors { views: 8, pixels, psnr, fitted_psnr: psnr + gain });
            Trial { iterations: 500, exposures: Some([25.0, 25.0 + 2.0 * gain]), cameras }
        };
        let unknown = |decision: Decision| Decision { on: false, measured: None, ..decision };
        let untold =
            [effects::exposure_by_trial([0.0; 2]), effects::poses_by_trial(0.0, [0.0; 2])].map(unknown).to_vec();
        let on = |decisions: &[Decision], trial: &Trial| {
            let mut decisions = decisions.to_vec();
            try_out(&mut decisions, trial);
            [decisions[0].on, decisions[1].on]
        };
        assert_eq!(on(&untold, &trial(0.4, 0.5, 25.0)), [true, true]);
        assert_eq!(on(&untold, &trial(0.4, 0.2, 25.0)), [true, false]);
        assert_eq!(on(&untold, &trial(0.2, 0.5, 25.0)), [false, false]);
        assert_eq!(on(&untold, &trial(0.4, 0.5, 15.0)), [true, false], "too poor a model");
        let forced: Vec<_> = untold.iter().map(|d| Decision { forced: true, ..d.clone() }).collect();
        let measured: Vec<_> = untold.iter().map(|d| Decision { measured: Some(0.1), ..d.clone() }).collect();
        for told in [forced, measured] {
            assert_eq!(on(&told, &trial(0.4, 0.5, 25.0)), [false, false], "{told:?}");
        }
    }

    #[test]
    fn a_measured_degree_leaves_an_initial_model_its_bands() {
        let config = RunConfig::sample(Preset::Quick);
        for (forced, initial, expected) in [(false, 2, 2), (false, 0, 1), (true, 2, 1)] {
            let mut decisions = [Decision { forced, ..Decision::of_degree(1, String::new()) }];
            keep_bands(&mut decisions, initial);
            assert_eq!((decisions[0].degree, config.decided(&decisions).sh_degree), (Some(expected), expected));
        }
    }

    #[test]
    fn keys_that_decide_nothing_are_named() {
        let config = RunConfig { exposure: true, dropout: true, ..RunConfig::sample(Preset::Quick) };
        let decided = RunConfig { exposure: false, poses: true, ..config.clone() };
        assert_eq!((config.overruled(&decided), decided.overruled(&config)), (vec!["exposure"], vec!["poses"]));
    }
}
