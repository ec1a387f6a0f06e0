//! Contents of a scene: views, cameras, points, skipped parts, and the split.

use crate::effects::Doubts;
use crate::job::{Error, Output};
use crate::pipeline::effects;
use crate::pipeline::prepare::refuse_photo_folders;
use crate::report::format::count;
use crate::scene::{EVAL_EVERY, OpenOptions, Scene, View};
use crate::view::alone::{self, PageOptions};
use crate::view::capture;
use crate::wording::counted;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A page with the scene's points and cameras: training cameras are blue, held-out cameras orange, suspect ones red.
fn page(scene: &Scene, test: &[usize], doubts: &Doubts<'_>, file: &Path) -> Result<(), Error> {
    let model = capture::model(scene, test, &doubts.photos());
    let title = format!("{}: points and cameras", scene.root.file_name().unwrap_or_default().to_string_lossy());
    let facts = format!(
        "{} points, {}: blue trained on, orange held out, red suspect",
        count(scene.points.len()),
        counted(scene.views.len(), "camera")
    );
    let (up, near) = (scene.up(), Some(scene.near));
    let options = PageOptions { title, up, near, facts: Some(facts), ..PageOptions::default() };
    let page = alone::page(&model, &options, file).map_err(Error::writing)?;
    Output::text(file, &page)
}

/// A note on photos with an EXIF rotation.
fn rotated(scene: &Scene) -> Option<String> {
    let mut photos: Vec<&View> = scene.views.iter().collect();
    photos.dedup_by(|a, b| a.image == b.image);
    let count = photos.par_iter().filter(|photo| photo.has_exif_rotation()).count();
    let photos = counted(count, "photo");
    (count > 0).then(|| {
        format!(
            "{photos} with an EXIF rotation, which is ignored, as in COLMAP: poses must be those of the stored pixels"
        )
    })
}

/// A note on photos whose colours are not those of sRGB.
fn coloured_otherwise(scene: &Scene) -> Option<String> {
    let mut photos: Vec<&View> = scene.views.iter().collect();
    photos.dedup_by(|a, b| a.image == b.image);
    let profiles: Vec<String> = photos.par_iter().filter_map(|photo| photo.foreign_profile()).collect();
    let names = Vec::from_iter(profiles.iter().map(String::as_str).collect::<BTreeSet<&str>>());
    (!profiles.is_empty()).then(|| {
        format!(
            "{} with a colour profile other than sRGB ({}), whose colours are used as stored, as if they were sRGB; to convert copies: \
             `magick mogrify -profile sRGB.icc *.jpg`",
            counted(profiles.len(), "photo"),
            names.join(", ")
        )
    })
}

/// The scene as one document, and as a page if `html` names one; reads training photos to decide which effects they call for. Also
/// returns the scene with the views whose photos are there, if there are any.
pub(super) fn describe(
    path: &Path,
    options: &OpenOptions,
    html: Option<&Path>,
) -> Result<(Value, Option<Scene>), Error> {
    let scene = Scene::open(path, options)?;
    let mut sizes: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    let mut cameras: BTreeMap<u32, (&View, usize)> = BTreeMap::new();
    for view in &scene.views {
        *sizes.entry((view.lens.width, view.lens.height)).or_default() += 1;
        cameras.entry(view.camera_id).or_insert((view, 0)).1 += 1;
    }
    let alpha = scene.views.par_iter().filter(|v| v.announces_alpha()).count();
    // As a run holds photos out, which then are all there.
    let mut present = scene.clone();
    let has_photos = present.has_photos();
    if has_photos {
        present.require_photos()?;
    }
    let held = present.split(EVAL_EVERY);
    let held_out: BTreeSet<&str> = held.test.iter().map(|i| present.views[*i].name.as_str()).collect();
    let test: Vec<usize> =
        (0..scene.views.len()).filter(|i| held_out.contains(scene.views[*i].name.as_str())).collect();
    let errors: Vec<f32> = scene.points.iter().map(|p| p.error).filter(|e| *e > 0.0).collect();
    if let Some(file) = html {
        refuse_photo_folders(&scene, [file.to_owned()].iter())?;
    }
    let (decisions, skipped, agreement) = effects::examine(&scene)?;
    let doubts = Doubts::of(&scene, agreement);
    if let Some(file) = html {
        page(&scene, &test, &doubts, file)?;
    }
    let photos: BTreeSet<&str> = scene.views.iter().map(View::photo_name).collect();
    let unread = skipped.missing_images.count + skipped.damaged_images.count + skipped.unread_images.count;
    let tracks: usize = scene.points.iter().map(|p| p.track.len()).sum();
    let facts = json!({
        "kind": "scene",
        "format": scene.kind,
        "source": scene.source.to_string_lossy(),
        "views": scene.views.len(),
        "photos_present": photos.len().saturating_sub(unread),
        "photos_with_alpha": alpha,
        "masks": scene.views.iter().filter(|v| v.is_masked()).count(),
        "depth_maps": scene.views.iter().filter(|v| v.depth.is_some()).count(),
        "sizes": sizes.iter().map(|((w, h), n)| json!({ "size": format!("{w}x{h}"), "views": n })).collect::<Vec<_>>(),
        "cameras": cameras.iter().map(|(id, (view, views))| camera(*id, view, *views)).collect::<Vec<_>>(),
        "points": scene.points.len(),
        "mean_track_length": mean(tracks as f64, scene.points.len()),
        "mean_reprojection_px": mean(errors.iter().map(|e| f64::from(*e)).sum(), errors.len()),
    });
    let decided = json!({
        "extent": present.extent(&held.train),
        "near_plane": scene.near,
        "origin": scene.origin.to_array(),
        "train_views": held.train.len(),
        "test_views": held.test.len(),
        "skipped": skipped.summary(),
        "advice": doubts.advice().into_iter().chain(scene.lacks_points()).chain(rotated(&scene))
            .chain(coloured_otherwise(&scene)).collect::<Vec<_>>(),
        "effects": decisions,
    });
    Ok((joined([facts, doubts.fields(), decided]), has_photos.then_some(present)))
}

/// One document with the fields of several, in their order.
fn joined(documents: [Value; 3]) -> Value {
    let fields = documents.into_iter().filter_map(|document| match document {
        Value::Object(fields) => Some(fields),
        _ => None,
    });
    Value::Object(fields.flatten().collect())
}

fn camera(id: u32, view: &View, views: usize) -> Value {
    let lens = &view.lens;
    let moved = lens.max_displacement();
    json!({
        "id": id,
        "views": views,
        "lens": lens.model.name(),
        "size": format!("{}x{}", lens.width, lens.height),
        "focal": [lens.focal.x, lens.focal.y],
        // JSON has no infinite number.
        "distortion_px": if moved.is_finite() { json!(moved) } else { json!("infinite") },
        "undistorted": view.undistorts(),
    })
}

fn mean(sum: f64, count: usize) -> Value {
    if count == 0 { Value::Null } else { json!(sum / count as f64) }
}
