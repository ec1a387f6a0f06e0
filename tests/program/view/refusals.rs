//! What a viewer refuses: strangers, other sites, bad requests and messages, a fifth page.

use super::session::{Viewer, pose, request};
use super::{beside, scene, viewer};
use crate::program::ended::{end, qirf};
use std::io::{Read, Write};
use std::net::TcpListener;
use std::time::{Duration, Instant};

#[test]
fn strangers_and_other_sites_see_nothing() {
    let viewer = viewer(&[]);
    let cookie = viewer.cookie.clone();
    let status = |path: &str, headers: &[(&str, &str)]| viewer.exchange(&viewer.request(path, headers)).0;
    let mine = ("Cookie", cookie.as_str());
    for path in ["/", "/scene.json", "/photo/0", "/page.js", "/ws", "/?token=0123456789abcdef0123456789abcdef"] {
        assert_eq!(status(path, &[]), 403, "{path} without a cookie");
        assert_eq!(status(path, &[("Cookie", "qirf-vk=1")]), 403, "{path} with another cookie");
    }
    let port = viewer.host.rsplit_once(':').unwrap().1;
    for host in [format!("127.evil.example:{port}"), "evil.example".into(), format!("127.0.0.1.nip.example:{port}")] {
        assert_eq!(status("/scene.json", &[mine, ("Host", &host)]), 403, "{host}");
    }
    let upgrade = [("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="), mine];
    for origin in [None, Some("http://evil.example"), Some("null")] {
        let headers: Vec<_> = upgrade.into_iter().chain(origin.map(|o| ("Origin", o))).collect();
        assert_eq!(status("/ws", &headers), 403, "{origin:?}");
    }
    for path in
        ["/photo/../../etc/passwd", "/photo/5", "/photo/-1", "/photo/99999999999999999999", "/photo/", "/page.rs", "//"]
    {
        assert_eq!(status(path, &[mine]), 404, "{path}");
    }
    for path in ["/", "/scene.json", "/photo/4", "/page.js", "/camera.js", "/draw.js", "/input.js", "/page.css"] {
        assert_eq!(status(path, &[mine]), 200, "{path}");
    }
    assert_eq!(status("/scene.json", &[mine, ("Host", "LOCALHOST")]), 200);
    let (code, head, _) = viewer.exchange("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(code == 405 && head.contains("Allow: GET, HEAD\r\n"), "{head}");
    let (code, head, body) = viewer.exchange(&viewer.request("/page.js", &[mine]).replacen("GET", "HEAD", 1));
    assert!(code == 200 && !head.contains("Content-Length: 0") && body.is_empty(), "{head}");
    let with_token = viewer.url.rsplit_once('?').unwrap().1;
    let (code, head, body) = viewer.exchange(&viewer.request(&format!("/scene.json?{with_token}"), &[]));
    assert!(code == 200 && head.contains("Set-Cookie: ") && body.starts_with(b"{"), "{head}");
    assert_eq!(status(&format!("/{}", "a".repeat(9000)), &[mine]), 431);
    let head = viewer.exchange(&viewer.request("/", &[mine])).1;
    assert!(head.contains("Content-Security-Policy: default-src 'none'") && !head.contains("Access-Control"), "{head}");
}

#[test]
fn a_request_that_never_ends_is_closed() {
    let viewer = viewer(&[]);
    let begun = Instant::now();
    let mut stream = viewer.connect();
    // A byte a second.
    let mut slow = stream.try_clone().unwrap();
    std::thread::spawn(move || {
        for byte in b"GET / HTTP/1.1\r\nHost: localhost" {
            if slow.write_all(&[*byte]).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_secs(1));
        }
    });
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    assert!(answer.starts_with("HTTP/1.1 408") || answer.is_empty(), "{answer}");
    assert!((8..14).contains(&begun.elapsed().as_secs()), "{:?}", begun.elapsed());
}

#[test]
fn bad_messages_end_the_conversation_and_bad_requests_do_not() {
    let viewer = viewer(&[]);
    for (message, why) in [
        ("{".to_owned(), "from another version"),
        (r#"{"control":"pause"}"#.to_owned(), "cannot control the run"),
        (format!("{{\"shown\":{}}}", " ".repeat(5000)), "4 kB"),
    ] {
        let mut socket = viewer.socket();
        socket.send(&message);
        let reason = socket.goodbye();
        assert!(reason.contains(why), "{message:.40}: {reason}");
    }
    let mut socket = viewer.socket();
    for (text, why) in [
        (request(1, r#"{"photo":7}"#, ""), "no photo 7"),
        (pose(r#""model":3"#, 2), "no model 3"),
        (pose(r#""picture":"error""#, 3), "a second model"),
        (request(4, r#"{"pose":{"position":[0,0,0],"rotation":[0,0,0,0],"fov":1}}"#, ""), "the camera"),
        (pose("", 5).replace("[64,48]", "[60000,60000]"), "pixels"),
        (pose("", 6).replace("[64,48]", "[0,48]"), "pixels"),
    ] {
        socket.send(&text);
        let said = socket.frame().unwrap_err();
        assert!(said.contains(why), "{text}: {said}");
    }
    socket.picture(&pose("", 9));
}

#[test]
fn a_fifth_page_waits_outside() {
    let viewer = viewer(&[]);
    let mut sockets: Vec<_> = (0..4).map(|_| viewer.socket()).collect();
    for socket in &mut sockets {
        socket.picture(&pose("", 1));
    }
    assert!(viewer.socket().goodbye().contains("four pages"));
    drop(sockets.pop());
    let begun = Instant::now();
    while viewer.socket().frame_or_refusal(&pose("", 2)).is_err() {
        assert!(begun.elapsed() < Duration::from_secs(5), "the place of a page that left stays taken");
    }
}

#[test]
fn what_cannot_be_shown_or_served_is_said() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let (model, scene) = (beside("model.ply"), scene().display().to_string());
    // As a run leaves its folder until it has finished.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("config.toml"), "").unwrap();
    let begun = folder.path().display().to_string();
    let results = tempfile::tempdir().unwrap();
    let [compared, swept, halted] = ["compare.json", "sweep.json", "arms/default"].map(|name| {
        let at = results.path().join(name.replace(['.', '/'], "_"));
        std::fs::create_dir_all(at.join("arms")).unwrap();
        std::fs::write(at.join("config.toml"), "").unwrap();
        std::fs::write(at.join(name), "").unwrap();
        at.display().to_string()
    });
    for (arguments, code, words) in [
        (vec!["view", &model, "--port", &port], 2, "cannot listen on"),
        (vec!["view", "nowhere.ply"], 3, "nowhere.ply"),
        (vec!["view", &model, "--scene", "nowhere"], 3, "nowhere"),
        (vec!["view", &model, "--host", "example.org"], 2, "--host"),
        (
            vec!["view", &model, "--host", "192.0.2.1"],
            2,
            "192.0.2.1 is not an address of this machine; choose another --host",
        ),
        (vec!["view", &begun], 3, "a run that has not finished; continue it with `run --resume`"),
        (vec!["view", &model, "--scene", &begun], 3, "a run that has not finished"),
        (vec!["inspect", &begun], 3, "a run that has not finished"),
        (vec!["eval", &begun, &scene], 3, "a run that has not finished"),
        (vec!["view", &compared], 3, "a comparison: compare.html shows its figures"),
        (vec!["render", &compared, "--orbit", "1", "-o", "orbit"], 3, "a comparison: compare.html shows its figures"),
        (vec!["inspect", &swept], 3, "a sweep: sweep.html shows its figures"),
        (vec!["inspect", &halted], 3, "continue it with `compare --resume`"),
    ] {
        let said = end(&mut qirf(arguments)).with(code, &[words]).said;
        assert!(!said.contains("other machines can reach"), "{said}");
    }
    drop(Viewer::start(&["view", &model]));
}
