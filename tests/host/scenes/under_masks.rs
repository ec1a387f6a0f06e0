//! What lies under masks, where photos are resampled.

use crate::support::files::writers::{Model, write};
use image::{GrayImage, Luma, Rgb, RgbImage};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{LoadOptions, OpenOptions, Resize, Scene};
use std::path::Path;

/// A photo of one colour on the left through a lens, with this colour under the mask on its right.
fn capture(root: &Path, right: [u8; 3]) {
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
            capture(folder.path(), right);
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
