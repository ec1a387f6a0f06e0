//! Adam for one row: one Gaussian's part of one parameter group.

pub use crate::kernels::constants::adam::float64::{BETA1, BETA2, EPSILON, GREATEST_GRADIENT};

/// The gradient by an opacity logit under the pressure of an attrition: `pressure` is added, divided by 1 - opacity or
/// by `least_through`, whichever is larger.
pub fn pressed(gradient: f64, logit: f64, pressure: f64, least_through: f64) -> f64 {
    gradient + pressure / (1.0 / (1.0 + logit.exp())).max(least_through)
}

/// Updates `row` in place by step `step` (the first is 1) with learning rate `rate` and these decays of the moments.
/// Returns false if the row was skipped.
///
/// A row with any gradient that is not finite, or beyond [`GREATEST_GRADIENT`], keeps its values and both moments; the
/// caller counts it. All four slices have the row's length.
pub fn adam(
    row: &mut [f64],
    gradient: &[f64],
    [first, second]: [&mut [f64]; 2],
    (step, rate, [beta1, beta2]): (u32, f64, [f64; 2]),
) -> bool {
    // Not `any(|g| g.abs() > ...)`: every comparison with a NaN is false.
    if !gradient.iter().all(|g| g.abs() <= GREATEST_GRADIENT) {
        return false;
    }
    let correction1 = 1.0 - beta1.powf(f64::from(step));
    let correction2 = 1.0 - beta2.powf(f64::from(step));
    for k in 0..row.len() {
        first[k] = beta1 * first[k] + (1.0 - beta1) * gradient[k];
        second[k] = beta2 * second[k] + (1.0 - beta2) * gradient[k] * gradient[k];
        row[k] -= rate * (first[k] / correction1) / ((second[k] / correction2).sqrt() + EPSILON);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_step_is_the_rate_against_the_sign() {
        let (mut row, mut m, mut v) = ([1.0, 2.0, 3.0], [0.0; 3], [0.0; 3]);
        assert!(adam(&mut row, &[4.0, -1e-3, 0.0], [&mut m, &mut v], (1, 0.1, [BETA1, BETA2])));
        assert!((row[0] - 0.9).abs() < 1e-12 && (row[1] - 2.1).abs() < 1e-10);
        assert_eq!(row[2], 3.0);
        assert!((m[0] - 0.4).abs() < 1e-15 && (v[0] - 0.016).abs() < 1e-15);
    }

    #[test]
    fn extremes_move_nothing_and_spread_nothing() {
        for (gradient, updated) in [
            ([0.0, 0.0], true),
            ([1e-38, -1e-38], true),
            ([1e38, 0.0], false),
            ([f64::NAN, 1.0], false),
            ([1.0, f64::NEG_INFINITY], false),
        ] {
            let (mut row, mut m, mut v) = ([1.0, -1.0], [0.5, 0.25], [0.125, 0.5]);
            assert_eq!(adam(&mut row, &gradient, [&mut m, &mut v], (10, 0.0, [BETA1, BETA2])), updated, "{gradient:?}");
            if !updated {
                assert_eq!((row, m, v), ([1.0, -1.0], [0.5, 0.25], [0.125, 0.5]));
            }
            let (mut row, mut m, mut v) = ([1.0, -1.0], [0.0; 2], [0.0; 2]);
            for step in 1..=1000 {
                adam(&mut row, &gradient, [&mut m, &mut v], (step, 0.1, [BETA1, BETA2]));
            }
            assert!((row[0] - 1.0).abs() < 1e-9 && (row[1] + 1.0).abs() < 1e-9, "{gradient:?}: {row:?}");
        }
    }

    /// Pressure lowers opaque Gaussians' logits faster, up to a limit, and whatever their size; without a limit below 1
    /// it is the same for all.
    #[test]
    fn pressure_is_finite_and_grows_with_opacity() {
        assert_eq!(pressed(-3.0, 0.0, 1.0, 0.05), -1.0, "half opaque");
        assert!((pressed(0.0, 1e4, 1.0, 0.05) - 20.0).abs() < 1e-12 && pressed(0.0, -1e4, 1.0, 0.05) == 1.0);
        assert_eq!([-9.0, 0.0, 9.0].map(|logit| pressed(2.0, logit, 0.5, 1.0)), [2.5; 3]);
    }

    /// A constant gradient of any size moves a parameter by the rate in each step: bias correction works.
    #[test]
    fn constant_gradient_moves_at_the_rate() {
        for size in [1e-6, 1.0, 1e15] {
            let (mut row, mut m, mut v) = ([0.0], [0.0], [0.0]);
            for step in 1..=500 {
                adam(&mut row, &[size], [&mut m, &mut v], (step, 0.01, [BETA1, BETA2]));
            }
            assert!((row[0] + 5.0).abs() < 1e-6, "{size}: {}", row[0]);
        }
    }
}
