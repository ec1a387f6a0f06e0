//! Captures that could be read wrongly without a word: each has the right value, a note, or an error.

use std::fs;
use std::path::Path;

use super::dialects::{notes, open};
use super::{TOP, refused, transformed};
use crate::support::files::make;
use crate::support::files::writers::{picture, row, transforms, write, written};
use qirf_vk::gaussians::formats::{self, RenderMode};
use qirf_vk::glam::DVec3;
use qirf_vk::pipeline::{place, prepare};
use qirf_vk::scene::lens::{Lens, LensModel};
use qirf_vk::scene::{AlphaRole, LoadOptions, Photo};

const NAMES: [&str; 2] = ["images/a.png", "images/b.png"];

/// A capture of two photos with this transforms.json.
fn capture(json: impl Into<Vec<u8>>) -> tempfile::TempDir {
    transformed(json, &NAMES)
}

fn json(top: &str) -> String {
    String::from_utf8(transforms(top, &NAMES)).unwrap()
}

fn load(root: &Path) -> (Vec<Photo>, String) {
    let mut scene = open(root);
    let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    (photos, notes(&scene))
}

/// A picture of two bytes a pixel, grey and alpha.
pub fn grey(path: &Path, pixel: impl Fn(u32) -> [u8; 2]) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::GrayAlphaImage::from_fn(64, 48, |x, _| image::LumaA(pixel(x))).save(path).unwrap();
}

#[test]
fn masks_count_where_they_are_not_zero_also_in_small_numbers_and_in_alpha() {
    let half = |x: u32, v: u8| if x < 32 { v } else { 0 };
    for (file, pixel) in [
        ("masks/a.png", &(|x| [half(x, 255), 255]) as &dyn Fn(u32) -> [u8; 2]),
        ("masks/a.png", &|x| [half(x, 1), 255]),
        ("masks/a.png", &|x| [half(x, 7), 255]),
        ("masks/a.png", &|x| [half(x, 128), 255]),
        ("masks/a.png", &|x| [255, half(x, 255)]),
        ("masks/a.png", &|x| [0, half(x, 255)]),
        ("images/masks/a.png", &|x| [half(x, 255), 255]),
    ] {
        let scene = capture(json(TOP));
        grey(&scene.path().join(file), pixel);
        let (photos, _) = load(scene.path());
        assert_eq!(photos[0].alpha_role, AlphaRole::Mask);
        for (x, counts) in [(31, 255), (32, 0)] {
            assert_eq!(photos[0].pixels.at(x).unwrap()[3], counts, "{file} {:?}", pixel(0));
        }
        assert_eq!(photos[1].pixels.at(40).unwrap()[3], 255);
    }
    let scene = capture(json(TOP));
    grey(&scene.path().join("masks/a.png"), |_| [0, 255]);
    assert!(load(scene.path()).1.contains("1 photo hidden as a whole by their masks"));
    // Black alone is no label, also in a file of colours.
    let black = image::RgbaImage::from_fn(64, 48, |x, _| image::Rgba([0, 0, 0, half(x, 255)]));
    black.save(scene.path().join("masks/a.png")).unwrap();
    let photos = load(scene.path()).0;
    assert_eq!([31, 32].map(|x| photos[0].pixels.at(x).unwrap()[3]), [255, 0]);
}

#[test]
fn alpha_that_leaves_nothing_does_not_count_and_goes_before_masks() {
    let with = |alpha: u8| {
        let scene = capture(json(TOP));
        let pixel = |x: u32, _: u32| image::Rgba([200, 9, 9, if x < 32 { alpha } else { 0 }]);
        for name in NAMES {
            image::RgbaImage::from_fn(64, 48, pixel).save(scene.path().join(name)).unwrap();
        }
        scene
    };
    let (photos, told) = load(with(0).path());
    assert_eq!((photos[0].alpha_role, photos[0].pixels.at(0).unwrap()), (AlphaRole::Opaque, [200, 9, 9, 255]));
    assert!(told.contains("all of the photos' pixels are transparent"), "{told}");
    let scene = with(255);
    picture(&scene.path().join("masks/a.png"), 64, 48);
    let (photos, told) = load(scene.path());
    assert_eq!(photos[0].alpha_role, AlphaRole::Alpha);
    assert!(told.contains("their masks are not used"), "{told}");
}

#[test]
fn lenses_of_nerfstudio_and_instant_ngp_are_read_or_refused_by_name() {
    let lens = |top: &str| -> Lens { open(capture(json(top)).path()).views[0].lens };
    let named = lens(&format!(r#"{TOP}, "k1": 0.1, "k2": -0.02, "k3": 0.003, "k4": 0.001, "p1": 0.004, "p2": 0.005"#));
    assert_eq!(lens(&format!(r#"{TOP}, "distortion_params": [0.1, -0.02, 0.003, 0.001, 0.004, 0.005]"#)), named);
    let angles = lens(r#""x_fov": 60, "y_fov": 40, "w": 64, "h": 48"#);
    let focal = [32.0 / 30_f64.to_radians().tan(), 24.0 / 20_f64.to_radians().tan()];
    assert!((angles.focal.x - focal[0]).abs() < 1e-9 && (angles.focal.y - focal[1]).abs() < 1e-9);
    let around = TOP.replace("48", "32") + r#", "equirectangular": true"#;
    let around = open(capture(json(&around)).path());
    assert_eq!((around.views.len(), around.views[0].lens.model), (12, LensModel::Equirectangular));
    for (flag, name) in [(r#""latlong": true"#, "latlong"), (r#""ftheta_p0": 0.1"#, "ftheta")] {
        assert!(refused(capture(json(&format!("{TOP}, {flag}"))).path()).contains(name), "{name}");
    }
    // A frame's own focal length is that of both axes.
    let own = json(TOP).replacen("{\"file_path\"", "{\"fl_x\": 70, \"file_path\"", 1);
    assert_eq!(open(capture(own).path()).views[0].lens.focal.to_array(), [70.0, 70.0]);
}

/// Project Aria's lens is COLMAP's of another name, with its twelve coefficients in the same order, of the file or of a frame.
#[test]
fn fisheyes_of_project_aria_are_read() {
    let bends = [0.05, -0.02, 0.01, 0.001, 0.0, 0.0002, 0.002, -0.001, 0.001, 0.0003, -0.001, 0.0004];
    let wanted = [&[50.0, 51.0, 32.0, 24.0][..], &bends].concat();
    let wanted = Lens::from_colmap(LensModel::RadTanThinPrismFisheye, 64, 48, &wanted).unwrap();
    let lens = |json: String| -> Lens { open(capture(json).path()).views[0].lens };
    let bends = format!(r#""distortion_params": {bends:?}"#);
    for name in ["FISHEYE624", "RAD_TAN_THIN_PRISM_FISHEYE"] {
        let top = format!(r#"{TOP}, "camera_model": "{name}""#);
        assert_eq!(lens(json(&format!("{top}, {bends}"))), wanted, "{name}");
        let of_frames = json(&top).replace("{\"file_path\"", &format!("{{{bends}, \"file_path\""));
        assert_eq!(lens(of_frames), wanted, "{name}");
    }
}

/// Beside poses with OpenCV's axes, NeuS2 gives a matrix of intrinsics for each frame.
#[test]
fn axes_and_intrinsics_of_neus2_are_read_and_those_of_mitsuba_refused() {
    let plain = open(capture(json(TOP)).path());
    let turned = json(&format!(r#"{TOP}, "from_na": true"#)).replace("[0,1,0,0],[0,0,1,4]", "[0,-1,0,0],[0,0,-1,4]");
    assert_eq!(open(capture(turned).path()).views[1].camera, plain.views[1].camera);
    let matrix = r#"{"intrinsic_matrix": [[70,0,30,0],[0,71,20,0],[0,0,1,0],[0,0,0,1]], "file_path""#;
    let own = json(r#""w": 64, "h": 48"#).replace("{\"file_path\"", matrix);
    let lens = open(capture(own).path()).views[0].lens;
    assert_eq!((lens.focal.to_array(), lens.principal.to_array()), ([70.0, 71.0], [30.0, 20.0]));
    let said = refused(capture(json(&format!(r#"{TOP}, "normal_mts_args": []"#))).path());
    assert!(said.contains("normal_mts_args"), "{said}");
}

#[test]
fn numbers_of_a_frame_hold_for_the_photo_to_whose_middle_they_are_nearer() {
    let own = |cx: u32| {
        let frame = format!(r#"{{"fl_x": 52, "cx": {cx}, "cy": {}, "file_path""#, 3 * cx / 4);
        let scene = capture(json(TOP).replace("{\"file_path\"", &frame));
        for name in NAMES {
            picture(&scene.path().join(name), 32, 24);
        }
        scene
    };
    for (cx, focal) in [(16, 52.0), (32, 26.0), (25, 26.0)] {
        assert_eq!(open(own(cx).path()).views[0].lens.focal.x, focal, "{cx}");
    }
    assert!(refused(own(21).path()).contains("the w and h for which its numbers hold"));
}

#[test]
fn what_lies_around_the_circle_of_a_fisheye_is_masked() {
    let with = |radius: u32| capture(json(&format!(r#"{TOP}, "cx": 30, "fisheye_crop_radius": {radius}"#)));
    let scene = with(20);
    for broken in [false, true] {
        if broken {
            picture(&scene.path().join("masks/a.png"), 48, 64);
        }
        let (photos, told) = load(scene.path());
        assert_eq!((photos[0].alpha_role, told.contains("another shape")), (AlphaRole::Mask, broken), "{told}");
        for (x, counts) in [(9, 0), (10, 255), (49, 255), (50, 0)] {
            assert_eq!(photos[0].pixels.at(64 * 24 + x).unwrap()[3], counts, "{x}");
        }
    }
    let [planned, other] = [20, 21].map(|radius| prepare::contents(&open(with(radius).path())).unwrap());
    assert_ne!(planned, other);
}

#[test]
fn movement_during_the_exposure_is_told() {
    let moved = format!(r#"{TOP}, "rolling_shutter": [0, 0, 0.02], "rolling_shutter_time": 0"#);
    let told = notes(&open(capture(json(&moved)).path()));
    assert_eq!(told, "not used: rolling_shutter; cameras are taken to stand still during an exposure");
}

#[test]
fn matrices_end_in_0_0_0_1() {
    let plain = open(capture(json(TOP)).path());
    let twice =
        json(TOP).replace("[[1,0,0,2],[0,1,0,0],[0,0,1,4],[0,0,0,1]]", "[[2,0,0,4],[0,2,0,0],[0,0,2,8],[0,0,0,2]]");
    assert_ne!(twice, json(TOP));
    assert_eq!(open(capture(twice).path()).views[1].camera, plain.views[1].camera);
    let transposed =
        json(TOP).replace("[[1,0,0,2],[0,1,0,0],[0,0,1,4],[0,0,0,1]]", "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[2,0,4,1]]");
    let said = refused(capture(transposed).path());
    assert!(said.contains("frame 2") && said.contains("transposed"), "{said}");
}

const CLOUD: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";

#[test]
fn files_that_a_capture_names_are_found_and_lists_that_name_nothing_are_told() {
    let points = format!("{CLOUD}end_header\n1 0 -1\n");
    for (mask, cloud) in [
        ("Seg/A.PNG", "Cloud/P.ply"),
        ("/home/me/scan/seg/a.png", "/home/me/scan/cloud/p.ply"),
        (r"C:\\scan\\seg\\a.png", r".\\cloud\\p.ply"),
        ("seg%2Fa.png", "%63loud/p.ply"),
    ] {
        let top = format!(r#"{TOP}, "ply_file_path": "{cloud}""#);
        let scene =
            capture(json(&top).replacen("{\"file_path\"", &format!("{{\"mask_path\": \"{mask}\", \"file_path\""), 1));
        grey(&scene.path().join("seg/a.png"), |_| [255, 255]);
        write(scene.path(), [("cloud/p.ply", points.clone().into_bytes())]);
        let opened = open(scene.path());
        let told = "1 photo without a mask, used as a whole (images/b.png)".to_owned();
        assert_eq!((opened.points.len(), notes(&opened)), (1, told), "{mask} {cloud}");
        assert_eq!(opened.views[0].mask.as_deref(), Some(scene.path().join("seg/a.png").as_path()));
    }
    let top = format!(r#"{TOP}, "train_filenames": ["images/a.png"], "test_filenames": ["b.png", "/x/images/c.png"]"#);
    let told = notes(&open(capture(json(&top)).path()));
    assert!(told.contains("2 of 3 in train_filenames, val_filenames and test_filenames"), "{told}");
}

/// nerfstudio uses only frames that a list has.
#[test]
fn frames_in_none_of_the_lists_are_not_used() {
    let with = |train: &str| open(capture(json(&format!(r#"{TOP}, "train_filenames": ["{train}"]"#))).path());
    let scene = with("images/a.png");
    assert_eq!((scene.views.len(), with("other/a.png").views.len()), (1, 2));
    let told =
        "1 photo in none of the lists of train_filenames, val_filenames and test_filenames, not used (images/b.png)";
    assert_eq!(notes(&scene), told);
}

#[test]
fn photos_of_another_shape_are_told_with_both_sizes() {
    let scene = capture(json(r#""fl_x": 50, "w": 800, "h": 800"#));
    let told = open(scene.path()).require_photos().unwrap_err().to_string();
    let file = scene.path().join("transforms.json");
    let camera = format!("a.png is 64 x 48, but its camera in {} is 800 x 800: correct w and h", file.display());
    assert!(told.contains(&camera) && !told.contains("mogrify"), "{told}");
}

#[test]
fn points_have_the_colours_of_their_file_whatever_they_are_called() {
    for (properties, values) in [
        ("uchar red uchar green uchar blue", "10 20 250"),
        ("ushort red ushort green ushort blue", "2570 5140 64250"),
        ("int red int green int blue", "10 20 250"),
        ("float red float green float blue", "0.0392 0.0784 0.9804"),
        ("float red float green float blue", "10 20 250"),
        ("uchar diffuse_red uchar diffuse_green uchar diffuse_blue", "10 20 250"),
        ("float f_dc_0 float f_dc_1 float f_dc_2", "-1.63345 -1.49443 1.70296"),
        ("uint rgb", "660730"),
        ("float rgba", "9.258799e-40"),
    ] {
        let words: Vec<&str> = properties.split(' ').collect();
        let header: Vec<String> = words.chunks(2).map(|p| format!("property {} {}\n", p[0], p[1])).collect();
        let header = header.concat();
        let scene = capture(json(&format!(r#"{TOP}, "ply_file_path": "p.ply""#)));
        write(scene.path(), [("p.ply", format!("{CLOUD}{header}end_header\n1 2 3 {values}\n").into_bytes())]);
        assert_eq!(open(scene.path()).points[0].colour, [10, 20, 250], "{properties}");
    }
}

#[test]
fn of_several_places_with_poses_the_one_used_is_told() {
    let all = ["a.png", "b.png", "c.png"];
    let scene = written(row(&all[..2]).text().map(|(name, bytes)| (name, bytes)));
    let sparse = tempfile::tempdir().unwrap();
    write(&sparse.path().join("sparse"), row(&all).text());
    write(&sparse.path().join("sparse/0"), row(&all[..2]).binary());
    let opened = open(sparse.path());
    assert_eq!(opened.views.len(), 3);
    assert!(
        notes(&opened).contains("holds 2 models: sparse (3 photos) is used, not 0 (2 photos)"),
        "{}",
        notes(&opened)
    );
    assert_eq!(notes(&open(scene.path())), "");
    write(sparse.path(), [("transforms.json", transforms(TOP, &all))]);
    assert!(notes(&open(sparse.path())).contains("the poses in sparse are used, not those in transforms.json"));
}

#[test]
fn cameras_that_look_away_from_the_points_are_told() {
    let cloud = |z: f64| format!("{CLOUD}end_header\n1 0 {z}\n").into_bytes();
    for (z, away) in [(-1.0, false), (9.0, true)] {
        // Two cameras at z = 4 that look along -z.
        let scene = capture(json(&format!(r#"{TOP}, "ply_file_path": "p.ply""#)));
        write(scene.path(), [("p.ply", cloud(z))]);
        assert_eq!(notes(&open(scene.path())).contains("2 of 2 views see none of the points"), away, "{z}");
    }
    assert!(open(capture(json(TOP)).path()).lacks_points().unwrap().starts_with("no points"));
}

#[test]
fn cameras_far_from_all_others_are_told() {
    let names = ["a.png", "b.png", "c.png", "d.png", "e.png", "f.png"];
    for (x, told) in [(80.0, false), (-9e3, true)] {
        let mut model = row(&names);
        model.images[4].2[0] = x;
        let scene = written(model.text());
        assert_eq!(
            notes(&open(scene.path())).contains("1 camera more than 100 times as far out as half of them"),
            told,
            "{x}"
        );
    }
}

#[test]
fn depth_maps_have_the_step_that_the_file_says() {
    for (field, step) in [
        ("", None),
        (r#", "integer_depth_scale": 6e-5"#, Some(6e-5)),
        (r#", "depth_unit_scale_factor": 0.5"#, Some(0.5)),
    ] {
        let scene = open(capture(json(&format!("{TOP}{field}"))).path());
        assert!(scene.views.iter().all(|view| view.depth_step == step), "{field}");
    }
}

/// A model with a local origin of its own is moved to the scene's, and cameras given in the world to the model's.
#[test]
fn models_scenes_and_cameras_of_one_far_world_meet() {
    let world = DVec3::new(500_000.0, 4_000_000.0, 100.0);
    let mut model = row(&["a.png", "b.png"]);
    for (.., translation, _, _, _) in &mut model.images {
        *translation = (DVec3::from(*translation) - world).to_array();
    }
    model.points[0].0 = (DVec3::from(model.points[0].0) + world).to_array();
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("sparse/0"), model.text());
    let scene = open(folder.path());
    assert!(scene.origin.distance(world) < 10.0 && scene.origin != DVec3::ZERO, "{}", scene.origin);
    let mut splats = make::model(20, 0);
    let own = world + DVec3::new(3.0, -2.0, 1.0);
    assert_eq!(place::shift_to(&splats, own.to_array(), &scene), own - scene.origin);
    assert_eq!(place::shift_to(&splats, [0.0; 3], &scene), DVec3::ZERO, "without a record, near zero");
    // georeference.json and the comment of a PLY may be lost; a glTF has a field for its origin. No capture is opened for a PLY alone.
    let of_ply = [true, false];
    for (file, doubted) in
        [("a.spz", [true; 2]), ("a.ply", of_ply), ("a.compressed.ply", of_ply), ("a.glb", [false; 2])]
    {
        let file = folder.path().join(file);
        formats::write(&file, &splats, RenderMode::Plain).unwrap();
        let mut loaded = formats::read(&file).unwrap();
        let warnings = [place::doubt(&loaded, &scene), place::place_read(&mut loaded, folder.path(), None).unwrap()];
        let names_both = |warning: &str| warning.contains("`origin X Y Z`") && warning.contains("georeference.json");
        assert_eq!(warnings.map(|warning| warning.is_some_and(names_both)), doubted, "{}", file.display());
        let opens = place::place_read(&mut loaded, &folder.path().join("absent"), None).is_err();
        assert_eq!(opens, doubted[1], "{}", file.display());
    }
    let mut loaded = formats::read(&folder.path().join("a.spz")).unwrap();
    assert!(place::doubt(&loaded, &scene).is_some());
    loaded.gaussians.shift(world);
    assert_eq!(place::doubt(&loaded, &scene), None);
    splats.shift(world);
    assert_eq!(place::shift_to(&splats, [0.0; 3], &scene), -scene.origin, "without a record, in the world");
    // Of two models, in the world and local, or each with a record or without.
    let (far, near) = (splats.clone(), make::model(20, 0));
    for (mut model, origins, original) in [
        (far.clone(), [[0.0; 3], world.to_array()], &near),
        (near.clone(), [world.to_array(), [0.0; 3]], &far),
        (near.clone(), [[0.0; 3], world.to_array()], &near),
        (far.clone(), [[0.0; 3]; 2], &far),
    ] {
        place::align(&mut model, origins, original);
        assert!((0..3).all(|k| (model.means[0][k] - original.means[0][k]).abs() < 0.5), "{origins:?}");
    }
    assert_eq!(place::origin_of_cameras(world + 5.0, own.to_array()), own);
    assert_eq!(place::origin_of_cameras(DVec3::splat(5.0), own.to_array()), DVec3::ZERO);
}

#[test]
fn a_smaller_copy_tells_the_size_of_the_photo_that_is_absent() {
    let scene = written([("transforms.json", transforms(r#""fl_x": 50, "fl_y": 51"#, &NAMES))]);
    for name in ["images_2/a.png", "images_2/b.png"] {
        picture(&scene.path().join(name), 32, 24);
    }
    let lens = open(scene.path()).views[0].lens;
    assert_eq!((lens.width, lens.focal.x, lens.principal.x), (32, 25.0, 16.0));
}

#[test]
fn principal_points_at_the_edge_are_told() {
    let said = |top: &str| notes(&open(capture(json(&format!("{TOP}{top}"))).path()));
    assert!(said(r#", "cx": 0, "cy": 0"#).contains("principal point far from the middle"));
    assert!(!said(r#", "cx": 30, "cy": 26"#).contains("principal point"));
}

#[test]
fn nulls_say_nothing() {
    let top = format!(r#"{TOP}, "train_filenames": null, "test_frames": null, "val_filenames": null"#);
    let empty = r#""is_bad": null, "mask_path": "", "depth_file_path": "", "transform_matrix""#;
    let scene = capture(json(&top).replace("\"transform_matrix\"", empty));
    let opened = open(scene.path());
    let missing = (opened.skipped.missing_masks.count, opened.skipped.missing_depths.count);
    assert_eq!((opened.views.len(), missing), (2, (0, 0)));
}
