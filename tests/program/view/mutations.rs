//! Damaged requests and frames, made from a fixed seed: each is answered or refused in time, none lets a stranger in, and the
//! viewer still serves and draws afterwards.

use super::session::{Viewer, pose, request};
use super::viewer;
use crate::support::files::mutate::{Rng, mutate};
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;

/// Cases of each kind: requests, requests of strangers, frames and messages.
const CASES: usize = 600;
/// Masking key of a client's frames.
const KEY: [u8; 4] = [0x37, 0xfa, 0x21, 0x3d];

/// Sends these bytes and no more; returns all that the viewer answers until it ends the connection, which it must.
fn exchange(viewer: &Viewer, pieces: [&[u8]; 2]) -> Vec<u8> {
    let mut stream = viewer.connect();
    let mut answer = Vec::new();
    // It may refuse the request, and close, before the last byte.
    let sent = pieces.iter().try_for_each(|bytes| stream.write_all(bytes));
    let _ = sent.and_then(|()| stream.shutdown(Shutdown::Write));
    if let Err(e) = stream.read_to_end(&mut answer) {
        let waits = matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut);
        assert!(!waits, "no end within 20 s: {}", String::from_utf8_lossy(&pieces.concat()));
    }
    answer
}

/// The status of an answer; 0 if there is none.
fn status(answer: &[u8]) -> u16 {
    if answer.is_empty() {
        return 0;
    }
    let head = String::from_utf8_lossy(&answer[..answer.len().min(12)]).into_owned();
    let number = head.strip_prefix("HTTP/1.1 ").and_then(|number| number.parse().ok());
    number.unwrap_or_else(|| panic!("no answer of HTTP: {head:?}"))
}

/// A request to upgrade, from the viewer's own page unless other headers are given.
fn upgrade(viewer: &Viewer, host: &str, origin: &str, cookie: &str) -> String {
    let headers = [
        ("Host", host),
        ("Origin", origin),
        ("Cookie", cookie),
        ("Connection", "Upgrade"),
        ("Upgrade", "websocket"),
        ("Sec-WebSocket-Version", "13"),
        ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
    ];
    viewer.request("/ws", &headers)
}

/// A client's frame: first byte, length, masking key, masked payload.
fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![first];
    match payload.len() {
        short @ 0..126 => bytes.push(0x80 | short as u8),
        long => {
            bytes.push(0x80 | 0x7e);
            bytes.extend((long as u16).to_be_bytes());
        }
    }
    bytes.extend(KEY);
    bytes.extend(payload.iter().zip(KEY.iter().cycle()).map(|(byte, key)| byte ^ key));
    bytes
}

#[test]
fn mutated_requests_and_frames_do_no_harm() {
    let mut viewer = viewer(&[]);
    let mut rng = Rng::new(7);
    requests(&viewer, &mut rng);
    strangers(&viewer, &mut rng);
    frames(&viewer, &mut rng);
    messages(&viewer, &mut rng);
    assert!(viewer.runs());
    assert_eq!(viewer.get("/scene.json").0, 200);
    assert_eq!(viewer.get("/photo/0").0, 200);
    viewer.socket().picture(&pose("", 2));
}

fn requests(viewer: &Viewer, rng: &mut Rng) {
    let own = format!("http://{}", viewer.host);
    let get = |path: &str| viewer.request(path, &[("Cookie", &viewer.cookie), ("Origin", &own)]);
    let whole =
        [get("/scene.json"), get("/photo/3"), get("/page.js?a=b"), upgrade(viewer, &viewer.host, &own, &viewer.cookie)];
    let mut seen = BTreeMap::new();
    for n in 0..CASES {
        let [text, other] = [n, n + 1].map(|n| whole[n % whole.len()].as_bytes());
        let text = mutate(rng, text, other);
        *seen.entry(status(&exchange(viewer, [&text, b""]))).or_insert(0) += 1;
    }
    // The damage is neither so small that all pass, nor so great that none is read.
    for code in [101, 200, 400, 403, 404, 405] {
        assert!(seen.contains_key(&code), "{code} is not among {seen:?}");
    }
}

/// Requests of strangers, damaged, but without parts of other requests: none becomes one that is served.
fn strangers(viewer: &Viewer, rng: &mut Rng) {
    let (host, cookie) = (viewer.host.as_str(), viewer.cookie.as_str());
    let own = format!("http://{host}");
    let (name, _) = cookie.split_once('=').unwrap();
    let another = format!("{name}=0123456789abcdef0123456789abcdef");
    let rebound = format!("viewer.evil.example:{}", host.rsplit_once(':').unwrap().1);
    let outside = [
        viewer.request("/scene.json", &[]),
        viewer.request("/scene.json", &[("Cookie", &another)]),
        viewer.request("/?token=0123456789abcdef0123456789abcdef", &[]),
        viewer.request("/photo/0", &[("Host", &rebound), ("Cookie", cookie)]),
        upgrade(viewer, host, &own, &another),
        upgrade(viewer, &rebound, &format!("http://{rebound}"), cookie),
        // Damaged, it may ask for the page instead, which the holder of the cookie is given.
        upgrade(viewer, host, "http://evil.example", cookie),
    ];
    for whole in &outside {
        assert_eq!(status(&exchange(viewer, [whole.as_bytes(), b""])), 403, "{whole}");
    }
    for n in 0..CASES {
        let kind = n % outside.len();
        let whole = outside[kind].as_bytes();
        let text = mutate(rng, whole, whole);
        let code = status(&exchange(viewer, [&text, b""]));
        let served = code == 101 || (code == 200 && kind + 1 < outside.len());
        assert!(!served, "{code}: {}", String::from_utf8_lossy(&text));
    }
}

/// Frames damaged as bytes: kinds, lengths, masks and fragments that no page sends.
fn frames(viewer: &Viewer, rng: &mut Rng) {
    let request = pose("", 1);
    let (first, second) = request.as_bytes().split_at(40);
    let whole = [
        frame(0x81, request.as_bytes()),
        frame(0x81, br#"{"shown":0}"#),
        [frame(0x01, first), frame(0x89, b"ping"), frame(0x80, second)].concat(),
        frame(0x82, &[1, 2, 3]),
        frame(0x88, &[0x03, 0xe8, b'b', b'y', b'e']),
        frame(0x81, "\u{fffd}\u{10ffff}".as_bytes()),
        frame(0x81, &[b' '; 5000]),
    ];
    let damaged = (0..CASES).map(|n| {
        let [bytes, other] = [n, n + 1].map(|n| &whole[n % whole.len()]);
        // Every second one where the frame's structure is.
        let within = if n % 2 == 0 { 8 } else { bytes.len() };
        [mutate(rng, &bytes[..within], other).as_slice(), &bytes[within..]].concat()
    });
    let answers = conversations(viewer, damaged);
    for reason in ["messages are JSON", "4 kB", "from another version"] {
        assert!(said(&answers, reason) > 0, "no frame was refused with {reason:?}");
    }
}

/// Whole frames whose text is damaged.
fn messages(viewer: &Viewer, rng: &mut Rng) {
    let photo = request(3, r#"{"photo":4}"#, r#""model":0,"degree":2"#);
    let texts = [pose(r#""still":true,"picture":"depth""#, 1), photo, r#"{"shown":1}"#.into()];
    let damaged = (0..CASES).map(|n| {
        let [text, other] = [n, n + 1].map(|n| texts[n % texts.len()].as_bytes());
        frame(0x81, &mutate(rng, text, other))
    });
    let answers = conversations(viewer, damaged);
    // Some are read, and some are not.
    let refused = said(&answers, "from another version");
    assert!((24..CASES - 24).contains(&refused), "{refused} of {CASES} were refused");
}

/// What the viewer says in a conversation of its own to each of these bytes.
fn conversations(viewer: &Viewer, damaged: impl Iterator<Item = Vec<u8>>) -> Vec<Vec<u8>> {
    let head = upgrade(viewer, &viewer.host, &format!("http://{}", viewer.host), &viewer.cookie);
    let answers = damaged.map(|bytes| {
        let answer = exchange(viewer, [head.as_bytes(), &bytes]);
        assert_eq!(status(&answer), 101);
        answer
    });
    answers.collect()
}

/// Number of the answers that hold these words.
fn said(answers: &[Vec<u8>], words: &str) -> usize {
    answers.iter().filter(|answer| answer.windows(words.len()).any(|w| w == words.as_bytes())).count()
}
