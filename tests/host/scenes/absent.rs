//! Photos that are absent, or that lie where their capture does not say: what is found for them, and what never is.

use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::sync::Mutex;

use super::dialects::{capture, notes, open};
use super::traps::grey;
use super::{TOP, transformed};
use crate::support::files::writers::{picture, row, transforms, write, written};
use qirf_vk::job::{Error, Selection, Silent, Watcher};
use qirf_vk::pipeline::prepare;
use qirf_vk::scene::{LoadOptions, OpenOptions, PhotoMemory, PhotoTree, Resize, Scene, masks_of, photo_folder};

const NAMES: [&str; 3] = ["a.png", "b.png", "c.png"];

/// Two captures of the photos `NAMES` with these pictures: of COLMAP, and a transforms.json that lists bare names.
fn captures(files: &[&str]) -> [tempfile::TempDir; 2] {
    let colmap = tempfile::tempdir().unwrap();
    write(&colmap.path().join("sparse/0"), row(&NAMES).text());
    for file in files {
        picture(&colmap.path().join(file), 64, 48);
    }
    [colmap, transformed(transforms(TOP, &NAMES), files)]
}

/// The photos found, by their paths within the capture.
fn found(root: &Path) -> Vec<String> {
    let files = open(root).views.into_iter().filter(|view| view.image.is_file());
    files.map(|view| view.image.strip_prefix(root).unwrap().to_string_lossy().replace('\\', "/")).collect()
}

#[test]
fn masks_maps_and_thumbnails_never_stand_for_photos() {
    for (files, there) in [
        (&["masks/a.png", "masks/b.png", "masks/c.png"][..], &[][..]),
        (&["depth/a.png", "depth/b.png", "depth/c.png"], &[]),
        (&["images/thumbs/a.png", "images/thumbs/b.png", "images/c.png"], &["images/c.png"]),
        (&["images/a.png", "images/b.png", "images/masks/c.png"], &["images/a.png", "images/b.png"]),
        (&["images/a.png", "images/b.png", "images/depth/c.png"], &["images/a.png", "images/b.png"]),
        (&["images/a.png", "images/b.png", "masks/c.png"], &["images/a.png", "images/b.png"]),
        (&["a.png", "b.png", "depth/c.png", "masks/c.png"], &["a.png", "b.png"]),
    ] {
        for capture in captures(files) {
            assert_eq!(found(capture.path()), there, "{files:?}");
            let mut scene = open(capture.path());
            assert_eq!(scene.require_photos().is_ok(), !there.is_empty());
            assert_eq!(scene.skipped.missing_images.count, 3 - there.len(), "{files:?}");
        }
    }
}

#[test]
fn photos_are_found_beside_masks_maps_and_copies() {
    let within = |folder: &str| NAMES.map(|name| format!("{folder}/{name}"));
    for (folder, others) in [
        ("frames", &["masks"][..]),
        ("frames", &["depth"]),
        ("images", &["masks", "depth"]),
        ("images", &["images_2", "depth"]),
        ("images", &["images_2", "images_4", "undistorted"]),
        ("images_4", &["masks"]),
        ("images_2", &["images_4", "images_8"]),
        ("frames", &["images_4"]),
    ] {
        let files: Vec<String> = [folder].iter().chain(others).flat_map(|folder| within(folder)).collect();
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        for (capture, colmap) in captures(&files).into_iter().zip([true, false]) {
            if (folder, colmap) == ("frames", false) && others.contains(&"images_4") {
                continue; // bare names say nothing of either folder
            }
            assert_eq!(found(capture.path()), within(folder), "{folder} beside {others:?}");
            let masks = open(capture.path()).views.iter().filter(|view| view.mask.is_some()).count();
            assert_eq!(masks, if others.contains(&"masks") { 3 } else { 0 }, "{folder} beside {others:?}");
            let told = notes(&open(capture.path())).contains("the photos are those of");
            assert_eq!(told, colmap && folder != "images", "{folder}");
        }
    }
    // Names without an extension, as of Blender.
    let capture = written([("transforms.json", transforms(TOP, &["a", "b", "c"]))]);
    for file in ["images", "images_2", "images_4"].iter().flat_map(|folder| within(folder)) {
        picture(&capture.path().join(file), 64, 48);
    }
    assert_eq!(found(capture.path()), within("images"));
}

/// A TIFF of floats, 64 x 48, as of a depth map.
pub fn floats() -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
    encoder.write_image::<tiff::encoder::colortype::Gray32Float>(64, 48, &[0.5_f32; 64 * 48]).unwrap();
    file.into_inner()
}

/// They may be its mask or depth map.
#[test]
fn grey_pictures_with_a_photos_name_do_not_stand_for_it() {
    for (listed, files, there) in [
        ("a.JPG", &["a.jpg"][..], &["images/a.jpg"][..]),
        ("A.jpg", &["a.jpeg"], &["images/a.jpeg"]),
        ("a.jpg", &["a.tif"], &["images/a.tif"]),
        ("a", &["a.jpg"], &["images/a.jpg"]),
        ("a", &[], &["images/a.png"]),
        ("a.jpg", &[], &[]),
        ("A.HEIC", &[], &[]),
    ] {
        let colmap = capture(&[listed, "b.jpg", "z.jpg"], &[]);
        let names = [listed, "b.jpg", "z.jpg"].map(|name| format!("images/{name}"));
        let other = written([("transforms.json", transforms(TOP, &names.each_ref().map(String::as_str)))]);
        for root in [colmap.path(), other.path()] {
            for file in files.iter().chain(&["z.jpg"]) {
                picture(&root.join("images").join(file), 64, 48);
            }
            grey(&root.join("images/a.png"), |_| [255, 255]);
            write(&root.join("images"), [("b.tif", floats())]);
            assert_eq!(found(root), [there, &["images/z.jpg"]].concat(), "{listed}");
        }
    }
}

#[test]
fn masks_in_colours_do_not_stand_for_a_photo_either() {
    for listed in ["a", "a.heic"] {
        let colmap = capture(&[listed], &["a.jpg", "a.png"]);
        let name = format!("images/{listed}");
        let other = transformed(transforms(TOP, &[name.as_str()]), &["images/a.jpg", "images/a.png"]);
        for root in [colmap.path(), other.path()] {
            assert_eq!(found(root), ["images/a.jpg"], "{listed}");
        }
    }
    // A PNG of a palette.
    let colmap = capture(&["a.jpg", "z.jpg"], &["z.jpg"]);
    let other = transformed(transforms(TOP, &["images/a.jpg", "images/z.jpg"]), &["images/z.jpg"]);
    for root in [colmap.path(), other.path()] {
        let header = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x40\0\0\0\x30\x08\x03\0\0\0";
        write(&root.join("images"), [("a.png", header.to_vec())]);
        assert_eq!(found(root), ["images/z.jpg"]);
    }
}

/// As of a monochrome camera.
#[test]
fn grey_photos_may_all_be_converted() {
    for listed in [["a.tif", "b.tif"], ["a.bmp", "b.bmp"], ["a.jpg", "b.jpg"]] {
        let colmap = capture(&listed, &[]);
        let names = listed.map(|name| format!("images/{name}"));
        let other = written([("transforms.json", transforms(TOP, &names.each_ref().map(String::as_str)))]);
        for root in [colmap.path(), other.path()] {
            for name in ["images/a.png", "images/b.png"] {
                grey(&root.join(name), |_| [99, 255]);
            }
            assert_eq!(found(root), ["images/a.png", "images/b.png"], "{listed:?}");
        }
    }
    // Beside a camera in colours.
    let colmap = capture(&["left/a.jpg", "mono/a.jpg"], &["left/a.jpg"]);
    let listed = ["images/left/a.jpg", "images/mono/a.jpg"];
    let other = transformed(transforms(TOP, &listed), &listed[..1]);
    for root in [colmap.path(), other.path()] {
        grey(&root.join("images/mono/a.png"), |_| [99, 255]);
        assert_eq!(found(root), ["images/left/a.jpg", "images/mono/a.png"]);
    }
    // A camera in colours and one in greys, in one folder.
    let mixed = capture(&["a.tif", "b.tif"], &["a.png"]);
    grey(&mixed.path().join("images/b.png"), |_| [99, 255]);
    assert_eq!(found(mixed.path()), ["images/a.png", "images/b.png"]);
    // The preview of a depth map.
    let colmap = capture(&["a"], &["a.png"]);
    image::GrayImage::from_pixel(64, 48, image::Luma([99])).save(colmap.path().join("images/a.jpg")).unwrap();
    assert_eq!(found(colmap.path()), ["images/a.png"]);
    // The copy of a photo that is not read may be grey, but that of a JPEG may be its mask.
    for (listed, used) in [("a.tif", "images/a.png"), ("a.jpg", "images/a.jpg")] {
        let colmap = capture(&[listed], &[]);
        write(&colmap.path().join("images"), [(listed, b"\0\0\0\x18ftypheic".to_vec())]);
        grey(&colmap.path().join("images/a.png"), |_| [99, 255]);
        assert_eq!(found(colmap.path()), [used]);
    }
}

#[test]
fn smaller_copies_stand_for_all_photos_or_none() {
    let json = transforms(TOP, &["images/a.png", "images/b.png"]);
    let scene = transformed(json, &["images_2/a.png", "images_4/a.png", "images_4/b.png"]);
    assert_eq!(found(scene.path()), ["images_2/a.png"]);
    picture(&scene.path().join("images/b.png"), 64, 48);
    assert_eq!(found(scene.path()), ["images/b.png"]);
}

/// The remedy that errors and notes name, `magick mogrify -format jpg`, leaves the original.
#[test]
fn a_converted_photo_replaces_its_original_that_is_not_read() {
    for extension in ["bmp", "gif", "tga", "HEIC", "jp2", "ppm"] {
        for keep in [true, false] {
            let listed = format!("a.{extension}");
            let colmap = capture(&[&listed], &[]);
            let json = transforms(TOP, &[&format!("images/{listed}")]);
            let other = written([("transforms.json", json)]);
            for root in [colmap.path(), other.path()] {
                picture(&root.join("images/a.jpg"), 64, 48);
                if keep {
                    fs::write(root.join("images").join(&listed), b"x").unwrap();
                }
                assert_eq!(found(root), ["images/a.jpg"], "{listed}, kept: {keep}");
                assert_eq!(notes(&open(root)), "", "{listed}");
            }
        }
    }
}

/// Likewise for photos whose encoding or format, which is not that of their name, is not read.
#[test]
fn a_converted_photo_replaces_its_original_whatever_that_is_called() {
    for (listed, bytes, copy) in [
        ("a.tif", &floats()[..], "a.png"),
        ("a.png", b"\0\0\0\x18ftypheic", "a.jpg"),
        ("a.jpg", b"\x1f\x8b\x08\0", "a.png"),
        ("a.jpg", b"GIF89a", "a.png"),
        // A JPEG of 12 bits.
        ("a.jpg", b"\xff\xd8\xff\xc1\0\x0b\x0c\0\x30\0\x40\x01\x01\x11\0", "a.png"),
    ] {
        let colmap = capture(&[listed], &[]);
        let other = written([("transforms.json", transforms(TOP, &[&format!("images/{listed}")]))]);
        for root in [colmap.path(), other.path()] {
            write(&root.join("images"), [(listed, bytes.to_vec())]);
            assert_eq!(found(root), [format!("images/{listed}")]);
            assert!(open(root).views[0].load_photo(Resize::Full).is_err(), "{listed}");
            picture(&root.join("images").join(copy), 64, 48);
            assert_eq!(found(root), [format!("images/{copy}")], "{listed}");
            assert_eq!(notes(&open(root)), "", "{listed}");
        }
    }
    // A photo that is read stays.
    let [colmap, _] = captures(&["images/a.png", "images/a.jpg"]);
    assert_eq!(found(colmap.path()), ["images/a.png"]);
}

#[test]
fn photos_that_are_there_in_another_format_alone_are_named() {
    let [colmap, _] = captures(&[]);
    let told = || open(colmap.path()).require_photos().unwrap_err().to_string();
    assert!(told().ends_with("images/a.png does not exist)"), "{}", told());
    write(&colmap.path().join("images"), [("a.HEIC", b"x".to_vec()), ("b.tga", b"x".to_vec())]);
    let convert = "convert it, with ImageMagick: `magick mogrify -format jpg -quality 95 *.HEIC`)";
    let wanted = format!("a.png: only a.HEIC is there, in HEIC, which is not read: {convert}");
    assert!(told().ends_with(&wanted), "{}", told());
}

#[test]
fn photos_that_are_not_read_are_told_from_damaged_ones() {
    let [capture, _] = captures(&["images/a.png"]);
    let images = capture.path().join("images");
    fs::write(images.join("b.png"), b"\0\0\0\x18ftypheic").unwrap();
    fs::write(images.join("c.png"), b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n").unwrap();
    let mut scene = open(capture.path());
    assert_eq!(scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap().len(), 1);
    assert_eq!((scene.skipped.unread_images.count, scene.skipped.damaged_images.count), (2, 0));
    assert!(notes(&scene).contains("2 photos not read (b.png, c.png)"), "{}", notes(&scene));
    assert!(notes(&scene).contains("is HEIC or a video, which is not read: convert it"), "{}", notes(&scene));
    for (bytes, told) in [
        (&b"version https://git-lfs.github.com/spec/v1\n"[..], "run `git lfs pull`"),
        (b"<!DOCTYPE html><html>", "perhaps a web page: download the photo again"),
        (b"", "is empty: copy it again"),
        (b"\x1f\x8b\x08\0", "unpack it by `gzip -dc < b.png > "),
    ] {
        fs::write(images.join("b.png"), bytes).unwrap();
        let error = open(capture.path()).views[1].load_photo(Resize::Full).unwrap_err().to_string();
        assert!(error.contains(told) && !error.contains("magick"), "{error}");
    }
    // So are the capture's own files.
    fs::write(capture.path().join("sparse/0/images.txt"), b"version https://git-lfs.github.com/spec/v1\n").unwrap();
    let error = Scene::open(capture.path(), &OpenOptions::default()).unwrap_err().to_string();
    assert!(error.contains("images.txt") && error.contains("git lfs pull"), "{error}");
}

/// Lines on losses, and others.
#[derive(Default)]
pub struct Told([Mutex<Vec<String>>; 2]);

impl Told {
    pub fn lines(self) -> [String; 2] {
        self.0.map(|lines| lines.into_inner().unwrap().join("\n"))
    }
}

impl Watcher for Told {
    fn lost(&self, line: &str) {
        self.0[0].lock().unwrap().push(line.to_owned());
    }

    fn note(&self, line: &str) {
        self.0[1].lock().unwrap().push(line.to_owned());
    }
}

#[test]
fn losses_are_told_apart_from_notes() {
    let [capture, _] = captures(&["images/a.png", "images/b.png"]);
    fs::write(capture.path().join("sparse/0/test.txt"), "a.png\nz.png\n").unwrap();
    let mut opened = prepare::open(&Selection::of(capture.path().to_owned())).unwrap();
    opened.scene.skipped.repeated_points = 3;
    let told = Told::default();
    opened.load(PhotoMemory::default(), &told).unwrap();
    let [lost, noted] = told.lines();
    for (told, is_loss) in [
        ("1 photo listed but absent (c.png)", true),
        ("1 name in", true),
        ("3 points merged with others", false),
        ("1 photo held out, as", false),
    ] {
        assert_eq!([&lost, &noted].map(|lines| lines.contains(told)), [is_loss, !is_loss], "{told}: {lost}; {noted}");
    }
}

#[test]
fn exports_of_apps_hold_photos_once() {
    let folder = tempfile::tempdir().unwrap();
    let frames = ["frame_00000.jpg", "frame_00001.jpg"];
    for file in frames.iter().chain(&["thumb_00.jpg", "thumb_01.jpg", "textured_output.jpg", "thumbnail.jpg"]) {
        picture(&folder.path().join(file), 8, 6);
    }
    assert_eq!(PhotoTree::of(folder.path()).names, frames);
    assert_eq!(PhotoTree::of(folder.path()).aside.len(), 4);
    let folder = tempfile::tempdir().unwrap();
    for file in ["images/1.jpg", "corrected_images/1.jpg"] {
        picture(&folder.path().join(file), 8, 6);
    }
    assert_eq!(photo_folder(folder.path(), None), Some(folder.path().join("corrected_images")));
}

#[test]
fn depth_maps_may_say_whose_they_are() {
    let [capture, _] = captures(&["images/a.png", "images/b.png", "images/c.png"]);
    let with = |folder: &str| {
        let options = OpenOptions { depth: Some(folder.into()), ..OpenOptions::default() };
        Scene::open(capture.path(), &options).unwrap()
    };
    let files = ["a_depth.npy", "depth_b.npy", "a_masked.png"];
    write(&capture.path().join("one"), files.map(|file| (file, b"x".to_vec())));
    let scene = with("one");
    assert_eq!(scene.views.iter().map(|view| view.depth.is_some()).collect::<Vec<_>>(), [true, true, false]);
    assert_eq!(scene.skipped.missing_depths.examples, ["c.png"]);
    // None of two is chosen.
    write(
        &capture.path().join("both"),
        [("a_depth.npy", b"x".to_vec()), ("depth_a.npy", b"x".to_vec()), ("depth_b.npy", b"x".to_vec())],
    );
    assert_eq!(with("both").skipped.missing_depths.examples, ["a.png", "c.png"]);
    write(&capture.path().join("deeper/images"), [("a.npy", b"x".to_vec()), ("c.npy", b"x".to_vec())]);
    assert_eq!(with("deeper").skipped.missing_depths.examples, ["b.png"]);
    write(&capture.path().join("two"), [("other.npy", b"x".to_vec())]);
    let scene = with("two");
    assert_eq!(scene.skipped.missing_depths.count, 0);
    assert!(notes(&scene).contains("holds 1 file such as other.npy, none a depth map with"), "{}", notes(&scene));
    write(&capture.path().join("packed"), [("a.npz", b"x".to_vec()), ("depth_b.pfm", b"x".to_vec())]);
    let told = notes(&with("packed"));
    assert!(told.contains("holds 2 files, and a.npz is .npz, which is not read: save as .npy"), "{told}");
    assert_eq!(masks_of(&capture.path().join("images"))("a.png"), None);
}

/// Masks of 16 bits whose numbers are those of 8 bits or less.
#[test]
fn masks_of_16_bits_count_by_their_own_numbers() {
    for (value, shown) in [(1, 255), (100, 255), (255, 255), (256, 255), (1000, 255), (32_768, 255), (65_535, 255)] {
        let [capture, _] = captures(&["images/a.png"]);
        let mask = image::ImageBuffer::from_fn(64, 48, |x, _| image::Luma([if x < 16 { 0_u16 } else { value }]));
        fs::create_dir_all(capture.path().join("masks")).unwrap();
        image::DynamicImage::ImageLuma16(mask).save(capture.path().join("masks/a.png")).unwrap();
        let mut scene = open(capture.path());
        scene.require_photos().unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        let fourth = |x: usize| photos[0].pixels.at(x).unwrap()[3];
        assert_eq!((fourth(15), fourth(16)), (0, shown), "{value}");
    }
    // Masks that hide everything leave nothing to train on.
    let [capture, _] = captures(&["images/a.png", "images/b.png", "images/c.png"]);
    for name in ["masks/b.png", "masks/c.png"] {
        grey(&capture.path().join(name), |_| [0, 255]);
    }
    let selection = Selection::of(capture.path().to_owned());
    let train = || prepare::open(&selection).unwrap().load_to_train(PhotoMemory::default(), &Silent).map(|_| ());
    assert!(matches!(train(), Err(Error::AllHidden(_))));
    grey(&capture.path().join("masks/c.png"), |x| [if x == 0 { 255 } else { 0 }, 255]);
    assert!(train().is_ok());
    let [capture, _] = captures(&["images/a.png"]);
    grey(&capture.path().join("masks/a.png"), |x| [if x < 16 { 100 } else { 200 }, 255]);
    let photos = open(capture.path()).load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!(photos[0].pixels.at(0).unwrap()[3], 127);
}

#[test]
fn a_file_that_may_be_either_of_two_photos_is_neither() {
    let twins = ["left/a.png", "right/a.png", "left/b.png"];
    let scene = capture(&twins, &["a.png", "b.png"]);
    assert_eq!(found(scene.path()), ["images/b.png"]);
    for file in ["images/left/a.png", "images/right/a.png"] {
        picture(&scene.path().join(file), 64, 48);
    }
    assert_eq!(found(scene.path())[..2], ["images/left/a.png", "images/right/a.png"]);
}
