//! Photos, cameras and poses that need a look, and advice on them.

use super::{Agreement, Change};
use crate::scene::{Misfit, Reading, Scene, median};
use crate::wording::counted;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Least misfit of a photo whose pose does not fit, in misfits of the middle photo.
const MISFIT: f64 = 4.0;
/// Largest share of a misfit that is left once its cause is removed.
const LEFT: f64 = 0.25;
/// Least share of a camera's photos that do not fit where the camera is at fault, and least number of its photos.
const OF_CAMERA: (f64, usize) = (0.8, 2);

/// A photo whose pose and lens were compared with the points.
#[derive(Clone, Copy)]
struct Measured<'a> {
    photo: &'a str,
    camera: u32,
    misfit: Misfit,
}

/// A change that would bring points to their places.
#[derive(Clone, Copy)]
pub(super) enum Cause {
    Read(Reading),
    /// Focal lengths times this.
    Focal(f64),
}

/// A camera that does not fit the points, and the number of its photos.
struct Unfit {
    camera: u32,
    photos: usize,
    middle: Misfit,
    cause: Option<(Cause, f64)>,
}

/// Photos, cameras and poses that need a look.
pub struct Doubts<'a> {
    /// The misfit of the middle photo.
    middle: Option<Misfit>,
    /// The common cause of the misfit of all photos, if they do not fit, with the misfit that is left without it, in
    /// pixels.
    cause: Option<(Cause, f64)>,
    /// Photos that do not fit the points, worst first.
    misfits: Vec<Measured<'a>>,
    /// Cameras of which nearly no photo fits.
    cameras: Vec<Unfit>,
    /// Numbers of photos that points connect, the largest group first.
    groups: Vec<usize>,
    /// Photos outside the largest group.
    apart: Vec<String>,
    agreement: Agreement,
}

impl<'a> Doubts<'a> {
    /// Compares the poses of a scene with its points; `agreement` tells of its photos.
    pub fn of(scene: &'a Scene, agreement: Agreement) -> Self {
        let mut fits: Vec<Measured<'a>> = Vec::new();
        for view in &scene.views {
            let photo = view.photo_name();
            if let Some(misfit) = view.misfit.filter(|_| fits.last().is_none_or(|last| last.photo != photo)) {
                fits.push(Measured { photo, camera: view.camera_id, misfit });
            }
        }
        fits.sort_by(|a, b| b.misfit.excess().total_cmp(&a.misfit.excess()));
        let middle = fits.get(fits.len() / 2).map(|fit| fit.misfit);
        let cause = middle.filter(|middle| middle.excess() > 1.0).and_then(|_| cause(&of_all(&fits)));
        let limit = middle.map_or(0.0, |middle| f64::max(1.0, MISFIT * middle.excess()));
        let alone = cause.is_none() && middle.is_some_and(|middle| !middle.behind);
        let misfits: Vec<Measured<'a>> =
            fits.iter().filter(|fit| alone && fit.misfit.excess() > limit).copied().collect();
        let cameras = unfit(&fits, limit, misfits.len());
        let groups = scene.overlap().unwrap_or_default();
        Self {
            middle,
            cause,
            misfits,
            cameras,
            groups: groups.iter().map(Vec::len).collect(),
            apart: groups.into_iter().skip(1).flatten().collect(),
            agreement,
        }
    }

    /// Photos that need a look.
    pub fn photos(&self) -> Vec<&str> {
        let doubted = self.agreement.doubted.iter().map(|(photo, _)| photo);
        let named = doubted.chain(&self.agreement.single_colour).chain(self.agreement.equal.iter().flatten());
        let named = named.chain(&self.apart).map(String::as_str);
        self.misfits.iter().map(|fit| fit.photo).chain(named).collect()
    }

    /// Fields of a JSON document.
    pub fn fields(&self) -> Value {
        let misfits = self.misfits.iter();
        let misfits = misfits.map(|m| json!({ "photo": m.photo, "px": m.misfit.px, "share": m.misfit.share() }));
        let doubted = self.agreement.doubted.iter();
        json!({
            "misfit_px": self.middle.map(|middle| middle.px),
            "misfit_share": self.middle.map(|middle| middle.share()),
            "misfits": misfits.collect::<Vec<_>>(),
            "misfit_cameras": self.cameras.iter().map(|unfit| unfit.camera).collect::<Vec<_>>(),
            "photo_groups": self.groups,
            "apart": self.apart,
            "agreement": self.agreement.usual,
            "disagreeing": doubted.map(|(photo, r)| json!({ "photo": photo, "agreement": r })).collect::<Vec<_>>(),
            "single_colour": self.agreement.single_colour,
            "equal_photos": self.agreement.equal,
            "copied_photos": self.agreement.copies,
        })
    }

    /// A line on each fault that was found, with a remedy.
    pub fn advice(&self) -> Vec<String> {
        let as_a_whole = self.whole();
        let photos = if as_a_whole.is_none() { self.disagreeing() } else { None };
        let mut said: Vec<String> = as_a_whole.into_iter().chain(self.cameras.iter().map(said_of)).collect();
        said.extend(self.misplaced());
        said.extend(photos);
        said.extend(self.unconnected());
        let single = &self.agreement.single_colour;
        let alike = counted(single.len(), "photo");
        said.extend((!single.is_empty()).then(|| format!("{alike} of a single colour: leave out ({})", few(single))));
        let alike = [
            (&self.agreement.equal, "with the same pixels under different poses: do their names fit?"),
            (&self.agreement.copies, "with the same pixels and pose, which flatter the scores: leave out all but one"),
        ];
        for (groups, what) in alike {
            let count: usize = groups.iter().map(Vec::len).sum();
            let names: Vec<String> = groups.iter().map(|group| group.join(" = ")).collect();
            said.extend((count > 0).then(|| format!("{count} photos {what} ({})", few(&names))));
        }
        said
    }

    /// A sentence on all photos together: that they do not fit the points, or do not show them.
    fn whole(&self) -> Option<String> {
        if let Some(middle) = self.middle.filter(|middle| middle.excess() > 1.0) {
            let off = if middle.behind {
                "most points lie behind the camera of the middle photo".to_owned()
            } else {
                format!("poses and points disagree by {} in the middle photo", distance(&middle))
            };
            let remedy = self.cause.map_or("do photos, cameras and points belong together?".to_owned(), remedy);
            return Some(format!("{off}: {remedy}"));
        }
        let now = self.agreement.usual;
        if let Some((change, then)) = self.agreement.change {
            let instead = now.map(|now| format!(" instead of {now:.2}")).unwrap_or_default();
            return Some(format!("{}: then photos agree by {then:.2} of 1{instead}", changed(change)));
        }
        now.filter(|_| self.agreement.lost).map(|now| {
            format!(
                "photos agree by {now:.2} of 1: do photos, poses and points belong together, in one world of the same axes, direction and \
                 scale?"
            )
        })
    }

    /// Photos that do not fit the points, though others of their camera do.
    fn misplaced(&self) -> Option<String> {
        let of_cameras = |fit: &&Measured<'_>| self.cameras.iter().any(|unfit| unfit.camera == fit.camera);
        let alone: Vec<&Measured<'_>> = self.misfits.iter().filter(|fit| !of_cameras(fit)).collect();
        let worst = alone.first()?;
        let names: Vec<&str> = alone.iter().map(|fit| fit.photo).collect();
        Some(format!(
            "{} with a pose that does not fit the points, by up to {}: leave them out, or pose again ({})",
            counted(names.len(), "photo"),
            distance(&worst.misfit),
            few(&names)
        ))
    }

    /// Photos that do not show the points, though their poses fit.
    fn disagreeing(&self) -> Option<String> {
        let misplaced = |photo: &String| self.misfits.iter().any(|fit| fit.photo == photo);
        let doubted = self.agreement.doubted.iter().map(|(photo, _)| photo).filter(|photo| !misplaced(photo));
        let names: Vec<&str> = doubted.map(String::as_str).collect();
        let shows = match names.len() {
            0 => return None,
            1 => "1 photo that does not look like the points seen from its pose".to_owned(),
            n => format!("{n} photos that do not look like the points seen from their poses"),
        };
        Some(format!("{shows}: names swapped, or from another scene? ({})", few(&names)))
    }

    /// Photos that share no point with the others.
    fn unconnected(&self) -> Option<String> {
        let most = *self.groups.first().filter(|_| !self.apart.is_empty())?;
        if most == 1 {
            return Some("no two photos share a point: take photos that overlap, or pose them again".to_owned());
        }
        Some(format!(
            "{} without a point that others of the {most} see: take photos between them, or leave them out ({})",
            counted(self.apart.len(), "photo"),
            few(&self.apart)
        ))
    }
}

fn of_all(fits: &[Measured<'_>]) -> Vec<Misfit> {
    fits.iter().map(|fit| fit.misfit).collect()
}

/// The change that removes most of the photos' misfit, if any does, with the misfit that is left in pixels: medians
/// over the photos.
pub(super) fn cause(fits: &[Misfit]) -> Option<(Cause, f64)> {
    let middle = |of: &dyn Fn(&Misfit) -> f64| median(&mut fits.iter().map(of).collect::<Vec<_>>());
    let most = LEFT * middle(&|misfit| misfit.px)?;
    let mut causes = Vec::new();
    for (k, reading) in Reading::ALL.into_iter().enumerate() {
        causes.push((Cause::Read(reading), middle(&|misfit| misfit.reread[k])?));
    }
    causes.push((Cause::Focal(middle(&|misfit| misfit.zoomed.0)?), middle(&|misfit| misfit.zoomed.1)?));
    causes.into_iter().filter(|(_, left)| *left <= most).min_by(|(_, a), (_, b)| a.total_cmp(b))
}

/// The cameras, of several, of which nearly all photos have a misfit above the limit; `count` photos have.
fn unfit(fits: &[Measured<'_>], limit: f64, count: usize) -> Vec<Unfit> {
    let mut by_camera: BTreeMap<u32, Vec<Measured<'_>>> = BTreeMap::new();
    for fit in fits {
        by_camera.entry(fit.camera).or_default().push(*fit);
    }
    if by_camera.len() < 2 || count == 0 {
        return Vec::new();
    }
    let of = |(camera, own): (u32, Vec<Measured<'_>>)| {
        let off: Vec<Measured<'_>> = own.iter().filter(|fit| fit.misfit.excess() > limit).copied().collect();
        let many = off.len() >= OF_CAMERA.1 && off.len() as f64 >= OF_CAMERA.0 * own.len() as f64;
        let cause = cause(&of_all(&off)).filter(|(cause, _)| matches!(cause, Cause::Focal(_)));
        many.then(|| Unfit { camera, photos: own.len(), middle: off[off.len() / 2].misfit, cause })
    };
    by_camera.into_iter().filter_map(of).collect()
}

/// Advice on a camera.
fn said_of(unfit: &Unfit) -> String {
    let Unfit { camera, photos, middle, cause } = unfit;
    let remedy = cause.map_or("check its model, focal length and principal point".to_owned(), remedy);
    let photos = counted(*photos, "photo");
    format!(
        "the intrinsics of camera {camera} do not fit its {photos}, which are off by {}: {remedy}",
        distance(middle)
    )
}

/// Advice on removing a cause, with the misfit that is left then, in pixels.
fn remedy((cause, left): (Cause, f64)) -> String {
    match cause {
        Cause::Read(Reading::CameraToWorld) => {
            format!(
                "inverted, the poses fit to {left:.1} px: write them from world to camera, not from camera to world"
            )
        }
        Cause::Read(Reading::OpenGl) => {
            format!(
                "with the cameras' y and z flipped, the poses fit to {left:.1} px: they have OpenGL's axes, not COLMAP's"
            )
        }
        Cause::Read(Reading::ScalarLast) => {
            format!(
                "with quaternions in the order x y z w, the poses fit to {left:.1} px: write them in the order w x y z"
            )
        }
        Cause::Focal(factor) => format!("with focal lengths {factor:.3} times as long, they fit to {left:.1} px"),
    }
}

/// A clause that says with which change the photos show the points.
fn changed(change: Change) -> &'static str {
    match change {
        Change::Read(Reading::CameraToWorld) => "the poses seem to be inverted (camera to world, or world to camera)",
        Change::Read(Reading::OpenGl) => "the cameras' y and z axes seem to be flipped",
        Change::Read(Reading::ScalarLast) => {
            "the poses' quaternions seem to be in the order x y z w (write them in the order w x y z)"
        }
        Change::Mirrored => "the photos seem to be mirrored, left to right (give the photos that were posed)",
        Change::Turned => "the photos seem to be turned by 180° (give the photos that were posed)",
        Change::Next => "the names seem to be off by one (each photo shows what the pose before its own sees)",
        Change::Previous => "the names seem to be off by one (each photo shows what the pose after its own sees)",
    }
}

/// A misfit in pixels, and as a share of the picture.
fn distance(misfit: &Misfit) -> String {
    format!("{:.1} px ({:.2} % of the picture's diagonal)", misfit.px, 100.0 * misfit.share())
}

/// The first five names.
fn few<S: AsRef<str>>(names: &[S]) -> String {
    let more = if names.len() > 5 { ", ..." } else { "" };
    let first: Vec<&str> = names.iter().take(5).map(AsRef::as_ref).collect();
    format!("{}{more}", first.join(", "))
}
