//! The loss kernel against the float64 twin: value and gradient.

use crate::support::{Random, device, finish, golden, relative};
use qirf_vk::scene::AlphaRole;
use qirf_vk::selftest::loss::Case;
use qirf_vk::train::loss::{Loss, Weights};

const SIZES: [[u32; 2]; 9] = [[1, 1], [11, 7], [45, 37], [8, 8], [64, 48], [17, 8], [8, 17], [3, 40], [40, 3]];
const WITH_SQUARES: Weights = Weights { l1: 0.8, ssim: 0.2, l2: 2.0 };
const SSIM_ALONE: Weights = Weights { l1: 0.0, ssim: 1.0, l2: 0.0 };

#[test]
fn the_golden_loss() {
    let device = device();
    let golden = golden::Loss::read();
    let case = Case {
        size: golden.size,
        image: golden.rendered.iter().map(|p| [p[0] as f32, p[1] as f32, p[2] as f32, 1.0]).collect(),
        photo: golden.truth.iter().map(|p| [p[0], p[1], p[2], 255]).collect(),
        weights: Weights { l1: (1.0 - golden.ssim_weight) as f32, ssim: golden.ssim_weight as f32, l2: 0.0 },
        ..Case::default()
    };
    let scratch = Loss::new(&device, golden.size[0], golden.size[1]).unwrap();
    let (value, gradient) = case.computed(&device, &scratch).unwrap();
    let gradient: Vec<[f64; 3]> = gradient.iter().map(|g| [g[0], g[1], g[2]].map(f64::from)).collect();
    let error = relative(gradient.as_flattened(), golden.gradient.as_flattened());
    println!("value {value} for {}, gradient {error:.1e}", golden.value);
    assert!((f64::from(value) / golden.value - 1.0).abs() < 1e-5 && error < 1e-4);
    finish(&device);
}

#[test]
fn noise_of_any_size() {
    let device = device();
    let scratch = Loss::new(&device, 64, 48).unwrap();
    let mut worst = (0_f64, 0_f64);
    for (n, size) in SIZES.into_iter().enumerate() {
        for weights in [Weights::default(), WITH_SQUARES, SSIM_ALONE, Weights { l1: 0.0, ssim: 0.0, l2: 1.0 }] {
            let [opaque, alpha] = [AlphaRole::Opaque, AlphaRole::Alpha];
            for (alpha_role, background) in [(opaque, [0.3, 0.6, 0.9]), (alpha, [0.3, 0.6, 0.9]), (alpha, [1.0; 3])] {
                let case = Case { alpha_role, background, weights, ..Case::noise(size, 1.2, n as u64) };
                let [value, gradient] = case.errors(&device, &scratch).unwrap();
                worst = (worst.0.max(value), worst.1.max(gradient));
                let told = format!("{size:?} {weights:?} {alpha_role:?}: value {value:.1e}, gradient {gradient:.1e}");
                assert!(value < 1e-5 && gradient < 1e-4, "{told}");
            }
        }
    }
    println!("worst: value {:.1e}, gradient {:.1e}", worst.0, worst.1);
    finish(&device);
}

/// Smooth and nearly equal pictures, as at the end of training: variances are small relative to the squared means.
#[test]
fn smooth_pictures() {
    let device = device();
    let size = [45, 37];
    let scratch = Loss::new(&device, 45, 37).unwrap();
    let mut r = Random(5);
    for (base, apart) in [(0.5, 0.02), (0.9, 0.02), (0.2, 0.1)] {
        let at = |n: u32| base + 0.08 * (f64::from(n % 45) / 7.0).sin() * (f64::from(n / 45) / 5.0).cos();
        let photo: Vec<[u8; 4]> = (0..45 * 37).map(|n| [(at(n) * 255.0) as u8; 4]).collect();
        let image: Vec<[f32; 4]> =
            (0..45 * 37).map(|n| [0; 4].map(|_| (at(n) + r.within(-apart, apart)) as f32)).collect();
        let case = Case { size, image, photo, ..Case::default() };
        let [value, gradient] = case.errors(&device, &scratch).unwrap();
        println!("smooth at {base}: value {value:.1e}, gradient {gradient:.1e}");
        assert!(value < 1e-4 && gradient < 1e-4, "smooth at {base}: value {value:.1e}, gradient {gradient:.1e}");
    }
    finish(&device);
}

/// With tiles, more of them than a dispatch has groups in one dimension.
#[test]
fn a_picture_of_a_million_columns() {
    let device = device();
    // Without tiles there are never so many groups: a quarter of the columns are enough.
    let size = [if device.tuning().loss_tile == 0 { 262_161 } else { 1_048_592 }, 1];
    let scratch = Loss::new(&device, size[0], size[1]).unwrap();
    let [value, gradient] = Case::noise(size, 1.2, 12).errors(&device, &scratch).unwrap();
    println!("value {value:.1e}, gradient {gradient:.1e}");
    assert!(value < 1e-5 && gradient < 1e-4, "value {value:.1e}, gradient {gradient:.1e}");
    finish(&device);
}

/// Radiance has no upper bound: if float32 cannot distinguish a variance from zero, results stay finite and SSIM within
/// its range.
#[test]
fn glaring_pictures_stay_finite() {
    let device = device();
    let scratch = Loss::new(&device, 45, 37).unwrap();
    for glare in [30.0, 73.0, 111.0, 157.0, 203.0, 331.0, 1e3, 1e6, 1e9] {
        for flat in [false, true] {
            let mut case = Case { weights: SSIM_ALONE, ..Case::noise([45, 37], 1.2, 9) };
            for p in &mut case.image {
                *p = p.map(|v| if flat { glare } else { v * glare });
            }
            let (value, gradient) = case.computed(&device, &scratch).unwrap();
            assert!(gradient.as_flattened().iter().all(|g| g.is_finite()), "{glare}, flat {flat}");
            // 1 - SSIM lies in [0, 2].
            assert!((-1e-3..2.001).contains(&value), "{glare}, flat {flat}: {value}");
            let steepest = gradient.as_flattened().iter().fold(0_f32, |m, g| m.max(g.abs()));
            let right = case.expected().0;
            println!("{glare}, flat {flat}: value {value}, twin's {right}, steepest {steepest:.1e}");
        }
    }
    // No variance is negative in float32 either: no denominator falls below its constant.
    for n in 0..150_u8 {
        let glare = 20.0 * 1.04_f32.powi(n.into());
        let case = Case { weights: SSIM_ALONE, ..Case::flat([11, 3], glare, n) };
        let (value, gradient) = case.computed(&device, &scratch).unwrap();
        let steepest = gradient.as_flattened().iter().fold(0_f32, |m, g| m.max(g.abs()));
        assert!((0.5..1.001).contains(&value) && steepest < 1e-2, "{glare} everywhere: {value}, {steepest:.1e}");
    }
    finish(&device);
}
