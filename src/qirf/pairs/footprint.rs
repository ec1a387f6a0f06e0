//! The appearance of a Gaussian in the pictures, and the predicted appearance of two merged into one.
//!
//! Seen from a direction, a Gaussian adds a (c - b) g to a picture: g is its projected density with peak 1, a its
//! opacity as shown in the pictures (opacity times the transmittance before it), c its colour, b the colour behind. The
//! squared error of replacing x and y by m is therefore the integral of |x + y - m|^2, sums of products of Gaussians,
//! which have closed forms. It is averaged over six directions, the axes of an icosahedron, and multiplied by the
//! number of pixels that all views together have per unit of area. A fourth channel, a times COVERAGE, accounts for
//! Gaussians that cover their background without differing from it.

use crate::gaussians::Gaussians;
use crate::kernels::constants::sh::float64::SH_C0;
use crate::response::Score;
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

/// Number of directions from which footprints are compared.
const DIRECTIONS: usize = 6;
/// Weight of coverage beside colours.
const COVERAGE: f64 = 0.3;
/// Share of the more visible Gaussian's transmittance in that of a merged one; the rest is the mean of both.
const NEARER: f64 = 0.5;
/// Range of opacities, as in rendering.
const OPACITIES: std::ops::RangeInclusive<f64> = 1e-4..=0.99;

/// The appearance of a Gaussian in the pictures.
#[derive(Clone, Debug)]
pub(super) struct Footprint {
    /// Centre in world units.
    pub mean: DVec3,
    /// Sum of T alpha over all pixels of all views: its weight in means.
    pub contribution: f64,
    /// Opacity.
    pub opacity: f64,
    /// Mean transmittance before it.
    transmittance: f64,
    /// Pixels of all views per unit of area.
    density: f64,
    colour: DVec3,
    behind: DVec3,
    /// Variance that rendering adds to the projections, in world units squared.
    widening: f64,
    /// Projected covariances, with the widening.
    projections: [Projection; DIRECTIONS],
}

/// A symmetric 2 x 2 covariance, and the root of its determinant.
#[derive(Clone, Copy, Debug)]
struct Projection {
    xx: f64,
    xy: f64,
    yy: f64,
    root: f64,
}

impl Projection {
    fn new(xx: f64, xy: f64, yy: f64) -> Self {
        Self { xx, xy, yy, root: (xx * yy - xy * xy).max(0.0).sqrt() }
    }

    /// Integral of the square of the density with peak 1.
    fn square(&self) -> f64 {
        PI * self.root
    }

    /// Integral of the product of two densities with peak 1, whose centres lie `apart`.
    fn product(&self, other: &Self, apart: DVec2) -> f64 {
        let sum = Self::new(self.xx + other.xx, self.xy + other.xy, self.yy + other.yy);
        let power = sum.yy * apart.x * apart.x - 2.0 * sum.xy * apart.x * apart.y + sum.xx * apart.y * apart.y;
        TAU * self.root * other.root / sum.root * (-0.5 * power / (sum.root * sum.root)).exp()
    }
}

/// Two axes across each direction.
static ACROSS: LazyLock<[[DVec3; 2]; DIRECTIONS]> = LazyLock::new(|| {
    let p = 0.5 * (1.0 + 5.0_f64.sqrt());
    let directions = [[0.0, 1.0, p], [0.0, 1.0, -p], [1.0, p, 0.0], [1.0, -p, 0.0], [p, 0.0, 1.0], [p, 0.0, -1.0]];
    directions.map(|direction| {
        let (a, b) = DVec3::from(direction).normalize().any_orthonormal_pair();
        [a, b]
    })
});

/// The covariance of a Gaussian in world units squared.
pub(super) fn covariance(model: &Gaussians, i: usize) -> DMat3 {
    let [w, x, y, z] = model.rotations[i].map(f64::from);
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let scaled = axes * DMat3::from_diagonal(DVec3::from(model.log_scales[i].map(|s| f64::from(s).exp())));
    scaled * scaled.transpose()
}

impl Footprint {
    /// The footprint of Gaussian `i` by its score over all views, where rendering adds the variance `widening` in world
    /// units squared to its projection; `None` if no picture shows it or its values are not finite.
    pub fn of(model: &Gaussians, i: usize, score: &Score, widening: f64) -> Option<Self> {
        let (contribution, squares) = (f64::from(score.contribution), f64::from(score.squares));
        if !(contribution > 0.0 && squares > 0.0) {
            return None;
        }
        let covariance = covariance(model, i);
        let projections = ACROSS.map(|[a, b]| {
            let (ca, cb) = (covariance * a, covariance * b);
            Projection::new(a.dot(ca) + widening, a.dot(cb), b.dot(cb) + widening)
        });
        let logit = f64::from(model.opacity_logits[i]);
        let opacity = (1.0 / (1.0 + (-logit).exp())).clamp(*OPACITIES.start(), *OPACITIES.end());
        // For a density g with peak a, the integral of a g is twice that of (a g)^2, over a.
        let amplitude = (2.0 * squares / contribution).min(opacity);
        let band = |k: usize| (0.5 + SH_C0 * f64::from(model.sh[0][3 * i + k])).max(0.0);
        let mut footprint = Self {
            mean: DVec3::from(model.means[i].map(f64::from)),
            contribution,
            opacity,
            transmittance: amplitude / opacity,
            density: 0.0,
            colour: DVec3::from(std::array::from_fn(band)),
            behind: DVec3::from(score.behind.map(f64::from)) / contribution,
            widening,
            projections,
        };
        footprint.density = contribution / (amplitude * footprint.area());
        (footprint.mean.is_finite() && footprint.density.is_finite() && footprint.density > 0.0).then_some(footprint)
    }

    /// Mean over the directions of the integral of the density with peak 1.
    fn area(&self) -> f64 {
        TAU / DIRECTIONS as f64 * self.projections.iter().map(|p| p.root).sum::<f64>()
    }

    /// The opacity as shown in the pictures.
    fn amplitude(&self) -> f64 {
        self.opacity * self.transmittance
    }

    /// The footprint of two Gaussians merged into one with their mean and covariance, and with an opacity that
    /// contributes as much as both, as far as the range of opacities permits.
    #[must_use]
    pub fn merged(&self, other: &Self) -> Self {
        let contribution = self.contribution + other.contribution;
        let (p, q) = (self.contribution / contribution, other.contribution / contribution);
        let apart = self.mean - other.mean;
        let projections = std::array::from_fn(|d| {
            let [a, b] = ACROSS[d];
            let v = DVec2::new(a.dot(apart), b.dot(apart)) * (p * q).sqrt();
            let (a, b) = (&self.projections[d], &other.projections[d]);
            let mix = |a: f64, b: f64, between: f64| p * a + q * b + between;
            Projection::new(mix(a.xx, b.xx, v.x * v.x), mix(a.xy, b.xy, v.x * v.y), mix(a.yy, b.yy, v.y * v.y))
        });
        let (t, u) = (self.transmittance, other.transmittance);
        let mut merged = Self {
            mean: p * self.mean + q * other.mean,
            contribution,
            opacity: 0.0,
            transmittance: NEARER * t.max(u) + (1.0 - NEARER) * (p * t + q * u),
            density: p * self.density + q * other.density,
            colour: p * self.colour + q * other.colour,
            behind: p * self.behind + q * other.behind,
            widening: p * self.widening + q * other.widening,
            projections,
        };
        let wanted = contribution / (merged.density * merged.area() * merged.transmittance);
        merged.opacity = wanted.clamp(*OPACITIES.start(), *OPACITIES.end());
        merged
    }

    /// Growth of the squared error over all views if two Gaussians are merged; infinite instead of NaN.
    pub fn cost(&self, other: &Self) -> f32 {
        let merged = self.merged(other);
        let channels = |f: &Self| {
            let colour = f.amplitude() * (f.colour - merged.behind);
            colour.extend(COVERAGE * f.amplitude())
        };
        let (x, y, m) = (channels(self), channels(other), channels(&merged));
        let (xx, yy, mm, xy, xm, ym) = (x.dot(x), y.dot(y), m.dot(m), x.dot(y), x.dot(m), y.dot(m));
        let (to_x, to_y) = (self.mean - merged.mean, other.mean - merged.mean);
        let mut sum = 0.0;
        for (d, [along, up]) in ACROSS.iter().enumerate() {
            let at = |v: DVec3| DVec2::new(along.dot(v), up.dot(v));
            let (a, b, c) = (&self.projections[d], &other.projections[d], &merged.projections[d]);
            let (to_a, to_b) = (at(to_x), at(to_y));
            sum += xx * a.square() + yy * b.square() + mm * c.square();
            sum += 2.0 * (xy * a.product(b, to_a - to_b) - xm * a.product(c, to_a) - ym * b.product(c, to_b));
        }
        let cost = (merged.density * sum.max(0.0) / DIRECTIONS as f64) as f32;
        if cost.is_nan() { f32::INFINITY } else { cost }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian, and its scores in 10 views with 100 x 100 pixels per unit of area if `transmittance` lies before it.
    fn seen(mean: [f32; 3], axes: [f32; 3], opacity: f32, transmittance: f64, rgb: [f32; 3]) -> Footprint {
        let mut model = Gaussians::zeroed(1, 0);
        model.means[0] = mean;
        model.log_scales[0] = axes.map(f32::ln);
        model.rotations[0] = [0.9, 0.1, -0.3, 0.2];
        model.opacity_logits[0] = (opacity / (1.0 - opacity)).ln();
        model.sh[0] = rgb.map(|v| (v - 0.5) / SH_C0 as f32).to_vec();
        let (unit, a) =
            (Score { contribution: 1.0, squares: 0.5, ..Score::default() }, f64::from(opacity) * transmittance);
        let area = Footprint::of(&model, 0, &unit, 0.001).unwrap().area();
        let pixels = 1e5 * area;
        let score = Score {
            contribution: (a * pixels) as f32,
            squares: (0.5 * a * a * pixels) as f32,
            behind: [(0.2 * a * pixels) as f32; 3],
            ..Score::default()
        };
        Footprint::of(&model, 0, &score, 0.001).unwrap()
    }

    fn pair() -> [Footprint; 2] {
        [
            seen([0.1, 0.2, 0.0], [0.2, 0.1, 0.02], 0.6, 0.8, [0.9, 0.3, 0.1]),
            seen([0.25, 0.1, 0.1], [0.1, 0.15, 0.03], 0.3, 0.5, [0.4, 0.5, 0.2]),
        ]
    }

    /// The mean over directions of the squared difference, on a grid of 0.02 units.
    fn by_grid(x: &Footprint, y: &Footprint) -> f64 {
        let m = x.merged(y);
        let step = 0.02;
        let value = |f: &Footprint, d: usize, at: DVec2| {
            let [a, b] = ACROSS[d];
            let Projection { xx, xy, yy, root } = f.projections[d];
            let v = at - DVec2::new(a.dot(f.mean), b.dot(f.mean));
            let power = (yy * v.x * v.x - 2.0 * xy * v.x * v.y + xx * v.y * v.y) / (root * root);
            let colour = f.amplitude() * (f.colour - m.behind);
            colour.extend(COVERAGE * f.amplitude()) * (-0.5 * power).exp()
        };
        let mut sum = 0.0;
        for d in 0..DIRECTIONS {
            for n in 0..200 * 200 {
                let at = DVec2::new(f64::from(n % 200) - 99.5, f64::from(n / 200) - 99.5) * step;
                sum += (value(x, d, at) + value(y, d, at) - value(&m, d, at)).length_squared() * step * step;
            }
        }
        m.density * sum / DIRECTIONS as f64
    }

    #[test]
    fn costs_are_integrals_of_squared_differences() {
        let [x, y] = pair();
        let (cost, grid) = (f64::from(x.cost(&y)), by_grid(&x, &y));
        println!("closed form {cost:.6}, grid {grid:.6}");
        assert!(cost > 1.0 && (cost / grid - 1.0).abs() < 1e-4);
        assert!((f64::from(y.cost(&x)) / cost - 1.0).abs() < 1e-6, "symmetric");
    }

    #[test]
    fn observations_are_understood() {
        let [x, _] = pair();
        assert!((x.transmittance - 0.8).abs() < 1e-6 && (x.density / 1e5 - 1.0).abs() < 1e-6);
        assert!((x.behind - DVec3::splat(0.2)).abs().max_element() < 1e-6);
    }

    #[test]
    fn merging_keeps_what_contributes() {
        let [x, y] = pair();
        let m = x.merged(&y);
        let shown = |f: &Footprint| f.amplitude() * f.area() * f.density;
        assert!((shown(&m) / (shown(&x) + shown(&y)) - 1.0).abs() < 1e-9);
        // Two that cover each other completely cannot add up to more than an opaque one.
        let opaque = seen([0.0; 3], [0.1; 3], 0.95, 1.0, [0.5; 3]);
        assert_eq!(opaque.merged(&opaque).opacity, *OPACITIES.end());
    }

    /// Faint halves of a Gaussian at its own place cost almost nothing; different colours and distance cost more.
    #[test]
    fn costs_grow_with_what_is_seen() {
        let half = seen([0.0; 3], [0.1; 3], 0.2, 1.0, [0.7, 0.2, 0.4]);
        let same = half.cost(&half);
        let moved = half.cost(&seen([0.15, 0.0, 0.0], [0.1; 3], 0.2, 1.0, [0.7, 0.2, 0.4]));
        let far = half.cost(&seen([0.4, 0.0, 0.0], [0.1; 3], 0.2, 1.0, [0.7, 0.2, 0.4]));
        let other = half.cost(&seen([0.15, 0.0, 0.0], [0.1; 3], 0.2, 1.0, [0.1, 0.9, 0.4]));
        let hidden = half.cost(&seen([0.15, 0.0, 0.0], [0.1; 3], 0.2, 0.01, [0.1, 0.9, 0.4]));
        println!("same {same}, moved {moved}, far {far}, other {other}, hidden {hidden}");
        assert!(same < 1e-6 * moved && moved < far && moved < other && hidden < 0.01 * other);
    }

    #[test]
    fn what_is_not_shown_has_no_footprint() {
        let mut model = Gaussians::zeroed(1, 0);
        let of = |model: &Gaussians, contribution: f32, squares: f32| {
            let score = Score { contribution, squares, ..Score::default() };
            Footprint::of(model, 0, &score, 1e-4)
        };
        model.rotations[0] = [1.0, 0.0, 0.0, 0.0];
        assert!(of(&model, 1.0, 0.5).is_some());
        assert!(
            of(&model, 0.0, 0.0).is_none() && of(&model, 1e-30, 0.0).is_none() && of(&model, f32::NAN, 1.0).is_none()
        );
        let damaged: [fn(&mut Gaussians); 3] =
            [|m| m.means[0][1] = f32::NAN, |m| m.log_scales[0][2] = f32::INFINITY, |m| m.rotations[0] = [0.0; 4]];
        for damage in damaged {
            let mut model = model.clone();
            damage(&mut model);
            assert!(of(&model, 1.0, 0.5).is_none());
        }
    }
}
