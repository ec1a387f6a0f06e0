//! Contents of a scene: views, cameras, points, skipped parts, and the split.

use crate::pipeline::Error;
use crate::pipeline::effects;
use crate::scene::{EVAL_EVERY, OpenOptions, Scene, View};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The scene as one document; reads training photos to decide which effects they call for.
pub(super) fn describe(path: &Path, options: &OpenOptions) -> Result<Value, Error> {
    let scene = Scene::open(path, options)?;
    let mut sizes: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    let mut cameras: BTreeMap<u32, (&View, usize)> = BTreeMap::new();
    for view in &scene.views {
        *sizes.entry((view.lens.width, view.lens.height)).or_default() += 1;
        cameras.entry(view.camera_id).or_insert((view, 0)).1 += 1;
    }
    let alpha = scene.views.par_iter().filter(|v| v.announces_alpha()).count();
    let split = scene.split(EVAL_EVERY);
    let errors: Vec<f32> = scene.points.iter().map(|p| p.error).filter(|e| *e > 0.0).collect();
    let tracks: usize = scene.points.iter().map(|p| p.track.len()).sum();
    Ok(json!({
        "kind": "scene",
        "format": scene.kind,
        "source": scene.source,
        "views": scene.views.len(),
        "photos_present": scene.views.iter().filter(|v| v.photo_size.is_some()).count(),
        "photos_with_alpha": alpha,
        "masks": scene.views.iter().filter(|v| v.is_masked()).count(),
        "sizes": sizes.iter().map(|((w, h), n)| json!({ "size": format!("{w}x{h}"), "views": n })).collect::<Vec<_>>(),
        "cameras": cameras.iter().map(|(id, (view, views))| camera(*id, view, *views)).collect::<Vec<_>>(),
        "points": scene.points.len(),
        "mean_track_length": mean(tracks as f64, scene.points.len()),
        "mean_reprojection_px": mean(errors.iter().map(|e| f64::from(*e)).sum(), errors.len()),
        "extent": scene.extent(&split.train),
        "near_plane": scene.near,
        "origin": scene.origin.to_array(),
        "train_views": split.train.len(),
        "test_views": split.test.len(),
        "skipped": scene.skipped.summary(),
        "effects": effects::of_scene(&scene)?,
    }))
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
