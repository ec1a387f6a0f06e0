//! Detectors that read the colours of points: exposure, and dependence on the direction of view.

use super::decision::{Decision, is_near};
use super::effect::Effect;
use super::quantile::quantile;
use super::tracks::Observation;
use super::training_set::TrainingSet;
use crate::gaussians::MAX_SH_DEGREE;
use crate::gaussians::sh::basis;
use crate::scene::View;
use crate::solve;
use crate::wording::counted;
use glam::DVec3;
use rayon::prelude::*;

/// Spread of the photos' log-gains above which each photo gets its own exposure.
pub const GAINS: f64 = 0.02;
/// Share of the points' differences between photos that gains must explain: if it is less, light changed or surfaces
/// reflect, which no exposure corrects.
pub const EXPLAINED: f64 = 1.0 / 3.0;
/// The same for points without tracks, some of which a photo does not see. Of sound captures, the largest were 0.04 and 0.04 (synthetic)
/// and 0.13 and 0.23 (snowmiku).
const STRONG: (f64, f64) = (0.2, 0.5);
/// Deviation of a point's colours above which they depend on the view: larger than the noise of thumbnails.
pub const DEVIATION: f64 = 0.005;
/// Share of points, the smoothest, whose deviation counts: the colours of others change with the texture around them.
const SMOOTH: f64 = 0.1;
/// The highest degree is chosen whose held-out error is at most this factor times the smallest.
const AS_GOOD: f64 = 1.005;
/// Range of channels that are neither lost in noise nor clipped.
const USABLE: (f64, f64) = (0.06, 0.94);
/// Rounds of fitting gains to points, then points to gains.
const ROUNDS: usize = 8;
/// Smallest number of photos with common points, and of common colours of each photo, for gains to be trusted.
const COMMON: (usize, usize) = (3, 20);
/// Smallest number of observations of a point for a fit of its dependence on the view.
const OBSERVED: usize = 8;
/// Smallest number of such points for the degree to be told.
const FEWEST: usize = 20;
/// Number of parts of a point's observations, each held out once.
const FOLDS: usize = 4;
/// Strength of the pull of SH coefficients towards 0, in observations.
const RIDGE: f64 = 1.0;
/// Number of coefficients up to degree 3.
const TERMS: usize = 16;

/// Brightness of each photo relative to the others.
#[derive(Clone, Debug, Default)]
pub struct Gains {
    /// For each photo, the log-gains of red, green and blue; their mean over photos is 0.
    pub log: Vec<DVec3>,
    /// For each photo, their standard errors; infinite if it has too few common colours.
    pub errors: Vec<DVec3>,
    /// Standard deviation of the log-gains, without the part that the errors explain.
    pub spread: f64,
    /// Share of the absolute differences of points' log-colours between photos that the gains explain.
    pub explained: f64,
    /// Number of photos that share enough points with others.
    pub photos: usize,
}

impl Gains {
    /// True if photos differ so much that points whose tracks are unknown tell it.
    pub fn are_strong(&self) -> bool {
        self.spread > STRONG.0 && self.explained > STRONG.1
    }

    /// For each photo, the gains of red, green and blue, each drawn towards 1 as its error grows relative to the spread
    /// of all; empty if photos share too little to be compared.
    pub fn believed(&self) -> Vec<[f32; 3]> {
        if self.photos == 0 {
            return Vec::new();
        }
        let variance = self.spread * self.spread;
        let believe = |(log, error): (&DVec3, &DVec3)| {
            let share = |e: f64| if variance > 0.0 { variance / (variance + e * e) } else { 0.0 };
            (*log * DVec3::from(error.to_array().map(share))).exp().as_vec3().to_array()
        };
        self.log.iter().zip(&self.errors).map(believe).collect()
    }
}

/// True if a channel is neither lost in noise nor clipped.
fn is_usable(value: f64) -> bool {
    value > USABLE.0 && value < USABLE.1
}

/// Fits gains of `count` photos to the colours of common points: log colour = point + gain, alternating medians.
pub fn gains(tracks: &[Vec<Observation>], count: usize) -> Gains {
    let fits: Vec<Channel> = (0..3).into_par_iter().map(|c| channel(tracks, count, c)).collect();
    let channels = |of: &dyn Fn(usize) -> f64| DVec3::new(of(0), of(1), of(2));
    let log: Vec<DVec3> = (0..count).map(|s| channels(&|c| fits[c].gains[s])).collect();
    let errors: Vec<DVec3> = (0..count).map(|s| channels(&|c| fits[c].errors[s])).collect();
    let (mut sum, mut noise, mut n) = (0.0, 0.0, 0.0);
    for Channel { gains, errors, .. } in &fits {
        for (value, error) in gains.iter().zip(errors).filter(|(_, e)| e.is_finite()) {
            sum += value * value;
            noise += error * error;
            n += 1.0;
        }
    }
    let spread = ((sum - noise).max(0.0) / f64::max(n, 1.0)).sqrt();
    let [before, after] = [0, 1].map(|k| fits.iter().map(|f| f.apart[k]).sum::<f64>());
    let explained = 1.0 - after / before.max(f64::MIN_POSITIVE);
    let photos = fits[0].errors.iter().filter(|e| e.is_finite()).count();
    if photos < COMMON.0 {
        return Gains { log: vec![DVec3::ZERO; count], errors, spread: 0.0, explained: 0.0, photos: 0 };
    }
    Gains { log, errors, spread, explained, photos }
}

/// Gains of one channel.
struct Channel {
    /// Log-gain of each photo.
    gains: Vec<f64>,
    /// Their standard errors; infinite for a photo with too few common colours.
    errors: Vec<f64>,
    /// Sums of the absolute differences between log-colours and those of their points, without and with the gains.
    apart: [f64; 2],
}

/// Fits the gains of channel `c`.
fn channel(tracks: &[Vec<Observation>], count: usize, c: usize) -> Channel {
    let usable = |o: &&Observation| is_usable(o.colour[c]);
    let logs: Vec<Vec<(usize, f64)>> = tracks
        .iter()
        .map(|seen| seen.iter().filter(usable).map(|o| (o.photo, o.colour[c].ln())).collect())
        .filter(|seen: &Vec<_>| seen.len() >= 3)
        .collect();
    let (mut gains, mut errors) = (vec![0.0; count], vec![f64::INFINITY; count]);
    for _ in 0..ROUNDS {
        let mut by_photo = vec![Vec::new(); count];
        for seen in &logs {
            for ((s, _), apart) in seen.iter().zip(from_point(seen, &gains)) {
                by_photo[*s].push(apart + gains[*s]);
            }
        }
        for (s, values) in by_photo.iter_mut().enumerate().filter(|(_, v)| v.len() >= COMMON.1) {
            gains[s] = quantile(values, 0.5);
            let mut deviations: Vec<f64> = values.iter().map(|v| (v - gains[s]).abs()).collect();
            // The standard error of the median of normal values, with the scale from the median absolute deviation.
            errors[s] = 1.2533 * 1.4826 * quantile(&mut deviations, 0.5) / (values.len() as f64).sqrt();
        }
        let known = || errors.iter().zip(&gains).filter(|(e, _)| e.is_finite()).map(|(_, g)| *g);
        let mean = known().sum::<f64>() / known().count().max(1) as f64;
        for (g, _) in gains.iter_mut().zip(&errors).filter(|(_, e)| e.is_finite()) {
            *g -= mean;
        }
    }
    let apart = |gains: &[f64]| -> f64 { logs.iter().flat_map(|seen| from_point(seen, gains)).map(f64::abs).sum() };
    let apart = [apart(&vec![0.0; count]), apart(&gains)];
    Channel { gains, errors, apart }
}

/// A point's log-colours by photo, minus the photos' gains and the point's own log-colour (their median).
fn from_point(seen: &[(usize, f64)], gains: &[f64]) -> Vec<f64> {
    let left: Vec<f64> = seen.iter().map(|(s, l)| l - gains[*s]).collect();
    let point = quantile(&mut left.clone(), 0.5);
    left.into_iter().map(|l| l - point).collect()
}

/// The exposures in the photos' headers: reported, but not used. Cameras with automatic exposure give darker scenes
/// more light, so that stops reflect the settings, not the photos' differences.
fn headers(set: &TrainingSet<'_>) -> String {
    let views = set.train.par_iter().filter_map(|i| set.scene.views.get(*i));
    let stops: Vec<f64> = views.filter_map(View::exposure_stops).collect();
    let (low, high) = stops.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), s| (l.min(*s), h.max(*s)));
    match stops.len() {
        0 => String::new(),
        n => format!("; EXIF of {}: exposures span {:.1} stops", counted(n, "photo"), high - low),
    }
}

/// Exposures of photos: compares their gains.
pub fn exposure(set: &TrainingSet<'_>, tracks: &[Vec<Observation>], gains: &Gains) -> Decision {
    let headers = headers(set);
    if gains.photos == 0 {
        let why = match tracks.len() {
            0 => "no points with tracks, and no strong differences on others: photos cannot be compared",
            _ if tracks.iter().flatten().all(|seen| !is_usable(seen.colour.element_sum() / 3.0)) => {
                "the points are nearly black or white in all photos, which cannot be compared"
            }
            _ => "photos share too few points that are neither black nor white to be compared",
        };
        return Decision::plain(Effect::Exposure, false, format!("{why}{headers}"));
    }
    let bounds = gains.log.iter().map(|g| g.element_sum() / 3.0);
    let (low, high) = bounds.fold((0.0_f64, 0.0_f64), |(l, h), g| (l.min(g), h.max(g)));
    let percent = |g: f64| 100.0 * (g.exp() - 1.0);
    let evidence = format!(
        "brightness of {} photos spreads by {:.1} % ({:+.1} to {:+.1} %) on {} points that they share, which explains {:.0} % of their differences{headers}",
        gains.photos,
        100.0 * gains.spread,
        percent(low),
        percent(high),
        tracks.len(),
        100.0 * gains.explained
    );
    let decision = Decision::by(Effect::Exposure, gains.spread, GAINS, evidence);
    // Either measure can switch it off; if one is far below its threshold, the other's closeness does not matter.
    let (explains, near) = (gains.explained > EXPLAINED, is_near(gains.explained, EXPLAINED));
    let near = (decision.near_threshold && (explains || near)) || (near && decision.on);
    Decision { on: decision.on && explains, near_threshold: near, ..decision }
}

/// Degree of a scene whose colours need none: the first band is cheap and small, and compensates for shapes that are
/// not right yet and look different from each side; higher bands fit the photos at the cost of all other views.
const LEAST_DEGREE: usize = 1;

/// The SH degree that the colours of points call for; the highest allowed if there are no such points.
pub fn view_dependence(tracks: &[Vec<Observation>], gains: &Gains, most: usize) -> Decision {
    let most = most.min(MAX_SH_DEGREE);
    let even = gains.spread <= GAINS;
    let corrected = |seen: &Vec<Observation>| -> Vec<Observation> {
        let gain = |s: usize| if even { DVec3::ONE } else { gains.log[s].exp() };
        seen.iter().map(|o| Observation { colour: o.colour / gain(o.photo), ..*o }).collect()
    };
    let long: Vec<Vec<Observation>> = tracks.iter().filter(|t| t.len() >= OBSERVED).map(corrected).collect();
    if long.len() < FEWEST || most == 0 {
        let why = match (most, tracks.len()) {
            (0, _) => "no SH degree above 0 is allowed".to_owned(),
            (_, 0) => format!("no points have tracks, so the scene does not tell the degree: {most} is used"),
            _ => format!(
                "{} seen by {OBSERVED} photos or more, too few to tell the degree: {most} is used",
                counted(long.len(), "point")
            ),
        };
        return Decision { degree: Some(most), ..Decision::plain(Effect::ViewDependence, most > 0, why) };
    }
    let errors = long
        .par_iter()
        .map(|seen| held_back(seen))
        .reduce(|| [0.0; MAX_SH_DEGREE + 1], |a, b| std::array::from_fn(|l| a[l] + b[l]));
    let mut order: Vec<(f64, usize)> = long.iter().map(|seen| contrast(seen)).zip(0..).collect();
    order.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    order.truncate(((long.len() as f64 * SMOOTH) as usize).max(10));
    let mut deviations: Vec<f64> = order.iter().map(|(_, i)| deviation(&long[*i])).collect();
    let deviation = quantile(&mut deviations, 0.5);
    let least = errors[..=most].iter().copied().fold(f64::INFINITY, f64::min);
    let best = (1..=most).rev().find(|l| errors[*l] <= AS_GOOD * least).unwrap_or(1);
    let explained = |l: usize| 100.0 * (1.0 - errors[l] / errors[0].max(f64::MIN_POSITIVE));
    let list: Vec<_> = (1..=most).map(|l| format!("{l}: {:.1} %", explained(l))).collect();
    let evidence = format!(
        "colours of smooth points differ by {:.2} % between photos (median of {}); on photos left out of the fit, the error \
         of {} points falls with the SH degree ({})",
        100.0 * deviation,
        order.len(),
        long.len(),
        list.join(", ")
    );
    let decision = Decision::by(Effect::ViewDependence, deviation, DEVIATION, evidence);
    let degree = if decision.on { best } else { LEAST_DEGREE };
    Decision { degree: Some(degree), on: true, ..decision }
}

/// Mean contrast around a point.
fn contrast(seen: &[Observation]) -> f64 {
    seen.iter().map(|o| o.contrast).sum::<f64>() / seen.len().max(1) as f64
}

/// Root mean square of a point's colours about their mean.
fn deviation(seen: &[Observation]) -> f64 {
    let mean = seen.iter().map(|o| o.colour).sum::<DVec3>() / seen.len() as f64;
    (seen.iter().map(|o| (o.colour - mean).length_squared()).sum::<f64>() / (3 * seen.len()) as f64).sqrt()
}

/// For each SH degree, the mean absolute error of a point's colours, each predicted from those of other photos.
fn held_back(seen: &[Observation]) -> [f64; MAX_SH_DEGREE + 1] {
    let mut errors = [0.0; MAX_SH_DEGREE + 1];
    for fold in 0..FOLDS {
        // Neighbours in the list are often neighbours in space and must be in different parts.
        let (held, fitted): (Vec<_>, Vec<_>) = seen.iter().enumerate().partition(|(i, _)| i % FOLDS == fold);
        for (degree, error) in errors.iter_mut().enumerate() {
            let terms = (degree + 1) * (degree + 1);
            let coefficients = fit(&fitted, terms);
            for (_, o) in &held {
                let predicted: DVec3 =
                    terms_of(o.direction).into_iter().zip(coefficients).take(terms).map(|(b, c)| c * b).sum();
                *error += (o.colour - predicted).abs().element_sum() / (3 * seen.len()) as f64;
            }
        }
    }
    errors
}

/// The basis with its constant term 1.
fn terms_of(direction: DVec3) -> [f64; TERMS] {
    let mut terms = basis(direction);
    terms[0] = 1.0;
    terms
}

/// Ridge regression of colours on the first `terms` functions; the constant one is not penalised.
fn fit(seen: &[(usize, &Observation)], terms: usize) -> [DVec3; TERMS] {
    let mut a = [[0.0; TERMS]; TERMS];
    let mut b = [DVec3::ZERO; TERMS];
    for (_, o) in seen {
        let x = terms_of(o.direction);
        for i in 0..terms {
            for j in 0..terms {
                a[i][j] += x[i] * x[j];
            }
            b[i] += o.colour * x[i];
        }
    }
    // Terms beyond these are 0.
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += if i == 0 {
            1e-9
        } else if i < terms {
            RIDGE
        } else {
            1.0
        };
    }
    let by_channel = [0, 1, 2].map(|c| solve::positive(a, b.map(|b| b[c])));
    std::array::from_fn(|i| DVec3::from_array(by_channel.map(|x| x[i])))
}
