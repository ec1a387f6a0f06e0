//! Fisheyes wider than a pinhole can show: cut into faces that lose nothing of the rim and show nothing beyond.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DVec2, DVec3};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{AlphaRole, LoadOptions, OpenOptions, Photo, Scene, load_photos};

use super::panorama::{colour, direction};
use crate::support::files::writers::{Model, write};

/// A lens that looks along z from the world's origin, by its own formula.
struct Wide {
    model: LensModel,
    size: [u32; 2],
    parameters: Vec<f64>,
    /// The radius over the focal length at which an angle from the axis is shown.
    radius: fn(f64) -> f64,
    /// The rays beyond this angle reach no pixel: the photo is black there.
    black: f64,
}

/// The angle that is shown at a radius, by bisection.
fn angle(radius: fn(f64) -> f64, shown: f64) -> f64 {
    let (mut low, mut high) = (0.0, PI);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if radius(middle) < shown { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

impl Wide {
    fn centre(&self) -> DVec2 {
        let at = if self.parameters.len() == 3 || self.model == LensModel::SimpleRadialFisheye { 1 } else { 2 };
        DVec2::new(self.parameters[at], self.parameters[at + 1])
    }

    fn pixel(&self, ray: DVec3) -> DVec2 {
        let shown = (self.radius)(ray.angle_between(DVec3::Z));
        self.centre() + ray.truncate().normalize_or_zero() * shown * self.parameters[0]
    }

    fn write(&self, root: &Path) {
        let [width, height] = self.size;
        let mut model = Model { cameras: Vec::new(), images: Vec::new(), points: Vec::new() };
        model.cameras.push((1, self.model, width.into(), height.into(), self.parameters.clone()));
        model.images.push((1, [1.0, 0.0, 0.0, 0.0], [0.0; 3], 1, "wide.png".to_owned(), 0));
        model.points = vec![([0.0, 0.0, 9.0], [9; 3], 0.5, vec![1]), ([2.4, 0.1, 1.0], [9; 3], 0.5, vec![1])];
        let picture = image::RgbImage::from_fn(width, height, |x, y| {
            let off = (DVec2::new(f64::from(x), f64::from(y)) + 0.5 - self.centre()) / self.parameters[0];
            let theta = angle(self.radius, off.length());
            let ray = (off.normalize_or_zero() * theta.sin()).extend(theta.cos());
            image::Rgb(if theta > self.black { [0; 3] } else { colour(ray).map(|v| v.round() as u8) })
        });
        std::fs::create_dir_all(root.join("images")).unwrap();
        picture.save(root.join("images/wide.png")).unwrap();
        write(&root.join("sparse/0"), model.binary());
    }

    /// The solid angle that the photo's pixels have, without black ones.
    fn field(&self) -> f64 {
        let mut own = 0.0;
        for n in 0..self.size[0] * self.size[1] {
            let off = DVec2::new(f64::from(n % self.size[0]), f64::from(n / self.size[0])) + 0.5 - self.centre();
            let (r, f) = (off.length() / self.parameters[0], self.parameters[0]);
            let theta = angle(self.radius, r);
            let nearest = angle(self.radius, self.centre().min_element() / f).max(0.5 * PI);
            let slope = (angle(self.radius, r + 1e-5) - angle(self.radius, r - 1e-5)) / 2e-5;
            own += if theta < nearest.min(self.black) { theta.sin() * slope / (r * f * f) } else { 0.0 };
        }
        own
    }
}

fn lenses() -> Vec<Wide> {
    let bent: fn(f64) -> f64 = |theta| theta * (1.0 - 0.03 * theta * theta + 0.004 * theta.powi(4));
    let unified: fn(f64) -> f64 =
        |theta| theta.sin() / (0.6 * (1.1 * theta.sin().powi(2) + theta.cos().powi(2)).sqrt() + 0.4 * theta.cos());
    let division: fn(f64) -> f64 = |theta| {
        let (r, z) = theta.sin_cos();
        2.0 * r / (z + (z * z + 1.2 * r * r).sqrt())
    };
    let field: fn(f64) -> f64 = |theta| (2.0 * theta.sin() * 0.5_f64.tan()).atan2(theta.cos());
    let circle = 190_f64.to_radians() / 2.0;
    let sharp = |model, size, parameters, radius: fn(f64) -> f64| Wide { model, size, parameters, radius, black: PI };
    // 190 degrees in a circle that touches the photo's sides; 150 by 100 degrees; others.
    let [round, flat] = [90.0 / bent(circle), 100.0 / 100_f64.to_radians()];
    let round = vec![round, round, 90.0, 90.0, -0.03, 0.004, 0.0, 0.0];
    // Circles within the photo, the second one cut above and below: the formula folds before the sides.
    let folding: fn(f64) -> f64 = |theta| theta * (1.0 - 0.07 * theta * theta);
    let later: fn(f64) -> f64 = |theta| theta * (1.0 - 0.05 * theta * theta);
    let [within, cut] = [(90.0, -0.07), (80.0, -0.05)].map(|(y, k)| vec![55.0, 55.0, 100.0, y, k, 0.0, 0.0, 0.0]);
    vec![
        Wide { black: 0.5 * PI, ..sharp(LensModel::OpenCvFisheye, [200, 180], within, folding) },
        Wide { black: 97_f64.to_radians(), ..sharp(LensModel::OpenCvFisheye, [200, 160], cut, later) },
        Wide { black: circle, ..sharp(LensModel::OpenCvFisheye, [180, 180], round, bent) },
        sharp(LensModel::SimpleFisheye, [150, 100], vec![flat, 75.0, 50.0], |theta| theta),
        sharp(LensModel::Eucm, [200, 120], vec![55.0, 55.0, 100.0, 60.0, 0.6, 1.1], unified),
        sharp(LensModel::Division, [200, 120], vec![60.0, 60.0, 100.0, 60.0, -0.3], division),
        sharp(LensModel::Fov, [200, 120], vec![60.0, 60.0, 100.0, 60.0, 1.0], field),
    ]
}

/// The direction of each pixel that counts, with the pixel and its solid angle.
fn rays(photo: &Photo) -> Vec<(DVec3, [u8; 4], f64)> {
    let pixels = photo.pixels.read().unwrap();
    let all = pixels.as_chunks::<4>().0.iter().enumerate();
    let counts = all.filter(|(_, p)| photo.alpha_role != AlphaRole::Mask || p[3] > 0);
    let with = counts.map(|(n, p)| {
        let ray = direction(photo, n);
        (ray, *p, ray.length().powi(-3) / photo.camera.focal.element_product())
    });
    with.collect()
}

#[test]
fn the_whole_field_is_shown_once() {
    for lens in lenses() {
        let name = lens.model.name();
        let folder = tempfile::tempdir().unwrap();
        lens.write(folder.path());
        let mut scene = Scene::open(folder.path(), &OpenOptions::default()).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        assert!(photos.len() >= 3, "{name} is cut into {} views", photos.len());
        let (mut solid, mut rim) = (0.0, 0.0_f64);
        for (photo, view) in photos.iter().zip(&scene.views) {
            for (ray, pixel, share) in rays(photo) {
                let at = lens.pixel(ray);
                // Near the rim, a pixel of the face has a part that is beyond, and a cubic of three pixels overshoots.
                let [width, height] = lens.size.map(f64::from);
                let border = at.min(DVec2::new(width, height) - at).min_element();
                let inner = border > 2.0 && ray.angle_between(DVec3::Z) < lens.black - 0.1;
                let off = colour(ray).iter().zip(pixel).map(|(a, b)| (a - f64::from(b)).abs()).fold(0.0, f64::max);
                assert!(!inner || off < 3.0, "{name} {}: {pixel:?} is not {:?} at {at}", view.name, colour(ray));
                assert!(border > -0.5, "{name} {}: {at} lies outside", view.name);
                solid += share;
                rim = rim.max(ray.angle_between(DVec3::Z));
            }
        }
        let own = lens.field();
        println!("{name}: {} views, {solid:.3} of {own:.3} sr, to {:.1} degrees", photos.len(), rim.to_degrees());
        assert!((solid / own - 1.0).abs() < 0.02, "{name}: {solid} of {own}");
        let track = |at: usize| scene.points[at].track.iter().map(|v| scene.views[*v as usize].name.as_str()).collect();
        let [ahead, aside]: [Vec<&str>; 2] = [track(0), track(1)];
        assert_eq!((ahead, aside), (vec!["wide.front.png"], vec!["wide.right.png"]), "{name}");
        assert_eq!(scene.views[scene.ahead(0)].name, "wide.front.png", "{name}");
    }
}

/// Photos with alpha hide what is beyond the rim and straight down, and what is transparent.
#[test]
fn alpha_leaves_the_rim_masked() {
    let folder = tempfile::tempdir().unwrap();
    lenses()[2].write(folder.path());
    let hidden = || {
        let mut scene = Scene::open(folder.path(), &OpenOptions { pole_mask: 20.0, ..OpenOptions::default() }).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        let count = |photo: &Photo| {
            assert_eq!(photo.alpha_role, AlphaRole::Mask);
            photo.pixels.read().unwrap().iter().skip(3).step_by(4).filter(|counts| **counts == 0).count()
        };
        photos.iter().map(count).sum::<usize>()
    };
    let opaque = hidden();
    let file = folder.path().join("images/wide.png");
    let mut picture = image::open(&file).unwrap().into_rgba8();
    picture.enumerate_pixels_mut().filter(|(_, y, _)| *y < 90).for_each(|(.., pixel)| pixel[3] = 0);
    picture.save(&file).unwrap();
    assert!(opaque > 200 && hidden() > opaque, "{opaque}, {}", hidden());
    // A task that sees one face has the same pixels, also of a face that hides nothing of itself.
    let mut scene = Scene::open(folder.path(), &OpenOptions::default()).unwrap();
    let whole = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    let alone = LoadOptions { alpha: Some(false), ..LoadOptions::default() };
    for (view, photo) in scene.views.iter().zip(&whole) {
        let of_task = load_photos(&[view], &alone, &|_| ()).unwrap().photos.remove(0).unwrap();
        assert!(*of_task.pixels.read().unwrap() == *photo.pixels.read().unwrap(), "{}", view.name);
    }
}

/// A view shows the points along the rays of the pixels that count.
#[test]
fn what_masks_hide_no_view_shows() {
    for lens in &lenses()[..3] {
        let folder = tempfile::tempdir().unwrap();
        lens.write(folder.path());
        let mut scene = Scene::open(folder.path(), &OpenOptions { pole_mask: 20.0, ..OpenOptions::default() }).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        for (photo, view) in photos.iter().zip(&mut scene.views) {
            let pixels = photo.pixels.read().unwrap();
            for (n, pixel) in pixels.as_chunks::<4>().0.iter().enumerate() {
                let shown = view.shows(4.0 * direction(photo, n));
                assert_eq!(shown, pixel[3] > 0, "{} {}: pixel {n}", lens.model.name(), view.name);
            }
            view.circle = Some(0.3);
            for (ray, ..) in rays(photo) {
                let off = lens.pixel(ray).distance(lens.centre()) - 0.3 * f64::from(lens.size[0]);
                assert!(off.abs() < 1e-6 || view.shows(4.0 * ray) == (off < 0.0), "{}: {off}", view.name);
            }
        }
    }
}

#[test]
fn what_a_pinhole_can_show_is_not_cut() {
    let folder = tempfile::tempdir().unwrap();
    let equidistant = |degrees: f64| Wide {
        model: LensModel::SimpleFisheye,
        size: [130, 80],
        parameters: vec![130.0 / degrees.to_radians(), 65.0, 40.0],
        radius: |theta| theta,
        black: PI,
    };
    equidistant(130.0).write(folder.path());
    let open = |undistort| {
        let options = OpenOptions { undistort, ..OpenOptions::default() };
        let scene = Scene::open(folder.path(), &options).unwrap();
        (scene.views.len(), scene.views[0].undistorts())
    };
    assert_eq!(open(None), (1, true));
    equidistant(140.0).write(folder.path());
    assert_eq!(open(None), (3, false));
    // As they are, if the user says so.
    assert_eq!(open(Some(false)), (1, false));
}
