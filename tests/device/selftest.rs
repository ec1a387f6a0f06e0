//! Every case of `qirf-vk selftest`, room by room.

use crate::support::mutants::Mistake;
use crate::support::{device, finish};
use qirf_vk::selftest::{Check, Verdict, cases};
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

/// A dropped term, a wrong clamp and a wrong constant, each in a case that has to notice.
const MISTAKES: [(&str, &str, Mistake); 3] = [
    (
        "overlap",
        "known pairs",
        Mistake {
            file: "qirf/overlap.comp",
            right: "z0 * z0 + z1 * z1 + z2 * z2",
            wrong: "z0 * z0 + z1 * z1",
            shaders: &["qirf/overlap"],
        },
    ),
    (
        "backward",
        "flat discs",
        Mistake {
            file: "render/project_backward.comp",
            right: "vec2(lessThanEqual(abs(slope), v.tangent_limit))",
            wrong: "vec2(1)",
            shaders: &["render/project_backward"],
        },
    ),
    (
        "ssim",
        "noise",
        Mistake {
            file: "train/loss.comp",
            right: "const float C2 = 9e-4;",
            wrong: "const float C2 = 8e-4;",
            shaders: &["train/loss"],
        },
    ),
];

#[test]
fn mistakes_are_wrong_and_not_rounding() {
    for (room, name, mistake) in MISTAKES {
        let (device, _folder) = mistake.device();
        let case = cases(false).find(|c| (c.room(), c.name()) == (room, name)).unwrap();
        let checks = case.run(&device).unwrap();
        let wrong: Vec<&Check> = checks.iter().filter(|c| c.verdict == Verdict::Wrong).collect();
        println!("{}: {wrong:#?}", mistake.file);
        assert!(!wrong.is_empty(), "{}: {checks:#?}", mistake.file);
    }
}
