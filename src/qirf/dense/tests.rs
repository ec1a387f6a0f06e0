//! Every library against residuals, and the libraries against each other.

use super::{LIBRARIES, Library, Real, eigen3, turn};
use crate::random::uniform;
use glam::{DMat3, DVec3};

/// A symmetric positive definite n x n matrix whose diagonal is 1 + `ridge`.
fn metric(n: usize, ridge: f64, seed: u64) -> Vec<f64> {
    let at = |i: usize| uniform(&[seed, i as u64]) * (n as f64).sqrt();
    let gaussian = |i: usize, j: usize| (-(at(i) - at(j)).powi(2)).exp();
    (0..n * n).map(|k| gaussian(k / n, k % n) + if k / n == k % n { ridge } else { 0.0 }).collect()
}

fn product(n: usize, a: &[f64], x: &[f64]) -> Vec<f64> {
    (0..n).map(|i| (0..n).map(|j| a[j * n + i] * x[j]).sum()).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// The largest |A u - lambda B u| of any component, and of any |u^T B u - 1|.
fn residual(n: usize, a: &[f64], b: &[f64], values: &[f64], vectors: &[f64]) -> f64 {
    let one = |(u, lambda): (&[f64], &f64)| {
        let (au, bu) = (product(n, a, u), product(n, b, u));
        let off = au.iter().zip(&bu).map(|(x, y)| (x - lambda * y).abs()).fold(0.0, f64::max);
        off.max((dot(u, &bu) - 1.0).abs())
    };
    vectors.chunks_exact(n).zip(values).map(one).fold(0.0, f64::max)
}

fn solves<T: Real>(library: &dyn Library, n: usize, allowed: f64) {
    let whole = metric(n, 1e-2, 7);
    let mut l: Vec<T> = whole.iter().map(|&x| T::of(x)).collect();
    let routines = T::by(library);
    assert!(routines.potrf(n, &mut l));
    let right: Vec<f64> = (0..2 * n).map(|k| uniform(&[9, k as u64])).collect();
    let mut x: Vec<T> = right.iter().map(|&x| T::of(x)).collect();
    assert!(routines.trtrs(false, n, 2, &l, &mut x) && routines.trtrs(true, n, 2, &l, &mut x));
    for (x, right) in x.chunks_exact(n).zip(right.chunks_exact(n)) {
        let x: Vec<f64> = x.iter().map(|x| x.to()).collect();
        let off = product(n, &whole, &x).iter().zip(right).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off <= allowed, "{library:?}, {n}: {off}");
    }
}

#[test]
fn every_library_factors_and_solves() {
    for library in LIBRARIES {
        for n in [1, 2, 3, 8, 33, 128, 200] {
            solves::<f64>(*library, n, 1e-11);
            solves::<f32>(*library, n, 5e-3);
        }
        assert!(f64::by(*library).trtrs(false, 2, 0, &[1.0, 0.5, 0.0, 1.0], &mut []));
    }
}

#[test]
fn every_library_refuses_what_has_no_factor() {
    for library in LIBRARIES {
        for wrong in [[1.0, 2.0, 2.0, 1.0], [0.0; 4], [-1.0, 0.0, 0.0, 1.0]] {
            assert!(!f64::by(*library).potrf(2, &mut wrong.clone()), "{library:?} {wrong:?}");
            assert!(!f32::by(*library).potrf(2, &mut wrong.map(|x| x as f32)), "{library:?} {wrong:?}");
            assert_eq!(library.sygvd(2, &mut [1.0, 0.0, 0.0, 1.0], &mut wrong.clone()), None, "{library:?} {wrong:?}");
        }
        assert!(!f64::by(*library).trtrs(false, 2, 1, &[1.0, 0.5, 0.0, 0.0], &mut [1.0, 1.0]), "{library:?}");
    }
}

#[test]
fn eigenpairs_leave_no_residual_and_agree() {
    for n in [1, 2, 3, 8, 33, 128, 200] {
        let (a, b) = (metric(n, 0.0, 1), metric(n, 1e-2, 2));
        let identity: Vec<f64> = (0..n * n).map(|k| f64::from(u8::from(k % (n + 1) == 0))).collect();
        let lower = |m: &[f64]| (0..n * n).map(|k| if k / n <= k % n { m[k] } else { f64::NAN }).collect::<Vec<_>>();
        let mut before: Option<[Vec<f64>; 2]> = None;
        for library in LIBRARIES {
            let mut vectors = lower(&a);
            let own = library.syevd(n, &mut vectors).unwrap();
            let off = residual(n, &a, &identity, &own, &vectors);
            assert!(off < 1e-12 * n as f64, "{library:?}, {n}: {off}");
            let (mut vectors, mut factor) = (lower(&a), b.clone());
            let general = library.sygvd(n, &mut vectors, &mut factor).unwrap();
            let off = residual(n, &a, &b, &general, &vectors);
            assert!(off < 1e-10 * n as f64, "{library:?}, {n}: {off}");
            for values in [&own, &general] {
                assert!(values.is_sorted(), "{library:?}, {n}");
            }
            if let Some([first, second]) = &before {
                let far = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
                assert!(far(first, &own) < 1e-12 * n as f64 && far(second, &general) < 1e-9 * n as f64, "{n}");
            }
            before = Some([own, general]);
        }
    }
}

#[test]
fn libraries_agree_on_signs() {
    // Eigenvectors (1, -1), (1, 1); and pairs of components of equal size: a chain of four.
    let chain: [f64; 16] = std::array::from_fn(|k| match (k / 4).abs_diff(k % 4) {
        0 => 2.0,
        1 => -1.0,
        _ => 0.0,
    });
    let cases: [(usize, &[f64]); 2] = [(2, &[1.0, 0.5, 0.5, 1.0]), (4, &chain)];
    for (n, matrix) in cases {
        let found = LIBRARIES.iter().map(|library| {
            let mut vectors = matrix.to_vec();
            library.syevd(n, &mut vectors).unwrap();
            vectors
        });
        let found: Vec<Vec<f64>> = found.collect();
        for other in &found[1..] {
            assert!(found[0].iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        }
    }
    let mut vector = [-0.1, 0.5, -0.9, 0.89];
    turn(&mut vector);
    assert_eq!(vector, [0.1, -0.5, 0.9, -0.89]);
}

#[test]
fn three_by_three_by_rotations() {
    for seed in 0..200 {
        let axes = DMat3::from_quat(
            glam::DQuat::from_xyzw(
                uniform(&[seed, 0]) - 0.5,
                uniform(&[seed, 1]) - 0.5,
                uniform(&[seed, 2]) - 0.5,
                uniform(&[seed, 3]) - 0.5,
            )
            .normalize(),
        );
        // Scales down to 1e-6 of the largest, as in thin Gaussians; every fourth matrix has two equal ones.
        let thin = 10_f64.powf(-12.0 * uniform(&[seed, 4]));
        let spread = DVec3::new(thin, if seed % 4 == 0 { thin } else { uniform(&[seed, 5]) }, 1.0);
        let matrix = axes * DMat3::from_diagonal(spread) * axes.transpose();
        let (values, vectors) = eigen3(&matrix);
        let again = vectors * DMat3::from_diagonal(values) * vectors.transpose();
        assert!((again - matrix).to_cols_array().iter().all(|x| x.abs() < 4e-15), "{seed}");
        let orthonormal = vectors.transpose() * vectors - DMat3::IDENTITY;
        assert!(orthonormal.to_cols_array().iter().all(|x| x.abs() < 4e-15), "{seed}");
        assert!(values.x <= values.y && values.y <= values.z);
        for library in LIBRARIES {
            let expected = library.syevd(3, &mut matrix.to_cols_array()).unwrap();
            assert!(values.to_array().iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-14), "{seed}");
        }
    }
    assert_eq!(eigen3(&DMat3::IDENTITY), (DVec3::ONE, DMat3::IDENTITY));
    assert_eq!(eigen3(&DMat3::ZERO), (DVec3::ZERO, DMat3::IDENTITY));
}
