//! A capture as a model to look at: its points, and a pyramid of lines for each camera.

use crate::gaussians::Gaussians;
use crate::sample::evenly;
use crate::scene::camera::Camera;
use crate::scene::{Point, Scene};
use crate::train::initialise::{Seed, from_points};
use glam::{DQuat, DVec2, DVec3};
use std::collections::HashSet;

/// Half the width of the picture's scene, in its own units: the cameras' extent.
const EXTENT: f64 = 10.0;
/// Most points shown; more are thinned evenly.
const POINTS: usize = 200_000;
/// Distance from the cameras' middle from which on points are left out, in extents.
const FAR: f64 = 30.0;
/// Largest size of a point, and depth of a camera's pyramid, in extents.
const POINT: f64 = 0.01;
const PYRAMID: f64 = 0.06;
/// Thickness of a line, as a share of its length.
const THICKNESS: f64 = 0.02;
/// Opacity of everything, before the logistic function.
const OPACITY: f32 = 3.0;

/// Colours of cameras: trained on, held out, of a photo that needs a look.
const COLOURS: [[f64; 3]; 3] = [[0.3, 0.6, 1.0], [1.0, 0.65, 0.1], [1.0, 0.15, 0.15]];

/// The model of a scene: its points in their colours; cameras blue, held-out ones orange, those of `marked` photos red.
pub fn model(scene: &Scene, test: &[usize], marked: &[&str]) -> Gaussians {
    let all: Vec<usize> = (0..scene.views.len()).collect();
    let (centre, extent) = (scene.centre(&all), scene.extent(&all));
    let extent = if extent > 0.0 { extent } else { 1.0 };
    let place = |p: DVec3| (p - centre) * (EXTENT / extent);
    let near: Vec<&Point> = scene.points.iter().filter(|point| place(point.position).length() < FAR * EXTENT).collect();
    let thinned = evenly(&near, POINTS);
    let seeds: Vec<Seed> =
        thinned.map(|point| Seed { position: place(point.position), normal: None, ..Seed::from(*point) }).collect();
    let mut model = from_points(&seeds);
    let most = (POINT * EXTENT).ln() as f32;
    model.log_scales.iter_mut().flatten().for_each(|scale| *scale = scale.min(most));
    let mut lines = Vec::new();
    let (test, marked): (HashSet<usize>, HashSet<&str>) =
        (test.iter().copied().collect(), marked.iter().copied().collect());
    for (v, view) in scene.views.iter().enumerate() {
        let kind = if marked.contains(&view.photo_name()) { 2 } else { usize::from(test.contains(&v)) };
        let corners = pyramid(&view.camera, PYRAMID * extent).map(place);
        let eye = corners[0];
        for k in 1..5 {
            lines.push((eye, corners[k], COLOURS[kind]));
            lines.push((corners[k], corners[k % 4 + 1], COLOURS[kind]));
        }
    }
    let middle = |(a, b, colour): &(DVec3, DVec3, [f64; 3])| Seed {
        position: 0.5 * (*a + *b),
        normal: None,
        colour: DVec3::from(*colour),
    };
    let seeds: Vec<Seed> = lines.iter().map(middle).collect();
    let mut drawn = from_points(&seeds);
    for (i, (a, b, _)) in lines.iter().enumerate() {
        let along = *b - *a;
        let turn = DQuat::from_rotation_arc(DVec3::X, along.normalize_or(DVec3::X));
        drawn.rotations[i] = [turn.w, turn.x, turn.y, turn.z].map(|v| v as f32);
        let length = along.length().max(1e-6);
        drawn.log_scales[i] = [length / 3.0, length * THICKNESS, length * THICKNESS].map(|v| v.ln() as f32);
    }
    model.append(&drawn);
    model.opacity_logits.fill(OPACITY);
    model
}

/// The camera's centre, and the corners of its picture at a depth, in world units.
fn pyramid(camera: &Camera, depth: f64) -> [DVec3; 5] {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let corner =
        |x: f64, y: f64| camera.rotation.transpose() * (camera.ray(DVec2::new(x, y)) * depth - camera.translation);
    [camera.centre(), corner(0.0, 0.0), corner(w, 0.0), corner(w, h), corner(0.0, h)]
}
