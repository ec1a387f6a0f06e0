//! Captures whose files are incomplete, mixed or named in unusual ways.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::TOP;
use super::dialects::{capture, notes, open};
use super::traps::grey;
use crate::support::files::writers::{picture, row, transforms, write, written};
use qirf_vk::job::Error;
use qirf_vk::pipeline::prepare;
use qirf_vk::scene::{AlphaRole, LoadOptions, OpenOptions, Resize, Role, Scene, load_photos, masks_of};

/// A model of which each file is kept as binary or as text.
fn mixed(kept: &[&str]) -> tempfile::TempDir {
    let scene = tempfile::tempdir().unwrap();
    let model = row(&["a.png", "b.png"]);
    let files = model.text().into_iter().chain(model.binary());
    write(&scene.path().join("sparse/0"), files.filter(|(name, _)| kept.contains(&&**name)));
    scene
}

#[test]
fn each_file_of_a_model_may_be_binary_or_text() {
    let whole = open(mixed(&["cameras.txt", "images.txt", "points3D.txt"]).path());
    for kept in [
        ["cameras.txt", "images.txt", "points3D.bin"],
        ["cameras.bin", "images.bin", "points3D.txt"],
        ["cameras.txt", "images.bin", "points3D.bin"],
        ["cameras.bin", "images.txt", "points3D.txt"],
    ] {
        let scene = mixed(&kept);
        let opened = open(scene.path());
        assert_eq!((opened.views.len(), &opened.points), (2, &whole.points), "{kept:?}");
    }
}

#[test]
fn whole_numbers_may_be_written_with_a_fraction() {
    let mut files = row(&["a.png"]).text();
    let cameras = String::from_utf8(files[0].1.clone()).unwrap();
    files[0].1 = cameras.replace(" 64 48 ", " 64.0 48.00 ").into_bytes();
    assert_ne!(files[0].1, cameras.as_bytes());
    let scene = written(files);
    assert_eq!((open(scene.path()).views[0].lens.width, open(scene.path()).views[0].lens.height), (64, 48));
}

#[test]
fn a_photo_never_stands_for_one_that_is_absent() {
    let scene = capture(&["a.jpg", "a.png"], &[]);
    let json = transforms(TOP, &["images/a.jpg", "images/a.png", "images/b"]);
    let other = written([("transforms.json", json)]);
    for root in [scene.path(), other.path()] {
        for there in ["a.jpg", "b.jpg"] {
            picture(&root.join("images").join(there), 64, 48);
        }
        let absent: Vec<String> = open(root).views.into_iter().filter(|v| !v.image.is_file()).map(|v| v.name).collect();
        assert_eq!(absent.len(), 1, "{absent:?}");
        assert!(absent[0].ends_with("a.png"), "{absent:?}");
    }
}

#[test]
fn a_frame_without_a_pose_is_counted() {
    let json = String::from_utf8(transforms(TOP, &["a.png", "b.png"])).unwrap();
    let at = json.find("\"transform_matrix\"").unwrap();
    let end = at + json[at..].find("]]").unwrap() + 2;
    for nothing in ["null", "[]"] {
        let json = format!("{}\"transform_matrix\": {nothing}{}", &json[..at], &json[end..]);
        let opened = open(written([("transforms.json", json.into_bytes())]).path());
        assert_eq!((opened.views.len(), opened.skipped.bad_poses.count), (1, 1), "{nothing}");
    }
}

#[test]
fn photos_for_validation_and_test_are_for_test() {
    let top = r#""camera_angle_x": 1.0, "w": 64, "h": 48"#;
    let of = |name: &'static str, photo: &str| (name, transforms(top, &[photo]));
    let [train, val] = [of("transforms_train.json", "train/r_0"), of("transforms_val.json", "test/r_1")];
    let opened = open(written([train, val, of("transforms_test.json", "test/r_1")]).path());
    assert_eq!(opened.views.iter().map(|v| v.role).collect::<Vec<_>>(), [Role::Test, Role::Train]);
    assert!(!notes(&opened).contains("both roles are ignored"), "{}", notes(&opened));
}

/// The share of a photo's pixels that its mask shows.
fn shown(root: &Path) -> f64 {
    let photos = open(root).load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!(photos[0].alpha_role, AlphaRole::Mask);
    let pixels = photos[0].pixels.read().unwrap();
    let sum: f64 = pixels.iter().skip(3).step_by(4).map(|a| f64::from(*a)).sum();
    sum / 255.0 / f64::from(64 * 48)
}

#[test]
fn masks_of_instant_ngp_hide_where_they_are_white() {
    for (name, share) in [("dynamic_mask_a.png", 0.75), ("mask_a.png", 0.25)] {
        let scene = capture(&["a.png"], &["a.png"]);
        grey(&scene.path().join("images").join(name), |x| [if x < 16 { 255 } else { 0 }, 255]);
        assert!((shown(scene.path()) - share).abs() < 1e-9, "{name}: {}", shown(scene.path()));
        // `pose` copies masks under their photos' names, which do not say so.
        assert_eq!(masks_of(&scene.path().join("images"))("a.png").is_some(), share < 0.5, "{name}");
    }
}

#[test]
fn folders_and_files_that_may_be_masks_are_told() {
    for (file, told) in [
        ("mattes/a.png", "mattes"),
        ("segmentation/a.png", "segmentation"),
        ("depth/a.png", ""),
        ("masks/a.bmp", "no pictures that are read"),
    ] {
        let scene = capture(&["a.png"], &["a.png"]);
        let path = scene.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::GrayImage::new(64, 48).save_with_format(&path, image::ImageFormat::Png).unwrap();
        let notes = notes(&open(scene.path()));
        assert_eq!(notes.is_empty(), told.is_empty(), "{file}: {notes}");
        assert!(notes.contains(told), "{file}: {notes}");
    }
}

#[test]
fn clouds_that_are_not_read_are_named() {
    let json = |top: &str| transforms(&format!("{TOP}{top}"), &["a.png"]);
    let scene = written([("transforms.json", json("")), ("scan.LAZ", b"LASF".to_vec())]);
    assert!(notes(&open(scene.path())).contains("scan.LAZ is not read; convert it to PLY"));
    let scene =
        written([("transforms.json", json(r#", "ply_file_path": "scan.las""#)), ("scan.las", b"LASF".to_vec())]);
    let error = Scene::open(scene.path(), &OpenOptions::default()).unwrap_err().to_string();
    assert!(error.contains("scan.las") && error.contains("is not a PLY file"), "{error}");
    // nerfstudio's captures of old have points in COLMAP's model alone.
    let scene = written([("transforms.json", json(""))]);
    write(&scene.path().join("colmap/sparse/0"), row(&["a.png"]).text());
    assert!(notes(&open(scene.path())).contains("no points: to use those of "), "{}", notes(&open(scene.path())));
}

#[test]
fn depth_maps_are_found_in_any_case() {
    let scene = written([("transforms.json", transforms(TOP, &["images/A.png", "images/b.png"]))]);
    for map in ["a.PNG", "B.tiff"] {
        picture(&scene.path().join("depth").join(map).with_extension("png"), 8, 6);
        fs::rename(scene.path().join("depth").join(map).with_extension("png"), scene.path().join("depth").join(map))
            .unwrap();
    }
    let options = OpenOptions { depth: Some("depth".into()), ..OpenOptions::default() };
    let opened = Scene::open(scene.path(), &options).unwrap();
    assert!(
        opened.views.iter().all(|view| view.depth.as_ref().is_some_and(|map| map.is_file())),
        "{:?}",
        opened.skipped
    );
}

/// Photos of which a job sees a part keep what alpha means in all of them.
#[test]
fn alpha_may_be_decided_beforehand() {
    let scene = capture(&["a.png"], &["a.png"]);
    let clear =
        |share: u32| image::RgbaImage::from_fn(64, 48, |x, _| image::Rgba([9, 9, 9, if x < share { 0 } else { 255 }]));
    let role = |columns: u32, alpha: Option<bool>| {
        let mut picture = clear(columns);
        // A speck beside the columns.
        picture.put_pixel(63, 0, image::Rgba([9, 9, 9, 0]));
        picture.save(scene.path().join("images/a.png")).unwrap();
        let opened = open(scene.path());
        let options = LoadOptions { alpha, ..LoadOptions::default() };
        let loaded = load_photos(&[&opened.views[0]], &options, &|_| {}).unwrap();
        loaded.photos[0].as_ref().unwrap().alpha_role
    };
    for columns in [0, 32] {
        let own = if columns == 0 { AlphaRole::Opaque } else { AlphaRole::Alpha };
        assert_eq!(role(columns, None), own);
        assert_eq!(role(columns, Some(true)), AlphaRole::Alpha);
        assert_eq!(role(columns, Some(false)), AlphaRole::Opaque);
    }
}

/// nerfstudio's lists beside a COLMAP model's photos give the roles; 3DGS's counts without them.
#[test]
fn lists_beside_a_model_give_the_roles() {
    let scene = capture(&["a.png", "b.png", "c.png", "d.png", "e.png"], &[]);
    let list = |file: &str, names: &str| fs::write(scene.path().join(file), names).unwrap();
    let roles = || {
        let opened = open(scene.path());
        let roles: Vec<_> = opened.views.iter().map(|view| (view.name[..1].to_owned(), view.role)).collect();
        (roles, notes(&opened))
    };
    let of = |names: &str, all: &[Role]| names.chars().map(String::from).zip(all.iter().copied()).collect::<Vec<_>>();
    let (train, test) = (Role::Train, Role::Test);
    list("train_test_lists.json", "{}");
    assert!(roles().1.contains("train_test_lists.json is not read: write its names to train_list.txt"));
    list("sparse/0/test.txt", "e.png\n");
    assert_eq!(roles().0, of("abcde", &[train, train, train, train, test]));
    list("test_list.txt", "a.png\r\nb.png\r\n");
    assert_eq!(roles().0, of("abcde", &[test, test, train, train, train]));
    list("train_list.txt", "c.png\n");
    list("validation_list.txt", "b.png\nd.png\nx.png\n");
    let (found, told_of) = roles();
    assert_eq!(found, of("abcd", &[test, test, train, Role::Validation]));
    for told in ["1 photo to use, as", "1 name in", "1 photo in neither train_list.txt nor", "not used (e.png)"] {
        assert!(told_of.contains(told), "{told_of}");
    }
    list("train_list.txt", "a.png\nc.png\n");
    assert_eq!(roles().0, of("abcd", &[Role::Unsaid, test, train, Role::Validation]));
    // Of photos whose names differ in the extension alone, the one listed.
    let scene = capture(&["a.jpg", "a.png", "b.png", "c.png"], &[]);
    fs::write(scene.path().join("sparse/0/test.txt"), "a.jpg\nB\nA\n").unwrap();
    let opened = open(scene.path());
    assert_eq!(opened.views.iter().map(|view| view.role).collect::<Vec<_>>(), [test, train, test, train]);
    for told in ["2 photos held out, as", "1 name in", "that several photos share"] {
        assert!(notes(&opened).contains(told), "{}", notes(&opened));
    }
    fs::write(scene.path().join("sparse/0/test.txt"), "a\n").unwrap();
    for told in ["names no single photo: nothing is held out", "1 name in", "that several photos share"] {
        assert!(notes(&open(scene.path())).contains(told), "{}", notes(&open(scene.path())));
    }
}

/// A TIFF of 64 x 48 pixels, perhaps with alpha that its colours are multiplied by.
fn tiff_of<C: tiff::encoder::colortype::ColorType>(numbers: &[C::Inner], alpha: bool) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut file = std::io::Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
    let mut image = encoder.new_image::<C>(64, 48).unwrap();
    if alpha {
        image.encoder().write_tag(tiff::tags::Tag::ExtraSamples, 1_u16).unwrap();
    }
    image.write_data(numbers).unwrap();
    file.into_inner()
}

#[test]
fn headers_tell_encodings_that_are_not_read_multiplied_colours_and_profiles() {
    use image::ImageEncoder;
    use tiff::encoder::colortype::{RGB32Float, RGBA8};
    let scene = capture(&["a.tif", "b.png"], &[]);
    let images = scene.path().join("images");
    let multiplied = tiff_of::<RGBA8>(&[60_u8, 30, 0, 128].repeat(64 * 48), true);
    write(&images, [("a.tif", multiplied)]);
    image::RgbaImage::from_pixel(64, 48, image::Rgba([120, 60, 0, 128])).save(images.join("b.png")).unwrap();
    let photos = open(scene.path()).load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!(photos[0].pixels.at(5).unwrap(), photos[1].pixels.at(5).unwrap());

    // Without SampleFormat (339), numbers are whole ones.
    let mut whole = tiff_of::<RGB32Float>(&vec![0.5_f32; 3 * 64 * 48], false);
    let tag = whole.windows(4).position(|w| w == [0x53, 1, 3, 0]).unwrap();
    whole[tag] += 1;
    write(&images, [("a.tif", whole)]);
    let fault = |view: usize| open(scene.path()).views[view].load_photo(Resize::Full).unwrap_err().to_string();
    assert!(fault(0).contains("holds whole numbers of 32 bits: save it with 8 or 16 bits"), "{}", fault(0));
    for (marker, bits, told) in
        [(0xc1, 12, "of 12 bits"), (0xc9, 8, "with arithmetic coding"), (0xc3, 8, "with lossless coding")]
    {
        let jpeg = [0xff, 0xd8, 0xff, marker, 0, 11, bits, 0, 48, 0, 64, 1, 1, 0x11, 0];
        write(&images, [("b.png", jpeg.to_vec())]);
        let error = fault(1);
        assert!(error.contains(&format!("is a JPEG {told}")) && error.contains("magick mogrify"), "{error}");
    }
    // A damaged header tells nothing.
    for bits in [0, 9, 255] {
        let jpeg = [0xff, 0xd8, 0xff, 0xc0, 0, 11, bits, 0, 48, 0, 64, 1, 1, 0x11, 0];
        write(&images, [("b.png", jpeg.to_vec())]);
        assert!(!fault(1).contains("is a JPEG"), "{}", fault(1));
    }
    let mut profile = vec![0; 132];
    profile[16..20].copy_from_slice(b"RGB ");
    let mut encoder = image::codecs::png::PngEncoder::new(fs::File::create(images.join("b.png")).unwrap());
    encoder.set_icc_profile(profile).unwrap();
    encoder.write_image(&[90; 3 * 64 * 48], 64, 48, image::ExtendedColorType::Rgb8).unwrap();
    let views = open(scene.path()).views;
    assert_eq!(views[0].foreign_profile(), None);
    assert_eq!(views[1].foreign_profile().as_deref(), Some("without a name"));
}

/// A planned job refuses photos, masks and cameras that changed, and accepts the same ones.
#[test]
fn changes_since_a_plan_are_noticed() {
    let scene = capture(&["a.png", "b.png"], &["a.png", "b.png"]);
    let model = scene.path().join("sparse/0");
    picture(&scene.path().join("masks/b.png"), 64, 48);
    let planned: BTreeMap<String, u32> = prepare::contents(&open(scene.path())).unwrap();
    let changed = || match prepare::unchanged(&open(scene.path()), &planned) {
        Ok(()) => None,
        Err(Error::ChangedPhoto { photo, .. }) => Some(photo),
        Err(error) => panic!("{error}"),
    };
    assert_eq!((planned.len(), changed()), (2, None));
    let mask = scene.path().join("masks/b.png");
    let before = fs::read(&mask).unwrap();
    picture(&mask, 32, 24);
    assert_ne!(before, fs::read(&mask).unwrap());
    assert_eq!(changed(), Some("b.png".to_owned()));
    fs::write(&mask, before).unwrap();
    assert_eq!(changed(), None);
    let text = fs::read_to_string(model.join("cameras.txt")).unwrap();
    fs::write(model.join("cameras.txt"), text.replace(" 64 48 ", " 128 96 ")).unwrap();
    assert_eq!(changed(), Some("a.png".to_owned()));
    assert!(prepare::unchanged(&open(scene.path()), &BTreeMap::new()).is_ok());
}
