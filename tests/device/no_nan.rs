//! Guards against NaN and infinity on drivers that assume there are none: other files' tests with rewritten modules.

use super::{effects, overlap, participation, rasterise, respond, train};
use crate::support::no_nan::{self, Outcome};
use crate::support::source;
use qirf_vk::gpu::Device;
use qirf_vk::selftest::{Check, cases};
use std::time::Instant;

type Test = (&'static str, fn(&Device));

const TESTS: [Test; 11] = [
    ("rasterise", rasterise::hard_gaussians),
    ("gradients", train::adam::gradients_not_finite),
    ("parameters", train::adam::parameters_not_finite),
    ("selftest", selftest),
    ("respond", respond::gradients_not_finite),
    ("densify", train::density::decisions),
    ("densify, any gradients", train::density::any_gradients),
    ("smoothing", train::smoothing::least_scales),
    ("exposure", effects::exposure::kernel_and_twin),
    ("overlap", overlap::values_not_finite),
    ("participation", participation::not_finite),
];

/// The selftest's cases with infinities: hard Gaussians alone, and impossible gradients.
fn selftest(device: &Device) {
    let hard =
        [("project", "opacity logits to infinity"), ("project", "quaternions of any length"), ("adam", "gradients")];
    let chosen = cases(false).filter(|case| hard.contains(&(case.room(), case.name())));
    let checks: Vec<Check> = chosen.flat_map(|case| case.run(device).unwrap()).collect();
    assert!(hard.iter().all(|(room, name)| checks.iter().any(|c| c.room == *room && c.name.starts_with(name))));
    let failed: Vec<&Check> = checks.iter().filter(|check| !check.passed()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

/// `QIRF_MODULES` names another folder of modules to rewrite, such as an older commit's, to see which tests fail.
fn guards_hold(outcome: Outcome) {
    let own = source("glsl/spirv");
    let modules = std::env::var_os("QIRF_MODULES").map_or(own, Into::into);
    let (device, _folder, changed) = no_nan::device(&modules, outcome);
    println!("{outcome:?}: {changed:?}");
    assert!(changed.comparisons > 50 && changed.extremes > 50, "{changed:?}");
    let mut failed = Vec::new();
    for (name, test) in TESTS {
        let begun = Instant::now();
        let passed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| test(&device))).is_ok();
        println!("{name}: {passed}, {:.1} s", begun.elapsed().as_secs_f64());
        failed.extend((!passed).then_some(name));
    }
    assert!(failed.is_empty(), "{outcome:?}: {failed:?}");
}

#[test]
fn guards_hold_where_comparisons_with_nan_are_true() {
    guards_hold(Outcome::Unordered);
}

#[test]
fn guards_hold_where_a_comparison_and_its_opposite_are_false() {
    guards_hold(Outcome::BothFalse);
}
