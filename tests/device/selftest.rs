//! Every case of `qirf-vk selftest`, room by room.

use crate::support::{device, finish};
use qirf_vk::selftest::cases;
use std::time::Instant;

fn room(name: &str) {
    let device = device();
    let mut failed = Vec::new();
    let mut count = 0;
    for case in cases(false).filter(|c| c.room() == name) {
        let begun = Instant::now();
        let checks = case.run(&device).unwrap();
        println!("{name}, {:.1} s", begun.elapsed().as_secs_f64());
        for check in checks {
            println!(
                "  {}: {:?}, allowed {:e} {}",
                check.name,
                check.seen,
                check.allowed,
                check.problem.as_deref().unwrap_or("")
            );
            count += 1;
            if !check.passed() {
                failed.push(check);
            }
        }
    }
    assert!(count > 0, "no case of {name}");
    assert!(failed.is_empty(), "{failed:#?}");
    finish(&device);
}

macro_rules! rooms {
    ($($test:ident: $name:literal),* $(,)?) => {
        $(#[test]
        fn $test() {
            room($name);
        })*

        #[test]
        fn no_room_is_left_out() {
            let known = [$($name),*];
            assert!(cases(false).all(|c| known.contains(&c.room())));
        }
    };
}

rooms!(
    driver: "driver", scan: "scan", sort: "sort", compact: "compact", sum: "sum", overlap: "overlap",
    participation: "participation", project: "project", rasterise: "rasterise", backward: "backward", adam: "adam",
    ssim: "ssim",
);
