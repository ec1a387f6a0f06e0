//! Scores of pictures whose photos have exposures of their own. No model can predict those of held-out photos: an
//! affine of the rendered colours is fitted by least squares on the left half of the photo, and the right half is
//! scored.

use crate::solve;

/// Unknowns per row: red, green, blue, constant.
const TERMS: usize = 4;
/// Weight of the pull towards the identity, in pixels: decides where a picture leaves the affine undetermined.
const RIDGE: f64 = 1e-3;

/// Text of `protocol.exposure`; with `fitted` photos have exposures of their own.
pub const fn exposure_rule(fitted: bool) -> &'static str {
    if fitted {
        "a 3x4 affine of the colours fitted by least squares on each photo's left half, its right half scored"
    } else {
        "none: pictures are scored as they are rendered"
    }
}

/// The picture `rendered` exposed like the photo, and clamped to [0, 1]. The photo's left half tells how, compared with that of `seen`:
/// the same picture with the background where a mask hides the photo. Pictures are row by row, red, green, blue in [0, 1].
pub fn exposed(seen: &[f32], photo: &[f32], rendered: &[f32], width: usize) -> Vec<f32> {
    let affine = fit(seen, photo, width, 0..width / 2);
    let expose = |x: &[f32]| {
        affine.map(|row| {
            let y = row[3] + (0..3).map(|c| row[c] * f64::from(x[c])).sum::<f64>();
            (y as f32).clamp(0.0, 1.0)
        })
    };
    rendered.chunks_exact(3).flat_map(expose).collect()
}

/// The right half of a picture; all of one that is one pixel wide.
pub fn right_half(picture: &[f32], width: usize) -> (usize, Vec<f32>) {
    let middle = width / 2;
    let half = picture.chunks_exact(3 * width).flat_map(|row| row[3 * middle..].iter().copied());
    (width - middle, half.collect())
}

/// Three rows: the affine that fits the rendered colours of some columns best to the photo's.
fn fit(rendered: &[f32], photo: &[f32], width: usize, columns: std::ops::Range<usize>) -> [[f64; TERMS]; 3] {
    let mut a = [[0.0; TERMS]; TERMS];
    let mut b = [[0.0; TERMS]; 3];
    for (i, row) in a.iter_mut().enumerate() {
        row[i] = RIDGE;
    }
    for (c, row) in b.iter_mut().enumerate() {
        row[c] = RIDGE;
    }
    let rows = rendered.chunks_exact(3 * width).zip(photo.chunks_exact(3 * width));
    for (x, y) in rows.flat_map(|(x, y)| columns.clone().map(move |k| (&x[3 * k..3 * k + 3], &y[3 * k..3 * k + 3]))) {
        let x = [f64::from(x[0]), f64::from(x[1]), f64::from(x[2]), 1.0];
        for i in 0..TERMS {
            for j in 0..TERMS {
                a[i][j] += x[i] * x[j];
            }
            for c in 0..3 {
                b[c][i] += f64::from(y[c]) * x[i];
            }
        }
    }
    b.map(|row| solve::positive(a, row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_affine_is_found_on_the_left_and_applied_on_the_right() {
        let (width, height) = (9, 7);
        let value = |n: usize| ((n * 37 % 101) as f32 / 101.0) * 0.5;
        let photo: Vec<f32> = (0..3 * width * height).map(value).collect();
        let dim: Vec<f32> =
            photo.chunks_exact(3).flat_map(|p| [0.8 * p[0] + 0.1, 0.7 * p[1], 0.9 * p[2] + 0.05]).collect();
        let (w, exposed) = right_half(&exposed(&dim, &photo, &dim, width), width);
        let right = right_half(&photo, width).1;
        assert_eq!((w, exposed.len(), right.len()), (5, 3 * 5 * height, 3 * 5 * height));
        assert!(exposed.iter().zip(&right).all(|(a, b)| (a - b).abs() < 2e-3));
        // Nothing to fit on: the colours stay unchanged.
        assert_eq!(right_half(&super::exposed(&photo[..3], &photo[..3], &photo[..3], 1), 1).1, photo[..3]);
        let flat = vec![0.5; 3 * width * height];
        assert!(super::exposed(&flat, &photo, &flat, width).iter().all(|v| v.is_finite()));
    }
}
