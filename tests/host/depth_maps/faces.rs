//! Depth maps of panoramas and wide fisheyes: each face sees its part of them.

use super::{npy_of, open};
use qirf_vk::depth_maps;
use qirf_vk::effects::DepthWitness;
use qirf_vk::scene::Resize;
use qirf_vk::synth::{Calibration, Kind, SynthOptions, write as write_scene};

/// Depths of panoramas lie along rays, and each face sees its part of them.
#[test]
fn faces_of_a_panorama_see_their_part_of_its_map() {
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        kind: Kind::Panorama,
        views: 3,
        width: 256,
        height: 128,
        points: 300,
        depth: true,
        ..SynthOptions::default()
    };
    write_scene(folder.path(), &options, &|_| ()).unwrap();
    let scene = open(folder.path());
    let maps = depth_maps::of_views(&scene, &(0..18).collect::<Vec<_>>(), Resize::Full);
    println!("{:?} {:?}", maps.evidence, maps.notes);
    assert_eq!((maps.evidence.maps, maps.evidence.by), (3, DepthWitness::Points));
    assert!(maps.evidence.deviation.is_some_and(|share| share < 0.015));
    let (mut off, mut seen) = (Vec::new(), 0);
    for point in &scene.points {
        for view in point.track.iter().map(|v| &scene.views[*v as usize]) {
            let Some([x, y]) = view.camera.pixel_of(point.position) else { continue };
            let map = maps.of(&view.name).unwrap();
            assert_eq!((map.width, map.height), (64, 64));
            let depth = f64::from(map.depths[(y * 64 + x) as usize]) * map.unit;
            seen += 1;
            off.extend((depth > 0.0).then(|| (depth / view.camera.depth(point.position) - 1.0).abs()));
        }
    }
    off.sort_by(f64::total_cmp);
    assert!(off.len() > 40 && off[off.len() / 2] < 0.01, "{} of {seen}, {}", off.len(), off[off.len() / 2]);
}

/// Maps of wide fisheyes hold lengths along rays; depths along the axis are recognised, and give the same depths.
#[test]
fn maps_of_wide_fisheyes_lie_along_rays_or_the_axis() {
    let folder = tempfile::tempdir().unwrap();
    let lens: Calibration = "SIMPLE_FISHEYE:40,64,64".parse().unwrap();
    let options = SynthOptions {
        views: 5,
        width: 128,
        height: 128,
        points: 600,
        depth: true,
        lens: Some(lens),
        ..SynthOptions::default()
    };
    write_scene(folder.path(), &options, &|_| ()).unwrap();
    let scene = open(folder.path());
    assert!(scene.views.iter().all(|view| view.face.is_some()));
    let maps = || {
        let maps = depth_maps::of_views(&scene, &(0..scene.views.len()).collect::<Vec<_>>(), Resize::Full);
        println!("{:?} {:?}", maps.evidence, maps.notes);
        assert!(maps.evidence.maps > 2 && maps.evidence.deviation.is_some_and(|share| share < 0.05));
        (maps.choices.join("; "), maps)
    };
    let (told, along_rays) = maps();
    assert!(!told.contains("along"), "{told}");
    for file in std::fs::read_dir(folder.path().join("depth")).unwrap() {
        let file = file.unwrap().path();
        let map = depth_maps::read::read(&file, None).unwrap();
        npy_of(&file, [128, 128], |x, y| {
            let angle = (f64::from(x) - 63.5).hypot(f64::from(y) - 63.5) / 40.0;
            map.depths[(128 * y + x) as usize] * angle.cos().max(0.0) as f32
        });
    }
    let (told, along_axis) = maps();
    assert!(told.contains("of depths along the photo's axis"), "{told}");
    let mut off = Vec::new();
    for (a, b) in scene.views.iter().filter_map(|view| along_rays.of(&view.name).zip(along_axis.of(&view.name))) {
        let both = a.depths.iter().zip(b.depths.iter()).filter(|(a, b)| **a > 0.0 && **b > 0.0);
        off.extend(both.map(|(x, y)| (f64::from(x / y) * a.unit / b.unit - 1.0).abs()));
    }
    off.sort_by(f64::total_cmp);
    assert!(off.len() > 1000 && off[off.len() / 2] < 0.02, "{} {}", off.len(), off[off.len() / 2]);
}
