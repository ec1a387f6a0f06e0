//! Point clouds beside a capture's cameras.

use std::fs;

use super::dialects::{capture, notes, open};
use crate::support::files::writers::{Model, transforms, write, written};
use qirf_vk::scene::{OpenOptions, Scene};

const NAMES: [&str; 2] = ["a.png", "b.png"];

const CLOUD: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                     property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 4 5 6\n1 2 4 4 5 6\n1 3 3 4 5 6\n";

#[test]
fn clouds_beside_cameras_are_read() {
    for place in [
        "sparse/0/points3D.ply",
        "sparse/0/points3d.ply",
        "sparse/0/Points3D.PLY",
        "sparse/0/points.ply",
        "sparse/points.ply",
        "points3D.ply",
        "Sparse_PC.ply",
        "pointcloud.PLY",
        "input.ply",
    ] {
        let scene = capture(&NAMES, &NAMES);
        fs::remove_file(scene.path().join("sparse/0/points3D.txt")).unwrap();
        write(scene.path(), [(place, CLOUD.as_bytes().to_vec())]);
        assert_eq!(open(scene.path()).points.len(), 3, "{place}");
    }
    let scene = capture(&NAMES, &NAMES);
    fs::remove_file(scene.path().join("sparse/0/points3D.txt")).unwrap();
    write(scene.path(), [("sparse/0/scene.ply", CLOUD.as_bytes().to_vec())]);
    assert!(notes(&open(scene.path())).contains("scene.ply holds them, name it points3D.ply"));
    // The model's own points come first.
    let scene = capture(&NAMES, &NAMES);
    write(scene.path(), [("points3D.ply", CLOUD.as_bytes().to_vec())]);
    assert_eq!(open(scene.path()).points.len(), 1);
    let top = r#""camera_angle_x": 1.0, "w": 64, "h": 48"#;
    let blender = written([("transforms_train.json", transforms(top, &["a"])), ("points3d.ply", CLOUD.into())]);
    assert_eq!(open(blender.path()).points.len(), 3);
    let top = r#""fl_x": 50, "w": 64, "h": 48, "ply_file_path": "sparse_pc.ply""#;
    let scene = written([("transforms.json", transforms(top, &["a.png"]))]);
    assert!(notes(&open(scene.path())).contains("sparse_pc.ply, named by ply_file_path, does not exist"));
}

#[test]
fn clouds_of_one_colour_are_told() {
    let of = |points: usize, colour: bool| {
        let head = CLOUD.split("property uchar").next().unwrap().replace("vertex 3", &format!("vertex {points}"));
        let named: String = ["red", "green", "blue"].map(|name| format!("property uchar {name}\n")).concat();
        let row = |k: usize| format!("{k} {} 5{}\n", k % 3, if colour { format!(" 0 {k} 0") } else { String::new() });
        let rows: String = (0..points).map(row).collect();
        let scene = capture(&NAMES, &NAMES);
        fs::remove_file(scene.path().join("sparse/0/points3D.txt")).unwrap();
        let cloud = format!("{head}{}end_header\n{rows}", if colour { named.as_str() } else { "" });
        write(scene.path(), [("points3D.ply", cloud.into_bytes())]);
        let opened = open(scene.path());
        (opened.plain, notes(&opened))
    };
    let (plain, note) = of(12, false);
    assert_eq!(plain, Some([128; 3]));
    assert!(note.contains("12 points without colours, or all of one (128, 128, 128): training"), "{note}");
    for (points, colour) in [(12, true), (9, false)] {
        let (plain, note) = of(points, colour);
        assert!(plain.is_none() && !note.contains("without colours"), "{points} {colour}: {note}");
    }
}

#[test]
fn normals_of_clouds_are_read() {
    let head = CLOUD.replace("end_header\n", "property float nx\nproperty float ny\nproperty float nz\nend_header\n");
    let rows = head.replace("4 5 6\n", "4 5 6 0 0 -2\n");
    let rows = rows.replacen("0 0 -2", "0 0 0", 1).replacen("0 0 -2", "nan 0 0", 1); // a model's, and no direction
    let scene = capture(&NAMES, &NAMES);
    fs::remove_file(scene.path().join("sparse/0/points3D.txt")).unwrap();
    write(scene.path(), [("points3D.ply", rows.into_bytes())]);
    let normals: Vec<_> = open(scene.path()).points.iter().map(|point| point.normal).collect();
    assert_eq!(normals, [None, None, Some(glam::DVec3::NEG_Z)]);
}

/// The near plane stays, as pictures depend on it.
#[test]
fn near_copies_of_points_go_where_a_scene_is_trained_on() {
    let mut model = Model::sample();
    let mut copies = model.points.clone();
    for (position, ..) in &mut copies {
        position[0] += 0.01;
    }
    model.points.append(&mut copies);
    let scene = written(model.binary());
    let opened = |check| Scene::open(scene.path(), &OpenOptions { check, ..OpenOptions::default() }).unwrap();
    let (drawn, trained) = (opened(false), opened(true));
    let counts = |scene: &Scene| [scene.points.len(), scene.skipped.repeated_points];
    assert_eq!([counts(&drawn), counts(&trained)], [[80, 0], [40, 40]]);
    assert_eq!((drawn.near, drawn.origin), (trained.near, trained.origin));
}
