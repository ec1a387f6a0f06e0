//! Photos in subfolders, as cameras write them.

use super::fake::{Stage, works};
use crate::program::faults::harness::{content, end, scene};
use std::fs;
use std::path::Path;

/// A photo of one grey.
fn photo(path: &Path, grey: u8) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_pixel(40, 30, image::Rgb([grey; 3])).save(path).unwrap();
}

/// Twelve photos in two folders of a card, in which each name occurs twice; returns their names within the card.
fn card(stage: &Stage) -> Vec<String> {
    fs::remove_dir_all(stage.path("photos")).unwrap();
    let names: Vec<String> = (0..12).map(|i| format!("DCIM/10{}CANON/IMG_{:04}.png", i / 6, i % 6)).collect();
    for (grey, name) in (0..).zip(&names) {
        photo(&stage.path("photos").join(name), 20 * grey);
    }
    names
}

#[test]
fn photos_in_subfolders_keep_their_names() {
    let stage = Stage::new();
    let names = card(&stage);
    stage.gives_named(0, &names);
    let photos = stage.path("photos");
    for other in
        [".Trash/IMG_0001.png", "DCIM/100CANON/.IMG_0001.png", "DCIM/Thumbs/IMG_0001.png", "@eaDir/a.png", "Mask/a.png"]
    {
        photo(&photos.join(other), 7);
    }
    // Masks beside all photos, and beside those of one folder.
    let masks = [("masks/DCIM/100CANON/IMG_0002.png", &names[2]), ("DCIM/101CANON/masks/IMG_0002.png", &names[8])];
    for (grey, (mask, _)) in (200..).zip(masks) {
        photo(&photos.join(mask), grey);
    }
    let (ended, said) = works(stage.pose(&[]));
    assert!(said.contains("12 of 12 photos have poses"), "{said}");
    let found =
        "found 12 photos in 2 folders of photos: DCIM/100CANON (6), DCIM/101CANON (6); left out: @eaDir, DCIM/Thumbs";
    assert!(ended.said.lines().any(|line| line == found), "{}", ended.said);

    // Every photo under its own name, and nothing else.
    let images = content(&stage.path("scene/images"));
    assert_eq!(images.len(), 12);
    for name in &names {
        assert_eq!(fs::read(stage.path("scene/images").join(name)).unwrap(), fs::read(photos.join(name)).unwrap());
    }
    assert_eq!(content(&stage.path("scene/masks")).len(), 2);
    for (mask, name) in masks {
        assert_eq!(fs::read(stage.path("scene/masks").join(name)).unwrap(), fs::read(photos.join(mask)).unwrap());
    }
    // COLMAP is given the names as they will be in its model, and equal sizes are one camera.
    assert_eq!(stage.calls("feature_extractor").len(), 2);
    let listed = fs::read_to_string(stage.path("scene/pose/photos.txt")).unwrap();
    assert_eq!(listed.lines().collect::<Vec<_>>(), names[1..]);
    let (_, told) = works(stage.program(&["inspect", "scene"]));
    assert!(told.lines().any(|l| l.starts_with("photos present") && l.ends_with(" 12")), "{told}");
    // Folders that hold scenes are no photos of another one.
    fs::create_dir(stage.path("shelf")).unwrap();
    fs::rename(stage.path("scene"), stage.path("shelf/scene")).unwrap();
    end(&mut stage.program(&["pose", "shelf", "-o", "other"])).with(3, &["shelf holds no photos"]);
}

#[test]
fn a_scene_among_its_own_photos_is_not_taken_for_photos() {
    let stage = Stage::new();
    let names = card(&stage);
    stage.gives_named(0, &names);
    let pose = || stage.program(&["pose", "photos", "-o", "photos/DCIM/scene"]);
    works(pose());
    let calls = stage.calls("").len();
    let (_, said) = works(pose());
    assert!(said.contains("12 of 12") && stage.calls("").len() == calls, "{said}");
}

#[test]
fn photos_that_are_gone_leave_no_folder_and_links_are_not_followed() {
    let stage = Stage::new();
    let names = card(&stage);
    stage.gives_named(0, &names);
    works(stage.pose(&[]));
    // A name that is in both folders changes in one: that is noticed.
    photo(&stage.path("photos").join(&names[6]), 255);
    works(stage.pose(&[]));
    let of = |name: &str| fs::read(stage.path("scene/images").join(name)).unwrap();
    assert_eq!(of(&names[6]), fs::read(stage.path("photos").join(&names[6])).unwrap());

    fs::rename(stage.path("photos/DCIM/101CANON"), stage.path("elsewhere")).unwrap();
    stage.gives_named(0, &names[..6]);
    // The scene's own folder has become a link to the user's one.
    fs::remove_dir_all(stage.path("scene/images/DCIM/101CANON")).unwrap();
    std::os::unix::fs::symlink(stage.path("elsewhere"), stage.path("scene/images/DCIM/101CANON")).unwrap();
    let (_, said) = works(stage.pose(&[]));
    assert!(said.contains("6 of 6"), "{said}");
    assert_eq!(content(&stage.path("elsewhere")).len(), 6, "the user's own photos stay");

    fs::remove_file(stage.path("scene/images/DCIM/101CANON")).unwrap();
    fs::rename(stage.path("photos/DCIM"), stage.path("photos/roll")).unwrap();
    let renamed: Vec<String> = names[..6].iter().map(|name| name.replace("DCIM", "roll")).collect();
    stage.gives_named(0, &renamed);
    works(stage.pose(&[]));
    assert!(!stage.path("scene/images/DCIM").exists() && stage.path("scene/images/roll").is_dir());

    // A record whose names lead out of the folder is not this program's.
    let record = fs::read_to_string(stage.path("scene/pose.json")).unwrap();
    for name in ["roll/../../../photos/roll/100CANON/IMG_0000.png", "/IMG_0000.png", ""] {
        fs::write(stage.path("scene/pose.json"), record.replace(&renamed[0], name)).unwrap();
        end(&mut stage.pose(&["--matching", "sequential"])).with(2, &["is not an output folder"]);
    }
}

#[test]
fn folders_that_sequential_pairs_did_not_connect_are_told() {
    let stage = Stage::new();
    let names = card(&stage);
    stage.gives_named(0, &names[..6]);
    stage.gives_named(1, &names[6..]);
    let hint = "--matching exhaustive may connect them";
    let (ended, _) = works(stage.pose(&["--matching", "sequential"]));
    assert!(ended.said.contains(hint), "{}", ended.said);
    let (ended, _) = works(stage.pose(&["--matching", "exhaustive"]));
    assert!(!ended.said.contains(hint), "{}", ended.said);
}

#[test]
fn names_that_a_list_cannot_hold_and_lone_photos_are_refused() {
    let stage = Stage::new();
    end(&mut stage.program(&["pose", "photos/00.png", "-o", "scene"])).with(3, &["it is one photo: give the folder"]);
    for name in [" a.png", "a\nb.png"] {
        let path = stage.path("photos").join(name);
        photo(&path, 9);
        end(&mut stage.pose(&[])).with(3, &["a space, or holds a control character", "rename it"]);
        fs::remove_file(path).unwrap();
    }
    assert!(!stage.path("scene").exists());
    // COLMAP's lists hold other spaces and controls than those of ASCII, and OpenMVG-rs reads no list.
    stage.gives(0, 0..12);
    photo(&stage.path("photos/\u{3000}a\u{85}.png"), 9);
    assert!(works(stage.pose(&["--poses", "colmap"])).1.contains("12 of 13 photos have poses"));
    photo(&stage.path("photos/ a.png"), 9);
    assert!(works(stage.pose(&["--poses", "openmvg"])).1.contains("12 of 14 photos have poses"));
}

#[test]
fn openmvg_is_not_given_subfolders() {
    let stage = Stage::new();
    stage.gives_named(0, &card(&stage));
    end(&mut stage.pose(&["--poses", "openmvg"])).with(2, &["photos has photos in subfolders", "--poses colmap"]);
    assert!(!stage.path("scene").exists());
    // The faces of panoramas would lie in subfolders.
    let stage = Stage::new();
    end(&mut stage.pose(&["--poses", "openmvg", "--panoramas"])).with(2, &["--panoramas", "--poses colmap"]);
    assert!(!stage.path("scene").exists());
}

#[test]
fn a_run_on_subfolders_trains_the_model_of_one_folder() {
    let stage = Stage::new();
    fs::remove_dir_all(stage.path("photos")).unwrap();
    // The same order; the first and the last photo, which are held out, have the same name.
    let names: Vec<String> =
        (0..9).map(|i| if i < 5 { format!("a/{}.png", i + 3) } else { format!("b/{}.png", i - 5) }).collect();
    let model = stage.path("fake/models/0");
    fs::create_dir_all(&model).unwrap();
    for part in ["cameras.txt", "images.txt", "points3D.txt"] {
        let mut text = fs::read_to_string(scene().join("sparse/0").join(part)).unwrap();
        for (i, name) in names.iter().enumerate() {
            text = text.replace(&format!("view_{i:04}.png"), name);
        }
        fs::write(model.join(part), text).unwrap();
    }
    for (i, name) in names.iter().enumerate() {
        let to = stage.path("photos").join(name);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(scene().join(format!("images/view_{i:04}.png")), to).unwrap();
    }
    let run = |input: &str, out: &str| {
        let run = ["run", input, "-o", out, "--iterations", "20", "--no-prune"];
        end(&mut stage.program(&run))
    };
    let found = "found 9 photos in 2 folders of photos: a (5), b (4)";
    run("photos", "out").with(0, &[found, "9 of 9 photos have poses"]);
    run(scene().to_str().unwrap(), "direct").with(0, &[]);
    let bytes = |out: &str| fs::read(stage.path(out).join("model.ply")).unwrap();
    assert!(bytes("out") == bytes("direct"), "the same photos in other folders");
    // Both held-out photos have pictures of their own.
    let pictures = |out: &str| -> Vec<Vec<u8>> {
        content(&stage.path(out).join("renders")).into_iter().map(|(_, bytes)| bytes).collect()
    };
    let (mut own, mut direct) = (pictures("out"), pictures("direct"));
    own.sort();
    direct.sort();
    assert!(!own.is_empty() && own == direct, "{} and {} pictures", own.len(), direct.len());
}
