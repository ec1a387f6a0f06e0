//! Lens distortion: a curve of the radius, then polynomials.

use glam::{DMat2, DVec2};

use super::curve::Curve;

/// Points between the axis and another one at which folds are looked for.
const ON_THE_WAY: u32 = 32;
/// Radius below which a curve is practically linear.
pub(super) const LEAST: f64 = 1e-9;

/// The coefficients that bend rays; zero where a model lacks them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// The curve of radii by ray, before the polynomials.
    pub curve: Curve,
    /// Radial k1..k6, of r^2, r^4 and so on to r^12.
    pub radial: [f64; 6],
    /// Coefficients of the rational model's denominator, of r^2, r^4, r^6.
    pub denominator: [f64; 3],
    /// Tangential p1, p2.
    pub tangential: [f64; 2],
    /// Thin prism s1 (on x), s2 (on y).
    pub prism: [f64; 2],
    /// Tangential p0, p1 and thin prism s0..s3 of the point that the radial terms have moved already.
    pub after: [f64; 6],
}

impl Distortion {
    /// The polynomial part, in the plane where the lens bends rays.
    pub(in crate::scene) fn bend(&self, w: DVec2) -> DVec2 {
        let r2 = w.length_squared();
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [d1, d2, d3] = self.denominator;
        let [p1, p2] = self.tangential;
        let [s1, s2] = self.prism;
        let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * (k4 + r2 * (k5 + r2 * k6)))));
        let denominator = 1.0 + r2 * (d1 + r2 * (d2 + r2 * d3));
        let xy = 2.0 * w.x * w.y;
        let moved = w * (numerator / denominator)
            + DVec2::new(
                p1 * xy + p2 * (r2 + 2.0 * w.x * w.x) + s1 * r2,
                p2 * xy + p1 * (r2 + 2.0 * w.y * w.y) + s2 * r2,
            );
        if matches!(self.after, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) { moved } else { moved + self.bend_again(moved) }
    }

    /// The terms of the point that the radial ones have moved.
    fn bend_again(&self, w: DVec2) -> DVec2 {
        let [p0, p1, s0, s1, s2, s3] = self.after;
        let (r2, xy) = (w.length_squared(), 2.0 * w.x * w.y);
        DVec2::new(
            p1 * xy + p0 * (r2 + 2.0 * w.x * w.x) + r2 * (s0 + s1 * r2),
            p0 * xy + p1 * (r2 + 2.0 * w.y * w.y) + r2 * (s2 + s3 * r2),
        )
    }

    /// The point at which the polynomials act, of an ideal one.
    pub(super) fn curved(&self, point: DVec2) -> DVec2 {
        if self.curve == Curve::Straight {
            return point;
        }
        let r = point.length().max(LEAST);
        point * (self.curve.shown(r, 1.0) / r)
    }

    /// Derivative of [`Self::bend`], by central differences: exact enough to steer Newton steps and to see folds.
    pub(in crate::scene) fn jacobian(&self, w: DVec2) -> DMat2 {
        let h = 1e-6 * (1.0 + w.length());
        let column = |d: DVec2| (self.bend(w + d) - self.bend(w - d)) / (2.0 * h);
        DMat2::from_cols(column(DVec2::new(h, 0.0)), column(DVec2::new(0.0, h)))
    }

    /// Returns true if [`Self::bend`] does not fold between the axis and a point. The determinant at the point alone does not
    /// tell: behind a fold all around the axis it may be positive again, for points shown on the other side of the axis.
    pub(in crate::scene) fn is_unfolded(&self, w: DVec2) -> bool {
        let shares = (1..=ON_THE_WAY).map(|k| f64::from(k) / f64::from(ON_THE_WAY));
        shares.rev().all(|share| self.jacobian(share * w).determinant() > 0.0)
    }

    /// Inverse of [`Self::bend`] on the branch that contains the axis, by damped Newton steps from the bent point.
    pub(super) fn unbend(&self, bent: DVec2) -> Option<DVec2> {
        let mut w = bent;
        let mut error = self.bend(w) - bent;
        for _ in 0..60 {
            if error.length() <= 1e-15 * (1.0 + bent.length()) {
                break;
            }
            let step = self.jacobian(w).inverse() * error;
            let mut share = 1.0;
            let next = loop {
                let next = w - step * share;
                let next_error = self.bend(next) - bent;
                if next_error.length() < error.length() && self.is_unfolded(next) {
                    break Some((next, next_error));
                }
                share *= 0.5;
                if share < 1e-4 {
                    break None; // stuck: at rounding level, or in a fold
                }
            };
            match next {
                Some((next, next_error)) => (w, error) = (next, next_error),
                None => break,
            }
        }
        (error.length() <= 1e-11 * (1.0 + bent.length()) && self.is_unfolded(w)).then_some(w)
    }
}
