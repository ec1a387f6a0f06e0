//! Lenses: undoing every model's distortion, and ideal pinholes that the photo covers.

use glam::DVec2;
use qirf_vk::scene::lens::{Lens, LensModel};

use crate::support::files::writers::parameters;

fn lens(model: LensModel) -> Lens {
    Lens::from_colmap(model, 640, 480, &parameters(model)).unwrap()
}

#[test]
fn undistort_is_the_inverse_of_distort() {
    for model in LensModel::ALL {
        let lens = lens(model);
        let mut worst = 0.0_f64;
        for j in 0..=60 {
            for i in 0..=80 {
                let point = (DVec2::new(f64::from(i) * 8.0, f64::from(j) * 8.0) - lens.principal) / lens.focal;
                let back = lens.undistort(lens.distort(point)).unwrap_or(DVec2::INFINITY);
                worst = worst.max((back - point).length());
                // And in the other direction: each pixel of the photo.
                if let Some(point) = lens.undistort(point) {
                    let pixel = lens.project(point);
                    worst = worst.max((pixel - DVec2::new(f64::from(i) * 8.0, f64::from(j) * 8.0)).length() / 1e3);
                }
            }
        }
        println!("{}: {worst:.1e}, moves up to {:.2} px", model.name(), lens.max_displacement());
        assert!(worst < 1e-9, "{}: {worst}", model.name());
    }
}

#[test]
fn opencv_values_agree_with_the_formula_by_hand() {
    // k1 = 0.1, k2 = 0.01, p1 = 0.002, p2 = -0.003 at (0.5, 0.25): r2 = 0.3125.
    let p = [1.0, 1.0, 0.0, 0.0, 0.1, 0.01, 0.002, -0.003];
    let lens = Lens::from_colmap(LensModel::OpenCv, 4, 4, &p).unwrap();
    let radial = 1.0 + 0.1 * 0.3125 + 0.01 * 0.3125 * 0.3125;
    let x = 0.5 * radial + 2.0 * 0.002 * 0.125 - 0.003 * (0.3125 + 0.5);
    let y = 0.25 * radial - 2.0 * 0.003 * 0.125 + 0.002 * (0.3125 + 0.125);
    assert!((lens.distort(DVec2::new(0.5, 0.25)) - DVec2::new(x, y)).length() < 1e-15);
    // The equidistant fisheye maps a ray at 45 degrees to radius pi / 4.
    let fisheye = Lens::from_colmap(LensModel::OpenCvFisheye, 4, 4, &[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    assert!((fisheye.distort(DVec2::X).x - std::f64::consts::FRAC_PI_4).abs() < 1e-15);
}

/// Lenses that fold between the middle of the picture's edges and its corners: the rays of corners have mirror images behind the fold.
#[test]
fn lenses_that_fold_in_the_corners_alone_are_undone() {
    let lens = |model, bends: &[f64]| {
        let [width, height] = [200, 150];
        Lens::from_colmap(model, width, height, &[&[150.0, 100.0, 75.0], bends].concat()).unwrap()
    };
    for (bends, focal) in [([-0.25, 0.0], 139.3), ([-0.3, 0.0], 136.6), ([-0.3, 0.02], 136.9), ([-0.4, 0.05], 131.5)] {
        let lens = lens(LensModel::Radial, &bends);
        let ideal = lens.ideal().expect("most of the photo is not folded");
        assert!((ideal.focal.x - focal).abs() < 0.1, "{bends:?}: {}", ideal.focal.x);
        let corner = lens.undistort((DVec2::splat(0.5) - lens.principal) / lens.focal);
        assert!(corner.is_none_or(|ray| ray.x < 0.0 && ray.y < 0.0), "{bends:?}: {corner:?}");
    }
    for bend in [-0.3, -0.33, -0.34, -0.35] {
        assert!(lens(LensModel::SimpleRadial, &[bend]).ideal().is_some(), "{bend}");
    }
}

#[test]
fn ideal_pinholes_show_nothing_beyond_the_photo() {
    for model in LensModel::ALL {
        let lens = lens(model);
        let ideal = lens.ideal().unwrap();
        for y in 0..480 {
            for x in 0..640 {
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let source = lens.project((pixel - ideal.principal) / ideal.focal);
                let inside =
                    source.cmpge(DVec2::splat(0.499)).all() && source.cmple(DVec2::new(639.501, 479.501)).all();
                assert!(inside, "{} pixel {pixel} comes from {source}", model.name());
            }
        }
        let zoom = ideal.focal / lens.focal;
        assert!((zoom.x - zoom.y).abs() < 1e-12);
        println!("{}: zoom {:.3}, principal point {:.1}", model.name(), zoom.x, ideal.principal);
    }
    let pinhole = lens(LensModel::Pinhole);
    let ideal = pinhole.ideal().unwrap();
    assert!((ideal.focal - pinhole.focal).length() < 1e-9 && (ideal.principal - pinhole.principal).length() < 1e-9);
    assert_eq!(pinhole.max_displacement(), 0.0);
}

/// A pinhole of the same intrinsics shows more than this lens, whose photo is sound.
#[test]
fn displacements_are_finite_where_every_pixel_shows_a_ray() {
    let lens = Lens::from_colmap(LensModel::SimpleDivision, 161, 119, &[60.0, 80.5, 59.5, 0.3]).unwrap();
    let moved = lens.max_displacement();
    assert!((45.0..60.0).contains(&moved), "{moved}");
}

#[test]
fn extreme_lenses_give_an_ideal_or_none() {
    for (width, height) in [(1, 1), (17, 3), (3, 1000), (4096, 16)] {
        for model in LensModel::ALL {
            for scale in [1e-3, 0.1, 1.0, 30.0] {
                let mut p = parameters(model);
                let lengths = if model.parameters() < 6 && model != LensModel::Pinhole { 3 } else { 4 };
                p.iter_mut().skip(lengths).for_each(|c| *c *= scale);
                let lens = Lens::from_colmap(model, width, height, &p).unwrap();
                if let Some(ideal) = lens.ideal() {
                    assert!(ideal.focal.is_finite() && ideal.focal.min_element() > 0.0 && ideal.principal.is_finite());
                }
                assert!(lens.max_displacement() >= 0.0);
            }
        }
    }
}

/// The models that COLMAP added, and FOV, at a point by hand: u = 0.6, v = -0.3, so r2 = 0.45.
#[test]
fn newer_models_agree_with_their_formulas_by_hand() {
    let (point, r2) = (DVec2::new(0.6, -0.3), 0.45_f64);
    let r = r2.sqrt();
    let of = |model: LensModel, rest: &[f64]| {
        let single = matches!(model, LensModel::SimpleDivision | LensModel::SimpleFisheye);
        let lengths: &[f64] = if single { &[1.0, 0.0, 0.0] } else { &[1.0, 1.0, 0.0, 0.0] };
        Lens::from_colmap(model, 4, 4, &[lengths, rest].concat()).unwrap().distort(point)
    };
    let scaled = |factor: f64| point * factor;
    let mut wanted = vec![
        (of(LensModel::Fov, &[0.8]), scaled((2.0 * r * 0.4_f64.tan()).atan() / (r * 0.8))),
        (of(LensModel::SimpleDivision, &[-0.3]), scaled(2.0 / (1.0 + (1.0 + 4.0 * r2 * 0.3).sqrt()))),
        (of(LensModel::Division, &[0.2]), scaled(2.0 / (1.0 + (1.0 - 4.0 * r2 * 0.2).sqrt()))),
        (of(LensModel::SimpleFisheye, &[]), scaled(r.atan() / r)),
        (of(LensModel::Fisheye, &[]), scaled(r.atan() / r)),
        (of(LensModel::Eucm, &[0.6, 1.2]), scaled(1.0 / (0.6 * (1.2 * r2 + 1.0).sqrt() + 0.4))),
    ];
    let coefficients = [0.1, -0.02, 0.003, 0.001, -0.0004, 0.0002, 0.01, -0.02, 0.003, 0.004, -0.005, 0.006];
    let w = scaled(r.atan() / r);
    let radial = 1.0 + (0..6).map(|i| coefficients[i] * w.length_squared().powi(i as i32 + 1)).sum::<f64>();
    let (x, y) = (w.x * radial, w.y * radial);
    let (s, [p0, p1, s0, s1, s2, s3]) = (x * x + y * y, [0.01, -0.02, 0.003, 0.004, -0.005, 0.006]);
    let bent = DVec2::new(
        x + 2.0 * p1 * x * y + p0 * (s + 2.0 * x * x) + s0 * s + s1 * s * s,
        y + 2.0 * p0 * x * y + p1 * (s + 2.0 * y * y) + s2 * s + s3 * s * s,
    );
    wanted.push((of(LensModel::RadTanThinPrismFisheye, &coefficients), bent));
    for (i, (found, right)) in wanted.into_iter().enumerate() {
        assert!((found - right).length() < 1e-14, "{i}: {found} {right}");
    }
}
