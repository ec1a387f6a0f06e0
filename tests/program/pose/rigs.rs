//! Rigs: cameras in folders of their own, which a COLMAP that knows them keeps together.

use super::fake::{Stage, works};
use crate::program::faults::harness::end;
use std::fs;

/// What a COLMAP of 3.12 or later says of itself.
const NEW: &str = "COLMAP 3.13 (without CUDA)
  --ImageReader.single_camera arg (=0)
  --ImageReader.existing_camera_id arg (=-1)
  --rig_config_path arg
  --input_path arg
  --Mapper.ba_refine_sensor_from_rig arg (=1)
  --Mapper.ba_refine_focal_length arg (=1)
  --ImageReader.camera_model arg
  --ImageReader.camera_params arg
";

/// Six photos of each of two cameras, of one kind.
fn stage(help: Option<&str>) -> Stage {
    let stage = Stage::new();
    fs::remove_dir_all(stage.path("photos")).unwrap();
    let names: Vec<String> = (0..12).map(|i| format!("cam{}/{:02}.png", i / 6, i % 6)).collect();
    for name in &names {
        let path = stage.path("photos").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::RgbImage::new(40, 30).save(path).unwrap();
    }
    stage.gives_named(0, &names);
    if let Some(help) = help {
        fs::write(stage.path("fake/help"), help).unwrap();
    }
    stage
}

/// The commands called, in order.
fn commands(stage: &Stage) -> Vec<String> {
    stage.calls("").iter().map(|call| call.split(' ').next().unwrap().to_owned()).collect()
}

#[test]
fn folders_of_a_rig_are_posed_alone_first_and_then_together() {
    let stage = stage(Some(NEW));
    let (ended, said) = works(stage.pose(&["--rig"]));
    assert!(said.contains("12 of 12 photos have poses"), "{said}");
    assert!(
        ended.said.contains("a rig of 2 cameras (cam0/, cam1/), as the photos show them to stand"),
        "{}",
        ended.said
    );
    // One camera a folder, though their kind is the same.
    let expected =
        [&["feature_extractor"; 4][..], &["exhaustive_matcher", "mapper", "rig_configurator", "mapper"]].concat();
    assert_eq!(commands(&stage), expected);
    let configured = &stage.calls("rig_configurator")[0];
    assert!(configured.contains("--input_path scene/pose/models/0"), "{configured}");
    assert!(stage.calls("mapper").iter().all(|call| !call.contains("ba_refine_sensor_from_rig")));
    let config: serde_json::Value =
        serde_json::from_slice(&fs::read(stage.path("scene/pose/rig_config.json")).unwrap()).unwrap();
    let cameras = serde_json::json!([{"cameras": [
        {"image_prefix": "cam0/", "ref_sensor": true}, {"image_prefix": "cam1/"}]}]);
    assert_eq!(config, cameras);
    assert!(!stage.path("scene/pose/alone").exists());
    // The same again ends at once; without the rig the poses are others.
    works(stage.pose(&["--rig"]));
    assert_eq!(commands(&stage).len(), expected.len());
    let (ended, _) = works(stage.pose(&[]));
    assert!(
        ended.said.contains("cam0/ and cam1/ have the same names") && ended.said.contains("--rig"),
        "{}",
        ended.said
    );
    assert_eq!(
        commands(&stage)[expected.len()..],
        ["feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"]
    );
}

#[test]
fn a_rig_whose_cameras_are_placed_is_known_before_photos_are_compared() {
    let stage = stage(Some(NEW));
    let placed = r#"[{"cameras": [{"image_prefix": "cam0/", "ref_sensor": true}, {"image_prefix": "cam1/",
        "cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0.1, 0, 0]}]}]"#;
    fs::write(stage.path("photos/rig_config.json"), placed).unwrap();
    let (ended, said) = works(stage.pose(&[]));
    assert!(said.contains("12 of 12") && ended.said.contains("as the file places them"), "{said} {}", ended.said);
    assert_eq!(commands(&stage)[4..], ["rig_configurator", "exhaustive_matcher", "mapper"]);
    assert!(!stage.calls("rig_configurator")[0].contains("--input_path"));
    assert!(stage.calls("mapper")[0].contains("--Mapper.ba_refine_sensor_from_rig 0"));
    assert_eq!(fs::read_to_string(stage.path("scene/pose/rig_config.json")).unwrap(), placed);

    fs::write(stage.path("photos/rig_config.json"), placed.replace("cam1/", "up/")).unwrap();
    end(&mut stage.pose(&[])).with(3, &["rig_config.json", "camera \"up/\"", "has no photo whose name begins so"]);
}

#[test]
fn without_help_from_colmap_cameras_are_posed_independently_and_that_is_told() {
    for (help, told) in [(None, "this version of COLMAP does not support"), (Some(NEW), "COLMAP refuses the rig")] {
        let stage = stage(help);
        let mut pose = stage.pose(&["--rig"]);
        pose.env("FAKE_AT", "rig_configurator");
        let (ended, said) = works(pose);
        assert!(said.contains("12 of 12") && ended.said.contains(told), "{said} {}", ended.said);
        assert_eq!(stage.calls("mapper").len(), 1);
    }
    let stage = Stage::new();
    end(&mut stage.pose(&["--rig"])).with(2, &["--rig: no folders side by side in photos", "rig_config.json"]);
}

/// Panoramas become the photos of a rig of six pinholes at one place.
#[test]
fn panoramas_are_posed_as_the_faces_of_a_cube() {
    let stage = Stage::new();
    fs::remove_dir_all(stage.path("photos")).unwrap();
    fs::create_dir_all(stage.path("photos/masks")).unwrap();
    for name in ["0.png", "1.png", "2.exr", "3.jpe"] {
        // Blue straight down, red to the right, green elsewhere.
        let colour = |x: u32, y: u32| match (x, y) {
            (_, 56..) => [0, 0, 255],
            (80..112, 20..44) => [255, 0, 0],
            _ => [0, 255, 0],
        };
        let photo = image::DynamicImage::from(image::RgbImage::from_fn(128, 64, |x, y| image::Rgb(colour(x, y))));
        let path = stage.path("photos").join(name);
        match name {
            "2.exr" => photo.to_rgb32f().save(path).unwrap(),
            "3.jpe" => photo.save_with_format(path, image::ImageFormat::Jpeg).unwrap(),
            _ => photo.save(path).unwrap(),
        }
    }
    image::GrayImage::from_fn(128, 64, |_, y| image::Luma([if y > 48 { 0 } else { 255 }]))
        .save(stage.path("photos/masks/2.png"))
        .unwrap();
    let faces = ["back", "down", "front", "left", "right", "up"];
    let kinds = ["0.png", "1.png", "2.exr.png", "3.jpe"];
    let names: Vec<String> = faces.iter().flat_map(|face| kinds.map(|name| format!("{face}/{name}"))).collect();
    stage.gives_named(0, &names);
    fs::write(stage.path("fake/help"), NEW).unwrap();
    let (_, said) = works(stage.pose(&["--panoramas"]));
    assert!(said.contains("24 of 24 photos have poses"), "{said}");
    let face = |name: &str| image::open(stage.path("scene").join(name)).unwrap().to_rgb8();
    assert_eq!(face("images/down/1.png").dimensions(), (32, 32));
    assert_eq!(face("images/down/1.png").get_pixel(16, 16).0, [0, 0, 255]);
    assert_eq!(face("images/right/1.png").get_pixel(16, 16).0, [255, 0, 0]);
    assert_eq!(face("images/front/1.png").get_pixel(16, 16).0, [0, 255, 0]);
    assert_eq!(face("masks/down/2.exr.png").get_pixel(16, 16).0, [0; 3]);
    let jpeg = fs::read(stage.path("scene/images/down/3.jpe")).unwrap();
    assert_eq!(image::guess_format(&jpeg).unwrap(), image::ImageFormat::Jpeg);
    assert!(!stage.path("scene/images/1.png").exists() && !stage.path("scene/masks/down/1.png").exists());

    assert_eq!(commands(&stage)[12..], ["rig_configurator", "exhaustive_matcher", "mapper"]);
    let features = stage.calls("feature_extractor");
    let lens = "--ImageReader.camera_model PINHOLE --ImageReader.camera_params 16,16,16,16";
    assert!(features.len() == 12 && features.iter().all(|call| call.contains(lens)), "{features:?}");
    assert!(
        stage.calls("mapper")[0].contains("--Mapper.ba_refine_sensor_from_rig 0 --Mapper.ba_refine_focal_length 0")
    );
    let config: serde_json::Value =
        serde_json::from_slice(&fs::read(stage.path("scene/pose/rig_config.json")).unwrap()).unwrap();
    let cameras = config[0]["cameras"].as_array().unwrap();
    assert_eq!((cameras.len(), &cameras[2]["ref_sensor"]), (6, &true.into()));
    // What lies to the right of the panorama is before the right face: x of the rig is its z.
    let q: Vec<f64> =
        cameras[4]["cam_from_rig_rotation"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let right = glam::DQuat::from_xyzw(q[1], q[2], q[3], q[0]) * glam::DVec3::X;
    assert!(right.distance(glam::DVec3::Z) < 1e-9, "{right}");
    // Again at once; a photo of another shape is refused by name.
    let calls = commands(&stage).len();
    works(stage.pose(&["--panoramas"]));
    assert_eq!(commands(&stage).len(), calls);
    let (ended, _) = works(stage.pose(&[]));
    assert!(ended.said.contains("panoramas (360°) need --panoramas"), "{}", ended.said);
    image::RgbImage::new(40, 30).save(stage.path("photos/9.png")).unwrap();
    end(&mut stage.pose(&["--panoramas"])).with(3, &["9.png", "is 40 x 30: a panorama is twice as wide as high"]);
}

/// Without a rig, COLMAP may give the faces of a panorama different places.
#[test]
fn faces_of_a_panorama_that_lie_apart_are_told() {
    let stage = Stage::new();
    for i in 0..12 {
        image::RgbImage::new(32, 16).save(stage.path("photos").join(format!("{i:02}.png"))).unwrap();
    }
    let names: Vec<String> = (0..24).map(|i| format!("{}/{:02}.png", ["back", "front"][i / 12], i % 12)).collect();
    stage.gives_named(0, &names);
    let told = |output: &str| works(stage.program(&["pose", "photos", "-o", output, "--panoramas"])).0.said;
    let wanted = "the faces of a panorama lie up to ";
    assert!(told("apart").contains(wanted) && told("apart").contains("COLMAP 3.12 or newer"), "{}", told("apart"));
    let at_one_place = |(i, name): (usize, &String)| format!("{} 1 0 0 0 0.{} 0 4 1 {name}\n\n", i + 1, i % 12);
    let images: String = names.iter().enumerate().map(at_one_place).collect();
    fs::write(stage.path("fake/models/0/images.txt"), images).unwrap();
    assert!(!told("together").contains(wanted), "{}", told("together"));
}
