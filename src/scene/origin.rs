//! Local origins of scenes far from the world's origin, such as those in map coordinates, where float32 has steps of half a
//! metre.

use glam::DVec3;

use super::{Point, Scene, camera};

/// Minimum ratio of a scene's distance from the origin to its size for a local origin; below it, float32 resolves a
/// hundred-thousandth of the size.
const FAR: f64 = 1000.0;

/// The origin for a scene of this centre and size: the world's, unless that is far; then the centre, rounded to a power of ten
/// that is no larger than the size.
pub fn near(centre: DVec3, size: f64) -> DVec3 {
    let far = centre.is_finite() && size > 0.0 && centre.abs().max_element() > FAR * size;
    if !far {
        return DVec3::ZERO;
    }
    // Written in decimals and read back, a whole number or a short fraction is itself.
    let digits = size.log10().floor().clamp(-300.0, 300.0) as i32;
    let rounded = |v: f64| {
        let text = if digits >= 0 {
            let step = 10_f64.powi(digits);
            format!("{:.0}", (v / step).round() * step)
        } else {
            format!("{v:.*}", digits.unsigned_abs() as usize)
        };
        text.parse().unwrap_or(v)
    };
    DVec3::new(rounded(centre.x), rounded(centre.y), rounded(centre.z))
}

/// The distance of the float32 number nearest to `value` from the next larger one.
fn spacing(value: f64) -> f64 {
    let value = value as f32;
    f64::from(value.next_up()) - f64::from(value)
}

impl Scene {
    /// Moves coordinates to a local origin if the world's is far away, and records it. `size` is [`super::near::size`].
    pub(super) fn move_near(mut self, size: f64) -> Self {
        let cameras = || self.views.iter().map(|view| &view.camera);
        let size = (camera::extent(cameras()) / 1.1).max(size);
        let origin = near(camera::mean_centre(cameras()), size);
        if origin == DVec3::ZERO {
            return self;
        }
        let farthest = self.points.iter().fold(0.0_f64, |most, point| most.max(point.position.abs().max_element()));
        let single = |point: &Point| point.position.as_vec3().as_dvec3() == point.position;
        if farthest > 0.0 && self.points.iter().all(single) {
            let step = spacing(farthest);
            self.skipped.notes.push(format!(
                "points are float32 numbers, which have steps of {step:.1e} units so far from the origin: export doubles or local \
                 coordinates"
            ));
        }
        for view in &mut self.views {
            view.camera = view.camera.relative_to(origin);
        }
        for point in &mut self.points {
            point.position -= origin;
        }
        self.origin = origin;
        let [x, y, z] = origin.to_array();
        self.skipped.choices.push(format!(
            "the capture lies far from its world's origin: its cameras and points are relative to the local origin {x},{y},{z}"
        ));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_of_float32_double_at_powers_of_two() {
        assert_eq!([0.5, 1.9, 4e6, 4.2e6].map(spacing), [2_f64.powi(-24), 2_f64.powi(-23), 0.25, 0.5]);
    }

    #[test]
    fn only_far_places_get_an_origin_and_it_is_round() {
        let utm = DVec3::new(500_123.4, 4_649_776.2, 312.7);
        for (centre, size, origin) in [
            (DVec3::new(3.0, -4.0, 900.0), 1.0, DVec3::ZERO),
            (utm, 9.0, DVec3::new(500_123.0, 4_649_776.0, 313.0)),
            (utm, 250.0, DVec3::new(500_100.0, 4_649_800.0, 300.0)),
            (utm, 0.05, DVec3::new(500_123.4, 4_649_776.2, 312.7)),
            (utm * 1e-3, 9e-3, DVec3::new(500.123, 4649.776, 0.313)),
            (utm, 0.0, DVec3::ZERO),
            (DVec3::NAN, 1.0, DVec3::ZERO),
        ] {
            assert_eq!(near(centre, size), origin, "{centre} {size}");
        }
    }
}
