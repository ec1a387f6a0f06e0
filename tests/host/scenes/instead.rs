//! Paths that hold no capture that is read: each error names what is there, and what to do.

use std::fs;

use super::dialects::{capture, notes, open};
use super::{TOP, refused, says};
use crate::support::files::writers::{picture, row, transforms, write, written};
use qirf_vk::scene::{Error, OpenOptions, PhotoTree, Role, Scene, instead};

#[test]
fn photos_videos_and_archives_are_told_with_their_remedy() {
    for (files, told) in [
        (&["b.heic", "a.HEIC"][..], "it holds 2 photos in HEIC, which is not read (a.HEIC, b.heic): convert them"),
        (&["images/a.bmp", "images/b.gif"], "it holds 2 photos in BMP and GIF, which are not read"),
        (&["a.mp4"], "it holds no photos, but a video: give `run` or `pose` "),
        (&["a.wmv"], "it holds no photos, but a video"),
        (&["a.insv"], "it holds a.insv, a 360° camera's own file: export it as an equirectangular video"),
        (&["cap.zip"], "it holds an archive: unpack cap.zip"),
    ] {
        let folder = written(files.iter().map(|file| (*file, b"x".to_vec())));
        let error = refused(folder.path());
        assert!(error.contains(told), "{error}");
        assert!(instead(folder.path()).unwrap().contains(told));
        fs::write(folder.path().join("config.toml"), "").unwrap(); // a run's folder may hold such files
        assert_eq!(instead(folder.path()), None);
    }
    for (file, told) in [
        ("cap.tar.gz", "it is an archive: unpack it and give its folder"),
        ("images.zip", "it is an archive: unpack it and give its folder"),
        ("scan.r3d", "it is an archive: unpack it and give its folder"),
        ("m.ply.bz2", "it is compressed: unpack it and give the file in it"),
        ("a.mov", "it is a video, without poses"),
        ("a.360", "it is a 360° camera's own file"),
        ("a.gif", "it is a GIF, which is not read; if it is a video, convert it by `ffmpeg -i '"),
        ("reconstruction.json", "perhaps from OpenSfM, is not read: `opensfm export_colmap` converts it"),
        ("sfm_data.json", "perhaps from OpenMVG"),
        ("cameras.npz", "perhaps from NeuS, IDR or DTU"),
        ("sfmData.json", "perhaps from Meshroom"),
    ] {
        let folder = written([(file, b"[]".to_vec())]);
        let error = refused(&folder.path().join(file));
        assert!(error.contains(told), "{file}: {error}");
    }
    let app = written([("rgb.mp4", b"x".to_vec()), ("odometry.csv", b"timestamp, frame".to_vec())]);
    says(&refused(app.path()), &["a video: give `run` or `pose` ", "; odometry.csv, perhaps from Stray Scanner"]);
    let mixed = written([("images/a.heic", b"x".to_vec())]);
    picture(&mixed.path().join("images/b.png"), 8, 6);
    assert!(refused(mixed.path()).ends_with("jpg -quality 95 *.heic`"), "{}", refused(mixed.path()));
    assert_eq!(PhotoTree::of(&mixed.path().join("images")).unread, ["a.heic"]);
}

#[test]
fn foreign_poses_are_known_by_whole_names_and_contents() {
    for (file, bytes, program) in [
        ("cameras.psx", "x", "Metashape"),
        ("Scan.SFM", "x", "Meshroom"),
        ("reconstruction.json", "[]", "OpenSfM"),
        ("database.db", "x", "COLMAP, without a model"),
        ("poses_bounds.npy", "x", "LLFF"),
        ("x.nvm", "NVM_V3\n", "VisualSFM"),
        ("cameras.npz", "PK", "NeuS"),
        ("scene.out", "# Bundle file v0.3\n", "Bundler"),
        ("sfm_data.bin", "x", "OpenMVG"),
        ("sfm.json", "{}", "Meshroom"),
        ("frame_00000.json", r#"{"cameraPoseARFrame": []}"#, "ARKit"),
        ("poses.txt", "1 0 0", "KITTI"),
        ("groundtruth.txt", "# timestamp", "TUM RGB-D"),
        ("scene.log", "0 0 0\n1 0 0 0\n", "Tanks and Temples"),
        ("images/a.xmp", r#"<x:xmpmeta xcr:Version="3"/>"#, "RealityScan"),
        ("cameras.json", r#"[{"id": 0, "img_name": "a"}]"#, "a run of 3DGS"),
        ("reg.csv", "#name,x,y,alt\n", "RealityScan"),
        ("chunk.xml", r#"<?xml version="1.0"?><document version="2.0.0">"#, "Metashape"),
        ("transforms_test.json", r#"{"frames": [{"transform_matrix": []}]}"#, "Blender, without transforms_train.json"),
        ("keyframes/corrected_cameras/1.json", "{}", "Polycam"),
        ("bundle/bundle.out", "# Bundle file v0.3\n", "Bundler"),
        ("MeshroomCache/StructureFromMotion/1/cameras.sfm", "{}", "Meshroom"),
        ("opensfm/reconstruction.json", "[]", "OpenSfM"),
        ("sensors/trajectories.txt", "# kapture format: 1.1\n", "kapture"),
        ("odometry.csv", "timestamp, frame, x, y, z\n", "Stray Scanner"),
        ("seq-01/frame-000000.pose.txt", "1 0 0 0\n", "7-Scenes"),
        ("metadata", r#"{"poses": []}"#, "Record3D"),
        ("keyframes/cameras/1.json", r#"{"t_00": 1}"#, "Polycam"),
        ("1_initial/params/a_calibrated_camera_parameters.txt", "fileName", "Pix4D"),
        ("odm_report/shots.geojson", "{}", "OpenDroneMap"),
        ("semicolons.csv", "#name;x;y\n", "RealityScan"),
        ("cameras.txt", "# Cameras (1)\n# PhotoID, X, Y, Z, Omega\n", "Metashape"),
        ("cams/00000000_cam.txt", "extrinsic\n", "MVSNet"),
        ("camera/1.json", r#"{"orientation": [], "pixel_aspect_ratio": 1.0}"#, "Nerfies"),
        ("metadata.json", r#"{"000001": {"warp_id": 0, "appearance_id": 0}}"#, "Nerfies"),
        ("images/a.json", r#"[{"Orientation": 1}]"#, ""),
        ("tabs.log", "0\t0\t1\n1\t0\t0\t0\n", "Open3D"),
        ("traj.txt", "1 0 0", "Replica"),
        ("poses/00.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "KITTI"),
        ("poses/0.txt", "1 0 0 0\n", "ScanNet or NSVF"),
        ("drive/oxts/data/0.txt", "49.0", "KITTI's raw data"),
        ("cam0_to_world.txt", "1", "KITTI-360"),
        ("mav0/state_groundtruth_estimate0/data.csv", "#timestamp", "EuRoC"),
        ("v1.0-mini/ego_pose.json", "[]", "nuScenes"),
        ("ego_pose/000.txt", "1", "Waymo"),
        ("frame_annotations.jgz", "x", "CO3D"),
        ("pos_001.txt", "1", "DTU"),
        ("scene.mvs", "x", "OpenMVS"),
        ("pose_intrinsic_imu.json", "{}", "ScanNet++"),
        ("traj_w_c.txt", "1", "Replica"),
        ("opk.txt", "# CoordinateSystem: Local\n#Label\tX\n", "Metashape"),
        ("ref.csv", "# CoordinateSystem: Local\n#Label,X/East\n", "Metashape"),
        ("a.tum", "0 1 0 0", "TUM RGB-D"),
        ("sparse/0/cameras.bin.gz", "x", "COLMAP, compressed"),
        ("predictions.npz", "PK", "VGGT"),
        ("closed_loop_trajectory.csv", "graph_uid", "Project Aria"),
        ("metadata.json", r#"{"h": 4, "fps": 60}"#, "Record3D"),
        ("train_000/metadata.json", r#"{"cam_angle_x": 0.7, "cam_transform_mat": "1,0"}"#, "NeRFactor"),
        ("metadata.json", r#"{"title": "my photos"}"#, ""),
        ("_detail/cam_00/camera_keyframe_positions.hdf5", "x", "Hypersim"),
        ("depth_masks/1.txt", "x", "CO3D"),
        ("0000cc6d8b108390.txt", "https://www.youtube.com/watch?v=x\n0 0.5 0.9\n", "RealEstate10K"),
        ("scene0000_00.sens", "x", "ScanNet"),
        ("scene.zep", "x", "3DF Zephyr"),
        ("gps.csv", "time,lat,lon\n", ""),
        ("desktop.xml", "<settings/>", ""),
        ("all_purpose", "x", ""),
        ("train.log", "epoch 1\n", ""),
        ("notes.json", "{}", ""),
        ("README.txt", "A video: https://www.youtube.com/watch?v=x\n", ""),
    ] {
        let folder = written([(file, bytes.into())]);
        picture(&folder.path().join("images/a.png"), 8, 6);
        let error = refused(folder.path());
        assert_eq!(error.contains("perhaps from "), !program.is_empty(), "{file}: {error}");
        assert!(error.contains(program), "{file}: {error}");
    }
}

#[test]
fn tables_of_quaternions_are_told() {
    for (file, text, is_told) in [
        ("img_pos.csv", "name,timestamp,x,y,z,qx,qy,qz,qw\n", true),
        ("pano/pano-poses.csv", "# ID; filename; pano_pos_x; pano_ori_w; pano_ori_x\n", true),
        ("CameraPoses.csv", "id,tx,ty,tz,QX,QY,QZ,QW,t\n", true),
        ("poses.json", r#"[{"qw": 1, "qx": 0}]"#, true),
        ("images.txt", "# IMAGE_ID, QW, QX, QY, QZ, TX\n", false),
        ("frames.txt", "# FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX]\n", false),
        ("notes.txt", "faqw qxy\n", false),
    ] {
        let folder = written([(file, text.into())]);
        picture(&folder.path().join("images/a.png"), 8, 6);
        let error = refused(folder.path());
        let file = file.split('/').collect::<std::path::PathBuf>();
        let told = format!(
            "; {} may hold poses of a format that is not read: convert it to a transforms.json",
            file.display()
        );
        assert_eq!(error.contains(&told), is_told, "{error}");
        // `run` warns of them before it estimates others.
        let found = Scene::find(folder.path(), &OpenOptions::default());
        assert!(matches!(found, Err(Error::NoPoses { beside, .. }) if beside.starts_with(&told) == is_told), "{told}");
    }
}

#[test]
fn photos_apart_from_a_model_are_named_with_it() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("outputs/sfm"), row(&["mapping/a.png", "mapping/b.png"]).text());
    let photos = folder.path().join("datasets/x/mapping");
    for name in ["a.png", "b.png"] {
        picture(&photos.join(name), 64, 48);
    }
    let model = folder.path().join("outputs").join("sfm");
    let told = format!("give it to use them, with `--images {}`", photos.display());
    says(&refused(folder.path()), &[&format!("poses lie in {}", model.display()), &told]);
    let mut scene = Scene::open(&model, &OpenOptions { images: Some(photos), ..OpenOptions::default() }).unwrap();
    scene.require_photos().unwrap();
    assert_eq!(scene.views.len(), 2);
}

#[test]
fn poses_beside_the_photos_folder_are_named() {
    let capture = capture(&["a.png"], &["a.png"]);
    let images = capture.path().join("images");
    let error = refused(&images);
    assert!(error.ends_with(&format!("poses lie beside it: give {} to use them", capture.path().display())), "{error}");
    // The same folder by a path that does not end in its name, as `.` does not.
    fs::create_dir(images.join("x")).unwrap();
    says(&refused(&images.join("x/..")), &["poses lie beside it: give ", ".. to use them"]);
}

#[test]
fn scenes_that_lie_too_deep_and_packed_ones_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |name: &str| {
        let scene = folder.path().join("scan").join(name);
        write(&scene.join("sparse/0"), row(&["a.png"]).text());
        picture(&scene.join("images/a.png"), 64, 48);
        scene.display().to_string()
    };
    let first = scene("one");
    says(&refused(folder.path()), &["holds no scene", &format!("; poses lie in {first}: give it to use them")]);
    let both = format!("; poses lie in {first}, {}: give one of these to use them", scene("two"));
    picture(&folder.path().join("b.png"), 64, 48);
    says(&refused(folder.path()), &["but no camera poses", &both]);

    let packed = written([("sparse.zip", b"x".to_vec())]);
    picture(&packed.path().join("images/a.png"), 8, 6);
    says(&refused(packed.path()), &["has no camera poses; if ", "sparse.zip holds some, unpack it"]);
    // `run` estimates poses, and warns of those that are there.
    let found = Scene::find(packed.path(), &OpenOptions::default());
    assert!(matches!(found, Err(Error::NoPoses { beside, .. }) if beside.is_empty()));
}

#[test]
fn photos_that_may_be_panoramas_are_told() {
    let folder = tempfile::tempdir().unwrap();
    picture(&folder.path().join("a.jpg"), 64, 32);
    assert!(refused(folder.path()).ends_with("for panoramas (360°), use `run` or `pose` with --panoramas"));
    picture(&folder.path().join("b.jpg"), 64, 48);
    assert!(!refused(folder.path()).contains("panoramas"));
}

#[test]
fn a_transforms_file_of_another_name_is_named() {
    let folder = written([("transforms_colmap.json", transforms(TOP, &["images/a.png"]))]);
    let file = folder.path().join("transforms_colmap.json");
    let told = format!("; transforms_colmap.json may hold some: give {} to use them", file.display());
    assert!(refused(folder.path()).ends_with(&told), "{}", refused(folder.path()));
    picture(&folder.path().join("images/a.png"), 64, 48);
    let error = refused(folder.path());
    assert!(error.contains("no camera poses") && error.ends_with(&told), "{error}");
    assert!(open(&file).views[0].image.is_file());
}

#[test]
fn models_lie_deeper_or_in_numbered_folders() {
    for (place, told) in [("sparse/0/0", ""), ("sparse_16/0", "the poses are those of sparse_16")] {
        let capture = tempfile::tempdir().unwrap();
        write(&capture.path().join(place), row(&["a.png"]).text());
        picture(&capture.path().join("images/a.png"), 64, 48);
        assert!(open(capture.path()).views[0].image.is_file());
        assert!(notes(&open(capture.path())).contains(told), "{}", notes(&open(capture.path())));
    }
    let capture = tempfile::tempdir().unwrap();
    write(&capture.path().join("sparse_3/0"), row(&["a.png"]).text());
    write(&capture.path().join("sparse_9/0"), row(&["a.png", "b.png"]).text());
    assert_eq!(open(capture.path()).views.len(), 2);
    assert!(notes(&open(capture.path())).contains("holds 2 models: "), "{}", notes(&open(capture.path())));
}

#[test]
fn a_list_of_held_out_photos_is_used() {
    let capture = capture(&["a.png", "b.png", "c.png"], &[]);
    write(&capture.path().join("sparse/0"), [("test.txt", b"b.png\n".to_vec())]);
    let scene = open(capture.path());
    assert_eq!(scene.views.iter().map(|v| v.role).collect::<Vec<_>>(), [Role::Train, Role::Test, Role::Train]);
    assert!(notes(&scene).contains("1 photo held out, as "), "{}", notes(&scene));
    // The capture's own counts where the model has none.
    fs::rename(capture.path().join("sparse/0/test.txt"), capture.path().join("test.txt")).unwrap();
    assert_eq!(open(capture.path()).split(8).test, [1]);
    write(capture.path(), [("test.txt", b"c.png\na.png\nb\n".to_vec())]);
    assert!(open(capture.path()).views.iter().all(|view| view.role == Role::Unsaid));
    assert!(notes(&open(capture.path())).contains("test.txt names all photos"));
    write(&capture.path().join("sparse/0"), [("test.txt", b"x.png\n".to_vec())]);
    assert!(open(capture.path()).views.iter().all(|view| view.role == Role::Unsaid));
    assert!(notes(&open(capture.path())).contains("names no photo"));
}

#[test]
fn intrinsics_that_would_be_ignored_are_refused_or_told() {
    let with = |top: &str| {
        let capture = written([("transforms.json", transforms(&format!("{TOP}{top}"), &["a.png"]))]);
        picture(&capture.path().join("a.png"), 64, 48);
        capture
    };
    for numbers in ["-0.2, 0.05, 0, 0", "-0.2, 0.05, 0, 0, 0"] {
        let error = refused(with(&format!(r#", "distortion_params": [{numbers}]"#)).path());
        assert!(error.contains("its distortion_params has") && error.contains("not the six k1, k2"), "{error}");
    }
    for (model, numbers, wanted) in [("FISHEYE624", 6, "twelve of FISHEYE624"), ("OPENCV", 12, "not the six k1")] {
        let numbers = vec!["0.1"; numbers].join(", ");
        let error = refused(with(&format!(r#", "camera_model": "{model}", "distortion_params": [{numbers}]"#)).path());
        assert!(error.contains(wanted), "{error}");
    }
    let shares =
        written([("transforms.json", transforms(r#""fl_x": 1.62, "fl_y": 2.2, "w": 64, "h": 48"#, &["a.png"]))]);
    assert!(refused(shares.path()).contains("its fl_x 1.62 is not a focal length in pixels of a photo of 64 x 48"));
    for model in ["FOV", "THIN_PRISM_FISHEYE"] {
        let error = refused(with(&format!(r#", "camera_model": "{model}""#)).path());
        let known = error.split_once("known are ").unwrap().1;
        assert!(known.contains("OPENCV_FISHEYE") && !known.split(", ").any(|name| name == model), "{error}");
        assert!(known.contains("image_undistorter"), "{error}");
    }
    let opened = open(with(r#", "camera_model": "OPENCV", "is_fisheye": true, "k1": 0.1"#).path());
    assert!(notes(&opened).contains("1 frame whose is_fisheye contradicts their camera_model"), "{}", notes(&opened));
    let json = String::from_utf8(transforms(TOP, &["a.png"])).unwrap();
    let moving = json.replace("\"transform_matrix\"", "\"transform_matrix_end\": [1], \"transform_matrix\"");
    let moving =
        written([("transforms.json", moving.into_bytes()), ("transforms_train.json", transforms(TOP, &["a"]))]);
    assert!(notes(&open(moving.path())).contains("1 frame with a pose at the end of the exposure"));
    assert!(notes(&open(moving.path())).contains("transforms.json are used, not those in "));
}

#[test]
fn frames_without_any_pose_are_told_with_their_fields() {
    let json = String::from_utf8(transforms(TOP, &["a.png"])).unwrap().replace("transform_matrix", "world_to_camera");
    let capture = written([("transforms.json", json.clone().into_bytes())]);
    says(&refused(capture.path()), &["transforms.json", "its frames give no transform_matrix", "world_to_camera"]);
    // Fields may have any name, of any length.
    let long = json.replace("world_to_camera", &format!("\\u001b[31m{}", "x".repeat(9999)));
    let error = refused(written([("transforms.json", long.into_bytes())]).path());
    assert!(error.contains("its frames give no") && error.len() < 999 && !error.contains('\u{1b}'), "{error}");
}

#[test]
fn a_comment_in_another_encoding_is_no_fault() {
    let mut files = row(&["a.png", "b.png"]).text();
    for (_, bytes) in &mut files {
        bytes.splice(0..0, *b"# cam\xe9ra\n");
    }
    assert_eq!(open(written(files.clone()).path()).views.len(), 2);
    let at = files[1].1.windows(5).position(|w| w == b"b.png").unwrap();
    files[1].1[at] = 0xe9;
    let error = refused(written(files).path());
    assert!(error.contains("is not UTF-8 text: save the file as UTF-8"), "{error}");
    // -1 in 64 bits, and as a float.
    for id in ["18446744073709551615", "-1.0"] {
        let mut files = row(&["a.png"]).text();
        let text = String::from_utf8(files[1].1.clone()).unwrap();
        let at = text.find("a.png\n").unwrap() + "a.png\n".len();
        files[1].1 = format!("{}1.0 2.0 {id}\n", &text[..at]).into_bytes();
        assert_eq!(open(written(files).path()).views.len(), 1, "{id}");
    }
}
