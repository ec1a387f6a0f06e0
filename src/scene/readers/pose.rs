//! Poses from quaternions and matrices; none for anything but a rigid motion.

use glam::{DMat3, DQuat, DVec3};
use serde_json::Value;

/// Largest coordinate of a pose or point; beyond it float32 has no precision left for detail.
const FARTHEST: f64 = 1e15;

/// True if a position can be used.
pub(super) fn is_place(p: DVec3) -> bool {
    p.is_finite() && p.abs().max_element() < FARTHEST
}

/// World-to-camera pose from a quaternion (w, x, y, z) of any length and a translation.
pub(super) fn from_quaternion([w, x, y, z]: [f64; 4], translation: [f64; 3]) -> Option<(DMat3, DVec3)> {
    let largest = [w, x, y, z].into_iter().map(f64::abs).fold(0.0, f64::max);
    let translation = DVec3::from_array(translation);
    let q = DQuat::from_xyzw(x, y, z, w);
    let usable = q.is_finite() && (1e-12..1e12).contains(&largest) && is_place(translation);
    usable.then(|| (DMat3::from_quat(q.normalize()), translation))
}

/// The rows of a matrix, of which there are at least three; they may also be given one after another. Numbers may be strings, and NaN
/// stands for what is no finite number.
pub(in crate::scene) fn rows(matrix: &Value) -> Option<Vec<Vec<f64>>> {
    let parsed = |v: &Value| v.as_str()?.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    let number = |v: &Value| v.as_f64().or_else(|| parsed(v)).unwrap_or(f64::NAN);
    let numbers = |list: &Vec<Value>| list.iter().map(number).collect::<Vec<f64>>();
    let list = matrix.as_array()?;
    let rows: Vec<Vec<f64>> = match list.len() {
        12 | 16 => numbers(list).chunks(4).map(<[f64]>::to_vec).collect(),
        _ => list.iter().map(|row| row.as_array().map(numbers)).collect::<Option<_>>()?,
    };
    (rows.len() >= 3 && rows.iter().all(|row| row.len() == 4)).then_some(rows)
}

/// Divides a matrix of four rows by its last entry, so that the last row is 0 0 0 1.
pub(super) fn divide(rows: &mut [Vec<f64>]) -> Result<(), String> {
    let Some([x, y, z, w]) = rows.get(3).and_then(|row| row.first_chunk::<4>().copied()) else { return Ok(()) };
    if [x, y, z].iter().any(|v| v.abs() > 1e-6 * w.abs()) {
        let what =
            "its transform_matrix does not end in a row 0 0 0 1: is it transposed, with columns as rows? Transpose it";
        return Err(what.to_owned());
    }
    rows.iter_mut().flatten().for_each(|v| *v /= w);
    Ok(())
}

/// Turns OpenCV's camera axes (x right, y down, z forwards) of a camera-to-world matrix into OpenGL's.
pub(super) fn opencv_to_opengl(rows: &mut [Vec<f64>]) {
    rows.iter_mut().flat_map(|row| row.iter_mut().skip(1).take(2)).for_each(|v| *v = -*v);
}

/// True for a matrix that would be a pose if it did not mirror the world.
pub(super) fn is_mirrored(rows: &[Vec<f64>]) -> bool {
    let flipped: Vec<Vec<f64>> =
        rows.iter().map(|row| row.iter().enumerate().map(|(c, v)| if c == 0 { -v } else { *v }).collect()).collect();
    from_opengl(&flipped).is_some()
}

/// World-to-camera pose from a camera-to-world matrix with OpenGL's camera axes (x right, y up, z backwards).
///
/// Uniformly scaled axes are normalised; a mirrored, sheared (cosine over 1e-3) or singular matrix is no pose.
pub(super) fn from_opengl(rows: &[Vec<f64>]) -> Option<(DMat3, DVec3)> {
    from_opengl_skewed(rows, 1e-3)
}

/// Variant of [`from_opengl`] with another limit on the cosine between axes.
pub(in crate::scene) fn from_opengl_skewed(rows: &[Vec<f64>], most: f64) -> Option<(DMat3, DVec3)> {
    let column = |c: usize| Some(DVec3::new(*rows.first()?.get(c)?, *rows.get(1)?.get(c)?, *rows.get(2)?.get(c)?));
    let centre = column(3)?;
    let (right, up, back) = (column(0)?.try_normalize()?, column(1)?.try_normalize()?, column(2)?.try_normalize()?);
    let skew = right.dot(up).abs().max(up.dot(back).abs()).max(back.dot(right).abs());
    if skew > most || right.cross(up).dot(back) <= 0.0 || !is_place(centre) {
        return None;
    }
    // The nearest rotation to within rounding: the viewing axis stays, the others are made orthogonal to it.
    let right = (right - back * back.dot(right)).try_normalize()?;
    let up = back.cross(right);
    let rotation = DMat3::from_cols(right, -up, -back).transpose();
    Some((rotation, -(rotation * centre)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strings_are_numbers_if_they_are_finite() {
        let matrix = serde_json::json!([["inf", "1", " 2e0 ", 3], [0, 0, 0, 0], ["-Infinity", "NaN", "x", 4]]);
        let rows = rows(&matrix).unwrap();
        assert!(rows[0][0].is_nan() && rows[2][..3].iter().all(|v| v.is_nan()));
        assert_eq!(rows[0][1..], [1.0, 2.0, 3.0]);
    }
}
