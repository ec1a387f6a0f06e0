//! What the numbers of depth maps are: of which type; depths, lengths along rays or inverse depths; between pixels; over many photos.

use super::{SIZE, npy, open, wall};
use crate::support::files::writers::{Model, write};
use qirf_vk::depth_maps::{self, DepthMaps};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{Resize, Scene};
use qirf_vk::synth::{SynthOptions, write as write_scene};
use std::path::Path;

/// A map's number by photo, depth and length along the ray.
type Number = dyn Fn(usize, f64, f64) -> f64;

/// Three photos of the wall z = 4 + x / 2 with points of it, and maps of these numbers by photo, depth and length along the ray.
fn slanted(root: &Path, number: impl Fn(usize, f64, f64) -> f64) -> Scene {
    wall(root, true, 0.0);
    std::fs::create_dir_all(root.join("depth")).unwrap();
    let mut model = Model { cameras: Vec::new(), images: Vec::new(), points: Vec::new() };
    model.cameras.push((1, LensModel::Pinhole, SIZE[0].into(), SIZE[1].into(), vec![60.0, 60.0, 32.0, 24.0]));
    for (i, name) in ["a", "b", "c"].iter().enumerate() {
        let left = 0.2 * i as f64;
        model.images.push((i as u32 + 1, [1.0, 0.0, 0.0, 0.0], [-left, 0.0, 0.0], 1, format!("{name}.jpg"), 0));
        npy(&root.join("depth").join(format!("{name}.npy")), |x, y| {
            let [x, y] = [(f64::from(x) - 31.5) / 60.0, (f64::from(y) - 23.5) / 60.0];
            let z = (4.0 + 0.5 * left) / (1.0 - 0.5 * x);
            number(i, z, z * (1.0 + x * x + y * y).sqrt()) as f32
        });
    }
    let point = |i: u32| {
        let [x, y] = [f64::from(i % 10) * 0.3 - 1.2, f64::from(i / 10) * 0.3 - 1.0];
        ([x, y, 4.0 + 0.5 * x], [9, 9, 9], 0.5, vec![1, 2, 3])
    };
    model.points = (0..80).map(point).collect();
    write(&root.join("sparse/0"), model.binary());
    open(root)
}

/// The points tell what the numbers are: depths, lengths along rays, or inverse depths of any scale and offset.
#[test]
fn numbers_of_maps_are_what_the_points_say() {
    let folder = tempfile::tempdir().unwrap();
    let maps = |number: &Number| {
        let scene = slanted(folder.path(), number);
        depth_maps::of_views(&scene, &[0, 1, 2], Resize::Full)
    };
    let kinds: [(&Number, &str, f64); 5] = [
        (&|_, z, _| z, "scales 1.000 to 1.000", 1e-5),
        (&|_, z, _| 0.5 * z * (1.0 + 0.05 * (1e3 * z).sin()), "scales 1.9", 0.06),
        (&|_, _, along| along, "3 depth maps of lengths along rays", 1e-3),
        (&|_, z, _| 1.0 / z, "3 depth maps of inverse depths", 1e-4),
        (&|i, z, _| 3.0 * (i + 1) as f64 / z + 0.7, "3 depth maps of inverse depths", 1e-4),
    ];
    for (number, told, off) in kinds {
        let DepthMaps { points, notes, choices, evidence, .. } = maps(number);
        println!("{notes:?} {choices:?} {evidence:?}");
        assert!(evidence.maps == 3 && evidence.deviation.is_some_and(|share| share < off), "{told}: {evidence:?}");
        assert!(choices.join("; ").contains(told), "{choices:?}");
        assert!(points.len() > 1000);
        let apart = |p: &qirf_vk::scene::Point| (p.position.z - 4.0 - 0.5 * p.position.x).abs();
        assert!(points.iter().all(|p| apart(p) < 8.0 * off), "{told}");
    }
    // Holes of inverse depths are holes, though their offset is a depth.
    let scene = slanted(folder.path(), |_, z, _| if z > 4.4 { 0.0 } else { 3.0 / z - 0.3 });
    let holed = depth_maps::of_views(&scene, &[0, 1, 2], Resize::Full);
    assert!(holed.points.iter().all(|p| p.position.z < 4.5) && holed.points.len() > 500, "{:?}", holed.notes);
    // Too far from the points to be trained on, and to give points.
    let DepthMaps { points, notes, evidence, .. } = maps(&|_, z, _| z * (1.0 + 0.2 * (3.0 * z).sin()));
    assert!(points.is_empty() && evidence.maps == 3, "{notes:?} {evidence:?}");
    assert!(notes.join("; ").contains("no points from 3 depth maps: the capture's points deviate"), "{notes:?}");
    // Most contradict the points, so that the one that fits says nothing.
    let DepthMaps { points, notes, evidence, .. } = maps(&|i, z, _| if i == 0 { z } else { z.powi(5) });
    assert!(points.is_empty() && evidence.maps == 0, "{notes:?} {evidence:?}");
}

/// A small map of a slanted wall shows the wall and no steps.
#[test]
fn depths_lie_between_those_of_pixels() {
    let text = format!("{:117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (4, 4), }");
    let depth = |x: f64| 4.0 / (1.0 - 0.04 * x);
    let values = (0..16).flat_map(|i| (depth(f64::from(i % 4) + 0.5) as f32).to_le_bytes()).collect::<Vec<_>>();
    let map = depth_maps::read::of_bytes(&[b"\x93NUMPY\x01\x00\x76\x00", text.as_bytes(), &values].concat(), None);
    let map = map.unwrap();
    for (x, y) in [(0.5, 0.5), (1.2, 3.4), (2.0, 2.0), (3.3, 0.1), (3.5, 3.9)] {
        let seen = map.between(glam::DVec2::new(x, y)).unwrap();
        assert!((seen / depth(x) - 1.0).abs() < 1e-6, "{x}, {y}: {seen}, not {}", depth(x));
    }
    assert_eq!(
        map.between(glam::DVec2::new(0.0, 3.9)),
        Some(f64::from(depth(0.5) as f32)),
        "no further than its border"
    );
}

/// Each map is near the next, and the last is far from the first.
#[test]
fn maps_that_drift_are_left_out_where_no_points_tell_their_scale() {
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 12, width: 64, height: 48, points: 0, depth: true, ..SynthOptions::default() };
    write_scene(folder.path(), &options, &|_| ()).unwrap();
    let mut files: Vec<_> =
        std::fs::read_dir(folder.path().join("depth")).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    let bare = || Scene { points: Vec::new(), ..open(folder.path()) };
    let all: Vec<usize> = (0..bare().views.len()).collect();
    let used = || {
        let DepthMaps { evidence, notes, .. } = depth_maps::of_views(&bare(), &all, Resize::Full);
        println!("{evidence:?} {notes:?}");
        evidence.maps
    };
    assert_eq!(used(), 12);
    for (i, file) in files.iter().enumerate() {
        let map = depth_maps::read::read(file, None).unwrap();
        npy(file, |x, y| map.depths[(y * map.width + x) as usize] * 1.12_f32.powi(i as i32));
    }
    assert_eq!(used(), 0);
}

/// Steps of whole numbers, and floats of 16 bits.
#[test]
fn numbers_of_maps_are_those_of_their_type() {
    let header = |kind: &str| format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': (1, 2), }}");
    let file = |kind: &str, values: [u16; 2]| {
        let text = format!("{:117}\n", header(kind));
        [b"\x93NUMPY\x01\x00\x76\x00", text.as_bytes(), values.map(u16::to_le_bytes).as_flattened()].concat()
    };
    for (kind, step, depths) in [
        ("<u2", None, [1.5, 15.36]),
        ("<u2", Some(0.01), [15.0, 153.6]),
        ("<i2", None, [1.5, 15.36]),
        ("<f2", None, [f32::from(half::f16::from_bits(1500)), 1.0]),
        ("<f2", Some(1e-3), [1e-3 * f32::from(half::f16::from_bits(1500)), 1e-3]),
    ] {
        // The largest of its kind says that nothing was hit.
        let least = if kind == "<i2" { 32767 } else { 65535 };
        if kind != "<f2" {
            assert_eq!(depth_maps::read::of_bytes(&file(kind, [1500, least]), step).unwrap().depths[1], 0.0, "{kind}");
        }
        let map = depth_maps::read::of_bytes(&file(kind, [1500, 15360]), step).unwrap();
        let near = |(a, b): (&f32, f32)| (a / b - 1.0).abs() < 1e-6;
        assert!(map.depths.iter().zip(depths).all(near), "{kind} {step:?}: {:?}", map.depths);
    }
    let nothing = half::f16::MAX.to_bits();
    assert_eq!(depth_maps::read::of_bytes(&file("<f2", [15360, nothing]), Some(1e-3)).unwrap().depths[1], 0.0);
}

/// The largest number of a kind says that nothing was hit, and no other of more bits.
#[test]
fn whole_numbers_beyond_sixteen_bits_are_depths() {
    let text = format!("{:117}\n", "{'descr': '<u4', 'fortran_order': False, 'shape': (1, 3), }");
    let bytes = [100_000_u32, 200_000, u32::MAX].map(u32::to_le_bytes);
    let file = [b"\x93NUMPY\x01\x00\x76\x00", text.as_bytes(), bytes.as_flattened()].concat();
    assert_eq!(depth_maps::read::of_bytes(&file, Some(1e-5)).unwrap().depths, [1.0, 2.0, 0.0]);
}
