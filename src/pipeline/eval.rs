//! `qirf-vk eval`: a model of any format against a scene's held-out photos, or against another model's pictures.

use super::budget;
use super::draw_source::DrawSource;
use super::evaluate::{Assessment, Evaluator, HeldOut, camera_errors, protocol};
use super::prepare::{Prepared, open, refuse_photo_folders};
use super::virtual_views::{ALL, OwnPictures, VirtualCameras};
use crate::gaussians::Gaussians;
use crate::job::records::{RunRecord, Times};
use crate::job::{Error, Output, Selection, Session, Stage};
use crate::render::{Settings, Source, Style};
use crate::scene::camera;
use std::path::Path;
use std::time::Instant;

/// Views to evaluate on, and the style of rendering.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// The scene and its held-out views.
    pub selection: Selection,
    /// Style of rendering: the one that the model was trained with.
    pub style: Style,
    /// True if photos have exposures of their own: fitted before scoring, as in a run.
    pub exposure: bool,
}

/// Renders and scores the held-out views of a scene as a run of the same selection does; writes figures and pictures to
/// `output`, if given. `file` is the path that `model` was read from.
pub fn eval(
    session: &Session<'_>,
    file: &Path,
    model: &Gaussians,
    evaluation: &Evaluation,
    output: Option<&Output>,
) -> Result<RunRecord, Error> {
    let begun = Instant::now();
    let Session { device, networks, watcher, .. } = *session;
    let Evaluation { selection, style, exposure } = evaluation;
    let opened = open(selection)?;
    let written = output.map(|output| [output.metrics(), output.renders().join("picture.png")]);
    refuse_photo_folders(&opened.scene, written.iter().flatten())?;
    let place = budget::for_pictures(device, model, opened.size(), *style)?;
    let elsewhere = std::env::temp_dir();
    let folder = output.map_or(elsewhere.as_path(), Output::folder);
    let prepared = opened.load(session.photo_memory(folder), watcher)?;
    if prepared.test.is_empty() {
        return Err(Error::NothingHeldOut(selection.scene.clone()));
    }
    let load_s = begun.elapsed().as_secs_f64();

    let evaluating = Instant::now();
    let shown = DrawSource::new(session, model, place.whole)?;
    let renders = output.map(Output::renders);
    let (mut assessment, mut evaluator) = assess(session, shown.source(), evaluation, &prepared, renders.as_deref())?;
    assessment.held_out.warn(watcher);
    assessment.frames_per_second = evaluator.frames_per_second(shown.source(), &prepared)?;
    drop((evaluator, shown));
    let held_out: Vec<_> = prepared.test.iter().map(|(_, photo)| photo).collect();
    let camera_errors = camera_errors(session, model, &held_out, prepared.settings(*style), *exposure)?;
    if let Some(note) = camera_errors.and_then(|errors| errors.note(None, true)) {
        watcher.note(&note);
    }
    let protocol = protocol(selection, &prepared, networks, *exposure);
    let record = RunRecord {
        time: Times {
            total_s: begun.elapsed().as_secs_f64(),
            load_s,
            evaluate_s: evaluating.elapsed().as_secs_f64(),
            ..Times::default()
        },
        camera_errors,
        memory: session.memory(place.bytes),
        ..assessment.record(session, prepared.scene.skipped.clone(), protocol, model, file)
    };
    if let Some(output) = output {
        Output::json(&output.metrics(), "metrics.json", &record)?;
    }
    Ok(record)
}

/// Measures a model on some of a scene's photos, for an evaluation in parts: as [`eval`] does on all of them, without the frame rate.
/// Photos are named, those `held_out` and those trained on, and only these are decoded.
pub fn part(
    session: &Session<'_>,
    model: &Gaussians,
    evaluation: &Evaluation,
    [held_out, trained]: [&[String]; 2],
) -> Result<Assessment, Error> {
    let Evaluation { selection, style, .. } = evaluation;
    let opened = open(selection)?.only(&[held_out, trained].concat())?;
    let place = budget::for_pictures(session.device, model, opened.size(), *style)?;
    let prepared = opened.load(session.photo_memory(&std::env::temp_dir()), session.watcher)?.holding_out(held_out);
    let shown = DrawSource::new(session, model, place.whole)?;
    Ok(assess(session, shown.source(), evaluation, &prepared, None)?.0)
}

/// Measures a model on these views, and writes pictures of those held out to a folder, if given.
fn assess(
    session: &Session<'_>,
    model: Source<'_>,
    evaluation: &Evaluation,
    prepared: &Prepared,
    renders: Option<&Path>,
) -> Result<(Assessment, Evaluator), Error> {
    let Session { device, networks, watcher, .. } = *session;
    let settings = prepared.settings(evaluation.style);
    let mut evaluator = Evaluator::of(device, settings, model, prepared.views())?;
    evaluator.compare_as(evaluation.exposure);
    let mut follow = |done: usize| watcher.step(Stage::Scores, done, prepared.test.len());
    let mut assessment = evaluator.assess(model, prepared, renders, networks, &mut follow)?;
    assessment.train_psnr = evaluator.psnr(model, prepared.train.iter())?;
    Ok((assessment, evaluator))
}

/// Scores a model against the pictures of `original`, in the held-out views that `qirf-vk compress` would use: the loss
/// of a compression by any tool. Each is given with its style; the background is red, green and blue.
pub fn against(
    session: &Session<'_>,
    [(model, style), (original, original_style)]: [(&Gaussians, Style); 2],
    background: [f32; 3],
) -> Result<HeldOut, Error> {
    let Session { device, networks, watcher, .. } = *session;
    let views = VirtualCameras::default().views(original, background, original_style);
    let (size, near) = (camera::largest(&views.around), views.settings.near);
    let test = {
        let original = DrawSource::for_pictures(session, original, size, original_style)?;
        OwnPictures::draw(session, original.source(), views, false, ALL)?.test
    };
    let shown = DrawSource::for_pictures(session, model, size, style)?;
    let settings = Settings { near, ..style.over(background) };
    let mut evaluator = Evaluator::of(device, settings, shown.source(), test.iter().map(|(_, view)| view))?;
    let held_out = evaluator
        .held_out(shown.source(), &test, None, networks, &mut |done| watcher.step(Stage::Scores, done, test.len()))?;
    held_out.warn(watcher);
    Ok(held_out)
}
