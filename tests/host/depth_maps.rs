//! Depth maps as points: found by name, scaled by the capture's points, refused if they fit none.

mod faces;
mod numbers;

use std::path::Path;

use crate::support::files::writers::{Model, picture, write};
use npyz::WriterBuilder;
use qirf_vk::depth_maps::{self, DepthMaps};
use qirf_vk::effects::{DepthEvidence, DepthWitness, Effect};
use qirf_vk::pipeline::effects::examine;
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{LoadOptions, OpenOptions, Resize, Scene};
use qirf_vk::synth::{SynthOptions, write as write_scene};

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

/// An empty capture, and the folder `depth` in it.
fn with_maps() -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("depth");
    std::fs::create_dir_all(&maps).unwrap();
    (folder, maps)
}

fn npy(path: &Path, value: impl Fn(u32, u32) -> f32) {
    npy_of(path, SIZE, value);
}

fn npy_of(path: &Path, [width, height]: [u32; 2], value: impl Fn(u32, u32) -> f32) {
    let file = std::fs::File::create(path).unwrap();
    let shape = [u64::from(height), u64::from(width)];
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd().unwrap();
    writer.extend((0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| value(x, y))).unwrap();
    writer.finish().unwrap();
}

fn open(root: &Path) -> Scene {
    Scene::open(root, &OpenOptions { depth: Some("depth".into()), ..OpenOptions::default() }).unwrap()
}

/// The maps of these views, their points in the colours of the photos.
fn maps_of(scene: &mut Scene, views: &[usize]) -> DepthMaps {
    let mut maps = depth_maps::of_views(scene, views, Resize::Full);
    let own = scene.points.len();
    scene.points.append(&mut maps.points);
    let photos = scene.load_photos(&LoadOptions::default(), &|_| ()).unwrap();
    depth_maps::colour(scene, own, &photos);
    maps.points = scene.points.split_off(own);
    maps
}

#[test]
fn maps_get_the_scale_of_the_points_and_lie_where_photos_show_them() {
    let (folder, folder_of_maps) = with_maps();
    for with_points in [true, false] {
        wall(folder.path(), with_points, 0.0);
        // Of other scales, half and a quarter, if points tell them.
        let [a, b] = if with_points { [2.0, 1.0] } else { [4.0; 2] };
        npy(&folder_of_maps.join("a.npy"), |_, _| a);
        let steps = image::Luma([(1000.0 * b) as u16]);
        let steps = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(32, 24, steps);
        steps.save(folder_of_maps.join("b.png")).unwrap();
        let mut scene = open(folder.path());
        assert_eq!((scene.skipped.missing_depths.count, &scene.skipped.missing_depths.examples[0][..]), (1, "c.jpg"));
        let maps = maps_of(&mut scene, &[0, 1, 2]);
        let (found, notes) = (&maps.points, &maps.choices);
        println!("{} points, {notes:?}, {:?}", found.len(), maps.evidence);
        // Without points they are compared with each other.
        let by = if with_points { DepthWitness::Points } else { DepthWitness::Maps };
        let expected = DepthEvidence { maps: 2, by, deviation: Some(0.0) };
        assert_eq!(maps.evidence, expected);
        // What a view sees is the wall, in the unit that was found.
        let seen = maps.of("b.jpg").unwrap();
        let depths: Vec<f64> = seen.depths.iter().map(|d| f64::from(*d) * seen.unit).filter(|d| *d > 0.0).collect();
        assert!(depths.len() > 2800 && maps.of("c.jpg").is_none());
        assert!(depths.iter().all(|d| (d - 4.0).abs() < 1e-6));
        assert!(found.len() > 1500);
        assert!(found.iter().all(|p| (p.position.z - 4.0).abs() < 1e-6));
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
        assert!(depth_maps::of_views(&scene, &[2], Resize::Full).points.is_empty());
    }
}

/// Of many points without tracks some are taken; where few of these lie in a map, all. Tracks say which points a photo sees.
#[test]
fn many_points_without_tracks_tell_the_scale() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("depth")).unwrap();
    wall(folder.path(), true, 0.0);
    npy(&folder.path().join("depth/a.npy"), |_, _| 2.0);
    let mut scene = open(folder.path());
    let seen = std::mem::take(&mut scene.points);
    let at = |depth: f64| {
        let mut points = seen.clone();
        for point in &mut points {
            (point.position.z, point.track) = (depth, Vec::new());
        }
        points
    };
    let many = |depth: f64, times: usize| at(depth).into_iter().cycle().take(times * seen.len()).collect::<Vec<_>>();
    for (what, points) in [
        ("few are on the wall", [at(4.0), many(-9.0, 10_000)].concat()),
        ("many are on the wall", [many(4.0, 3000), many(3.0, 1000)].concat()),
        ("most are hidden by the wall", [4.0, 7.0, 10.0, 14.0].map(|depth| many(depth, 1000)).concat()),
        ("tracks say what is seen", [many(3.0, 10_000), seen.clone()].concat()),
    ] {
        scene.points = points;
        // There is no such view.
        scene.points.last_mut().unwrap().track.push(77);
        let maps = depth_maps::of_views(&scene, &[0, 1, 2], Resize::Full);
        assert_eq!((maps.evidence.maps, maps.evidence.by), (1, DepthWitness::Points), "{what}");
        assert!(maps.choices[0].contains("scales 2.000 to 2.000"), "{what}: {:?}", maps.choices);
    }
}

/// A map from which its points deviate, as those that a wall hides do, is no judge of its own scale, if the others have one.
#[test]
fn a_map_far_from_its_points_gets_the_scale_of_the_others() {
    let (folder, folder_of_maps) = with_maps();
    wall(folder.path(), true, 0.0);
    npy(&folder_of_maps.join("a.npy"), |_, _| 4.0);
    npy(&folder_of_maps.join("c.npy"), |x, _| 4.0 / if x < 26 { 1.3 } else { [1.5, 1.7][usize::from(x > 28)] });
    for (b, scales, lent) in [(4.0, "1.000 to 1.000", true), (2.0, "1.000 to 2.000", false)] {
        npy(&folder_of_maps.join("b.npy"), |_, _| b);
        let maps = depth_maps::of_views(&open(folder.path()), &[0, 1, 2], Resize::Full);
        let told = [maps.notes.join("; "), maps.choices.join("; ")].join("; ");
        let unit = maps.of("c.jpg").unwrap().unit;
        assert_eq!((unit - 1.0).abs() < 1e-9, lent, "{unit}: {told}");
        assert_eq!(told.contains("1 depth map too far from the points to tell a scale"), lent, "{told}");
        assert!(told.contains(&format!("from 3 depth maps, scales {scales}")), "{told}");
    }
}

#[test]
fn maps_that_fit_no_scale_or_cannot_be_read_are_left_out_and_told() {
    let (folder, folder_of_maps) = with_maps();
    wall(folder.path(), true, 0.5);
    // The map lies at one depth, the points do not.
    npy(&folder_of_maps.join("a.npy"), |_, _| 4.0);
    picture(&folder_of_maps.join("b.png"), SIZE[0], SIZE[1]);
    std::fs::write(
        folder_of_maps.join("c.npy"),
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4', 'fortran_order': False, 'shape': (48, 64), }\n",
    )
    .unwrap();
    let DepthMaps { points: found, notes, evidence, .. } = maps_of(&mut open(folder.path()), &[0, 1, 2]);
    assert_eq!((evidence.maps, evidence.deviation), (0, None));
    assert!(found.is_empty(), "{notes:?}");
    let told = notes.join("; ");
    for part in
        ["1 depth map at no scale", "1 depth map not used: it is neither one channel of 16 bits nor floats", "(c.jpg)"]
    {
        assert!(told.contains(part), "{told}");
    }
    assert!(!told.contains("from 0 depth maps"), "{told}");
    let decisions = examine(&open(folder.path())).unwrap().0;
    let decision = decisions.into_iter().find(|d| d.name == Effect::Depth).unwrap();
    assert_eq!((decision.on, decision.evidence.as_str()), (false, "no depth map can be used"));
    let packed = folder_of_maps.join("a.npz");
    std::fs::write(&packed, b"PK\x03\x04").unwrap();
    assert_eq!(depth_maps::read::read(&packed, None).unwrap_err(), "is .npz, which is not read: save as .npy");
}

#[test]
fn maps_that_contradict_each_other_are_left_out_where_no_points_tell_their_scale() {
    let (folder, folder_of_maps) = with_maps();
    wall(folder.path(), false, 0.0);
    for (wrong, used) in [(1.0, 3), (2.0, 0)] {
        for (i, name) in ["a.npy", "b.npy", "c.npy"].iter().enumerate() {
            npy(&folder_of_maps.join(name), |_, _| 4.0 * f32::powi(wrong, i as i32));
        }
        let DepthMaps { points, notes, evidence, .. } = maps_of(&mut open(folder.path()), &[0, 1, 2]);
        assert_eq!((evidence.maps, points.is_empty()), (used, used == 0), "{notes:?}");
        assert_eq!(notes.join("; ").contains("apart in the median"), used == 0, "{notes:?}");
    }
}

#[test]
fn negative_depths_are_told() {
    let (folder, folder_of_maps) = with_maps();
    wall(folder.path(), false, 0.0);
    for name in ["a.npy", "b.npy", "c.npy"] {
        npy(&folder_of_maps.join(name), |_, _| -4.0);
    }
    let DepthMaps { points, notes, evidence, .. } = maps_of(&mut open(folder.path()), &[0, 1, 2]);
    assert_eq!((evidence.maps, points.len()), (0, 0), "{notes:?}");
    assert!(notes[0].starts_with("3 depth maps not used: each holds only negative depths"), "{notes:?}");
}

/// An EXR of 2 x 1 pixels with channels of these names, whose values are 1, 2, 3 and so on.
pub fn exr_of(names: &[&str]) -> Vec<u8> {
    use exr::prelude::*;
    let channel = |(i, name): (usize, &&str)| AnyChannel::new(*name, FlatSamples::F32(vec![i as f32 + 1.0; 2]));
    let channels = AnyChannels::sort(names.iter().enumerate().map(channel).collect());
    let mut file = std::io::Cursor::new(Vec::new());
    Image::from_channels((2, 1), channels).write().non_parallel().to_buffered(&mut file).unwrap();
    file.into_inner()
}

#[test]
fn the_channel_of_depths_in_an_exr_is_found_by_its_name() {
    for (names, value) in [
        (&["Z"][..], 1.0),
        (&["V"], 1.0),
        (&["Y"], 1.0),
        (&["distance"], 1.0),
        (&["R", "G", "B"], 1.0),
        (&["R", "G", "B", "Z"], 4.0),
        (&["View Layer.Combined.R", "View Layer.Depth.Z"], 2.0),
    ] {
        let map = depth_maps::read::of_bytes(&exr_of(names), None).unwrap();
        assert_eq!((map.width, map.height, map.depths), (2, 1, vec![value; 2]), "{names:?}");
    }
    let error = depth_maps::read::of_bytes(&exr_of(&["near", "far"]), None).unwrap_err();
    assert!(error.contains("far, near"), "{error}");
}

/// COLMAP's own maps lie by rows; the one that was checked against other photos comes first.
#[test]
fn dense_maps_of_colmap_are_read() {
    let (folder, folder_of_maps) = with_maps();
    wall(folder.path(), true, 0.0);
    let map = |head: &str, depths: &[f32]| {
        let numbers = depths.iter().flat_map(|depth| depth.to_le_bytes());
        head.bytes().chain(numbers).collect::<Vec<u8>>()
    };
    let flat = map("64&48&1&", &[4.0; 64 * 48]);
    for name in ["a.jpg.geometric.bin", "a.jpg.photometric.bin", "b.jpg.photometric.bin"] {
        std::fs::write(folder_of_maps.join(name), &flat).unwrap();
    }
    let scene = open(folder.path());
    let found: Vec<_> = scene.views.iter().map(|view| view.depth.clone()).collect();
    let expected = ["a.jpg.geometric.bin", "b.jpg.photometric.bin"].map(|name| Some(folder_of_maps.join(name)));
    assert_eq!(found, [&expected[..], &[None]].concat());
    let rows = [1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0];
    let read = depth_maps::read::of_bytes(&map("3&2&1&", &rows), None).unwrap();
    assert_eq!((read.width, read.height, &read.depths[..]), (3, 2, &rows[..]));
    assert_eq!(depth_maps::of_views(&scene, &[0, 1, 2], Resize::Full).evidence.maps, 2);
    for (bytes, what) in [
        (map("3&2&3&", &rows), "3 x 2 x 3 numbers: give COLMAP's folder depth_maps"),
        (map("3&1&1&", &rows), "24 bytes, not 1 x 3 floats"),
        (map("3&0&1&", &rows), "3 x 0 x 1 numbers"),
        (flat[..90].to_vec(), "82 bytes, not 48 x 64 floats"),
    ] {
        let error = depth_maps::read::of_bytes(&bytes, None).unwrap_err();
        assert!(error.contains(what), "{error}");
    }
}

/// A map of 2 x 3 whose file has its columns one after the other, as `numpy.save` writes a transposed array.
#[test]
fn maps_may_lie_by_columns() {
    let text = format!("{:117}\n", "{'descr': '<f4', 'fortran_order': True, 'shape': (2, 3), }");
    let values = [1.0_f32, 4.0, 2.0, 5.0, 3.0, 6.0].map(f32::to_le_bytes);
    let file = [b"\x93NUMPY\x01\x00\x76\x00", text.as_bytes(), values.as_flattened()].concat();
    let map = depth_maps::read::of_bytes(&file, None).unwrap();
    assert_eq!((map.width, map.height, map.depths), (3, 2, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
}

/// A scene calls for the loss whose maps agree with its points.
#[test]
fn the_evidence_decides_on_the_loss() {
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 9, width: 64, height: 48, points: 300, depth: true, ..SynthOptions::default() };
    write_scene(folder.path(), &options, &|_| ()).unwrap();
    let decide_on = |scene: &Scene| {
        let (decisions, ..) = examine(scene).unwrap();
        let decision = decisions.into_iter().find(|d| d.name == Effect::Depth).unwrap();
        println!("{}", decision.evidence);
        (decision.on, decision.evidence)
    };
    let decide = |options: &OpenOptions| decide_on(&Scene::open(folder.path(), options).unwrap());
    let with = OpenOptions { depth: Some("depth".into()), ..OpenOptions::default() };
    let (on, evidence) = decide(&with);
    assert!(on && evidence.starts_with("7 depth maps, from which the capture's points deviate by 0."), "{evidence}");
    let bare = Scene { points: Vec::new(), ..Scene::open(folder.path(), &with).unwrap() };
    let (on, evidence) = decide_on(&bare);
    assert!(on && evidence.starts_with("7 depth maps, from which others of them deviate by "), "{evidence}");
    assert_eq!(decide(&OpenOptions::default()), (false, "no photo has a depth map".to_owned()));
    // Nonsense at some scale: near the points in the mean, but nowhere right.
    for (i, file) in std::fs::read_dir(folder.path().join("depth")).unwrap().enumerate() {
        let wave = |x: u32, y: u32| 6.0 * (1.0 + 0.12 * ((x / 9 + y / 7 + i as u32) % 5) as f32);
        let file = file.unwrap().path();
        npy(&file, wave);
    }
    let (on, evidence) = decide(&with);
    assert!(!on, "{evidence}");
}

/// What a mask hides is no surface to train on.
#[test]
fn hidden_parts_of_photos_have_no_depth() {
    let folder = tempfile::tempdir().unwrap();
    let maps = folder.path().join("depth");
    std::fs::create_dir_all(&maps).unwrap();
    wall(folder.path(), true, 0.0);
    npy(&maps.join("a.npy"), |_, _| 4.0);
    std::fs::create_dir_all(folder.path().join("masks")).unwrap();
    let mask = image::GrayImage::from_fn(SIZE[0], SIZE[1], |x, _| image::Luma([if x < 20 { 0 } else { 255 }]));
    mask.save(folder.path().join("masks/a.png")).unwrap();
    let mut scene = Scene::open(
        folder.path(),
        &OpenOptions { depth: Some("depth".into()), undistort: Some(false), ..OpenOptions::default() },
    )
    .unwrap();
    let maps = depth_maps::of_views(&scene, &[0, 1, 2], Resize::Full);
    let photos = scene.load_photos(&LoadOptions::default(), &|_| ()).unwrap();
    let shown = maps.shown("a.jpg", &photos[0]).unwrap();
    let there = |x: usize| shown.depths[30 * 64 + x] > 0.0;
    assert_eq!([10, 19, 20, 40].map(there), [false, false, true, true]);
    assert!(maps.shown("b.jpg", &photos[1]).is_none());
}

#[test]
fn an_edge_gives_no_points_and_a_hole_none() {
    let (folder, folder_of_maps) = with_maps();
    wall(folder.path(), false, 0.0);
    npy(&folder_of_maps.join("a.npy"), |x, y| {
        if y < 20 {
            0.0
        } else if x < 32 {
            3.0
        } else {
            6.0
        }
    });
    let mut scene = open(folder.path());
    let found = maps_of(&mut scene, &[0]).points;
    assert!(found.len() > 800, "{}", found.len());
    for point in &found {
        let z = point.position.z;
        assert!(z == 3.0 || z == 6.0);
        let pixel = scene.views[0].lens.project((point.position / z).truncate());
        assert!(pixel.y > 21.0 && (pixel.x - 32.0).abs() > 1.0, "{pixel}");
    }
}

/// The background that renderers write where nothing was hit is no depth.
#[test]
fn backgrounds_are_no_depths() {
    let text = format!("{:117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (10, 10), }");
    let map = |background: f32, rows: usize| {
        let values = (0..100).map(|i| if i < 10 * rows { background } else { 3.0 + i as f32 * 0.01 });
        let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
        let file = [b"\x93NUMPY\x01\x00\x76\x00", text.as_bytes(), &bytes].concat();
        depth_maps::read::of_bytes(&file, None).unwrap().depths.into_iter().filter(|d| *d > 0.0).count()
    };
    for background in [1e10, 65504.0, 1000.0, f32::INFINITY] {
        assert_eq!(map(background, 2), 80, "{background}");
    }
    assert_eq!(map(5.0, 2), 100, "a wall a little behind");
    let mut png = std::io::Cursor::new(Vec::new());
    let steps = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(2, 1, vec![1500, 65535]).unwrap();
    steps.write_to(&mut png, image::ImageFormat::Png).unwrap();
    assert_eq!(depth_maps::read::of_bytes(png.get_ref(), None).unwrap().depths, [1.5, 0.0]);
}

/// The points of a scanner have no neighbours, which is no edge; the rim of a surface is one.
#[test]
fn single_depths_count_where_there_are_no_surfaces() {
    let map = |depth: &dyn Fn(u32, u32) -> f32| {
        let mut file = std::io::Cursor::new(Vec::new());
        let depths: Vec<f32> = (0..48 * 64).map(|n| depth(n % 64, n / 64)).collect();
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
        encoder.write_image::<tiff::encoder::colortype::Gray32Float>(64, 48, &depths).unwrap();
        depth_maps::read::of_bytes(file.get_ref(), None).unwrap()
    };
    let counted = |map: &depth_maps::read::Map| {
        (0..48).flat_map(|y| (0..64).map(move |x| (x, y))).filter(|(x, y)| map.at(*x, *y).is_some()).count()
    };
    let scanner = map(&|x, y| if x % 4 == 0 && y % 4 == 0 { 3.5 } else { 0.0 });
    assert_eq!((counted(&scanner), scanner.at(4, 8)), (16 * 12, Some(3.5)));
    let surface = map(&|x, y| if (8..40).contains(&x) && (8..40).contains(&y) { 2.0 } else { 0.0 });
    assert_eq!(counted(&surface), 30 * 30);
}
