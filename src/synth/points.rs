//! Surface points and the photos that see them, as structure from motion would find them, but without its errors.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::{
    Effect, Kind, SynthOptions, materials,
    path::View,
    place::Place,
    random::{Random, Stream},
    shade::{Thing, World},
};

/// Share of the candidates on floor and sky that are kept: most points belong on the objects.
const KEEP_PLAZA: f64 = 0.55;
const KEEP_MEADOW: f64 = 0.25;
const KEEP_SKY: f64 = 0.3;
/// Distance in pixels within which a view must show the same thing around a point.
const CLEARANCE: f64 = 0.75;

/// A point of a visible surface.
pub(super) struct Candidate {
    pub position: DVec3,
    /// Views that see it, in ascending order, each with the point's pixel.
    pub seen: Vec<(usize, DVec2)>,
}

/// Surface points, each seen by at least two views (or by the only one).
pub(super) fn candidates(place: &Place, views: &[View], options: &SynthOptions) -> Vec<Candidate> {
    let mut found = Vec::new();
    // A fixed number of rounds: if cameras see little, there are fewer points.
    for round in 0..8 {
        let missing = options.points - found.len();
        if missing == 0 {
            break;
        }
        // 1.5 times the missing number: some are seen by one view only.
        let tries = (missing + missing / 2 + 64) as u64;
        let first = round << 32;
        let more: Vec<_> =
            (first..first + tries).into_par_iter().filter_map(|i| candidate(place, views, options, i)).collect();
        found.extend(more.into_iter().take(missing));
    }
    found
}

fn candidate(place: &Place, views: &[View], options: &SynthOptions, i: u64) -> Option<Candidate> {
    let mut random = Random::new(options.seed, Stream::Points, i);
    let view = &views[(random.bits() % views.len() as u64) as usize];
    let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
    let ray = view.ray(DVec2::new(random.unit(), random.unit()) * size);
    let (t, thing) = World { place, mover: &view.mover }.hit(&ray);
    let share = match thing {
        Thing::Mover(_) => 0.0,
        Thing::Floor | Thing::Sky if options.has(Effect::Alpha) => 0.0,
        Thing::Floor if options.kind == Kind::Terrain => KEEP_PLAZA,
        Thing::Floor if ray.at(t).truncate().length() < materials::PLAZA => KEEP_PLAZA,
        Thing::Floor => KEEP_MEADOW,
        Thing::Sky => KEEP_SKY,
        Thing::Solid(_) => 1.0,
    };
    if random.unit() >= share {
        return None;
    }
    let p = ray.at(t);
    let seen: Vec<_> =
        views.iter().enumerate().filter_map(|(i, view)| Some((i, sees(place, view, p, thing)?))).collect();
    (seen.len() >= 2.min(views.len())).then(|| Candidate { position: p.as_dvec3(), seen })
}

/// The pixel at which a view sees the point `p` of a thing; none if something hides it or it lies at the thing's edge.
fn sees(place: &Place, view: &View, p: Vec3, thing: Thing) -> Option<DVec2> {
    let pixel = view.project(p.as_dvec3())?;
    let world = World { place, mover: &view.mover };
    let ray = view.ray(pixel);
    let (t, first) = world.hit(&ray);
    let far = p.distance(ray.origin);
    if first != thing || (t - far).abs() > 0.003 * far {
        return None;
    }
    let normal = world.normal(thing, p);
    if thing != Thing::Sky && -normal.dot(ray.direction) < 0.08 {
        return None;
    }
    let thin = matches!(thing, Thing::Solid(i) if place.surfaces[i as usize].thin);
    let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
    let clear = |(x, y): (f64, f64)| world.hit(&view.ray(pixel + DVec2::new(x, y) * CLEARANCE)).1 == thing;
    (thin || corners.into_iter().all(clear)).then_some(pixel)
}
