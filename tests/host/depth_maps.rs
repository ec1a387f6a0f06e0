//! Depth maps as points: found by name, scaled by the capture's points, refused if they fit none.

use std::path::Path;

use crate::support::files::writers::{Model, picture, write};
use npyz::WriterBuilder;
use qirf_vk::pipeline::depth_maps::points;
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{OpenOptions, Resize, Scene};

const SIZE: [u32; 2] = [64, 48];

/// Three photos of a wall at z = 4, from places side by side, with points on it, each `behind` the one before.
fn wall(root: &Path, with_points: bool, behind: f64) {
    let mut model = Model { cameras: Vec::new(), images: Vec::new(), points: Vec::new() };
    model.cameras.push((1, LensModel::SimpleRadial, SIZE[0].into(), SIZE[1].into(), vec![60.0, 32.0, 24.0, -0.1]));
    for (i, name) in ["a.jpg", "b.jpg", "c.jpg"].iter().enumerate() {
        picture(&root.join("images").join(name), SIZE[0], SIZE[1]);
        model.images.push((i as u32 + 1, [1.0, 0.0, 0.0, 0.0], [-0.2 * i as f64, 0.0, 0.0], 1, (*name).to_owned(), 0));
    }
    if with_points {
        let place = |i: u32| [f64::from(i % 5) * 0.2 - 0.3, f64::from(i / 5) * 0.2 - 0.3, 4.0 + f64::from(i) * behind];
        model.points = (0..20).map(|i| (place(i), [9, 9, 9], 0.5, vec![1, 2, 3])).collect();
    }
    write(&root.join("sparse/0"), model.binary());
}

fn npy(path: &Path, value: impl Fn(u32, u32) -> f32) {
    let file = std::fs::File::create(path).unwrap();
    let shape = [u64::from(SIZE[1]), u64::from(SIZE[0])];
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd().unwrap();
    writer.extend((0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))).map(|(x, y)| value(x, y))).unwrap();
    writer.finish().unwrap();
}

fn open(root: &Path) -> Scene {
    Scene::open(root, &OpenOptions { depth: Some("depth".into()), ..OpenOptions::default() }).unwrap()
}

#[test]
fn maps_get_the_scale_of_the_points_and_lie_where_photos_show_them() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("depth");
    std::fs::create_dir_all(&maps).unwrap();
    for with_points in [true, false] {
        wall(folder.path(), with_points, 0.0);
        // Of other scales: half, and thousandths of a quarter.
        npy(&maps.join("a.npy"), |_, _| 2.0);
        let steps = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(32, 24, image::Luma([1000]));
        steps.save(maps.join("b.png")).unwrap();
        let scene = open(folder.path());
        assert_eq!((scene.skipped.missing_depths.count, &scene.skipped.missing_depths.examples[0][..]), (1, "c.jpg"));
        let (found, notes) = points(&scene, &[0, 1, 2], Resize::Full);
        println!("{} points, {notes:?}", found.len());
        assert!(found.len() > 1500);
        let z = |which: std::ops::Range<usize>| found[which].iter().all(|p| (p.position.z - 4.0).abs() < 1e-6);
        assert_eq!(z(0..found.len()), with_points, "without points, numbers are world units");
        assert!(notes[0].contains(if with_points { "scales 2.000 to 4.000" } else { "in world units" }), "{notes:?}");
        for point in found.iter().step_by(97) {
            // Of the two photos one has it, red by column and green by row.
            let fits = [0, 1].iter().any(|v| {
                let view = &scene.views[*v];
                let p = view.camera.rotation * point.position + view.camera.translation;
                let at = view.lens.project(p.truncate() / p.z);
                let [r, g] = [255.0 * (at.x - 0.5) / 64.0, 255.0 * (at.y - 0.5) / 48.0];
                (r - f64::from(point.colour[0])).abs() < 9.0 && (g - f64::from(point.colour[1])).abs() < 11.0
            });
            assert!(fits, "{point:?}");
        }
        // A photo that is held out gives no point.
        assert!(points(&scene, &[2], Resize::Full).0.is_empty());
    }
}

#[test]
fn maps_that_fit_no_scale_or_cannot_be_read_are_left_out_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("depth");
    std::fs::create_dir_all(&maps).unwrap();
    wall(folder.path(), true, 0.5);
    // The map lies at one depth, the points do not.
    npy(&maps.join("a.npy"), |_, _| 4.0);
    picture(&maps.join("b.png"), SIZE[0], SIZE[1]);
    std::fs::write(
        maps.join("c.npy"),
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4', 'fortran_order': False, 'shape': (48, 64), }\n",
    )
    .unwrap();
    let (found, notes) = points(&open(folder.path()), &[0, 1, 2], Resize::Full);
    assert!(found.is_empty(), "{notes:?}");
    let told = notes.join("; ");
    for part in ["1 depth map at no scale", "b.jpg has neither 16 bits nor floats", "depth map of c.jpg"] {
        assert!(told.contains(part), "{told}");
    }
}

#[test]
fn an_edge_gives_no_points_and_a_hole_none() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("depth");
    std::fs::create_dir_all(&maps).unwrap();
    wall(folder.path(), false, 0.0);
    npy(&maps.join("a.npy"), |x, y| {
        if y < 20 {
            0.0
        } else if x < 32 {
            3.0
        } else {
            6.0
        }
    });
    let scene = open(folder.path());
    let (found, _) = points(&scene, &[0], Resize::Full);
    assert!(found.len() > 800, "{}", found.len());
    for point in &found {
        let z = point.position.z;
        assert!(z == 3.0 || z == 6.0);
        let pixel = scene.views[0].lens.project((point.position / z).truncate());
        assert!(pixel.y > 21.0 && (pixel.x - 32.0).abs() > 1.0, "{pixel}");
    }
}
