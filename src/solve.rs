//! Small dense systems.

/// Solves a x = b by Gaussian elimination without pivoting, for symmetric positive definite `a`.
pub fn positive<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    for i in 0..N {
        for k in i + 1..N {
            let share = a[k][i] / a[i][i];
            for j in i..N {
                a[k][j] -= share * a[i][j];
            }
            b[k] -= share * b[i];
        }
    }
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|j| a[i][j] * b[j]).sum();
        b[i] = (b[i] - known) / a[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_system_is_solved() {
        let a = [[4.0, 1.0, -2.0], [1.0, 3.0, 0.5], [-2.0, 0.5, 5.0]];
        let x = super::positive(a, [0.0, 8.5, 14.0]);
        assert!(x.iter().zip([1.0, 2.0, 3.0]).all(|(x, right)| (x - right).abs() < 1e-12), "{x:?}");
    }
}
