//! Rays, solids and their intersections. World: right-handed, z up, the floor at z = 0, lengths in metres.

use glam::{Mat3, Vec3};

/// A half line; the direction has unit length.
#[derive(Clone, Copy)]
pub(super) struct Ray {
    pub origin: Vec3,
    pub direction: Vec3,
}

impl Ray {
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// A solid.
#[derive(Clone, Debug)]
pub(super) enum Solid {
    Sphere {
        centre: Vec3,
        radius: f32,
    },
    /// `axes` turns local into world directions.
    Block {
        centre: Vec3,
        half: Vec3,
        axes: Mat3,
    },
    /// Upright, with lids; `base` is the centre of the lower lid.
    Cylinder {
        base: Vec3,
        radius: f32,
        height: f32,
    },
    /// A rod from `from` along the unit vector `axis`, with round ends.
    Rod {
        from: Vec3,
        axis: Vec3,
        length: f32,
        radius: f32,
    },
}

impl Solid {
    /// A rod between two distinct points.
    pub fn rod(from: Vec3, to: Vec3, radius: f32) -> Self {
        let length = from.distance(to);
        Self::Rod { from, axis: (to - from) / length.max(1e-6), length, radius }
    }

    /// A block turned by `degrees` about the vertical.
    pub fn block(centre: Vec3, half: Vec3, degrees: f32) -> Self {
        Self::Block { centre, half, axes: Mat3::from_rotation_z(degrees.to_radians()) }
    }

    /// Distance along the ray to its first entry in front of the origin; solids are never seen from within.
    pub fn hit(&self, ray: &Ray) -> Option<f32> {
        match *self {
            Self::Sphere { centre, radius } => hit_sphere(ray, centre, radius),
            Self::Block { centre, half, axes } => {
                let to_local = axes.transpose();
                let (o, d) = (to_local * (ray.origin - centre), to_local * ray.direction);
                let inverse = d.recip();
                let (a, b) = ((-half - o) * inverse, (half - o) * inverse);
                let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
                (enter > 0.0 && enter <= leave).then_some(enter)
            }
            Self::Cylinder { base, radius, height } => hit_cylinder(ray, base, radius, height),
            Self::Rod { from, axis, length, radius } => hit_rod(ray, from, axis, length, radius),
        }
    }

    /// Outward unit normal at a point of the surface.
    pub fn normal(&self, p: Vec3) -> Vec3 {
        match *self {
            Self::Sphere { centre, .. } => (p - centre).normalize_or(Vec3::Z),
            Self::Block { half, axes, .. } => {
                let scaled = self.local(p) / half;
                let a = scaled.abs();
                let local = if a.x >= a.y && a.x >= a.z {
                    Vec3::X * scaled.x.signum()
                } else if a.y >= a.z {
                    Vec3::Y * scaled.y.signum()
                } else {
                    Vec3::Z * scaled.z.signum()
                };
                axes * local
            }
            Self::Cylinder { base, radius, height } => {
                let q = p - base;
                let side = (q.x * q.x + q.y * q.y).sqrt() - radius;
                if (q.z - height).abs() < side.abs() {
                    Vec3::Z
                } else if q.z.abs() < side.abs() {
                    Vec3::NEG_Z
                } else {
                    q.with_z(0.0).normalize_or(Vec3::X)
                }
            }
            Self::Rod { from, axis, length, .. } => {
                let along = (p - from).dot(axis).clamp(0.0, length);
                (p - from - axis * along).normalize_or(Vec3::Z)
            }
        }
    }

    /// The point in the solid's own coordinates: from its centre or base, along its own axes.
    pub fn local(&self, p: Vec3) -> Vec3 {
        match *self {
            Self::Sphere { centre, .. } => p - centre,
            Self::Block { centre, axes, .. } => axes.transpose() * (p - centre),
            Self::Cylinder { base, .. } => p - base,
            Self::Rod { from, axis, .. } => {
                let (u, v) = axis.any_orthonormal_pair();
                Vec3::new((p - from).dot(u), (p - from).dot(v), (p - from).dot(axis))
            }
        }
    }

    /// Signed distance to the surface, negative inside.
    pub fn distance(&self, p: Vec3) -> f32 {
        match *self {
            Self::Sphere { centre, radius } => p.distance(centre) - radius,
            Self::Block { half, .. } => {
                let q = self.local(p).abs() - half;
                q.max(Vec3::ZERO).length() + q.max_element().min(0.0)
            }
            Self::Cylinder { base, radius, height } => {
                let q = p - base;
                let side = (q.x * q.x + q.y * q.y).sqrt() - radius;
                let lid = (q.z - 0.5 * height).abs() - 0.5 * height;
                (side.max(0.0).powi(2) + lid.max(0.0).powi(2)).sqrt() + side.max(lid).min(0.0)
            }
            Self::Rod { from, axis, length, radius } => {
                let along = (p - from).dot(axis).clamp(0.0, length);
                (p - from - axis * along).length() - radius
            }
        }
    }

    /// Lower and upper corner of the axis-aligned bounding box.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        match *self {
            Self::Sphere { centre, radius } => (centre - radius, centre + radius),
            Self::Block { centre, half, axes } => {
                let reach = axes.x_axis.abs() * half.x + axes.y_axis.abs() * half.y + axes.z_axis.abs() * half.z;
                (centre - reach, centre + reach)
            }
            Self::Cylinder { base, radius, height } => {
                (base - Vec3::new(radius, radius, 0.0), base + Vec3::new(radius, radius, height))
            }
            Self::Rod { from, axis, length, radius } => {
                let to = from + axis * length;
                (from.min(to) - radius, from.max(to) + radius)
            }
        }
    }
}

fn hit_sphere(ray: &Ray, centre: Vec3, radius: f32) -> Option<f32> {
    let to = centre - ray.origin;
    let nearest = to.dot(ray.direction);
    // The perpendicular itself, not |to|^2 - nearest^2, which loses small radii at large distances in f32.
    let off = to - ray.direction * nearest;
    let h = radius * radius - off.length_squared();
    if h < 0.0 {
        return None;
    }
    let t = nearest - h.sqrt();
    (t > 0.0).then_some(t)
}

fn hit_cylinder(ray: &Ray, base: Vec3, radius: f32, height: f32) -> Option<f32> {
    let (o, d) = (ray.origin - base, ray.direction);
    let a = d.x * d.x + d.y * d.y;
    let b = o.x * d.x + o.y * d.y;
    let c = o.x * o.x + o.y * o.y - radius * radius;
    let h = b * b - a * c;
    if h >= 0.0 && a > 1e-12 {
        let t = (-b - h.sqrt()) / a;
        let z = o.z + t * d.z;
        if t > 0.0 && (0.0..=height).contains(&z) {
            return Some(t);
        }
    }
    let lid = if d.z < 0.0 { height } else { 0.0 };
    let t = (lid - o.z) / d.z;
    let (x, y) = (o.x + t * d.x, o.y + t * d.y);
    (t > 0.0 && x * x + y * y <= radius * radius).then_some(t)
}

fn hit_rod(ray: &Ray, from: Vec3, axis: Vec3, length: f32, radius: f32) -> Option<f32> {
    // Start near the rod, so that f32 resolves rods thinner than 1/1000 of the distance.
    let start = (from + axis * (0.5 * length) - ray.origin).dot(ray.direction);
    let o = ray.at(start) - from;
    let d = ray.direction;
    let (along_d, along_o) = (axis.dot(d), axis.dot(o));
    let (d_across, o_across) = (d - axis * along_d, o - axis * along_o);
    let a = d_across.length_squared();
    let b = d_across.dot(o_across);
    let h = b * b - a * (o_across.length_squared() - radius * radius);
    if h < 0.0 {
        return None;
    }
    if a > 1e-9 {
        let t = (-b - h.sqrt()) / a;
        if (0.0..=length).contains(&(along_o + t * along_d)) {
            return (start + t > 0.0).then_some(start + t);
        }
    }
    let ends = [from, from + axis * length].map(|end| hit_sphere(ray, end, radius));
    match ends {
        [Some(p), Some(q)] => Some(p.min(q)),
        [p, q] => p.or(q),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_meet_surfaces_where_the_distance_is_zero() {
        let solids = [
            Solid::Sphere { centre: Vec3::new(0.1, 0.2, 0.5), radius: 0.5 },
            Solid::block(Vec3::new(0.0, 0.1, 0.4), Vec3::new(0.5, 0.3, 0.4), 25.0),
            Solid::Cylinder { base: Vec3::new(-0.1, 0.0, 0.1), radius: 0.4, height: 0.7 },
            Solid::rod(Vec3::new(-0.5, 0.2, 0.1), Vec3::new(0.4, -0.1, 0.8), 0.05),
        ];
        for solid in &solids {
            let (mut met, mut backs) = (0, 0);
            for i in 0..4000 {
                let angle = i as f32 * 0.37;
                let origin = Vec3::new(6.0 * angle.cos(), 6.0 * angle.sin(), 0.2 + (i % 13) as f32 * 0.3);
                let target = Vec3::new((i % 7) as f32 * 0.1 - 0.3, (i % 11) as f32 * 0.1 - 0.5, (i % 5) as f32 * 0.2);
                let ray = Ray { origin, direction: (target - origin).normalize() };
                if let Some(t) = solid.hit(&ray) {
                    met += 1;
                    let p = ray.at(t);
                    assert!(solid.distance(p).abs() < 1e-4, "{solid:?}: {}", solid.distance(p));
                    backs += usize::from(solid.normal(p).dot(ray.direction) > 0.02);
                    let (low, high) = solid.bounds();
                    assert!(p.cmpge(low - 1e-4).all() && p.cmple(high + 1e-4).all());
                }
            }
            assert!(met > 100, "{solid:?} met {met} rays");
            // Exactly on a rim, rounding may choose the neighbouring face.
            assert!(backs * 500 <= met, "{solid:?} shows its back to {backs} of {met} rays");
        }
    }
}
