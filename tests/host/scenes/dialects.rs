//! Captures as other systems and tools write them: each gives the same views as the plain one, or an error with the
//! reason.

use std::fs;
use std::path::Path;

use super::traps::grey;
use crate::host::depth_maps::exr_of;
use crate::support::files::writers::{Model, picture, row, transforms, write, written};
use qirf_vk::pipeline::effects::examine;
use qirf_vk::scene::{AlphaRole, LoadOptions, OpenOptions, PhotoTree, Resize, Scene, Split, alpha_role, masks_of};

/// Photos of a capture.
pub const NAMES: [&str; 4] = ["a.png", "b.png", "c.png", "d.png"];

pub fn open(root: &Path) -> Scene {
    Scene::open(root, &OpenOptions::default()).unwrap()
}

pub fn notes(scene: &Scene) -> String {
    scene.skipped.summary().join("\n")
}

/// A capture whose images.txt or .bin lists `listed`, and whose images folder contains `files`.
pub fn capture(listed: &[&str], files: &[&str]) -> tempfile::TempDir {
    let scene = tempfile::tempdir().unwrap();
    write(&scene.path().join("sparse/0"), row(listed).text());
    for file in files {
        picture(&scene.path().join("images").join(file), 64, 48);
    }
    scene
}

/// The photos found, by their paths within images.
fn found(scene: &tempfile::TempDir) -> Vec<String> {
    let images = scene.path().join("images");
    let files = open(scene.path()).views.into_iter().filter(|v| v.image.is_file());
    files.map(|v| v.image.strip_prefix(&images).unwrap().to_string_lossy().replace('\\', "/")).collect()
}

#[test]
fn names_of_other_systems_find_their_files() {
    for (listed, files) in [
        (["a\\x.png", "b\\x.png"], ["a/x.png", "b/x.png"]),
        (["D:\\scan 1\\images\\x.png", "D:\\scan 1\\images\\y.png"], ["x.png", "y.png"]),
        (["/home/me/left/x.png", "/home/me/right/x.png"], ["left/x.png", "right/x.png"]),
        (["file:///home/me/images/x.png", "file:///home/me/images/y%201.png"], ["x.png", "y 1.png"]),
        (["VIEW_0.PNG", "View_1.png"], ["view_0.png", "view_1.PNG"]),
        (["x.jpg", "y.JPG"], ["x.PNG", "y.png"]),
        (["caf\u{e9}.png", "\u{fc}ber.png"], ["cafe\u{301}.png", "u\u{308}ber.png"]),
        (["cafe\u{301}.png", "u.png"], ["caf\u{e9}.png", "u.png"]),
        (["frames/x.png", "frames/y.png"], ["x.png", "y.png"]),
        (["x.png", "y.png"], ["rgb/x.png", "rgb/y.png"]),
        (["shot 1 (2).png", "shot 2 (2).png"], ["shot 1 (2).png", "shot 2 (2).png"]),
    ] {
        let scene = capture(&listed, &files);
        let mut wanted = files.map(str::to_owned).to_vec();
        wanted.sort();
        let mut there = found(&scene);
        there.sort();
        assert_eq!(there, wanted, "{listed:?}");
        let opened = open(scene.path());
        assert!(opened.views.iter().all(|v| !v.name.contains('\\') && !v.name.starts_with('/')));
        assert_eq!(notes(&opened), "", "{listed:?}");
    }
    // No photo replaces another camera's, or serves for two, or may be either's.
    assert_eq!(found(&capture(&["left/x.png", "right/x.png"], &["right/x.png"])), ["right/x.png"]);
    assert_eq!(found(&capture(&["left/x.png", "right/x.png"], &["x.png"])), [""; 0]);
    assert_eq!(found(&capture(&["a.png"], &["b.png"])), [""; 0]);
}

#[test]
fn an_absent_second_line_is_noticed_whatever_the_names_look_like() {
    for name in ["shot 1 (2).png", "a b c.png", "one.png", "1 2 3.png"] {
        let mut files = row(&["x.png"]).text();
        let line = |i: usize| format!("{i} 1 0 0 0 {i} 0 0 1 {i}{name}\n");
        files[1].1 = (1..=4).map(line).collect::<String>().into_bytes();
        let scene = written(files);
        let error = Scene::open(scene.path(), &OpenOptions::default()).unwrap_err().to_string();
        assert!(error.contains("two lines") && error.contains("line 2"), "{error}");
    }
}

#[test]
fn the_largest_model_is_taken_and_told() {
    let scene = capture(&NAMES[..2], &NAMES);
    write(&scene.path().join("sparse/1"), row(&NAMES).binary());
    write(&scene.path().join("sparse/2"), row(&NAMES[..3]).text());
    for given in ["", "sparse"] {
        let opened = open(&scene.path().join(given));
        assert_eq!(opened.views.len(), 4);
        assert!(
            notes(&opened).contains("3 models: 1 (4 photos) is used, not 2 (3 photos), 0 (2 photos)"),
            "{}",
            notes(&opened)
        );
        assert!(opened.views.iter().all(|v| v.image.is_file()));
    }
    // A folder that is asked for is used.
    assert_eq!(open(&scene.path().join("sparse/0")).views.len(), 2);
    for only in ["sparse/1", "sparse/merged", "colmap/sparse/3"] {
        let scene = tempfile::tempdir().unwrap();
        write(&scene.path().join(only), row(&NAMES).binary());
        assert_eq!((open(scene.path()).views.len(), notes(&open(scene.path()))), (4, String::new()), "{only}");
    }
}

#[test]
fn photos_without_a_pose_are_counted() {
    let scene = capture(&NAMES[..1], &NAMES);
    let opened = open(scene.path());
    assert_eq!((opened.skipped.unposed_images.count, opened.views.len()), (3, 1));
    assert!(notes(&opened).contains("3 photos without a pose, not used (b.png, c.png, d.png)"));
    let scene = tempfile::tempdir().unwrap();
    for name in NAMES {
        picture(&scene.path().join("images").join(name), 64, 48);
    }
    write(scene.path(), [("transforms.json", transforms(r#""fl_x": 50, "w": 64, "h": 48"#, &["images/a.png"]))]);
    assert_eq!(open(scene.path()).skipped.unposed_images.count, 3);
    fs::write(scene.path().join("images/e.HEIC"), b"x").unwrap();
    assert!(notes(&open(scene.path())).contains("1 photo in HEIC, which is not read (e.HEIC)"));
}

/// A capture of four photos with an alpha channel of these values at their first pixels.
fn with_alpha(alphas: &[u8]) -> tempfile::TempDir {
    let scene = capture(&NAMES, &[]);
    for (i, name) in NAMES.iter().enumerate() {
        let path = scene.path().join("images").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let of = |x: u32, y: u32| alphas.get((y * 64 + x) as usize).filter(|_| i == 1).copied().unwrap_or(255);
        image::RgbaImage::from_fn(64, 48, |x, y| image::Rgba([200, 10, 10, of(x, y)])).save(path).unwrap();
    }
    scene
}

#[test]
fn specks_of_alpha_decide_nothing() {
    let (specks, even) = (
        "of the photos' pixels are transparent, under 0.5 %: taken as opaque",
        "1 photo with the same alpha everywhere",
    );
    for (alphas, role, says) in [
        (vec![254], AlphaRole::Opaque, specks),
        (vec![250, 0, 128], AlphaRole::Opaque, specks),
        (vec![254; 64 * 48], AlphaRole::Opaque, even),
        (vec![128; 64 * 48], AlphaRole::Opaque, even),
        (vec![0; 64 * 48], AlphaRole::Alpha, "1 photo transparent everywhere"),
        (
            vec![0; 64 * 12],
            AlphaRole::Alpha,
            "% of the photos' pixels are transparent: alpha is used; the background is white",
        ),
    ] {
        let scene = with_alpha(&alphas);
        let mut opened = open(scene.path());
        let views: Vec<_> = opened.views.iter().collect();
        assert_eq!(alpha_role(&views, &LoadOptions::default()).unwrap(), role);
        let photos = opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        assert!(photos.iter().all(|p| p.alpha_role == role), "{}", alphas.len());
        assert!(notes(&opened).contains(says), "{}", notes(&opened));
        for note in [specks, even] {
            assert_eq!(notes(&opened).contains(note), says == note, "{}", notes(&opened));
        }
        if role == AlphaRole::Opaque {
            assert!(photos[1].pixels.read().unwrap().iter().skip(3).step_by(4).all(|a| *a == 255));
        }
    }
    let scene = with_alpha(&[0; 44]);
    let mut opened = open(scene.path());
    opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert!(notes(&opened).contains("0.36 % of the photos' pixels are transparent"), "{}", notes(&opened));
    // A channel that hides nothing does not prevent the use of masks.
    let scene = with_alpha(&[]);
    picture(&scene.path().join("masks/a.png"), 64, 48);
    let mut opened = open(scene.path());
    let views: Vec<_> = opened.views.iter().collect();
    assert_eq!(alpha_role(&views, &LoadOptions::default()).unwrap(), AlphaRole::Mask);
    let photos = opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!(photos[0].alpha_role, AlphaRole::Mask);
}

#[test]
fn masks_maps_and_copies_are_no_photos() {
    for (files, names) in [
        (&["a.jpg", "a.jpg.mask.png", "b.jpg", "b.jpg.mask.png"][..], &["a.jpg", "b.jpg"][..]),
        (&["frame_00001.jpg", "depth_00001.png", "conf_00001.png"], &["frame_00001.jpg"]),
        (&["r_0.png", "r_0_depth_0001.png", "r_0_normal_0001.png"], &["r_0.png"]),
        (
            &["x/images/1.jpg", "x/corrected_images/1.jpg", "x/depth/1.png", "x/confidence/1.png"],
            &["x/corrected_images/1.jpg"],
        ),
        (&["images/1.jpg", "images_2/1.jpg", "images_8/1.png"], &["images/1.jpg"]),
        (&["left/1.jpg", "right/1.jpg"], &["left/1.jpg", "right/1.jpg"]),
        (&["depth_1.jpg", "mask.jpg"], &["depth_1.jpg", "mask.jpg"]),
        (&["a.tif", "b.tiff"], &["a.tif", "b.tiff"]),
        (&["f-0.color.png", "f-0.depth.png", "f-1.color.png"], &["f-0.color.png", "f-1.color.png"]),
        (&["x/frame000000.jpg", "x/depth000000.png"], &["x/frame000000.jpg"]),
        (&["0_rgb.png", "0_foreground_mask.png", "0_depth.png"], &["0_rgb.png"]),
        (&["1.jpg", "1_masked.jpg", "1_thumb.jpg", "2.jpg"], &["1.jpg", "2.jpg"]),
        (&["DSC_1.jpg", "DSC_1.png", "DSC_2.png"], &["DSC_1.jpg", "DSC_2.png"]),
        (&["bare_1.jpg", "masked_1.jpg"], &["bare_1.jpg", "masked_1.jpg"]),
        (&["index1.jpg", "thumb1.jpg"], &["index1.jpg", "thumb1.jpg"]),
        (&["x.png", "x.ir.png", "x_seg.png", "x_semantic.png"], &["x.png"]),
        (&["images/1.jpg", "rendered_depth/1.jpg"], &["images/1.jpg"]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            picture(&folder.path().join(file), 8, 6);
        }
        let tree = PhotoTree::of(folder.path());
        assert_eq!(tree.names, names, "{files:?}");
        let told = tree.notes().len() + tree.left_out.len();
        assert_eq!(told > 0, files.len() != names.len(), "{files:?}");
    }
    // Folders with the word of maps in their name hold them if they hold grey pictures.
    let folder = tempfile::tempdir().unwrap();
    for file in ["color/1.png", "depth_5m/2.png", "depth_cam/left/1.jpg"] {
        picture(&folder.path().join(file), 8, 6);
    }
    let maps = ["aligned_depth", "depth-png", "depth16"];
    for folder_of_maps in maps {
        grey(&folder.path().join(folder_of_maps).join("1.png"), |_| [9, 255]);
    }
    let tree = PhotoTree::of(folder.path());
    assert_eq!(tree.names, ["color/1.png", "depth_5m/2.png", "depth_cam/left/1.jpg"]);
    assert_eq!(tree.left_out, maps);
    write(&folder.path().join("sparse/0"), row(&["1.png"]).text());
    assert!(open(folder.path()).views[0].image.ends_with("color/1.png"));
    // Of one name, the file in colour is the photo.
    let folder = tempfile::tempdir().unwrap();
    picture(&folder.path().join("a.png"), 8, 6);
    image::GrayImage::new(8, 6).save(folder.path().join("a.jpg")).unwrap();
    assert_eq!(PhotoTree::of(folder.path()).names, ["a.png"]);
    let folder = tempfile::tempdir().unwrap();
    for file in ["a.jpg", "a.jpg.mask.png"] {
        picture(&folder.path().join(file), 8, 6);
    }
    assert_eq!(masks_of(folder.path())("a.jpg"), Some(folder.path().join("a.jpg.mask.png")));
}

#[test]
fn half_a_jpeg_with_an_end_is_left_out() {
    let names = ["a.jpg", "b.jpg"];
    let scene = capture(&names, &names);
    let path = scene.path().join("images/b.jpg");
    let whole = fs::read(&path).unwrap();
    let scan = whole.windows(2).position(|w| w == [0xff, 0xda]).unwrap();
    fs::write(&path, [&whole[..usize::midpoint(scan, whole.len())], &[0xff, 0xd9]].concat()).unwrap();
    let mut opened = open(scene.path());
    // `inspect` foretells what a run leaves out.
    assert_eq!(examine(&opened).unwrap().1.damaged_images.examples, ["b.jpg"]);
    assert_eq!(opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap().len(), 1);
    assert_eq!(opened.skipped.damaged_images.examples, ["b.jpg"]);
}

#[test]
fn a_byte_order_mark_is_no_text() {
    let marked = |bytes: &[u8]| [b"\xef\xbb\xbf", bytes].concat();
    let scene = written(row(&NAMES).text().map(|(name, bytes)| (name, marked(&bytes))));
    assert_eq!((open(scene.path()).views.len(), open(scene.path()).points.len()), (4, 1));
    let json = transforms(r#""fl_x": 50, "w": 64, "h": 48"#, &NAMES);
    let scene = written([("transforms.json", marked(&json))]);
    assert_eq!(open(scene.path()).views.len(), 4);
}

#[test]
fn names_of_a_captures_own_files_may_be_in_any_case() {
    let scene = tempfile::tempdir().unwrap();
    for (name, bytes) in row(&NAMES).text() {
        write(scene.path(), [(&*format!("SPARSE/0/{}", name.to_uppercase()), bytes)]);
    }
    picture(&scene.path().join("Images/a.png"), 64, 48);
    assert_eq!((open(scene.path()).views.len(), open(scene.path()).points.len()), (4, 1));
    assert!(open(scene.path()).views[0].image.is_file());
    let json = transforms(r#""fl_x": 50, "w": 64, "h": 48"#, &NAMES);
    assert_eq!(open(written([("Transforms.JSON", json)]).path()).views.len(), 4);
    // Lines may end as on old Macs.
    let old = |bytes: Vec<u8>| bytes.into_iter().map(|b| if b == b'\n' { b'\r' } else { b }).collect::<Vec<u8>>();
    let scene = written(row(&NAMES).text().map(|(name, bytes)| (name, old(bytes))));
    assert_eq!((open(scene.path()).views.len(), open(scene.path()).points.len()), (4, 1));
}

#[test]
fn copied_splits_and_train_alone_leave_the_choice_to_eval_every() {
    let top = r#""camera_angle_x": 1.0, "w": 64, "h": 48"#;
    let json_of = |top: &str| transforms(top, &NAMES);
    let json = json_of(top);
    let scene = written([("transforms_train.json", json.clone())]);
    let every_second = Split { train: vec![1, 3], test: vec![0, 2] };
    assert_eq!(open(scene.path()).split(2), every_second);
    assert_eq!(open(scene.path()).split(1).test.len(), 4);
    write(scene.path(), [("transforms_test.json", json)]);
    let opened = open(scene.path());
    assert_eq!((opened.views.len(), opened.split(2)), (4, every_second.clone()));
    assert!(notes(&opened).contains("4 views listed for both training and test"));
    // The copy may have rounded poses, and names without extension.
    let json = String::from_utf8(json_of(top)).unwrap().replace("[[1,0,0,0]", "[[0.99999,0,0,0.00001]");
    for copy in [json.clone(), json.replace(".png", "")] {
        let scene = written([("transforms_train.json", json_of(top)), ("transforms_test.json", copy.into_bytes())]);
        for name in NAMES {
            picture(&scene.path().join(name), 64, 48);
        }
        assert_eq!(open(scene.path()).split(2), every_second.clone());
    }
    // Some views are in both files: those that are for test alone are held out.
    write(scene.path(), [("transforms_test.json", transforms(top, &["a.png", "e.png"]))]);
    assert_eq!(open(scene.path()).split(2), Split { train: vec![0, 1, 2, 3], test: vec![4] });
    let top = r#""fl_x": 50, "w": 64, "h": 48, "train_filenames": ["a.png", "b.png", "c.png", "d.png"]"#;
    let scene = written([("transforms.json", transforms(top, &NAMES))]);
    assert_eq!(open(scene.path()).split(2), every_second);
}

#[test]
fn one_photo_is_trained_on_unless_all_are_held_out() {
    let scene = capture(&["a.png"], &["a.png"]);
    assert_eq!(open(scene.path()).split(8), Split { train: vec![0], test: vec![] });
    assert_eq!(open(scene.path()).split(1), Split { train: vec![], test: vec![0] });
}

#[test]
fn mirrored_poses_are_named() {
    let json = String::from_utf8(transforms(r#""fl_x": 50, "w": 64, "h": 48"#, &NAMES)).unwrap();
    let mirrored = json.replacen("[[1,0,0,0]", "[[-1,0,0,0]", 1);
    let scene = written([("transforms.json", mirrored.into_bytes())]);
    let opened = open(scene.path());
    assert_eq!((opened.views.len(), opened.skipped.mirrored_poses.count), (3, 1));
    assert!(notes(&opened).contains("1 pose mirrored, as of left-handed axes"));
}

#[test]
fn absent_files_that_a_capture_names_are_counted() {
    let scene = tempfile::tempdir().unwrap();
    let json = String::from_utf8(transforms(r#""fl_x": 50, "w": 64, "h": 48"#, &NAMES)).unwrap();
    write(
        scene.path(),
        [("transforms.json", json.replace("\"file_path\"", "\"mask_path\": \"m.png\", \"file_path\"").into())],
    );
    assert!(notes(&open(scene.path())).contains("4 mask files listed but absent (m.png"));
}

#[test]
fn repeated_points_are_merged_and_counted() {
    let mut model = Model::sample();
    let once = model.points.clone();
    model.points = [once.clone(), once.clone(), once].concat();
    let scene = written(model.binary());
    let opened = open(scene.path());
    assert_eq!((opened.points.len(), opened.skipped.repeated_points), (40, 80));
}

/// BigTIFF is read, whatever its name says.
#[test]
fn photos_may_be_of_bigtiff() {
    let pixels: Vec<u8> = (0..64 * 48 * 3).map(|i| (i % 251) as u8).collect();
    let mut file = std::io::Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new_big(&mut file).unwrap();
    encoder.write_image::<tiff::encoder::colortype::RGB8>(64, 48, &pixels).unwrap();
    for name in ["a.tif", "a.jpg"] {
        let scene = capture(&[name], &[]);
        write(&scene.path().join("images"), [(name, file.get_ref().clone())]);
        let mut opened = open(scene.path());
        assert_eq!(opened.views[0].photo_size, Some((64, 48)), "{name}");
        let photos = opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        assert_eq!(photos[0].pixels.at(1).unwrap(), [3, 4, 5, 255], "{name}");
    }
}

/// TIFF of 8 and 16 bits is read unchanged; floats of EXR are linear and get the curve of sRGB; other formats are named
/// in errors.
#[test]
fn photos_of_cameras_and_renderers_are_read_or_named() {
    let scene = capture(&["a.tif", "b.tif", "c.exr"], &["a.tif"]);
    let images = scene.path().join("images");
    let even = |v: u16| image::ImageBuffer::from_pixel(64, 48, image::Rgb([v; 3]));
    image::DynamicImage::ImageRgb16(even(0x8080)).save(images.join("b.tif")).unwrap();
    let linear = image::ImageBuffer::from_pixel(64, 48, image::Rgb([0.216_f32, 2.0, -1.0]));
    image::DynamicImage::ImageRgb32F(linear).save(images.join("c.exr")).unwrap();
    let mut opened = open(scene.path());
    let photos = opened.load_photos(&LoadOptions { resize: Resize::Full, ..LoadOptions::default() }, &|_| {}).unwrap();
    assert_eq!(photos.len(), 3, "{}", notes(&opened));
    assert_eq!(photos[1].pixels.at(70).unwrap(), [128, 128, 128, 255]);
    assert_eq!(photos[2].pixels.at(70).unwrap(), [128, 255, 0, 255]);
    fs::write(images.join("c.exr"), exr_of(&["ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B"]))
        .unwrap();
    let error = open(scene.path()).views[2].load_photo(Resize::Full).unwrap_err().to_string();
    assert!(error.contains("several layers") && error.contains("Blender"), "{error}");
    for (bytes, format) in
        [(&b"\0\0\0\x18ftypheic"[..], "HEIC"), (b"\0\0\0\x18ftypavif", "AVIF"), (b"BM123456789", "BMP")]
    {
        fs::write(images.join("a.tif"), bytes).unwrap();
        let opened = open(scene.path());
        let error = opened.views[0].load_photo(Resize::Full).unwrap_err().to_string();
        assert!(error.contains(&format!("is {format}")) && error.contains("magick mogrify"), "{error}");
    }
}
