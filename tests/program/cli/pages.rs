//! Pages that hold a model: what a browser makes of them, beside the pictures of `render`.
#![cfg(unix)]

use super::Sandbox;
use crate::support::Random;
use crate::support::browser::Browser;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats::{self, RenderMode};
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
        let page = ["convert", "cloud.ply", "cloud.html", "--scene", "photos", "--title", "A <cloud>", "--background"];
        sandbox.works(&[&page[..], &[background], style].concat());
        sandbox.works(&["convert", "cloud.ply", "cloud.spz"]);
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

#[test]
fn a_page_obeys_mouse_and_keys_and_unpacks_without_the_browsers_help() {
    let sandbox = Sandbox::new();
    sandbox.works(&["convert", "model.ply", "page.html", "--up", "-y"]);
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
    page.key("h");
    assert_eq!(page.value("document.getElementById('bar').hidden"), true);
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

/// Opens a page of this many small Gaussians.
fn opens(n: usize) {
    let sandbox = Sandbox::new();
    let mut large = cloud(n);
    large.log_scales.iter_mut().flatten().for_each(|s| *s -= 2.0);
    formats::write(&sandbox.path("large.ply"), &large, RenderMode::Plain).unwrap();
    sandbox.works(&["convert", "large.ply", "large.html"]);
    let Some(mut page) = open(&sandbox, "large.html") else { return };
    assert_eq!(page.value("viewer.n"), n);
    assert!(page.value("viewer.pixels().some((v, i) => i % 4 < 3 && v > 60)") == true);
    assert_alone(&page);
}

#[test]
fn a_page_of_a_hundred_thousand_opens() {
    opens(100_000);
}

/// A device with the smallest textures that WebGL 2 allows draws the page; one with smaller ones says why it does not.
#[test]
fn a_page_tells_that_a_device_is_too_small() {
    let sandbox = Sandbox::new();
    formats::write(&sandbox.path("large.ply"), &cloud(3000), RenderMode::Plain).unwrap();
    sandbox.works(&["convert", "large.ply", "page.html"]);
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
#[ignore = "a minute: the browser draws without a GPU"]
fn a_page_of_a_million_opens() {
    opens(1_000_000);
}

#[test]
fn posters_show_small_models_too() {
    use base64::Engine;
    let sandbox = Sandbox::new();
    sandbox.works(&["edit", "model.ply", "-o", "small.ply", "--scale", "0.004"]);
    sandbox.works(&["convert", "small.ply", "small.html"]);
    let html = fs::read_to_string(sandbox.path("small.html")).unwrap();
    let (_, poster) = html.split_once(";base64,").unwrap();
    let bytes = base64::engine::general_purpose::STANDARD.decode(poster.split('"').next().unwrap()).unwrap();
    let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
    assert!(picture.pixels().any(|p| p.0.iter().any(|v| *v > 60)), "black");
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
