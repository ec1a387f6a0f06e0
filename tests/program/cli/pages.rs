//! Pages that hold a model: what a browser makes of them, beside the pictures of `render`.
#![cfg(unix)]

use super::{Sandbox, model};
use crate::program::ended::capture;
use crate::program::html::parse;
use crate::support::Random;
use crate::support::browser::Browser;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats::{self, RenderMode};
use qirf_vk::glam::DVec3;
use qirf_vk::scene::{EVAL_EVERY, OpenOptions, Scene};
use serde_json::{Value, json};
use std::fs;

const SIZE: [u32; 2] = [320, 240];
const SETTLED: &str = "viewer.settled()";
/// Base64 of red, green, blue, alpha, lower rows first.
const PIXELS: &str = "btoa([...viewer.pixels()].map((v) => String.fromCharCode(v)).join(''))";

/// Many Gaussians of all sizes, with SH of degree 3, some of them behind the camera.
fn cloud(n: usize) -> Gaussians {
    let mut random = Random(7);
    let mut uniform = |low: f32, high: f32| random.within(low.into(), high.into()) as f32;
    let mut model = Gaussians::zeroed(n, 3);
    model.means.iter_mut().for_each(|m| *m = [uniform(-1.5, 1.5), uniform(-1.2, 1.2), uniform(-5.0, 3.0)]);
    model.log_scales.iter_mut().flatten().for_each(|s| *s = uniform(-5.0, -1.5));
    model.rotations.iter_mut().flatten().for_each(|q| *q = uniform(-1.0, 1.0));
    model.opacity_logits.iter_mut().for_each(|o| *o = uniform(-3.0, 5.0));
    model.sh[0].iter_mut().for_each(|c| *c = uniform(-1.5, 1.5));
    model.sh[1..].iter_mut().flatten().for_each(|c| *c = uniform(-0.3, 0.3));
    model
}

/// Opens a page in a window of [`SIZE`], and waits until it shows its model.
fn open(sandbox: &Sandbox, name: &str) -> Option<Browser> {
    let mut page = Browser::open(&format!("file://{}", sandbox.path(name).display()))?;
    let metrics = json!({ "width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": false });
    page.call("Emulation.setDeviceMetricsOverride", &metrics);
    page.until(&format!("innerWidth === {} && {SETTLED}", SIZE[0]));
    Some(page)
}

/// The parameters of a page's script.
fn parameters(page: &str) -> Value {
    let (_, rest) = page.split_once("id=\"scene\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[track_caller]
fn assert_near(value: &Value, expected: DVec3) {
    let found = DVec3::from(serde_json::from_value::<[f64; 3]>(value.clone()).unwrap());
    assert!(found.distance(expected) < 1e-6, "{found} instead of {expected}");
}

/// PSNR of the middle of the canvas against a picture, and the greatest difference there.
fn likeness(page: &mut Browser, sandbox: &Sandbox, picture: &str) -> (f64, u8) {
    use base64::Engine;
    let text = page.value(PIXELS);
    let drawn = base64::engine::general_purpose::STANDARD.decode(text.as_str().unwrap()).unwrap();
    let expected = image::open(sandbox.path(picture)).unwrap().into_rgb8();
    let [w, h] = SIZE;
    assert_eq!((expected.dimensions(), drawn.len()), ((w, h), (4 * w * h) as usize));
    let (mut sum, mut most, mut count) = (0.0, 0, 0.0);
    for y in h / 4..3 * h / 4 {
        for x in w / 4..3 * w / 4 {
            let at = (4 * ((h - 1 - y) * w + x)) as usize;
            for (a, b) in drawn[at..at + 3].iter().zip(expected.get_pixel(x, y).0) {
                most = most.max(a.abs_diff(b));
                sum += f64::from(a.abs_diff(b)).powi(2);
                count += 1.0;
            }
        }
    }
    (10.0 * (255.0 * 255.0 * count / sum).log10(), most)
}

/// Nothing was complained about but that the test reads pixels, and nothing was asked for but the page itself.
fn assert_alone(page: &Browser) {
    let complaints: Vec<_> = page.complaints.iter().filter(|c| !c.contains("GPU stall due to ReadPixels")).collect();
    assert!(complaints.is_empty(), "{complaints:?}");
    let own = |r: &&String| ["file:", "blob:", "data:", "about:blank"].iter().any(|kind| r.starts_with(kind));
    let foreign: Vec<_> = page.requests.iter().filter(|r| !own(r)).collect();
    assert!(
        foreign.is_empty() && page.requests.iter().filter(|r| r.starts_with("file:")).count() == 1,
        "{:?}",
        page.requests
    );
}

#[test]
fn a_page_shows_what_render_shows() {
    let sandbox = Sandbox::new();
    sandbox.scene("photos", &format!("1 PINHOLE {} {} 260 260 160 120", SIZE[0], SIZE[1]), &["one.png"]);
    let [plain, antialiased] = [RenderMode::Plain, RenderMode::AntiAliased];
    for (mode, background, style) in [
        (plain, "0.2,0.4,0.6", &[][..]),
        (antialiased, "black", &[]),
        (plain, "black", &["--antialias", "--dilation", "0.3"]),
    ] {
        formats::write(&sandbox.path("cloud.ply"), &cloud(1000), mode).unwrap();
        let page = ["cloud.ply", "cloud.html", "--scene", "photos", "--title", "A <cloud>", "--background"];
        sandbox.converts(&[&page[..], &[background], style].concat());
        sandbox.converts(&["cloud.ply", "cloud.spz"]);
        let render = ["render", "cloud.spz", "--scene", "photos", "-o", "out", "--background", background];
        sandbox.works(&[&render[..], style].concat());
        let Some(mut page) = open(&sandbox, "cloud.html") else { return };
        let (psnr, most) = likeness(&mut page, &sandbox, "out/one.png");
        println!("{mode}: {psnr:.1} dB, at most {most}");
        assert!(psnr > 45.0 && page.value("viewer.halves") == true, "{mode}: {psnr} dB, at most {most}");
        assert_eq!((page.value("viewer.n"), page.value("document.title")), (json!(1000), json!("A <cloud>")));
        assert_alone(&page);
    }
}

/// The principal point lies beside the picture's middle, as that of most photos, and pixels are not square; both stay so when the camera
/// moves.
#[test]
fn a_page_has_the_intrinsics_of_its_first_camera() {
    let sandbox = Sandbox::new();
    sandbox.scene("photos", &format!("1 PINHOLE {} {} 325 260 187 101", SIZE[0], SIZE[1]), &["one.png"]);
    formats::write(&sandbox.path("cloud.ply"), &cloud(1000), RenderMode::Plain).unwrap();
    sandbox.converts(&["cloud.ply", "cloud.html", "--scene", "photos"]);
    let given = parameters(&fs::read_to_string(sandbox.path("cloud.html")).unwrap());
    let shift: [f64; 2] = serde_json::from_value(given["start"]["shift"].clone()).unwrap();
    assert!((shift[0] - 27.0 / 240.0).abs() < 1e-9 && (shift[1] + 19.0 / 240.0).abs() < 1e-9, "{shift:?}");
    assert_eq!(given["start"]["stretch"], 1.25);
    sandbox.converts(&["cloud.ply", "cloud.spz"]);
    sandbox.works(&["render", "cloud.spz", "--scene", "photos", "-o", "out"]);
    let Some(mut page) = open(&sandbox, "cloud.html") else { return };
    let (psnr, most) = likeness(&mut page, &sandbox, "out/one.png");
    assert!(psnr > 45.0, "{psnr} dB, at most {most}");
    let now = "JSON.stringify([...viewer.camera.shift, viewer.camera.stretch])";
    let before = page.value(now);
    page.value("viewer.camera.orbit(0.2, 0.1)");
    page.key("l");
    assert!(before != "[0,0,1]" && page.value(now) == before, "{before}");
}

/// Among the faces' names, `front` is not the first.
#[test]
fn a_page_of_a_photo_that_is_cut_into_faces_begins_with_the_front() {
    let sandbox = Sandbox::new();
    sandbox.scene("wide", "1 OPENCV_FISHEYE 96 72 22 22 48 36 0 0 0 0", &["one.png"]);
    sandbox.converts(&["model.ply", "page.html", "--scene", "wide"]);
    let given = parameters(&fs::read_to_string(sandbox.path("page.html")).unwrap());
    assert_eq!(given["start"]["rotation"], json!([1.0, 0.0, 0.0, 0.0]));
}

/// A capture a hundred times smaller than usual, where z is up: nothing of it lies beyond the usual near plane.
#[test]
fn a_page_has_up_and_near_plane_of_its_scene() {
    let sandbox = Sandbox::new();
    sandbox.scene("photos", &format!("1 PINHOLE {} {} 260 260 160 120", SIZE[0], SIZE[1]), &["one.png"]);
    let half = 0.5_f64.sqrt();
    let upright = format!("1 {half} {half} 0 0 0 0 0.04 1 one.png\n\n");
    fs::write(sandbox.path("photos/sparse/0/images.txt"), upright).unwrap();
    formats::write(&sandbox.path("small.ply"), &model(20).scaled(0.01), RenderMode::Plain).unwrap();
    let given = |more: &[&str]| {
        sandbox.converts(&[&["small.ply", "page.html", "--scene", "photos"], more].concat());
        parameters(&fs::read_to_string(sandbox.path("page.html")).unwrap())
    };
    assert_near(&given(&["--up", "-y"])["up"], DVec3::NEG_Y);
    let given = given(&[]);
    assert_near(&given["up"], DVec3::Z);
    assert_near(&given["start"]["position"], DVec3::new(0.0, -0.04, 0.0));
    assert_near(&given["target"], DVec3::ZERO);
    assert!((5e-4..1e-3).contains(&given["near"].as_f64().unwrap()), "{given}");
    sandbox.converts(&["small.ply", "small.spz"]);
    sandbox.works(&["render", "small.spz", "--scene", "photos", "-o", "out"]);
    let Some(mut page) = open(&sandbox, "page.html") else { return };
    let (psnr, most) = likeness(&mut page, &sandbox, "out/one.png");
    assert!(psnr > 40.0, "{psnr} dB, at most {most}");
}

#[test]
fn the_page_of_a_run_begins_at_its_first_held_out_camera() {
    let sandbox = Sandbox::new();
    let scene = Scene::open(&capture(&sandbox.path("capture"), 300), &OpenOptions::default()).unwrap();
    let run = ["run", "capture/scene", "-o", "trained", "--no-prune", "--iterations", "20", "--sh-degree", "0"];
    sandbox.works(&[&run[..], &["--resolution", "24", "--with-model"]].concat());
    let report = parse(&fs::read_to_string(sandbox.path("trained/report.html")).unwrap()).unwrap();
    let given = parameters(report.select("#model iframe")[0].attribute("srcdoc").unwrap());
    let camera = &scene.views[scene.split(EVAL_EVERY).test[0]].camera;
    assert_near(&given["start"]["position"], camera.centre());
    assert_near(&given["target"], scene.sight(camera));
    assert_near(&given["up"], scene.up());
    assert!((given["near"].as_f64().unwrap() - f64::from(scene.near)).abs() < 1e-6, "{}", given["near"]);
}

#[test]
fn pages_show_models_of_any_unit_and_place() {
    let sandbox = Sandbox::new();
    let cloud = cloud(200);
    let far = cloud.means.iter().map(|[x, y, z]| [x + 1e5, y - 2e4, *z]).collect();
    let far = Gaussians { means: far, ..cloud.clone() };
    let psnr = |model: &Gaussians| -> f64 {
        formats::write(&sandbox.path("in.ply"), model, RenderMode::Plain).unwrap();
        let said = sandbox.works(&["convert", "in.ply", "out.html", "--sh-bits", "8,8"]).said;
        let (before, _) = said.split_once(" dB against the original").unwrap_or_else(|| panic!("{said}"));
        before.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let usual = psnr(&cloud);
    for (what, model) in [("1e-4", &*cloud.scaled(1e-4)), ("1e6", &*cloud.scaled(1e6)), ("far", &far)] {
        let psnr = psnr(model);
        assert!(psnr > usual - 2.0, "{what}: {psnr} dB, {usual} dB as usual");
    }
}

#[test]
fn a_page_obeys_mouse_and_keys_and_unpacks_without_the_browsers_help() {
    let sandbox = Sandbox::new();
    sandbox.converts(&["model.ply", "page.html", "--up", "-y"]);
    sandbox.works(&["render", "model.ply", "--orbit", "1", "--size", "320x240", "-o", "out"]);
    let Some(mut page) = open(&sandbox, "page.html") else { return };
    // Our framing is that of an orbit but for its table of shapes; SPZ's steps remain.
    let (psnr, _) = likeness(&mut page, &sandbox, "out/orbit_000.png");
    assert!(psnr > 25.0, "{psnr} dB");
    let position = |page: &mut Browser| page.value("viewer.camera.position");
    let start = position(&mut page);
    for (kind, at) in
        [("mousePressed", [160.0, 120.0]), ("mouseMoved", [200.0, 130.0]), ("mouseReleased", [200.0, 130.0])]
    {
        page.mouse(kind, at, &json!({}));
    }
    assert_ne!(position(&mut page), start);
    page.until(SETTLED);
    page.key("Home");
    assert_eq!(position(&mut page), start);
    page.mouse("mouseWheel", [160.0, 120.0], &json!({ "deltaX": 0, "deltaY": -240 }));
    page.until(&format!("viewer.camera.position[2] !== {}", start[2]));
    page.key(" ");
    assert_eq!(page.value("viewer.turning"), true);
    let before = position(&mut page);
    page.until(&format!("viewer.camera.position[0] !== {}", before[0]));
    // A key that is held changes nothing more.
    let held = json!({ "type": "keyDown", "key": " ", "autoRepeat": true });
    page.call("Input.dispatchKeyEvent", &held);
    assert_eq!(page.value("viewer.turning"), true);
    page.key("h");
    assert_eq!(page.value("document.getElementById('bar').hidden"), true);
    let offered =
        "[document.getElementById('full').hidden, document.querySelector('.keys').textContent.includes('Arrows')]";
    assert_eq!(page.value(offered), json!([false, true]), "full screen by a button, and all keys");
    // Zooming has an end on either side, and a flight goes on from there.
    let shares = page.value(
        "(() => { const { camera, reach } = viewer; camera.dolly(1e-12); const least = camera.distance, at = camera.position; \
         camera.fly(0, 0, 1); const flown = Math.hypot(...camera.position.map((v, i) => v - at[i])); camera.dolly(1e30); \
         return [least, flown, camera.distance].map((v) => v / reach) })()",
    );
    assert_near(&shares, DVec3::new(1e-3, 0.05, 1e3));
    assert_alone(&page);

    // The same words from the page's own decompressor.
    let html = fs::read_to_string(sandbox.path("page.html")).unwrap();
    let packed = html.split("id=\"model\">").nth(1).unwrap().split('<').next().unwrap();
    let mut unpacked = |fallback: bool| -> Value {
        page.value(&format!(
            "new Promise((done) => {{ const text = document.getElementById('worker').textContent; \
             const worker = new Worker(URL.createObjectURL(new Blob([text]))); \
             worker.onmessage = ({{ data }}) => done(data.fault ?? [...data.splats.slice(0, 160), ...data.bands.slice(0, 80)]); \
             worker.postMessage({{ model: '{packed}', widthBits: 11, fallback: {fallback} }}); }})"
        ))
    };
    let (own, browsers) = (unpacked(true), unpacked(false));
    assert!(own == browsers && own.as_array().is_some_and(|words| words.len() == 240), "{own}");
}

#[test]
fn words_of_a_page_are_right_and_legible_over_white() {
    let sandbox = Sandbox::new();
    formats::write(&sandbox.path("one.ply"), &model(1), RenderMode::Plain).unwrap();
    sandbox.converts(&["one.ply", "page.html", "--background", "white", "--title", " "]);
    let Some(mut page) = open(&sandbox, "page.html") else { return };
    assert_eq!(page.value("document.title"), "one");
    assert!(page.value("document.getElementById('facts').textContent").as_str().unwrap().starts_with("1 Gaussian, "));
    page.key(" ");
    let contrasts = page.value(
        "(() => { const of = (id, what) => getComputedStyle(document.getElementById(id))[what].match(/[\\d.]+/g).map(Number); \
         const over = ([r, g, b, a], under) => [r, g, b].map((v, k) => v * a + under[k] * (1 - a)); \
         const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; \
         const light = (c) => [0.2126, 0.7152, 0.0722].reduce((sum, w, k) => sum + w * linear(c[k] / 255), 0.05); \
         const bar = over(of('bar', 'backgroundColor'), [255, 255, 255]), pressed = over(of('turn', 'backgroundColor'), bar); \
         return [light(of('facts', 'color')) / light(bar), light(of('turn', 'color')) / light(pressed)] })()",
    );
    assert!(contrasts.as_array().unwrap().iter().all(|c| c.as_f64().unwrap() >= 4.5), "{contrasts}");
}

/// Opens a page of this many small Gaussians.
fn opens(n: usize) {
    let sandbox = Sandbox::new();
    let mut large = cloud(n);
    large.log_scales.iter_mut().flatten().for_each(|s| *s -= 2.0);
    formats::write(&sandbox.path("large.ply"), &large, RenderMode::Plain).unwrap();
    let said = sandbox.converts(&["large.ply", "large.html"]).said;
    assert!(said.contains("precision not chosen by pictures, loss not measured: there is no Vulkan device"), "{said}");
    let Some(mut page) = open(&sandbox, "large.html") else { return };
    assert_eq!(page.value("viewer.n"), n);
    assert!(page.value("viewer.pixels().some((v, i) => i % 4 < 3 && v > 60)") == true);
    assert_alone(&page);
}

/// More than 16 bits can count.
#[test]
fn a_page_of_seventy_thousand_opens() {
    opens(70_000);
}

/// A device with the smallest textures that WebGL 2 allows draws the page; one with smaller ones says why it does not.
#[test]
fn a_page_tells_that_a_device_is_too_small() {
    let sandbox = Sandbox::new();
    formats::write(&sandbox.path("large.ply"), &cloud(3000), RenderMode::Plain).unwrap();
    sandbox.converts(&["large.ply", "page.html"]);
    let html = fs::read_to_string(sandbox.path("page.html")).unwrap();
    let most = "gl.getParameter(gl.MAX_TEXTURE_SIZE)";
    assert_eq!(html.matches(most).count(), 2);
    fs::write(sandbox.path("narrow.html"), html.replace(most, "2048")).unwrap();
    let Some(mut page) = open(&sandbox, "narrow.html") else { return };
    assert!(page.value("viewer.pixels().some((v, i) => i % 4 < 3 && v > 60)") == true);
    assert_alone(&page);
    fs::write(sandbox.path("small.html"), html.replace(most, "64")).unwrap();
    let Some(mut page) = Browser::open(&format!("file://{}", sandbox.path("small.html").display())) else { return };
    page.until("document.getElementById('message').textContent.includes('more than this device can hold')");
}

#[test]
#[ignore = "a minute, as the browser draws without a GPU: make page-of-a-million"]
fn a_page_of_a_million_opens() {
    opens(1_000_000);
}

#[test]
fn posters_show_small_models_and_huge_pictures_too() {
    use base64::Engine;
    let sandbox = Sandbox::new();
    sandbox.works(&["edit", "model.ply", "-o", "small.ply", "--scale", "0.004"]);
    // A picture of its size takes 32 GiB.
    sandbox.scene("huge", "1 PINHOLE 32768 32768 28000 28000 20000 12000", &["one.png"]);
    let poster = |model: &str, scene: &[&str], size: (u32, u32)| {
        sandbox.works(&[&["convert", model, "page.html"][..], scene].concat());
        let html = fs::read_to_string(sandbox.path("page.html")).unwrap();
        let (_, poster) = html.split_once(";base64,").unwrap();
        let bytes = base64::engine::general_purpose::STANDARD.decode(poster.split('"').next().unwrap()).unwrap();
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert!(picture.pixels().any(|p| p.0.iter().any(|v| *v > 60)), "{model}: black");
        assert_eq!(picture.dimensions(), size, "{model}");
        picture
    };
    poster("small.ply", &[], (400, 250));
    let huge = poster("model.ply", &["--scene", "huge"], (800, 800));
    sandbox.works(&["render", "model.ply", "--scene", "huge", "--resolution", "800", "-o", "out"]);
    let drawn = image::open(sandbox.path("out/one.png")).unwrap().into_rgb8();
    assert_eq!(drawn.dimensions(), (800, 800));
    let sum: f64 = huge.iter().zip(drawn.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    let mean = sum / drawn.len() as f64;
    assert!(mean < 2.0, "{mean} of 255: a JPEG differs by less");

    // In a window wider than the picture, too, its scale is that of the model's picture, whose height is the window's.
    let Some(mut page) = open(&sandbox, "page.html") else { return };
    let place = page.value(
        "(async () => { const square = Object.assign(document.createElement('canvas'), { width: 80, height: 80 }); \
         const poster = Object.assign(new Image(), { id: 'poster', src: square.toDataURL() }); \
         document.getElementById('stage').append(poster); await poster.decode(); \
         const { left, width, height } = poster.getBoundingClientRect(); return [left, width, height] })()",
    );
    assert_eq!(place, json!([40, 240, 240]));
}

/// The rest of the page is for the model.
#[test]
fn a_poster_takes_at_most_a_fiftieth_of_a_size() {
    let sandbox = Sandbox::new();
    let poster = |more: &[&str]| {
        sandbox.works(&[&["convert", "model.ply", "page.html"][..], more].concat());
        let page = fs::read_to_string(sandbox.path("page.html")).unwrap();
        page.split_once("id=\"poster\" src=\"").map(|(_, rest)| rest.find('"').unwrap())
    };
    let bytes = poster(&[]).unwrap();
    assert_eq!(poster(&["--size", &format!("{}B", 50 * bytes)]), Some(bytes));
    assert_eq!(poster(&["--size", &format!("{}B", 50 * bytes - 1)]), None);
}

#[test]
fn options_of_pages_are_for_pages() {
    let sandbox = Sandbox::new();
    sandbox.fails(2, &["convert", "model.ply", "out.spz", "--title", "x"], &["are for pages", ".html"]);
    sandbox.fails(2, &["convert", "model.ply", "out.spz", "--dilation", "0.3"], &["only to pages"]);
    sandbox.fails(2, &["convert", "model.ply", "out.html", "--depth-order"], &["one order of depths"]);
    sandbox.fails(2, &["convert", "model.ply", "out.html", "--up", "north"], &["write x, y, z"]);
    sandbox.fails(2, &["compress", "model.ply", "-o", "out.html"], &["out.html", "qirf-vk convert"]);
    sandbox.fails(2, &["convert", "model.ply", "out.spz", "--spz-version", "2"], &["write 3 or 4"]);
    assert!(!sandbox.path("out.html").exists() && !sandbox.path("out.spz").exists());
}
