//! The page in a browser: what it shows, and what it makes of a mouse, keys and fingers.

use super::session::Viewer;
use super::{beside, counted_from, rendered, scene, viewer};
use crate::program::ended::{qirf, works};
use crate::support::browser::Browser;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

/// The still picture that belongs to the last request is on the canvas.
const RESTED: &str = "viewer.frame?.lossless && viewer.stillAsked && viewer.received === viewer.sent";
/// Red, green, blue of every pixel of the canvas, in base64.
const PIXELS: &str = "(() => { const { width: w, height: h } = document.getElementById('picture'); \
    const context = new OffscreenCanvas(w, h).getContext('2d', { willReadFrequently: true }); \
    context.drawImage(document.getElementById('picture'), 0, 0); \
    const data = context.getImageData(0, 0, w, h).data.filter((_, i) => i % 4 < 3); \
    return btoa(Array.from(data, (v) => String.fromCharCode(v)).join('')) })()";

/// Size and checksum of the canvas, which tell whether it changed in a hundredth of the time that its pixels take.
const SHOWN: &str = "(() => { const { width: w, height: h } = document.getElementById('picture'); \
    const context = new OffscreenCanvas(w, h).getContext('2d', { willReadFrequently: true }); \
    context.drawImage(document.getElementById('picture'), 0, 0); \
    const words = new Uint32Array(context.getImageData(0, 0, w, h).data.buffer); \
    return [w, h, words.reduce((sum, word) => Math.imul(sum ^ word, 0x01000193), 0)].join() })()";

fn bytes(value: &Value) -> Vec<u8> {
    STANDARD.decode(value.as_str().unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn a_still_canvas_holds_the_pixels_of_the_file_that_render_writes() {
    let viewer = viewer(&[]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    let out = rendered();
    page.until(RESTED);
    for n in 0..2 {
        page.value(&format!("document.querySelectorAll('#list button')[{n}].click()"));
        page.until(&format!("viewer.photo === {n} && {RESTED}"));
        let name = viewer.json("/scene.json")["cameras"][n]["name"].as_str().unwrap().to_owned();
        let file = image::open(out.path().join(name).with_extension("png")).unwrap().into_rgb8();
        assert_eq!(bytes(&page.value(PIXELS)), file.into_raw(), "photo {n}");
    }
    assert_eq!(page.complaints, Vec::<String>::new());
    let own = [format!("http://{}/", viewer.host), format!("ws://{}/", viewer.host)];
    let foreign = page.requests.iter().filter(|r| !own.iter().any(|o| r.starts_with(o)) && !r.starts_with("data:"));
    let foreign: Vec<_> = foreign.filter(|r| !r.starts_with("blob:") && *r != "about:blank").collect();
    assert!(foreign.is_empty() && page.requests.len() > 5, "{foreign:?} of {:?}", page.requests);
}

#[test]
fn a_crop_option_tells_the_sphere_in_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let (model, scene) = (counted_from(10.0, folder.path()), scene().display().to_string());
    let viewer = Viewer::start(&["view", &model, "--scene", &scene]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    // In the coordinates of the file, also where a run has another unit; round the target, which need not be in the middle.
    page.value(
        "document.getElementById('crop').open = true; viewer.scene.unit = 0.5; \
         Object.assign(viewer.camera, { shift: [0.1, -0.05], stretch: 1.25 })",
    );
    for narrow in [false, true] {
        if narrow {
            let screen = json!({ "width": 330, "height": 420, "deviceScaleFactor": 1, "mobile": false });
            page.call("Emulation.setDeviceMetricsOverride", &screen);
            page.key("h");
            page.until(&format!("viewer.frame.size.join() === '330,420' && {RESTED}"));
        }
        let [x, y, z, distance, fov, ratio] = numbers(&page.value(
            "[...viewer.camera.target, viewer.camera.distance, viewer.camera.fov, picture.width / picture.height]",
        ))[..] else {
            panic!("six numbers")
        };
        let radius = 0.5 * distance * ((0.5 * fov).tan() * ((ratio - 0.2) / 1.25).min(0.9)).atan().sin();
        let right = [0.5 * x - 10.0, 0.5 * y, 0.5 * z, radius];
        let told =
            "document.querySelector('#crop > code').textContent.replace('--crop-sphere ', '').split(',').map(Number)";
        page.until(&format!("{told}.every((v, i) => Math.abs(v - {right:?}[i]) <= {})", 1e-3 * radius));
    }
    // There is none about a target outside of the picture.
    page.value("viewer.camera.shift = [0, 0.6]");
    page.until("document.querySelector('#crop > code').textContent === ''");
    assert_eq!(page.complaints, Vec::<String>::new());
}

#[test]
fn the_panel_is_used_by_keys_alone() {
    let other = beside("other.ply");
    let viewer = viewer(&["--against", &other]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    let press = |page: &mut Browser, key: &str, code: u32, times: u32| {
        for kind in (0..times).flat_map(|_| ["keyDown", "keyUp"]) {
            let event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
            page.call("Input.dispatchKeyEvent", &event);
        }
    };
    page.value("document.getElementById('split').focus()");
    press(&mut page, "ArrowRight", 39, 4);
    let focus = "[document.activeElement.id, document.activeElement.value, viewer.photo]";
    assert_eq!(page.value(focus), json!(["split", "4", -1]));
    page.value("document.getElementById('kind').focus()");
    press(&mut page, "ArrowDown", 40, 2);
    assert_eq!(page.value("[document.activeElement.id, viewer.kind]"), json!(["kind", "alpha"]));
    // After a pointer, keys belong to the camera.
    let middle = "(() => { const { left, top, width, height } = document.getElementById('split').getBoundingClientRect(); \
        return [left + width / 2, top + height / 2] })()";
    let middle = numbers(&page.value(middle));
    for kind in ["mousePressed", "mouseReleased"] {
        page.mouse(kind, [middle[0], middle[1]], &json!({}));
    }
    page.until("document.getElementById('split').value > 40 && document.activeElement === document.body");
    let degrees = "[viewer.scene.models[0].degree, document.getElementById('degree').value, document.getElementById('degree').length]";
    assert_eq!(page.value(degrees), json!([0, "0", 1]), "no degree that the model lacks");
    // What is not text has a name.
    page.until(
        "photo.alt && [...document.querySelectorAll('main, canvas')].every((e) => e.getAttribute('aria-label'))",
    );
    assert_eq!(page.complaints, Vec::<String>::new());
}

#[test]
fn mouse_and_keys_move_the_camera() {
    let viewer = viewer(&[]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    let position = |page: &mut Browser| numbers(&page.value("viewer.camera.position"));
    let target = |page: &mut Browser| numbers(&page.value("viewer.camera.target"));
    let apart = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let drag = |page: &mut Browser, more: &Value| {
        page.mouse("mousePressed", [300.0, 300.0], more);
        page.mouse("mouseMoved", [340.0, 320.0], more);
        page.mouse("mouseMoved", [380.0, 330.0], more);
        page.mouse("mouseReleased", [380.0, 330.0], more);
    };
    let mut shown = page.value(SHOWN);
    let mut differs = |page: &mut Browser, what: &str| {
        page.until(RESTED);
        let now = page.value(SHOWN);
        assert_ne!(now, shown, "{what} changes the picture");
        shown = now;
    };

    // Whatever the drag does, what lies before the target follows the pointer, to the right and down.
    let near = "(() => { const c = viewer.camera; globalThis.near = c.position.map((v, i) => v + 0.5 * c.distance * c.forward[i]); })()";
    let seen = "viewer.camera.project(near, [640, 480]).slice(0, 2)";
    for (what, more) in [("orbit", json!({})), ("pan", json!({ "modifiers": 8 })), ("look", json!({ "modifiers": 2 }))]
    {
        page.value(near);
        let before = numbers(&page.value(seen));
        drag(&mut page, &more);
        let after = numbers(&page.value(seen));
        assert!(after[0] > before[0] + 1.0 && after[1] > before[1] + 1.0, "{what}: {before:?} to {after:?}");
    }
    differs(&mut page, "dragging");

    // At a pole an orbit stops, and turns back from there.
    page.value("viewer.camera.level()");
    page.value("for (let i = 0; i < 50; i++) viewer.camera.orbit(0.01, 0.3)");
    let above = "viewer.camera.forward.reduce((s, v, i) => s + v * viewer.camera.up[i], 0)";
    let lowest = page.value(above).as_f64().unwrap();
    assert!((-0.99999..-0.999).contains(&lowest), "{lowest}");
    page.value("viewer.camera.orbit(0, -0.5)");
    assert!(page.value(above).as_f64().unwrap() > -0.98, "it stays at the pole");
    page.key("Home");
    page.until(RESTED);

    // An orbit keeps the target and the distance.
    let before = (position(&mut page), target(&mut page));
    drag(&mut page, &json!({}));
    let after = (position(&mut page), target(&mut page));
    assert!(apart(&before.1, &after.1) < 1e-6 * apart(&before.0, &before.1), "the target stays");
    assert!((apart(&after.0, &after.1) / apart(&before.0, &before.1) - 1.0).abs() < 1e-6, "the distance stays");
    assert!(apart(&before.0, &after.0) > 0.1 * apart(&before.0, &before.1), "the camera moves");
    differs(&mut page, "an orbit");

    // A pan moves camera and target alike.
    let before = (position(&mut page), target(&mut page));
    drag(&mut page, &json!({ "modifiers": 8 }));
    let after = (position(&mut page), target(&mut page));
    let moved = [apart(&before.0, &after.0), apart(&before.1, &after.1)];
    assert!(moved[0] > 0.0 && (moved[0] - moved[1]).abs() < 1e-6 * moved[0], "{moved:?}");
    differs(&mut page, "a pan");

    // The wheel comes nearer, W flies on.
    let distance = page.value("viewer.camera.distance").as_f64().unwrap();
    page.mouse("mouseWheel", [300.0, 300.0], &json!({ "deltaX": 0, "deltaY": -240 }));
    page.until(&format!("viewer.camera.distance < {}", 0.9 * distance));
    differs(&mut page, "the wheel");
    let before = position(&mut page);
    page.call("Input.dispatchKeyEvent", &json!({ "type": "keyDown", "key": "w" }));
    page.until(&format!("Math.hypot(...viewer.camera.position.map((v, i) => v - {}[i])) > 1e-3", json!(before)));
    page.call("Input.dispatchKeyEvent", &json!({ "type": "keyUp", "key": "w" }));
    differs(&mut page, "W");

    // Two fingers apart come nearer; the level horizon has right at right angles to up; Home is the start.
    let distance = page.value("viewer.camera.distance").as_f64().unwrap();
    for (kind, places) in [("touchStart", [250, 350]), ("touchMove", [230, 370]), ("touchMove", [200, 400])] {
        let points: Vec<Value> = places.iter().zip(1..).map(|(x, id)| json!({ "x": x, "y": 300, "id": id })).collect();
        page.call("Input.dispatchTouchEvent", &json!({ "type": kind, "touchPoints": points }));
    }
    page.call("Input.dispatchTouchEvent", &json!({ "type": "touchEnd", "touchPoints": [] }));
    page.until(&format!("viewer.camera.distance < {}", 0.9 * distance));
    page.key("l");
    let level = "Math.abs(viewer.camera.right.reduce((s, v, i) => s + v * viewer.camera.up[i], 0)) < 1e-9";
    page.until(level);
    // Zooming is bounded, so that it ends neither in the middle nor nowhere.
    page.value("for (let i = 0; i < 4000; i++) viewer.camera.dolly(i < 2000 ? 2 : 0.5)");
    page.until("viewer.reach > 0 && viewer.camera.distance >= 0.9e-3 * viewer.reach");
    page.key("Home");
    page.until("viewer.camera.position.every((v, i) => v === viewer.scene.start.position[i])");
    assert_eq!(page.complaints, Vec::<String>::new());
}

/// An address of an earlier version has 9 numbers, the principal point being in the middle, or 11, pixels being square.
#[test]
fn an_address_keeps_the_view() {
    let viewer = viewer(&[]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(&format!("{RESTED} && location.hash.startsWith('#pose=') && location.hash.split(',').length === 12"));
    for (numbers, rest) in [("4,0.25,-0.5,1.5", "0.25,-0.5,1.5"), ("4,0.5,0", "0.5,0,1"), ("5", "0,0,1")] {
        page.value(&format!("location.hash = 'pose=1,2,3,1,0,0,0,0.8,{numbers}'"));
        let now = "[...viewer.camera.position, ...viewer.camera.shift, viewer.camera.stretch].join()";
        page.until(&format!("{now} === '1,2,3,{rest}' && {RESTED}"));
    }
    assert_eq!(page.complaints, Vec::<String>::new());
}

#[test]
fn photos_are_a_click_away_and_compared_by_a_slider() {
    let viewer = viewer(&[]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    // From behind the first photo's camera, its frustum can be clicked: its place, and the middle of its picture, which lies
    // beside its axis.
    let place = "(share) => { const { camera, scene, length } = viewer, s = document.getElementById('stage'), p = document.getElementById('picture'); \
        const r = Math.min(s.clientWidth / p.width, s.clientHeight / p.height), size = [p.width * r, p.height * r]; \
        const point = (c) => { const { forward, right } = new camera.constructor(c, c.position, camera.up), aside = 8 * Math.tan(c.fov / 2); \
          return c.position.map((v, i) => v + share * length * (forward[i] - aside * right[i])) }; \
        return scene.cameras.map((c) => camera.project(point(c), size)).map((q) => q && \
          [q[0] + (s.clientWidth - size[0]) / 2, q[1] + (s.clientHeight - size[1]) / 2]) }";
    let inside = |p: &Value| {
        p[0].as_f64().is_some_and(|x| (5.0..700.0).contains(&x)) && (5.0..690.0).contains(&p[1].as_f64().unwrap())
    };
    page.value("viewer.scene.cameras.forEach((c) => { c.shift = [4, 0] })");
    for share in [0, 1] {
        page.key("Home");
        page.until(RESTED);
        page.value("viewer.camera.dolly(3)");
        let places = page.value(&format!("({place})({share})"));
        let n = places.as_array().unwrap().iter().position(inside).expect("a camera in view");
        let at = numbers(&places[n]);
        for kind in ["mousePressed", "mouseReleased"] {
            page.mouse(kind, [at[0], at[1]], &json!({}));
        }
        page.until(&format!("viewer.photo === {n} && {RESTED}"));
    }
    assert_eq!(page.value("[viewer.frame.size[0], viewer.frame.size[1]]"), json!([64, 48]));
    // In another order, the list still marks it.
    page.value("document.getElementById('sort').click()");
    page.until("document.querySelectorAll('#list [aria-current=true]').length === 1");

    let slide = |page: &mut Browser, to: u32| {
        let event = "dispatchEvent(new Event('input', { bubbles: true }))";
        page.value(&format!("(() => {{ const s = document.getElementById('split'); s.value = {to}; s.{event} }})()"));
    };
    slide(&mut page, 50);
    page.until("!photo.hidden && photo.complete && photo.naturalWidth === 64");
    slide(&mut page, 0);
    page.until("photo.hidden");

    // Every kind of picture, by its key; the error's PSNR is told.
    let mut seen = vec![page.value(SHOWN)];
    for (key, kind) in [("2", "depth"), ("3", "alpha"), ("4", "blocks"), ("6", "count"), ("5", "error")] {
        page.key(key);
        page.until(&format!("viewer.kind === '{kind}' && viewer.received === viewer.sent && {RESTED}"));
        let now = page.value(SHOWN);
        assert!(!seen.contains(&now), "{kind}");
        seen.push(now);
    }
    page.until("document.getElementById('status').textContent.includes('PSNR')");
    // Those of a prune are not offered.
    assert_eq!(
        page.value("[...document.getElementById('kind').options].map((o) => o.value).join()"),
        "colour,depth,alpha,blocks,error,count"
    );
    page.key("7");
    assert_eq!(page.value("viewer.kind"), "error");
    page.key("ArrowRight");
    page.until(RESTED);
    assert_eq!(page.complaints, Vec::<String>::new());
}

#[test]
fn a_prune_is_shown_with_its_legend() {
    let folder = tempfile::tempdir().unwrap();
    let [out, file] = ["small.ply", "prune.safetensors"].map(|name| folder.path().join(name).display().to_string());
    let small = ["--views", "16", "--size", "64x64", "--diagnostics", &file];
    works(qirf(["compress", &beside("model.ply"), "-o", &out]).args(small));
    let viewer = viewer(&["--diagnostics", &file]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    let mut seen = vec![page.value(SHOWN)];
    for (key, kind, legend) in [
        ("4", "blocks", "each cluster"),
        ("6", "count", "red: 255"),
        ("7", "kept", "green: kept"),
        ("8", "score", "rank by score"),
        ("9", "guards", "blue: seen by no view"),
    ] {
        page.key(key);
        page.until(&format!("viewer.kind === '{kind}' && viewer.received === viewer.sent && {RESTED}"));
        page.until(&format!("document.getElementById('legend').textContent.includes('{legend}')"));
        let now = page.value(SHOWN);
        assert!(!seen.contains(&now), "{kind}");
        seen.push(now);
    }
    page.key("6");
    page.until("document.getElementById('status').textContent.includes('Gaussians per pixel on average')");
    page.key("1");
    page.until("document.getElementById('legend').textContent === ''");
    // Pairs solve no blocks.
    assert_eq!(page.value("document.querySelector('#kind [value=participation]')"), Value::Null);
    assert_eq!(page.complaints, Vec::<String>::new());
}

#[test]
fn two_models_share_a_picture() {
    let other = beside("other.ply");
    let viewer = viewer(&["--against", &other]);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    let first = bytes(&page.value(PIXELS));
    let slide = |to: u32| {
        format!(
            "(() => {{ const s = document.getElementById('split'); s.value = {to}; s.dispatchEvent(new Event('input')) }})()"
        )
    };
    page.value(&slide(50));
    page.until(&format!("viewer.other && {RESTED}"));
    let both = bytes(&page.value(PIXELS));
    let width = page.value("document.getElementById('picture').width").as_u64().unwrap() as usize;
    let part = |pixels: &[u8], left: bool| -> Vec<u8> {
        let column = |i: &usize| (i / 3 % width < width / 2) == left;
        (0..pixels.len()).filter(column).map(|i| pixels[i]).collect()
    };
    assert_eq!(part(&both, false), part(&first, false), "right of the slider is the first model");
    assert_ne!(part(&both, true), part(&first, true), "left of it is the other one");

    // Without the slider the other's picture is forgotten when the camera moves, and comes back from the new camera.
    page.value(&slide(0));
    page.value("viewer.camera.orbit(0.3, 0.1)");
    page.key("l");
    page.until(&format!("!viewer.other && {RESTED}"));
    page.value(&slide(50));
    page.until(&format!("viewer.other && {RESTED}"));
    assert_ne!(part(&bytes(&page.value(PIXELS)), true), part(&both, true));
    assert_eq!(page.complaints, Vec::<String>::new());
}

#[test]
fn a_page_without_the_token_or_without_a_program_says_so() {
    let viewer = viewer(&[]);
    let Some(mut page) = Browser::open(&format!("http://{}/", viewer.host)) else { return };
    page.until("document.body?.innerText.includes('token is missing')");
    drop(page);
    let Some(mut page) = Browser::open(&viewer.url) else { return };
    page.until(RESTED);
    let port = viewer.host.rsplit_once(':').unwrap().1.to_owned();
    viewer.interrupt();
    page.until("document.getElementById('message').textContent !== ''");
    // Another program in its place has another token, and the page says so.
    let _another = Viewer::start(&["view", &beside("model.ply"), "--port", &port]);
    page.until("document.getElementById('message').textContent.includes('token is missing')");
}

/// Draws the picture of the viewer in the README: `make viewer-picture`.
#[test]
#[ignore = "makes a figure: make viewer-picture"]
fn picture_of_the_page() {
    let [subject, file] =
        ["QIRF_SUBJECT", "QIRF_PICTURE"].map(|key| std::env::var(key).expect("make viewer-picture sets it"));
    let viewer = Viewer::start(&["view", &subject]);
    let mut page = Browser::open(&viewer.url).expect("a browser");
    page.until(RESTED);
    page.value("viewer.camera.dolly(1.6); viewer.camera.orbit(0.25, 0.1)");
    page.value("document.getElementById('width').value = 960; document.getElementById('width').dispatchEvent(new Event('change'))");
    page.value("viewer.camera.look(0, 0)");
    page.until(RESTED);
    let shot = page.call("Page.captureScreenshot", &json!({ "format": "jpeg", "quality": 85 }));
    std::fs::write(file, bytes(&shot["data"])).unwrap();
}
