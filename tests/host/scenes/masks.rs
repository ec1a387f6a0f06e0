//! Masks: how they are found, which are used, and what lies under them where photos are resampled.

use super::absent::floats;
use super::dialects::{NAMES, capture, notes, open};
use super::traps::grey;
use crate::support::files::writers::{Model, picture, write};
use image::{GrayImage, Luma, Rgb, RgbImage};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{AlphaRole, LoadOptions, OpenOptions, PhotoTree, Resize, Scene};
use std::path::Path;

/// A photo of one colour on the left through a lens, with this colour under the mask on its right.
fn half_hidden(root: &Path, right: [u8; 3]) {
    let mut model = Model { cameras: Vec::new(), images: Vec::new(), points: Vec::new() };
    model.cameras.push((1, LensModel::SimpleRadial, 64, 48, vec![60.0, 32.0, 24.0, -0.1]));
    model.images.push((1, [1.0, 0.0, 0.0, 0.0], [0.0; 3], 1, "a.png".to_owned(), 0));
    write(&root.join("sparse/0"), model.binary());
    for folder in ["images", "masks"] {
        std::fs::create_dir_all(root.join(folder)).unwrap();
    }
    let photo = RgbImage::from_fn(64, 48, |x, _| Rgb(if x < 32 { [200, 100, 50] } else { right }));
    photo.save(root.join("images/a.png")).unwrap();
    GrayImage::from_fn(64, 48, |x, _| Luma([if x < 32 { 255 } else { 0 }])).save(root.join("masks/a.png")).unwrap();
}

fn pixels(root: &Path, masks: bool, resize: Resize) -> Vec<[u8; 4]> {
    let mut scene = Scene::open(root, &OpenOptions::default()).unwrap();
    let photos = scene.load_photos(&LoadOptions { masks, resize, ..LoadOptions::default() }, &|_| ()).unwrap();
    photos[0].pixels.read().unwrap().as_chunks::<4>().0.to_vec()
}

#[test]
fn what_masks_hide_lends_no_colour_and_masks_that_do_not_count_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for resize in [Resize::Full, Resize::Width(24)] {
        for right in [[0, 255, 0], [255, 0, 255]] {
            half_hidden(folder.path(), right);
            let seen = pixels(folder.path(), true, resize);
            let most = seen.iter().filter(|p| p[3] >= 128).count();
            assert!(3 * most > seen.len(), "{most}");
            for pixel in seen.iter().filter(|p| p[3] >= 64) {
                let off = [200, 100, 50].iter().zip(pixel).map(|(a, b)| u8::abs_diff(*a, *b)).max();
                assert!(off <= Some(3), "{pixel:?}");
            }
            let without_counting = pixels(folder.path(), false, resize);
            std::fs::remove_dir_all(folder.path().join("masks")).unwrap();
            assert!(without_counting == pixels(folder.path(), true, resize), "masks=off is no mask");
        }
    }
}

#[test]
fn masks_are_found_under_the_names_that_tools_give_them() {
    for mask in [
        "masks/a.png.mask.png",
        "masks/a.PNG",
        "masks/a_mask.png",
        "masks/mask_a.png",
        "masks/a.jpg",
        "masks/a.jpg.png",
        "mask/a.png",
        "Masks/a-mask.png",
        "images/a.png.mask.png",
        "images/a_mask.png",
        "images_masks/a.png",
    ] {
        let scene = capture(&["a.png"], &["a.png"]);
        picture(&scene.path().join(mask), 64, 48);
        let opened = open(scene.path());
        assert_eq!(opened.views[0].mask.as_deref(), Some(scene.path().join(mask).as_path()), "{mask}");
        assert_eq!(notes(&opened).matches("without a pose").count(), 0, "{mask}");
    }
    // One mask is not that of two cameras' photos.
    let twins = ["left/a.png", "right/a.png", "right/b.png"];
    let scene = capture(&twins, &twins);
    for mask in ["a.png", "b.png"] {
        picture(&scene.path().join("masks").join(mask), 64, 48);
    }
    let opened = open(scene.path());
    assert_eq!(opened.views.iter().map(|v| v.mask.is_some()).collect::<Vec<_>>(), [false, false, true]);
    assert!(notes(&opened).contains("2 photos in several folders with the same names"), "{}", notes(&opened));
    let scene = capture(&NAMES, &NAMES);
    picture(&scene.path().join("masks/other.png"), 64, 48);
    assert!(notes(&open(scene.path())).contains("holds 1 file such as other.png, none with a photo's name"));
}

/// Whatever the word is that they have beside the name of a photo in colour; numbers are no words, and grey photos have no masks. A file
/// that cannot be read is told of later.
#[test]
fn grey_pictures_called_like_a_photo_in_colour_are_none() {
    let folder = tempfile::tempdir().unwrap();
    for photo in ["a.jpg", "IMG.jpg", "IMG_0001.jpg"] {
        picture(&folder.path().join(photo), 8, 6);
    }
    for file in ["a_matte.png", "a_0001.png", "b.png", "b_left.png"] {
        grey(&folder.path().join(file), |_| [9, 255]);
    }
    write(folder.path(), [("a_height.tif", floats()), ("a_torn.tif", b"II*\0".to_vec())]);
    let tree = PhotoTree::of(folder.path());
    assert_eq!(tree.names, ["IMG.jpg", "IMG_0001.jpg", "a.jpg", "a_0001.png", "a_torn.tif", "b.png", "b_left.png"]);
    assert_eq!(tree.aside, ["a_height.tif", "a_matte.png"]);
    assert!(
        tree.notes()[0]
            .contains("or grey or palette pictures named like a photo in colour (a_height.tif, a_matte.png)")
    );
}

#[test]
fn a_mask_of_another_shape_leaves_its_photo() {
    let scene = capture(&NAMES[..2], &NAMES[..2]);
    picture(&scene.path().join("masks/a.png"), 48, 64);
    picture(&scene.path().join("masks/b.png"), 64, 48);
    let mut opened = open(scene.path());
    let photos = opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!((photos.len(), photos[0].alpha_role), (2, AlphaRole::Mask));
    assert!(photos[0].pixels.read().unwrap().iter().skip(3).step_by(4).all(|a| *a == 255));
    assert!(notes(&opened).contains("1 mask file damaged or of another shape than its photo, not used (a.png)"));
    // The first one's sizes are told.
    picture(&scene.path().join("masks/b.png"), 48, 64);
    let mut opened = open(scene.path());
    opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    let told = notes(&opened);
    assert!(told.contains("2 mask files damaged or of another shape than their photos, not used (a.png, b.png)"));
    assert!(told.contains("masks/a.png is 48 x 64, its photo 64 x 48") && !told.contains("b.png is"), "{told}");
}
