//! Where training begins: Gaussians on reconstructed points, or on random points where several cameras look.

use super::photos::TrainView;
use crate::gaussians::Gaussians;
use crate::random::uniform;
use crate::scene::camera::Camera;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

/// SH band 0's basis function.
const SH_C0: f64 = 0.28209479177387814;
/// Opacity of every Gaussian at the start.
const OPACITY: f64 = 0.1;
/// Floor of the mean squared distance to the nearest neighbours, in square world units.
const LEAST_SQUARED_DISTANCE: f64 = 1e-7;
/// Depths tried along a random ray; the one whose photos agree best stays.
const DEPTHS: u64 = 12;
/// A random point must lie within this many views (or all, where there are fewer).
const SEEN_BY: usize = 3;
/// Views that a random point's colour is compared in.
const COMPARED: usize = 8;
/// Half the side of the cube that Blender scenes lie in (the reference's).
const BLENDER_CUBE: f64 = 1.3;

/// A point with a colour in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    /// World coordinates.
    pub position: DVec3,
    /// Red, green, blue.
    pub colour: DVec3,
}

/// Gaussians on points: round, as large as their three nearest neighbours are far, of opacity 0.1, SH degree 0.
pub fn from_points(points: &[Seed]) -> Gaussians {
    let entry = |(i, p): (usize, &Seed)| GeomWithData::new(p.position.to_array(), i);
    // The tree has no order for a NaN; such a Gaussian is left to density control.
    let finite = |p: &Seed| p.position.is_finite();
    let tree = RTree::bulk_load(points.iter().enumerate().filter(|(_, p)| finite(p)).map(entry).collect());
    let log_scale = |i: usize, p: &Seed| -> f32 {
        if !finite(p) {
            return 0.5 * (LEAST_SQUARED_DISTANCE as f32).ln();
        }
        let near = tree.nearest_neighbor_iter_with_distance_2(p.position.to_array());
        let (sum, n) = near.filter(|(e, _)| e.data != i).take(3).fold((0.0, 0), |(s, n), (_, d)| (s + d, n + 1));
        // A point alone has no neighbour to be sized by.
        let mean = if n == 0 { 1e-4 } else { sum / f64::from(n) };
        (0.5 * mean.max(LEAST_SQUARED_DISTANCE).ln()) as f32
    };
    let logit = (OPACITY / (1.0 - OPACITY)).ln() as f32;
    Gaussians {
        means: points.iter().map(|p| p.position.as_vec3().to_array()).collect(),
        log_scales: points.par_iter().enumerate().map(|(i, p)| [log_scale(i, p); 3]).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; points.len()],
        opacity_logits: vec![logit; points.len()],
        sh: vec![points.iter().flat_map(|p| ((p.colour - 0.5) / SH_C0).as_vec3().to_array()).collect()],
    }
}

/// Random points for a scene without any: along rays through random pixels, between a fifth and three times the distance
/// at which the cameras' axes meet, where at least three cameras see them. Of `DEPTHS` depths tried on a ray the one
/// whose photos agree best on its colour stays: a plane sweep of random planes, which costs a second and starts training
/// near the surfaces. Blender scenes: within their cube.
pub fn random(views: &[TrainView], count: usize, blender: bool, seed: u64) -> Vec<Seed> {
    if views.is_empty() {
        return Vec::new();
    }
    let focus = focus(views.iter().map(|v| &v.camera));
    (0..count as u64).into_par_iter().filter_map(|i| on_ray(views, focus, blender, &[seed, 0x696e_6974, i])).collect()
}

fn on_ray(views: &[TrainView], focus: DVec3, blender: bool, key: &[u64]) -> Option<Seed> {
    let draw = |n: u64| uniform(&[key[0], key[1], key[2], n]);
    let view = &views[(draw(0) * views.len() as f64) as usize];
    let camera = &view.camera;
    let pixel = DVec2::new(draw(1) * f64::from(camera.width), draw(2) * f64::from(camera.height));
    let ray = ((pixel - camera.principal) / camera.focal).extend(1.0);
    let distance = (camera.rotation * focus + camera.translation).z.max(1e-3);
    let mut best: Option<(f64, Seed)> = None;
    for n in 0..DEPTHS {
        let depth = distance * (0.2_f64.ln() + draw(3 + n) * (3.0_f64 / 0.2).ln()).exp();
        let position = camera.rotation.transpose() * (ray * depth - camera.translation);
        if blender && position.abs().max_element() > BLENDER_CUBE {
            continue;
        }
        let Some((disagreement, colour)) = agreement(views, position, key) else { continue };
        if best.as_ref().is_none_or(|(least, _)| disagreement < *least) {
            best = Some((disagreement, Seed { position, colour }));
        }
    }
    best.map(|(_, seed)| seed)
}

/// (variance of the colours, mean colour) of a point in the photos that see it; none where too few do.
fn agreement(views: &[TrainView], position: DVec3, key: &[u64]) -> Option<(f64, DVec3)> {
    let start = (uniform(&[key[0], key[1], key[2], 999]) * views.len() as f64) as usize;
    let (mut n, mut sum, mut squares) = (0_usize, DVec3::ZERO, 0.0);
    for k in 0..views.len() {
        let view = &views[(start + k) % views.len()];
        let Some(colour) = project(&view.camera, position).map(|at| view.colour(at)) else { continue };
        n += 1;
        sum += colour;
        squares += colour.length_squared();
        if n == COMPARED {
            break;
        }
    }
    if n < SEEN_BY.min(views.len()) {
        return None;
    }
    let mean = sum / n as f64;
    Some((squares / n as f64 - mean.length_squared(), mean))
}

/// Pixel that a world point falls on, where it lies inside the picture.
fn project(camera: &Camera, position: DVec3) -> Option<[u32; 2]> {
    let p = camera.rotation * position + camera.translation;
    if p.z < 1e-3 {
        return None;
    }
    let at = p.truncate() / p.z * camera.focal + camera.principal;
    let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(camera.width) && at.y < f64::from(camera.height);
    inside.then_some([at.x as u32, at.y as u32])
}

/// The point nearest to all cameras' axes; the cameras' centre, moved along their mean view, where the axes are parallel.
fn focus<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone) -> DVec3 {
    let (mut a, mut b, mut centre, mut forward, mut n) = (DMat3::ZERO, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, 0.0);
    for camera in cameras.clone() {
        let axis = camera.rotation.row(2);
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        a += across;
        b += across * camera.centre();
        centre += camera.centre();
        forward += axis;
        n += 1.0;
    }
    centre /= n;
    let spread = cameras.clone().map(|c| c.centre().distance(centre)).fold(0.0, f64::max).max(1e-3);
    let met = if a.determinant() > 1e-6 * n { a.inverse() * b } else { centre + forward.normalize_or_zero() * spread };
    let in_front = cameras.filter(|c| (c.rotation * met + c.translation).z > 0.0).count();
    // Cameras that look outward meet behind themselves.
    if in_front as f64 > 0.5 * n { met } else { centre + forward.normalize_or_zero() * spread }
}
