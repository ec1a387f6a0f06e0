//! Random hard cases. The seed is printed; `QIRF_SEED` sets another.

use crate::support::{Random, device, finish, seed};
use qirf_vk::qirf::overlap::Method;
use qirf_vk::selftest::overlap::{errors, random_rows};
use qirf_vk::selftest::project::{Hard, case_errors};

#[test]
fn overlaps_of_ten_thousand_pairs() {
    let (device, seed) = (device(), seed());
    // The limits are the selftest's; the determinant's figures are printed for docs/numerics.md.
    for (parallel, allowed) in [(false, 1e-5), (true, 2e-4)] {
        let rows = random_rows(10_000, parallel, seed);
        for method in [Method::Qr, Method::Determinant] {
            let (errors, nan) = errors(&device, &rows, method).unwrap();
            let at = |share: f64| errors[((errors.len() - 1) as f64 * share) as usize];
            println!(
                "{method:?}, {}: NaN {nan}; error median {:.1e}, 99 % {:.1e}, largest {:.1e}",
                if parallel { "near-parallel" } else { "any orientation" },
                at(0.5),
                at(0.99),
                at(1.0)
            );
            if method == Method::Qr {
                assert!(nan == 0 && at(1.0) <= allowed, "{nan} NaN, largest error {:e}", at(1.0));
            }
        }
    }
    finish(&device);
}

/// Gaussians of any shape and size before, around and behind the camera: the device draws the same picture as the twin,
/// and no result is NaN.
#[test]
fn gaussians_of_any_kind() {
    let (device, seed) = (device(), seed());
    let mut r = Random(seed);
    let (mut worst_picture, mut worst_gradient, mut drawn) = (0.0_f64, 0.0_f64, 0);
    for k in 0..200 {
        let z = 10_f64.powf(r.within(-1.5, 4.0));
        let size = z * 10_f64.powf(r.within(-5.0, 1.5));
        let hard = Hard {
            name: format!("number {k} of seed {seed}"),
            mean: {
                let side = if r.within(0.0, 1.0) < 0.1 { -1.0 } else { 1.0 };
                [r.within(-0.5, 0.5) * z, r.within(-0.5, 0.5) * z, z * side].map(|v| v as f32)
            },
            log_scale: [0; 3].map(|_| (size * 10_f64.powf(r.within(-3.0, 0.0))).ln() as f32),
            rotation: {
                let length = 10_f64.powf(r.within(-3.0, 10.0));
                [0; 4].map(|_| (length * r.within(-1.0, 1.0)) as f32)
            },
            logit: r.within(-8.0, 30.0) as f32,
        };
        let errors = case_errors(&device, &hard, k % 2 == 0).unwrap();
        let told = format!(
            "{}: {errors:?}; {:?} {:?} {:?} {}",
            hard.name, hard.mean, hard.log_scale, hard.rotation, hard.logit
        );
        drawn += usize::from(errors.alpha > 0.0);
        worst_picture = worst_picture.max(errors.picture);
        worst_gradient = worst_gradient.max(errors.gradient);
        assert!(errors.skipped == 0 && errors.alpha <= 0.99 + 1e-6, "{told}");
        // A pixel at the edge of 1/255 may be drawn by only one of device and twin.
        assert!(errors.picture < 8e-3 && errors.gradient < 1e-3, "{told}");
    }
    println!("{drawn} of 200 drawn; largest errors: picture {worst_picture:.1e}, gradients {worst_gradient:.1e}");
    assert!(drawn > 60);
    finish(&device);
}
