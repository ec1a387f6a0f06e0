//! Detectors that read cameras, lenses and the photos' fourth byte.

use super::decision::{Decision, is_near};
use super::doubts::cause;
use super::effect::Effect;
use super::quantile::quantile;
use super::sky::direction;
use super::training_set::{DepthEvidence, DepthWitness, TrainingSet};
use crate::scene::lens::{Lens, VISIBLE_DISPLACEMENT};
use crate::scene::{ALPHA_SHARE, AlphaRole, Misfit, SceneKind, View, median};
use crate::wording::counted;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeSet, HashSet};

/// Ratio of a point's pixel footprints above which a scene calls for anti-aliasing.
pub const FOOTPRINTS: f64 = 1.5;
/// The same, in multiples, above which a run says that it would help.
const MUCH: f64 = 2.0;
/// Median error of points, in pixels of the pictures trained on, above which cameras are corrected.
pub const MISPLACED: f64 = 1.0;
/// Misfit as a share of the picture's diagonal from which on no correction of poses finds the right ones.
const LOST: f64 = 0.1;
/// Median deviation of points from depth maps, as a share of their depth, up to which the maps are trained on, and points
/// are taken from them.
pub const DEPTHS_AGREE: f64 = 0.1;
/// Number of points whose footprints are compared.
const POINTS: usize = 4000;
/// Number of views that must see a point.
const SEEN_BY: usize = 3;
/// Share of pixels below which transparency or masks may be flaws of the photos.
const FEW: f64 = 1e-3;

/// Times that a run trains on each photo, divided by the number of photos, from which pictures leave Gaussians out.
pub const LOOKS: f64 = 4.5;

/// Largest number of photos with which pictures leave Gaussians out: of more, some show the same place, and to leave Gaussians
/// out only costs.
const FEW_PHOTOS: usize = 25;

/// How often a run of `iterations` trains on each photo, divided by the number of photos.
pub fn looks(iterations: u32, photos: usize) -> f64 {
    f64::from(iterations) / (photos.max(1) as f64).powi(2)
}

/// Dropout: how few photos there are, and how often the run trains on each. Before nothing, an object would
/// have holes where Gaussians are left out, which no other Gaussian can hide.
pub fn dropout(set: &TrainingSet<'_>) -> Decision {
    let photos = set.train.len();
    let times = f64::from(set.iterations) / photos.max(1) as f64;
    let often = if times.round() == 1.0 { "once".to_owned() } else { format!("{times:.0} times") };
    if photos == 0 {
        return Decision::plain(Effect::Dropout, false, "there is no photo to train on".to_owned());
    }
    let evidence = format!("each of {} is trained on {often}", counted(photos, "photo"));
    if hidden(set, AlphaRole::Alpha).0 > 0 {
        let why = format!("{evidence}, but transparent photos would show holes where Gaussians are omitted");
        return Decision::plain(Effect::Dropout, false, why);
    }
    let evidence = format!("{evidence} in {} iterations", set.iterations);
    if photos > FEW_PHOTOS {
        let why = format!("{evidence}; runs on more than {FEW_PHOTOS} photos do not need dropout");
        return Decision::plain(Effect::Dropout, false, why);
    }
    Decision::by(Effect::Dropout, looks(set.iterations, photos), LOOKS, evidence)
}

/// Depth: how far maps of it are from the points.
pub fn depth(set: &TrainingSet<'_>) -> Decision {
    let DepthEvidence { maps, by, deviation } = set.depths;
    let counted = counted(maps, "depth map");
    let (on, evidence) = match (maps, deviation) {
        (0, _) if set.views().any(|view| view.depth.is_some()) => (false, "no depth map can be used".to_owned()),
        (0, _) => (false, "no photo has a depth map".to_owned()),
        (_, None) => (false, format!("{counted}, but too little in common to tell whether they are right")),
        (_, Some(share)) => (
            share <= DEPTHS_AGREE,
            format!(
                "{counted}, from which {} deviate by {:.2} % of the depth (median)",
                match by {
                    DepthWitness::Points => "the capture's points",
                    DepthWitness::Maps => "others of them",
                },
                100.0 * share
            ),
        ),
    };
    Decision {
        near_threshold: deviation.is_some_and(|share| is_near(share, DEPTHS_AGREE)),
        measured: deviation,
        threshold: Some(DEPTHS_AGREE),
        ..Decision::plain(Effect::Depth, on, evidence)
    }
}

/// Poses: how far the points are from where the photos show them, in pixels of the pictures trained on. Structure from
/// motion writes this error with each point; where it also writes the places of points in
/// photos, the poses are measured against these.
pub fn poses(set: &TrainingSet<'_>) -> Decision {
    let mut errors: Vec<f64> = set.scene.points.iter().map(|p| f64::from(p.error)).filter(|e| *e > 0.0).collect();
    let written = (!errors.is_empty()).then(|| quantile(&mut errors, 0.5) * set.scale);
    let misfits: Vec<Misfit> = set.views().filter_map(|view| view.misfit).collect();
    let middle = |of: fn(&Misfit) -> f64| median(&mut misfits.iter().map(of).collect::<Vec<_>>());
    // Where lenses or axes account for it, other poses would only hide that.
    let told = middle(Misfit::share).is_some_and(|share| share < LOST) && cause(&misfits).is_none();
    let measured = middle(|misfit| misfit.px).filter(|_| told).map(|px| px * set.scale);
    let (pixels, evidence) = match (written, measured) {
        (_, Some(pixels)) if written.is_none_or(|written| pixels > written) => {
            let photos = counted(misfits.len(), "photo");
            (pixels, format!("the points lie {pixels:.2} pixels from where {photos} show them (median)"))
        }
        (Some(pixels), _) => {
            let points = counted(errors.len(), "point");
            (pixels, format!("the median reprojection error of {points} is {pixels:.2} pixels"))
        }
        (None, _) => {
            return Decision::plain(Effect::Poses, false, "the points have no reprojection errors".to_owned());
        }
    };
    Decision::by(Effect::Poses, pixels, MISPLACED, evidence)
}

/// Anti-aliasing: compares the sizes of the same point in the photos.
pub fn antialias(set: &TrainingSet<'_>) -> Decision {
    let mut ratios = footprint_ratios(set);
    if ratios.is_empty() {
        let why = "no point is seen by three photos: footprints cannot be compared".to_owned();
        return Decision::plain(Effect::Antialias, false, why);
    }
    let (low, middle, high) = (quantile(&mut ratios, 0.05), quantile(&mut ratios, 0.5), quantile(&mut ratios, 0.95));
    let evidence = format!(
        "the size of a pixel at a point differs by a factor of up to {middle:.2} between photos (median of {}; \
         {low:.2} to {high:.2} for nine tenths of them)",
        counted(ratios.len(), "point")
    );
    Decision::by(Effect::Antialias, middle, FOOTPRINTS, evidence)
}

/// A note where anti-aliasing is off, as it is unless it is asked for, and the sizes of points differ much.
pub fn antialias_would_help(decisions: &[Decision]) -> Option<String> {
    let much = |d: &&Decision| d.name == Effect::Antialias && !d.on && d.measured > Some(MUCH * FOOTPRINTS);
    let times = decisions.iter().find(much)?.measured?;
    Some(format!(
        "the size of a pixel at a point differs by a factor of up to {times:.1} between photos: --antialias may help (some viewers do not read \
         its tag)"
    ))
}

/// For each point, the 95th over the 5th percentile of its footprints (depth over focal length).
fn footprint_ratios(set: &TrainingSet<'_>) -> Vec<f64> {
    let points: Vec<(DVec3, Option<&[u32]>)> = if set.scene.points.iter().any(|p| !p.track.is_empty()) {
        set.scene.points.iter().map(|p| (p.position, Some(p.track.as_slice()))).collect()
    } else {
        middle_of(set).into_iter().map(|p| (p, None)).collect()
    };
    let count = points.len().min(POINTS);
    let ratio = |k: usize| {
        let (position, track) = points[k * points.len() / count];
        let sees = |i: &usize| track.is_none_or(|t| t.binary_search(&(*i as u32)).is_ok());
        let views = set.train.iter().filter(|i| sees(i)).map(|i| &set.scene.views[*i]);
        let mut footprints: Vec<f64> = views.filter_map(|v| footprint(v, position)).collect();
        let enough = footprints.len() >= SEEN_BY.min(set.train.len()).max(2);
        enough.then(|| quantile(&mut footprints, 0.95) / quantile(&mut footprints, 0.05))
    };
    (0..count).into_par_iter().filter_map(ratio).filter(|r| r.is_finite()).collect()
}

/// World units that a pixel covers at a point's depth; `None` if the view does not show the point.
fn footprint(view: &View, position: DVec3) -> Option<f64> {
    let camera = &view.camera;
    camera.shows(position).then(|| camera.depth(position) / camera.focal.element_product().sqrt())
}

/// Substitute points for a scene without any: a ball around the point where the cameras look, whose radius is half
/// their distance (Blender scenes: the unit ball, inside the reference's cube).
fn middle_of(set: &TrainingSet<'_>) -> Vec<DVec3> {
    let cameras = || set.views().map(|v| &v.camera);
    let centre = set.scene.centre(set.train);
    let forward = cameras().map(|c| c.rotation.row(2)).sum::<DVec3>() / set.train.len().max(1) as f64;
    let blender = set.scene.kind == SceneKind::Blender;
    let spread = cameras().map(|c| c.centre().distance(centre)).fold(0.0, f64::max);
    let (middle, radius) = if blender { (DVec3::ZERO, 1.0) } else { (centre + forward * spread, 0.5 * spread) };
    let at = |k: usize| middle + direction(k, 256) * radius * ((k % 16) as f64 + 1.0) / 16.0;
    (0..256).map(at).collect()
}

/// Undistortion: measures how far lenses move pixels.
pub fn distortion(set: &TrainingSet<'_>) -> Decision {
    let mut known = HashSet::new();
    let lenses = set.views().map(|view| &view.lens).filter(|lens| known.insert(lens.key()));
    let moved = lenses.map(Lens::max_displacement).fold(0.0, f64::max);
    let undistorted = set.views().filter(|v| v.undistorts()).count();
    let cut = set.views().filter(|v| v.face.is_some()).count();
    let shown = match (undistorted, cut) {
        (n, 0) => format!("{} {} resampled once to a pinhole", counted(n, "photo"), if n == 1 { "is" } else { "are" }),
        (0, n) => {
            format!("the photos show more than a pinhole camera can, so they are cut into {}", counted(n, "view"))
        }
        (n, m) => format!("{} resampled once to a pinhole, {m} cut from wider photos", counted(n, "view")),
    };
    let evidence = match (moved, cut) {
        (0.0, 0) => "every lens is an ideal pinhole".to_owned(),
        (0.0, _) => shown,
        _ => format!("a lens moves some pixel by {moved:.2} px; {shown}"),
    };
    Decision::by(Effect::Distortion, moved, VISIBLE_DISPLACEMENT, evidence)
}

/// The number of photos in which a fourth byte of this meaning hides something, and the share of all pixels hidden.
fn hidden(set: &TrainingSet<'_>, by: AlphaRole) -> (usize, f64) {
    let (mut photos, mut missing, mut pixels) = (0, 0.0, 0_usize);
    for photo in set.photos {
        pixels += photo.pixels.len() / 4;
        if photo.alpha_role == by {
            let own: f64 = photo.pixels.iter().skip(3).step_by(4).map(|a| 1.0 - f64::from(*a) / 255.0).sum();
            photos += usize::from(own > 0.0);
            missing += own;
        }
    }
    (photos, missing / pixels.max(1) as f64)
}

/// Transparency: reads the photos' alpha.
pub fn transparency(set: &TrainingSet<'_>) -> Decision {
    let (photos, share) = hidden(set, AlphaRole::Alpha);
    let evidence = match photos {
        0 if set.views().any(View::hides_itself) && set.photos.iter().any(|p| p.alpha_role == AlphaRole::Mask) => {
            "what is transparent in faces of panoramas and wide fisheyes is masked".to_owned()
        }
        0 => format!("less than {} % of all pixels are transparent", 100.0 * ALPHA_SHARE),
        1 => format!("1 photo has transparent pixels, {:.1} % of all pixels", 100.0 * share),
        n => format!("{n} photos have transparent pixels, {:.1} % of all pixels", 100.0 * share),
    };
    let decision = Decision::plain(Effect::Transparency, photos > 0, evidence);
    Decision {
        near_threshold: is_near(share, ALPHA_SHARE),
        measured: Some(share),
        threshold: Some(ALPHA_SHARE),
        ..decision
    }
}

/// Masks: measures the share of pixels that they hide.
pub fn masks(set: &TrainingSet<'_>) -> Decision {
    let listed = set.views().filter(|v| v.is_masked()).count();
    let (photos, share) = hidden(set, AlphaRole::Mask);
    let evidence = match (listed, photos) {
        (0, _) => "no photo has a mask".to_owned(),
        (n, 0) => format!("masks of {}, which hide nothing or are not used", counted(n, "photo")),
        (n, _) => format!("masks of {}, which hide {:.1} % of all pixels", counted(n, "photo"), 100.0 * share),
    };
    let decision = Decision::plain(Effect::Masks, photos > 0, evidence);
    Decision { near_threshold: photos > 0 && share < FEW, measured: Some(share), threshold: Some(0.0), ..decision }
}

/// Several cameras: compares their intrinsics.
pub fn cameras(set: &TrainingSet<'_>) -> Decision {
    let kind = |view: &View| {
        let lens = &view.lens;
        let bits = |v: f64| v.to_bits();
        (
            lens.width,
            lens.height,
            bits(lens.focal.x),
            bits(lens.focal.y),
            bits(lens.principal.x),
            bits(lens.principal.y),
        )
    };
    let kinds: BTreeSet<_> = set.views().map(kind).collect();
    let sizes: BTreeSet<_> = kinds.iter().map(|k| (k.0, k.1)).collect();
    let list: Vec<_> = sizes.iter().take(4).map(|(w, h)| format!("{w}x{h}")).collect();
    let more = if sizes.len() > list.len() { ", ..." } else { "" };
    let evidence = match kinds.len() {
        0 => "no photo is trained on".to_owned(),
        1 => format!("one camera, {}", list.join("")),
        n => format!("{n} different intrinsics, sizes {}{more}", list.join(", ")),
    };
    Decision {
        measured: Some(kinds.len() as f64),
        threshold: Some(1.0),
        ..Decision::plain(Effect::Cameras, kinds.len() > 1, evidence)
    }
}
