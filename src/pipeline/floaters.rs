//! Evidence for the detection of floaters, from photos or from a model's own pictures.

use super::budget::{self, CompressNeeds};
use super::draw_source::DrawSource;
use super::pair_capacity;
use super::place::place_in;
use super::prepare::open;
use super::virtual_views::{self, VirtualCameras, VirtualViews};
use crate::edit::{Evidence, Reason};
use crate::gaussians::Gaussians;
use crate::job::config::Pruning;
use crate::job::{Error, Selection, Session, Silent, Stage};
use crate::render::{Painter, Settings, Source, Style};
use crate::response::{Responses, Wanted};
use crate::scene::{Photo, camera, median};
use crate::train::loss::Weights;
use crate::train::schedule::Schedule;
use crate::train::{self, Exposures, Options, Trainer};
use std::ops::Range;

/// Least share by which gains lower a photo's differences from the model's picture if it has an exposure of its own.
const PAYS: f64 = 0.1;
/// Least logarithm of a gain of such a photo. On models of 3,000 to 8,000 Gaussians, the middle photo of captures without
/// exposures gained 0.04 at most, and 0.13 with exposures that spread by 4 %.
const EVEN: f32 = 0.01;
/// Range of channels that are neither lost in noise nor clipped.
const USABLE: Range<f32> = 0.06..0.94;
/// Number of pixels of a photo that its gains are fitted to, about; and the fewest usable ones.
const FITTED: (usize, usize) = (1 << 16, 20);

/// The rule by which each Gaussian of a model is a floater, if any, by the training photos of a scene. `origin` is the local origin of
/// its means in the world. Where most photos have exposures of their own, gains are fitted to them first: no Gaussian is to blame for these.
pub fn by_photos(
    session: &Session<'_>,
    model: &Gaussians,
    mut origin: [f64; 3],
    selection: &Selection,
    style: Style,
) -> Result<Vec<Option<Reason>>, Error> {
    let opened = open(selection)?;
    let needs = CompressNeeds { wanted: WANTED, style, exposure: true, ..CompressNeeds::of_photos(&opened) };
    let place = budget::for_compress(session.device, model, needs)?;
    let mut left = model.clone();
    place_in(&mut left, &mut origin, &opened.scene);
    let prepared = opened.load_to_train(session.photo_memory(&std::env::temp_dir()), session.watcher)?;
    let settings = prepared.settings(style);
    let mut found = vec![None; model.len()];
    // Each round measures what the last one left; where that removed nothing, its evidence still holds.
    let mut numbers: Vec<usize> = (0..model.len()).collect();
    let exposures = {
        let shown = DrawSource::new(session, &left, place.whole)?;
        fit_exposures(session, shown.source(), &prepared.train, settings)?
    };
    let mut measured = None;
    for round in 0..Evidence::ROUNDS {
        let evidence = if let Some(evidence) = measured.take() {
            evidence
        } else {
            let shown = DrawSource::new(session, &left, place.whole)?;
            of_photos(session, &left, shown.source(), (prepared.train.as_slice(), exposures.clone()), settings)?
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

/// The photos' exposures, if at least half of the photos have exposures of their own.
fn fit_exposures(
    session: &Session<'_>,
    source: Source<'_>,
    photos: &[Photo],
    settings: Settings,
) -> Result<Option<Exposures>, Error> {
    let (gains, own) = gains(session, source, photos, settings)?;
    if own == 0 || 2 * own < photos.len() {
        return Ok(None);
    }
    session.watcher.note("the photos differ in exposure: gains of red, green and blue are fitted to each of them");
    Ok(Some(Exposures::Learnt(gains)))
}

/// Gains of the photos' red, green and blue relative to the model's pictures, and the number of photos that have exposures of their own.
pub(super) fn gains(
    session: &Session<'_>,
    source: Source<'_>,
    photos: &[Photo],
    settings: Settings,
) -> Result<(Vec<[f32; 3]>, usize), Error> {
    let mut painter = Painter::of(session.device, settings, source, camera::largest(photos.iter().map(|p| &p.camera)))?;
    let (mut all, mut own) = (Vec::with_capacity(photos.len()), 0);
    for photo in photos {
        session.watcher.unless_stopped()?;
        let drawn = painter.render(source, &photo.camera)?;
        let (gains, pays) = fit_gains(&drawn.pixels, &photo.pixels.read().map_err(train::Error::Photos)?);
        own += usize::from(pays);
        all.push(gains);
    }
    Ok((all, own))
}

/// Gains by which a picture (red, green, blue, alpha) comes closest to a photo (RGBA, 8 bits each), and true if the photo has an exposure
/// of its own. They are medians of the pixels' ratios: floaters on less than half of the photo do not change them.
fn fit_gains(drawn: &[[f32; 4]], photo: &[u8]) -> ([f32; 3], bool) {
    // An odd step visits all columns of most pictures.
    let step = (drawn.len() / FITTED.0) | 1;
    let counted = drawn.iter().zip(photo.as_chunks::<4>().0).step_by(step).filter(|(_, p)| p[3] == u8::MAX);
    let (mut gains, mut before, mut after) = ([1.0_f32; 3], 0.0, 0.0);
    for (c, gain) in gains.iter_mut().enumerate() {
        let pairs: Vec<(f32, f32)> = counted.clone().map(|(x, p)| (x[c], f32::from(p[c]) / 255.0)).collect();
        let usable = pairs.iter().filter(|(x, y)| USABLE.contains(x) && USABLE.contains(y));
        let mut ratios: Vec<f32> = usable.map(|(x, y)| y / x).collect();
        if ratios.len() >= FITTED.1 {
            *gain = median(&mut ratios).unwrap_or(1.0);
        }
        for (x, y) in &pairs {
            before += f64::from((x.min(1.0) - y).abs());
            after += f64::from(((*gain * x).min(1.0) - y).abs());
        }
    }
    let differs = gains.iter().any(|gain| gain.ln().abs() >= EVEN);
    (gains, differs && before - after >= PAYS * before)
}

/// Evidence of photos, with their exposures if they have any, on a model.
fn of_photos(
    session: &Session<'_>,
    model: &Gaussians,
    source: Source<'_>,
    (photos, exposure): (&[Photo], Option<Exposures>),
    settings: Settings,
) -> Result<Evidence, Error> {
    let options = Options {
        schedule: Schedule { iterations: 0, ..Schedule::default() },
        settings,
        degree: model.degree(),
        most: model.len(),
        exposure,
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
    session.watcher.step(Stage::Responses, number + 1, photos.len())
}

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
    let VirtualViews { around: cameras, settings, .. } = cameras.views(model, [0.0; 3], style);
    let shown = DrawSource::new(session, model, place.whole)?;
    let mut evidence = Evidence::new(model.len(), false);
    let quiet = Session { watcher: &Silent, ..*session }; // a pass over one camera is a step, and no stage
    for (number, camera) in cameras.iter().enumerate() {
        let one = std::slice::from_ref(camera);
        let seen = virtual_views::responses(&quiet, shown.source(), one, None, settings, Wanted::SCORES)?;
        evidence.add(model, camera, &seen.scores);
        session.watcher.step(Stage::Responses, number + 1, cameras.len())?;
    }
    Ok(evidence.floaters(model))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture with floaters on a third of it, and photos without them, some with an exposure of their own.
    #[test]
    fn gains_are_those_of_the_photo_despite_floaters() {
        let value = |n: usize, c: usize| 0.1 + ((n * (7 + c)) % 60) as f32 / 100.0;
        let byte = |gain: f32, n: usize, c: usize| (255.0 * gain * value(n, c)).round() as u8;
        let photo = |[r, g, b]: [f32; 3]| -> Vec<u8> {
            (0..900).flat_map(|n| [byte(r, n, 0), byte(g, n, 1), byte(b, n, 2), 255]).collect()
        };
        let drawn: Vec<[f32; 4]> = (0..900)
            .map(|n| if n % 3 == 0 { [0.9, 0.9, 0.1, 1.0] } else { [value(n, 0), value(n, 1), value(n, 2), 1.0] })
            .collect();
        for (expected, own) in [([0.8, 1.2, 1.1], true), ([1.0; 3], false)] {
            let (gains, pays) = fit_gains(&drawn, &photo(expected));
            let near = gains.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.01);
            assert!(near && pays == own, "{gains:?}, {expected:?}");
        }
        let hidden = vec![0_u8; 3600];
        assert_eq!(fit_gains(&drawn, &hidden), ([1.0; 3], false), "a mask hides all");
    }
}
