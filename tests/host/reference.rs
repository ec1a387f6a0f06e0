//! The float64 twin against golden cases, another engine's gradients, finite differences, and the hard cases.

use crate::support::golden::{Case, Fixture, Loss};
use crate::support::synthetic::{difference_quotients, one, random_scene, small_camera};
use crate::support::{Random, greatest_difference, relative};
use glam::{DVec2, DVec3};
use qirf_vk::{
    reference::{
        Params, Settings,
        bin::{Tiles, depth_order},
        gradients, loss, poses,
        project::{Culled, Geometry, geometry},
        rasterise::{rasterise, sample},
        rasterise_backward::SlotSums,
        render,
    },
    scene::camera::Camera,
};

/// SH bands one after the other, as the oracle stores them: n x (L + 1)^2 x 3.
fn interleaved_sh(params: &Params) -> Vec<f64> {
    let mut all = Vec::new();
    for i in 0..params.len() {
        for (l, band) in params.sh.iter().enumerate() {
            let width = (2 * l + 1) * 3;
            all.extend_from_slice(&band[i * width..(i + 1) * width]);
        }
    }
    all
}

#[test]
fn golden_cases() {
    for case in Case::all() {
        let params = Params::from(&case.model);
        let (mut sum, mut contribution) = (params.zeros_like(), vec![0.0; params.len()]);
        let (mut image_error, mut alpha_error, mut loss_value) = (0f64, 0f64, 0.0);
        for (v, camera) in case.views.iter().enumerate() {
            let out = render(&params, camera, &case.settings).composite;
            let expected = case.expected_view("images", v);
            image_error = image_error.max(greatest_difference(out.image.as_flattened(), &expected));
            alpha_error = alpha_error.max(greatest_difference(&out.alpha, &case.expected_view("alphas", v)));
            let weights = case.expected_view("loss_weights", v);
            loss_value += out.image.as_flattened().iter().zip(&weights).map(|(a, b)| a * b).sum::<f64>();
            contribution.iter_mut().zip(&out.contribution).for_each(|(a, b)| *a += b);
            let by_image: Vec<[f64; 3]> = weights.chunks_exact(3).map(|w| [w[0], w[1], w[2]]).collect();
            let gradients = gradients(&params, camera, &case.settings, &by_image, None);
            for (m, c) in gradients.sums.iter().zip(&out.contribution) {
                assert!((m.contribution - c).abs() <= 1e-12 * c.abs(), "both passes sum the same contribution");
            }
            sum.add(&gradients.params);
        }
        let loss_error = (loss_value / case.expected("loss")[0] - 1.0).abs();
        let errors = [
            ("contribution", relative(&contribution, &case.expected("contribution"))),
            ("xyz", relative(sum.means.as_flattened(), &case.expected("grad_xyz"))),
            ("scale", relative(sum.log_scales.as_flattened(), &case.expected("grad_scale"))),
            ("rotation", relative(sum.rotations.as_flattened(), &case.expected("grad_rotation"))),
            ("opacity", relative(&sum.opacity_logits, &case.expected("grad_opacity"))),
            ("sh", relative(&interleaved_sh(&sum), &case.expected("grad_sh"))),
        ];
        println!("{}: image {image_error:.1e} alpha {alpha_error:.1e} loss {loss_error:.1e}", case.name);
        println!("    {}", errors.map(|(name, e)| format!("{name} {e:.1e}")).join("  "));
        // Half a unit in float32's last place, at values up to about 2, bounds the precision of the stored arrays.
        assert!(image_error < 1.5e-7 && alpha_error < 1e-7 && loss_error < 1e-6, "{}", case.name);
        assert!(errors.iter().all(|(_, e)| *e < 1e-7), "{}", case.name);
    }
}

#[test]
fn another_engines_gradients() {
    for (name, fixture) in Fixture::all() {
        agrees_with_another_engine(name, &fixture);
    }
}

fn agrees_with_another_engine(name: &str, fixture: &Fixture) {
    let (params, camera) = (Params::from(&fixture.model), &fixture.camera);
    let get = |key: &str| fixture.get(key);
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let settings = Settings { near: 0.01, direction_gradient: false, ..Settings::default() };

    let out = render(&params, camera, &settings);
    let rgba = get("out_img");
    let image: Vec<f64> = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let alpha: Vec<f64> = rgba.chunks_exact(4).map(|p| p[3]).collect();
    let seen: Vec<_> = out.projected.iter().map(|p| p.expect("visible")).collect();
    let xys: Vec<f64> = seen.iter().flat_map(|p| p.mean.to_array()).collect();
    let conics: Vec<f64> = seen.iter().flat_map(|p| p.conic).collect();

    let by_rgba = get("v_out_img");
    let by_image: Vec<[f64; 3]> = by_rgba.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect();
    let by_alpha: Vec<f64> = by_rgba.chunks_exact(4).map(|p| p[3]).collect();
    let g = gradients(&params, camera, &settings, &by_image, Some(&by_alpha));
    let by_mean: Vec<f64> = g.mean2d_ndc.iter().flat_map(|v| [v[0] / (0.5 * size.x), v[1] / (0.5 * size.y)]).collect();
    let by_conic: Vec<f64> = g.sums.iter().flat_map(SlotSums::conic).collect();
    let errors = [
        ("image", greatest_difference(out.composite.image.as_flattened(), &image)),
        ("alpha", greatest_difference(&out.composite.alpha, &alpha)),
        ("xys", relative(&xys, get("xys"))),
        ("conics", relative(&conics, get("conics"))),
        ("v_xy", relative(&by_mean, get("v_xy"))),
        ("v_conics", relative(&by_conic, get("v_conics"))),
        ("v_means", relative(g.params.means.as_flattened(), get("v_means"))),
        ("v_scales", relative(g.params.log_scales.as_flattened(), get("v_scales"))),
        ("v_quats", relative(g.params.rotations.as_flattened(), get("v_quats"))),
        ("v_opacities", relative(&g.params.opacity_logits, get("v_opacities"))),
        ("v_coeffs", relative(&interleaved_sh(&g.params), get("v_coeffs"))),
    ];
    println!("{name}: {}", errors.map(|(key, e)| format!("{key} {e:.1e}")).join("  "));
    assert!(errors.iter().all(|(_, e)| *e < 1e-4), "{name}");
}

#[test]
fn the_golden_loss() {
    let golden = Loss::read();
    let truth: Vec<[f64; 3]> = golden.truth.iter().map(|p| p.map(|byte| f64::from(byte) / 255.0)).collect();
    let got = loss::loss(&golden.rendered, &truth, golden.size[0] as usize, golden.ssim_weight);
    for (name, value, right) in
        [("l1", got.l1, golden.l1), ("ssim", got.ssim, golden.ssim), ("loss", got.value, golden.value)]
    {
        assert!((value - right).abs() < 1e-14, "{name}: {value} for {right}");
    }
    let error = relative(got.gradient.as_flattened(), golden.gradient.as_flattened());
    assert!(error < 1e-13, "gradient {error:e}");
}

/// Asserts that each group agrees in norm, and each element to the same fraction of the group's greatest value.
fn assert_agree(label: &str, analytic: &Params, quotients: &Params, tolerance: f64) {
    let (mut analytic, mut quotients) = (analytic.clone(), quotients.clone());
    let mut report = Vec::new();
    for ((name, a), (_, q)) in analytic.groups_mut().into_iter().zip(quotients.groups_mut()) {
        let error = relative(a, q);
        let worst = greatest_difference(a, q) / q.iter().fold(f64::MIN_POSITIVE, |m: f64, v| m.max(v.abs()));
        report.push(format!("{name} {error:.1e} ({worst:.1e})"));
        assert!(error < tolerance && worst < tolerance, "{label}: {name} {error:e}, worst {worst:e}");
    }
    println!("{label}: {}", report.join("  "));
}

#[test]
fn gradients_are_difference_quotients() {
    let camera = small_camera(16, 16);
    let pixels = 16 * 16;
    // Seeds whose kinks (alpha at 0.99) and depth ties are further away than the steps: 1 and 5 need steps of 2e-6.
    for (seed, antialias, dilation, sh_degree) in [(3, false, 0.3, 3), (2, true, 0.3, 3), (4, true, 0.1, 1)] {
        let params = random_scene(&camera, seed);
        let background = [0.3, 0.7, 0.1];
        let settings =
            Settings { background, antialias, dilation, sh_degree, smooth_cutoff: true, ..Settings::default() };
        let mut random = Random(seed + 100);
        let by_image: Vec<[f64; 3]> = (0..pixels).map(|_| [0; 3].map(|_| random.within(-1.0, 1.0))).collect();
        let by_alpha: Vec<f64> = (0..pixels).map(|_| random.within(-1.0, 1.0)).collect();

        // The scene takes every branch in which a derivative could be wrong.
        let all: Vec<_> =
            (0..params.len()).map(|i| geometry(&params, i, &camera, &settings).expect("in view")).collect();
        for free in [[false, true], [true, false], [false, false]] {
            assert!(all.iter().any(|g| g.free == free), "no Jacobian clamped as {free:?}");
        }
        assert!(all.iter().any(|g| !g.factor_free) && all.iter().any(|g| g.factor_free), "anti-aliasing floor");
        assert!(all.iter().any(|g| g.raw_colour.min_element() < 0.0), "no clamped colour");
        let at = |g: &Geometry| (g.projected.mean.x as u32, g.projected.mean.y as u32);
        let opaque = |g: &Geometry| sample(&g.projected, at(g).0, at(g).1, &settings).is_some_and(|s| s.clamped);
        assert!(all.iter().any(opaque), "no clamped alpha");

        let analytic = gradients(&params, &camera, &settings, &by_image, Some(&by_alpha));
        let quotients = difference_quotients(&params, 1e-4, |p| {
            let out = render(p, &camera, &settings).composite;
            let colours = out.image.as_flattened().iter().zip(by_image.as_flattened()).map(|(a, b)| a * b).sum::<f64>();
            colours + out.alpha.iter().zip(&by_alpha).map(|(a, b)| a * b).sum::<f64>()
        });
        assert_agree(&format!("antialias {antialias}, SH {sh_degree}"), &analytic.params, &quotients, 1e-8);
    }
}

/// The image mean's gradient, and the part through the view direction alone.
#[test]
fn mean_gradient_without_the_direction() {
    let camera = small_camera(32, 24);
    let params = random_scene(&camera, 9);
    let full = Settings { smooth_cutoff: true, ..Settings::default() };
    let part = Settings { direction_gradient: false, ..full.clone() };
    let by_image = vec![[0.5, -1.0, 2.0]; 32 * 24];
    let (a, b) =
        (gradients(&params, &camera, &full, &by_image, None), gradients(&params, &camera, &part, &by_image, None));
    assert_ne!(a.params.means, b.params.means);
    assert_eq!(a.params.rotations, b.params.rotations);
    for i in 0..params.len() {
        // The difference is tangential: moving along the ray does not change the direction.
        let along = DVec3::from(params.means[i]) - camera.centre();
        let difference = DVec3::from(a.params.means[i]) - DVec3::from(b.params.means[i]);
        assert!(along.dot(difference).abs() <= 1e-12 * along.length() * (1.0 + difference.length()));
        assert_eq!(a.mean2d_ndc[i], b.mean2d_ndc[i]);
    }
    // A shift of the principal point moves every image mean equally: an independent check of mean2d_ndc.
    let sum = |camera: &Camera| {
        let image = render(&params, camera, &full).composite.image;
        image.iter().zip(&by_image).map(|(a, b)| a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).sum::<f64>()
    };
    for axis in [DVec2::X, DVec2::Y] {
        let moved = |h: f64| Camera { principal: camera.principal + h * axis, ..camera.clone() };
        let quotient =
            (8.0 * (sum(&moved(1e-3)) - sum(&moved(-1e-3))) - (sum(&moved(2e-3)) - sum(&moved(-2e-3)))) / 12e-3;
        let half = 0.5 * DVec2::new(32.0, 24.0);
        let analytic: f64 = a.mean2d_ndc.iter().map(|g| (DVec2::from(*g) / half).dot(axis)).sum();
        assert!((quotient / analytic - 1.0).abs() < 1e-8, "{axis}: {quotient} against {analytic}");
    }
}

/// A camera's motion moves all that it sees: the sums over Gaussians are the difference quotients.
#[test]
fn gradients_by_the_pose() {
    let camera = small_camera(32, 24);
    for sh_degree in [0, 2, 3] {
        let params = random_scene(&camera, 9);
        let settings = Settings { sh_degree, smooth_cutoff: true, ..Settings::default() };
        let by_image = vec![[0.5, -1.0, 2.0]; 32 * 24];
        let by_params = gradients(&params, &camera, &settings, &by_image, None).params;
        let analytic = poses::gradient(&params, &by_params, camera.centre(), sh_degree);
        for k in 0..6 {
            let value = |h: f64| {
                let [turn, shift] =
                    [0, 3].map(|first| DVec3::from([0, 1, 2].map(|c| if first + c == k { h } else { 0.0 })));
                let image = render(&params, &camera.moved(turn, shift), &settings).composite.image;
                image.iter().zip(&by_image).map(|(a, b)| a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).sum::<f64>()
            };
            let h = 1e-5;
            let quotient = (8.0 * (value(h) - value(-h)) - (value(2.0 * h) - value(-2.0 * h))) / (12.0 * h);
            let scale = analytic.iter().fold(0.0_f64, |most, g| most.max(g.abs()));
            assert!((quotient - analytic[k]).abs() < 1e-6 * scale, "{sh_degree} {k}: {quotient} {}", analytic[k]);
        }
    }
}

/// Tiles and the exact extent only skip pairs: every Gaussian against every pixel gives the same bits.
#[test]
fn tiles_change_nothing() {
    for (width, height, seed) in [(50, 37, 1), (17, 3, 2), (1, 1, 3), (64, 64, 4)] {
        let camera = small_camera(width, height);
        let params = random_scene(&camera, seed);
        let settings = Settings { background: [0.1, 0.2, 0.3], antialias: seed % 2 == 0, ..Settings::default() };
        let out = render(&params, &camera, &settings);
        let order = depth_order(&out.projected);
        let count = out.tiles.offsets.len() - 1;
        let every = Tiles {
            offsets: (0..=count).map(|t| t * order.len()).collect(),
            gaussians: order.repeat(count),
            ..out.tiles.clone()
        };
        assert_eq!(out.composite, rasterise(&out.projected, &every, &camera, &settings));
        assert!(out.tiles.gaussians.len() < every.gaussians.len(), "something was skipped");
        assert_eq!(out, render(&params, &camera, &settings), "two runs are bit-identical");
    }
}

fn all_finite(params: &Params) -> bool {
    params.clone().groups_mut().iter().all(|(_, values)| values.iter().all(|v| v.is_finite()))
}

/// Renders and differentiates; everything must be finite. Returns the first Gaussian's reason for culling, if any, and
/// the gradients.
fn survive(params: &Params, camera: &Camera, label: &str) -> (Option<Culled>, Params) {
    let mut fate = None;
    let mut last = params.zeros_like();
    for antialias in [true, false] {
        let settings = Settings { antialias, ..Settings::default() };
        let out = render(params, camera, &settings);
        assert!(out.composite.image.as_flattened().iter().all(|v| v.is_finite()), "{label}: image");
        assert!(out.composite.alpha.iter().all(|v| (0.0..=1.0).contains(v)), "{label}: alpha");
        let count = out.composite.alpha.len();
        let g = gradients(params, camera, &settings, &vec![[1.0, -2.0, 0.5]; count], Some(&vec![0.3; count]));
        assert!(
            all_finite(&g.params) && g.mean2d_ndc.as_flattened().iter().all(|v| v.is_finite()),
            "{label}: gradients"
        );
        fate = out.projected[0].err();
        last = g.params;
    }
    (fate, last)
}

#[test]
fn hard_positions() {
    let camera = small_camera(32, 32);
    for (z, culled) in [(-3.0, true), (0.0, true), (0.199999, true), (0.2001, false), (1.0, false), (1e6, false)] {
        let (fate, _) = survive(&one(&camera, DVec3::new(0.01 * z, 0.0, z)), &camera, &format!("z {z}"));
        assert_eq!(fate, culled.then_some(Culled::Near), "z {z}");
    }
    survive(&one(&camera, DVec3::new(1e6, -1e6, 0.3)), &camera, "far off the image");
    for log_scale in
        [[20.0; 3], [-30.0; 3], [-30.0, 20.0, 0.0], [1e-6f64.ln(), 0.0, 0.0], [3.0; 3], [400.0; 3], [-800.0; 3]]
    {
        let mut params = one(&camera, DVec3::new(0.1, 0.1, 3.0));
        params.log_scales[0] = log_scale;
        survive(&params, &camera, &format!("log scales {log_scale:?}"));
    }
}

#[test]
fn hard_parameters() {
    let camera = small_camera(32, 32);
    let plain = one(&camera, DVec3::new(0.1, 0.1, 3.0));
    let (fate, plain_gradient) = survive(&plain, &camera, "plain");
    assert_eq!(fate, None);

    for (factor, expected) in
        [(0.0, Some(Culled::Quaternion)), (1e-20, Some(Culled::Quaternion)), (1e20, None), (-1.0, None)]
    {
        let mut params = plain.clone();
        params.rotations[0] = plain.rotations[0].map(|v| v * factor);
        let (fate, gradient) = survive(&params, &camera, &format!("quaternion x {factor}"));
        assert_eq!(fate, expected, "quaternion x {factor}");
        if fate.is_none() {
            let scaled = gradient.rotations[0].map(|v| v * factor);
            assert!(relative(&scaled, &plain_gradient.rotations[0]) < 1e-12, "gradient goes as 1 / |q|");
            let radial: f64 = (0..4).map(|k| gradient.rotations[0][k] * plain.rotations[0][k]).sum();
            assert!(radial.abs() < 1e-12, "the quaternion's length has no gradient");
        }
    }
    for (logit, expected) in [
        (f64::NEG_INFINITY, Some(Culled::Faint)),
        (-5.6, Some(Culled::Faint)),
        (-5.5, None),
        (40.0, None),
        (f64::INFINITY, None),
        (f64::NAN, Some(Culled::NonFinite)),
    ] {
        let mut params = plain.clone();
        params.opacity_logits[0] = logit;
        let settings = Settings::default();
        assert_eq!(render(&params, &camera, &settings).projected[0].err(), expected, "logit {logit}");
        survive(&params, &camera, &format!("logit {logit}"));
        let alpha = render(&params, &camera, &settings).composite.alpha;
        assert!(alpha.iter().all(|a| *a <= 0.99), "logit {logit}");
    }
    for bad in [f64::NAN, f64::INFINITY] {
        for group in 0..3 {
            let mut params = plain.clone();
            params.groups_mut()[group].1[1] = bad;
            assert_eq!(survive(&params, &camera, "bad").0, Some(Culled::NonFinite), "group {group}");
        }
        let mut params = plain.clone();
        params.sh[2][4] = bad;
        assert_eq!(survive(&params, &camera, "bad SH").0, Some(Culled::NonFinite));
    }
}

/// 10,000 coincident Gaussians: ties stay in index order, opaque stacks stop, thin ones run through the whole chain.
#[test]
fn deep_pixels() {
    let camera = small_camera(3, 2);
    let single = one(&camera, DVec3::new(0.0, 0.0, 3.0));
    let n = 10_000;
    for (logit, smooth_cutoff) in [(40.0, false), (-4.0, false), (-3.0, true), (1.0, true)] {
        let params = Params {
            means: single.means.repeat(n),
            log_scales: single.log_scales.repeat(n),
            rotations: single.rotations.repeat(n),
            opacity_logits: vec![logit; n],
            sh: single.sh.iter().map(|band| band.repeat(n)).collect(),
        };
        let settings = Settings { smooth_cutoff, ..Settings::default() };
        let out = render(&params, &camera, &settings);
        assert!((0..out.tiles.list(0).len()).all(|k| out.tiles.list(0)[k] == k as u32), "index order");
        assert!(out.composite.contribution.is_sorted_by(|a, b| a >= b), "nearer ones contribute no less");
        let g = gradients(&params, &camera, &settings, &[[1.0, 0.5, -0.5]; 6], Some(&[1.0; 6]));
        assert!(all_finite(&g.params), "logit {logit}");
    }
}

#[test]
fn odd_image_sizes() {
    for (width, height) in [(1, 1), (17, 3), (4096, 16), (1_048_592, 1)] {
        let mut camera = small_camera(width, height);
        camera.focal = DVec2::splat(40.0);
        camera.principal = DVec2::new(f64::from(width) - 0.6, 0.5);
        survive(&one(&camera, DVec3::new(0.0, 0.0, 2.0)), &camera, &format!("{width} x {height}"));
        let out = render(&one(&camera, DVec3::new(0.0, 0.0, 2.0)), &camera, &Settings::default());
        assert!(out.composite.alpha[width as usize - 1] > 0.5, "the last pixel of the first row is covered");
    }
}
