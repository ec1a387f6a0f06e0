//! A photo's own exposure: y = A x + b, twelve numbers row by row (red, green, blue, constant).

/// The identity map.
pub const IDENTITY: [f64; 12] = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// The exposed colours.
pub fn apply(affine: &[f64; 12], colours: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let row = |x: &[f64; 3], r: usize| (0..3).map(|c| affine[4 * r + c] * x[c]).sum::<f64>() + affine[4 * r + 3];
    colours.iter().map(|x| [row(x, 0), row(x, 1), row(x, 2)]).collect()
}

/// Gradients by the colours, A^T g, and by the affine map, the sums of g x^T and of g, from the gradient g by the
/// exposed colours.
pub fn backward(affine: &[f64; 12], colours: &[[f64; 3]], gradient: &[[f64; 3]]) -> (Vec<[f64; 3]>, [f64; 12]) {
    let mut sums = [0.0; 12];
    let through = |g: &[f64; 3], c: usize| (0..3).map(|r| affine[4 * r + c] * g[r]).sum::<f64>();
    for (x, g) in colours.iter().zip(gradient) {
        for r in 0..3 {
            for c in 0..3 {
                sums[4 * r + c] += g[r] * x[c];
            }
            sums[4 * r + 3] += g[r];
        }
    }
    (gradient.iter().map(|g| [through(g, 0), through(g, 1), through(g, 2)]).collect(), sums)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::reference::loss::{SSIM_WEIGHT, loss};

    #[test]
    fn gradients_are_the_difference_quotients() {
        let mut random = Random(7);
        let width = 9;
        let mut noise = |n: usize| (0..n).map(|_| [0; 3].map(|_| random.unit())).collect::<Vec<_>>();
        let (mut x, y) = (noise(72), noise(72));
        let mut affine = IDENTITY;
        noise(4).as_flattened().iter().zip(&mut affine).for_each(|(n, a)| *a += 0.3 * (n - 0.5));
        let value = |affine: &[f64; 12], x: &[[f64; 3]]| loss(&apply(affine, x), &y, width, SSIM_WEIGHT).value;
        let slope = loss(&apply(&affine, &x), &y, width, SSIM_WEIGHT).gradient;
        let (by_colour, by_affine) = backward(&affine, &x, &slope);
        let h = 1e-6;
        for k in 0..12 {
            let at = |v: f64| {
                let mut moved = affine;
                moved[k] += v;
                value(&moved, &x)
            };
            let quotient = (at(h) - at(-h)) / (2.0 * h);
            assert!((quotient - by_affine[k]).abs() < 1e-7, "{k}: {quotient} {}", by_affine[k]);
        }
        for p in (0..72).step_by(7) {
            for c in 0..3 {
                let kept = x[p][c];
                let mut at = |v: f64| {
                    x[p][c] = v;
                    value(&affine, &x)
                };
                let quotient = (at(kept + h) - at(kept - h)) / (2.0 * h);
                x[p][c] = kept;
                assert!((quotient - by_colour[p][c]).abs() < 1e-7, "{p} {c}: {quotient} {}", by_colour[p][c]);
            }
        }
    }
}
