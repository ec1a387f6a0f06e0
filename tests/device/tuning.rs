//! Kernels with the tunings of GPUs, on any device: the quick selftest of every room whose kernels differ.

use crate::support::{finish, opened};
use qirf_vk::gpu::{DeviceClass, TuningChoice};
use qirf_vk::selftest::{Check, cases};

const ROOMS: [&str; 6] = ["scan", "sort", "rasterise", "backward", "adam", "ssim"];

#[test]
fn kernels_tuned_for_gpus_are_right_here_too() {
    let tuning = Some(TuningChoice::class(DeviceClass::Gpu));
    let device = opened(|options| options.tuning = tuning);
    assert_eq!((device.tuning().class, device.tuning().tile), (DeviceClass::Gpu, 16));
    let rooms = cases(true).filter(|case| ROOMS.contains(&case.room()));
    let checks: Vec<Check> = rooms.flat_map(|case| case.run(&device).unwrap()).collect();
    assert!(ROOMS.iter().all(|room| checks.iter().any(|check| check.room == *room)), "{checks:#?}");
    let failed: Vec<&Check> = checks.iter().filter(|check| !check.passed()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
    finish(&device);
}
