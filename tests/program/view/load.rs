//! What a viewer bears: bursts of requests, pages that come and go, pages that do nothing.

use super::session::pose;
use super::viewer;
use std::time::{Duration, Instant};

/// Growth of memory by 50 pages that came and went, in bytes.
const GROWTH: f64 = 5e6;

/// A camera that moves 500 times in a second, and a page that shows what it gets: two frames at most are under way, and the last
/// camera's picture comes. In 300 ms where nothing else runs; here the machine may be busy.
#[test]
fn the_last_of_a_burst_is_shown_soon() {
    let viewer = viewer(&[]);
    let mut socket = viewer.socket();
    socket.picture(&pose("", 0));
    let begun = Instant::now();
    let (mut frames, mut newest) = (0_u32, 0);
    for number in 1..=500 {
        socket.send(&pose("", number));
        while let Some((header, _)) = socket.frame_within(Duration::from_micros(500)) {
            assert!(header.number > newest, "pictures come in order");
            (frames, newest) = (frames + 1, header.number);
            socket.send(r#"{"shown":0}"#);
        }
        std::thread::sleep((Duration::from_millis(2) * number).saturating_sub(begun.elapsed()));
    }
    let sent = Instant::now();
    let mut under_way = 0;
    while newest < 500 {
        newest = socket.frame().expect("a picture").0.number;
        under_way += 1;
        socket.send(r#"{"shown":0}"#);
    }
    assert!(sent.elapsed() < Duration::from_secs(3), "the last picture took {:?}", sent.elapsed());
    // What was drawn before the last request came, and the last one.
    assert!(under_way <= 3, "{under_way} pictures came after the last request");
    assert!(frames >= 5, "{frames} pictures in {:?}", begun.elapsed());
    println!("{frames} pictures of 500 requests, the last {:?} after its request", sent.elapsed());
}

#[test]
fn pages_that_come_and_go_leave_no_memory_behind() {
    let viewer = viewer(&[]);
    let visit = |number: u32| {
        let mut socket = viewer.socket();
        for step in 0..3 {
            socket.picture(&pose("", 3 * number + step));
        }
        // Half of them leave while a picture is under way.
        if number.is_multiple_of(2) {
            socket.send(&pose(r#""still":true"#, 3 * number + 3));
        }
    };
    // Threads and allocators have their first needs.
    (0..10).for_each(visit);
    let before = viewer.memory();
    assert!(before > 1e6, "the system tells no memory");
    (10..60).for_each(visit);
    // Threads of the last ones end by themselves.
    let begun = Instant::now();
    while viewer.memory() > before + GROWTH && begun.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(50));
    }
    let grown = viewer.memory() - before;
    assert!(grown < GROWTH, "50 pages left {:.1} MB", grown / 1e6);
    println!("50 pages left {:.2} MB", grown / 1e6);
}

/// More connections than are served, none of which sends a request: the oldest make room.
#[test]
fn silent_connections_keep_nobody_out() {
    let viewer = viewer(&[]);
    let silent: Vec<_> = (0..40).map(|_| viewer.connect()).collect();
    for path in ["/", "/page.js", "/scene.json"] {
        assert_eq!(viewer.get(path).0, 200, "{path}");
    }
    drop(silent);
}

#[test]
fn a_page_that_rests_is_sent_nothing_and_costs_little() {
    let viewer = viewer(&[]);
    let mut socket = viewer.socket();
    socket.picture(&pose("", 1));
    socket.picture(&pose(r#""still":true"#, 2));
    let (before, begun) = (viewer.processor_seconds(), Instant::now());
    assert!(before > 0.0, "the system tells no times");
    assert!(socket.frame_within(Duration::from_secs(3)).is_none(), "a picture that nobody requested");
    let share = (viewer.processor_seconds() - before) / begun.elapsed().as_secs_f64();
    assert!(share < 0.02, "{:.1} % of a core while nothing happens", 100.0 * share);
    println!("{:.2} % of a core while nothing happens", 100.0 * share);
}
