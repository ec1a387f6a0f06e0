//! Captures whose parts were mistaken for others: photos, masks, lenses and splits that are not what their names or places suggest.

use std::fs;
use std::path::Path;

use super::dialects::{notes, open};
use super::{TOP, transformed};
use crate::support::files::writers::{Model, picture, row, transforms, write, written};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{LoadOptions, OpenOptions, PhotoTree, Role, Scene};

/// A capture with a transforms.json of these frames, and these pictures.
fn capture(top: &str, frames: &[&str], pictures: &[&str]) -> tempfile::TempDir {
    transformed(transforms(top, frames), pictures)
}

/// The views that have a mask, by their names, with its path within the capture.
fn masks(root: &Path) -> Vec<(String, String)> {
    let within = |path: &Path| path.strip_prefix(root).unwrap().to_string_lossy().replace('\\', "/");
    let views = open(root).views.into_iter();
    views.filter_map(|view| Some((view.name.clone(), within(view.mask.as_deref()?)))).collect()
}

/// A mask whose left half counts.
fn mask(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::GrayImage::from_fn(64, 48, |x, _| image::Luma([if x < 32 { 255 } else { 0 }])).save(path).unwrap();
}

#[test]
fn pictures_of_other_programs_never_stand_for_an_absent_photo() {
    for other in ["renders/b.png", "out/val/b.png", "old/b.png"] {
        let scene = capture(TOP, &["a.png", "b.png"], &["a.png", other]);
        let there: Vec<bool> = open(scene.path()).views.iter().map(|v| v.image.is_file()).collect();
        assert_eq!(there, [true, false], "{other}");
        let scene = capture(TOP, &["a.png", "b.png"], &["images/a.png", other]);
        let there: Vec<bool> = open(scene.path()).views.iter().map(|v| v.image.is_file()).collect();
        assert_eq!(there, [true, false], "images and {other}");
    }
}

/// Pictures beside the photos' folder, and photos that are named without it.
#[test]
fn photos_are_found_beside_pictures_of_other_kinds() {
    let scene = capture(TOP, &["a.png", "b.png"], &["images/a.png", "images/b.png", "images/c.png", "overview.png"]);
    let opened = open(scene.path());
    assert!(opened.views.iter().all(|view| view.image.is_file()));
    assert_eq!(opened.skipped.unposed_images.count, 1, "{}", notes(&opened));
    let two = ["left/a.png", "right/a.png"];
    let scene = capture(TOP, &two, &[two[0], two[1], "cover.png"]);
    assert_eq!(open(scene.path()).skipped.unposed_images.count, 0);
}

#[test]
fn numbered_cameras_are_no_smaller_copies() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["cam/0.png", "cam_1/0.png", "cam_2/0.png", "corrected_a/0.png", "a/0.png"] {
        picture(&folder.path().join(name), 64, 48);
    }
    let tree = PhotoTree::of(folder.path());
    assert_eq!((tree.names.len(), tree.left_out.len()), (5, 0));
    picture(&folder.path().join("cam_4/0.png"), 16, 12);
    assert_eq!(PhotoTree::of(folder.path()).left_out, ["cam_4"]);
    // 2x are copies beside 1x (Nerfies), or a lens of a phone.
    for (width, height, copies) in [(4, 3, &["2x"][..]), (8, 6, &[])] {
        let folder = tempfile::tempdir().unwrap();
        picture(&folder.path().join("1x/0.png"), 8, 6);
        picture(&folder.path().join("2x/0.png"), width, height);
        assert_eq!(PhotoTree::of(folder.path()).left_out, copies);
    }
}

#[test]
fn folders_of_renders_are_not_those_of_the_photos() {
    let names: Vec<String> = (0..6).map(|i| format!("{i}.png")).collect();
    let listed: Vec<&str> = names.iter().map(String::as_str).collect();
    let scene = tempfile::tempdir().unwrap();
    write(&scene.path().join("sparse/0"), row(&listed).text());
    for name in &names {
        picture(&scene.path().join("images_4").join(name), 64, 48);
    }
    picture(&scene.path().join("compare/3.png"), 64, 48);
    assert!(open(scene.path()).views.iter().all(|view| view.image.starts_with(scene.path().join("images_4"))));
    // With the folders of another machine, and with images/ left out.
    let stray = capture(TOP, &["/home/me/images/a.png", "/home/me/images/b.png"], &["images/a.png", "b.png"]);
    let there: Vec<bool> = open(stray.path()).views.iter().map(|v| v.image.is_file()).collect();
    assert_eq!(there, [true, false]);
    let bare = capture(TOP, &["images/a.png"], &["a.png", "preview/p.png"]);
    assert!(open(bare.path()).views[0].image.is_file());
}

#[test]
fn masks_in_folders_named_after_cameras_are_those_cameras() {
    let photos = ["images/L/0.png", "images/R/0.png"];
    let scene = capture(TOP, &photos, &photos);
    for camera in ["L", "R"] {
        mask(&scene.path().join(format!("images/{camera}_mask/0.png")));
    }
    let found = photos.map(|photo| (photo.to_owned(), photo.replace("/0", "_mask/0")));
    assert_eq!(masks(scene.path()), found);
}

#[test]
fn a_mask_that_may_be_that_of_several_photos_is_none() {
    let names = ["left/0.png", "right/0.png"];
    let scene = capture(TOP, &names, &names);
    mask(&scene.path().join("masks/0.png"));
    assert_eq!(masks(scene.path()), []);
    assert!(notes(&open(scene.path())).contains("2 photos in several folders with the same names"));
    // Whether both have a pose or not.
    let one = capture(TOP, &["images/left/0.png"], &["images/left/0.png", "images/right/0.png"]);
    mask(&one.path().join("images/masks/0.png"));
    assert_eq!(masks(one.path()), []);
    mask(&scene.path().join("masks/right/0.png"));
    assert_eq!(masks(scene.path()), [("right/0.png".to_owned(), "masks/right/0.png".to_owned())]);
}

#[test]
fn masks_are_found_beside_and_in_the_folders_of_each_camera() {
    for (photo, file) in [
        ("images/L/0.png", "images/L/masks/0.png"),
        ("images/L/rgb/0.png", "images/L/mask/0.png"),
        ("images/L/0.png", "images/masks/L/0.png"),
        ("camL/images/0.png", "camL/masks/0.png"),
        ("data/images/L/0.png", "data/masks/L/0.png"),
        ("images/0.png", "dynamic_masks/0.png"),
    ] {
        let other = photo.replace('L', "R").replace("0.png", "1.png");
        let scene = capture(TOP, &[photo, &other], &[photo, &other]);
        mask(&scene.path().join(file));
        let empty = scene.path().join("masks");
        if !empty.is_dir() {
            fs::create_dir(&empty).unwrap();
        }
        assert_eq!(masks(scene.path()), [(photo.to_owned(), file.to_owned())], "{photo}");
        if let (Some(photo), Some(other)) = (photo.strip_prefix("images/"), other.strip_prefix("images/")) {
            fs::remove_file(scene.path().join("transforms.json")).unwrap();
            write(&scene.path().join("sparse/0"), row(&[photo, other]).text());
            assert_eq!(masks(scene.path()), [(photo.to_owned(), file.to_owned())], "COLMAP, {photo}");
        }
    }
}

/// Names with the folders of this machine or another, and photos that lie elsewhere.
#[test]
fn masks_are_those_of_the_capture_whatever_its_photos_are_called() {
    let scene = tempfile::tempdir().unwrap();
    picture(&scene.path().join("images/a.png"), 64, 48);
    mask(&scene.path().join("masks/a.png"));
    let absolute = scene.path().join("images/a.png").to_string_lossy().replace('\\', "/");
    let names = [absolute.as_str(), "./images/a.png", "/home/me/cap/images/a.png", "a.png", "images/a", "images/A.JPG"];
    for name in names {
        write(scene.path(), [("transforms.json", transforms(TOP, &[name]))]);
        let view = &open(scene.path()).views[0];
        assert_eq!(view.mask.as_deref(), Some(scene.path().join("masks/a.png").as_path()), "{name}");
    }
    // In the folder that is asked for, and in one outside of the capture.
    let asked = |root: &Path, images: &Path| {
        let options = OpenOptions { images: Some(images.to_owned()), ..OpenOptions::default() };
        Scene::open(root, &options).unwrap().views[0].mask.clone()
    };
    for name in ["images_4/L/0.png", "masks_4/L/0.png"] {
        mask(&scene.path().join(name));
    }
    write(scene.path(), [("transforms.json", transforms(TOP, &["L/0.png"]))]);
    assert_eq!(asked(scene.path(), Path::new("images_4")), Some(scene.path().join("masks_4/L/0.png")));
    let outside = tempfile::tempdir().unwrap();
    picture(&outside.path().join("a.png"), 64, 48);
    write(scene.path(), [("transforms.json", transforms(TOP, &["images/a.png"]))]);
    assert_eq!(asked(scene.path(), outside.path()), Some(scene.path().join("masks/a.png")));
}

/// A mask by its pixels.
type Pixel<'a> = &'a dyn Fn(u32, u32) -> [u8; 4];

#[test]
fn masks_in_colours_count_where_they_are_not_black_and_pictures_by_their_alpha() {
    let left = |x: u32, colour: [u8; 4], other: [u8; 4]| if x < 32 { colour } else { other };
    let red = |x: u32, y: u32| left(x, if y < 24 { [128, 0, 0, 255] } else { [0, 0, 192, 255] }, [0, 0, 0, 255]);
    let cut_out = |x: u32, y: u32| [(4 * x) as u8, (5 * y) as u8, 90, left(x, [255; 4], [0; 4])[3]];
    let no_alpha = |x: u32, _: u32| left(x, [255, 255, 255, 0], [0; 4]);
    let faint = |x: u32, _: u32| left(x, [255, 255, 255, 100], [0, 0, 0, 100]);
    let on_nothing = |x: u32, y: u32| left(x, if y < 24 { [255, 255, 255, 255] } else { [200, 0, 0, 255] }, [0; 4]);
    let faint_labels = |x: u32, _: u32| left(x, [0, 200, 255, 100], [0; 4]);
    let soft = |x: u32, y: u32| if (x, y) == (5, 5) { [250, 0, 0, 255] } else { left(x, [255; 4], [0, 0, 0, 255]) };
    let kinds: [(&str, Pixel<'_>); 7] = [
        ("faint labels", &faint_labels),
        ("a coloured pixel", &soft),
        ("labels on nothing", &on_nothing),
        ("labels", &red),
        ("a cut-out", &cut_out),
        ("alpha of 0", &no_alpha),
        ("even alpha", &faint),
    ];
    for (kind, pixel) in kinds {
        let scene = capture(TOP, &["images/a.png"], &["images/a.png"]);
        let file = scene.path().join("masks/a.png");
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        image::RgbaImage::from_fn(64, 48, |x, y| image::Rgba(pixel(x, y))).save(&file).unwrap();
        let photos = open(scene.path()).load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        for (x, counts) in [(31, 255), (31 + 64 * 40, 255), (32, 0), (63 + 64 * 47, 0)] {
            assert_eq!(photos[0].pixels.at(x).unwrap()[3], counts, "{kind} at {x}");
        }
    }
}

#[test]
fn a_frame_s_own_angle_replaces_the_focal_lengths_of_the_file() {
    let focal = |top: &str, own: &str| {
        let json = String::from_utf8(transforms(top, &["a.png"])).unwrap();
        let json = json.replacen("{\"file_path\"", &format!("{{{own}, \"file_path\""), 1);
        open(written([("transforms.json", json.into_bytes())]).path()).views[0].lens.focal
    };
    let expected = 24.0 / 20_f64.to_radians().tan();
    for top in [TOP, r#""camera_angle_x": 1.2, "w": 64, "h": 48"#] {
        for own in [r#""y_fov": 40"#, r#""camera_angle_y": 0.6981317007977318"#] {
            let found = focal(top, own);
            assert!((found - expected).abs().max_element() < 1e-9, "{top} {own}: {found}");
        }
    }
    // A frame may have one of two focal lengths.
    assert_eq!(focal(TOP, r#""fl_y": 60"#).to_array(), [50.0, 60.0]);
}

#[test]
fn lists_of_both_training_and_test_are_no_split_and_one_side_no_size() {
    let frames = ["a.png", "b.png", "c.png"];
    let lists = r#""train_filenames": ["a.png", "b.png", "c.png"], "test_filenames": ["b.png"]"#;
    let opened = open(capture(&format!("{TOP}, {lists}"), &frames, &frames).path());
    assert!(notes(&opened).contains("1 view listed for both training and test: both roles are ignored"));
    assert!(opened.views.iter().all(|view| view.role != Role::Test));
    let alone = |w: u32| {
        let scene = capture(&format!(r#""fl_x": 50, "w": {w}"#), &["a.png"], &["a.png"]);
        Scene::open(scene.path(), &OpenOptions::default()).map_err(|e| e.to_string())
    };
    assert!(alone(64).is_ok() && alone(67).is_ok());
    assert!(alone(128).unwrap_err().contains("gives w alone, and 128 is not that of"));
}

#[test]
fn sixteen_bits_of_colour_may_hold_bytes() {
    for (value, colour) in [(200_u16, 200), (200 * 257, 200)] {
        let header = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                      property float z\nproperty ushort red\nproperty ushort green\nproperty ushort blue\nend_header\n";
        let point = |z: f32| [0.0, 0.0, z].into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let colours: Vec<u8> = [value; 3].into_iter().flat_map(u16::to_le_bytes).collect();
        let cloud = [header.as_bytes(), &point(-1.0), &colours, &point(-2.0), &colours].concat();
        let scene = capture(&format!(r#"{TOP}, "ply_file_path": "p.ply""#), &["a.png"], &["a.png"]);
        write(scene.path(), [("p.ply", cloud)]);
        assert_eq!(open(scene.path()).points[0].colour, [colour; 3], "{value}");
    }
}

#[test]
fn one_lens_that_cannot_be_used_leaves_out_its_photos_alone() {
    let with = |images: &[u32], parameters: Vec<f64>| {
        let mut model = row(&["a.png", "b.png"]);
        let (_, _, width, height, _) = model.cameras[0].clone();
        model.cameras.push((90, LensModel::OpenCv, width, height, parameters));
        for (image, camera) in model.images.iter_mut().zip(images) {
            image.3 = *camera;
        }
        model
    };
    let first = row(&["a.png"]).cameras[0].0;
    let opened = |model: &Model| -> [Result<Scene, String>; 2] {
        [written(model.text()), written(model.binary())]
            .map(|folder| Scene::open(folder.path(), &OpenOptions::default()).map_err(|e| e.to_string()))
    };
    let folded = vec![50.0, 50.0, 32.0, 24.0, -3.0, 9.0, 0.5, 0.5];
    let absurd = vec![1e12, -50.0, 32.0, 24.0, 0.0, 0.0, 0.0, 0.0];
    for (lens, parameters) in [("folded", folded), ("absurd", absurd)] {
        for scene in opened(&with(&[first, 90], parameters.clone())) {
            let scene = scene.unwrap_or_else(|e| panic!("{lens}: {e}"));
            assert_eq!(scene.views.len(), 1, "{lens}");
            assert!(notes(&scene).contains("1 photo left out (b.png)"), "{lens}: {}", notes(&scene));
        }
        assert!(opened(&with(&[first, first], parameters.clone())).iter().all(Result::is_ok), "{lens}, not used");
        assert!(opened(&with(&[90, 90], parameters)).iter().all(Result::is_err), "{lens}, of all");
    }
}

/// As COLMAP's, a frame's impossible lens leaves out its photo alone.
#[test]
fn a_frame_without_a_lens_is_left_out() {
    let json = String::from_utf8(transforms(TOP, &["a.png", "b.png"])).unwrap();
    let json = json.replacen("{\"file_path\"", "{\"fl_x\": -5, \"file_path\"", 1);
    let scene = open(written([("transforms.json", json.into_bytes())]).path());
    assert_eq!(scene.views.len(), 1);
    assert!(notes(&scene).contains("1 photo left out (a.png)"), "{}", notes(&scene));
}

#[test]
fn a_model_alone_finds_photos_in_any_usual_folder() {
    for folder in ["images", "input", "photos", "frames", "images_4"] {
        let scene = tempfile::tempdir().unwrap();
        let model = scene.path().join("sparse/0");
        write(&model, row(&["a.png"]).text());
        picture(&scene.path().join(folder).join("a.png"), 64, 48);
        assert!(open(&model).views[0].image.is_file(), "{folder}");
    }
}

#[test]
fn photos_without_a_pose_are_counted_wherever_the_others_lie() {
    let scene = capture(TOP, &["images/main/a.png"], &["images/main/a.png", "images/top.png", "images/extra/b.png"]);
    assert_eq!(open(scene.path()).skipped.unposed_images.count, 2);
    for folder in ["images", "rgb", "."] {
        let [a, b] = ["a.png", "b.png"].map(|name| format!("{folder}/{name}").replace("./", ""));
        let scene = capture(TOP, &[&a], &[&a, &b]);
        assert_eq!(open(scene.path()).skipped.unposed_images.count, 1, "{folder}");
    }
}

#[test]
fn numbers_that_other_writers_print_are_read() {
    let folder = written(row(&["a.png"]).text());
    let edit = |file: &str, change: &dyn Fn(String) -> String| {
        let path = folder.path().join(file);
        fs::write(&path, change(fs::read_to_string(&path).unwrap())).unwrap();
    };
    let points = "1 0 0 5 128.5 10 20 0.5\n2 -nan(ind) 0 5 1 2 3 0.5\n";
    edit("points3D.txt", &|_| points.to_owned());
    edit("cameras.txt", &|text| text.to_lowercase());
    let scene = open(folder.path());
    assert_eq!((scene.points.len(), scene.points[0].colour), (1, [128, 10, 20]));
    assert_eq!(scene.skipped.bad_points, 1);
    edit("points3D.txt", &|_| "1 0 0 5 0.5 0.25 1 0.5\n2 1 0 5 0 1 1 0.5\n".to_owned());
    assert_eq!(
        open(folder.path()).points.iter().map(|p| p.colour).collect::<Vec<_>>(),
        [[128, 64, 255], [0, 255, 255]]
    );
}
