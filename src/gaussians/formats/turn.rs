//! Places of a file's parts in its world.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::Gaussians;
use super::fault::Fault;
use crate::scene::origin::near;

/// Largest deviation of a matrix from a turn times a number.
const EVEN: f64 = 1e-4;

/// Moves a part of a model to its place in the file's world. Where the first part goes far from the world's origin, all count
/// from there: `origin` gets that place. `what` names the part in the refusal of a map that scales axes by different factors, and in the
/// warning that is returned if float32 rounds its positions.
pub(super) fn place(
    model: &mut Gaussians,
    map: &DAffine3,
    origin: &mut Option<DVec3>,
    what: &str,
) -> Result<Option<String>, Fault> {
    // Below 0 for a map that mirrors, which is a turn and a reflection through the origin.
    let size = map.matrix3.determinant().cbrt();
    let turn = map.matrix3 * size.recip();
    if size == 0.0 || !(turn.transpose() * turn).abs_diff_eq(DMat3::IDENTITY, EVEN) {
        return Err(Fault::Unsupported(format!(
            "{what} is scaled by different factors along its axes; apply its transform in the program that made the file"
        )));
    }
    let means: Vec<DVec3> = model.means.iter().map(|mean| DVec3::from(mean.map(f64::from))).collect();
    let extent = size.abs() * middle(&means).1;
    let is_far = |place: DVec3| near(place, extent) != DVec3::ZERO;
    let from = *origin.get_or_insert_with(|| if is_far(map.translation) { map.translation } else { DVec3::ZERO });
    let shift = map.translation - from;
    if map.matrix3 != DMat3::IDENTITY || shift != DVec3::ZERO {
        // Only nearly orthonormal until it is a quaternion.
        let turn = DMat3::from_quat(DQuat::from_mat3(&turn).normalize());
        model.transform(turn * size.signum(), size.abs(), shift);
    }
    Ok(is_far(shift).then(|| {
        let step = f64::from(f32::EPSILON) * shift.abs().max_element();
        format!("{what} lies far from the file's first part: its positions are rounded to about {step:.1e} units")
    }))
}

/// The middle of places, and their extent without the outermost twentieth at each end of each axis; places that are not finite do
/// not count.
pub(super) fn middle(places: &[DVec3]) -> (DVec3, f64) {
    let ends = |axis: usize| {
        let mut values: Vec<f64> = places.iter().map(|p| p[axis]).filter(|v| v.is_finite()).collect();
        values.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| values.get((share * values.len() as f64) as usize).copied().unwrap_or_default();
        [at(0.05), at(0.5), at(0.95)]
    };
    let [x, y, z] = [ends(0), ends(1), ends(2)];
    (DVec3::new(x[1], y[1], z[1]), DVec3::new(x[2] - x[0], y[2] - y[0], z[2] - z[0]).length())
}
