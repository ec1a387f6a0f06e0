//! Evidence for the detection of floaters, from photos or from a model's own pictures.

use super::budget::{self, CompressNeeds};
use super::draw_source::DrawSource;
use super::pair_capacity;
use super::place::place_in;
use super::prepare::open;
use super::virtual_views::{self, VirtualCameras};
use crate::edit::{Evidence, Reason};
use crate::gaussians::Gaussians;
use crate::job::Error;
use crate::job::config::{Pruning, Selection};
use crate::job::session::Session;
use crate::job::watcher::{Silent, Stage};
use crate::render::{Settings, Source, Style};
use crate::response::{Responses, Wanted};
use crate::scene::Photo;
use crate::train::loss::Weights;
use crate::train::schedule::Schedule;
use crate::train::{self, Options, Trainer};

/// The rule by which each Gaussian of a model is a floater, if any, by the training photos of a scene. `origin` is the local origin of
/// its means in the world.
pub fn by_photos(
    session: &Session<'_>,
    model: &Gaussians,
    mut origin: [f64; 3],
    selection: &Selection,
    style: Style,
) -> Result<Vec<Option<Reason>>, Error> {
    let opened = open(selection)?;
    let needs = CompressNeeds { wanted: WANTED, style, ..CompressNeeds::of_photos(&opened) };
    let place = budget::for_compress(session.device, model, needs)?;
    let mut left = model.clone();
    place_in(&mut left, &mut origin, &opened.scene);
    let prepared = opened.load_to_train(session.photo_memory(&std::env::temp_dir()), session.watcher)?;
    let settings = prepared.settings(style);
    let mut found = vec![None; model.len()];
    // Each round measures what the last one left; where that removed nothing, its evidence still holds.
    let mut numbers: Vec<usize> = (0..model.len()).collect();
    let mut measured = None;
    for round in 0..Evidence::ROUNDS {
        let evidence = if let Some(evidence) = measured.take() {
            evidence
        } else {
            let shown = DrawSource::new(session, &left, place.whole)?;
            of_photos(session, &left, shown.source(), &prepared.train, settings)?
        };
        let reasons: Vec<Option<Reason>> = if round + 1 == Evidence::ROUNDS {
            evidence.floaters(&left)
        } else {
            evidence.disagreeing(&left, round).into_iter().map(|gone| gone.then_some(Reason::Disagrees)).collect()
        };
        if reasons.iter().all(Option::is_none) {
            measured = Some(evidence);
            continue;
        }
        numbers.iter().zip(&reasons).for_each(|(i, reason)| found[*i] = *reason);
        let kept: Vec<bool> = reasons.iter().map(Option::is_none).collect();
        left.compact(&kept);
        let mut kept = kept.into_iter();
        numbers.retain(|_| kept.next().unwrap_or(false));
    }
    Ok(found)
}

/// Evidence of photos on a model.
fn of_photos(
    session: &Session<'_>,
    model: &Gaussians,
    source: Source<'_>,
    photos: &[Photo],
    settings: Settings,
) -> Result<Evidence, Error> {
    let options = Options {
        schedule: Schedule { iterations: 0, ..Schedule::default() },
        settings,
        degree: model.degree(),
        most: model.len(),
        weights: Weights { l2: Pruning::L2 as f32, ..Weights::default() },
        pairs: pair_capacity::initial(session.device, model.len()),
        ..Options::default()
    };
    let mut evidence = Evidence::new(model.len(), true);
    train::responses_by_photo(session.device, source, photos, (&options, WANTED), |number, seen| {
        add(session, model, &mut evidence, photos, number, &seen)
    })?;
    Ok(evidence)
}

/// Floaters in a trainer's model, which is `model`, by the photos that it trains on, in one round of [`by_photos`].
pub fn of_training(
    session: &Session<'_>,
    model: &Gaussians,
    trainer: &mut Trainer,
    photos: &[Photo],
) -> Result<Vec<Option<Reason>>, Error> {
    let mut evidence = Evidence::new(model.len(), true);
    trainer.responses_by_photo(WANTED, |number, seen| add(session, model, &mut evidence, photos, number, &seen))?;
    Ok(evidence.floaters(model))
}

/// Adds the evidence of a photo.
fn add(
    session: &Session<'_>,
    model: &Gaussians,
    evidence: &mut Evidence,
    photos: &[Photo],
    number: usize,
    seen: &Responses,
) -> Result<(), Error> {
    evidence.add(model, &photos[number].camera, &seen.scores);
    session.watcher.progress(Stage::Responses, number + 1, photos.len());
    session.watcher.unless_stopped()
}

/// Scores, with the residual.
const WANTED: Wanted = Wanted { scores: true, residual: true, channels: false };

/// Floaters by a model's own pictures instead of photos ([`by_photos`]). The model agrees with them, so only the rules
/// for a single camera and for isolated Gaussians apply.
pub fn by_own_pictures(
    session: &Session<'_>,
    model: &Gaussians,
    cameras: &VirtualCameras,
    style: Style,
) -> Result<Vec<Option<Reason>>, Error> {
    let (size, wanted) = ([cameras.size.0, cameras.size.1], Wanted::SCORES);
    let needs = CompressNeeds { size, own_pictures: true, wanted, style, ..CompressNeeds::default() };
    let place = budget::for_compress(session.device, model, needs)?;
    let (cameras, settings) = cameras.views(model, [0.0; 3], style);
    let shown = DrawSource::new(session, model, place.whole)?;
    let mut evidence = Evidence::new(model.len(), false);
    let quiet = Session { watcher: &Silent, ..*session }; // a pass over one camera is a step, and no stage
    for (number, camera) in cameras.iter().enumerate() {
        let one = std::slice::from_ref(camera);
        let seen = virtual_views::responses(&quiet, shown.source(), one, None, settings, Wanted::SCORES)?;
        evidence.add(model, camera, &seen.scores);
        session.watcher.progress(Stage::Responses, number + 1, cameras.len());
        session.watcher.unless_stopped()?;
    }
    Ok(evidence.floaters(model))
}
