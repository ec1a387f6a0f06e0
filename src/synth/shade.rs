//! Shading: the light along a ray.

use glam::Vec3;

use super::{
    Kind,
    geometry::{Ray, Solid},
    materials::{self, Gloss, Paint},
    place::Place,
    sky, terrain,
};

/// Sunlight on a surface that faces it.
const SUN: Vec3 = Vec3::new(2.1, 1.9, 1.55);
/// Radius of the sun's disc as seen from the ground, in radians: larger than the real one, for soft shadows.
const SUN_RADIUS: f32 = 0.03;
/// Points on the sun's disc: cells along a side of a square grid, and points along a side of a cell.
const SUN_CELLS: usize = 4;
const SUN_PLACES: usize = 4;
/// Number of solids above which the hierarchy is faster than a list.
const SHORT_LIST: usize = 8;
/// Distance from a surface at which secondary rays start, in metres.
const LIFT: f32 = 1e-3;

/// The first thing along a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Thing {
    /// Index among the place's solids.
    Solid(u32),
    /// Index among the moving object's solids.
    Mover(u32),
    Floor,
    Sky,
}

/// The place with the moving object of one photo.
pub(super) struct World<'a> {
    pub place: &'a Place,
    pub mover: &'a [(Solid, Paint)],
}

/// Unit vectors to points spread evenly over the sun's disc.
pub(super) struct Sun {
    towards: Vec<Vec3>,
}

impl Sun {
    pub fn new() -> Self {
        let (across, along) = sky::sun().any_orthonormal_pair();
        let side = SUN_CELLS * SUN_PLACES;
        let place = |i: usize| {
            let (cell, within) = (i / (SUN_PLACES * SUN_PLACES), i % (SUN_PLACES * SUN_PLACES));
            let x = cell % SUN_CELLS * SUN_PLACES + within % SUN_PLACES;
            let y = cell / SUN_CELLS * SUN_PLACES + within / SUN_PLACES;
            let radius = SUN_RADIUS * ((x as f32 + 0.5) / side as f32).sqrt();
            let (sin, cos) = ((y as f32 + 0.5) / side as f32 * std::f32::consts::TAU).sin_cos();
            (sky::sun() + across * (radius * cos) + along * (radius * sin)).normalize()
        };
        Self { towards: (0..side * side).map(place).collect() }
    }

    /// The vector for one of the 16 cells; random `bits` choose the point within it.
    pub fn towards(&self, cell: usize, bits: u64) -> Vec3 {
        let places = SUN_PLACES * SUN_PLACES;
        self.towards[(cell * places + bits as usize % places) % self.towards.len()]
    }
}

/// The openness of the last surface: neighbouring samples share it, as it varies slowly.
#[derive(Default)]
pub(super) struct Openness {
    last: Option<(Thing, Vec3, f32)>,
}

/// The result of one sample.
pub(super) struct Sample {
    /// Linear radiance.
    pub colour: Vec3,
    pub thing: Thing,
    /// True if the moving object contributed to the colour, by itself, its shadow or its reflection.
    pub moved: bool,
}

impl World<'_> {
    /// The first thing along a ray and its distance.
    pub fn hit(&self, ray: &Ray) -> (f32, Thing) {
        self.hit_by(ray, |limit| self.place.bvh.first(&self.place.solids, ray, limit))
    }

    /// [`World::hit`] for a ray that can hit only the solids of a list.
    fn hit_listed(&self, ray: &Ray, list: &[u32]) -> (f32, Thing) {
        if list.len() > SHORT_LIST {
            return self.hit(ray);
        }
        self.hit_by(ray, |limit| {
            let mut first = None;
            for &i in list {
                if let Some(t) = self.place.solids[i as usize].hit(ray)
                    && t < first.map_or(limit, |(t, _)| t)
                {
                    first = Some((t, i));
                }
            }
            first
        })
    }

    fn hit_by(&self, ray: &Ray, solid: impl FnOnce(f32) -> Option<(f32, u32)>) -> (f32, Thing) {
        let (mut limit, mut thing) = (sky::hit_dome(ray, self.place.ground.dome), Thing::Sky);
        if ray.direction.z < 0.0 {
            let t = -ray.origin.z / ray.direction.z;
            if t > 0.0 && t < limit {
                (limit, thing) = (t, Thing::Floor);
            }
        }
        if let Some((t, i)) = solid(limit) {
            (limit, thing) = (t, Thing::Solid(i));
        }
        for (i, (solid, _)) in self.mover.iter().enumerate() {
            if let Some(t) = solid.hit(ray)
                && t < limit
            {
                (limit, thing) = (t, Thing::Mover(i as u32));
            }
        }
        (limit, thing)
    }

    /// Outward unit normal of a thing at a point; the sky has none and gives zero.
    pub fn normal(&self, thing: Thing, p: Vec3) -> Vec3 {
        match thing {
            Thing::Solid(i) => self.place.solids[i as usize].normal(p),
            Thing::Mover(i) => self.mover[i as usize].0.normal(p),
            Thing::Floor => Vec3::Z,
            Thing::Sky => Vec3::ZERO,
        }
    }

    /// The colour along a ray, for one point on the sun's disc; `open` is kept between the samples of a pixel.
    /// `list` names all solids that the ray may hit.
    pub fn trace(&self, ray: &Ray, list: &[u32], towards: Vec3, open: &mut Openness) -> Sample {
        let (t, thing) = self.hit_listed(ray, list);
        let p = ray.at(t);
        if thing == Thing::Sky {
            return Sample { colour: sky::radiance(p / self.place.ground.dome), thing, moved: false };
        }
        let normal = self.normal(thing, p);
        let (sun, blocked_by_mover) = self.sunlight(p, normal, towards);
        let mut moved = blocked_by_mover || matches!(thing, Thing::Mover(_));
        let open = match open.last {
            Some((last, n, value)) if last == thing && n.dot(normal) > 0.95 => value,
            _ => {
                let value = self.openness(p, normal);
                open.last = Some((thing, normal, value));
                value
            }
        };
        let mut colour = self.matte(thing, p, normal, sun, open);
        if let Some(gloss) = self.gloss(thing) {
            let facing = -ray.direction.dot(normal);
            let fresnel = gloss.f0 + (1.0 - gloss.f0) * (1.0 - facing).clamp(0.0, 1.0).powi(5);
            let mirrored = Ray { origin: p + normal * LIFT, direction: ray.direction + normal * (2.0 * facing) };
            let (reflection, seen) = self.reflection(&mirrored, towards);
            moved |= seen;
            let half = (sky::sun() - ray.direction).normalize_or(normal);
            let lobe = (gloss.shininess + 8.0) / 25.0 * normal.dot(half).max(0.0).powf(gloss.shininess);
            colour = colour * (1.0 - fresnel) + reflection * fresnel + SUN * (sun * lobe * fresnel);
        }
        Sample { colour, thing, moved }
    }

    /// The light that a mirror reflects; mirrors in mirrors are matte.
    fn reflection(&self, ray: &Ray, towards: Vec3) -> (Vec3, bool) {
        let (t, thing) = self.hit(ray);
        let p = ray.at(t);
        if thing == Thing::Sky {
            // The highlight accounts for the sun's disc.
            return (sky::radiance(p / self.place.ground.dome).min(Vec3::splat(1.6)), false);
        }
        let normal = self.normal(thing, p);
        let (sun, blocked_by_mover) = self.sunlight(p, normal, towards);
        (
            self.matte(thing, p, normal, sun, self.openness(p, normal)),
            blocked_by_mover || matches!(thing, Thing::Mover(_)),
        )
    }

    /// Light that a surface scatters evenly; `sun` is the sunlight that falls on it, `open` its share of the sky.
    fn matte(&self, thing: Thing, p: Vec3, normal: Vec3, sun: f32, open: f32) -> Vec3 {
        let painted = |solid: &Solid, paint: Paint| {
            let local_normal = match solid {
                Solid::Block { axes, .. } => axes.transpose() * normal,
                _ => normal,
            };
            paint.albedo(solid.local(p), local_normal)
        };
        let albedo = match thing {
            Thing::Solid(i) => painted(&self.place.solids[i as usize], self.place.surfaces[i as usize].paint),
            Thing::Mover(i) => painted(&self.mover[i as usize].0, self.mover[i as usize].1),
            Thing::Floor if self.place.ground.kind == Kind::Terrain => terrain::ground(p),
            Thing::Floor => materials::floor(p),
            Thing::Sky => return Vec3::ZERO,
        };
        albedo * (SUN * sun + sky::ambient(normal) * open)
    }

    fn gloss(&self, thing: Thing) -> Option<Gloss> {
        match thing {
            Thing::Solid(i) => self.place.surfaces[i as usize].gloss,
            Thing::Floor => self.place.floor_gloss,
            Thing::Mover(_) | Thing::Sky => None,
        }
    }

    /// Cosine of the sun's height over the surface, 0 in shadow; true if the moving object casts the shadow.
    fn sunlight(&self, p: Vec3, normal: Vec3, towards: Vec3) -> (f32, bool) {
        let height = normal.dot(sky::sun());
        if height <= 0.0 {
            return (0.0, false);
        }
        let ray = Ray { origin: p + normal * LIFT, direction: towards };
        if p.length_squared() > self.place.ground.shadows {
            return (height, false);
        }
        if self.place.bvh.any(&self.place.solids, &ray, f32::INFINITY) {
            return (0.0, false);
        }
        let blocked = self.mover.iter().any(|(solid, _)| solid.hit(&ray).is_some());
        (if blocked { 0.0 } else { height }, blocked)
    }

    /// Share of the sky that neighbours leave open, about 0.3..=1, from how much less free space there is along the
    /// normal than above a plain (Evans 2006, "Fast approximations for global illumination on dynamic scenes").
    fn openness(&self, p: Vec3, normal: Vec3) -> f32 {
        const STEPS: [(f32, f32); 3] = [(0.06, 1.0), (0.2, 0.8), (0.5, 0.6)];
        if p.truncate().length_squared() > self.place.ground.walls {
            return 1.0;
        }
        let mut room = STEPS.map(|(h, _)| (p.z + normal.z * h).min(h));
        for &i in &self.place.shading {
            let solid = &self.place.solids[i as usize];
            let here = solid.distance(p);
            if here > 1.0 {
                continue;
            }
            for (room, (h, _)) in room.iter_mut().zip(STEPS) {
                if here < 2.0 * h {
                    *room = room.min(solid.distance(p + normal * h));
                }
            }
        }
        let lost: f32 = room.iter().zip(STEPS).map(|(room, (h, weight))| weight * (1.0 - room.max(0.0) / h)).sum();
        (1.0 - 0.36 * lost).clamp(0.25, 1.0)
    }
}
