//! The loss kernel against the float64 twin: value and gradient.

use crate::support::{Random, device, finish, golden, relative};
use qirf_vk::gpu::{Device, Recording};
use qirf_vk::reference;
use qirf_vk::response::Target;
use qirf_vk::scene::AlphaRole;
use qirf_vk::train::loss::{Loss, Weights};

struct Case {
    name: String,
    size: [u32; 2],
    image: Vec<[f32; 4]>,
    photo: Vec<[u8; 4]>,
    alpha_role: AlphaRole,
    background: [f32; 3],
    weights: Weights,
}

/// Value (L1, SSIM and squares are left out); gradient by red, green, blue.
fn expected(case: &Case) -> (f64, Vec<[f64; 3]>) {
    let width = case.size[0] as usize;
    let x: Vec<[f64; 3]> = case.image.iter().map(|p| [p[0], p[1], p[2]].map(f64::from)).collect();
    let y: Vec<[f64; 3]> = case
        .photo
        .iter()
        .map(|p| {
            let opacity = if case.alpha_role.shows_background() { f64::from(p[3]) / 255.0 } else { 1.0 };
            std::array::from_fn(|c| f64::from(p[c]) / 255.0 * opacity + f64::from(case.background[c]) * (1.0 - opacity))
        })
        .collect();
    let (absolute, similar) = (reference::loss::loss(&x, &y, width, 0.0), reference::loss::loss(&x, &y, width, 1.0));
    let [l1, ssim, l2] = [case.weights.l1, case.weights.ssim, case.weights.l2].map(f64::from);
    let share = 1.0 / (3 * x.len()) as f64;
    let pairs = || x.as_flattened().iter().zip(y.as_flattened());
    let squares: f64 = pairs().map(|(x, y)| (x - y).powi(2) * share).sum();
    let gradient = (0..x.len())
        .map(|p| {
            std::array::from_fn(|c| {
                l1 * absolute.gradient[p][c] + ssim * similar.gradient[p][c] + 2.0 * l2 * share * (x[p][c] - y[p][c])
            })
        })
        .collect();
    (l1 * absolute.value + ssim * similar.value + l2 * squares, gradient)
}

fn computed(device: &Device, scratch: &Loss, case: &Case) -> (f32, Vec<[f32; 4]>) {
    let image = device.upload("image", &case.image).unwrap();
    let words: Vec<u32> = case.photo.iter().map(|p| u32::from_le_bytes(*p)).collect();
    let photo = device.upload("photo", &words).unwrap();
    let mut recording = Recording::new();
    let Case { size, alpha_role, background, .. } = *case;
    let target = Target { photo: &photo, size, alpha_role, background };
    scratch.record(&mut recording, &image, target, case.weights);
    scratch.record_value(&mut recording, case.size);
    device.run(recording).unwrap();
    let value = scratch.value(device, case.size, case.weights).unwrap();
    (value, scratch.gradient.read_first(device, case.image.len()).unwrap())
}

/// Errors of value and gradient, relative to the twin's; the gradient's norm counts as at least a tenth of an L1
/// gradient's, so that rounding at the optimum, where it vanishes, is not divided by zero.
fn errors(device: &Device, scratch: &Loss, case: &Case) -> (f64, f64) {
    let (value, gradient) = computed(device, scratch, case);
    let (right, slope) = expected(case);
    assert!(value.is_finite() && gradient.as_flattened().iter().all(|g| g.is_finite()), "{}", case.name);
    assert!(gradient.iter().all(|g| g[3] == 0.0), "{}: no term depends on alpha", case.name);
    let difference: f64 =
        gradient.iter().zip(&slope).flat_map(|(g, s)| (0..3).map(|c| (f64::from(g[c]) - s[c]).powi(2))).sum();
    let size: f64 = slope.as_flattened().iter().map(|s| s * s).sum();
    let floor = 0.1 / ((3 * gradient.len()) as f64).sqrt();
    ((f64::from(value) - right).abs() / right.abs().max(0.01), difference.sqrt() / size.sqrt().max(floor))
}

const SIZES: [[u32; 2]; 9] = [[1, 1], [11, 7], [45, 37], [8, 8], [64, 48], [17, 8], [8, 17], [3, 40], [40, 3]];
const BLACK: [f32; 3] = [0.0; 3];
const WITH_SQUARES: Weights = Weights { l1: 0.8, ssim: 0.2, l2: 2.0 };

fn noise(size: [u32; 2], seed: u64) -> (Vec<[f32; 4]>, Vec<[u8; 4]>) {
    let mut r = Random(seed);
    let count = (size[0] * size[1]) as usize;
    let image = (0..count).map(|_| [0; 4].map(|_| r.within(0.0, 1.2) as f32)).collect();
    (image, (0..count).map(|_| [0; 4].map(|_| r.within(0.0, 256.0) as u8)).collect())
}

#[test]
fn the_golden_loss() {
    let device = device();
    let golden = golden::Loss::read();
    let case = Case {
        name: "golden".into(),
        size: golden.size,
        image: golden.rendered.iter().map(|p| [p[0] as f32, p[1] as f32, p[2] as f32, 1.0]).collect(),
        photo: golden.truth.iter().map(|p| [p[0], p[1], p[2], 255]).collect(),
        alpha_role: AlphaRole::Opaque,
        background: BLACK,
        weights: Weights { l1: (1.0 - golden.ssim_weight) as f32, ssim: golden.ssim_weight as f32, l2: 0.0 },
    };
    let scratch = Loss::new(&device, golden.size[0], golden.size[1]).unwrap();
    let (value, gradient) = computed(&device, &scratch, &case);
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
        for weights in [
            Weights::default(),
            WITH_SQUARES,
            Weights { l1: 0.0, ssim: 1.0, l2: 0.0 },
            Weights { l1: 0.0, ssim: 0.0, l2: 1.0 },
        ] {
            let [opaque, alpha] = [AlphaRole::Opaque, AlphaRole::Alpha];
            for (alpha_role, background) in [(opaque, [0.3, 0.6, 0.9]), (alpha, [0.3, 0.6, 0.9]), (alpha, [1.0; 3])] {
                let (image, photo) = noise(size, n as u64);
                let name = format!("{size:?} {weights:?} {alpha_role:?}");
                let case = Case { name, size, image, photo, alpha_role, background, weights };
                let (value, gradient) = errors(&device, &scratch, &case);
                worst = (worst.0.max(value), worst.1.max(gradient));
                assert!(value < 1e-5 && gradient < 1e-4, "{}: value {value:.1e}, gradient {gradient:.1e}", case.name);
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
        let name = format!("smooth at {base}");
        let weights = Weights::default();
        let case = Case { name, size, image, photo, alpha_role: AlphaRole::Opaque, background: BLACK, weights };
        let (value, gradient) = errors(&device, &scratch, &case);
        println!("{}: value {value:.1e}, gradient {gradient:.1e}", case.name);
        assert!(value < 1e-4 && gradient < 1e-4, "{}: value {value:.1e}, gradient {gradient:.1e}", case.name);
    }
    finish(&device);
}

/// More tiles than a dispatch has groups in one dimension.
#[test]
fn a_picture_of_a_million_columns() {
    let device = device();
    let size = [1_048_592, 1];
    let scratch = Loss::new(&device, size[0], size[1]).unwrap();
    let (image, photo) = noise(size, 12);
    let (name, weights) = ("a million columns".into(), Weights::default());
    let case = Case { name, size, image, photo, alpha_role: AlphaRole::Opaque, background: BLACK, weights };
    let (value, gradient) = errors(&device, &scratch, &case);
    println!("value {value:.1e}, gradient {gradient:.1e}");
    assert!(value < 1e-5 && gradient < 1e-4, "value {value:.1e}, gradient {gradient:.1e}");
    finish(&device);
}

/// Constant pictures, equal, opposite, and brighter than any photo.
#[test]
fn flat_and_saturated_pictures() {
    let device = device();
    let scratch = Loss::new(&device, 64, 48).unwrap();
    for size in [[1, 1], [11, 11], [11, 3], [3, 40], [45, 37]] {
        let count = (size[0] * size[1]) as usize;
        for (x, y) in [(0.0, 0), (1.0, 255), (0.0, 255), (1.0, 0), (0.5, 128), (0.25, 192), (3.0, 255), (1.0, 200)] {
            let name = format!("{size:?}: {x} against {y}");
            let (image, photo) = (vec![[x; 4]; count], vec![[y; 4]; count]);
            let case = Case {
                name,
                size,
                image,
                photo,
                alpha_role: AlphaRole::Opaque,
                background: BLACK,
                weights: WITH_SQUARES,
            };
            let (value, gradient) = errors(&device, &scratch, &case);
            assert!(value < 1e-4 && gradient < 2e-4, "{}: value {value:.1e}, gradient {gradient:.1e}", case.name);
        }
    }
    finish(&device);
}

/// Radiance has no upper bound: if float32 cannot distinguish a variance from zero, results stay finite and SSIM within
/// its range.
#[test]
fn glaring_pictures_stay_finite() {
    let device = device();
    let size = [45, 37];
    let scratch = Loss::new(&device, 45, 37).unwrap();
    for glare in [30.0, 73.0, 111.0, 157.0, 203.0, 331.0, 1e3, 1e6, 1e9] {
        for flat in [false, true] {
            let (mut image, photo) = noise(size, 9);
            for p in &mut image {
                *p = p.map(|v| if flat { glare } else { v * glare });
            }
            let weights = Weights { l1: 0.0, ssim: 1.0, l2: 0.0 };
            let name = format!("{glare}, flat {flat}");
            let case = Case { name, size, image, photo, alpha_role: AlphaRole::Opaque, background: BLACK, weights };
            let (value, gradient) = computed(&device, &scratch, &case);
            assert!(gradient.as_flattened().iter().all(|g| g.is_finite()), "{}", case.name);
            // 1 - SSIM lies in [0, 2].
            assert!((-1e-3..2.001).contains(&value), "{}: {value}", case.name);
            let steepest = gradient.as_flattened().iter().fold(0_f32, |m, g| m.max(g.abs()));
            println!("{}: value {value}, twin's {}, steepest {steepest:.1e}", case.name, expected(&case).0);
        }
    }
    // No variance is negative in float32 either: no denominator falls below its constant.
    let size = [11, 3];
    for n in 0..150_u8 {
        let (glare, y) = (20.0 * 1.04_f32.powi(n.into()), n);
        let (image, photo) = (vec![[glare; 4]; 33], vec![[y; 4]; 33]);
        let weights = Weights { l1: 0.0, ssim: 1.0, l2: 0.0 };
        let name = format!("{glare} everywhere");
        let case = Case { name, size, image, photo, alpha_role: AlphaRole::Opaque, background: BLACK, weights };
        let (value, gradient) = computed(&device, &scratch, &case);
        let steepest = gradient.as_flattened().iter().fold(0_f32, |m, g| m.max(g.abs()));
        assert!((0.5..1.001).contains(&value) && steepest < 1e-2, "{}: {value}, {steepest:.1e}", case.name);
    }
    finish(&device);
}
