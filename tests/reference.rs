//! The float64 twin against golden cases, another engine's gradients, finite differences, and the hard cases.

mod golden;

use glam::{DMat3, DVec2, DVec3};
use golden::{Case, floats, shared};
use qirf_vk::{
    reference::{
        Params, Settings,
        bin::{Tiles, bin, depth_order},
        gradients, loss,
        project::{Culled, project},
        rasterise::rasterise,
        render,
    },
    scene::camera::Camera,
};
use safetensors::SafeTensors;

/// |a - b| / |b| in the Euclidean norm.
fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    let size: f64 = b.iter().map(|b| b * b).sum();
    (difference / size.max(f64::MIN_POSITIVE)).sqrt()
}

fn greatest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

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
    let Some(shared) = shared() else { return };
    for case in Case::all(&shared) {
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
            for (m, c) in gradients.moments.iter().zip(&out.contribution) {
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
        // Half a unit in float32's last place, at values up to about 2, bounds what the stored arrays can say.
        assert!(image_error < 1.5e-7 && alpha_error < 1e-7 && loss_error < 1e-6, "{}", case.name);
        assert!(errors.iter().all(|(_, e)| *e < 1e-7), "{}", case.name);
    }
}

#[test]
fn another_engines_gradients() {
    let Some(shared) = shared() else { return };
    for name in ["tiny", "basic"] {
        let path = shared.join(format!("fixtures/gsplat-cuda-gradients/{name}_case.safetensors"));
        let bytes = std::fs::read(path).expect("fixture");
        let file = SafeTensors::deserialize(&bytes).expect("safetensors");
        let get = |key: &str| floats(file.tensor(key).expect(key).data());
        let rows3 = |key: &str| get(key).chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect::<Vec<_>>();
        let coefficients = get("coeffs");
        let n = coefficients.len() / 48;
        let band = |l: usize| {
            (0..n).flat_map(|i| coefficients[i * 48 + l * l * 3..i * 48 + (l + 1) * (l + 1) * 3].to_vec()).collect()
        };
        let params = Params {
            means: rows3("means"),
            log_scales: rows3("scales"),
            rotations: get("quats").chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect(),
            opacity_logits: get("opacities"),
            sh: (0..4).map(band).collect(),
        };
        let shape = file.tensor("out_img").expect("out_img").shape().to_vec();
        let (height, width) = (shape[0] as u32, shape[1] as u32);
        let size = DVec2::new(f64::from(width), f64::from(height));
        let camera = Camera {
            rotation: DMat3::IDENTITY,
            translation: -DVec3::new(0.123, 0.456, -8.0),
            focal: DVec2::splat(0.5 * size.x),
            principal: 0.5 * size,
            width,
            height,
        };
        let settings = Settings { near: 0.01, direction_gradient: false, ..Settings::default() };

        let out = render(&params, &camera, &settings);
        let rgba = get("out_img");
        let image: Vec<f64> = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        let alpha: Vec<f64> = rgba.chunks_exact(4).map(|p| p[3]).collect();
        let seen: Vec<_> = out.projected.iter().map(|p| p.expect("visible")).collect();
        let xys: Vec<f64> = seen.iter().flat_map(|p| p.mean.to_array()).collect();
        let conics: Vec<f64> = seen.iter().flat_map(|p| p.conic).collect();

        let by_rgba = get("v_out_img");
        let by_image: Vec<[f64; 3]> = by_rgba.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect();
        let by_alpha: Vec<f64> = by_rgba.chunks_exact(4).map(|p| p[3]).collect();
        let g = gradients(&params, &camera, &settings, &by_image, Some(&by_alpha));
        let by_mean: Vec<f64> =
            g.mean2d_ndc.iter().flat_map(|v| [v[0] / (0.5 * size.x), v[1] / (0.5 * size.y)]).collect();
        let by_conic: Vec<f64> = g.moments.iter().flat_map(|m| m.conic()).collect();
        let errors = [
            ("image", greatest_difference(out.composite.image.as_flattened(), &image)),
            ("alpha", greatest_difference(&out.composite.alpha, &alpha)),
            ("xys", relative(&xys, &get("xys"))),
            ("conics", relative(&conics, &get("conics"))),
            ("v_xy", relative(&by_mean, &get("v_xy"))),
            ("v_conics", relative(&by_conic, &get("v_conics"))),
            ("v_means", relative(g.params.means.as_flattened(), &get("v_means"))),
            ("v_scales", relative(g.params.log_scales.as_flattened(), &get("v_scales"))),
            ("v_quats", relative(g.params.rotations.as_flattened(), &get("v_quats"))),
            ("v_opacities", relative(&g.params.opacity_logits, &get("v_opacities"))),
            ("v_coeffs", relative(&interleaved_sh(&g.params), &get("v_coeffs"))),
        ];
        println!("{name}: {}", errors.map(|(key, e)| format!("{key} {e:.1e}")).join("  "));
        assert!(errors.iter().all(|(_, e)| *e < 1e-4), "{name}");
    }
}
