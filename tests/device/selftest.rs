//! Every case of `qirf-vk selftest`, room by room.

use crate::support::mutants::{Mistake, rewritten};
use crate::support::{device, finish, rounding, skip, source};
use qirf_vk::selftest::{Check, Verdict, cases};
use std::path::Path;
use std::process::Command;
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
    driver: "driver", scan: "scan", sort: "sort", compact: "compact", overlap: "overlap",
    participation: "participation", project: "project", rasterise: "rasterise", backward: "backward", adam: "adam",
    ssim: "ssim",
);

/// A dropped term, a wrong clamp and a wrong constant, each in a case that must detect it.
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
            right: "vec2(greaterThanEqual(slope, least_slope(v))) * vec2(lessThanEqual(slope, most_slope(v)))",
            wrong: "vec2(1)",
            shaders: &["render/project_backward"],
        },
    ),
    (
        "ssim",
        "noise",
        Mistake {
            file: "lib/ssim.glsl",
            right: "const float C2 = 9e-4;",
            wrong: "const float C2 = 8e-4;",
            shaders: &["train/loss", "train/loss_tiles"],
        },
    ),
];

/// Whether this is a copied program (`tools/gpu-report`) on a machine that cannot compile its shaders.
fn cannot_compile() -> bool {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("glsl").is_dir();
    std::env::var_os("QIRF_SOURCE").is_some() && !(here && Command::new("glslc").arg("--version").output().is_ok())
}

#[test]
fn mistakes_are_wrong_and_not_rounding() {
    if cannot_compile() {
        return skip("no glslc, or no shaders");
    }
    for (room, name, mistake) in MISTAKES {
        let (device, _folder) = mistake.device();
        let case = cases(false).find(|c| (c.room(), c.name()) == (room, name)).unwrap();
        let checks = case.run(&device).unwrap();
        let wrong: Vec<&Check> = checks.iter().filter(|c| c.verdict == Verdict::Wrong).collect();
        println!("{}: {wrong:#?}", mistake.file);
        assert!(!wrong.is_empty(), "{}: {checks:#?}", mistake.file);
    }
}

/// Every exponential, logarithm, root, sine and quotient is off by up to two units in the last place.
#[test]
fn bounds_hold_where_devices_round_differently() {
    let mut changed = 0;
    let (device, _folder) = rewritten(&source("glsl/spirv"), |_| (), |words| rounding::rewrite(words, &mut changed));
    assert!(changed > 100, "{changed} instructions");
    let rooms = ["overlap", "participation", "project", "rasterise", "backward", "adam", "ssim"];
    let mut worst = [0.0_f64; 7];
    for case in cases(true) {
        let Some(room) = rooms.iter().position(|room| *room == case.room()) else { continue };
        for check in case.run(&device).unwrap() {
            let seen = check.seen.unwrap_or(f64::INFINITY);
            assert_eq!(check.verdict, Verdict::Pass, "{check:?}");
            worst[room] = worst[room].max(if check.allowed > 0.0 { seen / check.allowed } else { 0.0 });
        }
    }
    println!("{changed} instructions; of what is allowed: {:?}", rooms.iter().zip(worst).collect::<Vec<_>>());
    finish(&device);
}
