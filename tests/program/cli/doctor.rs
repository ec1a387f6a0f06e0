//! `inspect` names photos whose poses do not fit, and draws the capture.

use super::Sandbox;
use crate::program::ended::capture;
use std::fs;

#[test]
fn a_photo_that_fits_no_points_is_named_and_marked() {
    let sandbox = Sandbox::new();
    capture(&sandbox.path("capture"), 300);
    let sound = sandbox.works(&["inspect", "capture/scene", "--json"]).json();
    assert!(sound["misfits"].as_array().unwrap().is_empty() && sound["advice"].as_array().unwrap().is_empty());
    assert!(sound["misfit_px"].as_f64().unwrap() < 0.01, "{}", sound["misfit_px"]);

    // The fourth photo's camera a unit to the side.
    let images = sandbox.path("capture/scene/sparse/0/images.txt");
    let moved: Vec<String> = fs::read_to_string(&images)
        .unwrap()
        .lines()
        .map(|line| {
            let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
            if line.ends_with("view_0003.png") {
                words[5] = (words[5].parse::<f64>().unwrap() + 3.0).to_string();
            }
            words.join(" ")
        })
        .collect();
    fs::write(&images, moved.join("\n") + "\n").unwrap();
    let told = sandbox.works(&["inspect", "capture/scene", "--json", "--html", "capture.html"]).json();
    let names = serde_json::to_string(&told["misfits"]).unwrap();
    assert!(names.contains("view_0003.png") && told["misfits"].as_array().unwrap().len() == 1, "{names}");
    let advice = told["advice"][0].as_str().unwrap();
    assert!(advice.starts_with("1 photo with a pose that does not fit the points"), "{advice}");
    let page = fs::read_to_string(sandbox.path("capture.html")).unwrap();
    assert!(page.contains("<canvas") && page.len() > 20_000, "{}", page.len());
}
