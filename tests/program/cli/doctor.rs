//! `inspect` names photos, cameras and poses that do not fit, and draws the capture.

use super::Sandbox;
use crate::program::ended::{capture, copy};
use crate::support::documented;
use glam::{DQuat, DVec3};
use qirf_vk::synth::{SynthOptions, write};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// Changes each line of a file.
fn edit(file: &Path, line: impl Fn(&str) -> String) {
    let lines: Vec<String> = fs::read_to_string(file).unwrap().lines().map(line).collect();
    fs::write(file, lines.join("\n") + "\n").unwrap();
}

/// Changes the poses of a capture, world to camera.
fn pose(folder: &Path, change: impl Fn(DQuat, DVec3) -> (DQuat, DVec3)) {
    edit(&folder.join("sparse/0/images.txt"), |line| {
        if !line.contains(".png") {
            return line.to_owned();
        }
        let words: Vec<&str> = line.split(' ').collect();
        let n: Vec<f64> = words[1..8].iter().map(|word| word.parse().unwrap()).collect();
        let (q, t) = change(DQuat::from_xyzw(n[1], n[2], n[3], n[0]), DVec3::new(n[4], n[5], n[6]));
        format!("{} {} {} {} {} {} {} {} {}", words[0], q.w, q.x, q.y, q.z, t.x, t.y, t.z, words[8..].join(" "))
    });
}

fn invert(q: DQuat, t: DVec3) -> (DQuat, DVec3) {
    (q.conjugate(), -(q.conjugate() * t))
}

/// Leaves only this many fields of each point, of which 8 precede the track.
fn cut_points(folder: &Path, fields: usize) {
    edit(&folder.join("sparse/0/points3D.txt"), |line| line.split(' ').take(fields).collect::<Vec<_>>().join(" "));
}

/// Multiplies the focal lengths of the camera by 1.2, or gives three photos a second camera with such focal lengths.
fn zoom(folder: &Path, second: bool) {
    edit(&folder.join("sparse/0/cameras.txt"), |line| {
        let words: Vec<&str> = line.split(' ').collect();
        if words[0] != "1" {
            return line.to_owned();
        }
        let focal = 1.2 * words[4].parse::<f64>().unwrap();
        let zoomed =
            |id: u32| format!("{id} PINHOLE {} {} {focal} {focal} {} {}", words[2], words[3], words[6], words[7]);
        if second { format!("{line}\n{}", zoomed(2)) } else { zoomed(1) }
    });
    edit(&folder.join("sparse/0/images.txt"), |line| {
        let third = ["view_0001.png", "view_0004.png", "view_0007.png"].iter().any(|name| line.ends_with(name));
        if second && third { line.replace(" 1 view", " 2 view") } else { line.to_owned() }
    });
}

fn photo(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("images/view_{number:04}.png"))
}

/// What is told of twelve photos after a change.
fn told(sandbox: &Sandbox, change: impl FnOnce(&Path)) -> Value {
    let (sound, changed) = (sandbox.path("sound"), sandbox.path("changed"));
    if !sound.is_dir() {
        let options = SynthOptions { views: 12, width: 64, height: 48, points: 1500, ..SynthOptions::default() };
        write(&sound, &options, &|_| ()).unwrap();
    }
    let _ = fs::remove_dir_all(&changed);
    copy(&sound, &changed);
    change(&changed);
    let told = sandbox.works(&["inspect", "changed", "--json"]).json();
    documented("inspect", &told);
    let needs = &told["run_needs"];
    assert!(needs["gaussians"].as_u64() >= Some(1500) && needs["bytes"].as_u64() > Some(1 << 20), "{needs}");
    told
}

#[track_caller]
fn advises(told: &Value, words: &str) {
    assert!(told["advice"][0].as_str().is_some_and(|first| first.contains(words)), "{words}: {}", told["advice"]);
    assert_eq!(told["advice"].as_array().unwrap().len(), 1, "{}", told["advice"]);
}

#[test]
fn a_photo_that_fits_no_points_is_named_and_marked() {
    let sandbox = Sandbox::new();
    capture(&sandbox.path("capture"), 300);
    let sound = sandbox.works(&["inspect", "capture/scene", "--json"]).json();
    assert!(sound["misfits"].as_array().unwrap().is_empty() && sound["advice"].as_array().unwrap().is_empty());
    assert!(sound["misfit_px"].as_f64().unwrap() < 0.01, "{}", sound["misfit_px"]);

    // The fourth photo's camera to the side.
    edit(&sandbox.path("capture/scene/sparse/0/images.txt"), |line| {
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        if line.ends_with("view_0003.png") {
            words[5] = (words[5].parse::<f64>().unwrap() + 3.0).to_string();
        }
        words.join(" ")
    });
    let told = sandbox.works(&["inspect", "capture/scene", "--json", "--html", "capture.html"]).json();
    let names = serde_json::to_string(&told["misfits"]).unwrap();
    assert!(names.contains("view_0003.png") && told["misfits"].as_array().unwrap().len() == 1, "{names}");
    let advice = told["advice"][0].as_str().unwrap();
    assert!(advice.starts_with("1 photo with a pose that does not fit the points"), "{advice}");
    let page = fs::read_to_string(sandbox.path("capture.html")).unwrap();
    assert!(page.contains("<canvas") && page.len() > 20_000, "{}", page.len());
    assert!(page.contains(": points and cameras</title>") && page.contains("blue trained on, orange held out"));
}

#[test]
fn photos_that_do_not_show_their_points_are_named() {
    let sandbox = Sandbox::new();
    let sound = told(&sandbox, |_| ());
    assert!(sound["agreement"].as_f64().unwrap() > 0.9 && sound["advice"].as_array().unwrap().is_empty(), "{sound:#}");
    let swapped = told(&sandbox, |folder| {
        fs::rename(photo(folder, 3), folder.join("third")).unwrap();
        fs::rename(photo(folder, 9), photo(folder, 3)).unwrap();
        fs::rename(folder.join("third"), photo(folder, 9)).unwrap();
    });
    advises(&swapped, "2 photos that do not look like the points seen from their poses");
    let names = swapped["disagreeing"].to_string();
    assert!(names.contains("view_0003.png") && names.contains("view_0009.png"), "{names}");

    let shifted = told(&sandbox, |folder| {
        (0..12).for_each(|n| fs::rename(photo(folder, n), folder.join(n.to_string())).unwrap());
        (0..12).for_each(|n| fs::rename(folder.join(n.to_string()), photo(folder, (n + 1) % 12)).unwrap());
    });
    advises(&shifted, "names seem to be off by one (each photo shows what the pose before its own sees)");
    let mirrored = told(&sandbox, |folder| {
        for n in 0..12 {
            image::open(photo(folder, n)).unwrap().fliph().save(photo(folder, n)).unwrap();
        }
    });
    advises(&mirrored, "photos seem to be mirrored");

    let black = told(&sandbox, |folder| image::RgbImage::new(64, 48).save(photo(folder, 2)).unwrap());
    advises(&black, "1 photo of a single colour");
    assert_eq!(black["single_colour"][0], "view_0002.png");
    let same = told(&sandbox, |folder| {
        fs::copy(photo(folder, 1), photo(folder, 7)).unwrap();
    });
    assert!(same["advice"].to_string().contains("view_0001.png = view_0007.png"), "{}", same["advice"]);
    let copied = told(&sandbox, |folder| {
        fs::copy(photo(folder, 1), folder.join("images/copy.png")).unwrap();
        let file = folder.join("sparse/0/images.txt");
        let text = fs::read_to_string(&file).unwrap();
        let row = text.lines().find(|line| line.ends_with("view_0001.png")).unwrap().split_once(' ').unwrap().1;
        let row = row.replace("view_0001.png", "copy.png");
        fs::write(&file, format!("{}\n99 {row}\n\n", text.trim_end_matches('\n'))).unwrap();
    });
    let twins = "2 photos with the same pixels and pose, which flatter the scores: leave out all but one (copy.png = view_0001.png)";
    assert!(copied["advice"].to_string().contains(twins), "{}", copied["advice"]);
}

#[test]
fn faults_that_all_photos_of_a_camera_share_are_named_once() {
    let sandbox = Sandbox::new();
    let flip = |q: DQuat, t: DVec3| (DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0) * q, DVec3::new(t.x, -t.y, -t.z));
    advises(&told(&sandbox, |folder| pose(folder, flip)), "they have OpenGL's axes");
    advises(&told(&sandbox, |folder| pose(folder, invert)), "from world to camera, not from camera to world");
    let zoomed = told(&sandbox, |folder| zoom(folder, false));
    advises(&zoomed, "with focal lengths 0.833 times as long, they fit to 0.0 px");
    assert!(zoomed["misfit_share"].as_f64().unwrap() > 0.01 && zoomed["misfits"].as_array().unwrap().is_empty());
    let second = told(&sandbox, |folder| zoom(folder, true));
    advises(&second, "the intrinsics of camera 2 do not fit its 3 photos");
    assert_eq!(second["misfit_cameras"], serde_json::json!([2]));
    advises(&told(&sandbox, |folder| cut_points(folder, 10)), "no two photos share a point");

    // Without tracks, only the colours tell.
    let untracked = |change: fn(DQuat, DVec3) -> (DQuat, DVec3)| {
        let told = told(&sandbox, |folder| {
            cut_points(folder, 8);
            edit(&folder.join("sparse/0/images.txt"), |line| if line.contains(".png") { line } else { "" }.to_owned());
            let text = fs::read_to_string(folder.join("sparse/0/images.txt")).unwrap();
            fs::write(folder.join("sparse/0/images.txt"), text.trim_start()).unwrap();
            pose(folder, change);
        });
        told["advice"].to_string()
    };
    let advice = untracked(|q, t| (DQuat::from_xyzw(q.y, q.z, q.w, q.x), t));
    assert!(advice.contains("quaternions seem to be in the order x y z w"), "{advice}");
    let advice = untracked(invert);
    assert!(
        advice.contains("the poses seem to be inverted") && advice.contains("the points fall into 0 % of"),
        "{advice}"
    );
}
